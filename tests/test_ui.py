"""The browser page: its clock, meshes, layout and words; the server; and the page in a Chromium."""

import html
import os
import re
import socket
import string
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote, urlsplit

import mujoco
import numpy as np
import pytest
from browser_page import changed, nameless, new_page, settled
from live_time import until as eventually
from processes import python

from smooth_operator import Status, load_hand
from smooth_operator.errors import ConfigError, HandModelError, RecordingError
from smooth_operator.hands.hand import landmark_points
from smooth_operator.metrics import Trace
from smooth_operator.teleop.pages import Playback, PlaybackServer, player, serve
from smooth_operator.teleop.pages.hand_view import (
    FINGER_COLORS,
    FOV,
    HIGHLIGHT,
    HandView,
    body_meshes,
    camera_for,
    finger_of_body,
    geom_mesh,
    linear,
    plan,
    view_axes,
)
from smooth_operator.teleop.pages.player import PlaybackClock
from smooth_operator.teleop.pages.scene import lit_tips
from smooth_operator.teleop.pages.viser_server import plain
from smooth_operator.web import browser

HANDS = {side: load_hand("mimic_p050", side) for side in ("right", "left")}


def human_hand(curl: np.ndarray) -> np.ndarray:
    """(T, 21, 3) a plain hand whose fingers bend toward -y by ``curl`` [rad] at each joint."""
    hand = np.zeros((len(curl), 21, 3))
    angle = np.outer(curl, (1, 2, 3))
    bones = np.stack([0 * angle, -np.sin(angle), np.cos(angle)], axis=-1)
    chain = 0.03 * np.concatenate([np.zeros((len(curl), 1, 3)), np.cumsum(bones, axis=1)], axis=1)
    for finger, x in enumerate((0.06, 0.03, 0.01, -0.01, -0.03)):
        hand[:, 1 + 4 * finger : 5 + 4 * finger] = np.array([x, 0, 0.03 if finger == 0 else 0.09])
        hand[:, 1 + 4 * finger : 5 + 4 * finger] += chain
    return hand


def make_playback(
    frames: int = 60, rate: float = 100.0, side: str = "right", **changes: Any
) -> Playback:
    hand = HANDS[side]
    curl = 0.4 - 0.4 * np.cos(np.linspace(0, 3, frames))
    q = hand.full_configuration(np.clip(curl[:, None], *hand.limits.T))
    human = changes.pop("human", human_hand(curl)) * [1 if side == "right" else -1, 1, 1]
    right, up, toward = view_axes(HandView(hand, simple=True))
    fields: dict[str, Any] = {
        "human": human @ [right, -toward, up] + hand.wrist,
        "robot_tips": hand.tips(q),
        "robot_wrist": hand.wrist,
        "fingers": hand.fingers,
        "joint_positions": q,
        "joint_limits": hand.joint_limits,
        "stamps": 5.0 + np.arange(frames) / rate,
        "status": np.zeros(frames, int),
        "latency_ms": np.full(frames, 0.8),
    }
    return Playback("test hand", hand, Trace(**(fields | changes)))


@pytest.fixture(scope="module")
def playback() -> Playback:
    return make_playback()


@pytest.fixture
def server(playback: Playback) -> Iterator[PlaybackServer]:
    with PlaybackServer(playback, port=0) as running:
        yield running


@pytest.mark.parametrize(
    ("frames", "changes", "error", "words"),
    [
        (0, {}, RecordingError, "no frame"),
        (60, {"robot_wrist": np.full(3, np.nan)}, HandModelError, "NaN"),
        (60, {"robot_tips": np.full((60, 5, 3), np.inf)}, HandModelError, "infinity"),
    ],
)
def test_a_run_that_cannot_be_drawn_is_refused(frames, changes, error, words):
    with pytest.raises(error, match=words):
        make_playback(frames, **changes)


def test_pinches_are_under_12_mm_and_never_of_a_lost_hand():
    human = human_hand(np.zeros(4))
    human[1, 8] = human[1, 4] + [0.0119, 0, 0]
    human[2, 20] = human[2, 4] + [0, 0.0121, 0]
    human[3, 8] = human[3, 4]
    human[3, 4] = np.nan
    pinches = make_playback(4, human=human).pinches()
    assert pinches.any(axis=1).tolist() == [False, True, False, False]
    assert lit_tips(pinches[1]).tolist() == [True, True, False, False, False]


