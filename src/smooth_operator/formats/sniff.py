"""Recognises the format of a file by its first bytes."""

from __future__ import annotations

from pathlib import Path

from smooth_operator.errors import DocumentError, RecordingError
from smooth_operator.formats.arrays import PICKLE_REMEDY
from smooth_operator.formats.registry import READERS, find_reader, readable
from smooth_operator.io.documents import check_plain_file

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


def file_kind(path: Path) -> str:
    """Find the format of a file: by its first bytes, or by its suffix where a plugin says so.

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
            f"{path}: this is a video; track the hand in it first: smooth-operator convert {path} "
            f"--output {path.with_suffix('.npz').name}; or drive a hand from it live: "
            f"smooth-operator teleop --source video:{path} (extra webcam)"
        )
    if any(magic.startswith(head) for reader in built_in for magic in reader.magic):
        raise RecordingError(
            f"{path}: the file is cut off after {len(head)} bytes, before its first frame; record "
            "or copy it again"
        )
    if pickled:
        raise RecordingError(f"{path}: this is a pickle; {PICKLE_REMEDY}")
    for magic, what in _OTHERS.items():
        if head.startswith(magic):
            raise RecordingError(f"{path}: this is {what}. What is read: {readable()}")
    raise RecordingError(
        f"{path}: not a recording: it starts with {head[:8]!r}. What is read: {readable()}"
    )


def is_video_head(head: bytes) -> bool:
    """True for a video, by the first 12 bytes of the file: MP4 and MOV, AVI, Matroska and WebM."""
    return (
        head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free")
        or head.startswith(b"\x1aE\xdf\xa3")
        or (head.startswith(b"RIFF") and head[8:12] == b"AVI ")
    )


def is_dataset(path: Path) -> bool:
    """True for the folder of a LeRobot dataset, of any version and program."""
    return (path / "meta" / "info.json").is_file()


def _is_a_folder(path: Path) -> RecordingError:
    if is_dataset(path):
        return RecordingError(
            f"{path}: this is a LeRobot dataset; convert an episode of it first: smooth-operator "
            f"convert {path} --episode 0 --output episode.npz"
        )
    return RecordingError(f"{path}: this is a folder; give one of the files in it")
