"""The page of one hand, in a Chromium: a slider for every joint, and they move it."""

import socket
import sys
import threading
from dataclasses import replace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser_page import changed, nameless, new_page, settled
from hostile_texts import ATTACK, guarded_page, hostile_hand
from live_time import until as eventually

from smooth_operator.hands.capsules import hand_capsules
from smooth_operator.hands.hand import load_hand_spec
from smooth_operator.hands.registry import load_hand
from smooth_operator.teleop.pages.hand_page import HandPage
from smooth_operator.teleop.pages.hand_view import HandView

WIDTH, HEIGHT = 700, 480
SHOWN = 400  # the panel is to the right of this [px]


@pytest.mark.parametrize("name", ["mimic_p050", "allegro_hand", "shadow_hand", "franka_hand"])
def test_simple_shapes_are_those_that_self_collision_is_judged_by(name):
    """Nothing of a part stands out of the picture, and the picture shows nothing else."""
    hand = load_hand(name)
    drawn, capsules = HandView(hand, simple=True).meshes, hand_capsules(hand)
    for body, mesh in drawn.items():
        own = [capsule for capsule in capsules if capsule.body == body]
        low = np.min([c.ends.min(axis=0) - c.radius for c in own], axis=0)
        high = np.max([c.ends.max(axis=0) + c.radius for c in own], axis=0)
        np.testing.assert_allclose(mesh.bounds, [low, high], atol=0.002)
    assert {capsule.body for capsule in capsules} == set(drawn)


def test_a_shape_without_a_surface_is_not_drawn(tmp_path):
    """A tip's mesh of less than a millimetre is a capsule of no width."""
    whole = load_hand("allegro_hand")
    text = whole.spec.model.read_text(encoding="utf-8")
    speck = f'<body name="{whole.spec.fingers[1].tip.body}"'
    at = text.index(">", text.index(speck)) + 1
    model = tmp_path / whole.spec.model.name
    model.write_text(text[:at] + '<geom type="sphere" size="1e-8"/>' + text[at:], encoding="utf-8")
    hand = load_hand_spec(replace(whole.spec, model=model))
    assert set(HandView(hand, simple=True).meshes) == set(HandView(whole, simple=True).meshes)


def position(slider: Any) -> float:
    return float(slider.get_attribute("aria-valuenow") or "nan")


@pytest.mark.weekly
@pytest.mark.browser
def test_a_slider_moves_its_joint_and_the_hand_on_the_page(chromium):
    hand = load_hand("inspire_hand", "left")  # it has joints that follow others
    with HandPage(hand, "what was found", port=0) as served:
        # software rendering takes 5 s to prepare the reflections
        served._server.scene.configure_environment_map(None)
        page, problems = new_page(chromium, WIDTH, HEIGHT)
        page.goto(served.url)
        # the warning about software rendering would stand before the hand
        page.add_style_tag(content=".mantine-Notification-root {display: none !important}")
        page.get_by_text("what was found").wait_for()
        assert page.get_by_text("left hand", exact=False).first.is_visible()
        for joint in hand.joint_names:
            assert page.get_by_text(joint, exact=True).count() == 1, joint
        # not by role: the knob of one that can't be moved is not drawn
        sliders = page.locator('[role="slider"]')
        assert sliders.count() == len(hand.joint_names)
        # there is a hand
        rest = settled(page, SHOWN, HEIGHT, lambda p: (p.max(axis=-1) > 60).mean() > 0.02)

        moved = 1 + int(np.argmax(np.ptp(hand.limits, axis=1)[1:]))
        sliders.nth(moved).press("End")
        high = hand.limits[moved, 1]
        eventually(lambda: np.isclose(served.joint_positions[moved], high, atol=0.02))
        others = np.arange(len(hand.limits)) != moved
        np.testing.assert_array_equal(served.joint_positions[others], hand.neutral[others])
        settled(page, SHOWN, HEIGHT, lambda p: changed(p, rest) > 0.002)
        # the sliders of joints that follow go along and can't be moved by hand
        every = hand.full_configuration(served.joint_positions)
        followers = [i for i in range(len(hand.joint_names)) if i not in hand.actuated]
        for at, joint in enumerate(followers, len(hand.actuated)):
            knob = sliders.nth(at)
            eventually(lambda k=knob, v=every[joint]: abs(position(k) - v) < 0.02)
            assert knob.get_attribute("aria-disabled") == "true"
        assert np.abs(every - hand.full_configuration(hand.neutral))[followers].max() > 0.1
        page.get_by_role("button", name="Neutral pose").click()
        eventually(lambda: np.array_equal(served.joint_positions, hand.neutral))
        rest = settled(page, SHOWN, HEIGHT)
        page.get_by_label("shape", exact=True).uncheck()
        nodes = served._robot.shown.first.nodes.values()
        eventually(lambda nodes=nodes: not any(node.visible for node in nodes))
        settled(page, SHOWN, HEIGHT, lambda p: changed(p, rest) > 0.01)
        assert problems == []
        page.close()


@pytest.mark.browser
@pytest.mark.skipif(sys.platform == "win32", reason="names of files can't hold markup")
def test_names_and_texts_of_a_hand_are_shown_and_never_run(chromium, tmp_path):
    hand = load_hand(hostile_hand(tmp_path / ATTACK))
    texts = ('<iframe srcdoc="<script>parent.__pwned=1</script>">', "export const a = (b = 3)")
    hand = replace(hand, spec=replace(hand.spec, source=texts[0]))
    for description in (ATTACK, texts[1]):
        with HandPage(hand, description, port=0) as served, guarded_page(chromium) as page:
            served._server.scene.configure_environment_map(None)
            asked: list[str] = []
            page.on("request", lambda request, asked=asked: asked.append(request.url))
            page.goto(served.url)
            for text in (description, texts[0]):
                page.get_by_text(text, exact=True).first.wait_for()
            for joint in hand.joint_names:
                assert page.get_by_text(joint, exact=True).count() == 1
                assert page.get_by_role("slider", name=joint).count() == 1
            assert page.locator("iframe").count() == 0
            eventually(lambda page=page: not nameless(page))
            assert all(url.startswith((served.url, "data:", "blob:", "ws:")) for url in asked)


@pytest.mark.browser
def test_a_page_reaches_nothing_elsewhere_and_its_server_ends_with_it(chromium):
    before = set(threading.enumerate())
    with HandPage(load_hand("allegro_hand"), "a hand", port=0) as served:
        page, problems = new_page(chromium, WIDTH, HEIGHT, drawn=False)
        page.goto(served.url)
        fetch = "fetch('http://elsewhere.example/').then(() => 'sent', () => 'refused')"
        assert page.evaluate(fetch) == "refused"
        assert any("Content Security Policy" in problem for problem in problems)
        page.close()
        address = urlsplit(served.url)
        assert address.hostname == "127.0.0.1"
    with socket.socket() as probe:
        assert probe.connect_ex((address.hostname, address.port)) != 0
    eventually(lambda: not {t for t in threading.enumerate() if not t.daemon} - before)
