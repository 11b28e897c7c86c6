"""Calibration: operators with known offsets and sizes are found again, and bad ones told apart."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from metrics_cases import tip_gap_mm

from smooth_operator import Retargeter, SyntheticOperator, load_hand, method_config
from smooth_operator.calibration.estimate import (
    MARGIN,
    Calibration,
    _project,
    calibrate,
    closed_gaps,
    report,
)
from smooth_operator.calibration.operator_file import read_operator, write_operator
from smooth_operator.calibration.segments import Prompt, measure_features, poses, prompts
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.hand import Hand, knuckle_joints
from smooth_operator.human.alignment import palm_alignment
from smooth_operator.human.flat_hand import human_palm_axes
from smooth_operator.human.operator import COMPONENTS, tip_frames
from smooth_operator.lab.offline.folder import survey
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.planning import make_request
from smooth_operator.teleop.pages import Playback
from smooth_operator.types import HandRecording, Side

THREE = "thumb,index,pinky=ring"
CHOSEN = {"thumb": "thumb", "index": "index", "pinky": "ring"}

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def exact() -> HandRecording:
    """Every pose twice, as no tracker sees it; tips meet within 2 mm where they pinch."""
    return SyntheticOperator(seed=2).record(36.0)


@pytest.fixture(scope="module")
def found(exact, hand) -> Calibration:
    return calibrate(exact, hand)


def shifted(recording: HandRecording, hand: Hand, along: float, pad: float) -> HandRecording:
    """As a tracker sees it whose tip landmarks are that far short of the pads [m]."""
    fit = palm_alignment(recording.landmarks, hand)
    points = fit.apply(recording.landmarks)
    outwards, to_pad = tip_frames(points, [0, 1, 2, 3, 4], human_palm_axes(hand))
    turn_back = np.swapaxes(np.asarray(fit.rotation), -1, -2)
    offset = np.einsum("tij,tfj->tfi", turn_back, along * outwards + pad * to_pad)
    landmarks = recording.landmarks.copy()
    landmarks[:, TIPS] -= offset
    return replace(recording, landmarks=landmarks)


def test_every_pose_is_found_where_it_was_made(exact, found):
    made = np.array(exact.meta["gesture"])
    wanted = {"flat": None, "spread": "spread", "fist": "open_close"}
    for finding in found.findings:
        gesture = wanted.get(finding.pose, finding.pose)
        assert finding.confidence > 0.3, finding.pose
        if gesture is not None:
            at = np.concatenate([made[s.start : s.stop] for s in finding.segments])
            share = (at == gesture).mean()
            # A gait curls all fingers as well: its fists are fists.
            assert share > (0.7 if finding.pose == "fist" else 0.9), (
                f"{finding.pose} is {share:.0%} {gesture}"
            )
    assert [finding.pose for finding in found.findings] == list(poses())


def test_size_and_scale_are_the_operators(exact, hand, found):
    operator = found.operator
    anatomy = np.linalg.norm(np.diff(exact.landmarks[0, 1:].reshape(5, 4, 3), axis=1), axis=-1)
    np.testing.assert_allclose([f.bones for f in operator.fingers], anatomy, rtol=1e-6)
    for finger, bones in zip(operator.fingers, anatomy, strict=True):
        assert 0.94 * bones.sum() <= finger.reach <= bones.sum()
        assert finger.scale == pytest.approx(finger.robot_reach / finger.reach)
    palm = exact.landmarks[0, 5] - exact.landmarks[0, 17]
    assert operator.palm_width == pytest.approx(np.linalg.norm(palm), rel=1e-6)
    scale = np.median(np.asarray(palm_alignment(exact.landmarks, hand).scale))
    assert operator.scale == pytest.approx(scale)


def test_a_larger_hand_has_smaller_scales(exact, hand):
    small = calibrate(exact, hand).operator
    large = calibrate(replace(exact, landmarks=1.15 * exact.landmarks), hand).operator
    assert large.scale == pytest.approx(small.scale / 1.15)
    for a, b in zip(small.fingers, large.fingers, strict=True):
        assert b.scale == pytest.approx(a.scale / 1.15, rel=1e-3)


def test_a_latch_closes_at_a_distance_of_the_robots_size():
    """It holds what nine of ten frames of the loosest finger's pinches are held at, at its size."""
    spread = np.linspace(0, 0.05, 101)[:, None]  # nine of ten are 20 mm beyond the middle
    gaps = {"index": spread, "middle": 0.2 * spread}
    assert _project(gaps, 0.5, 0) == pytest.approx(0.5 * 0.02 + MARGIN)


