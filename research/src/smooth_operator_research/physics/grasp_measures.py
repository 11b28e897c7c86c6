"""Grasps of a robot hand on an object in physics: hold, push, release."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Final, Generic, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.aligned_recording import align_recording, calibrate_scale
from smooth_operator.types import HandRecording, Side
from smooth_operator_benchmark.recordings import SYNTHETIC, load_sources, parse_request
from smooth_operator_research.physics.grasp_physics import (
    GRASP_OBJECTS,
    POWER_GRASP_OBJECTS,
    GraspObject,
    GraspPhysics,
    PinchPhysics,
    PowerGraspPhysics,
)
from smooth_operator_research.physics.human_grasps import (
    HumanClosing,
    HumanGrasp,
    HumanPinch,
    find_closings,
    find_pinches,
    with_holds,
)
from smooth_operator_research.physics.measure import (
    Case,
    Clip,
    Drawing,
    Measured,
    PhysicsSettings,
    Unit,
)
from smooth_operator_research.physics.page import interval_drawings
from smooth_operator_research.physics.results import Figure, MeasureResults, Row

HOLD_S: Final = 1.0
"""Time for which the object must be held [s]."""
GRACE_S: Final = 0.2
"""Time after the human's tightest moment by which the robot must hold the object [s]."""
REST_S: Final = HOLD_S + GRACE_S + 0.05
"""Time for which the human rests at the tightest moment [s]."""
PUSH_N: Final = 0.3
"""[N]"""
OPEN_S: Final = 0.15
"""Time after the human's opening by which the robot must release the object [s]."""
HYSTERESIS: Final = 0.003
"""The human has opened when the skin distance exceeds the object's width by this [m]."""

_GRIP_N: Final = 0.2  # thumb and finger press so hard [N]...
_GRIP_S: Final = 0.05  # ... for so long before the object is let go [s]
_LOST_S: Final = 0.03  # not pressed from both sides for so long is lost [s]
_ALONE_S: Final = 0.25  # of the hold, without a push [s]
_LIMIT: Final = 0.99  # of a motor's torque


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotGrasp:
    """Commands of the robot in a grasp, and times of the human's grasp.

    Attributes:
        stamps: (T,) times of the commands [s].
        commands: (T, n) positions of all joints [rad].
        tight: time at which the human's hand is closed most and rests [s].
        shut: time until which the human holds the object [s]; None: to the end of the recording.
        opened: time at which the human has opened (in a pinch, by ``HYSTERESIS`` more) [s]; None:
            never.
    """

    stamps: Float[np.ndarray, " T"]
    commands: Float[np.ndarray, "T n"]
    tight: float
    shut: float | None
    opened: float | None


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotPinch(RobotGrasp):
    """Commands of the robot in a pinch, and times of the human's pinch.

    Attributes:
        finger: index of the pinching finger in ``Hand.fingers``.
        closing: last time before the human's tightest moment at which the commanded pads are
            farther apart than the object is wide [s]; None: they never are.
    """

    finger: int
    closing: float | None


@dataclass(frozen=True)
class GraspResult:
    """Result of a grasp of an object; its two sides are thumb and finger in a pinch, and fingers
    against palm and thumb in a grasp with the whole hand.

    Attributes:
        touched: True if the pads came as near as the object is wide; always True for a grasp with
            the whole hand.
        held: True if both sides pressed on it for a second under gravity and pushes, except for
            gaps of up to 30 ms.
        dropped: True if both sides had it and lost it while the human still held.
        let_go: True if it was free in time after the human opened; None if it was not held until
            then, or the recording ends before.
        delay: time from the human's opening until it was free [s]; None if it never was, or if
            ``let_go`` is None.
        gap: smallest excess of the pads' distance over the object's width [m]; 0 if they touched.
        force: mean force of the weaker side while it was held [N]; None without a hold.
        at_limit: fraction of the hold with a motor at its torque limit; None without a hold.
    """

    touched: bool
    held: bool = False
    dropped: bool = False
    let_go: bool | None = None
    delay: float | None = None
    gap: float = 0.0
    force: float | None = None
    at_limit: float | None = None


def try_pinch(physics: PinchPhysics, pinch: RobotPinch) -> GraspResult:
    """Tries a pinch with an object.

    When the pads close for the last time and are as far apart as the object is wide, it appears
    between them. Somebody holds it loosely until both pads press on it, or until ``GRACE_S`` after
    the human's tightest moment. Then it must stay for ``HOLD_S``, while it is pushed in six
    directions one after the other, and be free ``OPEN_S`` after the human has opened.
    """
    physics.begin(pinch.finger, pinch.commands[0])
    run = _Run(physics, pinch)
    gap = _close(run, pinch.closing)
    return GraspResult(False, gap=gap) if gap > 0.0 else run.result()


