"""What a corpus run is asked for, as plain values that cost a driver no JAX."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from smooth_operator.errors import ConfigError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.datasets.registry import ReadingOptions
from smooth_operator.version import package_version


@dataclass(frozen=True)
class CorpusSettings:
    """What is done to each clip, and the form of the result.

    Attributes:
        request: hand, method, preset and so on, as arguments of ``planning.make_request``.
        reading: what the readers need to know.
        frame: ``world`` or ``camera``, where wrists and objects are given; None for each clip's
            own frame.
        side: retarget this hand only; None for all that a clip has.
        limits: of quality, as arguments of ``filters.Limits``; None keeps every clip whole.
        format: name of the writer in ``WRITERS``.
        writing: arguments of ``WritingOptions``, without ``part`` and ``parts``.
        clips_per_shard: clips of a shard, which is a task of the engine and a part of the output.
        group: clips that are retargeted in one call, which a worker's death costs at most; with
            fewer the lanes of ``Retargeter.batch`` wait for the longest clip.
        attempts: how often a clip may be at work in a process that dies, before it is given up.
        retarget: False packs the human clips alone, without commands: many small files become
            few, which the reader ``parquet`` takes as a source.

    Raises:
        ConfigError: a number is below 1.
    """

    request: Mapping[str, Any] = field(default_factory=dict)
    reading: ReadingOptions = field(default_factory=ReadingOptions)
    frame: str | None = None
    side: str | None = None
    limits: Mapping[str, Any] | None = field(default_factory=dict)
    format: str = "parquet"
    writing: Mapping[str, Any] = field(default_factory=dict)
    clips_per_shard: int = 256
    group: int = 16
    attempts: int = 4
    retarget: bool = True

    def __post_init__(self) -> None:
        for name in ("clips_per_shard", "group", "attempts"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be 1 or more, not {getattr(self, name)}")

    def document(self) -> dict[str, Any]:
        """What the output depends on, as JSON has it; not how the work is spread."""
        fields = {name: v for name, v in asdict(self).items() if name not in ("group", "attempts")}
        return {"version": package_version(), **fields}


@dataclass(frozen=True)
class CorpusRun:
    """A run, as each worker needs to know it.

    Attributes:
        output: folder of the data set.
        settings: what is asked for.
        digest: of the settings and of the list of clips.
        shards: how many there are.
    """

    output: Path
    settings: CorpusSettings
    digest: str
    shards: int

    @property
    def state(self) -> Path:
        """Folder of what the run knows of itself."""
        return state_folder(self.output)

    @property
    def clips(self) -> Path:
        """Folder of the list of clips."""
        return self.state / "clips"

    def report(self, shard: int) -> Path:
        """File that says that a shard is whole, and what was dropped from it."""
        return self.state / "shards" / f"{shard:06d}.json"

    def packs(self, shard: int) -> Path:
        """Folder of the finished clips of a shard that is not whole."""
        return self.state / "packs" / f"{shard:06d}"


def state_folder(output: Path) -> Path:
    """Where a run keeps its list of clips, its reports and unfinished work."""
    return output / ".corpus"


def run_digest(document: Mapping[str, Any], clips: str) -> str:
    """SHA-256 of the settings' document and the digest of the list of clips."""
    return hashlib.sha256(f"{to_json(document)}\n{clips}".encode()).hexdigest()
