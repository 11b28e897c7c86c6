"""Each driver of a real hand with a simulator on its wire, in one form for the shared tests."""

import contextlib
import importlib.util
import itertools
import os
import sys
import time
import types
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from ability_simulator import AbilityHand
from allegro_simulator import AllegroHand
from fake_hand_sdks import FingerUnitMode, StarkWorld, WujiWorld
from revo2_simulator import Revo2Hand
from simulators import (
    aero_hand,
    feetech_bus,
    inspire_touch,
    revo3_sdk,
    rohand_modbus,
    wuji_sdk,
    xhand_sdk,
)
from simulators.common import Faults, SerialLine, serve_can
from simulators.modbus_rtu import RtuDevice, crc

from smooth_operator import load_hand
from smooth_operator.errors import SinkError
from smooth_operator.teleop.components import build_sink
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table, write_table
from smooth_operator_devices.hands.device import HandDevice
from smooth_operator_devices.hands.hardware_sink import HardwareSink

_channels = itertools.count()
DRIVERS: Final = "smooth_operator_devices.hands.drivers"


class Rig:
    """A simulated hand on its wire, and what is needed to reach it.

    Args:
        folder: folder for tables and ports.
        monkeypatch: for the times of the driver, and stand-ins of packages.
        side: side of the simulated hand.

    Attributes:
        hand: the simulated hand; most have ``motors``.
        sink: text of the sink, without settings.
        sent: targets that the hand got; NaN for a motor without one. Torques of an Allegro Hand.
    """

    driver: str = ""
    library: str = ""
    table: str = ""
    """Name of the table without the side; that of the driver if it is empty."""
    stand_in: str = ""
    """Hand of the catalogue whose joints the table gets in a sink, for a hand that is not in it."""
    unit: float = 1.0
    """How near a motor comes to its command, in the commands' unit."""
    waits: tuple[str, ...] = ("_TIMEOUT",)
    """Names of the driver's times; those of another module have its name in front."""
    wrong: tuple[str, ...] = ("short",)
    """Kinds of wrong answers."""
    reports = False
    """True for a hand that reports its positions without a question."""
    switches = False
    """True for a hand that can switch its torque off."""
    prefix = True
    """True if messages begin with the name of the driver."""
    other = ""
    """Words of the refusal of a hand of the other side; empty for a hand that does not tell it."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, side: str = "right") -> None:
        self.folder, self.monkeypatch, self.side = folder, monkeypatch, side
        self.served = contextlib.ExitStack()
        self.sent: list[Any] = []
        self._looks: list[Callable[[np.ndarray, np.ndarray], None]] = []
        self.hand: Any = self.make()
        self.watch()
        self.sink = self.serve()

    def make(self) -> Any:
        """The simulated hand, of ``side``."""
        raise NotImplementedError

    def serve(self) -> str:
        """Put the hand on its wire; returns the text of its sink."""
        raise NotImplementedError

    def text(self, port: object, **settings: object) -> str:
        """Text of a sink at a port, with a table on the joints of ``stand_in``, if there is one."""
        if self.stand_in:
            joints = load_hand(self.stand_in, side="right").actuated_names
            made = read_table(built_in_tables() / f"{self.table or self.driver}_right.toml")
            pairs = zip(made.actuators, joints, strict=False)
            actuators = tuple(replace(each, joints={joint: 1.0}) for each, joint in pairs)
            settings["table"] = self.folder / f"{self.driver}.toml"
            write_table(replace(made, hand=self.stand_in, actuators=actuators), settings["table"])
        return ",".join([f"{self.driver}:{port}", *(f"{k}={v}" for k, v in settings.items())])

    def build(self, **settings: object) -> HardwareSink:
        """The sink, with fast motion unless told otherwise."""
        values = {"approach": 50.0, "speed": 50.0, **settings}
        return build_sink(",".join([self.sink, *(f"{k}={v}" for k, v in values.items())]))

    def device(self, side: str = "", limit: float | None = None, **settings: Any) -> HandDevice:
        """A device with the table of a side (by default that of the hand) and some settings."""
        sink, side = self.build(), side or self.side
        built_in = built_in_tables() / f"{self.table or self.driver}_{side}.toml"
        table = read_table(built_in) if built_in.is_file() else sink.actuators("right")
        table = replace(table, settings={**table.settings, **settings}, limit=limit or table.limit)
        device = sink.device(table)
        self.served.callback(device.close)
        return device

    def open(self, **settings: Any) -> Any:
        """The same, open; closed again if it can't be opened, as by a sink."""
        device = self.device(**settings)
        try:
            device.open()
        except SinkError:
            device.close()
            raise
        return device

    @property
    def faults(self) -> Faults:
        return self.hand.faults

    def patience(self, seconds: float) -> None:
        """Set the time that the driver waits for an answer [s], before it is opened."""
        for name in self.waits:
            where = name if "." in name else f"{self.driver}.{name}"
            self.monkeypatch.setattr(f"{DRIVERS}.{where}", seconds)

    def watch(self) -> None:
        """Take note of every target."""
        move = self.hand.motors.move

        def moved(targets: Any, motors: Any = None) -> None:
            targets = list(targets)
            self.take(range(len(self.hand.motors)) if motors is None else list(motors), targets)
            move(targets, motors)

        self.monkeypatch.setattr(self.hand.motors, "move", moved)

    def take(self, motors: Sequence[int], targets: Sequence[float]) -> None:
        """Take note of targets of motors; NaN for the others."""
        row = np.full(len(self.positions()), np.nan)
        row[motors] = targets
        for look in self._looks:
            look(row, self.positions())
        self.sent.append(row)

    def watch_targets(self, look: Callable[[np.ndarray, np.ndarray], None]) -> None:
        """Call a function with each target, and the positions of the motors at that time."""
        self._looks.append(look)

    def positions(self) -> np.ndarray:
        """Positions of the motors, in the unit of the commands."""
        return self.hand.motors.positions

    def near(self, commands: np.ndarray) -> bool:
        """True if the motors have reached their commands."""
        return bool(np.abs(self.positions() - commands).max() <= 2 * self.unit)

    def outside(self) -> int:
        """Number of targets beyond the ends."""
        ends = np.array([a.ends for a in self.build().actuators("right").actuators])
        low, high = ends.T + np.array([[-self.unit], [self.unit]])
        return sum(bool(((row < low) | (row > high)).any()) for row in self.sent)

    def powered(self) -> bool | None:
        """True if the motors have torque; None for a hand that can't switch it off."""
        return bool(self.hand.motors.powered.all()) if self.switches else None

    def stick(self, motor: int) -> None:
        """Block a motor."""
        self.hand.motors.stuck.add(motor)

    def slow(self) -> None:
        """Make the motors so slow that even a stalled machine can stop them on their way."""
        looks, motors, begin = itertools.count(1), self.hand.motors, time.monotonic()
        seconds = 0.4 * self.unit / motors.speed.max()  # less than half a unit from look to look
        motors._clock = lambda: min(seconds * next(looks), 0.02 * (time.monotonic() - begin))
        motors._time = 0.0

    def limits(self) -> list[float]:
        """Settings of the driver that a restart deletes; empty if it sets nothing."""
        return []

    def restart(self) -> None:
        """Delete the settings that a restart deletes."""
        self.hand.reboot()

    def lose(self) -> None:
        """Take the hand off its wire, in motion."""
        self.faults.silent = True

    def back(self) -> None:
        """Put it back."""
        self.faults.silent = False

    def close(self) -> None:
        """End."""
        self.served.close()


