"""How often to draw: no more than the slowest browser shows."""

from __future__ import annotations

import threading
import time
from typing import Any, Final

import viser

_FASTEST_S: Final = 1 / 30
_SLOWEST_S: Final = 0.5
_EVERY_S: Final = 0.3  # between two questions
_PATIENCE_S: Final = 2.0


class Pace:
    """Asks each browser for a word now and then, and measures how long the answer takes.

    Browsers handle messages in order, so a browser that can't keep up answers late. What it has
    not shown yet would grow without bound otherwise, and a page that is seconds late is dangerous.

    Args:
        server: whose browsers they are.

    Attributes:
        period: least time between two drawn frames [s].
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self.period = _FASTEST_S
        self._server = server
        self._thread = threading.Thread(target=self._run, name="pace", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while True:
            time.sleep(_EVERY_S)
            clients = list(self._server.get_clients().values())
            slowest = max((_round_trip(client) for client in clients), default=0.0)
            self.period = min(max(_FASTEST_S, slowest), _SLOWEST_S)


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
