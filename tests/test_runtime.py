"""Policies, limits and one hand's steps, on a clock that the test turns; no sleeping."""

import dataclasses
import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

from smooth_operator import (
    Hand,
    HandFrame,
    HandRecording,
    Retargeter,
    Status,
    poses,
    read_recording,
)
from smooth_operator.errors import ConfigError
from smooth_operator.io.anatomy import FEWEST_FRAMES, HandCheck
from smooth_operator.landmarks import FINGERS, LAYOUTS, TIPS
from smooth_operator.retargeting.program import RetargetState
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.components import SINKS, SOURCES, build_component
from smooth_operator.teleop.runtime import statistics as run_statistics
from smooth_operator.teleop.runtime.pipeline import (
    COMPILED,
    COMPILING,
    NOT_FINITE,
    HandPipeline,
    Supervisor,
    implausible,
)
from smooth_operator.teleop.runtime.settings import (
    LimitsConfig,
    LoopConfig,
    SafetyConfig,
    WristConfig,
)
from smooth_operator.teleop.runtime.statistics import LoopStatistics, TrackerDelay, percentiles
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.teleop.sources.live import Arrival

PERIOD = 0.01
LOOP = LoopConfig(rate=1 / PERIOD)


@pytest.fixture(scope="module")
def retargeter(hand) -> Retargeter:
    built = Retargeter(hand, method="joint_angle")  # the quickest to compile
    built.warm_up()
    return built


@pytest.fixture(scope="module")
def motion() -> HandRecording:
    return SyntheticOperator(seed=2, rate_hz=1 / PERIOD).record(8.0)


def within(hand: Hand, limits: LimitsConfig, q: np.ndarray, dt: float) -> None:
    """Every joint of (T, n) commands within all limits."""
    low, high = hand.joint_limits.T
    assert ((q >= low - 1e-12) & (q <= high + 1e-12)).all()
    assert np.abs(np.diff(q, axis=0)).max() / dt <= limits.velocity * (1 + 1e-9)
    assert np.abs(np.diff(q, n=2, axis=0)).max() / dt**2 <= limits.acceleration * (1 + 1e-9)


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        (SafetyConfig, {"stale_s": 0}, "stale_s"),
        (SafetyConfig, {"stale_s": 1.0, "lost_s": 0.5}, "lost_s"),
        (SafetyConfig, {"blend_s": -1}, "blend_s"),
        (LimitsConfig, {"velocity": 0}, "velocity"),
        (LoopConfig, {"rate": 0.1}, "rate"),
        (WristConfig, {"scale": 0.0}, "scale must be positive"),
        (WristConfig, {"velocity": -1.0}, "velocity must be positive"),
        (WristConfig, {"yaw": math.nan}, r"yaw must be -1e\+09 to 1e\+09"),
        (WristConfig, {"low": (0.0, 0.0, 2.0)}, "low below high"),
        (WristConfig, {"high": (math.inf, 1.0, 1.0)}, "high"),
        (WristConfig, {"home": (0.0,) * 7}, "unit quaternion"),
    ],
)
def test_impossible_settings_are_refused(kind, settings, message):
    with pytest.raises(ConfigError, match=message):
        kind(**settings)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 1e300])
def test_a_setting_is_a_finite_number(value):
    """Infinity as "no limit" made every command NaN."""
    for kind in (SafetyConfig, LimitsConfig, WristConfig, LoopConfig):
        for field in dataclasses.fields(kind):
            if isinstance(field.default, float):
                with pytest.raises(ConfigError, match=field.name):
                    kind(**{field.name: value})
    for parts in (SOURCES, SINKS):
        for word in parts:
            hints = get_type_hints(parts.load(word))
            for name in (name for name, hint in hints.items() if float in (hint, *get_args(hint))):
                with pytest.raises(ConfigError, match=name):
                    build_component(parts, f"{word}:{name}={value}")


@pytest.mark.parametrize("part", ["fingers", "wrist"])
def test_a_command_that_is_not_finite_repeats_the_last_one(retargeter, motion, part):
    """Whatever makes it so: the limiter is broken here."""
    stage = Stage(retargeter)
    frames = [replace(frame, T_world_wrist=poses.IDENTITY) for frame in motion[:80]]
    stage.play(frames[:60])
    limiter = stage.pipeline.limiter if part == "fingers" else stage.pipeline.clutch.limiter
    limiter.velocity = limiter.velocity * np.nan
    ticks = stage.play(frames[60:])
    every = [(t.command.joint_positions, t.velocity, t.wrist.pose) for t in stage.ticks]
    assert all(np.isfinite(value).all() for tick in every for value in tick)
    assert [k for k, tick in enumerate(stage.ticks) if NOT_FINITE in tick.events] == [60]
    for index in (0, 2):
        np.testing.assert_array_equal(every[60][index], every[59][index])
    assert np.ptp([tick.command.joint_positions for tick in ticks[1:]], axis=0).max() > 0.01


