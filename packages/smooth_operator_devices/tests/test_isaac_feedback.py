"""The output of feedback ``isaac``, in the real library's session and graphs."""

import ctypes
import struct
from typing import Any

import pytest
from live_time import Kept, until
from openxr_runtime import NEEDS_COMPILER, loaded
from ticks import felt

from smooth_operator import load_hand
from smooth_operator.errors import ConfigError, SourceError
from smooth_operator.teleop.components import build_feedback
from smooth_operator.teleop.sinks.tick import Mode
from smooth_operator.teleop.sources.combined import CombinedSource
from smooth_operator.teleop.sources.webxr import WebXr
from smooth_operator_devices.trackers.isaac_feedback import IsaacFeedback
from smooth_operator_devices.trackers.isaac_hands import IsaacHands

PUSH_TENSOR = 256
GLOVES = "isaac:manus_glove_haptic,strength=0.8,rate=1000"


def command(data: bytes) -> tuple[str, list[float]]:
    """Endpoint and values of a ``HapticCommand``, whose fields 0 and 1 they are.

    Sources: ``haptic_command.fbs`` of https://github.com/NVIDIA/IsaacTeleop, and
    https://flatbuffers.dev/internals/.
    """

    def number(kind: str, place: int) -> Any:
        return struct.unpack_from(f"<{kind}", data, place)[0]

    def vector(field: int, kind: str) -> tuple[Any, ...]:
        root = number("I", 0)
        place = root + number("H", root - number("i", root) + 4 + 2 * field)
        place += number("I", place)
        return struct.unpack_from(f"<{number('I', place)}{kind}", data, place + 4)

    return b"".join(vector(0, "c")).decode(), list(vector(1, "f"))


class Gloves:
    """What the plug-in of the gloves reads from a runtime of the tests."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, extensions: int) -> None:
        monkeypatch.setenv("ISAAC_TELEOP_DISABLE_CXR_ENV_CHECKS", "1")
        self.runtime = loaded(monkeypatch, extensions, ready=True)
        self.runtime.pushed_sample.restype = ctypes.POINTER(ctypes.c_uint8 * 256)
        self.runtime.pushed_to.restype = ctypes.c_char_p

    def commands(self) -> list[tuple[str, list[float]]]:
        """All commands so far."""
        count = self.runtime.pushed_samples()
        return [command(bytes(self.runtime.pushed_sample(k).contents)) for k in range(count)]


@NEEDS_COMPILER
def test_each_finger_of_a_glove_vibrates_within_the_strength_and_the_end_is_silent(monkeypatch):
    pytest.importorskip(
        "isaacteleop", reason="isaacteleop is not installed: the extra isaac, on Linux"
    )
    gloves, hand = Gloves(monkeypatch, 127 | PUSH_TENSOR), load_hand("leap_hand")
    source, feedback = IsaacHands(rate=200.0), build_feedback(GLOVES)
    feedback.use_source(source)
    link = feedback.connect({"right": hand}, {})
    source.start(Kept())
    try:
        assert gloves.runtime.pushed_to() == b"manus_glove_haptic"
        assert gloves.commands() == []
        link.deliver(felt(hand, [0.5, 7.0, 0.0, 0.25]))
        until(lambda: gloves.runtime.pushed_samples() >= 1)
        (side, powers), *_ = gloves.commands()
        assert side == "right"
        assert powers == pytest.approx([0.4, 0.8, 0.0, 0.2, 0.0])  # LEAP has no little finger
        link.deliver(felt(hand, [1.0] * 4, mode=Mode.STOPPED))
        until(lambda: gloves.runtime.pushed_samples() >= 2)
        assert gloves.commands()[1] == ("right", [0.0] * 5)
        link.deliver(felt(hand, [1.0] * 4))
        until(lambda: gloves.runtime.pushed_samples() >= 3)
        assert max(gloves.commands()[2][1]) == pytest.approx(0.8)
    finally:
        source.stop()
    assert gloves.commands()[3:] == [("left", [0.0] * 5), ("right", [0.0] * 5)]


@NEEDS_COMPILER
def test_a_runtime_without_the_extension_for_gloves_is_an_error_at_the_start(monkeypatch):
    pytest.importorskip(
        "isaacteleop", reason="isaacteleop is not installed: the extra isaac, on Linux"
    )
    Gloves(monkeypatch, 127)
    source = IsaacHands()
    build_feedback(GLOVES).use_source(source)
    with pytest.raises(SourceError, match="can't start a session"):
        source.connect()


class Controllers:
    """Stand-in for ``ControllerTracker``, with the methods of its page on haptic feedback."""

    def __init__(self) -> None:
        self.pulses: list[tuple[Any, ...]] = []

    def apply_left_haptic_feedback(self, session: object, *pulse: float) -> None:
        self.pulses.append(("left", *pulse))

    def apply_right_haptic_feedback(self, session: object, *pulse: float) -> None:
        self.pulses.append(("right", *pulse))


def test_controllers_vibrate_as_strongly_as_the_finger_with_most_contact(hand, monkeypatch):
    trackers = pytest.importorskip(
        "isaacteleop.deviceio_trackers",
        reason="isaacteleop is not installed: the extra isaac, on Linux",
    )
    monkeypatch.setattr(trackers, "ControllerTracker", Controllers)
    source, feedback = IsaacHands(), build_feedback("isaac,rate=1000")
    feedback.use_source(CombinedSource(WebXr(), source, {}))
    link = feedback.connect({"right": hand}, {})
    (haptics,) = source.haptics
    graph = haptics.sink()
    pulses = graph.target_module.get_tracker().pulses

    def step(**settings: bool) -> list[tuple[Any, ...]]:
        pulses.clear()
        graph.execute_pipeline(haptics.inputs(**settings))
        graph.target_module.flush_to_device(None)
        return [(side, *map(pytest.approx, pulse)) for side, *pulse in pulses]

    assert step() == []
    link.deliver(felt(hand, [0.0, 0.5, 1.0, 0.0, 0.0]))
    assert step() == [("right", 0.5, 0.0, 0.1)]
    assert step() == []  # a level leaves once
    link.deliver(felt(hand, [1.0] * 5, mode=Mode.PAUSED))
    assert step() == [("right", 0.0, 0.0, 0.1)]
    link.deliver(felt(hand, [1.0] * 5))
    assert step(silent=True) == [("left", 0.0, 0.0, 0.1), ("right", 0.0, 0.0, 0.1)]


def test_another_source_is_refused():
    with pytest.raises(ConfigError, match="use --source isaac"):
        IsaacFeedback().use_source(WebXr())
