"""Messages between the live page's process and that of the loop, one JSON object a line."""

from __future__ import annotations

import json
import threading
from typing import IO, Any


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
