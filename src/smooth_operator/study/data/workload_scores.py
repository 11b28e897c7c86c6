"""Which workload is analysed: the mean of the six scales, or their weighted mean."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator.study.data.rows import StudyData, Workload

_SHOWN: Final = 5


def with_workload(data: StudyData, kind: Workload) -> StudyData:
    """The study with raw or weighted workload.

    Args:
        data: the study.
        kind: which.

    Raises:
        StudyError: weighted, and there are no questionnaires, or some without weights.
    """
    table = data.questionnaires
    if kind == "raw" and table is None:
        return data
    if table is None:
        raise StudyError("a weighted workload needs questionnaires; none were given")
    if kind == "weighted":
        without = (
            np.ones(len(table), bool)
            if table.weights is None
            else np.isnan(table.weights).any(axis=1)
        )
        if without.any():
            rows = zip(
                table.operator[without], table.task[without], table.block[without], strict=True
            )
            blocks = list(dict.fromkeys((str(o), str(t), int(b)) for o, t, b in rows))
            shown = "; ".join(f"operator {o}, task {t}, block {b}" for o, t, b in blocks[:_SHOWN])
            more = f"; and {len(blocks) - _SHOWN} more" if len(blocks) > _SHOWN else ""
            raise StudyError(
                f"a weighted workload needs the answers to the pairs of scales in every block; "
                f"they are missing in {len(blocks)}: {shown}{more}. Analyse the raw workload, or "
                "leave these operators out"
            )
    return replace(data, questionnaires=replace(table, kind=kind))
