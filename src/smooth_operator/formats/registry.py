"""Registry of the readers, built-in and from plugins; it determines which reader reads a file.

A reader returns clips. A recording is a clip of one hand; ``read_recording`` returns the hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

from smooth_operator.errors import (
    ConfigError,
    DocumentError,
    RecordingError,
    SmoothOperatorError,
    listed,
)
from smooth_operator.extras import PART_OF_DATA_SETS
from smooth_operator.formats.arrays import PICKLE_REMEDY
from smooth_operator.formats.both_hands import checked_hands, on_common_stamps, one_hand
from smooth_operator.formats.checks import (
    check_anatomy,
    check_rate,
    check_recording,
    without_outliers,
)
from smooth_operator.formats.clip import NOTES, ORDER, RATE, Clip, ClipRef, ReadingOptions
from smooth_operator.formats.foreign import foreign_dataset, foreign_file
from smooth_operator.formats.foreign import is_dataset as is_dataset
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.plugins import Entry, Registry
from smooth_operator.types import HandRecording, Side

NPY_MAGIC: Final = b"\x93NUMPY"
MCAP_MAGIC: Final = b"\x89MCAP0\r\n"

_Read = TypeVar("_Read")

_HEAD_BYTES: Final = 128
_FORMATS: Final = "smooth_operator.formats"
_EPISODES: Final = "smooth_operator.episode_files"
_HEADSETS: Final = "smooth_operator.headsets.recordings"
_RECORDING: Final = "smooth_operator.teleop.recording"

RESEARCH_LAYOUTS: Final = (
    *("arctic", "dexycb", "dynhamr", "egohandkit", "grab", "hawor", "ho3d", "hot3d", "mano"),
    *("oakink2", "predictions", "taco"),
)
"""Layouts that smooth-hand-datasets reads."""


class ClipReader(Protocol):
    """Reader of one layout of files or folders. It finds the clips in them, and reads a clip."""

    what: str
    """Description of its files, for messages, such as ``an HDF5 file of EgoDex``."""

    expects: str
    """Names of the files and arrays that it needs, for messages."""

    def matches(self, path: Path) -> bool:
        """True if a file or folder has this layout. Reads as little of it as possible.

        A folder is tested before its contents. A folder that matches is not searched further.
        """

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """Yields references to the clips of a matching file or folder, in order of their names;
        reads no arrays.
        """

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Reads one clip.

        Raises:
            RecordingError: the files differ from the layout; the message names what was expected
                and what was found, and says what to do.
            MissingExtraError: a library is missing.
        """


