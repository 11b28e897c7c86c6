"""Retarget tracked human hands onto robot hands, smoothly and in real time.

retargeter = Retargeter("mimic_p050", side="right")
result = retargeter(landmarks)  # (21, 3) in metres, measured now
result.command.joint_positions        # (20,) in radians

The public names are listed in ``__init__.pyi``, here and in each public subpackage.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
