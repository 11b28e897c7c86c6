"""The robot hand on the page: one node per body, moved by forward kinematics of the frame."""

from __future__ import annotations

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Bool, Float

from smooth_operator.ui.human import lit_tips
from smooth_operator.ui.meshes import body_meshes, finger_of_body
from smooth_operator.ui.palette import HIGHLIGHT, PALM, finger_colors, linear
from smooth_operator.ui.playback import Playback

_TIP, _PINCHED = 0.0035, 0.0075  # radii of the fingertip markers [m]
_GHOST = 0.45  # opacity of the robot when the human hand stands inside it


class RobotView:
    """Draws the robot hand; kinematics run per frame, so memory does not grow with the recording.

    Args:
        scene: where to draw.
        playback: what to draw.
        root: name of the parent node, which places the whole hand.
    """

    def __init__(self, scene: viser.SceneApi, playback: Playback, root: str) -> None:
        self._playback = playback
        self._data = mujoco.MjData(playback.model)
        meshes = body_meshes(playback.model, playback.bodies)
        owner = finger_of_body(playback.model, playback.qpos, playback.robot_tips)
        self._palette = finger_colors(len(playback.fingers))
        self._boxes = {body: mesh.bounding_box.vertices for body, mesh in meshes.items()}
        self._bodies = {
            body: scene.add_mesh_simple(
                f"{root}/body_{body}",
                mesh.vertices,
                mesh.faces,
                color=PALM if owner[body] < 0 else tuple(self._palette[owner[body]].tolist()),
                side="double",  # users' meshes are not always wound outward
            )
            for body, mesh in meshes.items()
        }
        ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
        count = len(playback.fingers)
        self._tips = scene.add_batched_meshes_simple(
            f"{root}/tips",
            ball.vertices,
            ball.faces,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            batched_positions=playback.robot_tips[0],
            batched_scales=np.full(count, _TIP),
            batched_colors=linear(self._palette),
            lod="off",
        )

    def draw(self, frame: int, pinched: Bool[np.ndarray, " G"]) -> None:
        """Show one frame.

        Args:
            frame: index of the frame.
            pinched: (F-1,) which fingers the human pinches with the thumb.
        """
        self._pose(frame)
        for body, node in self._bodies.items():
            node.position = self._data.xpos[body]  # unchanged poses are not sent again
            node.wxyz = self._data.xquat[body]
        lit = lit_tips(pinched)
        self._tips.batched_positions = self._playback.robot_tips[frame]
        self._tips.batched_scales = np.where(lit, _PINCHED, _TIP)
        colors = np.where(lit[:, None], np.array(HIGHLIGHT), self._palette)
        self._tips.batched_colors = linear(colors)

    def set_ghost(self, ghost: bool) -> None:
        """Make the hand see-through, for looking at the human hand inside it."""
        for node in self._bodies.values():
            node.opacity = _GHOST if ghost else None

    def bounds(self, samples: int = 16) -> Float[np.ndarray, "N 3"]:
        """(N, 3) corners of the bodies' boxes at some frames, in the model's world frame [m]."""
        points = [self._playback.robot_tips.reshape(-1, 3)]
        for frame in np.unique(np.linspace(0, len(self._playback) - 1, samples).astype(int)):
            self._pose(int(frame))
            for body, box in self._boxes.items():
                rotation = self._data.xmat[body].reshape(3, 3)
                points.append(box @ rotation.T + self._data.xpos[body])
        return np.concatenate(points)

    def _pose(self, frame: int) -> None:
        self._data.qpos[:] = self._playback.qpos[frame]
        mujoco.mj_kinematics(self._playback.model, self._data)
