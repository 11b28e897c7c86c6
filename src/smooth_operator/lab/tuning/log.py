"""The log of a search: one line of JSON for each trial, whole or not there, to go on from."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smooth_operator.errors import OutputError
from smooth_operator.io import output_error, to_json
from smooth_operator.io.documents import parse_json


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
        search: what trials depend on but for their values: method, recordings, hand, code.

    Raises:
        OutputError: it can't be read.
    """

    def __init__(self, path: Path, search: str) -> None:
        self.path, self._search = path, search
        self._known: dict[str, Trial] = {}
        try:
            content = path.read_bytes() if path.exists() else b""
        except OSError as error:
            raise output_error(path, error) from error
        whole = content[: content.rfind(b"\n") + 1]  # a killed run may have left half a line
        for line in whole.splitlines():
            self._take(line)
        if len(whole) < len(content):
            self._shorten(len(whole))

    def __len__(self) -> int:
        return len(self._known)

    def find(self, values: Mapping[str, float | int]) -> Trial | None:
        """A trial of these values that is known already."""
        return self._known.get(_key(values))

    def add(self, trial: Trial) -> None:
        """Keeps a trial; it is on the disk when this returns.

        Raises:
            OutputError: it can't be written.
        """
        line = {"search": self._search, "values": trial.values, "metrics": trial.metrics,
                "reason": trial.reason, "seconds": trial.seconds}  # fmt: skip
        try:
            with self.path.open("ab") as file:
                file.write(to_json(line).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise output_error(self.path, error) from error
        self._known[_key(trial.values)] = trial

    def _take(self, line: bytes) -> None:
        try:
            content = parse_json(line)
            if content["search"] != self._search:
                return
            trial = Trial(*(content[name] for name in ("values", "metrics", "reason", "seconds")))
            self._known[_key(trial.values)] = trial
        except (ValueError, KeyError, TypeError, AttributeError):
            raise OutputError(
                f"{self.path} holds a line that is no trial: give another folder with --output, "
                "or remove the file"
            ) from None

    def _shorten(self, size: int) -> None:
        try:
            os.truncate(self.path, size)
        except OSError as error:
            raise output_error(self.path, error) from error


def _key(values: Mapping[str, float | int]) -> str:
    text = json.dumps(dict(sorted(values.items())))
    return hashlib.sha256(text.encode()).hexdigest()