@pytest.mark.parametrize(("along", "pad"), [(0.0, 0.006), (0.004, 0.004), (-0.003, 0.006)])
def test_the_way_from_landmark_to_pad_is_found(along, pad, exact, hand):
    seen = shifted(exact, hand, along, pad)
    calibration = calibrate(seen, hand, apply=("tips",))
    truth = calibrate(exact, hand).gaps
    for finger, gaps in calibration.gaps.items():
        before, after = np.median(gaps, axis=0)
        # What is left is what there was without a tracker, and its own few tenths.
        assert after < np.median(truth[finger][:, 0]) + 0.0025, finger
        assert after < 0.6 * before or before < 0.003, finger
    got = np.array([(f.tip_along, f.tip_pad) for f in calibration.operator.fingers])
    # Pinches tell the sum of thumb and finger; how it is shared among them is a guess.
    assert np.abs(got.mean(axis=0) - (along, pad)).max() < 0.003


def test_noise_dropouts_and_outliers_are_lived_with(exact, hand):
    rng = np.random.default_rng(0)
    clean = shifted(exact, hand, 0.002, 0.005)
    landmarks = clean.landmarks + rng.normal(0, 0.001, clean.landmarks.shape)
    landmarks[rng.random(len(landmarks)) < 0.05] = np.nan
    landmarks[rng.random(landmarks.shape[:2]) < 0.002] += 0.2
    landmarks[200:230] = np.nan
    noisy = replace(clean, landmarks=landmarks, valid=None)
    want, got = calibrate(clean, hand), calibrate(noisy, hand)
    assert got.features.good.mean() < 0.93
    missing = [f.pose for f in got.findings if not f.segments]
    assert missing == []
    assert got.operator.scale == pytest.approx(want.operator.scale, rel=0.02)
    for a, b in zip(want.operator.fingers, got.operator.fingers, strict=True):
        assert b.reach == pytest.approx(a.reach, rel=0.03)
        assert abs(b.tip_along - a.tip_along) < 0.002
        assert abs(b.tip_pad - a.tip_pad) < 0.002
        if a.pinch_gap is not None and b.pinch_gap is not None:
            assert b.pinch_gap == pytest.approx(a.pinch_gap, abs=0.0025)


def test_without_pinches_the_rest_is_calibrated(hand):
    recording = SyntheticOperator(seed=1, gestures=("spread", "open_close")).record(8.0)
    calibration = calibrate(recording, hand)
    notes = {f.pose: f.note for f in calibration.findings}
    assert all("not found" in notes[f"pinch_{finger}"] for finger in FINGERS[1:])
    assert not notes["flat"]
    assert not notes["fist"]
    operator = calibration.operator
    assert (operator.project, operator.escape, operator.residual_gap) == (None, None, None)
    assert all((f.tip_along, f.tip_pad, f.pinch_gap) == (0, 0, None) for f in operator.fingers)
    config = method_config("dexpilot")
    assert config.with_operator(operator).objective == config.objective


def test_without_a_flat_hand_reach_is_the_bones(hand):
    whole = SyntheticOperator(seed=1, gestures=("pinch_index", "open_close")).record(6.0)
    bent = measure_features(whole).straightness[:, 1:].min(axis=1) < 0.85
    assert 50 < bent.sum() < 550
    valid = np.repeat(bent[:, None], 21, axis=1)
    calibration = calibrate(replace(whole, valid=valid), hand)
    notes = {f.pose: f.note for f in calibration.findings}
    assert "not found" in notes["flat"]
    assert calibration.rotation_deg is None
    for finger in calibration.operator.fingers:
        assert finger.reach == pytest.approx(sum(finger.bones))


def test_a_finger_that_never_pinched_has_the_offset_of_the_others(hand):
    recording = SyntheticOperator(seed=3, gestures=("pinch_index", "spread")).record(12.0)
    operator = calibrate(shifted(recording, hand, 0.0, 0.006), hand).operator
    index, pinky = operator.fingers[1], operator.fingers[4]
    assert index.pinch_gap is not None
    assert pinky.pinch_gap is None
    assert pinky.tip_pad == pytest.approx(index.tip_pad, abs=0.002)
    assert pinky.tip_pad > 0.7 * index.tip_pad > 0.001  # most of it is what fingers share


