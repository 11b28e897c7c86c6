"""The log of a search: one line of JSON for each trial, whole or not there, to go on from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from smooth_operator.errors import OutputError
from smooth_operator.parallel import TaskResult
from smooth_operator.result_cache import Job, Note, ResultLog, key_digest, no_note, run_jobs
from smooth_operator.result_cache.jobs import Execute

T = TypeVar("T")


@dataclass(frozen=True)
class Trial:
    """What came of a set of values.

    Attributes:
        values: path of a setting -> value.
        metrics: one for each recording, of ``evaluate``; None where the
            values can't be.
        reason: why they can't; None where they can.
        seconds: how long it took.
    """

    values: Mapping[str, float | int]
    metrics: Sequence[Mapping[str, Any]] | None
    reason: str | None
    seconds: float


class TrialLog:
    """A file of trials; those of another search in it are left alone and not used.

    Args:
        path: the file; made with the first trial.
        search: what trials depend on but for their values and for code: method, recordings, hand.
        code: digest of the code that makes them.
        note: called with what is in the file and can't be used.

    Raises:
        OutputError: it can't be read, or holds something other than trials.
    """

    def __init__(self, path: Path, search: object, code: str = "", note: Note = no_note) -> None:
        self._search, self._code = key_digest(search), code
        self._log = ResultLog(path, note)
        if self._log.damaged:
            raise OutputError(
                f"{path} holds a line that is no trial: give another folder with --output, "
                "or remove the file"
            )

    def __len__(self) -> int:
        return sum(one.get("search") == self._search for one in self._log.values(self._code))

    def find(self, values: Mapping[str, float | int]) -> Trial | None:
        """A trial of these values that is known already."""
        found = self._log.find("", self._key(values), self._code)
        return None if found is None else _trial(found)

    def add(self, trial: Trial) -> None:
        """Keeps a trial; it is on the disk when this returns.

        Raises:
            OutputError: it can't be written.
        """
        self._log.keep("", self._key(trial.values), self._code, self._line(trial))

    def run(
        self,
        tasks: Sequence[tuple[Mapping[str, float | int], T]],
        execute: Execute[T],
        *,
        keep_failures: bool = True,
    ) -> Iterator[tuple[int, Trial, bool]]:
        """Trials of some values: those that are known, then the others as they are measured.

        Args:
            tasks: values, and what ``execute`` is given for them.
            execute: as of ``run_jobs``; a task's result is its metrics.
            keep_failures: do not try again what has failed.

        Yields:
            Position among the tasks, the trial, and whether it was made now.

        Raises:
            OutputError: the file can't be written.
        """
        jobs = [Job(str(i), self._key(v), self._code, t) for i, (v, t) in enumerate(tasks)]
        failed: dict[str, Trial] = {}

        def line(job: Job[T], result: TaskResult[Any]) -> dict[str, Any] | None:
            values = tasks[int(job.name)][0]
            trial = Trial(values, result.value, result.error, result.seconds)
            if result.value is None and not keep_failures:
                failed[job.name] = trial
                return None
            return self._line(trial)

        for result in run_jobs(jobs, self._log, execute, line):
            name = result.job.name
            trial = failed[name] if result.value is None else _trial(result.value)
            yield int(name), trial, result.fresh

    def _key(self, values: Mapping[str, float | int]) -> object:
        return [self._search, dict(sorted(values.items()))]

    def _line(self, trial: Trial) -> dict[str, Any]:
        return {"search": self._search, "values": trial.values, "metrics": trial.metrics,
                "reason": trial.reason, "seconds": trial.seconds}  # fmt: skip


def _trial(line: Mapping[str, Any]) -> Trial:
    return Trial(*(line[name] for name in ("values", "metrics", "reason", "seconds")))
