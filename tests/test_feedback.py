"""Feedback of contact: from a simulated hand to messages, and silence where nothing may be felt."""

import json
import socket
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
import pytest
from free_port import free_port
from live_time import PATIENCE_S, until
from ticks import felt, make_tick

from smooth_operator import Hand
from smooth_operator.errors import ConfigError
from smooth_operator.simulation.physics import FURNISHED, HandPhysics
from smooth_operator.teleop import TeleopRequest, teleoperate
from smooth_operator.teleop.components import build_feedback
from smooth_operator.teleop.sinks import feedback as module
from smooth_operator.teleop.sinks.feedback import Feedback
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator.teleop.sinks.tick import Mode
from smooth_operator.teleop.sources.webxr import WebXr


@dataclass(frozen=True)
class Kept(Feedback):
    """Feedback that keeps its messages."""

    messages: list[dict[str, Any]] = field(default_factory=list)
    label = "kept"

    def output(self) -> module.Output:
        return self.messages.append, lambda: None


@dataclass(frozen=True)
class Broken(Feedback):
    """Feedback whose receiver never takes anything."""

    label = "broken"

    def output(self) -> module.Output:
        def fail(message: dict[str, Any]) -> None:
            raise OSError("the cable is out")

        return fail, lambda: None


@pytest.fixture
def patient(monkeypatch) -> None:
    """A busy machine may wait between the measurement of a contact and its message."""
    monkeypatch.setattr(module, "VALID_S", PATIENCE_S)


@pytest.mark.usefixtures("patient")
def test_strength_caps_and_a_contact_that_is_not_finite_is_nothing(hand):
    kept = Kept(strength=0.5, rate=1000.0)
    link = kept.connect({"right": hand}, {})
    levels = [np.nan, 7.0, 0.4, np.inf, -1.0]
    link.deliver(felt(hand, levels))
    (message,) = kept.messages
    assert message["fingers"] == list(hand.fingers)
    assert message["levels"] == [0.0, 0.5, 0.2, 0.0, 0.0]
    assert message["newtons"] == [None] * 5
    assert (message["side"], message["type"], message["number"]) == ("right", "feedback", 0)
    assert 0.0 < message["age_s"] < message["valid_for_s"]
    assert kept.figures["contacts_not_finite"] == 2
    assert kept.figures["feedback_delay_ms"]["max"] > 0.0


@pytest.mark.usefixtures("patient")
def test_nothing_is_felt_while_the_operator_moves_nothing(hand):
    """In each state one message says so, at once, although the rate allows no other."""
    some = [1.0] * len(hand.fingers)
    quiet: list[Callable[[Any], None]] = [
        *(lambda link, m=m: link.deliver(felt(hand, some, mode=m)) for m in Mode if not m.moves),
        lambda link: link.deliver(felt(hand, some, age=1.1 * PATIENCE_S)),
        lambda link: link.deliver(felt(hand, None)),
        lambda link: link.deliver(make_tick(hand)),  # the robot hand is lost
        lambda link: link.stalled(0.5),
        lambda link: link.close(),
    ]
    for silence in quiet:
        kept = Kept(rate=1.0)
        link = kept.connect({"right": hand}, {})
        for _ in range(9):
            link.deliver(felt(hand, some))
        assert 1 <= len(kept.messages) <= 3  # the rate
        assert all(max(message["levels"]) == 0.5 for message in kept.messages)
        silence(link)
        assert max(kept.messages[-1]["levels"]) == max(kept.messages[-1]["newtons"]) == 0.0
    assert Kept().note == ""
    kept = Kept()
    kept.connect({"right": hand}, {}).deliver(felt(hand, None))
    assert "does not measure contact" in kept.note


class Boxed(Simulation):
    """A simulated hand with a box where the tip of its closed index finger would be."""

    def _built(self, hand: Hand, task: str) -> HandPhysics:
        free = HandPhysics(hand)
        free.command(closed(hand))
        free.advance(1.0)
        tip = free.data.body(hand.spec.fingers[1].tip.body).xpos

        def furnish(spec: mujoco.MjSpec) -> mujoco.MjSpec:
            world = mujoco.MjSpec()
            for name in ("timestep", "integrator", "gravity"):
                setattr(world.option, name, getattr(spec.option, name))
            world.attach(spec, prefix=FURNISHED, frame=world.worldbody.add_frame())
            box = world.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01] * 3)
            box.pos = tip
            return world

        return HandPhysics(hand, furnish=furnish)


