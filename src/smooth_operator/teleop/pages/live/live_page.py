"""The loop's part of the live page: starts the page's process, answers its requests and carries out
clicks.

Drawing in Python takes a tenth of a core for each hand and would delay commands if it ran in the
loop's process. So the page is a separate process of lower priority. It asks for the state at its
own rate over a pipe, with one line of JSON in each direction. A page that hangs or dies does not
affect the loop.

Three threads serve the page. The first reads the pipe, carries out an emergency stop and its
release, and answers the heartbeat that tells the page that a stop would work. The second sends the
state, and the third carries out other clicks. Their errors are shown on the page and never end the
first thread.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field
from typing import IO, TYPE_CHECKING, Any, Final, Literal

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.control.bindings import DEFAULT_KEYS
from smooth_operator.terminal import print_note
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.teleop.arm.settings import ArmSettings
    from smooth_operator.teleop.pages.live.live_session import LiveSession


class LoopEnded(Exception):
    """The loop's process has closed the pipe or has ended."""


class Link:
    """One end of the pipe between page and loop. Each message is one line of JSON."""

    def __init__(self, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._in, self._out = incoming, outgoing
        self._writing = threading.Lock()

    def receive(self) -> dict[str, Any] | None:
        """Returns the next message, skipping other lines; None if the other end is closed."""
        with contextlib.suppress(OSError, ValueError):  # ValueError: the file is closed
            while line := self._in.readline():
                with contextlib.suppress(ValueError, RecursionError):
                    message = json.loads(line)
                    if isinstance(message, dict):
                        return message
        return None

    def send(self, message: Mapping[str, Any]) -> None:
        """Sends a message; safe from any thread. Does nothing if the other end is closed."""
        line = json.dumps(message).encode() + b"\n"
        with contextlib.suppress(OSError, ValueError), self._writing:
            self._out.write(line)
            self._out.flush()


class LoopLink:
    """The page's end of the pipe: requests the state, sends clicks, and checks the heartbeat."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._pulse = -math.inf
        self._ended = threading.Event()
        for work in (self._read, self._ask):
            threading.Thread(target=work, name="loop link", daemon=True).start()

    @property
    def alive(self) -> bool:
        """True if the loop's process has answered within the last 0.5 s, so that a stop works."""
        return time.monotonic() - self._pulse < _PULSE_LIMIT_S

    def do(self, name: str, *values: Any) -> None:
        """Sends the action of a button that was clicked."""
        self._link.send({"do": [name, *values]})

    def look(self, *, text: bool, scenery: int, pictures: Sequence[int]) -> dict[str, Any]:
        """Requests the state of the loop.

        Returns:
            the state, as ``LiveSession.look`` returns it; or ``setup``, another page to build; or
            ``trouble``, the reason why there is no state.

        Raises:
            LoopEnded: the loop has ended.
        """
        self._link.send({"look": {"text": text, "scenery": scenery, "pictures": pictures}})
        if (answer := self._answers.get()) is None:
            raise LoopEnded
        return answer

    def _read(self) -> None:
        while (message := self._link.receive()) is not None:
            if "pulse" in message:
                self._pulse = time.monotonic()
            else:
                self._answers.put(message)
        self._pulse = -math.inf
        self._ended.set()
        self._answers.put(None)

    def _ask(self) -> None:
        while not self._ended.wait(_PULSE_S):
            self._link.send({"pulse": True})


LOADING: Final = "loading the hand and method"
"""Text that the page shows before there is a loop."""
_PULSE_LIMIT_S: Final = 0.5  # age of the last answer at which the page reports a lost stop [s]
_PULSE_S: Final = 0.1
_MODULE: Final = "smooth_operator.teleop.pages.live.process"
_END_S: Final = 3.0  # longest time for the end of the page [s]


@dataclass(frozen=True)
class PageSetup:
    """Settings of a live page.

    Attributes:
        hand: name of the robot hand, or the path of its description.
        sides: sides of the hands.
        fingers: robot finger -> human finger that drives it; None for all.
        host: address to listen on; if other machines can reach it, the page needs a token.
        port: first port to try; 0 for any free one.
        simulated: also draw a simulated or measured hand.
        attended: True if the terminal of the run accepts keys, including one for the stop.
        keys: action of the operator -> its keys.
        blind: hide the method from the operator, who then can't change it.
        model: MJCF or URDF to draw, or ``menagerie``; None for the hand's installed meshes.
        meshes: draw meshes if there are any; otherwise simple shapes.
        details: draw reflections, which take long without a graphics card.
        arm: settings of the arm that carries the hands; None for no arm.
    """

    hand: str
    sides: tuple[Side, ...] = ("right",)
    fingers: Mapping[str, str] | None = None
    host: str = "127.0.0.1"
    port: int = 8080
    simulated: bool = False
    blind: bool = False
    model: str | None = None
    meshes: bool = True
    details: bool = True
    arm: ArmSettings | None = None
    attended: bool = False
    keys: Mapping[str, Sequence[str]] = field(default_factory=lambda: DEFAULT_KEYS)


class LivePage:
    """A live page in its own process, which starts immediately.

    Use it as a context manager, or call ``stop``.

    Attributes:
        setup: the current settings.
        trouble: reason why the page ended unexpectedly; empty while it runs.
    """

    def __init__(self, setup: PageSetup) -> None:
        self.trouble = ""
        self.setup = setup
        self._address: Future[str] = Future()
        self._session: LiveSession | None = None
        self._next: PageSetup | None = None
        self._stop_pending = False  # True after a stop without a loop
        self._ending = False
        self._looks: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._clicks: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", _MODULE],  # -P: no modules from the working folder
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # The import of MuJoCo would start a process to look for GLFW, which prints a traceback
            # if the page ends before it. The page needs no OpenGL.
            env={**os.environ, "MUJOCO_GL": "disable"},
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdout, self._process.stdin
        self._link = Link(self._in, self._out)
        self._link.send(asdict(setup))
        works = (self._read, self._show, self._click)
        self._threads = [threading.Thread(target=w, name="page", daemon=True) for w in works]
        for thread in self._threads:
            thread.start()

    @property
    def url(self) -> str:
        """Address of the page with its token. Waits until the port is open; ConfigError if the page
        can't be served at the address."""
        return self._address.result()

    def serve(self, session: LiveSession) -> str:
        """Shows a loop in place of the previous one. Returns the page's address.

        If the stop was pressed while there was no loop, this loop is stopped.

        Raises:
            ConfigError: the page can't be served at the address.
        """
        url, self._session = self.url, session
        if self._stop_pending:
            self._carry_out("stop")
        return url

    def change(self, setup: PageSetup) -> None:
        """Shows other hands or settings at the same address; nothing moves until ``serve``."""
        session, self._session = self._session, None
        self.setup = self._next = setup
        if session is not None:
            self._stop_pending |= session.stopped
            session.close()

    def stop(self) -> None:
        """Ends the page's process; safe to call twice."""
        self._ending = True
        with contextlib.suppress(OSError):
            self._out.close()
        self._process.terminate()  # it has no state to save, and may be busy with its browsers
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join(_END_S)
        self._in.close()
        if self._session is not None:
            self._session.close()

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _read(self) -> None:
        """Reads the page's messages until it ends."""
        failed = ""
        while (message := self._link.receive()) is not None:
            failed = str(message.get("failed", failed))
            try:
                self._take(message)
            except Exception as error:  # the next message may be a stop
                _note(f"a message from the page failed: {_words(error)}")
        self._looks.put(None)
        self._clicks.put(None)
        ended = "the page's process ended" + (f": {failed}" if failed else "")
        if not self._address.done():
            self._address.set_exception(ConfigError(failed or f"{ended} before it was ready"))
        elif not self._ending:
            self.trouble = f"{ended}; the loop continues without it"
            _note(self.trouble)

    def _take(self, message: Mapping[str, Any]) -> None:
        """Carries out a stop or release, and passes other messages to the other threads."""
        if "pulse" in message:
            self._link.send(message)
        elif "look" in message:
            self._looks.put(message["look"])
        elif message.get("do") in (["stop"], ["release"]):
            # Both in this thread keep their order: a release must not end a later stop.
            self._carry_out(*message["do"])
        elif "do" in message:
            self._clicks.put(message["do"])
        elif "url" in message:
            self._address.set_result(str(message["url"]))

    def _carry_out(self, name: Literal["stop", "release"]) -> None:
        self._stop_pending = name == "stop"
        if (session := self._session) is not None:
            self._stop_pending = False
            session.do(name)

    def _show(self) -> None:
        """Sends the state to the page until it ends."""
        last = ""
        while (request := self._looks.get()) is not None:
            try:
                self._link.send(self._look(request))
            except Exception as error:  # the page shows any error and asks again
                trouble = f"the page can't show the run: {_words(error)}"
                if trouble != last:
                    _note(trouble)
                last = trouble
                self._link.send({"trouble": trouble})

    def _look(self, request: Mapping[str, Any]) -> dict[str, Any]:
        setup, self._next = self._next, None
        if setup is not None:
            return {"setup": asdict(setup)}
        session = self._session
        if session is None:
            return {"hands": {}, "notice": LOADING, "stopped": self._stop_pending}
        return session.look(**request)

    def _click(self) -> None:
        """Carries out clicks until the page ends."""
        while (click := self._clicks.get()) is not None:
            try:
                if (session := self._session) is not None:
                    session.do(*click)
            except Exception as error:
                _note(f"a click on the page failed: {_words(error)}")


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _note(text: str) -> None:
    """Prints a note; does nothing if the terminal was closed."""
    with contextlib.suppress(OSError, ValueError):
        print_note(f"note: {text}")
