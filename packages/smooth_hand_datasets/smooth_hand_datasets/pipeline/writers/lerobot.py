"""Writer of LeRobot data sets, version 3.0, with the robot's state and action.

::

    meta/info.json, stats.json, tasks.parquet       as LeRobot defines them, for all complete shards
    meta/episodes/chunk-000/file-000.parquet        the episodes of one shard
    meta/shards/, meta/configurations/              for continued runs; LeRobot ignores them
    data/chunk-000/file-000.parquet                 the frames of a shard, one row group per episode
    videos/observation.images.camera/chunk-000/     the source's videos, one file each
    README.md                                       the columns and their units

A LeRobot data set has one frame rate. Clips that deviate from it by more than a quarter of a frame
are resampled. One writer writes all shards, because frames are numbered across them.

Videos are linked or copied, not decoded. LeRobot finds a frame by its time, so a video must have
the frame rate of the data set, and frames of equal length.
"""

from __future__ import annotations

import os
import shutil
import struct
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.arrays import clip_document, drift, resampled
from smooth_hand_datasets.pipeline.writers.lerobot_columns import RobotLayout
from smooth_hand_datasets.pipeline.writers.registry import DatasetFormat, WritingOptions
from smooth_hand_datasets.pipeline.writers.shards import (
    ShardedWriter,
    drop_parquet,
    hidden,
    publish,
    remove,
)
from smooth_operator.atomic_files import atomic_write
from smooth_operator.episode_files.lerobot.schema import dataset_features, index_columns
from smooth_operator.episode_files.lerobot.tables import (
    DATA_PATH,
    EPISODES_PATH,
    FILE_MB,
    FILES_A_CHUNK,
    OWN_COLUMN,
    UNNAMED_TASK,
    VIDEO_PATH,
    Statistics,
    arrow,
    column,
    columns_statistics,
    dataset_info,
    dataset_readme,
    episode_row,
    episodes_table,
    joint_statistics,
    mean_rate,
    parquet,
    standard_fps,
    tasks_table,
    write_description,
)
from smooth_operator.errors import RecordingError, reason
from smooth_operator.io.jsonable import to_json

VIDEO_KEY: Final = "observation.images.camera"
_CODECS: Final = {
    b"avc1": "h264",
    b"avc3": "h264",
    b"hvc1": "hevc",
    b"hev1": "hevc",
    b"av01": "av1",
    b"vp09": "vp9",
    b"mp4v": "mpeg4",
}
_MOST_HEAD: Final = 1 << 26  # bytes of tables; of a video of a day they have fewer
_INSIDE: Final = {b"moov", b"trak", b"mdia", b"minf", b"stbl"}


@dataclass(frozen=True)
class VideoHead:
    """Video track of an MP4 file.

    Attributes:
        width: width of the picture [pixels].
        height: height of the picture [pixels].
        rate: frame rate [Hz].
        frames: number of frames.
        codec: name of the codec in FFmpeg.
    """

    width: int
    height: int
    rate: Fraction
    frames: int
    codec: str

    def feature(self) -> dict[str, Any]:
        """Entry of the video under ``features`` in LeRobot's ``meta/info.json``."""
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
    """Reads the tables of an MP4 or QuickTime file; RecordingError if the file does not exist, is
    not an MP4 file, contains no video, or its frames have different lengths."""
    try:
        with path.open("rb") as file:
            tracks = [track for track in _tracks(file, path) if track is not None]
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such video; add it, or use --videos none") from None
    except (OSError, struct.error, ValueError) as error:
        raise RecordingError(
            f"{path}: can't be read as an MP4 video ({reason(error)}); convert it to MP4"
        ) from error
    if not tracks:
        raise RecordingError(f"{path}: not an MP4 file with a video track; convert it to MP4")
    return tracks[0]


def _tracks(file: IO[bytes], path: Path) -> Iterator[VideoHead | None]:
    size = os.fstat(file.fileno()).st_size
    at = 0
    while at + 8 <= size:
        file.seek(at)
        kind, head, length = _box(file.read(16), size - at)
        if kind == b"moov":
            if length > _MOST_HEAD:
                raise ValueError(f"its box 'moov' has {length} bytes, which is too large")
            file.seek(at + head)
            content = file.read(length - head)
            for name, track in _boxes(content):
                if name == b"trak":
                    yield _track(dict(_leaves(track)), path)
            return
        at += length


