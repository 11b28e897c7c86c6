"""A Unitree Dex3-1 on DDS (CycloneDDS).

Sources, by the maker (Unitree):

- github.com/unitreerobotics/unitree_sdk2_python, commit 37116c52 (2026-07-02), `unitree_sdk2py/idl/
  unitree_hg/msg/dds_/_{HandCmd_,HandState_,MotorCmd_,MotorState_,PressSensorState_,IMUState_}.py`:
  type names, fields and their order, final types with sequential member numbers.
- github.com/unitreerobotics/xr_teleoperate, commit d1510db0 (2025-07-18), `teleop/robot_control/
  robot_hand_unitree.py`: topics, order of the motors of each side, mode byte, gains, 100 Hz.

Facts: topics rt/dex3/left/cmd, rt/dex3/left/state and the same of the right hand, on domain 0
(1 in simulation). Left: thumb 0, 1, 2, middle 0, 1, index 0, 1. Right: thumb 0, 1, 2, index 0, 1,
middle 0, 1. The mode byte has the motor's number in bits 0 to 3, its status in bits 4 to 6 (1 is
on) and "timeout" in bit 7.

Not found: what bit 7 does (here nothing), what status 0 does (here the motor is free), what the
hand does when commands stop (here it holds its target), its rate (here 500 Hz), limits of the
joints (here none), and the values of `motorstate` and `error` (here 0, until a test sets them).
"""

import threading
import types
from dataclasses import dataclass
from typing import Any

import cyclonedds.idl as idl
import cyclonedds.idl.annotations as annotate
import numpy as np
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl.types import array, float32, int16, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from .common import Faults, Motors

ORDER = {
    "left": ("thumb_0", "thumb_1", "thumb_2", "middle_0", "middle_1", "index_0", "index_1"),
    "right": ("thumb_0", "thumb_1", "thumb_2", "index_0", "index_1", "middle_0", "middle_1"),
}


def _message(name: str, **fields: Any) -> Any:
    """A final type with sequential member numbers."""

    def body(members: dict[str, Any]) -> None:
        members["__module__"] = __name__
        members["__annotations__"].update(fields)

    typename = f"unitree_hg.msg.dds_.{name}_"
    kind = types.new_class(name, (idl.IdlStruct,), {"typename": typename}, body)
    return dataclass(annotate.final(annotate.autoid("sequential")(kind)))


MotorCmd = _message(
    "MotorCmd",
    mode=uint8,
    q=float32,
    dq=float32,
    tau=float32,
    kp=float32,
    kd=float32,
    reserve=uint32,
)
HandCmd = _message("HandCmd", motor_cmd=sequence[MotorCmd], reserve=array[uint32, 4])
MotorState = _message(
    "MotorState",
    mode=uint8,
    q=float32,
    dq=float32,
    ddq=float32,
    tau_est=float32,
    temperature=array[int16, 2],
    vol=float32,
    sensor=array[uint32, 2],
    motorstate=uint32,
    reserve=array[uint32, 4],
)
PressSensorState = _message(
    "PressSensorState",
    pressure=array[float32, 12],
    temperature=array[float32, 12],
    lost=uint32,
    reserve=uint32,
)
IMUState = _message(
    "IMUState",
    quaternion=array[float32, 4],
    gyroscope=array[float32, 3],
    accelerometer=array[float32, 3],
    rpy=array[float32, 3],
    temperature=int16,
)
HandState = _message(
    "HandState",
    motor_state=sequence[MotorState],
    press_sensor_state=sequence[PressSensorState],
    imu_state=IMUState,
    power_v=float32,
    power_a=float32,
    system_v=float32,
    device_v=float32,
    error=array[uint32, 2],
    reserve=array[uint32, 2],
)


class Dex3Hand:
    """A simulated Dex3-1 that reads commands and writes states on a DDS domain, in rad."""

    def __init__(self, side: str, domain: int) -> None:
        self.side = side
        self.faults = Faults("short")
        self.motors = Motors(np.zeros(7), 6.0)
        self.motors.set_power(False)
        self.motor_errors = [0] * 7
        self.error = [0, 0]
        self.pressure = np.zeros((9, 12))
        self.commands: list[HandCmd] = []
        self._modes = [0] * 7
        self._domain = domain
        self._ended = threading.Event()

    def reboot(self) -> None:
        """Switch the hand off and on: the motors are free until the next command."""
        self.motors.set_power(False)
        self.motors.place(self.motors.positions)
        self._modes = [0] * 7
        self.motor_errors = [0] * 7

    def __enter__(self) -> "Dex3Hand":
        participant = DomainParticipant(self._domain)
        base = f"rt/dex3/{self.side}"
        self._reader = DataReader(participant, Topic(participant, f"{base}/cmd", HandCmd))
        self._writer = DataWriter(participant, Topic(participant, f"{base}/state", HandState))
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(1 / 500):
            for command in self._reader.take(100):
                if isinstance(command, HandCmd) and not self.faults.silent:
                    self.obey(command)
            if not self.faults.silent:
                self._writer.write(self.state())

    def obey(self, command: HandCmd) -> None:
        """Take a command."""
        self.commands.append(command)
        for number, motor in enumerate(command.motor_cmd[:7]):
            self._modes[number] = motor.mode
            on = motor.mode >> 4 & 0x07 == 1 and motor.mode & 0x0F == number
            self.motors.set_power(on and motor.kp > 0, [number])
            self.motors.move([motor.q], [number])

    def state(self) -> HandState:
        """The message of this moment."""
        positions, velocities = self.motors.positions, self.motors.velocities
        currents = self.motors.currents
        count = 5 if self.faults.next_wrong() == "short" else 7
        return HandState(
            motor_state=[
                MotorState(
                    mode=self._modes[i],
                    q=float(positions[i]),
                    dq=float(velocities[i]),
                    ddq=0.0,
                    tau_est=float(currents[i] / 1000),
                    temperature=[int(self.motors.temperatures[i])] * 2,
                    vol=24.0,
                    sensor=[0, 0],
                    motorstate=self.motor_errors[i],
                    reserve=[0] * 4,
                )
                for i in range(count)
            ],
            press_sensor_state=[
                PressSensorState(pressure=row.tolist(), temperature=[30.0] * 12, lost=0, reserve=0)
                for row in self.pressure
            ],
            imu_state=IMUState([1.0, 0.0, 0.0, 0.0], [0.0] * 3, [0.0, 0.0, 9.81], [0.0] * 3, 30),
            power_v=24.0,
            power_a=float(currents.sum() / 1000),
            system_v=24.0,
            device_v=24.0,
            error=list(self.error),
            reserve=[0, 0],
        )
