"""A reader: recordings as CSV, the 63 coordinates [m] of 21 landmarks in each line."""

import numpy as np

from smooth_operator import HandRecording
from smooth_operator.errors import RecordingError
from smooth_operator.formats import Reader


def read(path, rate, side, layout):
    frames = np.loadtxt(path, delimiter=",", ndmin=2).reshape(-1, 21, 3)
    if rate is None:
        raise RecordingError(f"{path}: a .csv has no stamps; give its frames a second with --rate")
    return HandRecording(
        frames, np.arange(len(frames)) / rate, side or "right", meta={"side_assumed": side is None}
    )


CSV = Reader("a .csv of 63 coordinates [m] in each line", read, suffixes=(".csv",))