def arrived(frame: HandFrame, at: float, session: int = 0, **changes: object) -> Arrival:
    return Arrival(replace(frame, **changes), at, session)


def test_only_newer_frames_count(motion):
    supervisor, frame = Supervisor(SafetyConfig(stale_s=0.1)), motion[0]
    seen = [(1.0, 0), (1.0, 0), (1.01, 0), (0.9, 0), (1.02, 0), (1.5, 1), (0.1, 1)]
    answers = [
        supervisor.admits(arrived(frame, 5.0, session, stamp=stamp), 5.0) for stamp, session in seen
    ]
    assert answers == [None, "a repeated timestamp", None, "out of order", None, None, None]
    assert supervisor.refused == {"a repeated timestamp": 1, "out of order": 1}
    assert supervisor.admits(arrived(frame, 5.0, stamp=9.0), 5.2) == "too late"


def test_a_hand_in_another_unit_is_refused(motion):
    assert all(implausible(frame) is None for frame in motion)
    frame = motion[0]
    large = replace(frame, landmarks=frame.landmarks * 1000)
    assert "metres" in (implausible(large) or "")
    missing = replace(frame, landmarks=np.full((21, 3), np.nan), valid=None)
    assert implausible(missing) is None
    for distance, far in ((0.48, False), (0.52, True)):
        landmarks = frame.landmarks.copy()
        landmarks[4] = landmarks[0] + [distance, 0.0, 0.0]
        reason = implausible(HandFrame(landmarks)) or ""
        assert ("a landmark more than 0.5 m" in reason) == far


@pytest.mark.shared
def test_no_frame_of_a_real_hand_is_implausible(shared):
    recording = read_recording(shared / "recordings" / "manus_right_subject-000_run-010.npz")
    assert not [why for frame in recording[::7] if (why := implausible(frame))]


@pytest.fixture(scope="module")
def whole(retargeter, motion) -> np.ndarray:
    """Commands while the tracker sees every fingertip."""
    stage = Stage(retargeter)
    stage.play(motion[:320])
    return stage.q


@pytest.mark.parametrize("tip", TIPS)
def test_a_missing_fingertip_does_not_hold_the_hand(stage, motion, whole, hand, tip):
    """The other fingers go on as they would, and its own follows its other joints."""
    finger = FINGERS[TIPS.index(tip)]
    lost = range(100, 250)
    for k, frame in enumerate(motion[:320]):
        landmarks = frame.landmarks.copy()
        if k in lost:
            landmarks[tip] = np.nan
        stage.play([replace(frame, landmarks=landmarks, valid=None)])
    assert {tick.status for tick in stage.ticks} == {Status.OK}
    assert stage.pipeline.filled == {finger: len(lost)}
    said = [event for tick in stage.ticks for event in tick.events if "fingertips" in event]
    assert said == [
        f"fingertips: {finger} not seen, so estimated from the other joints",
        "fingertips: all seen again",
    ]
    off = np.abs(stage.q - whole)
    own = np.array([finger in name for name in hand.joint_names])
    assert off[:, ~own].max() < 0.02 or finger == "thumb"
    assert off[100:250].mean() < 0.05
    assert np.ptp(stage.q[100:250], axis=0).max() > 0.3
    assert off[300:].max() < 0.02


@pytest.mark.parametrize("missing", [[3], [8, 5], [4, 8, 12]])
def test_more_than_fingertips_missing_holds_the_hand(retargeter, motion, missing):
    stage = Stage(retargeter)
    for frame in motion[:100]:
        landmarks = frame.landmarks.copy()
        landmarks[missing] = np.nan
        stage.play([replace(frame, landmarks=landmarks, valid=None)])
    assert not stage.pipeline.filled
    assert not any(tick.mode.moves for tick in stage.ticks)


