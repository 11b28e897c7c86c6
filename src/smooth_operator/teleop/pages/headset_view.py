"""Describes the live page's scene in messages for a headset's page, which draws it around the
operator.

The page has no kinematics: it gets the shapes once, and then the poses of all bodies.
"""

from __future__ import annotations

import base64
import itertools
import time
from collections.abc import Mapping
from typing import Any, Final, get_args

import numpy as np
import trimesh
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import WRIST
from smooth_operator.poses import IDENTITY, compose, invert, quaternions
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.teleop.cameras import LATE_S
from smooth_operator.teleop.pages.live.live_scene import HandsScene, palm_fit
from smooth_operator.teleop.pages.live.live_session import LiveSession
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.teleop.sources.webxr.link import PICTURE
from smooth_operator.terminal import print_note
from smooth_operator.types import Side

_ROOT: Final = "/headset"
_NUMBERS: Final = itertools.count(1)
_WHITE: Final = 255
_FIT_EVERY_S: Final = 0.25
"""Period at which the place of the robot's palm on the operator's wrist is computed: it hardly
changes, and takes half of the time of an answer."""


class _Node:
    """A frame or some instances of a mesh; its attributes are those of viser's nodes.

    Args:
        parent: the frame in which it is placed; None for the root.
        mesh: vertices and faces; None for a frame and for nodes that are not drawn.
        values: attributes.
    """

    def __init__(
        self, nodes: NodeList, parent: _Node | None, mesh: Any, values: Mapping[str, Any]
    ) -> None:
        self.visible = True
        self.position, self.wxyz = np.zeros(3), IDENTITY[3:]
        self.scale, self.opacity, self.flat_shading = 1.0, None, False
        vars(self).update(values)
        self._nodes, self.parent, self.mesh = nodes, parent, mesh

    def remove(self) -> None:
        """Remove it from its list."""
        self._nodes.remove(self)

    @property
    def shown(self) -> bool:
        """True if neither the node nor a frame around it is hidden."""
        return self.visible and (self.parent is None or self.parent.shown)

    def values(self) -> Float[np.ndarray, "k v"]:
        """State of the node. For a frame: its pose (7). For a mesh: pose, three scales and linear
        colour (0 to 1) of each instance. NaN while the node is hidden."""
        if self.mesh is None:
            return np.concatenate([self.position, self.wxyz])[None]
        placed: Any = self
        block = np.full((len(placed.batched_positions), 13), np.nan, np.float32)
        if self.shown:
            block[:, :3] = self.scale * placed.batched_positions
            block[:, 3:7] = placed.batched_wxyzs
            block[:, 7:10] = self.scale * np.reshape(placed.batched_scales, (len(block), -1))
            block[:, 10:] = placed.batched_colors / _WHITE
        return block


class NodeList:
    """Takes the place of a viser server's scene: stores the nodes and reports which ones have
    changed.

    Attributes:
        number: a new number whenever a node was added or removed.
    """

    def __init__(self) -> None:
        self.number = 0
        self._nodes: dict[str, _Node] = {}
        self._sent: dict[int, bytes] = {}

    def add_frame(self, name: str, **values: Any) -> _Node:
        """Adds a frame."""
        return self._add(name, None, values)

    # Texts, floors and lines are not drawn in the headset.
    add_label = add_grid = add_line_segments = lambda self, *_, **values: _Node(
        self, None, None, values
    )

    def add_batched_axes(
        self, name: str, batched_wxyzs: Any, batched_positions: Any, **values: Any
    ) -> _Node:
        """Adds several sets of three axes."""
        long, thin = values.pop("axes_length"), 2 * values.pop("axes_radius")
        sizes = thin + (long - thin) * np.eye(3)
        rods = [trimesh.creation.box(s).apply_translation((s - thin) / 2) for s in sizes]
        mesh: Any = trimesh.util.concatenate(rods)
        many = len(batched_positions)
        return self.add_batched_meshes_simple(
            name,
            mesh.vertices,
            mesh.faces,
            batched_wxyzs=batched_wxyzs,
            batched_positions=batched_positions,
            batched_scales=np.ones(many),
            batched_colors=np.full((many, 3), _WHITE, np.uint8),
            flat_shading=True,
            **values,
        )

    def add_batched_meshes_simple(
        self, name: str, vertices: Any, faces: Any, **values: Any
    ) -> _Node:
        """Adds several instances of a mesh."""
        return self._add(name, (vertices, faces), values)

    def remove(self, node: _Node) -> None:
        """Removes a node."""
        self._nodes = {name: each for name, each in self._nodes.items() if each is not node}
        self.number = next(_NUMBERS)

    def index(self, node: _Node) -> int:
        """Position of a node in the description."""
        return list(self._nodes.values()).index(node)

    def describe(self) -> list[dict[str, Any]]:
        """Describes all nodes as JSON values; the next ``changes`` have the state of each."""
        self._sent.clear()
        nodes = list(self._nodes.values())
        described = []
        for name, node in self._nodes.items():
            parent = -1 if node.parent is None else nodes.index(node.parent)
            one: dict[str, Any] = {"parent": parent, "count": node.values().size}
            if node.mesh is not None:
                vertices, faces = node.mesh
                one["vertices"] = _text(np.asarray(vertices, "<f4"))
                one["faces"] = _text(np.asarray(faces, "<u4"))
                one["opacity"] = 1.0 if node.opacity is None else node.opacity
                one["flat"] = node.flat_shading
                if "/scenery" not in name:
                    one["side"] = next(
                        (side for side in get_args(Side) if f"/{side}" in name), None
                    )
            described.append(one)
        return described

    def changes(self) -> tuple[list[int], str]:
        """Returns the indices of the nodes that changed since the last call, and the ``values`` of
        these nodes, one after another: float32 in base64."""
        changed: list[int] = []
        content: list[bytes] = []
        for number, node in enumerate(self._nodes.values()):
            block = node.values().astype("<f4").tobytes()
            if self._sent.get(number) != block:
                self._sent[number] = block
                changed.append(number)
                content.append(block)
        return changed, base64.b64encode(b"".join(content)).decode()

    def _add(self, name: str, mesh: Any, values: Mapping[str, Any]) -> _Node:
        above = name.rpartition("/")[0]
        while above and above not in self._nodes:
            above = above.rpartition("/")[0]
        node = self._nodes[name] = _Node(self, self._nodes.get(above), mesh, values)
        self.number = next(_NUMBERS)
        return node