def try_power_grasp(physics: PowerGraspPhysics, grasp: RobotGrasp) -> GraspResult:
    """Tries to grasp an object with the whole hand.

    It lies in the open palm from the beginning. Somebody holds it loosely until ``GRACE_S`` after
    the human's tightest moment; everything else is as in ``try_pinch``.
    """
    physics.begin(grasp.commands[0])
    physics.appear()
    return _Run(physics, grasp, waits=True).result()


def _close(run: _Run[PinchPhysics], closing: float | None) -> float:
    """Waits until the pad distance equals the object's width; returns the remaining difference
    [m]."""
    width = run.physics.thing.width
    before, least = -1.0, np.inf
    if closing is None:
        # Pads that never were as far apart as the object could not take it.
        return 1e-6
    for _ in run.until(run.grasp.tight + GRACE_S):
        gap = run.physics.gap().distance
        least = min(least, gap - width)
        if before > width >= gap and run.time >= closing:
            run.physics.appear()
            return 0.0
        before = gap
    return max(float(least), 1e-6)


_Physics = TypeVar("_Physics", bound=GraspPhysics)


class _Run(Generic[_Physics]):
    """One trial with its stages.

    Args:
        waits: True to hand over the object when the time is up, not when both sides press on it.
    """

    def __init__(self, physics: _Physics, grasp: RobotGrasp, waits: bool = False) -> None:
        self.physics, self.grasp, self._waits = physics, grasp, waits
        self._start = float(grasp.stamps[0])
        self._frame = 0
        self._grips: list[float] = []
        self._efforts: list[float] = []
        self._gripped = False
        self._lost = 0.0
        self._zero = physics.time

    @property
    def time(self) -> float:
        """Time on the clock of the grasp [s]."""
        return self._start + self.physics.time - self._zero

    def result(self) -> GraspResult:
        """Runs the stages after the object has appeared."""
        if not self.hand_over():
            return GraspResult(True, dropped=self._gripped)
        held = self.hold()
        force = float(np.mean(self._grips)) if self._grips else None
        limit = float(np.mean(np.array(self._efforts) > _LIMIT)) if self._efforts else None
        if not held:
            return GraspResult(True, dropped=self._gripped, force=force, at_limit=limit)
        grasp, end = self.grasp, float(self.grasp.stamps[-1])
        opened = grasp.opened if grasp.opened is not None and grasp.opened + OPEN_S <= end else None
        free = self.release(end if opened is None else opened + OPEN_S)
        if free is not None and free < (end if grasp.shut is None else grasp.shut):
            return GraspResult(True, True, True, force=force, at_limit=limit)
        if opened is None:
            return GraspResult(True, True, force=force, at_limit=limit)
        delay = None if free is None else free - opened
        return GraspResult(True, True, False, free is not None, delay, 0.0, force, limit)

    def hand_over(self) -> bool:
        """Waits until both sides press on the object; False if it is lost before the hold
        begins."""
        pressed = 0.0
        for step in self.until(self.grasp.tight + GRACE_S):
            pressed = pressed + step if self.physics.grip > _GRIP_N else 0.0
            if pressed >= _GRIP_S:
                self._gripped = True
                if not self._waits:
                    break
        self.physics.let_go()
        return all(self._has(step) for step in self.until(self.grasp.tight))

    def hold(self) -> bool:
        """Applies gravity and pushes; True if the object stays."""
        physics = self.physics
        axes, begin = physics.axes, self.time
        pushes = [sign * PUSH_N * axes[:, k] for k in range(3) for sign in (1.0, -1.0)]
        each = (HOLD_S - _ALONE_S) / len(pushes)
        stays, lost = True, 0.0
        for step in self.until(begin + HOLD_S):
            number = int((self.time - begin - _ALONE_S) / each)
            if self.time - begin > _ALONE_S:
                physics.push(pushes[min(number, len(pushes) - 1)])
            grip = physics.grip
            self._grips.append(grip)
            self._efforts.append(physics.effort)
            lost = 0.0 if grip > 0.0 else lost + step
            stays = lost < _LOST_S
            if not stays:
                break
        physics.push(np.zeros(3))
        return stays

    def release(self, deadline: float) -> float | None:
        """Waits until the object is free; returns the time [s], or None after the deadline."""
        lost = 0.0
        for step in self.until(deadline + _LOST_S):
            lost = 0.0 if self.physics.grip > 0.0 else lost + step
            if lost >= _LOST_S:
                return self.time - lost
        return None

    def _has(self, step: float) -> bool:
        """True if both sides press, apart from brief gaps."""
        self._lost = 0.0 if self.physics.grip > 0.0 else self._lost + step
        return self._lost < _LOST_S

    def until(self, end: float) -> Iterator[float]:
        """Advances the physics in steps, with the commands that are due."""
        physics, grasp = self.physics, self.grasp
        while self.time < end - 1e-9:
            while self._frame < len(grasp.stamps) and grasp.stamps[self._frame] <= self.time + 1e-9:
                physics.command(grasp.commands[self._frame])
                self._frame += 1
            physics.advance(physics.timestep)
            yield physics.timestep


