"""``smooth``: the default method for live use; accurate, smooth and without self-collision.

It adds to Eq. (1) that fingertips copy the motion of the human's and reach positions within reach
exactly, that the thumb's vectors are controlled by angle and length, that its pad faces like the
human's, that parts of the hand do not penetrate each other, and a fingertip filter against the
tracker's shake and jumps. docs/explanation/smooth.md has the equations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.geometry import lengths
from smooth_operator.hands.differential import PointKinematics, linear_joints
from smooth_operator.hands.finger_circles import SHORTER, bends_past_straight
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.pose_table import PoseTable
from smooth_operator.hands.stand_ins import stand_in_note
from smooth_operator.landmarks import TIPS
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.correspondence import (
    Correspondence,
    CorrespondenceConfig,
    CorrespondenceState,
)
from smooth_operator.retargeting.fingertip_filter import (
    FilterState,
    FingertipFilterConfig,
    filter_fingertips,
)
from smooth_operator.retargeting.levenberg import damped_newton
from smooth_operator.retargeting.method import Method, MethodOutput, ObjectiveMethodConfig
from smooth_operator.retargeting.objective import FrameGoal, Objective, TermsConfig
from smooth_operator.retargeting.pinch_gaps import PinchGapEstimate, PinchGapState
from smooth_operator.retargeting.program import FrameClock
from smooth_operator.retargeting.smooth_terms import (
    DirectionLength,
    DirectionLengthConfig,
    FingerSpread,
    FingertipPositionConfig,
    FingertipTracking,
    PadDirection,
    SelfCollision,
    SelfCollisionConfig,
)
from smooth_operator.retargeting.targets import CloseTargets, KeyvectorLayout
from smooth_operator.retargeting.trajectory import FUTURE, TrajectoryMethodConfig
from smooth_operator.settings import check_numbers, is_off

REFERENCE: Final = 0.01
"""Time between frames to which the weights of change refer [s]. They scale with 1 / dt, so that an
error decays in the same time at any frame rate."""

ASTRAY: Final = 0.01
"""Distance from its target at which a fingertip is lost [m], in excess of the distance of the
nearest pose in the table. Its motion then has half of its weight."""
PATIENCE: Final = 0.3
"""Time for which a fingertip must be lost before another pose is searched [s]."""
BETTER: Final = 0.7
"""Cost of another pose, relative to that of the hand's own pose, below which it is used."""
LEAP: Final = (0.03, 1.0)
"""Distance [m] and speed [m/s] beyond which a fingertip has jumped between two frames: the tracker
is wrong now, or was wrong before."""
SETTLED: Final = 0.15
"""Time after a jump at which the previous command is discarded [s]."""


@dataclass(frozen=True)
class SmoothConfig(ObjectiveMethodConfig):
    """Settings of ``smooth``. A weight of 0 disables its term.

    Attributes:
        alignment: alignment of human landmarks to the palm frame.
        objective: targets, pose weight, and terms of your own.
        motion_weight: weight of the term that makes fingertips copy the human's motion, at 100 Hz.
        motion_speed: human fingertip speed at which that weight is halved [m/s]; it falls with the
            square of the speed.
        pinch_damping: added to the velocity weight of joints that move the thumb or a finger that
            is latched to it, because moving fingers roll a held object out of the pinch. It falls
            with speed like the motion weight.
        spread_weight: cost of the squared excess of a long finger's spread over 0.2 rad [1/rad^2].
        pad_weight: cost of one minus the cosine between the last segments of the robot's and the
            human's thumb.
        fingertip_position: cost of small position errors of fingertips.
        self_collision: cost of parts of the hand that penetrate each other.
        direction_length: cost of direction and length of the thumb-to-tip vectors.
        correspondence: fingertip targets for fingers of different lengths.
        fingertips: settings of the fingertip filter.
        iterations: maximum number of Newton steps of a descent. Most frames need two to four, and
            one in a hundred needs 15; descents that are stopped early end at different poses.
    """

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    objective: TermsConfig = field(default_factory=TermsConfig)
    motion_weight: float = 6000.0
    motion_speed: float = 0.05
    pinch_damping: float = 100.0
    spread_weight: float = 1.0
    pad_weight: float = 2.0
    fingertip_position: FingertipPositionConfig = field(default_factory=FingertipPositionConfig)
    self_collision: SelfCollisionConfig = field(default_factory=SelfCollisionConfig)
    direction_length: DirectionLengthConfig = field(default_factory=DirectionLengthConfig)
    correspondence: CorrespondenceConfig = field(default_factory=CorrespondenceConfig)
    fingertips: FingertipFilterConfig = field(default_factory=FingertipFilterConfig)
    iterations: int = 50

    def __post_init__(self) -> None:
        check_numbers(self, positive=("motion_speed", "iterations"))

    def build(self, hand: Hand) -> Smooth:
        """Builds the method for one hand."""
        return Smooth(hand, self)

    def notes(self, hand: Hand) -> tuple[str, ...]:
        """Note on estimated collision shapes."""
        note = stand_in_note(hand) if self.self_collision.weight else None
        return (note,) if note else ()


