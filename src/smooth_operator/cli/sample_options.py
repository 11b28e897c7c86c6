"""Options of ``smooth-operator sample``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, Synthetic


@dataclass(frozen=True, kw_only=True)
class Sample(Common, Synthetic):
    """Write a recording of the built-in operator, as input for the other commands."""

    work: ClassVar[str] = "smooth_operator.cli.sample:sample"
    details: ClassVar[str] = """The hand opens, closes, pinches, spreads and gaits its fingers. Its
proportions and its motion come from --seed: the same seed is the same file.

Examples:
  smooth-operator sample hand.npz
  smooth-operator sample noisy.npz --seed 7 --noise 1 --rate 30
  smooth-operator sample left.mcap --side left --duration 60
"""

    output: Annotated[Positional[Path], arg(metavar="OUT.npz|OUT.mcap|OUT.h5")]
    """File to write; its folder is created if missing."""

    seed: int = 0
    """Seed of the person: bone lengths, timing and motion."""

    overwrite: bool = False
    """Replace an existing file."""

    quiet: bool = False
    """Print nothing on standard error."""