def test_segments_that_prompts_mark_calibrate_like_those_of_a_search(exact, hand, found):
    segments = [
        replace(next(s for s in found.segments if s.pose == prompt.pose), confidence=1.0)
        for prompt in prompts()
    ]
    assert len(segments) == 7
    calibration = calibrate(exact, hand, segments)
    assert all(f.confidence == 1.0 for f in calibration.findings)
    for a, b in zip(found.operator.fingers, calibration.operator.fingers, strict=True):
        assert b.reach == pytest.approx(a.reach, rel=0.05)
        assert abs(b.tip_pad - a.tip_pad) < 0.002
    assert sum(prompt.settle + prompt.hold for prompt in prompts()) < 120  # two minutes
    assert [p.pose for p in prompts(("thumb", "ring"))] == ["flat", "spread", "fist", "pinch_ring"]


def test_the_wrong_side_is_noticed(exact, hand):
    mirrored = replace(exact, landmarks=exact.landmarks * np.array([-1.0, 1.0, 1.0]))
    with pytest.raises(RecordingError, match=r"this is a left hand.*say --side left"):
        calibrate(mirrored, hand)
    left = load_hand(side="left")
    with pytest.raises(ConfigError, match="a right operator can't be calibrated for the left"):
        calibrate(exact, left)
    other = calibrate(replace(mirrored, side="left"), left).operator
    right = calibrate(exact, hand).operator
    assert other.side == "left"
    assert other.scale == pytest.approx(right.scale, rel=1e-6)
    np.testing.assert_allclose(
        [(f.tip_along, f.tip_pad) for f in other.fingers],
        [(f.tip_along, f.tip_pad) for f in right.fingers],
        atol=1e-6,
    )


def test_a_recording_without_whole_hands_is_refused(exact, hand):
    valid = np.ones((len(exact), 21), bool)
    valid[5:, 7] = False
    with pytest.raises(RecordingError, match=r"5 of .* frames show a whole hand"):
        calibrate(replace(exact, valid=valid), hand)


@pytest.mark.parametrize("name", ["mimic_p050", "allegro_hand", "leap_hand"])
def test_a_straight_pose_reaches_as_far_as_any(name):
    robot = load_hand(name)
    straight = robot.straight_pose
    low, high = robot.limits.T
    assert ((straight.q >= low) & (straight.q <= high)).all()
    q = np.random.default_rng(0).uniform(low, high, (4000, len(low)))
    points = robot.landmark_positions(q)
    names = [robot.tree.names.index(n) for n in robot.tip_names]
    bases = [
        robot.tree.names.index(f"{f}_{'cmc' if f == 'thumb' else 'mcp'}") for f in robot.fingers
    ]
    reach = np.linalg.norm(points[:, names] - points[:, bases], axis=-1).max(axis=0)
    assert (straight.reach >= 0.985 * reach).all()


@pytest.mark.parametrize(
    "name", ["shadow_hand", "schunk_svh", "tesollo_dg5f", "orca_v2", "shadow_dexee"]
)
def test_joints_behind_the_knuckle_do_not_lengthen_a_finger(name):
    robot = load_hand(name)
    assert knuckle_joints(robot).any()
    points = robot.landmark_positions(np.clip(0.0, *robot.limits.T))
    for finger, reach in list(zip(robot.fingers, robot.straight_pose.reach, strict=True))[1:]:
        own = [robot.tree.names.index(f"{finger}_{part}") for part in ("mcp", "pip", "dip", "tip")]
        bones = np.linalg.norm(np.diff(points[own], axis=0), axis=-1).sum()
        assert 0.95 * bones < reach < 1.03 * bones


@pytest.mark.parametrize("name", ["mimic_p050", "allegro_hand", "leap_hand", "wuji_hand"])
def test_hands_without_joints_behind_the_knuckle(name):
    assert not knuckle_joints(load_hand(name)).any()


