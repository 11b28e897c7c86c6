"""Finished clips in packs: one file for many, whole or not there, found again by the next run.

A pack is an uncompressed zip file of ``.npy`` arrays and one JSON document, ``index.json``. It
takes its name when it is whole, so a killed run loses the packs that were being made, and nothing
else.
"""

from __future__ import annotations

import contextlib
import hashlib
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeAlias, cast

import numpy as np

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import RecordingError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.io.documents import parse_json
from smooth_operator.lab.datasets.clip import Clip, ObjectTrack, RobotClip
from smooth_operator.lab.datasets.retargeting import SourceFile, shared_config
from smooth_operator.lab.offline.finished import remove_leftovers
from smooth_operator.result_cache import key_digest
from smooth_operator.types import CommandTrajectory, HandRecording, Side

INDEX: Final = "index.json"
_PREFIX: Final = "pack-"
_MOST_BYTES: Final = 64_000_000
_DATE: Final = (1980, 1, 1, 0, 0, 0)
_SMALL: Final = {"landmarks", "metacarpals", "orientations", "confidence"}
"""Arrays that float32 holds to a micrometre."""


@dataclass(frozen=True, eq=False)
class Finished:
    """The clips of one item of the work.

    Attributes:
        item: name of the item.
        asked: ``Item.asked`` of the item.
        files: files that were read.
        clips: results, by name.
    """

    item: str
    asked: str
    files: tuple[SourceFile, ...]
    clips: tuple[RobotClip, ...]


@dataclass(frozen=True, slots=True)
class Kept:
    """Place of the clips of an item.

    Attributes:
        pack: file.
        position: position of the item in the file.
        key: digest of all that the clips depend on.
        sides: hands that the clips have.
        frames: number of frames of all clips.
        camera: whether a clip has poses of the camera.
        objects: largest number of objects of a clip.
    """

    pack: Path
    position: int
    key: str
    sides: tuple[Side, ...]
    frames: int
    camera: bool
    objects: int


Accept: TypeAlias = Callable[[str, str, tuple[SourceFile, ...]], bool]
"""True if an item, by its name, ``asked`` and the files that were read, is done."""


@dataclass(eq=False)
class Store:
    """The packs of one recipe.

    Args:
        folder: folder of the packs, however deep.
    """

    folder: Path
    _open: dict[Path, _Pack] = field(default_factory=dict)

    def find(self, accept: Accept) -> dict[str, Kept]:
        """Name of item -> where it is; a damaged pack is removed, and its clips are made again."""
        packs: dict[str, Kept] = {}
        for path in sorted(self.folder.rglob(f"{_PREFIX}*.zip")):
            try:
                with _Pack(path) as pack:
                    for position, item in enumerate(pack.index["items"]):
                        files = tuple(SourceFile(**file) for file in item["files"])
                        if accept(item["item"], item["asked"], files) and _shown(item["clips"]):
                            packs[item["item"]] = _pack_entry(path, position, item["clips"])
            except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
                with contextlib.suppress(OSError):
                    path.unlink()
        return packs

    def read(self, stored: Kept) -> list[RobotClip]:
        """The clips of an item.

        Raises:
            RecordingError: the pack is damaged; it is removed.
        """
        try:
            pack = self._open.get(stored.pack)
            if pack is None:
                self.close()  # items are asked for in the order of the packs
                pack = self._open[stored.pack] = _Pack(stored.pack)
            return pack.clips(stored.position)
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            self.close()
            with contextlib.suppress(OSError):
                stored.pack.unlink()
            raise RecordingError(
                f"{stored.pack} was damaged ({error}) and is removed; run the same command again "
                "to make its clips again"
            ) from error

    def close(self) -> None:
        """Closes what is open."""
        for pack in self._open.values():
            pack.close()
        self._open.clear()


