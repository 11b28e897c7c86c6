from smooth_operator.methods.method import Method as Method
from smooth_operator.methods.method import MethodConfig as MethodConfig
from smooth_operator.methods.method import MethodOutput as MethodOutput
from smooth_operator.methods.method import ObjectiveMethodConfig as ObjectiveMethodConfig
from smooth_operator.methods.presets import method_config as method_config
from smooth_operator.methods.presets import method_names as method_names
from smooth_operator.methods.retargeter import Retargeter as Retargeter
