"""GeoRT: its networks, its training, its files, its command."""

import csv
import json
import shlex
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from metrics_cases import tip_gap_mm
from trees import pincer

from smooth_operator import Retargeter, load_hand, method_config
from smooth_operator.baselines.geort import training_data as data_module
from smooth_operator.baselines.geort.method import (
    GeortConfig,
    GeortModel,
    Weights,
    built_in_model,
    finger_joints,
    forward,
    read_geort_model,
)
from smooth_operator.baselines.geort.training import (
    CHECKPOINT,
    LOSSES,
    MODEL,
    Batch,
    GeortLoss,
    GeortTrainer,
    TrainingSession,
    TrainingState,
)
from smooth_operator.baselines.geort.training_data import (
    FIRST_SEED,
    TRAINING_OPERATORS,
    GeortTraining,
    TrainingData,
    synthetic_recordings,
    training_data,
)
from smooth_operator.cli import main
from smooth_operator.errors import (
    ConfigError,
    HandModelError,
    OutputError,
    RecordingError,
    UnknownNameError,
)
from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.landmarks import TIPS
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import HandFrame, HandRecording, Status

TINY = GeortTraining(epochs=4, batch=64, reach=64, seed=3)
CHAIN = '<joint joint1="{}" joint2="{}" polycoef="0 1 0 0 0"/>'


@pytest.fixture(scope="module", autouse=True)
def _few_poses() -> Iterator[None]:
    """A sixteenth of the robot's random poses, which is enough to look at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(data_module, "REACH_POSES", 4096)
        yield


@pytest.fixture(scope="module")
def operator() -> HandRecording:
    return SyntheticOperator(seed=5, rate_hz=40).record(20.0)


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Two fingers of two joints each: quick to compile."""
    return load_hand_spec(pincer(tmp_path_factory.mktemp("pincer")))


def trainer(hand: Hand, recording: HandRecording, settings: GeortTraining = TINY) -> GeortTrainer:
    return GeortTrainer(hand, training_data([recording], hand, settings), settings)


@pytest.fixture(scope="module")
def coach(hand: Hand, operator: HandRecording) -> GeortTrainer:
    """Compiles once; what it remembers is in its states."""
    return trainer(hand, operator)


@pytest.fixture(scope="module")
def trained(
    coach: GeortTrainer, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, GeortModel]:
    """A training that was never stopped."""
    folder = tmp_path_factory.mktemp("trained")
    return folder, TrainingSession(coach, folder, every=2).run()


def test_each_finger_has_the_joints_that_move_it_alone():
    mimic = load_hand()
    names = [[mimic.actuated_names[j] for j in joints] for joints in finger_joints(mimic)]
    assert [len(joints) for joints in names] == [4, 3, 3, 3, 3]
    for finger, joints in zip(mimic.fingers, names, strict=True):
        assert all(joint.startswith(finger) for joint in joints)


def test_a_joint_of_two_fingers_is_of_neither(tmp_path):
    shared = load_hand_spec(
        pincer(tmp_path, actuated=("t1", "t2", "i1"), equality=CHAIN.format("i2", "t2"))
    )
    assert finger_joints(shared) == ((0,), (2,))  # t2 also drives i2
    lame = load_hand_spec(
        pincer(
            tmp_path,
            actuated=("t1", "t2"),
            equality=CHAIN.format("i1", "t2") + CHAIN.format("i2", "t2"),
        )
    )
    with pytest.raises(HandModelError, match=r"no joint moves only its index tip.*sbr"):
        finger_joints(lame)


def test_the_networks_are_what_they_say():
    rng = np.random.default_rng(1)
    f, h, j, n = 2, 5, 3, 7
    shapes = ((f, 3, h), (f, h), (f, h, h), (f, h), (f, h, j), (f, j))
    arrays = [rng.normal(size=shape) for shape in shapes]
    x = rng.normal(size=(f, 3, n))
    answer = np.asarray(forward(Weights(*map(jnp.asarray, arrays)), jnp.asarray(x)))
    w1, b1, w2, b2, w3, b3 = arrays
    for k in range(f):
        for i in range(n):
            hidden = w1[k].T @ x[k, :, i] + b1[k]
            hidden = w2[k].T @ (hidden / (1 + np.exp(-hidden))) + b2[k]
            expected = np.tanh(w3[k].T @ (hidden / (1 + np.exp(-hidden))) + b3[k])
            np.testing.assert_allclose(answer[k, :, i], expected, atol=1e-5)
    assert np.abs(answer).max() <= 1


