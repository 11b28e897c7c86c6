"""A log holds what Foxglove's 3D panel draws, in its own schemas, read here by the libraries of
MCAP and of Protocol Buffers."""

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from protobuf_log import decoded, message_class, plain
from ticks import make_tick, record

from smooth_operator import SyntheticOperator, load_hand
from smooth_operator.landmarks import BONES, LANDMARKS
from smooth_operator.teleop.recording import LogWriter, read_log
from smooth_operator.teleop.recording.messages import landmark_keypoints
from smooth_operator.types import JointCommand, Status

REQUIRED = """
foxglove.SceneUpdate: deletions entities
foxglove.SceneEntity: timestamp frame_id id lifetime frame_locked metadata
foxglove.SceneEntity: arrows cubes spheres cylinders lines triangles texts models
foxglove.LinePrimitive: type pose thickness scale_invariant points color colors indices
foxglove.FrameTransforms: transforms
foxglove.FrameTransform: timestamp parent_frame_id child_frame_id translation rotation
foxglove.JointStates: timestamp joints
foxglove.JointState: name position velocity acceleration effort
foxglove.Pose: position orientation
foxglove.Quaternion: x y z w
foxglove.Vector3: x y z
foxglove.Point3: x y z
foxglove.Color: r g b a
"""
"""Fields of Foxglove's published messages."""
TOPICS = {
    "/foxglove/hand": "foxglove.SceneUpdate",
    "/foxglove/robot": "foxglove.SceneUpdate",
    "/foxglove/joints": "foxglove.JointStates",
    "/foxglove/frames": "foxglove.FrameTransforms",
}


