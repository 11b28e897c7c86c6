"""Operators of a study: exclusions, flow of participants, and differences of their means.

The flow of participants has the counts of CONSORT: Schulz, Altman and Moher (2010). CONSORT 2010
statement. doi:10.1136/bmj.c332
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator_study.analysis.results import OUTCOMES
from smooth_operator_study.data.rows import Flow, StudyData


def leave_out(data: StudyData, exclude: Mapping[str, str] | None = None) -> StudyData:
    """Leaves operators out of a study, and completes its flow of participants.

    Args:
        data: data of the study; operators who withdrew with their data are always left out.
        exclude: operator -> reason to leave them out as well.
    """
    flow = data.flow
    present = tuple(dict.fromkeys(map(str, data.trials.operator)))
    if not flow.logged:
        # Operators who were excluded earlier took part, too.
        there = tuple(dict.fromkeys((*flow.enrolled, *present)))
        flow = replace(flow, enrolled=there, started=there)
    excluded = dict(flow.excluded)
    for operator, reason in (exclude or {}).items():
        if operator not in (operators := {*flow.enrolled, *present}):
            raise UnknownNameError("operator to exclude:", operator, operators)
        if not reason.strip():
            raise StudyError(f"operator {operator} can't be excluded without a reason")
        excluded[operator] = reason.strip()
    out = {*excluded, *(code for code, left in flow.withdrawn.items() if not left.keep)}
    analysed = tuple(code for code in present if code not in out)
    if not analysed:
        raise StudyError(f"no operators are left to analyse; excluded: {', '.join(sorted(out))}")
    flow = replace(flow, excluded=excluded, analysed=analysed)
    if not out:
        return replace(data, flow=flow)
    changes: dict[str, Any] = {
        name: table[~table.operator.isin(out)].reset_index(drop=True)
        for name in ("trials", "questionnaires", "metrics")
        if (table := getattr(data, name)) is not None
    }
    changes["ranking"] = {code: v for code, v in data.ranking.items() if code not in out}
    for name in ("questionnaires", "metrics"):
        if name in changes and len(changes[name]) == 0:
            changes[name] = None
    return replace(data, flow=flow, **changes)


def flow_rows(flow: Flow) -> list[dict[str, Any]]:
    """Returns the flow as rows: ``step``, ``retargeter``, ``count``, ``operators``, ``reason``."""
    rows: list[dict[str, Any]] = []

    def add(step: str, count: int, who: str = "", reason: str = "", retargeter: str = "") -> None:
        row = {"step": step, "retargeter": retargeter, "count": count, "operators": who}
        rows.append({**row, "reason": reason})

    if flow.planned is not None:
        add("planned", flow.planned)
    steps = {"enrolled": flow.enrolled, "started": flow.started}
    if flow.logged:
        steps["completed"] = flow.completed
    for step, codes in steps.items():
        add(step, len(codes), " ".join(codes))
    for code, left in flow.withdrawn.items():
        add(f"withdrawn, data {'kept' if left.keep else 'left out'}", 1, code, left.reason)
    for code, reason in flow.excluded.items():
        add("excluded", 1, code, reason)
    add("analysed", len(flow.analysed), " ".join(flow.analysed))
    if flow.logged:
        for step, counts in (
            ("void trials", flow.voids),
            ("undone events", flow.undone),
            ("amended trials", flow.amended),
        ):
            for name, count in counts.items():
                add(step, count, retargeter=name)
        add("pauses", flow.pauses)
        add("recalibrations", flow.recalibrations)
        add("blocks ended early", flow.ended_early)
    return rows


def flow_text(flow: Flow) -> str:
    """Describes the flow in one or two sentences."""
    parts = []
    if flow.logged:
        parts.append(
            f"{len(flow.enrolled)} operators enrolled, {len(flow.started)} started, "
            f"{len(flow.completed)} completed all blocks"
        )
    parts += [
        f"{code} withdrew ({f'{one.reason}, ' * bool(one.reason)}"
        f"data {'kept' if one.keep else 'excluded'})"
        for code, one in flow.withdrawn.items()
    ]
    parts += [f"{code} was excluded ({reason})" for code, reason in flow.excluded.items()]
    return "; ".join([*parts, f"{len(flow.analysed)} were analysed."]) if parts else ""


def operator_means(data: StudyData) -> pd.DataFrame:
    """Computes success rate, mean time of successes [s] and mean workload of each operator.

    Returns:
        Columns ``outcome``, ``task``, ``retargeter``, ``operator``, ``n`` (number of rows) and
        ``mean``.
    """
    groups = {
        outcome: rows.groupby(["task", "retargeter", "operator"]).value.agg(n="size", mean="mean")
        for outcome, rows in data.outcomes().items()
    }
    return pd.concat(groups, names=["outcome"]).reset_index()


def variance(data: StudyData) -> dict[str, Any]:
    """Computes the distribution of the operators' means.

    Returns:
        By outcome, task and retargeter: ``operators``, ``mean``, ``sd``, ``min``, ``q25``,
        ``median``, ``q75`` and ``max``.
    """
    names = ["min", "q25", "median", "q75", "max"]
    spread: dict[str, Any] = {outcome: {} for outcome in OUTCOMES}
    groups = operator_means(data).groupby(["outcome", "task", "retargeter"])["mean"]
    for (outcome, task, retargeter), means in groups:
        quantiles = np.percentile(means, [0, 25, 50, 75, 100]).tolist()
        spread[outcome].setdefault(task, {})[retargeter] = {
            "operators": len(means),
            "mean": float(means.mean()),
            "sd": float(means.std()) if len(means) > 1 else None,
            **dict(zip(names, quantiles, strict=True)),
        }
    return spread
