"""What ``smooth-operator doctor`` reports and advises."""

import json

from smooth_operator.cli import doctor, main


def test_the_machine_and_the_advice(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path))
    assert main(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["environment"]["programs"] == str(tmp_path / "programs")
    assert report["environment"]["cores"] >= 1
    assert "jax" in report["environment"]
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", "off")
    assert main(["doctor"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "SMOOTH_OPERATOR_CACHE is off, so every start compiles them again" in text


def test_two_opencvs_in_one_folder_are_named(capsys, monkeypatch):
    versions = {"opencv-contrib-python": "5.1.0.95", "opencv-python-headless": "4.13.0.92"}
    monkeypatch.setattr(doctor, "_version", versions.get)
    assert main(["doctor", "--json"]) == 0
    advice = json.loads(capsys.readouterr().out)["advice"]
    both = "opencv-python-headless 4.13.0.92, opencv-contrib-python 5.1.0.95"
    assert any(line.startswith(f"{both} are installed in one folder") for line in advice)
    del versions["opencv-python-headless"]
    assert main(["doctor", "--json"]) == 0
    assert "one folder" not in capsys.readouterr().out
