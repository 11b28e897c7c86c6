"""Messages in the forms of other programs: objects, rows of 7, matrices, stamps, the wrist.

The encoders here are written from the formats alone and share no code with the readers.
"""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.io.landmark_order import chirality
from smooth_operator.landmarks import FROM_OPENXR_26
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.payload import Forms, PayloadReader, read_payload

HAND = next(SyntheticOperator(seed=2).frames())
POINTS = HAND.landmarks
QUATERNIONS = HAND.orientations
JOINTS = np.zeros((26, 3))
JOINTS[list(FROM_OPENXR_26)] = POINTS


def matrix(point: Any, q: Any, columns: bool = False) -> list[list[float]]:
    """The 4 x 4 matrix of a pose, by rows or by columns."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(np.roll(q, -1)).as_matrix()
    pose[:3, 3] = point
    return (pose.T if columns else pose).tolist()


def read(*, settings: Any = None, **said: Any) -> Any:
    message = json.dumps(said).encode()
    return read_payload(message, "right", Forms(**(settings or {})))[0].frame


def same_turns(a: Any, b: Any) -> bool:
    return bool((np.abs((np.asarray(a) * np.asarray(b)).sum(axis=1)) > 1 - 1e-9).all())


def test_objects_as_mediapipe_writes_them():
    rows: list[Any] = [
        {"x": x, "y": y, "z": z, "visibility": 0.0, "presence": 0.0} for x, y, z in POINTS.tolist()
    ]
    assert np.array_equal(read(landmarks=rows).landmarks, POINTS)
    rows[3], rows[8] = None, {"x": None, "y": 0.1, "z": 0.2}
    assert read(landmarks=rows).valid.tolist() == [k not in (3, 8) for k in range(21)]
    rows[5] = {"x": 1.0, "y": 2.0}
    with pytest.raises(RecordingError, match="objects with x, y and z"):
        read(landmarks=rows)


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_rows_of_seven_keep_their_orientations(order):
    def rows(points: np.ndarray, turns: np.ndarray) -> list[Any]:
        turns = np.roll(turns, -1, axis=1) if order == "xyzw" else turns
        return np.hstack([points, turns]).tolist()

    form = {"quaternion": order}
    landmarks = rows(POINTS, QUATERNIONS)
    frame = read(landmarks=landmarks, settings=form)
    assert np.array_equal(frame.landmarks, POINTS)
    np.testing.assert_allclose(frame.orientations, QUATERNIONS, atol=1e-12)
    landmarks[4] = None
    frame = read(joints=landmarks, settings=form)
    assert frame.valid.tolist() == [k != 4 for k in range(21)]
    assert np.isnan(frame.orientations[4]).all()
    turned = np.tile([1.0, 0.0, 0.0, 0.0], (26, 1))  # of 26, they are mapped, too
    turned[list(FROM_OPENXR_26)] = QUATERNIONS
    frame = read(joints=rows(JOINTS, turned), settings=form)
    np.testing.assert_allclose(frame.landmarks, POINTS)
    np.testing.assert_allclose(frame.orientations, QUATERNIONS, atol=1e-12)


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("columns", [False, True])
def test_matrices_say_by_themselves_how_they_are_written(columns, flat):
    rows: list[Any] = [matrix(p, q, columns) for p, q in zip(POINTS, QUATERNIONS, strict=True)]
    if flat:
        rows = [[v for row in each for v in row] for each in rows]
    said = "columns" if columns else "rows"
    for settings in ({}, {"matrix": said}):
        frame = read(landmarks=rows, settings=settings)
        np.testing.assert_allclose(frame.landmarks, POINTS, atol=1e-12)
        assert same_turns(frame.orientations, QUATERNIONS)
    with pytest.raises(
        RecordingError, match=r"matrix=columns\)" if not columns else r"matrix=rows"
    ):
        read(landmarks=rows, settings={"matrix": "rows" if columns else "columns"})
    rows[7] = None
    assert read(landmarks=rows).valid.tolist() == [k != 7 for k in range(21)]


def test_matrices_that_are_no_rigid_transforms_are_refused():
    good = np.array([matrix(p, q) for p, q in zip(POINTS, QUATERNIONS, strict=True)])
    projective, scaled, mirrored = good.copy(), good.copy(), good.copy()
    projective[2, 3] = [0.1, 0.0, 0.0, 1.0]
    scaled[2, 0] *= 1.1
    mirrored[:, 1] *= -1.0
    for rows, words in (
        (projective, "neither the last row nor the last column"),
        (scaled, "scaled or skewed"),
        (mirrored, "mirror image"),
    ):
        with pytest.raises(RecordingError, match=words):
            read(landmarks=rows.tolist())


@pytest.mark.parametrize(
    ("unit", "factor"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)]
)
def test_stamps_of_four_units(unit, factor):
    rows = POINTS.tolist()
    said = {"stamp_unit": unit}
    assert read(landmarks=rows, stamp=3 * factor, settings=said).stamp == 3.0
    # of Unix time in whole nanoseconds, nothing is lost but what float64 can't hold
    stamp = 1_732_613_438_765_715_200 * factor // 10**9
    found = read(landmarks=rows, timestamp=stamp, settings=said).stamp
    assert math.isclose(found, stamp / factor, abs_tol=3e-7)
    assert read(landmarks=rows, settings=said).stamp is None


def test_a_stamp_in_another_unit_names_the_setting():
    unix_ns = 1_732_613_438_765_715_200
    for stamp, unit in ((unix_ns, "ns"), (unix_ns // 10**3, "us"), (unix_ns // 10**6, "ms")):
        with pytest.raises(RecordingError, match=f"stamp_unit={unit}"):
            read(landmarks=POINTS.tolist(), stamp=stamp)
    with pytest.raises(RecordingError, match=r"in ms \(stamp_unit=ms\).*stamp_unit=us"):
        read(landmarks=POINTS.tolist(), stamp=unix_ns // 10**3, settings={"stamp_unit": "ms"})
    with pytest.raises(RecordingError, match="stamp_unit=s, ms, us or ns"):
        read(landmarks=POINTS.tolist(), stamp=1e300)


def refusals(unit: Any, stamp: Callable[[int], float]) -> list[str]:
    """Errors of a reader in 3 s at 40 Hz, with frames that arrive unevenly."""
    reader, refused = PayloadReader("right", Forms(stamp_unit=unit)), []
    for k in range(120):
        message = json.dumps({"stamp": stamp(k), "landmarks": POINTS.tolist()}).encode()
        try:
            reader.read(message, k / 40 + 0.03 * (k % 3 == 0))
        except RecordingError as error:
            refused.append(str(error))
    return refused


@pytest.mark.parametrize(
    ("declared", "sent"), [("s", 1e3), ("s", 1e6), ("ms", 1e9), ("ns", 1.0), ("us", 1e3)]
)
def test_stamps_in_another_unit_are_found_by_their_pace(declared, sent):
    """An uptime of an hour is a plausible stamp in any unit."""
    right = {1.0: "s", 1e3: "ms", 1e6: "us", 1e9: "ns"}[sent]
    refused = refusals(declared, lambda k: (3600.0 + k / 40) * sent)
    assert 60 < len(refused) < 90
    assert f"set stamp_unit={right}" in refused[-1]
    assert not refusals(right, lambda k: (3600.0 + k / 40) * sent)
    for speed in (0.01, 100.0):  # of a player, which is no other unit
        assert not refusals("s", lambda k, speed=speed: speed * k / 40)


def test_the_wrist_has_a_pose_in_a_named_world():
    rows = POINTS.tolist()
    frame = read(landmarks=rows, wrist=[1, 2, 3, 0, 0, 0, 2], world="table")
    assert frame.world == "table"
    np.testing.assert_allclose(frame.T_world_wrist, [1, 2, 3, 0, 0, 0, 1])
    frame = read(landmarks=rows, wrist=[1, 2, 3, 1, 0, 0, None])
    assert frame.world == "tracker"
    assert np.isnan(frame.T_world_wrist).all()
    frame = read(landmarks=rows, world="table")
    assert frame.T_world_wrist is None
    hands = [{"side": side, "landmarks": rows, "wrist": [0, 0, 0, 1, 0, 0, 0]} for side in "RL"]
    message = json.dumps({"hands": hands, "world": "map"}).encode()
    both = read_payload(message, None)
    assert [(r.frame.side, r.frame.world) for r in both] == [("right", "map"), ("left", "map")]
    with pytest.raises(RecordingError, match=r"'wrist' must have shape \(7,\)"):
        read(landmarks=rows, wrist=[1, 2, 3])


def test_sources_have_the_settings():
    source = build_source("udp:0,stamp_unit=ns,quaternion=xyzw,matrix=columns")
    rows = [[*p, *q[1:], q[0]] for p, q in zip(POINTS.tolist(), QUATERNIONS.tolist(), strict=True)]
    data = json.dumps({"stamp": 5_000_000_000, "landmarks": rows}).encode()
    (reading,) = source.reader()((data,), 0.0)
    assert reading.frame.stamp == 5.0
    np.testing.assert_allclose(reading.frame.orientations, QUATERNIONS, atol=1e-12)
    # the same hand as the plain landmarks, not its mirror image
    assert chirality(reading.frame.landmarks[None])[0] > 0
    with pytest.raises(ConfigError, match="s or ms or us or ns"):
        build_source("zmq:tcp://127.0.0.1:1,stamp_unit=min")
