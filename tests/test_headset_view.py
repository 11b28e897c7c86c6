"""The robot in a headset's view: its messages, and the page that draws it."""

import base64
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from browser_page import picture
from emulated_headset import new_headset, pair
from live_time import PATIENCE_S
from live_time import until as eventually

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import WRIST
from smooth_operator.own_files import SWITCH
from smooth_operator.poses import compose, invert, rotate
from smooth_operator.retargeting.alignment import reference_landmarks
from smooth_operator.teleop.cameras import Shot
from smooth_operator.teleop.pages.headset_view import HeadsetView
from smooth_operator.teleop.pages.live.live_session import task_scenes
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sources.live import Arrival, Mailbox
from smooth_operator.teleop.sources.webxr import WebXr
from smooth_operator.teleop.sources.webxr.link import PICTURE
from smooth_operator.types import HandFrame, Side

CODE = "246810"
HAND = "shadow_hand"


class Session:
    """State of a run, as ``LiveSession`` gives it to pages."""

    def __init__(self, hand: Hand, simulation: Simulation | None = None) -> None:
        self.side: Side = hand.spec.side
        self.state: dict[str, Any] = {
            "mode": "tracking",
            "positions": hand.full_configuration(hand.neutral).tolist(),
            "human": None,
            "latched": [],
            "targets": None,
            "scale": None,
        }
        self.seen: Arrival | None = None
        self.trouble: Exception | None = None
        self.cameras: Any = None
        self._simulation = simulation

    def look(self, *, text: bool, scenery: int) -> dict[str, Any]:
        assert not text
        if self.trouble is not None:
            raise self.trouble
        shown: dict[str, Any] = {"hands": {self.side: self.state}}
        if self._simulation is not None:
            shown["scenery"] = task_scenes(self._simulation, (self.side,), scenery)
        return json.loads(json.dumps(shown))

    def arrival(self, side: Side) -> Arrival | None:
        return self.seen


class Page:
    """Reads the messages as the page does."""

    def __init__(self, view: Any) -> None:
        self._view = view
        self.number = 0
        self.nodes: list[dict[str, Any]] = []

    def look(self) -> dict[str, Any]:
        message = json.loads(json.dumps(self._view.look(self.number)))
        assert message["type"] == "view"
        self.number = message["number"]
        self.nodes = message.get("nodes", self.nodes)
        values = np.frombuffer(base64.b64decode(message["values"]), "<f4")
        at = 0
        for index in message["changed"]:
            node = self.nodes[index]
            node["values"] = values[at : at + node["count"]]
            at += node["count"]
        assert at == len(values)
        return message

    def shown(self, count: int) -> list[np.ndarray]:
        """(count, 13) values of the meshes with so many instances, where they are shown."""
        blocks = [node["values"].reshape(-1, 13) for node in self.nodes if "vertices" in node]
        return [b for b in blocks if len(b) == count and not np.isnan(b).any() and b[:, 7].all()]


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand(HAND)


def view_of(session: Any, hand: Hand, simulated: bool = False) -> HeadsetView:
    return HeadsetView(session, {hand.spec.side: hand}, simulated, None)


def some_positions(hand: Hand) -> np.ndarray:
    low, high = hand.limits.T
    return hand.full_configuration(low + np.random.default_rng(5).random(len(low)) * (high - low))


def test_bodies_and_fingertips_are_where_the_kinematics_puts_them(hand):
    session = Session(hand)
    page = Page(view_of(session, hand))
    page.look()
    positions = some_positions(hand)
    session.state["positions"] = positions.tolist()
    page.look()
    (tips,) = page.shown(len(hand.tip_names))
    np.testing.assert_allclose(tips[:, :3], hand.tips(positions), atol=1e-4)
    data = mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(positions)
    mujoco.mj_kinematics(hand.model, data)
    palm = data.body(hand.spec.palm)
    there = (data.xpos - palm.xpos) @ palm.xmat.reshape(3, 3)
    bodies = [block[0, :3] for block in page.shown(1)]
    assert len(bodies) > 12
    for body in bodies:
        assert np.linalg.norm(there - body, axis=1).min() < 1e-4


