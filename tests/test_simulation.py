"""Simulated hands: they follow, they stop where they should, and they do not come apart."""

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
import viser
from browser_page import new_page, settled
from live_time import until
from ticks import make_tick

from smooth_operator.errors import SinkError, UnknownNameError
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.palm import human_palm_axes
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.teleop.pages.hand_view import HandView
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.live.live_session import task_scenes
from smooth_operator.teleop.pages.viser_server import open_server
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.types import Side

pytestmark = pytest.mark.usefixtures("elsewhere")

BUILT_IN = [
    "mimic_p050",
    "shadow_hand",
    "allegro_hand",
    "leap_hand",
    "wuji_hand",
    "shadow_dexee",
    "orca_v2",
    "ability_hand",
    "inspire_hand",
    "schunk_svh",
]


@pytest.mark.parametrize(
    "name",
    [
        *("mimic_p050", "inspire_hand", "leap_hand"),
        *(pytest.param(name, marks=pytest.mark.weekly) for name in BUILT_IN),
    ],
)
def test_follows_a_sine(name):
    """1 Hz, up to 0.3 rad, joint by joint where it touches nothing; left and right in turn."""
    hand = load_hand(name, "left" if BUILT_IN.index(name) % 2 else "right")
    physics = HandPhysics(hand)
    low, high = hand.limits.T
    amplitude = np.minimum(0.3, (high - low) / 4)
    centre = np.clip(hand.neutral, low + amplitude, high - amplitude)
    free = 0
    for joint in range(len(hand.actuated)):
        pose = hand.neutral.copy()
        pose[joint] = centre[joint]
        physics.command(hand.full_configuration(pose))
        physics.advance(0.3)
        worst, touched = 0.0, False
        for k in range(110):
            pose[joint] = centre[joint] + amplitude[joint] * np.sin(2 * np.pi * 0.01 * k)
            target = hand.full_configuration(pose)
            physics.command(target)
            assert physics.advance(0.01)
            touched |= physics.contacts > 0
            if k > 10:
                worst = max(worst, float(np.abs(physics.positions - target).max()))
        if not touched:
            free += 1
            assert np.degrees(worst) < 2.0, hand.actuated_names[joint]
    assert free >= 0.5 * len(hand.actuated)


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("mimic_p050", 20),
        ("inspire_hand", 20),
        *(pytest.param(name, 60, marks=pytest.mark.weekly) for name in BUILT_IN),
    ],
)
def test_random_commands(name, seconds):
    """Twelve jumps a second to anywhere, fingers through fingers: it stays whole and in bounds."""
    hand = load_hand(name, "right" if BUILT_IN.index(name) % 2 else "left")
    physics = HandPhysics(hand)
    rng = np.random.default_rng(0)
    low, high = hand.joint_limits.T
    outside, fastest = 0.0, 0.0
    for _ in range(12 * seconds):
        physics.command(hand.full_configuration(rng.uniform(hand.limits[:, 0], hand.limits[:, 1])))
        physics.advance(1 / 12)
        q = physics.positions
        outside = max(outside, float(np.maximum(q - high, low - q).max()))
        fastest = max(fastest, float(np.abs(physics.velocities).max()))
    assert physics.time == pytest.approx(seconds, abs=0.01)
    assert physics.resets == 0
    assert np.degrees(outside) < 15.0
    assert fastest < 100.0


def test_fingers_stop_at_fingers():
    """A thumb that is sent through the fist stays outside; without contacts it would arrive."""
    hand = load_hand("mimic_p050")
    physics = HandPhysics(hand)
    fist = hand.limits[:, 1].copy()
    thumb = [i for i, n in enumerate(hand.actuated_names) if n.startswith("thumb")]
    fist[thumb] = hand.neutral[thumb]
    physics.command(hand.full_configuration(fist))
    physics.advance(1.0)
    closed = fist.copy()
    closed[thumb] = hand.limits[thumb].max(axis=1)
    physics.command(hand.full_configuration(closed))
    physics.advance(1.0)
    assert physics.contacts > 0
    assert np.degrees(np.abs(physics.positions - hand.full_configuration(closed)).max()) > 5.0


