"""Stand-ins for two makers' packages, ``wujihandpy`` and ``bc_stark_sdk``, with a simulated hand.

They have the calls that our drivers use, with the names, parameters and results of the real ones;
``test_hand_packages.py`` compares them with the real packages where those are installed.
"""

import asyncio
import enum
import types
from typing import Any

import numpy as np
from simulators.common import Faults, Motors
from simulators.sdk import module


class WujiWorld:
    """A simulated hand on USB; ``module`` stands for ``wujihandpy``."""

    def __init__(self, handedness: int = 0) -> None:
        self.motors = Motors([0.1] * 20, 20.0)
        self.motors.set_power(False)
        self.faults = Faults("not finite")
        self.plugged_in = True
        self.handedness = handedness
        self.effort_limit = np.full((5, 4), 1.5)
        self.codes = np.zeros((5, 4), np.uint32)
        self.switched: list[bool] = []
        world = self

        class Hand(WujiHand):
            def __init__(self, serial_number: str | None = None) -> None:
                super().__init__(world)

        self.module = module(
            "wujihandpy",
            Hand=Hand,
            logging=types.SimpleNamespace(set_log_to_console=lambda value: None),
            filter=types.SimpleNamespace(LowPass=WujiLowPass),
        )

    def touch(self) -> str:
        """Every call passes here; the kind of wrong answer."""
        if not self.plugged_in:
            raise ConnectionError("device disconnected")
        if self.faults.silent:
            raise TimeoutError("SDO operation timeout")
        return self.faults.next_wrong()


class WujiLowPass:
    def __init__(self, cutoff_freq: float = 10.0) -> None:
        self.cutoff = cutoff_freq


class WujiController:
    def __init__(self, world: WujiWorld) -> None:
        self.world = world

    def set_joint_target_position(self, value_array: Any) -> None:
        self.world.touch()
        assert np.shape(value_array) == (5, 4)
        self.world.motors.move(np.ravel(value_array))

    def get_joint_actual_position(self) -> np.ndarray:
        wrong = self.world.touch()
        return np.nan * np.ones((5, 4)) if wrong else self.world.motors.positions.reshape(5, 4)

    def get_joint_actual_effort(self) -> np.ndarray:
        self.world.touch()
        return self.world.motors.currents.reshape(5, 4) / 1000.0

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
        self.world.motors.set_power(value)
        self.world.switched.append(value)

    def realtime_controller(self, enable_upstream: bool, filter: Any) -> WujiController:
        self.world.touch()
        assert isinstance(filter, WujiLowPass)
        return WujiController(self.world)


Baudrate = enum.Enum("Baudrate", ["Baud115200", "Baud460800", "Baud1Mbps"])
FingerUnitMode = enum.Enum("FingerUnitMode", ["Normalized", "Physical"])
HandType = enum.Enum("HandType", ["Left", "Right"])
MotorState = enum.Enum("MotorState", ["Unknown", "Idle", "Running", "Stall", "Turbo"])


class StarkWorld:
    """A simulated hand on a serial line; ``main_mod`` stands for the module of that name."""

    def __init__(self, left: bool = False) -> None:
        self.motors = Motors([0.0] * 6, 8000.0, stall_current=1000.0)
        self.faults = Faults("not a position")
        self.plugged_in = True
        self.number = 0x7E if left else 0x7F
        self.type = HandType.Left if left else HandType.Right
        self.unit: FingerUnitMode | None = None

        def modbus_open(port_name: str, baudrate: Baudrate) -> Any:
            async def opened() -> StarkContext:
                if not self.plugged_in:
                    raise RuntimeError("Failed to open Modbus context: No such file\n\nStack:\n 0")
                return StarkContext(self)

            asyncio.get_running_loop()  # the real one needs a loop that runs, too
            return opened()

        kinds = {each.__name__: each for each in (Baudrate, FingerUnitMode, HandType, MotorState)}
        self.main_mod = module(
            "main_mod", modbus_open=modbus_open, DeviceContext=StarkContext, **kinds
        )
        self.package = module("bc_stark_sdk", main_mod=self.main_mod)

    async def answer(self, slave_id: int) -> str:
        """Every call passes here; the kind of wrong answer."""
        if self.faults.silent:
            await asyncio.sleep(10.0)
        if not self.plugged_in or slave_id != self.number:
            raise RuntimeError(f"slave[{slave_id}] read_input_registers(address: 2000) failed\n0:")
        return self.faults.next_wrong()


class StarkContext:
    def __init__(self, world: StarkWorld) -> None:
        self.world = world

    async def get_device_info(self, slave_id: int) -> Any:
        await self.world.answer(slave_id)
        return types.SimpleNamespace(
            hand_type=self.world.type, hardware_type="Revo2Basic", uses_revo2_motor_api=lambda: True
        )

    async def set_finger_unit_mode(self, slave_id: int, mode: FingerUnitMode) -> None:
        await self.world.answer(slave_id)
        self.world.unit = mode

    async def get_finger_unit_mode(self, slave_id: int) -> FingerUnitMode | None:
        await self.world.answer(slave_id)
        return self.world.unit

    async def get_motor_status(self, slave_id: int) -> Any:
        wrong, motors = await self.world.answer(slave_id), self.world.motors
        currents = np.rint(motors.currents).astype(int).tolist()
        return types.SimpleNamespace(
            positions=[30000] * 6 if wrong else np.rint(motors.positions).astype(int).tolist(),
            speeds=[0] * 6,
            currents=currents,
            states=[
                MotorState.Stall if k in motors.stuck and current else MotorState.Idle
                for k, current in enumerate(currents)
            ],
        )

    async def set_finger_positions_and_speeds(
        self, slave_id: int, positions: list[int], speeds: list[int]
    ) -> None:
        await self.world.answer(slave_id)
        assert len(speeds) == 6
        self.world.motors.move(positions)

    async def close(self) -> None:
        return None
