"""Pipe between the live page's process and that of the loop: one JSON object a line."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Mapping
from typing import IO, Any


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