def test_the_report_says_what_was_found(exact, found):
    content = report(found, exact)
    assert content["frames_used"] == len(exact)
    index = content["fingers"]["index"]
    assert index["pinch_gap_mm"]["median"] == pytest.approx(
        1e3 * found.operator.fingers[1].pinch_gap
    )
    assert index["pinch_gap_corrected_mm"]["median"] <= index["pinch_gap_mm"]["median"]
    assert content["fingers"]["thumb"]["pinch_gap_mm"] is None
    segment = content["poses"]["pinch_ring"]["segments"][0]
    assert segment["to_s"] > segment["from_s"]
    assert closed_gaps(found, "thumb") is None


@pytest.mark.weekly
@pytest.mark.shared
def test_the_second_half_gains_from_a_fit_on_the_first(shared, hand):
    file = shared / "recordings" / "manus_right_subject-000_run-010.npz"
    whole = read_recording(file)
    operator = calibrate(whole[:2500], hand).operator
    part = whole[2600:3400]  # three of the four pinches; none was in the first half

    def judged(config: object) -> tuple[float, float]:
        commands, _ = Retargeter(hand, config=config).run(part)
        trace = assemble_trace(part, commands, hand, reach_samples=0)
        metrics = evaluate(trace)
        assert isinstance(metrics["scale_ratio"], float)
        return tip_gap_mm(trace), abs(metrics["scale_ratio"] - 1)

    config = method_config("sbr")
    before, after = judged(config), judged(config.with_operator(operator))
    assert after[0] < 0.97 * before[0]
    assert after[1] < 0.9 * before[1]


@pytest.mark.weekly
@pytest.mark.shared
def test_the_precise_preset_closes_pinches_and_keeps_its_directions(shared, hand):
    """Fitted on the first half, judged in the second, against the human as tracked."""
    file = shared / "recordings" / "manus_right_subject-000_run-010.npz"
    whole = read_recording(file)
    operator = calibrate(whole[:2500], hand).operator
    part = whole[2500:]

    def judged(config: object) -> tuple[float, float, float]:
        commands, _ = Retargeter(hand, config=config).run(part)
        trace = assemble_trace(part, commands, hand, reach_samples=0)
        metrics: Any = evaluate(trace)
        return (
            tip_gap_mm(trace, 0.012),
            metrics["cosine_similarity"],
            metrics["motion_preservation"],
        )

    config = method_config("smooth", "precise")
    before, after = judged(config), judged(config.with_operator(operator))
    assert after[0] < before[0] - 0.2
    # without a calibration, fingers that should bend no longer stay straight: 0.9567, not 0.9529
    assert before[1] > 0.955
    assert after[1] > before[1] - 0.004
    assert after[2] > before[2] - 0.005


def test_the_report_promises_what_held_for_frames_it_was_not_fitted_on(found):
    """A gap that differs between two pinches is not closed by the fit of one of them."""
    finger = next(iter(found.gaps))
    early = np.full((20, 2), 0.004)
    two = np.concatenate([early, early + 0.006])
    left = closed_gaps(replace(found, gaps={finger: two}), finger)
    np.testing.assert_allclose(left[20:], 0.006, atol=1e-12)
    assert closed_gaps(replace(found, gaps={finger: two[:6]}), finger) is None


def save(path: Path, seconds: float = 20.0, side: Side = "right") -> Path:
    hand = SyntheticOperator(seed=2, side=side).record(seconds)
    np.savez(path, landmarks=hand.landmarks, timestamps=hand.stamps, side=side)
    return path


