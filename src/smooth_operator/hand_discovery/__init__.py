"""Derives the description of a hand from a URDF or MJCF file, and checks hand descriptions.

``discover`` makes the description and states a confidence for each finding. ``check_hand`` gives
the checklist of a hand; ``round_trip`` asks one retargeter for poses that its hand can reach.
Nothing here prints.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