@dataclass(frozen=True)
class Reader:
    """Reader of a file format with one recording per file, which is a clip of one hand or of both
    hands.

    Attributes:
        what: description of its files, for messages, such as ``a .csv file of landmarks``.
        read_hand: ``read_hand(path, rate, side, layout)`` returns the recording of one hand:
            ``rate`` [Hz] for a file without stamps, ``side`` and ``layout`` (the order of 21
            landmarks, by its name) as given by the caller, each None if the caller does not state
            it. Raises ``RecordingError`` if the file can't be used. The result is checked like
            other recordings. This is a function, or the path from which it is imported when a file
            is read. None for a format with both hands.
        magic: possible first bytes of its files.
        suffixes: suffixes of its files, in lower case (``.csv``). They select the files of a
            folder; for a format without ``magic``, they also identify its files.
        expects: expected content of a file, for messages.
        read_hands: ``read_hands(path, rate, side)`` returns the recordings of all hands by side,
            for a format whose clips have both; ``side`` is that of a file that does not state it.
            None for a format with one hand.

    Raises:
        ConfigError: neither ``magic`` nor ``suffixes`` is given, or no function that reads.
    """

    what: str
    read_hand: Callable[[Path, float | None, Side | None, str | None], HandRecording] | Entry | None
    magic: tuple[bytes, ...] = ()
    suffixes: tuple[str, ...] = ()
    expects: str = "a recording of one hand"
    read_hands: (
        Callable[[Path, float | None, Side | None], dict[Side, HandRecording]] | Entry | None
    ) = None

    def __post_init__(self) -> None:
        if not (self.magic or self.suffixes):
            raise ConfigError(
                f"a reader of {self.what} must have magic (first bytes) or suffixes, to "
                "recognise its files"
            )
        if self.read_hand is None and self.read_hands is None:
            raise ConfigError(f"a reader of {self.what} must have read_hand or read_hands")

    def recognises(self, path: Path, head: bytes) -> bool:
        """True for a file of this format.

        Args:
            path: the file.
            head: its first 128 bytes, or fewer.
        """
        if self.magic:
            return head.startswith(self.magic)
        return path.suffix.lower() in self.suffixes

    def matches(self, path: Path) -> bool:
        """True for a file with a suffix of this format and the first bytes of this format."""
        if path.suffix.lower() not in self.suffixes or not path.is_file():
            return False
        with path.open("rb") as stream:
            return self.recognises(path, stream.read(_HEAD_BYTES))

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """Yields the reference to the only clip of a file."""
        yield ClipRef(path.stem, path, size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Reads the clip of a file. If it has both hands, they have common timestamps, and a
        missing hand is NaN. Raises RecordingError if the file can't be used, or if its units, order
        or side are wrong."""
        if self.read_hands is not None:
            where = str(ref.path)
            hands = _loaded(self.read_hands)(ref.path, options.rate, options.side)
            checked = checked_hands(on_common_stamps(hands, where), where, self.expects)
            form = next(iter(checked.values())).meta["format"]
            return Clip(ref.name, checked, form, (ref.path,), meta={"form": form})
        return self.read_one_hand(ref, options)

    def read_one_hand(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Reads one hand of a file as a clip; see ``read``."""
        recording, rate = rated_if_unstamped(
            lambda rate: with_assumed_side(
                lambda side: self.recording(ref.path, rate, side, options.order),
                options.side,
                options.assumed,
            ),
            options.rate,
        )
        notes = []
        if recording.meta.get("side_assumed"):
            notes.append(
                "the side is not stated, so right is assumed; if it is a left hand, use --side left"
            )
        if ignored := recording.meta.get("ignored"):
            notes.append(f"ignored: {listed(ignored)}")
        facts = {NOTES: notes, RATE: rate, ORDER: options.order}
        meta = {name: value for name, value in facts.items() if value}
        return Clip(ref.name, {recording.side: recording}, "files", (ref.path,), meta=meta)

    def recording(
        self, path: Path, rate: float | None, side: Side | None, layout: str | None
    ) -> HandRecording:
        """Reads and checks one hand of a file; the arguments are those of ``read_recording``.

        Raises:
            RecordingError: the file can't be used.
            ConfigError: ``read_hand`` can't be imported, or does not return a recording.
            MissingExtraError: the format needs an extra that is not installed.
        """
        try:
            recording: Any
            if self.read_hand is not None:
                recording = _loaded(self.read_hand)(path, rate, side, layout)
            elif self.read_hands is not None:
                recording = one_hand(_loaded(self.read_hands)(path, rate, side), side, path)
        except SmoothOperatorError:
            raise
        except (OSError, ValueError) as error:  # of a plugin that leaves a bad file to NumPy
            raise RecordingError(f"{path}: can't be read as {self.what}: {error}") from error
        if not isinstance(recording, HandRecording):
            raise ConfigError(
                f"the reader of {self.what} must return a HandRecording, not "
                f"{type(recording).__name__}"
            )
        check_anatomy(recording, str(path), side=side)
        check_recording(recording, str(path))
        check_rate(recording.stamps, rate, str(path))
        return without_outliers(recording)


def _loaded(function: Callable[..., Any] | Entry) -> Callable[..., Any]:
    return function.load() if isinstance(function, Entry) else function


def rated_if_unstamped(
    read: Callable[[float | None], _Read], rate: float | None
) -> tuple[_Read, float | None]:
    """Reads a file without the rate first and, if that fails, with the rate, which files without
    timestamps need.

    Args:
        read: reads the file with a rate [Hz], or with None.
        rate: rate of files without stamps [Hz]; None if the caller has none.

    Returns:
        the result of ``read``, and the rate if it was needed.

    Raises:
        RecordingError: as ``read``.
    """
    try:
        return read(None), None
    except RecordingError:
        if rate is None:
            raise
        return read(rate), rate


def with_assumed_side(
    read: Callable[[Side | None], HandRecording], side: Side | None, assumed: Side
) -> HandRecording:
    """Reads a recording; a file that states no side is read as a hand of the side ``assumed``.

    Args:
        read: reads the file as a hand of the given side, or of the file's own side for None.
        side: side that the caller requests.

    Raises:
        RecordingError: as ``read``.
    """
    if side is None and assumed == "left":
        with suppress(RecordingError):  # it is a right hand, by its side or by its shape
            return read("left")
    return read(side)


_ARRAYS: Final = Entry(f"{_FORMATS}.readers:read_arrays")

NPY: Final = Reader("a .npy file of landmarks (T, 21, 3) [m]", _ARRAYS, (NPY_MAGIC,), (".npy",))
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
    Entry(f"{_EPISODES}.hdf5:read_hdf5_recording"),
    (b"\x89HDF\r\n\x1a\n",),
    (".h5", ".hdf5"),
)
AVP: Final = Reader(
    "a .jsonl file of Tracking Streamer (Vision Pro)",
    None,
    tuple(
        f'{{"{key}"'.encode()
        for key in (
            *("timestamp", "systemTime", "headMatrix", "leftHand", "rightHand"),
            *("videoFrameIndex", "videoWidth", "videoHeight"),
        )
    ),
    (".jsonl",),
    "lines of JSON with 'timestamp', 'leftHand' and 'rightHand'; each hand has 'wrist' and 24 "
    "joints of 16 numbers each",
    Entry(f"{_HEADSETS}:read_avp_hands"),
)
HTS: Final = Reader(
    "a text recording of Hand Tracking Streamer (Quest)",
    None,
    tuple(
        f"{start}{who}".encode()
        for start in ("", "\n")
        for who in ("Right wrist", "Left wrist", "Right landmarks", "Left landmarks", "Head pose")
    ),
    (".hts",),
    "lines 'Right wrist:, ...' and 'Right landmarks:, ...', or the same with 'Left'",
    Entry(f"{_HEADSETS}:read_hts_hands"),
)
BVH: Final = Reader(
    "a .bvh file of body motion capture with fingers",
    None,
    (b"HIERARCHY", b"\xef\xbb\xbfHIERARCHY"),
    (".bvh",),
    "finger joints, named as in Axis Studio, MotionBuilder, hc_mocap, Xsens or Rokoko",
    Entry(f"{_FORMATS}.bvh:read_bvh_hands"),
)
ARIA_CSV: Final = Reader(
    "hand_tracking_results.csv of Project Aria",
    None,
    (b"tracking_timestamp_us", b"\xef\xbb\xbftracking_timestamp_us"),
    (".csv",),
    "columns tracking_timestamp_us, left_tracking_confidence, tx_left_landmark_0_device ... "
    "tz_right_landmark_20_device",
    Entry(f"{_FORMATS}.landmark_csv:read_aria_hands"),
)
LANDMARK_CSV: Final = Reader(
    "a .csv file of landmarks with a header",
    None,
    tuple(
        f"{mark}{stamp}{side}wrist_x".encode()
        for mark in ("", "\ufeff")
        for stamp in ("", "timestamp,")
        for side in ("", "side,")
    ),
    (".csv",),
    "columns timestamp [s], side, and wrist_x, wrist_y, wrist_z ... pinky_tip_z [m]",
    Entry(f"{_FORMATS}.landmark_csv:read_landmark_csv_hands"),
)
ONE_HAND: Final = {
    **{"npy": NPY, "npz": NPZ, "log": LOG, "hdf5": HDF5, "avp": AVP, "hts": HTS},
    **{"bvh": BVH, "aria_csv": ARIA_CSV, "landmark_csv": LANDMARK_CSV},
}
"""Built-in formats of recordings: name -> reader. The first one that recognises a file reads it."""
READERS: Final = Registry(
    "reader",
    {
        **{
            name: Entry(f"{_FORMATS}.registry:{name.upper()}", reader.what)
            for name, reader in ONE_HAND.items()
        },
        "egodex": Entry(
            f"{_EPISODES}.egodex:EGODEX", "EgoDex: HDF5 of both hands, camera and task"
        ),
        "landmarks": Entry(
            f"{_EPISODES}.landmark_pairs:LANDMARKS_OF_BOTH_HANDS",
            "an .npz file with 'right' and 'left'",
        ),
        "parquet": Entry(
            f"{_EPISODES}.packed:PACKED",
            "clips written by 'smooth-operator dataset --format parquet'",
        ),
        "files": Entry(
            f"{_FORMATS}.readers:FILES", "any recording of one hand that 'retarget' reads"
        ),
    },
    needs=("what", "expects", "matches", "clips", "read"),
    elsewhere=dict.fromkeys(RESEARCH_LAYOUTS, PART_OF_DATA_SETS),
)
"""Name -> ``ClipReader``, such as a ``Reader``, open to plugins as ``smooth_operator.readers``.
``--layout`` takes one of these names."""


