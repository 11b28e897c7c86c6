"""The retargeter as a whole: state, bad frames, limits, both sides, few fingers, round trips."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import jax
import numpy as np
import pytest
from trees import limited_poses, pincer, random_rotations

from smooth_operator.baselines.geort.training_data import GeortTraining
from smooth_operator.baselines.slsqp_method import SlsqpConfig
from smooth_operator.cli.retarget import Retarget
from smooth_operator.cli.teleop import Teleop
from smooth_operator.errors import ConfigError, RecordingError, UnknownNameError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import hand_names, load_hand
from smooth_operator.io.anatomy import implausible
from smooth_operator.landmarks import BASES, LANDMARKS, TIPS
from smooth_operator.planning import make_request
from smooth_operator.retargeting import program as frame_module
from smooth_operator.retargeting.aligned_recording import align_recording, calibrate_scale
from smooth_operator.retargeting.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    palm_range,
    reference_landmarks,
)
from smooth_operator.retargeting.correspondence import CorrespondenceConfig
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import PRESETS, method_names
from smooth_operator.retargeting.program import RetargetState
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.retargeting.sbr.newton import NewtonConfig
from smooth_operator.retargeting.sbr.published import DexPilotTargets, ObjectiveConfig
from smooth_operator.retargeting.sbr.sampling import SamplingConfig
from smooth_operator.retargeting.smooth import SmoothConfig
from smooth_operator.retargeting.smooth_terms import DirectionLengthConfig
from smooth_operator.retargeting.targets import CloseTargets
from smooth_operator.retargeting.trajectory import TrajectoryConfig
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.types import HandFrame, HandRecording, Result, Status

FRESH = SbrConfig(sampling=SamplingConfig(samples=128, elites=16, cycles=4))
"""Random numbers in every frame, as in preset ``paper``, but few of them."""


def motion(hand: Hand, count: int, seed: int = 0) -> np.ndarray:
    """(T, 21, 3) a smooth motion of a human hand that is the robot's, turned, moved and larger;
    in the middle, thumb and index meet."""
    rng = np.random.default_rng(seed)
    ends = limited_poses(rng, hand.limits, 4)
    at = np.linspace(0, 3, count)
    q = np.stack([np.interp(at, range(4), column) for column in ends.T], axis=1)
    landmarks = np.zeros((count, 21, 3))
    landmarks[:, [LANDMARKS.index(name) for name in hand.tree.names]] = hand.landmark_positions(q)
    middle = slice(count // 3, count // 2)
    landmarks[middle, TIPS[1]] = landmarks[middle, TIPS[0]] + (0.003, 0.002, 0.0)
    return 1.15 * landmarks @ random_rotations(rng).T + rng.normal(0, 0.3, 3)


def play(retargeter: Retargeter, frames: Sequence[np.ndarray | HandFrame]) -> list[Result]:
    """From a fresh state."""
    state, results = retargeter.init(), []
    for frame in frames:
        state, result = retargeter.step(state, frame)
        results.append(result)
    return results


def positions(results: Sequence[Result]) -> np.ndarray:
    return np.stack([result.command.joint_positions for result in results])


def leaves_equal(a: RetargetState, b: RetargetState) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.array_equal(x, y) for x, y in pairs)


@pytest.fixture(scope="module")
def fresh() -> Retargeter:
    return Retargeter(config=FRESH, rate=100.0)


@pytest.fixture(scope="module")
def realtime() -> Retargeter:
    return Retargeter(method="sbr", rate=100.0)


@pytest.fixture(scope="module")
def usual() -> Retargeter:
    """What one gets without asking for a method."""
    return Retargeter(rate=100.0)


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    return motion(load_hand(), 30)


def test_the_same_seed_and_frames_give_the_same_commands(fresh, frames):
    first, again = positions(play(fresh, frames)), positions(play(fresh, frames))
    np.testing.assert_array_equal(first, again)
    twin = Retargeter(load_hand(), config=FRESH, rate=100.0)
    np.testing.assert_array_equal(positions(play(twin, frames)), first)
    state, others = fresh.init(seed=1), []
    for frame in frames:
        state, result = fresh.step(state, frame)
        others.append(result)
    assert (positions(others) != first).any(axis=1).all()


def test_reset_restores_everything_and_never_recompiles(fresh, frames, monkeypatch):
    fresh.warm_up()

    def traced_again(*_: object) -> None:
        raise AssertionError("the program is compiled a second time")

    monkeypatch.setattr(frame_module, "palm_alignment", traced_again)
    fresh.reset()
    first = [fresh(frame) for frame in frames[:15]]
    assert np.asarray(fresh._state.method.targets.latched).any()  # a pinch: something to forget
    fresh.reset()
    assert leaves_equal(fresh._state, fresh.init())
    np.testing.assert_array_equal(
        positions([fresh(frame) for frame in frames[:15]]), positions(first)
    )
    fresh.reset(seed=5)
    fresh(np.full((21, 3), np.nan))
    fresh(HandFrame(frames[0], valid=np.ones(21, bool)))
    fresh(frames[0].tolist())
    fresh(frames[0].astype(np.float32))
    fresh.reset()
    fresh.run(HandRecording(frames[:2], np.arange(2.0)), seed=3)
    with pytest.raises(AssertionError, match="a second time"):  # were it so, this is what happens
        Retargeter(config=replace(FRESH, settle_rounds=7)).warm_up()


def test_a_step_changes_nothing_but_what_it_returns(fresh, frames):
    state = fresh.init()
    for frame in frames[:3]:
        state, _ = fresh.step(state, frame)
    copy = jax.tree.map(lambda leaf: np.array(leaf), state)
    landmarks = frames[3].copy()
    one_state, one = fresh.step(state, landmarks)
    fresh.step(one_state, frames[4])
    np.testing.assert_array_equal(landmarks, frames[3])
    assert leaves_equal(state, copy)
    two_state, two = fresh.step(state, frames[3])  # an old state may be used again
    np.testing.assert_array_equal(one.command.joint_positions, two.command.joint_positions)
    assert leaves_equal(one_state, two_state)
    assert not leaves_equal(state, one_state)


def test_a_run_is_what_a_loop_gives(fresh, frames):
    landmarks = frames.copy()
    landmarks[7] = np.nan
    stamps = np.arange(len(frames)) / 60
    seen: list[int] = []
    trajectory, loss = fresh.run(
        HandRecording(landmarks, stamps), track=lambda steps: (seen.append(i) or i for i in steps)
    )
    results = play(fresh, landmarks)
    np.testing.assert_array_equal(trajectory.joint_positions, positions(results))
    assert trajectory.joint_names == fresh.hand.joint_names
    np.testing.assert_array_equal(trajectory.stamps, stamps)
    np.testing.assert_array_equal(trajectory.status, [r.status for r in results])
    assert (trajectory.latency_ms > 0).all()
    assert np.flatnonzero(np.isnan(loss)).tolist() == [7]
    assert seen == list(range(len(frames)))


def changed(frame: np.ndarray, at: Any, value: Any) -> np.ndarray:
    out = frame.copy()
    out[at] = value
    return out


LINE = np.outer(np.arange(5), [0.01, 0.02, -0.01])
SHUFFLED = np.random.default_rng(1).permutation(21)
BAD: dict[str, tuple[Callable[[np.ndarray], np.ndarray | HandFrame], Status]] = {
    "nan": (lambda f: changed(f, (TIPS[2], 1), np.nan), Status.INVALID_LANDMARKS),
    "all nan": (lambda f: np.nan * f, Status.INVALID_LANDMARKS),
    "inf": (lambda f: changed(f, (0, 0), np.inf), Status.INVALID_LANDMARKS),
    "beyond float32": (lambda f: changed(f, (0, 0), 1e300), Status.INVALID_LANDMARKS),
    "flag": (lambda f: HandFrame(f, valid=np.arange(21) != BASES[4]), Status.INVALID_LANDMARKS),
    "collinear": (lambda f: changed(f, list(BASES), f[0] + LINE), Status.DEGENERATE_PALM),
    "coincident": (lambda f: np.tile(f[0], (21, 1)), Status.DEGENERATE_PALM),
    "zeros": (lambda f: 0 * f, Status.DEGENERATE_PALM),
    "millimetres": (lambda f: 1e3 * f, Status.IMPLAUSIBLE_HAND),
    "hundredth": (lambda f: 0.01 * f, Status.IMPLAUSIBLE_HAND),
    "far tip": (lambda f: changed(f, TIPS[2], f[TIPS[2]] + 0.5), Status.IMPLAUSIBLE_HAND),
    "shuffled": (lambda f: f[SHUFFLED], Status.IMPLAUSIBLE_HAND),
}
"""Faults of a frame, and the status of its result."""


def spoiled(frame: np.ndarray, how: str) -> np.ndarray | HandFrame:
    return BAD[how][0](frame)


def stamped(frame: np.ndarray | HandFrame, stamp: float) -> HandFrame:
    return replace(frame if isinstance(frame, HandFrame) else HandFrame(frame), stamp=stamp)


@pytest.mark.filterwarnings("ignore:overflow encountered in cast:RuntimeWarning")
@pytest.mark.parametrize("how", BAD)
@pytest.mark.parametrize("kind", ["fresh", "usual"])
def test_a_bad_frame_never_taints_the_next(kind, request, frames, how):
    retargeter: Retargeter = request.getfixturevalue(kind)
    at = 13  # amid the pinch
    good = [stamped(frames[i], i / 100) for i in range(5, 20)]
    clean = play(retargeter, good)
    bad = spoiled(frames[at], how)
    between = [stamped(bad, (at - left) / 100) for left in (0.6, 0.3)]
    results = play(retargeter, [*good[:8], *between, *good[8:]])
    held, rest = results[8:10], results[:8] + results[10:]
    assert [result.status for result in held] == 2 * [BAD[how][1]]
    for result in held:
        np.testing.assert_array_equal(
            result.command.joint_positions, results[7].command.joint_positions
        )
    assert all(result.status == Status.OK for result in rest)
    np.testing.assert_array_equal(positions(rest), positions(clean))


@pytest.mark.parametrize("how", ["all nan", "collinear"])
def test_before_the_first_good_frame_the_hand_is_neutral(usual, frames, how):
    state, result = usual.step(usual.init(), spoiled(frames[0], how))
    assert result.status != Status.OK
    hand = usual.hand
    np.testing.assert_allclose(
        result.command.joint_positions, hand.full_configuration(hand.neutral), atol=1e-6
    )
    # the first good frame is still the first: nothing but the time is remembered
    assert leaves_equal(replace(state, stamp=None), usual.init())


def test_landmarks_that_are_not_needed_may_be_missing(usual, frames):
    method = usual.method
    needed = {*method.needs, *usual.hand.align_indices}
    partial = frames[:4].copy()
    partial[:, [i for i in range(21) if i not in needed]] = np.nan
    assert {result.status for result in play(usual, partial)} == {Status.OK}
    assert np.isfinite(positions(play(usual, partial))).all()


def test_nonsense_gives_finite_commands_within_the_limits(usual, frames):
    rng = np.random.default_rng(0)
    limits = usual.hand.joint_limits
    nonsense = [
        1e30 * frames[0],
        *rng.normal(0, 10, (10, 21, 3)),
        *rng.normal(0, 1e-6, (10, 21, 3)),
        *(frames[:5] * 1e-3),
        *frames[:3],
    ]
    for result in play(usual, nonsense):
        assert result.command.joint_names == usual.hand.joint_names
        assert np.isfinite(result.command.joint_positions).all()
        assert (result.command.joint_positions >= limits[:, 0]).all()
        assert (result.command.joint_positions <= limits[:, 1]).all()
    assert result.status == Status.OK


@pytest.mark.parametrize("kind", ["fresh", "realtime", "usual"])
def test_fingers_that_no_robot_can_follow_stay_within_the_limits(kind, request, frames):
    retargeter: Retargeter = request.getfixturevalue(kind)
    low, high = retargeter.hand.joint_limits.T
    exaggerated = frames.copy()
    for base in BASES:
        exaggerated[:, base : base + 4] += 0.9 * (
            frames[:, base : base + 4] - frames[:, base, None]
        )
    q = positions(play(retargeter, [*frames, *exaggerated]))
    assert ((q >= low) & (q <= high)).all()
    # the limits did bind; the default takes fingers of any length for its own
    assert kind != "realtime" or ((q == low) | (q == high)).sum() > 20


def test_a_call_notices_units_order_and_side():
    """Before any method sees the hand, so by the quickest."""
    usual = Retargeter(method="joint_angle", rate=100.0)
    landmarks = SyntheticOperator(seed=1).record(2.0).landmarks
    first = usual(landmarks[0])
    assert first.status == Status.OK
    for points in 1e3 * landmarks[:40]:  # in millimetres: from the first frame on
        result = usual(points)
        assert result.status == Status.IMPLAUSIBLE_HAND
        np.testing.assert_array_equal(result.command.joint_positions, first.command.joint_positions)
    assert "metres" in result.status.reason
    assert all(usual(points).status == Status.OK for points in landmarks[1:60])
    # another hand, later on: held from its first frame on, no end of the program
    last = usual(landmarks[60]).command.joint_positions
    for points in landmarks[60:150]:
        result = usual(points * (-1, 1, 1))
        assert result.status == Status.IMPLAUSIBLE_HAND
        np.testing.assert_array_equal(result.command.joint_positions, last)
    assert [usual(points).status for points in landmarks[100:160]] == [Status.OK] * 60
    usual.reset()
    shuffled = landmarks[:5, np.random.default_rng(2).permutation(21)]
    for points in shuffled[:4]:
        assert usual(points).status == Status.IMPLAUSIBLE_HAND
    with pytest.raises(RecordingError, match="do not form a hand in this or any other"):
        usual(shuffled[4])
    usual.reset()


@pytest.mark.parametrize("name", hand_names())
def test_a_robots_own_landmarks_are_plausible(name):
    hand = load_hand(name)
    poses = np.vstack([hand.neutral, limited_poses(np.random.default_rng(0), hand.limits, 40)])
    landmarks = human_landmarks(hand, poses)
    assert not implausible(landmarks, np.ones((41, 21), bool), palm_range(hand)).any()


@pytest.mark.parametrize("shape", [(20, 3), (21, 2), (63,), (1, 21, 3), (25, 3)])
def test_landmarks_of_another_shape_are_refused(fresh, shape):
    with pytest.raises(RecordingError, match=r"must have shape \(21, 3\)"):
        fresh(np.zeros(shape))


def test_a_stamp_that_stands_still_is_refused(frames):
    """The time of day in float32 changes every two minutes."""
    for whole in (0.0, 1.5, 900.0):
        assert HandFrame(frames[0], stamp=np.float32(whole)).stamp == whole
    with pytest.raises(RecordingError, match=r"a float32, which near .* has a resolution of 128"):
        HandFrame(frames[0], stamp=np.float32(1.7e9))
    assert HandFrame(frames[0], stamp=np.float64(1.7e9)).stamp == 1.7e9


def test_the_other_hand_is_refused(fresh, frames):
    with pytest.raises(ConfigError, match="a left human hand can't drive the right hand"):
        fresh(HandFrame(frames[0], side="left"))


def test_unknown_names_are_refused():
    with pytest.raises(UnknownNameError, match=r"unknown method 'sbrr'. Did you mean 'sbr'\?"):
        Retargeter(method="sbrr")
    with pytest.raises(UnknownNameError, match=r"unknown preset.*'quick'.*paper, realtime\.$"):
        Retargeter(method="sbr", preset="quick")
    with pytest.raises(UnknownNameError, match=r"'paper' is a preset of sbr: also choose"):
        Retargeter(preset="paper")
    with pytest.raises(UnknownNameError, match="unknown hand"):
        Retargeter("shadow")
    with pytest.raises(ConfigError, match="side must be 'right' or 'left'"):
        Retargeter(side="both")


def settings_of(config: object) -> Iterator[tuple[object, str, float]]:
    """Each number of a configuration: the part that has it, its name and its value."""
    for field in fields(config) if is_dataclass(config) else ():
        value = getattr(config, field.name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield config, field.name, value
        yield from settings_of(value)


@pytest.mark.parametrize("method", method_names())
def test_no_setting_takes_what_no_program_can_use(method):
    """A preset file sets them, and an objective of NaN moves nothing, in silence."""
    taken = []
    for part, name, _ in (each for c in PRESETS[method].values() for each in settings_of(c)):
        for bad in (np.nan, np.inf, -np.inf, -1.0):
            with contextlib.suppress(ConfigError):
                replace(part, **{name: bad})
                taken.append((type(part).__name__, name, bad))
    assert {*taken} <= {("SelfCollisionConfig", "margin", -1.0)}


TRAJECTORY = ("acceleration_weight", "iterations", "tolerance", "speed_limit")
REFUSED: list[tuple[type, dict[str, Any]]] = [
    *((AlignmentConfig, {"scale": value}) for value in (0.0, 50.0)),
    (CloseTargets, {"project": 0.0}),
    (CloseTargets, {"escape": 0.01, "project": 0.02}),
    *((CorrespondenceConfig, each) for each in ({"near": 0.09}, {"share": 1.5})),
    *((DexPilotTargets, {"project": 0.02, "escape": 0.01}), (DexPilotTargets, {"project": 0.0})),
    *((DexPilotTargets, {"blend": value}) for value in (0.0, 1.5)),
    *((DirectionLengthConfig, {name: 0.0}) for name in ("huber_width", "near")),
    *((GeortTraining, {name: 0}) for name in ("epochs", "learning_rate", "margin")),
    *((GeortTraining, each) for each in ({"batch": 2.5}, {"seed": -1}, {"coverage": np.nan})),
    *((GeortTraining, {name: value}) for name, value in (("ramp", 1.0), ("validation", -0.1))),
    *((NewtonConfig, {"damping": value}) for value in ((), (-1.0, 0.0))),
    *((ObjectiveConfig, each) for each in ({"loss": "huber"}, {"pose_centre": "middle"})),
    (ObjectiveConfig, {"transition": 0.0}),
    *((SamplingConfig, {name: 0}) for name in ("samples", "elites", "cycles", "sigma", "jitter")),
    *((SamplingConfig, each) for each in ({"elites": 11, "samples": 10}, {"draws": "halton"})),
    *((SlsqpConfig, {name: 0}) for name in ("tolerance", "max_iterations")),
    *((TrajectoryConfig, {"acceleration_weight": 1.0, name: 0}) for name in TRAJECTORY),
]
"""Settings that are refused, besides those that no number may have."""


@pytest.mark.parametrize(("kind", "settings"), REFUSED)
def test_settings_out_of_range_are_refused(kind, settings):
    with pytest.raises(ConfigError, match="|".join(settings)):
        kind(**settings)


def test_who_names_no_method_gets_the_default_one(usual):
    assert DEFAULT_METHOD == "smooth"
    assert usual.config is method_config() is method_config(DEFAULT_METHOD, "teleop")
    assert make_request().method == Retarget.method == Teleop.method == DEFAULT_METHOD
    assert (make_request().preset, make_request().config) == ("teleop", usual.config)


def test_a_configuration_in_the_place_of_a_name_is_refused():
    for arguments in ({"method": SmoothConfig()}, {"preset": SmoothConfig()}):
        with pytest.raises(ConfigError, match=r"must be names.*config="):
            Retargeter(**arguments)


def test_presets():
    assert next(iter(PRESETS["sbr"])) == "realtime"
    assert method_config("sbr") is method_config("sbr", "realtime")
    assert method_config("sbr", "published") is method_config("sbr", "paper")
    assert method_config("sbr", "paper") == SbrConfig(
        AlignmentConfig(scale=None),
        ObjectiveConfig(pose_weight=0.05, velocity_weight=0.1, transition=0.02),
        SamplingConfig(8192, 128, 20, 0.2, 0.1, 1e-6, "fresh"),
        NewtonConfig(iterations=0),
        settle_rounds=1,
    )
    for method in ("keyvector", "hybrid", "dexpilot", "ako"):
        assert method_config(method, "published") is method_config(method)
        assert [*PRESETS[method]] == ["published", "fast"]
    with pytest.raises(UnknownNameError, match="'published' is a preset of keyvector"):
        method_config("joint_angle", "published")


def test_settling_starts_where_the_operator_is(realtime, fresh, frames):
    """The first command should be near the one after a second of the same frame."""
    settled = positions(play(realtime, [frames[0]] * 60))
    creeping = positions(play(fresh, [frames[0]] * 60))
    assert abs(settled[0] - settled[-1]).max() < 0.1
    assert abs(creeping[0] - creeping[-1]).max() > 0.2


def test_turning_moving_and_scaling_the_human_hand_changes_little(usual):
    frames = motion(load_hand(), 300)
    plain = play(usual, frames)
    turn = random_rotations(np.random.default_rng(1)).T
    other = play(usual, 0.9 * frames @ turn + (2.0, -1.0, 0.5))
    np.testing.assert_allclose([r.scale for r in plain], 1 / 1.15, rtol=1e-4)
    np.testing.assert_allclose([r.scale for r in other], 1 / 1.15 / 0.9, rtol=1e-4)
    apart = np.abs(positions(other) - positions(plain)).max(axis=1)
    assert np.quantile(apart, 0.95) < 5e-3
    assert (apart > 0.03).mean() < 0.02  # one joint may leave its limit a frame earlier

    # the missing fingers' landmarks are not needed: round_trip left them out


def test_recordings_are_aligned_frame_by_frame(frames):
    hand = load_hand()
    landmarks = frames.copy()
    landmarks[3, 0] = np.nan  # the wrist is not a palm landmark of this hand
    landmarks[4, BASES[0]] = np.nan
    landmarks[5] = spoiled(frames[5], "collinear")
    aligned = align_recording(HandRecording(landmarks, np.arange(30.0)), hand)
    assert np.isnan(aligned[3, 0]).all()
    assert np.isfinite(aligned[3, 1:]).all()
    assert np.isnan(aligned[[4, 5]]).all()
    rest = [i for i in range(30) if i not in (3, 4, 5)]
    for i in rest:
        np.testing.assert_allclose(
            aligned[i], palm_alignment(frames[i], hand).apply(frames[i]), atol=1e-12
        )
    np.testing.assert_allclose(
        aligned[rest][:, list(hand.align_indices)],
        np.broadcast_to(hand.align_points, (len(rest), 3, 3)),
        atol=1e-9,
    )


def test_a_scale_is_calibrated_once(frames):
    hand = load_hand()
    landmarks = frames.copy()
    landmarks[0] = np.nan
    landmarks[1] = spoiled(frames[1], "coincident")
    recording = HandRecording(landmarks, np.arange(30.0))
    scale = calibrate_scale(recording, hand)
    assert scale == pytest.approx(1 / 1.15)
    landmarks[::4] *= 3.0  # a tracker that took the hand for one three times as large
    wrong = HandRecording(landmarks, np.arange(30.0))
    assert calibrate_scale(wrong, hand) == pytest.approx(scale, rel=1e-3)
    fixed = palm_alignment(frames * 1.3, hand, AlignmentConfig(scale))
    np.testing.assert_array_equal(fixed.scale, scale)
    with pytest.raises(RecordingError, match="from which to calibrate a scale"):
        calibrate_scale(recording[:2], hand)


def test_two_fingers_are_aligned_by_their_bases_and_the_wrist(tmp_path):
    hand = load_hand(pincer(tmp_path))
    rng = np.random.default_rng(3)
    landmarks = reference_landmarks(hand) @ random_rotations(rng).T / 0.8 + rng.normal(0, 1, 3)
    fit = palm_alignment(landmarks, hand)
    assert fit.condition > MIN_CONDITION
    assert fit.scale == pytest.approx(0.8)
    np.testing.assert_allclose(fit.apply(landmarks), reference_landmarks(hand), atol=1e-12)


def test_the_repr_tells_hand_side_method_and_preset():
    named = Retargeter("mimic_p050", side="left", method="joint_angle")
    assert repr(named) == (
        "Retargeter('mimic_p050', side='left', method='joint_angle', preset='default')"
    )
    own = Retargeter("mimic_p050", config=method_config("keyvector", "fast"))
    assert repr(own) == "Retargeter('mimic_p050', side='right', config=SlsqpMethodConfig(...))"
