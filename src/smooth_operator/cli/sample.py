"""``smooth-operator sample``: records the synthetic operator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Final

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, Quiet, Synthetic
from smooth_operator.errors import OutputError

if TYPE_CHECKING:
    from smooth_operator.synthetic import SyntheticOperator
    from smooth_operator.types import Side


@dataclass(frozen=True, kw_only=True)
class Sample(Common, Synthetic, Quiet):
    """Write a recording of the built-in synthetic hand, as input for the other commands."""

    work: ClassVar[str] = "smooth_operator.cli.sample:sample"
    details: ClassVar[str] = """The hand opens, closes, pinches, spreads its fingers and moves them
one by one. --seed determines its proportions and motion: the same seed gives the same file.

Examples:
  smooth-operator sample hand.npz
  smooth-operator sample noisy.npz --seed 7 --tracker headset
  smooth-operator sample left.mcap --side left --duration 60
"""

    output: Annotated[Positional[Path], arg(metavar="OUT.npz|OUT.mcap|OUT.h5")]
    """File to write. Its folder is created if missing."""

    seed: int = 0
    """Seed of the person: bone lengths, timing and motion."""

    overwrite: bool = False
    """Replace an existing file."""


_SUFFIXES: Final = (".npz", ".mcap", ".h5", ".hdf5")


def sample(options: Sample) -> None:
    """Records the operator and writes the file."""
    from smooth_operator.cli.console import Progressing
    from smooth_operator.cli.outputs import folder_for
    from smooth_operator.errors import counted
    from smooth_operator.formats.episode import Episode
    from smooth_operator.teleop.recording import write_episode

    path = options.output
    if path.suffix.lower() not in _SUFFIXES:
        raise OutputError(
            f"can't write {str(path)!r}: the name must end in {', '.join(_SUFFIXES[:-1])} or "
            f"{_SUFFIXES[-1]}"
        )
    if path.exists() and not options.overwrite:
        raise OutputError(
            f"can't write {str(path)!r}: it exists; choose another name, or add --overwrite"
        )
    recording = synthetic_operator(options, options.seed).record(options.duration)
    with folder_for(path.parent):
        write_episode(path, Episode(recording, name=path.stem))
    rate = recording.meta["rate_hz"]
    content = f"{counted(len(recording), 'frame')} of a {recording.side} hand at {rate:g} Hz"
    Progressing(options.quiet).note(f"wrote {path}: {content}")


def synthetic_operator(options: Synthetic, seed: int, side: Side = "right") -> SyntheticOperator:
    """Makes the synthetic operator with the side, rate and tracker that the options name.

    Args:
        seed: random seed of its movements and its tracker's errors.
        side: side to use if the options name none.

    Raises:
        ConfigError: a setting is outside its range.
    """
    from smooth_operator.synthetic import SyntheticOperator
    from smooth_operator.synthetic.tracker import tracker_model

    return SyntheticOperator(
        seed=seed,
        side=options.side or side,
        rate_hz=options.rate,
        tracker=tracker_model(
            options.tracker,
            seed,
            frame_loss=options.frame_loss,
            landmark_loss=options.landmark_loss,
        ),
    )
