"""Hands drawn with their real meshes: from a file, or from MuJoCo Menagerie by its package."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from smooth_operator.cli import main
from smooth_operator.errors import HandModelError, MissingExtraError, install_command
from smooth_operator.formats.commands import write_commands
from smooth_operator.hand_files.menagerie import drawn_on, menagerie_file
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import MODELS, load_hand
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.pages.hand_view import HandView
from smooth_operator.teleop.pages.live.live_page import PageSetup
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.playback import Playback
from smooth_operator.teleop.pages.viser_server import close_server, open_server
from smooth_operator.types import CommandTrajectory, Side

HANDS: tuple[tuple[str, Side, str], ...] = (
    ("allegro_hand", "right", "wonik_allegro_hand"),
    ("allegro_hand", "left", "wonik_allegro_hand"),
    ("leap_hand", "right", "leap_hand"),
    ("shadow_dexee", "right", "shadow_dexee_hand"),
    ("shadow_hand", "right", "shadow_hand"),
    ("shadow_hand", "left", "shadow_hand"),
)
"""Hand, side, and its folder among the real ones; LEAP's left one has no meshes there."""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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
        ("<worldbody>", """<asset><mesh name="palm" file="palm.stl"/></asset><worldbody>
          <body name="base"><geom type="box" size="0.3 0.3 0.01"/>
          <body name="forearm" pos="0.1 0.2 0.6" quat="0.6 0 0.8 0">
          <joint name="elbow" axis="0 1 0" range="-1 1"/><geom type="sphere" size="0.2"/>"""),
        ("</worldbody>", "</body></body></worldbody>"),
        ('<body name="palm">', """<body name="palm"><joint name="wrist" axis="1 0 0" range="-1 1"/>
          <geom type="mesh" mesh="palm" pos="0 0 0.05"/>"""),
    ):  # fmt: skip
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "right_hand.xml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_hand_of_the_package_is_the_same_hand(root: Path) -> None:
    path = vendors(root / "shadow_hand")
    hand = load_hand("shadow_hand")
    assert menagerie_file(hand) == path
    there = drawn_on(hand, "menagerie")
    assert there.model.nmesh == 1
    assert there.model.njnt == len(hand.joint_names) + 2
    assert there.joint_names == hand.joint_names
    np.testing.assert_allclose(there.align_points, hand.align_points, atol=1e-6)
    drawn = HandView(there).meshes
    assert "forearm" not in {there.model.body(body).name for body in drawn}


@pytest.mark.shared
@pytest.mark.parametrize(("name", "side", "folder"), HANDS)
def test_every_published_hand_is_drawn_with_its_meshes(
    shared: Path, root: Path, name: str, side: Side, folder: str
) -> None:
    # the folders beside this checkout are Menagerie's, under names that may end in hand
    (root / folder).symlink_to(shared / "hands" / folder)
    (root / folder.removesuffix("_hand")).symlink_to(shared / "hands" / folder)
    hand = load_hand(name, side)
    there = drawn_on(hand, "menagerie")
    assert there.model.nmesh > 5
    assert there.joint_names == hand.joint_names
    assert len(HandView(there).meshes) >= len(hand.fingers)