def test_every_refusal_is_counted_by_its_reason(retargeter, motion):
    stage = Stage(retargeter)
    mirrored = [replace(f, landmarks=f.landmarks * [-1.0, 1.0, 1.0]) for f in motion]
    large = [replace(f, landmarks=f.landmarks * (10.0 + i)) for i, f in enumerate(motion[:30])]
    ticks = stage.play([*mirrored, *large])
    refused = stage.pipeline.supervisor.refused
    told = [event for tick in ticks for event in tick.events if "frame refused" in event]
    assert sum(refused.values()) == len(told)
    assert sum(n for why, n in refused.items() if "a left hand" in why) == len(mirrored)
    # figures in a reason would make a reason of every frame
    assert [n for why, n in refused.items() if "metres" in why] == [30]


def test_a_session_of_the_other_hand_or_in_another_order_is_refused(retargeter, motion):
    """From its first few frames on, whatever the pose; the next session is judged by itself."""
    mano = np.argsort(LAYOUTS["mano"])
    faults = {
        "judging by its shape, it is a left hand": lambda points: points * [-1.0, 1.0, 1.0],
        "landmarks in the order 'mano'; for a source, set layout=mano": lambda points: points[mano],
    }
    for why, fault in faults.items():
        stage = Stage(retargeter)
        frames = list(motion[100:160])
        stage.play([replace(frame, landmarks=fault(frame.landmarks)) for frame in frames])
        refused = stage.pipeline.supervisor.refused
        assert sum(refused.values()) >= 60 - FEWEST_FRAMES
        assert sum(n for told, n in refused.items() if told.startswith(why)) >= 30
        before = sum(refused.values())
        stage.play(motion[160:200], session=1)
        assert sum(refused.values()) == before
        assert stage.ticks[-1].mode.moves


def test_another_tracker_takes_over_without_a_jump(retargeter, motion):
    """A hand in place of a controller is a new session, whatever its pose."""
    spread = np.linalg.norm(motion.landmarks[:, 8] - motion.landmarks[:, 0], axis=1)
    opened, closed = motion[int(spread.argmax())], motion[int(spread.argmin())]
    stage, moved = Stage(retargeter), []
    for session, frame in ((0, opened), (0, closed), (1, opened)):
        first = stage.now
        stamps = first + PERIOD * np.arange(1, 101)
        ticks = stage.play([replace(frame, stamp=stamp) for stamp in stamps], session)
        q = np.array([tick.command.joint_positions for tick in ticks])
        moved.append(np.abs(q - q[0]).max(axis=1))
        assert ticks[-1].mode is Mode.TRACKING
    assert ticks[0].mode is Mode.BLENDING
    _, fast, smooth = moved
    assert smooth[-1] > 0.5
    assert smooth[10] < 0.2 * smooth[-1]  # of half a second
    assert fast[10] > 0.6 * fast[-1]  # the same tracker, meanwhile


def test_the_delay_of_a_tracker_with_another_clock(motion):
    delay, rng = TrackerDelay(), np.random.default_rng(0)
    extra = rng.exponential(0.004, 500)
    extra[0] = 0.0
    for i in range(500):
        arrival = arrived(motion[0], 1000.0 + i * PERIOD + extra[i], stamp=i * PERIOD)
        delay.see(arrival)
        assert delay.above_fastest(arrival) == pytest.approx(extra[i], abs=1e-9)
    slow = TrackerDelay()  # of a recording that is played at a tenth of its speed: 30 s
    for i in range(300):
        arrival = Arrival(replace(motion[0], stamp=i * PERIOD), 5.0 + 10 * i * PERIOD, 0, 0.1)
        slow.see(arrival)
        assert slow.above_fastest(arrival) == pytest.approx(0.0, abs=1e-9)


class Stage:
    """A pipeline on a clock that the test turns."""

    def __init__(self, retargeter: Retargeter, config: LoopConfig = LOOP) -> None:
        self.now = 100.0
        self.pipeline = HandPipeline(retargeter, config, clock=lambda: self.now)
        self.ticks: list[Tick] = []

    def play(self, frames: Sequence[HandFrame | None], session: int = 0) -> list[Tick]:
        """A frame, or silence, per period."""
        start = len(self.ticks)
        for frame in frames:
            self.now += PERIOD
            arrival = None if frame is None else Arrival(frame, self.now, session)
            self.ticks.append(self.pipeline.step(self.now, arrival))
        return self.ticks[start:]

    @property
    def q(self) -> np.ndarray:
        return np.array([tick.command.joint_positions for tick in self.ticks])