def test_calibrate_and_retarget(tmp_path, run, monkeypatch):
    glove = save(tmp_path / "glove.npz")
    out = tmp_path / "new" / "operator.json"
    status, text, err = run("calibrate", glove, "--output", out)
    assert status == 0, err
    assert "pinch_ring" in text
    assert "in use: scale, pinch" in text
    assert (tmp_path / "new" / "operator.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert read_operator(out).apply == ("scale", "pinch")
    status, text, err = run(
        "calibrate", glove, "--output", out, "--json", "--quiet", "--apply", "all",
        "--fingers", THREE, "--frames", ":1500",
    )  # fmt: skip
    assert (status, err) == (0, "")
    content = json.loads(text)
    assert content["fingers"].keys() == {"thumb", "index", "ring"}
    assert content["fingers"]["ring"]["robot"].startswith("pinky")
    figures = json.loads((tmp_path / "new" / "operator.report.json").read_text(encoding="utf-8"))
    assert figures == content
    operator = read_operator(out)
    assert operator.apply == COMPONENTS

    def commands(name: str, *more: object) -> np.ndarray:
        target = tmp_path / f"{name}.npz"
        status, _, err = run(
            "retarget", glove, "--method", "joint_angle", "--frames", ":20", "--quiet", "--json",
            "--output", target, *more,
        )  # fmt: skip
        assert status == 0, err
        config = json.loads(target.with_suffix(".json").read_text(encoding="utf-8"))
        asked = "--operator" in more
        assert (config["config"]["alignment"]["operator"] is not None) == asked
        assert config["fingers"] == (CHOSEN if "--fingers" in more else None)
        if asked:
            assert config["config"]["alignment"]["operator"]["scale"] == operator.scale
        return np.asarray(np.load(target)["joint_positions"])

    plain = commands("plain")
    three = commands("three", "--fingers", THREE)
    both = commands("both", "--fingers", THREE, "--operator", out)
    assert not np.array_equal(plain, three)
    assert not np.array_equal(three, both)
    hand = load_hand()
    still = [i for i, name in enumerate(hand.joint_names) if name.startswith(("middle", "ring"))]
    assert np.ptp(three[:, still], axis=0).max() == 0
    assert np.ptp(plain[:, still]) > 0

    pages: list[Playback] = []
    monkeypatch.setattr("smooth_operator.teleop.pages.serve", lambda runs, **_: pages.extend(runs))
    assert run("view", tmp_path / "both.npz", glove)[0] == 0
    assert run("view", tmp_path / "plain.npz", glove)[0] == 0
    assert [len(page.trace.fingers) for page in pages] == [3, 5]

    status, _, err = run("retarget", glove, "--operator", out, "--output", tmp_path / "x.npz")
    assert status == 2
    assert "calibrate with the same --fingers" in err
    status, _, err = run("retarget", glove, "--fingers", "index", "--output", tmp_path / "x.npz")
    assert status == 2
    assert "the thumb must be among the fingers" in err


def test_what_calibrate_refuses(tmp_path, run):
    glove = save(tmp_path / "glove.npz", 1.0)
    mine = tmp_path / "mine.json"
    mine.write_text('{"thesis": 1}', encoding="utf-8")
    cases = {
        ("--output", tmp_path / "operator.txt"): "the name must end in .json",
        ("--output", mine): "something other than a calibration",
        ("--output", tmp_path / "o.json", "--apply", "tip"): "unknown component",
        ("--output", tmp_path / "o.json", "--hand", "foot"): "unknown hand",
        ("--output", tmp_path / "o.json", "--frames", ":5"): "frames show a whole hand",
    }
    for arguments, message in cases.items():
        status, out, err = run("calibrate", glove, *arguments)
        assert (status, out) == (2, ""), err
        assert message in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["glove.npz", "mine.json"]


def test_a_folder_is_made_again_for_other_fingers_or_another_operator(tmp_path, run, exact, found):
    recordings, output = tmp_path / "in", tmp_path / "out"
    recordings.mkdir()
    save(recordings / "a.npz", 0.3)
    file = tmp_path / "operator.json"
    write_operator(file, found.operator)
    status, _, err = run(
        "retarget", recordings, "--output", output, "--method", "joint_angle", "--workers", "0",
        "--operator", file, "--fingers", THREE, "--quiet",
    )  # fmt: skip
    assert status == 2
    assert "calibrate with the same --fingers" in err
    write_operator(file, calibrate(exact[:1500], load_hand(fingers=CHOSEN)).operator)
    status, _, err = run(
        "retarget", recordings, "--output", output, "--method", "joint_angle", "--workers", "0",
        "--operator", file, "--fingers", THREE, "--quiet",
    )  # fmt: skip
    assert status == 0, err

    def left(fingers: str | None, operator: Path | None) -> int:
        asked = make_request(method="joint_angle", fingers=fingers, operator=operator)
        return len(survey(recordings, output, asked).jobs)

    assert left(THREE, file) == 0
    assert left(None, None) == left(THREE, None) == 1
    assert left("thumb,index,ring", file) == 1  # the same human fingers, other robot ones
    content = json.loads(file.read_text(encoding="utf-8"))
    file.write_text(json.dumps(content | {"scale": content["scale"] * 1.01}), encoding="utf-8")
    assert left(THREE, file) == 1
    status, _, err = run("retarget", recordings, "--output", output, "--fingers", "thumb,toe")
    assert status == 2
    assert "unknown finger 'toe'" in err


def test_a_benchmark_measures_again_for_other_fingers_or_another_operator(tmp_path, run, found):
    glove, operator = save(tmp_path / "a.npz", 1.0), tmp_path / "operator.json"
    write_operator(operator, found.operator)

    def bench(*more: object) -> tuple[dict[str, object], bool]:
        status, _, err = run(
            "bench", f"{glove}@:24", "--methods", "joint_angle", "--output", tmp_path / "out",
            "--workers", "0", "--latency-frames", "0", "--no-report", *more,
        )  # fmt: skip
        assert status == 0, err
        (row,) = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
        return row, "need no measuring again" in err

    first, _ = bench()
    assert bench() == (first, True)
    row, again = bench("--operator", operator)
    assert not again
    assert row["operator"]["hand"] == "mimic_p050"
    row, again = bench("--fingers", THREE)
    assert not again
    assert list(row["fingers"]) == ["thumb", "index", "ring"]
    assert row["fingers_driven"] == CHOSEN
    assert bench("--fingers", THREE) == (row, True)
    assert not bench("--fingers", "thumb,index,ring")[1]


def test_the_demo_drives_some_fingers_and_says_so(tmp_path, run):
    status, _, err = run(
        "demo", "--no-view", "--duration", "0.2", "--method", "joint_angle", "--fingers", THREE,
        "--output", tmp_path / "demo", "--quiet",
    )  # fmt: skip
    assert status == 0, err
    config = json.loads((tmp_path / "demo" / "config.json").read_text(encoding="utf-8"))
    assert config["fingers"] == CHOSEN
    metrics = json.loads((tmp_path / "demo" / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["pinch_touch_share_per_finger"].keys() == {"index", "ring"}


def test_a_session_waits_while_no_hand_is_seen_and_labels_what_was_held():
    from smooth_operator.teleop.runtime.calibration_session import CalibrationSession
    from smooth_operator.teleop.sources.live import Arrival
    from smooth_operator.types import HandFrame

    asked = (Prompt("flat", "flat", 0.5, 1.0), Prompt("fist", "fist", 0.5, 1.0))
    session = CalibrationSession("right", asked)
    shape = np.arange(63.0).reshape(21, 3)
    phases, now = [], 10.0
    for step in range(1000):
        now += 0.01
        lost = 100 <= step < 200  # in the middle of the first pose
        if not lost and step > 20:
            session.see(Arrival(HandFrame(shape + step, stamp=0.0), now))
            session.see(Arrival(HandFrame(shape, stamp=0.0, side="left"), now))
        moment = session.at(now)
        if moment is None:
            break
        if not phases or phases[-1] != (moment.number, moment.phase):
            phases.append((moment.number, moment.phase))
    else:
        pytest.fail("it never ends")
    assert phases == [
        (0, "wait"), (0, "settle"), (0, "hold"), (0, "wait"), (0, "hold"),
        (1, "settle"), (1, "hold"),
    ]  # fmt: skip
    recording, segments = session.recording(), session.segments()
    assert [s.pose for s in segments] == ["flat", "fist"]
    held = [np.ptp(recording.stamps[s.start : s.stop]) for s in segments]
    assert held[1] == pytest.approx(1.0, abs=0.05)
    assert 0.95 < held[0] - 0.7 < 1.05  # 0.3 s of the second without a hand still count as seen


def test_calibrate_asks_a_live_operator(tmp_path, monkeypatch, capsys):
    from smooth_operator.cli import prompting

    monkeypatch.setattr(
        prompting, "prompts", lambda fingers: (Prompt("flat", "hold it flat", 0.2, 1.0),)
    )
    output = tmp_path / "operator.json"
    source = "synthetic:gestures=spread,seed=1"
    assert main(["calibrate", "--source", source, "--output", str(output)]) == 0
    assert "hold it flat" in capsys.readouterr().err
    assert 0.5 < read_operator(output).scale < 2
    assert main(["calibrate", "--output", str(output)]) == 2
    assert "--source" in capsys.readouterr().err
