"""The README of a dataset: what a person, and the dataset hub, should know of it."""

from __future__ import annotations

from typing import Any, Final

from smooth_operator.episode_files.lerobot.columns import UNITS

# The head is what the hub reads to show the frames as a table.
_HEAD: Final = """---
tags:
- LeRobot
task_categories:
- robotics
configs:
- config_name: default
  data_files: data/*/*.parquet
---

# Human hands and robot commands

A LeRobot dataset ({version}), written by smooth-operator: {episodes} episodes, {frames} frames,
{fps} frames a second.

| column | type | unit, meaning |
|---|---|---|
"""


def dataset_card(info: dict[str, Any]) -> str:
    """The text, from ``meta/info.json``."""
    head = _HEAD.format(
        version=info["codebase_version"],
        episodes=info["total_episodes"],
        frames=info["total_frames"],
        fps=info["fps"],
    )
    lines = []
    for name, feature in info["features"].items():
        kind = feature["dtype"] + ("" if feature["names"] is None else f" × {feature['shape'][0]}")
        lines.append(f"| `{name}` | {kind} | {UNITS.get(name, 'index')} |")
    return head + "\n".join(lines) + "\n"
