"""Options of ``smooth-operator dataset``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import RARE, Common, HandSide, Retargeting


@dataclass(frozen=True, kw_only=True)
class Dataset(Common, Retargeting):
    """Turn recordings of human hands into a data set of robot episodes."""

    work: ClassVar[str] = "smooth_operator.cli.dataset:dataset"
    details: ClassVar[str] = """A SOURCE is a folder (with all subfolders), a file, some frames of a
file (take.npz@100:500), a pattern in quotes, a list of paths (.txt a path a line; .csv or .jsonl
with path and, where wanted, task, side, layout and rate), or an address of object storage (s3://,
gs://, ...; extra datasets). Each file's layout is recognised; --layout names it.

Both hands of a clip are retargeted. An episode holds the joints of both robot hands, the poses of
their wrists, which frames are valid, the task in words, the files that it is from with their
digests, and figures of its quality. Clips are cut where no hand is seen or the tracker jumps;
episodes outside the limits (--min-..., --max-...) are dropped. --whole cuts nothing.

FOLDER/dataset is the data set; report.html, report.json and episodes.jsonl say what was kept,
dropped and why; work holds the retargeted clips. Run the same command again to go on where it was
stopped or killed, or to add new files. Changing limits or format does not retarget again.

Formats:
  lerobot      a LeRobot data set, v3.0: state and action of the robot, wrists, videos
  webdataset   tar files, a sample a clip
  parquet      Parquet files, a row a clip
  npz          files of commands as retarget writes them, one a hand
  spider, flashdex (after: pip install ./packages/smooth_hand_datasets)

Examples:
  smooth-operator dataset egodex/ --hand leap_hand --output out
  smooth-operator dataset 'takes/**/*.npz' clips.csv --hand shadow_hand --output out
  smooth-operator dataset s3://bucket/hands --hand leap_hand --format webdataset --output out
  smooth-operator dataset egodex/ --hand leap_hand --max-collision 0.05 --output out
"""

    more: ClassVar[str] = """Jobs on several machines, here the third of 16; and when all are done:
  smooth-operator dataset /nfs/egodex --hand leap_hand --shard 3/16 --output /nfs/out
  smooth-operator dataset /nfs/egodex --hand leap_hand --merge --output /nfs/out

Exit status: 0 done, 1 some clips could not be read or retargeted (the others are done), 2 the
request is invalid, 130 stopped."""
    rare: ClassVar[frozenset[str]] = RARE | {
        "device", "frame", "mano", "objects", "whole", "hands", "min_confidence", "max_gap",
        "max_jump", "min_seconds", "min_valid", "max_tip_error", "min_reach", "min_finger_motion",
        "no_limits", "loose", "shard_mb", "shard", "merge",
    }  # fmt: skip

    sources: Annotated[Positional[tuple[str, ...]], arg(metavar="SOURCE...")]
    """Folders, files, patterns, lists of paths, addresses."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder of the results; created if missing."""

    format: Annotated[str, arg(metavar="NAME")] = "lerobot"
    """Output format: lerobot, webdataset, parquet, npz, spider, flashdex, or one of a plugin."""

    frame: Literal["world", "camera"] | None = None
    """Frame of wrists and objects. A clip that has no poses in it fails. Default: each
    clip's own frame, the world where it is known, else the camera."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Only this hand; and the hand of recordings that do not say which it is."""

    layout: Annotated[str | None, arg(metavar="NAME")] = None
    """Layout of the sources, such as egodex or files. Default: recognised from the files."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of recordings without time stamps [Hz]."""

    mano: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Your MANO model files, for layouts that hold MANO parameters."""

    objects: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Meshes of the objects, where they are not in the place that the layout has for them."""

    with_objects: bool = False
    """Robot fingertips touch what the human's touch, and stay out of the objects, in clips that
    have an object's pose and mesh. For whole recordings: --preset offline. Needs
    packages/smooth_hand_datasets."""

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
    """Largest share of frames in which links of the robot hand are over 2 mm inside each other."""

    max_tip_error: Annotated[float, arg(metavar="MM")] = 60.0
    """Largest mean distance between robot fingertips and the human's, on the robot's scale [mm]."""

    min_reach: Annotated[float, arg(metavar="SHARE")] = 0.5
    """Least share of frames in which every fingertip is nearer to the human's than a quarter of the
    robot hand's length."""

    min_finger_motion: Annotated[float, arg(metavar="MM")] = 3.0
    """Least motion of the human fingers over the whole clip [mm], where it lasts 2 s or more. Body
    captures without gloves have fingers that never move."""

    no_limits: bool = False
    """Keep every clip, whole; the options above have no effect."""

    videos: Literal["none", "link", "copy"] = "none"
    """Videos of the clips, in formats that take them: left out, linked or copied."""

    fps: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of the data set [Hz]. Default: the format's own."""

    loose: bool = False
    """Formats spider and flashdex: files as those programs read them, in place of tar files."""

    shard_mb: Annotated[float | None, arg(metavar="MB")] = None
    """Size at which a file of the data set is full [MB]. Default: the format's own."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of processes; 0 works in this process. Default: one per core."""

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

    json: bool = False
    """Print the report as one JSON object on standard output."""

    def extras(self) -> dict[str, tuple[str, ...]]:
        """For the report, and for the format, addresses and the cluster; each extra has those
        before it."""
        libraries = ["jinja2", "matplotlib"]
        extra = "lab"
        if self.format in ("lerobot", "parquet"):
            extra = "datasets"
            libraries.append("pyarrow")
        if any("://" in source for source in self.sources):
            extra = "datasets"
            libraries.append("fsspec")
        if self.cluster is not None:
            extra = "cluster"
            libraries.append("ray")
        return {extra: tuple(libraries)}
