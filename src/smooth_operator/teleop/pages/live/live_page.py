"""The live page as the loop sees it: a process that asks what to show and sends what was clicked.

viser, its WebSockets and the kinematics for drawing take a tenth of a core for each hand, in
Python. In the loop's own process each of those milliseconds may come just when a frame does, and
the loop would have to wait for the interpreter. So they are elsewhere, at a lower priority: the
page asks at its own pace over a pipe, one line of JSON each way. A page that hangs or dies harms
nothing.

In the loop's process three threads answer it. The first reads the pipe and carries out what must
not wait: an emergency stop, its release, and the pulse by which the page knows that a stop would be
carried out. The second reads the state to show, the third does what other controls ask for; an
error there is shown on the page and never ends the first.
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
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from typing import IO, TYPE_CHECKING, Any, Final, Literal

from smooth_operator.errors import ConfigError
from smooth_operator.terminal import print_note
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.teleop.arm.settings import ArmSettings
    from smooth_operator.teleop.pages.live.live_session import LiveSession


class LoopEnded(Exception):
    """The loop's process has closed the pipe, or has ended."""


class Link:
    """One end of the pipe between the page and the loop: a line of JSON for each message.

    Args:
        incoming: messages of the other end.
        outgoing: messages to it; from any thread.
    """

    def __init__(self, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._in, self._out = incoming, outgoing
        self._writing = threading.Lock()

    def receive(self) -> dict[str, Any] | None:
        """The next message, without lines that are none; None where the other end is gone."""
        with contextlib.suppress(OSError, ValueError):  # ValueError: the file is closed
            while line := self._in.readline():
                message = _parsed(line)
                if message is not None:
                    return message
        return None

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message; does nothing where the other end is gone, as ``receive`` reports.

        Raises:
            TypeError, ValueError: JSON can't hold the message.
        """
        line = json.dumps(message).encode() + b"\n"
        with contextlib.suppress(OSError, ValueError), self._writing:
            self._out.write(line)
            self._out.flush()


def _parsed(line: bytes) -> dict[str, Any] | None:
    """A line as a message; None if it is not one."""
    with contextlib.suppress(ValueError, RecursionError):
        message = json.loads(line)
        if isinstance(message, dict):
            return message
    return None


class LoopLink:
    """The page's end of the pipe: asks what to show, sends clicks, and feels the loop's pulse.

    Args:
        link: the pipe, from which nothing else is received from now on.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._pulse = -math.inf
        self._ended = threading.Event()
        for work in (self._read, self._ask):
            threading.Thread(target=work, name="loop link", daemon=True).start()

    @property
    def alive(self) -> bool:
        """True if the loop's process would carry out a stop: it answered within the last 0.5 s."""
        return time.monotonic() - self._pulse < PULSE_LIMIT_S

    def do(self, name: str, *values: Any) -> None:
        """Send a click."""
        self._link.send({"do": [name, *values]})

    def look(self, *, text: bool, scenery: int) -> dict[str, Any]:
        """The state to show; see ``LiveSession.look``. With ``setup``, another one to build; with
        ``trouble``, the reason why there is none.

        Raises:
            LoopEnded: the loop is gone.
        """
        self._link.send({"look": {"text": text, "scenery": scenery}})
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
"""State of a page that has nothing to show yet."""
PULSE_LIMIT_S: Final = 0.5
"""Age of the last answer from which on the page says that its stop does not work [s]."""
_PULSE_S: Final = 0.1
_MODULE: Final = "smooth_operator.teleop.pages.live.process"
_END_S: Final = 3.0
"""Time that the page may take to end [s]."""


@dataclass(frozen=True)
class PageSetup:
    """Settings of a page before there is anything to show.

    Attributes:
        hand: name of the robot hand, or the path of its description.
        sides: sides of the hands.
        fingers: robot finger -> human finger that drives it; None for all.
        host: address to listen on; another than this machine's own wants a token.
        port: first port to try; 0 for any free one.
        simulated: True if a simulated or measured hand is to be drawn.
        attended: True if the terminal of the run has keys, one of which stops.
        blind: the operator is not to know the method: nothing shows or changes it.
        model: MJCF or URDF that is drawn, or ``menagerie``; if None, the hand's meshes that are
            here.
        meshes: draw meshes, where there are some; otherwise simple shapes.
        details: with reflections, which a browser without a graphics card takes long to prepare.
        arm: that carries the hands; None for none.
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


class LivePage:
    """The process of a page. Use as a context manager, or call ``stop``.

    It starts immediately, and its address is there before there is anything to show.

    Args:
        setup: hands to show, and the address.

    Attributes:
        setup: as given to it, or to ``change``.
        trouble: why the page ended by itself; empty as long as it has not.
    """

    def __init__(self, setup: PageSetup) -> None:
        self.trouble = ""
        self.setup = setup
        self._address: Future[str] = Future()
        self._session: LiveSession | None = None
        self._next: PageSetup | None = None
        self._stop_pending = False  # a stop that was pressed while there was no loop
        self._ending = False
        self._looks: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._clicks: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", _MODULE],  # -P: nothing from the working folder
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # The page draws in the browser; MuJoCo's import would start a process to look for GLFW,
            # which writes a traceback to the terminal if the page ends before it.
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
        """Address of the page, with its token; waits until the port is open.

        Raises:
            ConfigError: the page can't be served there.
        """
        return self._address.result()

    def serve(self, session: LiveSession) -> str:
        """Show a loop, in the place of the one before; returns the page's address.

        A stop that was pressed before stops it.

        Raises:
            ConfigError: the page can't be served there.
        """
        url, self._session = self.url, session
        if self._stop_pending:
            self._carry_out("stop")
        return url

    def change(self, setup: PageSetup) -> None:
        """Show another setup at the same address; nothing moves on it until ``serve``."""
        session, self._session = self._session, None
        self.setup = self._next = setup
        if session is not None:
            self._stop_pending |= session.stopped
            session.close()

    def stop(self) -> None:
        """End the page; safe to call twice."""
        self._ending = True
        with contextlib.suppress(OSError):
            self._out.close()
        self._process.terminate()  # it has nothing to lose, and may be busy with its browsers
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
        """Read the page's messages until it ends."""
        failed = ""
        while (message := self._link.receive()) is not None:
            failed = str(message.get("failed", failed))
            try:
                self._take(message)
            except Exception as error:  # the next message may be a stop
                _note(f"a message of the page: {_words(error)}")
        self._looks.put(None)
        self._clicks.put(None)
        ended = "the process of the page ended" + (f": {failed}" if failed else "")
        if not self._address.done():
            self._address.set_exception(ConfigError(failed or f"{ended} before it was ready"))
        elif not self._ending:
            self.trouble = f"{ended}; the loop continues without it"
            _note(self.trouble)

    def _take(self, message: Mapping[str, Any]) -> None:
        """Carry out a stop at once, and hand the rest on to the other threads."""
        if "pulse" in message:
            self._link.send(message)
        elif "look" in message:
            self._looks.put(message["look"])
        elif message.get("do") in (["stop"], ["release"]):
            # Both here, in the order in which they came: a release must not end a later stop.
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
        """Answer the page what to show, until it ends."""
        last = ""
        while (asked := self._looks.get()) is not None:
            try:
                self._link.send(self._look(asked))
            except Exception as error:  # whatever it is, the page says it and asks again
                trouble = f"the page can't show the run: {_words(error)}"
                if trouble != last:
                    _note(trouble)
                last = trouble
                self._link.send({"trouble": trouble})

    def _look(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        setup, self._next = self._next, None
        if setup is not None:
            return {"setup": asdict(setup)}
        session = self._session
        if session is None:
            return {"hands": {}, "notice": LOADING, "stopped": self._stop_pending}
        return session.look(**asked)

    def _click(self) -> None:
        """Do what was clicked, until the page ends."""
        while (click := self._clicks.get()) is not None:
            try:
                if (session := self._session) is not None:
                    session.do(*click)
            except Exception as error:
                _note(f"a click on the page: {_words(error)}")


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _note(text: str) -> None:
    """Print a note; a terminal that is gone ends no thread."""
    with contextlib.suppress(OSError, ValueError):
        print_note(f"note: {text}")
