"""Options of ``smooth-operator ablate`` and ``smooth-operator paper``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeAlias

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common

# Spelt out again: the catalogue that owns the names imports JAX, and `--help` needs none.
ExperimentName: TypeAlias = Literal[
    "fk", "compute", "solver", "velocity", "hessian", "table", "noise", "rate"
]


@dataclass(frozen=True, kw_only=True)
class Experimenting(Common):
    """Options of both commands."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write, new, empty or of earlier experiments."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each recording, as a Python slice: :500, 2600:3100, -500:"""

    quick: bool = False
    """A minimal size, to test that it runs; the verdicts mean little."""

    published: bool = False
    """For an accelerator: the published 32,768 samples and starts of RMSProp, 64 starts of SLSQP
    (it runs them one after the other), 1,024 of Newton, 500 frames."""

    quiet: bool = False
    """No progress on standard error, no verdicts on standard output."""


@dataclass(frozen=True, kw_only=True)
class Ablate(Experimenting):
    """Re-run one of the paper's experiments on your own machine and recordings."""

    work: ClassVar[str] = "smooth_operator.cli.ablate:ablate"
    details: ClassVar[str] = """Experiments:
  fk        libraries of forward kinematics over the size of the batch
  compute   tracking loss over samples N and cycles L, along contours of equal compute
  solver    DexPilot's loss unchanged, the solver swapped: loss, jitter, time
  velocity  the same with a velocity term
  hessian   in which directions of the loss a solver jitters
  table     the six metrics of all methods, in the paper's layout
  noise     methods behind a tracker with noise and drop-outs
  rate      methods at frame rates from 15 to 100 Hz

FOLDER gets NAME/results.json, NAME/*.png, report.html (all experiments in the folder), and cells/
(what was computed, shared by the experiments). The same command continues a stopped
run. Without recordings twenty people of the built-in operator are used (four with --quick); a
recording may bring a range of frames, a rate or a side after an @, as for bench. Of each at most
300 frames are used (for the solvers 150, with --published 500). Files count as independent,
parts of one file as one.

Examples:
  smooth-operator ablate solver --output out
  smooth-operator ablate hessian glove.npz@2600:3100 --output out
"""

    name: Annotated[Positional[ExperimentName], arg(metavar="NAME")]
    """The experiment."""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic:SEED`, each with settings after an @ if need be."""


@dataclass(frozen=True, kw_only=True)
class Paper(Experimenting):
    """Re-run all of the paper's experiments, and judge each claim."""

    work: ClassVar[str] = "smooth_operator.cli.ablate:paper"
    details: ClassVar[str] = """FOLDER gets a folder for each experiment (results.json and figures),
and report.html with all of them. The same command continues a stopped run.

Examples:
  smooth-operator paper --output out
  smooth-operator paper --quick --output out
  smooth-operator paper glove.npz@2600:3100 video.npz@30hz --output out
"""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="[RECORDING ...]")] = ()
    """Files, folders or `synthetic:SEED`, each with settings after an @ if need be."""
