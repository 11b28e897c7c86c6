"""The three-dimensional part of the page: the hands, their keyvectors, their places."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Bool, Float, Int

from smooth_operator.teleop.pages.hand_view import body_meshes, finger_of_body, without_forearm
from smooth_operator.teleop.pages.human import (
    BodyNodes,
    HumanView,
    TipBalls,
    keyvector_colors,
    thumb_lines,
)
from smooth_operator.teleop.pages.page_layout import FOREARM, Aiming, plan, view_axes
from smooth_operator.teleop.pages.playback import Playback, SimpleShapes

_LINE = 0.0022  # thickness of a keyvector [m]


class Scene:
    """Builds the nodes once, then shows any frame.

    Args:
        server: the viser server to draw on.
        runs: what to draw: the human of the first, the robot of each.
        below: height of a panel that covers the lower edge of the canvas [px].
    """

    def __init__(
        self, server: viser.ViserServer, runs: Sequence[Playback], below: float = 0.0
    ) -> None:
        self._runs = tuple(runs)
        first = self._runs[0]
        self._pinches = first.pinches()
        scene = server.scene
        self._names = ("human", *(f"robot_{i}" for i in range(len(self._runs))))
        self._roots = {name: scene.add_frame(f"/{name}", show_axes=False) for name in self._names}
        self._human = HumanView(scene, first.human_tips, "/human")
        self._robots = [
            RobotView(scene, run, f"/{name}")
            for run, name in zip(self._runs, self._names[1:], strict=True)
        ]
        self._layout = plan(first, *(robot.bounds() for robot in self._robots))
        count = len(first.fingers)
        none = np.zeros(count - 1, bool)
        self._lines = {
            name: scene.add_line_segments(
                f"/{name}/keyvectors",
                np.zeros((count - 1, 2, 3)),
                keyvector_colors(count, none),
                thickness=_LINE,
            )
            for name in self._names
        }
        words = ("human", *(run.label for run in self._runs))
        self._labels = [
            scene.add_label(f"/{name}/label", word, position=top, anchor="bottom-center")
            for name, word, top in zip(self._names, words, self._layout.tops, strict=True)
        ]
        layout = self._layout
        axes = np.stack([layout.right, layout.up, layout.toward])
        self._aiming = Aiming(server, axes, layout.centre, layout.half, below)
        self.set_overlay(False)

    def draw(self, frame: int) -> None:
        """Show one frame of all hands."""
        pinched = self._pinches[frame]
        first = self._runs[0]
        self._human.draw(first.human[frame], pinched)
        tips = [first.human[frame, list(first.human_tips)]]
        for run, robot in zip(self._runs, self._robots, strict=True):
            robot.draw(frame, pinched)
            tips.append(run.robot_tips[frame])
        colors = keyvector_colors(len(first.fingers), pinched)
        for lines, points in zip(self._lines.values(), tips, strict=True):
            lines.points = thumb_lines(points)
            lines.colors = colors

    def set_overlay(self, overlay: bool) -> None:
        """Put all hands in one place, or side by side."""
        shifts = (self._layout.human_shift, *self._layout.robot_shifts)
        for root, shift in zip(self._roots.values(), shifts, strict=True):
            root.position = np.zeros(3) if overlay else shift
        for label in self._labels:
            label.visible = not overlay
        for robot in self._robots:
            robot.set_translucent(overlay)

    def set_meshes(self, visible: bool) -> None:
        """Draw the makers' meshes, or simple shapes, where a run has both."""
        for robot in self._robots:
            robot.set_meshes(visible)

    def set_keyvectors(self, visible: bool) -> None:
        """Show or hide the thumb-to-tip lines."""
        for lines in self._lines.values():
            lines.visible = visible

    def aim(self, client: viser.ClientHandle) -> None:
        """Point one browser's camera at both hands, whatever the shape of its window."""
        self._aiming.aim(client)

    def greet(self, client: viser.ClientHandle) -> None:
        """Aim a new browser's camera, and again when its canvas changes shape."""
        self._aiming.greet(client)

    def forget(self, client: viser.ClientHandle) -> None:
        """Drop what was kept for a browser that has left."""
        self._aiming.forget(client)


