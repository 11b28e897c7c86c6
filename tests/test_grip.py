"""Thumb and finger press on what keeps them apart, and let go at once."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from smooth_operator import Retargeter, load_hand, method_config
from smooth_operator.errors import ConfigError
from smooth_operator.hands.surfaces import tip_surface_distances
from smooth_operator.human.grip import GripConfig, GripState, grip
from smooth_operator.landmarks import TIPS
from smooth_operator.metrics.pinches import DEEP
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.types import HandFrame

CONFIG = GripConfig()
step = jax.jit(grip, static_argnums=4)


def held(distances, dt=0.01, nearness=(1.0, 0.0)):
    """(T, 3, 3) offsets of thumb, index and middle finger; the index is so far from the thumb."""
    state, offsets = GripState.open(3), []
    for frame, distance in enumerate(distances):
        tips = np.array([[0.0, 0, 0], [distance, 0, 0], [0, 0.1, 0]], np.float32)
        state = step(state, tips, np.float32(nearness), np.float32(dt), CONFIG, frame == 0)
        offsets.append(np.asarray(state.offsets))
    return np.stack(offsets)


@pytest.mark.parametrize("dt", [0.01, 1 / 30])
def test_the_grip_grows_while_the_distance_stays_and_moves_thumb_and_finger_alike(dt):
    offsets = held([0.02] * round(0.5 / dt), dt)
    assert abs(offsets[0]).max() <= CONFIG.depth * dt / CONFIG.time
    half = 0.5 * CONFIG.depth * 0.02 / (0.02 + CONFIG.depth)
    np.testing.assert_allclose(offsets[-1], [[half, 0, 0], [-half, 0, 0], [0, 0, 0]], atol=1e-6)
    assert abs(np.diff(offsets, axis=0)).max() <= half * dt / CONFIG.time * 1.01


def test_the_grip_is_gone_as_soon_as_the_human_has_opened_by_its_release():
    opening = 0.02 + 0.3 * 0.01 * np.arange(1, 6)  # 0.3 m/s
    offsets = held([*[0.02] * 50, *opening])
    assert abs(offsets[50]).max() < 0.7 * CONFIG.depth / 2
    assert abs(offsets[51:]).max() == 0.0


def test_a_trackers_shake_does_not_end_the_grip():
    shake = np.random.default_rng(0).normal(0.0, 0.001, 200)
    offsets = held(0.02 + shake, 1 / 30)
    assert np.median(abs(offsets[60:, 1, 0])) > 0.7 * CONFIG.depth / 2


def test_a_finger_that_pinches_nothing_is_not_gripped():
    assert abs(held([0.02] * 100, nearness=(0.0, 0.0))).max() == 0.0


def test_two_fingers_grip_against_one_thumb():
    state = GripState.open(3)
    tips = np.array([[0.0, 0, 0], [0.02, 0.01, 0], [0.02, -0.01, 0]], np.float32)
    for frame in range(50):
        state = step(state, tips, np.float32([1, 1]), np.float32(0.01), CONFIG, frame == 0)
    lengths = np.linalg.norm(state.offsets, axis=1)
    np.testing.assert_allclose(lengths, lengths[0], rtol=1e-4)
    np.testing.assert_allclose(state.offsets[0], [lengths[0], 0, 0], atol=1e-6)


def test_settings_are_checked():
    with pytest.raises(ConfigError, match=r"grip\.time"):
        GripConfig(time=0.0)


def commanded(config, frames):
    """Commands of frames at 100 Hz."""
    retargeter = Retargeter("mimic_p050", config=config)
    state, commands = retargeter.init(), []
    for k, points in enumerate(frames):
        state, result = retargeter.step(state, HandFrame(points, 0.01 * k, "right"))
        commands.append(result.command.joint_positions)
    return np.stack(commands)


def test_the_hand_closes_on_a_held_thing_and_pads_without_one_stay_whole():
    hand, config = load_hand("mimic_p050"), method_config("smooth")
    points = human_landmarks(hand, hand.neutral[None])[0]
    index, thumb = TIPS[1], TIPS[0]
    none = replace(config, grip=replace(config.grip, depth=0.0))
    for apart, least in ((0.018, 0.0015), (0.001, -0.0005)):
        pinch = points.copy()
        middle = (pinch[index] + pinch[thumb]) / 2
        across = (pinch[index] - pinch[thumb]) / np.linalg.norm(pinch[index] - pinch[thumb])
        pinch[index], pinch[thumb] = middle + across * apart / 2, middle - across * apart / 2
        frames = np.tile(pinch, (150, 1, 1))
        tips = [hand.tips(commanded(one, frames)[-1:])[0] for one in (none, config)]
        lengths = [np.linalg.norm(tip[1] - tip[0]) for tip in tips]
        assert lengths[0] - lengths[1] > least
    nearest = tip_surface_distances(hand, commanded(config, frames)[-1:], np.ones((1, 4), bool))
    assert nearest[0, 0] > -DEEP
