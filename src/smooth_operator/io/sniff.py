"""Telling what a file is from its first bytes, and refusing what can't be a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, TypeAlias

from smooth_operator.errors import DocumentError, RecordingError
from smooth_operator.io.documents import check_plain_file

FileKind: TypeAlias = Literal["npy", "npz", "log", "hdf5"]

NPY_MAGIC = b"\x93NUMPY"
MCAP_MAGIC = b"\x89MCAP0\r\n"
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_ZIP_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
_PICKLE_SUFFIXES = (".pkl", ".pickle", ".pck", ".p")

# Formats that people bring, and the shortest way from them to one that is read here.
_OTHERS = {
    b"\x1f\x8b": "gzip-compressed; unpack it first",
    b"BZh": "bzip2-compressed; unpack it first",
    b"\xfd7zXZ\x00": "xz-compressed; unpack it first",
    b"\x28\xb5\x2f\xfd": "zstd-compressed; unpack it first",
    b"PAR1": "a Parquet file; give the whole LeRobot dataset folder to 'smooth-operator convert'",
    b"MATLAB": "a MATLAB file; save its landmarks with numpy.savez",
    b"#ROSBAG": "a ROS bag; save its landmarks with numpy.savez",
    b"version https://git-lfs": "a Git LFS pointer, not the data; run 'git lfs pull'",
}

READABLE = (
    "a MANUS .npz, a .npy or .npz of landmarks (T, 21, 3) [m], and this program's own .mcap log "
    "and .h5 file"
)
"""What can be read, for error messages."""

PICKLE_REMEDY = (
    "pickles can run any code when they are read and are never opened here. Convert it once, where "
    "you trust the file: numpy.savez('recording.npz', landmarks=<array of shape (T, 21, 3), in "
    "metres>, timestamps=<array of shape (T,), in seconds>, side='right')"
)


def file_kind(path: Path) -> FileKind:
    """Find the format of a file from its content.

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
        raise RecordingError(f"{path}: {error}; give the file of a recording") from None
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
    if head.startswith(NPY_MAGIC):
        return "npy"
    if head.startswith(_ZIP_MAGICS):
        return "npz"
    if head.startswith(MCAP_MAGIC):
        return "log"
    if head.startswith(HDF5_MAGIC):
        return "hdf5"
    if is_video_head(head):
        raise RecordingError(
            f"{path}: this is a video; track the hand in it first: smooth-operator convert {path} "
            f"--output {path.with_suffix('.npz').name}; or drive a hand from it live: "
            f"smooth-operator teleop --source video:{path} (extra webcam)"
        )
    if len(head) < len(MCAP_MAGIC) and any(
        magic.startswith(head) for magic in (NPY_MAGIC, MCAP_MAGIC, HDF5_MAGIC, *_ZIP_MAGICS)
    ):
        raise RecordingError(
            f"{path}: the file is cut off after {len(head)} bytes, before its first frame; record "
            "or copy it again"
        )
    # Protocols 2 to 5 announce themselves; 0 and 1 are text that only the name gives away.
    if (len(head) > 1 and head[0] == 0x80 and head[1] in range(2, 6)) or (
        path.suffix.lower() in _PICKLE_SUFFIXES
    ):
        raise RecordingError(f"{path}: this is a pickle; {PICKLE_REMEDY}")
    for magic, what in _OTHERS.items():
        if head.startswith(magic):
            raise RecordingError(f"{path}: this is {what}. What is read: {READABLE}")
    raise RecordingError(
        f"{path}: not a recording: it starts with {head[:8]!r}. What is read: {READABLE}"
    )


def is_video_head(head: bytes) -> bool:
    """Whether a file is a video, by its first 12 bytes: MP4 and MOV, AVI, Matroska and WebM."""
    return (
        head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free")
        or head.startswith(b"\x1aE\xdf\xa3")
        or (head.startswith(b"RIFF") and head[8:12] == b"AVI ")
    )


def is_dataset(path: Path) -> bool:
    """Whether a folder is a LeRobot dataset, of whatever version and program."""
    return (path / "meta" / "info.json").is_file()


def _is_a_folder(path: Path) -> RecordingError:
    if is_dataset(path):
        return RecordingError(
            f"{path}: this is a LeRobot dataset; convert an episode of it first: smooth-operator "
            f"convert {path} --episode 0 --output episode.npz"
        )
    return RecordingError(f"{path}: this is a folder; give one of the files in it")
