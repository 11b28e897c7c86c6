"""Registry of the output formats of data sets: the built-in ones and those of plugins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from smooth_operator.errors import ConfigError
from smooth_operator.plugins import Entry, Registry
from smooth_operator.types import Side


@dataclass(frozen=True)
class WritingOptions:
    """Options for writing a data set; each format uses some of them.

    Attributes:
        joints: side -> joint names of the robot hands of all clips; empty to use those of the first
            clip. Formats with fixed columns (LeRobot) need them.
        rate: frame rate of the data set [Hz]; None for the format's default: LeRobot uses that of
            the first clip, SPIDER 50 and FlashDexRetarget 60; the others keep the timestamps.
        videos: LeRobot: ``none``, ``link`` (hard or symbolic links) or ``copy``.
        camera: LeRobot: True for columns with the camera's pose.
        objects: LeRobot: number of objects that have columns.
        shard_mb: size at which a shard is full [MB]; None for the format's own choice.
        part: index of this writer among ``parts``, for formats that are ``parallel``.
        parts: number of writers that share the folder.
        apart: True if the parts contain different clips, so that a writer need not read the indices
            of the others; with a thousand parts, reading them takes longer than writing one part.
        loose: SPIDER and FlashDexRetarget: True for files as these programs read them, False for
            tar files to unpack.
    """

    joints: Mapping[Side, tuple[str, ...]] = field(default_factory=dict)
    rate: float | None = None
    videos: Literal["none", "link", "copy"] = "none"
    camera: bool = True
    objects: int = 2
    shard_mb: float | None = None
    part: int = 0
    parts: int = 1
    apart: bool = False
    loose: bool = False

    def __post_init__(self) -> None:
        if self.rate is not None and not 0.0 < self.rate < float("inf"):
            raise ConfigError(
                f"rate must be a positive number of frames per second, not {self.rate}"
            )
        if self.shard_mb is not None and not self.shard_mb > 0.0:
            raise ConfigError(f"shard_mb must be above 0, not {self.shard_mb}")


@dataclass(frozen=True)
class DatasetFormat:
    """An output format of data sets.

    Attributes:
        what: kind of its data sets, for messages, such as ``a LeRobot dataset``.
        open: ``open(output, options)`` returns a writer into a folder. The folder is created, or
            continued if it was begun in this format. The writer is a ``ShardedWriter``, or has the
            same public methods. Raises ``MissingExtraError`` (a library is missing),
            ``ConfigError`` (the folder was begun in another format or with other options) or
            ``OutputError`` (the folder has other content, or can't be written).
        parallel: True if several writers (``part``, ``parts``) can write one data set at once.
        shortest: smallest number of frames of a clip; a single frame has no rate.
    """

    what: str
    open: Callable[[Path, WritingOptions], Any]
    parallel: bool = False
    shortest: int = 2


_WRITERS: Final = "smooth_hand_datasets.pipeline.writers"

WRITERS: Final = Registry(
    "writer",
    {
        "lerobot": Entry(
            f"{_WRITERS}.lerobot:LEROBOT", "LeRobot v3: state and action of the robot, videos"
        ),
        "webdataset": Entry(f"{_WRITERS}.shards:WEBDATASET", "tar shards, one sample per clip"),
        "parquet": Entry(f"{_WRITERS}.parquet:PARQUET", "Parquet files, one row per clip"),
        "npz": Entry(f"{_WRITERS}.npz:NPZ", "command files like those that retarget writes"),
        "spider": Entry("smooth_hand_datasets.spider:SPIDER", "input files of SPIDER"),
        "flashdex": Entry(
            "smooth_hand_datasets.flashdex:FLASHDEX", "input files of FlashDexRetarget"
        ),
    },
    needs=("what", "open"),
)
"""Name -> ``DatasetFormat``. Plugins can add formats as ``smooth_operator.writers``."""
