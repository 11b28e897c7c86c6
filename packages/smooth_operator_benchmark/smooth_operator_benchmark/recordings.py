"""Reads the recordings of a benchmark: files, folders and the synthetic operator.

A recording is named by its path, or ``synthetic`` or ``synthetic:SEED`` for the built-in operator.
It may have its own settings after an ``@``, separated by commas: a range of frames, a rate, a side,
an order of landmarks and a tracker. The built-in operator's tracker is simulated, and the length of
its hand and its tempo can also be set. Examples: ``glove.npz@:500``,
``video.npz@30hz,mano,camera``, ``synthetic:3@left,100:300``, ``synthetic:3@headset``,
``synthetic:3@17.5cm,1.2x``.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from smooth_operator.errors import ConfigError, RecordingError, SmoothOperatorError
from smooth_operator.formats.checks import frame_slice
from smooth_operator.formats.commands import only_commands
from smooth_operator.formats.readers import read_recording
from smooth_operator.formats.registry import (
    files_below,
    is_dataset,
    named_as_recording,
    rated_if_unstamped,
    recording_suffixes,
)
from smooth_operator.landmarks import LAYOUTS
from smooth_operator.retargeting.known_gaps import MEDIAPIPE, known_gaps
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.tracker import TRACKERS, tracker_model
from smooth_operator.types import HandRecording, Side, as_side

SYNTHETIC: Final = "synthetic"
SYNTHETIC_SECONDS: Final = 20.0
"""Length of the built-in operator's motion [s]."""

UNKNOWN_TRACKER: Final = "other"
"""Kind of tracker of recordings that do not state one and whose format does not determine it."""

_TRACKER_OF: Final = {
    "manus": "glove",
    "avp": "headset",
    "hts": "headset",
    "egodex": "headset",
}
_NOTED: Final = ("side_assumed", "implausible_frames", "format")  # entries that a report reads
_RATE = re.compile(r"(\d+(?:\.\d+)?)\s*hz", re.IGNORECASE)
_LENGTH = re.compile(r"(\d+(?:\.\d+)?)\s*cm", re.IGNORECASE)
_SPEED = re.compile(r"(\d+(?:\.\d+)?)\s*x", re.IGNORECASE)


@dataclass(frozen=True)
class Request:
    """A requested recording with its settings.

    Attributes:
        path: the file; None for the built-in operator.
        seed: seed of the built-in operator.
        frames: range of frames ``A:B``; None for all.
        rate: frame rate [Hz]; None uses that of the file.
        side: side of the hand; None uses that of the file.
        hand_length: hand length of the built-in operator [m]; None keeps the operator's own.
        speed: tempo of the built-in operator; 1 is natural.
        layout: order of the landmarks in a plain array; None for this project's order.
        tracker: one of ``TRACKERS``. None derives it from the format; for the built-in operator,
            None means a perfect tracker.
        mediapipe: True for a recording of MediaPipe, whose pinch gaps are known.
    """

    path: Path | None
    seed: int = 0
    frames: str | None = None
    rate: float | None = None
    side: Side | None = None
    hand_length: float | None = None
    speed: float = 1.0
    layout: str | None = None
    tracker: str | None = None
    mediapipe: bool = False

    @property
    def unit(self) -> str:
        """What counts as one independent sample: the file, or the synthetic operator with its seed.

        Parts of one file, or one file read in several ways, count as one unit.
        """
        return f"{SYNTHETIC}:{self.seed}" if self.path is None else str(self.path.resolve())

    def operator(self) -> SyntheticOperator:
        """The requested synthetic operator with its tracker; ConfigError if the length of the hand
        or the tempo is outside its range."""
        operator = SyntheticOperator(
            seed=self.seed,
            side=self.side or "right",
            speed=self.speed,
            tracker=tracker_model(self.tracker, self.seed),
        )
        if self.hand_length is not None:
            operator = replace(operator, hand_length=self.hand_length)
        return operator if self.rate is None else replace(operator, rate_hz=self.rate)