@pytest.fixture
def stage(retargeter) -> Stage:
    return Stage(retargeter)


@pytest.fixture(scope="module")
def frames(motion) -> list[HandFrame]:
    return list(motion)


def modes(ticks: list[Tick]) -> list[Mode]:
    """Modes in their order, without repetitions."""
    out: list[Mode] = []
    for tick in ticks:
        if not out or out[-1] is not tick.mode:
            out.append(tick.mode)
    return out


def test_silence_holds_then_eases_and_the_return_blends(stage, frames, hand):
    assert modes(stage.play([None] * 5)) == [Mode.WAITING]
    assert modes(stage.play(frames[:200])) == [Mode.BLENDING, Mode.TRACKING]
    held = stage.play([None] * 100)
    assert modes(held) == [Mode.TRACKING, Mode.HOLDING]
    tracking = sum(t.mode is Mode.TRACKING for t in held)
    assert tracking == pytest.approx(LOOP.safety.stale_s / PERIOD, abs=1)  # the clock's rounding
    np.testing.assert_array_equal(
        held[-1].command.joint_positions, held[50].command.joint_positions
    )
    lost = stage.play([None] * 500)
    assert modes(lost) == [Mode.HOLDING, Mode.EASING]
    neutral = hand.full_configuration(hand.neutral)
    np.testing.assert_allclose(lost[-1].command.joint_positions, neutral, atol=1e-9)
    eased = np.abs(np.diff([t.command.joint_positions for t in lost], axis=0)).max() / PERIOD
    assert eased <= LOOP.safety.ease_velocity * (1 + 1e-9)
    back = stage.play(frames[200:400])
    assert modes(back) == [Mode.BLENDING, Mode.TRACKING]
    within(hand, LOOP.limits, stage.q, PERIOD)


def test_tracking_is_the_methods_own_answer(stage, frames, retargeter):
    followed = stage.play(frames[:300])[-1]
    assert followed.mode is Mode.TRACKING
    assert followed.status == Status.OK
    _, result = retargeter.step(retargeter.init(), frames[299])
    np.testing.assert_allclose(
        followed.command.joint_positions, result.command.joint_positions, atol=1e-6
    )
    assert followed.command.stamp == frames[299].stamp
    assert list(followed.stages) == ["tracker", "receive", "solve", "limit"]


def test_on_loss_hold_never_eases(retargeter, motion):
    stage = Stage(retargeter, replace(LOOP, safety=SafetyConfig(on_loss="hold")))
    stage.play(list(motion)[:100])
    assert modes(stage.play([None] * 500)) == [Mode.TRACKING, Mode.HOLDING]


def test_a_robot_holds_while_a_method_is_compiled(stage, frames, retargeter):
    stage.pipeline.hold()
    waiting = stage.play(frames[:50])
    assert modes(waiting) == [Mode.WAITING]
    assert waiting[0].events == (COMPILING,)
    assert all(tick.status is None for tick in waiting)
    assert stage.pipeline.latest.frame is frames[49]
    stage.pipeline.go_on()
    moving = stage.play(frames[50:250])
    assert moving[0].events == (COMPILED, "waiting -> blending")
    assert modes(moving) == [Mode.BLENDING, Mode.TRACKING]
    stage.pipeline.hold()
    held = stage.play(frames[250:500])  # longer than a loss, which would ease
    assert modes(held) == [Mode.HOLDING]
    np.testing.assert_array_equal(
        held[-1].command.joint_positions, held[50].command.joint_positions
    )
    stage.pipeline.switch(retargeter)
    assert modes(stage.play(frames[500:700])) == [Mode.BLENDING, Mode.TRACKING]
    within(stage.pipeline.retargeter.hand, LOOP.limits, stage.q, PERIOD)


def test_useless_frames_are_a_loss(stage, frames):
    stage.play(frames[:100])
    nothing = [replace(f, landmarks=np.full((21, 3), np.nan), valid=None) for f in frames[100:400]]
    ticks = stage.play(nothing)
    assert modes(ticks) == [Mode.TRACKING, Mode.HOLDING, Mode.EASING]
    assert all(t.status == Status.INVALID_LANDMARKS for t in ticks)
    assert "not used" in ticks[0].events[0]


