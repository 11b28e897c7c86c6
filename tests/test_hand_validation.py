"""Checks of a hand's description: a right one passes, each fault is found by the check for it."""

import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest
from compact_hands import GRIPPERS

from smooth_operator.cli import main
from smooth_operator.errors import ConfigError
from smooth_operator.hand_discovery.checks import HandValidation, Samples
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.fingers import part_distances
from smooth_operator.hand_discovery.hand_validation import (
    check_hand,
    check_method,
    check_pinches,
    reachable_poses,
    round_trip,
)
from smooth_operator.hand_discovery.joint_map import check_joint_map
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.registry import hand_names, load_hand
from smooth_operator.hands.spec import FingerSpec, HandSpec, Point
from smooth_operator.hands.surfaces import tip_surface_distances
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.types import JointCommand, Result, Status

pytestmark = pytest.mark.usefixtures("own_hands")

ALLEGRO = load_hand("allegro_hand").spec
BASICS = {
    "size",
    "palm frame",
    "palm tilt",
    "wrist",
    "joint ranges",
    "joints used",
    "fingertips",
    "neutral pose",
    "shapes",
    "flexion",
    "side",
    "pinches",
}
SIDES = [(name, side) for name in hand_names() for side in ("right", "left")]
EVERY_RUN = (("allegro_hand", "left"), ("inspire_hand", "left"), ("mimic_p050", "right"))
"""Hands of each run of the tests; the weekly run checks all."""


def basics(hand: str | Hand | HandSpec, side: str | None = None) -> HandValidation:
    return check_hand(hand, side, methods=())


@pytest.mark.parametrize(
    ("name", "side"),
    [pytest.param(*pair, marks=[] if pair in EVERY_RUN else pytest.mark.weekly) for pair in SIDES],
)
def test_a_built_in_hand_passes(name, side):
    found = basics(name, side)
    wrist = {"wrist joints"} if load_hand(name, side).spec.wrist_joints else set()
    assert {check.name for check in found.checks} == BASICS | wrist
    # their thumbs do not reach all fingers, e.g. Revo 2's not the little finger
    short = (
        "amazing_hand",
        "brainco_revo2",
        "fourier_hand",
        "inspire_ftp",
        "inspire_hand",
        "inspire_rh56f1",
        "linker_l6",
        "linker_o6",
        "rohand",
    )
    able = {"pinches"} if name in short else set()
    other = {c.name for c in found.checks if c.verdict not in ("ok", "unjudged")}
    jaws = {"flexion"} if name in GRIPPERS else set()  # jaws that stay parallel do not bend
    assert other - jaws == able, found


@pytest.mark.shared
@pytest.mark.parametrize(
    "file",
    [
        "ability_hand/ability_hand_left.urdf",
        "leap_hand/leap_hand_right.urdf",
        "schunk_hand/schunk_svh_hand_right.urdf",
    ],
)
def test_a_discovered_hand_passes(shared, file):
    """URDFs without their meshes: some shapes are left, and are no reason for an alarm."""
    found = basics(discover(shared / "hands_urdf" / file, name="mine").spec)
    assert found.ok, found.failed


# Wrong ones: each is found by its check, and by no other


def retold(spec: HandSpec, tmp_path: Path, change: Callable[[str], str]) -> HandSpec:
    """The same description of a changed model."""
    text = spec.model.read_text(encoding="utf-8")
    changed = change(text)
    assert changed != text
    model = tmp_path / spec.model.name
    model.write_text(changed, encoding="utf-8")
    return replace(spec, model=model)


def with_finger(spec: HandSpec, name: str, tip: Point, dip: Point | bool | None = True) -> HandSpec:
    """A finger's tip moved, and its third point if one is given (None: left out)."""
    fingers = []
    for finger in spec.fingers:
        if finger.name == name:
            a, b, c, _ = finger.points
            finger = FingerSpec(name, (a, b, c if isinstance(dip, bool) else dip, tip))
        fingers.append(finger)
    return replace(spec, fingers=tuple(fingers))


def tip_of(spec: HandSpec, name: str) -> Point:
    return next(finger.tip for finger in spec.fingers if finger.name == name)


def in_degrees(text: str) -> str:
    def turned(match: re.Match[str]) -> str:
        low, high = (float(v) * 180 / np.pi for v in match[1].split())
        return f'range="{low} {high}"'

    return re.sub(r'range="(\S+ \S+)"', turned, text)


def index_bends_back(text: str) -> str:
    """The index finger's flexion axes turned round, as after a mistake in mirroring."""
    root = text
    for joint in load_hand("allegro_hand").joint_names[1:4]:
        root, count = re.subn(
            rf'(<joint name="{re.escape(joint)}"[^>]*axis=")([^"]+)"',
            lambda m: m[1] + " ".join(str(-float(v)) for v in m[2].split()) + '"',
            root,
        )
        assert count == 1, joint
    return root


