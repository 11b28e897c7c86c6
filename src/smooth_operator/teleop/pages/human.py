"""The human hand on the page: a mannequin of spheres and bones, in two batched nodes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Bool, Float, Int, UInt8

from smooth_operator.landmarks import BASES, BONES, NUM_LANDMARKS, WRIST
from smooth_operator.teleop.pages.hand_view import HIGHLIGHT, PALM, Rgb, finger_colors, linear

_JOINT, _WRIST, _TIP, _PINCHED = 0.0070, 0.0095, 0.0075, 0.0095  # sphere radii [m]
_BONE, _PALM_BONE = 0.0052, 0.0062  # bone radii [m]
# Across the knuckles: without them the palm is a fan of five rods and not a palm.
_LINKS = (*BONES, *pairwise(BASES))
_PARENTS, _CHILDREN = (np.array(column) for column in zip(*_LINKS, strict=True))


def add_balls(
    scene: viser.SceneApi,
    name: str,
    positions: Float[np.ndarray, "k 3"],
    radii: Float[np.ndarray, " k"],
    colors: UInt8[np.ndarray, "k 3"],
) -> Any:
    """Adds balls to a scene, which are drawn as one mesh; their node."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    return scene.add_batched_meshes_simple(
        name,
        ball.vertices,
        ball.faces,
        batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(positions), 1)),
        batched_positions=positions,
        batched_scales=radii,
        batched_colors=linear(colors),
        lod="off",
    )


class HumanView:
    """Draws the human landmarks of one frame; a frame costs at most five messages.

    Args:
        scene: where to draw.
        tips: (F,) landmarks of the fingertips that drive the robot, thumb first.
        root: name of the parent node, which places the whole hand.
    """

    def __init__(self, scene: viser.SceneApi, tips: Sequence[int], root: str) -> None:
        self._tips = np.array(tips)
        self._colors = np.tile(np.array(PALM, np.uint8), (NUM_LANDMARKS, 1))
        palette = finger_colors(len(tips))
        for tip, color in zip(self._tips, palette, strict=True):
            self._colors[tip - 3 : tip + 1] = color  # a finger's four landmarks end at its tip
        self._colors[WRIST] = PALM
        self._radii = np.full(NUM_LANDMARKS, _JOINT)
        self._radii[WRIST], self._radii[self._tips] = _WRIST, _TIP

        palm = np.array([p == WRIST or c in BASES for p, c in _LINKS])
        bone_colors = np.where(palm[:, None], np.array(PALM, np.uint8), self._colors[_CHILDREN])
        self._bone_radii = np.where(palm, _PALM_BONE, _BONE)

        rod = trimesh.creation.cylinder(radius=1.0, height=1.0, sections=20, cap=False)
        none = np.zeros((NUM_LANDMARKS, 3))
        self._joints = add_balls(
            scene, f"{root}/joints", none, np.zeros(NUM_LANDMARKS), self._colors
        )
        self._bones = scene.add_batched_meshes_simple(
            f"{root}/bones",
            rod.vertices,
            rod.faces,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(_LINKS), 1)),
            batched_positions=np.zeros((len(_LINKS), 3)),
            batched_scales=np.zeros((len(_LINKS), 3)),
            batched_colors=linear(bone_colors),
            lod="off",
        )

    def draw(self, landmarks: Float[np.ndarray, "21 3"], pinched: Bool[np.ndarray, " G"]) -> None:
        """Show one frame.

        Args:
            landmarks: (21, 3) [m]; NaN where there is none.
            pinched: (F-1,) which fingers pinch with the thumb; their tips are lit up and grow.
        """
        present = np.isfinite(landmarks).all(axis=-1)
        points = np.where(present[:, None], landmarks, 0.0)
        lit = lit_tips(pinched)
        radii, colors = self._radii.copy(), self._colors.copy()
        radii[self._tips[lit]], colors[self._tips[lit]] = _PINCHED, HIGHLIGHT
        self._joints.batched_positions = points
        # a missing landmark has size zero; unchanged arrays are not sent again
        self._joints.batched_scales = np.where(present, radii, 0.0)
        self._joints.batched_colors = linear(colors)

        start, end = points[_PARENTS], points[_CHILDREN]
        both = (present[_PARENTS] & present[_CHILDREN])[:, None]
        length = np.linalg.norm(end - start, axis=-1, keepdims=True)
        size = np.concatenate([np.repeat(self._bone_radii[:, None], 2, axis=1), length], axis=1)
        self._bones.batched_positions = (start + end) / 2
        self._bones.batched_wxyzs = _turn_z(end - start)
        self._bones.batched_scales = np.where(both, size, 0.0)


def lit_tips(pinched: Bool[np.ndarray, " G"]) -> Bool[np.ndarray, " F"]:
    """(F,) which fingertips take part in a pinch: the pinching fingers, and then the thumb."""
    return np.concatenate([[pinched.any()], pinched])


def keyvector_colors(fingers: int, pinched: Bool[np.ndarray, " G"]) -> UInt8[np.ndarray, "G 2 3"]:
    """(F-1, 2, 3) linear colours of the thumb-to-tip lines: the finger's own, or the highlight."""
    colors = np.where(pinched[:, None], np.array(HIGHLIGHT), finger_colors(fingers)[1:])
    return np.repeat(linear(colors)[:, None], 2, axis=1)


