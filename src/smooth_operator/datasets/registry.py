"""The layouts of data sets by name, built-in and of plugins: how one is recognised and read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

from smooth_operator.datasets.clip import Clip
from smooth_operator.plugins import Entry, Registry
from smooth_operator.types import Side

_READERS: Final = "smooth_operator.datasets.readers"

RESEARCH_PACKAGE: Final = (
    "a part of smooth-hand-datasets, research data sets of hands and objects, which is not "
    "installed; in a clone of the repository: python -m pip install ./packages/smooth_hand_datasets"
)
"""Where to get what this distribution does not have, for messages."""

RESEARCH_LAYOUTS: Final = (
    *("arctic", "dexycb", "dynhamr", "egohandkit", "grab", "hawor", "ho3d", "hot3d", "mano"),
    *("oakink2", "predictions", "taco"),
)
"""Layouts that smooth-hand-datasets reads."""


@dataclass(frozen=True)
class ReadingOptions:
    """Options of a reader that its files do not state.

    Attributes:
        rate: frames a second [Hz], for layouts without times; None for the layout's own.
        side: side of the hand, where the files hold one and do not say; None for the layout's own.
        mano: folder with the user's MANO model files, ``MANO_RIGHT.pkl`` and ``MANO_LEFT.pkl``.
        objects: folder with the meshes of objects; None for the layout's own place.
        order: order of the landmarks in plain arrays; None for the project's own.
        assumed: side of the hand in a recording that does not state it.
    """

    rate: float | None = None
    side: Side | None = None
    mano: Path | None = None
    objects: Path | None = None
    order: str | None = None
    assumed: Side = "right"


@dataclass(frozen=True, order=True)
class ClipRef:
    """A clip that has not been read: cheap to list, to send to a worker, and to sort.

    Attributes:
        name: name of the clip, unique in its source.
        path: the file or folder that holds it.
        key: part of the file, for a file that holds several.
        layout: name of its reader in ``DATASETS``.
        size: bytes or frames, for the order of the work; 0 if unknown.
    """

    name: str
    path: Path
    key: str = ""
    layout: str = ""
    size: int = field(default=0, compare=False)


class DatasetReader(Protocol):
    """A layout of files."""

    what: str
    """What it reads, for messages: ``an HDF5 file of EgoDex``."""

    expects: str
    """The files and arrays that it needs, by name, for messages."""

    def matches(self, path: Path) -> bool:
        """True if a file or folder is of this layout. It opens as little as it can.

        Folders are asked before what is in them. One that matches is not looked into further.
        """

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """The clips of a file or folder that matches, by name; reads no arrays."""

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """One clip.

        Raises:
            RecordingError: the files differ from the layout; says by name what was expected, what
                was found, and what to do.
            MissingExtraError: a library is missing.
        """


DATASETS: Final = Registry(
    "dataset",
    {
        name: Entry(f"{_READERS}.{where}", what)
        for name, where, what in (
            ("egodex", "built_in:EGODEX", "EgoDex: HDF5 of both hands, camera and task"),
            ("avp", "built_in:AVP_RECORDING", "Tracking Streamer (Vision Pro): tracking.jsonl"),
            ("hts", "built_in:HTS_RECORDING", "Hand Tracking Streamer (Quest): lines, JSON lines"),
            ("landmarks", "built_in:LANDMARKS_OF_BOTH_HANDS", "an .npz with 'right' and 'left'"),
            ("parquet", "packed:PACKED", "clips that the format 'parquet' has packed"),
            ("files", "built_in:FILES", "any recording of one hand that 'retarget' reads"),
        )
    },
    needs=("what", "expects", "matches", "clips", "read"),
    elsewhere=dict.fromkeys(RESEARCH_LAYOUTS, RESEARCH_PACKAGE),
)
"""Name -> ``DatasetReader``. A path belongs to the first that matches; ``--layout`` names one."""


def readers() -> dict[str, DatasetReader]:
    """All readers by name, in the order in which a path is offered to them.

    A reader with a true attribute ``generic`` follows the others; ``files`` is the last.
    """
    parts: dict[str, DatasetReader] = DATASETS.loadable()
    names = sorted(parts, key=lambda n: (n == "files", getattr(parts[n], "generic", False)))
    return {name: parts[name] for name in names}
