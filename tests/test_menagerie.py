"""Hands drawn with their real meshes: from a file, or from MuJoCo Menagerie by its package."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from smooth_operator import Retargeter, assemble_trace
from smooth_operator.cli import main
from smooth_operator.cli.hands_show import Show
from smooth_operator.cli.page import hand_to_draw
from smooth_operator.errors import HandModelError, MissingExtraError
from smooth_operator.extras import install_command
from smooth_operator.formats.commands import write_commands
from smooth_operator.hand_files.vendor_model import hand_with_meshes, has_meshes, menagerie_file
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.registry import MODELS, load_hand
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.pages.hand_page import HandPage
from smooth_operator.teleop.pages.hand_view import HandView, coarser
from smooth_operator.teleop.pages.live.live_page import PageSetup
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.player import Playback, Scene
from smooth_operator.teleop.pages.scene import RobotLooks
from smooth_operator.teleop.pages.viser_server import open_server
from smooth_operator.types import Side

HANDS: tuple[tuple[str, Side, str], ...] = (
    ("allegro_hand", "right", "wonik_allegro_hand"),
    ("allegro_hand", "left", "wonik_allegro_hand"),
    ("leap_hand", "right", "leap_hand"),
    ("shadow_dexee", "right", "shadow_dexee_hand"),
    ("shadow_hand", "right", "shadow_hand"),
    ("shadow_hand", "left", "shadow_hand"),
)
"""Hand, side, and its folder among the real ones; LEAP's left one has no meshes there."""
RIGHT_ONES = [
    pytest.param(*each, marks=pytest.mark.weekly if each[1] == "left" else ()) for each in HANDS
]
"""Right hands in each run of the tests; the weekly run has the left ones, too."""
LARGER = {"leap_hand": 0.02, "shadow_hand": 0.015}
"""How far the boxes of the last link's mesh and capsule may differ [m]: LEAP's carries a motor,
Shadow's begins beyond the joint."""


@pytest.fixture
def root(tmp_path, monkeypatch) -> Path:
    """A checkout of Menagerie that the package is to use; nothing is fetched."""
    pytest.importorskip("mujoco_menagerie", reason="the extra menagerie is not installed")
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "checkout"
    folder.mkdir()
    monkeypatch.setenv("MENAGERIE_ROOT", str(folder))
    return folder


