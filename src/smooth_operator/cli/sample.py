"""``smooth-operator sample``: a recording of the built-in operator."""

from __future__ import annotations

from typing import Final

from smooth_operator.cli.console import Progressing
from smooth_operator.cli.outputs import folder_for
from smooth_operator.cli.sample_options import Sample
from smooth_operator.cli.synthetic import synthetic_operator
from smooth_operator.errors import OutputError
from smooth_operator.formats.episode import Episode
from smooth_operator.teleop.recording import write_episode

_SUFFIXES: Final = (".npz", ".mcap", ".h5", ".hdf5")


def sample(options: Sample) -> None:
    """Records the operator and writes the file.

    Raises:
        ConfigError: a setting is outside its range.
        OutputError: the suffix names no format, the file exists, or it can't be written.
    """
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
    said = f"{len(recording)} frames of a {recording.side} hand at {options.rate:g} Hz"
    Progressing(options.quiet).note(f"wrote {path}: {said}")
