"""``smooth-operator hardware``: lists drivers, checks a hand and writes its table, or monitors a
hand."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from rich.live import Live
from rich.table import Table
from rich.text import Text

from smooth_operator.cli.console import output_console, plain_table
from smooth_operator.errors import ConfigError, SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.io.jsonable import numbers
from smooth_operator.teleop.components import SINKS, build_sink
from smooth_operator.teleop.sinks.tick import HandState
from smooth_operator.terminal import printable
from smooth_operator.types import Side
from smooth_operator_devices.commands.hardware_options import Check, List, Monitor
from smooth_operator_devices.hands.actuator_map import (
    ActuatorMap,
    BoundMap,
    list_tables,
    read_table,
    user_tables_folder,
    write_table,
)
from smooth_operator_devices.hands.bus_lock import BusLock, serial_ports
from smooth_operator_devices.hands.hardware_sink import HardwareSink
from smooth_operator_devices.hands.table_check import HELP, ActuatorMover, TableCheck, blank_table

_REDRAW_S: Final = 0.2

_TRIED: Final = (
    "each driver was tested with a simulator or with the maker's package; no driver has moved a "
    "physical hand yet"
)


def list_hardware(options: List) -> None:
    """Prints drivers, tables and serial ports."""
    drivers = {}
    for name, entry in SINKS.items():
        try:
            kind = entry.load()
        except SmoothOperatorError:
            continue  # A plugin may be broken, or need an extra to be loaded.
        if isinstance(kind, type) and issubclass(kind, HardwareSink):
            drivers[name] = entry.summary
    tables, broken = [], []
    for path in list_tables():
        try:
            tables.append((path, read_table(path)))
        except ConfigError as error:
            broken.append(str(error))
    ports, folder = serial_ports(), user_tables_folder()
    if options.json:
        listing: dict[str, Any] = {
            "drivers": drivers,
            "tried": _TRIED,
            "tables": {
                path.name.removesuffix(".toml"): {
                    "file": str(path),
                    "driver": table.driver,
                    "hand": table.hand,
                    "side": table.side,
                    "actuators": len(table.actuators),
                    "unit": table.unit,
                }
                for path, table in tables
            },
            "unreadable": broken,
            "ports": ports,
            "folder": str(folder),
        }
        print(json.dumps(listing))
        return
    console = output_console()
    console.print(_rows(("driver", "hand"), list(drivers.items())))
    console.print(f"{_TRIED}\n", markup=False, soft_wrap=True)
    rows = [
        (
            path.name.removesuffix(".toml"),
            t.driver,
            f"{t.hand} {t.side}",
            f"{len(t.actuators)}",
            t.unit,
            "yours" if path.is_relative_to(folder) else "",
        )
        for path, t in tables
    ]
    console.print(_rows(("table", "driver", "hand", "actuators", "unit", ""), rows))
    for line in [
        *broken,
        f"tables of your own: {folder}",
        "serial ports: " + (", ".join(f"{p} ({d})" for p, d in ports.items()) or "none"),
    ]:
        console.print(line, markup=False, soft_wrap=True)


def monitor_hardware(options: Monitor) -> None:
    """Shows the state of a hand until the time is over or the user presses Ctrl-C."""
    sink, _, hand = opened(options.device, options.side, options.hand)
    try:
        sink.open({options.side: hand}, {})
        end = None if options.seconds is None else time.monotonic() + options.seconds
        if options.json:
            _print_lines(sink, options.side, end)
        else:
            with Live(console=output_console(), auto_refresh=False) as live:
                while end is None or time.monotonic() < end:
                    live.update(_picture(sink, sink.state(options.side)), refresh=True)
                    time.sleep(_REDRAW_S)
    finally:
        sink.close()


def opened(device: str, side: Side, hand: str | None) -> tuple[HardwareSink, ActuatorMap, Hand]:
    """Returns the sink of a real hand, which is not open yet, with its table and its model.

    Raises:
        ConfigError: the device is not a real hand, or its table can't be used.
        SmoothOperatorError: there is no such sink, hand or setting.
    """
    sink = build_sink(device)
    if not isinstance(sink, HardwareSink):
        raise ConfigError(
            f"{device!r} is not a real hand; smooth-operator hardware list lists the drivers"
        )
    table = sink.actuators(side, hand or "")
    return sink, table, with_wrist_joints(load_hand(hand or table.hand, side))


def _print_lines(sink: HardwareSink, side: Side, end: float | None) -> None:
    shown: HandState | None = None
    while end is None or time.monotonic() < end:
        state = sink.state(side)
        if state is None or state is shown:
            time.sleep(0.002)
            continue
        shown = state
        message: dict[str, Any] = {
            "time": state.stamp,
            "joints": dict(zip(state.names, numbers(state.positions), strict=True)),
            "note": sink.note,
        }
        for name in ("currents", "temperatures", "touch"):
            values = getattr(state, name)
            if values is not None:
                message[name] = numbers(values)
        if (reading := sink.reading) is not None and reading.pads:
            message["pads"] = {name: numbers(cells) for name, cells in reading.pads.items()}
        print(json.dumps(message), flush=True)


def _picture(sink: HardwareSink, state: HandState | None) -> Table:
    table = plain_table(title=Text(f"{sink.label}: {sink.note or 'ready'}"))
    for header in ("joint", "measured [rad]", "[°]"):
        table.add_column(header, justify="left" if header == "joint" else "right")
    for header in ("actuator", "current", "°C"):
        table.add_column(header, justify="left" if header == "actuator" else "right")
    if state is None:
        return table
    joints = [(n, q) for n, q in zip(state.names, state.positions, strict=True) if np.isfinite(q)]
    for row in range(max(len(joints), len(state.actuators))):
        cells = ["", "", ""]
        if row < len(joints):
            name, q = joints[row]
            cells = [name, f"{q:+.3f}", f"{np.rad2deg(q):+.1f}"]
        more = ["", "", ""]
        if row < len(state.actuators):
            currents, hot = state.currents, state.temperatures
            more = [
                state.actuators[row],
                "" if currents is None else f"{currents[row]:.0f}",
                "" if hot is None else f"{hot[row]:.0f}",
            ]
        table.add_row(*(Text(cell) for cell in (*cells, *more)))
    return table


def _rows(headers: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Table:
    return plain_table(None, headers, (map(Text, row) for row in rows), no_wrap=True)


def check_hardware(options: Check) -> None:
    """Moves the actuators of a hand one by one, and writes its table."""
    if options.ids is None:
        sink, table, hand = opened(options.device, options.side, options.hand)
    else:
        device = build_sink(options.device)
        if not isinstance(device, HardwareSink) or options.hand is None:
            raise ConfigError(
                "--ids is for a real hand that has no table yet; choose its model with --hand"
            )
        sink, hand = device, with_wrist_joints(load_hand(options.hand, options.side))
        ids, low, high = _ids(options.ids), *options.ends
        if not low < high:
            raise ConfigError(
                f"--ends must be the minimum command and the maximum, not {low:g} and {high:g}"
            )
        table = blank_table(sink.driver, hand, ids, options.unit, (low, high), sink.limit)
    BoundMap(table, hand)
    output = options.output or user_tables_folder() / f"{sink.driver}_{options.side}.toml"
    lock = BusLock(sink.bus)
    try:
        print(HELP + "\n", flush=True)
        with ActuatorMover(sink.device(table), table) as mover:
            checked = TableCheck(mover, hand, _ask, print).run(table)
    finally:
        lock.release()
    if checked is None:
        print("no actuator was measured or confirmed, so no table was written")
        return
    write_table(checked, output, f"Written by smooth-operator hardware check {options.device}")
    print(printable(f"\n{output}"))
    if options.output is not None:
        sink_text = f"{options.device},table={output.absolute()}"
        print(printable(f"use this table with: teleop --sink {sink_text}"))


def _ask(question: str) -> str:
    try:
        return input(question)
    except EOFError:  # the end of the input counts as the answer to quit
        return "q"


def _ids(text: str) -> list[int]:
    try:
        ids: list[int] = []
        for part in text.split(","):
            first, _, last = part.partition("-")
            ids += range(int(first), int(last or first) + 1)
    except ValueError:
        ids = []
    if not 0 < len(ids) <= 100:
        raise ConfigError(f"--ids must be numbers such as 1-12 or 0,3,5, not {text!r}")
    return ids