def thumb_lines(tips: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "G 2 3"]:
    """(F-1, 2, 3) from the thumb's tip to each other; to one that is missing, of no length."""
    lines = np.stack([np.broadcast_to(tips[0], tips[1:].shape), tips[1:]], axis=1)
    return np.where(np.isfinite(lines).all(axis=(1, 2), keepdims=True), lines, 0.0)


def _turn_z(direction: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    """(N, 4) quaternions (wxyz) that turn +z to each direction; identity for a zero vector."""
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    z = np.divide(direction, length, out=np.tile([0.0, 0.0, 1.0], (len(direction), 1)),
                  where=length > 1e-9)  # fmt: skip
    # the half-way quaternion (1 + z.e, e x z); straight down, any axis in the plane will do
    quat = np.stack([1 + z[:, 2], -z[:, 1], z[:, 0], np.zeros(len(z))], axis=-1)
    quat[quat[:, 0] < 1e-9] = [0.0, 1.0, 0.0, 0.0]
    return np.asarray(quat / np.linalg.norm(quat, axis=-1, keepdims=True))


_BALL, _BALL_PINCHED = 0.0035, 0.0075  # radii of the fingertip markers [m]
_TARGET, _TARGET_LINE = 0.0028, 0.0012  # radius of a target, thickness of its line [m]


class BodyNodes:
    """Draws the bodies of a model where its joints put them, in the model's world frame.

    Args:
        scene: where to draw.
        model: the robot hand.
        meshes: body -> its surface.
        owner: (nbody,) finger of each body, -1 for the palm.
        root: name of the parent node.
        color: colour of all bodies; as its fingers are if left out.
        opacity: 0 to 1; None for solid.
        scale: scale of each body about its own origin: a little less hides it in one that stands
            alike.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        model: mujoco.MjModel,
        meshes: dict[int, trimesh.Trimesh],
        owner: Int[np.ndarray, " nbody"],
        root: str,
        *,
        color: Rgb | None = None,
        opacity: float | None = None,
        scale: float = 1.0,
    ) -> None:
        self.data = mujoco.MjData(model)
        self._model = model
        palette = finger_colors(int(owner.max()) + 1)
        self.nodes = {
            body: scene.add_mesh_simple(
                f"{root}/body_{body}",
                mesh.vertices,
                mesh.faces,
                color=color or (PALM if owner[body] < 0 else tuple(palette[owner[body]].tolist())),
                opacity=opacity,
                scale=scale,
                side="double",  # users' meshes are not always wound outward
            )
            for body, mesh in meshes.items()
        }

    def place(self, qpos: Float[np.ndarray, " nq"]) -> None:
        """Places the bodies without drawing them."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self.data)

    def draw(self, qpos: Float[np.ndarray, " nq"]) -> None:
        """Show a pose; what has not moved is not sent again."""
        self.place(qpos)
        for body, node in self.nodes.items():
            node.position = self.data.xpos[body]
            node.wxyz = self.data.xquat[body]

    def set_opacity(self, opacity: float | None) -> None:
        """Make the hand see-through, or solid with None."""
        for node in self.nodes.values():
            node.opacity = opacity

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""
        for node in self.nodes.values():
            node.visible = visible


class TipBalls:
    """Fingertips, which grow and light up where they pinch.

    Args:
        scene: where to draw.
        count: number of fingers.
        name: name of the node.
    """

    def __init__(self, scene: viser.SceneApi, count: int, name: str) -> None:
        self._palette = finger_colors(count)
        radii = np.full(count, _BALL)
        self.node = add_balls(scene, name, np.zeros((count, 3)), radii, self._palette)

    def draw(self, tips: Float[np.ndarray, "F 3"], pinched: Bool[np.ndarray, " G"]) -> None:
        """Show tips [m], and which fingers pinch with the thumb."""
        lit = lit_tips(pinched)
        self.node.batched_positions = tips
        self.node.batched_scales = np.where(lit, _BALL_PINCHED, _BALL)
        colors = np.where(lit[:, None], np.array(HIGHLIGHT), self._palette)
        self.node.batched_colors = linear(colors)


class TargetMarks:
    """The places that the method wants for the fingertips, each with a line from the robot's tip.

    Args:
        scene: where to draw.
        count: number of fingers.
        name: name of the nodes.
    """

    def __init__(self, scene: viser.SceneApi, count: int, name: str) -> None:
        palette = finger_colors(count)
        none = np.zeros((count, 3))
        self._balls = add_balls(scene, f"{name}/places", none, np.zeros(count), palette)
        lines = np.repeat(linear(palette)[:, None], 2, axis=1)
        self._lines = scene.add_line_segments(
            f"{name}/lines", np.zeros((count, 2, 3)), lines, thickness=_TARGET_LINE
        )

    def draw(self, targets: Sequence[float] | None, tips: Float[np.ndarray, "F 3"]) -> None:
        """Show the places.

        Args:
            targets: 3 F numbers [m]; None for a method that has none.
            tips: (F, 3) the robot's fingertips [m].
        """
        places = tips if targets is None else np.reshape(targets, (-1, 3))
        size = 0.0 if targets is None else _TARGET
        self._balls.batched_positions = places
        self._balls.batched_scales = np.full(len(tips), size)
        self._lines.points = np.stack([tips, places], axis=1)

    def set_visible(self, visible: bool) -> None:
        """Show or hide them."""
        self._balls.visible = self._lines.visible = visible
