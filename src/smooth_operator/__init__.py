"""Retarget tracked human hands onto robot hands, smoothly and in real time.

retargeter = Retargeter("mimic_p050", side="right")
result = retargeter(landmarks)  # (21, 3) in metres
result.command.positions        # (20,) in radians
"""

from smooth_operator.errors import SmoothOperatorError as SmoothOperatorError
from smooth_operator.hands.catalogue import hand_names as hand_names
from smooth_operator.hands.catalogue import load_hand as load_hand
from smooth_operator.hands.hand import Hand as Hand
from smooth_operator.hands.spec import FingerSpec as FingerSpec
from smooth_operator.hands.spec import HandSpec as HandSpec
from smooth_operator.hands.spec import Point as Point
from smooth_operator.human.alignment import align_recording as align_recording
from smooth_operator.human.alignment import calibrate_scale as calibrate_scale
from smooth_operator.landmarks import LANDMARKS as LANDMARKS
from smooth_operator.retargeters.presets import method_config as method_config
from smooth_operator.retargeters.presets import method_names as method_names
from smooth_operator.retargeters.retargeter import Retargeter as Retargeter
from smooth_operator.retargeters.retargeter import RetargetState as RetargetState
from smooth_operator.retargeters.sbr import SbrConfig as SbrConfig
from smooth_operator.types import CommandTrajectory as CommandTrajectory
from smooth_operator.types import HandFrame as HandFrame
from smooth_operator.types import HandRecording as HandRecording
from smooth_operator.types import JointCommand as JointCommand
from smooth_operator.types import Result as Result
from smooth_operator.types import Status as Status
