"""Options of ``smooth-operator glove-simulator``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import arg

from smooth_operator.cli.common_options import Common


@dataclass(frozen=True, kw_only=True)
class GloveSimulate(Common):
    """Publish a moving hand as a MANUS glove bridge does, for tests without a glove."""

    work: ClassVar[str] = "smooth_operator.cli.glove_simulator:simulate"
    details: ClassVar[str] = """Needs the extra zmq. A second terminal receives it:
  smooth-operator teleop --source manus

Examples:
  smooth-operator glove-simulator
  smooth-operator glove-simulator --side both --rate 120
  smooth-operator glove-simulator --recording glove.npz
  smooth-operator glove-simulator --drop 0.1 --missing 0.02 --silence-every 20
"""

    address: Annotated[str, arg(metavar="ADDRESS")] = "tcp://127.0.0.1:8000"
    """Where to publish; tcp://127.0.0.1:* takes any free port, and the first line says which."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Messages per second of each hand [Hz]; the recording's own, or 100, if left out."""

    side: Literal["right", "left", "both"] = "right"
    """Which hands; of a recording, the one that it lacks is mirrored."""

    recording: Annotated[Path | None, arg(metavar="FILE")] = None
    """Play this instead of the built-in operator, forwards and backwards without end."""

    duration: Annotated[float | None, arg(metavar="SECONDS")] = None
    """How long [s]; until Ctrl-C if left out."""

    noise: Annotated[float, arg(metavar="MM")] = 0.0
    """Noise of the built-in operator: standard deviation of each coordinate [mm]."""

    seed: int = 0
    """Seed of the operator and the faults."""

    drop: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of frames that are never sent."""

    silence_every: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Time between silences [s]; 0 is never."""

    silence: Annotated[float, arg(metavar="SECONDS")] = 2.0
    """Length of a silence [s]."""

    missing: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of frames without a finger, or without any node, alternately."""

    duplicate: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of frames that repeat the stamp of the one before."""

    reorder: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of frames that are sent after the next one."""

    swap: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of frames whose hands have exchanged sides."""

    garbage: Annotated[float, arg(metavar="SHARE")] = 0.0
    """Share of messages that are cut off in the middle."""

    restart_every: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Time between restarts, each with stamps from 0 [s]; 0 is never."""

    quiet: bool = False
    """Print nothing but errors."""
