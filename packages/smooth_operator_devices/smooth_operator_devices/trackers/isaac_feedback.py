"""Feedback of contact through NVIDIA's Isaac Teleop: vibration of its controllers or gloves."""

from __future__ import annotations

from dataclasses import dataclass, field

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.sinks.feedback import Feedback, Output
from smooth_operator.teleop.sources.combined import part_of
from smooth_operator.teleop.sources.live import LiveSource
from smooth_operator_devices.trackers.isaac_hands import Haptics, IsaacHands


@dataclass(frozen=True)
class IsaacFeedback(Feedback):
    """Lets the controllers or gloves of the source ``isaac`` vibrate.

    Controllers vibrate with the highest level of all fingers; gloves vibrate at each finger.

    Attributes:
        collection: collection that the plug-in of the gloves reads, such as
            ``manus_glove_haptic``; empty for the controllers.
    """

    collection: str = ""
    rate: float = field(default=50.0, kw_only=True)
    _haptics: Haptics | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def label(self) -> str:
        """The words ``feedback isaac`` and the collection."""
        return f"feedback isaac {self.collection}".rstrip()

    def use_source(self, source: LiveSource) -> None:
        """Join the session of the source; see ``Feedback``."""
        isaac = part_of(source, IsaacHands)
        if isaac is None:
            raise ConfigError("--feedback isaac needs Isaac Teleop's session: use --source isaac")
        haptics = Haptics(self.collection)
        isaac.haptics.append(haptics)
        self._set(_haptics=haptics)

    def output(self) -> Output:
        """Send through the source, which has its own connection."""
        assert self._haptics is not None  # set before the run
        return self._haptics.put, lambda: None