class OnALine(Rig):
    """A hand on a serial line."""

    settings: Final[dict[str, object]] = {}
    question = b""
    """Question of another program on the line; empty if that is not tried."""

    def serve(self) -> str:
        self.line = self.served.enter_context(SerialLine(self.hand))
        return self.text(self.line.port, **self.settings)

    def lose(self) -> None:
        self.line.unplug()

    def back(self) -> None:
        self.line.plug()


class OnCan(Rig):
    """A hand on a virtual CAN bus, whose name is ``channel``."""

    library = "can"

    def serve(self) -> str:
        import can

        self.channel = f"{self.driver}-{next(_channels)}-{os.getpid()}"
        self.served.enter_context(serve_can(self.hand, can.Bus(self.channel, interface="virtual")))
        return self.text(f"virtual:{self.channel}")


class Packaged(Rig):
    """A hand behind a stand-in of its maker's package."""

    def port(self) -> object:
        """Port in the sink's text."""
        return self.folder / f"tty{self.driver}"

    def modules(self) -> dict[str, types.ModuleType]:
        """Modules of the stand-in."""
        raise NotImplementedError

    def serve(self) -> str:
        for name, module in self.modules().items():
            self.monkeypatch.setitem(sys.modules, name, module)
        return self.text(self.port())


