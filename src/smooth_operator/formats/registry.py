"""Registry of the recording formats, built-in and of plugins: how a file is recognised and read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import ConfigError, DocumentError, RecordingError, SmoothOperatorError
from smooth_operator.formats.arrays import PICKLE_REMEDY
from smooth_operator.formats.foreign import foreign_dataset, foreign_file
from smooth_operator.formats.foreign import is_dataset as is_dataset
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.plugins import Entry, Registry
from smooth_operator.types import HandRecording, Side

NPY_MAGIC: Final = b"\x93NUMPY"
MCAP_MAGIC: Final = b"\x89MCAP0\r\n"

_HERE: Final = "smooth_operator.formats.registry"
_RECORDING: Final = "smooth_operator.teleop.recording"


@dataclass(frozen=True)
class Reader:
    """A format of recordings.

    Attributes:
        what: kind of its files, for messages: ``a .csv file of landmarks``.
        read: ``read(path, rate, side, layout)`` returns the recording: ``rate`` [Hz] for a file
            without stamps, ``side`` and ``layout`` (the order of 21 landmarks, by its name) as the
            caller says, each None if the caller does not state it. Raises ``RecordingError`` if the
            file can't be used. The result is checked like other recordings. This is a function, or
            the path from which it is imported when a file is read.
        magic: possible first bytes of its files.
        suffixes: suffixes of its files, in lower case (``.csv``). They select the files of a
            folder; for a format without ``magic``, they also identify its files.

    Raises:
        ConfigError: neither ``magic`` nor ``suffixes`` is given.
    """

    what: str
    read: Callable[[Path, float | None, Side | None, str | None], HandRecording] | Entry
    magic: tuple[bytes, ...] = ()
    suffixes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (self.magic or self.suffixes):
            raise ConfigError(
                f"a reader of {self.what} must have magic (first bytes) or suffixes, to "
                "recognise its files"
            )

    def recognises(self, path: Path, head: bytes) -> bool:
        """True for a file of this format.

        Args:
            path: the file.
            head: its first 128 bytes, or fewer.
        """
        if self.magic:
            return head.startswith(self.magic)
        return path.suffix.lower() in self.suffixes

    def read_file(
        self, path: Path, rate: float | None, side: Side | None, layout: str | None
    ) -> HandRecording:
        """Calls ``read``.

        Raises:
            RecordingError: the file can't be used.
            ConfigError: ``read`` can't be imported, or gives something else.
            MissingExtraError: the format needs an extra that is not installed.
        """
        read = self.read.load() if isinstance(self.read, Entry) else self.read
        try:
            recording: Any = read(path, rate, side, layout)
        except SmoothOperatorError:
            raise
        except (OSError, ValueError) as error:  # of a plugin that leaves a bad file to NumPy
            raise RecordingError(f"{path}: can't be read as {self.what}: {error}") from error
        if not isinstance(recording, HandRecording):
            raise ConfigError(
                f"the reader of {self.what} must return a HandRecording, not "
                f"{type(recording).__name__}"
            )
        return recording


_ARRAYS: Final = Entry("smooth_operator.formats.readers:read_arrays")

NPY: Final = Reader("a .npy of landmarks (T, 21, 3) [m]", _ARRAYS, (NPY_MAGIC,), (".npy",))
NPZ: Final = Reader(
    "a MANUS .npz or an .npz of landmarks", _ARRAYS, (b"PK\x03\x04", b"PK\x05\x06"), (".npz",)
)
LOG: Final = Reader(
    "this program's own .mcap log",
    Entry(f"{_RECORDING}.log_reader:read_log_recording"),
    (MCAP_MAGIC,),
    (".mcap",),
)
HDF5: Final = Reader(
    "this program's own .h5 file",
    Entry("smooth_operator.episode_files.hdf5:read_hdf5_recording"),
    (b"\x89HDF\r\n\x1a\n",),
    (".h5", ".hdf5"),
)
AVP: Final = Reader(
    "a .jsonl of Tracking Streamer (Vision Pro)",
    Entry("smooth_operator.headsets.recordings:read_avp_recording"),
    tuple(
        f'{{"{key}"'.encode()
        for key in (
            *("timestamp", "systemTime", "headMatrix", "leftHand", "rightHand"),
            *("videoFrameIndex", "videoWidth", "videoHeight"),
        )
    ),
    (".jsonl",),
)
HTS: Final = Reader(
    "the lines of Hand Tracking Streamer (Quest)",
    Entry("smooth_operator.headsets.recordings:read_hts_lines"),
    tuple(
        f"{start}{who}".encode()
        for start in ("", "\n")
        for who in ("Right wrist", "Left wrist", "Right landmarks", "Left landmarks", "Head pose")
    ),
    (".hts",),
)
READERS: Final = Registry(
    "reader",
    {
        "npy": Entry(f"{_HERE}:NPY", NPY.what),
        "npz": Entry(f"{_HERE}:NPZ", NPZ.what),
        "log": Entry(f"{_HERE}:LOG", LOG.what),
        "hdf5": Entry(f"{_HERE}:HDF5", HDF5.what),
        "avp": Entry(f"{_HERE}:AVP", AVP.what),
        "hts": Entry(f"{_HERE}:HTS", HTS.what),
    },
    needs=("what", "recognises", "read_file"),
)
"""Maps names to ``Reader``. The first reader that recognises a file reads it."""


def find_reader(name: str) -> Reader:
    """Returns the reader with a name.

    Raises:
        UnknownNameError: there is none.
        ConfigError: the reader of a plugin can't be loaded or is not a ``Reader``.
    """
    reader: Reader = READERS.load(name)
    READERS.check(name, reader)
    return reader


def recording_suffixes() -> tuple[str, ...]:
    """Suffixes of the files that are read as recordings, in lower case."""
    readers = READERS.loadable(find_reader).values()
    return tuple(dict.fromkeys(suffix for reader in readers for suffix in reader.suffixes))


def readable() -> str:
    """List of the formats that are read, for error messages."""
    readers = READERS.loadable(find_reader)
    *most, last = (
        "a MANUS .npz",
        "a .npy or .npz of landmarks (T, 21, 3) [m]",
        AVP.what,
        HTS.what,
        LOG.what,
        HDF5.what,
        *(readers[name].what for name in READERS.plugins if name in readers),
    )
    return f"{', '.join(most)} and {last}"


_PICKLE_SUFFIXES = (".pkl", ".pickle", ".pck", ".p")


def file_kind(path: Path) -> str:
    """Find the format of a file by its first bytes or, for some plugins, by its suffix.

    Returns:
        Its name in ``READERS``.

    Raises:
        RecordingError: if there is no such file, it can't be opened, is empty, a pickle, or of a
            format that is not read here.
    """
    try:
        if not path.is_dir():
            check_plain_file(path)
        with path.open("rb") as stream:
            head = stream.read(128)
    except DocumentError as error:
        raise RecordingError(f"{path}: {error}; name the file of a recording") from None
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file; check the name and the folder") from None
    except IsADirectoryError:
        raise _is_a_folder(path) from None
    except OSError as error:
        if path.is_dir():  # Windows calls that a lack of permission
            raise _is_a_folder(path) from None
        raise RecordingError(f"{path}: can't be opened: {error.strerror or error}") from error
    if not head:
        raise RecordingError(f"{path}: the file is empty (0 bytes); record or copy it again")
    built_in = [find_reader(name) for name in READERS.built_in]
    for name, reader in zip(READERS.built_in, built_in, strict=True):
        if reader.recognises(path, head):
            return name
    # Protocols 2 to 5 announce themselves; 0 and 1 are text that only the name gives away.
    pickled = (len(head) > 1 and head[0] == 0x80 and head[1] in range(2, 6)) or (
        path.suffix.lower() in _PICKLE_SUFFIXES
    )
    if READERS.plugins and not pickled:
        for name, reader in READERS.loadable(find_reader).items():
            if reader.recognises(path, head):
                return name
    if is_video_head(head):
        raise RecordingError(
            f"{path}: this is a video; track the hand in it first: smooth-operator convert "
            f"{path} --output {path.with_suffix('.npz').name}; or drive a hand from it live: "
            f"smooth-operator teleop --source video:{path} (webcam extra)"
        )
    if any(magic.startswith(head) for reader in built_in for magic in reader.magic):
        raise RecordingError(
            f"{path}: the file is cut off after {len(head)} bytes, before its first frame; record "
            "or copy it again"
        )
    if pickled:
        raise RecordingError(f"{path}: this is a pickle; {PICKLE_REMEDY}")
    kind = foreign_file(path)
    if kind is not None:
        raise RecordingError(f"{path}: this is {kind}")
    raise RecordingError(
        f"{path}: not a recording: it starts with {head[:8]!r}. Readable files: {readable()}"
    )


def is_video_head(head: bytes) -> bool:
    """True for a video, by the first 12 bytes of the file: MP4 and MOV, AVI, Matroska and WebM."""
    return (
        head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free")
        or head.startswith(b"\x1aE\xdf\xa3")
        or (head.startswith(b"RIFF") and head[8:12] == b"AVI ")
    )


def _is_a_folder(path: Path) -> RecordingError:
    if is_dataset(path):
        foreign = foreign_dataset(path)
        if foreign is not None:
            return RecordingError(f"{path}: this is {foreign}")
        return RecordingError(
            f"{path}: this is a LeRobot dataset; convert one of its episodes first: "
            f"smooth-operator convert {path} --episode 0 --output episode.npz"
        )
    return RecordingError(f"{path}: this is a folder; name one of the files in it")
