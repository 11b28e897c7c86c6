"""Recordings that are begun and ended while the loop runs: numbered takes in a folder."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.record import RecordSink
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.types import Side


@dataclass(frozen=True)
class _Take(RecordSink):
    """A recording that holds the configuration of when it began, and not of when the run did."""

    configuration: Callable[[], Mapping[str, Any]] = dict

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Create the files."""
        super().open(hands, {**config, **self.configuration()})


class Recordings:
    """Begins and ends recordings; creating and ending files may take a while, and is waited for by
    nobody.

    Args:
        sinks: of the running loop.
        folder: where the takes go.
        configuration: what has changed since the run began, for the log.
    """

    def __init__(
        self,
        sinks: SinkRunner,
        folder: Path,
        configuration: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        self.folder = folder
        self.error = ""
        self._sinks, self._configuration = sinks, configuration
        self._take: _Take | None = None
        self._working = threading.Lock()

    @property
    def recording(self) -> str:
        """The files that are being written, or nothing."""
        take = self._take
        return "" if take is None else ", ".join(path.name for path in take.paths)

    def toggle(self) -> None:
        """Begin a take, or end the one that runs; does not wait."""
        threading.Thread(target=self._toggle, name="take", daemon=True).start()

    def _toggle(self) -> None:
        with self._working:
            self.error = ""
            take, self._take = self._take, None
            if take is not None:
                self._sinks.remove(take)
                return
            try:
                take = _Take(self.folder, configuration=self._configuration)
                self._sinks.add(take)
            except SmoothOperatorError as error:
                self.error = str(error)
            else:
                self._take = take
