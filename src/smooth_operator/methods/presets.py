"""Methods and their presets, as Python objects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from smooth_operator.errors import ConfigError, UnknownNameError, brief
from smooth_operator.human.correspondence import CorrespondenceConfig
from smooth_operator.methods.default import DEFAULT_METHOD
from smooth_operator.methods.method import MethodConfig, TrajectoryMethodConfig
from smooth_operator.methods.registry import METHODS, as_presets
from smooth_operator.methods.sbr import SbrConfig
from smooth_operator.methods.smooth import SmoothConfig
from smooth_operator.objective.loss import ObjectiveConfig
from smooth_operator.objective.smooth_terms import SelfCollisionConfig
from smooth_operator.objective.targets import CloseTargets, DexPilotTargets
from smooth_operator.plugins import Entry
from smooth_operator.solvers.newton import NewtonConfig
from smooth_operator.solvers.sampling import SamplingConfig
from smooth_operator.solvers.trajectory import TrajectoryConfig

_PRESET_FILE = Entry("smooth_operator.formats.preset_file:read_preset_file")
_WITH_SETTINGS = Entry("smooth_operator.formats.setting_paths:with_settings")
_FILE: Final = ".toml"

SBR_PAPER: Final = SbrConfig()
"""The paper's table of hyper-parameters, fresh normals in every cycle."""

SBR_REALTIME: Final = SbrConfig(
    objective=ObjectiveConfig(
        targets=DexPilotTargets(w_thumb=1.4, w_between=0.85, blend=0.4),
        pose_weight=0.049,
        velocity_weight=0.107,
    ),
    sampling=SamplingConfig(samples=256, elites=24, cycles=5, draws="quasi"),
    polish=NewtonConfig(iterations=3, damping=(0.0, 1.0)),
    settle_rounds=10,
)
"""For an ordinary CPU: few quasi-random base samples find the basin, Newton steps its floor.

The optimum that the paper's sampler only approaches follows jumps of the pinch latches more
closely; so a latch moves over 2.5 frames, and weight goes from the finger-to-finger keyvectors to
the thumb's. docs/reference/benchmarks.md says what the weights were tuned on.
"""

SMOOTH_TELEOP: Final = SmoothConfig()
"""For a live loop: causal, no frame later than the human's; open when the human's hand is open,
closed when it is closed, whatever the lengths of either's fingers."""

SMOOTH_PRECISE: Final = replace(
    SMOOTH_TELEOP,
    correspondence=CorrespondenceConfig(share=0.0),
    objective=replace(
        SMOOTH_TELEOP.objective, targets=CloseTargets(w_wrist=1.0, w_thumb=20.0, focus=0.5)
    ),
    motion_weight=1300.0,
    pinch_damping=0.0,
    self_collision=SelfCollisionConfig(),
)
"""For the paper's metrics: the human's fingertips as the palms are aligned, and of them first the
directions from the thumb. Fingers of other lengths than the human's stay bent in an open hand."""

SMOOTH_GRASP: Final = replace(SMOOTH_TELEOP, pinch_damping=1000.0)
"""For a live loop that handles objects: fingers that pinch hardly follow a slow motion of the
human's, so that they do not roll out what they hold (docs/explanation/smooth.md)."""

_FUTURE: Final = TrajectoryConfig(
    acceleration_weight=2e-8, motion_weight=0.07, motion_speed=0.6, speed_limit=28.0
)

SBR_OFFLINE: Final = TrajectoryMethodConfig(
    replace(SBR_REALTIME, objective=replace(SBR_REALTIME.objective, pose_weight=0.02)),
    _FUTURE,
    jump=0.03,
)
"""For recordings: Eq. (1) for all frames together, with a cost of acceleration, and of fingertips
that move otherwise than the human's.

With the future known, velocity need not cost anything, and the pull to the neutral pose can be
weaker for the same smoothness.
"""

SMOOTH_OFFLINE: Final = TrajectoryMethodConfig(
    SMOOTH_PRECISE,
    replace(_FUTURE, acceleration_weight=3e-8, motion_weight=0.35, motion_speed=0.15),
    jump=0.02,
    noise=50.0,
)
"""For recordings: ``smooth:precise`` for all frames together, without its filters."""

