"""The request of a data set: the command parses it, and ``make_dataset`` takes it."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Final, Literal

from tyro.conf import Positional, arg

from smooth_operator.errors import ConfigError
from smooth_operator.request import MethodRequest

DATASET: Final = "dataset"
"""Folder of the data set, in the folder of results."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of an episode's quality. Figures that are not known break no limit.

    Raises:
        ConfigError: a limit is not a possible one.
    """

    whole: bool = False
    """Keep or drop clips whole; do not cut them."""

    hands: Literal["any", "all"] = "any"
    """A frame is good if any hand of the clip is seen in it, or if all are."""

    min_confidence: Annotated[float, arg(metavar="0..1")] = 0.3
    """Least confidence of the tracker, if it is known: frames below it count as not seen."""

    max_gap: Annotated[float, arg(metavar="SECONDS")] = 0.5
    """Longest time without a good frame in an episode [s]; a clip is cut there."""

    max_jump: Annotated[float, arg(metavar="M/S")] = 5.0
    """Fastest motion of a wrist, or of a fingertip to it [m/s]; a clip is cut at a faster one."""

    min_seconds: Annotated[float, arg(metavar="SECONDS")] = 1.0
    """Shortest episode [s]."""

    min_valid: Annotated[float, arg(metavar="SHARE")] = 0.6
    """Least share of an episode's frames with a good hand."""

    max_collision: Annotated[float, arg(metavar="SHARE")] = 0.2
    """Largest share of frames in which links of the robot hand overlap by over 2 mm."""

    max_tip_error: Annotated[float, arg(metavar="MM")] = 60.0
    """Largest mean distance between robot fingertips and the human's, on the robot's scale [mm]."""

    min_reach: Annotated[float, arg(metavar="SHARE")] = 0.5
    """Least share of frames in which every fingertip is nearer to the human's than a quarter of the
    robot hand's length."""

    min_finger_motion: Annotated[float, arg(metavar="MM")] = 3.0
    """Least motion of the human fingers over the whole clip [mm], where it lasts 2 s or more. Body
    captures without gloves have fingers that never move."""

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
"""Keeps every clip whole."""


@dataclass(frozen=True, kw_only=True)
class DatasetRequest(Limits, MethodRequest):
    """Sources, robot hand, limits of quality, format and output of a data set."""

    sources: Annotated[Positional[tuple[str, ...]], arg(metavar="SOURCE...")]
    """Folders, files, patterns, lists of paths, addresses."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder of the results; created if missing."""

    format: Annotated[str, arg(metavar="NAME")] = "lerobot"
    """Output format: lerobot, webdataset, parquet, npz, spider, flashdex, or a plugin's."""

    frame: Literal["world", "camera"] | None = None
    """Frame of wrists and objects. A clip that has no poses in it fails. Default: each
    clip's own frame, the world where it is known, else the camera."""

    side: Annotated[Literal["right", "left"] | None, arg(metavar="right|left")] = None
    """Use only this hand. Recordings that do not state their side are taken as this hand."""

    layout: Annotated[str | None, arg(metavar="NAME")] = None
    """Layout of the sources, such as egodex or files. Default: recognised from the files."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of recordings without time stamps [Hz]."""

    mano: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Your MANO model files, for layouts that hold MANO parameters."""

    objects: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Meshes of the objects, where they are not in the place that the layout has for them."""

    with_objects: bool = False
    """In clips that have an object's pose and mesh, make the robot's fingertips touch the object
    where the human's do, without penetrating it. Works on whole recordings only: add
    --preset offline. Needs packages/smooth_hand_datasets."""

    no_limits: bool = False
    """Keep every clip, whole; the limits have no effect."""

    videos: Literal["none", "link", "copy"] = "none"
    """Videos of the clips, in formats that take them: left out, linked or copied."""

    fps: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of the data set [Hz]. Default: the format's own."""

    loose: bool = False
    """Formats spider and flashdex: files as those programs read them, in place of tar files."""

    shard_mb: Annotated[float | None, arg(metavar="MB")] = None
    """Size at which a file of the data set is full [MB]. Default: the format's own."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of worker processes; 0 does the work in this process. Default: one per core."""

    device: Literal["cpu", "gpu"] = "cpu"
    """What retargets. gpu: this process, a thousand recordings side by side, on JAX's first GPU;
    the workers read."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Work on a running Ray cluster (auto finds it), or start Ray here (local); its nodes need this
    package and the same folders."""

    shard: Annotated[str | None, arg(metavar="I/N")] = None
    """Retarget only the I-th of N shares (an array job); write no data set. Give all shares the
    same FOLDER, and --merge at the end."""

    merge: bool = False
    """Write the data set from what shares have finished; retarget nothing."""

    @property
    def limits(self) -> Limits:
        """The limits of quality."""
        if self.no_limits:
            return NO_LIMITS
        return Limits(**{each.name: getattr(self, each.name) for each in fields(Limits)})

    @property
    def mirror(self) -> bool:
        """True if results stand in ``output`` itself, at the paths of their recordings."""
        return False

    @property
    def data(self) -> Path:
        """Folder of the data set."""
        return self.output if self.mirror else self.output / DATASET

    @property
    def packs(self) -> Path:
        """Folder with the retargeted clips; hidden where results stand beside it."""
        return self.output / (".work" if self.mirror else "work")


@dataclass(frozen=True, kw_only=True)
class MirrorRequest(DatasetRequest):
    """Recordings of folders, each retargeted to files of commands at its path in its folder."""

    layout: str | None = "files"
    format: str = "npz"
    no_limits: bool = True

    @property
    def mirror(self) -> bool:
        """Results stand in ``output`` itself."""
        return True
