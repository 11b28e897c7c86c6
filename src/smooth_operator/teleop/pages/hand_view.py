"""Shape, colours and axes of a robot hand for pages and pictures, and where to place the camera."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int, UInt8
from trimesh import intersections
from trimesh.graph import smooth_shade

from smooth_operator import landmarks
from smooth_operator.hands.capsules import hand_capsules
from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS
from smooth_operator.poses import rotate
from smooth_operator.retargeting.palm import human_palm_axes

if TYPE_CHECKING:
    import viser


def view_basis(hand: Hand) -> Float[np.ndarray, "3 3"]:
    """Axes of the view in the palm frame; its rows point right, up and towards the viewer, with
    fingers up and palm visible.

    The thumb of a right hand is on the right, as when you look at your own palm, and that of a left
    hand on the left. The jaws of a gripper are on both sides of its middle.
    """
    at = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True))
    bases = [at[LANDMARKS[BASES[FINGERS.index(finger)]]] for finger in hand.fingers]
    long = bases if hand.spec.gripper else bases[1:]
    up = np.mean(long, axis=0) - hand.wrist
    across = bases[0] - bases[-1]
    if hand.spec.side == "left":
        across = -across
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    right = across - up * (across @ up)
    length = float(np.linalg.norm(right))
    if length < 1e-6:  # finger bases in line with the wrist: any direction across will do
        right = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        length = float(np.linalg.norm(right))
    right /= length
    return np.stack([right, up, np.cross(right, up)])


class HandView:
    """Surfaces of a robot hand, and their poses in the palm frame [m].

    With ``simple``, the surfaces are simple shapes even if the model has meshes.
    """

    def __init__(self, hand: Hand, *, simple: bool = False) -> None:
        self.hand = hand
        self._data = mujoco.MjData(hand.model)
        self._palm = hand.model.body(hand.spec.palm).id
        meshes = {} if simple else body_meshes(hand.model, hand.bodies)
        self.meshes = meshes or _simple_meshes(hand)
        self.finger_of_body = finger_of_body(hand)

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) rows that point right, up (distal) and towards a viewer who looks at the palm."""
        if self.hand.spec.gripper:  # it has no palm to lay a human one on
            return view_basis(self.hand)
        distal, radial, palmar = human_palm_axes(self.hand)
        # A viewer of the palm of a right hand has its thumb on the right.
        right = radial if self.hand.spec.side == "right" else -radial
        return np.stack([right, distal, palmar])

    def bodies(
        self, q: Float[np.ndarray, " m"]
    ) -> dict[int, tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]]:
        """Rotation and position of each body with a mesh, for actuated joint positions q [rad]."""
        self._data.qpos[:] = self.hand.qpos(self.hand.full_configuration(q))
        mujoco.mj_kinematics(self.hand.model, self._data)
        rotation = self._data.xmat.reshape(-1, 3, 3)
        palm, origin = rotation[self._palm], self._data.xpos[self._palm]
        return {
            body: (palm.T @ rotation[body], palm.T @ (self._data.xpos[body] - origin))
            for body in self.meshes
        }

    def without_forearm(
        self, below: float, distal: Float[np.ndarray, "3"]
    ) -> dict[int, trimesh.Trimesh]:
        """The meshes, with the forearm cut off.

        Args:
            below: length of forearm to keep below the wrist [m].
            distal: unit vector along the forearm, toward the fingers.
        """
        poses, point = self.bodies(self.hand.neutral), self.hand.wrist - below * distal
        slice_faces: Any = intersections.slice_faces_plane  # untyped
        cut: dict[int, trimesh.Trimesh] = {}
        for body, whole in self.meshes.items():
            mesh = whole
            if self.finger_of_body[body] < 0:
                rotation, position = poses[body]
                vertices, faces, *_ = slice_faces(
                    whole.vertices,
                    whole.faces,
                    rotation.T @ distal,
                    rotation.T @ (point - position),
                )
                # process: merged vertices would average the normals across the edges
                mesh = trimesh.Trimesh(vertices, faces, process=False)
            if len(mesh.faces):
                cut[body] = mesh
        return cut or self.meshes

    def bones(self) -> list[tuple[int, int, int]]:
        """Each line between landmarks as (finger, from, to), with indices into ``hand.tree``."""
        names = self.hand.tree.names
        lines = []
        for number, finger in enumerate(self.hand.fingers):
            base = BASES[FINGERS.index(finger)]
            chain = [LANDMARKS[0], *LANDMARKS[base : base + 4]]
            at = [names.index(name) for name in chain if name in names]
            lines += [(number, a, b) for a, b in pairwise(at)]
        return lines


