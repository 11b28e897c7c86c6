"""Main program of the live page's process, which the loop's process starts."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from pathlib import Path
from typing import Final

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.signals import leave_to_parent
from smooth_operator.teleop.pages.live.live_page import Link, LoopEnded, LoopLink
from smooth_operator.teleop.pages.live.stop_panel import StopPanel
from smooth_operator.teleop.pages.viser_server import name_panel, name_tab, open_server, page_url

_NICE: Final = 5
"""Nice value of the page's process: below the loop's priority, but not starved on a busy
machine."""


def main() -> None:
    """Serves the page until the loop's process closes the pipe."""
    # A library may print, which must not come between the messages.
    outgoing = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    # viser warns about each message to a browser that has just left
    warnings.filterwarnings("ignore", message="Queued a", category=UserWarning)
    leave_to_parent()
    pipe = Link(sys.stdin.buffer, outgoing)
    if (setup := pipe.receive()) is None:
        return
    link = LoopLink(pipe)
    try:
        server = open_server(setup["host"], setup["port"], lambda: link.alive)
        # The rest takes seconds, so a browser gets title and stop first.
        name = Path(setup["hand"]).stem
        name_tab(server, f"{name} live – smooth-operator")
        with server.atomic():
            name_panel(server.gui, name)
            server.gui.main_panel.dock_right()
            stop = StopPanel(server, link.do, attended=setup["attended"], keys=setup["keys"])
        pipe.send({"url": page_url(setup["host"], server)})
        # A person waits for the address, so these slow imports come later.
        from smooth_operator.teleop.pages.live.drawing import LiveDrawing

        drawing = LiveDrawing(server, link, setup, stop)
    except SmoothOperatorError as error:
        pipe.send({"failed": str(error)})
        return
    # Not earlier: nothing moves while the page loads, and a busy machine would load it slowly.
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(_NICE)
    with contextlib.suppress(LoopEnded):
        drawing.run()
    # The system closes the port. viser would wait for its browsers and threads, for seconds on a
    # busy machine, and the run waits for this process.
    os._exit(0)


if __name__ == "__main__":
    main()
