"""One retargeter over one recording, in an environment of its own; ``peers.py`` runs it.

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
from typing import Any

import numpy as np

Step = Callable[[int], Any]
"""The command of a frame, by its number."""


def smooth_operator(hand: str, method: str, landmarks: Any, stamps: Any) -> tuple[Step, Any]:
    from smooth_operator import HandFrame, Retargeter  # type: ignore[import-not-found,unused-ignore]

    name, _, preset = method.partition(":")
    retargeter = Retargeter(hand, method=name, preset=preset or None)

    def step(i: int) -> Any:
        return retargeter(HandFrame(landmarks[i], stamp=stamps[i])).command.positions

    return step, retargeter.hand.joint_names


def wuji_sdk(landmarks: Any) -> tuple[Step, Any]:
    from wuji_sdk import (  # type: ignore[import-not-found,unused-ignore]
        Handedness,
        HandModel,
        RetargetSession,
    )

    session = RetargetSession.for_hand(HandModel.WujiHand, Handedness.Right)
    points = landmarks.astype(np.float32)
    names = [f"right_finger{1 + i // 4}_joint{1 + i % 4}" for i in range(20)]  # firmware order
    return lambda i: session.step(points[i]), names


def dex_retargeting(kind: str, urdf: str, landmarks: Any) -> tuple[Step, Any]:
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
    path = get_default_config_path(RobotName.leap, RetargetingType[kind], HandType.right)
    retargeter = RetargetingConfig.load_from_file(path).build()
    x, y, z = np.moveaxis(landmarks, -1, 0)
    human = np.stack([-z, y, x], axis=-1)  # the axes of MANO's hand, which its settings expect
    origin, end = retargeter.optimizer.target_link_human_indices

    def step(i: int) -> Any:
        return retargeter.retarget(human[i][end] - human[i][origin])

    return step, retargeter.joint_names


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("program", help="smooth-operator, wuji-sdk or dex-retargeting")
    parser.add_argument("recording")
    parser.add_argument("output")
    parser.add_argument("--hand", default="", help="of smooth-operator")
    parser.add_argument("--method", default="", help="of smooth-operator or dex-retargeting")
    parser.add_argument("--urdf", default="", help="folder with leap_hand/leap_hand_right.urdf")
    parser.add_argument("--frames", type=int, default=None, help="so many only")
    options = parser.parse_args()
    with np.load(options.recording) as file:
        landmarks, stamps = file["landmarks"], file["stamps"]
    if options.program == "smooth-operator":
        step, names = smooth_operator(options.hand, options.method, landmarks, stamps)
    elif options.program == "wuji-sdk":
        step, names = wuji_sdk(landmarks)
    else:
        step, names = dex_retargeting(options.method, options.urdf, landmarks)
    commands = [np.array(step(0), float)]
    first = time.time()
    seconds = []
    for i in range(1, len(landmarks) if options.frames is None else options.frames):
        before = time.perf_counter()
        command = step(i)
        seconds.append(time.perf_counter() - before)
        commands.append(np.array(command, float))
    np.savez(options.output, q=np.stack(commands), names=list(names), ms=np.array(seconds) * 1e3)
    print(json.dumps({"first": first}))


if __name__ == "__main__":
    main()
