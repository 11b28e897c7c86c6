"""``smooth`` whose operations are queued one by one, as those of a batch are."""

from __future__ import annotations

from dataclasses import dataclass, fields

from smooth_operator.methods.presets import method_config
from smooth_operator.methods.smooth import SmoothConfig


@dataclass(frozen=True)
class QueuedSmooth(SmoothConfig):
    """The same method without ``one_kernel``."""

    in_kernels = False

    @classmethod
    def default(cls) -> QueuedSmooth:
        """The default preset."""
        preset = method_config("smooth")
        return cls(**{field.name: getattr(preset, field.name) for field in fields(preset)})
