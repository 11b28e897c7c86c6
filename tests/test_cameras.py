"""Cameras of the pages: streams, the simulated camera, a loss, and the live page."""

import base64
import contextlib
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest
from browser_page import new_page
from live_loop import panel_of, serving
from live_time import until as eventually
from pictures import opencv_or_skip

from smooth_operator.errors import ConfigError, SmoothOperatorError, SourceError, UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.camera import SimulatedCamera
from smooth_operator.teleop import TeleopRequest, teleoperate
from smooth_operator.teleop.cameras import LATE_S, Cameras
from smooth_operator.teleop.pages.viser_server import page_url
from smooth_operator.teleop.sinks.simulation import Simulation

cv2 = opencv_or_skip()

ORANGE = (40, 140, 220)  # blue, green, red


class MjpegServer:
    """A network camera with orange pictures: JPEG as multipart/x-mixed-replace (RFC 2046)."""

    def __init__(self, port: int = 0) -> None:
        jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), ORANGE, np.uint8))[1].tobytes()
        head = f"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
        self.paused = False
        ended, server = threading.Event(), self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                kind = "multipart/x-mixed-replace; boundary=picture"
                self.send_header("Content-Type", kind)
                self.end_headers()
                with contextlib.suppress(OSError):  # the client is gone
                    while not ended.wait(0.05):
                        if not server.paused:
                            self.wfile.write(head.encode() + jpeg + b"\r\n")

            def log_message(self, *_: Any) -> None:
                """Stays silent."""

        self._ended, self._server = ended, ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.port = self._server.server_address[1]
        self.address = f"http://127.0.0.1:{self.port}/video.mjpg"
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        """Ends all streams, and frees the port."""
        self._ended.set()
        time.sleep(0.1)  # the streams' last picture
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def server() -> Iterator[MjpegServer]:
    started = MjpegServer()
    yield started
    started.close()


def pixels(shot: Any) -> np.ndarray:
    return np.asarray(cv2.imdecode(np.frombuffer(shot.jpeg, np.uint8), cv2.IMREAD_COLOR))


def test_a_stream_is_shown_and_comes_back_after_a_loss(server):
    with Cameras([f"{server.address},name=bench,rate=100"]) as cameras:

        def state() -> dict[str, Any]:
            (only,) = cameras.states(time.perf_counter())
            return only

        eventually(lambda: state()["number"] > 2)
        assert state()["name"] == "bench"
        assert not state()["lost"]
        eventually(lambda: state()["age_s"] < LATE_S)
        shot = cameras.shot(0)
        np.testing.assert_allclose(pixels(shot).mean(axis=(0, 1)), ORANGE, atol=4)
        known = [state()["number"]]
        server.close()
        eventually(lambda: state()["lost"])
        eventually(lambda: state()["age_s"] > LATE_S)
        number = state()["number"]
        assert number >= known[0]
        again = MjpegServer(server.port)
        try:
            eventually(lambda: state()["number"] > number)
            eventually(lambda: state()["age_s"] < LATE_S)
            assert not state()["lost"]
        finally:
            again.close()


def test_a_page_gets_each_picture_once(server):
    with Cameras([server.address]) as cameras:
        eventually(lambda: cameras.shot(0) is not None)
        server.paused = True
        time.sleep(0.3)
        shot = cameras.shot(0)
        assert shot is not None
        (first,) = cameras.states(shot.time + 2.0, [])
        assert first["age_s"] == pytest.approx(2.0)
        assert base64.b64decode(first["jpeg"]) == shot.jpeg
        assert "jpeg" not in cameras.states(0.0, [shot.number])[0]
        assert "jpeg" not in cameras.states(0.0)[0]
        assert cameras.shot(1) is None


def test_the_simulated_hand_has_a_camera():
    hand = load_hand("mimic_p050")
    simulation = Simulation()
    with Cameras(["mujoco,rate=30,width=160,height=120"], [simulation]) as cameras:
        assert cameras.states(0.0)[0]["number"] == 0  # the run has not begun
        simulation.open({"right": hand}, {})
        try:
            there = simulation.snapshot("right")
            assert there is not None
            try:
                SimulatedCamera(there[0], 160, 120).close()
            except ConfigError as error:
                pytest.skip(str(error))
            eventually(lambda: cameras.shot(0) is not None)
            picture = pixels(cameras.shot(0))
            assert picture.shape == (120, 160, 3)
            assert picture.std() > 10
        finally:
            simulation.close()


@pytest.mark.parametrize(
    ("texts", "error", "words"),
    [
        (["mujoco"], ConfigError, "add --sink mujoco"),
        (["http://127.0.0.1:9/none"], SourceError, "can't be opened"),
        (["0,widht=3"], UnknownNameError, "Did you mean 'width'"),
        (["0,rate=0"], ConfigError, "camera: rate must be 0.1 to 120 Hz"),
        (["-1"], ConfigError, "camera must be 0 to 99"),
        (["0"] * 5, ConfigError, "at most 4 cameras, not 5"),
    ],
)
def test_what_can_not_be_shown_is_refused(texts, error, words):
    with pytest.raises(error, match=words):
        Cameras(texts)


def test_a_camera_needs_a_page_and_must_be_there_before_anything_moves(tmp_path):
    with pytest.raises(ConfigError, match="remove --no-view"):
        teleoperate(TeleopRequest(camera=("0",), duration=0.1))
    with pytest.raises(SmoothOperatorError, match="mujoco"):
        teleoperate(TeleopRequest(source="webxr,port=0", camera=("mujoco",), duration=0.1))


@pytest.mark.browser
def test_the_live_page_shows_pictures_with_their_age(chromium):
    hands: Any = {"right": load_hand("mimic_p050")}
    with serving() as server:
        panel = panel_of(server, hands)
        assert panel.pictures == []
        picture = np.full((48, 64, 3), ORANGE, np.uint8)
        jpeg = base64.b64encode(cv2.imencode(".jpg", picture)[1].tobytes()).decode()
        seen = {"name": "wrist", "number": 7, "age_s": 0.04, "lost": False}
        shown: dict[str, Any] = {"hands": {}, "cameras": [seen | {"jpeg": jpeg}]}
        panel.show(shown)
        assert panel.pictures == [7]
        page, problems = new_page(chromium, drawn=False)
        page.goto(page_url("127.0.0.1", server))
        image = page.get_by_alt_text("camera wrist")
        image.wait_for()
        eventually(lambda: image.evaluate("image => image.naturalWidth") == 64)
        page.get_by_text("wrist: 0.0 s old").wait_for()
        assert image.evaluate("image => getComputedStyle(image).opacity") == "1"
        panel.show({"hands": {}, "cameras": [seen | {"age_s": 3.2, "lost": True}]})
        page.get_by_text("late: 3.2 s old, lost: opening it again").wait_for()
        eventually(lambda: image.evaluate("image => getComputedStyle(image).opacity") == "0.3")
        assert image.evaluate("image => image.naturalWidth") == 64  # the last picture
        assert problems == []
        page.close()
