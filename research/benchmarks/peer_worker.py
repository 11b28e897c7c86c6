"""Runs one retargeter on one recording in its own environment, started by ``peers.py``.

    PYTHON research/benchmarks/peer_worker.py PROGRAM RECORDING.npz OUTPUT.npz

It needs NumPy and the package of the program only. The recording has ``landmarks`` (T, 21, 3) in
the wrist's axes (x to the base of the middle finger, z out of the back of the hand) [m] and
``stamps`` [s], all of a right hand. Commands, their joints' names and the time of each frame are
written; a line of JSON says when the first command was there.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Prepare = Callable[[Any, Any], list[Any]]
"""Landmarks and stamps of a recording -> what the program takes, frame by frame."""


def smooth_operator(hand: str, method: str, _: str) -> tuple[Prepare, Callable[[Any], Any], Any]:
    from smooth_operator import HandFrame, Retargeter  # type: ignore[import-not-found,unused-ignore]
    from smooth_operator.retargeting import (  # type: ignore[import-not-found,unused-ignore]
        ProgramStore,
    )

    name, _, preset = method.partition(":")
    retargeter = Retargeter(hand, method=name, preset=preset or None, cache=ProgramStore.of_user())

    def prepare(landmarks: Any, stamps: Any) -> list[Any]:
        return [HandFrame(p, stamp=s) for p, s in zip(landmarks, stamps, strict=True)]

    return (
        prepare,
        lambda frame: retargeter(frame).command.joint_positions,
        retargeter.hand.joint_names,
    )


def wuji_sdk(*_: str) -> tuple[Prepare, Callable[[Any], Any], Any]:
    from wuji_sdk import (  # type: ignore[import-not-found,unused-ignore]
        Handedness,
        HandModel,
        RetargetSession,
    )

    session = RetargetSession.for_hand(HandModel.WujiHand, Handedness.Right)
    names = [f"right_finger{1 + i // 4}_joint{1 + i % 4}" for i in range(20)]  # firmware order
    return lambda landmarks, _: list(landmarks.astype(np.float32)), session.step, names


def dex_retargeting(hand: str, kind: str, urdf: str) -> tuple[Prepare, Callable[[Any], Any], Any]:
    from dex_retargeting.constants import (  # type: ignore[import-not-found,unused-ignore]
        HandType,
        RetargetingType,
        RobotName,
        get_default_config_path,
    )
    from dex_retargeting.retargeting_config import (  # type: ignore[import-not-found,unused-ignore]
        RetargetingConfig,
    )

    RetargetingConfig.set_default_urdf_dir(urdf)
    path = get_default_config_path(
        RobotName[hand.removesuffix("_hand")], RetargetingType[kind], HandType.right
    )
    retargeter = RetargetingConfig.load_from_file(path).build()
    origin, end = retargeter.optimizer.target_link_human_indices

    def prepare(landmarks: Any, _: Any) -> list[Any]:
        x, y, z = np.moveaxis(landmarks, -1, 0)
        return list(np.stack([-z, y, x], axis=-1))  # MANO's axes, which its settings expect

    step = lambda frame: retargeter.retarget(frame[end] - frame[origin])  # noqa: E731
    return prepare, step, retargeter.joint_names


PROGRAMS = {
    "smooth-operator": smooth_operator,
    "wuji-sdk": wuji_sdk,
    "dex-retargeting": dex_retargeting,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("program", choices=list(PROGRAMS))
    parser.add_argument("recording", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--hand", default="", help="our name of the hand")
    parser.add_argument("--method", default="", help="method of smooth-operator or dex-retargeting")
    parser.add_argument("--urdf", default="", help="folder with HAND/HAND_right.urdf")
    options = parser.parse_args()
    build = PROGRAMS[options.program]
    prepare, step, names = build(options.hand, options.method, options.urdf)
    with np.load(options.recording) as file:
        frames = prepare(file["landmarks"], file["stamps"])
    commands = [np.array(step(frames[0]), float)]
    first = time.time()
    seconds = []
    for frame in frames[1:]:
        before = time.perf_counter()
        command = step(frame)
        seconds.append(time.perf_counter() - before)
        commands.append(np.array(command, float))
    np.savez(options.output, q=np.stack(commands), names=list(names), ms=np.array(seconds) * 1e3)
    print(json.dumps({"first": first}))


if __name__ == "__main__":
    main()
