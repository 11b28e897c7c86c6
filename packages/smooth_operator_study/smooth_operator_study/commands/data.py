"""``smooth-operator study export`` and ``study erase``: export and delete data of a study."""

from __future__ import annotations

import sys
from pathlib import Path

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.terminal import printable
from smooth_operator_study.commands.options import Erase, Export
from smooth_operator_study.design.plan_file import NAME, read_plan, write_plan
from smooth_operator_study.store.export import export_study
from smooth_operator_study.store.study_store import FILE, open_study


def export_data(options: Export) -> None:
    """Exports the data and prints the names of the files."""
    _check_there(options.study)
    with open_study(options.study) as store:
        files = export_study(store, options.output, operators=options.operator or None)
    print(printable(f"written: {', '.join(str(path) for path in files)}"))


def erase_data(options: Erase) -> None:
    """Deletes the data of an operator after confirmation, and removes the operator from the plan in
    the folder."""
    _check_there(options.study)
    with open_study(options.study) as store:
        if options.operator not in (*store.plan.codes, *store.erased):
            raise UnknownNameError("operator", options.operator, store.plan.codes)
        count = len(store.records(options.operator))
        if not options.yes:
            if not sys.stdin.isatty():
                raise ConfigError(
                    f"{count} events of {options.operator} would be deleted permanently; "
                    "confirm with --yes"
                )
            question = (
                f"Delete {count} events of {options.operator} permanently? Type the code to "
                "confirm: "
            )
            if input(question).strip() != options.operator:
                raise ConfigError("nothing was deleted")
        gone = store.erase(options.operator)
    file = Path(options.study) / NAME
    if file.is_file():
        plan = read_plan(file)
        if options.operator in plan.codes:
            write_plan(plan.withdraw(options.operator), file)
    print(
        printable(f"deleted: {gone} events of {options.operator}; delete exported copies yourself")
    )


def _check_there(study: str) -> None:
    """Refuses a missing store, because opening it would create an empty one."""
    path = Path(study) / FILE if Path(study).is_dir() else Path(study)
    if not path.is_file():
        raise ConfigError(f"no study data at {path}; name the folder of a study that was run")
