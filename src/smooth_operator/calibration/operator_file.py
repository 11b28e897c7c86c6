"""Reads and writes ``operator.json``, the stored profile of an operator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from smooth_operator.atomic_files import write_json
from smooth_operator.errors import ConfigError, DocumentError, brief
from smooth_operator.extras import UPGRADE
from smooth_operator.io.documents import read_json
from smooth_operator.io.entries import Entries
from smooth_operator.retargeting.known_gaps import check_gaps
from smooth_operator.types import Side, as_side

FORMAT: Final = "smooth-operator operator"
VERSION: Final = 1

_MOST_BYTES: Final = 1_000_000  # a profile has about 500 bytes
_EXPECTED: Final = "expected the OPERATOR.json that `smooth-operator calibrate` or `teleop` writes"


@dataclass(frozen=True)
class OperatorProfile:
    """Profile of an operator, measured with one tracker.

    Attributes:
        side: side of the hand.
        pinch_gaps: gaps that the tracker leaves between thumb and finger when they touch, by finger
            [palm lengths], without fingers whose gap is unknown.
        source: recording or tracker from which the gaps were computed.
        mounts: where trackers sit on the hands: side -> pose of the wrist in the tracker's frame,
            x y z [m] and unit quaternion w x y z.

    Raises:
        UnknownNameError: a finger has no such name, or is the thumb.
        ConfigError: a gap is not between 0 and 1 palm length, or a mount is not a pose.
    """

    side: Side
    pinch_gaps: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    mounts: Mapping[Side, tuple[float, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_gaps(self.pinch_gaps)
        for side, mount in self.mounts.items():
            pose = np.array(mount)
            if pose.shape != (7,) or abs(np.linalg.norm(pose[3:]) - 1.0) > 1e-3:
                raise ConfigError(
                    f"the mount of the {side} hand must be x y z and a unit quaternion w x y z, "
                    f"not {mount}"
                )

    def check(self, side: Side) -> None:
        """Raises ConfigError unless the pinch gaps were measured on a hand of this side."""
        if side != self.side:
            raise ConfigError(
                f"this operator file is for the {self.side} hand and can't be used for the "
                f"{side} one"
            )


def write_operator(path: Path, operator: OperatorProfile) -> None:
    """Writes a profile atomically; OutputError if the file can't be written."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "side": operator.side,
        "source": operator.source,
        "pinch_gaps": dict(operator.pinch_gaps),
        "mounts": dict(operator.mounts),
    }
    write_json(path, content, indent=2)


def read_operator(path: Path) -> OperatorProfile:
    """Reads a profile that ``write_operator`` wrote. Raises ConfigError if the file does not exist,
    is not a profile or has another version, or if an entry is missing, unknown or outside the range
    of a human hand."""
    try:
        content = read_json(Path(path), most_bytes=_MOST_BYTES)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; {_EXPECTED}") from None
    except OSError as error:
        raise ConfigError(f"{path}: can't be read: {error.strerror or error}") from error
    except DocumentError as error:
        raise ConfigError(f"{path}: damaged, or not JSON ({error}); {_EXPECTED}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ConfigError(f"{path}: it does not describe an operator; {_EXPECTED}")
    version = content.get("version")
    if version != VERSION:
        raise ConfigError(
            f"{path}: the file has format version {brief(version)}, but this program reads "
            f"version {VERSION}; calibrate again, or upgrade: {UPGRADE}"
        )
    entries = Entries(str(path), content)
    with entries.name_file():
        entries.only("format", "version", "side", "source", "pinch_gaps", "mounts")
        gaps, mounts = entries.table("pinch_gaps"), entries.table("mounts")
        return OperatorProfile(
            side=as_side(entries.text("side", lines=True)),
            pinch_gaps={name: gaps.number(name) for name in gaps.names},
            source=entries.text("source", lines=True),
            mounts={as_side(name): mounts.numbers(name, 7) for name in mounts.names},
        )
