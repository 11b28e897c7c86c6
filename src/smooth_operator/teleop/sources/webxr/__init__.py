"""A headset's browser as a tracker: the page, its server and the source of frames."""

from smooth_operator.teleop.sources.webxr.link import LinkState as LinkState
from smooth_operator.teleop.sources.webxr.source import WebXr as WebXr
