"""Settings for making a data set, which the command line parses and ``make_dataset`` takes."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Final, Literal

from tyro.conf import Positional, arg

from smooth_operator.errors import ConfigError
from smooth_operator.request import MethodRequest, WristJointChoice

DATASET: Final = "dataset"
"""Name of the data set's folder inside the folder of results."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits on an episode's quality. An unknown metric does not violate its limit. Raises
    ConfigError if a limit is outside its range."""

    whole: bool = False
    """Keep or drop complete clips; never cut them."""

    hands: Literal["any", "all"] = "any"
    """A frame counts as good if any hand of the clip is seen in it (any), or only if all are (all).
    """

    min_confidence: Annotated[float, arg(metavar="0..1")] = 0.3
    """Minimum confidence of the tracker: in frames with lower confidence, the hand counts as not
    seen."""

    max_gap: Annotated[float, arg(metavar="SECONDS")] = 0.5
    """Maximum time without a good frame in an episode [s]; a clip is cut at longer gaps."""

    max_jump: Annotated[float, arg(metavar="M/S")] = 5.0
    """Maximum speed of a wrist, or of a fingertip relative to the wrist [m/s]; a clip is cut where
    the speed is higher."""

    min_seconds: Annotated[float, arg(metavar="SECONDS")] = 1.0
    """Minimum length of an episode [s]; shorter ones are dropped."""

    min_valid: Annotated[float, arg(metavar="SHARE")] = 0.6
    """Minimum fraction of good frames in an episode."""

    max_collision: Annotated[float, arg(metavar="SHARE")] = 0.2
    """Maximum fraction of frames in which links of the robot hand overlap by over 2 mm."""

    max_tip_error: Annotated[float, arg(metavar="MM")] = 60.0
    """Maximum mean distance between the robot's fingertips and the human's, at the robot's scale
    [mm].
    """

    min_reach: Annotated[float, arg(metavar="SHARE")] = 0.5
    """Minimum fraction of frames in which every fingertip is within a quarter of the robot hand's
    length of the human's fingertip.
    """

    min_finger_motion: Annotated[float, arg(metavar="MM")] = 3.0
    """Minimum motion of the human fingers over the whole clip [mm]; checked in clips of 2 s or
    more. In body motion capture without gloves, the fingers never move."""

    def __post_init__(self) -> None:
        for each in fields(Limits):
            value = getattr(self, each.name)
            if each.name in ("whole", "hands"):
                continue
            share = each.name in ("min_confidence", "min_valid", "max_collision", "min_reach")
            if not 0.0 <= value <= (1.0 if share else math.inf):
                expected = "between 0 and 1" if share else "0 or more"
                raise ConfigError(f"{each.name} must be {expected}, not {value:g}")


NO_LIMITS: Final = Limits(
    whole=True,
    max_gap=math.inf,
    max_jump=math.inf,
    min_confidence=0.0,
    min_seconds=0.0,
    min_valid=0.0,
    max_collision=1.0,
    max_tip_error=math.inf,
    min_reach=0.0,
    min_finger_motion=0.0,
)
"""Limits that keep every clip whole."""


@dataclass(frozen=True, kw_only=True)
class DatasetRequest(Limits, MethodRequest):
    """Request to make a data set: sources, robot hand, quality limits, format and output."""

    sources: Annotated[Positional[tuple[str, ...]], arg(metavar="SOURCE...")]
    """Folders, files, patterns, lists of paths, or addresses of object storage."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder for the results; created if missing."""

    format: Annotated[str, arg(metavar="NAME")] = "lerobot"
    """Output format: lerobot, webdataset, parquet, npz, spider, flashdex, or a plugin's."""

    frame: Literal["world", "camera"] | None = None
    """Frame of wrists and objects. A clip without poses in that frame fails. Default: each clip's
    own frame, which is the world if it is known, otherwise the camera.
    """

    side: Annotated[Literal["right", "left"] | None, arg(metavar="right|left")] = None
    """Use only this hand. Recordings that do not state a side are assumed to show this hand."""

    wrist_joints: WristJointChoice = "auto"
    """Whether the robot hand's wrist joints, if it has any, follow the human wrist, relative to the
    first valid frame of a clip (docs/how-to/hands.md). auto: off, since a data set contains wrist
    poses, which an arm can follow."""

    layout: Annotated[str | None, arg(metavar="NAME")] = None
    """Layout of the sources, such as egodex or files. Default: detected from the files."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of recordings without timestamps [Hz]."""

    mano: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder with your MANO model files, for layouts that contain MANO parameters."""

    objects: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder with the meshes of the objects, if they are not in the place that the layout defines.
    """

    with_objects: bool = False
    """In clips that have an object's pose and mesh, make the robot's fingertips touch the object
    where the human's do, without penetrating it. Works on whole recordings only: add
    --preset offline. Needs the extra objects of packages/smooth_hand_datasets."""

    no_limits: bool = False
    """Keep every clip without cutting it; the limits have no effect."""

    videos: Literal["none", "link", "copy"] = "none"
    """What to do with the videos of the clips, in formats that support videos: leave them out, link
    them or copy them.
    """

    fps: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of the data set [Hz]. Default: the rate of each clip; for lerobot, that of the
    first clip or video; 50 for spider; 60 for flashdex."""

    loose: bool = False
    """For the formats spider and flashdex: write the files that those programs read instead of tar
    files.
    """

    shard_mb: Annotated[float | None, arg(metavar="MB")] = None
    """Maximum size of a file of the data set [MB]. Default: 100 for lerobot, 128 for parquet, 256
    for the other formats."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of worker processes; 0 does the work in this process. Default: one per core."""

    device: Literal["cpu", "gpu"] = "cpu"
    """Device for the retargeting. cpu: the workers retarget. gpu: this process retargets a thousand
    recordings at once on JAX's first GPU, and the workers only read."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Work on a running Ray cluster (auto finds it), or start Ray here (local); its nodes need this
    package and the same folders."""

    shard: Annotated[str | None, arg(metavar="I/N")] = None
    """Retarget only the I-th of N shards, for example in an array job; write no data set. Use the
    same FOLDER for all shards, and run --merge at the end."""

    merge: bool = False
    """Write the data set from the clips of the finished shards; do not retarget."""

    @property
    def limits(self) -> Limits:
        """The quality limits of the request."""
        if self.no_limits:
            return NO_LIMITS
        return Limits(**{each.name: getattr(self, each.name) for each in fields(Limits)})

    @property
    def mirror(self) -> bool:
        """True if the results are written to ``output`` itself, at the paths of their
        recordings."""
        return False

    @property
    def data(self) -> Path:
        """Folder of the data set."""
        return self.output if self.mirror else self.output / DATASET

    @property
    def packs(self) -> Path:
        """Folder for the retargeted clips. It is hidden if the results lie next to it."""
        return self.output / (".work" if self.mirror else "work")


@dataclass(frozen=True, kw_only=True)
class MirrorRequest(DatasetRequest):
    """Request to retarget a folder of recordings to command files at the same relative paths."""

    layout: str | None = "files"
    format: str = "npz"
    no_limits: bool = True

    @property
    def mirror(self) -> bool:
        """Always True: the results are written to ``output`` itself."""
        return True