class Mapped(GeortLoss):
    """A robot whose fingertips are a given function of the human's."""

    def tips(self, weights: Weights, points: jnp.ndarray) -> jnp.ndarray:
        return self.settings.how(points)


def judged(
    how: Callable[[jnp.ndarray], jnp.ndarray],
    reach_shift: float = 0.0,
    ramp: float = 1.0,
    settings: GeortTraining | None = None,
) -> tuple[float, dict[str, float]]:
    rng = np.random.default_rng(0)
    # a lattice, so that the nearest of a shifted copy is the point itself
    points = np.stack(np.meshgrid(*[np.arange(4) * 0.05] * 3), axis=-1).reshape(-1, 3).T[None]
    points = jnp.asarray(np.repeat(points, 2, axis=0), jnp.float32)
    steps = jnp.asarray(rng.normal(0, 0.003, points.shape), jnp.float32)
    pinches = points.at[1].set(points[0] + jnp.array([[0.0], [0.003], [0.004]]))
    pinched = jnp.arange(points.shape[-1])[None] < 5
    batch = Batch(points, points, steps, points + reach_shift, pinches, pinched)
    settings = settings or GeortTraining(direction=2.0, coverage=3.0, curvature=5.0, pinch=7.0)
    object.__setattr__(settings, "how", how)
    loss = Mapped(load_hand(), settings, np.zeros((2, 3)), np.ones(2))
    total, each = loss(None, batch, ramp)
    return float(total), dict(zip(LOSSES, map(float, each), strict=True))


def test_each_loss_sees_its_own_fault():
    full, copy = judged(lambda p: p)
    assert copy["direction"] == pytest.approx(0, abs=1e-5)
    assert copy["coverage"] == pytest.approx(0, abs=1e-10)
    assert copy["curvature"] == pytest.approx(0, abs=1e-7)
    assert copy["pinch"] == pytest.approx(0.005**2, rel=1e-3)  # 3 and 4 mm are 5 mm
    assert full == pytest.approx(7 * copy["pinch"], rel=1e-2)
    _, mirrored = judged(lambda p: -p)
    assert mirrored["direction"] == pytest.approx(2, abs=1e-4)
    _, frozen = judged(lambda p: 0 * p)
    assert frozen["direction"] == pytest.approx(1, abs=1e-4)
    full, shifted = judged(lambda p: p, reach_shift=0.01)
    # both ways, two fingers, three axes
    assert shifted["coverage"] == pytest.approx(2 * 2 * 3 * 0.01**2, rel=1e-3)
    none, _ = judged(lambda p: p, reach_shift=0.01, ramp=0.0)  # which holds coverage back
    assert full - none == pytest.approx(3 * shifted["coverage"], rel=1e-3)
    _, bent = judged(lambda p: p.at[:, 0].set(100 * p[:, 0] ** 2))
    assert bent["curvature"] > 1e-3
    _, huge = judged(lambda p: 2 * p)
    assert huge["direction"] == pytest.approx(0, abs=1e-5)
    assert huge["pinch"] == pytest.approx(0.01**2, rel=1e-3)


def test_training_prices_faults_as_published():
    """What a fault costs with the settings that training uses: 80 a square metre by which the reach
    is missed, 1 for a direction that is turned round."""
    copy, _ = judged(lambda p: p, settings=GeortTraining())
    shifted, _ = judged(lambda p: p, reach_shift=0.01, settings=GeortTraining())
    assert shifted - copy == pytest.approx(80 * 2 * 2 * 3 * 0.01**2, rel=1e-3)
    mirrored, each = judged(lambda p: -p, settings=GeortTraining())
    rest = 80 * each["coverage"] + 0.1 * each["curvature"] + 200 * each["pinch"]
    assert mirrored - rest == pytest.approx(2, abs=1e-3)


