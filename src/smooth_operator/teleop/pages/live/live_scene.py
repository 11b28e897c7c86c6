"""Both sides' hands on the page: human, robot at its command, simulated robot, keyvectors."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any, Final

import mujoco
import numpy as np
import viser
from jaxtyping import Float, UInt8

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    reference_landmarks,
)
from smooth_operator.human.flat_hand import human_palm_axes
from smooth_operator.human.operator import FingerProfile, OperatorProfile
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.teleop.opencv import opencv
from smooth_operator.teleop.pages.hand_view import HandView, Rgb
from smooth_operator.teleop.pages.live.arm_room import ArmRoom, SceneryNodes
from smooth_operator.teleop.pages.page_layout import FOREARM, GAP, Aiming, view_axes
from smooth_operator.teleop.pages.scene import TRANSLUCENT, HandRow, RobotBodies, TargetMarks
from smooth_operator.types import Side

_LABEL: Final = 0.016  # from there to the label [m]
_LEGEND: Final = 84.0  # height of what lies over the canvas's lower edge [px]
_TRIAL: Final = 120.0  # height of what a trial's state takes above [px]
_FONT: Final = 1.25  # size of the labels
_FLOOR: Final = 1.6  # width and depth of the floor [m]
_CELLS: Final[Rgb] = (82, 90, 102)
_SECTIONS: Final[Rgb] = (122, 132, 146)
_VIEW: Final = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # rows: right, up, toward the viewer


class LiveScene:
    """Builds the nodes once, then shows what the loop sends.

    Every palm is turned so that one looks at it with the fingers up.

    Args:
        server: where to draw.
        hands: side -> robot hand.
        simulated: True if there is a simulated hand.
        drawn: side -> the same hand on a model with meshes, with the same joints by name, in any
            order; see ``on_model``. It can be added later.
        arm: settings of the arms that carry the hands; None for none.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        hands: Mapping[Side, Hand],
        simulated: bool,
        drawn: Mapping[Side, Hand] | None = None,
        arm: ArmSettings | None = None,
    ) -> None:
        self.simulated = simulated
        self.scenery_number = 0
        self._own = False  # the operator's own hand is shown at a task, too
        sides: tuple[Side, ...] = ("left", "right")
        order = [side for side in sides if side in hands]
        self._sides = {side: _SideView(server.scene, hands[side], simulated) for side in order}
        for side, hand in (drawn or {}).items():
            self._sides[side].add_meshes(HandView(hand))
        self._room = None if arm is None else ArmRoom(server.scene, hands, arm, simulated)
        self._server = server
        # viser encodes pictures by OpenCV where it can be imported; an import of its own that fails
        # would leave a folder on the module path that ends processes which are started later.
        with contextlib.suppress(SmoothOperatorError):
            opencv()
        server.scene.set_background_image(background(), format="png")
        self._floor = server.scene.add_grid(
            "/floor", _FLOOR, _FLOOR, plane="xy", cell_size=0.02, section_size=0.1,
            cell_color=_CELLS, section_color=_SECTIONS, fade_distance=2.0,
        )  # fmt: skip
        centre, half = self._arrange()
        self.aiming = Aiming(server, _VIEW, centre, half, _LEGEND)

    def _arrange(self) -> tuple[Float[np.ndarray, "3"], tuple[float, float]]:
        """Give each hand its place; where the picture's middle is, and half its size [m]."""
        low = np.min([view.low for view in self._sides.values()], axis=0)
        high = np.max([view.high for view in self._sides.values()], axis=0)
        size = high - low
        # One hand: human next to robot. Two: each human above its robot.
        # At a task: the robots alone, large.
        alone = self.has_task and not self._own
        columns, rows = (2, 1) if len(self._sides) == 1 else (len(self._sides), 2)
        if alone:
            columns, rows = len(self._sides), 1
        for column, view in enumerate(self._sides.values()):
            right = (size[0] + GAP) * column
            up = (size[1] + 2 * GAP) * (rows - 1)
            step = np.array([size[0] + GAP, 0.0])
            places = (
                (np.zeros(2), step)
                if rows == 1
                else (np.array([right, up]), np.array([right, 0.0]))
            )
            if alone:
                places = (np.array([right - step[0], 0.0]), np.array([right, 0.0]))
            view.show_human(not alone)
            view.put(*places)
        spread = (columns - 1) * (size[0] + GAP), (rows - 1) * (size[1] + 2 * GAP)
        middle = (low + high + np.array([*spread, 0.0])) / 2
        if self.has_task:
            middle[2] = high[2]  # what is nearest, which looks largest, is to fit in, too
        half = (float(size[0] + spread[0]) / 2, float(size[1] + spread[1]) / 2)
        if self._room is not None:  # to the right of the hands
            wide, high_, _ = self._room.size
            self._room.put(middle + np.array([half[0] + GAP + wide / 2, 0.0, 0.0]), _VIEW)
            middle = middle + np.array([(GAP + wide) / 2, 0.0, 0.0])
            half = (half[0] + (GAP + wide) / 2, max(half[1], high_ / 2 + _LABEL))
        ground = np.array([middle[0], middle[1] - half[1] - _LABEL, (low[2] + high[2]) / 2])
        self._floor.position = ground @ _VIEW
        return middle @ _VIEW, half

    def _aim(self) -> None:
        """Give the hands their places again, and have every browser look at them."""
        self.aiming.centre, self.aiming.half = self._arrange()
        self.aiming.above = _TRIAL if self.has_task else 0.0
        for client in self._server.get_clients().values():
            self.aiming.aim(client)

    @property
    def has_task(self) -> bool:
        """True if a hand works on the object of a task."""
        return any(view.scenery.there for view in self._sides.values())

    def draw(self, hands: Mapping[Side, Mapping[str, Any]]) -> None:
        """Show the hands; see ``LiveSession.look``."""
        for side, view in self._sides.items():
            if side in hands:
                view.draw(hands[side])
                if self._room is not None:
                    self._room.draw(side, hands[side])

    def draw_scenery(self, scenery: Mapping[str, Any]) -> None:
        """Show what the hands work on; see ``Scenery``."""
        self.scenery_number = scenery["number"]
        if "parts" in scenery:
            for side, view in self._sides.items():
                view.scenery.show(scenery["parts"].get(side, ()))
                if self._room is not None:
                    self._room.show_scenery(side, scenery["parts"].get(side, ()))
                view.face(scenery["views"].get(side), scenery["poses"].get(side))
            self._floor.visible = not self.has_task  # which stands on its own floor
            self._aim()
        for side, view in self._sides.items():
            pose, fixture = scenery["poses"].get(side), scenery["fixtures"].get(side)
            view.scenery.draw(pose)
            view.scenery.hide_object(side in scenery.get("away", ()))
            if self._room is not None:
                there = self._room.draw_scenery(side, pose, fixture)
                if there is not None:  # what stands in the room goes past a hand that moves
                    view.scenery.place(there)

    def set_operators(self, operators: Mapping[Side, Mapping[str, Any] | None]) -> None:
        """Sets the calibrations that correct the human hands."""
        for side, view in self._sides.items():
            operator = operators.get(side)
            view.operator = None if operator is None else operator_of(operator)

    def set_overlay(self, overlay: bool) -> None:
        """Each human hand inside its robot, or side by side."""
        for view in self._sides.values():
            view.set_overlay(overlay)

    def set_own(self, visible: bool) -> None:
        """Show or hide the operator's own hand while the robot works on a task."""
        self._own = visible
        self._aim()

    def set_keyvectors(self, visible: bool) -> None:
        """Show or hide the thumb-to-tip lines, and the places of the fingertips."""
        for view in self._sides.values():
            view.row.set_keyvectors(visible)
            view.targets.set_visible(visible)

    def set_simulated(self, visible: bool) -> None:
        """Show or hide the simulated hand in the robot's place."""
        for view in self._sides.values():
            view.set_simulated(visible)

    def add_meshes(self, views: Mapping[Side, HandView]) -> None:
        """Draw robots on models with meshes from now on; the simple shapes stay for a switch."""
        for side, view in views.items():
            self._sides[side].add_meshes(view)

    def set_meshes(self, visible: bool) -> None:
        """Draw the meshes, where there are some, or simple shapes."""
        for view in self._sides.values():
            view.set_meshes(visible)