def test_the_clutch_holds_and_takes_over_where_the_operator_is(stage, frames, hand):
    stage.play(frames[:100])
    stage.pipeline.supervisor.pause()
    paused = stage.play(frames[100:200])
    assert modes(paused) == [Mode.PAUSED]
    np.testing.assert_array_equal(
        paused[-1].command.joint_positions, paused[20].command.joint_positions
    )
    stage.pipeline.supervisor.resume()
    back = stage.play(frames[200:300])
    assert modes(back) == [Mode.BLENDING, Mode.TRACKING]
    within(hand, LOOP.limits, stage.q, PERIOD)


def test_an_emergency_stop_stands_at_once_until_released(stage, frames):
    before = stage.play(frames[:100])[-1]
    stage.pipeline.supervisor.stop()
    stopped = stage.play(frames[100:150])
    assert modes(stopped) == [Mode.STOPPED]
    for tick in stopped:
        np.testing.assert_array_equal(tick.command.joint_positions, before.command.joint_positions)
        assert (tick.velocity == 0).all()
    stage.pipeline.supervisor.resume()  # the clutch does not release a stop
    assert modes(stage.play(frames[150:160])) == [Mode.STOPPED]
    stage.pipeline.supervisor.release()
    assert modes(stage.play(frames[160:260])) == [Mode.BLENDING, Mode.TRACKING]


@pytest.mark.parametrize("switch", ["stop", "pause"])
def test_a_release_moves_nothing_before_a_frame_comes(stage, frames, switch):
    stage.play(frames[:100])
    getattr(stage.pipeline.supervisor, switch)()
    stopped = stage.play(frames[100:150])[-1]
    getattr(stage.pipeline.supervisor, {"stop": "release", "pause": "resume"}[switch])()
    released = stage.play([None] * 50)
    assert modes(released) == [Mode.WAITING]
    for tick in released:
        np.testing.assert_array_equal(tick.command.joint_positions, stopped.command.joint_positions)
    assert modes(stage.play(frames[150:152])) == [Mode.BLENDING]


def test_the_memory_of_a_method_ends_with_the_loss_of_the_hand(
    stage, frames, retargeter, monkeypatch
):
    begun: list[float] = []
    first = retargeter.init

    def init(**given: Any) -> RetargetState:
        begun.append(stage.now)
        return first(**given)

    stage.play(frames[:50])
    monkeypatch.setattr(retargeter, "init", init)
    stage.play([None] * 30)  # held, not lost
    stage.play(frames[80:120])
    assert not begun
    stage.play([None] * 300)
    stage.play(frames[120:160])
    assert len(begun) == 1
    stage.pipeline.supervisor.pause()
    stage.play(frames[160:200])
    stage.pipeline.supervisor.resume()
    stage.play(frames[200:220])
    assert len(begun) == 2