def palm_of_one_box(text: str) -> str:
    """LEAP's palm as a box around it, which fills the room of the thumb, too."""
    box = '<geom name="palm" type="box" size="0.045 0.065 0.015" pos="-0.065 -0.03 -0.0187"/>'
    return re.sub(r'<geom name="palm" .*<geom name="palm_edge"[^\n]*', box, text, flags=re.DOTALL)


WRONG: dict[str, tuple[str, Callable[[Path], HandSpec], str]] = {
    "side": ("side", lambda _: replace(ALLEGRO, side="left"), "this is a right hand"),
    "order": (
        "side",
        lambda _: replace(
            ALLEGRO,
            fingers=tuple(
                replace(ALLEGRO.fingers[k], name=finger.name)
                for k, finger in zip((0, 3, 2, 1), ALLEGRO.fingers, strict=True)
            ),
        ),
        "wrong order",
    ),
    "degrees": ("joint ranges", lambda p: retold(ALLEGRO, p, in_degrees), "degrees"),
    "radians": (
        "joint ranges",
        lambda p: retold(ALLEGRO, p, lambda t: t.replace('angle="radian" ', "")),
        "radian",
    ),
    "tip on the palm": (
        "fingertips",
        lambda _: with_finger(ALLEGRO, "index", Point(ALLEGRO.palm, (0.0, 0.04, 0.1))),
        "last link",
    ),
    "tip of another finger": (
        "fingertips",
        lambda _: with_finger(ALLEGRO, "middle", tip_of(ALLEGRO, "index")),
        "last link",
    ),
    "tip 10 cm off": (
        "fingertips",
        lambda _: with_finger(
            ALLEGRO, "ring", replace(tip_of(ALLEGRO, "ring"), offset=(0.1, 0.0, 0.02))
        ),
        "offset in metres",
    ),
    "idle joint": (
        "joints used",
        lambda _: with_finger(
            ALLEGRO, "index", Point(ALLEGRO.fingers[1].points[1].body, (0.0, 0.0, 0.03)), None
        ),
        "last link",
    ),
    "neutral": (
        "neutral pose",
        lambda _: replace(
            ALLEGRO, neutral={**ALLEGRO.neutral, load_hand("allegro_hand").joint_names[1]: 20.0}
        ),
        "radians",
    ),
    "wrist": (
        "size",
        lambda _: replace(ALLEGRO, wrist=replace(ALLEGRO.wrist, offset=(0.0, 0.0, -0.9))),
        "metres",
    ),
    "palm too large": (
        "shapes",
        lambda p: retold(load_hand("leap_hand").spec, p, palm_of_one_box),
        "the size of the real parts",
    ),
    "axes": ("flexion", lambda p: retold(ALLEGRO, p, index_bends_back), "sign"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_fault_fails_its_check_and_no_other(fault, tmp_path):
    name, make, advice = WRONG[fault]
    found = basics(make(tmp_path))
    assert [check.name for check in found.failed] == [name], found
    assert advice in found[name].advice
    assert not found.ok


@pytest.mark.parametrize("name", [name for name in hand_names() if name not in GRIPPERS])
def test_joint_angles_point_the_thumb_of_a_built_in_hand(name):
    assert check_joint_map(load_hand(name)).verdict == "ok"


def test_a_map_that_points_the_thumb_elsewhere_fails():
    """The gains that are measured on LEAP's thumb, without the rows of its description."""
    leap = load_hand("leap_hand")
    found = check_joint_map(load_hand_spec(replace(leap.spec, joint_map=())))
    assert found.verdict == "failed"
    assert found.figures["thumb_deg"] > 60
    assert "[joint_map]" in found.advice


def test_a_palm_that_is_a_line():
    fingers = tuple(
        FingerSpec(f.name, (Point(ALLEGRO.palm, (0.0, 0.03 * i, 0.0)), *f.points[1:]))
        for i, f in enumerate(ALLEGRO.fingers)
    )
    found = basics(replace(ALLEGRO, fingers=fingers))
    assert found["palm frame"].verdict == "failed"
    assert "line" in found["palm frame"].advice


def test_knuckles_that_move_are_told():
    fingers = tuple(
        FingerSpec(f.name, (f.points[1], *f.points[1:])) if f.name == "ring" else f
        for f in ALLEGRO.fingers
    )
    found = basics(replace(ALLEGRO, fingers=fingers))
    assert found["palm frame"].verdict == "warning"
    assert found["palm frame"].figures["travel_mm"] > 20


def test_nothing_that_rests_on_a_fault_is_measured(tmp_path):
    found = check_hand(WRONG["degrees"][1](tmp_path), methods=("sbr",))
    assert found["round trip: sbr"].verdict == "skipped"
    assert "joint ranges" in found["round trip: sbr"].measured
    assert found["pinches"].verdict == "skipped"


def test_the_least_gap_of_surfaces_is_reported_for_each_finger():
    """Of a hand whose thumb can't reach its ring and little fingers."""
    hand = load_hand("inspire_hand")
    samples = Samples(hand)
    check = check_pinches(samples, hand.fingers)
    tips, surfaces = check.figures["tips_mm"], check.figures["surfaces_mm"]
    assert (surfaces["index"], surfaces["middle"]) == (0.0, 0.0)
    assert check.advice.startswith(
        "the thumb can't pinch with ring, pinky,"
    )  # the middle finger touches
    for name in ("ring", "pinky"):
        assert 5.0 < surfaces[name] < tips[name]
        assert f"{name} {surfaces[name]:.1f}" in check.measured
    # the thumb and the finger meet in a plane: a grid over their joints agrees
    joints = [j for j, n in enumerate(hand.actuated_names) if "thumb" in n or "pinky" in n]
    axes = (np.linspace(*hand.limits[j], 25) for j in joints)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(joints))
    q = np.tile(hand.neutral, (len(grid), 1))
    q[:, joints] = grid
    every = hand.full_configuration(q)
    wanted = np.tile([False, False, False, True], (len(every), 1))
    best = 1e3 * tip_surface_distances(hand, every, wanted)[:, 3].min()
    assert surfaces["pinky"] == pytest.approx(best, abs=1.0)


def test_distances_to_shapes():
    """A mesh of a cube is as far away as the same cube as a box; a sphere is round."""
    corners = " ".join(
        f"{x} {y} {z}" for x in (-0.01, 0.01) for y in (-0.02, 0.02) for z in (-0.03, 0.03)
    )
    text = f"""<mujoco><asset><mesh name="cube" vertex="{corners}"/></asset><worldbody>
      <body name="palm"><geom type="sphere" size="0.001" pos="1 0 0"/>
      <body name="a"><joint name="a" range="-1 1" axis="1 0 0"/>
        <geom type="SHAPE" pos="0 0 0.1" quat="0.8 0 0.6 0"/></body></body></worldbody></mujoco>"""
    points = np.random.default_rng(0).normal((0, 0, 0.1), 0.03, (40, 3))

    def distances(shape: str) -> np.ndarray:
        model = mujoco.MjModel.from_xml_string(text.replace('type="SHAPE"', shape))
        hand = SimpleNamespace(
            model=model,
            bodies=np.ones(model.nbody, bool),
            neutral=np.zeros(1),
            full_configuration=lambda q: q,
            qpos=lambda q: q,
        )
        body = model.body("a").id
        return np.array([part_distances(cast(Any, hand), body, p)[body] for p in points])

    box = distances('type="box" size="0.01 0.02 0.03"')
    assert (box < 0).any()
    np.testing.assert_allclose(distances('type="mesh" mesh="cube"'), box, atol=1e-7)
    ball = np.linalg.norm(points - (0, 0, 0.1), axis=1) - 0.02
    for sizes in ("0.02", "0.02 0.5 0.5"):  # a file may give sizes that a sphere does not use
        sphere = distances(f'type="sphere" size="{sizes}"')
        np.testing.assert_allclose(sphere, ball, atol=1e-12)


def test_reachable_poses_are_free_and_mean_no_pinch():
    hand = load_hand("leap_hand")
    q = reachable_poses(hand, 30, seed=3)
    np.testing.assert_array_equal(q, reachable_poses(hand, 30, seed=3))
    assert q.shape == (30, 16)
    assert (q >= hand.limits[:, 0]).all()
    assert (q <= hand.limits[:, 1]).all()
    depths = penetration_depths(hand, hand.full_configuration(q))
    assert depths.max() <= 1e-3
    tips = hand.tips(hand.full_configuration(q))
    assert np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1).min() >= 0.02
    assert (np.ptp(q, axis=0) > 0.5 * np.ptp(hand.limits, axis=1)).mean() > 0.9