def grasp_figures(
    grasps: str, owner: str, things: Sequence[GraspObject], *more: Figure
) -> tuple[Figure, ...]:
    """Defines the figures of a measure of grasps.

    Args:
        grasps: word for the grasps of a recording.
        owner: words for the parts that have the object.
        things: the objects; each has a figure for the share held.
        more: figures that follow the share that was dropped.
    """
    return (
        Figure(
            "held",
            "",
            "up",
            f"Share of {grasps} and objects in which the object was held for "
            "1 s under gravity and pushes of 0.3 N.",
        ),
        Figure(
            "let_go",
            "",
            "up",
            "Share of the objects held until the human opened that were free within 150 ms.",
            short="let go",
        ),
        Figure(
            "dropped",
            "",
            "down",
            f"Share of {grasps} and objects in which {owner} had the "
            "object and lost it while the human still held.",
        ),
        *more,
        Figure(
            "at_limit",
            "",
            "",
            "Share of the hold during which a motor is at its torque limit.",
            short="at the limit",
        ),
        *(
            Figure(
                _column(thing.name),
                "",
                "up",
                f"The share held, {thing.kind} of {1e3 * thing.width:g} mm.",
                short=thing.name,
                main=False,
            )
            for thing in things
        ),
    )


_UNITS, _QUICK_UNITS = 5, 1
_GRASP_S: Final = 10.0  # about as much work as so much of a recording [s]

Commanded: TypeAlias = Callable[[GraspObject], RobotGrasp | None]
"""The robot's grasp with an object; None if the human could not take the object."""


class GraspMeasure(ABC):
    """Measure that tries each grasp of the recordings on objects in physics."""

    unit = "recording"
    name: str
    figures: tuple[Figure, ...]
    things: ClassVar[tuple[GraspObject, ...]]
    quick_things: ClassVar[tuple[str, ...]]
    grasps: ClassVar[str]
    """Column with the number of grasps."""
    absent: ClassVar[str]
    """Message for recordings without such grasps; ``{}`` are their names."""
    drawn: ClassVar[int]
    """Number of figures that the report draws."""
    physics: ClassVar[type[GraspPhysics]]

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        """A single condition; nothing is varied."""
        return ("",)

    @abstractmethod
    def find(self, recording: HandRecording) -> Sequence[HumanGrasp]:
        """Finds the human's grasps in a recording."""

    def usable(self, case: Case, recording: HandRecording) -> Sequence[Any]:
        """Selects the grasps that the robot hand can try."""
        return self.find(recording)

    @abstractmethod
    def commanded(
        self,
        case: Case,
        grasp: Any,
        stamps: Float[np.ndarray, " P"],
        commands: Float[np.ndarray, "P n"],
        moments: Float[np.ndarray, " T"],
    ) -> tuple[Commanded, dict[str, float]]:
        """The robot's commands in one grasp, and further figures, whose means are reported.

        Args:
            grasp: one of ``usable``.
            stamps: (P,) times of the commands, of the recording with holds [s].
            commands: (P, n) positions of all joints [rad].
            moments: (T,) time of each frame of the original recording in ``stamps`` [s].
        """

    @abstractmethod
    def attempt(self, physics: Any, grasp: Any) -> GraspResult:
        """Tries a grasp in a physics simulation with an object."""

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        """Recordings with such grasps; built-in operators if no recording is given."""
        count = settings.count(_UNITS, _QUICK_UNITS)
        names = settings.recordings or [f"{SYNTHETIC}:{settings.seed + k}" for k in range(count)]
        requests = [
            parse_request(name, frames=settings.frames, rate=settings.rate, layout=settings.layout)
            for name in names
        ]
        units = []
        for source in load_sources(requests):
            if source.recording is not None and (grasps := self.find(source.recording)):
                effort = source.recording.duration + _GRASP_S * len(grasps)
                units.append(Unit(source.name, source.digest, source.recording, effort))
        if not units:
            raise RecordingError(self.absent.format(", ".join(names)))
        return units

    def run(self, case: Case) -> Measured:
        """Tries all grasps of a recording on all objects."""
        recording = of_side(case.unit.data, case.side)
        grasps = self.usable(case, recording)
        longer, moments = with_holds(recording, grasps, REST_S)
        commands = case.commands(longer).joint_positions
        things = [t for t in self.things if not case.quick or t.name in self.quick_things]
        tried: dict[str, list[GraspResult]] = {thing.name: [] for thing in things}
        more: dict[str, list[float]] = {}
        diverged = 0
        for grasp in grasps:
            ends = np.searchsorted(longer.stamps, [moments[grasp.first], moments[grasp.last]])
            part = slice(int(ends[0]), int(ends[1]) + 1)
            commanded, figures = self.commanded(
                case, grasp, longer.stamps[part], commands[part], moments
            )
            for name, value in figures.items():
                more.setdefault(name, []).append(value)
            for thing in things:
                if (robot := commanded(thing)) is None:
                    continue
                physics = physics_with(self.physics, case.hand_name, case.side, thing)
                before = physics.resets
                tried[thing.name].append(self.attempt(physics, robot))
                diverged += physics.resets > before
        row = grasp_row(tried) | {name: float(np.mean(values)) for name, values in more.items()}
        row[self.grasps] = len(grasps)
        row["diverged"] = diverged  # trials in which the physics came apart; they measure nothing
        if not case.clip:
            return Measured(row)
        human = align_recording(longer, case.hand, case.config.alignment)
        return Measured(row, Clip(longer.stamps, human, commands))

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        """Draws the first figures of each method."""
        return interval_drawings(self.name, results, self.figures[: self.drawn], colors)


