"""Stores retargeted clips in packs, so that the next run can reuse them.

A pack is an uncompressed zip file of ``.npy`` arrays and one JSON document, ``index.json``. It is
written under a temporary name, so a killed run loses only the packs that it was writing.
"""

from __future__ import annotations

import contextlib
import hashlib
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeAlias, cast

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.retargeting import SourceFile, shared_config
from smooth_hand_datasets.pipeline.sources import Item
from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import Clip, ObjectTrack
from smooth_operator.io.documents import parse_json
from smooth_operator.io.jsonable import to_json
from smooth_operator.result_cache import key_digest
from smooth_operator.types import CommandTrajectory, HandRecording, Side

INDEX: Final = "index.json"
_PREFIX: Final = "pack-"
_DAMAGE: Final = (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile)
"""What reading a damaged pack raises."""
_MOST_BYTES: Final = 64_000_000
_DATE: Final = (1980, 1, 1, 0, 0, 0)
_DTYPES: Final = dict.fromkeys(
    ("landmarks", "metacarpals", "orientations", "confidence", "tracks", "latency_ms"), np.float32
) | {"status": np.int8}
"""Types in which arrays are stored: float32 resolves a micrometre, int8 is enough for status
codes."""
_KINDS: Final[dict[str, Any]] = {
    kind.__name__: kind for kind in (RobotClip, Clip, HandRecording, ObjectTrack, CommandTrajectory)
}
_LEFT_OUT: Final = {(RobotClip, "config"), (RobotClip, "figures"), (HandRecording, "meta")}


@dataclass(frozen=True)
class ReadClip:
    """A clip that was read and is not retargeted yet.

    Attributes:
        item: item to which the clip belongs.
        clip: hands and scene.
        files: source files.
        key: digest of all inputs of its commands.
        rate: frame rate that the reader needed [Hz]; None if the file has timestamps.
    """

    item: Item
    clip: Clip
    files: tuple[SourceFile, ...]
    key: str
    rate: float | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """Where the retargeted clips of an item are stored, and facts about them.

    Attributes:
        pack: file of the pack.
        position: position of the item in the file.
        key: digest of all inputs of the clips.
        sides: hands that the clips have.
        frames: total number of frames.
        camera: True if any clip has camera poses.
        objects: largest number of objects in any clip.
    """

    pack: Path
    position: int
    key: str
    sides: tuple[Side, ...]
    frames: int
    camera: bool
    objects: int


Results: TypeAlias = dict[str, Result | str]
"""Name of item -> its result, or the reason why it has no result."""

Accept: TypeAlias = Callable[[str, str, tuple[SourceFile, ...], float | None], bool]
"""Function that returns True if an item's result is still valid, given the item's name, settings
key, files and rate."""


@dataclass(eq=False)
class Store:
    """The packs (files of retargeted clips) that were made with one recipe.

    Args:
        folder: folder of the packs, at any depth.
    """

    folder: Path
    _open: dict[Path, _Pack] = field(default_factory=dict)

    def find(self, accept: Accept) -> dict[str, Result]:
        """Finds valid results: maps the name of an item to its result. Removes damaged packs, so
        that their clips are made again."""
        packs: dict[str, Result] = {}
        for path in sorted(self.folder.rglob(f"{_PREFIX}*.zip")):
            try:
                with _Pack(path) as pack:
                    for position, item in enumerate(pack.index["items"]):
                        files = tuple(SourceFile(**file) for file in item["files"])
                        done = accept(item["item"], item["settings"], files, item["rate"])
                        if done and _shown(item["clips"]):
                            packs[item["item"]] = _pack_entry(path, position, item["clips"])
            except _DAMAGE:
                with contextlib.suppress(OSError):
                    path.unlink()
        return packs

    def remove_superseded(self, finished: Mapping[str, Result]) -> None:
        """Deletes packs whose items are all stored in other packs.

        A worker of a killed run may finish its pack while the next run makes the same clips.

        Args:
            finished: name of item -> the result that is used.
        """
        for path in sorted(self.folder.rglob(f"{_PREFIX}*.zip")):
            with contextlib.suppress(*_DAMAGE):
                with _Pack(path) as pack:
                    names = [str(item["item"]) for item in pack.index["items"]]
                if all(name in finished and finished[name].pack != path for name in names):
                    path.unlink()

    def read(self, stored: Result) -> list[RobotClip]:
        """Reads the clips of an item. RecordingError if the pack is damaged; it is removed."""
        try:
            pack = self._open.get(stored.pack)
            if pack is None:
                self.close()  # items are read in the order of the packs
                pack = self._open[stored.pack] = _Pack(stored.pack)
            return pack.clips(stored.position)
        except _DAMAGE as error:
            self.close()
            with contextlib.suppress(OSError):
                stored.pack.unlink()
            raise RecordingError(
                f"{stored.pack} was damaged ({error}) and has been removed; run the same command "
                "again to retarget its clips"
            ) from error

    def close(self) -> None:
        """Closes open packs."""
        for pack in self._open.values():
            pack.close()
        self._open.clear()


