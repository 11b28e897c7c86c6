"""Landmarks as CSV: Project Aria's table, written from its documentation, and plain tables."""

import csv
import itertools
from pathlib import Path

import fuzzing
import numpy as np
import pytest

from smooth_operator import read_recording
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import ReadingOptions
from smooth_operator.formats.readers import FILES
from smooth_operator.formats.registry import ARIA_CSV, LANDMARK_CSV, recognise
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import Side

COUNT = 40
HANDS: dict[Side, np.ndarray] = {
    "right": np.stack(
        [one.landmarks for one in itertools.islice(SyntheticOperator(seed=3).frames(), COUNT)]
    )
}
HANDS["left"] = HANDS["right"] * [1.0, -1.0, 1.0] + [0.1, 0.4, 0.2]
STAMPS = 5.0 + np.arange(COUNT) / 30.0

# "MPS Output - Hand Tracking": fingertips, wrist, then the joints of the fingers, last the palm
ARIA = (
    *("thumb_tip", "index_tip", "middle_tip", "ring_tip", "pinky_tip", "wrist"),
    *("thumb_mcp", "thumb_ip"),
    *(
        f"{f}_{joint}"
        for f in ("index", "middle", "ring", "pinky")
        for joint in ("mcp", "pip", "dip")
    ),
)


def aria_table(space: str = "", lost: dict[Side, int] | None = None) -> list[list[str]]:
    """Rows of a table with the header of the documentation; ``space`` is before some names."""
    header = ["tracking_timestamp_us"]
    sides: tuple[Side, ...] = ("left", "right")
    for side in sides:
        header.append(f"{side}_tracking_confidence")
        header += [f"t{axis}_{side}_landmark_{n}_device" for n in range(21) for axis in "xyz"]
    for side in sides:
        header += [f"{space}t{axis}_{side}_device_wrist" for axis in "xyz"]
        header += [f"{space}q{axis}_{side}_device_wrist" for axis in "xyzw"]
    rows = [header]
    for k in range(COUNT):
        row = [str(round(STAMPS[k] * 1e6))]
        for side in sides:
            points = HANDS[side][k]
            named = [points[LANDMARKS.index(name)] for name in ARIA]
            palm = points[[0, 5, 17]].mean(axis=0)
            if (lost or {}).get(side) == k:
                row += ["-1", *["0"] * 63]
            else:
                row += ["0.99", *(f"{v:.6f}" for point in (*named, palm) for v in point)]
        rows.append([*row, *["0"] * 14])
    return rows


def plain_table(sides: tuple[Side, ...] = (), stamped: bool = True) -> list[list[str]]:
    header = ["timestamp"] * stamped + ["side"] * bool(sides)
    rows = [[*header, *(f"{name}_{axis}" for name in LANDMARKS for axis in "xyz")]]
    for k in range(COUNT):
        for side in sides or ("right",):
            start = [f"{STAMPS[k]:.6f}"] * stamped + [side] * bool(sides)
            rows.append([*start, *(f"{v:.6f}" for v in HANDS[side][k].ravel())])
    return rows


def saved(folder: Path, rows: list[list[str]], name: str = "hand.csv") -> Path:
    path = folder / name
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    return path


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("space", ["", " "])
def test_aria_landmarks_in_the_order_of_the_project(tmp_path, side, space):
    path = saved(tmp_path, aria_table(space, {"left": 7}), "hand_tracking_results.csv")
    recording = read_recording(path, side=side)
    points = HANDS[side]
    exact = [k for k in range(21) if k != 1]
    seen = [k for k in range(COUNT) if (side, k) != ("left", 7)]
    np.testing.assert_allclose(
        recording.landmarks[seen][:, exact], points[seen][:, exact], atol=1e-6
    )
    cmc = np.linalg.norm(recording.landmarks[seen, 1] - points[seen, 1], axis=1)
    assert cmc.max() < 0.02  # it is estimated
    np.testing.assert_allclose(recording.stamps, STAMPS, atol=1e-6)
    assert recording.valid[seen].all()
    if side == "left":
        assert not recording.valid[7].any()


