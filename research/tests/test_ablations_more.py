"""The experiments on libraries and methods: takes, lag, orders, gaps, resuming."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.presets import PRESETS
from smooth_operator.synthetic.tracker import TrackerModel
from smooth_operator_benchmark.cells import Choice
from smooth_operator_benchmark.ranking import HEADLINES
from smooth_operator_benchmark.recordings import Request, Source, load_sources, parse_request
from smooth_operator_research.paper import fk, follow, sweeps, table
from smooth_operator_research.paper.experiment import QUICK, ExperimentContext, ExperimentFolder
from smooth_operator_research.paper.figures import looks_of
from smooth_operator_research.paper.fk import (
    AGREEMENT,
    BOUNDED,
    MJX,
    MUJOCO,
    OURS,
    PINOCCHIO,
    Library,
    disagreement,
    make_library,
    missing,
    random_poses,
    write_urdf,
)
from smooth_operator_research.paper.follow import (
    LEAD,
    PUBLISHED_SBR,
    Field,
    at_rate,
    field_of,
    middle,
    nearest_frames,
    sub_frame_lag,
    through_tracker,
)
from smooth_operator_research.paper.intervals import independent, mean_of
from smooth_operator_research.paper.sweeps import Condition
from smooth_operator_research.paper.table import Benchmark

pytestmark = pytest.mark.weekly

TINY = dataclasses.replace(
    QUICK,
    name="tiny",
    fk_batches=(1, 64),
    fk_rounds=3,
    table_frames=30,
    latency_frames=6,
    noise_frames=30,
    noises=(0.0, 2e-3),
    losses=(0.0, 0.3),
    tracker_seeds=2,
    rates=(30.0, 100.0),
    rate_seconds=0.9,
)


@pytest.fixture(scope="module")
def sources() -> list[Source]:
    return load_sources([parse_request(t) for t in ("synthetic:0@300:400", "synthetic:1@700:800")])


@pytest.fixture
def context(sources, tmp_path) -> ExperimentContext:
    return ExperimentContext(sources, "mimic_p050", TINY, ExperimentFolder(tmp_path / "out", {}))


@pytest.fixture
def field() -> Field:
    # the paper's preset would take minutes
    stand_in = Choice("sbr", "realtime", PRESETS["sbr"]["realtime"])
    geort = Choice("geort", "default", PRESETS["geort"]["default"])
    return Field({PUBLISHED_SBR: stand_in, "geort": geort}, {})


@pytest.mark.parametrize("hand", [("mimic_p050", "right"), ("mimic_p050", "left")])
def test_the_urdf_has_the_hands_kinematics(hand):
    robot = load_hand(*hand)
    urdf = write_urdf(robot)
    option = '<mujoco><compiler fusestatic="false"/></mujoco></robot>'
    model = mujoco.MjModel.from_xml_string(urdf.text.replace("</robot>", option))
    data = mujoco.MjData(model)
    for q in random_poses(robot, 20, 0):
        for name, value in zip(urdf.joints, q - urdf.zero, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        tips = np.array([data.body(name).xpos for name in urdf.tips])
        np.testing.assert_allclose(tips, robot.tips(q), atol=1e-9)


def test_the_urdf_knows_slides_offsets_and_references():
    """Of a joint that slides, sits beside its body's origin, and is not 0 at its reference."""
    robot = load_hand("mimic_p050")
    spec = mujoco.MjSpec.from_string(
        """<mujoco><worldbody><body name="palm" pos="1 2 3" euler="10 20 30">
        <body name="a" pos="0.1 0 0" euler="0 40 0">
          <joint name="h" type="hinge" axis="0 0.6 0.8" pos="0.01 0.02 0" ref="0.3" range="-1 1"/>
          <joint name="s" type="slide" axis="0 1 0" range="-1 1"/>
          <geom size="0.01"/>
          <body name="fixed" pos="0 0 0.05" euler="70 0 0"><geom size="0.01"/>
            <body name="b" pos="0 0.03 0"><joint name="h2" axis="1 0 0" range="-1 1"/>
            <geom size="0.01"/></body></body></body></body></worldbody></mujoco>"""
    )
    model = spec.compile()

    class Point:
        body, offset = "b", (0.01, 0.02, 0.03)

    class Finger:
        name, tip = "thumb", Point

    class Spec:
        palm, mirror, fingers = "palm", False, (Finger,)

    class Odd:
        spec, joint_names = Spec, ("h", "s", "h2")
        bodies = np.array([False, True, True, True, True])

    Odd.model = model
    assert len(write_urdf(robot).tips) == 5
    urdf = write_urdf(Odd)
    option = '<mujoco><compiler fusestatic="false"/></mujoco></robot>'
    other = mujoco.MjModel.from_xml_string(urdf.text.replace("</robot>", option))
    data, found = mujoco.MjData(model), mujoco.MjData(other)
    q = np.array([0.7, 0.02, -0.4])
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    for name, value in zip(urdf.joints, q - urdf.zero, strict=True):
        found.qpos[other.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(other, found)
    at = data.body("b").xpos + data.body("b").xmat.reshape(3, 3) @ Point.offset
    in_palm = data.body("palm").xmat.reshape(3, 3).T @ (at - data.body("palm").xpos)
    np.testing.assert_allclose(found.body("tip_thumb").xpos, in_palm, atol=1e-9)


def test_every_library_that_is_here_agrees():
    hand = load_hand("mimic_p050", "left")
    q = random_poses(hand, 30, 1)
    here = [name for name in fk.LIBRARIES if missing(name) is None]
    assert {OURS, BOUNDED, MUJOCO} <= set(here)
    for name in here:
        if name == MJX:
            continue  # compiles for ten seconds; every run of the experiment checks it
        assert disagreement(make_library(name, hand), hand, q) < AGREEMENT, name


def test_fk_names_what_is_missing_and_does_not_time_what_is_wrong(context, monkeypatch):
    def wrong(name: str, hand: Any) -> Library:
        right = make_library(name, hand)
        if name != BOUNDED:
            return right
        return Library(name, right.prepare, lambda found: right.read(found) + 1e-3)

    monkeypatch.setattr(fk, "make_library", wrong)
    here = (OURS, BOUNDED, MUJOCO)
    monkeypatch.setattr(fk, "missing", lambda name: None if name in here else "not installed")
    found = fk.time_libraries(context, load_hand(context.hand))
    assert set(found.per_pose) == {OURS, MUJOCO}
    assert found.gaps[PINOCCHIO] == "not installed"
    assert "m from MuJoCo's" in found.gaps[BOUNDED]
    assert all(
        len(times) == TINY.fk_rounds and min(times) > 0
        for own in found.per_pose.values()
        for times in own.values()
    )
    monkeypatch.setattr(fk, "make_library", None)  # nothing is made or timed again
    outcome = fk.FkLibraries().run(context)
    assert outcome.figures["ns_per_pose"] == found.per_pose
    assert "Pinocchio is missing: not installed" in outcome.setup
    paper, ours = outcome.verdicts
    assert paper.held == "not shown"
    assert fk.INSTALL in paper.note
    assert MUJOCO in ours.ours
    legend = [text.get_text() for text in outcome.drawings[0].figure.legends[0].get_texts()]
    assert "Pinocchio: not installed" in legend


def test_every_round_counts_and_libraries_are_compared_round_by_round():
    walk, mujoco = [1.0, 3.0, 9.0], [4.0, 12.0, 37.0]  # the machine was busy in the last
    found = fk.Timing((1,), {OURS: {1: walk}, MUJOCO: {1: mujoco}}, {}, {}, 0)
    assert found.mean(OURS, 1).value == pytest.approx(3.0)  # geometric
    assert found.mean(OURS, 1).units == 3
    over = found.over(MUJOCO, OURS, 1)
    assert over.value == pytest.approx((4 * 4 * 37 / 9) ** (1 / 3))
    assert over.low > 3.8  # what slows both down alike is no difference between them


def test_a_tracker_adds_its_noise_and_loses_its_share(sources):
    clean = sources[0].recording
    before = clean.landmarks.copy()
    degraded = through_tracker(sources[0], clean, TrackerModel(frame_loss=0.2, seed=3), 2e-3)
    lost = ~degraded.seen.valid.any(axis=1)
    assert not lost[:LEAD].any()
    assert 0.08 < lost.mean() < 0.35
    assert np.isnan(degraded.seen.landmarks[lost]).all()
    kept = ~lost[LEAD:]
    error = degraded.seen.landmarks[LEAD:][kept] - clean.landmarks[kept]
    assert np.std(error) == pytest.approx(2e-3, rel=0.03)
    assert abs(np.mean(error)) < 1e-4
    assert len(degraded.seen) == len(clean) + LEAD
    np.testing.assert_array_equal(clean.landmarks, before)
    np.testing.assert_array_equal(degraded.seen.stamps[LEAD:], clean.stamps)
    np.testing.assert_allclose(np.diff(degraded.seen.stamps), 0.01, atol=1e-9)
    again = through_tracker(sources[0], clean, TrackerModel(frame_loss=0.2, seed=3), 2e-3)
    other = through_tracker(sources[0], clean, TrackerModel(frame_loss=0.2, seed=4), 2e-3)
    assert degraded.digest == again.digest != other.digest


def test_without_imperfections_a_take_is_the_recording(sources):
    clean = sources[0].recording
    degraded = through_tracker(sources[0], clean, TrackerModel())
    np.testing.assert_array_equal(degraded.seen.landmarks[LEAD:], clean.landmarks)
    np.testing.assert_array_equal(
        degraded.seen.landmarks[:LEAD], np.repeat(clean.landmarks[:1], LEAD, axis=0)
    )


def test_the_built_in_operator_moves_alike_at_every_rate(sources):
    base, fast = (at_rate(sources[1], hz, 0.5) for hz in (100.0, 200.0))
    assert fast.clean.rate_hz == pytest.approx(200.0)
    assert fast.clean.duration == pytest.approx(0.5, abs=0.011)
    both = [i for i, t in enumerate(fast.clean.stamps) if np.isclose(t, base.clean.stamps).any()]
    same = [i for i, t in enumerate(base.clean.stamps) if np.isclose(t, fast.clean.stamps).any()]
    assert len(both) > 40
    np.testing.assert_allclose(fast.clean.landmarks[both], base.clean.landmarks[same], atol=1e-9)


def test_an_operators_hand_and_tempo_stay_at_every_rate():
    (source,) = load_sources([parse_request("synthetic:1@16.5cm,1.3x,300:400")])
    degraded = at_rate(source, 100.0, 0.5)
    at = np.flatnonzero(np.isclose(source.recording.stamps, degraded.clean.stamps[0]))[0]
    same = source.recording.landmarks[at : at + len(degraded.clean)]
    np.testing.assert_allclose(degraded.clean.landmarks, same, atol=1e-9)


def test_of_a_file_frames_are_taken_and_never_made_up(sources):
    recording = sources[0].recording
    source = Source(Request(Path("glove.npz")), "glove", recording, digest="d")
    slow = at_rate(source, 30.0, 0.9)
    assert slow.clean.rate_hz == pytest.approx(30.0, rel=0.15)
    assert np.isin(slow.clean.stamps, recording.stamps).all()
    assert at_rate(source, 200.0, 0.9) is None
    with pytest.raises(RecordingError, match="it needs"):
        at_rate(source, 15.0, 0.2)


def test_the_middle_leaves_as_much_on_either_side(sources):
    recording = sources[0].recording
    count = len(recording)
    found = middle(recording, count - 20)
    np.testing.assert_array_equal(found.stamps, recording.stamps[10 : count - 10])
    assert len(middle(recording, count + 5)) == count


def test_nearest_frames_are_taken_once():
    stamps = np.array([0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(
        nearest_frames(stamps, np.array([0.0, 0.04, 0.16, 0.9])), [0, 2, 3]
    )


@pytest.mark.parametrize("rate_hz", [15.0, 30.0, 100.0, 200.0])
@pytest.mark.parametrize("delay_ms", [0.0, 3.7, 41.0])
def test_a_delay_is_found_finer_than_a_frame(rate_hz, delay_ms):
    rng = np.random.default_rng(0)
    speed, phase = rng.uniform(2.0, 12.0, (5, 3)), rng.uniform(0, 6, (5, 3))
    stamps = np.arange(0.0, 4.0, 1 / rate_hz)

    def tips(t: np.ndarray) -> np.ndarray:
        return 0.05 * np.sin(speed * t[:, None, None] + phase)

    lag, correlation = sub_frame_lag(tips(stamps), tips(stamps - delay_ms / 1e3), stamps)
    assert lag == pytest.approx(delay_ms, abs=0.5)
    assert correlation > 0.99


def test_where_nothing_moves_there_is_no_lag():
    stamps = np.arange(0.0, 2.0, 0.01)
    still = np.zeros((len(stamps), 5, 3))
    assert np.isnan(sub_frame_lag(still, still, stamps)).all()
    assert np.isnan(sub_frame_lag(still[:5], still[:5], stamps[:5])).all()


def test_noise_makes_rougher_and_is_resumed(context, field, monkeypatch):
    monkeypatch.setattr(sweeps, "field_of", lambda context: field)
    outcome = sweeps.TrackerNoise().run(context)
    clean, noisy = Condition(), Condition(noise=2e-3)
    by = {
        (one["method"], one["condition"], one["recording"]): one["seeds"]
        for one in outcome.figures["cells"]
    }
    for source in context.sources:
        for label in field.choices:
            (at_rest,), shaken = (by[label, c, source.name] for c in (clean, noisy))
            assert len(shaken) == TINY.tracker_seeds
            assert shaken[0]["jitter"] != shaken[1]["jitter"]
            assert min(one["jitter"] for one in shaken) > 3 * at_rest["jitter"]
            assert min(one["flatness"] for one in shaken) > 9 * at_rest["flatness"]
            assert at_rest["cosine_similarity"] > 0.9
            lost = by[label, Condition(loss=0.3), source.name]
            assert max(one["held"] for one in lost) > 0
            assert at_rest["held"] == 0
        (human,) = by["human", clean, source.name]
        assert human["flatness"] == human["seen_flatness"]
        assert by["human", noisy, source.name][0]["seen_flatness"] > 9 * human["flatness"]
    assert "geort × " in outcome.verdicts[0].ours
    assert "geort ×" not in outcome.verdicts[2].ours
    monkeypatch.setattr(follow, "built_for", None)  # no method runs again
    assert sweeps.TrackerNoise().run(context).figures == outcome.figures


def test_rate_reports_accelerations_and_lags(context, field, monkeypatch):
    monkeypatch.setattr(sweeps, "field_of", lambda context: field)
    glove = Source(Request(Path("glove.npz")), "glove", context.sources[0].recording, digest="d")
    mixed = dataclasses.replace(context, sources=[context.sources[1], glove])
    outcome = sweeps.FrameRate().run(mixed)
    cells = [one for one in outcome.figures["cells"] if one["method"] == PUBLISHED_SBR]
    assert {one["condition"] for one in cells} == set(TINY.rates)
    for one in cells:
        (figures,) = one["seeds"]
        assert figures["acceleration"] > 0
        assert -50 < figures["lag_ms"] < 250
        assert figures["correlation"] > 0.5
    assert outcome.figures["too_slow"] == []
    assert "100 Hz" in outcome.verdicts[0].note
    faster = dataclasses.replace(TINY, rates=(100.0, 200.0))
    again = sweeps.FrameRate().run(dataclasses.replace(mixed, size=faster))
    assert again.figures["too_slow"] == ["glove at 200 Hz"]
    assert "glove at 200 Hz" in again.setup


def test_a_method_that_cannot_serve_the_hand_is_a_gap(context):
    other = dataclasses.replace(context, hand="allegro_hand")  # no GeoRT model comes with it
    found = field_of(other, ("joint_angle", "geort"))
    assert list(found.choices) == ["joint_angle"]
    assert "geort is missing: there is no built-in GeoRT model" in found.note()
    with pytest.raises(ConfigError, match="no method can be used with hand"):
        field_of(other, ("geort",))


def test_the_table_has_six_metrics_by_both_definitions(context, field, monkeypatch):
    monkeypatch.setattr(table, "field_of", lambda context, names: field)
    outcome = table.BenchmarkTable().run(context)
    assert [v.claim.partition(":")[0].split(" (")[0].split(" [")[0] for v in outcome.verdicts] == [
        "cosine similarity",
        "scale ratio",
        "motion preservation",
        "flatness",
        "workspace utilisation",
        "latency",
    ]
    values = {
        (v["definition"], v["method"], v["metric"]): v["recordings"]
        for v in outcome.figures["values"]
    }
    names = {source.name for source in context.sources}
    for definition in ("paper", "sound"):
        for label in field.choices:
            for metric in HEADLINES:
                assert set(values[definition, label, metric.name]) == names
    paper = outcome.tables[0]
    assert paper.headers == ["metric", "GeoRT", "SBR"]
    assert len(paper.rows) == 12
    assert paper.rows[1][1:] == ["0.9799", "0.9969 ★"]
    json.dumps(outcome.figures["values"])
    # the lead is not measured: nobody is on the way from the neutral pose
    flat = values["sound", PUBLISHED_SBR, "flatness"]
    assert max(flat.values()) < 1e-6
    monkeypatch.setattr(table, "built_for", None)
    monkeypatch.setattr(table, "measure_latency", None)
    assert table.BenchmarkTable().run(context).figures == outcome.figures


def _benchmark(order: tuple[str, ...]) -> Benchmark:
    """Six metrics in which ``order`` goes from best to worst, on three recordings."""
    values: dict[tuple[str, str, str], dict[str, float]] = {}
    for metric in HEADLINES:
        for place, label in enumerate(order):
            worse = 0.02 * place
            value = {"->1": 1.0 - worse, "up": 0.5 - worse, "down": 1.0 + worse}[metric.goal]
            for definition in ("paper", "sound"):
                values[definition, label, metric.name] = {
                    f"r{k}": value + 1e-3 * k for k in range(-1, 2)
                }
    return Benchmark(order, values, {name: name for name in ("r-1", "r0", "r1")}, None)


def test_an_order_holds_only_where_all_pairs_do():
    papers = list(table.PAPERS)
    cosine = next(metric for metric in HEADLINES if metric.name == "cosine_similarity")
    order = ("sbr:paper", "dexpilot", "hybrid", "geort")
    assert table._verdict(_benchmark(order), cosine, papers).held == "held"
    assert table._verdict(_benchmark(order[::-1]), cosine, papers).held == "did not hold"
    swapped = ("dexpilot", "sbr:paper", "hybrid", "geort")
    verdict = table._verdict(_benchmark(swapped), cosine, papers)
    assert verdict.held == "mixed"
    assert "5 are shown" in verdict.note
    assert "1 in the opposite one" in verdict.note
    assert verdict.ours.startswith("DexPilot")
    assert _benchmark(swapped).winners("paper", cosine, list(swapped)) == {"dexpilot"}


def test_differences_are_written_with_their_sign():
    assert sweeps.signed(mean_of(independent([-3.0, -1.0])), " ms").startswith("−2")
    assert sweeps.signed(mean_of(independent([1.0, 3.0]))).startswith("+2")


def test_presets_of_a_method_share_a_colour_and_not_a_look():
    looks = looks_of(["sbr", "sbr:paper", "geort", "unheard_of"])
    assert looks["sbr"].color == looks["sbr:paper"].color
    assert looks["sbr"].line != looks["sbr:paper"].line
    assert len({look.color for look in looks.values()}) == 3
