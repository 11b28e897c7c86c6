"""Opens a page in the local browser without exposing its token in the process list."""

from __future__ import annotations

import atexit
import contextlib
import html
import os
import sys
import tempfile
import threading
import webbrowser
from pathlib import Path
from typing import Final

_FILE_S: Final = 60.0
"""Time for which the file that redirects the browser exists [s]."""


def open_page(url: str) -> None:
    """Opens a page in the browser, if there is a desktop.

    All users of this machine can read a process's arguments, so an address with a token is written
    to a file of this user, which redirects to the page.
    """
    if not has_desktop():
        return
    if "?" not in url:
        webbrowser.open(url)
        return
    with contextlib.suppress(OSError):  # the terminal shows the address as well
        webbrowser.open(leading_to(url).as_uri())


def leading_to(url: str) -> Path:
    """Writes a temporary file that redirects to a page. Only this user can read it, for a
    minute."""
    handle, name = tempfile.mkstemp(prefix="smooth-operator-", suffix=".html")  # mode 0600
    file = Path(name)
    shown = html.escape(url)
    with os.fdopen(handle, "w", encoding="utf-8") as out:
        out.write(
            '<!DOCTYPE html><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
            f'<meta http-equiv="refresh" content="0; url={shown}"><title>smooth-operator</title>'
            f'<a href="{shown}">Open the page</a>\n'
        )

    def remove() -> None:
        atexit.unregister(remove)
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)

    atexit.register(remove)
    timer = threading.Timer(_FILE_S, remove)
    timer.daemon = True
    timer.start()
    return file


def has_desktop() -> bool:
    """True if a browser would open a window."""
    # without a display, webbrowser starts a text browser in the terminal
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
