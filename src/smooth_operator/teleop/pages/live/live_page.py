"""The live page as the loop sees it: a process that asks what to show and sends what was clicked.

viser, its WebSockets and the kinematics for drawing take a tenth of a core for each hand, in
Python. In the loop's own process each of those milliseconds may come just when a frame does, and
the loop would have to wait for the interpreter. So they are elsewhere, at a lower priority: the
page asks at its own pace over a pipe, one line of JSON each way, and the thread that answers is
all that the loop's process knows of it. A page that hangs or dies harms nothing.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import IO, TYPE_CHECKING, Any, Final

from smooth_operator.errors import ConfigError
from smooth_operator.terminal import print_note
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.teleop.arm.settings import ArmSettings
    from smooth_operator.teleop.pages.live.live_session import LiveSession


class LoopEnded(Exception):
    """The loop's process has closed the pipe, or has ended."""


class Link:
    """One end of the pipe. The page asks what to show and sends clicks, the loop answers.

    Args:
        incoming: messages of the other end.
        outgoing: messages to it; from any thread.
    """

    def __init__(self, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._in, self._out = incoming, outgoing
        self._writing = threading.Lock()

    def receive(self) -> dict[str, Any] | None:
        """The next message; None where the other end is gone."""
        with contextlib.suppress(OSError, ValueError):
            if line := self._in.readline():
                message: dict[str, Any] = json.loads(line)
                return message
        return None

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message; does nothing where the other end is gone, as ``receive`` reports."""
        with contextlib.suppress(OSError, ValueError), self._writing:
            self._out.write(json.dumps(message).encode() + b"\n")
            self._out.flush()

    def do(self, name: str, *values: Any) -> None:
        """Send a click."""
        self.send({"do": [name, *values]})

    def look(self, *, text: bool, scenery: int) -> dict[str, Any]:
        """The state to show; see ``LiveSession.look``. With ``setup``, another one to build.

        Raises:
            LoopEnded: the loop is gone.
        """
        self.send({"look": {"text": text, "scenery": scenery}})
        if (answer := self.receive()) is None:
            raise LoopEnded
        return answer


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
        self._url = ""
        self._session: LiveSession | None = None
        self._next: PageSetup | None = None
        self._thread: threading.Thread | None = None
        self._ending = False
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

    @property
    def url(self) -> str:
        """Address of the page, with its token; waits until the port is open.

        Raises:
            ConfigError: the page can't be served there.
        """
        if not self._url:
            ended = {"failed": "the process of the page ended before it was ready"}
            first = self._link.receive() or ended
            if "failed" in first:
                raise ConfigError(str(first["failed"]))
            self._url = str(first["url"])
        return self._url

    def serve(self, session: LiveSession) -> str:
        """Show a loop, in the place of the one before; returns the page's address.

        Raises:
            ConfigError: the page can't be served there.
        """
        url, self._session = self.url, session
        if self._thread is None:
            self._thread = threading.Thread(target=self._answer, name="page", daemon=True)
            self._thread.start()
        return url

    def change(self, setup: PageSetup) -> None:
        """Show another setup at the same address; nothing moves on it until ``serve``."""
        if self._session is not None:
            self._session.close()
        self.setup = self._next = setup
        self._session = None

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
        if self._thread is not None:
            self._thread.join(_END_S)
            self._thread = None
        self._in.close()
        if self._session is not None:
            self._session.close()

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _answer(self) -> None:
        """Answer the page until it ends."""
        failed = ""
        while (message := self._link.receive()) is not None:
            session = self._session
            if "do" in message and session is not None:
                session.do(*message["do"])
            elif "look" in message:
                setup, self._next = self._next, None
                answer: dict[str, Any] = {"hands": {}}
                if setup is not None:
                    answer["setup"] = asdict(setup)
                elif session is not None:
                    answer = session.look(**message["look"])
                self._link.send(answer)
            elif "failed" in message:
                failed = f": {message['failed']}"
        if not self._ending:
            self.trouble = f"the process of the page ended{failed}; the loop goes on without it"
            print_note(f"note: {self.trouble}")
