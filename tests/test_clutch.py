"""The clutch of the wrist: limits at every pair of stamps, no jump, holds, the measured arm."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smooth_operator import HandFrame, Retargeter, load_hand, poses
from smooth_operator.planning import make_request
from smooth_operator.retargeting.flat_hand import FLAT_HAND
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.runtime.limiter import MAX_STEP_S, Clutch, PoseLimiter
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig, SafetyConfig, WristConfig
from smooth_operator.teleop.sinks.tick import Mode, WristCommand
from smooth_operator.teleop.sources.live import Arrival

HZ = 100.0
HOME = np.array(WristConfig().home)


def wrist(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: object = (0, 0, 0)) -> np.ndarray:
    return np.concatenate([[x, y, z], poses.from_rotation_vectors(np.array(turn, float))])


class Stage:
    """A clutch, its time, and all that it commanded."""

    def __init__(self, config: WristConfig | None = None, rate: float = HZ) -> None:
        self.clutch = Clutch(LoopConfig(rate=rate, wrist=config or WristConfig()))
        self.time, self.period = 0.0, 1 / rate
        self.times: list[float] = []
        self.commands: list[WristCommand] = []
        self.events: list[str] = []

    def tick(
        self,
        pose: np.ndarray | None = None,
        mode: Mode = Mode.TRACKING,
        dt: float | None = None,
        *,
        session: int = 0,
        world: str = "room",
        stamp: float | None = None,
    ) -> WristCommand | None:
        before = self.time
        self.time += self.period if dt is None else dt
        arrival = None
        if pose is not None:
            stamp = self.time if stamp is None else stamp
            frame = HandFrame(FLAT_HAND, stamp, T_world_wrist=pose, world=world)
            arrival = Arrival(frame, self.time, session)
        command = self.clutch.step(mode, self.time, self.time - before, arrival)
        if command is not None:
            self.times.append(self.time)
            self.commands.append(command)
        self.events += self.clutch.events()
        return command

    @property
    def poses(self) -> np.ndarray:
        return np.array([command.pose for command in self.commands])

    def excess(self) -> dict[str, float]:
        """Relative excess of the worst pair of commands over each limit."""
        config, p, dt = self.clutch.config.wrist, self.poses, np.diff(self.times)[:, None]
        v = np.diff(p[:, :3], axis=0) / dt
        turned = poses.multiply(p[1:, 3:], poses.conjugate(p[:-1, 3:]))
        w = poses.rotation_vectors(turned) / dt
        apart = np.minimum(dt[1:], (dt[1:] + dt[:-1]) / 2)

        def over(vectors: np.ndarray, limit: float) -> float:
            return float(np.linalg.norm(vectors, axis=-1).max(initial=0.0) / limit - 1)

        return {
            "box": float(np.maximum(config.low - p[:, :3], p[:, :3] - config.high).max()),
            "speed": over(v, config.velocity),
            "acceleration": over(np.diff(v, axis=0) / apart, config.acceleration),
            "turning": over(w, config.turn_velocity),
            "turn acceleration": over(np.diff(w, axis=0) / apart, config.turn_acceleration),
            "unit": float(np.abs(np.linalg.norm(p[:, 3:], axis=-1) - 1).max()),
        }

    def first_steps(self) -> np.ndarray:
        """(engagements, 2) how far the first command after each is from the one before it."""
        on = [command.engaged for command in self.commands]
        first = [k for k in range(1, len(on)) if on[k] and not on[k - 1]]
        p = self.poses
        return np.array([poses.separation(p[k - 1], p[k]) for k in first]).reshape(-1, 2)


def engaged(config: WristConfig | None = None) -> Stage:
    stage = Stage(config)
    stage.tick(wrist())
    assert stage.commands[-1].engaged
    assert np.array_equal(stage.commands[-1].pose, stage.clutch.config.wrist.home)
    return stage


def engages_again(arm: np.ndarray) -> Stage:
    """A clutch that was released, with the arm elsewhere when it is to engage again."""
    stage = engaged()
    stage.clutch.released = True
    stage.tick(wrist())
    stage.clutch.released = False
    stage.clutch.measured = lambda: arm
    return stage


KINDS = (
    *["go"] * 4,
    *("still", "flip", "lost", "none", "teleport", "pause", "stop", "released"),
    *("restart", "world", "far", "reversed"),
)
MOVES = st.lists(
    st.tuples(
        st.one_of(st.floats(1e-4, 0.03), st.sampled_from([0.01, 0.01, 1 / 72, 0.0014, 0.2, 2.0])),
        st.sampled_from(KINDS),
        st.tuples(*[st.floats(-3.0, 3.0)] * 3),  # velocity [m/s]
        st.tuples(*[st.floats(-9.0, 9.0)] * 3),  # angular velocity [rad/s]
        st.integers(1, 8),
    ),
    min_size=2,
    max_size=20,
)


@settings(max_examples=40, deadline=None)
@given(
    config=st.builds(
        WristConfig,
        scale=st.floats(0.2, 3.0),
        yaw=st.floats(-4.0, 4.0),
        velocity=st.floats(0.1, 3.0),
        acceleration=st.floats(1.0, 50.0),
        turn_velocity=st.floats(0.3, 10.0),
        turn_acceleration=st.floats(2.0, 200.0),
        low=st.sampled_from([(-1.0, -1.0, 0.0), (0.39, -0.02, 0.35)]),
        high=st.sampled_from([(1.0, 1.0, 1.5), (0.42, 0.01, 0.5)]),
    ),
    moves=MOVES,
)
def test_limits_hold_at_every_pair_of_stamps(config, moves):
    stage, place, session, arm = Stage(config), wrist(), 0, HOME
    stage.clutch.measured = lambda: arm
    stage.tick(place)
    for dt, kind, velocity, turning, count in moves:
        stage.clutch.released = kind == "released"
        if kind in ("teleport", "far"):
            place = poses.compose(wrist(*velocity, turn=turning), place)
        if kind == "far" and stage.commands:  # the arm was pushed to another place
            shift = np.array(velocity) * 0.02
            arm = np.concatenate([np.clip(HOME[:3] + shift, config.low, config.high), place[3:]])
        else:
            arm = stage.commands[-1].pose if stage.commands else HOME
        session += kind == "restart"
        mode = {"pause": Mode.PAUSED, "stop": Mode.STOPPED}.get(kind, Mode.TRACKING)
        for _ in range(count):
            if kind in ("go", "reversed", "restart"):
                step = wrist(*(np.array(velocity) * dt), turn=np.array(turning) * dt)
                place = np.concatenate([place[:3] + step[:3], poses.multiply(step[3:], place[3:])])
            if kind == "flip":
                place = place * [1, 1, 1, -1, -1, -1, -1]
            given_pose = {"lost": np.full(7, np.nan), "none": None}.get(kind, place)
            stamp = stage.time - 0.001 if kind == "reversed" else None
            world = "elsewhere" if kind == "world" else "room"
            stage.tick(given_pose, mode, dt, session=session, stamp=stamp, world=world)
    over = stage.excess()
    assert max(over.values()) < 1e-6, over
    steps = stage.first_steps()
    assert (steps <= (1e-12, 1e-7)).all(), steps  # 2 mm and 0.02 rad are allowed
    if (session, stage.clutch.config.wrist.scale) == (0, config.scale):
        assert np.isfinite(stage.poses).all()


def test_a_pause_is_not_caught_up_with():
    config = WristConfig()
    limiter = PoseLimiter(config)
    before = limiter.pose
    after = limiter.step(poses.compose(wrist(0.2, turn=(0, 0, 1.5)), before), 2.0)
    assert 0.0 < math.dist(after[:3], before[:3]) <= config.velocity * MAX_STEP_S + 1e-9
    turn = poses.rotation_vectors(poses.multiply(after[3:], poses.conjugate(before[3:])))
    assert 0.0 < math.hypot(*turn) <= config.turn_velocity * MAX_STEP_S + 1e-9


@pytest.mark.parametrize(
    ("frames", "lag"), [(1, (1e-6, 1e-6)), (2, (2e-3, 1e-2))], ids=["at the rate", "at half of it"]
)
def test_the_wrist_is_followed_without_lag(frames, lag):
    """Its 0.5 m/s and 2 rad/s are within the limits."""
    stage, apart = Stage(), []
    for k in range(400):
        t = k / HZ
        place = wrist(
            0.1 * math.sin(2 * math.pi * 0.8 * t),
            0.05 * math.sin(4 * t),
            turn=(0, 0, 0.4 * math.sin(5 * t)),
        )
        command = stage.tick(place if k % frames == 0 else None)
        target = np.concatenate([HOME[:3] + place[:3], place[3:]])  # it began at the identity
        if k > 50:
            apart.append(poses.separation(command.pose, target))
    assert max(stage.excess().values()) < 1e-6
    assert (np.max(apart, axis=0) < lag).all()


def test_pumping_moves_the_robot_farther_than_the_arm_reaches():
    stage = engaged()
    for _ in range(3):
        for k in range(31):
            stage.tick(wrist(0.1 * k / 30))
        for k in range(31):  # back, with the clutch released
            stage.clutch.released = True
            stage.tick(wrist(0.1 * (30 - k) / 30))
        stage.clutch.released = False
        stage.tick(wrist())
    assert stage.commands[-1].pose[0] == pytest.approx(HOME[0] + 0.3, abs=0.02)
    assert stage.events.count("wrist engaged") == 4
    assert (stage.first_steps() == 0).all()


def test_translation_is_scaled_and_turned_to_the_robot():
    stage = engaged(WristConfig(scale=2.0, yaw=math.pi / 2))
    for k in range(60):
        stage.tick(wrist(0.001 * k, turn=(0.005 * k, 0, 0)))
    for _ in range(40):
        stage.tick(wrist(0.059, turn=(0.295, 0, 0)))
    pose = stage.commands[-1].pose
    assert np.allclose(pose[:3] - HOME[:3], [0, 0.118, 0], atol=1e-4)  # forward is the robot's y
    assert np.allclose(poses.rotation_vectors(pose[3:]), [0, 0.295, 0], atol=1e-4)


@pytest.mark.parametrize("mode", [Mode.PAUSED, Mode.STOPPED, Mode.HOLDING, Mode.EASING])
def test_what_is_no_tracking_holds(mode):
    stage = engaged()
    for k in range(40):
        stage.tick(wrist(0.005 * k))
    assert stage.clutch.limiter.velocity[0] == pytest.approx(0.5, abs=0.01)
    for _ in range(20):
        stage.tick(wrist(0.2), mode)
    braked = stage.commands[-1].pose
    assert stage.poses[-15, 0] == braked[0]  # it stands, after braking at 10 m/s^2
    assert not stage.commands[-1].engaged
    for k in range(100):  # the operator goes elsewhere
        stage.tick(wrist(0.2 - 0.003 * k), mode)
    stage.tick(wrist(-0.1))
    assert stage.commands[-1].engaged
    assert np.array_equal(stage.commands[-1].pose, braked)


def test_it_engages_only_when_the_robot_stands():
    stage = engaged()
    for k in range(40):
        stage.tick(wrist(0.008 * k))
    stage.tick(wrist(0.3), Mode.PAUSED)
    moving = stage.tick(wrist(0.3))
    assert not moving.engaged
    while not stage.commands[-1].engaged:
        stage.tick(wrist(0.3))
    assert stage.first_steps().max() == 0.0


def test_a_lost_wrist_is_held_and_latched_again():
    stage = engaged()
    for k in range(40):
        stage.tick(wrist(0.002 * k))
    for _ in range(5):  # 50 ms are no loss
        stage.tick(np.full(7, np.nan))
    assert stage.commands[-1].engaged
    assert stage.commands[-1].valid
    for _ in range(20):
        stage.tick(np.full(7, np.nan))
    assert not stage.commands[-1].valid
    assert stage.events[-1] == "wrist released: no valid wrist"
    held = stage.commands[-1].pose
    stage.tick(wrist(0.7, 0.2))
    assert stage.commands[-1].engaged
    assert np.array_equal(stage.commands[-1].pose, held)


@pytest.mark.parametrize(("age", "valid"), [(1.0, True), (1.1, False)])
def test_a_wrist_counts_for_stale_s_and_no_longer(age, valid):
    stage, stale_s = engaged(), 0.125
    stage.clutch.config = LoopConfig(safety=SafetyConfig(stale_s=stale_s))
    stage.tick(wrist(), dt=0.25 - stage.time)
    command = stage.tick(dt=age * stale_s)
    assert (command.valid, command.engaged) == (valid, valid)


def test_the_robot_does_not_go_on_without_frames():
    stage, speed, frame_s = engaged(), 0.3, 0.03
    for k in range(1, 61):  # a tracker that delivers every third tick, and then falls silent
        stage.tick(wrist(speed * k / HZ) if k % 3 == 0 else None)
    last = HOME[0] + speed * 60 / HZ
    beyond = [stage.tick().pose[0] - last for _ in range(40)]
    assert 0.9 * frame_s < max(beyond) / speed < 1.5 * frame_s  # brakes before the second is missed
    assert beyond[-1] / speed <= 1.1 * frame_s


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"session": 1}, "the tracker was restarted"),
        ({"world": "elsewhere"}, "the tracker was restarted"),
        ({"pose": wrist(0.09)}, "the wrist jumped"),
        ({"pose": wrist(turn=(0, 0, 0.9))}, "the wrist jumped"),
    ],
)
def test_a_jump_of_the_tracker_does_not_move_the_robot(change, why):
    stage = engaged()
    change = {"pose": wrist(), **change}
    for _ in range(30):
        stage.tick(**change)
    assert f"wrist released: {why}" in stage.events
    assert stage.commands[-1].engaged
    assert np.array_equal(stage.poses, np.tile(HOME, (31, 1)))


def test_a_flipped_quaternion_is_the_same_wrist():
    stage = engaged()
    for k in range(20):
        stage.tick(wrist(turn=(0.01, 0, 0)) * ([1, 1, 1, -1, -1, -1, -1] if k % 2 else 1))
    assert stage.commands[-1].engaged
    assert stage.events == ["wrist engaged"]
    assert poses.separation(stage.commands[-1].pose, HOME)[1] < 0.02


def test_home_is_where_the_arm_is():
    nothing = Stage()
    assert nothing.tick() is None  # without a wrist and without an arm there is no command
    assert nothing.tick(np.full(7, np.nan)) is None
    stage, arm = Stage(), wrist(0.2, 0.3, 0.6, turn=(0, 1, 0))
    stage.clutch.measured = lambda: arm
    assert stage.tick() is not None  # an arm is commanded before there is a wrist
    stage.tick(wrist())
    assert stage.commands[-1].engaged
    assert np.array_equal(stage.poses, [arm, arm])


@pytest.mark.parametrize(
    ("arm", "seconds"),
    [
        (wrist(0.5, 0.1, 0.4, turn=(0, 0, 0.5)), 0.12 / 0.2),  # at a fifth of 1 m/s
        (wrist(*HOME[:3], turn=(0, 0, 1.0)), 0.9 / (0.2 * WristConfig().turn_velocity)),
    ],
)
def test_an_arm_that_was_moved_is_met_slowly_before_it_engages(arm, seconds):
    stage = engages_again(arm)
    begun = stage.time
    while not stage.commands[-1].engaged:
        stage.tick(wrist())
    assert stage.time - begun > seconds
    apart = poses.separation(stage.commands[-1].pose, arm)
    assert (apart <= (0.02, 0.1)).all()
    assert max(stage.excess().values()) < 1e-6


@pytest.mark.parametrize(
    ("arm", "near"),
    [
        (wrist(0.019), True),
        (wrist(0.025), False),
        (wrist(turn=(0, 0, 0.09)), True),
        (wrist(turn=(0, 0, 0.12)), False),
    ],
)
def test_it_engages_where_the_arm_is_near(arm, near):
    turned = poses.multiply(arm[3:], HOME[3:])
    stage = engages_again(np.concatenate([HOME[:3] + arm[:3], turned]))
    stage.tick(wrist())
    assert stage.commands[-1].engaged == near


def test_a_loop_gives_fingers_and_wrist_one_stamp():
    hand, now = load_hand("mimic_p050"), 0.0
    config = LoopConfig(safety=SafetyConfig(blend_s=0.0))
    method = make_request(method="joint_angle").config
    pipeline = HandPipeline(Retargeter(hand, config=method), config, clock=lambda: now)
    recording = SyntheticOperator(seed=1).record(1.0)
    for k in range(20):
        now += 0.02
        frame = replace(recording[k], T_world_wrist=wrist(0.002 * k), world="room")
        if k == 10:
            pipeline.supervisor.pause()
        if k == 15:
            pipeline.supervisor.resume()
        tick = pipeline.step(now, Arrival(frame, now))
        assert tick.wrist.engaged == tick.mode.moves
        if tick.mode.moves:
            assert tick.command.stamp == frame.stamp
        if k == 15:
            assert "wrist engaged" in tick.events
    assert tick.wrist.pose[0] == pytest.approx(HOME[0] + 0.018 + 0.008, abs=0.003)
    assert pipeline.step(now, Arrival(recording[21], now)).wrist is not None
