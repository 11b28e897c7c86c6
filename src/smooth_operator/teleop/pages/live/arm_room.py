"""The arms on the page: a small picture of the room, next to the hands in their own size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import trimesh
import viser
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import (
    CarriedHand,
    WristKinematics,
    arm_spec,
    inverse,
    matrix_of,
    pose_of,
    rigid,
)
from smooth_operator.teleop.arm.settings import ArmSettings, place_arms
from smooth_operator.teleop.pages.hand_view import PALM, SIMULATED, HandView, Rgb, body_meshes
from smooth_operator.teleop.pages.scene import BodyNodes, add_body, put
from smooth_operator.types import Side

_SCALE: Final = 0.32  # of the room, next to hands in their own size
_AZIMUTH, _ELEVATION = np.radians(-58.0), np.radians(22.0)  # of the viewer, as seen from the arms
_ROOM: Final = ((-0.25, 0.9), (0.35, 0.35), (0.0, 1.0))  # x; y outside the bases; z, in the picture
_TABLE: Final = (1.6, 0.1)  # size of the table and of its cells [m]
_GRID: Final[Rgb] = (100, 110, 124)
_GHOST: Final = 0.35  # opacity of the measured arm
_AXES: Final = (0.12, 0.006)  # length and thickness of the target's axes [m]


class ArmRoom:
    """Draws arms with hands in a room, smaller than life.

    Solid is what is commanded; where an arm is measured, a translucent one shows it. Three axes
    show where the wrist of the hand is to be.

    Args:
        scene: where to draw.
        hands: side -> robot hand.
        settings: settings of the arms.
        measured: True if the arms are measured.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        hands: Mapping[Side, Hand],
        settings: ArmSettings,
        measured: bool,
    ) -> None:
        placed = place_arms(settings, hands)
        toward = np.array(
            [
                np.cos(_ELEVATION) * np.cos(_AZIMUTH),
                np.cos(_ELEVATION) * np.sin(_AZIMUTH),
                np.sin(_ELEVATION),
            ]
        )
        right = np.cross((0.0, 0.0, 1.0), toward)
        right /= np.linalg.norm(right)
        self._rows = np.stack([right, np.cross(toward, right), toward])
        self._root = scene.add_frame("/room", show_axes=False)
        across = [carried.base[1, 3] for carried in placed.values()]
        (x0, x1), (y0, y1), (z0, z1) = _ROOM
        corners = np.array(
            [
                (x, y, z)
                for x in (x0, x1)
                for y in (min(across) - y0, max(across) + y1)
                for z in (z0, z1)
            ]
        )
        projected = _SCALE * corners @ self._rows.T
        self._low, self._high = projected.min(axis=0), projected.max(axis=0)
        if not settings.no_table:
            scene.add_grid(
                "/room/table", _SCALE * _TABLE[0], _SCALE * _TABLE[0], plane="xy",
                cell_size=_SCALE * _TABLE[1], section_size=_SCALE * 5 * _TABLE[1],
                cell_color=_GRID, section_color=_GRID,
                position=_SCALE * np.array([0.35, 0.0, settings.table]),
            )  # fmt: skip
        self._label = scene.add_label("/room/label", settings.name, anchor="center-center")
        self._arms = {
            side: _ArmView(scene, side, carried, measured) for side, carried in placed.items()
        }

    @property
    def size(self) -> Float[np.ndarray, "3"]:
        """Width, height and depth of the picture [m]."""
        return np.asarray(self._high - self._low)

    def put(self, middle: Float[np.ndarray, "3"], view: Float[np.ndarray, "3 3"]) -> None:
        """Place the picture.

        Args:
            middle: right, up and toward the viewer [m].
            view: rows right, up and toward, in the page's own frame.
        """
        offset = middle - (self._low + self._high) / 2
        pose = pose_of(rigid(view.T @ self._rows, offset @ view))
        self._root.position, self._root.wxyz = pose[:3], pose[3:]
        below = np.array([(self._low[0] + self._high[0]) / 2, self._low[1] - 0.012, 0.0])
        self._label.position = below @ self._rows

    def draw(self, side: Side, state: Mapping[str, Any]) -> None:
        """Show an arm with its hand; see ``LiveSession.look``."""
        if state.get("arm") is not None:
            self._arms[side].draw(state["arm"], np.array(state["positions"], float))

    def show_scenery(self, side: Side, parts: Sequence[Mapping[str, Any]]) -> None:
        """Draw what the hand works on; see ``Scenery``."""
        self._arms[side].scenery.show(parts)

    def draw_scenery(
        self, side: Side, pose: Sequence[float] | None, fixture: Sequence[float] | None
    ) -> Float[np.ndarray, "7"] | None:
        """Show where the object is.

        Args:
            pose: pose of the object in the palm frame of the task's own fixture.
            fixture: pose of that frame in the arm's base.

        Returns:
            pose of that frame in the palm frame as it is now; None where there is no scene.
        """
        arm = self._arms[side]
        arm.scenery.draw(pose)
        return None if fixture is None else arm.place_scenery(np.array(fixture, float))