@lru_cache(maxsize=16)
def physics_with(
    kind: type[GraspPhysics], hand_name: str, side: Side, thing: GraspObject
) -> GraspPhysics:
    """Physics simulation of a hand and an object, shared by all recordings and methods."""
    return kind(load_hand(hand_name, side), thing)


def of_side(recording: HandRecording, side: Side) -> HandRecording:
    """The recording, or its mirror image as the other hand."""
    if recording.side == side:
        return recording
    landmarks = recording.landmarks * np.array([-1.0, 1.0, 1.0])
    return HandRecording(landmarks, recording.stamps, side, recording.valid, name=recording.name)


def grasp_row(tried: Mapping[str, Sequence[GraspResult]]) -> Row:
    """Figures of all trials, and those of each object by its name."""
    every = [result for results in tried.values() for result in results]
    judged = [result.let_go for result in every if result.let_go is not None]
    held = [result for result in every if result.held]
    apart = [1e3 * result.gap for result in every if not result.touched]
    delays = [1e3 * result.delay for result in every if result.delay is not None]
    return {
        "held": _mean([result.held for result in every]),
        "let_go": _mean(judged),
        "dropped": _mean([result.dropped for result in every]),
        "force_n": _mean([result.force for result in held]),
        "at_limit": _mean([result.at_limit for result in held]),
        **{
            _column(name): _mean([result.held for result in results])
            for name, results in tried.items()
        },
        "tried": len(every),
        "touched": sum(result.touched for result in every),
        "judged": len(judged),
        "apart_mm": _mean(apart),
        "delay_ms": _mean(delays),
    }


def _column(name: str) -> str:
    return f"held_{name.replace(' ', '_')}"


def _mean(values: Sequence[float | bool | None]) -> float | None:
    finite = [float(value) for value in values if value is not None]
    return float(np.mean(finite)) if finite else None


