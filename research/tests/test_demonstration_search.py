"""Demonstrations for other hands: first guesses, the search, and the files that come of it."""

from dataclasses import replace

import numpy as np
import pytest

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.scenes import scene_for
from smooth_operator.simulation.tasks import FIXED_WRIST
from smooth_operator_research.demonstrations import search
from smooth_operator_research.demonstrations.demonstration import (
    demonstrated_hands,
    demonstration_text,
    load_demonstration,
    play,
    read_demonstration,
)
from smooth_operator_research.demonstrations.judging import (
    Candidate,
    World,
    excess,
    judge,
    tried,
)
from smooth_operator_research.demonstrations.search import Evolution, transferred

pytestmark = [pytest.mark.weekly, pytest.mark.usefixtures("elsewhere")]


OTHERS = [(task, name) for task in FIXED_WRIST for name in demonstrated_hands(task)[1:]]


@pytest.mark.parametrize(("task", "name"), OTHERS)
def test_another_hand_can_do_it(task, name):
    *_, (_, run) = play(load_demonstration(task, name))
    assert (run.outcome.score, run.outcome.line) == (1.0, "done")


@pytest.mark.parametrize("task", FIXED_WRIST)
def test_a_file_is_read_as_it_was_written(task):
    assert demonstrated_hands(task)[0] == "mimic_p050"
    for name in demonstrated_hands(task):
        demonstration = load_demonstration(task, name)
        again = read_demonstration(demonstration_text(demonstration))
        assert (again.task, again.hand, again.side) == (task, name, "right")
        np.testing.assert_allclose(again.poses, demonstration.poses, atol=5e-4)
        np.testing.assert_array_equal(again.times, demonstration.times)


def test_an_operator_before_a_headset_has_a_screwdriver_of_his_own():
    common, own = (load_demonstration("screwdriver", tracker=one) for one in ("glove", "headset"))
    np.testing.assert_array_equal(common.times, load_demonstration("screwdriver").times)
    low, high = own.robot.limits.T
    assert ((own.poses < low) | (own.poses > high)).any()  # the person pushes on
    np.testing.assert_array_equal(
        load_demonstration("card", tracker="headset").poses, load_demonstration("card").poses
    )
    assert read_demonstration(demonstration_text(own)).times[-1] == own.times[-1]


def test_what_is_not_there_is_said():
    with pytest.raises(StudyError, match=r"schunk_svh.*mimic_p050"):
        load_demonstration("card", "schunk_svh")
    with pytest.raises(UnknownNameError, match="card"):
        load_demonstration("cart")
    text = demonstration_text(load_demonstration("card"))
    with pytest.raises(StudyError, match="other joints"):
        read_demonstration(text.replace("index_base2mcp", "index_base"))


def test_a_first_guess_has_its_fingertips_where_the_first_hand_has_them():
    demonstration, hand = load_demonstration("cube"), load_hand("allegro_hand")
    first = load_hand(demonstration.hand)
    guess = transferred(demonstration, hand)
    np.testing.assert_array_equal(guess.poses[0], hand.neutral)
    assert ((guess.poses >= hand.limits[:, 0]) & (guess.poses <= hand.limits[:, 1])).all()
    off = []
    for one, poses in ((first, demonstration.poses), (hand, guess.poses)):
        scene = scene_for("cube", one)
        at, turn = scene.mount.palm
        tips = one.tips(one.full_configuration(poses[1:]))[:, :2]
        off.append(at + tips @ turn.T - scene.start[0])
    assert np.median(np.linalg.norm(off[1] - off[0], axis=-1)) < 0.001


def test_the_evolution_finds_an_optimum():
    """An ellipsoid with axes of 1 to 100 about a point that is 1 away in each of 20 numbers."""
    scale = np.geomspace(1.0, 100.0, 20)
    state = Evolution.begin(np.zeros(20), 0.5, 0, 12)
    for _ in range(300):
        points = state.candidates()
        state = state.judged(points, -(((points - 1.0) ** 2) * scale).sum(axis=1))
    np.testing.assert_allclose(state.mean, 1.0, atol=0.01)
    back = Evolution.from_json(state.to_json())
    np.testing.assert_array_equal(back.candidates(), state.candidates())


