"""Hand validation: checks on the description of a hand, and a round trip through every method.

``check_hand`` gives the checklist, ``round_trip`` asks one retargeter for poses that its
hand can reach. Nothing here prints.
"""

from smooth_operator.lab.validation.checks import Check as Check
from smooth_operator.lab.validation.checks import HandValidation as HandValidation
from smooth_operator.lab.validation.hand_validation import RoundTrip as RoundTrip
from smooth_operator.lab.validation.hand_validation import check_hand as check_hand
from smooth_operator.lab.validation.hand_validation import round_trip as round_trip
