from smooth_operator.teleop.pages.player import Playback as Playback
from smooth_operator.teleop.pages.player import PlaybackServer as PlaybackServer
from smooth_operator.teleop.pages.player import serve as serve
