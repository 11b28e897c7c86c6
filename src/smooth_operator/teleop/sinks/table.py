"""Sink that shows the commands in the terminal: a bar for each joint, mode and latency."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from smooth_operator.console import open_console
from smooth_operator.errors import SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.settings import check_range
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.types import Side

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

_KEPT: Final = 1000
"""Number of ticks from which latency and rate are computed."""
_BAR: Final = 24
_PLAIN_S: Final = 1.0
_COLOURS: Final = {Mode.TRACKING: "green", Mode.BLENDING: "cyan", Mode.STOPPED: "bold red"}


@dataclass(frozen=True)
class TableSink(Sink):
    """Table on standard error, updated a few times a second; plain lines if there is no terminal.

    Attributes:
        rate: how often the table is drawn [Hz].

    Raises:
        ConfigError: the rate is out of its range.
    """

    rate: float = 5.0
    observes: ClassVar[bool] = True

    _thread: _Drawing | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_range("table: rate", self.rate, 0.1, 30.0, "Hz")

    @property
    def label(self) -> str:
        """The word ``table``."""
        return "table"

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Starts drawing; see ``Sink``."""
        if self._thread is not None:
            raise SinkError("table: the sink is already open")
        panels = {side: HandPanel(side, hand) for side, hand in hands.items()}
        self._set(_thread=_Drawing(panels, open_console(stderr=True), self.rate))

    def send(self, tick: Tick) -> None:
        """Stores a tick."""
        if self._thread is None:
            raise SinkError("table: it is not open")
        self._thread.panels[tick.side].see(tick)

    def stalled(self, seconds: float) -> None:
        """Shows a time without commands."""
        if self._thread is not None:
            for panel in self._thread.panels.values():
                panel.silence = seconds

    def close(self) -> None:
        """Draws the table for the last time."""
        drawing = self._thread
        self._set(_thread=None)
        if drawing is not None:
            drawing.end()


class HandPanel:
    """Table of one hand's joints. The loop calls ``see``; the drawing thread calls the other
    methods."""

    def __init__(self, side: Side, hand: Hand) -> None:
        self.title = f"{hand.name} {side}"
        self.silence = 0.0
        self._names = hand.joint_names
        self._limits = hand.joint_limits
        self._tick: Tick | None = None
        self._times: deque[float] = deque(maxlen=_KEPT)
        self._latencies: deque[float] = deque(maxlen=_KEPT)

    def see(self, tick: Tick) -> None:
        """Stores a tick."""
        self._tick, self.silence = tick, 0.0
        self._times.append(tick.time)
        if tick.arrival is not None:
            self._latencies.append((tick.time - tick.arrival.received) * 1e3)

    def line(self) -> str:
        """Mode, rate and latency, on one line."""
        tick = self._tick
        if tick is None:
            return f"{self.title}: no command yet"
        times, latencies = self._times.copy(), self._latencies.copy()  # the loop appends on
        parts = [f"{self.title}: {'stalled' if self.silence else tick.mode.value}"]
        if len(times) > 1 and times[-1] > times[0]:
            parts.append(f"{(len(times) - 1) / (times[-1] - times[0]):.0f} Hz")
        if latencies:
            p50, p99 = np.percentile(latencies, (50, 99))
            parts.append(f"latency p50 {p50:.2f} ms, p99 {p99:.2f} ms")
        if self.silence:
            parts.append(f"no command for {self.silence:.1f} s")
        return ", ".join(parts)

    def table(self) -> RenderableType:
        """Table of the joints and their positions within their limits, for rich to print."""
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        tick = self._tick
        colour = "yellow" if tick is None or self.silence else _COLOURS.get(tick.mode, "yellow")
        table = Table(pad_edge=False)
        table.add_column("joint", no_wrap=True)
        table.add_column("rad", justify="right")
        table.add_column("of its range", no_wrap=True)
        if tick is not None:
            rows = zip(self._names, tick.command.joint_positions, self._limits, strict=True)
            for name, q, (low, high) in rows:
                table.add_row(name, f"{q:+.3f}", _bar(float(q), float(low), float(high)))
        return Group(Text(self.line(), style=colour), table)


class _Drawing:
    """The thread that draws."""

    def __init__(self, panels: Mapping[Side, HandPanel], console: Console, rate: float) -> None:
        self.panels = panels
        self._console = console
        self._period = 1.0 / rate
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="table", daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._ending.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        if not self._console.is_terminal:
            while not self._ending.wait(max(self._period, _PLAIN_S)):
                self._print()
            self._print()
            return
        from rich.live import Live

        with Live(self._picture(), console=self._console, auto_refresh=False) as live:
            while not self._ending.wait(self._period):
                live.update(self._picture(), refresh=True)
            live.update(self._picture(), refresh=True)

    def _print(self) -> None:
        for panel in self.panels.values():
            self._console.print(panel.line(), markup=False, highlight=False, soft_wrap=True)

    def _picture(self) -> RenderableType:
        from rich.columns import Columns

        return Columns([panel.table() for panel in self.panels.values()], padding=(0, 4))


def _bar(value: float, low: float, high: float) -> Text:
    """Bar for a position within its limits, empty at the lower limit."""
    from rich.text import Text

    if not (np.isfinite([value, low, high]).all() and high > low):
        return Text("-")
    filled = round(_BAR * min(max((value - low) / (high - low), 0.0), 1.0))
    bar = Text("█" * filled, style="cyan")
    bar.append("░" * (_BAR - filled), style="dim")
    return bar
