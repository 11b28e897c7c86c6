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
from hand_servos import Faults
from inspire_simulator import InspireHand, RtuServer, TcpServer
from revo2_simulator import Revo2Hand
from simulators.common import SerialLine, serve_can

from smooth_operator import load_hand
from smooth_operator.teleop.components import build_sink
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table, write_table
from smooth_operator_devices.hands.hardware_sink import HardwareSink

_channels = itertools.count()


class Rig:
    """A simulated hand, and what is needed to reach it.

    Attributes:
        driver: name of the driver.
        sink: text of the sink, without settings.
        faults: what the simulated device does wrong.
        unit: how near a motor comes to its command, in the commands' unit.
        moved: what came over the wire that makes the hand move, counted.
    """

    driver: str = ""
    library: str = ""
    unit: float = 1.0
    module: str = ""
    """Module of the driver's times; that of the driver if it is empty."""
    waits: tuple[str, ...] = ("_TIMEOUT",)
    """Names of the driver's times."""
    reports = False
    """True for a hand that reports its positions without a question."""
    delay_s = 0.01
    """A delay that the driver must bear."""
    prefix = True
    """True if messages begin with the name of the driver."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.monkeypatch = folder, monkeypatch
        self.sink = self.driver
        self.hand: Any = None
        self.start()

    @property
    def faults(self) -> Faults:
        return self.hand.faults

    def patience(self, seconds: float) -> None:
        """Set the time that the driver waits for an answer [s], before it is opened."""
        module = f"smooth_operator_devices.hands.drivers.{self.module or self.driver}"
        for name in self.waits:
            self.monkeypatch.setattr(f"{module}.{name}", seconds)

    def build(self, **settings: object) -> HardwareSink:
        """The sink, with fast motion unless told otherwise."""
        values = {"approach": 50.0, "speed": 50.0, **settings}
        joint = "," if ":" in self.sink else ":"
        return build_sink(
            self.sink + joint + ",".join(f"{name}={value}" for name, value in values.items())
        )

    def positions(self) -> np.ndarray:
        """Positions of the motors, in the unit of the commands."""
        return self.hand.servos.positions()

    def near(self, commands: np.ndarray) -> bool:
        """True if the motors have reached their commands."""
        return bool(np.abs(self.positions() - commands).max() <= 2 * self.unit)

    def outside(self) -> int:
        """Number of targets beyond the ends."""
        return len(self.hand.servos.outside)

    def targets(self) -> int:
        """Number of targets."""
        return len(self.hand.servos.targets)

    def powered(self) -> bool | None:
        """True if the motors have torque; None for a hand that can't switch it off."""
        return None

    def stick(self, motor: int) -> None:
        """Block a motor."""
        self.hand.servos.stuck.add(motor)

    def slow(self) -> None:
        """Make the motors so slow that even a stalled machine can stop them on their way."""
        self.hand.servos.moves_when_looked_at(1e-4)

    def watch_targets(self, look: Callable[[np.ndarray, np.ndarray], None]) -> None:
        """Call a function with each target, and the positions of the motors at that time."""
        servos = self.hand.servos
        aim = servos.aim

        def aimed(target: Any) -> None:
            look(np.array(target, float), servos.positions())
            aim(target)

        self.monkeypatch.setattr(servos, "aim", aimed)

    def limits(self) -> list[float]:
        """Settings of the driver that a restart deletes; empty if it sets nothing."""
        return []

    def restart(self) -> None:
        """Delete the settings that a restart deletes, and nothing else."""
        raise NotImplementedError

    def start(self) -> None:
        """Put the hand on its wire."""
        raise NotImplementedError

    def lose(self) -> None:
        """Take the hand off its wire, in motion."""
        self.faults.mute = True

    def back(self) -> None:
        """Put it back."""
        self.faults.mute = False

    def close(self) -> None:
        """End."""
        self.hand.close()


class Packaged(Rig):
    """A hand behind a stand-in of its maker's package."""

    def lose(self) -> None:
        self.hand.plugged_in = False

    def back(self) -> None:
        self.hand.plugged_in = True

    def close(self) -> None:
        """There is nothing to close."""