def test_an_aria_table_is_a_clip_of_both_hands(tmp_path):
    path = saved(tmp_path, aria_table())
    assert recognise(path, None) == ("aria_csv", ARIA_CSV)
    (ref,) = ARIA_CSV.clips(path)
    assert set(ARIA_CSV.read(ref, ReadingOptions()).hands) == {"right", "left"}
    with pytest.raises(RecordingError, match="both hands; choose one with --side"):
        read_recording(path)


def test_a_plain_table_of_one_hand(tmp_path):
    recording = read_recording(saved(tmp_path, plain_table()))
    np.testing.assert_allclose(recording.landmarks, HANDS["right"], atol=1e-6)
    np.testing.assert_allclose(recording.stamps, STAMPS, atol=1e-6)
    assert recording.meta["side_assumed"]
    assert recording.meta["format"] == "landmark_csv"
    path = saved(tmp_path, plain_table(stamped=False))
    with pytest.raises(RecordingError, match="--rate"):
        read_recording(path)
    assert read_recording(path, rate=50.0).rate_hz == pytest.approx(50.0)


def test_a_plain_table_of_both_hands(tmp_path):
    path = saved(tmp_path, plain_table(("right", "left")))
    (ref,) = LANDMARK_CSV.clips(path)
    clip = LANDMARK_CSV.read(ref, ReadingOptions())
    for side, hand in clip.hands.items():
        np.testing.assert_allclose(hand.landmarks, HANDS[side], atol=1e-6)
    left = read_recording(path, side="left")
    assert (left.side, len(left)) == ("left", COUNT)


def test_an_empty_cell_is_a_landmark_not_seen(tmp_path):
    rows = plain_table()
    rows[3][1 + 3 * 8] = ""
    rows[5][1 + 3 * 4] = "nan"
    recording = read_recording(saved(tmp_path, rows))
    assert recording.valid[2].tolist() == [k != 8 for k in range(21)]
    assert recording.valid[4].tolist() == [k != 4 for k in range(21)]


def changed(rows: list[list[str]], row: int, column: int, text: str) -> list[list[str]]:
    rows[row][column] = text
    return rows


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (changed(plain_table(), 0, 5, "other"), "no column thumb_cmc_y; it has timestamp, wrist_x"),
        (changed(plain_table(), 4, 9, "x1"), "row 5, column .*: 'x1' is not a number"),
        (changed(plain_table(), 0, 5, "wrist_x"), "occurs twice in the header"),
        (changed(plain_table(("left",)), 2, 1, "both"), "side must be 'right' or 'left'"),
        ([*plain_table(), ["1", "2"]], "row 42 has 2 cells, but the header has 64"),
        (plain_table()[:1], "no rows"),
        (changed(aria_table(), 0, 3, "x"), "no column ty_left_landmark_0_device"),
        ([aria_table()[0]], "no hand with a confidence above 0"),
        (
            [aria_table()[0], *([row[0], *["0"] * 142] for row in aria_table()[1:])],
            "no hand with a confidence above 0",
        ),
    ],
)
def test_a_damaged_table_says_what_is_wrong(tmp_path, rows, words):
    with pytest.raises(RecordingError, match=words):
        read_recording(saved(tmp_path, rows), side="left")


def test_coordinates_in_millimetres_are_refused_with_the_factor(tmp_path):
    rows = plain_table()
    for row in rows[1:]:
        row[1:] = [str(1000.0 * float(text)) for text in row[1:]]
    with pytest.raises(RecordingError, match=r"millimetres .*0\.001"):
        read_recording(saved(tmp_path, rows))


def test_a_table_of_other_data_in_a_folder_is_no_recording(tmp_path):
    assert FILES.matches(saved(tmp_path, plain_table()))
    other = tmp_path / "closed_loop_trajectory.csv"
    other.write_text("graph_uid,tracking_timestamp_us,tx_world_device\n1,2,3\n")
    assert not FILES.matches(other)


def test_damaged_files_raise_only_errors_of_this_program(tmp_path):
    for good in (plain_table()[:4], aria_table()[:4]):
        mutants = fuzzing.damaged_bytes(saved(tmp_path, good).read_bytes())
        refused, _ = fuzzing.outcomes(mutants, 40, fuzzing.recording_at(tmp_path / "hand.csv"))
        assert len(refused) > 5