def find_reader(name: str) -> ClipReader:
    """Returns the reader of a given name.

    Raises:
        UnknownNameError: there is no such reader.
        ConfigError: the reader of a plugin can't be loaded or lacks an attribute of a reader.
    """
    reader: ClipReader = READERS.load(name)
    READERS.check(name, reader)
    return reader


def recording_format(kind: str) -> Reader:
    """Returns the reader for a kind of recording, as named by ``file_kind``."""
    return _recording_formats()[kind] if kind not in ONE_HAND else ONE_HAND[kind]


def _recording_formats() -> dict[str, Reader]:
    """Formats of recordings by name, built-in ones first."""
    if not READERS.plugins:
        return ONE_HAND
    readers = READERS.loadable(find_reader)
    return {name: reader for name, reader in readers.items() if isinstance(reader, Reader)}


def clip_readers() -> dict[str, ClipReader]:
    """Returns the readers by name, in the order in which they are asked whether they match a path.

    Readers whose attribute ``generic`` is true come after the others. ``files``, the last, reads
    all formats with one hand.
    """
    parts = READERS.loadable(find_reader)
    names = [n for n, r in parts.items() if not isinstance(r, Reader) or r.read_hands is not None]
    names.sort(key=lambda n: (n == "files", getattr(parts[n], "generic", False)))
    return {name: parts[name] for name in names}


