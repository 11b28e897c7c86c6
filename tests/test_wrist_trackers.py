"""A tracker on a glove: its place on the hand is found, kept and used for the wrist."""

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from ticks import KeptTicks

from smooth_operator import poses
from smooth_operator.calibration import mount as mounts
from smooth_operator.calibration.mount import find_mount
from smooth_operator.calibration.operator_file import (
    OperatorProfile,
    read_operator,
    write_operator,
)
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.teleop import TeleopRequest, teleoperate
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.combined import WRIST_AGE_S, CombinedSource
from smooth_operator.teleop.sources.live import Mailbox, Running, ThreadedSource
from smooth_operator.teleop.sources.payload import pose_frame, read_payload
from smooth_operator.types import HandFrame, Side

# 4 cm behind the tracker and 3 cm under it; the tracker is turned on the back of the hand
MOUNT = np.array([-0.04, 0.01, -0.03, *poses.from_rotation_vectors(np.array([0.2, -0.1, 2.0]))])
WHERE = {"right": tuple(MOUNT), "left": (0.0, 0.05, 0.0, 1.0, 0.0, 0.0, 0.0)}


def tracker(wrists: np.ndarray, noise: float = 0.0) -> np.ndarray:
    """Poses of the tracker for poses of the wrist, with noise [m] and half a degree."""
    seen = poses.compose(wrists, np.broadcast_to(poses.invert(MOUNT), wrists.shape))
    rng = np.random.default_rng(0)
    seen[:, :3] += noise * rng.standard_normal((len(seen), 3))
    turns = 9 * noise * rng.standard_normal((len(seen), 3))
    seen[:, 3:] = poses.multiply(seen[:, 3:], poses.from_rotation_vectors(turns))
    return seen


def turning(count: int = 600, flexion: float = 0.7, deviation: float = 0.35) -> np.ndarray:
    """The wrist stays, and the hand circles; the forearm points to the front left."""
    t = np.linspace(0, 12 * np.pi, count)
    turns = np.stack([0 * t, flexion * np.sin(t), deviation * np.cos(t)], axis=1)
    forearm = poses.from_rotation_vectors(np.array([0.1, -0.5, 0.7]))
    turned = poses.multiply(
        np.broadcast_to(forearm, (count, 4)), poses.from_rotation_vectors(turns)
    )
    return np.concatenate([np.broadcast_to([0.3, -0.2, 1.1], (count, 3)), turned], axis=1)


def sliding(way: float = 0.3, count: int = 200, heading: float = 2.5) -> np.ndarray:
    """The flat hand moves in the direction of its fingers."""
    ahead = np.clip(np.linspace(-0.2, 1.2, count), 0, 1)[:, None] * way
    place = [0.1, 0.4, 0.75] + ahead * [np.cos(heading), np.sin(heading), 0]
    turn = poses.from_rotation_vectors(np.array([0, 0, heading]))
    return np.concatenate([place, np.broadcast_to(turn, (count, 4))], axis=1)


def test_the_place_of_a_tracker_is_found():
    exact = find_mount(tracker(turning()), tracker(sliding()))
    assert (poses.separation(exact.T_tracker_wrist, MOUNT) < 1e-9).all()
    assert exact.residual < 1e-9
    assert exact.slide == pytest.approx(0.3, rel=0.01)
    seen = tracker(turning(), 0.001)
    seen[100:110, :3] += 0.2  # a reflection
    seen[200] = np.nan
    noisy = find_mount(seen, tracker(sliding(), 0.001))
    distance, angle = poses.separation(noisy.T_tracker_wrist, MOUNT)
    assert distance < 0.002
    assert angle < np.deg2rad(1.0)
    assert noisy.residual == pytest.approx(0.001 * np.sqrt(3), rel=0.3)
    assert noisy.tilt == pytest.approx(0.009 * np.sqrt(3), rel=0.2)


