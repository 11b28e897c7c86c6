"""Messages of Unitree's Dex3-1 over DDS.

Names and fields: the maker's unitreerobotics/unitree_sdk2_python, commit 37116c52
(``unitree_sdk2py/idl/unitree_hg/msg/dds_``). Units: positions in rad, velocities in rad/s, torques
in N m.
"""

from cyclonedds.idl.types import array, float32, int16, sequence, uint8, uint32

from smooth_operator_devices.ros2.messages import message_class

MotorCommand = message_class(
    "unitree_hg",
    "MotorCmd",
    mode=uint8,
    q=float32,
    dq=float32,
    tau=float32,
    kp=float32,
    kd=float32,
    reserve=uint32,
)
HandCommand = message_class(
    "unitree_hg", "HandCmd", motor_cmd=sequence[MotorCommand], reserve=array[uint32, 4]
)
_MotorState = message_class(
    "unitree_hg",
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
_PressState = message_class(
    "unitree_hg",
    "PressSensorState",
    pressure=array[float32, 12],
    temperature=array[float32, 12],
    lost=uint32,
    reserve=uint32,
)
_ImuState = message_class(
    "unitree_hg",
    "IMUState",
    quaternion=array[float32, 4],
    gyroscope=array[float32, 3],
    accelerometer=array[float32, 3],
    rpy=array[float32, 3],
    temperature=int16,
)
HandState = message_class(
    "unitree_hg",
    "HandState",
    motor_state=sequence[_MotorState],
    press_sensor_state=sequence[_PressState],
    imu_state=_ImuState,
    power_v=float32,
    power_a=float32,
    system_v=float32,
    device_v=float32,
    error=array[uint32, 2],
    reserve=array[uint32, 2],
)