class _SideView:
    """The hands of one side."""

    def __init__(self, scene: viser.SceneApi, hand: Hand, simulated: bool) -> None:
        side = hand.spec.side
        self._hand, self._nodes = hand, scene
        self.operator: OperatorProfile | None = None
        self._palm_axes = human_palm_axes(hand)
        view = HandView(hand, simple=True)
        # From the palm frame to the picture: rows right, up, toward become x, z, -y.
        self._axes = view_axes(view)
        self._model_root = f"/{side}/robot/model"
        self._with_simulated = self._show_simulated = simulated
        self._state: Mapping[str, Any] = {
            "positions": hand.full_configuration(hand.neutral), "human": None, "latched": None,
            "targets": None,
        }  # fmt: skip
        self._tips = [TIPS[FINGERS.index(finger)] for finger in hand.fingers]
        words = {"human": f"human {side}", "robot": f"{hand.name} {side}"}
        self.row = HandRow(
            scene, f"/{side}", self._tips, words, anchor="center-center", font_screen_scale=_FONT
        )
        self._simple = self._bodies(view, self._model_root)
        self._meshes: RobotBodies | None = None
        self._want_meshes = True
        self.targets = TargetMarks(scene, len(self._tips), f"/{side}/robot/targets")
        self.scenery = SceneryNodes(scene, f"/{side}/robot/scenery")
        self._points = self._hull()
        self._places = (np.zeros(3), np.zeros(3))
        self._overlaid, self._with_human = False, True
        self.face(None, None)
        self.draw(self._state)

    def _bodies(self, view: HandView, root: str) -> RobotBodies:
        meshes = view.without_forearm(FOREARM, self._axes[1])
        return RobotBodies(
            self._nodes, self._hand, view, root, meshes=meshes, second=self._with_simulated
        )

    @property
    def _robot(self) -> RobotBodies:
        """The bodies that are drawn."""
        return self._meshes if self._meshes and self._want_meshes else self._simple

    def add_meshes(self, view: HandView) -> None:
        self._meshes = self._bodies(view, f"{self._model_root}_meshes")
        self._show()

    def set_meshes(self, visible: bool) -> None:
        self._want_meshes = visible
        self._show()

    def _show(self) -> None:
        """Show what is to be drawn in the present pose, and hide the other."""
        self._robot.draw(*self._poses(self._state))
        for bodies in filter(None, (self._simple, self._meshes)):
            bodies.show(bodies is self._robot, self._show_simulated)
            bodies.first.set_opacity(TRANSLUCENT if self._overlaid else None)

    def show_human(self, visible: bool) -> None:
        self._with_human = self.row.roots["human"].visible = visible

    def put(self, human: Float[np.ndarray, "2"], robot: Float[np.ndarray, "2"]) -> None:
        """Places of the two when they don't overlap: right and up [m]."""
        here, there = (np.array([*place, 0.0]) @ _VIEW for place in (human, robot))
        self._places = (here, there)
        self.set_overlay(self._overlaid)

    def _poses(self, state: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray | None]:
        """Joint positions of the solid hand, and of the one that is seen where it differs."""
        every = np.asarray(state["positions"], float)
        if not self._with_simulated or state.get("simulated") is None:
            return every, None
        other = np.asarray(state["simulated"], float)
        # with a task, the hand that touches the object is the one to look at
        return (other, every) if self.scenery.there else (every, other)

    def draw(self, state: Mapping[str, Any]) -> None:
        self._state = state
        every, other = self._poses(state)
        self._robot.draw(every, other)
        latched = np.isin(self._hand.fingers[1:], state["latched"] or ())
        robot_tips = self._hand.tips(every)
        self.row.draw(self._aligned(state), [robot_tips], latched)
        self.targets.draw(state.get("targets"), robot_tips)

    def set_overlay(self, overlay: bool) -> None:
        self._overlaid = overlay
        human, robot = self._places
        self.row.roots["human"].position = robot if overlay else human
        self.row.roots["robot"].position = robot
        self.row.labels["human"].visible = self._with_human and not overlay
        self._show()

    def set_simulated(self, visible: bool) -> None:
        self._show_simulated = visible
        self._show()

    def _aligned(self, state: Mapping[str, Any]) -> Float[np.ndarray, "21 3"]:
        """The human hand in the palm frame, as the method sees it; NaN where there is none."""
        if state.get("human") is None:
            return np.full((21, 3), np.nan)
        landmarks = np.asarray(state["human"], float).reshape(21, 3)
        missing = ~np.isfinite(landmarks).all(axis=-1)
        if missing[list(self._hand.align_indices)].any():
            return np.full((21, 3), np.nan)
        safe = np.where(missing[:, None], reference_landmarks(self._hand), landmarks)
        config = AlignmentConfig(state.get("scale"), self.operator)
        fit = palm_alignment(safe, self._hand, config)
        if not fit.condition >= MIN_CONDITION:
            return np.full((21, 3), np.nan)
        aligned = fit.apply(safe)
        if self.operator is not None:
            aligned = self.operator.correct(aligned, fit.scale, self._hand, self._palm_axes)
        return np.where(missing[:, None], np.nan, aligned)

    def face(
        self, axes: Sequence[Sequence[float]] | None, object_pose: Sequence[float] | None
    ) -> None:
        """Turn the hands: as one looks at a scene, or at a palm with the fingers up.

        Args:
            axes: (3, 3) rows right, up and toward the viewer in the palm frame; None for the palm.
            object_pose: pose of what the hand works on, which is to be in the picture, too.
        """
        rows = self._axes if axes is None else np.asarray(axes, float)
        turn, wxyz = _VIEW.T @ rows, np.empty(4)
        mujoco.mju_mat2Quat(wxyz, turn.ravel())
        for root in self.row.roots.values():
            root.wxyz = wxyz
        end = self._hand.wrist - (FOREARM + _LABEL) * self._axes[1]
        points = np.concatenate([self._points, end[None]])
        if object_pose is not None:
            points = np.concatenate([points, self.scenery.bounds(object_pose)])
        extent = points @ rows.T
        self.low, self.high = extent.min(axis=0), extent.max(axis=0)
        for label in self.row.labels.values():
            label.position = end

    def _hull(self) -> Float[np.ndarray, "p 3"]:
        """(p, 3) points that hands of either kind stay within, in the palm frame [m]."""
        hand = self._hand
        neutral, straight = hand.neutral, np.clip(0.0, *hand.limits.T)
        points = [hand.landmark_positions(np.stack([neutral, straight])).reshape(-1, 3)]
        bodies = [self._simple.corners(hand.full_configuration(q)) for q in (neutral, straight)]
        return np.concatenate([*points, *bodies])


_SKY: Final[Rgb] = (72, 80, 92)
_GROUND: Final[Rgb] = (44, 49, 57)


def background() -> UInt8[np.ndarray, "h w 3"]:
    """A grey that is lighter above: dark bodies and the finger colours stand out on it."""
    shade = np.linspace(_SKY, _GROUND, 64).round().astype(np.uint8)
    return np.repeat(shade[:, None], 2, axis=1)


def operator_of(content: Mapping[str, Any]) -> OperatorProfile:
    """A profile that came as JSON."""
    fingers = tuple(
        FingerProfile(**{**finger, "bones": tuple(finger["bones"])})
        for finger in content["fingers"]
    )
    return OperatorProfile(
        **{
            **content,
            "fingers": fingers,
            "palm_rotation": tuple(content["palm_rotation"]),
            "apply": tuple(content["apply"]),
        }
    )
