"""Stand-ins for two makers' packages, ``wujihandpy`` and ``bc_stark_sdk``, with a simulated hand.

They have the calls that our drivers use, with the names, parameters and results of the real ones;
``test_hand_protocols.py`` compares them with the real packages where those are installed.
"""

import asyncio
import enum
import time
import types
from typing import Any

import numpy as np
from hand_servos import Faults, Servos

WUJI_LOWER, WUJI_UPPER = np.full(20, -0.5), np.full(20, 1.62)


class WujiWorld:
    """A simulated hand on USB; ``module`` stands for ``wujihandpy``."""

    def __init__(self, handedness: int = 0) -> None:
        self.servos = Servos([0.1] * 20, speed=20.0, lower=WUJI_LOWER, upper=WUJI_UPPER)
        self.servos.powered = False
        self.faults = Faults()
        self.plugged_in = True
        self.handedness = handedness
        self.effort_limit = np.full((5, 4), 1.5)
        self.codes = np.zeros((5, 4), np.uint32)
        self.switched: list[bool] = []
        self.module = types.ModuleType("wujihandpy")
        self.module.logging = types.SimpleNamespace(set_log_to_console=lambda value: None)
        self.module.filter = types.SimpleNamespace(LowPass=WujiLowPass)
        world = self

        class Hand(WujiHand):
            def __init__(
                self,
                serial_number: str | None = None,
                usb_pid: int = 8192,
                usb_vid: int = 1155,
                mask: Any = None,
            ) -> None:
                super().__init__(world)

        self.module.Hand = Hand

    def touch(self) -> None:
        """Every call passes here."""
        if not self.plugged_in:
            raise ConnectionError("device disconnected")
        if self.faults.delay_s:
            time.sleep(self.faults.delay_s)
        if self.faults.mute or self.faults.refuse:
            raise TimeoutError("SDO operation timeout")


class WujiLowPass:
    def __init__(self, cutoff_freq: float = 10.0) -> None:
        self.cutoff = cutoff_freq


class WujiController:
    def __init__(self, world: WujiWorld) -> None:
        self.world = world

    def set_joint_target_position(self, value_array: Any) -> None:
        self.world.touch()
        assert np.shape(value_array) == (5, 4)
        self.world.servos.aim(np.asarray(value_array).ravel().tolist())

    def get_joint_actual_position(self) -> np.ndarray:
        self.world.touch()
        if self.world.faults.garble:
            return np.full((5, 4), np.nan)
        return self.world.servos.positions().reshape(5, 4)

    def get_joint_actual_effort(self) -> np.ndarray:
        self.world.touch()
        return np.clip(self.world.servos.load(), -1.5, 1.5).reshape(5, 4)

    def close(self) -> None:
        self.world.touch()


class WujiHand:
    def __init__(self, world: WujiWorld) -> None:
        if not world.plugged_in:
            raise ConnectionError("Failed to init.")
        self.world = world

    def read_handedness(self, timeout: float = 0.5) -> np.uint8:
        self.world.touch()
        return np.uint8(self.world.handedness)

    def read_joint_actual_position(self, timeout: float = 0.5) -> np.ndarray:
        return WujiController(self.world).get_joint_actual_position()

    def read_joint_temperature(self, timeout: float = 0.5) -> np.ndarray:
        self.world.touch()
        return np.full((5, 4), 41.0, np.float32)

    def read_joint_error_code(self, timeout: float = 0.5) -> np.ndarray:
        self.world.touch()
        return self.world.codes

    def read_joint_effort_limit(self, timeout: float = 0.5) -> np.ndarray:
        self.world.touch()
        return self.world.effort_limit.copy()

    def write_joint_effort_limit(self, value_array: Any, timeout: float = 0.5) -> None:
        self.world.touch()
        self.world.effort_limit = np.asarray(value_array, float)

    def write_joint_target_position(self, value_array: Any, timeout: float = 0.5) -> None:
        WujiController(self.world).set_joint_target_position(value_array)

    def write_joint_enabled(self, value: bool, timeout: float = 0.5) -> None:
        self.world.touch()
        self.world.servos.positions()
        self.world.servos.powered = value
        self.world.switched.append(value)

    def realtime_controller(self, enable_upstream: bool, filter: Any) -> WujiController:
        self.world.touch()
        assert isinstance(filter, WujiLowPass)
        return WujiController(self.world)


