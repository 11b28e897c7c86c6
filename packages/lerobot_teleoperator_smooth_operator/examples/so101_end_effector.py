"""Drives an SO-101 through LeRobot's own steps and inverse kinematics, as LeRobot's phone example.

LeRobot's commands run no inverse kinematics, so this needs a script. It needs
``python -m pip install "lerobot[feetech,kinematics]"``, and ``so101_new_calib.urdf`` with its
meshes from ``Simulation/SO101`` of github.com/TheRobotStudio/SO-ARM100 (Apache-2.0).

    python so101_end_effector.py --port /dev/ttyACM0 --urdf so101_new_calib.urdf --source webxr
"""

import argparse
import time

from lerobot.model.kinematics import RobotKinematics
from lerobot.processor import RobotAction, RobotObservation, RobotProcessorPipeline
from lerobot.processor.converters import (
    robot_action_observation_to_transition,
    transition_to_robot_action,
)
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig
from lerobot.robots.so_follower.robot_kinematic_processor import (
    EEBoundsAndSafety,
    InverseKinematicsEEToJoints,
)
from lerobot.utils.robot_utils import precise_sleep
from lerobot_teleoperator_smooth_operator import SmoothOperator, SmoothOperatorConfig, StartAtRobot

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--port", required=True, help="serial port of the arm")
parser.add_argument("--urdf", required=True, help="model of the arm")
parser.add_argument("--id", default="follower", help="name under which LeRobot calibrated the arm")
parser.add_argument("--source", default="webxr", help="tracker of the hand, as for teleop --source")
parser.add_argument("--fps", type=int, default=30, help="actions a second")
parser.add_argument("--seconds", type=float, default=float("inf"), help="length of the run")
options = parser.parse_args()

robot = SO101Follower(SO101FollowerConfig(port=options.port, id=options.id))
# For each action: ee.x … ee.wz of the operator's wrist, and ee.gripper_pos of the pinch.
teleop = SmoothOperator(SmoothOperatorConfig(source=options.source, wrist="ee"))
motors = list(robot.bus.motors)
kinematics = RobotKinematics(options.urdf, "gripper_frame_link", motors)
to_joints = RobotProcessorPipeline[tuple[RobotAction, RobotObservation], RobotAction](
    steps=[
        StartAtRobot(kinematics, motors),  # the gripper starts where it is
        EEBoundsAndSafety(
            {"min": [-0.5, -0.5, 0.0], "max": [0.5, 0.5, 0.5]}, 0.05, raise_on_jump=False
        ),
        InverseKinematicsEEToJoints(kinematics, motors, initial_guess_current_joints=False),
    ],
    to_transition=robot_action_observation_to_transition,
    to_output=transition_to_robot_action,
)
teleop.connect()
robot.connect()
try:
    end = time.monotonic() + options.seconds
    while (now := time.monotonic()) < end:
        robot.send_action(to_joints((teleop.get_action(), robot.get_observation())))
        precise_sleep(max(1 / options.fps - (time.monotonic() - now), 0.0))
finally:
    robot.disconnect()
    teleop.disconnect()
