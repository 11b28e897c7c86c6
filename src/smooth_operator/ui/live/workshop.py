"""Another method, preset or setting while the hand moves: built beside the loop."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.human.operator import OperatorProfile
from smooth_operator.offline import Request, build_retargeter, settled_config
from smooth_operator.retargeters.method import MethodConfig
from smooth_operator.retargeters.presets import method_config
from smooth_operator.retargeters.retargeter import Retargeter
from smooth_operator.runtime.loop import TeleopLoop
from smooth_operator.runtime.pipeline import HandPipeline
from smooth_operator.types import Side
from smooth_operator.ui.live.fields import changed

_DEBOUNCE_S: Final = 0.4
"""A slider that has not moved for so long has been let go of [s]."""


@dataclass(frozen=True, eq=False)
class Choice:
    """What the hands are, or should be, driven by.

    Attributes:
        method: its name.
        preset: and that of its preset.
        base: the preset's own configuration, which sets the ranges of sliders.
        configs: side -> configuration, with what has been changed.
    """

    method: str
    preset: str
    base: MethodConfig
    configs: Mapping[Side, MethodConfig]

    @property
    def shown(self) -> MethodConfig:
        """The configuration of the first hand; the others' differ in their operators only."""
        return next(iter(self.configs.values()))


class Workshop:
    """Builds retargeters on a thread of its own; the loop goes on with the old ones until then.

    What is asked for while one is built replaces it: only the newest is handed over.

    Args:
        loop: whose hands they are for.
        asked: what the run was begun with.

    Attributes:
        used: what drives the hands.
        wanted: what was asked for last; ``used`` if nothing is under way.
        error: why the last wish failed; empty if it did not.
        refused: how many wishes failed, so that a page knows to show the old values again.
    """

    def __init__(self, loop: TeleopLoop, asked: Request) -> None:
        self._loop, self._asked = loop, asked
        self._hands = {side: p.retargeter.hand for side, p in loop.pipelines.items()}
        self.operators: dict[Side, OperatorProfile | None] = dict.fromkeys(
            self._hands, asked.operator
        )
        configs = {side: p.retargeter.config for side, p in loop.pipelines.items()}
        self.used = self.wanted = Choice(asked.method, asked.preset, asked.config, configs)
        self.error = ""
        self.refused = 0
        self.building = ""
        self._due = 0.0
        self._changed = threading.Condition()
        self._ending = False
        self._thread = threading.Thread(target=self._run, name="workshop", daemon=True)
        self._thread.start()

    def choose(self, method: str, preset: str | None = None) -> None:
        """Ask for a method; its default preset if none is named.

        Raises:
            UnknownNameError: there is no such method or preset.
            ConfigError: the operator does not fit.
        """
        self._want(self._settled(method, preset), 0.0)

    def set(self, path: str, value: Any) -> None:
        """Ask for one setting to be changed, for all hands.

        Raises:
            ConfigError: it can't have that value.
        """
        with self._changed:
            wanted = self.wanted
            try:
                configs = {s: changed(c, path, value) for s, c in wanted.configs.items()}
            except SmoothOperatorError:
                self.refused += 1
                raise
            self._want(replace(wanted, configs=configs), _DEBOUNCE_S)

    def operate(self, side: Side, operator: OperatorProfile | None) -> None:
        """Ask for an operator's calibration to be used; changed settings go back to the preset's.

        Raises:
            ConfigError: it was made for another hand.
        """
        before, self.operators[side] = self.operators[side], operator
        try:
            self._want(self._settled(self.wanted.method, self.wanted.preset), 0.0)
        except SmoothOperatorError:
            self.operators[side] = before
            raise

    def stop(self) -> None:
        """End; what is being built is not waited for."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()

    def _settled(self, method: str, preset: str | None) -> Choice:
        base = method_config(method, preset)
        asked = replace(self._asked, method=method, preset=preset or "", config=base)
        configs = {
            side: settled_config(replace(asked, operator=self.operators[side]), hand)
            for side, hand in self._hands.items()
        }
        return Choice(method, preset or "default", base, configs)

    def _want(self, choice: Choice, after: float) -> None:
        with self._changed:
            self.wanted, self.error = choice, ""
            self._due = time.monotonic() + after
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ending or self.wanted is not self.used)
                while not self._ending and (rest := self._due - time.monotonic()) > 0:
                    self._changed.wait(rest)
                if self._ending:
                    return
                choice, used = self.wanted, self.used
                self.building = f"compiling {choice.method} {choice.preset}"
            try:
                built = self._build(choice, used)
            except Exception as error:  # whatever it is, the old one goes on
                known = isinstance(error, SmoothOperatorError)
                self._fail(choice, str(error) if known else f"{type(error).__name__}: {error}")
            else:
                self._hand_over(choice, built)

    def _build(self, choice: Choice, used: Choice) -> dict[Side, Retargeter]:
        return {
            side: build_retargeter(self._hands[side], config, self._asked.seed)[0]
            for side, config in choice.configs.items()
            if config != used.configs[side]
        }

    def _hand_over(self, choice: Choice, built: Mapping[Side, Retargeter]) -> None:
        def switch(hand: HandPipeline) -> None:
            if hand.side in built:
                hand.switch(built[hand.side])

        with self._changed:
            self.building = ""
            if choice is self.wanted and not self._ending:
                self.used = choice
                self._loop.controls.change(switch)

    def _fail(self, choice: Choice, error: str) -> None:
        with self._changed:
            self.building = ""
            if choice is self.wanted:
                self.wanted, self.error = self.used, error
                self.refused += 1


def checked(operator: OperatorProfile | None) -> OperatorProfile:
    """The operator, where there is one.

    Raises:
        ConfigError: there is none.
    """
    if operator is None:
        raise ConfigError("there is no finished calibration; calibrate first")
    return operator
