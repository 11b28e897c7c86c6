"""The node for Isaac Teleop, in the real library's graphs: joints, validity, loss, reset, pause."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from smooth_operator import HandFrame, HandRecording, Retargeter, load_hand
from smooth_operator.errors import ConfigError, MissingExtraError
from smooth_operator.landmarks import FROM_OPENXR_26, METACARPALS_OPENXR_26
from smooth_operator.synthetic import SyntheticOperator

RATE = 100.0
METHOD = "joint_angle"


@pytest.fixture(scope="module")
def isaac() -> SimpleNamespace:
    pytest.importorskip(
        "isaacteleop", reason="isaacteleop is not installed: the extra isaac, on Linux"
    )
    from isaacteleop.retargeting_engine import interface, tensor_types

    from smooth_operator_devices.isaac import SmoothHandRetargeter

    return SimpleNamespace(i=interface, t=tensor_types, node=SmoothHandRetargeter)


def operator(side: Any, seconds: float = 1.0) -> HandRecording:
    return SyntheticOperator(side=side, rate_hz=RATE, seed=3).record(seconds)


class Graph:
    """A node in a graph of Isaac Teleop, with values in the place of a headset."""

    def __init__(self, isaac: SimpleNamespace, side: str, **settings: Any) -> None:
        self.isaac, self.key, self.time = isaac, f"hand_{side}", 50.0
        self.node = isaac.node("mimic_p050", side, method=METHOD, **settings)
        source = isaac.i.ValueInput("headset", isaac.i.OptionalType(isaac.t.HandInput()))
        self.graph = self.node.connect({self.key: source.output("value")})

    def step(
        self,
        frame: HandFrame | None,
        *,
        valid: bool = True,
        turn: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0),
        **events: Any,
    ) -> dict[str, Any]:
        self.time += 1 / RATE
        given = self.isaac.i.OptionalTensorGroup(self.isaac.t.HandInput())
        if frame is not None:
            points = np.zeros((26, 3), np.float32)
            points[list(FROM_OPENXR_26)] = frame.landmarks
            if frame.metacarpals is not None:
                points[list(METACARPALS_OPENXR_26)] = frame.metacarpals
            given[0], given[1] = points, np.tile(np.float32(turn), (26, 1))
            given[2], given[3] = np.full(26, 0.01, np.float32), np.full(26, valid, np.uint8)
        stamp = round(self.time * 1e9)
        context = self.isaac.i.ComputeContext(
            self.isaac.i.GraphTime(0, stamp), self.isaac.i.ExecutionEvents(**events)
        )
        out = self.graph.execute_pipeline({"headset": {"value": given}}, context)
        return {
            "joints": np.array([out["hand_joints"][k] for k in range(len(self.node.joint_names))]),
            "valid": out["hand_valid"][0],
            "wrist": None if out["wrist_pose"].is_none else np.asarray(out["wrist_pose"][0]),
            "wrist_valid": out["wrist_valid"][0],
            "names": [each.name for each in out["hand_joints"].group_type.types],
        }


@pytest.mark.parametrize("side", ["right", "left"])
def test_joints_follow_the_hand_under_their_names(isaac, side):
    graph, recording = Graph(isaac, side), operator(side)
    hand = load_hand("mimic_p050", side)
    rows = [graph.step(frame) for frame in recording]
    assert rows[0]["names"] == list(hand.joint_names)
    assert [row["valid"] for row in rows] == [1.0] * len(rows)
    path = np.array([row["joints"] for row in rows])
    low, high = hand.limits.T
    assert np.all(path[:, list(hand.actuated)] >= low - 1e-6)
    assert np.all(path[:, list(hand.actuated)] <= high + 1e-6)
    # what the library alone gives, once the node has gone over to the operator
    alone = Retargeter("mimic_p050", side=side, method=METHOD)
    commands, _ = alone.run(recording)
    late = slice(70, None)
    np.testing.assert_allclose(path[late], commands.joint_positions[late], atol=2e-3)
    assert np.ptp(path, axis=0).max() > 0.3


def test_a_lost_hand_holds_and_comes_back_without_a_jump(isaac):
    graph, recording = Graph(isaac, "right", joints="actuated"), operator("right", 2.0)
    hand = load_hand("mimic_p050")
    before = graph.step(None)
    np.testing.assert_allclose(before["joints"], hand.neutral, atol=1e-6)  # not zeros
    assert before["valid"] == 0.0
    assert before["wrist"] is None
    assert graph.node.joint_names == hand.actuated_names
    for frame in recording[:80]:
        last = graph.step(frame)
    for _ in range(20):  # the limiter brakes first
        graph.step(None)
    held = graph.step(None)
    for lost in (None, recording[80]):
        for _ in range(150):
            row = graph.step(lost, valid=False)
            assert row["valid"] == 0.0
            np.testing.assert_array_equal(row["joints"], held["joints"])
    assert np.abs(held["joints"] - last["joints"]).max() < 0.2
    assert np.abs(held["joints"]).max() > 0.1
    rows = [held] + [graph.step(frame) for frame in recording[120:]]
    steps = np.abs(np.diff([row["joints"] for row in rows], axis=0)).max(axis=1)
    assert steps[0] <= 0.02
    assert rows[-1]["valid"] == 1.0


def test_reset_and_pause_hold_and_go_on_from_there(isaac):
    graph, recording = Graph(isaac, "right"), operator("right", 2.0)
    for frame in recording[:80]:
        last = graph.step(frame)
    row = graph.step(recording[150], reset=True)
    assert np.abs(row["joints"] - last["joints"]).max() <= 0.2  # it brakes and turns, no jump
    state = isaac.i.ExecutionState
    for number in range(60):
        paused = graph.step(recording[number], execution_state=state.PAUSED)
    still = graph.step(recording[100], execution_state=state.STOPPED)
    np.testing.assert_array_equal(paused["joints"], still["joints"])
    assert still["valid"] == 0.0
    back = graph.step(recording[101], execution_state=state.RUNNING)
    assert np.abs(back["joints"] - still["joints"]).max() <= 0.02
    assert back["valid"] == 1.0


def test_the_wrist_is_in_the_z_up_world(isaac):
    frame = operator("right")[0]
    at = HandFrame(frame.landmarks - frame.landmarks[0] + (0.1, 1.2, -0.4), side="right")
    graph = Graph(isaac, "right", compile=False)
    row = graph.step(at)  # OpenXR: x right, y up, z back; fingers forward, palm down
    np.testing.assert_allclose(row["wrist"], [0.4, -0.1, 1.2, 0, 0, 0, 1], atol=1e-6)
    assert row["wrist_valid"] == 1.0
    half = float(np.sqrt(0.5))
    row = graph.step(at, turn=(0.0, half, 0.0, half))  # to the left about the vertical
    np.testing.assert_allclose(row["wrist"][3:], [0, 0, half, half], atol=1e-6)
    held = graph.step(at, valid=False)
    np.testing.assert_array_equal(held["wrist"], row["wrist"])
    assert held["wrist_valid"] == 0.0

    graph = Graph(isaac, "right", compile=False, world="z_up")
    np.testing.assert_allclose(graph.step(at)["wrist"][:3], [0.1, 1.2, -0.4], atol=1e-6)


def test_the_pipeline_of_the_page_can_be_built(isaac):
    page = (Path(__file__).parents[3] / "docs/how-to/isaac.md").read_text(encoding="utf-8")
    code = page.partition("```python\n")[2].partition("```")[0]
    for side in ("right", "left"):
        quick = f'"mimic_p050", "{side}", method="{METHOD}"'
        code = code.replace(f'"shadow_hand", "{side}"', quick)
    built: dict[str, Any] = {}
    exec(code, built)
    assert set(built["pipeline"].output_types()) == {
        f"{side}_{what}" for side in ("right", "left") for what in ("joints", "valid")
    }


def test_a_wrong_setting_is_refused(isaac):
    for settings in ({"joints": "some"}, {"world": "unity"}):
        with pytest.raises(ConfigError, match="must be"):
            isaac.node("mimic_p050", "right", method=METHOD, **settings)


def test_without_the_library_one_line_says_what_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "isaacteleop", None)
    for name in [n for n in sys.modules if n.startswith("isaacteleop.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "smooth_operator_devices.isaac", raising=False)
    with pytest.raises(MissingExtraError) as caught:
        importlib.import_module("smooth_operator_devices.isaac")
    needed = "the node for Isaac Teleop needs the extra 'isaac': python -m pip"
    assert str(caught.value).startswith(needed)
    assert "\n" not in str(caught.value)
