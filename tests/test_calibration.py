"""Calibration: the gaps that a tracker leaves in pinches are found, kept in a file and used."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smooth_operator import SyntheticOperator, load_hand
from smooth_operator.calibration.estimate import Calibration, calibrate
from smooth_operator.calibration.operator_file import OperatorProfile, read_operator, write_operator
from smooth_operator.calibration.segments import PROMPTS, Prompt
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.hands.hand import knuckle_joints
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.planning import make_request, plan
from smooth_operator.retargeting.known_gaps import MEDIAPIPE
from smooth_operator.types import HandRecording, Side

THREE = "thumb,index,pinky=ring"
CHOSEN = {"thumb": "thumb", "index": "index", "pinky": "ring"}
KNOWN = OperatorProfile("right", {"index": 0.08, "ring": 0.05}, "here")


@pytest.fixture(scope="module")
def exact() -> HandRecording:
    """Every pinch twice, as no tracker sees it; tips meet within 2 mm where they pinch."""
    return SyntheticOperator(seed=2).record(36.0)


@pytest.fixture(scope="module")
def found(exact) -> Calibration:
    return calibrate(exact)


def kept_apart(recording: HandRecording, gap: float) -> HandRecording:
    """As a tracker sees it that keeps fingertips apart from the thumb [m]: d' = d + gap, less the
    further they are apart."""
    landmarks = recording.landmarks.copy()
    away = landmarks[:, TIPS[1:]] - landmarks[:, TIPS[:1]]
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    landmarks[:, TIPS[1:]] += away * gap / distance * np.clip(2 - distance / 0.02, 0, 1)
    return replace(recording, landmarks=landmarks)


def test_every_pinch_is_found_where_it_was_made(exact, found):
    made = np.array(exact.meta["gesture"])
    for finding in found.findings:
        assert finding.confidence > 0.3, finding.finger
        at = np.concatenate([made[s.start : s.stop] for s in finding.segments])
        assert (at == f"pinch_{finding.finger}").mean() > 0.9
    assert [finding.finger for finding in found.findings] == list(FINGERS[1:])


def test_the_gap_of_a_tracker_is_found_through_noise_and_outliers(exact, found):
    rng = np.random.default_rng(0)
    landmarks = kept_apart(exact, 0.01).landmarks + rng.normal(0, 0.0005, exact.landmarks.shape)
    landmarks[rng.random(len(landmarks)) < 0.05] = np.nan
    landmarks[rng.random(landmarks.shape[:2]) < 0.002] += 0.2
    noisy = calibrate(replace(exact, landmarks=landmarks, valid=None))
    assert noisy.features.good.mean() < 0.97
    palm = noisy.features.palm_length
    for finger, own in found.operator.pinch_gaps.items():
        assert noisy.operator.pinch_gaps[finger] * palm == pytest.approx(
            own * palm + 0.01, abs=0.002
        )


def test_a_finger_without_a_pinch_has_no_gap():
    recording = SyntheticOperator(seed=3, gestures=("pinch_index", "spread")).record(12.0)
    calibration = calibrate(recording)
    assert calibration.operator.pinch_gaps.keys() == {"index"}
    notes = {f.finger: f.note for f in calibration.findings}
    assert not notes["index"]
    assert all("no pinch was found" in notes[finger] for finger in FINGERS[2:])


def test_pinches_that_prompts_mark_calibrate_like_those_of_a_search(exact, found):
    segments = [replace(f.segments[0], confidence=1.0) for f in found.findings]
    calibration = calibrate(exact, segments)
    assert all(f.confidence == 1.0 for f in calibration.findings)
    assert calibration.operator.pinch_gaps == pytest.approx(found.operator.pinch_gaps, abs=0.02)
    assert sum(prompt.settle + prompt.hold for prompt in PROMPTS) < 30
    flat = replace(segments[0], start=0, stop=30)  # the hand is open, whatever was asked for
    opened = calibrate(exact, [flat])
    assert opened.operator.pinch_gaps == {}
    assert "this is not a pinch" in opened.findings[0].note
    valid = np.ones((len(exact), 21), bool)
    valid[5:, 7] = False
    with pytest.raises(RecordingError, match=r"5 of .* frames show a whole hand"):
        calibrate(replace(exact, valid=valid))


def test_the_wrong_side_is_noticed(exact, found):
    """A larger left hand has the same gaps, in lengths of its palm."""
    mirrored = replace(exact, landmarks=1.15 * exact.landmarks * np.array([-1.0, 1.0, 1.0]))
    with pytest.raises(RecordingError, match=r"this is a left hand.*use --side left"):
        calibrate(mirrored)
    other = calibrate(replace(mirrored, side="left")).operator
    assert other.side == "left"
    assert other.pinch_gaps == pytest.approx(found.operator.pinch_gaps, abs=0.003)


def test_an_operators_gaps_come_before_those_of_the_tracker(exact, tmp_path):
    write_operator(tmp_path / "operator.json", KNOWN)
    asked = make_request(operator=tmp_path / "operator.json", pinch_gaps="mediapipe")
    assert plan(exact, asked).pinch_gaps == {**MEDIAPIPE, **KNOWN.pinch_gaps}
    assert plan(exact, make_request()).pinch_gaps == {}
    assert plan(exact, make_request(operator=KNOWN, pinch_gaps="off")).pinch_gaps is None
    left = replace(KNOWN, side="left")
    with pytest.raises(ConfigError, match="is for the left hand"):
        plan(exact, make_request(operator=left))


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_file_brings_back_every_figure(side, tmp_path):
    mount = {side: (0.1, -0.02, 0.0, 0.6, 0.0, 0.8, 0.0)}
    for each in (replace(KNOWN, side=side, mounts=mount), OperatorProfile(side)):
        write_operator(tmp_path / "operator.json", each)
        assert read_operator(tmp_path / "operator.json") == each


def test_a_bad_file_says_what_is_wrong_with_it(tmp_path):
    path = tmp_path / "operator.json"
    with pytest.raises(ConfigError, match=r"no such file; expected the OPERATOR\.json"):
        read_operator(path)
    write_operator(path, KNOWN)
    good = json.loads(path.read_text(encoding="utf-8"))

    def refused(message: str, content: object) -> None:
        text = content if isinstance(content, str) else json.dumps(content)
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ConfigError, match=message):
            read_operator(path)

    refused("damaged, or not JSON", '{"format": ')
    refused("does not describe an operator", [1, 2])
    refused("does not describe an operator", {"program": "smooth-operator"})
    refused("format version 2,.*upgrade", good | {"version": 2})
    refused("source: is missing", {k: v for k, v in good.items() if k != "source"})
    refused(r"sourse: no such entry. Did you mean 'source'\?", good | {"sourse": "x"})
    refused("side must be", good | {"side": "both"})
    refused("pinch_gaps: expected a table", good | {"pinch_gaps": []})
    refused("index: expected a finite number, not 'big'", good | {"pinch_gaps": {"index": "big"}})
    refused("index finger must be 0 to 1 palm length", good | {"pinch_gaps": {"index": 24}})
    refused("finger that pinches 'toe'", good | {"pinch_gaps": {"toe": 0.1}})


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
    assert not knuckle_joints(load_hand("allegro_hand")).any()


def save(path: Path, seconds: float, side: Side = "right") -> Path:
    hand = SyntheticOperator(seed=2, side=side).record(seconds)
    np.savez(path, landmarks=hand.landmarks, timestamps=hand.stamps, side=side)
    return path


def test_calibrate_and_retarget(tmp_path, run):
    glove = save(tmp_path / "glove.npz", 12.0)
    out = tmp_path / "new" / "operator.json"
    status, text, err = run("calibrate", glove, "--output", out)
    assert status == 0, err
    assert "gap [mm]" in text
    assert (tmp_path / "new" / "operator.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    status, text, err = run(
        "calibrate", glove, "--output", out, "--json", "--quiet", "--frames", ":1000"
    )
    assert (status, err) == (0, "")
    figures = json.loads((tmp_path / "new" / "operator.report.json").read_text(encoding="utf-8"))
    assert figures == json.loads(text)
    index = figures["fingers"]["index"]
    assert index["pinch_gap_mm"]["median"] > 0
    assert index["segments"][0]["to_s"] > index["segments"][0]["from_s"]
    operator = read_operator(out)
    assert operator.pinch_gaps

    def known(name: str, *more: object) -> object:
        target = tmp_path / f"{name}.npz"
        arguments = ["--method", "joint_angle", "--frames", ":20", "--quiet", "--json", "--output"]
        status, _, err = run("retarget", glove, *arguments, target, *more)
        assert status == 0, err
        return json.loads(target.with_suffix(".json").read_text(encoding="utf-8"))["pinch_gaps"]

    assert known("plain") == {}
    assert known("own", "--operator", out) == operator.pinch_gaps
    assert known("off", "--operator", out, "--pinch-gaps", "off") is None


def test_some_fingers_are_driven_and_seen(tmp_path, run, monkeypatch):
    glove, pages = save(tmp_path / "glove.npz", 1.0), []
    commands = {}
    for name, more in {"plain": (), "three": ("--fingers", THREE)}.items():
        target = tmp_path / f"{name}.npz"
        arguments = ("--method", "joint_angle", "--frames", ":20", "--quiet", "--output", target)
        status, _, err = run("retarget", glove, *arguments, *more)
        assert status == 0, err
        config = json.loads(target.with_suffix(".json").read_text(encoding="utf-8"))
        assert config["fingers"] == (CHOSEN if more else None)
        commands[name] = np.asarray(np.load(target)["joint_positions"])
    hand = load_hand()
    still = [i for i, name in enumerate(hand.joint_names) if name.startswith(("middle", "ring"))]
    assert np.ptp(commands["three"][:, still], axis=0).max() == 0
    assert np.ptp(commands["plain"][:, still]) > 0
    monkeypatch.setattr("smooth_operator.teleop.pages.serve", lambda runs, **_: pages.extend(runs))
    for name in commands:
        assert run("view", tmp_path / f"{name}.npz", glove)[0] == 0
    assert [len(page.trace.fingers) for page in pages] == [5, 3]
    status, _, err = run("retarget", glove, "--fingers", "index", "--output", tmp_path / "x.npz")
    assert status == 2
    assert "the thumb must be among the fingers" in err


def test_what_calibrate_refuses(tmp_path, run):
    glove = save(tmp_path / "glove.npz", 1.0)
    mine = tmp_path / "mine.json"
    mine.write_text('{"thesis": 1}', encoding="utf-8")
    cases = {
        (glove, "--output", tmp_path / "operator.txt"): "the name must end in .json",
        (glove, "--output", mine): "is not a calibration",
        (glove, "--output", tmp_path / "o.json", "--frames", ":5"): "frames show a whole hand",
        ("--output", tmp_path / "o.json"): "--source",
    }
    for arguments, message in cases.items():
        status, out, err = run("calibrate", *arguments)
        assert (status, out) == (2, ""), err
        assert message in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["glove.npz", "mine.json"]


def test_a_session_waits_while_no_hand_is_seen_and_labels_what_was_held():
    from smooth_operator.teleop.runtime.calibration_session import CalibrationSession
    from smooth_operator.teleop.sources.live import Arrival
    from smooth_operator.types import HandFrame

    asked = (Prompt("index", "", 0.5, 1.0), Prompt("ring", "", 0.5, 1.0))
    session = CalibrationSession("right", asked)
    shape = np.arange(63.0).reshape(21, 3)
    phases, now = [], 10.0
    for step in range(1000):
        now += 0.01
        lost = 100 <= step < 200  # in the middle of the first pinch
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
    first = [(0, "wait"), (0, "settle"), (0, "hold"), (0, "wait"), (0, "hold")]
    assert phases == [*first, (1, "settle"), (1, "hold")]
    recording, segments = session.recording(), session.segments()
    assert [s.finger for s in segments] == ["index", "ring"]
    held = [np.ptp(recording.stamps[s.start : s.stop]) for s in segments]
    assert held[1] == pytest.approx(1.0, abs=0.05)
    assert 0.95 < held[0] - 0.7 < 1.05  # 0.3 s of the second without a hand still count as seen


def test_calibrate_asks_a_live_operator(tmp_path, monkeypatch, capsys):
    prompt = replace(PROMPTS[0], settle=0.2, hold=1.0)
    monkeypatch.setattr("smooth_operator.calibration.segments.PROMPTS", (prompt,))
    output = tmp_path / "operator.json"
    source = "synthetic:gestures=pinch_index,seed=1"
    assert main(["calibrate", "--source", source, "--output", str(output)]) == 0
    assert "thumb pad on index finger pad" in capsys.readouterr().err
    assert read_operator(output).pinch_gaps.keys() == {"index"}