def test_the_clock_drops_frames_and_never_stretches_time():
    times = np.array([0.0, 0.01, 0.02, 0.5, 0.51])  # a gap in tracking is a gap on the page
    clock = PlaybackClock(times, loop=False)
    clock.start(0, now=100.0)
    shown = [clock.frame(100.0 + dt)[0] for dt in (0.0, 0.015, 0.4, 0.505, 0.511)]
    assert shown == [0, 1, 2, 3, 4]
    assert clock.frame(101.0) == (4, True)
    clock.start(0, now=0.0)
    assert clock.frame(0.5)[0] == 3  # due at its very stamp

    clock = PlaybackClock(np.arange(100) / 100, speed=1.0, loop=True)
    clock.start(10, now=0.0)
    assert clock.frame(0.105)[0] == 20
    clock.set_speed(4.0, now=0.105)  # without a jump
    assert clock.frame(0.105)[0] == 20
    assert clock.frame(0.2051)[0] == 60
    assert clock.frame(0.105 + (1.0 - 0.205) / 4 + 0.01) == (4, False)

    single = PlaybackClock(np.array([3.0]), loop=True)
    single.start(0, now=0.0)
    assert single.frame(0.0) == (0, True)


@pytest.mark.parametrize(
    ("kind", "size", "half", "volume"),
    [
        ("sphere", "0.02", (0.02, 0.02, 0.02), 4 / 3 * np.pi * 0.02**3),
        ("box", "0.01 0.02 0.03", (0.01, 0.02, 0.03), 8 * 0.01 * 0.02 * 0.03),
        ("cylinder", "0.02 0.05", (0.02, 0.02, 0.05), np.pi * 0.02**2 * 0.1),
        ("capsule", "0.02 0.05", (0.02, 0.02, 0.07), np.pi * 0.02**2 * (0.1 + 4 / 3 * 0.02)),
        ("ellipsoid", "0.01 0.02 0.03", (0.01, 0.02, 0.03), 4 / 3 * np.pi * 6e-6),
    ],
)
def test_primitive_meshes_have_mujocos_size(kind, size, half, volume):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="{kind}" size="{size}"/></worldbody></mujoco>'
    )
    mesh = geom_mesh(model, 0)
    np.testing.assert_allclose(mesh.bounds, [-np.array(half), half], atol=2e-4)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume, rel=0.03)


def test_bodies_draw_visible_groups_and_meshes_where_mujoco_puts_them():
    box = '<geom type="box" size=".1 .1 .1" group="3"/>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><geom type="plane" size="1 1 0.1"/>
        <body><geom type="sphere" size="0.05"/>{box}</body></worldbody></mujoco>"""
    )
    (body,) = body_meshes(model).items()  # no world: a plane is scenery
    assert (body[0], body[1].extents) == (1, pytest.approx([0.1] * 3, abs=1e-3))
    # an off-centre tetrahedron: MuJoCo re-centres and turns it, which the geom's pose undoes
    corners = np.array([[0.1, 0, 0], [0.14, 0, 0], [0.1, 0.05, 0], [0.1, 0, 0.06]])
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><asset><mesh name="t" vertex="{" ".join(map(str, corners.ravel()))}"/></asset>
        <worldbody><body pos="1 2 3"><geom type="mesh" mesh="t"/></body></worldbody></mujoco>"""
    )
    mesh = body_meshes(model)[1]
    got = np.unique(np.round(mesh.vertices, 6), axis=0)
    np.testing.assert_allclose(got, np.unique(corners, axis=0), atol=1e-6)


