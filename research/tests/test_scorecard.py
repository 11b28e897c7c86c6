"""Scorecard of a hand: Kapandji's test, object sizes, postures, the command."""

from dataclasses import replace

import numpy as np
import pytest

from smooth_operator.cli.hands_check import Check
from smooth_operator.errors import HandModelError
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.surfaces import tip_surface_distances
from smooth_operator.synthetic.gestures import FREE_LOWER, FREE_UPPER
from smooth_operator_research.scorecard.card import hand_scorecard
from smooth_operator_research.scorecard.command import kapandji_picture, print_scorecard
from smooth_operator_research.scorecard.grasp_sizes import object_size, pinch
from smooth_operator_research.scorecard.kapandji import (
    PATCH,
    TOUCHED,
    highest_stage,
    kapandji_places,
    kapandji_touches,
)
from smooth_operator_research.scorecard.postures import (
    grasp_postures,
    posture_faults,
    standard_postures,
)


def only(*stages):
    """Keeps the places of some stages."""
    return lambda places: [place for place in places if place.stage in stages]


@pytest.fixture(scope="module")
def wuji():
    return load_hand("wuji_hand")


@pytest.fixture(scope="module")
def wuji_touches(wuji):
    return kapandji_touches(wuji, only(3, 6, 9))


def test_wujis_thumb_reaches_the_whole_little_finger(wuji_touches):
    free, _ = wuji_touches
    assert [touch.stage for touch in free if touch.touched] == [3, 6, 9]
    assert highest_stage(free) == 9


def test_straight_fingers_score_no_higher_than_bent_ones(wuji_touches):
    for free, straight in zip(*wuji_touches, strict=True):
        assert free.distance <= straight.distance
    assert sum(t.touched for t in wuji_touches[1]) < sum(t.touched for t in wuji_touches[0])


def test_inspires_thumb_does_not_reach_the_little_finger():
    free, straight = kapandji_touches(load_hand("inspire_hand"), only(2, 6))
    assert [touch.touched for touch in free] == [True, False]
    assert not any(touch.touched for touch in straight)
    assert highest_stage(free[1:]) is None


def test_mujoco_measures_the_same_touch_within_the_limits(wuji, wuji_touches):
    touch = wuji_touches[0][0]  # the tip of the index finger
    q = wuji.full_configuration(touch.pose)[None]
    pairs = np.array([[True, False, False, False]])
    apart = tip_surface_distances(wuji, q, pairs)[0, 0]
    assert -TOUCHED <= apart <= TOUCHED + 0.001  # points are 2 mm apart
    assert penetration_depths(wuji, q)[0] <= TOUCHED
    low, high = wuji.limits.T
    assert ((touch.pose >= low) & (touch.pose <= high)).all()


def test_two_runs_give_the_same_poses(wuji, wuji_touches):
    again, _ = kapandji_touches(wuji, only(9))
    assert np.array_equal(again[0].pose, wuji_touches[0][2].pose)


def test_a_hand_without_a_little_finger_has_no_stage_of_its_tip():
    stages = [place.stage for place in kapandji_places(load_hand("leap_hand"))]
    assert stages == [0, 1, 2, 3, 4, 5, 7, 8, 9, 10]


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_side_of_the_index_faces_the_thumb(side):
    hand = load_hand("shadow_hand", side)
    first, *_ = kapandji_places(hand)
    (touch,), _ = kapandji_touches(hand, only(first.stage))
    thumb = hand.landmark_positions(touch.pose)[hand.tree.names.index("thumb_tip")]
    assert (thumb - touch.point) @ touch.normal > 0
    assert np.linalg.norm(thumb - touch.point) < 0.02 + PATCH


def test_wuji_pinches_a_sheet_and_a_ball_and_no_melon(wuji):
    grasp = pinch(wuji, "index")
    assert object_size(wuji, grasp, largest=False) == 0.0
    assert 0.05 < object_size(wuji, grasp, largest=True) < 0.2


def test_inspires_thumb_and_little_finger_leave_a_gap():
    hand = load_hand("inspire_hand")
    assert 0.02 < object_size(hand, pinch(hand, "pinky"), largest=False) < 0.05


def test_the_33_grasps_are_within_the_human_joint_ranges():
    grasps = grasp_postures()
    assert [name.split()[0] for name in grasps] == [str(k) for k in range(1, 34)]
    angles = np.array(list(grasps.values()))
    assert ((angles >= FREE_LOWER) & (angles <= FREE_UPPER)).all()


def test_inspire_takes_a_flat_hand_and_does_not_spread_its_fingers():
    postures = standard_postures()
    chosen = {name: postures[name] for name in ("flat", "spread")}
    assert list(posture_faults(load_hand("inspire_hand"), chosen)) == ["spread"]


def test_a_gripper_gets_a_clear_sentence():
    with pytest.raises(HandModelError, match=r"gripper of two jaws.*without --scorecard"):
        hand_scorecard(load_hand("robotiq_2f85"))


def test_a_broken_model_gets_a_clear_error(tmp_path):
    spec = tmp_path / "broken.toml"
    write_hand_spec(replace(load_hand("inspire_hand").spec, model=tmp_path / "absent.xml"), spec)
    options = Check(hand=str(spec), scorecard=True)
    with pytest.raises(HandModelError, match=r"absent\.xml"):
        print_scorecard(options, lambda what, steps: steps)


def test_the_picture_shows_the_place_in_red_in_the_middle_of_a_view(wuji, wuji_touches):
    picture = np.asarray(kapandji_picture(wuji, wuji_touches[0][:1], 1, 60), float)
    assert picture.shape == (60, 120, 3)
    red = picture[..., 1] < 0.25 * picture[..., 0]  # the thumb is orange
    rows, columns = np.nonzero(red)
    assert len(rows)
    assert np.abs(rows - 30).max() < 8
    assert np.minimum(np.abs(columns - 30), np.abs(columns - 90)).max() < 8