def _box(data: bytes, left: int) -> tuple[bytes, int, int]:
    """Kind, length of the header and total length of the first box [bytes]."""
    length, kind = struct.unpack_from(">I4s", data)
    head = 8
    if length == 1:
        (length,) = struct.unpack_from(">Q", data, 8)
        head = 16
    if length == 0:
        length = left
    if length < head or length > left:
        raise ValueError(
            f"its box {kind.decode('latin-1')!r} has the impossible length of {length} bytes"
        )
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
        raise ValueError("a table of times is cut off")
    steps = [struct.unpack_from(">II", boxes[b"stts"], 8 + 8 * i) for i in range(count)]
    frames = sum(number for number, _ in steps)
    # The last frame may last as long as it likes: nothing comes after it.
    lengths = {length for number, length in steps[:-1]} | {
        length for number, length in steps[-1:] if number > 1 or count == 1
    }
    if len(lengths) != 1 or 0 in lengths or not scale or not width or not height:
        raise RecordingError(
            f"{path}: its frames have different durations, so LeRobot can't find one by its time; "
            "convert it with a constant frame rate (ffmpeg -fps_mode cfr)"
        )
    codec = _CODECS.get(entry[4:8], entry[4:8].decode("latin-1").strip())
    return VideoHead(width, height, Fraction(scale, lengths.pop()), frames, codec)


def place(source: Path, target: Path, how: str) -> None:
    """Copies a video or, if ``how`` asks for a link, makes a hard link or else a symbolic link.
    Raises OSError if it can't be written."""
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


_OFF_GRID: Final = 0.25  # frames
_UNITS: Final = {
    "observation.state": "rad, joint positions; m and quaternion wxyz, robot wrists",
    "action": "the state of the next frame",
    VIDEO_KEY: "the source's video",
}
"""Units of the columns whose content differs from those that ``convert`` writes."""
_IMAGENET: Final = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}


