"""What ``smooth-operator doctor`` finds, measures and advises."""

import json

import pytest

from smooth_operator.cli import doctor, main
from smooth_operator.compilation import diagnosis
from smooth_operator.compilation.diagnosis import StartTimes, start_times

WORDS = ("doctor", "--method", "joint_angle", "--frames", "12", "--quiet")


@pytest.fixture
def quick(monkeypatch) -> list[tuple[object, ...]]:
    """No processes: starts as if measured, of 5 s; what was asked for."""
    asked: list[tuple[object, ...]] = []

    def start(*chosen: object) -> StartTimes:
        asked.append(chosen)
        return StartTimes(0.1, 0.4, 0.2, 0.3, 4.0, 5.0)

    monkeypatch.setattr(doctor, "start_times", start)
    return asked


def test_what_was_found_and_measured(quick, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path))
    assert main([*WORDS, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert quick == 2 * [("mimic_p050", None, "joint_angle", None)]
    assert found["environment"]["programs"] == str(tmp_path / "programs")
    assert found["environment"]["cores"] >= 1
    assert [start["total"] for start in found["starts"]] == [5.0, 5.0]
    assert found["frames"]["count"] == 12
    assert 0 < found["frames"]["p50_ms"] <= found["frames"]["p99_ms"]
    assert any("did not find the program" in line for line in found["advice"])
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", "off")
    assert main(WORDS) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "first frame 4.00 4.00" in said
    assert "SMOOTH_OPERATOR_CACHE is off, so each start compiles" in said


def test_two_opencvs_in_one_folder_are_named(quick, capsys, monkeypatch):
    versions = {"opencv-contrib-python": "5.1.0.95", "opencv-python-headless": "4.13.0.92"}
    monkeypatch.setattr(diagnosis, "_version", versions.get)
    assert main([*WORDS, "--json"]) == 0
    advice = json.loads(capsys.readouterr().out)["advice"]
    both = "opencv-python-headless 4.13.0.92, opencv-contrib-python 5.1.0.95"
    assert any(line.startswith(f"{both} are in one folder") for line in advice)
    del versions["opencv-python-headless"]
    assert main([*WORDS, "--json"]) == 0
    assert "one folder" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--frames", "9"), "--frames must be at least 10, not 9"),
        (("--hand", "no_such_hand"), "no_such_hand"),
        (("--method", "smooth", "--preset", "offline"), "looks at the whole recording"),
    ],
)
def test_a_mistake_is_one_sentence(quick, capsys, words, expected):
    assert main(["doctor", *words]) == 2
    assert expected in " ".join(capsys.readouterr().err.split())
    assert not quick


def test_a_fresh_process_is_timed():
    times = start_times("mimic_p050", "left", "joint_angle", None)
    parts = [times.interpreter, times.import_jax, times.import_package, times.build]
    assert min(parts) > 0
    assert times.total == pytest.approx(sum(parts) + times.first_frame)
