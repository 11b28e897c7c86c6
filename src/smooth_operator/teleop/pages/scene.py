"""Draws hands in the scene of a browser page: human hand, robot bodies, fingertips, keyvectors,
labels.

All moving parts are batches of instances, even single bodies. viser draws the pose of a node in
the next picture, but other properties in the picture after that, so that bodies and lines would
show different times in a slow browser. A batch has its poses as properties, so all changes of one
``atomic`` block appear in the same picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int, UInt8

from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.landmarks import BASES, BONES, NUM_LANDMARKS, WRIST
from smooth_operator.teleop.pages.hand_view import (
    FOREARM,
    HIGHLIGHT,
    PALM,
    SIMULATED,
    HandView,
    Rgb,
    finger_colors,
    linear,
    moved,
    palm_to_model,
)

if TYPE_CHECKING:
    import viser

_JOINT, _WRIST, _TIP, _PINCHED = 0.0070, 0.0095, 0.0075, 0.0095  # sphere radii [m]
_BONE, _PALM_BONE = 0.0052, 0.0062  # bone radii [m]
# With the rods across the knuckles, five rods from the wrist look like a palm.
_LINKS = (*BONES, *pairwise(BASES))
_PARENTS, _CHILDREN = (np.array(column) for column in zip(*_LINKS, strict=True))


def _add_instances(
    scene: viser.SceneApi,
    name: str,
    mesh: trimesh.Trimesh,
    colors: UInt8[np.ndarray, "k 3"],
    scales: np.ndarray,
    **more: Any,
) -> Any:
    """Adds instances of a mesh to a scene as one node, all at the origin."""
    return scene.add_batched_meshes_simple(
        name,
        mesh.vertices,
        mesh.faces,
        batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(colors), 1)),
        batched_positions=np.zeros((len(colors), 3)),
        batched_scales=scales,
        batched_colors=linear(colors),
        lod="off",
        **more,
    )


def add_balls(scene: viser.SceneApi, name: str, colors: UInt8[np.ndarray, "k 3"]) -> Any:
    """Adds several spheres without a size to a scene as one node."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    return _add_instances(scene, name, ball, colors, np.zeros(len(colors)))


class HumanView:
    """Draws a human hand as spheres and rods; ``tips`` are its fingertip landmarks, thumb first."""

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
        self._joints = add_balls(scene, f"{root}/joints", self._colors)
        none = np.zeros((len(_LINKS), 3))
        self._bones = _add_instances(scene, f"{root}/bones", rod, bone_colors, none)

    def draw(self, landmarks: Float[np.ndarray, "21 3"], pinched: Bool[np.ndarray, " G"]) -> None:
        """Shows landmarks [m], NaN for missing ones. Pinching fingertips are larger and
        highlighted."""
        present = np.isfinite(landmarks).all(axis=-1)
        points = np.where(present[:, None], landmarks, 0.0)
        lit = lit_tips(pinched)
        radii, colors = self._radii.copy(), self._colors.copy()
        radii[self._tips[lit]], colors[self._tips[lit]] = _PINCHED, HIGHLIGHT
        self._joints.batched_positions = points
        # viser does not send unchanged arrays again
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
    """(F,) True for fingertips that pinch; the thumb's is True if any finger pinches."""
    return np.concatenate([[pinched.any()], pinched])


def keyvector_colors(fingers: int, pinched: Bool[np.ndarray, " G"]) -> UInt8[np.ndarray, "G 2 3"]:
    """(F-1, 2, 3) linear colours of the thumb-to-tip lines: the finger's colour, or the highlight
    colour."""
    colors = np.where(pinched[:, None], np.array(HIGHLIGHT), finger_colors(fingers)[1:])
    return np.repeat(linear(colors)[:, None], 2, axis=1)


