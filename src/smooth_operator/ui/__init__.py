"""Browser pages. Needs viser; nothing outside this package imports it."""

from smooth_operator.ui.playback import Playback as Playback
from smooth_operator.ui.player import PlaybackServer as PlaybackServer
from smooth_operator.ui.player import serve as serve
