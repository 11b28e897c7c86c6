"""The ORCA driver against the hand in memory of orca-core."""

from __future__ import annotations

import sys
import time
import types
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from ticks import make_tick

from smooth_operator.errors import MissingExtraError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.hardware.drivers.orca import OrcaSink
from smooth_operator.teleop.hardware.table_file import built_in_tables, read_table
from smooth_operator.types import JointCommand


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("orca_v2")


def until(done: Callable[[], object], seconds: float = 10.0) -> None:
    end = time.perf_counter() + seconds
    while not done():
        assert time.perf_counter() < end, "it did not happen in time"
        time.sleep(0.005)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_table_fits_our_model(side: str) -> None:
    table = read_table(built_in_tables() / f"orca_{side}.toml")
    hand = load_hand("orca_v2", side)  # type: ignore[arg-type]
    bound = table.bind(hand)
    assert bound.determined.all()
    low, high = hand.limits.T
    for q in (low, high):  # our model's ends are the maker's
        commands = bound.commands(bound.angles(hand.full_configuration(q)))
        assert commands == pytest.approx(bound.clip(commands), abs=0.1)


def test_without_orca_core_the_extra_is_named(hand: Hand) -> None:
    try:
        import orca_core  # noqa: F401
    except ImportError:
        with pytest.raises(MissingExtraError, match="orca"):
            OrcaSink().open({"right": hand}, {})
    else:
        pytest.skip("orca-core is installed")


def test_the_makers_mock_boots_approaches_and_is_read_back(
    hand: Hand, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("orca_core", reason="the extra orca (orca-core) is not installed")
    sink = build_sink("orca:mock=true,approach=5")
    sink.open({"right": hand}, {})
    try:
        state = sink.state("right")
        assert state is not None
        q = hand.full_configuration(hand.neutral)
        tick = replace(make_tick(hand), command=JointCommand(q, hand.joint_names))
        until(lambda: sink.send(tick) or "approaches" not in sink.note)

        def error() -> float:
            now = sink.state("right")
            return 9.0 if now is None else float(np.abs(now.positions - q).max())

        until(lambda: sink.send(tick) or error() < 0.01)
        assert sink.figures["wrong_answers"] == 0  # type: ignore[attr-defined]
        until(lambda: "it rests" in sink.note)
    finally:
        sink.close()
    assert capsys.readouterr().out == ""  # what the makers' library says is no result


def test_a_hand_that_is_not_calibrated_is_refused(
    hand: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    core = pytest.importorskip("orca_core", reason="the extra orca (orca-core) is not installed")
    real = core.load_hand

    def uncalibrated(**options: object) -> object:
        made = real(**options)
        made.calibration = replace(made.calibration, calibrated=False)
        return made

    monkeypatch.setattr(core, "load_hand", uncalibrated)
    with pytest.raises(SinkError, match="is not calibrated"):
        OrcaSink(mock=True).open({"right": hand}, {})


class _Hand:
    """What the driver calls of a hand of orca-core, with the current of its motors [mA]."""

    last_read_ok, calibrated, absent_joints = True, True, ()

    def __init__(self, names: tuple[str, ...]) -> None:
        wired = {name: k + 1 for k, name in enumerate(names)}
        self.config = types.SimpleNamespace(
            joint_ids=list(names),
            motor_ids=list(wired.values()),
            joint_to_motor_map=wired,
            max_current=400.0,
        )
        self.current = 1750.0
        self.at_power: list[float] = []

    def connect(self, interactive: bool) -> tuple[bool, str]:
        return True, "connected"

    def init_joints(self, move_to_neutral: bool) -> None:
        self.current = self.config.max_current

    def set_max_current(self, current: float) -> None:
        self.current = current

    def enable_torque(self) -> list[int]:
        self.at_power.append(self.current)
        return []

    def disable_torque(self) -> None:
        pass

    def set_joint_positions(self, pose: dict[str, float]) -> None:
        pass

    def disconnect(self) -> None:
        pass


@pytest.mark.parametrize(("limit", "current"), [(150.0, 150.0), (None, 400.0)])
def test_the_limit_is_back_before_torque_that_was_off(
    monkeypatch: pytest.MonkeyPatch, limit: float | None, current: float
) -> None:
    table = read_table(built_in_tables() / "orca_right.toml")
    first = replace(table.actuators[0], limit=limit)
    table = replace(table, limit=None, actuators=(first, *table.actuators[1:]))
    hand = _Hand(table.names)
    core = types.ModuleType("orca_core")
    core.load_hand = lambda **_: hand  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "orca_core", core)
    device = OrcaSink().device(table)
    device.open()
    commands = np.zeros(len(table.names))
    device.write(commands)
    device.relax()
    hand.current = 1750.0  # as a motor that restarted has it
    device.write(commands)
    assert hand.at_power == [current, current]
    device.close()
