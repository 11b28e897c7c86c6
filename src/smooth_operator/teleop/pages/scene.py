"""Hands in a browser's scene: the human mannequin, robot bodies, fingertips, keyvectors, labels.

All that moves is a batch of instances, also where it is a single body. viser puts the pose of a
node into a browser's next picture, and all other properties into the one after: bodies that were
moved as nodes and lines would be of different instants on a slow browser. As properties, all that
is sent in one ``atomic`` block is drawn in one picture.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Bool, Float, Int, UInt8

from smooth_operator.hands.hand import Hand
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
)

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
    """(N, 4) quaternions (wxyz) that turn +z to each direction; any for a zero vector."""
    turns = np.empty((len(direction), 4))
    for turn, vector in zip(turns, direction, strict=True):
        mujoco.mju_quatZ2Vec(turn, vector)
    return turns


_BALL, _BALL_PINCHED = 0.0035, 0.0075  # radii of the fingertip markers [m]
_LINE: Final = 0.0022  # thickness of a keyvector [m]
_TARGET, _TARGET_LINE = 0.0028, 0.0012  # radius of a target, thickness of its line [m]
TRANSLUCENT: Final = 0.45
"""Opacity of a hand that overlaps another."""
_WITHIN: Final = 0.985  # size of a second hand, which is seen where it leaves the first
_UNTURNED: Final = np.array([[1.0, 0.0, 0.0, 0.0]])


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
    """Adds a rigid surface; ``put`` moves it.

    Args:
        mesh: the surface in its own frame [m].
        color: sRGB, 0 to 255.
        opacity: 0 to 1; None for solid.
        scale: scale of the surface and of its positions.
        flat: shade each face by itself.
    """
    return scene.add_batched_meshes_simple(
        name,
        mesh.vertices,
        mesh.faces,
        batched_wxyzs=_UNTURNED,
        batched_positions=np.zeros((1, 3)),
        batched_scales=np.array([size]),
        batched_colors=linear(np.array([color], np.uint8)),
        lod="off",
        opacity=opacity,
        flat_shading=flat,
        side="double",  # users' meshes are not always wound outward
        scale=scale,
    )


def put(
    node: Any,
    position: Float[np.ndarray, "3"],
    wxyz: Float[np.ndarray, "4"],
    pose: Float[np.ndarray, "7"] | None = None,
) -> None:
    """Moves a node of ``add_body``; what has not moved is not sent again.

    Args:
        position: [m].
        pose: position and quaternion of the frame that these are in; None for the node's parent.
    """
    if pose is not None:
        at, turn = np.empty(3), np.empty(4)
        mujoco.mju_mulPose(at, turn, pose[:3], pose[3:], position, wxyz)
        position, wxyz = at, turn
    node.batched_positions, node.batched_wxyzs = position[None], wxyz[None]


class BodyNodes:
    """Draws the bodies of a model where its joints put them.

    Args:
        scene: where to draw.
        model: the robot hand.
        meshes: body -> its surface.
        owner: (nbody,) finger of each body, -1 for the palm.
        root: name of the parent node.
        color: colour of all bodies; as its fingers are if left out.
        opacity: 0 to 1; None for solid.
        scale: scale of the whole model.
        size: scale of each body about its own origin: a little less hides it in one that stands
            alike.
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

    def place(self, qpos: Float[np.ndarray, " nq"]) -> None:
        """Places the bodies without drawing them."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self.data)

    def draw(
        self, qpos: Float[np.ndarray, " nq"], pose: Float[np.ndarray, "7"] | None = None
    ) -> None:
        """Shows a pose of the joints; ``pose`` is that of the model's world, see ``put``."""
        self.place(qpos)
        for body, node in self.nodes.items():
            put(node, self.data.xpos[body].copy(), self.data.xquat[body].copy(), pose)

    def corners(self, qpos: Float[np.ndarray, " nq"]) -> Float[np.ndarray, "N 3"]:
        """(N, 3) corners of the bodies' boxes, in the model's world frame [m]."""
        self.place(qpos)
        return np.concatenate(
            [
                mesh.bounding_box.vertices @ self.data.xmat[body].reshape(3, 3).T
                + self.data.xpos[body]
                for body, mesh in self.meshes.items()
            ]
        )

    def set_opacity(self, opacity: float | None) -> None:
        """Make the hand see-through, or solid with None."""
        for node in self.nodes.values():
            node.opacity = opacity

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""
        for node in self.nodes.values():
            node.visible = visible


