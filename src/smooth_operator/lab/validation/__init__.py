"""Is the description of a hand right? Checks on it, and a round trip through every method.

``check_hand`` gives the checklist, ``round_trip`` asks one retargeter for poses that its
hand can reach. Nothing here prints.
"""

from smooth_operator.lab.validation.checks import Check as Check
from smooth_operator.lab.validation.checks import Checkup as Checkup
from smooth_operator.lab.validation.checkup import check_hand as check_hand
from smooth_operator.lab.validation.round_trip import RoundTrip as RoundTrip
from smooth_operator.lab.validation.round_trip import round_trip as round_trip
