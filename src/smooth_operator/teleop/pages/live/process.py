"""The process of the live page, which the process of the loop starts."""

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
"""The loop goes first; the page still gets its share on a busy machine."""


def main() -> None:
    """Serves the page until the loop's process closes the pipe."""
    # What a library prints must not get between the messages.
    outgoing = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    # viser warns of each message to a browser that has just left, which happens
    warnings.filterwarnings("ignore", message="Queued a", category=UserWarning)
    leave_to_parent()
    pipe = Link(sys.stdin.buffer, outgoing)
    if (setup := pipe.receive()) is None:
        return
    link = LoopLink(pipe)
    try:
        server = open_server(setup["host"], setup["port"], lambda: link.alive)
        # A browser that opens now waits for seconds: it gets title and stop first of all.
        name = Path(setup["hand"]).stem
        name_tab(server, f"{name} live – smooth-operator")
        with server.atomic():
            name_panel(server.gui, name)
            server.gui.main_panel.dock_right()
            stop = StopPanel(server, link.do, attended=setup["attended"])
        pipe.send({"url": page_url(setup["host"], server)})
        # After the address, which a person waits for: this reads the hand and more libraries.
        from smooth_operator.teleop.pages.live.drawing import LiveDrawing

        drawing = LiveDrawing(server, link, setup, stop)
    except SmoothOperatorError as error:
        pipe.send({"failed": str(error)})
        return
    # Not before: while the page loads, nothing moves yet, and a busy machine leaves it little.
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(_NICE)
    with contextlib.suppress(LoopEnded):
        drawing.run()
    # The system closes the port now. viser would wait for its browsers and threads, for
    # seconds on a busy machine, and the run does not end before this process.
    os._exit(0)


if __name__ == "__main__":
    main()