def test_what_the_package_has_not_is_said(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(HandModelError, match=r"no model of the right hand 'mimic_p050', only of"):
        drawn_on(load_hand("mimic_p050"), "menagerie")
    with pytest.raises(HandModelError, match="no model of the left hand 'shadow_dexee'"):
        drawn_on(load_hand("shadow_dexee", "left"), "menagerie")
    with pytest.raises(HandModelError, match=r"can't be had.*MENAGERIE_ROOT"):
        drawn_on(load_hand("shadow_hand"), "menagerie")
    status = main(["hands", "show", "orca_v2", "--model", "menagerie", "--no-view"])
    assert status == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_without_the_package_one_line_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(MissingExtraError):
        drawn_on(load_hand("shadow_hand"), "menagerie")
    output = tmp_path / "s.png"
    arguments = ["hands", "render", "shadow_hand", "--model", "menagerie", "--output", str(output)]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert install_command("menagerie") in said
    assert said.count("\n") == 1
    assert not output.exists()


def run_of(hand: Hand, folder: Path) -> tuple[Path, Path, np.ndarray]:
    """Commands and the recording that they answer, as files, and the joint positions (T, n)."""
    recording = SyntheticOperator(seed=4).record(duration=0.2)
    rng = np.random.default_rng(0)
    low, high = hand.limits.T
    share = rng.uniform(0.3, 0.7, (len(recording), len(low)))
    positions = hand.full_configuration(low + share * (high - low))
    commands = CommandTrajectory(
        joint_positions=positions,
        joint_names=hand.joint_names,
        stamps=recording.stamps,
        latency_ms=np.full(len(recording), 1.0),
        status=np.zeros(len(recording), np.int8),
    )
    out, glove = folder / "out.npz", folder / "glove.npz"
    write_commands(out, commands, {"hand": hand.name})
    np.savez(glove, landmarks=recording.landmarks, timestamps=recording.stamps, side="right")
    return out, glove, positions


def test_a_run_plays_on_the_vendors_model(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    vendors(root / "shadow_hand")
    hand = load_hand("shadow_hand")
    out, glove, positions = run_of(hand, tmp_path)
    pages: list[Playback] = []
    monkeypatch.setattr("smooth_operator.cli.view.serve", lambda runs, **_: pages.extend(runs))
    for model in ([], ["--model", "menagerie"]):
        assert main(["view", str(out), str(glove), "--hand", hand.name, *model]) == 0
    plain, real = pages
    assert real.model.nmesh == 1
    assert real.model.nq == plain.model.nq + 2
    for column, name in enumerate(hand.joint_names):
        at = real.model.joint(name).qposadr[0]
        np.testing.assert_array_equal(real.qpos[:, at], positions[:, column])
    # tips, as the page marks them, are where the drawn model has them, wherever its palm is
    data = mujoco.MjData(real.model)
    tip = hand.spec.fingers[1].tip
    for frame in (0, 7):
        data.qpos[:] = real.qpos[frame]
        mujoco.mj_kinematics(real.model, data)
        body = data.body(tip.body)
        expected = body.xpos + body.xmat.reshape(3, 3) @ tip.offset
        np.testing.assert_allclose(real.robot_tips[frame, 1], expected, atol=1e-5)
    assert np.linalg.norm(real.robot_wrist - plain.robot_wrist) > 0.3
    assert real.bodies is not None
    assert not real.bodies[real.model.body("forearm").id]


def test_a_model_of_another_hand_is_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("it should not have come to this")

    monkeypatch.setattr("smooth_operator.cli.demo.execute_shown", never)
    output = tmp_path / "demo"
    arguments = ["--model", str(MODELS / "leap_hand_right.xml"), "--output", str(output)]
    assert main(["demo", "--no-view", "--duration", "0.5", *arguments]) == 2
    assert "lacks the joints" in capsys.readouterr().err
    assert not output.exists()


def test_teleop_draws_the_vendors_meshes_on_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The option reaches the page's process; the bodies are the vendor's, in the hand's pose."""
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

    hand = load_hand("shadow_hand")
    drawn = drawn_on(hand, path)
    server = open_server("127.0.0.1", 0)
    try:
        scene = LiveScene(server, {"right": hand}, simulated=False, drawn={"right": drawn})
        every = hand.full_configuration(np.random.default_rng(1).uniform(*hand.limits.T))
        scene.draw({"right": {"positions": every, "human": None, "latched": None}})
        robot = scene._sides["right"]._robot
        names = {drawn.model.body(body).name for body in robot.nodes}
        assert {"palm", "rh_ffdistal"} & names
        assert "forearm" not in names
        palm = robot.data.body(drawn.spec.palm)
        own = mujoco.MjData(hand.model)
        own.qpos[:] = hand.qpos(every)
        mujoco.mj_kinematics(hand.model, own)
        there = own.body(hand.spec.palm)
        for joint in hand.joint_names:
            body = int(hand.model.joint(joint).bodyid[0])
            mine = there.xmat.reshape(3, 3).T @ (own.xpos[body] - there.xpos)
            theirs = drawn.model.joint(joint).bodyid[0]
            shown = palm.xmat.reshape(3, 3).T @ (robot.data.xpos[theirs] - palm.xpos)
            np.testing.assert_allclose(shown, mine, atol=1e-6)
    finally:
        close_server(server)
