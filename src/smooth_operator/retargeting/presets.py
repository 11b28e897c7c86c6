"""Looks up methods and their presets. The presets are defined next to their methods."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from smooth_operator.errors import ConfigError, UnknownNameError, brief
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.registry import DEFAULT_METHOD, METHODS, as_presets
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig


class _Presets(Mapping[str, Mapping[str, MethodConfig]]):
    """Registry of methods that loads its values."""

    def __getitem__(self, method: str) -> Mapping[str, MethodConfig]:
        loaded = METHODS.load(method)
        refusal = (
            f"{METHODS.find(method).target} can't be a method: it must be a MethodConfig, its "
            "class, or a mapping of preset names to them, not "
        )
        if isinstance(loaded, type) and not issubclass(loaded, MethodConfig):
            raise ConfigError(f"{refusal}{brief(loaded)}")
        try:
            presets = as_presets(loaded)
        except TypeError as error:  # a class whose fields lack defaults
            raise ConfigError(f"{refusal}a class that needs arguments ({error})") from error
        if not presets:
            raise ConfigError(f"method {method!r} has no presets")
        for config in presets.values():
            if not isinstance(config, MethodConfig):
                raise ConfigError(f"{refusal}{brief(config)}")
        return presets

    def __iter__(self) -> Iterator[str]:
        return iter(METHODS)

    def __len__(self) -> int:
        return len(METHODS)


PRESETS: Final[Mapping[str, Mapping[str, MethodConfig]]] = _Presets()
"""Maps a method, or ``package.module:attribute``, and a preset to a configuration; the first preset
is the default. A look-up raises ``UnknownNameError`` for an unknown method, and ``ConfigError`` if
a plugin's method can't be loaded."""

_ALIASES: Final = {"sbr": {"published": "paper"}}
"""Alternative names of presets, by method: every published method accepts ``published``."""


def method_names() -> tuple[str, ...]:
    """Names of the methods, both built-in and from plugins."""
    return tuple(METHODS)


def loadable_presets() -> dict[str, Mapping[str, MethodConfig]]:
    """``PRESETS`` without plugin methods that can't be loaded; a note names them."""
    return METHODS.loadable(PRESETS.__getitem__)


def live_presets() -> dict[str, list[str]]:
    """Names of the presets that work frame by frame, by method."""
    return {
        method: [
            name
            for name, config in presets.items()
            if not isinstance(config, TrajectoryMethodConfig)
        ]
        for method, presets in loadable_presets().items()
    }


def default_preset(method: str) -> str:
    """Name of a method's default preset. Raises the same errors as ``PRESETS``."""
    return next(iter(PRESETS[method]))


def preset_config(method: str = DEFAULT_METHOD, preset: str | None = None) -> MethodConfig:
    """Configuration that a preset of a method has; for None, that of the method's default preset.

    ``published`` is a preset of keyvector, hybrid, dexpilot and ako; for sbr it means ``paper``.
    geort also accepts the path of a trained model, and ``method_config`` accepts preset files.

    Raises:
        UnknownNameError: there is no such method or preset.
        ConfigError: the method of a plugin can't be loaded.
    """
    for name in (method, preset):
        if not isinstance(name, (str, type(None))):
            raise ConfigError(
                f"method and preset must be names, not {brief(name)}; pass a configuration as "
                "Retargeter(..., config=...)"
            )
    default = default_preset(method)
    presets = PRESETS[method]
    if preset is None:
        return presets[default]
    preset = _ALIASES.get(method, {}).get(preset, preset)
    if preset not in presets:
        file = Path(preset)
        own = presets[default].with_file(file) if file.is_file() else None
        if own is not None:
            return own
        raise UnknownNameError(f"preset of method {method!r}:", preset, presets, _elsewhere(preset))
    return presets[preset]


def _elsewhere(preset: str) -> str:
    """Hint for a preset of another method, since without --method the default method is used."""
    owners = [method for method, presets in loadable_presets().items() if preset in presets]
    return (
        f"{preset!r} is a preset of {', '.join(owners)}: also choose that method." if owners else ""
    )