def test_motors_give_what_their_makers_state():
    assert np.all(load_hand("leap_hand").torques == 0.28)
    shadow = load_hand("shadow_hand")
    torques = dict(zip(shadow.actuated_names, shadow.torques, strict=True))
    assert (torques["rh_THJ5"], torques["rh_FFJ3"]) == (5.0, 2.0)
    mimic = load_hand("mimic_p050")
    assert np.isnan(mimic.torques).all()
    weak = load_hand_spec(replace(mimic.spec, torque={"index_mcp2pp": 0.01}))
    with pytest.raises(UnknownNameError, match="elbow"):
        load_hand_spec(replace(mimic.spec, torque={"elbow": 1.0}))
    joint = mimic.actuated_names.index("index_mcp2pp")
    turned = []
    for hand in (mimic, weak):
        physics = HandPhysics(hand)
        start = physics.positions[list(hand.actuated)][joint]
        pose = hand.neutral.copy()
        pose[joint] = hand.limits[joint, 1]
        physics.command(hand.full_configuration(pose))
        physics.advance(0.04)
        turned.append(physics.positions[list(hand.actuated)][joint] - start)
    # 0.01 N m turns a rotor of 5e-4 kg m^2 by at most 16 mrad in 40 ms
    assert turned[0] > 0.1
    assert 0.0 < turned[1] < 0.5 * (0.01 / 5e-4) * 0.04**2


def test_critically_damped_and_back_at_rest():
    hand = load_hand("allegro_hand")
    physics = HandPhysics(hand)
    start = hand.neutral
    step = start.copy()
    step[1] += 0.4
    physics.command(hand.full_configuration(step))
    path = []
    for _ in range(200):
        physics.advance(0.002)
        path.append(physics.positions[hand.actuated[1]])
    assert max(path) < step[1] + 0.02  # no overshoot to speak of
    assert path[-1] == pytest.approx(step[1], abs=0.005)
    reached = next(i for i, q in enumerate(path) if q > start[1] + 0.9 * 0.4)
    assert 0.02 < reached * 0.002 < 0.1


@pytest.mark.parametrize("gravity", [False, True])
def test_gravity_bends_it_a_little(gravity):
    hand = load_hand("leap_hand")
    physics = HandPhysics(hand, gravity=gravity)
    physics.advance(2.0)
    sag = np.degrees(np.abs(physics.positions - hand.full_configuration(hand.neutral)).max())
    assert (0.02 < sag < 3.0) if gravity else sag < 0.01


def test_bad_commands_change_nothing_and_hold_stands():
    hand = load_hand("mimic_p050")
    physics = HandPhysics(hand)
    physics.advance(0.5)
    before = physics.positions
    physics.command(np.full(len(hand.joint_names), np.nan))
    physics.advance(0.5)
    np.testing.assert_allclose(physics.positions, before, atol=1e-3)
    physics.command(np.full(len(hand.joint_names), 99.0))  # as far as the limits go
    physics.advance(0.05)
    physics.hold()
    at = physics.positions
    physics.advance(1.0)
    assert np.degrees(np.abs(physics.positions - at).max()) < 25.0
    assert (physics.positions <= hand.joint_limits[:, 1] + 0.05).all()


def test_physics_that_comes_apart_is_set_back():
    hand = load_hand("mimic_p050")
    physics = HandPhysics(hand)
    physics._data.qvel[:] = 1e5
    assert physics.advance(0.01) is False
    assert physics.resets == 1
    assert physics.advance(0.1) is True
    np.testing.assert_allclose(physics.positions, hand.full_configuration(hand.neutral), atol=0.01)
    physics._data.qpos[:] = np.nan
    assert physics.advance(0.01) is False
    assert physics.advance(0.1) is True
    assert np.isfinite(physics.positions).all()


def test_an_arm_is_taken_out(tmp_path):
    bare = load_hand("mimic_p050")
    palm = mujoco.MjSpec.from_file(str(bare.spec.model))
    body = palm.worldbody.first_body()
    shoulder = body.add_joint()
    shoulder.name, shoulder.axis = "shoulder", (0, 0, 1)
    palm.compile()
    (tmp_path / "arm.xml").write_text(palm.to_xml())
    hand = load_hand_spec(replace(bare.spec, model=tmp_path / "arm.xml"))
    physics = HandPhysics(hand, gravity=True)
    assert physics._built.model.nv == len(hand.joint_names)
    physics.advance(1.0)
    assert np.isfinite(physics.positions).all()