@dataclass(frozen=True, eq=False)
class Source:
    """A requested recording after it was read. Either ``recording`` or ``error`` is None.

    Attributes:
        request: the user's request.
        name: name in results, unique among the sources of a benchmark.
        recording: the frames.
        error: reason why there are no frames.
        frames: range of these frames in the file.
        digest: SHA-256 of the frames; empty without frames.
    """

    request: Request
    name: str
    recording: HandRecording | None = None
    error: str | None = None
    frames: tuple[int, int] | None = None
    digest: str = ""

    @property
    def side(self) -> Side:
        """Side of the recording. If the recording can't be read, the requested side, or right
        without a request."""
        return self.recording.side if self.recording else self.request.side or "right"

    @property
    def tracker(self) -> str:
        """Kind of tracker that made the recording: one of ``TRACKERS``, ``synthetic`` or
        ``UNKNOWN_TRACKER``."""
        if self.request.path is None:
            return SYNTHETIC
        stored = "" if self.recording is None else str(self.recording.meta.get("format"))
        return self.request.tracker or _TRACKER_OF.get(stored, UNKNOWN_TRACKER)

    @property
    def pinch_gaps(self) -> Mapping[str, float]:
        """Known pinch gaps of the recording's tracker, as ``Retargeter`` takes them."""
        if self.request.mediapipe:
            return MEDIAPIPE
        return known_gaps(self.request.tracker if self.tracker == SYNTHETIC else None)

    @property
    def facts(self) -> dict[str, object]:
        """Properties of the recording that the results contain."""
        recording = self.recording
        return {
            "path": None if self.request.path is None else str(self.request.path),
            "unit": self.request.unit,
            "tracker": self.tracker,
            "frames": self.frames,
            "sha256": self.digest or None,
            "side_assumed": bool(recording and recording.meta.get("side_assumed")),
            "rate_hz": None if recording is None or len(recording) < 2 else recording.rate_hz,
            "duration_s": None if recording is None else recording.duration,
        }


def parse_request(
    text: str,
    *,
    frames: str | None = None,
    rate: float | None = None,
    side: Side | None = None,
    layout: str | None = None,
) -> Request:
    """Parses the name of a recording and its settings.

    Args:
        text: name and settings; see the docstring of this module.
        frames: default range of frames.
        rate: default rate.
        side: default side.
        layout: default layout.

    Raises:
        ConfigError: the part after the ``@`` is not a setting, or the seed is not a number.
    """
    name, at, options = text.rpartition("@")
    if not at or Path(text).exists():  # a file's name may hold an @
        name, options = text, ""
    length, speed, tracker, mediapipe = None, 1.0, None, False
    for option in filter(None, (part.strip() for part in options.split(","))):
        if rated := _RATE.fullmatch(option):
            rate = float(rated[1])
        elif long := _LENGTH.fullmatch(option):
            length = 1e-2 * float(long[1])
        elif fast := _SPEED.fullmatch(option):
            speed = float(fast[1])
        elif ":" in option:
            frames = option
        elif option.lower() in ("left", "right", "l", "r"):
            side = as_side(option)
        elif option.lower() in LAYOUTS:
            layout = option.lower()
        elif option.lower() == "mediapipe":
            tracker, mediapipe = "camera", True
        elif option.lower() in TRACKERS:
            tracker = option.lower()
        else:
            raise ConfigError(
                f"{text!r}: {option!r} is not a setting of a recording; after the @ you can write "
                "a range of frames (:500), a rate (60hz), a side (left), a landmark order (mano), "
                f"a tracker ({', '.join(TRACKERS)}, mediapipe) or, for the synthetic hand, its "
                "length (17.5cm) and its tempo (1.2x), separated by commas"
            )
    if frames is not None:
        frame_slice(frames, None)  # refuses an invalid range before anything is read
    if name == SYNTHETIC or name.startswith(f"{SYNTHETIC}:"):
        seed = name.partition(":")[2] or "0"
        if not (seed.isascii() and seed.isdigit()):
            raise ConfigError(f"{name!r}: the seed must be a whole number, as in {SYNTHETIC}:3")
        own_rate = rate if "hz" in options.lower() else None
        return Request(None, int(seed), frames, own_rate, side, length, speed, tracker=tracker)
    if length is not None or speed != 1.0:
        raise ConfigError(
            f"{text!r}: length and tempo are only for the synthetic hand, as in "
            f"{SYNTHETIC}:3@17.5cm,1.2x"
        )
    return Request(
        Path(name), 0, frames, rate, side, layout=layout, tracker=tracker, mediapipe=mediapipe
    )


