"""The wrist on the page and at the keys: maps, a line of text, release and engage."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser
from ticks import make_tick

from smooth_operator import Retargeter, load_hand
from smooth_operator.errors import ConfigError
from smooth_operator.human.palm_axes import FLAT_HAND
from smooth_operator.planning import make_request
from smooth_operator.teleop.control.keyboard import actions
from smooth_operator.teleop.control.rpc_handlers import RpcHandlers
from smooth_operator.teleop.pages.live import live_texts
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.live.live_session import LiveSession
from smooth_operator.teleop.pages.viser_server import close_server, open_server
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.teleop.sinks.tick import WristCommand
from smooth_operator.teleop.sources.live import Arrival, SourceHealth
from smooth_operator.types import HandFrame

SEEN = {
    "operator": [0.1, 0.2, 1.0, 1.0, 0.0, 0.0, 0.0],
    "world": "webxr/local-floor",
    "target": [0.4, 0.0, 3.0, 0.0, 1.0, 0.0, 0.0],
    "base": "base",
    "engaged": True,
    "released": False,
}


@pytest.fixture(scope="module")
def loop() -> TeleopLoop:
    asked = make_request(method="joint_angle")
    retargeter = Retargeter(load_hand("mimic_p050"), config=asked.config)
    source: Any = SimpleNamespace(label="none", health=lambda: SourceHealth("waiting"))
    config = LoopConfig()
    return TeleopLoop({"right": HandPipeline(retargeter, config)}, source, SinkRunner(), config)


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    made = open_server("127.0.0.1", 0)
    yield made
    close_server(made)


def test_a_line_says_what_the_arm_does_and_how_near_it_is_to_something() -> None:
    def shown(**arm: Any) -> str:
        hand = {"mode": "tracking", "latched": None, "wrist": None, "arm": arm}
        return live_texts.modes({"right": hand})

    assert "arm: follows<" in shown(state="following", position_error=0.002, clearance=0.2)
    braking = shown(state="braking", position_error=0.041, clearance=0.021)
    assert "brakes, too near to something, the wrist is 41 mm off, 21 mm from touching" in braking
    still = shown(state="holding", position_error=float("nan"), clearance=float("inf"))
    assert "arm: holds<" in still
    assert "data-arm" not in live_texts.modes(
        {"right": {"mode": "tracking", "latched": None, "wrist": None, "arm": None}}
    )


def test_a_line_says_whether_there_is_a_wrist_and_what_it_does() -> None:
    def line(**wrist: Any) -> str:
        hand = {"mode": "tracking", "latched": None, "wrist": {**SEEN, **wrist}}
        return live_texts.modes({"right": hand})

    assert "wrist in webxr/local-floor: moves the robot" in line()
    assert "released (C)" in line(engaged=False, released=True)
    assert "lost" in line(engaged=False, operator=None)
    assert "is held" in line(engaged=False)
    assert "&lt;b&gt;" in line(world="<b>")
    none = live_texts.modes({"right": {"mode": "tracking", "latched": None, "wrist": None}})
    assert "wrist: not tracked" in none


def test_the_maps_come_with_the_wrist_and_go_with_it(server: viser.ViserServer) -> None:
    hand = load_hand("mimic_p050")
    scene = LiveScene(server, {"right": hand}, simulated=False)
    state: dict[str, Any] = {
        "positions": hand.full_configuration(hand.neutral), "human": None, "latched": None
    }  # fmt: skip
    view = scene._sides["right"]
    maps = view.wrists
    half = scene.aiming.half
    scene.draw({"right": state})
    assert not maps._human._root.visible
    assert scene.aiming.half == half
    scene.draw({"right": {**state, "wrist": SEEN}})
    assert maps._human._root.visible
    assert maps._robot._root.visible
    assert scene.aiming.half[1] == pytest.approx(half[1] + maps.height / 2)
    assert maps._human._label.text == "wrist in webxr/local-floor"
    # drawn to scale, and at the edge of the map where it is farther away
    human, robot = maps._human._wrist.position, maps._robot._wrist.position
    assert np.asarray(human)[2] / np.asarray(human)[0] == pytest.approx(10.0)
    assert robot[2] == pytest.approx(human[2])
    np.testing.assert_array_equal(maps._robot._wrist.wxyz, [0, 1, 0, 0])
    # x goes away from the viewer (y of the scene), z up, seen from above
    turn = viser.transforms.SO3(maps._human._room.wxyz)
    assert (turn.apply(np.array([1.0, 0, 0]))[1:] > 0.6).all()
    assert turn.apply(np.array([0.0, 1, 0]))[0] == pytest.approx(-1.0)
    scene.draw({"right": {**state, "wrist": {**SEEN, "operator": None}}})
    assert not maps._human._wrist.visible
    assert maps._human._root.visible
    scene.draw({"right": {**state, "wrist": None}})
    assert not maps._human._root.visible
    assert scene.aiming.half == half


def test_the_page_is_told_both_wrists(loop: TeleopLoop) -> None:
    session = LiveSession(loop, make_request(method="joint_angle"))
    (pipeline,) = loop.pipelines.values()
    target = WristCommand(np.array(SEEN["target"]), True, True)
    for k, pose in enumerate((None, SEEN["operator"], np.full(7, np.nan))):
        frame = HandFrame(FLAT_HAND, float(k), T_world_wrist=pose, world="room")
        pipeline.seen = Arrival(frame, loop.mailbox.clock())
        tick = make_tick(pipeline.retargeter.hand, k)
        session.watch(replace(tick, wrist=None if pose is None else target))
        seen = json.loads(json.dumps(session.look(text=False, fields=0)))
        wrist = seen["hands"]["right"]["wrist"]
        if pose is None:
            assert wrist is None
        else:
            assert wrist["world"] == "room"
            assert wrist["base"] == "base"
            assert wrist["target"] == SEEN["target"]
            assert wrist["operator"] == (SEEN["operator"] if k == 1 else None)
    session.close()


def test_a_key_and_a_message_release_the_wrist_alone(loop: TeleopLoop) -> None:
    said: list[str] = []
    (pipeline,) = loop.pipelines.values()
    press = actions(loop, said.append)["c"]
    for released in (True, False):
        press()
        loop._change()
        assert pipeline.clutch.released is released
        assert not pipeline.supervisor.paused
    assert said == ["wrist released; c engages it, the fingers go on", "wrist: engages"]
    do = RpcHandlers(loop, SimpleNamespace()).by_command["wrist"]  # type: ignore[arg-type]
    assert do({"engage": False}) == {"engage": False}
    loop._change()
    assert pipeline.clutch.released
    do({"engage": True})
    loop._change()
    assert not pipeline.clutch.released
    with pytest.raises(ConfigError, match="expected true or false"):
        do({})