class InspireTcp(Rig):
    driver, library, wrong = "inspire", "pymodbus", ("unit", "short")
    waits = ("modbus_line.TIMEOUT",)
    shift = 0

    def make(self) -> Any:
        return inspire_touch.InspireTouchHand()

    def serve(self) -> str:
        self.served.enter_context(self.hand)
        self.hand.transaction_shift = self.shift
        return self.text(f"127.0.0.1:{self.hand.address[1]}")

    def limits(self) -> list[float]:
        return [self.hand.word(start + 2 * k) for start in (1498, 1522) for k in range(6)]

    def lose(self) -> None:
        super().lose()
        self.hand.hang_up()


class InspireRtu(OnALine, InspireTcp):
    library, wrong = "serial", RtuDevice.WRONG

    def make(self) -> Any:
        return inspire_touch.InspireSerialHand()

    def lose(self) -> None:
        self.line.unplug()


class Linker(OnCan):
    other = "not a left hand, which has the identifier 0x28"
    driver, wrong = "linker", ("identifier", "short")
    model, table = "L20", "linker_l20"

    def make(self) -> Any:
        from simulators.linkerhand_can import LinkerHand

        return LinkerHand(self.model, self.side)

    def text(self, port: object, **settings: object) -> str:
        return super().text(port, model=self.table.removeprefix("linker_"), **settings)

    def limits(self) -> list[float]:
        return [*self.hand.speeds, *self.hand.torques]


class Feetech(OnALine):
    driver, library, prefix = "feetech", "serial", False
    wrong = ("checksum", "identifier", "short")
    waits = ("servo_bank._SLOW_ANSWER_MS",)
    question = feetech_bus.packet(1, feetech_bus.READ, bytes([56, 2]))
    model, middle, unit_name = "sts3215", 2048, "step"

    def make(self) -> Any:
        self.joints = load_hand("inspire_hand", side="right").actuated_names
        return feetech_bus.FeetechBus({k + 1: self.model for k in range(len(self.joints))})

    def text(self, port: object, **settings: object) -> str:
        table = self.folder / "feetech.toml"
        table.write_text(
            f'format = 1\ndriver = "feetech"\nhand = "inspire_hand"\nside = "right"\n'
            f'unit = "{self.unit_name}"\nlimit = 60.0\n'
            + "".join(
                f'[[actuators]]\nname = "{joint}"\nid = {k + 1}\njoint = "{joint}"\n'
                f"zero = {self.middle}\nsign = {1 - 2 * (k % 2)}\n"
                f"ends = [{self.middle // 2}, {self.middle + self.middle // 2}]\n"
                for k, joint in enumerate(self.joints)
            )
        )
        return super().text(port, table=table)

    def watch(self) -> None:
        """Take note of every goal; switching the torque also sets targets of the motors."""
        for servo in self.hand.servos.values():

            def gone(goal: int, servo: Any = servo, go: Callable[[int], None] = servo._go) -> None:
                self.take([servo.number], [goal])
                go(goal)

            self.monkeypatch.setattr(servo, "_go", gone)

    def patience(self, seconds: float) -> None:
        super().patience(1e3 * seconds)

    def powered(self) -> bool:
        return bool(self.hand.motors.powered.any())

    def limits(self) -> list[float]:
        return [servo.word(48) for servo in self.hand.servos.values()]


