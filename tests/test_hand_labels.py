"""Which seen hand is which: flipped labels, doubles, crossings. No tracker is needed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from smooth_operator.teleop.sources.webcam.picture_tracker import (
    MEMORY_S,
    PATIENCE,
    SeenHand,
    Tracks,
    assign_sides,
    landmarks_of,
)
from smooth_operator.types import Side

PERIOD = 1 / 30
PALM = 0.1  # in the picture


def seen(label: Side, x: float, score: float = 0.95) -> SeenHand:
    """A hand whose palm is a tenth of the picture long, ``x`` from its left edge."""
    picture = np.zeros((21, 3))
    picture[:, 0] = x
    picture[:, 1] = 0.5
    picture[[5, 9, 13, 17], 1] -= PALM
    return SeenHand(label, score, np.zeros((21, 3)), picture, np.ones(21, bool))


def feed(pictures: list[list[SeenHand]]) -> list[dict[Side, float]]:
    """Side -> x of the hand that it got, for each picture."""
    out, tracks = [], Tracks()
    for i, hands in enumerate(pictures):
        found, tracks = assign_sides(hands, tracks, i * PERIOD)
        out.append({side: float(hand.picture[0, 0]) for side, hand in found.items()})
    return out


BOTH = [seen("right", 0.2), seen("left", 0.8)]


def test_two_hands_keep_their_labels() -> None:
    assert feed([BOTH, BOTH]) == [{"right": 0.2, "left": 0.8}] * 2


def test_the_order_in_which_they_are_found_does_not_matter() -> None:
    assert feed([BOTH, BOTH[::-1]])[1] == {"right": 0.2, "left": 0.8}


def test_a_label_that_flips_for_a_moment_is_overruled() -> None:
    flipped = [seen("left", 0.21, 0.99)]
    assert feed([[seen("right", 0.2)], flipped, flipped, [seen("right", 0.22)]]) == [
        {"right": 0.2},
        {"right": 0.21},
        {"right": 0.21},
        {"right": 0.22},
    ]


def test_a_label_that_insists_is_believed() -> None:
    """Or the first guess, if it was wrong, would hold for ever."""
    out = feed([[seen("right", 0.2)]] + [[seen("left", 0.2)]] * (PATIENCE + 3))
    sides = [next(iter(found)) for found in out]
    assert sides == ["right"] * PATIENCE + ["left"] * 4


def test_labels_that_swap_for_a_moment_move_no_hand() -> None:
    swapped = [seen("left", 0.2), seen("right", 0.8)]
    assert feed([BOTH, swapped, swapped, BOTH]) == [{"right": 0.2, "left": 0.8}] * 4


def test_hands_that_cross_keep_their_labels() -> None:
    """Where both were near, the label decides."""
    steps = np.linspace(-0.2, 0.2, 15)
    out = feed([[seen("right", 0.5 + x), seen("left", 0.5 - x)] for x in steps])
    for x, found in zip(steps, out, strict=True):
        assert found.get("right", 0.5 + x) == pytest.approx(0.5 + x)
        assert found.get("left", 0.5 - x) == pytest.approx(0.5 - x)
    assert set(out[-1]) == {"right", "left"}


def test_of_two_hands_with_one_label_the_surer_one_counts_and_none_is_guessed() -> None:
    assert feed([[seen("right", 0.2, 0.7), seen("right", 0.8, 0.9)]]) == [{"right": 0.8}]


def test_of_two_hands_with_one_label_the_one_that_was_there_counts() -> None:
    strangers = [seen("right", 0.2, 0.7), seen("right", 0.8, 0.99)]
    assert feed([[seen("right", 0.2)], strangers])[1] == {"right": 0.2}


def test_two_hands_get_one_label_for_a_moment() -> None:
    confused = [seen("right", 0.2, 0.8), seen("right", 0.8, 0.9)]
    assert feed([BOTH, confused])[1] == {"right": 0.2, "left": 0.8}


def test_one_hand_found_twice_is_one_hand() -> None:
    twice = [seen("left", 0.2 + 0.3 * PALM, 0.6), seen("right", 0.2, 0.9)]
    assert feed([twice]) == [{"right": 0.2}]


def test_what_was_long_ago_is_forgotten() -> None:
    wait = int(MEMORY_S / PERIOD) + 2
    assert feed([[seen("right", 0.2)]] + [[]] * wait + [[seen("left", 0.2)]])[-1] == {"left": 0.2}


def test_time_that_goes_back_forgets_all() -> None:
    _, tracks = assign_sides([seen("right", 0.2)], Tracks(), 20.0)
    found, _ = assign_sides([seen("left", 0.2)], tracks, 0.0)
    assert list(found) == ["left"]


def test_a_hand_may_move_fast_but_not_jump() -> None:
    assert feed([[seen("right", 0.2)], [seen("left", 0.2 + 1.4 * PALM)]])[1] == {
        "right": pytest.approx(0.34)
    }
    assert feed([[seen("right", 0.2)], [seen("left", 0.2 + 1.6 * PALM)]])[1] == {
        "left": pytest.approx(0.36)
    }


def test_points_of_the_picture_get_the_size_of_those_in_metres() -> None:
    rng = np.random.default_rng(1)
    world = rng.normal(scale=0.04, size=(21, 3))
    picture = (world - world.mean(axis=0)) * 2.7 + (0.3, 0.6, 0.0)
    hand = dataclasses.replace(seen("right", 0.5), world=world, picture=picture)
    np.testing.assert_allclose(
        landmarks_of(hand, "picture"), world - world.mean(axis=0), atol=1e-12
    )
    np.testing.assert_array_equal(landmarks_of(hand, "world"), world)