def test_landmarks_that_a_robot_lacks_are_plausible():
    spec = load_hand("allegro_hand").spec
    fingers = [FingerSpec(f.name, (f.points[0], None, None, f.points[3])) for f in spec.fingers]
    hand = load_hand_spec(replace(spec, fingers=tuple(fingers)))
    (points,) = human_landmarks(hand, hand.neutral[None])
    assert np.isfinite(points).all()
    at = dict(zip(LANDMARKS, points, strict=True))
    np.testing.assert_allclose(
        at["index_pip"], at["index_mcp"] + (at["index_tip"] - at["index_mcp"]) / 3
    )
    # the little finger that it hasn't got is beyond the ring finger, seen from the index
    across = at["ring_mcp"] - at["index_mcp"]
    assert (at["pinky_mcp"] - at["ring_mcp"]) @ across > 0


def test_a_round_trip_tells_a_hand_that_never_moves():
    hand = load_hand("allegro_hand")
    positions = hand.full_configuration(hand.neutral)
    positions[0] = hand.joint_limits[0, 1] + 0.1

    def step(state: None, frame: np.ndarray) -> tuple[None, Result]:
        command = JointCommand(positions, hand.joint_names, 0.0)
        return None, Result(command, Status.INVALID_LANDMARKS, 0.0, 0.0, 1.0)

    idle = SimpleNamespace(hand=hand, init=lambda: None, step=step)
    trip = round_trip(cast(Retargeter, idle), poses=3, seed=1)
    assert trip.tip_error_mm.shape == (3, 4)
    true = hand.full_configuration(reachable_poses(hand, 3, 1))
    apart = hand.tips(true) - hand.tips(positions)
    np.testing.assert_allclose(trip.tip_error_mm, 1e3 * np.linalg.norm(apart, axis=-1))
    assert (trip.ok, trip.frozen, trip.limit_violations) == (0.0, 1.0, 3 * 35)
    assert trip.median == np.median(trip.tip_error_mm)
    with pytest.raises(ConfigError, match="one pose"):
        round_trip(cast(Retargeter, idle), poses=0, seed=1)