class SmoothState(NamedTuple):
    """Everything that ``smooth`` remembers between frames.

    Attributes:
        q: (m,) last command of the actuated joints [rad].
        reach: (F, 3) vectors from the wrist to the fingertips at that command [m].
        operator: lengths of the operator's fingers; empty without a correspondence.
        gaps: gaps that the tracker leaves in pinches.
        filtered: the fingertip filter's state, of the needed landmarks.
        targets: state of the target policy.
        ticks: time of the last frame, in microseconds modulo 2^32.
        frames: number of frames with a command so far.
        astray: time for which a fingertip has been lost [s].
        leapt: time since a fingertip jumped [s].
    """

    q: Float[Array, " m"]
    reach: Float[Array, "F 3"]
    operator: CorrespondenceState | tuple[()]
    gaps: PinchGapState
    filtered: FilterState
    targets: Any
    ticks: UInt32[Array, ""]
    frames: UInt32[Array, ""]
    astray: Float[Array, ""]
    leapt: Float[Array, ""]


class Smooth(Method):
    """The method ``smooth`` for one hand.

    Attributes:
        hand: the robot hand.
        config: settings.
        objective: the terms to minimise: those of Eq. (1), and six more.
        layout: the vectors from wrist and thumb's tip to the fingertips, which the terms need.
        points: kinematics of the wrist and the fingertips.
        closing: closes the gaps of a tracker in pinches.
        correspondence: correspondence of human and robot fingers.
        pose_table: start poses for frames without a last command.
    """

    uneven = True

    def __init__(self, hand: Hand, config: SmoothConfig) -> None:
        self.hand, self.config = hand, config
        layout = Objective(hand, config.objective).layout
        terms = (
            FingertipTracking(layout, config.fingertip_position),
            DirectionLength(layout, config.direction_length),
            SelfCollision(hand, config.self_collision),
            FingerSpread(hand, config.spread_weight),
            PadDirection(hand, config.pad_weight),
        )
        self.objective = Objective(hand, config.objective, terms)
        self.layout = cast(KeyvectorLayout, layout)
        self.points = PointKinematics(hand.tree, self.objective.keyvectors.points())
        self.closing = PinchGapEstimate(hand)
        self.correspondence = Correspondence(hand, config.correspondence)
        self.pose_table = PoseTable(hand)

    @property
    def needs(self) -> tuple[int, ...]:
        """Indices of the wrist and the fingertips."""
        return self.layout.landmarks

    def init(self, seed: int) -> SmoothState:
        """State with the neutral pose; the method uses no random numbers."""
        del seed
        hand, put = self.hand, jax.device_put  # which does not compile
        reach = hand.tips(hand.full_configuration(hand.neutral)) - hand.wrist
        return SmoothState(
            put(hand.neutral.astype(np.float32)),
            put(reach.astype(np.float32)),
            () if is_off(self.config.correspondence.share) else self.correspondence.init(),
            PinchGapState.of(hand.fingers, {}),
            FilterState.unseen(len(self.needs)),
            self.config.objective.targets.init(self.objective.layout),
            *put((np.uint32(0), np.uint32(0), np.float32(0), np.float32(1))),
        )

    def latched(self, state: SmoothState) -> Bool[Array, " P"] | None:
        """(F - 1,) True for fingers latched to the thumb; None if the targets have no latches."""
        return self.config.objective.targets.latched(state.targets)

    def pinch_gaps(self, state: SmoothState) -> Float[Array, " P"]:
        """(F - 1,) estimated gaps between thumb and finger in a pinch [palm lengths]."""
        return state.gaps.gap

    def with_pinch_gaps(self, state: SmoothState, known: Mapping[str, float] | None) -> SmoothState:
        """Returns the state with known gaps; None disables closing gaps."""
        return state._replace(gaps=PinchGapState.of(self.hand.fingers, known))

    def continued(self, fresh: SmoothState, before: SmoothState) -> SmoothState:
        """Returns a fresh state with the pinch gaps of an earlier state."""
        return fresh._replace(gaps=before.gaps)

    def fingertip_targets(self, state: SmoothState) -> Float[Array, "F 3"] | None:
        """(F, 3) fingertip targets of the last frame in the palm frame [m]; None before the first
        frame, and if the settings have no correspondence."""
        if not state.operator or not np.asarray(state.frames):
            return None
        return state.operator.places

    @property
    def trajectory_objective(self) -> Objective:
        """The method's objective. The filter is left out, because the future is known."""
        return self.objective

    def step(
        self, state: SmoothState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[SmoothState, MethodOutput]:
        """Computes one frame; see ``Method.step``."""
        config, now = self.config, jnp.asarray(ticks, jnp.uint32)
        clock = FrameClock.of(now - state.ticks, state.frames)

        # fingertips without the tracker's pinch gaps, jumps and shake
        gaps, closed = self.closing.step(state.gaps, aligned, clock)
        measured = closed[np.array(self.needs)]  # the wrist and the fingertips
        filtered, still, steps = filter_fingertips(
            state.filtered, measured, config.fingertips, clock
        )
        tips, speeds = filtered.followed[1:], still[1:] - still[0]
        leaps = lengths((measured - state.filtered.followed)[1:]) > LEAP[0] + LEAP[1] * clock.dt
        leapt = jnp.where(leaps.any() & ~clock.restart, 0.0, state.leapt + clock.dt)

        # their targets on the robot
        origin = jnp.asarray(self.hand.wrist, aligned.dtype)
        operator, places, moves = state.operator, tips - filtered.followed[0] + origin, speeds
        if operator:  # a tuple of arrays; empty without a correspondence
            operator, moves = self.correspondence.step(
                operator, aligned, tips, speeds, steps[1:] - steps[0], clock
            )
            places = operator.places
        table, possible = self.pose_table.nearest(places)
        policy, human = config.objective.targets, jnp.concatenate([origin[None], places])
        targets, latches = policy(state.targets, self.layout, self.layout.among(human))

        def beyond(reach: Float[Array, "F 3"]) -> Float[Array, " F"]:
            """Distance of fingertips from their targets, beyond that of the table's pose [m]."""
            return jnp.maximum(lengths(reach + origin - places) - possible, 0.0)

        # weights; the coupling between two frames decreases with the time between them
        holds = jnp.where(clock.restart, 0.0, REFERENCE / clock.dt)
        slow = 1 / (1 + (lengths(speeds, 1e-18) / clock.dt / config.motion_speed) ** 2)
        latched = policy.latched(latches)
        latched = jnp.zeros(len(tips) - 1, bool) if latched is None else latched
        pinching = slow * jnp.concatenate([latched.any()[None], latched])
        damped = (pinching[:, None] * jnp.asarray(self.pose_table.moves)).max(axis=0)
        reach, weights = state.reach + moves, config.motion_weight * holds * slow
        if operator:  # the targets are within reach, so a lasting error means a wrong pose
            weights = weights / (1 + (beyond(reach) / ASTRAY) ** 4)
        pad = aligned[TIPS[0]] - aligned[TIPS[0] - 1]
        pad = pad / lengths(pad, 1e-12)
        damping = config.pinch_damping * holds * damped
        goal = FrameGoal(*targets, state.q, damping, reach, weights, pad)

        forget = clock.restart | ((state.leapt < SETTLED) & (leapt >= SETTLED))
        search = state.astray > PATIENCE
        q = self.solve(goal, table, forget, search)

        joints = self.hand.transmission.curved(linear_joints(self.hand, q))
        vectors = self.layout.among(self.points(joints).points)
        loss = self.objective.keyvectors.slopes(vectors - goal.vectors, goal).cost
        reach, frames = vectors[: len(tips)], state.frames + jnp.uint32(1)
        lost = (beyond(reach) > ASTRAY).any() & ~search & bool(operator)
        astray = jnp.where(lost, state.astray + clock.dt, 0.0)
        after = SmoothState(q, reach, operator, gaps, filtered, latches, now, frames, astray, leapt)
        return after, MethodOutput(q, loss)

    def solve(
        self,
        goal: FrameGoal,
        table: Float[Array, " m"],
        forget: Bool[Array, ""],
        search: Bool[Array, ""],
    ) -> Float[Array, " m"]:
        """Solves one frame; returns (m,) joint positions; traceable.

        Normally, one descent starts from the last command. Without one, and shortly after a
        fingertip has jumped (``forget``), two descents without the terms about the past start from
        the table's and the neutral pose, and the one with the lower cost is used. If a fingertip
        has been lost for a while (``search``), it is used only if its cost is much lower than that
        of a third descent, which starts from the hand's own pose.
        """
        last = jnp.asarray(goal.previous)
        limits = frame_limits(self.hand, goal.vectors[: len(self.hand.fingers)])
        neutral = jnp.asarray(self.hand.neutral, last.dtype)

        def descent(start: Array, best: tuple[Array, Array]) -> tuple[Array, Array]:
            pose, lowest = best
            past = start == 0
            now = goal._replace(
                velocity_weight=jnp.where(past, goal.velocity_weight, 0.0),
                motion_weights=jnp.where(past, jnp.asarray(goal.motion_weights), 0.0),
            )
            end, cost, _ = damped_newton(
                lambda one: self.objective.value_grad_hess(one, now),
                jnp.clip(jnp.stack([last, pose, table, neutral])[start], *limits.T),
                limits,
                self.config.iterations,
            )
            taken = (start != 1) & (cost <= lowest)
            bar = jnp.where(past, jnp.inf, jnp.where(start == 1, BETTER * cost, cost))
            return jnp.where(taken, end, pose), jnp.minimum(bar, lowest)

        first, after = jnp.where(forget, 2, 0), jnp.where(forget | search, 4, 1)
        best = lax.fori_loop(first, after, descent, (last, jnp.float32(jnp.inf)))
        return jnp.asarray(best[0])


def frame_limits(
    hand: Hand, tips: Float[Array, "F 3"] | Float[np.ndarray, "F 3"]
) -> Float[Array, "m 2"] | Float[np.ndarray, "m 2"]:
    """(m, 2) joint limits for one frame [rad], given (F, 3) human fingertips relative to the
    robot's wrist [m]; traceable.

    Many robot fingers are longest some degrees before the limit of a joint beyond the knuckle. In
    between they bend backwards, and an optimiser that ends there can't bend them. If the human's
    finger is shorter than the robot's at the limit, the joint is kept on the other side.
    """
    limits, bends = hand.limits, bends_past_straight(hand)
    if not bends:
        return limits
    fingers, joints, longest, length, centres = map(np.array, zip(*bends, strict=True))
    tips = jnp.asarray(tips)
    away = tips[fingers] - jnp.asarray(centres, tips.dtype)
    bent = (away * away).sum(-1) < jnp.asarray(length - SHORTER, tips.dtype) ** 2
    low, high = (jnp.asarray(side, tips.dtype) for side in limits.T)
    low = low.at[joints].set(jnp.where(bent, jnp.asarray(longest, tips.dtype), low[joints]))
    return jnp.stack([low, high], axis=1)


SMOOTH_TELEOP: Final = SmoothConfig()
"""Preset for live use. The robot hand is open when the human's hand is open and closed when it is
closed, whatever the lengths of the fingers."""

SMOOTH_PRECISE: Final = replace(
    SMOOTH_TELEOP,
    correspondence=CorrespondenceConfig(share=0.0),
    objective=replace(SMOOTH_TELEOP.objective, targets=CloseTargets(w_wrist=1.0)),
    motion_weight=1300.0,
    motion_speed=0.1,
    pinch_damping=0.0,
    spread_weight=0.0,
    pad_weight=0.0,
    direction_length=DirectionLengthConfig(direction=2.5),
)
"""Preset for the paper's metrics: matches the human's fingertip positions and the directions from
the thumb. Fingers may stay bent in an open hand."""

SMOOTH_OFFLINE: Final = TrajectoryMethodConfig(
    SMOOTH_PRECISE,
    replace(FUTURE, acceleration_weight=3e-8, motion_weight=0.35, motion_speed=0.15),
    jump=0.02,
    noise=50.0,
)
"""Preset for recordings: ``smooth:precise`` for all frames together, without its filters."""

SMOOTH: Final = {"teleop": SMOOTH_TELEOP, "precise": SMOOTH_PRECISE, "offline": SMOOTH_OFFLINE}