class FeetechScs(Feetech):
    model, middle, unit_name = "scs0009", 511, "scs_step"

    def limits(self) -> list[float]:
        return []


class Rohand(OnALine):
    driver, library, generation = "rohand", "pymodbus", 2
    table, stand_in, wrong = "rohand", "inspire_hand", RtuDevice.WRONG
    waits = ("modbus_line.TIMEOUT",)
    question = b"\2\3\4\x6f\0\1"
    question += crc(question)

    def make(self) -> Any:
        return rohand_modbus.RoHand(self.generation)

    def limits(self) -> list[float]:
        return [*self.hand.read(1095, 6), *self.hand.read(1115, 5), *self.hand.read(1125, 6)]


class Aero(OnALine):
    driver, library, stand_in, wrong = "aero", "serial", "unitree_dex3", ("short", "operation")
    question = bytes([0x24, *[0] * 15])

    def make(self) -> Any:
        return aero_hand.AeroHand("right")

    def powered(self) -> bool:
        return not self.hand.torque_mode


class Ability(OnALine):
    driver, library, unit, switches, wrong = "ability", "serial", 0.3, True, ("checksum",)
    settings: Final = {"baud": 115200}  # macOS has no other bauds on a pty

    def make(self) -> Any:
        return AbilityHand()


class Dex3(Rig):
    other = "that it is the right one"
    switches = True
    driver, library, unit = "dex3", "cyclonedds", 0.01
    waits = ("_TIMEOUT", "_FINDING_S")

    def make(self) -> Any:
        from simulators.dex3_dds import Dex3Hand

        self.monkeypatch.setenv("CYCLONEDDS_URI", ON_LOOPBACK)
        self.domain = 100 + os.getpid() % 100
        return Dex3Hand(self.side, domain=self.domain)

    def serve(self) -> str:
        self.served.enter_context(self.hand)
        return f"dex3:side=right,domain={self.domain}"


ON_LOOPBACK: Final = """<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface
address="127.0.0.1"/></Interfaces></General></Domain></CycloneDDS>"""
"""Settings of CycloneDDS, for a network that other programs of this machine only can reach."""


class XHand(Packaged):
    other = "is a left hand"
    driver, unit, wrong, stand_in = "xhand", 0.01, ("error",), "tesollo_dg5f"
    waits = ()

    def make(self) -> Any:
        return xhand_sdk.XHand(self.side, str(self.port()), 7)

    def modules(self) -> dict[str, types.ModuleType]:
        return xhand_sdk.xhand_modules(self.hand)


class DexHand021(OnCan):
    other = "that it is not a left hand"
    switches = True
    driver, unit, stand_in = "dexhand021", 0.3, "tesollo_dg5f"
    wrong = ("identifier", "short")

    def make(self) -> Any:
        from simulators.dexhand021_can import DexHand021 as SimulatedDexHand

        return SimulatedDexHand(self.side)


class Wuji2(Packaged):
    other = "is a left hand"
    switches = True
    driver, unit, wrong, stand_in = "wuji2", 0.01, ("missing",), "wuji_hand"
    reports = True  # a joint that is missing in a frame has no position

    def make(self) -> Any:
        letter = "J" if self.side == "left" else "K"
        return wuji_sdk.Hand(self.side, f"WH2{letter}{next(_channels):07d}")

    def port(self) -> object:
        return self.hand.sn

    def modules(self) -> dict[str, types.ModuleType]:
        return wuji_sdk.wuji_modules(self.hand)

    def limits(self) -> list[float]:
        return list(self.hand.effort_limits)

    def restart(self) -> None:
        self.hand.effort_limits = [1.5] * 20


