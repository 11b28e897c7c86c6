"""The scene of a task on the page: its table or pedestal, and the object where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Float

_ROOM: Final = 1.5  # of an object's size is kept in the picture
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
        """Whether there is a scene."""
        return self._all is not None

    def bounds(self, pose: Sequence[float]) -> Float[np.ndarray, "c 3"]:
        """(c, 3) points around the object and where it goes next, in the palm frame [m].

        Args:
            pose: position and quaternion of the object.
        """
        return np.asarray(_ROOM * self._corners @ _rotation(pose[3:]).T + np.array(pose[:3]))

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
        """Where the object is: position [m] and quaternion; None leaves it where it was."""
        if self._object is not None and pose is not None:
            self._object.position = self._scale * np.array(pose[:3])
            self._object.wxyz = np.array(pose[3:])

    def hide_object(self, hidden: bool) -> None:
        """Whether there is no object now."""
        if self._object is not None and self._object.visible is hidden:
            self._object.visible = not hidden

    def place(self, position: Float[np.ndarray, "3"], wxyz: Float[np.ndarray, "4"]) -> None:
        """Where the frame of the scene is, in that of the node's parent."""
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