class InspireTcp(Rig):
    driver, library = "inspire", "pymodbus"
    module, waits = "modbus_line", ("TIMEOUT",)

    def start(self) -> None:
        self.hand = self.hand or InspireHand()
        self.server: Any = TcpServer(self.hand)
        self.sink = f"inspire:127.0.0.1:{self.server.port}"

    def limits(self) -> list[float]:
        return [*self.hand.force_limit, *self.hand.speed]

    def restart(self) -> None:
        self.hand.force_limit, self.hand.speed = [1000] * 6, [1000] * 6

    def lose(self) -> None:
        super().lose()
        self.server.drop()

    def close(self) -> None:
        self.server.close()


class InspireRtu(InspireTcp):
    library = "serial"

    def start(self) -> None:
        self.hand = self.hand or InspireHand()
        self.server = RtuServer(self.hand)
        self.sink = f"inspire:{_linked(self.folder / 'ttyHand', self.server.port)}"

    def lose(self) -> None:
        self.server.close()

    def back(self) -> None:
        self.start()


class SimulatedFaults(Faults):
    """Faults of a hand of ``simulators``, in the form of the other rigs.

    Args:
        wrong: kind of the wrong answers.
    """

    def __init__(self, wrong: str) -> None:
        super().__init__()
        self.wrong = wrong

    @property
    def silent(self) -> bool:
        return self.mute

    def next_wrong(self) -> str | None:
        """Fault of the answer that is being sent."""
        time.sleep(self.delay_s)
        return self.wrong if self.garble else None


class Simulated(Rig):
    """A hand of ``simulators``, which has ``motors``."""

    wrong = "short"
    """Kind of its wrong answers."""
    switches = False
    """True for a hand that can switch its torque off."""

    def simulate(self, hand: Any) -> None:
        """Take a simulated hand as that of the rig."""
        self.hand, self.sent = hand, []
        self.served = contextlib.ExitStack()
        hand.faults = SimulatedFaults(self.wrong)
        self._looks: list[Callable[[np.ndarray, np.ndarray], None]] = []
        self.watch(hand)

    def watch(self, hand: Any) -> None:
        """Take note of every target."""
        move = hand.motors.move

        def moved(targets: Any, motors: Any = None) -> None:
            targets = list(targets)
            self.take(range(len(hand.motors)) if motors is None else list(motors), targets)
            move(targets, motors)

        self.monkeypatch.setattr(hand.motors, "move", moved)

    def take(self, motors: Sequence[int], targets: Sequence[float]) -> None:
        """Take note of targets of motors; NaN for the others."""
        row = np.full(len(self.hand.motors), np.nan)
        row[motors] = targets
        for look in self._looks:
            look(row, self.positions())
        self.sent.append(row)

    def positions(self) -> np.ndarray:
        return self.hand.motors.positions

    def outside(self) -> int:
        ends = np.array([a.ends for a in self.build().actuators("right").actuators])
        low, high = ends.T + np.array([[-self.unit], [self.unit]])
        return sum(bool(((row < low) | (row > high)).any()) for row in self.sent)

    def targets(self) -> int:
        return len(self.sent)

    def powered(self) -> bool | None:
        return bool(self.hand.motors.powered.all()) if self.switches else None

    def restart(self) -> None:
        self.hand.reboot()

    def close(self) -> None:
        self.served.close()

    def stick(self, motor: int) -> None:
        self.hand.motors.stuck.add(motor)

    def slow(self) -> None:
        looks, motors = itertools.count(1), self.hand.motors
        seconds = 0.4 * self.unit / motors.speed.max()  # less than half a unit from look to look
        motors._clock, motors._time = lambda: seconds * next(looks), 0.0

    def watch_targets(self, look: Callable[[np.ndarray, np.ndarray], None]) -> None:
        self._looks.append(look)

    def on_another_hand(self, table: str, hand: str) -> str:
        """File of a table with the joints of a hand of the catalogue; for a hand that is not in
        it."""
        joints = load_hand(hand, side="right").actuated_names
        made = read_table(built_in_tables() / f"{table}_right.toml")
        pairs = zip(made.actuators, joints, strict=False)
        actuators = tuple(replace(each, joints={joint: 1.0}) for each, joint in pairs)
        path = self.folder / f"{table}.toml"
        write_table(replace(made, hand=hand, actuators=actuators), path)
        return str(path)


