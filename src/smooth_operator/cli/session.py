"""Reads and retargets a recording with progress and notes, for several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from smooth_operator.cli.console import Progressing
from smooth_operator.execution import Outcome, build, execute
from smooth_operator.formats.checks import frame_slice, reading_notes
from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.stand_ins import stand_in_note
from smooth_operator.planning import Plan
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.start import start_jax
from smooth_operator.types import HandRecording


def execute_shown(todo: Plan, progress: Progressing) -> Outcome:
    """Retargets a recording, with a progress bar."""
    say_notes(todo.config, todo.hand, progress)
    with progress.waiting(f"compiling {todo.method} for {todo.hand.name} (slow the first time)"):
        start_jax(one_thread=todo.config.one_thread)
        built = build(todo)
    return execute(todo, built, progress.frames("retargeting"))


def read_shown(
    path: Path | str, progress: Progressing, frames: str | None, **reading: Any
) -> HandRecording:
    """Reads the chosen frames of a recording, and prints notes on it.

    Args:
        frames: range ``A:B``; None for all frames.
        reading: options of ``read_recording``.
    """
    recording = read_recording(path, **reading)
    for note in reading_notes(recording, str(path)):
        progress.note(note, matters=True)
    return recording if frames is None else recording[frame_slice(frames, len(recording))]


def say_notes(config: MethodConfig, hand: Hand, progress: Progressing) -> None:
    """Prints notes on a method and a hand, and on the collision shapes that the metrics use."""
    for note in dict.fromkeys([*config.notes(hand), *filter(None, [stand_in_note(hand)])]):
        progress.note(note, matters=True)
