"""Writes the data set from retargeted clips: selects episodes, writes them in order, and writes a
report."""

from __future__ import annotations

import contextlib
import json
import shutil
from array import array
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.code import code_of_files
from smooth_hand_datasets.pipeline.quality import FIGURES, RULES, Dropped, select, worst
from smooth_hand_datasets.pipeline.request import DATASET, DatasetRequest, Limits
from smooth_hand_datasets.pipeline.store import Result, Store
from smooth_hand_datasets.pipeline.writers.registry import WRITERS, WritingOptions
from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.errors import OutputError, RecordingError
from smooth_operator.formats.clip import NOTES, SIDES
from smooth_operator.io.documents import read_json
from smooth_operator.io.jsonable import to_json
from smooth_operator.parallel import run_tasks
from smooth_operator.planning import PROGRAM, RetargetRequest
from smooth_operator.reporter import Reporter
from smooth_operator.reporting.report_page import Html, Plots, templates, write_report_page
from smooth_operator.result_cache import key_digest
from smooth_operator.types import Side
from smooth_operator.version import package_version

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PERCENTILES: Final = (1, 5, 50, 95, 99)
_LIMIT_OF: Final = {rule.figure: rule.limit for rule in RULES}
_FIGURE_OF: Final = {rule.limit: rule.figure for rule in RULES}
_SHOWN: Final = 200
_KEPT: Final = "#0072B2"
_DROPPED: Final = "#D55E00"
_COLUMNS: Final = 3


class FigureTable:
    """Table of the quality metrics of all episodes, with the worse hand's values; 4 bytes per
    value."""

    def __init__(self) -> None:
        self.kept: dict[str, array[float]] = {}
        self.dropped: dict[str, array[float]] = {}

    def add(self, episode: RobotClip | Dropped) -> None:
        """Adds the metrics of an episode."""
        table = self.dropped if isinstance(episode, Dropped) else self.kept
        if not episode.figures:
            return
        for figure in FIGURES:
            value = worst(episode.figures, figure.name)
            if value is not None:
                table.setdefault(figure.name, array("f")).append(value)
        table.setdefault("seconds", array("f")).append(episode.figures["seconds"])

    def extend(self, other: FigureTable) -> None:
        """Adds the metrics of another table."""
        for own, more in ((self.kept, other.kept), (self.dropped, other.dropped)):
            for name, values in more.items():
                own.setdefault(name, array("f")).extend(values)

    def percentiles(self) -> dict[str, dict[str, float]]:
        """Maps the name of each metric to its percentiles over the kept episodes."""
        result = {}
        for name, values in self.kept.items():
            at = np.percentile(np.asarray(values), _PERCENTILES)
            result[name] = {
                f"p{p}": round(float(v), 6) for p, v in zip(_PERCENTILES, at, strict=True)
            }
        return result


def write_report(output: Path, content: Mapping[str, Any], figures: FigureTable) -> None:
    """Writes ``report.html``, and histograms as ``plots/quality.png`` and ``.svg``.

    Without matplotlib there are no histograms.

    Args:
        content: content of ``report.json``.

    Raises:
        OutputError: a file can't be written.
    """
    try:
        drawn = _histograms(figures, content["limits"])
    except ImportError:
        drawn = None
    plot = Plots(output / "plots").element(drawn, "quality", "Quality metrics of the episodes")
    template = templates("smooth_hand_datasets.pipeline").get_template("report.html.j2")
    macros: Any = template.make_module(
        {
            **content,
            "plot": plot,
            "percentages": [f"{p} %" for p in _PERCENTILES],
            "measures": {figure.name: figure for figure in FIGURES},
            "shown": _SHOWN,
        }
    )
    sections = [
        (title, anchor, Html(str(section())))
        for title, anchor, section in (
            ("Counts", "counts", macros.counts),
            ("Why episodes were dropped", "reasons", macros.dropped_for),
            ("Quality", "quality", macros.quality),
            ("Could not be read or retargeted", "failed", macros.failures),
        )
    ]
    write_report_page(
        output / "report.html",
        f"{content['episodes']} episodes of {content['hand']}",
        Html(str(macros.heading())),
        sections,
        f"smooth-operator {content['version']}",
    )


