"""The robot hand on the page: one node per body, moved by forward kinematics of the frame."""

from __future__ import annotations

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Bool, Float, Int

from smooth_operator.teleop.pages.body_nodes import BodyNodes, TipBalls
from smooth_operator.teleop.pages.meshes import body_meshes, finger_of_body, without_forearm
from smooth_operator.teleop.pages.page_layout import FOREARM, view_axes
from smooth_operator.teleop.pages.playback import Playback, SimpleShapes

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
    kept = without_forearm(meshes, poses, owner, playback.robot_wrist - FOREARM * up, up)
    return kept or meshes