class InspireTouch(Simulated):
    """A hand with touch pads, whose answers have a transaction number that is off by one."""

    driver, library = "inspire", "pymodbus"
    module, waits = "modbus_line", ("TIMEOUT",)

    def start(self) -> None:
        from simulators.inspire_touch import InspireTouchHand

        self.simulate(InspireTouchHand())
        self.served.enter_context(self.hand)
        self.hand.transaction_shift = 1
        table = self.on_another_hand("inspire_ftp", "inspire_hand")
        self.sink = f"inspire:127.0.0.1:{self.hand.address[1]},table={table}"

    def limits(self) -> list[float]:
        return [self.hand.word(start + 2 * k) for start in (1498, 1522) for k in range(6)]

    def lose(self) -> None:
        super().lose()
        self.hand.hang_up()


class Linker(Simulated):
    driver, library = "linker", "can"
    model, name, stand_in = "l20", "L20", ""

    def start(self) -> None:
        import can
        from simulators.linkerhand_can import LinkerHand

        self.channel = f"linker-{next(_channels)}-{os.getpid()}"
        self.simulate(LinkerHand(self.name, "right"))
        self.served.enter_context(serve_can(self.hand, can.Bus(self.channel, interface="virtual")))
        self.sink = f"linker:virtual:{self.channel},model={self.model}"
        if self.stand_in:
            table = self.on_another_hand(f"linker_{self.model}", self.stand_in)
            self.sink += f",table={table}"

    def limits(self) -> list[float]:
        return [*self.hand.speeds, *self.hand.torques]


class LinkerL10(Linker):
    model, name = "l10", "L10"


class LinkerO6(Linker):
    model, name, stand_in = "o6", "O6", "inspire_hand"


class LinkerL21(Linker):
    model, name, stand_in = "l21", "L21", "tesollo_dg5f"


class OnALine(Simulated):
    """A simulated hand on a serial line."""

    def serve(self, hand: Any, **settings: object) -> None:
        """Put a hand on a line, for a sink with these settings."""
        self.simulate(hand)
        self.line = self.served.enter_context(SerialLine(hand))
        words = [f"{self.driver}:{self.line.port}", *(f"{k}={v}" for k, v in settings.items())]
        self.sink = ",".join(words)

    def lose(self) -> None:
        self.line.unplug()

    def back(self) -> None:
        self.line.plug()


class Feetech(OnALine):
    driver, library, wrong, prefix = "feetech", "serial", "checksum", False
    model, goal, unit_name, stand_in = "sts3215", 2048, "step", "leap_hand"

    def start(self) -> None:
        from simulators.feetech_bus import FeetechBus

        joints = load_hand(self.stand_in, side="right").actuated_names
        table = self.folder / "feetech.toml"
        table.write_text(
            f'format = 1\ndriver = "feetech"\nhand = "{self.stand_in}"\nside = "right"\n'
            f'unit = "{self.unit_name}"\nlimit = 60.0\n'
            + "".join(
                f'[[actuators]]\nname = "{joint}"\nid = {k + 1}\njoint = "{joint}"\n'
                f"zero = {self.goal}\nsign = {1 - 2 * (k % 2)}\n"
                f"ends = [{self.goal // 2}, {self.goal + self.goal // 2}]\n"
                for k, joint in enumerate(joints)
            )
        )
        self.serve(FeetechBus({k + 1: self.model for k in range(len(joints))}), table=table)

    def watch(self, hand: Any) -> None:
        """Take note of every goal; switching the torque also sets targets of the motors."""
        for servo in hand.servos.values():
            self._watch_servo(servo, servo._go)

    def _watch_servo(self, servo: Any, go: Callable[[int], None]) -> None:
        def gone(goal: int) -> None:
            self.take([servo.number], [goal])
            go(goal)

        self.monkeypatch.setattr(servo, "_go", gone)

    def patience(self, seconds: float) -> None:
        module = "smooth_operator_devices.hands.drivers.servo_bank"
        self.monkeypatch.setattr(f"{module}._SLOW_ANSWER_MS", 1e3 * seconds)

    def powered(self) -> bool:
        return bool(self.hand.motors.powered.any())

    def limits(self) -> list[float]:
        return [servo.word(48) for servo in self.hand.servos.values()]