class Baudrate(enum.Enum):
    Baud115200 = 0
    Baud460800 = 3
    Baud1Mbps = 4


class FingerUnitMode(enum.Enum):
    Normalized = 0
    Physical = 1


class HandType(enum.Enum):
    Left = 0
    Right = 1


class MotorState(enum.Enum):
    Unknown = 0
    Idle = 1
    Running = 2
    Stall = 3
    Turbo = 4


class StarkWorld:
    """A simulated hand on a serial line; ``main_mod`` stands for the module of that name."""

    def __init__(self, left: bool = False) -> None:
        self.servos = Servos([0.0] * 6, speed=8000.0, lower=0.0, upper=1000.0)
        self.faults = Faults()
        self.plugged_in = True
        self.number = 0x7E if left else 0x7F
        self.type = HandType.Left if left else HandType.Right
        self.unit: FingerUnitMode | None = None
        self.units: list[FingerUnitMode | None] = []  # in which positions came
        self.package, self.main_mod = (types.ModuleType(n) for n in ("bc_stark_sdk", "main_mod"))
        self.package.main_mod = self.main_mod
        for kind in (Baudrate, FingerUnitMode, HandType, MotorState):
            setattr(self.main_mod, kind.__name__, kind)
        self.main_mod.DeviceContext = StarkContext

        def modbus_open(port_name: str, baudrate: Baudrate) -> Any:
            async def opened() -> StarkContext:
                if not self.plugged_in:
                    raise RuntimeError("Failed to open Modbus context: No such file\n\nStack:\n 0")
                return StarkContext(self)

            asyncio.get_running_loop()  # the real one needs a loop that runs, too
            return opened()

        self.main_mod.modbus_open = modbus_open

    async def answer(self, slave_id: int) -> None:
        """Every call passes here."""
        if self.faults.delay_s:
            await asyncio.sleep(self.faults.delay_s)
        if self.faults.mute:
            await asyncio.sleep(10.0)
        if self.faults.refuse or not self.plugged_in or slave_id != self.number:
            raise RuntimeError(f"slave[{slave_id}] read_input_registers(address: 2000) failed\n0:")


class StarkContext:
    def __init__(self, world: StarkWorld) -> None:
        self.world = world

    async def get_device_info(self, slave_id: int) -> Any:
        await self.world.answer(slave_id)
        return types.SimpleNamespace(
            hand_type=self.world.type,
            hardware_type="Revo2Basic",
            uses_revo2_motor_api=lambda: True,
        )

    async def set_finger_unit_mode(self, slave_id: int, mode: FingerUnitMode) -> None:
        await self.world.answer(slave_id)
        self.world.unit = mode

    async def get_finger_unit_mode(self, slave_id: int) -> FingerUnitMode | None:
        await self.world.answer(slave_id)
        return self.world.unit

    async def get_motor_status(self, slave_id: int) -> Any:
        await self.world.answer(slave_id)
        servos = self.world.servos
        positions = np.rint(servos.positions()).astype(int).tolist()
        load = servos.load()
        return types.SimpleNamespace(
            positions=[30000] * 6 if self.world.faults.garble else positions,
            speeds=[0] * 6,
            currents=np.rint(np.clip(load * 2, -1000, 1000)).astype(int).tolist(),
            states=[
                MotorState.Stall if k in servos.stuck and abs(x) > 5 else MotorState.Idle
                for k, x in enumerate(load)
            ],
        )

    async def set_finger_positions_and_speeds(
        self, slave_id: int, positions: list[int], speeds: list[int]
    ) -> None:
        await self.world.answer(slave_id)
        assert len(speeds) == 6
        self.world.units.append(self.world.unit)
        self.world.servos.aim(positions)

    async def close(self) -> None:
        return None
