"""Poses that are found in recordings, and pictures of hands in them."""

import numpy as np

from smooth_operator import load_hand
from smooth_operator.reporting.run_plots import Panel, Run, robot_landmarks
from smooth_operator.synthetic.gestures import FIST, FLAT, pinch_postures
from smooth_operator.synthetic.hand_anatomy import couple, draw_anatomy, pose_hand
from smooth_operator_benchmark.contact_sheet import (
    CELL,
    HandPicture,
    contact_sheet,
    find_poses,
    pose_scores,
)
from smooth_operator_benchmark.hand_surface import Surface, landmark_surface, paint, rod
from smooth_operator_benchmark.model_shape import ModelShape

STILL = 9


def human_hand(postures: list[np.ndarray]) -> np.ndarray:
    """(T, 21, 3) landmarks; each posture is held for ``STILL`` frames."""
    held = np.repeat(np.stack(postures), STILL, axis=0)
    return pose_hand(draw_anatomy(0.19, 0), couple(held)).landmarks


def panel(human: np.ndarray, name: str = "a", side: str = "right", methods: str = "m") -> Panel:
    hand = load_hand("shadow_hand", side)
    joints = np.tile(hand.full_configuration(hand.neutral), (len(human), 1))
    points = robot_landmarks(hand, joints)
    runs = tuple(Run(method, human, points, joints) for method in methods)
    return Panel((name, hand.name, side), hand, np.arange(len(human)) / 100.0, runs)


def test_poses_are_found_where_they_are():
    human = human_hand([FLAT, FIST, *pinch_postures(0)])
    found = {pose.name: pose.frame // STILL for pose in find_poses([panel(human)])}
    assert found["flat"] == 0
    assert found["fist"] == 1
    pinches = [name for name in found if name.startswith(("pinch", "OK", "tripod"))]
    assert pinches
    assert all(found[name] >= 2 for name in pinches)


def test_a_single_wrong_frame_is_no_pose_and_nan_is_none():
    human = human_hand([FLAT, FLAT])
    human[5] = human_hand([FIST])[0]
    human[0] = np.nan
    assert [pose.name for pose in find_poses([panel(human)])] == ["flat"]
    assert (pose_scores(human)["fist"] <= 0).all()
    assert find_poses([panel(np.full((STILL, 21, 3), np.nan))]) == []
    flat, fist = panel(human_hand([FLAT]), "flat"), panel(human_hand([FIST]), "fist")
    shown = {pose.name: pose.panel.key[0] for pose in find_poses([fist, flat])}
    assert (shown["flat"], shown["fist"]) == ("flat", "fist")  # the best recording for each


def test_the_nearer_surface_hides_the_other():
    square = np.array([[[-1, -1, 0], [1, -1, 0], [1, 1, 0]], [[-1, -1, 0], [1, 1, 0], [-1, 1, 0]]])
    near, far = square * 0.5 + [0, 0, 1], square * 1.0
    colors = np.repeat(np.array([[200, 0, 0], [0, 0, 200]], np.uint8), 2, axis=0)
    picture = paint(Surface(np.concatenate([near, far]), colors), np.eye(3), (0.0, 0.0), 1.25, 50)
    middle, side, corner = picture[25, 25], picture[25, 9], picture[1, 1]
    assert middle[0] > 100 > middle[2]
    assert side[2] > 100 > side[0]
    assert (corner == 255).all()  # paper


def test_a_rod_is_closed_and_as_thick_as_asked():
    start, end = np.array([0.0, 0, 0]), np.array([0.0, 0.03, 0.04])
    corners = rod(start, end, 0.005).reshape(-1, 3)
    axis = (end - start) / 0.05
    along = np.clip(corners @ axis, 0, 0.05)
    away = np.linalg.norm(corners - along[:, None] * axis, axis=1)
    np.testing.assert_allclose(away.max(), 0.005, rtol=1e-6)
    np.testing.assert_allclose((corners @ axis).max(), 0.055, rtol=1e-6)


def test_a_human_hand_stands_upright_with_its_palm_in_sight():
    points = human_hand([FLAT, FIST])
    for side, (hand, *_, bent) in (("right", points), ("left", points * [-1, 1, 1])):
        palm, beside = HandPicture.of_human(hand, side).views
        assert palm[1] @ (hand[12] - hand[0]) > 0.1
        assert palm[2] @ (bent[12] - bent[9]) > 0.005  # fingers close toward the viewer
        assert beside[2] @ (hand[5] - hand[17]) > 0.02  # from the thumb's side
    assert len(landmark_surface(np.full((21, 3), np.nan)).triangles) == 0


def test_a_sheet_has_a_row_a_pose_and_a_column_a_method(tmp_path):
    human = human_hand([FLAT, FIST])
    first, second = panel(human[:STILL], "one", methods="mn"), panel(human[STILL:], "two")
    shapes: list[str] = []

    def shape(hand):
        shapes.append(hand.name)
        return ModelShape(hand)

    sheet = contact_sheet([first, second], shape, ("fist", "flat"))
    assert shapes == ["shadow_hand"]
    pixels = np.asarray(sheet)
    ink = (pixels < 250).any(axis=-1)
    assert pixels.shape[0] > 2 * CELL
    column = (pixels.shape[1] - 3 * 2 * CELL) // 2
    assert column > 0
    rows = [ink[-2 * CELL : -CELL], ink[-CELL:]]
    robot_n = slice(pixels.shape[1] - 2 * CELL - 4, None)
    assert rows[0][2:-2, robot_n].sum() == 0  # the second method has no fist
    assert rows[1][2:-2, robot_n].sum() > 500
    assert contact_sheet([panel(np.full((STILL, 21, 3), np.nan))]) is None