@pytest.mark.shared
@pytest.mark.parametrize(
    "file",
    [
        "hands/orca_v2_hand/right_hand_kinematics_only.xml",
        "hands/shadow_hand/right_hand.xml",
        "hands_urdf/leap_hand/leap_hand_right.urdf",
        "hands_urdf/schunk_hand/schunk_svh_hand_left.urdf",
    ],
)
def test_vendors_models_stay_whole(shared, file):
    """With their own defaults, actuators, tendons, meshes that are there or missing."""
    found = next(iter(shared.glob(file)), None)
    if found is None:
        pytest.skip(f"no {file}")
    hand = load_hand_spec(discover(found).spec)
    physics = HandPhysics(hand)
    rng = np.random.default_rng(0)
    for _ in range(30):
        physics.command(hand.full_configuration(rng.uniform(hand.limits[:, 0], hand.limits[:, 1])))
        assert physics.advance(0.1)
    pose = hand.neutral + 0.1 * (hand.limits.mean(axis=1) - hand.neutral)
    fresh = HandPhysics(hand)
    fresh.command(hand.full_configuration(pose))
    fresh.advance(1.0)
    assert np.degrees(np.median(np.abs(fresh.positions - hand.full_configuration(pose)))) < 1.0


def test_sink_follows_in_real_time_and_holds_when_commands_stop():
    hands: dict[Side, Hand] = {s: load_hand("mimic_p050", s) for s in ("right", "left")}
    sim = Simulation()
    assert sim.state("right") is None
    with pytest.raises(SinkError, match="not open"):
        sim.send(make_tick(hands["right"]))
    sim.open(hands, {})
    cpu, start = time.process_time(), time.perf_counter()
    for i in range(100):
        for hand in hands.values():
            sim.send(make_tick(hand, i // 4))
        time.sleep(0.01)
    last = make_tick(hands["left"], 24)
    time.sleep(0.3)

    def arrived() -> bool:
        """In real time: the hand is where it was sent, and its state is a present one."""
        state = sim.state("left")
        assert state.time <= time.perf_counter()
        age = time.perf_counter() - state.time
        off = np.degrees(np.abs(state.positions - last.command.joint_positions).max())
        return bool(off < 10.0 and age < 0.2)

    until(arrived)
    busy = (time.process_time() - cpu) / (time.perf_counter() - start)
    assert busy < 0.25 + 0.2  # both hands, and this test's own share
    sim.close()
    sim.close()
    assert sim.state("left") is None
    assert sim.note == ""


def test_sink_holds_where_the_hand_is_when_the_loop_stalls():
    hand = load_hand("mimic_p050", "left")
    sim = Simulation(bandwidth=0.5)  # a slow hand is still on its way on a busy machine, too
    sim.open({"left": hand}, {})
    far = make_tick(hand, 60)
    sim.send(far)
    for k in range(5):
        sim.stalled(0.2 + 0.05 * k)
        time.sleep(0.05)

    def halted() -> bool:
        before = sim.state("left").positions
        time.sleep(0.1)
        return bool(np.abs(sim.state("left").positions - before).max() < 1e-3)

    until(halted)
    off = np.abs(sim.state("left").positions - far.command.joint_positions)
    sim.close()
    assert np.degrees(off.max()) > 10.0


def test_sink_tells_of_physics_that_came_apart():
    hand = load_hand("mimic_p050")
    sim = Simulation()
    sim.open({"right": hand}, {})
    sim._world.physics["right"]._data.qvel[:] = 1e5
    until(lambda: sim.note)
    assert "became unstable" in sim.note
    sim.send(make_tick(hand, 3))
    state = sim.state("right")
    assert np.isfinite(state.positions).all()
    sim.close()


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
    server.stop()


def looked(simulation: Simulation, sides: tuple[Side, ...] = SIDES, known: int = 0) -> Any:
    return json.loads(json.dumps(task_scenes(simulation, sides, known)))  # as through the pipe


@pytest.mark.parametrize("task", ["card", "cube", "screwdriver"])
def test_the_object_is_where_the_physics_has_it(simulation, task):
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


def test_the_hands_turn_to_the_scene_and_back(simulation, page):
    server, scene = page
    view = scene._sides["right"]
    before, size = view.row.roots["robot"].wxyz.copy(), scene.aiming.half
    simulation.change_task("screwdriver")
    seen = looked(simulation, ("right",))
    scene.draw_scenery(seen)
    assert scene.scenery_number == seen["number"]
    assert view.scenery.there
    assert np.abs(view.row.roots["robot"].wxyz - before).max() > 0.1
    np.testing.assert_allclose(view.row.roots["human"].wxyz, view.row.roots["robot"].wxyz)
    assert not scene._floor.visible  # the scene has its own
    assert not view.row.roots["human"].visible  # the one that touches things is large
    wide = scene.aiming.half[0]
    scene.set_own(True)
    assert view.row.roots["human"].visible
    assert scene.aiming.half[0] > wide
    scene.set_own(False)
    simulation.put_away("right")
    while not (away := looked(simulation, ("right",), seen["number"]))["away"]:
        pass
    scene.draw_scenery(away)
    assert not any(node.visible for node, _, moves in view.scenery._parts if moves)
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
    np.testing.assert_allclose(view.robot.shown.first.data.qpos, hand.qpos(bent))
    simulation.change_task("none")
    scene.draw_scenery(looked(simulation, ("right",), seen["number"]))
    assert not view.scenery.there
    assert scene._floor.visible
    assert view.row.roots["human"].visible
    np.testing.assert_allclose(view.row.roots["robot"].wxyz, before)
    np.testing.assert_allclose(scene.aiming.half, size)
    scene.draw({"right": state})
    np.testing.assert_allclose(view.robot.shown.first.data.qpos, hand.qpos(straight))
    assert not [name for name in server.scene._handle_from_node_name if "part_" in name]


def test_all_that_moves_is_sent_as_one_kind_of_change(simulation, page):
    """A browser has the poses of nodes a picture before all else, so none of a node changes."""
    server, scene = page
    hand = load_hand("mimic_p050")
    simulation.change_task("card")
    seen = looked(simulation, ("right",))
    scene.draw_scenery(seen)
    every = server.scene._handle_from_node_name.items()
    nodes = [handle for name, handle in every if name.startswith("/live/right/")]

    def drawn(bend: float, lift: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
        every = hand.full_configuration(hand.neutral + bend)
        human = np.random.default_rng(0).normal(size=63) + bend
        state = {"positions": every, "simulated": every, "human": human, "latched": ()}
        scene.draw({"right": state})
        pose = list(seen["poses"]["right"])
        pose[2] += lift
        scene.draw_scenery({"number": seen["number"], "poses": {"right": pose}, "fixtures": {}})
        batched = [np.copy(n.batched_positions) for n in nodes if hasattr(n, "batched_positions")]
        return [np.concatenate([n.position, n.wxyz]) for n in nodes], batched

    (poses, before), (still, after) = drawn(0.0, 0.0), drawn(0.1, 0.02)
    np.testing.assert_array_equal(poses, still)
    moved = [not np.array_equal(*pair) for pair in zip(before, after, strict=True)]
    assert sum(moved) > len(hand.actuated)
    simulation.change_task("none")


def test_the_places_of_the_fingertips_are_marked():
    """A method with places shows them, each with a line from the robot's tip; others show none."""
    hand = load_hand("mimic_p050")
    server = open_server("127.0.0.1", 0)
    try:
        scene = LiveScene(server, {"right": hand}, simulated=False)
        marks = scene._sides["right"].targets
        bent = hand.full_configuration(hand.limits[:, 1])
        state: dict[str, Any] = {"positions": bent, "human": None, "latched": None}
        scene.draw({"right": state})
        assert not np.any(marks._balls.batched_scales)
        places = hand.tips(bent) + np.array([0.0, 0.01, 0.0])
        scene.draw({"right": state | {"targets": places.ravel().tolist()}})
        np.testing.assert_allclose(marks._balls.batched_positions, places, atol=1e-6)
        assert np.all(marks._balls.batched_scales)
        np.testing.assert_allclose(marks._lines.points[:, 1], places, atol=1e-6)
        scene.set_keyvectors(False)
        assert not marks._balls.visible
    finally:
        server.stop()


def test_the_forearm_is_cut_off_and_the_picture_holds_the_label():
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


def test_the_card_is_seen(chromium, simulation, page):
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
