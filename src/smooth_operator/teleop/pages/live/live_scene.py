"""3D scene of the live page: human hands, commanded and simulated robot hands, tasks and arms."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np
import trimesh
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.geometry import Similarity
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.retargeting.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    reference_landmarks,
)
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
from smooth_operator.teleop.pages.hand_view import (
    FOREARM,
    GAP,
    PALM,
    SIMULATED,
    Aiming,
    HandView,
    Rgb,
    body_meshes,
    moved,
    view_axes,
)
from smooth_operator.teleop.pages.scene import (
    TRANSLUCENT,
    BodyNodes,
    HandRow,
    RobotLooks,
    TargetMarks,
    add_body,
    put,
)
from smooth_operator.teleop.sources.webcam.camera import opencv
from smooth_operator.types import Side
from smooth_operator.wrist_following import PalmMotion

if TYPE_CHECKING:
    import viser

_SCALE: Final = 0.32  # scale of the room; the hands beside it have their own size
_AZIMUTH, _ELEVATION = np.radians(-58.0), np.radians(22.0)  # direction from the arms to the viewer
_ROOM: Final = ((-0.25, 0.9), (0.35, 0.35), (0.0, 1.0))
"""Part of the room that is shown [m]: range of x, margins in y outside the bases, range of z."""
_TABLE: Final = (1.6, 0.1)  # size of the table and of its cells [m]
_GRID: Final[Rgb] = (100, 110, 124)
_GHOST: Final = 0.35  # opacity of the measured arm
_AXES: Final = (0.12, 0.006)  # length and thickness of the target's axes [m]


class ArmRoom:
    """Draws the arms with their hands at a smaller scale, in a room.

    The solid arm shows the command; a translucent arm shows the measured positions, if there are
    any. Three axes show the target of the wrist.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        hands: Mapping[Side, Hand],
        settings: ArmSettings,
        measured: bool,
        root: str,
    ) -> None:
        placed = place_arms(settings, hands)
        level, height = np.cos(_ELEVATION), np.sin(_ELEVATION)
        toward = np.array([level * np.cos(_AZIMUTH), level * np.sin(_AZIMUTH), height])
        right = np.cross((0.0, 0.0, 1.0), toward)
        right /= np.linalg.norm(right)
        self._rows = np.stack([right, np.cross(toward, right), toward])
        self._root = scene.add_frame(f"{root}/room", show_axes=False)
        across = [carried.base[1, 3] for carried in placed.values()]
        y = (min(across) - _ROOM[1][0], max(across) + _ROOM[1][1])
        corners = np.array(list(itertools.product(_ROOM[0], y, _ROOM[2])))
        projected = _SCALE * corners @ self._rows.T
        self._low, self._high = projected.min(axis=0), projected.max(axis=0)
        if not settings.no_table:
            width, cell = _SCALE * _TABLE[0], _SCALE * _TABLE[1]
            scene.add_grid(
                f"{root}/room/table",
                width,
                width,
                plane="xy",
                cell_size=cell,
                section_size=5 * cell,
                cell_color=_GRID,
                section_color=_GRID,
                position=_SCALE * np.array([0.35, 0.0, settings.table]),
            )
        self._label = scene.add_label(f"{root}/room/label", settings.name, anchor="center-center")
        self.arms = {
            side: _ArmView(scene, f"{root}/room/{side}", carried, measured)
            for side, carried in placed.items()
        }

    @property
    def size(self) -> Float[np.ndarray, "3"]:
        """Width, height and depth of the picture [m]."""
        return np.asarray(self._high - self._low)

    def put(self, middle: Float[np.ndarray, "3"]) -> None:
        """Places the picture; ``middle`` is its centre, given as right, up and towards the viewer
        [m]."""
        offset = middle - (self._low + self._high) / 2
        pose = pose_of(rigid(_VIEW.T @ self._rows, offset @ _VIEW))
        self._root.position, self._root.wxyz = pose[:3], pose[3:]
        below = np.array([(self._low[0] + self._high[0]) / 2, self._low[1] - 0.012, 0.0])
        self._label.position = below @ self._rows