def _turn_z(direction: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    """(N, 4) quaternions (wxyz) that turn +z to each direction."""
    turns = np.empty((len(direction), 4))
    for turn, vector in zip(turns, direction, strict=True):
        mujoco.mju_quatZ2Vec(turn, vector)
    return turns


_CONTACT: Final[Rgb] = (235, 40, 30)  # color of a fingertip in full contact
_BALL, _BALL_PINCHED = 0.0035, 0.0075  # radii of the fingertip markers [m]
_LINE: Final = 0.0022  # thickness of a keyvector [m]
_TARGET, _TARGET_LINE = 0.0028, 0.0012  # radius of a target, thickness of its line [m]
TRANSLUCENT: Final = 0.45
"""Opacity of a hand that overlaps another."""
_WITHIN: Final = 0.985  # size of a second hand, which hides in the first one in the same pose


def add_body(
    scene: viser.SceneApi,
    name: str,
    mesh: trimesh.Trimesh,
    color: Sequence[int],
    *,
    opacity: float | None = None,
    scale: float = 1.0,
    size: float = 1.0,
    flat: bool = False,
) -> Any:
    """Adds a rigid surface to a scene; ``put`` moves it.

    Args:
        color: sRGB, 0 to 255.
        opacity: 0 to 1; None for solid.
        scale: scale of the surface and of its positions.
        size: scale of the surface alone.
        flat: shade each face separately.
    """
    return _add_instances(
        scene,
        name,
        mesh,
        np.array([color], np.uint8),
        np.array([size]),
        opacity=opacity,
        flat_shading=flat,
        side="double",  # some users' meshes have faces that are wound inward
        scale=scale,
    )


def put(
    node: Any,
    position: Float[np.ndarray, "3"],
    wxyz: Float[np.ndarray, "4"],
    pose: Float[np.ndarray, "7"] | None = None,
) -> None:
    """Moves a node that ``add_body`` made to a position [m] and quaternion.

    Args:
        pose: pose, in the node's parent, of the frame in which position and quaternion are given;
            None if that is the parent's frame.
    """
    if pose is not None:
        at, turn = np.empty(3), np.empty(4)
        mujoco.mju_mulPose(at, turn, pose[:3], pose[3:], position, wxyz)
        position, wxyz = at, turn
    node.batched_positions, node.batched_wxyzs = position[None], wxyz[None]


class BodyNodes:
    """Draws the bodies of a model, with the settings of ``add_body``.

    Args:
        owner: (nbody,) finger of each body, -1 for the palm.
        root: name of the parent node.
        color: colour of all bodies; None for the colours of the fingers.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        model: mujoco.MjModel,
        meshes: Mapping[int, trimesh.Trimesh],
        owner: Int[np.ndarray, " nbody"],
        root: str,
        *,
        color: Rgb | None = None,
        opacity: float | None = None,
        scale: float = 1.0,
        size: float = 1.0,
    ) -> None:
        self.data = mujoco.MjData(model)
        self.meshes = meshes
        self._model = model
        palette = [PALM, *map(tuple, finger_colors(int(owner.max()) + 1).tolist())]
        self.nodes = {
            body: add_body(
                scene,
                f"{root}/body_{body}",
                mesh,
                color or palette[owner[body] + 1],
                opacity=opacity,
                scale=scale,
                size=size,
            )
            for body, mesh in meshes.items()
        }

    def draw(
        self, qpos: Float[np.ndarray, " nq"], pose: Float[np.ndarray, "7"] | None = None
    ) -> None:
        """Shows the model at joint positions; ``pose`` is the pose of its world, see ``put``."""
        self._place(qpos)
        for body, node in self.nodes.items():
            put(node, self.data.xpos[body].copy(), self.data.xquat[body].copy(), pose)

    def corners(self, qpos: Float[np.ndarray, " nq"]) -> Float[np.ndarray, "N 3"]:
        """(N, 3) corners of the bodies' bounding boxes, in the model's world frame [m]."""
        self._place(qpos)
        return np.concatenate(
            [
                mesh.bounding_box.vertices @ self.data.xmat[body].reshape(3, 3).T
                + self.data.xpos[body]
                for body, mesh in self.meshes.items()
            ]
        )

    def show(self, visible: bool, opacity: float | None) -> None:
        """Shows or hides the bodies. With None as the opacity, they are solid."""
        for node in self.nodes.values():
            node.visible, node.opacity = visible, opacity

    def _place(self, qpos: Float[np.ndarray, " nq"]) -> None:
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self.data)


class RobotBodies:
    """Draws a robot hand in its palm frame, and a second, translucent hand where it differs.

    Args:
        hand: the robot hand, which defines the order of the joints.
        view: the same hand on the model to draw, with the same joint names in any order.
        root: name of the parent node, in the palm frame.
        meshes: body -> its surface.
        second: draw the second hand.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        hand: Hand,
        view: HandView,
        root: str,
        meshes: Mapping[int, trimesh.Trimesh],
        second: bool,
    ) -> None:
        drawn = self._drawn = view.hand
        owner, model = view.finger_of_body, drawn.model
        self._rest = drawn.full_configuration(drawn.neutral)
        self._order = [drawn.joint_names.index(name) for name in hand.joint_names]
        self._pose = palm_to_model(drawn)
        places = landmark_points(model, drawn.spec)
        self._tips = [places[name] for name in drawn.tip_names]
        self.first = BodyNodes(scene, model, meshes, owner, f"{root}/first")
        self.other: BodyNodes | None = None
        if second:
            fingers = {body: mesh for body, mesh in meshes.items() if owner[body] >= 0}
            looks: dict[str, Any] = {"color": SIMULATED, "opacity": TRANSLUCENT, "size": _WITHIN}
            self.other = BodyNodes(scene, model, fingers, owner, f"{root}/second", **looks)

    def draw(
        self, every: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"] | None = None
    ) -> None:
        """Shows joint positions [rad]; ``other`` are those of the second hand, if different."""
        self.first.draw(self._qpos(every), self._pose)
        if self.other is not None:
            self.other.draw(self._qpos(every if other is None else other), self._pose)

    @property
    def tips(self) -> Float[np.ndarray, "F 3"]:
        """(F, 3) fingertips of the hand that was drawn last, in its palm frame [m]."""
        data = self.first.data
        tips = [data.xmat[body].reshape(3, 3) @ at + data.xpos[body] for body, at in self._tips]
        return moved(self._pose, np.array(tips))

    def corners(self, every: Float[np.ndarray, " n"]) -> Float[np.ndarray, "N 3"]:
        """(N, 3) corners of the bodies' bounding boxes, in the palm frame [m]."""
        return moved(self._pose, self.first.corners(self._qpos(every)))

    def _qpos(self, every: Float[np.ndarray, " n"]) -> Float[np.ndarray, " nq"]:
        """Joint positions of the drawn model; joints that only it has stay at rest."""
        positions = self._rest.copy()
        positions[self._order] = every
        return self._drawn.qpos(positions)


class RobotLooks:
    """Draws a robot hand with the vendor's meshes or with simple shapes; see ``RobotBodies``.

    Args:
        views: the hand on the models to draw, simple shapes last.
        distal: unit vector along the forearm, to cut it off below the wrist; None keeps it.

    Attributes:
        visible, meshes, second: True to show the hand, its meshes, and the second hand.
        opacity: 0 to 1; None for solid.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        hand: Hand,
        views: Sequence[HandView],
        root: str,
        *,
        distal: Float[np.ndarray, "3"] | None = None,
        second: bool = False,
    ) -> None:
        self._scene, self._hand, self._second = scene, hand, second
        self._root, self._distal = root, distal
        self.visible = self.meshes = self.second = True
        self.opacity: float | None = None
        self._pose: tuple[Any, Any] = (hand.full_configuration(hand.neutral), None)
        self._looks: list[RobotBodies] = []
        for view in reversed(views):
            self.add(view)

    @property
    def shown(self) -> RobotBodies:
        """The bodies that are shown at present."""
        return self._looks[0 if self.meshes else -1]

    def add(self, view: HandView) -> None:
        """Adds a model of the hand, which is preferred to earlier ones."""
        name, distal = f"{self._root}_{len(self._looks)}", self._distal
        meshes = view.meshes if distal is None else view.without_forearm(FOREARM, distal)
        look = RobotBodies(self._scene, self._hand, view, name, meshes, self._second)
        self._looks.insert(0, look)
        self.show()

    def draw(
        self, every: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"] | None = None
    ) -> None:
        """Shows joint positions [rad]; see ``RobotBodies``."""
        self._pose = every, other
        self.shown.draw(every, other)

    def show(self, **choices: Any) -> None:
        """Sets attributes of this object, and shows the hand accordingly."""
        vars(self).update(choices)
        self.shown.draw(*self._pose)
        for look in self._looks:
            visible = self.visible and look is self.shown
            look.first.show(visible, self.opacity)
            if look.other is not None:
                look.other.show(visible and self.second, TRANSLUCENT)


class TargetMarks:
    """Marks the method's target for each fingertip, with a line from the robot's fingertip."""

    def __init__(self, scene: viser.SceneApi, count: int, name: str) -> None:
        palette = finger_colors(count)
        self._balls = add_balls(scene, f"{name}/places", palette)
        lines = np.repeat(linear(palette)[:, None], 2, axis=1)
        self._lines = scene.add_line_segments(
            f"{name}/lines", np.zeros((count, 2, 3)), lines, thickness=_TARGET_LINE
        )

    def draw(self, targets: Sequence[float] | None, tips: Float[np.ndarray, "F 3"]) -> None:
        """Shows targets (3 F numbers) [m], or none for a method without targets, and lines from the
        robot's tips [m]."""
        places = tips if targets is None else np.reshape(targets, (-1, 3))
        size = 0.0 if targets is None else _TARGET
        self._balls.batched_positions = places
        self._balls.batched_scales = np.full(len(tips), size)
        self._lines.points = np.stack([tips, places], axis=1)

    def set_visible(self, visible: bool) -> None:
        """Shows or hides the targets."""
        self._balls.visible = self._lines.visible = visible


