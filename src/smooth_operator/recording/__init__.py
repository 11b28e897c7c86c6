"""Recordings of hands and commands: reading, checking, writing, logging.

Reading dispatches on what a file holds, never on its name alone, and nothing here unpickles.
"""

from smooth_operator.recording.anatomy import check_hand as check_hand
from smooth_operator.recording.atomic import atomic_write as atomic_write
from smooth_operator.recording.atomic import output_error as output_error
from smooth_operator.recording.checks import check_recording as check_recording
from smooth_operator.recording.checks import check_stamps as check_stamps
from smooth_operator.recording.checks import check_units as check_units
from smooth_operator.recording.checks import reading_notes as reading_notes
from smooth_operator.recording.convert import read_episode as read_episode
from smooth_operator.recording.convert import write_episode as write_episode
from smooth_operator.recording.episode import Episode as Episode
from smooth_operator.recording.frames import frame_slice as frame_slice
from smooth_operator.recording.jsonable import to_json as to_json
from smooth_operator.recording.log import LogWriter as LogWriter
from smooth_operator.recording.log_reader import Log as Log
from smooth_operator.recording.log_reader import read_log as read_log
from smooth_operator.recording.readers import read_recording as read_recording
from smooth_operator.recording.results import config_path as config_path
from smooth_operator.recording.results import read_commands as read_commands
from smooth_operator.recording.results import write_commands as write_commands
