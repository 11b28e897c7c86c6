"""What the hands work on, on the live page: where it is, how one looks at it, and the pixels."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import trimesh
import viser
from browser_page import new_page, settled

from smooth_operator.hands.registry import load_hand
from smooth_operator.human.palm_axes import human_palm_axes
from smooth_operator.teleop.pages.hand_view import HandView, above
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.live.live_session import Scenery
from smooth_operator.teleop.pages.viser_server import close_server, open_server
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.types import Side

SIDES: tuple[Side, ...] = ("right", "left")


@pytest.fixture(scope="module")
def simulation() -> Iterator[Simulation]:
    made = Simulation(task="card")
    made.open({side: load_hand("mimic_p050", side) for side in SIDES}, {})
    yield made
    made.close()


@pytest.fixture(scope="module")
def page() -> Iterator[tuple[viser.ViserServer, LiveScene]]:
    server = open_server("127.0.0.1", 0)
    server.scene.configure_environment_map(None)
    scene = LiveScene(server, {"right": load_hand("mimic_p050")}, simulated=True)

    async def greet(client: viser.ClientHandle) -> None:
        scene.aiming.greet(client)

    server.on_client_connect(greet)
    yield server, scene
    close_server(server)


def looked(simulation: Simulation, sides: tuple[Side, ...] = SIDES, known: int = 0) -> Any:
    return json.loads(json.dumps(Scenery(simulation).look(sides, known)))  # as through the pipe


@pytest.mark.parametrize("task", ["card", "cube", "screwdriver"])
def test_the_object_is_where_the_physics_has_it(simulation: Simulation, task: str) -> None:
    simulation.change_task(task)
    seen = looked(simulation)
    for side in SIDES:
        scene = simulation.scene_of(side)
        position, turn = scene.mount.palm
        pose = np.array(seen["poses"][side])
        # at its start, or a hair's breadth below, where it lies
        np.testing.assert_allclose(turn @ pose[:3] + position, scene.start[0], atol=2e-3)
        parts = {part["name"]: part for part in seen["parts"][side]}
        assert any(part["moves"] for part in parts.values())
        for part in simulation.parts_of(side):
            if not part.moves:
                at = turn @ np.array(parts[part.name]["position"]) + position
                np.testing.assert_allclose(at, part.position, atol=1e-4)
        axes = np.array(seen["views"][side])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-4)
        assert np.linalg.det(axes) > 0.99
        up = turn.T @ (0.0, 0.0, 1.0)
        assert axes[1] @ up > 0.8  # the picture's up is the world's
        assert axes[2] @ up >= 0  # seen from above, if at all
    # a left hand is seen as a right hand's mirror image is: its thumb on the other side
    radial = {s: simulation.scene_of(s).mount.directions[:, 1] for s in SIDES}
    across = {
        s: np.array(seen["views"][s][0]) @ simulation.scene_of(s).mount.palm[1].T @ radial[s]
        for s in SIDES
    }
    assert across["left"] == pytest.approx(-across["right"], abs=1e-3)


def test_the_hands_turn_to_the_scene_and_back(
    simulation: Simulation, page: tuple[viser.ViserServer, LiveScene]
) -> None:
    server, scene = page
    view = scene._sides["right"]
    before, size = view._roots["robot"].wxyz.copy(), scene.aiming.half
    simulation.change_task("screwdriver")
    seen = looked(simulation, ("right",))
    scene.draw_scenery(seen)
    assert scene.scenery_number == seen["number"]
    assert view.scenery.there
    assert np.abs(view._roots["robot"].wxyz - before).max() > 0.1
    np.testing.assert_allclose(view._roots["human"].wxyz, view._roots["robot"].wxyz)
    assert not scene._floor.visible  # the scene has its own
    assert not view._roots["human"].visible  # the one that touches things is large
    wide = scene.aiming.half[0]
    scene.set_own(True)
    assert view._roots["human"].visible
    assert scene.aiming.half[0] > wide
    scene.set_own(False)
    simulation.put_away("right")
    while not (away := looked(simulation, ("right",), seen["number"]))["away"]:
        pass
    scene.draw_scenery(away)
    assert not view.scenery._object.visible  # type: ignore[union-attr]
    blade = np.array(seen["views"]["right"]) @ view.scenery.bounds(seen["poses"]["right"]).T
    assert (blade.min(axis=1) >= view.low - 1e-9).all()
    assert (blade.max(axis=1) <= view.high + 1e-9).all()
    assert scene.aiming.half != size
    # what is looked at is the hand that touches things, not what it was told
    hand = view._hand
    straight, bent = (
        hand.full_configuration(hand.limits[:, 0]),
        hand.full_configuration(hand.limits[:, 1]),
    )
    state = {"positions": straight, "simulated": bent, "human": None, "latched": ()}
    scene.draw({"right": state})
    np.testing.assert_allclose(view._robot.command.data.qpos, hand.qpos(bent))
    simulation.change_task("none")
    scene.draw_scenery(looked(simulation, ("right",), seen["number"]))
    assert not view.scenery.there
    assert scene._floor.visible
    assert view._roots["human"].visible
    np.testing.assert_allclose(view._roots["robot"].wxyz, before)
    np.testing.assert_allclose(scene.aiming.half, size)
    scene.draw({"right": state})
    np.testing.assert_allclose(view._robot.command.data.qpos, hand.qpos(straight))
    assert not [name for name in server.scene._handle_from_node_name if "part_" in name]


def test_lines_and_bodies_can_be_sent_one_after_the_other() -> None:
    """A slow browser shows lines a picture later than bodies, so they are sent earlier."""
    hand = load_hand("mimic_p050")
    server = open_server("127.0.0.1", 0)
    try:
        scene = LiveScene(server, {"right": hand}, simulated=False)
        view = scene._sides["right"]
        bent = hand.full_configuration(hand.limits[:, 1])
        hands: Any = {"right": {"positions": bent, "human": None, "latched": None}}
        before = view._robot.command.data.qpos.copy()
        scene.draw_lines(hands)
        np.testing.assert_allclose(view._balls.node.batched_positions, hand.tips(bent), atol=1e-6)
        np.testing.assert_array_equal(view._robot.command.data.qpos, before)
        scene.draw_bodies(hands)
        np.testing.assert_allclose(view._robot.command.data.qpos, hand.qpos(bent))
    finally:
        close_server(server)


def test_the_forearm_is_cut_off_and_the_picture_holds_the_label() -> None:
    """Mimic's model has a forearm 12 cm long; the page shows 3 cm of it."""
    hand = load_hand("mimic_p050")
    whole = HandView(hand)
    up = np.asarray(human_palm_axes(hand)[0]) / np.linalg.norm(human_palm_axes(hand)[0])

    def heights(meshes: dict[int, trimesh.Trimesh]) -> np.ndarray:
        poses = whole.bodies(hand.neutral)
        points = [m.vertices @ poses[b][0].T + poses[b][1] for b, m in meshes.items()]
        return np.asarray((np.concatenate(points) - hand.wrist) @ up)

    cut = whole.without_forearm(0.03, up)
    assert heights(whole.meshes).min() < -0.1
    assert heights(cut).min() == pytest.approx(-0.03, abs=1e-9)
    assert heights(cut).max() == heights(whole.meshes).max()
    assert set(cut) == set(whole.meshes)
    # nothing is lost above the plane, and nothing stays below it
    box = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    half = above(box, np.array([0.0, 0.0, 0.25]), np.array([0.0, 0.0, 1.0]))
    assert half is not None
    np.testing.assert_allclose(half.bounds, [[-1, -1, 0.25], [1, 1, 1]])
    assert half.area == pytest.approx(4 + 4 * 2 * 0.75)
    assert half.face_normals[:, 2].min() == pytest.approx(0.0)  # they still point outward
    assert above(box, np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 1.0])) is None
    assert above(box, np.array([0.0, 0.0, -2.0]), np.array([0.0, 0.0, 1.0])) is box


def test_the_card_is_seen(
    chromium: Any, simulation: Simulation, page: tuple[viser.ViserServer, LiveScene]
) -> None:
    server, scene = page
    simulation.change_task("card")
    scene.draw_scenery(looked(simulation, ("right",)))
    browser, problems = new_page(chromium, 900, 560)
    browser.goto(f"http://127.0.0.1:{server.get_port()}")

    def shown(picture: np.ndarray) -> bool:
        red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
        card = (red > 180) & (green < 0.75 * red) & (abs(green - blue) < 60)
        # see-through, on a background that is bluish
        table = (red > 110) & (green > 0.75 * red) & (blue < 0.97 * green) & (blue > 0.6 * green)
        return bool(card.sum() > 1000 and table.sum() > 4000)

    settled(browser, 900, 560, shown)
    browser.close()
    assert not [problem for problem in problems if "WebGL" not in problem]