def test_the_place_is_found_for_a_wrist_with_two_axes_and_an_imprecise_slide():
    """Axes up to 8 mm apart, a forearm that moves by 3 mm, a slide 3° off, a tilted palm."""
    rng, errors = np.random.default_rng(1), []
    for _ in range(40):
        t = np.linspace(0, 2 * np.pi * rng.uniform(6, 12), 600)
        flexion, deviation = rng.uniform(0.5, 0.9), rng.uniform(0.3, 0.45)
        first = poses.from_rotation_vectors(np.outer(flexion * np.sin(t), [0, 1, 0]))
        second = poses.from_rotation_vectors(np.outer(deviation * np.cos(t), [0, 0, 1]))
        drift = 0.003 * np.sin(0.3 * t[:, None] + rng.uniform(0, 6, 3))
        centre = poses.rotate(first, np.tile([rng.uniform(0, 0.008), 0, 0], (600, 1))) + drift
        slide = sliding(heading=np.radians(rng.normal(0, 3)))
        slide[:, 3:] = poses.from_rotation_vectors(np.radians([*rng.normal(0, 2, 2), 0]))
        wrists = np.concatenate([centre, poses.multiply(first, second)], axis=1)
        found = find_mount(tracker(wrists, 0.001), tracker(slide, 0.001))
        errors.append(poses.separation(found.T_tracker_wrist, MOUNT))
    distance, angle = np.median(errors, axis=0)
    assert distance < 0.004
    assert np.degrees(angle) < 4.5


def test_motions_that_do_not_tell_the_place_are_refused():
    swinging, tilted, bent = turning(), sliding(), sliding()
    swinging[:, 0] += 0.03 * np.sin(np.linspace(0, 50, len(swinging)))
    tilted[:, 3:] = turning(len(tilted))[:, 3:]
    bent[:, 2] += np.linspace(0, 0.1, len(bent))
    good = tracker(turning()), tracker(sliding())
    cases = (
        (good[0][:20], good[1], "20 poses arrived from the tracker while the hand turned"),
        (good[0], good[1][:0], "0 poses arrived from the tracker while the hand slid"),
        (tracker(turning(deviation=0.05)), good[1], "turned too little about one of its axes"),
        (tracker(swinging), good[1], r"the wrist moved by 2\d mm .* at most 10 mm"),
        (good[0], tracker(sliding(0.1)), "the hand slid by 10 cm; at least 15 cm"),
        (good[0], tracker(tilted), "while it slid, but at most 8° are accepted"),
        (good[0], tracker(bent), r"deviated from a straight, level line by 3\d % of its length"),
    )
    for turns, slides, message in cases:
        with pytest.raises(RecordingError, match=message):
            find_mount(turns, slides)


@dataclass(frozen=True)
class Tracker(ThreadedSource):
    """Gives the poses of both motions, one after the other, on both hands."""

    label = "a tracker"
    turn_s: float = 0.4
    side: Side = "right"

    def run(self, running: Running) -> None:
        turns, slides = tracker(turning(200)), tracker(sliding(count=200))
        begin = running.mailbox.clock()
        while not running.stopping.wait(0.002):
            share = (running.mailbox.clock() - begin) / self.turn_s
            row = int(200 * (share if share < 1 else (share - 1) / 1.5))
            pose = turns[row] if share < 1 else slides[min(row, 199)]
            running.mailbox.post(pose_frame(pose, None, self.side, "stage"))


def test_the_command_asks_for_the_motions_and_adds_the_place(tmp_path, monkeypatch, capsys):
    turn, slide = mounts.PROMPTS
    steps = replace(turn, settle=0.1, hold=0.2), replace(slide, settle=0.2, hold=0.3)
    monkeypatch.setattr(mounts, "PROMPTS", steps)
    monkeypatch.setattr(mounts, "MIN_FRAMES", 10)
    monkeypatch.setattr(mounts, "SLIDE", 0.05)
    output = tmp_path / "anna.json"
    write_operator(output, OperatorProfile("right", {"index": 0.1}, "x", {"left": WHERE["left"]}))
    command = ["calibrate", "--wrist-source", f"{__name__}:Tracker", "--output", str(output)]
    assert main([*command, "--json"]) == 0
    out, err = capsys.readouterr()
    assert "move the hand in wide circles" in err
    assert json.loads(out)["residual_mm"] < 1.0
    found = read_operator(output)
    assert (found.pinch_gaps, found.mounts["left"]) == ({"index": 0.1}, WHERE["left"])
    distance, angle = poses.separation(np.array(found.mounts["right"]), MOUNT)
    assert distance < 1e-3
    assert angle < 1e-2
    assert main([*command, "--source", "synthetic"]) == 2
    assert "can't be combined with" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="mount of the left hand must be x y z and a unit quat"):
        OperatorProfile("right", mounts={"left": (0.0,) * 7})


class Posting:
    """A source that posts what a test gives it."""

    def __init__(self, label: str) -> None:
        self.label, self.running = label, False

    def prepare(self) -> None: ...

    def start(self, mailbox: Mailbox) -> None:
        self.post, self.running = mailbox.post, True

    def stop(self) -> None:
        self.running = False

    def health(self) -> Any:
        return build_source("synthetic").health()


def test_the_wrist_comes_from_the_tracker_while_it_is_fresh():
    hands, wrist = Posting("glove"), Posting("tracker")
    source, mailbox = CombinedSource(hands, wrist, {"right": tuple(MOUNT)}), Mailbox()
    source.start(mailbox)
    own = np.array([9.0, 9, 9, 1, 0, 0, 0])
    hand = HandFrame(np.ones((21, 3)), 5.0, T_world_wrist=own, world="glove")

    def seen(frame: HandFrame, at: float) -> HandFrame:
        hands.post(frame, received=at)
        arrival = mailbox.take(frame.side)
        assert arrival is not None
        return arrival.frame

    assert seen(hand, 1.0).T_world_wrist is None
    place = turning(1)[0]
    wrist.post(pose_frame(tracker(place[None])[0], None, "right", "stage"), received=2.0)
    frame = seen(hand, 2.0 + WRIST_AGE_S / 2)
    np.testing.assert_allclose(frame.T_world_wrist, place, atol=1e-12)
    assert (frame.world, frame.stamp) == ("stage", 5.0)
    assert np.isnan(seen(hand, 2.0 + 2 * WRIST_AGE_S).T_world_wrist).all()
    wrist.post(pose_frame(place, None, "left", "stage"), received=3.0)
    left = seen(replace(hand, side="left"), 3.0)
    np.testing.assert_array_equal(left.T_world_wrist, place)  # it has no mount
    assert source.label == "glove with the wrist from tracker"
    assert source.health().state == "waiting"
    source.stop()
    assert [hands.running, wrist.running] == [False, False]
    with pytest.raises(AttributeError):
        CombinedSource(object(), wrist, {}).start(mailbox)
    assert not wrist.running


def test_a_message_may_be_the_pose_of_a_tracker():
    message = {"side": "left", "stamp": 2.5, "wrist": [1, 2, 3, 1, 0, 0, 0], "world": "room"}
    (reading,) = read_payload(json.dumps(message).encode(), None)
    frame = reading.frame
    assert (frame.side, frame.stamp, frame.world, frame.valid.any()) == ("left", 2.5, "room", False)
    assert frame.T_world_wrist.tolist() == message["wrist"]


def test_a_run_uses_the_places_of_both_hands_and_the_gaps_of_one(tmp_path, caplog):
    caplog.set_level("INFO", "smooth_operator.teleop")
    file, kept = tmp_path / "anna.json", KeptTicks()
    write_operator(file, OperatorProfile("right", {"index": 0.1}, mounts={"right": tuple(MOUNT)}))
    request = TeleopRequest(
        side="both",
        method="joint_angle",
        operator=file,
        wrist_source=f"{__name__}:Tracker,turn_s=60",
        duration=0.5,
    )
    teleoperate(request, sinks=[kept])
    assert kept.config["pinch_gaps"] == {"right": {"index": 0.1}, "left": {}}
    assert kept.config["source"].mounts == {"right": tuple(MOUNT)}
    frames = [tick.arrival.frame for tick in kept.ticks if tick.arrival is not None]
    placed = [f for f in frames if f.side == "right" and poses.is_valid(f.T_world_wrist)]
    assert placed
    np.testing.assert_allclose(placed[0].T_world_wrist[:3], [0.3, -0.2, 1.1], atol=1e-9)
    assert {f.T_world_wrist is None for f in frames if f.side == "left"} == {True}
    said = [record.message for record in caplog.records]
    assert [text for text in said if "used as the pose of the left wrist" in text]
    assert not [text for text in said if "used as the pose of the right wrist" in text]