def test_points_are_thinned_and_pinches_are_of_one_moment(operator):
    mimic = load_hand()
    data = training_data([operator, operator], mimic, replace(TINY, validation=0.0))
    once = training_data([operator], mimic, replace(TINY, validation=0.0))
    # seen twice is no more, and a cell of a millimetre holds one point
    np.testing.assert_array_equal(data.train.counts, once.train.counts)
    for row, count in zip(data.train.points, data.train.counts, strict=True):
        cells = np.floor(row[:, :count].T.astype(np.float64) / 1e-3 + 1e-4)
        assert len(np.unique(cells, axis=0)) > 0.98 * count

    tips = align_recording(operator, mimic)[:, list(TIPS)]
    gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
    at = np.flatnonzero((gaps < 0.015).any(axis=1))
    assert len(at) > 20
    np.testing.assert_allclose(once.train.pinches, np.moveaxis(tips[at], 0, -1), atol=1e-7)
    np.testing.assert_array_equal(once.train.pinched, (gaps[at] < 0.015).T)
    assert data.digest != once.digest


def test_the_margin_keeps_the_reach_near_the_operator(operator):
    mimic = load_hand()
    near = training_data([operator], mimic, replace(TINY, margin=0.01))
    whole = training_data([operator], mimic, replace(TINY, margin=None))
    assert near.reach.shape == whole.reach.shape
    for finger in range(5):
        own = near.train.points[finger, :, : near.train.counts[finger]].T
        for reach, least, most in ((near.reach, 0.0, 0.0101), (whole.reach, 0.02, 1.0)):
            some = reach[finger, :, :300].T
            away = np.linalg.norm(some[:, None] - own[None], axis=-1).min(axis=1).max()
            assert least < away < most


def test_the_end_is_kept_apart(hand, operator):
    data = training_data([operator], hand, replace(TINY, validation=0.25))
    assert data.frames == {"train": 600, "validation": 200}
    assert data.validation is not None
    first = training_data([operator[:600]], hand, replace(TINY, validation=0.0))
    np.testing.assert_array_equal(data.train.points, first.train.points)
    assert first.validation is None
    other = SyntheticOperator(seed=6, rate_hz=40).record(5.0)
    apart = training_data([operator], hand, replace(TINY, validation=0.25), [other])
    assert apart.frames == {"train": 800, "validation": 200}
    assert apart.sources["validation"] == [other.name]


def test_frames_that_a_tracker_lost_are_left_out(hand, operator):
    landmarks = operator.landmarks.copy()
    landmarks[100:200, 8] = np.nan  # the index fingertip
    landmarks[300:400] = np.nan
    data = training_data(
        [replace(operator, landmarks=landmarks, valid=None)], hand, replace(TINY, validation=0.0)
    )
    whole = training_data([operator], hand, replace(TINY, validation=0.0))
    assert np.isfinite(data.train.points).all()
    assert np.isfinite(data.train.pinches).all()
    assert data.frames["train"] == 700  # one fingertip is enough
    assert (data.train.counts < whole.train.counts).all()


def test_what_can_not_be_trained_on_is_refused(hand, operator):
    with pytest.raises(RecordingError, match="at least one recording"):
        training_data([], hand, TINY)
    left = SyntheticOperator(seed=5, side="left").record(1.0)
    with pytest.raises(RecordingError, match="left hand, but 'pincer' is a right"):
        training_data([left], hand, TINY)
    still = replace(operator, landmarks=np.repeat(operator.landmarks[:1], len(operator), axis=0))
    with pytest.raises(RecordingError, match=r"thumb, index hardly move.*half a minute"):
        training_data([still], hand, TINY)


def test_synthetic_operators_are_many_and_none_is_judged_on_what_it_trained(monkeypatch):
    monkeypatch.setattr(data_module, "DURATION_S", 0.2)
    train, held_out = synthetic_recordings("left")
    names = [recording.name for recording in (*train, *held_out)]
    assert len(train) == TRAINING_OPERATORS
    assert len(set(names)) == len(names)
    assert {recording.side for recording in (*train, *held_out)} == {"left"}
    assert len({recording.meta["hand_length"] for recording in train}) == TRAINING_OPERATORS