@pytest.mark.parametrize("name", ["mimic_p050", "shadow_hand", "unitree_dex3"])
def test_a_finger_is_the_chain_to_its_tip_and_the_palm_is_none(name):
    hand = load_hand(name, "right")
    owner, model = finger_of_body(hand), hand.model
    points = landmark_points(model, hand.spec)
    assert [owner[points[tip][0]] for tip in hand.tip_names] == list(range(len(hand.fingers)))
    assert owner[0] == owner[model.body(hand.spec.palm).id] == -1
    for body in range(1, model.nbody):
        assert owner[model.body_parentid[body]] in (-1, owner[body])


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(
    ("aspect", "covered", "above"), [(0.46, 0.44, 0.0), (1.9, 0.0, 0.0), (1.2, 0.1, 0.2)]
)
def test_the_camera_sees_both_hands_from_the_palm_side(side, aspect, covered, above):
    playback = make_playback(side=side)
    trace, axes = playback.trace, view_axes(HandView(playback.hand, simple=True))
    tips = trace.robot_tips.reshape(-1, 3)
    layout = plan(axes, trace.human, trace.robot_wrist, tips, tips)  # two robots, side by side
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    # the thumb of a right hand is on the right, and fingers bend toward the viewer
    thumb = (trace.robot_tips[0, 0] - trace.robot_tips[0, 1:].mean(axis=0)) @ axes[0]
    assert (thumb > 0) == (side == "right")
    assert (trace.robot_tips[-1, 1:] - trace.robot_tips[0, 1:]).mean(axis=0) @ axes[2] > 0.01

    position, target = camera_for(axes, layout.centre, layout.half, aspect, covered, above)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, axes[1])
    right /= np.linalg.norm(right)
    view = np.stack([right, np.cross(right, forward), forward])
    low, high = [], []
    for points, shift in (
        (trace.human.reshape(-1, 3), layout.human_shift),
        *((tips, shift) for shift in layout.robot_shifts),
    ):
        x, y, depth = ((points + shift - position) @ view.T).T
        assert depth.min() > 0
        screen = np.stack([x / aspect, y]) / (depth * np.tan(FOV / 2))  # -1 .. 1 is the canvas
        assert np.abs(screen).max() <= 1.0
        assert screen[1].min() >= -1 + 2 * covered  # nothing behind the controls
        assert screen[1].max() <= 1 - 2 * above
        low.append(screen[0].min())
        high.append(screen[0].max())
    assert high[0] < low[1] < high[1] < low[2]  # human left of the robots, all apart
    # without a human the view stands on the robot
    layout = plan(axes, np.full((60, 21, 3), np.nan), np.zeros(3), tips)
    for part in (layout.centre, layout.human_shift, *layout.robot_shifts, *layout.tops):
        assert np.isfinite(part).all()


def test_the_status_line_says_frame_time_reason_and_latency():
    status = np.zeros(60, int)
    status[7], status[8] = Status.DEGENERATE_PALM, 99
    latency = np.full(60, 1.25)
    latency[8] = np.nan
    playback = make_playback(status=status, latency_ms=latency)
    line = player.status_line([playback], 7)
    assert 'data-frame="7"' in line
    assert "0.07" in line
    assert "solved in 1.25 ms" in line
    assert Status.DEGENERATE_PALM.reason in line
    assert "status 99" in player.status_line([playback], 8)
    assert "solving time unknown" in player.status_line([playback], 8)


@pytest.mark.parametrize(
    "text",
    [
        '<iframe srcdoc="<script>parent.__pwned=1</script>">',
        "{globalThis.__pwned = 1}",
        "export const pwned = (globalThis.__pwned = 1)",
        "import x from 'data:text/javascript,1'",
        "![picture](http://elsewhere.example/x.png) | `code` \\ &lt; #",
        "from https://elsewhere.example, größer – 手",
    ],
)
def test_text_from_elsewhere_is_never_markup(text):
    shown = plain(text)
    assert html.unescape(shown) == text
    assert not set(re.sub(r"&#\d+;", "", shown)) & set(string.punctuation)
    assert not shown.startswith(("import", "export"))
    assert "\n" not in plain("export\nconst")


def test_runs_that_do_not_fit_together_and_impossible_addresses_are_refused(playback):
    fingers, tips = playback.trace.fingers[:-1], playback.trace.robot_tips[:, :-1]
    four = make_playback(fingers=fingers, robot_tips=tips)
    for runs, words in (
        ([playback, make_playback(61)], "retarget the same frames"),
        ([playback, four], "with the same fingers"),
        ([], "nothing to play"),
    ):
        with pytest.raises(RecordingError, match=words):
            PlaybackServer(runs)
    for host, port in (("192.0.2.1", 8080), ("no.such.host.invalid", 8080), ("127.0.0.1", 70000)):
        with pytest.raises(ConfigError):
            PlaybackServer(playback, host=host, port=port).start()


def test_the_scene_shows_the_kinematics_of_its_frame(server, playback):
    robot, row = server._scene.robots[0], server._scene.row
    tips, joints = row.tips["robot_0"], row.human._joints
    server.set_frame(40)
    eventually(lambda: np.allclose(tips.batched_positions, playback.trace.robot_tips[40]))
    eventually(lambda: server._panel._slider.value == 40)
    hand, look = playback.hand, robot.shown
    poses = HandView(hand, simple=True).bodies(
        playback.trace.joint_positions[40, list(hand.actuated)]
    )
    for body, node in look.first.nodes.items():
        np.testing.assert_allclose(node.batched_positions[0], poses[body][1], atol=1e-5)
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, np.asarray(node.batched_wxyzs[0], float))
        np.testing.assert_allclose(matrix.reshape(3, 3), poses[body][0], atol=1e-4)
    np.testing.assert_allclose(joints.batched_positions, playback.trace.human[40], atol=1e-6)


