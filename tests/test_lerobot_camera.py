"""The simulated camera: what it shows, and as a camera of the LeRobot robot."""

import sys
import threading
import time
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from lerobot_stand_in import CAMERA, REAL, ROBOT, plugins
from live_time import PATIENCE_S

from smooth_operator import load_hand
from smooth_operator.errors import ConfigError
from smooth_operator.simulation.camera import SimulatedCamera, View
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.scenes.scene import OBJECT


def camera_at(physics: HandPhysics, *size: int, view: View | None = None) -> SimulatedCamera:
    try:
        return SimulatedCamera(physics, *size, view=view)
    except ConfigError as error:
        if "OpenGL" not in str(error):
            raise
        pytest.skip(str(error))


@pytest.mark.parametrize(
    ("task", "side"), [("none", "left"), ("card", "right"), ("screwdriver", "left")]
)
def test_hand_and_object_are_in_the_picture_and_move_in_it(task, side):
    hand = load_hand("mimic_p050", side)
    physics = HandPhysics(hand) if task == "none" else ScenePhysics(hand, scene_for(task, hand))
    camera = camera_at(physics, 160, 120)
    first = camera.draw(physics.data.qpos)
    assert first.shape == (120, 160, 3)
    moved = physics.data.qpos.copy()
    prefix = "" if task == "none" else "hand/"
    joints = [physics.model.joint(prefix + name) for name in hand.actuated_names]
    moved[[joint.qposadr[0] for joint in joints]] += 0.3
    changed = (camera.draw(moved) != first).any(axis=2)
    assert changed.mean() > 0.005  # the fingers are seen, and not the whole picture
    assert changed.mean() < 0.5
    if task != "none":
        away = physics.data.qpos.copy()
        away[physics.model.joint(OBJECT).qposadr[0]] += 5.0
        gone = (camera.draw(away) != first).any(axis=2)
        rows, columns = np.nonzero(gone)
        assert len(rows) > 50
        assert abs(columns.mean() - 80) < 40  # it is what the camera looks at
        assert abs(rows.mean() - 60) < 30
    camera.close()


def test_without_a_display_and_its_substitutes_there_is_a_sentence(monkeypatch):
    if sys.platform != "linux":
        pytest.skip("other systems draw without a display")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    physics = HandPhysics(load_hand("mimic_p050"))
    for choice in ("", "glfw"):
        monkeypatch.setenv("MUJOCO_GL", choice)
        with pytest.raises(ConfigError, match="can't draw with OpenGL: without a display, install"):
            SimulatedCamera(physics, 64, 64)


def test_the_view_can_be_chosen_and_wrong_sizes_are_refused():
    hand = load_hand("mimic_p050")
    physics = ScenePhysics(hand, scene_for("cube", hand))
    pictures = []
    for view in (None, View(azimuth=20.0), View(distance=1.0)):
        camera = camera_at(physics, 64, 64, view=view)
        pictures.append(camera.draw(physics.data.qpos))
        camera.close()
    assert (pictures[0] != pictures[1]).any()
    assert (pictures[0] != pictures[2]).any()
    with pytest.raises(ConfigError, match="16 to 4096 pixels"):
        SimulatedCamera(physics, 8, 64)
    with pytest.raises(ConfigError, match="distance"):
        SimulatedCamera(physics, 64, 64, View(distance=0.0))


@pytest.fixture
def plugin() -> Iterator[SimpleNamespace]:
    with plugins() as patch:
        import lerobot_camera_smooth_hand as camera
        import lerobot_robot_smooth_hand as package
        from lerobot.utils import errors

        if not REAL:
            patch.setattr(
                sys.modules[f"{ROBOT}.smooth_hand"],
                "_cameras",
                lambda config: {n: camera.SmoothHandCamera(c) for n, c in config.cameras.items()},
            )
        yield SimpleNamespace(package=package, camera=camera, errors=errors)


