"""A layout of made clips: a file names their number, and each is made when it is read."""

import functools
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import SIDES, Clip, ClipRef, ReadingOptions
from smooth_operator.synthetic import SyntheticOperator, WristMotion
from smooth_operator.types import HandRecording, Side

LAYOUT = "made_clips:CLIPS"
RATE = 30.0
_PALM_DOWN = poses.axes("z", "y", "-x")  # the wrist's axes in those of the operator's hand


def write(path: Path, clips: int, seconds: tuple[float, float], lost: float = 0.0) -> Path:
    """Writes the file; a hand is out of sight for a while in a share of the clips."""
    path.write_text(json.dumps({"clips": clips, "seconds": seconds, "lost": lost}))
    return path


def made_clip(
    number: int,
    seconds: tuple[float, float],
    lost: float = 0.0,
    name: str = "",
    source: tuple[Path, ...] = (),
) -> Clip:
    """Both hands and their wrists; a function of the number."""
    rng = np.random.default_rng(number)
    count = max(2, round(rng.uniform(*seconds) * RATE))
    stamps = np.arange(count) / RATE
    hands, confidence, task = {}, {}, ""
    for side in SIDES:
        film, labels = _film(side)
        first = int(rng.integers(len(film) - count))
        place, turn = WristMotion(0.05, 0.25, int(rng.integers(2**31))).at(stamps)
        at = np.array([0.35, -0.15 if side == "right" else 0.15, 1.1])
        wrist = np.concatenate([at + place, poses.from_rotation_vectors(turn)], axis=-1)
        shown = film[first : first + count]
        landmarks = wrist[:, None, :3] + poses.rotate(wrist[:, None, 3:], shown)
        sure = np.ones(count)
        if rng.random() < lost:
            start = int(rng.integers(count))
            sure[start : start + count // 3] = 0.0
            landmarks[sure == 0.0] = np.nan
            wrist = np.where(sure[:, None] == 0.0, np.nan, wrist)
        hands[side] = HandRecording(
            landmarks, stamps, side, T_world_wrist=wrist, world="made", name=name
        )
        confidence[side] = sure
        task = task or labels[first].replace("_", " ")
    return Clip(
        name or f"{number:04d}", hands, "made", source, task, confidence, meta={"n": number}
    )


@functools.cache
def _film(side: Side) -> tuple[np.ndarray, list[str]]:
    recording = SyntheticOperator(seed=side == "left", side=side, rate_hz=RATE).record(8.0)
    shown = poses.points_to_ours(recording.landmarks - recording.landmarks[:, :1], _PALM_DOWN)
    return shown, recording.meta["gesture"]


class MadeClips:
    """Reader of the files that ``write`` writes."""

    what = "made clips"
    expects = "a file *.made.json"

    def matches(self, path: Path) -> bool:
        return path.name.endswith(".made.json")

    def clips(self, path: Path) -> Iterator[ClipRef]:
        for number in range(json.loads(path.read_text())["clips"]):
            yield ClipRef(f"made/{number:04d}", path, str(number), LAYOUT)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        about = json.loads(ref.path.read_text())
        if int(ref.key) >= about["clips"]:
            raise RecordingError(f"{ref.path}: it has no clip {ref.key!r}")
        return made_clip(int(ref.key), about["seconds"], about["lost"], ref.name, (ref.path,))


CLIPS = MadeClips()
