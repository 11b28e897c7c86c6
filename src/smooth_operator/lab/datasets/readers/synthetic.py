"""A corpus of any size that exists as a description alone: clips are made when they are read."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator import poses
from smooth_operator.atomic_files import write_json
from smooth_operator.errors import ConfigError, DocumentError, RecordingError, brief
from smooth_operator.io.documents import read_json
from smooth_operator.lab.datasets.clip import SIDES, Clip
from smooth_operator.lab.datasets.registry import ClipRef, ReadingOptions
from smooth_operator.synthetic.operator import SyntheticOperator
from smooth_operator.synthetic.tracker import WristMotion, check_range, check_seed
from smooth_operator.types import HandRecording, Side, as_side

SUFFIX: Final = ".synthetic.json"
"""What the name of a description ends with."""

FORMAT: Final = "smooth-operator synthetic corpus 1"

_MOST_CLIPS: Final = 100_000_000
_FILM_S: Final = 64.0
"""Length of what a person does before the same motion comes again [s]."""

_PALM_DOWN: Final = poses.axes("z", "y", "-x")  # the wrist's axes in those of the operator's hand


@dataclass(frozen=True)
class SyntheticCorpus:
    """Clips of synthetic operators, each a function of the corpus' seed and its own number.

    A person is a ``SyntheticOperator`` that is recorded once in each process. A clip is a stretch
    of this recording, at a place, with a size of the hand and a motion of the wrist of its own. So
    no two clips are the same, and a clip takes a millisecond, where a new person would take longer
    than retargeting does.

    Attributes:
        clips: number of clips.
        shortest: least length of a clip [s].
        longest: greatest length [s]; lengths are drawn evenly between both.
        rate_hz: frames a second.
        sides: sides of the hands.
        people: number of different persons.
        lost: share of the clips in which a hand is out of sight for a while.
        seed: seed of all random numbers.

    Raises:
        ConfigError: a value is outside its range.
    """

    clips: int = 1000
    shortest: float = 2.0
    longest: float = 20.0
    rate_hz: float = 30.0
    sides: tuple[Side, ...] = SIDES
    people: int = 16
    lost: float = 0.05
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "sides", tuple(as_side(side) for side in self.sides))
        check_range("clips", self.clips, 1, _MOST_CLIPS)
        check_range("shortest", self.shortest, 0.1, _FILM_S / 2, "s")
        check_range("longest", self.longest, self.shortest, _FILM_S / 2, "s")
        check_range("rate_hz", self.rate_hz, 5.0, 1000.0, "Hz")
        check_range("people", self.people, 1, 1000)
        check_range("lost", self.lost, 0.0, 1.0)
        check_seed("seed", self.seed)
        if not self.sides or len(set(self.sides)) < len(self.sides):
            raise ConfigError("sides must name 'right', 'left' or both")

    def write(self, path: Path) -> None:
        """Writes the description.

        Raises:
            ConfigError: the name does not end in ``SUFFIX``.
            OutputError: it can't be written.
        """
        if not path.name.endswith(SUFFIX):
            raise ConfigError(f"the name of a synthetic corpus must end in {SUFFIX}, not {path}")
        write_json(path, {"format": FORMAT, **dataclasses.asdict(self)}, indent=2)

    def clip(self, number: int, name: str = "", source: tuple[Path, ...] = ()) -> Clip:
        """One clip.

        Args:
            number: from 0 to ``clips`` - 1.
            name: of the clip; its number if left out.
            source: the description's file.
        """
        rng = np.random.default_rng([self.seed, 0xC1, number])
        count = max(2, round(rng.uniform(self.shortest, self.longest) * self.rate_hz))
        person = int(rng.integers(self.people))
        size = rng.uniform(0.9, 1.1)
        stamps = np.arange(count) / self.rate_hz
        hands, confidence, task = {}, {}, ""
        for side in self.sides:
            film, labels = _film(self.seed, person, side, self.rate_hz)
            first = int(rng.integers(len(film) - count))
            shown = film[first : first + count] * size
            wrist = _wrist(rng, side, stamps)
            landmarks = wrist[:, None, :3] + poses.rotate(wrist[:, None, 3:], shown)
            sure = np.ones(count)
            if rng.random() < self.lost:
                start, length = rng.integers(count), rng.integers(1, max(2, count // 3))
                sure[start : start + length] = 0.0
                landmarks[sure == 0.0] = np.nan
                wrist = np.where(sure[:, None] == 0.0, np.nan, wrist)
            hands[side] = HandRecording(
                landmarks, stamps, side, T_world_wrist=wrist, world="synthetic", name=name
            )
            confidence[side] = sure
            task = task or labels[first + count // 2].replace("_", " ")
        meta = {"person": person, "hand_scale": size}
        return Clip(
            name or f"{number:09d}", hands, "synthetic", source, task, confidence, meta=meta
        )


def read_corpus(path: Path) -> SyntheticCorpus:
    """The description in a file.

    Raises:
        RecordingError: it is none.
    """
    try:
        content: Any = read_json(path)
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: not the description of a synthetic corpus: {error}") from (
            error
        )
    if not isinstance(content, dict) or content.pop("format", None) != FORMAT:
        raise RecordingError(f'{path}: expected a JSON object with "format": {json.dumps(FORMAT)}')
    names = {field.name for field in dataclasses.fields(SyntheticCorpus)}
    if extra := sorted(set(content) - names):
        raise RecordingError(
            f"{path}: unknown {', '.join(extra)}; a synthetic corpus has {', '.join(sorted(names))}"
        )
    for name, value in content.items():
        kind = type(getattr(SyntheticCorpus, name))
        fits = isinstance(value, int | float if kind is float else list if kind is tuple else kind)
        if not fits or isinstance(value, bool):
            raise RecordingError(f"{path}: {name} must be a {kind.__name__}, not {brief(value)}")
    try:
        return SyntheticCorpus(**content)
    except (ConfigError, TypeError) as error:
        raise RecordingError(f"{path}: {error}") from error


class Synthetic:
    """Reader of descriptions of synthetic corpora."""

    what = "a synthetic corpus"
    expects = f'a JSON file *{SUFFIX} with "format": "{FORMAT}"'

    def matches(self, path: Path) -> bool:
        """True if the file's name is that of a description."""
        return path.name.endswith(SUFFIX) and path.is_file()

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """The clips; each bears its number alone.

        Raises:
            RecordingError: as ``read_corpus``.
        """
        stem = path.name.removesuffix(SUFFIX)
        for number in range(read_corpus(path).clips):
            yield ClipRef(f"{stem}/{number:09d}", path, str(number), "synthetic")

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Makes the clip; the options are for layouts of files.

        Raises:
            RecordingError: as ``read_corpus``, or there is no such clip.
        """
        corpus = _corpus(ref.path, ref.path.stat().st_mtime_ns)
        if not ref.key.isdecimal() or int(ref.key) >= corpus.clips:
            last = corpus.clips - 1
            raise RecordingError(f"{ref.path}: it has no clip {ref.key!r}, but 0 to {last}")
        return corpus.clip(int(ref.key), ref.name, (ref.path,))


@functools.lru_cache(maxsize=8)
def _corpus(path: Path, _modified_ns: int) -> SyntheticCorpus:
    return read_corpus(path)


@functools.lru_cache(maxsize=2048)
def _film(seed: int, person: int, side: Side, rate: float) -> tuple[np.ndarray, list[str]]:
    """(T, 21, 3) landmarks from the wrist in its axes [m], and the gesture of each frame."""
    # The hands of a person are different recordings: both do not move in step.
    operator = SyntheticOperator(
        seed=(seed * 1009 + person) * 2 + (side == "left"), side=side, rate_hz=rate
    )
    recording = operator.record(_FILM_S)
    shown = poses.points_to_ours(recording.landmarks - recording.landmarks[:, :1], _PALM_DOWN)
    shown.setflags(write=False)
    return shown, recording.meta["gesture"]


def _wrist(rng: np.random.Generator, side: Side, stamps: np.ndarray) -> np.ndarray:
    """(T, 7) poses of a wrist that moves a few centimetres at chest height, z up [m]."""
    motion = WristMotion(0.05, 0.25, int(rng.integers(2**31)))
    place, turn = motion.at(stamps)
    at = np.array([0.35, -0.15 if side == "right" else 0.15, 1.1])
    return np.concatenate([at + place, poses.from_rotation_vectors(turn)], axis=-1)


SYNTHETIC: Final = Synthetic()
