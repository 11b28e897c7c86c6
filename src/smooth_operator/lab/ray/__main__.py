"""``python -m smooth_operator.lab.ray``: a data set from a corpus of any size, on Ray."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.lab.datasets.registry import ReadingOptions
from smooth_operator.lab.datasets.sources import Item, Refused, each_item
from smooth_operator.lab.ray.corpus import Progress, retarget_corpus
from smooth_operator.lab.ray.settings import CorpusSettings
from smooth_operator.types import Side

_NOTE_S = 10.0
_SHOWN = ("clips", "made", "dropped", "failed", "episodes")


@dataclass(frozen=True)
class Options:
    """Retarget a corpus of human hands to robot episodes on Ray Data; go on where a run stopped.

    The same steps as ``smooth-operator dataset``, for corpora that one machine is too small for, or
    whose list does not fit in its memory. Start it again with the same options after anything
    has died: what is done is not done again.

    Attributes:
        sources: folders, files, patterns, lists of paths, or addresses of object storage.
        output: folder of the data set; on a cluster one that all nodes see.
        hand: robot hand.
        method: retargeting method.
        preset: of the method.
        side: retarget this hand only.
        frame: where wrists and objects are given; each clip's own frame unless given.
        layout: name of the reader; the one that recognises each file unless given.
        rate: frames a second of files without times [Hz].
        mano: folder with your MANO model files.
        format: of the output.
        keep_all: keep every clip whole, whatever its quality.
        pack: do not retarget: pack the human clips into few files, a source for later runs.
        clips_per_shard: clips of a task, and of a part of the output.
        cluster: local, for a Ray of its own; auto, or the address of a running one; none, for
            processes without Ray.
        workers: how many at most; as many as there are cores unless given.
        least_workers: begin with so many, and grow as the cluster has room.
        gpus: accelerators for each worker; may be a fraction.
        quiet: no progress.
    """

    sources: tyro.conf.Positional[tuple[str, ...]]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    hand: str = "mimic_p050"
    method: str = "smooth"
    preset: str | None = None
    side: Side | None = None
    frame: Literal["world", "camera"] | None = None
    layout: str | None = None
    rate: float | None = None
    mano: Path | None = None
    format: str = "parquet"
    keep_all: bool = False
    pack: bool = False
    clips_per_shard: int = 256
    cluster: str = "local"
    workers: int | None = None
    least_workers: int | None = None
    gpus: float = 0.0
    quiet: bool = False


def run(options: Options) -> dict[str, Any]:
    """Runs it.

    Returns:
        the summary.

    Raises:
        SmoothOperatorError: as ``retarget_corpus``.
    """
    settings = CorpusSettings(
        {"hand": options.hand, "method": options.method, "preset": options.preset},
        ReadingOptions(rate=options.rate, mano=options.mano),
        options.frame,
        options.side,
        None if options.keep_all else {},
        options.format,
        clips_per_shard=options.clips_per_shard,
        retarget=not options.pack,
    )
    return retarget_corpus(
        _items(options),
        options.output,
        settings,
        workers=options.workers,
        least_workers=options.least_workers,
        cluster=None if options.cluster == "none" else options.cluster,
        gpus=options.gpus,
        progress=None if options.quiet else _Teller(),
    )


def _items(options: Options) -> Iterator[Item]:
    """The clips of the sources; what can't be used is said, and passed over."""
    for each in each_item(options.sources, layout=options.layout, leave_out=options.output):
        if isinstance(each, Item):
            yield each
        elif isinstance(each, Refused):
            print(f"left out: {each.name}: {each.reason}", file=sys.stderr)


class _Teller:
    """A line on standard error now and then."""

    def __init__(self) -> None:
        self._next = 0.0

    def __call__(self, so_far: Progress) -> None:
        now = time.monotonic()
        if now < self._next and so_far.done < so_far.clips:
            return
        self._next = now + _NOTE_S
        line = f"{so_far.done} of {so_far.clips} clips"
        if so_far.left_s is not None and so_far.elapsed_s > 0:
            pace = (so_far.done - so_far.kept) / so_far.elapsed_s
            line += f", {pace:.1f} a second, {so_far.left_s / 60:.0f} min left"
        print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    try:
        summary = run(tyro.cli(Options, prog="python -m smooth_operator.lab.ray"))
    except SmoothOperatorError as error:
        sys.exit(f"error: {error}")
    counts = ", ".join(f"{summary[name]} {name}" for name in _SHOWN)
    print(f"{counts}; see summary.json and report.jsonl in the output's folder")
