"""The settings that an operator changes on the live page while the hand moves."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import viser

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.pages.viser_server import from_person


@dataclass(frozen=True)
class Setting:
    """A number of a configuration that has a slider.

    Attributes:
        path: names from the top of the configuration, with dots.
        label: name on the page, with the unit.
        low, high, step: range of the slider.
        hint: meaning, in a few words.
        automatic: None is a value too, and stands for an automatic choice.
    """

    path: str
    label: str
    low: float
    high: float
    step: float
    hint: str
    automatic: bool = False


METHOD_SETTINGS: Final = (
    Setting("alignment.scale", "Scale", 0.5, 2.0, 0.01, "robot size over human size", True),
    Setting("objective.targets.project", "Pinch closes [m]", 0.001, 0.05, 0.001,
            "a finger nearer to the thumb touches it"),
    Setting("objective.targets.escape", "Pinch opens [m]", 0.001, 0.08, 0.001,
            "a finger farther from the thumb is free again"),
    Setting("objective.velocity_weight", "Smoothness", 0.0, 1.0, 0.005,
            "weight of the change from one command to the next"),
    Setting("joint_speed", "Joint speed [rad/s]", 1.0, 60.0, 0.5, "speed the method allows itself"),
)  # fmt: skip
"""Settings of retargeting methods; a method shows those that its configuration has."""
LOOP_SETTINGS: Final = (
    Setting("limits.velocity", "Joint velocity [rad/s]", 0.1, 30.0, 0.1, "largest, of any joint"),
    Setting("limits.acceleration", "Joint acceleration [rad/s²]", 10.0, 3000.0, 10.0,
            "largest, of any joint"),
    Setting("limits.margin", "Margin [rad]", 0.0, 0.5, 0.01, "kept clear of each joint limit"),
    Setting("safety.stale_s", "Hold after [s]", 0.02, 1.0, 0.01, "age of the last usable frame"),
    Setting("safety.lost_s", "Ease after [s]", 0.1, 10.0, 0.1, "time without a usable frame"),
    Setting("wrist.scale", "Wrist scale", 0.1, 4.0, 0.05, "metres of the robot per metre"),
    Setting("wrist.yaw", "Wrist yaw [rad]", -3.2, 3.2, 0.05,
            "where the operator's forward points in the robot's base"),
    Setting("wrist.velocity", "Wrist velocity [m/s]", 0.1, 4.0, 0.1, "largest"),
)  # fmt: skip
"""Settings of the loop: limits, the policy when the tracker is lost, and the wrist."""


def values(config: Any, settings: tuple[Setting, ...]) -> dict[str, float | None]:
    """Path -> value of the settings that a configuration has."""
    present: dict[str, float | None] = {}
    for setting in settings:
        value = config
        for name in setting.path.split("."):
            value = getattr(value, name, _ABSENT)
        if value is not _ABSENT:
            present[setting.path] = value
    return present


def changed(config: Any, settings: tuple[Setting, ...], path: str, value: Any) -> Any:
    """The configuration with one setting changed.

    Args:
        config: a dataclass.
        settings: those that may be changed.
        path: path of the setting.
        value: a number; None if the setting can be automatic.

    Raises:
        ConfigError: there is no such setting, or it can't have that value.
    """
    setting = next((each for each in settings if each.path == path), None)
    if setting is None or path not in values(config, settings):
        raise ConfigError(f"there is no setting {path!r} here")
    automatic = value is None and setting.automatic
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not automatic and not (number and math.isfinite(value)):
        raise ConfigError(f"{path} can't be {value!r}")
    return _replaced(config, path.split("."), value if automatic else float(value))


def _replaced(config: Any, names: list[str], value: float | None) -> Any:
    first, *rest = names
    inner = _replaced(getattr(config, first), rest, value) if rest else value
    return dataclasses.replace(config, **{first: inner})


_ABSENT: Final = object()


class SettingSliders:
    """Sliders in a folder of the panel; those that a configuration lacks are left out.

    Args:
        gui: where to build, within the container that is open.
        title: heading of the folder.
        settings: settings that can be changed.
        change: called with the path and the new value of a setting that a person has changed.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        settings: tuple[Setting, ...],
        change: Callable[[str, float | None], None],
    ) -> None:
        self._gui, self._change = gui, change
        self._settings = {setting.path: setting for setting in settings}
        self._folder = gui.add_folder(title)
        self.sliders: dict[str, Any] = {}
        self._boxes: dict[str, Any] = {}

    def show(self, shown: Mapping[str, float | None]) -> None:
        """Show values; the sliders are built anew if the set of settings has changed."""
        if list(shown) != list(self.sliders):
            for handle in (*self.sliders.values(), *self._boxes.values()):
                handle.remove()
            self.sliders, self._boxes = {}, {}
            with self._folder:
                for path, value in shown.items():
                    self._add(self._settings[path], value)
        for path, value in shown.items():
            if path in self._boxes:
                self._boxes[path].value = value is not None
                self.sliders[path].disabled = value is None
            if value is not None and self.sliders[path].value != value:
                self.sliders[path].value = value

    def _add(self, setting: Setting, value: float | None) -> None:
        path = setting.path
        if setting.automatic:
            box = self._gui.add_checkbox(f"{setting.label}: fixed", value is not None)
            box.on_update(
                from_person(
                    lambda event: self._change(
                        path, self.sliders[path].value if event.target.value else None
                    )
                )
            )
            self._boxes[path] = box
        start = 1.0 if value is None else value
        slider = self._gui.add_slider(
            setting.label, min(setting.low, start), max(setting.high, start), setting.step, start,
            hint=setting.hint, disabled=value is None,
        )  # fmt: skip
        # sliders add up their steps
        slider.on_update(
            from_person(lambda event: self._change(path, float(f"{event.target.value:.6g}")))
        )
        self.sliders[path] = slider
