"""Registries of methods, hands, sources, sinks, readers, metrics and commands, open to plugins.

A name stands for a built-in part, for one that an installed distribution offers under the entry
point group ``smooth_operator.<kind>s``, or is itself ``package.module:attribute``. Nothing is
imported before it is asked for, so an absent extra or a broken plugin costs nothing until then.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, Final

from smooth_operator.errors import ConfigError, UnknownNameError

_SIGN: Final = ":"


@dataclass(frozen=True)
class Entry:
    """One named part.

    Attributes:
        target: where it is: ``package.module:attribute``.
        summary: one line for ``--help``.
    """

    target: str
    summary: str = ""

    def load(self) -> Any:
        """The object; imports its module.

        Raises:
            ConfigError: there is no such module or attribute, or its module can't be imported.
        """
        module, sign, attribute = self.target.partition(_SIGN)
        if not (sign and module and attribute):
            raise ConfigError(f"{self.target!r} must be package.module:attribute")
        try:
            found: Any = importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{module}.".startswith(f"{error.name}."):
                raise  # a module that it needs, not the module itself
            raise ConfigError(
                f"{self.target}: there is no module {error.name!r}: install the distribution that "
                "has it, or start where Python finds it (PYTHONPATH)"
            ) from error
        for part in attribute.split("."):
            if not hasattr(found, part):
                raise ConfigError(f"{self.target}: {module} has no {attribute!r}")
            found = getattr(found, part)
        return found


@functools.cache
def _installed(group: str) -> dict[str, Entry]:
    """Parts that installed distributions offer, by name."""
    found: dict[str, Entry] = {}
    for point in entry_points(group=group):
        owner = point.dist.name if point.dist is not None else "an installed distribution"
        found.setdefault(point.name, Entry(point.value, f"from {owner}"))
    return found


class Registry(Mapping[str, Entry]):
    """Parts of one kind by name: the built-in ones first, then those of installed distributions.

    A built-in name can't be taken over by a plugin.

    Args:
        kind: what a part is, in one word, for messages: ``sink``.
        built_in: name -> part.
    """

    def __init__(self, kind: str, built_in: Mapping[str, Entry]) -> None:
        self.kind = kind
        self.built_in = dict(built_in)

    @property
    def group(self) -> str:
        """The entry point group in which a distribution offers parts of this kind."""
        return f"smooth_operator.{self.kind}s"

    @property
    def plugins(self) -> dict[str, Entry]:
        """Name -> part of installed distributions."""
        offered = _installed(self.group)
        return {name: entry for name, entry in offered.items() if name not in self.built_in}

    def __getitem__(self, name: str) -> Entry:
        return self.built_in[name] if name in self.built_in else self.plugins[name]

    def __iter__(self) -> Iterator[str]:
        yield from self.built_in
        yield from self.plugins

    def __len__(self) -> int:
        return len(self.built_in) + len(self.plugins)

    def find(self, name: str) -> Entry:
        """The part of a name, or of ``package.module:attribute``.

        Raises:
            UnknownNameError: there is no such name.
        """
        if name in self:
            return self[name]
        if is_target(name):
            return Entry(name)
        raise UnknownNameError(self.kind, name, self)

    def load(self, name: str) -> Any:
        """The object of a name, or of ``package.module:attribute``.

        Raises:
            UnknownNameError: there is no such name.
            ConfigError: its module can't be found, or lacks the attribute.
        """
        return self.find(name).load()

    def describe(self) -> str:
        """The names with their summaries, a line each."""
        width = max(map(len, self), default=0)
        return "\n".join(f"  {name:{width}}  {self[name].summary}" for name in self)


def is_target(text: str) -> bool:
    """Whether a text has the form ``package.module:attribute``."""
    module, sign, attribute = text.partition(_SIGN)
    return bool(sign) and all(
        part.isidentifier() for part in (*module.split("."), *attribute.split("."))
    )
