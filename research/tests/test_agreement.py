"""The default method on real recordings: runs that see the same last second agree; leaps."""

from pathlib import Path

import pytest

from smooth_operator import Retargeter, assemble_trace, evaluate, load_hand
from smooth_operator_benchmark.recordings import load_sources, parse_request

LEAST = {"mimic_p050": 0.83}
"""Hand -> share of frames in which two runs agree, a second after a fault; .75 for others. The
goal of .97 holds for the recordings of other trackers, not for this one, whose lowest share is .849
(20 frames of the other hand)."""


@pytest.mark.weekly
@pytest.mark.parametrize(
    "name",
    ["mimic_p050", "shadow_hand", "orca_v2", "allegro_hand", "leap_hand", "wuji_hand"],
)
def test_fast_fists_of_a_camera(name, shared, monkeypatch):
    """Fists that close within four frames, seen by a tracker with 4 mm of noise."""
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "benchmarks"))
    import looks

    recording = shared / "recordings" / "wilor_workspace_21x3.npz"
    source = load_sources([parse_request(f"{recording}@30hz,camera,1100:1700")])[0]
    for fault, (_, share) in looks.fault_rows("smooth", name, source.recording).items():
        assert fault == "begins later" or share >= LEAST.get(name, 0.75), fault


def test_the_fingers_of_leap_do_not_leap(shared):
    """A glove's quick fists. Without a cost of spread a bent finger drifts sideways to the end of a
    range of 1.05 rad, and one frame in twenty has a leap of more than 12 mm where it opens."""
    recording = shared / "recordings" / "manus_right_subject-000_run-010.npz"
    (source,) = load_sources([parse_request(f"{recording}@1300:1900")])
    hand = load_hand("leap_hand")
    commands, _ = Retargeter(hand).run(source.recording)
    figures = evaluate(assemble_trace(source.recording, commands, hand, reach_samples=0))
    assert figures["jumps_per_1000"] <= 8  # four frames of 600; none with a spread weight of 3