def write_pack(
    folder: Path, items: Sequence[tuple[ReadClip, Sequence[RobotClip]]]
) -> dict[str, Result]:
    """Writes a pack atomically; its name depends on its content.

    Args:
        items: for each item, one clip as read (for its files) and all its retargeted clips.

    Returns:
        name of item -> its result.

    Raises:
        OutputError: it can't be written.
    """
    keys = "\n".join(clip.key for _, clips in items for clip in clips)
    names = "\n".join(source.item.name for source, _ in items)
    digest = hashlib.sha256(f"{names}\n\n{keys}".encode()).hexdigest()[:24]
    path = folder / f"{_PREFIX}{digest}.zip"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    configs: dict[str, int] = {}
    index: list[dict[str, Any]] = []
    number = 0
    with (
        atomic_write(path) as file,
        zipfile.ZipFile(cast(BinaryIO, file), "w", zipfile.ZIP_STORED) as pack,
    ):
        for source, robot_clips in items:
            clips = []
            for clip in robot_clips:
                config = configs.setdefault(to_json(clip.config), len(configs))
                arrays, document = encoded(clip)
                clips.append(
                    {
                        "arrays": number,
                        "names": [*arrays],
                        "config": config,
                        "clip": document,
                        **_facts(clip),
                    }
                )
                for name, values in arrays.items():
                    with pack.open(zipfile.ZipInfo(f"{number}/{name}.npy", _DATE), "w") as member:
                        np.lib.format.write_array(member, values, allow_pickle=False)
                number += 1
            facts = {
                "settings": source.item.settings_key,
                "files": source.files,
                "rate": source.rate,
            }
            index.append({"item": source.item.name, **facts, "clips": clips})
        content = to_json({"items": index, "configs": [*configs]})
        pack.writestr(zipfile.ZipInfo(INDEX, _DATE), content)
    return {each["item"]: _pack_entry(path, at, each["clips"]) for at, each in enumerate(index)}


class _Pack(zipfile.ZipFile):
    """A pack that is open for reading."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            content = self.read(INDEX)
            self.index: dict[str, Any] = parse_json(content, most_bytes=_MOST_BYTES)
        except BaseException:
            self.close()
            raise

    def clips(self, position: int) -> list[RobotClip]:
        """Reads the clips of one item."""
        item = self.index["items"][position]
        return [self._clip(document) for document in item["clips"]]

    def _clip(self, document: Mapping[str, Any]) -> RobotClip:
        prefix = f"{document['arrays']}/"
        arrays = {}
        for name in document["names"]:
            with self.open(f"{prefix}{name}.npy") as member:
                arrays[name] = np.lib.format.read_array(member, allow_pickle=False)
        config = shared_config(self.index["configs"][document["config"]])
        return replace(decoded(arrays, document["clip"]), config=config)


def _shown(clips: Sequence[Mapping[str, Any]]) -> bool:
    """True if the videos and meshes of the clips still exist."""
    return all(Path(path).exists() for clip in clips for path in clip["files"])


def _pack_entry(path: Path, position: int, clips: Sequence[Mapping[str, Any]]) -> Result:
    keys = [str(clip["key"]) for clip in clips]
    sides: set[Side] = {side for clip in clips for side in clip["sides"]}
    return Result(
        path,
        position,
        keys[0] if len(keys) == 1 else key_digest(keys),
        tuple(sorted(sides, reverse=True)),
        sum(clip["frames"] for clip in clips),
        any(clip["camera"] for clip in clips),
        max(clip["objects"] for clip in clips),
    )


def _facts(whole: RobotClip) -> dict[str, Any]:
    """Facts for the index, which can be read without reading the clip."""
    clip = whole.clip
    files = [clip.video, *(each.mesh for each in clip.objects)]
    return {
        "key": whole.key,
        "frames": len(clip),
        "sides": [*whole.commands],
        "camera": clip.T_world_camera is not None,
        "objects": len(clip.objects),
        "files": [file for file in files if file is not None],
    }


def encoded(whole: RobotClip) -> tuple[dict[str, np.ndarray], list[Any]]:
    """Encodes a clip as named arrays and a JSON document, which contain neither its configuration
    nor its quality metrics.

    In the document, a value that JSON does not have is a pair of its kind and its content.
    """
    arrays: dict[str, np.ndarray] = {}
    names: dict[int, str] = {}  # arrays that several parts share are written once

    def part(value: Any, *path: str) -> Any:
        if isinstance(value, np.ndarray):
            name = names.setdefault(id(value), ".".join(path))
            dtype = next((_DTYPES[word] for word in path if word in _DTYPES), None)
            arrays.setdefault(name, np.asarray(value, dtype))
            return ["array", name]
        if is_dataclass(value) and not isinstance(value, type):
            content = {
                each.name: ["json", getattr(value, each.name)]
                if each.name == "meta"
                else part(getattr(value, each.name), *path, each.name)
                for each in fields(value)
                if (type(value), each.name) not in _LEFT_OUT
            }
            return [type(value).__name__, content]
        if isinstance(value, Mapping):
            return ["mapping", {key: part(each, *path, key) for key, each in value.items()}]
        if isinstance(value, (tuple, list)):
            return ["tuple", [part(each, *path, str(i)) for i, each in enumerate(value)]]
        return ["path", str(value)] if isinstance(value, Path) else value

    document: list[Any] = part(whole)
    return arrays, document


def decoded(arrays: Mapping[str, np.ndarray], document: Any) -> RobotClip:
    """Decodes the result of ``encoded``; the clip has no configuration and no quality metrics."""

    def value(part: Any) -> Any:
        if not isinstance(part, list):
            return part
        kind, content = part
        if kind == "json":
            return content
        if kind == "tuple":
            return tuple(map(value, content))
        if kind in ("array", "path"):
            return arrays[content] if kind == "array" else Path(content)
        members = {name: value(each) for name, each in content.items()}
        return members if kind == "mapping" else _KINDS[kind](**members)

    clip: RobotClip = value(document)
    return clip
