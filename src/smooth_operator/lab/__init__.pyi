from smooth_operator.lab.validation.hand_validation import check_hand as check_hand
from smooth_operator.lab.validation.round_trip import round_trip as round_trip