class _Writer(ShardedWriter):
    most_clips = 1000  # whose statistics, 50 kB each, are kept until the shard is full

    def __init__(self, output: Path, options: WritingOptions) -> None:
        self._layout: RobotLayout | None = None
        self._episodes = self._frames = 0
        self._tasks: dict[str, int] = {}
        self._videos: dict[str, int] = {}
        self._total: dict[str, Statistics] = {}
        self._tasks_written = -1
        names = ("rate", "videos", "camera", "objects")
        fixed = {name: getattr(options, name) for name in names}
        fixed["joints"] = {side: list(names) for side, names in options.joints.items()}
        super().__init__(output, options, "lerobot", FILE_MB, fixed)

    def _filled(self, template: str, number: int) -> Path:
        chunk, file = divmod(number, FILES_A_CHUNK)
        return self.output / template.format(
            video_key=VIDEO_KEY, chunk_index=chunk, file_index=file
        )

    def _path(self, number: int) -> Path:
        return self._filled(DATA_PATH, number)

    def _video_path(self, number: int) -> Path:
        return self._filled(VIDEO_PATH, number)

    # One shard.

    def _start(self) -> None:
        self._parquet: Any = None
        self._rows: list[dict[str, Any]] = []
        self._statistics: list[dict[str, Statistics]] = []
        self._new_tasks: list[str] = []
        self._new_videos: list[str] = []
        self._shard_frames = 0

    def _add(self, clip: RobotClip, entry: dict[str, Any]) -> None:
        head = self._head(clip)
        if self._layout is None:
            fps = self._fps(clip, head)
            layout = RobotLayout.of(clip, self.options, fps)
            layout.check(clip)
            layout = replace(layout, video=None if head is None else head.feature())
        else:
            layout = self._layout
            layout.check(clip)
            self._check_video(clip, head, layout)
        fps = layout.fps
        if drift(clip.clip.stamps, fps) > _OFF_GRID:
            clip = resampled(clip, fps)
            self.note(f"resampled to {fps:g} frames per second")
        columns = layout.columns(clip)
        video, start = None, 0.0
        if head is not None:
            assert clip.clip.video is not None
            start_frame = round(clip.clip.video_start_s * fps)
            rest = head.frames - start_frame
            if start_frame < 0 or rest < 1:
                raise RecordingError(
                    f"{clip.clip.name}: it begins {clip.clip.video_start_s:g} s after the start of "
                    f"its video {clip.clip.video}, which has only {head.frames} frames"
                )
            if rest < len(clip.clip):
                columns = {name: values[:rest] for name, values in columns.items()}
                self.note("cut to the length of the video")
            video, start = clip.clip.video, start_frame / fps
        if len(clip.clip.objects) > layout.objects:
            self.note(f"only the first {layout.objects} objects have columns")
        # From here on nothing refuses the clip.
        self._layout = layout
        self._append(clip, entry, columns, video, start)

    def _append(
        self,
        clip: RobotClip,
        entry: dict[str, Any],
        columns: dict[str, np.ndarray],
        video: Path | None,
        start: float,
    ) -> None:
        assert self._layout is not None
        fps, count = self._layout.fps, len(columns["stamp"])
        number, first = self._episodes + len(self._rows), self._frames + self._shard_frames
        task = clip.clip.task or UNNAMED_TASK
        if task not in self._tasks:
            self._tasks[task] = len(self._tasks)
            self._new_tasks.append(task)
        index = self._tasks[task]
        columns |= index_columns(count, number=number, first=first, task=index, fps=fps)
        row = episode_row(number, first, count, task, divmod(self._number, FILES_A_CHUNK))
        row[OWN_COLUMN] = to_json(clip_document(clip, entry["key"], self.configuration(clip)))
        if video is not None:
            row |= self._linked(video, start, count / fps)
        self._rows.append(row)
        self._statistics.append(columns_statistics(columns))
        self._shard_frames += count
        entry["episode"] = number
        entry["frames"] = count
        self._write(columns)

    def _write(self, columns: dict[str, np.ndarray]) -> None:
        """Writes a clip as one row group, as LeRobot's recorder does."""
        table = arrow().table({name: column(values) for name, values in columns.items()})
        if self._parquet is None:
            # Numbers of a movement hardly repeat: a dictionary of them only takes time.
            floats = [name for name in columns if columns[name].dtype.kind == "f"]
            self._parquet = parquet().ParquetWriter(
                self._file,
                table.schema,
                compression="zstd",
                use_dictionary=[name for name in columns if name not in floats],
            )
        self._parquet.write_table(table, row_group_size=table.num_rows)

    def _complete(self) -> dict[str, Any]:
        assert self._layout is not None
        self._parquet.close()
        episodes = self._filled(EPISODES_PATH, self._number)
        episodes.parent.mkdir(parents=True, exist_ok=True)
        chunk, file = divmod(self._number, FILES_A_CHUNK)
        table = episodes_table(self._rows, self._statistics, chunk=chunk, file=file)
        with hidden(episodes).open("wb") as stream:
            parquet().write_table(table, stream)
        publish(episodes)
        together = {
            name: joint_statistics([each[name] for each in self._statistics])
            for name in self._statistics[0]
        }
        return {
            "frames": self._shard_frames,
            "tasks": self._new_tasks,
            "videos": self._new_videos,
            "layout": asdict(self._layout),
            "statistics": {name: part.to_json() for name, part in together.items()},
        }

    def _discard(self) -> None:
        drop_parquet(self._parquet)
        for task in self._new_tasks:
            del self._tasks[task]
        for video in self._new_videos:
            remove(self._video_path(self._videos.pop(video)))
        if not self._episodes:
            self._layout = None

    def _clean(self, number: int) -> None:
        super()._clean(number)
        remove(self._filled(EPISODES_PATH, number))
        left = len(self._videos)
        while self._video_path(left).exists() or self._video_path(left).is_symlink():
            remove(self._video_path(left))
            left += 1

    # All shards.

    def _resume(self, index: Any) -> None:
        self._episodes += len(index["clips"])
        self._frames += index["frames"]
        self._layout = RobotLayout.from_json(index["layout"])
        for task in index["tasks"]:
            self._tasks.setdefault(task, len(self._tasks))
        for video in index["videos"]:
            self._videos.setdefault(video, len(self._videos))
        for name, part in index["statistics"].items():
            new = Statistics.from_json(part)
            total = self._total.get(name)
            self._total[name] = new if total is None else joint_statistics([total, new])

    def _describe(self) -> None:
        if self._layout is None or not self._episodes:
            return
        layout, meta = self._layout, self.output / "meta"
        if len(self._tasks) != self._tasks_written:
            with atomic_write(meta / "tasks.parquet") as file:
                parquet().write_table(tasks_table(self._tasks), file)
            self._tasks_written = len(self._tasks)
        stats: dict[str, Any] = {name: part.to_lists() for name, part in self._total.items()}
        features = dataset_features(layout.layout())
        if layout.video is not None:
            features = {**features, VIDEO_KEY: dict(layout.video)}
            stats[VIDEO_KEY] = _video_statistics(self._frames)
        info = dataset_info(
            features,
            robot=layout.robot or None,
            episodes=self._episodes,
            frames=self._frames,
            tasks=len(self._tasks),
            fps=layout.fps,
            video_path=None if layout.video is None else VIDEO_PATH,
        )
        more = f"Hands: {layout.robot}. The motion was retargeted from human hands; no robot moved."
        if layout.video is not None:
            more += (
                f" The statistics of `{VIDEO_KEY}` are those of ImageNet; they were not measured "
                "on these videos."
            )
        title = "Human hands retargeted to robot hands"
        write_description(self.output, info, stats, dataset_readme(info, title, more, _UNITS))

    # Frames a second, and videos.

    def _fps(self, clip: RobotClip, head: VideoHead | None) -> float:
        if head is not None:
            fps = float(head.rate)
            if self.options.rate is not None and abs(self.options.rate / fps - 1.0) > 1e-6:
                raise RecordingError(
                    f"{clip.clip.name}: its video has {fps:g} frames per second, but "
                    f"{self.options.rate:g} were requested; LeRobot can't show it at a different "
                    "rate: omit the rate, or write without videos"
                )
            return fps
        if self.options.rate is not None:
            return self.options.rate
        rate = mean_rate(clip.clip.stamps)
        if rate is None:
            raise RecordingError(
                f"{clip.clip.name}: a clip with a single frame has no frame rate, and the data set "
                "has none yet; set the rate with --rate"
            )
        return float(standard_fps(rate))

    def _head(self, clip: RobotClip) -> VideoHead | None:
        if self.options.videos == "none":
            return None
        if clip.clip.video is None:
            raise RecordingError(
                f"{clip.clip.name} has no video; in a LeRobot data set, either all episodes have "
                "a video or none do: write without videos, or leave this clip out"
            )
        return video_head(clip.clip.video)

    def _check_video(self, clip: RobotClip, head: VideoHead | None, layout: RobotLayout) -> None:
        if head is None:
            return
        expected, actual = layout.video, head.feature()
        if expected is None or expected["shape"] != actual["shape"]:
            size = (
                "none" if expected is None else f"{expected['shape'][1]} x {expected['shape'][0]}"
            )
            raise RecordingError(
                f"{clip.clip.name}: its video has {head.width} x {head.height} pixels, but those "
                f"of the data set have {size}; write each size to its own data set"
            )
        if abs(float(head.rate) / layout.fps - 1.0) > 1e-6:
            raise RecordingError(
                f"{clip.clip.name}: its video has {float(head.rate):g} frames per second, but the "
                f"data set has {layout.fps:g}; write each rate to its own data set"
            )

    def _linked(self, video: Path, start: float, seconds: float) -> dict[str, Any]:
        source = video.as_posix()
        number = self._videos.get(source)
        if number is None:
            number = len(self._videos)
            place(video, self._video_path(number), self.options.videos)
            self._videos[source] = number
            self._new_videos.append(source)
        chunk, file = divmod(number, FILES_A_CHUNK)
        return {
            f"videos/{VIDEO_KEY}/chunk_index": chunk,
            f"videos/{VIDEO_KEY}/file_index": file,
            f"videos/{VIDEO_KEY}/from_timestamp": start,
            f"videos/{VIDEO_KEY}/to_timestamp": start + seconds,
        }


def _video_statistics(frames: int) -> dict[str, Any]:
    """ImageNet's statistics, which LeRobot uses by default, so that no picture need be decoded."""

    def each(values: tuple[float, ...]) -> list[Any]:
        return [[[value]] for value in values]

    zero, one = each((0.0,) * 3), each((1.0,) * 3)
    mean, std = each(_IMAGENET["mean"]), each(_IMAGENET["std"])
    return {"min": zero, "max": one, "mean": mean, "std": std, "count": [frames]}


LEROBOT: Final = DatasetFormat("a LeRobot data set (v3.0)", _Writer)
