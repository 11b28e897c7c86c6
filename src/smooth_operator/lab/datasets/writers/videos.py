"""Videos of clips in LeRobot's layout: what an MP4 file holds, and links to it or copies of it.

Nothing is decoded. LeRobot finds a frame by its time, so a video fits a data set only if its frames
are as many a second as the data set's, all of the same length.
"""

from __future__ import annotations

import os
import shutil
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import IO, Any, Final

from smooth_operator.errors import RecordingError, reason
from smooth_operator.lab.datasets.writers.shards import hidden, remove

VIDEO_KEY: Final = "observation.images.camera"
_CODECS: Final = {
    b"avc1": "h264", b"avc3": "h264", b"hvc1": "hevc", b"hev1": "hevc", b"av01": "av1",
    b"vp09": "vp9", b"mp4v": "mpeg4",
}  # fmt: skip
_MOST_HEAD: Final = 1 << 26  # bytes of tables; of a video of a day they have fewer
_INSIDE: Final = {b"moov", b"trak", b"mdia", b"minf", b"stbl"}


@dataclass(frozen=True)
class VideoHead:
    """Header of an MP4 file's picture.

    Attributes:
        width: width of the picture [pixels].
        height: height of the picture [pixels].
        rate: frames a second.
        frames: number of frames.
        codec: name of the format of the frames, as FFmpeg has it.
    """

    width: int
    height: int
    rate: Fraction
    frames: int
    codec: str

    def feature(self) -> dict[str, Any]:
        """The video in the ``features`` of LeRobot's ``meta/info.json``."""
        rate = int(self.rate) if self.rate.denominator == 1 else float(self.rate)
        return {
            "dtype": "video",
            "shape": [self.height, self.width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": self.height,
                "video.width": self.width,
                "video.codec": self.codec,
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False,
                "video.fps": rate,
                "video.channels": 3,
                "has_audio": False,
            },
        }


def video_head(path: Path) -> VideoHead:
    """Reads the tables of an MP4 or QuickTime file.

    Raises:
        RecordingError: there is no such file, it is no MP4, has no picture, or its frames do not
            all last as long.
    """
    try:
        with path.open("rb") as file:
            tracks = [track for track in _tracks(file, path) if track is not None]
    except FileNotFoundError:
        raise RecordingError(
            f"{path}: no such video; give --videos none, or put it there"
        ) from None
    except (OSError, struct.error, ValueError) as error:
        raise RecordingError(
            f"{path}: can't be read as an MP4 video ({reason(error)}); convert it to MP4"
        ) from error
    if not tracks:
        raise RecordingError(f"{path}: no MP4 video with a picture; convert it to MP4")
    return tracks[0]


def _tracks(file: IO[bytes], path: Path) -> Iterator[VideoHead | None]:
    size = os.fstat(file.fileno()).st_size
    at = 0
    while at + 8 <= size:
        file.seek(at)
        kind, head, length = _box(file.read(16), size - at)
        if kind == b"moov":
            if length > _MOST_HEAD:
                raise ValueError(f"{length} bytes of tables")
            file.seek(at + head)
            content = file.read(length - head)
            for name, track in _boxes(content):
                if name == b"trak":
                    yield _track(dict(_leaves(track)), path)
            return
        at += length


def _box(data: bytes, left: int) -> tuple[bytes, int, int]:
    """(kind, bytes of its head, bytes in all) of the box at the beginning."""
    length, kind = struct.unpack_from(">I4s", data)
    head = 8
    if length == 1:
        (length,) = struct.unpack_from(">Q", data, 8)
        head = 16
    if length == 0:
        length = left
    if length < head or length > left:
        raise ValueError(f"a box {kind!r} of {length} bytes")
    return kind, head, length


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 8 <= len(data):
        kind, head, length = _box(data[at : at + 16], len(data) - at)
        yield kind, data[at + head : at + length]
        at += length


def _leaves(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    for kind, content in _boxes(data):
        if kind in _INSIDE:
            yield from _leaves(content)
        else:
            yield kind, content


def _track(boxes: dict[bytes, bytes], path: Path) -> VideoHead | None:
    if not {b"hdlr", b"mdhd", b"stsd", b"stts"} <= boxes.keys() or boxes[b"hdlr"][8:12] != b"vide":
        return None
    (scale,) = struct.unpack_from(">I", boxes[b"mdhd"], 20 if boxes[b"mdhd"][0] == 1 else 12)
    entry = boxes[b"stsd"][8:]
    width, height = struct.unpack_from(">HH", entry, 32)
    (count,) = struct.unpack_from(">I", boxes[b"stts"], 4)
    if len(boxes[b"stts"]) < 8 + 8 * count:
        raise ValueError("a table of times that is cut off")
    steps = [struct.unpack_from(">II", boxes[b"stts"], 8 + 8 * i) for i in range(count)]
    frames = sum(number for number, _ in steps)
    # The last frame may last as long as it likes: nothing comes after it.
    lengths = {length for number, length in steps[:-1]} | {
        length for number, length in steps[-1:] if number > 1 or count == 1
    }
    if len(lengths) != 1 or 0 in lengths or not scale or not width or not height:
        raise RecordingError(
            f"{path}: its frames do not all last as long, so LeRobot can't find one by its time; "
            "convert it with a constant frame rate (ffmpeg -fps_mode cfr)"
        )
    codec = _CODECS.get(entry[4:8], entry[4:8].decode("latin-1").strip())
    return VideoHead(width, height, Fraction(scale, lengths.pop()), frames, codec)


def place(source: Path, target: Path, how: str) -> None:
    """Links a video, by a hard link or else a symbolic one, or copies it.

    Raises:
        OSError: it can't be written.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = hidden(target)
    remove(target)  # a link to the same file would stay under its hidden name
    real = Path(os.path.realpath(source))
    if how == "copy":
        shutil.copyfile(real, temporary)
    else:
        try:
            os.link(real, temporary)
        except OSError:  # on another disk, or this one has none
            temporary.symlink_to(real)
    os.replace(temporary, target)