def write_pack(folder: Path, items: Sequence[Finished]) -> dict[str, Kept]:
    """Writes a pack, whole or not at all; its name depends on what is in it.

    Returns:
        name of item -> where it is.

    Raises:
        OutputError: it can't be written.
    """
    keys = "\n".join(clip.key for item in items for clip in item.clips)
    names = "\n".join(item.item for item in items)
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
        for item in items:
            clips = []
            for clip in item.clips:
                config = configs.setdefault(to_json(clip.config), len(configs))
                arrays, document = encoded(clip)
                clips.append({"arrays": number, "config": config, **document})
                for name, values in arrays.items():
                    with pack.open(zipfile.ZipInfo(f"{number}/{name}.npy", _DATE), "w") as member:
                        np.lib.format.write_array(member, values, allow_pickle=False)
                number += 1
            index.append(
                {"item": item.item, "asked": item.asked, "files": item.files, "clips": clips}
            )
        content = to_json({"items": index, "configs": [*configs]})
        pack.writestr(zipfile.ZipInfo(INDEX, _DATE), content)
    return {each["item"]: _pack_entry(path, at, each["clips"]) for at, each in enumerate(index)}


def clear_unfinished(folder: Path) -> int:
    """Deletes the unfinished files of a killed run; returns their number."""
    if not folder.is_dir():
        return 0
    return remove_leftovers([folder, *(path for path in folder.rglob("*") if path.is_dir())])


class _Pack:
    """A pack that is open for reading."""

    def __init__(self, path: Path) -> None:
        self._zip = zipfile.ZipFile(path)
        try:
            content = self._zip.read(INDEX)
            self.index: dict[str, Any] = parse_json(content, most_bytes=_MOST_BYTES)
        except BaseException:
            self._zip.close()
            raise

    def __enter__(self) -> _Pack:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._zip.close()

    def clips(self, position: int) -> list[RobotClip]:
        """Clips of one item."""
        item = self.index["items"][position]
        return [self._clip(document) for document in item["clips"]]

    def _clip(self, document: Mapping[str, Any]) -> RobotClip:
        prefix = f"{document['arrays']}/"
        arrays = {}
        for name in document["names"]:
            with self._zip.open(f"{prefix}{name}.npy") as member:
                arrays[name] = np.lib.format.read_array(member, allow_pickle=False)
        config = shared_config(self.index["configs"][document["config"]])
        return replace(decoded(arrays, document), config=config)


def _pack_entry(path: Path, position: int, clips: Sequence[Mapping[str, Any]]) -> Kept:
    keys = [str(clip["key"]) for clip in clips]
    sides: set[Side] = {side for clip in clips for side in clip["commands"]}
    return Kept(
        path,
        position,
        keys[0] if len(keys) == 1 else key_digest(keys),
        tuple(sorted(sides, reverse=True)),
        sum(clip["frames"] for clip in clips),
        any("camera" in clip["names"] for clip in clips),
        max(len(clip["objects"]) for clip in clips),
    )


def _shown(clips: Sequence[Mapping[str, Any]]) -> bool:
    """True if the videos and meshes that clips name are still there."""
    named = {clip["video"] for clip in clips}
    named |= {each["mesh"] for clip in clips for each in clip["objects"]}
    return all(Path(path).exists() for path in named - {None})


