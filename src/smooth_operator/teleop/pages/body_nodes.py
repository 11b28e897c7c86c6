"""A robot hand on a page: one node per body, moved by forward kinematics, and balls at its tips."""

from __future__ import annotations

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Bool, Float, Int

from smooth_operator.teleop.pages.human import lit_tips
from smooth_operator.teleop.pages.palette import HIGHLIGHT, PALM, Rgb, finger_colors, linear

_TIP, _PINCHED = 0.0035, 0.0075  # radii of the fingertip markers [m]


class BodyNodes:
    """Draws the bodies of a model where its joints put them, in the model's world frame.

    Args:
        scene: where to draw.
        model: the robot hand.
        meshes: body -> its surface.
        owner: (nbody,) finger of each body, -1 for the palm.
        root: name of the parent node.
        color: of all of it; as its fingers are if left out.
        opacity: 0 to 1; None for solid.
        scale: of each body about its own origin: a little less hides it in one that stands alike.
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
        """Where the bodies are, without drawing them."""
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
        count: of fingers.
        name: of the node.
    """

    def __init__(self, scene: viser.SceneApi, count: int, name: str) -> None:
        self._palette = finger_colors(count)
        ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
        self.node = scene.add_batched_meshes_simple(
            name,
            ball.vertices,
            ball.faces,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            batched_positions=np.zeros((count, 3)),
            batched_scales=np.full(count, _TIP),
            batched_colors=linear(self._palette),
            lod="off",
        )

    def draw(self, tips: Float[np.ndarray, "F 3"], pinched: Bool[np.ndarray, " G"]) -> None:
        """Show tips [m], and which fingers pinch with the thumb."""
        lit = lit_tips(pinched)
        self.node.batched_positions = tips
        self.node.batched_scales = np.where(lit, _PINCHED, _TIP)
        colors = np.where(lit[:, None], np.array(HIGHLIGHT), self._palette)
        self.node.batched_colors = linear(colors)
