"""A search for clips among damaged files, files of robots and pipes; lists of recordings."""

import json
import os
import zipfile

import numpy as np
import pytest
from test_hostile_files import good
from test_recording import FRAMES, hand, robot_dataset, save

from smooth_hand_datasets.pipeline.sources import find_items, read_manifest
from smooth_operator import read_recording
from smooth_operator.errors import RecordingError


def test_the_data_of_a_robot_among_recordings_is_one_failure(tmp_path):
    robot_dataset(tmp_path / "in" / "set")
    save(tmp_path / "in" / "a.npz", {"joints": hand(), "stamps": np.arange(FRAMES) / 30.0})
    items = find_items([str(tmp_path / "in")])
    assert [item.name for item in items.items] == ["a"]
    assert [refused.name for refused in items.refused] == ["set"]
    assert items.passed_over == {}


def test_one_damaged_file_does_not_end_a_search(tmp_path):
    good(tmp_path)
    # NumPy hands such a header to tokenize, which raises an error of its own.
    with zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (12, 21, 3 ".ljust(117) + b"\n"
        archive.writestr("landmarks.npy", b"\x93NUMPY\x01\x00v\x00" + header + bytes(6048))
    found = find_items([str(tmp_path)], layout="files")
    assert [item.name for item in found.items] == ["bad", "good"]
    with pytest.raises(RecordingError, match="damaged or incomplete"):
        read_recording(tmp_path / "bad.npz")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_search_passes_over_pipes(tmp_path):
    os.mkfifo(tmp_path / "x.npz")
    good(tmp_path)
    found = find_items([str(tmp_path)], layout="files")
    assert [item.name for item in found.items] == ["good"]
    assert found.passed_over[".npz"] == 1


def test_a_line_of_a_manifest_is_not_quoted_at_length(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text(json.dumps({"path": "a.npz", "rate": "{a=" * 500 + "\x1b[2J"}))
    with pytest.raises(RecordingError, match="line") as caught:
        list(read_manifest(path))
    message = str(caught.value).removeprefix(str(tmp_path))
    assert len(message) < 250
    assert "\x1b" not in message