class _ArmView:
    """Draws one arm with its hand in the room."""

    def __init__(
        self, scene: viser.SceneApi, root: str, carried: CarriedHand, measured: bool
    ) -> None:
        base = pose_of(carried.base)
        scene.add_frame(root, show_axes=False, position=_SCALE * base[:3], wxyz=base[3:])
        self._base = inverse(carried.base)
        self._kinematics = WristKinematics(carried)
        model = arm_spec(carried.arm).compile()
        meshes = body_meshes(model)
        owner = np.full(model.nbody, -1)
        self._arm = BodyNodes(scene, model, meshes, owner, f"{root}/arm", scale=_SCALE, color=PALM)
        self._measured: BodyNodes | None = None
        if measured:
            looks: dict[str, Any] = {"scale": _SCALE, "color": SIMULATED, "opacity": _GHOST}
            self._measured = BodyNodes(scene, model, meshes, owner, f"{root}/measured", **looks)
        hand = self._own = carried.mount.hand
        view = HandView(hand)
        self._hand = BodyNodes(
            scene, hand.model, view.meshes, view.finger_of_body, f"{root}/hand", scale=_SCALE
        )
        self._to_model = inverse(carried.mount.model_to_palm)
        self._target = scene.add_batched_axes(
            f"{root}/target",
            np.array([[1.0, 0, 0, 0]]),
            np.zeros((1, 3)),
            scale=_SCALE,
            axes_length=_AXES[0],
            axes_radius=_AXES[1],
            visible=False,
        )
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
        """Places the task at a pose in the arm's base frame; returns its pose in the palm frame."""
        self.scenery.place(fixture)
        return poses.relative(pose_of(self._palm), fixture)


_SPACE: Final = 1.5  # space around an object in the picture, as a multiple of its size
_STANDS: Final = 0.7  # opacity of fixed shapes, which may hide a fallen object
_ROUND: Final = 24  # edges of round shapes, which are small on the page


class SceneryNodes:
    """Draws the shapes of a task around one robot hand. Their poses are relative to the hand's palm
    frame, which is the node ``root``."""

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
        """(c, 3) points around the object in a pose, in the palm frame [m]."""
        return moved(np.array(pose, float), _SPACE * self._corners)

    def show(self, parts: Sequence[Mapping[str, Any]]) -> None:
        """Replaces the shapes; see ``task_scenes``."""
        for node, _, _ in self._parts:
            node.remove()
        self._parts = []
        self._corners = np.zeros((0, 3))
        self._count += 1  # a browser may still have the old nodes, so each name is used once
        for number, part in enumerate(parts):
            mesh, moves = _mesh(part["kind"], part["size"]), bool(part["moves"])
            pose = np.array([*part["position"], *part["quaternion"]])
            if moves:
                box = moved(pose, mesh.bounding_box.vertices)
                self._corners = np.concatenate([self._corners, box])
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
            self._parts.append((node, pose, moves))
        self._put()

    def draw(self, pose: Sequence[float] | None) -> None:
        """Moves the object to a pose; None leaves it where it is."""
        if pose is not None:
            self._object = np.array(pose, float)
            self._put()

    def hide_object(self, hidden: bool) -> None:
        """Shows or hides the object."""
        for node, _, moves in self._parts:
            if moves:
                node.visible = not hidden

    def place(self, pose: Float[np.ndarray, "7"]) -> None:
        """Sets the pose of the shapes' frame in the frame of the parent node."""
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


_LABEL: Final = 0.016  # distance of a label from the end of the forearm [m]
_LEGEND: Final = 84.0  # height of the legend over the canvas's lower edge [px]
_TRIAL: Final = 120.0  # height of a trial's state at the upper edge [px]
_FONT: Final = 1.25  # size of the labels
_FLOOR: Final = 1.6  # width and depth of the floor [m]
_CELLS: Final[Rgb] = (82, 90, 102)
_SECTIONS: Final[Rgb] = (122, 132, 146)
_VIEW: Final = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # rows: right, up, toward the viewer


