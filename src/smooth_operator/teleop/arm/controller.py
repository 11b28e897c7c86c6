"""Arm controller: converts target poses of the hand's wrist to joint commands within limits.

``Clearance`` limits velocities by the distances between the arm's parts, its hand, table and wall.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import mink
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import (
    BASE,
    FLANGE,
    ArmSpec,
    CarriedHand,
    HandCapsules,
    HandMount,
    Matrix,
    Point,
    angle_between,
    arm_spec,
    inverse,
    matrix_of,
    pose_of,
    rigid,
)
from smooth_operator.teleop.arm.settings import ArmSettings, place_arms
from smooth_operator.teleop.runtime.limiter import MAX_STEP_S, JointLimiter
from smooth_operator.teleop.sinks.tick import ArmCommand
from smooth_operator.types import Side

_POSES: Final = 400
"""Number of random poses used to determine which parts can come near each other."""

_ROWS: Final = 16
"""Number of nearest pairs that limit a step; each one costs time."""

_BRAKING: Final = 0.3
"""Fraction of the joints' effect on a distance that may be used to stop before the smallest
allowed distance."""

_FATTER: Final = 0.04
"""Overlap of two capsules up to which links with one link between them count as apart [m]; the
capsules are fatter than the links."""

_LEEWAY: Final = 0.02
"""Fraction of a step's effect on a distance that is reserved for other distances."""

_DEEP: Final = 1.0
"""Penetration depth that parts never reach [m]."""

_TINY: Final = 1e-9
_SITE, _TABLE, _WALL = "target", "table", "wall"


_PARTS_M: Final = 0.02
"""Smallest distance between parts of the arm, and between arm and hand [m]."""

_TABLE_M: Final = 0.02
"""Smallest distance between the table and the arm or the palm [m]."""

_FINGERS_M: Final = 0.0
"""Smallest distance between the table and the fingers, which may touch it [m]."""

_WALL_M: Final = 0.02
"""Smallest distance between the wall and any part [m]."""

_HORIZON_M: Final = 0.3
"""Distance beyond which pairs are not limited [m]."""

_CLOSING: Final = 4.0
"""Maximum closing speed of a pair per metre of remaining clearance [1/s]."""


class Clearance(mink.CollisionAvoidanceLimit):
    """Velocity limits that keep the parts of arm and hand away from each other, the table and the
    wall.

    mink computes the near pairs, their distances and derivatives. This class adds the distance that
    each pair must keep, and limits speeds so that the joints can still stop.

    Args:
        arm: the arm; its base frame is the world.
        model: model from ``_arm_model``.
        fingers: (g,) mask of the model's geoms that the hand's joints move.
        box: bounds of the joint velocities.

    Attributes:
        nearest: smallest distance at the last step [m], except that of fingers and table; infinite
            if nothing is near.
    """

    def __init__(
        self, arm: ArmSpec, model: mujoco.MjModel, fingers: Bool[np.ndarray, " g"], box: _Box
    ) -> None:
        self.nearest = np.inf
        self._arm, self._box = arm, box
        super().__init__(
            model,
            [([int(a)], [int(b)]) for a, b in _close_pairs(arm, model)],
            gain=1.0,
            # Far below every distance, so that a bound is a distance, also inside each other.
            minimum_distance_from_collisions=-_DEEP,
            collision_detection_distance=_HORIZON_M,
        )
        pairs = np.array(self.geom_id_pairs, int).reshape(-1, 2)
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        table, wall = (
            [name in names and names.index(name) in pair for pair in pairs]
            for name in (_TABLE, _WALL)
        )
        self._touches = np.array(table, bool) & fingers[pairs].any(axis=1)
        self._least = np.select(
            [self._touches, table, wall], [_FINGERS_M, _TABLE_M, _WALL_M], _PARTS_M
        )

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.limits.Constraint:
        """Rows G and bounds h of G dq <= h; see ``mink.Limit``."""
        rows, bounds = super().compute_qp_inequalities(configuration, dt)
        assert rows is not None
        assert bounds is not None
        near = np.flatnonzero(np.isfinite(bounds))
        distance = bounds[near] * dt - _DEEP
        self.nearest = float(distance[~self._touches[near]].min(initial=np.inf))
        if not len(near):
            return mink.limits.Constraint()
        spare = distance - self._least[near]
        if len(near) > _ROWS:
            nearest = np.argpartition(spare, _ROWS)[:_ROWS]
            near, spare = near[nearest], spare[nearest]
        rows = rows[near]
        room = np.maximum(spare, 0.0)
        braking = _BRAKING * (np.abs(rows) @ self._arm.acceleration)
        bound = dt * np.minimum(min(_CLOSING, 0.5 / dt) * room, np.sqrt(2.0 * braking * room))
        # If no velocity within the joints' bounds keeps a distance, the arm brakes at its limits.
        ends = rows * self._box.low, rows * self._box.high
        least, most = np.minimum(*ends).sum(axis=1) * dt, np.maximum(*ends).sum(axis=1) * dt
        return mink.limits.Constraint(G=rows, h=np.maximum(bound, least + _LEEWAY * (most - least)))


def _close_pairs(arm: ArmSpec, model: mujoco.MjModel) -> Int[np.ndarray, "p 2"]:
    """Pairs of geoms that can come near each other within the joints' limits.

    Excludes pairs that touch at rest, pairs of links that share a joint, and the table with the
    base and the links that only rotate above it.
    """
    joints = len(arm.links)
    levels = {0: 0, model.body(BASE).id: 0, model.body(FLANGE).id: joints} | {
        model.body(f"link{i}").id: i for i in range(1, joints + 1)
    }
    level = np.array([levels[int(body)] for body in model.geom_bodyid])
    planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    least = np.full((model.ngeom, model.ngeom), np.inf)
    for number in range(_POSES + 1):
        data.qpos[:] = arm.nominal if number == 0 else rng.uniform(*arm.limits.T)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        first, second = np.sort(data.contact.geom, axis=1).T
        np.minimum.at(least, (first, second), data.contact.dist)
        if number == 0:
            touching = least < _PARTS_M
    first, second = np.triu_indices(model.ngeom, 1)
    apart, plane = np.abs(level[first] - level[second]), planes[first] | planes[second]
    meet = (least[first, second] < 2 * _PARTS_M) & ~touching[first, second] & ~plane
    # One link and the next are shaped not to collide; the three axes of a wrist meet.
    meet &= (apart >= 2) & ~((level[first] >= joints - 2) & (level[second] >= joints - 2))
    # The joint limits keep links apart that are two joints from each other. Their capsules are
    # fatter, so a small overlap is no collision.
    hand = model.geom_bodyid == model.body(FLANGE).id
    meet &= (apart != 2) | hand[second] | (least[first, second] <= -_FATTER)
    pairs = [np.stack([first[meet], second[meet]], axis=1)]
    for name, lowest in ((_TABLE, 3), (_WALL, 1)):
        for geom in np.flatnonzero(planes):
            if model.geom(geom).name == name:
                free = np.flatnonzero((level >= lowest) & ~planes)
                pairs.append(np.stack([np.full(len(free), geom), free], axis=1))
    return np.concatenate(pairs)


def _arm_model(
    arm: ArmSpec,
    mount: HandMount,
    site: Matrix,
    capsules: HandCapsules,
    table: float | None,
    wall: float | None,
) -> mujoco.MjModel:
    """Model of an arm with the site ``_SITE``, table and wall; the hand's capsules come last."""
    spec = arm_spec(arm)
    flange = spec.body(FLANGE)
    pose = pose_of(site)
    flange.add_site(name=_SITE, pos=pose[:3], quat=pose[3:])
    middles, axes = capsules.at(mount.hand.full_configuration(mount.hand.neutral))
    turns = _quaternions(axes)
    for k, (radius, half) in enumerate(zip(capsules.radii, capsules.halves, strict=True)):
        flange.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=(radius, max(half, _TINY), 0.0),
            pos=middles[k],
            quat=turns[k],
            mass=0.0,
        )
    if table is not None:
        _add_plane(spec, _TABLE, (0.0, 0.0, table), (0.0, 0.0, 1.0))
    if wall is not None:
        _add_plane(spec, _WALL, (0.0, wall, 0.0), (0.0, -np.sign(wall), 0.0))
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 1
        geom.margin = 2 * _PARTS_M
    model = spec.compile()
    model.geom_sameframe[model.ngeom - len(capsules) :] = 0  # capsules move in the flange's frame
    return model


def _add_plane(
    spec: mujoco.MjSpec, name: str, position: tuple[float, ...], normal: tuple[float, ...]
) -> None:
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(1.0, 1.0, 1.0),
        pos=position,
        quat=_quaternions(np.array([normal]))[0],
    )


def _quaternions(axes: Float[np.ndarray, "c 3"]) -> Float[np.ndarray, "c 4"]:
    """Rotations of the z axis onto unit vectors (w x y z)."""
    x, y, z = axes.T
    turns = np.stack([1.0 + z, -y, x, np.zeros_like(x)], axis=1)
    lengths = np.linalg.norm(turns, axis=1, keepdims=True)
    return np.asarray(np.where(lengths > _TINY, turns / np.maximum(lengths, _TINY), (0, 1, 0, 0)))


_SMOOTHING_S: Final = 0.03
"""Time constant of the estimate of the target's velocity [s]."""

_JUMP: Final = 3.0
"""Velocity above which a target counts as having jumped [m/s]; for rotations, three times this
number [rad/s]."""

_HOME_STEPS: Final = 1000
_HOME_STEP_S: Final = 0.01
_HOME_NEAR: Final = (1e-3, 5e-3)
"""Distance at which the home pose counts as reached [m, rad]."""


_SPEED: Final = 1.0
_TURN: Final = 3.0
"""Velocity limits of the wrist [m/s] and [rad/s]."""

_ACCELERATION: Final = 3.0
_TURN_ACCELERATION: Final = 10.0
"""Accelerations with which the wrist stops at its target [m/s^2] and [rad/s^2]."""

_VELOCITY_SHARE: Final = 0.9
"""Fraction of the vendor's joint velocity limits that is used."""

_JOINT_SPEED: Final = 2.0
"""Velocity limit of every joint [rad/s], above which an arm can't stop in time."""

_MARGIN: Final = 0.02
"""Distance to keep from each end of a joint's range [rad]."""

_WEIGHTS: Final = (0.15, 0.03)
"""Weights of 1 rad of rotation error, and of 1 rad from the preferred posture, against 1 m."""

_SOFT_WEIGHTS: Final = (0.03, 0.005)
"""``_WEIGHTS`` for arms with fewer than six joints, which can't reach every orientation: the
position then comes first."""

_DAMPING: Final = 0.08
"""Largest damping near a singular pose [m]."""

_SINGULAR: Final = 0.04
"""Smallest singular value of the Jacobian without damping [m/rad]."""


