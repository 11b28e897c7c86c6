"""Messages of Unitree's Dex3-1 over DDS.

Names and fields: the maker's unitreerobotics/unitree_sdk2_python, commit 37116c52
(``unitree_sdk2py/idl/unitree_hg/msg/dds_``).
"""
# Without postponed annotations, since cyclonedds reads the types of the fields.

from dataclasses import dataclass

import cyclonedds.idl as idl
import cyclonedds.idl.annotations as annotate
import cyclonedds.idl.types as types


@dataclass
@annotate.final
@annotate.autoid("sequential")
class MotorCommand(idl.IdlStruct, typename="unitree_hg.msg.dds_.MotorCmd_"):  # type: ignore[call-arg,misc]
    """Command of a motor: mode, position [rad], velocity [rad/s], torque [N m], gains."""

    mode: types.uint8
    q: types.float32
    dq: types.float32
    tau: types.float32
    kp: types.float32
    kd: types.float32
    reserve: types.uint32 = 0


@dataclass
@annotate.final
@annotate.autoid("sequential")
class HandCommand(idl.IdlStruct, typename="unitree_hg.msg.dds_.HandCmd_"):  # type: ignore[call-arg,misc]
    """Command of a hand."""

    motor_cmd: types.sequence[MotorCommand]
    reserve: types.array[types.uint32, 4]


@dataclass
@annotate.final
@annotate.autoid("sequential")
class MotorState(idl.IdlStruct, typename="unitree_hg.msg.dds_.MotorState_"):  # type: ignore[call-arg,misc]
    """State of a motor: position [rad], velocity [rad/s], torque [N m], two temperatures."""

    mode: types.uint8
    q: types.float32
    dq: types.float32
    ddq: types.float32
    tau_est: types.float32
    temperature: types.array[types.int16, 2]
    vol: types.float32
    sensor: types.array[types.uint32, 2]
    motorstate: types.uint32
    reserve: types.array[types.uint32, 4]


@dataclass
@annotate.final
@annotate.autoid("sequential")
class PressState(idl.IdlStruct, typename="unitree_hg.msg.dds_.PressSensorState_"):  # type: ignore[call-arg,misc]
    """State of a field of twelve pressure sensors."""

    pressure: types.array[types.float32, 12]
    temperature: types.array[types.float32, 12]
    lost: types.uint32
    reserve: types.uint32


@dataclass
@annotate.final
@annotate.autoid("sequential")
class ImuState(idl.IdlStruct, typename="unitree_hg.msg.dds_.IMUState_"):  # type: ignore[call-arg,misc]
    """State of the hand's inertial sensor."""

    quaternion: types.array[types.float32, 4]
    gyroscope: types.array[types.float32, 3]
    accelerometer: types.array[types.float32, 3]
    rpy: types.array[types.float32, 3]
    temperature: types.int16


@dataclass
@annotate.final
@annotate.autoid("sequential")
class HandState(idl.IdlStruct, typename="unitree_hg.msg.dds_.HandState_"):  # type: ignore[call-arg,misc]
    """State of a hand."""

    motor_state: types.sequence[MotorState]
    press_sensor_state: types.sequence[PressState]
    imu_state: ImuState
    power_v: types.float32
    power_a: types.float32
    system_v: types.float32
    device_v: types.float32
    error: types.array[types.uint32, 2]
    reserve: types.array[types.uint32, 2]