class HandsScene:
    """Robot hands beside the operator's hands, with tasks and arms. Palms face the viewer, fingers
    up.

    Args:
        scene: scene of a viser server, or one with the same methods.
        hands: side -> robot hand.
        simulated: True if there is a simulated hand.
        arm: settings of the arms that carry the hands; None for no arm.
        root: name of the root node; no earlier node of the scene may have used it.
        human: draw the operator's hands.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        hands: Mapping[Side, Hand],
        simulated: bool,
        arm: ArmSettings | None = None,
        root: str = "/live",
        human: bool = True,
    ) -> None:
        self.simulated = simulated
        self._root = scene.add_frame(root, show_axes=False)
        self.scenery_number = 0
        self._human = human
        self._own = False  # True to show the operator's own hand during a task
        self._sides = {
            side: _SideView(scene, hands[side], simulated, f"{root}/{side}")
            for side in sorted(hands)  # left before right
        }
        self._room = None if arm is None else ArmRoom(scene, hands, arm, simulated, root)
        self._floor = scene.add_grid(
            f"{root}/floor",
            _FLOOR,
            _FLOOR,
            plane="xy",
            cell_size=0.02,
            section_size=0.1,
            cell_color=_CELLS,
            section_color=_SECTIONS,
            fade_distance=2.0,
        )
        self._floor.visible = self._room is None
        self.centre, self.half = self._arrange()

    def _arrange(self) -> tuple[Float[np.ndarray, "3"], tuple[float, float]]:
        """Places the hands; returns the middle of the picture and half its size [m]."""
        low = np.min([view.low for view in self._sides.values()], axis=0)
        high = np.max([view.high for view in self._sides.values()], axis=0)
        size = high - low
        # One hand: human next to robot. Two hands: each human above its robot.
        # During a task: the robots alone, large.
        alone = not self._human or (self.has_task and not self._own)
        columns, rows = (2, 1) if len(self._sides) == 1 else (len(self._sides), 2)
        if alone:
            columns, rows = len(self._sides), 1
        for column, view in enumerate(self._sides.values()):
            right = (size[0] + GAP) * column
            up = (size[1] + 2 * GAP) * (rows - 1)
            step = np.array([size[0] + GAP, 0.0])
            robot = step if rows == 1 and not alone else np.array([right, 0.0])
            human = robot - step if rows == 1 else np.array([right, up])
            view.show_human(not alone)
            view.put(human, robot)
        spread = (columns - 1) * (size[0] + GAP), (rows - 1) * (size[1] + 2 * GAP)
        middle = (low + high + np.array([*spread, 0.0])) / 2
        if self.has_task:
            middle[2] = high[2]  # so that the nearest parts fit in, too
        half = (float(size[0] + spread[0]) / 2, float(size[1] + spread[1]) / 2)
        if self._room is not None:  # to the right of the hands
            wide, high_, _ = self._room.size
            self._room.put(middle + np.array([half[0] + GAP + wide / 2, 0.0, 0.0]))
            middle = middle + np.array([(GAP + wide) / 2, 0.0, 0.0])
            half = (half[0] + (GAP + wide) / 2, max(half[1], high_ / 2 + _LABEL))
        ground = np.array([middle[0], middle[1] - half[1] - _LABEL, (low[2] + high[2]) / 2])
        self._floor.position = ground @ _VIEW
        return middle @ _VIEW, half

    def _aim(self) -> None:
        """Places the hands again."""
        self.centre, self.half = self._arrange()

    @property
    def has_task(self) -> bool:
        """True if a hand is working on the object of a task."""
        return any(view.scenery.there for view in self._sides.values())

    def root_of(self, side: Side) -> Any:
        """Frame of the palm of a robot hand."""
        return self._sides[side].row.roots["robot"]

    def draw(self, hands: Mapping[Side, Mapping[str, Any]]) -> None:
        """Shows new states of the hands; see ``LiveSession.look``."""
        for side, view in self._sides.items():
            if side in hands:
                state = hands[side]
                view.draw(state)
                if self._room is not None and state.get("arm") is not None:
                    positions = np.array(state["positions"], float)
                    self._room.arms[side].draw(state["arm"], positions)

    def draw_scenery(self, scenery: Mapping[str, Any]) -> None:
        """Shows new states of the task around each hand; see ``task_scenes``."""
        self.scenery_number = scenery["number"]
        if "parts" in scenery:
            for side, view in self._sides.items():
                view.scenery.show(scenery["parts"].get(side, ()))
                if self._room is not None:
                    self._room.arms[side].scenery.show(scenery["parts"].get(side, ()))
                view.face(scenery["views"].get(side), scenery["poses"].get(side))
            # A task and the arms' room have a floor of their own, at another tilt.
            self._floor.visible = not self.has_task and self._room is None
            self._aim()
        for side, view in self._sides.items():
            pose, fixture = scenery["poses"].get(side), scenery["fixtures"].get(side)
            view.scenery.draw(pose)
            view.scenery.hide_object(side in scenery.get("away", ()))
            if self._room is not None:
                arm = self._room.arms[side]
                arm.scenery.draw(pose)
                if fixture is not None:  # the task stays in the room while the hand moves
                    view.scenery.place(arm.place_scenery(np.array(fixture, float)))

    def set_overlay(self, overlay: bool) -> None:
        """Shows each human hand inside its robot hand, or beside it."""
        for view in self._sides.values():
            view.set_overlay(overlay)

    def set_own(self, visible: bool) -> None:
        """Shows or hides the operator's own hand during a task."""
        self._own = visible
        self._aim()

    def set_keyvectors(self, visible: bool) -> None:
        """Shows or hides the thumb-to-tip lines and the fingertip targets."""
        for view in self._sides.values():
            view.row.set_keyvectors(visible)
            view.targets.set_visible(visible)

    def set_simulated(self, visible: bool) -> None:
        """Shows or hides the simulated hand that overlaps the robot hand."""
        for view in self._sides.values():
            view.robot.show(second=visible)

    def add_meshes(self, views: Mapping[Side, HandView]) -> None:
        """Draws the robot hands with meshes from now on; a switch can still show simple shapes."""
        for side, view in views.items():
            self._sides[side].robot.add(view)

    def set_meshes(self, visible: bool) -> None:
        """Draws meshes, if there are any, or simple shapes."""
        for view in self._sides.values():
            view.robot.show(meshes=visible)


class LiveScene(HandsScene):
    """The 3D scene of the live page, and the browsers' cameras, which are aimed at it.

    Args:
        server: the viser server.
        others: further arguments of ``HandsScene``.
    """

    def __init__(self, server: viser.ViserServer, *others: Any, **named: Any) -> None:
        super().__init__(server.scene, *others, **named)
        self._server = server
        # viser encodes pictures by OpenCV. If its own import of OpenCV fails, it leaves a folder on
        # the module path that breaks later processes; this import cleans up.
        with contextlib.suppress(SmoothOperatorError):
            opencv()
        # a grey that is lighter above, so that dark bodies and the finger colours stand out
        grey = np.linspace((72, 80, 92), (44, 49, 57), 64).round().astype(np.uint8)
        server.scene.set_background_image(np.repeat(grey[:, None], 2, axis=1), format="png")
        self.aiming = Aiming(server, _VIEW, self.centre, self.half, _LEGEND)

    def remove(self) -> None:
        """Removes the scene from the page."""
        self._root.remove()
        for client in self._server.get_clients().values():
            self.aiming.forget(client)

    def _aim(self) -> None:
        super()._aim()
        self.aiming.centre, self.aiming.half = self.centre, self.half
        self.aiming.above = _TRIAL if self.has_task else 0.0
        for client in self._server.get_clients().values():
            self.aiming.aim(client)