def messages(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """(log time, message) of Foxglove's topics, each decoded by the schema in the file."""
    found: dict[str, list[tuple[int, dict[str, Any]]]] = defaultdict(list)
    for topic, message, content in decoded(path, TOPICS, in_order=False):
        assert content.DESCRIPTOR.full_name == TOPICS[topic]
        found[topic].append((message.log_time, plain(content)))
    return found


def types(message: Any, found: dict[str, Any]) -> dict[str, Any]:
    """A type and those of its parts, by name."""
    if message.full_name not in found:
        found[message.full_name] = message
        for field in message.fields:
            if field.message_type is not None:
                types(field.message_type, found)
    return found


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    """Two seconds at 100 Hz."""
    path, hand = tmp_path_factory.mktemp("log") / "a.mcap", load_hand("mimic_p050")
    ticks = []
    for k, frame in enumerate(SyntheticOperator(seed=1, rate_hz=100).record(2.0)):
        tick = make_tick(hand, k, at=5.0 + 0.01 * k)
        landmarks = frame.landmarks + np.array([3.0, 1.0, 0.0])  # somewhere in the room
        landmarks[8] = np.nan if k % 2 else landmarks[8]
        shown = replace(frame, landmarks=landmarks, valid=None)
        ticks.append(replace(tick, arrival=replace(tick.arrival, frame=shown)))
    record(path, hand, ticks)
    return path


def test_schemas_are_foxgloves(session):
    with session.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    found: dict[str, Any] = {}
    for schema in summary.schemas.values():
        if schema.name.startswith("foxglove."):
            types(message_class(schema).DESCRIPTOR, found)
    required: dict[str, set[str]] = defaultdict(set)
    for line in REQUIRED.split("\n")[1:-1]:
        name, _, fields = line.partition(": ")
        required[name] |= set(fields.split())
    for name, fields in required.items():
        assert {field.name for field in found[name].fields} == fields, name
    state = found["foxglove.JointState"].fields
    assert {f.name for f in state if f.has_presence} == required["foxglove.JointState"] - {"name"}
    line = found["foxglove.LinePrimitive"].fields_by_name
    assert line["type"].enum_type.values_by_name["LINE_LIST"].number == 2
    assert line["indices"].type == line["indices"].TYPE_FIXED32
    assert found["foxglove.SceneEntity"].fields_by_name["timestamp"].message_type.full_name == (
        "google.protobuf.Timestamp"
    )


def test_a_session_is_drawn_at_a_bounded_rate(session):
    found = messages(session)
    assert set(found) == set(TOPICS)
    for topic, content in found.items():
        assert 50 <= len(content) <= 62, topic  # 2 s
    log = read_log(session)
    assert len(log.commands) == len(log.recording) == 200  # and its readers read what they did


def test_the_scene_shows_hand_and_robot_side_by_side(session):
    found, log, hand = messages(session), read_log(session), load_hand("mimic_p050")
    place = found["/foxglove/frames"][0][1]["transforms"][0]
    assert (place["parent_frame_id"], place["child_frame_id"]) == ("robot", "tracker")
    (first,) = found["/foxglove/hand"][0][1]["entities"]
    wrist = xyz(first["lines"][0]["points"])[0] + xyz([place["translation"]])[0]
    np.testing.assert_allclose(wrist, [0.25, 0.0, 0.0], atol=1e-5)
    times = {round(stamp * 1e9): k for k, stamp in enumerate(log.recording.stamps)}
    for at, message in found["/foxglove/hand"]:
        (entity,) = message["entities"]
        assert entity["frame_id"] == "tracker"
        assert entity["timestamp"]["seconds"] * 10**9 + entity["timestamp"]["nanos"] == at
        (lines,) = entity["lines"]
        assert lines["type"] == 2
        assert lines["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        assert lines["color"] == {"r": 0.9, "g": 0.6, "b": 0.35, "a": 1.0}
        frame = log.recording[times[at]]
        ends = xyz(lines["points"])[lines["indices"]].reshape(-1, 2, 3)
        bones = [b for b in BONES if frame.valid[list(b)].all()]
        np.testing.assert_allclose(ends, frame.landmarks[np.array(bones)], atol=1e-6)
    commands = {round(stamp * 1e9): k for k, stamp in enumerate(log.commands.stamps)}
    for (at, message), (_, joints) in zip(
        found["/foxglove/robot"], found["/foxglove/joints"], strict=True
    ):
        q = log.commands.joint_positions[commands[at]]
        assert [j["name"] for j in joints["joints"]] == list(hand.joint_names)
        np.testing.assert_array_equal([j["position"] for j in joints["joints"]], q)
        (lines,) = message["entities"][0]["lines"]
        tip = hand.tree.positions(q)[hand.tree.names.index(LANDMARKS[8])]
        assert np.abs(xyz(lines["points"]) - tip).max(axis=1).min() < 1e-6


@pytest.mark.parametrize(("name", "side"), [("mimic_p050", "left"), ("allegro_hand", "right")])
def test_the_drawn_landmarks_are_those_of_the_kinematics(name, side):
    hand = load_hand(name, side)
    low, high = hand.joint_limits.T
    q = np.random.default_rng(3).uniform(low, high, (5, len(low)))
    found = landmark_keypoints(hand)(q)
    named = [k for k, landmark in enumerate(LANDMARKS) if landmark in hand.tree.names]
    columns = [hand.tree.names.index(LANDMARKS[k]) for k in named]
    np.testing.assert_allclose(found[:, named], hand.tree.positions(q)[:, columns], atol=1e-12)
    assert np.isnan(np.delete(found, named, axis=1)).all()


def test_a_robot_that_can_not_be_drawn_costs_no_command(tmp_path):
    def broken(positions: np.ndarray) -> np.ndarray:
        raise ValueError("another hand")

    log = LogWriter(tmp_path / "a.mcap", keypoints=broken)
    with pytest.raises(ValueError, match="another hand"):
        log.write_command(JointCommand(np.zeros(1), ("a",), 1.0), Status.OK, 1.0)
    log.close()
    commands = read_log(tmp_path / "a.mcap").commands
    assert len(commands) == 1


def test_stamps_that_go_back_and_unknown_joints_are_no_obstacle(tmp_path):
    path = tmp_path / "b.mcap"
    with LogWriter(path) as log:
        for stamp in (-3.0, 100.0, 100.001, 1.0, 1.001, 1.05):
            positions = np.array([0.1, np.nan])
            log.write_command(JointCommand(positions, ("a", "b"), stamp), Status.OK, 1.0)
    found = messages(path)
    assert set(found) == {"/foxglove/joints"}  # no hand came, and where the robot is nobody knows
    assert [at for at, _ in found["/foxglove/joints"]] == [0, 10**11, 10**9, 1_050_000_000]
    assert found["/foxglove/joints"][0][1]["joints"] == [
        {"name": "a", "position": 0.1},
        {"name": "b"},
    ]


def xyz(points: list[dict[str, float]]) -> np.ndarray:
    """Points as an array (k, 3)."""
    return np.array([[p["x"], p["y"], p["z"]] for p in points])