def test_only_changes_are_sent_and_a_new_page_gets_everything(hand, capfd):
    session = Session(hand)
    view = view_of(session, hand)
    session.trouble = ValueError("out of paint")
    assert view.look(0) == view.look(0) == {"type": "view", "number": 0}
    assert capfd.readouterr().err.count("out of paint") == 1  # and the link goes on
    session.trouble = None
    first = view.look(0)
    assert view.look(first["number"])["changed"] == []
    session.state["positions"] = some_positions(hand).tolist()
    moved = view.look(first["number"])
    assert 12 < len(moved["changed"]) < len(first["changed"])
    assert len(json.dumps(moved)) < 5_000  # thirty times a second
    again = view.look(0)  # the page was loaded anew
    assert again["changed"] == first["changed"]
    assert len(again["nodes"]) == len(first["nodes"])


def test_targets_and_state_of_the_hand_are_told(hand):
    session = Session(hand)
    page = Page(view_of(session, hand))
    page.look()
    assert len(page.shown(len(hand.tip_names))) == 1  # the fingertips
    targets = hand.tips(some_positions(hand))
    session.state |= {"targets": targets.ravel().tolist(), "latched": ["index"], "mode": "stopped"}
    told = page.look()["hands"]["right"]
    assert (told["mode"], told["latched"], told["name"]) == ("stopped", ["index"], HAND)
    tips, marks = page.shown(len(hand.tip_names))
    np.testing.assert_allclose(marks[:, :3], targets, atol=1e-5)
    assert tips[0, 7] == tips[1, 7] > tips[2, 7]  # thumb and index are larger


def test_the_palm_is_placed_on_the_operators(hand):
    """An operator whose hand is the robot's, 0.8 times as large, somewhere in the room."""
    session, size = Session(hand), 0.8
    own = reference_landmarks(hand)
    landmarks = size * rotate(np.array([0.5, -0.1, 0.7, 0.5]), own) + [0.2, 1.1, -0.4]
    wrist = np.array([0.1, 0.7, -0.1, 0.7])
    orientations = np.tile(wrist, (21, 1))
    frame = HandFrame(landmarks, 0.0, orientations=orientations, world="webxr/local-floor")
    session.seen = Arrival(frame, 0.0, 0.0, 1)
    assert "palm" not in view_of(session, hand).look(0)["hands"]["right"]  # seconds ago
    session.state["human"] = landmarks.ravel().tolist()
    told = view_of(session, hand).look(0)["hands"]["right"]
    assert told["size"] == pytest.approx(1 / size, abs=1e-3)
    palm = compose(np.concatenate([landmarks[WRIST], wrist]), np.array(told["palm"]))
    back = invert(palm)
    np.testing.assert_allclose(
        rotate(back[3:], landmarks) + back[:3], size * own, atol=1e-3
    )  # landmarks in the palm's frame
    other = HandFrame(landmarks, 0.0, orientations=orientations, world="glove")
    session.seen = Arrival(other, 0.0, 0.0, 1)
    assert "palm" not in view_of(session, hand).look(0)["hands"]["right"]


def test_a_task_is_drawn_where_the_physics_has_it(hand):
    simulation = Simulation(task="cube")
    simulation.open({"right": hand}, {})
    try:
        session = Session(hand, simulation)
        view = view_of(session, hand, simulated=True)
        page = Page(view)
        page.look()
        boxes = [node for node in page.nodes if node.get("flat")]
        assert boxes
        assert all(node.get("side") is None for node in boxes)  # no tint of the robot's state
        told = page.look()["hands"]["right"]
        assert (told["palm"], told["size"]) == (None, None)  # it stays in front of the operator
        mount, state = simulation.scene_of("right").mount, simulation.scene_state("right")
        assert state is not None
        there = mount.in_palm(state.position, state.quaternion)[0]
        nearest = min(np.linalg.norm(box["values"][:3] - there) for box in boxes)
        assert nearest < 5e-3
        number = page.number
        simulation.change_task("card")
        page.look()
        assert page.number != number
        simulation.put_away("right")
        eventually(lambda: page.look() and any(np.isnan(n["values"]).any() for n in page.nodes))
    finally:
        simulation.close()


@pytest.fixture
def mailbox() -> Mailbox:
    return Mailbox()