class _SideView:
    """Draws the human hand and the robot hands of one side."""

    def __init__(self, scene: viser.SceneApi, hand: Hand, simulated: bool, root: str) -> None:
        side = hand.spec.side
        self._hand = hand
        view = HandView(hand, simple=True)
        # From the palm frame to the picture: rows right, up, toward become x, z, -y.
        self._axes = view_axes(view)
        self._with_simulated = simulated
        self._tips = [TIPS[FINGERS.index(finger)] for finger in hand.fingers]
        words = {"human": f"human {side}", "robot": f"{hand.name} {side}"}
        self.row = HandRow(
            scene, root, self._tips, words, anchor="center-center", font_screen_scale=_FONT
        )
        self.robot = RobotLooks(
            scene, hand, [view], f"{root}/robot/model", distal=self._axes[1], second=simulated
        )
        self.targets = TargetMarks(scene, len(self._tips), f"{root}/robot/targets")
        self.scenery = SceneryNodes(scene, f"{root}/robot/scenery")
        self._points = self._hull()
        self._places = (np.zeros(3), np.zeros(3))
        self._overlaid, self._with_human = False, True
        self._motion, self._palm = PalmMotion(hand), _HERE  # of the palm, from its rest
        self.face(None, None)
        neutral = hand.full_configuration(hand.neutral)
        self.draw({"positions": neutral, "human": None, "latched": None, "targets": None})

    def show_human(self, visible: bool) -> None:
        self._with_human = self.row.roots["human"].visible = visible

    def put(self, human: Float[np.ndarray, "2"], robot: Float[np.ndarray, "2"]) -> None:
        """Sets the offsets of the human hand and the robot hand, right and up [m]."""
        here, there = (np.array([*place, 0.0]) @ _VIEW for place in (human, robot))
        self._places = (here, there)
        self.set_overlay(self._overlaid)

    def _poses(self, state: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray | None]:
        """Joint positions of the solid hand and of the second hand, which shows where they
        differ."""
        every = np.asarray(state["positions"], float)
        if not self._with_simulated or state.get("simulated") is None:
            return every, None
        other = np.asarray(state["simulated"], float)
        # during a task, the solid hand is the one that touches the object
        return (other, every) if self.scenery.there else (every, other)

    def draw(self, state: Mapping[str, Any]) -> None:
        every, other = self._poses(state)
        count = len(self._hand.joint_names)
        if len(every) > count:
            self._palm = self._motion.at(every[count:])
            self._place()
            every, other = every[:count], None if other is None else other[:count]
        self.robot.draw(every, other)
        latched = np.isin(self._hand.fingers[1:], state["latched"] or ())
        robot_tips = self.robot.shown.tips
        landmarks = self._aligned(state) if self._with_human else _UNKNOWN
        self.row.draw(landmarks, [robot_tips], latched, state.get("contact"))
        self.targets.draw(state.get("targets"), robot_tips)

    def set_overlay(self, overlay: bool) -> None:
        self._overlaid = overlay
        self._place()
        self.row.labels["human"].visible = self._with_human and not overlay
        self.robot.show(opacity=TRANSLUCENT if overlay else None)

    def _place(self) -> None:
        """Places both hands; the robot's wrist joints move its palm, but not the task."""
        human, robot = (np.concatenate([place, self._turn]) for place in self._places)
        robot = poses.compose(robot, self._palm)
        human = robot if self._overlaid else human
        for name, pose in (("human", human), ("robot", robot)):
            root = self.row.roots[name]
            root.position, root.wxyz = pose[:3], pose[3:]
        if self._palm is not _HERE:
            self.scenery.place(poses.invert(self._palm))

    def _aligned(self, state: Mapping[str, Any]) -> Float[np.ndarray, "21 3"]:
        """Landmarks of the human hand in the palm frame, as the method uses them; NaN if
        missing."""
        fit = palm_fit(self._hand, state)
        return _UNKNOWN if fit is None else fit.apply(_landmarks(state))

    def face(
        self, axes: Sequence[Sequence[float]] | None, object_pose: Sequence[float] | None
    ) -> None:
        """Turns the hands toward the viewer.

        Args:
            axes: (3, 3) rows right, up and toward the viewer in the palm frame; None for a view of
                the palm with the fingers up.
            object_pose: pose of the task's object, which the picture must also show.
        """
        rows = self._axes if axes is None else np.asarray(axes, float)
        turn, wxyz = _VIEW.T @ rows, np.empty(4)
        mujoco.mju_mat2Quat(wxyz, turn.ravel())
        self._turn = wxyz
        self._place()
        end = self._hand.wrist - (FOREARM + _LABEL) * self._axes[1]
        points = np.concatenate([self._points, end[None]])
        if object_pose is not None:
            points = np.concatenate([points, self.scenery.bounds(object_pose)])
        extent = points @ rows.T
        self.low, self.high = extent.min(axis=0), extent.max(axis=0)
        for label in self.row.labels.values():
            label.position = end

    def _hull(self) -> Float[np.ndarray, "p 3"]:
        """(p, 3) points that enclose the human and the robot hand, in the palm frame [m]."""
        hand = self._hand
        neutral, straight = hand.neutral, np.clip(0.0, *hand.limits.T)
        points = [hand.landmark_positions(np.stack([neutral, straight])).reshape(-1, 3)]
        bodies = [self.robot.shown.corners(hand.full_configuration(q)) for q in (neutral, straight)]
        return np.concatenate([*points, *bodies])


_UNKNOWN: Final = np.full((21, 3), np.nan)


def _landmarks(state: Mapping[str, Any]) -> Float[np.ndarray, "21 3"]:
    return np.asarray(state["human"], float).reshape(21, 3)


def palm_fit(hand: Hand, state: Mapping[str, Any]) -> Similarity[np.ndarray] | None:
    """Transform from the operator's landmarks to a robot hand's palm frame.

    Args:
        state: state of the hand; see ``LiveSession.look``.

    Returns:
        None if the operator's palm is not seen.
    """
    if state.get("human") is None:
        return None
    landmarks = _landmarks(state)
    missing = ~np.isfinite(landmarks).all(axis=-1)
    if missing[list(hand.align_indices)].any():
        return None
    safe = landmarks
    if missing.any():
        safe = np.where(missing[:, None], reference_landmarks(hand), landmarks)
    fit = palm_alignment(safe, hand, AlignmentConfig(state.get("scale")))
    return fit if fit.condition >= MIN_CONDITION else None
