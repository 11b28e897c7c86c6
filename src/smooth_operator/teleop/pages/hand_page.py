"""Browser page that shows one robot hand: shape, landmarks, palm frame, and a slider for each
joint."""

from __future__ import annotations

import itertools
import threading
from typing import Any, Final

import numpy as np
import viser
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.joint_rows import JointRow, joint_rows
from smooth_operator.teleop.pages.hand_view import HandView, finger_colors
from smooth_operator.teleop.pages.scene import RobotLooks, add_balls
from smooth_operator.teleop.pages.viser_server import PageServer, name_panel, plain, serve_page

_LANDMARK, _TIP = 0.003, 0.0045  # radii of the balls [m]
_FRAME: Final = 0.03  # length of the palm frame's axes [m]
_FOV: Final = np.deg2rad(40.0)
_TRANSLUCENT: Final = 0.5  # opacity of the shape, so that landmarks inside it are seen


class HandPage(PageServer):
    """Serves the page of one robot hand; see ``PageServer``.

    Args:
        hand: the robot hand.
        notes: first line of text in the panel.
        drawn: the same hand on a model with meshes and the same joint names, in any order. The page
            then has a switch between meshes and simple shapes; None for simple shapes only.
    """

    def __init__(
        self,
        hand: Hand,
        notes: str = "",
        *,
        drawn: Hand | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        super().__init__(host, port)
        self.hand = hand
        self._notes = notes
        self._view = HandView(hand, simple=True)
        self._drawn = [self._view] if drawn is None else [HandView(drawn), self._view]
        self._q = hand.neutral.copy()
        self._lock = threading.Lock()  # viser calls back on several threads

    @property
    def title(self) -> str:
        """Name of the hand."""
        return self.hand.name

    def _build(self, server: viser.ViserServer) -> None:
        self._build_scene(server)
        self._build_panel(server.gui)
        self._draw()

    @property
    def joint_positions(self) -> Float[np.ndarray, " m"]:
        """(m,) positions of the actuated joints that the page shows [rad]."""
        with self._lock:
            return self._q.copy()

    def set_joint(self, index: int, position: float) -> None:
        """Moves an actuated joint to a position [rad], clipped to its limits."""
        with self._lock:
            low, high = self.hand.limits[index]
            self._q[index] = np.clip(position, low, high)
            self._draw()

    def reset(self) -> None:
        """Returns the hand to its neutral pose."""
        for slider, position in zip(self._sliders, self.hand.neutral, strict=True):
            slider.value = float(position)
        with self._lock:
            self._q = self.hand.neutral.copy()
            self._draw()

    def _build_scene(self, server: viser.ViserServer) -> None:
        scene, view = server.scene, self._view
        right, up, toward = view.axes
        scene.set_up_direction(up)
        scene.configure_default_lights(cast_shadow=False)
        colors = finger_colors(len(self.hand.fingers))
        self._robot = RobotLooks(scene, self.hand, self._drawn, "/hand")
        self._robot.show(opacity=_TRANSLUCENT)
        names, bones = self.hand.tree.names, view.bones()
        points = self.hand.landmark_positions(self._q)
        shades = np.tile(np.array([[40, 40, 40]], np.uint8), (len(points), 1))
        for finger, _, end in bones:
            shades[end] = colors[finger]
        tips = np.isin(names, self.hand.tip_names)
        radii = np.where(tips, _TIP, _LANDMARK)
        self._balls = add_balls(scene, "/landmarks/points", shades)
        self._balls.batched_scales = radii
        self._lines = scene.add_line_segments(
            "/landmarks/bones",
            np.zeros((len(bones), 2, 3)),
            np.stack([np.stack([colors[finger]] * 2) for finger, _, _ in bones]),
            thickness=0.0015,
        )
        self._labels = [
            scene.add_label(f"/labels/{name}", name, position=point, anchor="bottom-center")
            for name, point in zip(names, points, strict=True)
        ]
        self._frame = scene.add_frame("/palm", axes_length=_FRAME, axes_radius=0.0012)
        every = self.hand.full_configuration(self._q)
        shown = np.concatenate([points, self._robot.shown.corners(every)])
        centre = (shown.min(axis=0) + shown.max(axis=0)) / 2
        distance = 0.6 * float(np.linalg.norm(np.ptp(shown, axis=0))) / np.tan(_FOV / 2)
        direction = toward + 0.35 * right + 0.25 * up
        camera = server.initial_camera
        camera.position = centre + distance * direction / np.linalg.norm(direction)
        camera.look_at, camera.up = centre, up
        camera.fov, camera.near, camera.far = _FOV, 0.005, 50.0

    def _build_panel(self, gui: viser.GuiApi) -> None:
        hand, spec = self.hand, self.hand.spec
        name_panel(gui, hand.name)
        gui.main_panel.dock_right()
        facts = [
            f"{spec.side} hand{', mirrored' if spec.mirror else ''}; {len(hand.fingers)} fingers; "
            f"{len(hand.actuated)} of {len(hand.joint_names)} joints actuated",
            *([spec.source] if spec.source else []),
            *([self._notes] if self._notes else []),
        ]
        gui.add_markdown("\n\n".join(map(plain, facts)))
        with gui.add_folder("Show"):
            shape = gui.add_checkbox("shape", True)
            shape.on_update(lambda _: self._show(visible=shape.value))
            if len(self._drawn) > 1:
                meshes = gui.add_checkbox(
                    "meshes", True, hint="show the vendor's meshes or simple shapes"
                )
                meshes.on_update(lambda _: self._show(meshes=meshes.value))
            self._toggle(gui, "landmarks", True, [self._balls, self._lines])
            self._toggle(gui, "names", False, list(self._labels))
            self._toggle(gui, "palm frame", True, [self._frame])
        with gui.add_folder("Joints [rad]"):
            rows = joint_rows(hand)
            gui.add_button("Neutral pose").on_click(lambda _: self.reset())
            self._sliders = []
            # Many makers number their joints, so a folder has the name of the finger.
            groups = itertools.groupby(enumerate(hand.actuated), lambda each: self._part(each[1]))
            for part, joints in groups:
                with gui.add_folder(part):
                    self._sliders += [self._slider(gui, i, rows[joint]) for i, joint in joints]
        self._followers: list[tuple[int, Any]] = []
        if hand.couplings:
            with gui.add_folder("Coupled joints [rad]"):
                for joint, row in enumerate(rows):
                    if not row.actuated:
                        self._followers.append((joint, self._slider(gui, None, row)))

    def _part(self, joint: int) -> str:
        """Name of the finger that a joint moves, or of the palm."""
        body = self.hand.model.joint(self.hand.joint_names[joint]).bodyid[0]
        finger = self._view.finger_of_body[body]
        return "palm" if finger < 0 else self.hand.fingers[finger]

    def _show(self, **choices: bool) -> None:
        with self._lock:
            self._robot.show(**choices)

    @staticmethod
    def _toggle(gui: viser.GuiApi, name: str, initial: bool, nodes: list[Any]) -> None:
        box = gui.add_checkbox(name, initial)

        def apply(_: object = None) -> None:
            for node in nodes:
                node.visible = box.value

        box.on_update(apply)
        apply()

    def _slider(self, gui: viser.GuiApi, index: int | None, row: JointRow) -> Any:
        low, high = (
            (row.low, row.high) if np.isfinite([row.low, row.high]).all() else (-np.pi, np.pi)
        )
        slider = gui.add_slider(
            row.name,
            min=low,
            max=high,
            step=(high - low) / 200,
            initial_value=min(max(row.neutral, low), high),
            disabled=index is None,
            hint=f"{low:.3f} .. {high:.3f}, neutral {row.neutral:.3f}"
            + (f"; = {row.follows}" if row.follows else ""),
        )
        if index is not None:
            slider.on_update(lambda _: self.set_joint(index, float(slider.value)))
        return slider

    def _draw(self) -> None:
        every = self.hand.full_configuration(self._q)
        self._robot.draw(every)
        points = self.hand.landmark_positions(self._q)
        self._balls.batched_positions = points
        self._lines.points = np.stack([points[[a, b]] for _, a, b in self._view.bones()])
        for label, point in zip(self._labels, points, strict=True):
            label.position = point
        for joint, slider in self._followers:
            slider.value = float(np.clip(every[joint], slider.min, slider.max))


def serve_hand(
    hand: Hand,
    notes: str = "",
    *,
    drawn: Hand | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    open_browser: bool = True,
    block: bool = True,
) -> HandPage:
    """Shows a hand in the browser; see ``HandPage`` and ``serve_page`` for the arguments.
    ConfigError if the address is not one of this machine's, or no port is free."""
    page = HandPage(hand, notes, drawn=drawn, host=host, port=port).start()
    return serve_page(page, f"showing {hand.name} at", open_browser=open_browser, block=block)
