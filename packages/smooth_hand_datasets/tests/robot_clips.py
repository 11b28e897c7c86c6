"""Robot clips for tests of writers: smooth motion made with NumPy, nothing is retargeted."""

from pathlib import Path
from typing import Any

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_operator.formats.clip import Clip, ObjectTrack
from smooth_operator.types import CommandTrajectory, HandRecording, Side

JOINTS = ("thumb", "index_a", "index_b", "middle", "ring", "pinky")
CONFIG = {"method": "smooth", "preset": "live"}

# A flat right hand, palm down, fingers along x, thumb to the left (y): wrist, then each finger.
_SPREAD = {"thumb": 0.04, "index": 0.025, "middle": 0.0, "ring": -0.02, "pinky": -0.04}
_BASE = {"thumb": 0.02, "index": 0.09, "middle": 0.095, "ring": 0.09, "pinky": 0.08}


def hand_points(side: Side) -> np.ndarray:
    """(21, 3) landmarks of a hand at the origin whose wrist frame is that of the world."""
    points = [np.zeros(3)]
    for finger, y in _SPREAD.items():
        points += [np.array([_BASE[finger] + 0.025 * k, y, -0.004 * k * k]) for k in range(4)]
    found = np.array(points)
    return found if side == "right" else found * [1.0, -1.0, 1.0]


def poses_along(stamps: np.ndarray, seed: int) -> np.ndarray:
    """(T, 7) a slow movement through the room."""
    phase = 0.7 * seed + stamps[:, None] * [0.9, 1.1, 1.3]
    place = 0.2 * np.sin(phase) + [0.5, 0.1 * seed, 1.0]
    axis = np.array([0.36, 0.48, 0.8])
    half = 0.3 * np.sin(0.5 * stamps + seed)[:, None]
    return np.concatenate([place, np.cos(half), np.sin(half) * axis], axis=1)


def rotation(q: np.ndarray) -> np.ndarray:
    """(T, 3, 3) matrices of quaternions wxyz, written out."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def robot_clip(
    number: int = 0,
    *,
    frames: int = 40,
    rate: float = 30.0,
    sides: tuple[Side, ...] = ("right", "left"),
    objects: int = 1,
    mesh: Path | None = None,
    wrists: bool = True,
    world: str = "room",
    **changes: Any,
) -> RobotClip:
    """One clip of either hand moving; ``changes`` are fields of ``Clip``."""
    stamps = 100.0 * number + np.arange(frames) / rate
    time = stamps - 100.0 * number
    hands: dict[Side, HandRecording] = {}
    commands: dict[Side, CommandTrajectory] = {}
    robot: dict[Side, np.ndarray] = {}
    for k, side in enumerate(sides):
        wrist = poses_along(time, number % 7 + 3 * k)
        turned = np.einsum("tij,lj->tli", rotation(wrist[:, 3:]), hand_points(side))
        hands[side] = HandRecording(
            turned + wrist[:, None, :3],
            stamps,
            side,
            T_world_wrist=wrist if wrists else None,
            world=world if wrists else None,
        )
        speed = np.arange(1, len(JOINTS) + 1)
        joints = 0.5 + 0.4 * np.sin(time[:, None] * speed + number + k)
        commands[side] = CommandTrajectory(
            joints, JOINTS, stamps, np.full(frames, 0.4), np.zeros(frames, int)
        )
        robot[side] = wrist if wrists else np.full((frames, 7), np.nan)
    fields: dict[str, Any] = {
        "name": f"part1/pick/{number}",
        "hands": hands,
        "layout": "files",
        "source": (Path(f"in/{number}.npz"),),
        "task": "pick up the cup",
        "confidence": {side: np.full(frames, 0.9) for side in sides},
        "T_world_camera": poses_along(time, 5) if wrists else None,
        "objects": tuple(
            ObjectTrack(f"cup {i}", poses_along(time, 2 * i), mesh) for i in range(objects)
        ),
        **changes,
    }
    return RobotClip(
        Clip(**fields),
        commands,
        dict.fromkeys(sides, "mimic_p050"),
        robot,
        {side: np.ones(frames, bool) for side in sides},
        figures={"jump_mm": 1.5 + number},
        config=CONFIG,
        key=f"{number:064x}",
    )
