"""Registries of methods, hands, sources, sinks, readers, metrics and commands, open to plugins.

A name denotes a built-in part, or a part that an installed distribution offers under the entry
point group ``smooth_operator.<kind>s``, or it has the form ``package.module:attribute``. A part is
imported only when it is used, so a missing extra or a broken plugin has no effect until then.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

from smooth_operator.errors import ConfigError, SmoothOperatorError, UnknownNameError
from smooth_operator.extras import DISTRIBUTION
from smooth_operator.terminal import print_note

_Part = TypeVar("_Part")

PREFIX: Final = "smooth_operator."
"""Prefix of the entry point groups of plugins."""

_TARGET: Final = re.compile(r"(?P<module>[^\W\d]\w*(\.[^\W\d]\w*)*):(?P<attribute>[^\W\d][\w.]*)")


@dataclass(frozen=True)
class Entry:
    """A named part of a registry, such as a method or a reader.

    Attributes:
        target: location of the object, ``package.module:attribute``.
        summary: one line for ``--help``.
        distribution: installed distribution that offers it; empty for a built-in part.
    """

    target: str
    summary: str = ""
    distribution: str = ""

    def load(self) -> Any:
        """Imports the module and returns the object; SmoothOperatorError if that fails."""
        module, sign, attribute = self.target.partition(":")
        where = f"{self.target} (of {self.distribution})" if self.distribution else self.target
        if not (sign and module and attribute):
            raise ConfigError(f"{where} must be package.module:attribute")
        try:
            part: Any = importlib.import_module(module)
        except SmoothOperatorError:
            raise
        except ModuleNotFoundError as error:
            if error.name is None or not f"{module}.".startswith(f"{error.name}."):
                raise _broken(where, error) from error  # a module that it needs
            raise ConfigError(
                f"{where}: there is no module {error.name!r}: install the distribution that "
                "contains it, or start in the folder that contains it"
            ) from error
        except Exception as error:  # of foreign code: anything
            raise _broken(where, error) from error
        for name in attribute.split("."):
            if not hasattr(part, name):
                raise ConfigError(f"{where}: module {module} has no {attribute!r}")
            part = getattr(part, name)
        return part


def _broken(where: str, error: Exception) -> ConfigError:
    text = " ".join(str(error).split())
    return ConfigError(f"{where} can't be imported: {type(error).__name__}: {text}")


@functools.cache
def _installed(group: str) -> dict[str, Entry]:
    """Parts that installed distributions offer, by name; of equal names, that of this distribution.
    They are read once per process."""
    from importlib.metadata import entry_points  # here, since the import takes a while

    parts: dict[str, Entry] = {}
    points = entry_points(group=group)
    for point in sorted(points, key=lambda each: getattr(each.dist, "name", "") != DISTRIBUTION):
        owner = point.dist.name if point.dist is not None else "an installed distribution"
        parts.setdefault(point.name, Entry(point.value, f"from {owner}", owner))
    return parts


@functools.cache
def _note_once(text: str) -> None:
    print_note(text)


class Registry(Mapping[str, Entry]):
    """Registry of one kind of part by name. Built-in parts come first, then those of installed
    distributions, which can't replace built-in ones.

    Args:
        kind: kind of part, for messages, such as ``sink``.
        built_in: built-in parts by name.
        needs: names of the attributes that every part must have.
        advice: advice about a missing attribute.
        elsewhere: name of a part of another distribution -> how to get it.
        summaries: name of a part of another distribution -> its line for ``--help``; these parts
            come first.
    """

    def __init__(
        self,
        kind: str,
        built_in: Mapping[str, Entry],
        needs: tuple[str, ...] = (),
        advice: str = "",
        elsewhere: Mapping[str, str] | None = None,
        summaries: Mapping[str, str] | None = None,
    ) -> None:
        self.kind = kind
        self.built_in = dict(built_in)
        self._added: dict[str, Entry] = {}
        self.needs, self.advice = needs, advice
        self.elsewhere, self.summaries = dict(elsewhere or {}), dict(summaries or {})

    @property
    def group(self) -> str:
        """Entry-point group in which distributions declare parts of this kind."""
        return f"{PREFIX}{self.kind}s"

    @property
    def plugins(self) -> dict[str, Entry]:
        """Maps names to parts that come from installed distributions or were added."""
        offered = _installed(self.group) | self._added
        return {
            name: replace(offered[name], summary=self.summaries.get(name, offered[name].summary))
            for name in dict.fromkeys((*self.summaries, *offered))
            if name in offered and name not in self.built_in
        }

    def add(self, name: str, entry: Entry) -> None:
        """Adds a part in this process only; ConfigError if another part has the name."""
        present = self.get(name)
        if present is not None and present.target != entry.target:
            raise ConfigError(f"{entry.target}: there is another {self.kind} {name!r}; rename it")
        self._added[name] = entry

    def __getitem__(self, name: str) -> Entry:
        return self.built_in[name] if name in self.built_in else self.plugins[name]

    def __iter__(self) -> Iterator[str]:
        yield from self.built_in
        yield from self.plugins

    def __len__(self) -> int:
        return len(self.built_in) + len(self.plugins)

    def split(self, text: str) -> tuple[str, str]:
        """Splits ``NAME`` or ``package.module:attribute``, optionally followed by ``:REST`` or
        ``,REST``, into the name and the rest. A name in the registry takes precedence over a module
        of the same name."""
        name, rest = [*re.split("[:,]", text, maxsplit=1), ""][:2]
        target = _TARGET.match(text)
        if name in self or target is None or not is_target(target[0]):
            return name, rest
        after = text[target.end() :]
        return (target[0], after[1:]) if not after or after[0] in ":," else (name, rest)

    def find(self, name: str) -> Entry:
        """Returns the entry with this name or at ``package.module:attribute``; UnknownNameError if
        there is none, ConfigError if it belongs to a distribution that is not installed."""
        if name in self:
            return self[name]
        if is_target(name):
            return Entry(name)
        if name in self.elsewhere:
            raise ConfigError(f"{self.kind} {name!r} is {self.elsewhere[name]}")
        raise UnknownNameError(self.kind, name, self)

    def load(self, name: str) -> Any:
        """Imports and returns the object of this name; raises as ``find`` and ``Entry.load`` do."""
        entry = self.find(name)
        if name in self:
            return entry.load()
        try:
            return entry.load()
        except ConfigError as error:  # perhaps a name was meant, and misspelt
            raise ConfigError(f"{error}. Available {self.kind}s: {', '.join(self)}") from error

    def loadable(self, load: Callable[[str], _Part] | None = None) -> dict[str, _Part]:
        """Maps the name of every part to its object, loaded with ``load`` or ``Registry.load``.
        Parts of plugins that can't be loaded are skipped, with a note on standard error."""
        parts: dict[str, _Part] = {}
        for name in self:
            try:
                parts[name] = (load or self.load)(name)
            except SmoothOperatorError as error:
                if name in self.built_in:
                    raise
                _note_once(f"{self.kind} {name!r} is skipped: {error}")
        return parts

    def check(self, name: str, part: object) -> None:
        """Raises ConfigError for an abstract class or for an object that lacks one of ``needs``."""
        missing = (
            sorted(getattr(part, "__abstractmethods__", ()))
            if isinstance(part, type)
            else [each for each in self.needs if not hasattr(part, each)]
        )
        if missing:
            raise ConfigError(
                f"{self.find(name).target} can't be a {self.kind}: it lacks {', '.join(missing)}"
                + (f"; {self.advice}" if self.advice else "")
            )

    def describe(self) -> str:
        """Returns the names with their summaries, one per line, and the names that are not
        installed."""
        width = max(map(len, self), default=0)
        lines = [f"  {name:{width}}  {entry.summary}" for name, entry in self.items()]
        absent = [name for name in self.elsewhere if name not in self]
        return "\n".join(lines + [f"  not installed: {', '.join(absent)}"] * bool(absent))


def is_target(text: str) -> bool:
    """True for text of the form ``package.module:attribute``. A module without a dot must exist.

    Therefore a misspelt name with an argument (``repaly:glove.npz``) is not mistaken for a module.
    If the module is in the current folder, that folder is appended to Python's search path.
    """
    match = _TARGET.fullmatch(text)
    if match is None:
        return False
    module = match["module"]
    top, folder = module.partition(".")[0], Path.cwd()
    near = (folder / f"{top}.py").is_file() or (folder / top / "__init__.py").is_file()
    if near and str(folder) not in sys.path:
        sys.path.append(str(folder))
        importlib.invalidate_caches()
    return "." in module or importlib.util.find_spec(module) is not None