def _text(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode()


class HeadsetView:
    """Answers requests of a headset's page; see ``webxr.link`` for the messages.

    Args:
        session: state of the run.
        hands: side -> robot hand.
        simulated: True if there is a simulated or measured hand.
        arm: settings of the arms that carry the hands; None for no arm.
    """

    def __init__(
        self,
        session: LiveSession,
        hands: Mapping[Side, Hand],
        simulated: bool,
        arm: ArmSettings | None,
    ) -> None:
        self._session, self._hands = session, hands
        self._nodes = NodeList()
        scene: Any = self._nodes
        self._scene = HandsScene(scene, hands, simulated, arm=arm, root=_ROOT, human=False)
        self._trouble = ""
        self._fits: dict[Side, dict[str, Any]] = {}
        self._next_fit: dict[Side, float] = {}

    def look(self, number: object) -> dict[str, Any]:
        """Returns the message ``view``, with the shapes if ``number`` is not that of the current
        shapes."""
        try:
            state = self._session.look(text=False, scenery=self._scene.scenery_number)
            self._scene.draw(state["hands"])
            if "scenery" in state:
                self._scene.draw_scenery(state["scenery"])
            nodes = self._nodes
            message: dict[str, Any] = {"type": "view", "number": nodes.number}
            if number != nodes.number:
                message["nodes"] = nodes.describe()
                message["middle"] = [round(x, 4) for x in self._scene.centre.tolist()]
            message["changed"], message["values"] = nodes.changes()
            if (cameras := self._session.cameras) is not None:
                message["cameras"] = cameras.states(time.perf_counter())
                message["late_s"] = LATE_S
            message["hands"] = {side: self._hand(side, state["hands"]) for side in self._hands}
        except Exception as error:  # the link must go on because of its stop
            trouble = f"the headset's page can't draw the run: {type(error).__name__}: {error}"
            if trouble != self._trouble:
                self._trouble = trouble
                print_note(f"note: {trouble}")
            return {"type": "view", "number": 0}
        return message

    def picture(self, camera: object) -> bytes | None:
        """Returns the newest picture of a camera: its number and time, packed with ``PICTURE``,
        then the JPEG."""
        cameras = self._session.cameras
        if cameras is None or not isinstance(camera, int) or (shot := cameras.shot(camera)) is None:
            return None
        return PICTURE.pack(camera, shot.number, shot.time) + shot.jpeg

    def _hand(self, side: Side, states: Mapping[Side, Mapping[str, Any]]) -> dict[str, Any]:
        """Frame, name and state of a hand; the pose of its palm in the frame of the operator's
        wrist joint (position [m], quaternion wxyz), and the size of robot over human."""
        hand, state = self._hands[side], states.get(side, {})
        root: Any = self._scene.root_of(side)
        message = {
            "node": self._nodes.index(root),
            "name": hand.name,
            "mode": state.get("mode", "waiting"),
            "latched": state.get("latched") or [],
        }
        arrival = self._session.arrival(side)
        if self._scene.has_task:  # the palm does not move, so it stays in front of the operator
            message |= {"palm": None, "size": None}
        elif arrival is not None and state.get("human") is not None:
            now = time.monotonic()
            if now >= self._next_fit.get(side, -np.inf):
                self._next_fit[side] = now + _FIT_EVERY_S
                self._fits[side] = _palm_in_wrist(arrival, hand, state["scale"])
            message |= self._fits[side]
        return message


def _palm_in_wrist(arrival: Arrival, hand: Hand, scale: float | None) -> dict[str, Any]:
    """``palm`` and ``size`` of the message; empty unless a WebXR page sees the palm."""
    frame = arrival.frame
    fit = palm_fit(hand, {"human": frame.landmarks, "scale": scale})
    if fit is None or frame.orientations is None or not (frame.world or "").startswith("webxr"):
        return {}
    wrist = np.concatenate([frame.landmarks[WRIST], frame.orientations[WRIST]])
    if not np.isfinite(wrist).all():
        return {}
    back = fit.rotation.T
    origin = -back @ fit.translation / fit.scale
    palm = compose(invert(wrist), np.concatenate([origin, quaternions(back)]))
    return {"palm": palm.round(5).tolist(), "size": round(float(fit.scale), 4)}
