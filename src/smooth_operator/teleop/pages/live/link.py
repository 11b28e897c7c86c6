"""The page's end of the pipe to the loop's process: one line of JSON each way."""

from __future__ import annotations

import json
import threading
from typing import IO, Any


class LoopEnded(Exception):
    """Nobody answers any more: the loop's process has closed the pipe, or is gone."""


class Link:
    """Asks the loop's process what to show, and sends it what was clicked.

    Args:
        incoming: answers.
        outgoing: questions and clicks; from any thread.
    """

    def __init__(self, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._in, self._out = incoming, outgoing
        self._writing = threading.Lock()

    def hear(self) -> dict[str, Any]:
        """The next answer.

        Raises:
            LoopEnded: there is none.
        """
        line = self._in.readline()
        if not line:
            raise LoopEnded
        answer: dict[str, Any] = json.loads(line)
        return answer

    def say(self, message: dict[str, Any]) -> None:
        """Send a message.

        Raises:
            LoopEnded: nobody listens.
        """
        try:
            with self._writing:
                self._out.write(json.dumps(message).encode() + b"\n")
                self._out.flush()
        except OSError as error:
            raise LoopEnded from error

    def do(self, name: str, *values: Any) -> None:
        """Have something done; a click into the void does nothing."""
        try:
            self.say({"do": [name, *values]})
        except LoopEnded:
            return

    def look(
        self, *, text: bool, settings: int, scenery: int, configuration: bool = False
    ) -> dict[str, Any]:
        """The state to show; see ``LiveSession.look``. With ``setup``, another one to build."""
        request = {"text": text, "settings": settings, "scenery": scenery}
        self.say({"look": request, "configuration": configuration})
        return self.hear()
