"""The LeRobot plug-ins as distributions: found by LeRobot by their names, all of one version."""

import json
import subprocess
import tomllib
from pathlib import Path

from lerobot_stand_in import CAMERA, ENVIRONMENT, PACKAGES, ROBOT, TELEOPERATOR
from plugin_environment import environment_with

MAIN = tomllib.loads((PACKAGES.parent / "pyproject.toml").read_text())["project"]


NAMES = (CAMERA, ENVIRONMENT, ROBOT, TELEOPERATOR)

ASK = f"""
import importlib.metadata, importlib.util, json, pathlib
for name in {NAMES!r}:
    found = [d for d in importlib.metadata.distributions() if d.metadata["Name"] == name]
    where = pathlib.Path(importlib.util.find_spec(name).origin).parent
    data = found[0].metadata
    needs = data.get_all("Requires-Dist")
    modules = len(list(where.glob("*.py")))
    print(json.dumps([len(found), str(where), data["Version"], needs, modules]))
"""


def test_plugins_are_installed_under_the_names_that_lerobot_looks_for(tmp_path):
    python = environment_with(tmp_path, *(PACKAGES / name for name in NAMES))
    done = subprocess.run([python, "-c", ASK], capture_output=True, encoding="utf-8", check=True)
    for name, line in zip(NAMES, done.stdout.splitlines(), strict=True):
        found, where, version, needs, modules = json.loads(line)
        assert found == 1
        assert Path(where).name == name
        assert Path(where).is_relative_to(tmp_path / "venv")
        assert version == MAIN["version"]
        assert ("gymnasium>=1.0" if name == ENVIRONMENT else "lerobot>=0.4.4") in needs
        ours = [need for need in needs if need.startswith(MAIN["name"])]
        assert ours
        assert all(f"~={version.rpartition('.')[0]}" in need for need in ours)
        assert modules == len(list((PACKAGES / name / name).glob("*.py")))
        licence = (PACKAGES / name / "LICENSE").read_text()
        assert licence == (PACKAGES.parent / "LICENSE").read_text()
