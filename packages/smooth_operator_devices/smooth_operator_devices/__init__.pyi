from smooth_operator_devices.hands.device import HandDevice as HandDevice
from smooth_operator_devices.hands.device import Reading as Reading
from smooth_operator_devices.hands.hardware_sink import HardwareSink as HardwareSink
