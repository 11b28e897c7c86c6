"""Options of ``smooth-operator train``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered


@dataclass(frozen=True, kw_only=True)
class Train(Ordered, Common):
    """Train a learning-based method for a robot hand: geort."""

    work: ClassVar[str] = "smooth_operator.cli.train:train"
    details: ClassVar[str] = """Needs the extra lab.

DIR gets model.npz, ready to use, model.json (how it was trained), losses.csv, losses.png and
checkpoint.npz. Ctrl-C keeps all of it; the same command with --resume continues, and
gives the same bytes as a training without a stop.

A good recording opens, closes, spreads and pinches for a minute or more.

Examples:
  smooth-operator train geort glove.npz --hand mimic_p050 --output my-geort
  smooth-operator train geort glove.npz --hand mimic_p050 --output my-geort --resume
  smooth-operator train geort synthetic --hand mimic_p050 --output geort-synthetic
"""

    method: Annotated[Positional[Literal["geort"]], arg(metavar="geort")]
    """The method to train."""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="RECORDING...")]
    """MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or this program's .mcap log; one or
    more, of one side. The word synthetic stands for a dozen built-in operators (a file of that
    name is ./synthetic)."""

    output: Annotated[Path, arg(metavar="DIR")]
    """Folder to write; created if missing."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Which hand; as the recording says if left out."""

    epochs: int = 120
    """Passes over the recorded points."""

    seed: int = 0
    """Seed of all random numbers: the same seed and frames give the same model."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of recordings without time stamps [Hz]."""

    coverage: Literal["operator", "reach"] = "operator"
    """What the robot's motion covers: the operator's motion, or, as published, the robot's whole
    reach; the recording must then contain the ends of the operator's own reach."""

    checkpoint_every: Annotated[int, arg(metavar="EPOCHS")] = 10
    """Epochs between checkpoints."""

    resume: bool = False
    """Continue the training in DIR, started with the same recording and options."""

    quiet: bool = False
    """No progress on standard error."""