def test_the_default_method_is_judged_without_its_pull(monkeypatch):
    """The pull to the neutral pose is the method's taste, and no fault of the hand."""
    given: list[Any] = []

    def refuse(hand: Hand, *, config: Any, **_: Any) -> Retargeter:
        given.append(config)
        raise ConfigError("looked at")

    module = sys.modules["smooth_operator.hand_discovery.hand_validation"]
    monkeypatch.setattr(module, "Retargeter", refuse)
    check = check_method(load_hand("mimic_p050"), DEFAULT_METHOD, poses=1, seed=0)
    assert check.verdict == "skipped"
    config: Any = method_config(DEFAULT_METHOD)
    assert config.objective.pose_weight > 0.01
    free = replace(config, objective=replace(config.objective, pose_weight=1e-4))
    assert given == [free]


def test_the_command_prints_one_object(capfd):
    assert main(["hands", "check", "inspire_hand", "--quick", "--poses", "4", "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert (found["hand"], found["side"], found["ok"]) == ("inspire_hand", "right", True)
    checks = {check["name"]: check for check in found["checks"]}
    assert set(checks) == {*BASICS, "round trip: sbr", f"round trip: {DEFAULT_METHOD}"}
    usual = checks[f"round trip: {DEFAULT_METHOD}"]
    assert usual["verdict"] == "ok"
    assert (usual["figures"]["ok"], usual["figures"]["limit_violations"]) == (1.0, 0)
    trip = checks["round trip: sbr"]["figures"]
    assert trip["median_mm"] <= 3
    assert (trip["ok"], trip["limit_violations"], trip["frozen"]) == (1.0, 0, 0.0)


def test_a_method_that_has_no_model_is_no_failure():
    found = check_hand("inspire_hand", "left", methods=("joint_angle", "geort"), poses=2)
    assert found.side == "left"
    assert found["round trip: joint_angle"].verdict == "unjudged"
    assert "for information" in found["round trip: joint_angle"].advice
    assert found["round trip: geort"].verdict == "skipped"
    assert "train geort" in found["round trip: geort"].measured
    assert found.ok


def test_the_exit_status_says_how_it_went(tmp_path, capfd):
    wrong = tmp_path / "wrong.toml"
    write_hand_spec(WRONG["tip on the palm"][1](tmp_path), wrong)
    assert main(["hands", "check", str(wrong)]) == 1
    out = capfd.readouterr().out
    assert "1 check failed" in out
    assert "index tip is fixed to the palm" in out
    assert main(["hands", "check", "no_such_hand"]) == 2
    assert "no_such_hand" in capfd.readouterr().err


def test_a_scorecard_names_the_distribution_that_it_needs(monkeypatch, capfd):
    monkeypatch.setattr("smooth_operator.plugins._installed", lambda group: {})
    assert main(["hands", "check", "inspire_hand", "--scorecard"]) == 2
    assert "smooth-retargeting-research" in capfd.readouterr().err
    assert main(["hands", "check", "inspire_hand", "--out", "card.html"]) == 2
    assert "add --scorecard" in capfd.readouterr().err
