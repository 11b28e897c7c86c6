"""The files of a plan in the folder of its study: the plan, and two schedules made of it."""

from __future__ import annotations

from pathlib import Path

from smooth_operator.atomic_files import atomic_write
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import NAME, write_plan
from smooth_operator.study.design.schedule import schedule_csv, schedule_text


def write_plan_files(plan: Plan, folder: Path) -> list[Path]:
    """Writes plan and schedules; those that stand there are replaced.

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