class _ArmView:
    """One arm with its hand, in the room."""

    def __init__(
        self, scene: viser.SceneApi, side: Side, carried: CarriedHand, measured: bool
    ) -> None:
        root = f"/room/{side}"
        base = pose_of(carried.base)
        scene.add_frame(root, show_axes=False, position=_SCALE * base[:3], wxyz=base[3:])
        self._base = inverse(carried.base)
        self._kinematics = WristKinematics(carried)
        model = arm_spec(carried.arm).compile()
        meshes = body_meshes(model)
        owner = np.full(model.nbody, -1)
        self._arm = BodyNodes(scene, model, meshes, owner, f"{root}/arm", scale=_SCALE, color=PALM)
        self._measured = (
            BodyNodes(scene, model, meshes, owner, f"{root}/measured", scale=_SCALE,
                      color=SIMULATED, opacity=_GHOST)
            if measured
            else None
        )  # fmt: skip
        hand = self._own = carried.mount.hand
        view = HandView(hand)
        self._hand = BodyNodes(
            scene, hand.model, view.meshes, view.finger_of_body, f"{root}/hand", scale=_SCALE
        )
        self._to_model = inverse(carried.mount.model_to_palm)
        length, thickness = _AXES
        self._target = scene.add_batched_axes(
            f"{root}/target", np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3)), scale=_SCALE,
            axes_length=length, axes_radius=thickness, visible=False,
        )  # fmt: skip
        self.scenery = SceneryNodes(scene, f"{root}/scenery", _SCALE)
        self._palm = np.eye(4)

    def draw(self, arm: Mapping[str, Any], fingers: Float[np.ndarray, " n"]) -> None:
        positions = np.array(arm["positions"], float)
        self._arm.draw(positions)
        if self._measured is not None and arm["measured"] is not None:
            self._measured.draw(np.array(arm["measured"], float))
        self._palm = self._base @ matrix_of(self._kinematics.palm(positions))
        self._hand.draw(self._own.qpos(fingers), pose_of(self._palm @ self._to_model))
        target = arm["target"]
        self._target.visible = target is not None
        if target is not None:
            put(self._target, np.array(target[:3]), np.array(target[3:]))

    def place_scenery(self, fixture: Float[np.ndarray, "7"]) -> Float[np.ndarray, "7"]:
        self.scenery.place(fixture)
        return poses.relative(pose_of(self._palm), fixture)


_SPACE: Final = 1.5  # of an object's size is kept in the picture
_STANDS: Final = 0.7  # opacity of what stands, behind which an object may fall
_ROUND: Final = 24  # edges of what is round: it is small on the page


class SceneryNodes:
    """Draws the shapes around one robot hand, in its palm frame.

    Args:
        scene: where to draw.
        root: name of the node of the palm frame.
        scale: scale of everything.
    """

    def __init__(self, scene: viser.SceneApi, root: str, scale: float = 1.0) -> None:
        self._scene, self._root, self._scale = scene, root, scale
        self._parts: list[tuple[Any, Float[np.ndarray, "7"], bool]] = []  # node, pose, moves
        self._object, self._fixture = _HERE, _HERE
        self._count = 0
        self._corners = np.zeros((0, 3))

    @property
    def there(self) -> bool:
        """True if there is a scene."""
        return bool(self._parts)

    def bounds(self, pose: Sequence[float]) -> Float[np.ndarray, "c 3"]:
        """(c, 3) points around the object and where it goes next, in the palm frame [m].

        Args:
            pose: position and quaternion of the object.
        """
        turn = np.array(pose[3:], float)
        corners: np.ndarray = poses.rotate(turn, _SPACE * self._corners) + np.array(pose[:3])
        return corners

    def show(self, parts: Sequence[Mapping[str, Any]]) -> None:
        """Draw these shapes in the place of those before; see ``Scenery``."""
        for node, _, _ in self._parts:
            node.remove()
        self._parts = []
        self._corners = np.zeros((0, 3))
        self._count += 1  # a browser may still have the old nodes: names are not used twice
        for number, part in enumerate(parts):
            mesh, moves = _mesh(part["kind"], part["size"]), bool(part["moves"])
            if moves:
                box = poses.rotate(np.array(part["quaternion"]), mesh.bounding_box.vertices)
                self._corners = np.concatenate([self._corners, box + np.array(part["position"])])
            *color, opacity = part["color"]
            opacity = opacity if moves else min(opacity, _STANDS)
            node = add_body(
                self._scene,
                f"{self._root}_{self._count}_part_{number}",
                mesh,
                [round(255 * c) for c in color],
                opacity=None if opacity >= 1.0 else opacity,
                flat=part["kind"] == "box",
                scale=self._scale,
            )
            self._parts.append((node, np.array([*part["position"], *part["quaternion"]]), moves))
        self._put()

    def draw(self, pose: Sequence[float] | None) -> None:
        """Places the object: position [m] and quaternion; None leaves it."""
        if pose is not None:
            self._object = np.array(pose, float)
            self._put()

    def hide_object(self, hidden: bool) -> None:
        """True if there is no object now."""
        for node, _, moves in self._parts:
            if moves:
                node.visible = not hidden

    def place(self, pose: Float[np.ndarray, "7"]) -> None:
        """Places the scene's frame in that of the node's parent: position [m] and quaternion."""
        self._fixture = pose
        self._put()

    def _put(self) -> None:
        at = poses.compose(self._fixture, self._object)
        for node, pose, moves in self._parts:
            put(node, pose[:3], pose[3:], at if moves else self._fixture)


_HERE: Final = np.array([0.0, 0, 0, 1, 0, 0, 0])


def _mesh(kind: str, size: Sequence[float]) -> trimesh.Trimesh:
    if kind == "box":
        mesh = trimesh.creation.box([2 * half for half in size])
    elif kind == "capsule":
        mesh = trimesh.creation.capsule(2 * size[1], size[0], count=[_ROUND, _ROUND // 2])
    else:
        mesh = trimesh.creation.cylinder(size[0], 2 * size[1], sections=_ROUND)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh
