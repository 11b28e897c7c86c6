"""``smooth-operator hardware check``: a dialogue that ends with the table of a real hand."""

from __future__ import annotations

from pathlib import Path

from smooth_operator.cli.hardware import opened
from smooth_operator.cli.hardware_options import Check
from smooth_operator.errors import ConfigError
from smooth_operator.hands.registry import load_hand
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.hardware.actuator_map import (
    ActuatorMap,
    user_tables_folder,
    write_table,
)
from smooth_operator.teleop.hardware.bus_lock import BusLock
from smooth_operator.teleop.hardware.hardware_sink import real_hand
from smooth_operator.teleop.hardware.table_check import HELP, ActuatorMover, TableCheck, blank_table
from smooth_operator.terminal import printable


def check_hardware(options: Check) -> None:
    """Goes through the actuators of a hand, and writes what was found."""
    table: ActuatorMap
    if options.ids is None:
        sink, table, hand = opened(options.device, options.side, options.hand)
    else:
        device = real_hand(build_sink(options.device))
        if device is None or options.hand is None:
            raise ConfigError("--ids is for a real hand without a table; say its model with --hand")
        sink, hand = device, load_hand(options.hand, options.side)
        ids, low, high = _ids(options.ids), *options.ends
        if not low < high:
            raise ConfigError(f"--ends must be the least command, then the greatest, not {low:g}")
        table = blank_table(sink.driver, hand, ids, options.unit, (low, high), sink.limit)
    table.bind(hand)
    output = options.output or user_tables_folder() / f"{sink.driver}_{options.side}.toml"
    lock = BusLock(sink.bus)
    try:
        print(HELP + "\n", flush=True)
        with ActuatorMover(sink.device(table), table) as mover:
            checked = TableCheck(mover, hand, _ask, print).run(table)
    finally:
        lock.release()
    if checked is None:
        print("nothing was confirmed, so no table is written")
        return
    write_table(checked, output, f"Written by smooth-operator hardware check {options.device}")
    print(printable(f"\n{output}"))
    if options.output is not None:
        print(printable(f"use it: teleop --sink {options.device},table={_absolute(output)}"))


def _ask(question: str) -> str:
    try:
        return input(question)
    except EOFError:  # no input: as the answer to end
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


def _absolute(path: Path) -> str:
    return str(path.absolute())
