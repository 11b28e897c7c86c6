"""The process of the live page, and its pipe to the loop's process: one JSON object a line."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import warnings
from typing import IO, Any, Final

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.signals import leave_to_parent
from smooth_operator.teleop.pages.viser_server import open_server, page_url


class LoopEnded(Exception):
    """The loop's process has closed the pipe, or has ended."""


class Link:
    """Pipe to the loop's process: it gives the state to show, and takes clicks.

    Args:
        incoming: answers.
        outgoing: questions and clicks; from any thread.
    """

    def __init__(self, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._in, self._out = incoming, outgoing
        self._writing = threading.Lock()

    def receive(self) -> dict[str, Any]:
        """The next answer.

        Raises:
            LoopEnded: the pipe is closed.
        """
        line = self._in.readline()
        if not line:
            raise LoopEnded
        answer: dict[str, Any] = json.loads(line)
        return answer

    def send(self, message: dict[str, Any]) -> None:
        """Send a message.

        Raises:
            LoopEnded: the pipe is closed.
        """
        try:
            with self._writing:
                self._out.write(json.dumps(message).encode() + b"\n")
                self._out.flush()
        except OSError as error:
            raise LoopEnded from error

    def do(self, name: str, *values: Any) -> None:
        """Send a click; without a loop it does nothing."""
        try:
            self.send({"do": [name, *values]})
        except LoopEnded:
            return

    def look(self, *, text: bool, scenery: int) -> dict[str, Any]:
        """The state to show; see ``LiveSession.look``. With ``setup``, another one to build."""
        self.send({"look": {"text": text, "scenery": scenery}})
        return self.receive()


_NICE: Final = 5
"""The loop goes first; the page still gets its share on a busy machine."""


def main() -> None:
    """Serves the page until the loop's process closes the pipe."""
    # What a library prints must not get between the messages.
    outgoing = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    # viser warns of each message to a browser that has just left, which happens
    warnings.filterwarnings("ignore", message="Queued a", category=UserWarning)
    leave_to_parent()
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(_NICE)
    link = Link(sys.stdin.buffer, outgoing)
    with contextlib.suppress(LoopEnded):
        setup = link.receive()
        try:
            server = open_server(setup["host"], setup["port"])
            link.send({"url": page_url(setup["host"], server)})
            # After the address, which a person waits for: this reads the hand and more libraries.
            from smooth_operator.teleop.pages.live.drawing import LiveDrawing

            drawing = LiveDrawing(server, link, setup)
        except SmoothOperatorError as error:
            link.send({"failed": str(error)})
            return
        with contextlib.suppress(LoopEnded):
            drawing.run()
        # The system closes the port now. viser would wait for its browsers and threads, for
        # seconds on a busy machine, and the run does not end before this process.
        os._exit(0)


if __name__ == "__main__":
    main()
