"""Opens the store of a study, or creates it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_table
from smooth_operator.study.store.database_tables import open_engine, tables
from smooth_operator.study.store.study_store import StudyStore, now

if TYPE_CHECKING:
    from sqlalchemy import Engine

FORMAT: Final = 1
"""Version of what is stored; a store of a newer one is refused."""


def open_study(
    target: str | Path, plan: Plan | None = None, *, name: str | None = None
) -> StudyStore:
    """Opens the store of a study; makes it if a plan is given.

    Args:
        target: folder of the study, an SQLite file, or the URL of a database.
        plan: of the study; operators that it newly enrols are taken over. None for what is stored.
        name: of the study, where a database holds several and no plan is given.

    Raises:
        MissingExtraError: what the database needs is not installed.
        StudyError: it can't be opened, holds no such study, or that with another protocol.
        UnknownNameError: it holds no study of that name.
    """
    engine = open_engine(target)
    try:
        made, study_id = _find(engine, plan, plan.protocol.name if plan is not None else name)
        store = StudyStore(engine, study_id, made)
        if plan is not None:
            store.revise(plan)
        return store
    except BaseException:
        engine.dispose()
        raise


def _find(engine: Engine, plan: Plan | None, name: str | None) -> tuple[str, int]:
    all_tables = tables().tables
    studies = all_tables["studies"]
    with engine.begin() as connection:
        if plan is not None and engine.dialect.name == "postgresql":
            connection.exec_driver_sql("LOCK TABLE studies IN SHARE ROW EXCLUSIVE MODE")
        rows = {row.name: row for row in connection.execute(studies.select())}
        if name is None:
            if len(rows) != 1:
                held = ", ".join(sorted(rows)) or "none"
                raise StudyError(f"the store holds these studies: {held}; say which, by its name")
            name = next(iter(rows))
        if name in rows:
            if rows[name].format != FORMAT:
                raise StudyError(
                    f"study {name!r} is stored in format {rows[name].format}, this program reads "
                    f"{FORMAT}: update it"
                )
            return name, int(rows[name].id)
        if plan is None:
            raise UnknownNameError("study", name, rows)
        values: dict[str, Any] = {
            "name": name, "format": FORMAT, "created_at": now().isoformat(),
        }  # fmt: skip
        key = connection.execute(studies.insert().values(values)).inserted_primary_key
        assert key is not None
        connection.execute(
            all_tables["plans"]
            .insert()
            .values(study_id=key[0], at=now().isoformat(), plan=json.dumps(plan_table(plan)))
        )
        return name, int(key[0])