class FeetechScs(Feetech):
    model, goal, unit_name, stand_in = "scs0009", 511, "scs_step", "inspire_hand"

    def limits(self) -> list[float]:
        return []


class Rohand(OnALine):
    driver, library, generation = "rohand", "pymodbus", 2
    module, waits = "modbus_line", ("TIMEOUT",)

    def start(self) -> None:
        from simulators.rohand_modbus import RoHand

        name = "rohand" if self.generation == 2 else "rohand_gen1"
        self.serve(RoHand(self.generation), table=self.on_another_hand(name, "inspire_hand"))

    def limits(self) -> list[float]:
        return [*self.hand.read(1095, 6), *self.hand.read(1115, 5), *self.hand.read(1125, 6)]


class RohandGen1(Rohand):
    generation = 1


class Aero(OnALine):
    driver, library = "aero", "serial"

    def start(self) -> None:
        from simulators.aero_hand import AeroHand

        table = self.on_another_hand("aero", "unitree_dex3")
        self.serve(AeroHand("right"), table=table)

    def powered(self) -> bool:
        return not self.hand.torque_mode


class Dex3(Simulated):
    switches = True
    driver, library, unit = "dex3", "cyclonedds", 0.01
    waits = ("_TIMEOUT", "_FINDING_S")

    def start(self) -> None:
        from simulators.dex3_dds import Dex3Hand

        self.monkeypatch.setenv("CYCLONEDDS_URI", ON_LOOPBACK)
        domain = 100 + os.getpid() % 100
        self.simulate(Dex3Hand("right", domain=domain))
        self.served.enter_context(self.hand)
        self.sink = f"dex3:side=right,domain={domain}"


ON_LOOPBACK: Final = """<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface
address="127.0.0.1"/></Interfaces></General></Domain></CycloneDDS>"""
"""Settings of CycloneDDS, for a network that other programs of this machine only can reach."""


class XHand(Simulated):
    driver, unit, wrong = "xhand", 0.01, "error"
    waits = ()

    def start(self) -> None:
        from simulators.xhand_sdk import XHand as SimulatedXHand
        from simulators.xhand_sdk import xhand_modules

        port = str(self.folder / "ttyXHand")
        self.simulate(SimulatedXHand("right", port, 7))
        for name, module in xhand_modules(self.hand).items():
            self.monkeypatch.setitem(sys.modules, name, module)
        self.sink = f"xhand:{port},table={self.on_another_hand('xhand', 'tesollo_dg5f')}"


class DexHand021(Simulated):
    switches = True
    driver, library, unit = "dexhand021", "can", 0.3

    def start(self) -> None:
        import can
        from simulators.dexhand021_can import DexHand021 as SimulatedDexHand

        channel = f"dexhand-{next(_channels)}-{os.getpid()}"
        self.simulate(SimulatedDexHand("right"))
        self.served.enter_context(serve_can(self.hand, can.Bus(channel, interface="virtual")))
        table = self.on_another_hand("dexhand021", "tesollo_dg5f")
        self.sink = f"dexhand021:virtual:{channel},table={table}"


class Wuji2(Simulated):
    switches = True
    driver, unit, wrong = "wuji2", 0.01, "missing"
    reports = True  # a joint that is missing in a frame has no position

    def start(self) -> None:
        from simulators.wuji_sdk import Hand as SimulatedWuji
        from simulators.wuji_sdk import wuji_modules

        self.simulate(SimulatedWuji("right", f"WH2K{next(_channels):07d}"))
        self.monkeypatch.setitem(sys.modules, "wuji_sdk", wuji_modules(self.hand)["wuji_sdk"])
        self.sink = f"wuji2:{self.hand.sn},table={self.on_another_hand('wuji2', 'wuji_hand')}"

    def limits(self) -> list[float]:
        return list(self.hand.effort_limits)

    def restart(self) -> None:
        self.hand.effort_limits = [1.5] * 20


