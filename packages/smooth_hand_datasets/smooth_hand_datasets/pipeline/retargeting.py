"""Retargets clips of human hands, and returns them with the commands of robot hands."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.code import code_of_clips
from smooth_hand_datasets.pipeline.quality import Tracks, quality_tracks
from smooth_hand_datasets.pipeline.request import DatasetRequest
from smooth_operator.errors import ConfigError, RecordingError, SmoothOperatorError, require
from smooth_operator.execution import answers, built_for, checked, execute
from smooth_operator.formats.clip import SIDES, Clip, Frame, ReadingOptions, in_frame, with_side
from smooth_operator.hands.registry import default_side
from smooth_operator.io.jsonable import to_json
from smooth_operator.planning import (
    PROGRAM,
    Plan,
    RetargetRequest,
    make_request,
    plan,
)
from smooth_operator.plugins import Entry
from smooth_operator.result_cache import content_digest, key_digest
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
from smooth_operator.types import CommandTrajectory, Side, Status
from smooth_operator.version import package_version
from smooth_operator.wrist_following import add_wrist_commands

_OBJECT_AWARE: Final = Entry("smooth_hand_datasets.objects.retargeter:object_aware")
"""Function that retargets one hand of a clip with its objects, given clip, side and plan.

Its result has the attributes ``commands``, ``loss`` (T,), ``tracks`` (name -> (T,)) and
``T_world_wrist`` (T, 7).
"""


def whole_config(config: MethodConfig) -> TrajectoryMethodConfig:
    """Checks that a configuration solves whole recordings, and returns it with the type of such a
    configuration. Raises ConfigError if it solves frame by frame."""
    if not isinstance(config, TrajectoryMethodConfig):
        raise ConfigError(
            "clips with objects need a preset for whole recordings, such as smooth:offline"
        )
    return config


@dataclass(frozen=True)
class SourceFile:
    """A file from which a clip is read.

    Attributes:
        path: its path in the source, with slashes; or its address.
        bytes: its size.
        sha256: digest of its content, in hexadecimal.
        changed: time of its last change, or the change mark of an object store.
    """

    path: str
    bytes: int
    sha256: str
    changed: str = ""

    def identity(self) -> dict[str, Any]:
        """Values that identify the file in a data set; the time of its last change is left out."""
        return {"path": self.path, "bytes": self.bytes, "sha256": self.sha256}


@dataclass(frozen=True)
class Recipe:
    """All settings on which the commands of a clip depend.

    Attributes:
        request: hand, method, preset, seed, scale, fingers and operator; and side, rate and layout
            for the readers. If a side is given, only that hand of a clip is retargeted.
        frame: frame of wrists and objects; None for each clip's own.
        with_objects: keep the contacts of the human's fingertips with objects, in clips with the
            wrist's pose and an object's mesh; needs the extra ``objects``.
        device: device that retargets; the commands of a GPU differ from a CPU's by 1e-4 rad.
        mano: as in ``ReadingOptions``.
        objects: as in ``ReadingOptions``.
        one_by_one: retarget one recording after the other, with the commands that ``retarget``
            computes for a file; many together give slightly different ones.

    Raises:
        ConfigError: ``with_objects`` is set, but the configuration solves frame by frame; or a GPU
            is requested for settings that retarget clips one by one.
        MissingExtraError: ``with_objects`` is set, and the extra ``objects`` is not installed.
    """

    request: RetargetRequest
    frame: Frame | None = None
    with_objects: bool = False
    device: Literal["cpu", "gpu"] = "cpu"
    mano: Path | None = None
    objects: Path | None = None
    one_by_one: bool = False

    @classmethod
    def of(cls, request: DatasetRequest, resolved: RetargetRequest | None = None) -> Recipe:
        """Makes the recipe for a request.

        Args:
            resolved: request that replaces hand, method and settings of ``request``.

        Raises:
            SmoothOperatorError: a setting is not valid.
        """
        if resolved is None:
            resolved = make_request(
                **request.settings(),
                side=request.side,
                rate=request.rate,
                wrist_joints=request.wrist_joints == "on",
            )
        return cls(
            checked(resolved),
            request.frame,
            request.with_objects,
            request.device,
            request.mano,
            request.objects,
        )

    def __post_init__(self) -> None:
        if self.device == "gpu" and (self.with_objects or self.request.scale == "calibrate"):
            raise ConfigError(
                "a GPU retargets many clips together, but clips with objects, or with their own "
                "scale, are retargeted one by one: use --device cpu for them"
            )
        if self.with_objects:
            require("retargeting with objects", "objects", "igl", "trimesh")
            whole_config(self.request.config)

    @functools.cached_property
    def digest(self) -> str:
        """Digest of the recipe, the code and both robot hands; see ``code_of_clips``."""
        mano = self.mano
        models = [] if mano is None else [*sorted(mano.glob("MANO_*"))] if mano.is_dir() else [mano]
        code = code_of_clips(self.request)
        # Frames are of an item, and a rate is for the items that need it.
        request = replace(self.request, frames=None, rate=None)
        parts = [code, request, self.frame]
        parts += ["with objects"] if self.with_objects else []
        parts += ["gpu"] if self.device == "gpu" else []
        parts += ["one by one"] if self.one_by_one else []
        return key_digest([*parts, [(m.name, content_digest(m)) for m in models]])

    @functools.cached_property
    def _assumed(self) -> Side:
        return default_side(self.request.hand)

    def reading(self, side: Side | None = None, rate: float | None = None) -> ReadingOptions:
        """Options for reading an item; the list that names the item may state side and rate."""
        own = self.request
        return ReadingOptions(
            rate or own.rate, side or own.side, self.mano, self.objects, own.layout, self._assumed
        )


def retarget_clips(
    clips: Sequence[Clip],
    recipe: Recipe,
    files: Sequence[Sequence[SourceFile]] | None = None,
    keys: Sequence[str] | None = None,
) -> list[RobotClip | SmoothOperatorError]:
    """Retargets clips; returns them with the commands of their robot hands, in the same order.

    Retargeters are built once per process and kept.

    Args:
        files: source files of each clip, for its ``meta``.
        keys: key of each clip; by default a digest of recipe and name.

    Returns:
        for each clip, its result or the error.
    """
    todo = [_prepared(clip, recipe) for clip in clips]
    works = [
        _Work(number, side, each, clip.clip if _touches(clip.clip, side, recipe) else None)
        for number, clip in enumerate(todo)
        if not isinstance(clip, SmoothOperatorError)
        for side, each in clip.plans.items()
    ]
    done: dict[int, dict[Side, _Answer]] = {}
    failed: dict[int, SmoothOperatorError] = {}
    for group in _groups(works, recipe):
        for work, answer in zip(group, _answers(group, recipe), strict=True):
            if isinstance(answer, SmoothOperatorError):
                failed[work.clip] = answer
            else:
                done.setdefault(work.clip, {})[work.side] = answer
    results: list[RobotClip | SmoothOperatorError] = []
    for number, clip in enumerate(todo):
        if isinstance(clip, SmoothOperatorError) or number in failed:
            results.append(clip if isinstance(clip, SmoothOperatorError) else failed[number])
            continue
        sources = () if files is None else files[number]
        key = "" if keys is None else keys[number]
        results.append(_result(clip, done[number], recipe, sources, key))
    return results


def clip_key(
    recipe: Recipe,
    layout: str,
    part: str,
    selection: str,
    files: Sequence[SourceFile],
    rate: float | None,
) -> str:
    """Computes the key of a clip: digest of its files, reader, hand, method, settings and code.

    Args:
        part: name of the clip in its file.
        files: source files.
        rate: frame rate that the reader needed [Hz].
    """
    content = [(file.bytes, file.sha256) for file in files]
    return key_digest([recipe.digest, layout, part, selection, content, rate])


@dataclass(frozen=True, eq=False)
class _Prepared:
    clip: Clip
    plans: dict[Side, Plan]


def _prepared(clip: Clip, recipe: Recipe) -> _Prepared | SmoothOperatorError:
    try:
        clip = in_frame(with_side(clip, recipe.request.side), recipe.frame)
        plans = {
            side: plan(clip.hands[side], recipe.request)
            for side in SIDES
            if side in clip.hands and np.asarray(clip.hands[side].valid).any()
        }
        if not plans:
            raise RecordingError(f"{clip.name}: no hand is seen in any frame")
    except SmoothOperatorError as error:
        return error
    return _Prepared(clip, plans)


@dataclass(frozen=True, eq=False)
class _Work:
    """One hand of a clip to retarget. ``scene`` is the clip if its objects are used, else None."""

    clip: int
    side: Side
    plan: Plan
    scene: Clip | None = None


@dataclass(frozen=True, eq=False)
class _Answer:
    commands: CommandTrajectory
    tracks: Tracks
    T_world_wrist: np.ndarray | None = None  # where it is not the human's


def _touches(clip: Clip, side: Side, recipe: Recipe) -> bool:
    return (
        recipe.with_objects
        and clip.hands[side].T_world_wrist is not None
        and any(track.mesh is not None for track in clip.objects)
    )


def _groups(works: Sequence[_Work], recipe: Recipe) -> Iterator[list[_Work]]:
    """Yields groups to retarget together; scenes, and recordings with their own scale, are
    alone."""
    one_by_one = recipe.request.scale == "calibrate"
    yield from ([work] for work in works if one_by_one or work.scene is not None)
    for side in SIDES:
        group = [work for work in works if work.side == side and work.scene is None]
        if group and not one_by_one:
            yield group


def _answers(group: Sequence[_Work], recipe: Recipe) -> list[_Answer | SmoothOperatorError]:
    """Computes the commands of a group. If the group fails, each clip is retargeted alone."""
    if group[0].scene is not None:
        return [_with_objects(each, each.scene) for each in group if each.scene is not None]
    keep = recipe.request.scale != "calibrate"  # each scale is a program of its own
    recordings = [work.plan.recording for work in group]
    first = group[0].plan
    try:
        plans = [work.plan for work in group]
        if recipe.one_by_one:
            outcomes = [execute(each, built_for(each)) for each in plans]
            results = [(each.commands, each.tracking_loss) for each in outcomes]
        else:
            results = answers(plans, keep=keep)
        commands, losses = [each for each, _ in results], [loss for _, loss in results]
        alignment = first.config.alignment
        tracks = quality_tracks(recordings, commands, losses, first.hand, alignment)
    except SmoothOperatorError as error:
        if len(group) == 1:
            return [error]
        return [each for work in group for each in _answers([work], recipe)]
    return [_Answer(*each) for each in zip(commands, tracks, strict=True)]


def _with_objects(work: _Work, scene: Clip) -> _Answer | SmoothOperatorError:
    plan = work.plan
    try:
        answer = _OBJECT_AWARE.load()(scene, work.side, plan)
        (tracks,) = quality_tracks(
            [plan.recording], [answer.commands], [answer.loss], plan.hand, plan.config.alignment
        )
    except SmoothOperatorError as error:
        return error
    return _Answer(answer.commands, tracks | dict(answer.tracks), answer.T_world_wrist)


def _result(
    todo: _Prepared,
    done: Mapping[Side, _Answer],
    recipe: Recipe,
    files: Sequence[SourceFile],
    key: str,
) -> RobotClip:
    clip, request = todo.clip, recipe.request
    commands = {side: done[side].commands for side in todo.plans}
    if request.wrist_joints:
        commands = {
            side: add_wrist_commands(commands[side], each.recording, each.hand)
            for side, each in todo.plans.items()
        }
    tracks = {
        f"{side}.{name}": values
        for side in todo.plans
        for name, values in done[side].tracks.items()
    }
    config: dict[str, Any] = {
        "program": PROGRAM,
        "command": "dataset",
        "hand": request.hand_name,
        "fingers": request.fingers,
        "method": request.method,
        "preset": request.preset,
        "seed": request.seed,
        "config": {side: each.config for side, each in todo.plans.items()},
        "pinch_gaps": request.known_gaps(),
        "with_objects": recipe.with_objects,
        "layout": clip.layout,
        "frame": clip.world,
        "version": package_version(),
    }
    unknown = np.full((len(clip), 7), np.nan)
    wrists = {
        side: clip.hands[side].T_world_wrist if own.T_world_wrist is None else own.T_world_wrist
        for side, own in done.items()
    }
    meta = {**clip.meta, "source": [file.identity() for file in files]} if files else clip.meta
    return RobotClip(
        replace(clip, meta=meta),
        commands,
        {side: todo.plans[side].hand.name for side in commands},
        {side: unknown if wrist is None else wrist for side, wrist in wrists.items()},
        {side: each.status == Status.OK for side, each in commands.items()},
        tracks,
        config=shared_config(to_json(config)),
        key=key or key_digest([recipe.digest, clip.name]),
    )


@functools.lru_cache(maxsize=64)
def shared_config(text: str) -> dict[str, Any]:
    """Parses a configuration from JSON. Equal texts give the same object, because most clips share
    one configuration."""
    config: dict[str, Any] = json.loads(text)
    return config
