"""``smooth-operator teleop``: the options into a call of ``teleoperate``."""

from __future__ import annotations

import json

from smooth_operator.cli.console import Progressing
from smooth_operator.cli.teleop_options import Teleop
from smooth_operator.errors import ConfigError
from smooth_operator.teleop.run import teleoperate
from smooth_operator.teleop.run_page import PageSettings


def teleop(options: Teleop) -> None:
    """Runs a teleoperation, with keys in the terminal and what happens on standard error.

    Raises:
        SmoothOperatorError: something can't be opened; nothing has moved then.
        SystemExit: 1, a sink failed on the way.
        KeyboardInterrupt: a signal; everything is closed and what it came to is printed.
    """
    if options.no_view and options.model is not None:
        raise ConfigError(
            "--model says what the page draws, and --no-view leaves the page out; leave out one"
        )
    page = PageSettings(
        options.host,
        options.port,
        open_browser=not options.no_browser,
        model=options.model,
        meshes=not options.no_meshes,
    )
    summary = teleoperate(
        options.source,
        options.sink,
        hand=options.hand,
        side=options.side,
        method=options.method,
        preset=options.preset,
        seed=options.seed,
        scale=options.scale,
        fingers=options.fingers,
        operator=options.operator,
        rate=options.rate,
        duration=options.duration,
        safety=options.safety,
        limits=options.limits,
        wrist=options.wrist,
        priority=options.priority,
        methods=options.methods,
        control=options.control,
        estop=options.estop,
        page=None if options.no_view else page,
        blind=options.blind,
        task=options.task,
        trials=options.trials,
        arm=options.arm,
        keys=True,
        reporter=Progressing(options.quiet),
    )
    if options.json:
        print(json.dumps(summary))
    if summary["interrupted"]:
        raise KeyboardInterrupt
    if any(sink["failed"] for sink in summary["sinks"]):
        raise SystemExit(1)
