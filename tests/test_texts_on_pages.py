"""Names and texts that others wrote, on pages in a Chromium: shown letter by letter, never run."""

import sys

import numpy as np
import pytest
from hostile_texts import ATTACK, guarded_page, hostile_hand

from smooth_operator import load_hand
from smooth_operator.cli import main
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.pages.hand_page import HandPage

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(sys.platform == "win32", reason="names of files can't hold markup"),
]


def test_the_page_of_a_hand(chromium, tmp_path):
    hand = load_hand(hostile_hand(tmp_path / ATTACK))
    with HandPage(hand, ATTACK, port=0) as shown, guarded_page(chromium) as page:
        shown._server.scene.configure_environment_map(None)
        page.goto(shown.url)
        page.get_by_text(ATTACK, exact=True).first.wait_for()
        for joint in hand.joint_names:
            assert page.get_by_text(joint, exact=True).count() == 1


def test_the_report_of_a_benchmark(chromium, tmp_path):
    recording = SyntheticOperator(seed=2).record(0.6)
    file = tmp_path / f"{ATTACK}.npz"
    np.savez(file, landmarks=recording.landmarks, timestamps=recording.stamps)
    hand, output = hostile_hand(tmp_path / f"{ATTACK}hand"), tmp_path / "out"
    words = ("--hands", hand, "--methods", "joint_angle", "--output", output, "--workers", "0")
    more = ("--latency-frames", "10", "--quiet")
    main(["bench", str(tmp_path), *map(str, words), *more])
    with guarded_page(chromium) as page:
        page.goto((output / "report.html").as_uri())
        assert page.get_by_text(ATTACK).count() > 3
        play = page.get_by_role("button", name="Play").first
        play.click()
        page.wait_for_timeout(300)
