"""What the measures of pinches and of whole-hand grasps share: their units and their rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from smooth_operator.lab.benchmark.recordings import SYNTHETIC, load_sources, parse_request
from smooth_operator.types import HandRecording, Side
from smooth_operator_research.physics.grasp_objects import GraspObject
from smooth_operator_research.physics.grasp_trial import GraspResult
from smooth_operator_research.physics.human_pinches import HumanGrasp
from smooth_operator_research.physics.measure import Unit
from smooth_operator_research.physics.results import Figure, Row
from smooth_operator_research.physics.settings import PhysicsSettings

LET_GO: Final = Figure(
    "let_go", "", "up", "Of the objects that were held until the human opened, the share that was "
    "free within 150 ms.", short="let go",
)  # fmt: skip
AT_LIMIT: Final = Figure(
    "at_limit", "", "", "Share of the hold in which a motor is at its torque limit.",
    short="at the limit",
)  # fmt: skip
"""Figures of both measures."""

_UNITS, _QUICK_UNITS = 5, 1
_GRASP_S: Final = 10.0  # about as much work as so much of a recording [s]


def named_recordings(settings: PhysicsSettings) -> list[str]:
    """The recordings asked for; built-in operators where none is named."""
    if settings.recordings:
        return list(settings.recordings)
    count = settings.count(_UNITS, _QUICK_UNITS)
    return [f"{SYNTHETIC}:{settings.seed + k}" for k in range(count)]


def recording_units(
    settings: PhysicsSettings, find: Callable[[HandRecording], Sequence[HumanGrasp]]
) -> list[Unit]:
    """The recordings in which there are such grasps.

    Raises:
        RecordingError: no recording can be read.
    """
    requests = [
        parse_request(name, frames=settings.frames, rate=settings.rate, layout=settings.layout)
        for name in named_recordings(settings)
    ]
    units = []
    for source in load_sources(requests):
        if source.recording is not None and (found := find(source.recording)):
            effort = source.recording.duration + _GRASP_S * len(found)
            units.append(Unit(source.name, source.digest, source.recording, effort))
    return units


def object_figures(things: Sequence[GraspObject]) -> Iterator[Figure]:
    """The share held of each object."""
    for thing in things:
        yield Figure(
            _column(thing.name), "", "up",
            f"The share held, {thing.kind} of {1e3 * thing.width:g} mm.",
            short=thing.name, main=False,
        )  # fmt: skip


def of_side(recording: HandRecording, side: Side) -> HandRecording:
    """The recording, or its mirror image as the other hand."""
    if recording.side == side:
        return recording
    landmarks = recording.landmarks * np.array([-1.0, 1.0, 1.0])
    return HandRecording(landmarks, recording.stamps, side, recording.valid, name=recording.name)


def grasp_row(tried: Mapping[str, Sequence[GraspResult]]) -> Row:
    """Figures of all trials; those of an object by its name."""
    every = [result for results in tried.values() for result in results]
    judged = [result.let_go for result in every if result.let_go is not None]
    held = [result for result in every if result.held]
    apart = [1e3 * result.gap for result in every if not result.touched]
    delays = [1e3 * result.delay for result in every if result.delay is not None]
    return {
        "held": _mean([result.held for result in every]),
        "let_go": _mean(judged),
        "dropped": _mean([result.dropped for result in every]),
        "force_n": _mean([result.force for result in held]),
        "at_limit": _mean([result.at_limit for result in held]),
        **{
            _column(name): _mean([result.held for result in results])
            for name, results in tried.items()
        },
        "tried": len(every),
        "touched": sum(result.touched for result in every),
        "judged": len(judged),
        "apart_mm": _mean(apart),
        "delay_ms": _mean(delays),
    }


def _column(name: str) -> str:
    return f"held_{name.replace(' ', '_')}"


def _mean(values: Sequence[float | bool | None]) -> float | None:
    known = [float(value) for value in values if value is not None]
    return float(np.mean(known)) if known else None
