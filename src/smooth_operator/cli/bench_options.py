"""Options of ``smooth-operator bench``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import RARE, Common, HandSide, Ordered


@dataclass(frozen=True, kw_only=True)
class Bench(Ordered, Common):
    """Compare methods on recordings and hands: a table, results.json, an HTML report."""

    work: ClassVar[str] = "smooth_operator.cli.bench:bench"
    details: ClassVar[str] = """FOLDER gets results.json (a row for each recording, hand and
method), report.html (everything in one file: tables, poses, plots, clips), summary.md (the main
table), plots/, and cells/ (the commands of each). The same command continues a stopped run;
unchanged results are not measured again. Latency is measured at the end, with no other work.

A recording is a file, a folder of files, or `synthetic` (`synthetic:SEED`), the built-in
operator, which is used if there is none. It may bring its own settings after an @:
glove.npz@:500 (frames), video.npz@30hz (rate), video.npz@30hz,left,camera,100:900.
Means are over recordings of each tracker (glove, headset, camera), then over trackers;
mediapipe is a camera whose pinch gaps are known.

Methods are names, or METHOD:PRESET, METHOD:all or METHOD:FILE (a trained model); `all` is
each method with its default preset.

Exit status: 0 all measured, 1 some cells failed (the report says which and why), 2 the
request is invalid, 130 stopped.

Examples:
  smooth-operator bench --output out
      all methods on the built-in operator and the built-in hand
  smooth-operator bench glove.npz video.npz@30hz --methods sbr,sbr:paper,dexpilot --output out
      three candidates on your own recordings
  smooth-operator bench glove.npz@:500 --methods all --output new --compare old/results.json
      what changed since an earlier benchmark
  smooth-operator bench glove.npz --methods smooth,sbr --hands leap_hand --sheet --output out
      pictures of poses, side by side
  smooth-operator bench recordings/ --hands all --workers 8 --output out
      a folder, on every hand, in eight processes
  smooth-operator bench --physics --output out
      what hands achieve in physics; of the distribution research/ (research/docs/physics.md)
"""

    rare: ClassVar[frozenset[str]] = RARE

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic`, each with settings after an @ if need be."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write, new, empty or of an earlier benchmark."""

    hands: Annotated[str, arg(metavar="A,B|all")] = "mimic_p050"
    """Robot hands by their catalogue names, with commas between them."""

    methods: Annotated[str, arg(metavar="M1,M2|all")] = "all"
    """Methods, with commas between them; METHOD:PRESET for a preset."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of recordings without time stamps [Hz]."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of each recording."""

    seed: int = 0
    """Seed of the methods' random numbers."""

    fingers: Annotated[str | None, arg(metavar="A,B=C")] = None
    """Robot fingers to drive (two to five, including the thumb), each by its own human finger
    or by another: thumb,index,pinky=ring has the ring finger drive the robot's pinky. All if left
    out."""

    operator: Annotated[Path | None, arg(metavar="OPERATOR.json")] = None
    """What is known of the operator of all recordings, as calibrate and teleop write it."""

    definition: Literal["sound", "paper"] = "sound"
    """How the metrics are defined; paper is as published."""

    metrics: Annotated[str, arg(metavar="MODULE:NAME")] = ""
    """Further metrics: package.module:NAME of a Metric, with commas between them
    (docs/how-to/plugins.md). The built-in ones and those of plugins are measured anyway."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of processes that measure quality; 0 measures in this process. Default: one per core.
    Latency is always measured alone."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Measure quality on a running Ray cluster (auto finds it), or start Ray here (local). Latency
    is measured in this process."""

    latency_frames: Annotated[int, arg(metavar="N")] = 500
    """Frames of each recording to measure latency over, after a warm-up; 0 to leave it out."""

    compare: Annotated[Path | None, arg(metavar="OTHER/results.json")] = None
    """Results of another benchmark to compare with this one."""

    sheet: bool = False
    """Draw only the contact sheet of each hand: poses of the recordings, the human hand and each
    method's. No latency, no report."""

    no_report: bool = False
    """Write the results, but no report and no plots."""

    quiet: bool = False
    """Hide progress output and the table."""
