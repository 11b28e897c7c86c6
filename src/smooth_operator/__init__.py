"""Retarget tracked human hands onto robot hands, smoothly and in real time.

retargeter = Retargeter("mimic_p050", side="right")
result = retargeter(landmarks)  # (21, 3) in metres, of this moment
result.command.positions        # (20,) in radians
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from smooth_operator.errors import SmoothOperatorError as SmoothOperatorError
    from smooth_operator.hands.catalogue import hand_names as hand_names
    from smooth_operator.hands.catalogue import load_hand as load_hand
    from smooth_operator.hands.hand import Hand as Hand
    from smooth_operator.hands.spec import FingerSpec as FingerSpec
    from smooth_operator.hands.spec import HandSpec as HandSpec
    from smooth_operator.hands.spec import Point as Point
    from smooth_operator.human.alignment import align_recording as align_recording
    from smooth_operator.human.alignment import calibrate_scale as calibrate_scale
    from smooth_operator.io import read_recording as read_recording
    from smooth_operator.landmarks import LANDMARKS as LANDMARKS
    from smooth_operator.methods.presets import method_config as method_config
    from smooth_operator.methods.presets import method_names as method_names
    from smooth_operator.methods.retargeter import Retargeter as Retargeter
    from smooth_operator.methods.retargeter import RetargetState as RetargetState
    from smooth_operator.methods.sbr import SbrConfig as SbrConfig
    from smooth_operator.synthetic import SyntheticOperator as SyntheticOperator
    from smooth_operator.types import CommandTrajectory as CommandTrajectory
    from smooth_operator.types import HandFrame as HandFrame
    from smooth_operator.types import HandRecording as HandRecording
    from smooth_operator.types import JointCommand as JointCommand
    from smooth_operator.types import Result as Result
    from smooth_operator.types import Status as Status

# Looked up when first asked for: JAX and MuJoCo take a second, and `--help` needs neither.
_HOME = {
    "SmoothOperatorError": "smooth_operator.errors",
    "hand_names": "smooth_operator.hands.catalogue",
    "load_hand": "smooth_operator.hands.catalogue",
    "Hand": "smooth_operator.hands.hand",
    "FingerSpec": "smooth_operator.hands.spec",
    "HandSpec": "smooth_operator.hands.spec",
    "Point": "smooth_operator.hands.spec",
    "align_recording": "smooth_operator.human.alignment",
    "calibrate_scale": "smooth_operator.human.alignment",
    "LANDMARKS": "smooth_operator.landmarks",
    "read_recording": "smooth_operator.io",
    "method_config": "smooth_operator.methods.presets",
    "method_names": "smooth_operator.methods.presets",
    "Retargeter": "smooth_operator.methods.retargeter",
    "RetargetState": "smooth_operator.methods.retargeter",
    "SbrConfig": "smooth_operator.methods.sbr",
    "SyntheticOperator": "smooth_operator.synthetic",
    "CommandTrajectory": "smooth_operator.types",
    "HandFrame": "smooth_operator.types",
    "HandRecording": "smooth_operator.types",
    "JointCommand": "smooth_operator.types",
    "Result": "smooth_operator.types",
    "Status": "smooth_operator.types",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value  # found directly from now on
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
