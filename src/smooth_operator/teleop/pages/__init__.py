"""Browser pages and pictures of hands. Needs the ``teleop`` extra."""

from smooth_operator.errors import require
from smooth_operator.lazy_names import public_names

require("a page or picture of a hand", "teleop", "viser", "trimesh", "matplotlib", "jinja2")

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