def vendors(folder: Path) -> Path:
    """A Shadow Hand as a vendor may have it: on an arm, its palm a mesh."""
    (folder / "assets").mkdir(parents=True)
    trimesh.creation.box(extents=(0.08, 0.02, 0.09)).export(folder / "assets/palm.stl")
    text = (MODELS / "shadow_hand_right.xml").read_text(encoding="utf-8")
    for old, new in (
        ("<compiler ", '<compiler meshdir="assets" '),
        (
            "<worldbody>",
            """<asset><mesh name="palm" file="palm.stl"/></asset><worldbody>
          <body name="base"><geom type="box" size="0.3 0.3 0.01"/>
          <body name="forearm" pos="0.1 0.2 0.6" quat="0.6 0 0.8 0">
          <joint name="elbow" axis="0 1 0" range="-1 1"/><geom type="sphere" size="0.2"/>""",
        ),
        ("</worldbody>", "</body></body></worldbody>"),
        (
            '<body name="palm">',
            """<body name="palm"><joint name="wrist" axis="1 0 0" range="-1 1"/>
          <geom type="mesh" mesh="palm" pos="0 0 0.05"/>""",
        ),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "right_hand.xml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_hand_of_the_package_is_the_same_hand(root):
    path = vendors(root / "shadow_hand")
    hand = load_hand("shadow_hand")
    assert menagerie_file(hand) == path
    there = hand_with_meshes(hand, "menagerie")
    assert there.model.nmesh == 1
    assert there.model.njnt == hand.model.njnt + 2
    assert there.joint_names == hand.joint_names
    np.testing.assert_allclose(there.align_points, hand.align_points, atol=1e-6)
    drawn = HandView(there).meshes
    assert "forearm" not in {there.model.body(body).name for body in drawn}


def test_what_the_package_has_not_is_said(root, capsys):
    with pytest.raises(HandModelError, match=r"no model of the right hand 'mimic_p050', only of"):
        hand_with_meshes(load_hand("mimic_p050"), "menagerie")
    with pytest.raises(HandModelError, match="no model of the left hand 'shadow_dexee'"):
        hand_with_meshes(load_hand("shadow_dexee", "left"), "menagerie")
    with pytest.raises(HandModelError, match=r"can't be downloaded.*MENAGERIE_ROOT"):
        hand_with_meshes(load_hand("shadow_hand"), "menagerie")
    status = main(["hands", "show", "orca_v2", "--model", "menagerie", "--no-view"])
    assert status == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_without_the_package_one_line_says_how_to_install_it(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(MissingExtraError):
        hand_with_meshes(load_hand("shadow_hand"), "menagerie")
    output = tmp_path / "s.png"
    arguments = ["hands", "render", "shadow_hand", "--model", "menagerie", "--output", str(output)]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert install_command("menagerie") in said
    assert said.count("\n") == 1
    assert not output.exists()


def test_a_run_plays_on_the_vendors_model(root, tmp_path, monkeypatch):
    vendors(root / "shadow_hand")
    hand, recording = load_hand("shadow_hand"), SyntheticOperator(seed=4).record(duration=0.2)
    commands, _ = Retargeter(hand, method="joint_angle").run(recording)
    out, glove = tmp_path / "out.npz", tmp_path / "glove.npz"
    write_commands(out, commands, {"hand": hand.name})
    np.savez(glove, landmarks=recording.landmarks, timestamps=recording.stamps, side="right")
    pages: list[Playback] = []
    monkeypatch.setattr("smooth_operator.teleop.pages.serve", lambda runs, **_: pages.extend(runs))
    for model in (["--no-meshes"], ["--model", "menagerie"], []):
        assert main(["view", str(out), str(glove), "--hand", hand.name, *model]) == 0
    plain, real, here = (page.drawn for page in pages)
    assert plain is None
    assert here.model.nq == real.model.nq == hand.model.nq + 2
    assert real.model.nmesh == 1
    np.testing.assert_array_equal(pages[1].trace.joint_positions, commands.joint_positions)


def test_a_model_of_another_hand_is_refused_before_any_work(tmp_path, capsys, monkeypatch):
    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("it should not have come to this")

    monkeypatch.setattr("smooth_operator.cli.session.execute_shown", never)
    output = tmp_path / "demo"
    arguments = ["--model", str(MODELS / "leap_hand_right.xml"), "--output", str(output)]
    assert main(["demo", "--no-view", "--duration", "0.5", *arguments]) == 2
    assert "lacks the joints" in capsys.readouterr().err
    assert not output.exists()


def test_teleop_draws_the_vendors_meshes_on_its_page(tmp_path, monkeypatch, capsys):
    """The option reaches the page's process."""
    path = vendors(tmp_path / "vendor")
    setups: list[PageSetup] = []

    class Shown(Exception):
        """Enough is known."""

    def page(setup: PageSetup) -> None:
        setups.append(setup)
        raise Shown

    monkeypatch.setattr("smooth_operator.teleop.pages.live.live_page.LivePage", page)
    given = ["teleop", "--hand", "shadow_hand", "--method", "joint_angle", "--no-browser"]
    with pytest.raises(Shown):
        main([*given, "--model", str(path)])
    assert setups[0].model == str(path)
    other = MODELS / "leap_hand_right.xml"
    assert main([*given, "--model", str(other)]) == 2  # before a page opens
    assert "lacks the joints" in capsys.readouterr().err


@pytest.mark.shared
@pytest.mark.parametrize(("name", "side", "folder"), RIGHT_ONES)
def test_meshes_lie_where_the_simple_shapes_do(shared, root, name, side, folder):
    """In a pose: a fingertip is on its mesh, and each finger's shapes have about its box."""
    # the folders beside this checkout are Menagerie's, under names that may end in hand
    (root / folder).symlink_to(shared / "hands" / folder)
    (root / folder.removesuffix("_hand")).symlink_to(shared / "hands" / folder)
    hand = load_hand(name, side)
    there = hand_with_meshes(hand, "menagerie")
    assert there.joint_names == hand.joint_names
    simple, real = HandView(hand), HandView(there)
    low, high = hand.limits.T
    q = low + np.random.default_rng(2).uniform(0.2, 0.8, len(low)) * (high - low)
    links = []
    for view in (simple, real):
        order = [hand.actuated_names.index(joint) for joint in view.hand.actuated_names]
        poses, model, ends = view.bodies(q[order]), view.hand.model, {}
        for body, mesh in view.meshes.items():
            turn, at = poses[body]
            part = ends.setdefault(model.body_weldid[body], [])
            part.append(mesh.vertices @ turn.T + at)
        last = [model.body_weldid[model.body(f.tip.body).id] for f in view.hand.spec.fingers]
        links.append([np.concatenate(ends[body]) for body in last])
        assert (view.finger_of_body[last] == np.arange(len(last))).all()
    tips = hand.tips(hand.full_configuration(q))
    for tip, ours, theirs in zip(tips, *links, strict=True):
        assert np.linalg.norm(theirs - tip, axis=1).min() < 0.006
        for end in (np.min, np.max):
            assert np.abs(end(ours, 0) - end(theirs, 0)).max() < LARGER.get(name, 0.008)


def check_places(robot: RobotLooks, hand: Hand, there: Hand) -> None:
    """Each link is drawn in the same place with meshes and with simple shapes."""
    meshes, simple = (look.first.nodes for look in robot._looks)
    links = [
        (hand.model.joint(j).bodyid[0], there.model.joint(j).bodyid[0]) for j in hand.joint_names
    ]
    drawn = [(simple[a], meshes[b]) for a, b in links if a in simple and b in meshes]
    assert len(drawn) > 10
    for mine, theirs in drawn:
        np.testing.assert_allclose(mine.batched_positions, theirs.batched_positions, atol=1e-5)
    assert np.ptp([mine.batched_positions for mine, _ in drawn], axis=0).max() > 0.05


def test_the_player_and_the_live_scene_place_meshes_as_simple_shapes(root):
    vendors(root / "shadow_hand")
    hand, recording = load_hand("shadow_hand"), SyntheticOperator(seed=4).record(duration=0.2)
    there = hand_with_meshes(hand)
    commands, _ = Retargeter(hand, method="joint_angle").run(recording)
    trace = assemble_trace(recording, commands, hand, reach_samples=0)
    state = {"positions": commands.joint_positions[3], "human": None, "latched": None}
    server = open_server("127.0.0.1", 0)
    try:
        player = Scene(server, [Playback("t", hand, trace, there)])
        live = LiveScene(server, {"right": hand}, simulated=False)
        live.add_meshes({"right": HandView(there)})
        player.draw(3)
        live.draw({"right": state})
        for robot in (player.robots[0], live._sides["right"].robot):
            robot.show(meshes=False)
            robot.show(meshes=True)
            check_places(robot, hand, there)
            np.testing.assert_allclose(robot.shown.tips, trace.robot_tips[3], atol=1e-5)
    finally:
        server.stop()


def test_meshes_are_drawn_where_they_are_here_and_can_be_switched(root):
    hand = load_hand("shadow_hand")
    assert hand_with_meshes(hand) is None  # neither fetched nor in the checkout
    vendors(root / "shadow_hand")
    there = hand_with_meshes(hand)
    assert has_meshes(there)
    assert hand_with_meshes(there) is there
    assert hand_with_meshes(load_hand("mimic_p050")) is None
    with HandPage(hand, drawn=there, port=0) as page:
        meshes, simple = page._robot._looks

        def shown() -> tuple[bool, bool]:
            a, b = ({n.visible for n in look.first.nodes.values()} for look in (meshes, simple))
            assert len(a) == len(b) == 1
            return a.pop(), b.pop()

        assert shown() == (True, False)
        page._show(meshes=False)
        assert shown() == (False, True)
        page._show(meshes=True)
        page.set_joint(2, 0.3)
        model = page._drawn[0].hand.model
        palm = next(b for b in meshes.first.nodes if model.body(b).name == "palm")
        np.testing.assert_allclose(meshes.first.nodes[palm].batched_positions, 0, atol=1e-7)
    server = open_server("127.0.0.1", 0)
    try:
        scene = LiveScene(server, {"right": hand}, simulated=True)
        robot = scene._sides["right"].robot
        before = robot.shown
        scene.add_meshes({"right": HandView(there)})
        real = robot.shown
        assert real is not before
        assert {n.visible for n in before.first.nodes.values()} == {False}
        scene.set_meshes(visible=False)
        assert robot.shown is before
        assert {n.visible for n in real.first.nodes.values()} == {False}
        assert {n.visible for n in before.first.nodes.values()} == {True}
    finally:
        server.stop()


def test_damaged_meshes_leave_the_simple_shapes(root, capsys):
    """One sentence where nobody asked for them, an error where somebody did."""
    path = vendors(root / "shadow_hand")
    text = path.read_text(encoding="utf-8")
    hand, options = load_hand("shadow_hand"), Show(hand="shadow_hand")
    for broken in (text.replace("<worldbody>", "<worldbod>"), text.replace("rh_FFJ4", "FFJ4")):
        path.write_text(broken, encoding="utf-8")
        assert hand_to_draw(hand, options) is None
        said = capsys.readouterr().err
        assert said.startswith("the meshes can't be drawn, so simple shapes are shown: ")
        assert said.count("\n") == 1
        with pytest.raises(HandModelError):
            hand_to_draw(hand, replace(options, model=path))
    path.write_text(text, encoding="utf-8")
    assert hand_to_draw(hand, options) is not None
    assert hand_to_draw(hand, replace(options, no_meshes=True)) is None


def test_large_meshes_are_made_coarser():
    fine = trimesh.creation.icosphere(subdivisions=6, radius=0.02)
    coarse = coarser(fine, 3000)
    assert 1000 < len(coarse.faces) <= 3000 < len(fine.faces)
    distance = np.linalg.norm(coarse.vertices, axis=1)
    assert np.abs(distance - 0.02).max() < 0.0003
    assert abs(coarse.area / fine.area - 1) < 0.02
    assert coarser(fine, len(fine.faces)) is fine


def test_a_hand_of_meshes_alone_has_simple_shapes(root):
    """As a user's own, which has no other shapes: its capsules are drawn."""
    there = load_hand_spec(hand_with_meshes(load_hand("shadow_hand"), vendors(root / "v")).spec)
    simple = HandView(there, simple=True).meshes
    assert set(HandView(there).finger_of_body[list(simple)]) == {-1, 0, 1, 2, 3, 4}
    palm = simple[there.model.body("palm").id]
    assert palm.extents.max() < 0.13