class Revo3(Packaged):
    other = "is a left hand"
    driver, unit, wrong, stand_in = "revo3", 0.3, ("timeout", "fault"), "sharpa_wave"

    def make(self) -> Any:
        return revo3_sdk.Revo3(self.side, str(self.port()))

    def modules(self) -> dict[str, types.ModuleType]:
        return revo3_sdk.revo3_modules(self.hand)

    def powered(self) -> bool:
        return bool(self.hand.sent) and bool(self.hand.motors.powered.all())


class OnUsb(Packaged):
    """A hand whose stand-in can be unplugged."""

    def lose(self) -> None:
        self.hand.plugged_in = False

    def back(self) -> None:
        self.hand.plugged_in = True


class Wuji(OnUsb):
    other = "is a left hand"
    driver, unit, switches, wrong = "wuji", 0.01, True, ("not finite",)
    waits = ()

    def make(self) -> Any:
        return WujiWorld(1 if self.side == "left" else 0)

    def port(self) -> object:
        return f"{self.folder.name}-{os.getpid()}"  # a serial number of its own

    def modules(self) -> dict[str, types.ModuleType]:
        return {"wujihandpy": self.hand.module}

    def limits(self) -> list[float]:
        return self.hand.effort_limit.ravel().tolist()

    def restart(self) -> None:
        self.hand.effort_limit = np.full((5, 4), 1.5)


class Revo2(OnUsb):
    other = "is a left hand"
    driver, wrong = "revo2", ("not a position",)

    def make(self) -> Any:
        world = StarkWorld(left=self.side == "left")
        world.number = 0x7F  # also of a left hand, so that its type tells the side
        return world

    def modules(self) -> dict[str, types.ModuleType]:
        return {"bc_stark_sdk": self.hand.package, "bc_stark_sdk.main_mod": self.hand.main_mod}

    def limits(self) -> list[float]:
        return [0.0 if self.hand.unit is None else float(self.hand.unit is FingerUnitMode.Physical)]

    def restart(self) -> None:
        self.hand.unit = FingerUnitMode.Physical


class Revo2Real(OnALine):
    """With the maker's real package, on a line."""

    driver, library, wrong = "revo2", "bc_stark_sdk", RtuDevice.WRONG

    def make(self) -> Any:
        return Revo2Hand()

    def limits(self) -> list[float]:
        return [float(self.hand.unit_mode or 0)]

    def restart(self) -> None:
        self.hand.unit_mode = 1 - int(self.hand.unit_mode or 0)


class Allegro(Rig):
    other = "is a left hand"
    driver, library, unit, reports = "allegro", "can", 0.06, True
    waits = ("_LATE_S", "_STALE_S", "_OPENING_S")
    version = "v5"
    table = "allegro_v5"

    def make(self) -> Any:
        self.channel = f"allegro-{next(_channels)}-{os.getpid()}"
        hand = AllegroHand(self.channel, self.version, left=self.side == "left")
        clock = types.SimpleNamespace(perf_counter=lambda: hand.now, sleep=time.sleep)
        self.monkeypatch.setattr(f"{DRIVERS}.allegro.time", clock)
        self.served.callback(hand.close)
        return hand

    def watch(self) -> None:
        """The hand gets no positions, but torques."""
        self.sent = self.hand.torques

    def serve(self) -> str:
        return self.text(f"virtual:{self.channel}", table=self.table)

    def positions(self) -> np.ndarray:
        return self.hand.position.copy()

    def outside(self) -> int:
        """Torques above the table's limit."""
        return int(self.hand.largest_torque > (150 if self.version == "v5" else 300))

    def powered(self) -> bool:
        return bool(self.hand.servo_on)

    def restart(self) -> None:
        self.hand.period_s, self.hand.servo_on = 0.0, False

    def stick(self, motor: int) -> None:
        self.hand.stuck.add(motor)

    def slow(self) -> None:
        self.hand.friction *= 8


