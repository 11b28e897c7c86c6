"""Tests of the research distribution; the fixtures are those of the conftest.py above."""

from __future__ import annotations

import os
import sys
import tempfile
import tomllib
from importlib import metadata
from pathlib import Path

RESEARCH = Path(__file__).resolve().parents[1]


def _offer_commands() -> None:
    """Entry points of a checkout that is on Python's path but not installed."""
    project = tomllib.loads((RESEARCH / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    try:
        metadata.distribution(project["name"])
        return
    except metadata.PackageNotFoundError:
        pass
    home = Path(tempfile.mkdtemp(prefix="smooth-operator-research-"))
    folder = home / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    folder.mkdir()
    name, version = project["name"], project["version"]
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    groups = project["entry-points"].items()
    text = "".join(
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
        for group, points in groups
    )
    (folder / "entry_points.txt").write_text(text)
    paths = [str(RESEARCH / "src"), str(home)]
    sys.path += paths
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    os.environ["PYTHONPATH"] = os.pathsep.join([*filter(None, inherited), *paths])


_offer_commands()