class PinchHold(GraspMeasure):
    """The measure; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "pinch"
    title: Final = "Pinch and hold"
    definition: Final = (
        "At every pinch of a recording a card, pen, sphere or cube of 2 to 30 mm appears between "
        "the robot's pads, which should hold it for a second under gravity and a push of 0.3 N, "
        "keep it while the human holds, and release it within 150 ms of the human's opening."
    )
    page: Final = "docs/physics-measures.md#pinch-and-hold"
    figures = grasp_figures(
        "pinches",
        "thumb and finger",
        GRASP_OBJECTS,
        Figure(
            "overlap_mm",
            "mm",
            "",
            "Overlap of the pads at the command of the tightest moment, without an object; a "
            "negative value is their distance.",
            short="commanded overlap",
        ),
        Figure("force_n", "N", "", "Force of the pinch while the object is held.", short="force"),
    )
    things = GRASP_OBJECTS
    quick_things = ("card 2", "sphere 20")
    grasps = "pinches"
    absent = "no pinch in {}: expected thumb and finger tips nearer than 15 mm for 0.1 s"
    drawn = 4
    physics = PinchPhysics

    def find(self, recording: HandRecording) -> Sequence[HumanPinch]:
        """See ``GraspMeasure``."""
        return find_pinches(recording)

    def usable(self, case: Case, recording: HandRecording) -> Sequence[HumanPinch]:
        """See ``GraspMeasure``: pinches with fingers that the hand has, at the robot's size."""
        pinches = [p for p in find_pinches(recording) if p.finger in case.hand.fingers]
        if not pinches:
            raise RecordingError(
                f"{case.unit.name}: no pinch with a finger that {case.hand_name} has"
            )
        scale = calibrate_scale(recording, case.hand)
        return [pinch.of_size(scale) for pinch in pinches]

    def commanded(
        self,
        case: Case,
        grasp: HumanPinch,
        stamps: Float[np.ndarray, " P"],
        commands: Float[np.ndarray, "P n"],
        moments: Float[np.ndarray, " T"],
    ) -> tuple[Commanded, dict[str, float]]:
        """See ``GraspMeasure``."""
        finger, tight = case.hand.fingers.index(grasp.finger), float(moments[grasp.tight])
        pads = physics_with(PinchPhysics, case.hand_name, case.side, GRASP_OBJECTS[0])
        assert isinstance(pads, PinchPhysics)
        settled = int(np.searchsorted(stamps, tight + GRACE_S))
        overlap = -1e3 * pads.gap_at(finger, commands[settled])
        gaps = np.array([pads.gap_at(finger, command) for command in commands])

        def opening(width: float) -> float | None:
            frame = grasp.opening(width)
            return None if frame is None else float(moments[frame])

        def pinch(thing: GraspObject) -> RobotPinch | None:
            if grasp.opening_before < thing.width + HYSTERESIS:
                return None
            wider = stamps[(gaps > thing.width) & (stamps <= tight)]
            return RobotPinch(
                finger=finger,
                stamps=stamps,
                commands=commands,
                tight=tight,
                closing=float(wider[-1]) if len(wider) else None,
                shut=opening(thing.width),
                opened=opening(thing.width + HYSTERESIS),
            )

        return pinch, {"overlap_mm": overlap}

    def attempt(self, physics: PinchPhysics, grasp: RobotPinch) -> GraspResult:
        """See ``GraspMeasure``."""
        return try_pinch(physics, grasp)


class PowerGrasp(GraspMeasure):
    """The measure; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "grasp"
    title: Final = "Whole-hand grasp"
    definition: Final = (
        "Each time the hand of a recording closes, a handle or a ball of 30 to 65 mm lies in the "
        "robot's palm, which should hold it for a second under gravity and a push of 0.3 N, keep "
        "it while the human holds, and release it within 150 ms of the human's opening."
    )
    page: Final = "docs/physics-measures.md#whole-hand-grasp"
    figures = grasp_figures(
        "closings",
        "the hand",
        POWER_GRASP_OBJECTS,
        Figure("force_n", "N", "", "Force of the grasp while the object is held.", short="force"),
    )
    things = POWER_GRASP_OBJECTS
    quick_things = ("handle 30",)
    grasps = "closings"
    absent = (
        "the hand never closes in {}: expected index to pinky bent for 0.1 s until the tips are "
        "nearer to their bases than 0.65 of the fingers' length"
    )
    drawn = 3
    physics = PowerGraspPhysics

    def find(self, recording: HandRecording) -> Sequence[HumanClosing]:
        """See ``GraspMeasure``."""
        return find_closings(recording)

    def commanded(
        self,
        case: Case,
        grasp: HumanClosing,
        stamps: Float[np.ndarray, " P"],
        commands: Float[np.ndarray, "P n"],
        moments: Float[np.ndarray, " T"],
    ) -> tuple[Commanded, dict[str, float]]:
        """See ``GraspMeasure``."""
        robot = RobotGrasp(
            stamps=stamps,
            commands=commands,
            tight=float(moments[grasp.tight]),
            shut=float(moments[grasp.shut]),
            opened=None if grasp.opened is None else float(moments[grasp.opened]),
        )
        return lambda thing: robot, {}

    def attempt(self, physics: PowerGraspPhysics, grasp: RobotGrasp) -> GraspResult:
        """See ``GraspMeasure``."""
        return try_power_grasp(physics, grasp)