def palm_to_model(hand: Hand) -> Float[np.ndarray, "7"]:
    """Pose of the model's world in the palm frame, which does not depend on the joints."""
    data = mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_kinematics(hand.model, data)
    palm, pose = data.body(hand.spec.palm), np.empty(7)
    mujoco.mju_negPose(pose[:3], pose[3:], palm.xpos, palm.xquat)
    return pose


def moved(pose: Float[np.ndarray, "*n 7"], points: Float[np.ndarray, "*n 3"]) -> np.ndarray:
    """Points whose coordinates are given in a frame with this pose, in the frame of the pose."""
    return np.asarray(rotate(pose[..., 3:], points) + pose[..., :3])


_Parts = dict[int, list[trimesh.Trimesh]]  # body -> its surfaces


def _merged(parts: _Parts) -> dict[int, trimesh.Trimesh]:
    """Merges all surfaces of each body into one mesh; returns body -> mesh."""
    merge: Any = trimesh.util.concatenate  # untyped: returns a mesh for meshes
    return {body: merge(pieces) for body, pieces in parts.items()}


def _simple_meshes(hand: Hand) -> dict[int, trimesh.Trimesh]:
    """Body -> convex hulls of its self-collision capsules, one for each shape, in its frame [m]."""
    shapes: dict[tuple[int, int], list[Float[np.ndarray, "n 3"]]] = {}
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0).vertices
    for number, capsule in enumerate(hand_capsules(hand)):
        if capsule.radius > _VISIBLE:
            own = capsule.geom if capsule.geom >= 0 else -1 - number
            points = [end + capsule.radius * ball for end in capsule.ends]
            shapes.setdefault((capsule.body, own), []).extend(points)
    parts: _Parts = {}
    for (body, _), corners in shapes.items():
        parts.setdefault(body, []).append(trimesh.convex.convex_hull(np.concatenate(corners)))
    return _merged(parts) or body_meshes(hand.model, hand.bodies)


_VISIBLE: Final = 1e-4  # radius of the smallest capsule that is drawn [m]
_VISIBLE_GROUPS: Final = 3  # as in MuJoCo's viewer; collision shapes are usually in group 3
_CREASE = np.deg2rad(35.0)
"""Angle from which an edge is drawn sharp. Averaged normals would make CAD parts look inflated."""

_MOST_FACES = 20_000
"""Largest number of triangles per part, since a browser draws all of them in every picture. LEAP's
published parts have up to 87,000."""