class Revo3(Simulated):
    driver, unit, wrong = "revo3", 0.3, "timeout"

    def start(self) -> None:
        from simulators.revo3_sdk import Revo3 as SimulatedRevo3
        from simulators.revo3_sdk import revo3_modules

        port = str(self.folder / "ttyRevo3")
        self.simulate(SimulatedRevo3("right", port))
        for name, module in revo3_modules(self.hand).items():
            self.monkeypatch.setitem(sys.modules, name, module)
        self.sink = f"revo3:{port},table={self.on_another_hand('revo3', 'sharpa_wave')}"

    def powered(self) -> bool:
        return bool(self.hand.sent) and bool(self.hand.motors.powered.all())


class Allegro(Rig):
    driver, library, unit, reports = "allegro", "can", 0.06, True
    waits = ("_LATE_S", "_STALE_S", "_OPENING_S")
    version = "v5"
    table = "allegro_v5"

    def start(self) -> None:
        self.channel = f"allegro-{next(_channels)}-{os.getpid()}"
        self.hand = AllegroHand(self.channel, self.version)
        clock = types.SimpleNamespace(perf_counter=lambda: self.hand.now, sleep=time.sleep)
        self.monkeypatch.setattr("smooth_operator_devices.hands.drivers.allegro.time", clock)
        self.sink = f"allegro:virtual:{self.channel},table={self.table}"

    def positions(self) -> np.ndarray:
        return self.hand.position.copy()

    def outside(self) -> int:
        """Torques above the table's limit: the hand is sent no positions."""
        return int(self.hand.largest_torque > (150 if self.version == "v5" else 300))

    def targets(self) -> int:
        return int(self.hand.torque_frames) if any(self.hand.switched) else 0

    def powered(self) -> bool:
        return bool(self.hand.servo_on)

    def restart(self) -> None:
        self.hand.period_s, self.hand.servo_on = 0.0, False

    def stick(self, motor: int) -> None:
        self.hand.stuck.add(motor)

    def slow(self) -> None:
        self.hand.friction *= 8


class AllegroV4(Allegro):
    version, table = "v4", "allegro"


class Ability(Rig):
    driver, library, unit = "ability", "serial", 0.3

    def start(self) -> None:
        self.hand = AbilityHand()
        port = _linked(self.folder / "ttyAbility", self.hand.port)
        self.sink = f"ability:{port},baud=115200"  # macOS has no other bauds on a pty

    def powered(self) -> bool:
        return bool(self.hand.servos.powered)

    def lose(self) -> None:
        self.hand.close()

    def back(self) -> None:
        self.start()


class Leap(Rig):
    driver, library, unit = "dynamixel", "dynamixel_sdk", 0.01
    prefix = False

    def start(self) -> None:
        from dynamixel_bank import ServoBank

        self.hand = ServoBank(list(range(16)))
        self.port = str(self.folder / "ttyLeap")
        self.lose()
        self.back()
        self.sink = f"leap:{self.port},baud=57600"

    def patience(self, seconds: float) -> None:
        module = "smooth_operator_devices.hands.drivers.servo_bank"
        module = "smooth_operator_devices.hands.drivers.servo_bank"
        self.monkeypatch.setattr(f"{module}._SLOW_ANSWER_MS", 1e3 * seconds)

    def positions(self) -> np.ndarray:
        return RADIAN * np.array([servo.position for servo in self.hand.servos.values()])

    def outside(self) -> int:
        ends = np.array([a.ends for a in self.build().actuators("right").actuators]) / RADIAN
        goals = np.array([list(goals.values()) for goals in self.hand.goals if len(goals) == 16])
        return int(((goals < ends[:, 0] - 1) | (goals > ends[:, 1] + 1)).any(axis=1).sum())

    def targets(self) -> int:
        return len(self.hand.goals)

    def powered(self) -> bool:
        return any(servo.torque for servo in self.hand.servos.values())

    def stick(self, motor: int) -> None:
        self.hand.servos[motor].stop = self.hand.servos[motor].position

    def slow(self) -> None:
        for servo in self.hand.servos.values():
            servo.speed = 30.0

    def watch_targets(self, look: Callable[[np.ndarray, np.ndarray], None]) -> None:
        self.hand.aimed = lambda goals: look(RADIAN * np.array([*goals.values()]), self.positions())

    def limits(self) -> list[float]:
        return [servo.get(at, 2) for servo in self.hand.servos.values() for at in (84, 102)]

    def restart(self) -> None:
        for servo in self.hand.servos.values():
            servo.restart()

    def lose(self) -> None:
        self.hand.unplug()

    def back(self) -> None:
        self.hand.plug(self.port)

    def close(self) -> None:
        self.hand.unplug()