def test_training_learns_and_says_so(hand, operator, trained):
    folder, model = trained
    with (folder / "losses.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["epoch"]) for row in rows] == [1, 2, 3, 4]
    first, last = (float(rows[i]["train_direction"]) for i in (0, -1))
    assert last < 0.8 * first
    assert all(float(row["validation_loss"]) > 0 for row in rows)
    about = json.loads((folder / "model.json").read_text(encoding="utf-8"))["training"]
    assert about["epochs_done"] == 4
    assert about["recordings"]["train"] == [operator.name]
    assert about["settings"]["seed"] == 3
    assert about["losses"]["train"]["direction"] == pytest.approx(last)
    assert about["environment"]["versions"]["jax"]
    assert model.fingers == hand.fingers
    assert model.joints == (("t1", "t2"), ("i1", "i2"))


def stopping_after(epochs: int) -> Callable[[TrainingState], None]:
    def watch(state: TrainingState) -> None:
        if int(state.epoch) == epochs:
            raise KeyboardInterrupt

    return watch


def test_stopped_before_anything_was_learnt_leaves_nothing(coach, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        TrainingSession(coach, tmp_path).run(watch=stopping_after(0))
    assert not list(tmp_path.iterdir())


def test_another_training_is_not_resumed(hand, operator, coach, trained, tmp_path):
    folder, _ = trained

    def resume(settings: GeortTraining = TINY, recording: HandRecording = operator) -> None:
        TrainingSession(trainer(hand, recording, settings), folder).run(resume=True)

    with pytest.raises(ConfigError, match=r"settings\.epochs is 4, not 9"):
        resume(replace(TINY, epochs=9))
    with pytest.raises(ConfigError, match="its data is"):
        resume(recording=operator[:700])
    with pytest.raises(OutputError, match=r"already contains a training.*--resume"):
        TrainingSession(coach, folder).run()
    with pytest.raises(ConfigError, match="no checkpoint to resume from"):
        TrainingSession(coach, tmp_path).run(resume=True)
    whole = (folder / CHECKPOINT).read_bytes()
    for damage in (whole[:3000], b"", whole[:-200] + bytes(200)):
        (tmp_path / CHECKPOINT).write_bytes(damage)
        with pytest.raises(ConfigError, match="not a checkpoint of GeoRT"):
            TrainingSession(coach, tmp_path).run(resume=True)
    (tmp_path / CHECKPOINT).unlink()
    (tmp_path / MODEL).write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"model\.npz would be overwritten"):
        TrainingSession(coach, tmp_path).run()


def test_what_is_no_model_is_refused(trained, tmp_path):
    folder, _ = trained
    path = tmp_path / "wrong.npz"
    with pytest.raises(ConfigError, match="no such GeoRT model"):
        read_geort_model(path)

    def refused(reason: str) -> None:
        with pytest.raises(ConfigError, match=rf"not a GeoRT model.*{reason}.*train geort"):
            read_geort_model(path)

    whole = (folder / MODEL).read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"hello"):
        path.write_bytes(content)
        refused("")
    with np.load(folder / MODEL, allow_pickle=False) as file:
        arrays = dict(file)
    np.savez(path, **{k: v for k, v in arrays.items() if k != "w2"})
    refused("w2")
    np.savez(path, **arrays | {"b1": arrays["b1"][:, :-1]})
    refused("b1 must be finite and have shape")
    np.savez(path, **arrays | {"w1": arrays["w1"] * np.nan})
    refused("w1 must be finite")
    np.savez(path, **arrays | {"about": np.array(str(arrays["about"]).replace(" geort", " x"))})
    refused("format")
    np.savez(path, **arrays | {"w1": np.array([print], object)})
    refused("pickle")


def test_another_hand_is_refused_with_what_differs(trained, tmp_path):
    _, model = trained

    def refused(other: Hand, reason: str) -> None:
        with pytest.raises(ConfigError, match=f"(?s){reason}.*smooth-operator train geort"):
            model.mirrored_for(other)

    refused(load_hand(), r"'pincer'.*fingers \('thumb', 'index'\), but 'mimic_p050' has")
    refused(load_hand_spec(pincer(tmp_path, actuated=("t1", "t2", "i1"))), "actuated joints of 4")
    refused(load_hand_spec(pincer(tmp_path, t2='range="-1 1"')), "with thumb limits")
    other = pincer(tmp_path, actuated=("t1", "t2", "i1", "i3"))
    refused(load_hand_spec(other), "with the index joints")
    spec = pincer(tmp_path)
    text = spec.model.read_text(encoding="utf-8")
    spec.model.write_text(text.replace('pos="0 0 0.02"', 'pos="0 0 0.025"'), encoding="utf-8")
    refused(load_hand_spec(spec), "fingertips are up to .* mm off")
    spec = replace(pincer(tmp_path), side="left")  # called left, and still the same
    refused(load_hand_spec(spec), "does not match the mirror image of it")
    assert model.mirrored_for(load_hand_spec(replace(spec, mirror=True)))
    assert not model.mirrored_for(load_hand_spec(pincer(tmp_path)))