_SPECK = 5e-4
"""Size below which a part is not drawn [m]. Some published models have stray specks far from the
hand, which would widen the picture."""


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Surface of a geom in the geom's frame [m]; None for planes, height fields and distance
    fields."""
    size = model.geom_size[geom]
    kind = int(model.geom_type[geom])
    kinds = mujoco.mjtGeom
    mesh: trimesh.Trimesh | None = None
    if kind == kinds.mjGEOM_SPHERE:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=size[0])
    elif kind == kinds.mjGEOM_ELLIPSOID:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
        mesh.apply_scale(size)
    elif kind == kinds.mjGEOM_CAPSULE:  # size: radius, half-length of the straight part
        mesh = trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=[24, 24])
        # releases of trimesh differ in the origin; MuJoCo's is the middle
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
    elif kind == kinds.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=32)
    elif kind == kinds.mjGEOM_BOX:
        mesh = trimesh.creation.box(extents=2 * size)
    elif kind == kinds.mjGEOM_MESH:
        mesh = _asset(model, int(model.geom_dataid[geom]))
    return mesh


def body_meshes(
    model: mujoco.MjModel, bodies: Bool[np.ndarray, " nbody"] | None = None
) -> dict[int, trimesh.Trimesh]:
    """Maps each body to the mesh of its geoms, in the body's frame [m].

    Uses the geoms of the visible groups or, if those are empty, all geoms. Vertices are split along
    sharp edges, so that averaged normals shade both curves and corners well.

    Args:
        bodies: (nbody,) True for the bodies to use; None for all.
    """
    own = np.ones(model.ngeom, bool) if bodies is None else bodies[model.geom_bodyid]
    shown = own & (model.geom_group < _VISIBLE_GROUPS)
    if not shown.any():
        shown = own
    parts: _Parts = {}
    assets: dict[int, trimesh.Trimesh | None] = {}  # phalanges often share a file
    for geom in np.flatnonzero(shown):
        asset = int(model.geom_dataid[geom])
        if asset < 0 or asset not in assets:
            mesh = geom_mesh(model, int(geom))
            if mesh is None or mesh.extents is None or mesh.extents.max() < _SPECK:
                mesh = None
            assets[asset] = None if mesh is None else smooth_shade(mesh, angle=_CREASE)
        shaded = assets[asset]
        if shaded is None:
            continue
        pose = np.eye(4)
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), model.geom_pos[geom]
        placed = shaded.copy().apply_transform(pose)
        parts.setdefault(int(model.geom_bodyid[geom]), []).append(placed)
    return _merged(parts)


def finger_of_body(hand: Hand) -> Int[np.ndarray, " nbody"]:
    """(nbody,) index of the finger to which each body belongs; -1 for the palm and all other
    bodies.

    A finger is the chain from its tip's body up to the first shared body, with all children.
    """
    model, points = hand.model, landmark_points(hand.model, hand.spec)
    chains = [_chain(model, points[name][0]) for name in hand.tip_names]
    palm = _chain(model, int(model.body(hand.spec.palm).id))
    owner = np.full(model.nbody, -1)
    for finger, chain in enumerate(chains):
        owner[list(chain.difference(palm, *chains[:finger], *chains[finger + 1 :]))] = finger
    for body in range(1, model.nbody):  # parents come first; includes bodies beyond the tip
        if owner[body] < 0:
            owner[body] = owner[model.body_parentid[body]]
    return owner


def _chain(model: mujoco.MjModel, body: int) -> set[int]:
    """The body and its ancestors, excluding the world."""
    chain = {0}
    while body:
        chain.add(body)
        body = int(model.body_parentid[body])
    return chain


def _asset(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    surface = trimesh.Trimesh(
        model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]].astype(np.float64),
        model.mesh_face[face : face + model.mesh_facenum[mesh]],
        process=True,  # merges duplicate vertices, which the crease splitting relies on
    )
    surface.update_faces(surface.nondegenerate_faces())  # slivers flicker as stray pixels
    return coarser(surface)


def coarser(mesh: trimesh.Trimesh, most: int = _MOST_FACES) -> trimesh.Trimesh:
    """Simplifies a mesh to at most ``most`` triangles, by merging the vertices in each cell of a
    grid.

    Source: Rossignac and Borrel, "Multi-resolution 3D approximations" (1993).
    """
    if len(mesh.faces) <= most:
        return mesh
    # a closed surface has about two triangles in each cell that it passes
    cell = float(np.sqrt(2 * mesh.area / most))
    while True:
        grid = np.floor((mesh.vertices - mesh.bounds[0]) / cell).astype(np.int64)
        _, cells, count = np.unique(grid, axis=0, return_inverse=True, return_counts=True)
        cells = cells.reshape(-1)
        faces = cells[mesh.faces]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
        if len(faces) <= most:
            break
        cell *= 1.25
    means = np.stack([np.bincount(cells, column) for column in mesh.vertices.T], axis=1)
    coarse = trimesh.Trimesh(means / count[:, None], faces, process=False)
    coarse.update_faces(coarse.unique_faces())
    coarse.remove_unreferenced_vertices()
    return coarse


Rgb = tuple[int, int, int]


def _rgb(code: str) -> Rgb:
    """Red, green and blue of a colour ``#rrggbb``, 0 to 255."""
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)


FINGER_COLORS: Final[tuple[Rgb, ...]] = tuple(map(_rgb, landmarks.FINGER_COLORS))
"""Colour of each finger, thumb first."""
HIGHLIGHT: Final[Rgb] = (240, 228, 66)
"""Colour of a pinching fingertip."""
SIMULATED: Final[Rgb] = (240, 228, 66)
"""Colour of the second of two overlapping robot hands, visible only where they differ."""
PALM: Final[Rgb] = (205, 205, 212)
"""Colour of the palm, the wrist and all other bodies that do not belong to a finger."""


def finger_colors(count: int) -> UInt8[np.ndarray, "F 3"]:
    """(F, 3) colours of the first ``count`` fingers; they repeat after five fingers."""
    return np.array([FINGER_COLORS[i % len(FINGER_COLORS)] for i in range(count)], np.uint8)


def linear(colors: UInt8[np.ndarray, "*n 3"]) -> UInt8[np.ndarray, "*n 3"]:
    """Converts sRGB colours to linear light; both range from 0 to 255.

    viser interprets the colours of instances and vertices as linear, and those of nodes as sRGB.
    """
    value = np.asarray(colors, np.float64) / 255
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(255 * light), np.uint8)  # IEC 61966-2-1


