"""A process that compiles a method and keeps its programs, so that the one that asked only loads
them.

Tracing holds the interpreter and compiling takes the processor, so a loop whose own process
compiles sends commands late. The helper runs at a lower priority. It gets its job as a line of JSON
on its standard input, and ends when that is closed: it does not outlive who started it.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Final

import jax

from smooth_operator.compilation.dispatch import dispatch_here
from smooth_operator.compilation.job_text import as_plain, from_plain
from smooth_operator.compilation.kept_program import shaping_settings
from smooth_operator.compilation.program_cache import LOGGER
from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.methods.shared import fingerprint

_CODE: Final = """
import json, sys
job = json.loads(sys.stdin.readline())
sys.path[:] = job["path"]
from smooth_operator.compilation.helper_process import serve
serve(job)
"""
_NICE: Final = 5
"""By how much its priority is lower: the loop's command goes first, and it still gets on where
other processes want the cores."""
_LONGEST_S: Final = 300.0
_POLL_S: Final = 0.05


def compile_in_helper(hand: Hand, config: MethodConfig) -> bool:
    """Has a method's programs compiled and kept by another process, and waits for it.

    It gives up when the main thread ends, so that a process can exit meanwhile.

    Returns:
        whether they are there to be read. If not, the caller compiles them, and whatever is wrong
        with them is said there.
    """
    if not _can_start():
        return False
    try:
        line = json.dumps(_job(hand, config)) + "\n"
    except ConfigError:  # the user's own classes
        return False
    try:
        process = subprocess.Popen([sys.executable, "-c", _CODE], **_pipes())
    except OSError as error:
        LOGGER.info("no process to compile in: %s", error)
        return False
    assert process.stdin is not None
    try:
        with contextlib.suppress(OSError):  # it has ended: its return code says so
            process.stdin.write(line.encode())
            process.stdin.flush()
        return _ended_well(process)
    finally:
        process.kill()
        with contextlib.suppress(OSError):
            process.stdin.close()
        process.wait()


def _ended_well(process: subprocess.Popen[bytes]) -> bool:
    for _ in range(int(_LONGEST_S / _POLL_S)):
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = process.wait(_POLL_S)
            if code:
                LOGGER.info("the process that compiles ended with %s", code)
            return code == 0
        if not threading.main_thread().is_alive():
            return False
    return False


def _job(hand: Hand, config: MethodConfig) -> dict[str, Any]:
    return {
        "path": sys.path,
        "hand": as_plain(hand.spec),
        "fingerprint": fingerprint(hand),
        "config": as_plain(config),
        "settings": {
            name: value
            for name, value in shaping_settings().items()
            if value is None or isinstance(value, (bool, int, float, str))
        },
    }


def _can_start() -> bool:
    """Whether ``sys.executable`` is an interpreter; in a program that embeds one it is not."""
    name = Path(sys.executable or "").name.lower()
    return name.startswith("python") and not getattr(sys, "frozen", False)


def _pipes() -> dict[str, Any]:
    apart: dict[str, Any] = {"start_new_session": True}  # Ctrl-C in a terminal is not for it
    if sys.platform == "win32":
        flags = subprocess.BELOW_NORMAL_PRIORITY_CLASS | subprocess.CREATE_NEW_PROCESS_GROUP
        apart = {"creationflags": flags}
    nothing = subprocess.DEVNULL
    return {"stdin": subprocess.PIPE, "stdout": nothing, "stderr": nothing, **apart}


def serve(job: dict[str, Any]) -> None:
    """Compiles what a job says; in the helper's process."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(_NICE)
    settings: Any = jax.config  # its attributes are made at run time
    mine = shaping_settings()
    for name, value in job["settings"].items():
        if name in mine and mine[name] != value:
            settings.update(name, value)
    # XLA writes an executable that JAX took from a cache of its own without its code
    settings.update("jax_enable_compilation_cache", False)
    hand, config = load_hand_spec(from_plain(job["hand"])), from_plain(job["config"])
    if fingerprint(hand) != job["fingerprint"]:
        sys.exit(3)  # a hand that was changed after it was loaded
    dispatch_here(one_thread=config.one_thread)
    Retargeter(hand, config=config).warm_up()
    os._exit(0)  # nothing is left to be written


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)
