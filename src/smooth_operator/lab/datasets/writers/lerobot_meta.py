"""What describes a LeRobot data set of robot hands as a whole: statistics, README."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from smooth_operator.episode_files.lerobot.stats import Statistics
from smooth_operator.lab.datasets.writers.lerobot_columns import unit_of
from smooth_operator.lab.datasets.writers.videos import VIDEO_KEY

_IMAGENET: Final = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}


def statistics_to_json(part: Statistics) -> dict[str, Any]:
    """Statistics as JSON has them, to the last bit."""
    values = {name: each.tolist() for name, each in part.values.items()}
    return {"frames": part.frames, "finite": part.finite.tolist(), "values": values}


def statistics_from_json(value: dict[str, Any]) -> Statistics:
    """What ``statistics_to_json`` wrote."""
    values = {name: np.asarray(each, np.float64) for name, each in value["values"].items()}
    return Statistics(value["frames"], np.asarray(value["finite"], np.float64), values)


def video_statistics(frames: int) -> dict[str, Any]:
    """Those of ImageNet, which LeRobot puts in their place by default; no picture is decoded."""

    def each(values: tuple[float, ...]) -> list[Any]:
        return [[[value]] for value in values]

    zero, one = each((0.0,) * 3), each((1.0,) * 3)
    mean, std = each(_IMAGENET["mean"]), each(_IMAGENET["std"])
    return {"min": zero, "max": one, "mean": mean, "std": std, "count": [frames]}


def card(info: dict[str, Any]) -> str:
    """The README of a data set, from ``meta/info.json``."""
    lines = [
        "---",
        "tags:",
        "- LeRobot",
        "task_categories:",
        "- robotics",
        "configs:",
        "- config_name: default",
        "  data_files: data/*/*.parquet",
        "---",
        "",
        "# Human hands as robot hands",
        "",
        f"A LeRobot data set ({info['codebase_version']}), written by smooth-operator: "
        f"{info['total_episodes']} episodes, {info['total_frames']} frames, {info['fps']:g} frames "
        f"a second, hands {info['robot_type']}. Human hands were retargeted; no robot moved.",
        "",
        "| column | type | unit, meaning |",
        "|---|---|---|",
    ]
    for name, feature in info["features"].items():
        size = " × ".join(map(str, feature["shape"]))
        unit = "the source's video" if name == VIDEO_KEY else unit_of(name)
        lines.append(f"| `{name}` | {feature['dtype']} × {size} | {unit} |")
    if VIDEO_KEY in info["features"]:
        lines += ["", f"The statistics of `{VIDEO_KEY}` are ImageNet's, not measured."]
    return "\n".join(lines) + "\n"
