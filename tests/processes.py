"""Python in a process of its own."""

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from live_time import PATIENCE_S


def python(
    *arguments: object,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    check: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Runs Python to its end: exit status and what was printed.

    Args:
        arguments: of Python.
        cwd: working folder.
        env: all variables of its environment; this process's by default.
        check: whether it must succeed.
    """
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=env,
        capture_output=True,
        encoding="utf-8",
        timeout=10 * PATIENCE_S,
        check=False,
    )
    assert not check or done.returncode == 0, done.stderr
    return done
