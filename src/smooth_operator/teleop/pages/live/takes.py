"""Takes of a running loop: record, stop, then keep under a name or discard."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.record import SUFFIX, RecordSink
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.types import Side

_NAME: Final = re.compile(r"[\w.-]{1,80}")


@dataclass(frozen=True)
class _Take(RecordSink):
    """A recording that holds the configuration of when it began, and not of when the run did."""

    configuration: Callable[[], Mapping[str, Any]] = dict

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Create the files."""
        super().open(hands, {**config, **self.configuration()})


class Takes:
    """Begins and ends recordings, which may take a while: ``toggle`` does not wait.

    A take that has ended lies whole in its numbered file, and stays there if nothing is decided.

    Args:
        sinks: sinks of the running loop.
        folder: where the takes go.
        configuration: settings that were changed since the run began, for the log.

    Attributes:
        error: why the last action failed; empty if it did not.
        kept: takes of this run that were not discarded.
    """

    def __init__(
        self,
        sinks: SinkRunner,
        folder: Path,
        configuration: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        self.folder = folder
        self.error = ""
        self.kept = 0
        self._sinks, self._configuration = sinks, configuration
        self._take: _Take | None = None
        self._begun = 0.0
        self._last: tuple[Path, ...] = ()
        self._open = False  # whether the last take is still to be named, kept or discarded
        self._working = threading.Lock()

    @property
    def recording(self) -> str:
        """The files that are being written, or nothing."""
        take = self._take
        return "" if take is None else ", ".join(path.name for path in take.paths)

    def state(self) -> dict[str, Any]:
        """State for the page, as JSON values: the take that runs, the last one, their number."""
        return {
            "recording": self.recording,
            "seconds": time.monotonic() - self._begun if self._take is not None else 0.0,
            "kept": self.kept,
            "last": [str(path) for path in self._last],
            "open": self._open,
        }

    def toggle(self) -> None:
        """Begin a take, or end the one that runs; does not wait."""
        threading.Thread(target=self._toggle, name="take", daemon=True).start()

    def keep(self, name: str = "") -> None:
        """Keep the last take, under a name if there is one.

        Raises:
            ConfigError: there is no take, or the name can't be a file's.
            OutputError: a file has that name.
        """
        with self._working:
            name = re.sub(r"\s+", "_", name.strip()).removesuffix(SUFFIX)
            if name:
                self._rename(name)
            self._decided()

    def discard(self) -> None:
        """Delete the last take.

        Raises:
            ConfigError: there is none, or it is decided already.
            OutputError: its file can't be deleted.
        """
        with self._working:
            files = self._decided()
            self.kept -= 1
            self._last = ()
            for file in files:
                try:
                    file.unlink(missing_ok=True)
                except OSError as error:
                    raise output_error(file, error) from error

    def _decided(self) -> tuple[Path, ...]:
        if not self._open:
            raise ConfigError("there is no take to keep or discard: record one first")
        self._open = False
        return self._last

    def _rename(self, name: str) -> None:
        """Rename the files of the last take; of both hands, all or none."""
        if not _NAME.fullmatch(name) or name.startswith("."):
            raise ConfigError(
                f"a take can't be called {name!r}: letters, digits, '-', '_' and '.' only"
            )
        named = {
            file: file.with_name("".join([name, *file.suffixes[-len(self._last) :]]))
            for file in self._last
        }
        if len(set(named.values())) < len(named):
            raise ConfigError("the take broke off and is in several files: keep it as they are")
        taken = [file.name for file in named.values() if file.exists()]
        if taken:
            raise ConfigError(f"there is a take {taken[0]} already: choose another name")
        for file, new in named.items():
            try:
                file.rename(new)
            except OSError as error:
                raise output_error(new, error) from error
        self._last = tuple(named.values())

    def _toggle(self) -> None:
        with self._working:
            self.error = ""
            take, self._take = self._take, None
            if take is not None:
                self._sinks.remove(take)
                self._last, self._open = tuple(take.paths), bool(take.paths)
                self.kept += self._open
                return
            try:
                take = _Take(self.folder, configuration=self._configuration)
                self._sinks.add(take)
            except SmoothOperatorError as error:
                self.error = str(error)
            else:
                self._begun, self._open = time.monotonic(), False
                self._take = take