_TRANSLUCENT = 0.45  # opacity of the robot when the human hand is drawn inside it


class RobotView:
    """Draws the robot hand; kinematics run per frame, so memory does not grow with the recording.

    Args:
        scene: where to draw.
        playback: what to draw.
        root: name of the parent node, which places the whole hand.
    """

    def __init__(self, scene: viser.SceneApi, playback: Playback, root: str) -> None:
        self._playback = playback
        meshes = body_meshes(playback.model, playback.bodies)
        owner = finger_of_body(playback.model, playback.qpos, playback.robot_tips)
        meshes = _cut(playback, meshes, owner)
        self._boxes = {body: mesh.bounding_box.vertices for body, mesh in meshes.items()}
        self._hand = BodyNodes(scene, playback.model, meshes, owner, root)
        self._bodies = self._hand.nodes
        self._simple: BodyNodes | None = None
        if (simple := playback.simple) is not None:
            base = f"{root}/simple"
            scene.add_frame(base, show_axes=False, wxyz=simple.wxyz, position=simple.position)
            of = finger_of_body(simple.model, simple.qpos, _tips(playback, simple))
            self._simple = BodyNodes(scene, simple.model, dict(simple.meshes), of, base)
            self.set_meshes(playback.show_meshes)
        self._balls = TipBalls(scene, len(playback.fingers), f"{root}/tips")
        self._tips = self._balls.node

    def draw(self, frame: int, pinched: Bool[np.ndarray, " G"]) -> None:
        """Show one frame.

        Args:
            frame: index of the frame.
            pinched: (F-1,) which fingers the human pinches with the thumb.
        """
        self._hand.draw(self._playback.qpos[frame])
        if self._simple is not None and self._playback.simple is not None:
            self._simple.draw(self._playback.simple.qpos[frame])
        self._balls.draw(self._playback.robot_tips[frame], pinched)

    def set_translucent(self, translucent: bool) -> None:
        """Make the hand see-through, for looking at the human hand inside it."""
        for bodies in filter(None, (self._hand, self._simple)):
            bodies.set_opacity(_TRANSLUCENT if translucent else None)

    def set_meshes(self, visible: bool) -> None:
        """Draw the model, or the hand in simple shapes."""
        if self._simple is not None:
            self._hand.set_visible(visible)
            self._simple.set_visible(not visible)

    def bounds(self, samples: int = 16) -> Float[np.ndarray, "N 3"]:
        """(N, 3) corners of the bodies' boxes at some frames, in the model's world frame [m]."""
        points = [self._playback.robot_tips.reshape(-1, 3)]
        data = self._hand.data
        for frame in np.unique(np.linspace(0, len(self._playback) - 1, samples).astype(int)):
            self._hand.place(self._playback.qpos[frame])
            for body, box in self._boxes.items():
                rotation = data.xmat[body].reshape(3, 3)
                points.append(box @ rotation.T + data.xpos[body])
        return np.concatenate(points)


def _tips(playback: Playback, simple: SimpleShapes) -> Float[np.ndarray, "T F 3"]:
    """(T, F, 3) fingertips in the world of the simple shapes' model [m]."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, simple.wxyz)
    return np.asarray((playback.robot_tips - simple.position) @ matrix.reshape(3, 3))


def _cut(
    playback: Playback, meshes: dict[int, trimesh.Trimesh], owner: Int[np.ndarray, " nbody"]
) -> dict[int, trimesh.Trimesh]:
    """The surfaces without what is far below the wrist in the first frame."""
    data = mujoco.MjData(playback.model)
    data.qpos[:] = playback.qpos[0]
    mujoco.mj_kinematics(playback.model, data)
    poses = {body: (data.xmat[body].reshape(3, 3), data.xpos[body]) for body in meshes}
    up = view_axes(playback)[1]
    cut = without_forearm(meshes, poses, owner, playback.robot_wrist - FOREARM * up, up)
    return cut or meshes
