"""``smooth-operator study metrics``: computes simulation metrics of the trials from recorded
takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.cli.console import Progressing
from smooth_operator.cli.outputs import folder_for
from smooth_operator.errors import ConfigError, DocumentError, SmoothOperatorError, StudyError
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.hands.registry import load_hand
from smooth_operator.io.documents import parse_json
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.teleop.recording.log_reader import read_log
from smooth_operator_study.commands.options import Metrics
from smooth_operator_study.data.reading import METRIC_COLUMNS, NAMES
from smooth_operator_study.data.take_metrics import (
    METRIC_NAMES,
    Take,
    take_metrics,
    utc_of_zero,
)
from smooth_operator_study.store.study_store import open_study


def study_metrics(options: Metrics) -> None:
    """Writes the table of simulation metrics."""
    progress = Progressing()
    folder = Path(options.study)
    folder = folder if folder.is_dir() else folder.parent
    takes = folder / "takes" if options.takes is None else options.takes
    files = sorted(takes.glob("*.mcap"))
    if not files:
        raise ConfigError(
            f"no takes in {str(takes)!r}; record them with smooth-operator teleop --sink "
            f"record:{takes}/, or name their folder with --takes"
        )
    with open_study(options.study) as store:
        everyone = [store.progress(code) for code in store.plan.codes]
    trials = [(one.operator, trial) for one in everyone for trial in one.trials if trial.counts]
    pieces, hands, covered = [], {}, set()
    with progress.counter("takes") as bar:
        task = bar.add_task("takes", total=len(files))
        for file in files:
            take = read_take(file)
            hands[take.hand.name] = take.hand
            for k, (operator, trial) in enumerate(trials):
                if (trace := take.cut(trial)) is not None:
                    pieces.append(((operator, trial.block.condition.name), trace))
                    covered.add(k)
            bar.advance(task)
    if len(hands) > 1:
        raise StudyError(
            f"the takes are of several robot hands: {', '.join(hands)}; name only the takes of "
            "one hand"
        )
    if not pieces:
        raise StudyError(
            f"none of the {len(trials)} trials of the study is in the {len(files)} takes in "
            f"{str(takes)!r}: the takes were recorded at other times"
        )
    rows = take_metrics(pieces, next(iter(hands.values())))
    output = folder / NAMES[2] if options.output is None else options.output
    with folder_for(output.parent), atomic_write(output) as target:
        target.write(csv_text((*METRIC_COLUMNS, *METRIC_NAMES), rows).encode())
    if missing := len(trials) - len(covered):
        progress.note(
            f"note: {missing} of {len(trials)} trials are not covered by any take", matters=True
        )
    progress.note(f"wrote {output}: {len(rows)} rows from {len(covered)} trials", matters=True)


def read_take(file: Path) -> Take:
    """Reads a take with its hand and its time of recording."""
    log = read_log(file)
    if log.recording is None or log.commands is None:
        what = "landmarks" if log.recording is None else "commands"
        raise StudyError(
            f"the take {str(file)!r} contains no {what}, so its metrics can't be computed"
        )
    try:
        meta = parse_json(log.origin.get("meta", "{}"))
        begin = utc_of_zero(str(meta["started"]), float(meta["clock"]))
    except (DocumentError, KeyError, TypeError, ValueError) as error:
        raise StudyError(
            f"the take {str(file)!r} does not contain its time of recording ({error}); "
            "expected a recording of smooth-operator teleop --sink record:FOLDER/"
        ) from error
    config = log.config or {}
    fingers = config.get("fingers")
    try:
        hand = load_hand(
            str(config.get("hand")),
            log.recording.side,
            fingers=fingers if isinstance(fingers, dict) else None,
        )
    except SmoothOperatorError as error:
        raise StudyError(f"the hand of the take {str(file)!r} can't be loaded: {error}") from error
    stamps, frames, commands = np.intersect1d(
        log.recording.stamps, log.commands.stamps, assume_unique=True, return_indices=True
    )
    if not len(stamps):
        raise StudyError(f"no command of the take {str(file)!r} matches a frame")
    recording = log.recording
    if len(stamps) < len(recording):
        parts = ("landmarks", "stamps", "valid", "metacarpals", "orientations", "T_world_wrist")
        held = {name: getattr(recording, name) for name in (*parts, "forearm")}
        recording = replace(
            recording, **{name: a[frames] for name, a in held.items() if a is not None}
        )
    alignments = [(use.stamp, _alignment(use.config)) for use in log.methods]
    return Take(recording, log.commands[commands], hand, begin, alignments)


def _alignment(config: dict[str, Any]) -> AlignmentConfig:
    """Alignment with the scale that the log names; otherwise the default alignment."""
    try:
        return AlignmentConfig(scale=config["alignment"]["scale"])
    except (KeyError, TypeError):
        return AlignmentConfig()