def load_sources(requests: Iterable[Request]) -> list[Source]:
    """Reads the requested recordings. A folder stands for all recordings in it and in its
    subfolders.

    Returns:
        The sources in the requested order, without duplicates; an unreadable source has the reason.

    Raises:
        RecordingError: no recording can be read; the message has the reason for the first one.
    """
    unique = dict.fromkeys(one for request in requests for one in _expanded(request))
    sources = [_load(request) for request in unique]
    if all(source.recording is None for source in sources):
        first = sources[0].error if sources else "no recording was given"
        more = (
            f" (the other {len(sources) - 1} recordings can't be read either)"
            if len(sources) > 1
            else ""
        )
        raise RecordingError(f"{first}{more}")
    names = unique_names([(source.name, source.request.path) for source in sources])
    labelled: dict[str, Source] = {}
    for source, name in zip(sources, names, strict=True):
        label, count = _ranged(name, source), 1
        while label in labelled and labelled[label].digest != source.digest:
            count += 1  # one file read in two ways, such as at two rates
            label = f"{_ranged(name, source)}#{count}"
        labelled.setdefault(label, replace(source, name=label))
    return list(labelled.values())


def unique_names(named: Sequence[tuple[str, Path | None]]) -> list[str]:
    """Makes the names of files unique, by adding as many parent folders as needed to names that
    clash."""
    paths = [None if path is None else path.absolute() for _, path in named]

    def at(depth: int, i: int) -> str:
        path = paths[i]
        return (
            named[i][0] if path is None else "/".join((*path.parts[-1 - depth : -1], named[i][0]))
        )

    names = []
    for i, path in enumerate(paths):
        others = [k for k, other in enumerate(paths) if other != path]
        deepest = len(path.parts) - 1 if path is not None else 0
        depths = (d for d in range(deepest) if all(at(d, k) != at(d, i) for k in others))
        depth = next(depths, None)
        # Files of one folder that differ by their endings only keep them.
        ending = path.suffix if depth is None and path is not None else ""
        names.append(at(depth or 0, i) + ending)
    return names


def _ranged(name: str, source: Source) -> str:
    """The name, with the range of frames if the request has one."""
    if source.request.frames is None:
        return name
    if source.frames is None:
        return f"{name}[{source.request.frames}]"
    return f"{name}[{source.frames[0]}:{source.frames[1]}]"


def _expanded(request: Request) -> list[Request]:
    if request.path is None or not request.path.is_dir() or is_dataset(request.path):
        return [request]
    paths = sorted(files_below(request.path), key=lambda path: path.as_posix())
    recordings = [
        replace(request, path=path)
        for path in paths
        if is_dataset(path) or (named_as_recording(path) and not only_commands(path))
    ]
    return recordings or [request]


def _load(request: Request) -> Source:
    name = f"{SYNTHETIC}-{request.seed}" if request.path is None else request.path.stem
    try:
        recording = _read(request)
        total = len(recording)
        cut = slice(0, total) if request.frames is None else frame_slice(request.frames, total)
        chosen = recording[cut]
        valid = chosen.valid
        if valid is None or not valid.any():
            raise RecordingError(f"{request.path}: none of these frames contains a valid landmark")
    except SmoothOperatorError as error:
        return Source(request, name, error=str(error))
    return Source(
        request,
        recording.name if request.path is None else name,
        replace(chosen, meta={key: recording.meta[key] for key in _NOTED if key in recording.meta}),
        frames=(cut.start, cut.stop),
        digest=_digest(chosen),
    )


def _read(request: Request) -> HandRecording:
    if request.path is None:
        recording = request.operator().record(SYNTHETIC_SECONDS)
        return replace(recording, name=recording.name + _suffix(request))
    if request.path.is_dir() and not is_dataset(request.path):
        raise RecordingError(
            f"{request.path}: the folder and its subfolders contain no recordings; expected "
            f"names that end in {', '.join(recording_suffixes())}"
        )
    path = request.path

    def read(rate: float | None) -> HandRecording:
        return read_recording(path, rate=rate, side=request.side, layout=request.layout)

    # The rate is meant for those files among many that hold no stamps.
    return rated_if_unstamped(read, request.rate)[0]


def _suffix(request: Request) -> str:
    """Suffix that distinguishes the built-in operator's recordings of one seed."""
    length = "" if request.hand_length is None else f"+{1e2 * request.hand_length:g}cm"
    speed = "" if request.speed == 1.0 else f"+{request.speed:g}x"
    tracker = f"+{request.tracker}" if request.tracker else ""
    return length + speed + tracker


def _digest(recording: HandRecording) -> str:
    assert recording.valid is not None  # filled in on construction
    points = np.where(recording.valid[..., None], recording.landmarks, np.nan)
    total = hashlib.sha256(recording.side.encode())
    for array in (points, recording.stamps):
        total.update(np.ascontiguousarray(array, "<f8").tobytes())
    return total.hexdigest()
