from smooth_operator.formats.commands import read_commands as read_commands
from smooth_operator.formats.commands import write_commands as write_commands
from smooth_operator.formats.readers import read_recording as read_recording
from smooth_operator.formats.registry import Reader as Reader