def _histograms(figures: FigureTable, limits: Mapping[str, Any]) -> Figure | None:
    """Histogram of each metric, with dropped episodes stacked on kept ones; None if there are
    none."""
    from matplotlib.figure import Figure  # not pyplot: no global state, no display

    shown = [f for f in FIGURES if f.name in figures.kept or f.name in figures.dropped]
    if not shown:
        return None
    rows = -(-len(shown) // _COLUMNS)
    drawn = Figure(figsize=(3.2 * _COLUMNS, 2.1 * rows))
    # By hand: an automatic layout takes as long as the drawing.
    gap, edge = 0.55, 0.3 / rows
    drawn.subplots_adjust(0.05, 0.6 * edge, 0.98, 1.0 - edge, wspace=0.25, hspace=gap)
    axes = np.atleast_1d(drawn.subplots(rows, _COLUMNS)).ravel()
    for ax, figure in zip(axes, shown, strict=False):
        parts = [
            np.asarray(table.get(figure.name, ())) for table in (figures.kept, figures.dropped)
        ]
        values = np.concatenate(parts)
        top = float(np.percentile(values, 99.0)) * 1.1  # a few odd ones do not squeeze the others
        bins = np.linspace(min(0.0, float(values.min())), top or 1.0, 31)
        clipped = [np.clip(part, bins[0], bins[-1]) for part in parts]
        counts = [np.histogram(part, bins)[0] for part in clipped]
        ax.stairs(counts[0], bins, fill=True, color=_KEPT)
        ax.stairs(counts[0] + counts[1], bins, baseline=counts[0], fill=True, color=_DROPPED)
        limit = limits.get(_LIMIT_OF.get(figure.name, ""))
        if isinstance(limit, int | float) and bins[0] <= limit <= bins[-1]:
            ax.axvline(limit, color="black", linestyle="--", linewidth=1.0)
        unit = f" [{figure.unit}]" if figure.unit else ""
        ax.set_title(f"{figure.name}{unit}", fontsize=9)
        ax.tick_params(labelsize=8)
    for ax in axes[len(shown) :]:
        ax.set_axis_off()
    return drawn


REPORT: Final = "report.json"
EPISODES: Final = "episodes.jsonl"
_STATE: Final = "dataset.json"

PART_FRAMES: Final = 1_000_000
"""Number of frames in a part of the data set, which one worker writes: about six Parquet files."""


@dataclass
class Summary:
    """Result of a run: counts of clips, episodes and frames.

    Attributes:
        output: the folder of results.
        shard: (i, n) for a share of the work; None for a whole data set.
        clips: number of retargeted clips, of this run and earlier ones.
        frames: number of frames.
        episodes: number of episodes in the data set.
        episode_frames: number of recorded frames of these episodes.
        written_frames: number of their frames in the data set, which may have another rate.
        dropped: number of dropped parts of clips.
        dropped_frames: number of dropped frames.
        reasons: name of a limit -> number of episodes that violated it.
        failed: name of clip -> reason why it could not be read or retargeted.
        passed_over: suffix -> number of files in folders that no reader recognised.
        notes: notes of the writer.
    """

    output: Path
    shard: tuple[int, int] | None = None
    clips: int = 0
    frames: int = 0
    episodes: int = 0
    episode_frames: int = 0
    written_frames: int = 0
    dropped: int = 0
    dropped_frames: int = 0
    reasons: dict[str, int] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    passed_over: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def add(self, part: Summary) -> None:
        """Adds the episodes, reasons and notes of a part."""
        counts = ("episodes", "episode_frames", "written_frames", "dropped", "dropped_frames")
        for name in counts:
            setattr(self, name, getattr(self, name) + getattr(part, name))
        reasons = Counter(self.reasons) + Counter(part.reasons)
        self.reasons = dict(sorted(reasons.items()))
        self.notes += [note for note in part.notes if note not in self.notes]

    def as_json(self) -> dict[str, Any]:
        """Content of ``report.json``."""
        counts = {name: value for name, value in asdict(self).items() if name != "output"}
        return {"program": PROGRAM, "version": package_version(), **counts}


@dataclass(frozen=True, eq=False)
class Order:
    """Everything that determines the data set to write.

    Attributes:
        request: the request for the data set.
        resolved: hand, method and settings of its commands.
        writing: options of the format.
        items: name and result of each finished item, sorted by name.
        store: folder of the packs.
    """

    request: DatasetRequest
    resolved: RetargetRequest
    writing: WritingOptions
    items: Sequence[tuple[str, Result]]
    store: Path

    @property
    def identity(self) -> str:
        """Digest of the clips, the limits, the format with its options, and the code that writes
        the data set."""
        content = [(name, pack.key) for name, pack in self.items]
        request = self.request
        code = code_of_files(WRITERS[request.format].target)
        return key_digest([code, request.limits, request.format, self.writing, content])


@dataclass(eq=False)
class Part:
    """Result of writing consecutive items.

    Attributes:
        summary: counts of episodes.
        lines: lines of ``episodes.jsonl``.
        figures: quality metrics of the episodes.
    """

    summary: Summary
    lines: list[bytes] = field(default_factory=list)
    figures: FigureTable = field(default_factory=FigureTable)


def write_episodes(
    order: Order,
    failed: Mapping[str, str],
    passed_over: Mapping[str, int],
    reporter: Reporter | None = None,
    notes: Sequence[str] = (),
) -> Summary:
    """Writes the data set and the report. Continues where an earlier run was stopped.

    A large data set is written in parts of ``PART_FRAMES`` frames, several in parallel. The parts
    and their bytes depend only on the items.

    Args:
        order: settings of the data set.
        failed: name of clip -> reason of its failure, for the report.
        passed_over: suffix -> number of files that no reader recognises, for the report.
        reporter: shows the progress.
        notes: notes of the run, for the report.

    Raises:
        OutputError: it can't be written.
        RecordingError: a pack is damaged.
        WorkerError: the cluster can't be reached, or failed.
    """
    summary = Summary(
        order.request.output,
        failed=dict(sorted(failed.items())),  # workers end in any order
        passed_over=dict(passed_over),
        notes=[*notes],
    )
    summary.clips = len(order.items)
    summary.frames = sum(pack.frames for _, pack in order.items)
    if not order.items:
        _account(order, summary, FigureTable())
        return summary
    order = replace(order, writing=_fitted(order))
    _prepare(order)
    parts = _parts(order)
    done: dict[int, Part] = {}
    reporter = Reporter() if reporter is None else reporter
    with reporter.counting("", len(order.items), "clips written", in_files=True) as advance:
        if len(parts) == 1:
            done[0] = write_part(parts[0], advance)
        else:
            workers, cluster = order.request.workers, order.request.cluster
            tasks = run_tasks(write_part, parts, workers=workers, cluster=cluster)
            with contextlib.closing(tasks) as results:
                for result in results:
                    if result.value is None:
                        raise OutputError(
                            f"a part of the data set can't be written: {result.error}"
                        )
                    done[result.index] = result.value
                    advance(len(parts[result.index].items))
    figures = FigureTable()
    with atomic_write(order.request.output / EPISODES) as lines:
        for _, part in sorted(done.items()):
            summary.add(part.summary)
            figures.extend(part.figures)
            lines.write(b"".join(part.lines))
    if summary.episodes == 0 and not order.request.mirror:  # it would be taken for a data set
        shutil.rmtree(order.request.data, ignore_errors=True)
        summary.notes += _nothing_kept(summary, figures, order.request.limits)
    _account(order, summary, figures)
    return summary


def _nothing_kept(summary: Summary, figures: FigureTable, limits: Limits) -> list[str]:
    """Notes on the limits that dropped all episodes, and on the options that change them."""
    if not summary.reasons:
        return []
    lines = [
        f"Nothing was kept, so no data set is written. Limits that the {summary.dropped} parts "
        "violate:"
    ]
    for name, count in sorted(summary.reasons.items(), key=lambda item: -item[1]):
        line = f"{count} of {summary.dropped} violate {name}"
        if hasattr(limits, name):
            option = f"--{name.replace('_', '-')} {getattr(limits, name)}"
            line = f"{count} of {summary.dropped} violate {option}"
        values = figures.dropped.get(_FIGURE_OF.get(name, ""))
        if values:
            line += f"; their values are {min(values):.2g} to {max(values):.2g}"
        lines.append(line)
    lines.append(
        "Look at report.html, then run again with other limits; nothing is retargeted again. "
        "--no-limits keeps every clip whole."
    )
    return lines


def _parts(order: Order) -> list[Order]:
    """Splits the items into consecutive parts; all but the last have at least ``PART_FRAMES``
    frames."""
    if not getattr(WRITERS.load(order.request.format), "parallel", False):
        return [order]
    groups: list[list[tuple[str, Result]]] = []
    frames = PART_FRAMES
    for item in order.items:
        if frames >= PART_FRAMES:
            groups.append([])
            frames = 0
        groups[-1].append(item)
        frames += item[1].frames
    count = len(groups)
    return [
        replace(
            order,
            items=group,
            writing=replace(order.writing, part=number, parts=count, apart=count > 1),
        )
        for number, group in enumerate(groups)
    ]


def write_part(order: Order, written: Callable[[], None] = lambda: None) -> Part:
    """Writes the episodes of some items, in a worker.

    Args:
        order: the items.
        written: function that is called after each item.

    Raises:
        OutputError: they can't be written.
        RecordingError: a pack is damaged.
    """
    request = order.request
    part = Part(Summary(request.output))
    limits = request.limits
    reasons: Counter[str] = Counter()
    notes: Counter[str] = Counter()
    with (
        contextlib.closing(Store(order.store)) as store,
        WRITERS.load(request.format).open(request.data, order.writing) as writer,
    ):
        for _, pack in order.items:
            for clip in store.read(pack):
                notes.update(clip.clip.meta.get(NOTES, ()))
                for episode in select(clip, limits):
                    episode = _written(episode, writer)
                    _count(part.summary, reasons, episode)
                    part.figures.add(episode)
                    part.lines.append(to_json(_line(clip, episode)).encode() + b"\n")
            written()
    read = [f"{count} clip{'s' * (count > 1)}: {text}" for text, count in sorted(notes.items())]
    part.summary.notes = [*read, *writer.notes]
    part.summary.written_frames = getattr(writer, "frames", part.summary.episode_frames)
    part.summary.reasons = dict(reasons)
    return part


def _written(episode: RobotClip | Dropped, writer: Any) -> RobotClip | Dropped:
    """Writes an episode, or returns it as dropped if the format can't hold it."""
    if isinstance(episode, Dropped):
        return episode
    try:
        writer.write(episode)
    except OutputError:
        raise
    except RecordingError as error:
        frames = (0, len(episode.clip))
        return Dropped(episode.clip.name, frames, {"format": str(error)}, dict(episode.figures))
    return episode


def _count(summary: Summary, reasons: Counter[str], episode: RobotClip | Dropped) -> None:
    if isinstance(episode, Dropped):
        summary.dropped += 1
        summary.dropped_frames += episode.frames[1] - episode.frames[0]
        reasons.update(episode.reasons.keys())
    else:
        summary.episodes += 1
        summary.episode_frames += len(episode.clip)


def _line(clip: RobotClip, episode: RobotClip | Dropped) -> dict[str, Any]:
    shared = {"clip": clip.clip.name, "source": clip.clip.meta.get("source")}
    if isinstance(episode, Dropped):
        return {
            "episode": episode.name,
            "kept": False,
            "reasons": episode.reasons,
            "frames": episode.frames[1] - episode.frames[0],
            "figures": episode.figures,
            **shared,
        }
    return {
        "episode": episode.clip.name,
        "kept": True,
        "frames": len(episode.clip),
        "task": episode.clip.task,
        "world": episode.clip.world,
        "key": episode.key,
        "figures": episode.figures,
        **shared,
    }


def _fitted(order: Order) -> WritingOptions:
    """The writing options, completed with the joints, camera and objects of the clips."""
    writing, packs = order.writing, [pack for _, pack in order.items]
    if writing.joints:
        return writing
    sides: set[Side] = {side for pack in packs for side in pack.sides}
    return replace(
        writing,
        joints={
            side: order.resolved.commanded(order.resolved.load_hand(side)).joint_names
            for side in SIDES
            if side in sides
        },
        camera=any(pack.camera for pack in packs),
        objects=min(writing.objects, max((pack.objects for pack in packs), default=0)),
    )


def _prepare(order: Order) -> None:
    """Prepares the folder: continues that of a stopped run of the same data set, or starts a new
    one; OutputError if the folder contains files that this program did not write."""
    target = order.request.data
    state = _state(order)
    if order.request.mirror:
        state = None  # existing files stay until new ones replace them
    elif target.exists() and state is None and any(target.iterdir()):
        raise OutputError(
            f"can't write {str(target)!r}: it contains files that this command did not write; "
            "choose another folder with --output, or remove them first"
        )
    if state is not None and state.get("identity") != order.identity:
        shutil.rmtree(target, ignore_errors=True)  # other clips, limits or format: all again
    order.request.packs.mkdir(parents=True, exist_ok=True)
    write_json(order.request.packs / _STATE, {"program": PROGRAM, "identity": order.identity})


def hand_in(output: Path) -> str | None:
    """Name of the robot hand in the data set of a results folder; None if there is no data set."""
    if not (output / DATASET).exists():
        return None
    try:
        report = read_json(output / REPORT)
    except (OSError, ValueError):
        return None
    return report.get("hand") if isinstance(report, dict) else None


def _state(order: Order) -> dict[str, Any] | None:
    try:
        state = read_json(order.request.packs / _STATE)
    except (OSError, ValueError):
        return None
    return state if isinstance(state, dict) and state.get("program") == PROGRAM else None


def _account(order: Order, summary: Summary, figures: FigureTable) -> None:
    request = order.resolved
    content = {
        **summary.as_json(),
        "hand": request.hand_name,
        "method": request.method,
        "preset": request.preset,
        "seed": request.seed,
        "frame": order.request.frame,
        "format": order.request.format,
        "limits": order.request.limits,
        "figures": figures.percentiles(),
    }
    write_json(order.request.output / REPORT, content, indent=2)
    if not order.request.mirror:
        write_report(order.request.output, json.loads(to_json(content)), figures)
