"""Browser pages, and pictures of hands. Needs the extra ``teleop``."""

from smooth_operator.errors import require

require("a page or picture of a hand", "teleop", "viser", "trimesh", "matplotlib")

from smooth_operator.teleop.pages.playback import Playback as Playback
from smooth_operator.teleop.pages.player import PlaybackServer as PlaybackServer
from smooth_operator.teleop.pages.player import serve as serve
