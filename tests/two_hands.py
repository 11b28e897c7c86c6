"""A layout for tests: both hands of a clip in one ``.pair.npz``, made by the built-in operator."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import SIDES, Clip, ClipRef, ReadingOptions
from smooth_operator.reporter import Reporter
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.tracker import WristMotion
from smooth_operator.types import HandRecording

SUFFIX = ".pair.npz"


class Counting(Reporter):
    """Number of clips of a run, and of those that an earlier run finished.

    Attributes:
        again: what is said of results that are made again.
    """

    items = kept = 0
    again = ""

    def note(self, text: str, *, matters: bool = False) -> None:
        if counts := re.match(r"(\d+) to retarget, (\d+) already done", text):
            self.kept = int(counts[2])
            self.items = self.kept + int(counts[1])
        elif "again" in text:
            self.again = text.partition(":")[0]


LAYOUT = "two_hands:PAIRS"


class Pairs:
    what = "a pair of hands"
    expects = "a file NAME.pair.npz with stamps, and landmarks and wrist of each side"

    def matches(self, path: Path) -> bool:
        return path.name.endswith(SUFFIX) and path.is_file()

    def clips(self, path: Path) -> Iterator[ClipRef]:
        yield ClipRef(path.name.removesuffix(SUFFIX), path, size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        try:
            with np.load(ref.path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
        except Exception as error:
            raise RecordingError(f"{ref.path}: can't be read: {error}") from error
        hands = {
            side: HandRecording(
                arrays[f"{side}_landmarks"],
                arrays["stamps"],
                side,
                T_world_wrist=arrays[f"{side}_wrist"],
                world="room",
            )
            for side in SIDES
            if f"{side}_landmarks" in arrays
        }
        sure = {s: arrays[f"{s}_confidence"] for s in SIDES if f"{s}_confidence" in arrays}
        task = str(arrays["task"]) if "task" in arrays else None
        meta = {"operator": "built-in"}
        camera = arrays.get("camera")
        return Clip(ref.name, hands, "pairs", (ref.path,), task, sure, camera, meta=meta)


PAIRS = Pairs()


def save_pair(path: Path, frames: int, seed: int = 0, **more: Any) -> dict[str, np.ndarray]:
    """Writes a clip of two hands at 50 Hz; ``more`` replaces arrays. Returns them."""
    arrays: dict[str, Any] = {}
    for number, side in enumerate(SIDES):
        operator = SyntheticOperator(
            seed=seed + 10 * number,
            side=side,
            rate_hz=50.0,
            wrist=WristMotion(translation=0.05, rotation=0.2),
        )
        recording = operator.record((frames + 0.5) / 50.0)[:frames]
        arrays["stamps"] = recording.stamps
        arrays[f"{side}_landmarks"] = recording.landmarks
        arrays[f"{side}_wrist"] = recording.T_world_wrist
    arrays |= more
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return arrays


def save_pairs(folder: Path, clips: int) -> Path:
    """Writes clips of 10 frames and more; in every second one the right hand is lost in the end."""
    for number in range(clips):
        frames = 10 + 3 * number
        sure = np.ones(frames)
        sure[frames - 4 :] = number % 2
        save_pair(
            folder / f"{number:02d}{SUFFIX}",
            frames,
            number,
            task=f"task {number}",
            right_confidence=sure,
            left_confidence=np.full(frames, 0.75),
        )
    return folder