def css(color: Rgb | UInt8[np.ndarray, "3"]) -> str:
    """Formats a colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*(int(channel) for channel in color))


GAP = 0.03
"""Free space between two hands side by side [m]."""
FOV = float(np.deg2rad(32.0))
"""Vertical field of view [rad]; narrow, so that both hands are seen from nearly one direction."""
FOREARM = 0.03
"""Length of forearm below the wrist that the picture shows [m]."""

_MARGIN = 1.1
_LABEL = 0.012  # height of a label above the highest fingertip [m]
_SNAP = np.cos(np.deg2rad(30.0))  # a direction closer than this to a model axis becomes that axis
_TILT = np.deg2rad(8.0)  # angle between camera and palm normal, which shows depth


@dataclass(frozen=True, eq=False)
class Layout:
    """Where hands are placed side by side, in the palm frame [m].

    Attributes:
        human_shift, robot_shifts: offsets of the human and of each robot hand.
        centre: middle of the picture.
        tops: points above the human hand and each robot hand, before the shifts.
        half: half width and half height of the picture.
    """

    human_shift: Float[np.ndarray, "3"]
    robot_shifts: tuple[Float[np.ndarray, "3"], ...]
    centre: Float[np.ndarray, "3"]
    tops: tuple[Float[np.ndarray, "3"], ...]
    half: tuple[float, float]


def camera_for(
    axes: Float[np.ndarray, "3 3"],
    centre: Float[np.ndarray, "3"],
    half: tuple[float, float],
    aspect: float,
    covered: float = 0.0,
    above: float = 0.0,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Position and look-at point of a camera that sees the whole picture.

    Args:
        axes, centre, half: the picture; see ``Aiming``.
        aspect: width / height of the canvas.
        covered, above: fractions of the canvas height that controls cover at the bottom and at the
            top.
    """
    right, up, toward = axes
    tangent = np.tan(FOV / 2)
    free = 1.0 - covered - above
    width, height = half
    distance = _MARGIN * max(height / (free * tangent), width / (aspect * tangent))
    # the free part's middle is half of this share of a canvas height above the canvas's middle
    target = centre - up * (covered - above) * distance * tangent
    direction = toward + np.tan(_TILT) * (0.6 * right + up)
    return target + distance * direction / np.linalg.norm(direction), target


def plan(
    axes: Float[np.ndarray, "3 3"],
    human: Float[np.ndarray, "T 21 3"],
    wrist: Float[np.ndarray, "3"],
    *robots: Float[np.ndarray, "_ 3"],
) -> Layout:
    """Plans the layout for a recording: the human hand, and the robot hands to its right.

    Args:
        axes: (3, 3) rows: the picture's right, up and toward the viewer.
        human: (T, 21, 3) landmarks [m], NaN if missing. If all are missing, the layout uses the
            robot's size.
        wrist: (3,) wrist of one of the robots [m].
        robots: (N, 3) points that bound a robot hand over the recording [m].
    """
    points = human[np.isfinite(human).all(axis=-1)]
    points = (points if len(points) else robots[0]) @ axes.T
    low_h, high_h = points.min(axis=0) - 0.01, points.max(axis=0) + 0.01
    floor = min(low_h[1], float(axes[1] @ wrist)) - FOREARM
    boxes = [(low_h, high_h), *(_above(points @ axes.T, floor) for points in robots)]
    low = np.min([box[0] for box in boxes], axis=0)
    high = np.max([box[1] for box in boxes], axis=0)
    high[1] += _LABEL
    middle = (low + high) / 2
    widths = [(box[1] - box[0])[0] for box in boxes]
    width = sum(widths) + GAP * len(robots)
    left = middle[0] - width / 2
    shifts = []
    for box, own in zip(boxes, widths, strict=True):
        shifts.append((left - box[0][0]) * axes[0])
        left += own + GAP
    top = high[1]
    tops = [np.array([(a[0] + b[0]) / 2, top, (a[2] + b[2]) / 2]) @ axes for a, b in boxes]
    return Layout(
        human_shift=shifts[0],
        robot_shifts=tuple(shifts[1:]),
        centre=middle @ axes,
        tops=tuple(tops),
        half=(width / 2, float(high[1] - low[1]) / 2),
    )