@pytest.mark.parametrize("task", FIXED_WRIST)
def test_progress_is_more_the_further_a_trial_gets(task):
    """Of a hand that does nothing, of one that stops halfway, and of the demonstration."""
    whole = load_demonstration(task)
    half = np.searchsorted(whole.times, whole.times[-1] / 2)
    poses = whole.poses.copy()
    poses[half:] = poses[half - 1]
    idle = replace(whole, poses=np.broadcast_to(whole.poses[0], whole.poses.shape))
    none, part, all_ = (
        tried(one, World(0, 0)) for one in (idle, replace(whole, poses=poses), whole)
    )
    assert none < 0.35
    assert none < part < 1.0 <= all_ <= 1.1


def test_an_operator_before_a_tracker_takes_part():
    """The same operator twice, another one, and none: the joints follow the demonstration."""
    demonstration = load_demonstration("cube")
    worlds = [
        World(1000, 1, 2, "headset"),
        World(1000, 1, 2, "headset"),
        World(1000, 1, 3, "headset"),
        World(1000, 1),
    ]
    first, again, other, own = judge(Candidate(demonstration, tuple(worlds)))
    assert first == again
    assert len({first, other, own}) == 3


def test_a_search_moves_what_it_may_within_its_bounds():
    first = load_demonstration("card")
    looking = search.Search(first, 1, 0, 4, sigma=0.5, kept=12, beyond=0.1)
    candidates = [looking._of(point) for point in looking.state.candidates()]
    low, high = first.robot.limits.T
    for one in candidates:
        np.testing.assert_array_equal(one.poses[:12], first.poses[:12])
        np.testing.assert_array_equal(one.times[:12], first.times[:12])
        assert (one.poses >= low - 0.101).all()
        assert (one.poses <= high + 0.101).all()
    moved = np.stack([one.poses[12:] for one in candidates])
    assert ((moved < low) | (moved > high)).any()


def test_self_penetration_counts_beyond_what_a_pinch_needs():
    """A thumb in the index finger: deeper costs more, and merit goes down by it."""
    hand, demonstration = load_hand("mimic_p050"), load_demonstration("card")
    open_ = replace(demonstration, poses=np.broadcast_to(hand.neutral, demonstration.poses.shape))
    names = hand.actuated_names
    inward = {
        "thumb_base2cmc": 0.47,
        "thumb_cmc2mcp": -0.53,
        "thumb_mcp2pp": 1.71,
        "thumb_pp2dp_actuated": 1.45,
        "index_base2mcp": 0.49,
        "index_mcp2pp": 1.5,
        "index_pp2mp": 1.33,
    }
    deep = np.array(open_.poses)
    deep[4, [names.index(name) for name in inward]] = list(inward.values())
    deeper = deep.copy()
    deeper[4, names.index("index_mcp2pp")] += 0.2
    amounts = [excess(replace(open_, poses=poses)) for poses in (open_.poses, deep, deeper)]
    assert amounts[0] == 0.0 < amounts[1] < amounts[2]
    judged = [
        judge(Candidate(replace(open_, poses=poses), (World(0, 0),)))[0]
        for poses in (open_.poses, deeper)
    ]
    assert judged[1] < judged[0]


def test_a_search_goes_on_where_it_stopped(tmp_path):
    state, output = tmp_path / "state.json", tmp_path / "cube.json"
    common = ["mimic_p050", "cube", "--output", str(output), "--state", str(state)]
    common += ["--candidates", "2", "--worlds", "1", "--workers", "0", "--sigma", "0.001"]
    search.main([*common, "--generations", "1"])
    first = state.read_text()
    found = read_demonstration(output.read_text())
    *_, (_, run) = play(found)
    assert run.outcome.score == 1.0
    search.main([*common, "--generations", "1"])
    assert state.read_text() == first
