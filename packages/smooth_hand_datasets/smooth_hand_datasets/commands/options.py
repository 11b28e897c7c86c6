"""Options of ``smooth-operator dataset``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from smooth_hand_datasets.pipeline.request import DatasetRequest
from smooth_operator.cli.common_options import RARE, Common, Quiet


@dataclass(frozen=True, kw_only=True)
class Dataset(Common, Quiet, DatasetRequest):
    """Turn recordings of human hands into a data set of robot episodes."""

    work: ClassVar[str] = "smooth_hand_datasets.commands.dataset:dataset"
    details: ClassVar[str] = """A SOURCE is a folder (with all subfolders), a file, some frames of a
file (take.npz@100:500), a pattern in quotes, a list of paths (.txt: one path per line; .csv
or .jsonl: path and optionally task, side, layout and rate), or an address of object storage
(s3://, gs://, ...). The layout of each file is detected; --layout
sets it.

Both hands of a clip are retargeted. An episode has the joints and wrist poses of both robot
hands, a validity flag for each frame, a description of the task, its source files with their
digests, and quality metrics. Clips are cut where no hand is seen or the tracker jumps; episodes
outside the limits (--min-..., --max-...) are dropped. With --whole, clips are never cut.

FOLDER/dataset is the data set; report.html, report.json and episodes.jsonl say what was kept
and dropped, and why; the folder FOLDER/work contains the retargeted clips. Run the same command
again to resume a run that was stopped or killed, or to add new files. If you change only the limits
or the format, nothing is retargeted again.

Formats:
  lerobot      a LeRobot data set, v3.0: state and action of the robot, wrists, videos
  webdataset   tar files, one sample per clip
  parquet      Parquet files, one row per clip
  npz          command files like those that retarget writes, one per hand
  spider, flashdex
               input files of SPIDER and FlashDexRetarget

Examples:
  smooth-operator dataset egodex/ --hand leap_hand --output out
  smooth-operator dataset 'takes/**/*.npz' clips.csv --hand shadow_hand --output out
  smooth-operator dataset s3://bucket/hands --hand leap_hand --format webdataset --output out
  smooth-operator dataset egodex/ --hand leap_hand --max-collision 0.05 --output out
"""

    more: ClassVar[str] = """To use several machines, start a job for each shard (here the third of
16), and merge the shards at the end:
  smooth-operator dataset /nfs/egodex --hand leap_hand --shard 3/16 --output /nfs/out
  smooth-operator dataset /nfs/egodex --hand leap_hand --merge --output /nfs/out

Exit status: 0 done, 1 some clips could not be read or retargeted (the others are done), 2 the
request is invalid, 130 stopped."""
    rare: ClassVar[frozenset[str]] = RARE | {
        "device",
        "frame",
        "mano",
        "objects",
        "wrist_joints",
        "whole",
        "hands",
        "min_confidence",
        "max_gap",
        "max_jump",
        "min_seconds",
        "min_valid",
        "max_tip_error",
        "min_reach",
        "min_finger_motion",
        "no_limits",
        "loose",
        "shard_mb",
        "shard",
        "merge",
    }

    json: bool = False
    """Print the report as one JSON object on standard output."""

    def extras(self) -> dict[str, tuple[str, ...]]:
        """The extra that a cluster needs."""
        return {} if self.cluster is None else {"cluster": ("ray",)}
