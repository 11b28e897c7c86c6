from smooth_operator.human.alignment import AlignmentConfig as AlignmentConfig
from smooth_operator.human.alignment import align_recording as align_recording
from smooth_operator.human.alignment import calibrate_scale as calibrate_scale
from smooth_operator.human.operator import OperatorProfile as OperatorProfile