class ArmController:
    """Makes an arm follow target poses of its hand's wrist, one step per command of the loop.

    Each step solves one quadratic program (mink, daqp) for joint velocities: the wrist's error,
    a preferred posture and damping near singular poses, within limits of position, velocity,
    acceleration and clearance. ``JointLimiter`` comes last, so the first three limits hold for any
    target. If the program has no solution, the arm brakes.

    An arm with fewer than six joints can't reach every orientation. It brings the point between the
    tips of thumb and index finger to its place, and turns the hand as far as it can.

    Not thread-safe: it belongs to the loop.

    Args:
        arm: the arm.
        mount: the hand on the arm's flange.
        table: height of the table in the base frame [m]; None without a table.
        wall: y of a wall in the base frame that the arm does not cross [m]; None without a wall.
        collisions: True to avoid collisions between parts.

    Attributes:
        limiter: limiter with the last command.

    Raises:
        ConfigError: the arm can't reach its home pose with this hand.
    """

    def __init__(
        self,
        arm: ArmSpec,
        mount: HandMount,
        *,
        table: float | None = 0.0,
        wall: float | None = None,
        collisions: bool = True,
    ) -> None:
        self.arm, self.mount, self._collisions = arm, mount, collisions
        self._soft = len(arm.links) < 6
        self._to_site = mount.wrist_to_pinch if self._soft else np.eye(4)
        self._capsules = HandCapsules(mount)
        site = mount.flange_to_wrist @ self._to_site
        self.model = _arm_model(arm, mount, site, self._capsules, table, wall)
        nominal = np.array(arm.nominal)
        self._configuration = mink.Configuration(self.model, nominal)
        self._site = self.model.site(_SITE).id
        self._hand_geoms = slice(self.model.ngeom - len(self._capsules), None)
        fingers = np.zeros(self.model.ngeom, bool)
        fingers[self._hand_geoms] = self._capsules.fingers
        self._box = _Box(self.model.nv)
        self._clearance = Clearance(arm, self.model, fingers, self._box)
        self._orientation, posture = _SOFT_WEIGHTS if self._soft else _WEIGHTS
        self._task = mink.FrameTask(
            _SITE, "site", position_cost=1.0, orientation_cost=self._orientation
        )
        self._posture = mink.PostureTask(self.model, cost=posture, gain=0.02)
        self._posture.set_target(nominal)
        self._hand = mount.hand.full_configuration(mount.hand.neutral)
        self.limiter = self._limiter(nominal)
        self._before: Matrix | None = None
        self._twist = np.zeros(6)
        self.home = nominal if arm.home is None else self._go_home(arm.home)

    @property
    def q(self) -> Float[np.ndarray, " n"]:
        """(n,) last command [rad]."""
        return self.limiter.q

    @property
    def pose(self) -> Float[np.ndarray, "7"]:
        """(7,) pose of the hand's wrist at the last command, in the base frame."""
        return pose_of(self._at_site() @ inverse(self._to_site))

    def wrist_at(self, positions: Float[np.ndarray, " n"]) -> Float[np.ndarray, "7"]:
        """Pose of the hand's wrist in the base frame.

        Args:
            positions: (n,) positions of the arm's joints [rad].
        """
        data = mujoco.MjData(self.model)
        data.qpos[:] = positions
        mujoco.mj_kinematics(self.model, data)
        site = rigid(data.site_xmat[self._site].reshape(3, 3), data.site_xpos[self._site])
        return pose_of(site @ inverse(self._to_site))

    def restart(self, positions: Float[np.ndarray, " n"]) -> None:
        """Restarts the controller at measured (n,) joint positions [rad], at rest."""
        self.limiter = self._limiter(positions)
        self._configuration.update(self.limiter.q)
        self._before = None

    def step(
        self,
        target: Float[np.ndarray, "7"] | None,
        dt: float,
        hand: Float[np.ndarray, " h"] | None = None,
        *,
        stop: bool = False,
    ) -> ArmCommand:
        """Computes the next command.

        Args:
            target: wrist pose in the base frame: position [m], quaternion (w x y z). None, or a
                pose that is not finite, holds the arm.
            dt: time since the last command [s].
            hand: (h,) positions of all joints of the hand [rad]; by default unchanged.
            stop: True to brake as hard as the limits allow and stay at rest.
        """
        if hand is not None and np.isfinite(hand).all():
            self._hand = hand
        dt = max(dt, 1e-4)
        goal = None
        if not stop and target is not None and np.isfinite(target).all():
            turns = np.linalg.norm(target[3:]) >= 1e-6
            goal = matrix_of(target) @ self._to_site if turns else None
        state = "stopped" if stop else "holding" if goal is None else "following"
        if goal is None:
            self.limiter.rest(dt)
            self._before = None
        else:
            velocity, limited = self._solve(goal, min(dt, MAX_STEP_S))
            if velocity is None:
                self.limiter.rest(dt)
            else:
                self.limiter.follow(velocity, dt)
            state = limited or state
        self._configuration.update(self.limiter.q)
        now = self._at_site()
        apart = (float("nan"), float("nan"))
        if goal is not None:
            apart = float(np.linalg.norm(goal[:3, 3] - now[:3, 3])), angle_between(now, goal)
        return ArmCommand(
            self.arm.name,
            self.arm.joint_names,
            self.limiter.q.copy(),
            self.limiter.velocity.copy(),
            self.pose,
            *apart,
            self._clearance.nearest,
            state,
        )

    def _solve(self, goal: Matrix, dt: float) -> tuple[Float[np.ndarray, " n"] | None, str]:
        """Joint velocities [rad/s], and ``braking`` if there is no solution."""
        middles, axes = self._capsules.at(self._hand)
        self.model.geom_pos[self._hand_geoms] = middles
        self.model.geom_quat[self._hand_geoms] = _quaternions(axes)
        self._configuration.update()
        now = self._at_site()
        step = self._governed(now, goal, dt)
        aim = now.copy()
        aim[:3, 3] += step[:3]
        aim[:3, :3] = mink.SO3.exp(step[3:]).as_matrix() @ now[:3, :3]
        self._task.set_target(mink.SE3.from_matrix(aim))
        self._box.low, self._box.high = self.limiter.bounds(dt)
        limits: list[mink.Limit] = [self._box]
        if self._collisions:
            limits.append(self._clearance)
        try:
            velocity = mink.solve_ik(
                self._configuration,
                [self._task, self._posture],
                dt,
                "daqp",
                damping=self._damping(),
                limits=limits,
            )
        except (mink.NoSolutionFound, ValueError):
            return None, "braking"
        return velocity, ""

    def _governed(self, now: Matrix, goal: Matrix, dt: float) -> Float[np.ndarray, "6"]:
        """Motion of this step: translation [m] and rotation vector [rad], in the base frame.

        It is the target's own motion, plus as much of the remaining distance as lets the wrist stop
        at the target.
        """
        if self._before is not None:
            moved = _difference(self._before, goal) / dt
            if max(np.linalg.norm(moved[:3]), np.linalg.norm(moved[3:]) / 3.0) > _JUMP:
                moved = np.zeros(6)
            self._twist = self._twist + (moved - self._twist) * min(1.0, dt / _SMOOTHING_S)
        else:
            self._twist = np.zeros(6)
        self._before = goal
        error = _difference(now, goal)
        return np.concatenate(
            [
                _approach(error[:3], self._twist[:3], dt, _ACCELERATION, _SPEED),
                _approach(error[3:], self._twist[3:], dt, _TURN_ACCELERATION, _TURN),
            ]
        )

    def _damping(self) -> float:
        """Damping of the quadratic program [m^2]; zero if the arm can move in every direction."""
        jacobian = self._configuration.get_frame_jacobian(_SITE, "site")
        scaled = jacobian[:3] if self._soft else jacobian.copy()
        scaled[3:] *= self._orientation
        least = np.sqrt(max(float(np.linalg.eigvalsh(scaled @ scaled.T)[0]), 0.0))
        share = max(0.0, 1.0 - least / _SINGULAR)
        return 1e-6 + float(share * _DAMPING) ** 2

    def _at_site(self) -> Matrix:
        data = self._configuration.data
        return rigid(data.site_xmat[self._site].reshape(3, 3), data.site_xpos[self._site])

    def _limiter(self, start: Float[np.ndarray, " n"]) -> JointLimiter:
        velocity = np.minimum(_VELOCITY_SHARE * self.arm.velocity, _JOINT_SPEED)
        return JointLimiter(self.arm.limits, velocity, self.arm.acceleration, start, _MARGIN)

    def _go_home(self, place: Point) -> Float[np.ndarray, " n"]:
        """Joint positions of the home pose, reached from the nominal posture by normal steps.

        In that pose, the fingers point forward and down, and the back of the hand up.
        """
        half = self.arm.pitch / 2.0
        pose = np.array([*place, np.cos(half), 0.0, np.sin(half), 0.0])
        for _ in range(_HOME_STEPS):
            command = self.step(pose, _HOME_STEP_S)
            if (
                command.position_error < _HOME_NEAR[0]
                and command.rotation_error < _HOME_NEAR[1]
                and np.abs(command.velocity).max() < 1e-2
            ):
                self.restart(self.limiter.q)
                return self.limiter.q.copy()
        raise ConfigError(
            f"arm {self.arm.name!r} can't reach the home pose of hand {self.mount.hand.name!r}: "
            f"{1e3 * command.position_error:.0f} mm and {command.rotation_error:.2f} rad remain; "
            "mount the hand at another roll angle, or with a thinner adapter"
        )