def test_a_blend_goes_half_the_way_in_half_of_its_time(stage, frames):
    stage.play(frames[:100])
    stage.pipeline.supervisor.pause()
    start = stage.play([None] * 30)[-1].command.joint_positions
    stage.pipeline.supervisor.resume()
    still = [replace(frame, landmarks=frames[300].landmarks) for frame in frames[130:330]]
    ticks = stage.play(still)
    count = sum(tick.mode is Mode.BLENDING for tick in ticks)
    assert count == pytest.approx(LOOP.safety.blend_s / PERIOD, abs=2)
    way = ticks[-1].command.joint_positions - start
    assert np.abs(way).max() > 0.2
    for quarter, share in ((1, 0.15625), (2, 0.5), (3, 0.84375)):  # x^2 (3 - 2 x)
        gone = ticks[count * quarter // 4].command.joint_positions - start
        np.testing.assert_allclose(gone, share * way, atol=0.04 * np.abs(way).max())


def test_a_short_gap_blends_as_long_as_the_gap(stage, frames):
    stage.play(frames[:100])
    stage.play([None] * 20)  # 0.2 s
    back = stage.play(frames[120:200])
    blending = sum(tick.mode is Mode.BLENDING for tick in back)
    assert blending == pytest.approx(0.21 / PERIOD, abs=2)


def test_whoever_looks_during_a_switch_sees_a_method_with_its_own_state(hand, motion, monkeypatch):
    """As the page does, on another thread; here in the middle of each switch."""
    methods = [Retargeter(hand, method=name) for name in ("smooth", "joint_angle", "keyvector")]
    pipeline, begin, looks = HandPipeline(methods[0], LOOP), Retargeter.init, []

    def looked_at(retargeter: Retargeter) -> RetargetState:
        state = begin(retargeter)
        looks.append((pipeline.latched, pipeline.fingertip_targets))
        return state

    monkeypatch.setattr(Retargeter, "init", looked_at)
    for one, other in itertools.permutations(methods, 2):
        pipeline.switch(one)
        pipeline.switch(other)
        assert pipeline.retargeter is other
    assert len(looks) == 12


def test_the_fault_run_breaks_no_limit(hand, retargeter):
    """Drop-outs, bursts, NaN, swapped hands, doubled and shuffled stamps, a restarted tracker."""
    rng, stage = np.random.default_rng(7), Stage(retargeter)
    frames = list(SyntheticOperator(seed=9, rate_hz=1 / PERIOD).record(16.0))
    events: list[HandFrame | None] = []
    for i in range(1200, len(frames)):  # started again
        frames[i] = replace(frames[i], stamp=frames[i].stamp - 10.0)
    for i, frame in enumerate(frames):
        kind = rng.random()
        if 500 <= i < 600 or kind < 0.1:
            events.append(None)
        elif kind < 0.13:
            landmarks = frame.landmarks.copy()
            landmarks[rng.integers(21)] = np.nan
            events.append(replace(frame, landmarks=landmarks, valid=None))
        elif kind < 0.16:
            events.append(replace(frame, landmarks=frame.landmarks * [-1, 1, 1]))
        elif kind < 0.19:
            events.append(replace(frame, stamp=frames[i - 1].stamp))
        elif kind < 0.22:
            events.append(frames[max(i - 3, 0)])
        elif kind < 0.23:
            events.append(replace(frame, landmarks=frame.landmarks * 1000))
        else:
            events.append(frame)
    stage.play(events)
    within(hand, LOOP.limits, stage.q, PERIOD)
    seen = {t.mode for t in stage.ticks}
    assert {Mode.TRACKING, Mode.HOLDING, Mode.BLENDING} <= seen
    assert sum(t.mode.moves for t in stage.ticks) > 0.8 * len(stage.ticks)
    stamps = [t.command.stamp for t in stage.ticks if t.status == Status.OK]
    backwards = sum(b <= a for a, b in itertools.pairwise(stamps))
    assert backwards == 1  # the restart


def test_what_a_run_came_to(retargeter, motion):
    stage = Stage(retargeter)
    statistics = LoopStatistics(PERIOD)
    for i, tick in enumerate(stage.play([*list(motion)[:50], *[None] * 50])):
        late = 0.02 if i == 10 else 0.002
        statistics.add(tick, tick.time, tick.time + late)
    summary = statistics.summary()
    assert summary["commands"] == {"right": 100}
    assert summary["deadlines_missed"] == 1
    assert summary["added_latency_ms"]["p50"] == pytest.approx(2.0)
    assert summary["added_latency_ms"]["max"] == pytest.approx(20.0)
    assert summary["rate_hz"] == pytest.approx(100, rel=0.01)
    assert sum(summary["mode_share"].values()) == pytest.approx(1)
    assert percentiles([]) == {}


def test_times_of_a_long_run_take_no_more_memory(monkeypatch):
    monkeypatch.setattr(run_statistics, "_CAPACITY", 100)
    times = run_statistics.RecentTimes()
    assert len(times.newest()) == 0
    for i in range(1050):
        if i == 90:
            assert sorted(times.newest()) == list(range(90))
        times.append(float(i))
    assert sorted(times.newest()) == list(range(950, 1050))
    assert sorted(times.newest(7)) == list(range(1043, 1050))


def test_numbers_of_any_size_are_refused_without_a_warning(motion):
    frame = motion[10]
    assert implausible(frame) is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for value in (1e300, -1e308, 1e155, 1e39, 20.0):
            for rows in ([0], [3], [9], [17], range(21)):
                landmarks = frame.landmarks.copy()
                landmarks[rows, 1] = value * np.linspace(0.1, 1.0, len(rows))
                assert implausible(replace(frame, landmarks=landmarks, valid=None)) is not None
                HandCheck("right").see(landmarks, np.ones(21, bool), 0.0)
        for value in (np.nan, np.inf, 5e-324, 0.0):
            landmarks = frame.landmarks.copy()
            landmarks[5] = value
            implausible(replace(frame, landmarks=landmarks, valid=None))
            HandCheck("right").see(landmarks, np.isfinite(landmarks).all(axis=1), 0.0)
    lost = frame.landmarks.copy()
    lost[8] = 1e6  # where the tracker says that it has none
    assert implausible(replace(frame, landmarks=lost, valid=np.arange(21) != 8)) is None