class HandRow:
    """Draws a human hand and robot hands in a row, each with a frame, a label, fingertips and
    keyvectors.

    The frames are named ``ROOT/NAME``. Fingertips in a pinch are larger and highlighted.

    Args:
        human_tips: (F,) landmarks of the fingertips that drive the robots, thumb first.
        words: name -> label; the human hand first, then the robots.
        label: settings of all labels, for ``viser.SceneApi.add_label``.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        root: str,
        human_tips: Sequence[int],
        words: Mapping[str, str],
        **label: Any,
    ) -> None:
        self._human_tips, count = list(human_tips), len(human_tips)
        self._human_name, *robots = words
        self.roots = {name: scene.add_frame(f"{root}/{name}", show_axes=False) for name in words}
        self.human = HumanView(scene, human_tips, f"{root}/{self._human_name}")
        self._palette = finger_colors(count)
        self.tips = {
            name: add_balls(scene, f"{root}/{name}/tips", self._palette) for name in robots
        }
        self.lines = {
            name: scene.add_line_segments(
                f"{root}/{name}/keyvectors",
                np.zeros((count - 1, 2, 3)),
                keyvector_colors(count, np.zeros(count - 1, bool)),
                thickness=_LINE,
            )
            for name in words
        }
        self.labels = {
            name: scene.add_label(f"{root}/{name}/label", text, **label)
            for name, text in words.items()
        }

    def draw(
        self,
        landmarks: Float[np.ndarray, "21 3"],
        robot_tips: Sequence[Float[np.ndarray, "F 3"]],
        pinched: Bool[np.ndarray, " G"],
        contact: Sequence[float] | None = None,
    ) -> None:
        """Shows the human's landmarks and each robot's fingertips, in the frames of the hands [m].

        The more contact (0 to 1) a robot's fingertip has, the redder and larger it is.
        """
        if self.roots[self._human_name].visible:
            self.human.draw(landmarks, pinched)
        lit = lit_tips(pinched)
        level = np.zeros(len(lit)) if contact is None else np.asarray(contact, float)
        colors = np.where(lit[:, None], np.array(HIGHLIGHT), self._palette)
        mixed = colors + level[:, None] * (np.array(_CONTACT) - colors)
        shades = linear(mixed.round().astype(np.uint8))
        sizes = np.maximum(np.where(lit, _BALL_PINCHED, _BALL), level * _BALL_PINCHED)
        for balls, tips in zip(self.tips.values(), robot_tips, strict=True):
            balls.batched_positions = tips
            balls.batched_scales = sizes
            balls.batched_colors = shades
        colors = keyvector_colors(len(self._human_tips), pinched)
        for lines, tips in zip(
            self.lines.values(), (landmarks[self._human_tips], *robot_tips), strict=True
        ):
            ends = np.stack([np.broadcast_to(tips[0], tips[1:].shape), tips[1:]], axis=1)
            both = np.isfinite(ends).all(axis=(1, 2), keepdims=True)
            lines.points = np.where(both, ends, 0.0)
            lines.colors = colors

    def set_keyvectors(self, visible: bool) -> None:
        """Shows or hides the thumb-to-tip lines."""
        for lines in self.lines.values():
            lines.visible = visible
