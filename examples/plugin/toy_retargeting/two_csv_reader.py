"""A data set's layout: a folder with ``right.csv`` and ``left.csv``, 63 coordinates [m] a line."""

import numpy as np

from smooth_operator import HandRecording
from smooth_operator.errors import RecordingError
from smooth_operator.formats import Clip, ClipRef, checked_hands


class TwoCsv:
    what = "a folder of right.csv and left.csv"
    expects = "right.csv and left.csv with 63 numbers in each line"

    def matches(self, path):
        return all((path / f"{side}.csv").is_file() for side in ("right", "left"))

    def clips(self, path):
        yield ClipRef(path.name, path, layout="two_csv")

    def read(self, ref, options):
        if options.rate is None:
            raise RecordingError(f"{ref.path}: give the frames a second with --rate")
        hands = {}
        for side in ("right", "left"):
            points = np.loadtxt(ref.path / f"{side}.csv", delimiter=",").reshape(-1, 21, 3)
            hands[side] = HandRecording(points, np.arange(len(points)) / options.rate, side)
        return Clip(ref.name, checked_hands(hands, str(ref.path), self.expects), "two_csv")


TWO_CSV = TwoCsv()
