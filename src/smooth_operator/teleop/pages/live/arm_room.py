"""The arms on the page: a small picture of the room, next to the hands in their own size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import arm_spec
from smooth_operator.simulation.arms.carried import CarriedHand, WristKinematics
from smooth_operator.simulation.arms.rigid import inverse, matrix_of, pose_of, rigid
from smooth_operator.teleop.arm.settings import ArmSettings, place_arms
from smooth_operator.teleop.pages.hand_view import PALM, SIMULATED, HandView, Rgb, body_meshes
from smooth_operator.teleop.pages.human import BodyNodes
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
        measured: whether the arms are measured.
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
            side: which hand's.
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
        self._arm = _Smaller(scene, model, meshes, owner, f"{root}/arm", scale=_SCALE, color=PALM)
        self._measured = (
            _Smaller(scene, model, meshes, owner, f"{root}/measured", scale=_SCALE,
                     color=SIMULATED, opacity=_GHOST)
            if measured
            else None
        )  # fmt: skip
        self._hand_root = scene.add_frame(f"{root}/hand", show_axes=False)
        hand = self._own = carried.mount.hand
        view = HandView(hand)
        self._hand = _Smaller(
            scene, hand.model, view.meshes, view.finger_of_body, f"{root}/hand/bodies",
            scale=_SCALE,
        )  # fmt: skip
        self._to_model = inverse(carried.mount.model_to_palm)
        length, thickness = _AXES
        self._target = scene.add_frame(
            f"{root}/target", axes_length=_SCALE * length, axes_radius=_SCALE * thickness,
            origin_radius=_SCALE * 2 * thickness, visible=False,
        )  # fmt: skip
        self.scenery = SceneryNodes(scene, f"{root}/scenery", _SCALE)
        self._palm = np.eye(4)

    def draw(self, arm: Mapping[str, Any], fingers: Float[np.ndarray, " n"]) -> None:
        positions = np.array(arm["positions"], float)
        self._arm.draw(positions)
        if self._measured is not None and arm["measured"] is not None:
            self._measured.draw(np.array(arm["measured"], float))
        self._palm = self._base @ matrix_of(self._kinematics.palm(positions))
        pose = pose_of(self._palm @ self._to_model)
        self._hand_root.position, self._hand_root.wxyz = _SCALE * pose[:3], pose[3:]
        self._hand.draw(self._own.qpos(fingers))
        target = arm["target"]
        self._target.visible = target is not None
        if target is not None:
            self._target.position = _SCALE * np.array(target[:3])
            self._target.wxyz = np.array(target[3:])

    def place_scenery(self, fixture: Float[np.ndarray, "7"]) -> Float[np.ndarray, "7"]:
        self.scenery.place(_SCALE * fixture[:3], fixture[3:])
        return poses.relative(pose_of(self._palm), fixture)


class _Smaller(BodyNodes):
    """The bodies of a model, smaller than life."""

    def draw(self, qpos: Float[np.ndarray, " nq"]) -> None:
        self.place(qpos)
        for body, node in self.nodes.items():
            node.position = _SCALE * self.data.xpos[body]
            node.wxyz = self.data.xquat[body]


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
        self._frame = scene.add_frame(root, show_axes=False)
        self._all: viser.FrameHandle | None = None
        self._object: viser.FrameHandle | None = None
        self._count = 0
        self._corners = np.zeros((0, 3))

    @property
    def there(self) -> bool:
        """True if there is a scene."""
        return self._all is not None

    def bounds(self, pose: Sequence[float]) -> Float[np.ndarray, "c 3"]:
        """(c, 3) points around the object and where it goes next, in the palm frame [m].

        Args:
            pose: position and quaternion of the object.
        """
        return np.asarray(_SPACE * self._corners @ _rotation(pose[3:]).T + np.array(pose[:3]))

    def show(self, parts: Sequence[Mapping[str, Any]]) -> None:
        """Draw these shapes in the place of those before; see ``Scenery``."""
        if self._all is not None:
            self._all.remove()  # and what hangs from it
        self._all = self._object = None
        self._corners = np.zeros((0, 3))
        if not parts:
            return
        self._count += 1  # a browser may still have the old nodes: names are not used twice
        root = f"{self._root}/scene_{self._count}"
        self._all = self._scene.add_frame(root, show_axes=False)
        self._object = self._scene.add_frame(f"{root}/object", show_axes=False)
        for number, part in enumerate(parts):
            mesh = _mesh(part["kind"], part["size"])
            parent = f"{root}/object" if part["moves"] else root
            if part["moves"]:
                box = mesh.bounding_box.vertices @ _rotation(part["quaternion"]).T
                self._corners = np.concatenate([self._corners, box + np.array(part["position"])])
            *color, opacity = part["color"]
            opacity = opacity if part["moves"] else min(opacity, _STANDS)
            self._scene.add_mesh_simple(
                f"{parent}/part_{number}",
                self._scale * mesh.vertices,
                mesh.faces,
                color=tuple(round(255 * c) for c in color),
                opacity=None if opacity >= 1.0 else opacity,
                flat_shading=part["kind"] == "box",
                position=self._scale * np.array(part["position"]),
                wxyz=part["quaternion"],
            )

    def draw(self, pose: Sequence[float] | None) -> None:
        """Places the object: position [m] and quaternion; None leaves it."""
        if self._object is not None and pose is not None:
            self._object.position = self._scale * np.array(pose[:3])
            self._object.wxyz = np.array(pose[3:])

    def hide_object(self, hidden: bool) -> None:
        """True if there is no object now."""
        if self._object is not None and self._object.visible is hidden:
            self._object.visible = not hidden

    def place(self, position: Float[np.ndarray, "3"], wxyz: Float[np.ndarray, "4"]) -> None:
        """Places the frame of the scene in that of the node's parent."""
        self._frame.position, self._frame.wxyz = position, wxyz


def _rotation(quaternion: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(quaternion, float))
    return matrix.reshape(3, 3)


def _mesh(kind: str, size: Sequence[float]) -> trimesh.Trimesh:
    if kind == "box":
        mesh = trimesh.creation.box([2 * half for half in size])
    elif kind == "capsule":
        mesh = trimesh.creation.capsule(2 * size[1], size[0], count=[_ROUND, _ROUND // 2])
    else:
        mesh = trimesh.creation.cylinder(size[0], 2 * size[1], sections=_ROUND)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh
