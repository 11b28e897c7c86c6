"""The Feetech driver against simulated servos of both series on a pseudo-terminal."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_time import until
from simulators.common import SerialLine, opening
from simulators.feetech_bus import READ, SYNC_WRITE, WRITE, FeetechBus, packet

from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator_devices.hands.actuator_map import read_table
from smooth_operator_devices.hands.device import WrongAnswerError
from smooth_operator_devices.hands.drivers.feetech import FeetechHand

pytest.importorskip("serial", reason="the extra feetech is not installed")
if sys.platform == "win32":
    pytest.skip("needs pseudo-terminals", allow_module_level=True)

MODELS = ["scs0009", "sts3215"]


@pytest.fixture(autouse=True)
def patience(monkeypatch) -> None:
    """The machine may be busy."""
    monkeypatch.setattr("smooth_operator_devices.hands.drivers.servo_bank._SLOW_ANSWER_MS", 1000.0)


class Bank:
    """Three servos on a line, and the driver's device."""

    def __init__(self, folder: Path, models: str | list[str], *, echo: bool = False) -> None:
        models = [models] * 3 if isinstance(models, str) else models
        self.bus = FeetechBus(dict(zip((1, 2, 7), models, strict=True)))
        self.line = SerialLine(self.bus, echo=echo)
        self.folder = folder
        self.sts = models[0] == "sts3215"
        self.middle = 2048 if self.sts else 511

    def table(self, **entries: Any) -> Path:
        unit = "step" if self.sts else "scs_step"
        head = {"unit": f'"{unit}"', "limit": "60.0", **entries}
        path = self.folder / "bank.toml"
        path.write_text(
            'format = 1\ndriver = "feetech"\nhand = "inspire_hand"\nside = "right"\n'
            + "".join(f"{name} = {value}\n" for name, value in head.items())
            + "".join(
                f'[[actuators]]\nname = "{name}"\nid = {number}\njoint = "{joint}"\n'
                f"points = [[-1.0, {self.middle // 2}], [1.0, {self.middle * 3 // 2}]]\n"
                for name, number, joint in (
                    ("index", 1, "index_proximal_joint"),
                    ("middle", 2, "middle_proximal_joint"),
                    ("ring", 7, "ring_proximal_joint"),
                )
            )
        )
        return path

    def device(self, series: str | None = None, **entries: Any) -> FeetechHand:
        return FeetechHand(self.line.port, read_table(self.table(**entries)), series=series)

    def writes(self, address: int) -> list[bytes]:
        """Parameters of the sync writes at an address."""
        data = [body[5:-1] for body in self.bus.received if body[4] == SYNC_WRITE]
        return [parameters for parameters in data if parameters[0] == address]


@pytest.fixture
def bank(request, tmp_path) -> Iterator[Callable[..., Bank]]:
    made: list[Bank] = []

    def make(models: str | list[str], **settings: Any) -> Bank:
        made.append(Bank(tmp_path, models, **settings))
        return made[-1]

    yield make
    for each in made:
        each.line.close()


@pytest.fixture
def opened(bank) -> Iterator[Callable[[str], tuple[Bank, FeetechHand]]]:
    """Three servos, and their device, which is open."""
    with opening(lambda simulated: simulated.device()) as opened:
        yield lambda model: (simulated := bank(model), opened(simulated))


@pytest.mark.parametrize("model", MODELS)
def test_words_have_the_byte_order_of_the_series(opened, model):
    simulated, device = opened(model)
    device.write(device.read().positions)
    device.write(np.array([300.0, 600.0, 601.4]))
    device.read()  # the line has taken the goals then
    sent = simulated.writes(42)[-1]
    order = "little" if simulated.sts else "big"
    goals = [n.to_bytes(2, order) for n in (300, 600, 601)]
    assert sent == bytes([42, 2, 1]) + goals[0] + b"\x02" + goals[1] + b"\x07" + goals[2]
    until(lambda: device.read().positions.tolist() == [300.0, 600.0, 601.0])


@pytest.mark.parametrize(
    ("model", "per_radian"), [("scs0009", 1024 / np.deg2rad(300)), ("sts3215", 4096 / (2 * np.pi))]
)
def test_angles_are_converted_by_the_steps_of_the_series(bank, model, per_radian):
    device = bank(model).device(unit='"rad"')
    device.open()
    middle = bank(model).middle
    assert device.read().positions == pytest.approx([middle / per_radian] * 3)
    device.close()


@pytest.mark.parametrize("model", MODELS)
def test_the_first_goals_are_the_positions_and_come_before_the_torque(bank, model):
    simulated = bank(model)
    simulated.bus.motors.place([100.0, 200.0, 900.0])
    device = simulated.device()
    device.open()
    assert not simulated.bus.motors.powered.any()
    assert not simulated.writes(42)
    device.write(device.read().positions)
    assert simulated.bus.motors.powered.all()
    order = [body[5] for body in simulated.bus.received if body[4] == SYNC_WRITE]
    assert order[-3:] == [42, 40, 42]
    assert simulated.bus.motors.positions.tolist() == [100.0, 200.0, 900.0]
    assert [servo.word(48) for servo in simulated.bus.servos.values()] == (
        [600] * 3 if simulated.sts else [0x0100] * 3  # the lock of the SCS is there
    )
    device.relax()
    until(lambda: not simulated.bus.motors.powered.any())
    device.close()


@pytest.mark.parametrize("model", MODELS)
def test_loads_temperatures_and_errors_are_read(opened, model):
    simulated, device = opened(model)
    device.write(device.read().positions)
    motors = simulated.bus.motors
    motors.temperatures[:] = 31, 32, 71
    motors.stuck.add(1)
    device.write(np.array([simulated.middle + n for n in (0.0, -90.0, 0.0)]))
    reading = device.read()
    assert reading.temperatures.tolist() == [31, 32, 71]
    assert reading.currents.tolist() == [0.0, -100.0, 0.0]
    assert reading.errors == ("ring: too hot",)
    simulated.bus.servos[2].error = 32
    reading = device.read()
    assert reading.errors == ("middle: overload", "ring: too hot")
    assert reading.currents[1] == -20.0  # its protective torque


@pytest.mark.parametrize("model", MODELS)
def test_an_overloaded_servo_keeps_its_protection_until_it_gets_another_goal(opened, model):
    simulated, device = opened(model)
    device.write(device.read().positions)
    simulated.bus.motors.stuck.add(1)
    goals = np.full(3, simulated.middle - 90.0)
    device.write(goals)
    device.read()  # the line has taken the goals then
    simulated.bus.servos[2].error = 32
    device.read()
    count = len(simulated.writes(42))
    device.write(goals)
    device.read()
    assert len(simulated.writes(42)) == count + 1
    assert simulated.writes(42)[-1][2::3] == b"\x01\x07"  # none for servo 2
    assert simulated.bus.servos[2].error == 32
    device.write(goals + 30.0)
    assert device.read().errors == ()


@pytest.mark.parametrize("model", MODELS)
def test_a_restart_is_noticed_by_the_torque_that_is_off(opened, model):
    simulated, device = opened(model)
    device.write(device.read().positions)
    before = {s.name: s.measured.tolist() for s in device.settings()}
    simulated.bus.reboot()
    after = {s.name: s.measured.tolist() for s in device.settings()}
    assert (before["torque"], after["torque"]) == ([1] * 3, [0] * 3)
    if simulated.sts:
        assert (before["torque limit"], after["torque limit"]) == ([600] * 3, [1000] * 3)


@pytest.mark.parametrize("kind", ["checksum", "identifier", "short"])
@pytest.mark.parametrize("model", MODELS)
def test_one_wrong_answer_is_an_error_and_the_next_one_is_read(opened, model, kind, monkeypatch):
    simulated, device = opened(model)
    device._bus._answer_s = 0.1
    simulated.bus.faults.answer_wrongly(kind)
    with pytest.raises(WrongAnswerError, match=r"no valid answer from servo 1 \(index\)"):
        device.read()
    device._bus._answer_s = 1.0
    assert device.read().positions.tolist() == [simulated.middle] * 3


@pytest.mark.parametrize("model", MODELS)
def test_answers_to_another_program_and_an_echo_are_skipped(bank, model):
    simulated = bank(model, echo=True)
    device = simulated.device()
    device.open()
    for _ in range(20):
        simulated.line.second_program(packet(1, READ, bytes([56, 2])))
        assert device.read().positions.tolist() == [simulated.middle] * 3
        simulated.line.second_program(packet(2, WRITE, bytes([41, 0])))
    device.close()


@pytest.mark.parametrize("model", MODELS)
def test_servos_that_are_absent_or_of_another_kind_are_named(bank, model, tmp_path):
    simulated = bank(model)
    simulated.bus.absent.add(2)
    device = simulated.device()
    monkey = pytest.MonkeyPatch()
    with monkey.context() as patch:
        patch.setattr("smooth_operator_devices.hands.drivers.servo_bank._SLOW_ANSWER_MS", 50.0)
        with pytest.raises(SinkError, match=r"no answer from the servos 2 \(middle\)"):
            device.open()
        device.close()
    simulated.bus.absent.clear()
    simulated.bus.servos[7].set_word(3, 0x0909)
    with pytest.raises(SinkError, match=r"servo 7 \(ring\) is of model number 2313.*series=scs"):
        device.open()
    device.close()
    device = simulated.device("sts" if simulated.sts else "scs")
    device.open()
    assert device.read().positions.tolist() == [simulated.middle] * 3
    device.close()


def test_servos_of_both_series_on_one_line_are_refused(bank):
    device = bank(["sts3215", "sts3215", "scs0009"]).device()
    with pytest.raises(SinkError, match="the servos are of both series"):
        device.open()
    device.close()


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"limit": "150.0"}, "limit must be 1 to 100 % of the largest load"),
        ({"unit": '"furlong"'}, "the unit of servos must be rad or deg or step or scs_step"),
        ({"settings": "{watchdog = 1}"}, "feetech has no setting 'watchdog'; expected one of baud"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(bank, entries, said):
    with pytest.raises(ConfigError, match=said):
        bank("scs0009").device(**entries)


def test_a_check_writes_a_table_of_servos(bank, monkeypatch, tmp_path, capsys):
    simulated = bank("scs0009")
    replies = iter(["", "index_proximal_joint", *["k"] * 2, "", "", "q"])
    monkeypatch.setattr("builtins.input", lambda _: next(replies, "q"))
    output = tmp_path / "written.toml"
    argv = ["hardware", "check", f"feetech:{simulated.line.port},limit=60", "--hand"]
    argv += ["inspire_hand", "--ids", "1,2,7", "--unit", "scs_step", "--ends", "400", "620"]
    assert main([*argv, "--output", str(output)]) == 0
    table = read_table(output)
    assert (table.driver, table.unit) == ("feetech", "scs_step")
    assert [actuator.id for actuator in table.actuators] == [1, 2, 7]
    until(lambda: not simulated.bus.motors.powered.any())
