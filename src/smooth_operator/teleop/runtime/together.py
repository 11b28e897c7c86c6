"""Frames of both hands that come together, answered by one program."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from typing import Final

from smooth_operator.compilation.pair import PairProgram, shares_program
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.sources.live import Arrival

_LOGGER: Final = logging.getLogger("smooth_operator.teleop")

_WORTH: Final = 100
"""So many frames come together before the program is compiled: a short run does without."""


class Together:
    """Works out the answers to two frames before the hands' turns, in one program.

    The program is compiled, or read, by another thread while frames are answered one by one. It
    serves hands that are mirror images of each other; frames of others are left to their turns.
    """

    def __init__(self) -> None:
        self._program: PairProgram | None = None
        self._compiling: threading.Thread | None = None
        self._tried: list[Retargeter] = []
        self._seen = 0

    def answer(self, hands: Sequence[tuple[HandPipeline, Arrival]]) -> None:
        """Give each hand the answer to its frame, if they can be answered together.

        Args:
            hands: two, and the frames that their next steps are likely to be given.
        """
        retargeters = [hand.retargeter for hand, _ in hands]
        expected = [hand.expects(arrival) for hand, arrival in hands]
        known = [one for one in expected if one is not None]
        if len(known) < len(hands) or not shares_program(retargeters[0], retargeters[1]):
            return
        program = self._program
        if program is None or not program.fits(retargeters):
            self._seen += 1
            if self._seen >= _WORTH:
                self.prepare(retargeters)
            return
        states, frames = zip(*known, strict=True)
        answers = program.step(states, frames)
        for (hand, _), state, frame, answer in zip(hands, states, frames, answers, strict=True):
            hand.take(state, frame, answer)

    def prepare(self, retargeters: Sequence[Retargeter], wait: bool = False) -> None:
        """Compile the program on a thread of its own, once for these retargeters.

        Args:
            retargeters: one for each hand.
            wait: whether to return only when it is there.
        """
        busy = self._compiling is not None and self._compiling.is_alive()
        if not busy and self._tried != list(retargeters):
            self._tried = list(retargeters)
            # Not a daemon: one that is inside XLA when the interpreter ends can abort the process
            self._compiling = threading.Thread(target=self._compile, name="pair")
            self._compiling.start()
        if wait and self._compiling is not None:
            self._compiling.join()

    def _compile(self) -> None:
        try:
            program = PairProgram(self._tried)
            program.warm_up()
        except Exception as error:  # frames are answered one by one, as before
            _LOGGER.warning("both hands in one program: %s: %s", type(error).__name__, error)
        else:
            self._program = program
