"""Source that uses a headset's browser as a tracker: page, server and link."""

from smooth_operator.teleop.sources.webxr.link import LinkState as LinkState
from smooth_operator.teleop.sources.webxr.source import WebXr as WebXr