def test_missing_landmarks_vanish_and_pinches_light_up():
    human = human_hand(np.zeros(3))
    human[1, 6] = np.nan
    human[2, 8] = human[2, 4]
    with PlaybackServer(make_playback(3, human=human), port=0) as server:
        joints = server._scene.row.human._joints
        for frame, missing, lit in ((1, [6], []), (2, [], [4, 8])):
            server.set_frame(frame)
            eventually(lambda frame=frame: server._panel._slider.value == frame)
            assert np.isfinite(joints.batched_positions).all()
            assert (joints.batched_scales == 0).nonzero()[0].tolist() == missing
            shown = np.all(joints.batched_colors == linear(np.array(HIGHLIGHT)), axis=-1)
            assert shown.nonzero()[0].tolist() == lit


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The player's clock: the time [s] that is its only item."""
    clock = [100.0]
    monkeypatch.setattr(player, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    return clock


def test_pause_step_and_speed(server):
    server.set_speed(0.5)
    server.set_frame(-1)
    server.play()  # from the end: over again
    eventually(lambda: 0 < server.frame < 59)
    server.pause()
    held = server.frame
    time.sleep(0.1)
    assert server.frame == held
    server.set_frame(0)
    server.step(-1)
    assert server.frame == 59
    server.set_loop(False)
    server.step(5)
    assert server.frame == 59
    with pytest.raises(ConfigError, match=r"-60\.\.59, not 60"):
        server.set_frame(60)
    with pytest.raises(ConfigError, match="speed"):
        server.set_speed(9.0)


def test_scrubbing_holds_time_until_the_slider_rests(now, server):
    server.play()
    server.scrub(20)
    now[0] += 0.25
    time.sleep(0.1)
    assert server.frame == 20
    assert server.playing
    now[0] += 0.25
    eventually(lambda: server.frame > 20)


def test_a_taken_port_gives_the_next_free_one(playback, capfd):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        server = serve(playback, port=taken, open_browser=False, block=False)
        try:
            assert server.port > taken
            assert server.url == f"http://127.0.0.1:{server.port}"
            assert server.playing
        finally:
            server.stop()
    output = capfd.readouterr()
    # Standard output belongs to results; viser says from a thread of its own that it stops.
    assert output.out == "(viser) Server stopped\n"
    assert f"http://127.0.0.1:{server._wanted_port}" not in output.err
    assert f"(port {taken} was taken)" in output.err


def test_ctrl_c_ends_serve_cleanly(playback, monkeypatch):
    before = set(threading.enumerate())

    def interrupted(self: PlaybackServer) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(PlaybackServer, "wait", interrupted)
    server = serve(playback, port=0, open_browser=False)
    with pytest.raises(ConfigError, match="start"):
        _ = server.url
    server.stop()  # twice is fine
    assert set(threading.enumerate()) <= before


def test_an_error_while_drawing_reaches_the_caller(server, monkeypatch):
    def broken(frame: int) -> None:
        raise RuntimeError("lost the scene")

    monkeypatch.setattr(server._scene, "draw", broken)
    server.set_frame(3)
    with pytest.raises(RuntimeError, match="lost the scene"):
        server.wait()


def test_a_browser_needs_a_desktop_and_gets_no_token_in_its_arguments(monkeypatch):
    opened: list[str] = []
    monkeypatch.setattr(browser.sys, "platform", "linux")
    monkeypatch.setattr(browser.webbrowser, "open", opened.append)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    browser.open_page("http://127.0.0.1:8080")
    assert opened == []
    monkeypatch.setenv("DISPLAY", ":9")
    browser.open_page("http://127.0.0.1:8080")
    assert opened == ["http://127.0.0.1:8080"]
    browser.open_page("http://10.0.0.7:8080/?token=s3cret&x=1")
    assert "s3cret" not in opened[-1]
    file = Path(unquote(urlsplit(opened[-1]).path.removeprefix("/" if os.name == "nt" else "")))
    assert "url=http://10.0.0.7:8080/?token=s3cret&x=1" in html.unescape(file.read_text())
    if os.name == "posix":
        assert file.stat().st_mode & 0o777 == 0o600
    monkeypatch.setattr(browser, "_FILE_S", 0.05)
    short = browser.leading_to("http://localhost/?token=x")
    eventually(lambda: not short.exists())
    code = "from smooth_operator.web.browser import leading_to; print(leading_to('http://h/?t=x'))"
    assert not Path(python("-c", code, check=True).stdout.strip()).exists()  # goes with its process


@pytest.fixture(scope="module")
def opened(chromium: Any) -> Iterator[tuple[PlaybackServer, Any, list[str]]]:
    """A server, a page that shows it, and what the page has complained about so far."""
    with PlaybackServer(make_playback(300), port=0) as server:
        # software rendering takes 5 s to prepare the reflections
        server._server.scene.configure_environment_map(None)
        page, problems = new_page(chromium)
        page.goto(server.url)
        page.wait_for_selector("#playback-status")
        yield server, page, problems
        page.close()


FRAME = "+document.querySelector('#playback-status').dataset.frame"


@pytest.mark.browser
def test_the_page_plays_pauses_and_scrubs(opened):
    server, page, problems = opened
    for label in ("Frame", "Step", "Speed", "Loop", "Overlay", "Keyvectors"):
        assert page.get_by_text(label, exact=True).is_visible(), label
    assert page.get_by_text("test hand").first.is_visible()
    page.get_by_label("Keyvectors").uncheck()  # they move, too: what is compared is the hands
    eventually(lambda: not server._scene.row.lines["robot_0"].visible)
    # nothing pinches at the start
    colors = {color: color != HIGHLIGHT for color in (*FINGER_COLORS[:2], HIGHLIGHT)}
    start = settled(page, 470, 600, lambda p: all(has(p, c) == w for c, w in colors.items()))

    page.get_by_role("button", name="Play (Space)", exact=True).click()
    page.wait_for_function(f"{FRAME} > 20")
    assert server.playing
    page.get_by_role("button", name="Pause (Space)", exact=True).click()
    page.get_by_role("button", name="Play (Space)", exact=True).wait_for()
    held = server.frame
    page.wait_for_timeout(400)
    assert server.frame == held == int(page.evaluate(FRAME))

    page.locator('[role=slider][aria-valuemax="299"]').press("End")
    page.wait_for_function(f"{FRAME} == 299")
    assert server.frame == 299
    for left, right in ((0, 235), (235, 470)):  # the human hand has moved, and the robot
        part = np.s_[:, left:right]
        settled(page, 470, 600, lambda p, part=part: changed(p[part], start[part]) > 0.01)
    page.get_by_role("button", name="−1 (J)", exact=True).click()
    page.wait_for_function(f"{FRAME} == 298")
    for key, playing in (("k", True), ("Space", False), ("Space", True)):
        page.get_by_role("button", name="−1 (J)").focus()  # which Space does not press
        page.keyboard.press(key)
        eventually(lambda playing=playing: server.playing == playing)
    server.pause()
    eventually(lambda: not nameless(page))
    assert page.locator(".mantine-Notification-root").count() == 0
    assert page.title() == "test hand – smooth-operator"

    page.get_by_label("Overlay").check()
    eventually(lambda: np.allclose(server._scene.row.roots["robot_0"].position, 0))
    assert problems == []


@pytest.mark.browser
def test_the_page_fits_a_phone(opened):
    server, page, problems = opened
    server.pause()
    server.set_frame(0)
    server.set_overlay(False)
    page.set_viewport_size({"width": 390, "height": 844})
    play = page.get_by_role("button", name="Play (Space)", exact=True)

    def inside() -> bool:
        """Whether the button is on the screen; it may be gone while the layout changes."""
        box = play.bounding_box()
        return box is not None and box["x"] >= 0 and box["y"] + box["height"] <= 844

    eventually(inside, 30)
    eventually(lambda: both_hands_fit(page), 30)  # the camera follows the new shape
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert problems == []


def has(picture: np.ndarray, color: tuple[int, int, int]) -> bool:
    """Whether a colour is on a picture, bright or dim."""
    pixels = picture[picture.max(axis=-1) > 60]
    hue = np.array(color) / np.linalg.norm(color)
    return bool((pixels @ hue / np.linalg.norm(pixels, axis=-1) > 0.985).any())


def both_hands_fit(page: Any) -> bool:
    """Something bright spans a phone's width above the controls, and none of it is cut off."""
    shown = settled(page, 390, 440)
    columns = (shown.max(axis=-1) > 60).any(axis=0).nonzero()[0]
    return bool(columns.min() >= 2 and columns.max() <= 387 and np.ptp(columns) > 200)
