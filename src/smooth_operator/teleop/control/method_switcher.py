"""Switches method, preset or operator of a running loop. Compiles on a separate thread."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Mapping
from concurrent.futures import Future, InvalidStateError
from dataclasses import dataclass, replace
from typing import Any

from smooth_operator.calibration.operator_file import OperatorProfile
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.planning import RetargetRequest, resolve_config
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import default_preset
from smooth_operator.retargeting.program_store import ProgramStore
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.sinks.tick import Driver
from smooth_operator.teleop.sources.live import source_gaps
from smooth_operator.types import Side


@dataclass(frozen=True, eq=False)
class DriverSpec:
    """The method that drives the hands, and its configuration for each hand.

    Attributes:
        method: name of the method.
        preset: name of its preset, never empty.
        base: configuration of the preset.
        configs: side -> configuration.
        operators: side -> profile of the operator, or None.
    """

    method: str
    preset: str
    base: MethodConfig
    configs: Mapping[Side, MethodConfig]
    operators: Mapping[Side, OperatorProfile | None]

    def driver(self, side: Side) -> Driver:
        """Method and configuration of one side, for the recordings of the run."""
        return Driver(self.method, self.preset, self.configs[side])


class MethodSwitcher:
    """Builds retargeters on a separate thread; the robot holds while a method is compiled.

    A method that this process has compiled earlier takes over without a hold. A request replaces a
    pending one: only the newest takes effect.

    Args:
        loop: the loop.
        request: the request at the start of the run.

    Attributes:
        used: current method and configurations.
        target: the last request; equals ``used`` if no request is pending.
        error: reason of the failure of the last request; empty if it did not fail.
    """

    def __init__(self, loop: TeleopLoop, request: RetargetRequest) -> None:
        self._loop, self._begun_with = loop, request
        self._hands = {side: p.retargeter.hand for side, p in loop.pipelines.items()}
        self.operators: dict[Side, OperatorProfile | None] = {
            side: request.of(side).operator for side in self._hands
        }
        configs = {side: p.retargeter.config for side, p in loop.pipelines.items()}
        self.used = DriverSpec(
            request.method, request.preset, request.config, configs, dict(self.operators)
        )
        self.target = self.used
        self.error = ""
        self.building = ""
        self._request: Future[DriverSpec] = Future()
        self._request.set_result(self.used)
        self._changed = threading.Condition()
        self._ending = False
        self._thread = threading.Thread(target=self._run, name="switcher", daemon=True)
        self._thread.start()

    def configuration(self) -> dict[str, Any]:
        """Settings to write into a recording; they may have changed since the start of the run."""
        used = self.used
        return {
            "method": used.method,
            "preset": used.preset,
            "config": dict(used.configs),
            "loop": self._loop.config,
        }

    def choose(self, method: str, preset: str | None = None) -> Future[DriverSpec]:
        """Requests another method; if no preset is given, its default preset.

        Returns:
            a future that completes when the method drives the hands, or fails with the error. A
            newer request ends it with ``ConfigError``.

        Raises:
            UnknownNameError: there is no such method or preset.
            ConfigError: the operator's file is for the other side.
        """
        with self._changed:
            return self._want(self._settled(method, preset))

    def operate(self, operators: Mapping[Side, OperatorProfile | None]) -> Future[DriverSpec]:
        """Requests other operator profiles; see ``choose``.

        Hands that are not named keep their profiles.

        Raises:
            ConfigError: the run has no hand of a side.
        """
        for side in operators:
            if side not in self._hands:
                raise ConfigError(f"there is no {side} hand in this run")
        with self._changed:
            before = dict(self.operators)
            self.operators.update(operators)
            try:
                return self._want(self._settled(self.target.method, self.target.preset))
            except SmoothOperatorError:
                self.operators.update(before)
                raise

    def close(self) -> None:
        """Stops, without waiting for a method that is being compiled."""
        with self._changed:
            self._ending = True
            _complete(self._request, ConfigError("the run has ended"))
            self._changed.notify_all()

    def _settled(self, method: str, preset: str | None) -> DriverSpec:
        base = method_config(method, preset)
        preset = preset or default_preset(method)
        request = replace(self._begun_with, method=method, preset=preset, config=base)
        configs = {
            side: resolve_config(replace(request, operator=self.operators[side]), hand)
            for side, hand in self._hands.items()
        }
        return DriverSpec(method, preset, base, configs, dict(self.operators))

    def _want(self, spec: DriverSpec) -> Future[DriverSpec]:
        replaced = ConfigError("another method was requested before this one was ready")
        _complete(self._request, replaced)
        self._request = Future()
        self.target, self.error = spec, ""
        self._changed.notify_all()
        return self._request

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ending or self.target is not self.used)
                if self._ending:
                    return
                spec, used = self.target, self.used
                self.building = f"compiling {spec.method} {spec.preset}"
            try:
                built = self._build(spec, used)
            except Exception as error:  # the old method stays in use
                expected = isinstance(error, SmoothOperatorError)
                words = f"{type(error).__name__}: {error}"
                self._fail(spec, error if expected else ConfigError(words))
            else:
                self._hand_over(spec, built)

    def _build(self, spec: DriverSpec, used: DriverSpec) -> dict[Side, Retargeter]:
        tracker = source_gaps(self._loop.source)
        built = {
            side: Retargeter(
                self._hands[side],
                config=spec.configs[side],
                seed=self._begun_with.seed,
                cache=ProgramStore.of_user(),
                pinch_gaps=replace(self._begun_with, operator=spec.operators[side]).known_gaps(
                    tracker
                ),
            )
            for side in spec.configs
            if (spec.configs[side], spec.operators[side])
            != (used.configs[side], used.operators[side])
        }
        waiting = {side for side, retargeter in built.items() if not retargeter.compiled}
        if waiting:
            self._loop.controls.change(lambda hand: hand.hold() if hand.side in waiting else None)
        for retargeter in built.values():
            retargeter.warm_up()
        return built

    def _hand_over(self, spec: DriverSpec, built: Mapping[Side, Retargeter]) -> None:
        def switch(hand: HandPipeline) -> None:
            if hand.side in built:
                hand.switch(built[hand.side], spec.driver(hand.side))
            else:
                hand.go_on()  # an earlier request may have made it hold

        with self._changed:
            self.building = ""
            if spec is not self.target or self._ending:
                return
            self.used, request = spec, self._request
            self._loop.controls.change(switch)
            # Changes are carried out in order, so the request is complete after the switch.
            self._loop.controls.change(lambda hand: _complete(request, spec))

    def _fail(self, spec: DriverSpec, error: Exception) -> None:
        with self._changed:
            self.building = ""
            if spec is self.target:
                self.target, self.error = self.used, str(error)
                self._loop.controls.change(lambda hand: hand.go_on())
                _complete(self._request, error)


def _complete(request: Future[DriverSpec], outcome: DriverSpec | Exception) -> None:
    with contextlib.suppress(InvalidStateError):  # it is complete already
        if isinstance(outcome, DriverSpec):
            request.set_result(outcome)
        else:
            request.set_exception(outcome)
