"""dex-retargeting over a folder of recordings, in an environment of its own; ``batch.py`` runs it.

    OTHER_PYTHON research/benchmarks/dex_retargeting_folder.py FOLDER --urdf HANDS --workers 2

It needs NumPy and dex-retargeting only. The recordings are ``.npz`` files with ``landmarks`` in the
wrist's axes (x to the base of the middle finger, z out of the back of the hand). The settings are
those that come with dex-retargeting for live use. Each worker takes recordings in turn; a line of
JSON for each says when it was done.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from pathlib import Path
from typing import Any

import numpy as np

_made: dict[str, Any] = {}


def build(urdf: str, robot: str, kind: str) -> Any:
    from dex_retargeting.constants import (  # type: ignore[import-not-found]
        HandType,
        RetargetingType,
        RobotName,
        get_default_config_path,
    )
    from dex_retargeting.retargeting_config import RetargetingConfig  # type: ignore[import-not-found]

    RetargetingConfig.set_default_urdf_dir(urdf)
    path = get_default_config_path(RobotName[robot], RetargetingType[kind], HandType.right)
    return RetargetingConfig.load_from_file(path).build()


def retarget(task: tuple[str, str, str, str]) -> tuple[int, float, float]:
    """Frames, seconds of the frames alone, and the median time of one [ms]."""
    path, *settings = task
    if not _made:
        _made["it"] = build(*settings)
    retargeter = _made["it"]
    retargeter.reset()
    with np.load(path) as file:
        x, y, z = np.moveaxis(file["landmarks"], -1, 0)
    human = np.stack([-z, y, x], axis=-1)  # the axes of MANO's hand, which its settings expect
    origin, end = retargeter.optimizer.target_link_human_indices
    times, answers = [], []
    for frame in human:
        before = time.perf_counter()
        answers.append(retargeter.retarget(frame[end] - frame[origin]))
        times.append(time.perf_counter() - before)
    np.savez(Path(path).with_suffix(".commands.npz"), joint_positions=np.stack(answers))
    return len(human), sum(times), float(np.median(times)) * 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--urdf", required=True, help="folder with leap_hand/leap_hand_right.urdf")
    parser.add_argument("--robot", default="leap")
    parser.add_argument("--kind", default="vector", choices=("vector", "dexpilot"))
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    started = time.perf_counter()
    files = sorted(p for p in options.folder.glob("*.npz") if ".commands" not in p.name)
    tasks = [(str(path), options.urdf, options.robot, options.kind) for path in files]
    with multiprocessing.get_context("spawn").Pool(options.workers) as pool:
        for frames, seconds, median in pool.imap_unordered(retarget, tasks):
            at = time.perf_counter() - started
            print(json.dumps({"frames": frames, "seconds": seconds, "p50_ms": median, "at": at}))


if __name__ == "__main__":
    main()
