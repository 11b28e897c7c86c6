"""``smooth-operator sample``: a recording for whoever has none."""

from dataclasses import replace

import numpy as np
import pytest

from smooth_operator.cli import main
from smooth_operator.formats.readers import read_recording
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.tracker import tracker_model


@pytest.mark.parametrize("suffix", ["npz", "mcap"])
def test_the_file_holds_the_operator(tmp_path, suffix):
    path = tmp_path / "new" / f"hand.{suffix}"
    options = ["--seed", "7", "--side", "left", "--tracker", "camera", "--duration", "2"]
    assert main(["sample", str(path), *options, "--landmark-loss", "0.1"]) == 0
    tracker = replace(tracker_model("camera", 7), landmark_loss=0.1)
    expected = SyntheticOperator(seed=7, side="left", tracker=tracker).record(2.0)
    found = read_recording(path)
    assert found.side == "left"
    np.testing.assert_array_equal(found.landmarks, expected.landmarks)
    np.testing.assert_allclose(found.stamps, expected.stamps, atol=1e-9)


def test_what_can_be_mended_is_said(tmp_path, capsys):
    path = tmp_path / "hand.npz"
    arguments = ["sample", str(path), "--duration", "0.5"]
    assert main(arguments) == 0
    before = path.read_bytes()
    capsys.readouterr()
    assert main([*arguments, "--seed", "1"]) == 2
    assert "it exists; choose another name, or add --overwrite" in capsys.readouterr().err
    assert path.read_bytes() == before
    assert main([*arguments, "--seed", "1", "--overwrite"]) == 0
    assert path.read_bytes() != before
    assert main(["sample", str(tmp_path / "hand.txt")]) == 2
    assert "must end in .npz, .mcap, .h5 or .hdf5" in capsys.readouterr().err
    assert main(["sample", str(tmp_path / "none.npz"), "--duration", "0"]) == 2
    assert not (tmp_path / "none.npz").exists()