def closed(hand: Hand) -> np.ndarray:
    """Joint positions with the index finger closed."""
    pose = hand.neutral.copy()
    index = [i for i, name in enumerate(hand.actuated_names) if name.startswith("index")]
    pose[index] = hand.limits[index, 1]
    return hand.full_configuration(pose)


def test_a_simulated_finger_that_touches_a_box_is_felt_in_a_message(hand):
    zmq = pytest.importorskip("zmq", reason="the extra zmq is not installed")
    address = f"tcp://127.0.0.1:{free_port()}"
    world, glove = Boxed(), build_feedback(f"zmq:{address},strength=0.5")
    runner = SinkRunner([world, glove])
    runner.open({"right": hand}, {})
    context = zmq.Context()
    receiver = context.socket(zmq.SUB)
    receiver.connect(address)
    receiver.subscribe(b'{"side":"right"')

    def next_message(pose: np.ndarray, mode: Mode = Mode.TRACKING) -> dict[str, Any]:
        """Commands a pose, as the loop does, until a message comes."""
        while not receiver.poll(10):
            tick = make_tick(hand, mode=mode)
            command = replace(tick.command, joint_positions=pose)
            tick = replace(tick, command=command, state=runner.state("right"))
            runner.send(tick)
            runner.observe(tick)
        return dict(json.loads(receiver.recv()))

    try:
        assert next_message(hand.full_configuration(hand.neutral))["levels"] == [0.0] * 5
        touching = until(lambda: any((m := next_message(closed(hand)))["levels"]) and m)
        levels = dict(zip(touching["fingers"], touching["levels"], strict=True))
        newtons = dict(zip(touching["fingers"], touching["newtons"], strict=True))
        assert {name for name, level in levels.items() if level} == {"index"}
        assert levels["index"] == pytest.approx(0.5 * min(newtons["index"] / 5.0, 1.0), abs=1e-3)
        until(lambda: next_message(closed(hand))["newtons"][1] > 1.0)
        until(lambda: not any(next_message(closed(hand), Mode.STOPPED)["levels"]))
        assert world.state("right").contact.newtons[1] > 1.0  # it still touches
    finally:
        runner.close()
        receiver.close()
        context.term()


def test_a_receiver_that_fails_does_not_stop_the_run_and_the_end_is_silent():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        port = receiver.getsockname()[1]
        request = TeleopRequest(
            method="joint_angle",
            sink=("mujoco",),
            feedback=(f"udp:127.0.0.1:{port},rate=50", f"{__name__}:Broken"),
            duration=0.5,
        )
        summary = teleoperate(request)
        broken, glove = (
            next(sink for sink in summary["sinks"] if sink["label"].startswith(label))
            for label in ("broken", "feedback udp")
        )
        assert "the cable is out" in broken["detail"]
        assert glove["failed"] == 0
        assert 0 < glove["figures"]["messages"] <= summary["commands"]["right"]
        messages = [json.loads(receiver.recv(4000)) for _ in range(glove["figures"]["messages"])]
    assert [message["number"] for message in messages] == list(range(len(messages)))
    assert not any(messages[-1]["levels"])


@pytest.mark.parametrize(
    ("feedback", "sinks", "words"),
    [
        ("udp:127.0.0.1:9", (), "needs a sink that measures contact"),
        ("udp:9000", ("mujoco",), "expected HOST:PORT"),
        ("udp:127.0.0.1:9,strength=2", ("mujoco",), "strength must be 0 to 1"),
        ("zmq:here", ("mujoco",), "not a ZeroMQ address"),
        ("webxr", ("mujoco",), "needs a headset"),
    ],
)
def test_settings_that_can_not_work_are_refused(feedback, sinks, words):
    with pytest.raises(ConfigError, match=words):
        teleoperate(TeleopRequest(sink=sinks, feedback=(feedback,)))


def test_pulses_follow_the_finger_with_most_contact_and_end_once(hand, monkeypatch):
    pulses: list[tuple[str, float]] = []
    monkeypatch.setattr(WebXr, "pulse", lambda self, side, level, _: pulses.append((side, level)))
    glove = build_feedback("webxr,strength=0.8,rate=1000")
    glove.use_source(WebXr())
    link = glove.connect({"right": hand}, {})
    link.deliver(felt(hand, [0.0, 0.5, 1.0, 0.0, 0.0]))
    for _ in range(3):
        link.deliver(felt(hand, [1.0] * 5, mode=Mode.PAUSED))
    link.close()
    assert pulses == [("right", 0.8), ("right", 0.0)]
