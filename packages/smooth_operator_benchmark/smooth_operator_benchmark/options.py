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

    work: ClassVar[str] = "smooth_operator_benchmark.command:bench"
    details: ClassVar[str] = """Writes to FOLDER: results.json (one row per recording, hand and
method), report.html (everything in one file: tables, poses, plots, clips), summary.md (the main
table), plots/, and cells/ (the commands of each row). Run the same command again to continue a
stopped run; unchanged results are not measured again. Latency is measured at the end, when no other
work is running.

A recording is a file, a folder of files, or `synthetic` (`synthetic:SEED`), the built-in synthetic
hand. Default: synthetic. Settings of one recording follow its name after an @: glove.npz@:500
(frames), video.npz@30hz (rate), video.npz@30hz,left,camera,100:900. Results are averaged over the
recordings of each tracker (glove, headset, camera), then over trackers. Write mediapipe instead
of camera if the tracker was MediaPipe: the gaps that it usually reports between a touching thumb
and finger are then corrected.

Methods are names, or METHOD:PRESET, METHOD:all or METHOD:FILE (a trained model); `all` selects each
method with its default preset.

Exit status: 0 everything was measured, 1 some rows failed (the report says which and why), 2 the
request is invalid, 130 stopped by the user.

Examples:
  smooth-operator bench --output out
      compare all methods on the built-in synthetic hand and the default robot hand
  smooth-operator bench glove.npz video.npz@30hz --methods sbr,sbr:paper,dexpilot --output out
      compare three methods on your own recordings
  smooth-operator bench glove.npz@:500 --methods all --output new --compare old/results.json
      show what changed since an earlier benchmark
  smooth-operator bench glove.npz --methods smooth,sbr --hands leap_hand --sheet --output out
      draw pictures of poses side by side
  smooth-operator bench recordings/ --hands all --workers 8 --output out
      measure a folder of recordings on every hand, in eight processes
  smooth-operator bench --physics --output out
      measure how well hands do tasks in simulation (first: pip install
      ./packages/smooth_operator_study ./research; see research/docs/physics.md)
"""

    rare: ClassVar[frozenset[str]] = RARE

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic`, each optionally with settings after an @."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write: a new one, an empty one or that of an earlier benchmark."""

    hands: Annotated[str, arg(metavar="A,B|all")] = "mimic_p050"
    """Names of the robot hands, separated by commas; smooth-operator hands list prints them."""

    methods: Annotated[str, arg(metavar="M1,M2|all")] = "all"
    """Methods, separated by commas; METHOD:PRESET selects a preset."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of recordings without timestamps [Hz]."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of each recording."""

    seed: int = 0
    """Seed of the methods' random numbers."""

    fingers: Annotated[str | None, arg(metavar="A,B=C")] = None
    """Robot fingers to drive (two to five, including the thumb). thumb,index,pinky=ring drives the
    robot's pinky with the human ring finger. Default: all."""

    operator: Annotated[Path | None, arg(metavar="OPERATOR.json")] = None
    """Operator file, written by calibrate or teleop; used for all recordings."""

    definition: Literal["sound", "paper"] = "sound"
    """Definition of the metrics. Use paper to compare with the published table."""

    metrics: Annotated[str, arg(metavar="MODULE:NAME")] = ""
    """Additional metrics: package.module:NAME of each Metric, separated by commas
    (docs/how-to/plugins.md). Built-in metrics and those of plugins are always measured."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of processes that measure quality; 0 measures in this process. Default: one per core.
    Latency is always measured in this process, without other work."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Measure quality on a running Ray cluster (auto finds it), or start Ray here (local). Latency
    is measured in this process."""

    latency_frames: Annotated[int, arg(metavar="N")] = 500
    """Number of frames of each recording over which latency is measured, after a warm-up; 0 skips
    the latency measurement."""

    compare: Annotated[Path | None, arg(metavar="OTHER/results.json")] = None
    """Results of another benchmark to compare with this one."""

    sheet: bool = False
    """Draw only a contact sheet for each hand: poses of the human hand and of the robot hand with
    each method. No latency measurement and no report."""

    no_report: bool = False
    """Write only the results, without a report and plots."""

    quiet: bool = False
    """Hide progress output and the table."""
