"""The files of a plan in the folder of its study: the plan, and texts made of it."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import NAME, plan_text, write_plan
from smooth_operator.study.design.preregistration import NAME as PREREGISTRATION
from smooth_operator.study.design.preregistration import preregistration
from smooth_operator.study.design.schedule import schedule_csv, schedule_text

KEPT: Final = "PREREGISTRATION.before.md"
"""The text of the plan before it was changed."""


def write_plan_files(plan: Plan, folder: Path) -> list[Path]:
    """Writes plan and schedules; those that stand there are replaced.

    Args:
        plan: of the study.
        folder: exists.

    Returns:
        The files.

    Raises:
        OutputError: a file can't be written.
    """
    written = [write_plan(plan, folder / NAME)]
    texts = {"schedule.csv": schedule_csv(plan), "schedule.txt": schedule_text(plan)}
    for name, text in texts.items():
        with atomic_write(folder / name) as file:
            file.write(text.encode("utf-8"))
        written.append(folder / name)
    return written


def write_preregistration(plan: Plan, folder: Path) -> Path | None:
    """Writes ``PREREGISTRATION.md``, where none of this very plan is there.

    To be called before anyone has begun only. A text of another plan, which somebody may have
    completed by hand, is kept under the name of ``KEPT``.

    Returns:
        The file, or None where it is there.

    Raises:
        OutputError: it can't be written.
    """
    path = folder / PREREGISTRATION
    mark = f"<!-- plan {_digest(plan)} -->"
    try:
        there = path.read_text("utf-8", errors="replace") if path.is_file() else None
        if there is not None and mark in there:
            return None
        if there is not None:
            path.replace(folder / KEPT)
    except OSError as error:
        raise output_error(path, error) from error
    with atomic_write(path) as file:
        file.write(f"{preregistration(plan)}\n{mark}\n".encode())
    return path


def _digest(plan: Plan) -> str:
    """Of all but who is enrolled."""
    return hashlib.sha256(plan_text(replace(plan, enrolled=())).encode()).hexdigest()[:16]
