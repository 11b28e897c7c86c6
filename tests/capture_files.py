"""Body captures as BVH text, written from the makers' texts; no code of the readers is used.

The skeleton is the arms of Noitom's template (NeuronDataReader, appendix B), in centimetres: the
person looks along z in a T pose, y up, x to the left. Expected places are by SciPy's rotations.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from smooth_operator.types import Side

_FINGERS = {
    "Thumb": ((2.418, 0.185, 3.031), (3.578, 0, 0), (2.485, 0, 0), (2.2, 0, 0)),
    "Index": ((3.132, 0.494, 1.922), (5.068, -0.089, 0.971), (3.516, 0, 0), (1.993, 0, 0)),
    "Middle": ((3.285, 0.502, 0.735), (5.026, -0.082, 0.305), (3.837, 0, 0), (2.405, 0, 0)),
    "Ring": ((3.269, 0.523, -0.125), (4.502, -0.021, -0.465), (3.344, 0, 0), (2.32, 0, 0)),
    "Pinky": ((3.071, 0.456, -1.167), (4.023, -0.021, -1.059), (2.678, 0, 0), (1.692, 0, 0)),
}
_TIP_CM = (2.1, 0.0, 0.0)

Tree = list[tuple[str, str, tuple[float, float, float]]]
"""(name, parent, offset) of each joint after its parent; the name of a tip ends with ``End``."""


def arms(sides: Sequence[Side] = ("right", "left")) -> Tree:
    """Joints of the spine, the arms and the hands [cm]."""
    tree: Tree = [("Hips", "", (0, 84.1, 0)), ("Spine2", "Hips", (0, 34.0, 0))]
    for side in sides:
        sign, word = (-1, "Right") if side == "right" else (1, "Left")

        def add(name: str, parent: str, offset: Sequence[float], sign: int = sign) -> None:
            tree.append((name, parent, (sign * offset[0], offset[1], offset[2])))

        add(f"{word}Arm", "Spine2", (14.0, 11.7, 0))
        add(f"{word}ForeArm", f"{word}Arm", (25.0, 0, 0))
        add(f"{word}Hand", f"{word}ForeArm", (25.0, 0, 0))
        for finger, offsets in _FINGERS.items():
            parent = f"{word}Hand"
            if finger != "Thumb":
                add(f"{word}InHand{finger}", parent, offsets[0])
                parent = f"{word}InHand{finger}"
                offsets = (*offsets[1:], _TIP_CM)
            for number, offset in enumerate(offsets[:3], 1):
                add(f"{word}Hand{finger}{number}", parent, offset)
                parent = f"{word}Hand{finger}{number}"
            add(f"{parent}End", parent, offsets[3])
    return tree


def angles(tree: Tree, count: int, seed: int = 5) -> np.ndarray:
    """(T, J, 3) rotations [deg] about y, x and z of joints in T frames: arms and bent fingers."""
    random = np.random.default_rng(seed)
    turns = np.zeros((count, len(tree), 3))
    for joint, (name, _, _) in enumerate(tree):
        sign = 1.0 if "Right" in name else -1.0
        move = np.sin(np.linspace(0, 6, count) + random.uniform(0, 6))
        if "Arm" in name or name in ("Hips", "Spine2"):
            turns[:, joint] = np.outer(move, random.uniform(5, 25, 3))
        elif name.endswith(("1", "2", "3")) and "Thumb" not in name:
            turns[:, joint, 2] = sign * (30 + 25 * move)
        elif name.endswith(("2", "3")):
            turns[:, joint, 0] = sign * (15 + 10 * move)
    return turns


def places(tree: Tree, turns: np.ndarray, order: str, moved: np.ndarray) -> dict[str, np.ndarray]:
    """(T, 3) place of each joint, for rotations about y, x, z in the order ``order``."""
    where: dict[str, np.ndarray] = {}
    facing: dict[str, Rotation] = {}
    for joint, (name, parent, offset) in enumerate(tree):
        own = turns[:, joint][:, ["YXZ".index(axis) for axis in order]]
        local = Rotation.from_euler(order, own, degrees=True)
        if parent:
            where[name] = where[parent] + facing[parent].apply(np.asarray(offset, float))
            facing[name] = facing[parent] * local
        else:
            where[name], facing[name] = moved, local
    return where


def numbers(
    tree: Tree, turns: np.ndarray, order: str, moved: np.ndarray, displaced: bool
) -> np.ndarray:
    """(T, C) numbers of frames: positions of the root (or of all), then rotations in ``order``."""
    columns = []
    for joint, (name, parent, offset) in enumerate(tree):
        if name.endswith("End"):
            continue
        if not parent:
            columns.append(moved)
        elif displaced:
            columns.append(np.tile(np.asarray(offset, float), (len(turns), 1)))
        columns.append(turns[:, joint][:, ["YXZ".index(axis) for axis in order]])
    return np.concatenate(columns, axis=1)


def bvh(
    tree: Tree,
    frames: np.ndarray,
    order: str = "YXZ",
    displaced: bool = False,
    period: float = 0.01,
    rename: Callable[[str], str] = str,
    scale: float = 1.0,
) -> str:
    """Text of a file; ``scale`` changes the unit from centimetres."""
    turns = " ".join(f"{axis}rotation" for axis in order)
    lines = ["HIERARCHY"]

    def write(name: str, parent: str, offset: Sequence[float], depth: str) -> None:
        kind = "JOINT" if parent else "ROOT"
        lines.append(f"{depth}{'End Site' if name.endswith('End') else f'{kind} {rename(name)}'}")
        lines.append(f"{depth}{{")
        lines.append(f"{depth}  OFFSET " + " ".join(f"{scale * v:.6f}" for v in offset))
        if not name.endswith("End"):
            place = "Xposition Yposition Zposition " if displaced or not parent else ""
            lines.append(f"{depth}  CHANNELS {6 if place else 3} {place}{turns}")
        for child in tree:
            if child[1] == name:
                write(*child, f"{depth}  ")
        lines.append(f"{depth}}}")

    write(*tree[0], "")
    lines += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {period}"]
    lines += [" ".join(f"{value:.5f}" for value in row) for row in frames]
    return "\n".join(lines) + "\n"


def in_file_order(tree: Tree) -> Tree:
    """Joints in the order of a file: each with all that follows it, depth first."""
    out: Tree = []

    def visit(one: tuple[str, str, tuple[float, float, float]]) -> None:
        out.append(one)
        for child in tree:
            if child[1] == one[0]:
                visit(child)

    visit(tree[0])
    return out


def landmarks(where: dict[str, np.ndarray], side: Side) -> np.ndarray:
    """(T, 21, 3) landmarks in the file's axes and unit."""
    word = side.title()
    names = [f"{word}Hand"]
    for finger in _FINGERS:
        names += [f"{word}Hand{finger}{number}" for number in (1, 2, 3)]
        names.append(f"{names[-1]}End")
    return np.stack([where[name] for name in names], axis=1)