def recognise(path: Path, layout: str | None) -> tuple[str, ClipReader] | None:
    """Returns the name and the reader of a file or folder; None if no reader matches.

    Args:
        layout: name of the only reader to ask; None to ask all.

    Raises:
        UnknownNameError: there is no reader of the name ``layout``.
    """
    choice = clip_readers() if layout is None else {layout: find_reader(layout)}
    for name, reader in choice.items():
        with suppress(Exception):  # a file that makes a reader stumble is not of its layout
            if reader.matches(path):
                return name, reader
    return None


def recording_suffixes() -> tuple[str, ...]:
    """Suffixes of the files that are read as recordings, in lower case."""
    readers = _recording_formats().values()
    return tuple(dict.fromkeys(suffix for reader in readers for suffix in reader.suffixes))


def named_as_recording(path: Path) -> bool:
    """True if a file has the suffix of a recording. A table must also have the header of a
    recording, because most tables in a folder of recordings contain other data."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return any(reader.matches(path) for reader in _recording_formats().values())
    return suffix in recording_suffixes()


def files_below(folder: Path, leave: Iterable[Path] = ()) -> Iterator[Path]:
    """Yields the files and LeRobot data sets in a folder and its subfolders, sorted by name within
    each folder. Hidden files are skipped; links are followed once.

    Args:
        leave: resolved files and folders to skip.

    Raises:
        RecordingError: a folder can't be read.
    """
    seen = {folder.resolve(), *leave}

    def walk(folder: Path) -> Iterator[Path]:
        try:
            entries = sorted(folder.iterdir())
        except OSError as error:
            raise RecordingError(f"{folder}: can't be read: {error.strerror}") from error
        for path in entries:
            real = path.resolve()
            if path.name.startswith(".") or real in seen:
                continue
            if path.is_dir() and not is_dataset(path):
                seen.add(real)
                yield from walk(path)
            else:
                yield path

    return walk(folder)


def readable() -> str:
    """Lists the formats that can be read, for error messages."""
    *most, last = (reader.what for reader in _recording_formats().values())
    return f"{', '.join(most)} and {last}"


_PICKLE_SUFFIXES = (".pkl", ".pickle", ".pck", ".p")


def file_kind(path: Path) -> str:
    """Finds the format of a file by its first bytes or, for some plugins, by its suffix.

    Returns:
        Its name in ``READERS``.

    Raises:
        RecordingError: the file does not exist, can't be opened, is empty, is a pickle, or has a
            format that can't be read.
    """
    try:
        if not path.is_dir():
            check_plain_file(path)
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
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
    for name, reader in ONE_HAND.items():
        if reader.recognises(path, head):
            return name
    # Protocols 2 to 5 announce themselves; 0 and 1 are text that only the name gives away.
    pickled = (len(head) > 1 and head[0] == 0x80 and head[1] in range(2, 6)) or (
        path.suffix.lower() in _PICKLE_SUFFIXES
    )
    if READERS.plugins and not pickled:
        for name, reader in _recording_formats().items():
            if reader.recognises(path, head):
                return name
    if is_video_head(head):
        raise RecordingError(
            f"{path}: this is a video; track the hand in it first: smooth-operator convert "
            f"{path} --output {path.with_suffix('.npz').name}; or drive a hand from it live: "
            f"smooth-operator teleop --source video:{path} (webcam extra)"
        )
    if any(magic.startswith(head) for reader in ONE_HAND.values() for magic in reader.magic):
        raise RecordingError(
            f"{path}: the file ends after {len(head)} bytes, before its first frame; record or "
            "copy it again"
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
    """True if the first 12 bytes of a file are those of a video: MP4, MOV, AVI, Matroska or
    WebM."""
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
            f"smooth-operator convert {path} --episode 0 --output episode.npz; or derive the "
            f"actions of another robot hand: smooth-operator retarget --dataset {path}"
        )
    return RecordingError(f"{path}: this is a folder; name one of the files in it")