@pytest.fixture
def source(mailbox: Mailbox, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[WebXr]:
    """A started source."""
    pytest.importorskip("cryptography", reason="the extra webxr is not installed")
    monkeypatch.setenv(SWITCH, str(tmp_path))
    started = WebXr(port=0, code=CODE)
    started.start(mailbox)
    yield started
    started.stop()


def opened(source: WebXr, chromium: Any, emulator: str) -> Any:
    """A page of an emulated headset that tracks in a dark space, with the hands at rest."""
    page = new_headset(chromium, emulator)
    pair(page, source.addresses[0], CODE, "immersive-vr")
    page.evaluate(
        """() => {
          window.moving = false;
          headset.hands.left.connected = false;
          headset.hands.right.position.set(0, 1.48, -0.4);
        }"""
    )
    page.click("#start")
    return page


def share(page: Any, color: str) -> float:
    """Share of the picture below the stop button that has a colour."""
    shot = picture(page, 480, 640)[280:]
    red, green, blue = np.moveaxis(shot, -1, 0)
    kinds = {
        "red": (red > 90) & (np.maximum(green, blue) < 0.4 * red),
        "green": (green > 120) & (np.maximum(red, blue) < 0.5 * green),
        "any": shot.max(axis=-1) > 60,
    }
    return float(kinds[color].mean())


class GreenPictures:
    """Two cameras: a green picture, and one that has none yet."""

    def __init__(self) -> None:
        from PIL import Image

        jpeg = io.BytesIO()
        Image.new("RGB", (64, 48), (20, 220, 60)).save(jpeg, "JPEG")
        self.taken = Shot(3, 0.0, jpeg.getvalue())
        self.delay = 0.0

    def states(self, now: float) -> list[dict[str, Any]]:
        self.taken = replace(self.taken, number=self.taken.number + 1, time=now - self.delay)
        state = {"number": self.taken.number, "time": self.taken.time, "lost": False}
        return [{"name": "wrist", **state}, {"name": "head", "number": 0, "lost": True}]

    def shot(self, camera: int) -> Shot | None:
        return None if camera else self.taken


def test_a_picture_is_sent_with_its_time(hand):
    session = Session(hand)
    view = view_of(session, hand)
    assert view.picture(0) is None
    session.cameras = GreenPictures()
    wrist, head = view.look(0)["cameras"]
    assert (wrist["name"], head["lost"]) == ("wrist", True)
    message = view.picture(0)
    assert PICTURE.unpack_from(message) == (0, wrist["number"], wrist["time"])
    assert message[PICTURE.size :] == session.cameras.taken.jpeg
    for camera in (1, "0", None, [0]):
        assert view.picture(camera) is None


@pytest.mark.browser
def test_pictures_hang_in_front_and_a_late_one_is_dimmed(source, chromium, emulator, hand):
    session = Session(hand)
    session.cameras = GreenPictures()
    page = opened(source, chromium, emulator)
    choose(page, "hidden")
    source.show(view_of(session, hand))
    eventually(lambda: share(page, "green") > 0.01)
    session.cameras.delay = 2.0
    eventually(lambda: share(page, "green") < 0.001)
    page.context.close()


def choose(page: Any, place: str) -> None:
    """Chooses where the robot is drawn; the headset's view lies above the page."""
    page.evaluate(
        """(place) => {
          const choice = document.querySelector('#place');
          choice.value = place;
          choice.dispatchEvent(new Event('change'));
        }""",
        place,
    )


@pytest.mark.browser
def test_the_headset_draws_the_robot_and_its_state(source, mailbox, chromium, emulator, hand):
    session = Session(hand)
    page = opened(source, chromium, emulator)
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))

    def follow() -> None:
        assert mailbox.wait(["right"], PATIENCE_S)
        session.seen = mailbox.take("right")
        session.state["human"] = session.seen.frame.landmarks.ravel().tolist()

    follow()
    choose(page, "over")
    page.wait_for_timeout(500)
    alone = share(page, "any"), share(page, "red")
    source.show(view_of(session, hand))
    eventually(lambda: share(page, "any") > alone[0] + 0.01)
    assert share(page, "red") < alone[1] + 0.01
    session.state["mode"] = "stopped"
    eventually(lambda: share(page, "red") > alone[1] + 0.02)
    session.state["mode"] = "tracking"
    eventually(lambda: share(page, "red") < alone[1] + 0.01)
    choose(page, "hidden")
    eventually(lambda: share(page, "any") < alone[0] + 0.005)
    choose(page, "front")
    eventually(lambda: share(page, "any") > alone[0] + 0.01)
    source.show(None)
    eventually(lambda: share(page, "any") < alone[0] + 0.005)
    assert problems == []
    page.context.close()
