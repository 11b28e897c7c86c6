"""Takes, which are recordings that the operator starts, ends, keeps or discards while a loop
runs."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.teleop.sinks.sink import SinkRunner

if TYPE_CHECKING:
    from smooth_operator.teleop.sinks.record import TakeSink

_NAME: Final = re.compile(r"[\w.-]{1,80}")


class Takes:
    """Starts and ends recordings (takes). A take that has ended is complete in its numbered file,
    and is kept unless the operator discards it.

    Args:
        sinks: sinks of the running loop.
        folder: folder of the takes.
        configuration: returns the settings that have changed since the start of the run, for the
            log.
        say: shows a line to the operator.

    Attributes:
        error: reason why the last action failed; empty if it succeeded.
        kept: number of takes of this run that were not discarded.
    """

    def __init__(
        self,
        sinks: SinkRunner,
        folder: Path,
        configuration: Callable[[], Mapping[str, Any]] = dict,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.folder = folder
        self.error = ""
        self.kept = 0
        self._sinks, self._configuration, self._say = sinks, configuration, say
        self._take: TakeSink | None = None
        self._begun = 0.0
        self._last: tuple[Path, ...] = ()
        self._open = False  # True until the last take is named, kept or discarded
        self._working = threading.Lock()

    def state(self) -> dict[str, Any]:
        """State of the takes for the page, as JSON values."""
        take = self._take
        return {
            "recording": "" if take is None else _names(take.paths),
            "seconds": 0.0 if take is None else time.monotonic() - self._begun,
            "kept": self.kept - self._open,
            "last": [str(path) for path in self._last],
            "open": self._open,
        }

    @property
    def actions(self) -> dict[str, Callable[[], None]]:
        """Operator actions for takes, by their names in ``ACTIONS``."""
        return {"record": self.toggle, "keep": self._keep, "discard": self._discard}

    def toggle(self) -> None:
        """Starts or ends a take; does not wait."""
        threading.Thread(target=self._toggle, name="take", daemon=True).start()

    def keep(self, name: str = "") -> None:
        """Keeps the last take; if a name is given, renames it.

        Raises:
            ConfigError: there is no take, or the name is not valid for a file.
            OutputError: the file can't be renamed.
        """
        with self._working:
            name = re.sub(r"\s+", "_", name.strip()).removesuffix(".mcap")
            if name:
                self._rename(name)
            self._decided()

    def discard(self) -> None:
        """Deletes the last take.

        Raises:
            ConfigError: there is no take to discard.
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

    def _keep(self) -> None:
        self._tell(self.keep, "kept")

    def _discard(self) -> None:
        self._tell(self.discard, "deleted")

    def _tell(self, decide: Callable[[], None], decided: str) -> None:
        """Keep or discard the last take, and say so."""
        names = _names(self._last)
        try:
            decide()
        except SmoothOperatorError as error:
            self._say(str(error))
        else:
            self._say(f"take {decided}: {names}")

    def _decided(self) -> tuple[Path, ...]:
        if not self._open:
            raise ConfigError("there is no take to keep or discard: record one first")
        self._open = False
        return self._last

    def _rename(self, name: str) -> None:
        """Renames all files of the last take; if one fails, renames none."""
        if not _NAME.fullmatch(name) or name.startswith("."):
            raise ConfigError(
                f"a take can't be called {name!r}: use only letters, digits, '-', '_' and '.'"
            )
        named = {
            file: file.with_name("".join([name, *file.suffixes[-len(self._last) :]]))
            for file in self._last
        }
        if len(set(named.values())) < len(named):
            raise ConfigError(
                "the take was interrupted and is in several files: keep it without a new name"
            )
        taken = [file.name for file in named.values() if file.exists()]
        if taken:
            raise ConfigError(f"there is already a take {taken[0]}: choose another name")
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
                self._say(f"take ended: {_names(self._last)}")
                return
            try:
                from smooth_operator.teleop.sinks.record import TakeSink

                take = TakeSink(self.folder, configuration=self._configuration)
                self._sinks.add(take)
            except SmoothOperatorError as error:
                self.error = str(error)
                self._say(self.error)
            else:
                self._begun, self._open = time.monotonic(), False
                self._take = take
                self._say(f"recording {_names(take.paths)}")


def _names(paths: Iterable[Path]) -> str:
    return ", ".join(path.name for path in paths)