def test_the_robots_observations_have_pictures_of_its_simulated_hand(plugin):
    camera_at(HandPhysics(load_hand("mimic_p050")), 64, 64).close()  # or there is no OpenGL
    config = plugin.camera.SmoothHandCameraConfig(width=96, height=64, fps=20)
    robot = plugin.package.SmoothHand(
        plugin.package.SmoothHandConfig(sinks=["mujoco:task=cube"], cameras={"front": config})
    )
    assert robot.observation_features["front"] == (64, 96, 3)
    robot.connect()
    try:
        first = robot.get_observation()["front"]
        assert first.shape == (64, 96, 3)
        low, high = load_hand("mimic_p050").limits.T
        names = list(robot.action_features)
        goal = dict(zip(names, (low + 0.7 * (high - low)).tolist(), strict=True))
        end, changed = time.perf_counter() + PATIENCE_S, False
        while time.perf_counter() < end and not changed:
            robot.send_action(goal)
            time.sleep(0.02)
            changed = bool((robot.get_observation()["front"] != first).mean() > 0.01)
        assert changed
        camera = robot.cameras["front"]
        assert (camera.async_read(2000.0) != first).any()
        assert camera.read().shape == (64, 96, 3)
        with pytest.raises(plugin.errors.DeviceAlreadyConnectedError):
            camera.connect()
    finally:
        robot.disconnect()
    assert not camera.is_connected
    with pytest.raises(plugin.errors.DeviceNotConnectedError):
        camera.read_latest()


def test_a_camera_without_a_simulated_hand_says_so(plugin):
    config = plugin.camera.SmoothHandCameraConfig(side="left")
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="belongs to the robot"):
        plugin.camera.SmoothHandCamera(config).connect()
    robot = plugin.package.SmoothHand(plugin.package.SmoothHandConfig(cameras={"front": config}))
    with pytest.raises(ValueError, match="a hand in simulation"):
        robot.connect()
    assert not robot.is_connected
    with pytest.raises(ValueError, match="above 0"):
        plugin.camera.SmoothHandCamera(plugin.camera.SmoothHandCameraConfig(width=0))


class Drawing:
    """A renderer that draws a picture each time it is told to, and a clock that it does not move.

    The grey of a picture is its number.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, camera_module: ModuleType) -> None:
        self.now, self.number, self.pictures = 100.0, 0, threading.Semaphore(0)
        monkeypatch.setattr(camera_module, "SimulatedCamera", lambda *_: self)
        clock = SimpleNamespace(perf_counter=lambda: self.now)
        monkeypatch.setattr(camera_module, "time", clock)
        monkeypatch.setattr(camera_module, "_FRESH_S", 0.3)

    def draw(self, qpos: np.ndarray) -> np.ndarray:
        self.pictures.acquire()
        self.number += 1
        return np.full((24, 32, 3), self.number, np.uint8)

    def close(self) -> None:
        pass


@pytest.fixture
def drawing(plugin, monkeypatch) -> Iterator[Drawing]:
    """The camera of a hand whose pictures come when the test wants them."""
    module = sys.modules[f"{CAMERA}.smooth_hand_camera"]
    made = Drawing(monkeypatch, module)
    config = plugin.camera.SmoothHandCameraConfig(width=32, height=24, fps=1000, stale_s=1.0)
    camera = plugin.camera.SmoothHandCamera(config)
    camera._side = "right"
    camera._simulation = SimpleNamespace(snapshot=lambda side: ("physics", np.zeros(1)))
    made.camera = camera
    made.pictures.release()
    camera.connect()
    yield made
    camera._ending.set()
    made.pictures.release(100)
    camera.disconnect()


def test_an_observation_waits_for_a_picture_that_is_new_enough(drawing):
    camera = drawing.camera
    assert camera.read_latest()[0, 0, 0] == 1
    drawing.now += 1.9  # LeRobot wrote its files meanwhile
    with pytest.raises(TimeoutError, match=r"1\.9 s old, more than 0\.5 s"):
        camera.read_latest(max_age_ms=500)  # who names an age does not wait
    later = threading.Timer(0.02, drawing.pictures.release, (2,))  # one may have begun before
    later.start()
    assert camera.read_latest()[0, 0, 0] > 1
    assert drawing.now - camera._time <= 1.0
    later.join()


def test_a_machine_that_draws_too_slowly_is_told_what_to_set(drawing):
    drawing.now += 1.9
    words = r"1\.9 s old, more than 1 s.*smaller width and height.*stale_s: 5.*must be deleted"
    with pytest.raises(TimeoutError, match=f"(?s){words}"):
        drawing.camera.read_latest()