SBR: Final = {"realtime": SBR_REALTIME, "paper": SBR_PAPER, "offline": SBR_OFFLINE}
SMOOTH: Final = {
    "teleop": SMOOTH_TELEOP,
    "precise": SMOOTH_PRECISE,
    "grasp": SMOOTH_GRASP,
    "offline": SMOOTH_OFFLINE,
}


class _Presets(Mapping[str, Mapping[str, MethodConfig]]):
    """The registry of methods, with its values loaded."""

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
            raise ConfigError(f"method {method!r} has no preset")
        for config in presets.values():
            if not isinstance(config, MethodConfig):
                raise ConfigError(f"{refusal}{brief(config)}")
        return presets

    def __iter__(self) -> Iterator[str]:
        return iter(METHODS)

    def __len__(self) -> int:
        return len(METHODS)


PRESETS: Final[Mapping[str, Mapping[str, MethodConfig]]] = _Presets()
"""Method name -> preset name -> configuration; the first preset of a method is its default.

A name may be ``package.module:attribute``. A look-up raises ``UnknownNameError`` (a ``KeyError``)
where there is no such method, and ``ConfigError`` where a plugin's can't be loaded.
"""

_ALIASES: Final = {"sbr": {"published": "paper"}}
"""Method -> other names of its presets: ``published`` is what every published method answers to."""


def method_names() -> tuple[str, ...]:
    """Names of the methods, built-in and of plugins."""
    return tuple(METHODS)


def loadable_presets() -> dict[str, Mapping[str, MethodConfig]]:
    """``PRESETS`` without the methods of plugins that can't be loaded; a note says which."""
    return METHODS.loadable(PRESETS.__getitem__)


def live_presets() -> dict[str, list[str]]:
    """Names of the presets that answer frame by frame, by method."""
    return {
        method: [name for name, config in presets.items() if config.trajectory is None]
        for method, presets in loadable_presets().items()
    }


def default_preset(method: str) -> str:
    """Name of a method's default preset.

    Raises:
        UnknownNameError: there is no such method.
        ConfigError: it is a plugin's, and can't be loaded.
    """
    return next(iter(PRESETS[method]))


def method_config(method: str = DEFAULT_METHOD, preset: str | None = None) -> MethodConfig:
    """Configuration of a method by preset name; None gives the method's default preset.

    For a method with a trained model (geort), the file of one may stand for the preset; for any
    method a preset file (``smooth_operator.formats.preset_file``). ``published`` is a preset
    of every method that the paper compares but GeoRT, of ``ako`` and of ``keyvector``; that of sbr
    is its ``paper``.

    The method may be ``package.module:attribute``: a configuration, its class, or presets by name.

    Raises:
        UnknownNameError: if there is no such method or preset.
        ConfigError: the preset file is none, or for another method; the method is a plugin's and
            can't be loaded.
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
    if preset not in presets and preset.endswith(_FILE):
        return _from_file(method, Path(preset))
    if preset not in presets:
        file = Path(preset)
        own = presets[default].with_file(file) if file.is_file() else None
        if own is not None:
            return own
        raise UnknownNameError(f"preset of method {method!r}:", preset, presets, _elsewhere(preset))
    return presets[preset]


def _elsewhere(preset: str) -> str:
    """Whose preset it is, if not that of the method: who names none gets the default one."""
    owners = [method for method, presets in loadable_presets().items() if preset in presets]
    return (
        f"{preset!r} is a preset of {', '.join(owners)}: choose that method too." if owners else ""
    )


def _from_file(method: str, path: Path) -> MethodConfig:
    file = _PRESET_FILE.load()(path)
    if file.method != method:
        raise ConfigError(
            f"{path} is a preset of method {brief(file.method)}, not of {method!r}: choose "
            "that method too"
        )
    if file.base.endswith(_FILE):
        raise ConfigError(f"{path}: its base must be the name of a preset, not {brief(file.base)}")
    config: MethodConfig = _WITH_SETTINGS.load()(method_config(method, file.base), file.settings)
    return config