RADIAN: Final = 2 * np.pi / 4096
"""Radians of a step of a Dynamixel servo."""


class Wuji(Packaged):
    driver, unit = "wuji", 0.01
    waits = ()

    def start(self) -> None:
        self.hand = self.hand or WujiWorld()
        self.sink = f"wuji:{self.folder.name}-{os.getpid()}"  # a serial number of its own
        self.monkeypatch.setitem(sys.modules, "wujihandpy", self.hand.module)

    def powered(self) -> bool:
        return bool(self.hand.servos.powered)

    def limits(self) -> list[float]:
        return self.hand.effort_limit.ravel().tolist()

    def restart(self) -> None:
        self.hand.effort_limit = np.full((5, 4), 1.5)


class Revo2(Packaged):
    driver = "revo2"

    def start(self) -> None:
        self.hand = self.hand or StarkWorld()
        self.sink = f"revo2:{self.folder / 'ttyRevo2'}"
        self.monkeypatch.setitem(sys.modules, "bc_stark_sdk", self.hand.package)
        self.monkeypatch.setitem(sys.modules, "bc_stark_sdk.main_mod", self.hand.main_mod)

    def limits(self) -> list[float]:
        return [0.0 if self.hand.unit is None else float(self.hand.unit is FingerUnitMode.Physical)]

    def restart(self) -> None:
        self.hand.unit = FingerUnitMode.Physical


class Revo2Real(InspireRtu):
    """With the maker's real package, on a line."""

    driver, library = "revo2", "bc_stark_sdk"

    def start(self) -> None:
        self.hand = self.hand or Revo2Hand()
        self.server = RtuServer(self.hand)
        self.sink = f"revo2:{_linked(self.folder / 'ttyRevo2', self.server.port)}"

    def limits(self) -> list[float]:
        return [float(self.hand.unit_mode or 0)]

    def restart(self) -> None:
        self.hand.unit_mode = 1 - int(self.hand.unit_mode or 0)


def _linked(link: Path, port: str) -> Path:
    """A fixed name for a port that changes when the adapter is plugged in again, as udev's."""
    link.unlink(missing_ok=True)
    link.symlink_to(port)
    return link


RIGS: Final[dict[str, Callable[[Path, pytest.MonkeyPatch], Rig]]] = {
    "inspire": InspireTcp,
    "inspire-rtu": InspireRtu,
    "inspire-touch": InspireTouch,
    "linker-l20": Linker,
    "linker-l10": LinkerL10,
    "linker-o6": LinkerO6,
    "linker-l21": LinkerL21,
    "rohand": Rohand,
    "rohand-gen1": RohandGen1,
    "aero": Aero,
    "dex3": Dex3,
    "xhand": XHand,
    "dexhand021": DexHand021,
    "wuji2": Wuji2,
    "revo3": Revo3,
    "allegro-v5": Allegro,
    "allegro-v4": AllegroV4,
    "ability": Ability,
    "leap": Leap,
    "feetech-sts": Feetech,
    "feetech-scs": FeetechScs,
    "wuji": Wuji,
    "revo2": Revo2,
    "revo2-sdk": Revo2Real,
}
"""Name -> a driver with its simulator."""

ON_A_PTY: Final = (
    *("inspire-rtu", "ability", "leap", "revo2-sdk"),
    *("feetech-sts", "feetech-scs"),
    *("rohand", "rohand-gen1", "aero"),
)


def missing(name: str) -> str:
    """Why a rig can't be used here; empty if it can."""
    library = RIGS[name].library
    if library and importlib.util.find_spec(library) is None:
        return f"needs {library}"
    return "needs a pty" if name in ON_A_PTY and sys.platform == "win32" else ""
