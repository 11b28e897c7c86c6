from smooth_operator.lab.validation.hand_validation import check_hand as check_hand
