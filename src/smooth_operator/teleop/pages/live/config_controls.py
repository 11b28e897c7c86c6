"""Sliders, switches and choices for the fields of a configuration."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import viser

from smooth_operator.teleop.pages.callbacks import asked

_WORDS: Final = {
    "objective.targets": "Targets",
    "objective": "Weights",
    "sampling": "Sampling",
    "polish": "Newton steps",
    "approach": "Newton steps",
    "solver": "Solver",
    "alignment": "Alignment",
    "safety": "Safety",
    "limits": "Limits",
}
"""Part of a configuration -> heading; others are headed by their own names. What is of no part
stands above them."""


class ConfigControls:
    """Controls for a list of fields, in folders by part; rebuilt when the list changes.

    Args:
        gui: where to build, within whatever container is open.
        folder: heading of all of it.
        change: called with the path and the new value of a field that a person has changed.
        expanded: whether the folder is open at first.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        folder: str,
        change: Callable[[str, Any], None],
        expanded: bool = False,
    ) -> None:
        self._gui, self._change = gui, change
        self._folder = gui.add_folder(folder, expand_by_default=expanded)
        self._parts: list[Any] = []
        self._schema: list[tuple[Any, ...]] = []
        self.handles: dict[str, Any] = {}
        self._units: dict[str, Any] = {}

    def show(self, fields: Sequence[Mapping[str, Any]]) -> None:
        """Show values; controls that are there already keep their places."""
        schema = [
            (f["path"], f["kind"], f["low"], f["high"], f["step"], tuple(f["choices"]))
            for f in fields
        ]
        if schema != self._schema:
            self._rebuild(fields)
            self._schema = schema
            return
        for field in fields:
            self._put(field)

    def _rebuild(self, fields: Sequence[Mapping[str, Any]]) -> None:
        for part in self._parts:
            part.remove()
        self._parts, self.handles, self._units = [], {}, {}
        headings: dict[str, list[Mapping[str, Any]]] = {}
        for field in fields:
            headings.setdefault(field["path"].rpartition(".")[0], []).append(field)
        with self._folder:
            for field in headings.pop("", ()):
                self._add(field)
            self._parts += [*self.handles.values(), *self._units.values()]
            for part, members in headings.items():
                folder = self._gui.add_folder(_heading(part), expand_by_default=False)
                self._parts.append(folder)
                with folder:
                    for field in members:
                        self._add(field)

    def _add(self, field: Mapping[str, Any]) -> None:
        path, kind, value = field["path"], field["kind"], field["value"]
        name, hint = path.rpartition(".")[2].replace("_", " "), field["doc"] or None
        handle: Any
        if kind in ("number", "whole"):
            handle = self._slider(name, field, value, hint)
        elif kind == "optional":
            handle = self._optional(name, field, hint)
        elif kind == "switch":
            handle = self._gui.add_checkbox(name, value, hint=hint)
        elif kind == "choice":
            handle = self._gui.add_dropdown(
                name, tuple(field["choices"]), initial_value=value, hint=hint
            )
        else:
            handle = self._gui.add_text(name, str(value), hint=hint, disabled=kind == "shown")
        self.handles[path] = handle
        if kind != "shown":
            handle.on_update(asked(lambda event: self._tell(field, event.target.value)))

    def _slider(
        self, name: str, field: Mapping[str, Any], value: float, hint: Any, off: bool = False
    ) -> Any:
        whole = field["kind"] == "whole"
        low, high = min(field["low"], value), max(field["high"], value)
        numbers = (int(low), int(high), 1, int(value)) if whole else (
            float(low), float(high), float(field["step"]), float(value))  # fmt: skip
        return self._gui.add_slider(
            name, min=numbers[0], max=numbers[1], step=numbers[2], initial_value=numbers[3],
            hint=hint, disabled=off,
        )  # fmt: skip

    def _optional(self, name: str, field: Mapping[str, Any], hint: Any) -> Any:
        """A box that says whether there is a value, and a slider for it."""
        value = field["value"]
        box = self._gui.add_checkbox(f"{name}: fixed", value is not None, hint=hint)
        start = min(max(1.0, field["low"]), field["high"]) if value is None else value
        # made as it is to be: a separate message may reach a new browser before the slider does
        slider = self._slider(name, field, start, hint, off=value is None)

        def toggle(_: Any) -> None:
            slider.disabled = not box.value
            self._change(field["path"], float(slider.value) if box.value else None)

        box.on_update(asked(toggle))
        self._units[field["path"]] = box
        return slider

    def _tell(self, field: Mapping[str, Any], value: Any) -> None:
        if field["kind"] in ("number", "optional"):
            value = float(f"{value:.6g}")  # sliders add up their steps
        self._change(field["path"], value)

    def _put(self, field: Mapping[str, Any]) -> None:
        handle, value = self.handles[field["path"]], field["value"]
        box = self._units.get(field["path"])
        if box is not None:
            box.value = value is not None
            if handle.disabled != (value is None):
                handle.disabled = value is None
            if value is None:
                return
        if field["kind"] in ("path", "numbers", "shown"):
            value = str(value)
        if handle.value != value:
            with contextlib.suppress(ValueError):  # out of the slider's range: a typed-in value
                handle.value = value


def _heading(part: str) -> str:
    """A word or two for a part of a configuration, with a capital."""
    return _WORDS.get(part) or part.rpartition(".")[2].replace("_", " ").capitalize()