class Leap(Rig):
    driver, library, unit, wrong = "leap", "dynamixel_sdk", 0.01, ("checksum",)
    waits = ("servo_bank._SLOW_ANSWER_MS",)
    prefix = False

    def make(self) -> Any:
        from dynamixel_bank import ServoBank

        return ServoBank(list(range(16)))

    def watch(self) -> None:
        self.hand.aimed = lambda goals: self.take(
            range(len(goals)), RADIAN * np.array([*goals.values()])
        )

    def serve(self) -> str:
        self.served.callback(self.hand.unplug)
        return self.text(self.hand.path, baud=57600)

    def patience(self, seconds: float) -> None:
        super().patience(1e3 * seconds)

    def positions(self) -> np.ndarray:
        return RADIAN * np.array([servo.position for servo in self.hand.servos.values()])

    def powered(self) -> bool:
        return any(servo.torque for servo in self.hand.servos.values())

    def stick(self, motor: int) -> None:
        self.hand.servos[motor].stop = self.hand.servos[motor].position

    def slow(self) -> None:
        for servo in self.hand.servos.values():
            servo.speed = 30.0

    def limits(self) -> list[float]:
        return [servo.get(at, 2) for servo in self.hand.servos.values() for at in (84, 102)]

    def restart(self) -> None:
        for servo in self.hand.servos.values():
            servo.restart()

    def lose(self) -> None:
        self.hand.line.unplug()

    def back(self) -> None:
        self.hand.line.plug()


RADIAN: Final = 2 * np.pi / 4096
"""Radians of a step of a Dynamixel servo."""


def variant(kind: type[Rig], **attributes: object) -> type[Rig]:
    """A rig that differs from another in some attributes."""
    return type(kind.__name__, (kind,), attributes)


RIGS: Final[dict[str, type[Rig]]] = {
    "inspire": InspireTcp,
    "inspire-rtu": InspireRtu,
    # With touch pads, and answers whose transaction number is off by one.
    "inspire-touch": variant(InspireTcp, table="inspire_ftp", stand_in="inspire_hand", shift=1),
    "linker-l20": Linker,
    "linker-l10": variant(Linker, model="L10", table="linker_l10"),
    "linker-o6": variant(Linker, model="O6", table="linker_o6", stand_in="inspire_hand"),
    "linker-l21": variant(Linker, model="L21", table="linker_l21", stand_in="tesollo_dg5f"),
    "rohand": Rohand,
    "rohand-gen1": variant(Rohand, table="rohand_gen1", generation=1),
    "aero": Aero,
    "dex3": Dex3,
    "xhand": XHand,
    "dexhand021": DexHand021,
    "wuji2": Wuji2,
    "revo3": Revo3,
    "allegro-v5": Allegro,
    "allegro-v4": variant(Allegro, version="v4", table="allegro"),
    "ability": Ability,
    "leap": Leap,
    "feetech-sts": Feetech,
    "feetech-scs": FeetechScs,
    "wuji": Wuji,
    "revo2": Revo2,
    "revo2-sdk": Revo2Real,
}
"""Name -> a driver with its simulator."""

LINKER_HANDS: Final = {
    "linker-l6": variant(Linker, model="L6", table="linker_l6"),
    "linker-l7": variant(Linker, model="L7", table="linker_l7"),
    "linker-l20lite": variant(Linker, model="L20 lite", table="linker_l20lite"),
    "linker-l25": variant(Linker, model="L25", table="linker_l25"),
}
"""Further models, for tests of their frames."""


def missing(name: str) -> str:
    """Why a rig can't be used here; empty if it can."""
    kind = RIGS.get(name) or LINKER_HANDS[name]
    if kind.library and importlib.util.find_spec(kind.library) is None:
        return f"needs {kind.library}"
    on_a_pty = issubclass(kind, OnALine | Leap)
    return "needs a pty" if on_a_pty and sys.platform == "win32" else ""