def test_a_trained_model_retargets(hand, trained):
    folder, model = trained
    retargeter = Retargeter(hand, config=GeortConfig(model=folder / MODEL))
    recording = SyntheticOperator(seed=8, rate_hz=40).record(1.0)
    commands, loss = retargeter.run(recording)
    assert (commands.status == Status.OK).all()
    assert np.isfinite(loss).all()
    # the same by hand
    tips = align_recording(recording, hand)[:, [4, 8]]
    unit = np.asarray(
        forward(
            model.weights,
            jnp.moveaxis(jnp.asarray((tips - model.centre) / model.scale[:, None]), 0, -1),
        )
    )
    q = commands.joint_positions[:, list(hand.actuated)]
    for k, (finger, output) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1)]):
        expected = 0.5 + 1.5 * unit[finger, output]  # limits -1 to 2
        np.testing.assert_allclose(q[:, k], expected, atol=1e-5)


@pytest.fixture(scope="module")
def right() -> Retargeter:
    return Retargeter(method="geort")


def measured(retargeter: Retargeter, recording: HandRecording) -> dict[str, object]:
    commands, _ = retargeter.run(recording)
    trace = assemble_trace(recording, commands, retargeter.hand, reach_samples=0)
    return dict(evaluate(trace)) | {"tip_gap_mm": tip_gap_mm(trace)}


def test_the_built_in_model_says_how_it_was_made():
    path = built_in_model("mimic_p050")
    assert path.stat().st_size < 500_000
    about = read_geort_model(path).training
    trained_on = about["recordings"]["train"]
    assert len(trained_on) == TRAINING_OPERATORS
    assert all(int(name.rsplit("-", 1)[1]) >= FIRST_SEED for name in trained_on)
    assert about["settings"] == json.loads(json.dumps(about["settings"]))
    assert about["epochs_done"] == about["settings"]["epochs"]
    assert built_in_model("pincer") is None


def test_the_built_in_model_serves_an_operator_it_never_saw(right):
    metrics = measured(right, SyntheticOperator(seed=77, rate_hz=50).record(20.0))
    assert metrics["cosine_similarity"] > 0.9
    assert metrics["cosine_similarity_all"] > 0.93
    assert metrics["motion_preservation"] > 0.95
    assert metrics["tip_gap_mm"] < 6
    assert metrics["limit_violation_share"] == 0
    assert metrics["frozen_share"] == 0
    assert metrics["lag_ms"] < 2


def test_only_fingertips_count_and_no_frame_before(right):
    recording = SyntheticOperator(seed=4, rate_hz=30).record(1.0)
    state, _ = right.step(right.init(), recording[10])
    _, after = right.step(state, recording[20])
    tips = recording[20].landmarks.copy()
    tips[[2, 3, 6, 7, 10, 11, 14, 15, 18, 19]] = np.nan
    _, fresh = right.step(right.init(seed=9), HandFrame(tips, 0.0))
    assert after.status == Status.OK
    np.testing.assert_array_equal(after.command.joint_positions, fresh.command.joint_positions)


@pytest.mark.shared
def test_the_built_in_model_is_as_good_as_the_authors_on_a_real_hand(right, shared):
    (path,) = (shared / "recordings").glob("manus*.npz")
    recording = read_recording(path)
    metrics = measured(right, recording[:500])
    assert metrics["cosine_similarity"] >= 0.93
    assert metrics["flatness"] <= 3.7e-6
    assert metrics["motion_preservation"] >= 0.95
    assert measured(right, recording[2600:3100])["tip_gap_mm"] < 15