class RobotBodies:
    """A robot hand in its palm frame, and a second, see-through one that is seen where it differs.

    Args:
        scene: where to draw.
        hand: the robot hand, in the order of whose joints poses come.
        view: the same hand on the model to draw, with the same joints by name, in any order.
        root: name of the parent node, in the palm frame.
        meshes: body -> its surface; those of ``view`` if left out.
        second: draw the second hand.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        hand: Hand,
        view: HandView,
        root: str,
        *,
        meshes: Mapping[int, trimesh.Trimesh] | None = None,
        second: bool = False,
    ) -> None:
        drawn = self._drawn = view.hand
        meshes = view.meshes if meshes is None else meshes
        owner, model = view.finger_of_body, drawn.model
        self._rest = drawn.full_configuration(drawn.neutral)
        self._order = [drawn.joint_names.index(name) for name in hand.joint_names]
        self._pose = _palm_to_model(drawn)
        self.first = BodyNodes(scene, model, meshes, owner, f"{root}/first")
        fingers = {body: mesh for body, mesh in meshes.items() if owner[body] >= 0}
        self._second = (
            BodyNodes(
                scene,
                model,
                fingers,
                owner,
                f"{root}/second",
                color=SIMULATED,
                opacity=TRANSLUCENT,
                size=_WITHIN,
            )
            if second
            else None
        )

    def draw(
        self, every: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"] | None = None
    ) -> None:
        """Show a pose of the hand's joints [rad], and that of the second hand; by default the same,
        where it is not seen."""
        self.first.draw(self._qpos(every), self._pose)
        if self._second is not None:
            self._second.draw(self._qpos(every if other is None else other), self._pose)

    def show(self, visible: bool, second: bool = True) -> None:
        """Show or hide it, and the second hand with it."""
        self.first.set_visible(visible)
        if self._second is not None:
            self._second.set_visible(visible and second)

    def corners(self, every: Float[np.ndarray, " n"]) -> Float[np.ndarray, "N 3"]:
        """(N, 3) corners of the bodies' boxes in a pose, in the palm frame [m]."""
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self._pose[3:])
        corners = self.first.corners(self._qpos(every))
        return np.asarray(corners @ matrix.reshape(3, 3).T + self._pose[:3])

    def _qpos(self, every: Float[np.ndarray, " n"]) -> Float[np.ndarray, " nq"]:
        """Joint positions of the drawn model; what it has besides the hand's joints rests."""
        positions = self._rest.copy()
        positions[self._order] = every
        return self._drawn.qpos(positions)


class RobotLooks:
    """A robot hand in one of its looks: the maker's meshes, where there are some, or simple shapes.

    Args:
        scene: where to draw.
        hand: the robot hand, in the order of whose joints poses come.
        views: the hand on the models to draw, simple shapes last; see ``RobotBodies``.
        root: name of the nodes, in the palm frame.
        distal: unit vector along the forearm, which is cut off below the wrist; None leaves it.
        second: draw the second hand.

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
        self._bodies = functools.partial(RobotBodies, scene, hand, second=second)
        self._root, self._distal = root, distal
        self.visible = self.meshes = self.second = True
        self.opacity: float | None = None
        self._pose: tuple[Any, Any] = (hand.full_configuration(hand.neutral), None)
        self._looks: list[RobotBodies] = []
        for view in reversed(views):
            self.add(view)

    @property
    def shown(self) -> RobotBodies:
        """The look that is drawn."""
        return self._looks[0 if self.meshes else -1]

    def add(self, view: HandView) -> None:
        """Add a look, which goes before those that are there."""
        meshes = None if self._distal is None else view.without_forearm(FOREARM, self._distal)
        self._looks.insert(0, self._bodies(view, f"{self._root}_{len(self._looks)}", meshes=meshes))
        self.show()

    def draw(
        self, every: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"] | None = None
    ) -> None:
        """Show a pose of the hand's joints [rad], and that of the second hand."""
        self._pose = every, other
        self.shown.draw(every, other)

    def show(self, **choices: Any) -> None:
        """Set attributes, and show what they say."""
        vars(self).update(choices)
        self.shown.draw(*self._pose)
        for look in self._looks:
            look.show(self.visible and look is self.shown, self.second)
            look.first.set_opacity(self.opacity)


def _palm_to_model(hand: Hand) -> Float[np.ndarray, "7"]:
    """Pose of the model's world in the palm frame; fingers hang from the palm, it does not move."""
    data = mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_kinematics(hand.model, data)
    palm, pose = data.body(hand.spec.palm), np.empty(7)
    mujoco.mju_negPose(pose[:3], pose[3:], palm.xpos, palm.xquat)
    return pose


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


class HandRow:
    """A human hand and robot hands: each with a place, a label, fingertips and keyvectors.

    The robots' bodies hang from the frames ``ROOT/NAME``.

    Args:
        scene: where to draw.
        root: name of the parent node; empty for the scene itself.
        human_tips: (F,) landmarks of the fingertips that drive the robots, thumb first.
        words: name -> label; the human hand first, then the robots.
        label: ``viser.SceneApi.add_label``'s settings of all labels.

    Attributes:
        roots: name -> frame of a hand.
        labels: name -> label.
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
        self.tips = {name: TipBalls(scene, count, f"{root}/{name}/tips") for name in robots}
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
    ) -> None:
        """Show the human landmarks, NaN where there is none, and each robot's fingertips [m].

        Args:
            landmarks: (21, 3) in the frame of the human hand [m].
            robot_tips: fingertips of each robot, (F, 3) in its frame [m].
            pinched: (F-1,) which fingers pinch with the thumb.
        """
        self.human.draw(landmarks, pinched)
        for balls, tips in zip(self.tips.values(), robot_tips, strict=True):
            balls.draw(tips, pinched)
        colors = keyvector_colors(len(self._human_tips), pinched)
        ends = (landmarks[self._human_tips], *robot_tips)
        for lines, tips in zip(self.lines.values(), ends, strict=True):
            lines.points = thumb_lines(tips)
            lines.colors = colors

    def set_keyvectors(self, visible: bool) -> None:
        """Show or hide the thumb-to-tip lines."""
        for lines in self.lines.values():
            lines.visible = visible