def _above(
    points: Float[np.ndarray, "N 3"], floor: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Bounds of the part of a robot hand above ``floor``; the whole forearm would take up too
    much of the picture."""
    hand = points[points[:, 1] > floor]
    low, high = hand.min(axis=0), hand.max(axis=0)
    low[1] = max(points[:, 1].min(), floor)
    return low, high


def view_axes(view: HandView) -> Float[np.ndarray, "3 3"]:
    """(3, 3) rows that point right, up and towards the viewer, snapped to the palm frame's axes if
    close.

    Models are built along their axes, and a forearm that leans by 10 degrees looks like an error.
    """
    up, toward = _snap(view.axes[1]), _snap(view.axes[2])
    toward = toward - (toward @ up) * up
    length = float(np.linalg.norm(toward))
    toward = toward / length if length > 1e-9 else np.eye(3)[np.abs(up).argmin()]
    return np.stack([np.cross(up, toward), up, toward])


def _snap(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    axis = int(np.abs(vector).argmax())
    return np.sign(vector) * np.eye(3)[axis] if abs(vector[axis]) > _SNAP else vector


_PHONE = 0.75  # width / height of a canvas below which the panel is a sheet over its lower part
_SHEET = 0.44  # share of a phone's screen that the sheet covers at first
_MOST_BELOW, _MOST_ABOVE = 0.6, 0.2  # largest shares of a canvas that panels take from the picture


class Aiming:
    """Aims the cameras of all browsers at the picture.

    Args:
        axes: (3, 3) rows: the picture's right, up and toward the viewer.
        centre: its middle [m].
        half: its half width and half height [m].
        below: height of the panel at the lower edge of a desktop's canvas [px].

    Attributes:
        above: height of the panel at the upper edge of a canvas [px].
    """

    above = 0.0

    def __init__(
        self,
        server: viser.ViserServer,
        axes: Float[np.ndarray, "3 3"],
        centre: Float[np.ndarray, "3"],
        half: tuple[float, float],
        below: float = 0.0,
    ) -> None:
        self._axes, self.centre, self.half, self._below = axes, centre, half, below
        # client number -> size of the canvas [px] and camera position [m] of the last commands
        self._aims: dict[int, deque[tuple[tuple[int, int], np.ndarray]]] = {}
        up = axes[1]
        server.scene.set_up_direction(up)
        server.scene.configure_default_lights(cast_shadow=False)
        camera, (position, target) = server.initial_camera, camera_for(axes, centre, half, 1.4)
        self._initial = position
        camera.position, camera.look_at, camera.up = position, target, up
        camera.fov, camera.near, camera.far = FOV, 0.005, 50.0

    def aim(self, client: viser.ClientHandle) -> None:
        """Aims one browser's camera at the picture, depending on the shape of its canvas."""
        camera = client.camera
        height = max(camera.image_height, 1)
        panel = min(self._below / height, _MOST_BELOW)
        covered = _SHEET if camera.aspect < _PHONE else panel
        above = min(self.above / height, _MOST_ABOVE)
        position, target = camera_for(
            self._axes, self.centre, self.half, camera.aspect, covered, above
        )
        with client.atomic():
            camera.up_direction = self._axes[1]
            camera.fov = FOV
            camera.position = position
            camera.look_at = target
        aims = self._aims.setdefault(client.client_id, deque(maxlen=8))
        aims.append(((camera.image_width, camera.image_height), position))

    def greet(self, client: viser.ClientHandle) -> None:
        """Aims a browser's camera now, and again whenever its canvas changes shape.

        A canvas changes when the panel docks, a window is resized or a phone is turned. If the user
        has moved the view, it is left alone.
        """
        camera = client.camera
        before = (camera.image_width, camera.image_height), np.array(camera.position)
        self._aims[client.client_id] = deque([before], maxlen=8)
        self.aim(client)

        async def check(camera: viser.CameraHandle) -> None:
            aims = self._aims.get(client.client_id)
            if not aims:
                return
            # A report may be older than the last command, and a page that is still loading may
            # drop a command for its initial camera, of this scene or of the one before. At any of
            # these places no person has moved the view.
            ours = [position for _, position in aims]
            at = [np.allclose(camera.position, p, atol=1e-3) for p in (self._initial, *ours)]
            reshaped = aims[-1][0] != (camera.image_width, camera.image_height)
            if any(at) and (reshaped or not at[-1]):
                self.aim(client)

        client.camera.on_update(check)

    def forget(self, client: viser.ClientHandle) -> None:
        """Forgets a browser that has disconnected."""
        self._aims.pop(client.client_id, None)
