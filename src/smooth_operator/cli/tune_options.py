"""Options of ``smooth-operator tune``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, UseAppendAction, arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class Tune(Common):
    """Tune the settings of a method's preset; held-out recordings are never used."""

    work: ClassVar[str] = "smooth_operator.cli.tune:tune"
    details: ClassVar[str] = """FOLDER gets preset.toml (for --preset, wherever there is one),
result.json (figures of the start and of the best, recording by recording) and trials.jsonl,
Optuna's journal. Ctrl-C keeps all of it; the same command continues and gives the result of a
search without a stop. More --trials continue further. Needs the extra tune.

The score is 0 at the start and lower if better: on each recording the sum of
weight x log(error / error at the start), for the errors cosine, cosine_all, scale, motion,
velocity, flatness, collision and pinch, and ten times the relative excess over bounds. Lag stays
within a frame, a joint's largest step within 0.25 rad at 115 Hz, and no frame is frozen, unless
bounds say otherwise.

Held-out recordings, and copies or slices of them, are refused.

Examples:
  smooth-operator tune sbr train.npz@:500 --vary pose_weight=0.01:0.1:log
      --vary velocity_weight=0.02:0.5:log --held-out judge.npz --output out
  smooth-operator tune sbr train.npz synthetic:7@headset --vary w_thumb=1:4 --weight flatness=2
      --at-least cosine_similarity=0.99 --trials 200 --output out
  smooth-operator retarget glove.npz --method sbr --preset out/preset.toml --output out.npz
"""

    method: Annotated[Positional[str], arg(metavar="METHOD")]
    """The method whose preset is tuned."""

    recordings: Annotated[Positional[tuple[str, ...]], arg(metavar="RECORDING...")]
    """What to tune on: files, folders or synthetic:SEED, each with settings after an @ if need be
    (a range of frames :500, a rate 60hz, a side, a tracker, of synthetic ones a hand of 17.5cm, a
    tempo of 1.2x)."""

    output: Annotated[Path, arg(metavar="FOLDER")]
    """Folder to write, new, empty or of an earlier search."""

    vary: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=LOW:HIGH[:log]")] = ()
    """A setting to vary, by its path in the configuration or the end of it. With log, equal steps
    are equal ratios."""

    fix: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=VALUE")] = ()
    """Another value for a setting that is not varied."""

    preset: Annotated[str | None, arg(metavar="NAME|FILE.toml")] = None
    """Start of the search. Default: the default preset of the method."""

    held_out: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="RECORDING")] = ()
    """A recording that must not be tuned on."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of recordings without time stamps [Hz]."""

    trials: int = 120
    """How many sets of values may be tried: half of them spread over the bounds (Sobol), half
    proposed from the scores before (TPE)."""

    weight: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="TERM=WEIGHT")] = ()
    """Another weight in the score, such as flatness=2 or pinch=0."""

    at_least: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="FIGURE=VALUE")] = ()
    """A lower bound of a figure on every recording, such as cosine_similarity=0.99."""

    at_most: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="FIGURE=VALUE")] = ()
    """An upper bound, such as flatness=2e-6, self_collision.share=0.05 or lag_frames=0.5."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of parallel trials; 0 runs them in this process. Default: one per core."""

    seed: int = 0
    """Seed of the search: the same seed and recordings give the same preset."""

    quiet: bool = False
    """Hide progress output and the table."""
