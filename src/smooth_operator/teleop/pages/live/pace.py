"""Frame rate of the page: no more than the slowest browser shows."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any, Final

import viser

_FASTEST_S: Final = 1 / 30
_SLOWEST_S: Final = 1.0
_LATE_S: Final = 0.1
_RECENT: Final = 12  # questions; the slowest answer counts
_SETTLE: Final = 3  # pictures of a slow browser in which it shows nothing else
_EVERY_S: Final = 0.3  # between two questions
_PATIENCE_S: Final = 2.0


class Pace:
    """Occasionally asks each browser for a message, and measures how long the answer takes.

    Browsers handle messages in order, so a browser that can't keep up answers late. What it has
    not shown yet would grow without bound otherwise, and a page that is seconds late is dangerous.

    viser's page puts poses of nodes into its next picture and all other changes into the one
    after, and draws no further picture once 250 ms are over. Where a picture takes longer, bodies
    and lines on it are of different moments. So a slow browser gets the lines first, and the bodies
    one picture later.

    Args:
        server: whose browsers they are.

    Attributes:
        period: least time between two drawn frames [s].
        delay: how late the slowest browser shows what it is sent, at worst in the last few
            seconds [s]; the time of one picture varies a lot without a graphics card.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self.period, self.delay = _FASTEST_S, 0.0
        self._server = server
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self._thread = threading.Thread(target=self._run, name="pace", daemon=True)
        self._thread.start()

    @property
    def slow(self) -> bool:
        """Whether what belongs together has to be sent in two steps, with a ``wait`` between
        them."""
        return self.delay >= _LATE_S

    def wait(self) -> None:
        """Until all browsers have handled what they were sent; two seconds at most for each."""
        for client in self._server.get_clients().values():
            _round_trip(client)

    def _run(self) -> None:
        while True:
            time.sleep(_EVERY_S)
            clients = list(self._server.get_clients().values())
            slowest = max((_round_trip(client) for client in clients), default=0.0)
            self._recent.append(slowest)
            self.period, self.delay = period_for(slowest), max(self._recent)


def period_for(delay: float) -> float:
    """Least time between two drawn frames for a browser that shows them so late [s]."""
    wanted = delay if delay < _LATE_S else _SETTLE * delay
    return min(max(_FASTEST_S, wanted), _SLOWEST_S)


def _round_trip(client: Any) -> float:
    """Until a browser has handled all that it was sent before now [s]; 0 if it has left."""
    start = time.monotonic()
    try:
        client.local_storage.get_item("pace", timeout=_PATIENCE_S)
    except TimeoutError:
        return _PATIENCE_S
    except RuntimeError:  # it has left, or keeps no such things, and says so
        pass
    return time.monotonic() - start