@pytest.fixture
def run(
    hand: Hand, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., tuple[int, str]]]:
    """Runs a command for the quick hand: exit status and standard error."""

    def quick(**chosen: int) -> GeortTraining:
        return replace(TINY, **chosen)

    made: dict[tuple[str, int, int], GeortTrainer] = {}

    def compiled_once(hand: Hand, data: TrainingData, settings: GeortTraining) -> GeortTrainer:
        key = (data.digest, settings.epochs, settings.seed)
        return made.setdefault(key, GeortTrainer(hand, data, settings))

    monkeypatch.setattr("smooth_operator.baselines.geort.training.GeortTrainer", compiled_once)
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", "off")
    monkeypatch.delenv("SMOOTH_OPERATOR_DEBUG", raising=False)
    monkeypatch.setattr("smooth_operator.hands.registry.load_hand", lambda name, side: hand)
    monkeypatch.setattr("smooth_operator.baselines.geort.training_data.GeortTraining", quick)

    def call(*arguments: object) -> tuple[int, str]:
        capfd.readouterr()
        status = main(["train", "geort", *map(str, arguments)])
        out, err = capfd.readouterr()
        assert out == ""
        return status, err

    return call


def test_the_command_stops_resumes_and_ends_the_same(run, operator, tmp_path, monkeypatch):
    # a recording that says neither its side nor its rate, and holds no pinch
    glove = tmp_path / "open hand.npy"
    spreading = [name in ("spread", "open_close") for name in operator.meta["gesture"]]
    far = np.linalg.norm(operator.landmarks[:, 8] - operator.landmarks[:, 4], axis=-1) > 0.06
    np.save(glove, operator.landmarks[np.array(spreading) & far])
    start = (glove, "--rate", 40, "--epochs", 3, "--seed", 1, "--output")
    whole, halted = tmp_path / "new" / "whole", tmp_path / "halted"
    status, err = run(*start, whole)
    assert status == 0, err
    assert "assuming right" in err
    assert "the recordings contain no pinch" in err
    assert "3/3 epochs" in err
    assert "validation: direction" in err

    epochs = GeortTrainer.epochs

    def impatient(self: GeortTrainer, state: TrainingState) -> Iterator[TrainingState]:
        yield next(iter(epochs(self, state)))
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(GeortTrainer, "epochs", impatient)
        status, err = run(*start, halted, "--quiet")
    assert status == 130
    (told,) = [line for line in err.splitlines() if "to continue: " in line]
    words = shlex.split(told.partition("to continue: ")[2])
    assert words[:3] == ["smooth-operator", "train", "geort"]
    assert read_geort_model(halted / MODEL).training["epochs_done"] == 1  # usable as it is
    assert run(*words[3:])[0] == 0
    for name in (MODEL, CHECKPOINT, "losses.csv", "model.json"):
        assert (halted / name).read_bytes() == (whole / name).read_bytes(), name

    status, err = run(*start, whole)
    assert (status, "--resume" in err) == (2, True)
    status, err = run(*start, halted, "--epochs", 5, "--resume")
    assert (status, "epochs is 3, not 5" in err) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("no-such-file.npz",), "no-such-file"),
        (("synthetic", "--rate", "30"), "can't be combined with"),
        (("synthetic", "other.npz"), "can't be combined with"),
        (("synthetic", "--checkpoint-every", "0"), "checkpoint-every"),
    ],
)
def test_the_command_says_what_is_wrong(run, tmp_path, arguments, reason):
    folder = tmp_path / "out"
    status, err = run(*arguments, "--output", folder)
    assert status == 2
    assert reason in err
    assert not folder.exists()


def test_the_file_of_a_model_stands_for_a_preset(tmp_path):
    built_in = files("smooth_operator.baselines.geort") / "models" / "geort_mimic_p050.npz"
    (tmp_path / "mine.npz").write_bytes(built_in.read_bytes())
    path = tmp_path / "mine.npz"
    assert method_config("geort", str(path)) == GeortConfig(model=path)
    with pytest.raises(UnknownNameError, match="preset"):
        method_config("geort", str(tmp_path / "none.npz"))
    with pytest.raises(UnknownNameError, match="preset"):
        method_config("sbr", str(path))
