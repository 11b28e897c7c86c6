"""Files of arrays, documents and recordings: reading within bounds, checking, atomic writing.

Reading dispatches on what a file holds, never on its name alone, and nothing here unpickles.
"""

from smooth_operator.io.anatomy import check_hand as check_hand
from smooth_operator.io.atomic import atomic_write as atomic_write
from smooth_operator.io.atomic import output_error as output_error
from smooth_operator.io.checks import check_recording as check_recording
from smooth_operator.io.checks import check_stamps as check_stamps
from smooth_operator.io.checks import check_units as check_units
from smooth_operator.io.checks import reading_notes as reading_notes
from smooth_operator.io.episode import Episode as Episode
from smooth_operator.io.frames import frame_slice as frame_slice
from smooth_operator.io.jsonable import to_json as to_json
from smooth_operator.io.readers import read_recording as read_recording
from smooth_operator.io.results import config_path as config_path
from smooth_operator.io.results import read_commands as read_commands
from smooth_operator.io.results import write_commands as write_commands