def encoded(whole: RobotClip) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """A clip as arrays by name and a document of JSON, without its configuration and figures."""
    clip = whole.clip
    arrays: dict[str, Any] = {"stamps": clip.stamps, "camera": clip.T_world_camera}
    for side, hand in clip.hands.items():
        for name in ("landmarks", "valid", "metacarpals", "orientations", "T_world_wrist"):
            arrays[f"{side}.hand.{name}"] = getattr(hand, name)
        arrays[f"{side}.hand.confidence"] = clip.confidence.get(side)
        arrays[f"{side}.hand.shape"] = clip.shape.get(side)
    for side, commands in whole.commands.items():
        arrays[f"{side}.positions"] = commands.joint_positions
        arrays[f"{side}.status"] = np.asarray(commands.status, np.int8)
        arrays[f"{side}.wrist"] = whole.T_world_wrist.get(side)
        arrays[f"{side}.valid"] = whole.valid[side]
    for name, values in whole.tracks.items():
        arrays[f"track.{name}"] = np.asarray(values, np.float32)
    for number, each in enumerate(clip.objects):
        arrays[f"object.{number}"] = each.T_world_object
    stored = {
        name: np.asarray(values, np.float32 if name.rpartition(".")[2] in _SMALL else None)
        for name, values in arrays.items()
        if values is not None
    }
    document = {
        "name": clip.name,
        "key": whole.key,
        "frames": len(clip),
        "names": [*stored],
        "layout": clip.layout,
        "task": clip.task,
        "source": [str(path) for path in clip.source],
        "video": None if clip.video is None else str(clip.video),
        "video_start_s": clip.video_start_s,
        "meta": clip.meta,
        "hands": {
            side: {"name": hand.name, "world": hand.world} for side, hand in clip.hands.items()
        },
        "objects": [
            {
                "name": each.name,
                "mesh": None if each.mesh is None else str(each.mesh),
                "scale": each.scale,
            }
            for each in clip.objects
        ],
        "commands": {
            side: {"hand": whole.hand_names[side], "joints": commands.joint_names}
            for side, commands in whole.commands.items()
        },
    }
    return stored, document


def as_stored(whole: RobotClip) -> RobotClip:
    """A clip as it is read from a pack: some arrays are rounded to float32 there."""
    return replace(decoded(*encoded(whole)), config=whole.config)


def decoded(arrays: Mapping[str, np.ndarray], document: Mapping[str, Any]) -> RobotClip:
    """A clip from what ``encoded`` gave, without its configuration and figures."""
    stamps = arrays["stamps"]

    def of_hand(side: str, name: str) -> np.ndarray | None:
        return arrays.get(f"{side}.hand.{name}")

    hands = {
        side: HandRecording(
            arrays[f"{side}.hand.landmarks"],
            stamps,
            side,
            of_hand(side, "valid"),
            of_hand(side, "metacarpals"),
            of_hand(side, "orientations"),
            own["name"],
            T_world_wrist=of_hand(side, "T_world_wrist"),
            world=own["world"],
        )
        for side, own in document["hands"].items()
    }
    mesh = [each["mesh"] for each in document["objects"]]
    clip = Clip(
        document["name"],
        hands,
        document["layout"],
        tuple(Path(path) for path in document["source"]),
        document["task"],
        _present({side: of_hand(side, "confidence") for side in hands}),
        arrays.get("camera"),
        tuple(
            ObjectTrack(
                each["name"],
                arrays[f"object.{number}"],
                None if mesh[number] is None else Path(mesh[number]),
                each["scale"],
            )
            for number, each in enumerate(document["objects"])
        ),
        _present({side: of_hand(side, "shape") for side in hands}),
        None if document["video"] is None else Path(document["video"]),
        document["video_start_s"],
        document["meta"],
    )
    sides: list[Side] = list(document["commands"])
    return RobotClip(
        clip,
        {
            side: CommandTrajectory(
                arrays[f"{side}.positions"],
                tuple(document["commands"][side]["joints"]),
                stamps,
                np.full(len(stamps), np.nan),
                arrays[f"{side}.status"],
            )
            for side in sides
        },
        {side: document["commands"][side]["hand"] for side in sides},
        _present({side: arrays.get(f"{side}.wrist") for side in sides}),
        {side: arrays[f"{side}.valid"] for side in sides},
        {
            name.removeprefix("track."): values
            for name, values in arrays.items()
            if name.startswith("track.")
        },
        key=document["key"],
    )


def _present(values: Mapping[Side, np.ndarray | None]) -> dict[Side, np.ndarray]:
    return {side: value for side, value in values.items() if value is not None}