class _Box(mink.Limit):
    """Bounds of the joint velocities [rad/s], set before each step."""

    def __init__(self, count: int) -> None:
        self.low = self.high = np.zeros(count)
        self._rows = np.concatenate([np.eye(count), -np.eye(count)])

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.limits.Constraint:
        del configuration
        return mink.limits.Constraint(G=self._rows, h=np.concatenate([self.high, -self.low]) * dt)


def _approach(
    error: np.ndarray, moving: np.ndarray, dt: float, acceleration: float, speed: float
) -> np.ndarray:
    """A step [m or rad] that follows a moving target and stops at a target at rest."""
    distance = float(np.linalg.norm(error))
    # The step and the braking after it must not overshoot a resting target.
    late = acceleration * dt
    closing = min(np.sqrt(late**2 + 2.0 * acceleration * distance) - late, distance / dt)
    velocity = moving + (error * (closing / distance) if distance > 1e-12 else 0.0)
    fast = float(np.linalg.norm(velocity))
    return np.asarray(velocity * (min(1.0, speed / fast) if fast > 0 else 1.0) * dt)


def _difference(one: Matrix, other: Matrix) -> Float[np.ndarray, "6"]:
    """Translation [m] and rotation vector [rad] from one pose to another, in the base frame."""
    turn, vector = mink.SO3.from_matrix(other[:3, :3] @ one[:3, :3].T), np.zeros(3)
    mujoco.mju_quat2Vel(vector, turn.wxyz, 1.0)  # mink's logarithm of half a turn is zero
    return np.concatenate([other[:3, 3] - one[:3, 3], vector])


@dataclass(frozen=True, eq=False)
class ArmOfHand:
    """An arm that carries a hand, and its controller.

    Attributes:
        carried: arm and hand for simulations and pages.
        controller: controller for the loop.
    """

    carried: CarriedHand
    controller: ArmController


def build_arms(settings: ArmSettings, hands: Mapping[Side, Hand]) -> dict[Side, ArmOfHand]:
    """Creates an arm for each hand, and a virtual wall between two arms.

    Args:
        hands: side -> robot hand.

    Raises:
        ConfigError: an arm can't reach its home pose with the hand.
    """
    built = {}
    for side, carried in place_arms(settings, hands).items():
        controller = ArmController(
            carried.arm,
            carried.mount,
            table=None if settings.no_table else settings.table,
            wall=-float(carried.base[1, 3]) if len(hands) > 1 else None,
            collisions=settings.collisions,
        )
        built[side] = ArmOfHand(replace(carried, home=controller.home), controller)
    return built
