"""The wrist on the page and at the keys: a line of text, release and engage."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from ticks import make_tick

from smooth_operator import Retargeter, load_hand
from smooth_operator.errors import ConfigError
from smooth_operator.human.palm_axes import FLAT_HAND
from smooth_operator.planning import make_request
from smooth_operator.teleop.control.keyboard import actions
from smooth_operator.teleop.control.rpc_handlers import RpcHandlers
from smooth_operator.teleop.pages.live import live_texts
from smooth_operator.teleop.pages.live.live_session import LiveSession
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.teleop.sinks.tick import WristCommand
from smooth_operator.teleop.sources.live import Arrival, SourceHealth
from smooth_operator.types import HandFrame

SEEN = {
    "tracked": True,
    "world": "webxr/local-floor",
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
    assert "lost" in line(engaged=False, tracked=False)
    assert "is held" in line(engaged=False)
    assert "&lt;b&gt;" in line(world="<b>")
    none = live_texts.modes({"right": {"mode": "tracking", "latched": None, "wrist": None}})
    assert "wrist: not tracked" in none


def test_the_page_is_told_both_wrists(loop: TeleopLoop) -> None:
    session = LiveSession(loop, make_request(method="joint_angle"))
    (pipeline,) = loop.pipelines.values()
    target = WristCommand(np.array([0.4, 0.0, 3.0, 0.0, 1.0, 0.0, 0.0]), True, True)
    poses = (None, np.array([0.1, 0.2, 1.0, 1.0, 0.0, 0.0, 0.0]), np.full(7, np.nan))
    for k, pose in enumerate(poses):
        frame = HandFrame(FLAT_HAND, float(k), T_world_wrist=pose, world="room")
        pipeline.latest = Arrival(frame, loop.mailbox.clock())
        tick = make_tick(pipeline.retargeter.hand, k)
        session.watch(replace(tick, wrist=None if pose is None else target))
        latest = json.loads(json.dumps(session.look(text=False, settings=0)))
        wrist = latest["hands"]["right"]["wrist"]
        if pose is None:
            assert wrist is None
        else:
            assert wrist["world"] == "room"
            assert wrist["tracked"] == (k == 1)
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
