"""A PostgreSQL server of the system's packages, for as long as a test needs it."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def _programs() -> Path | None:
    if (found := shutil.which("initdb")) is not None:
        return Path(found).parent
    return max(Path("/usr/lib/postgresql").glob("*/bin/initdb"), default=Path()).parent or None


def missing() -> str | None:
    """Why there can be no server; None if there can."""
    programs = _programs()
    if programs is None or not (programs / "initdb").is_file():
        return "no PostgreSQL server is installed (Debian: apt-get install postgresql)"
    if os.geteuid() == 0:
        try:
            pwd.getpwnam("postgres")
        except KeyError:
            return "PostgreSQL refuses to run as root, and there is no user postgres"
    return None


@contextmanager
def server() -> Iterator[str]:
    """URL of an empty database, reached through a socket that no other user can open."""
    programs = _programs()
    assert programs is not None
    user = "postgres" if os.geteuid() == 0 else None
    with tempfile.TemporaryDirectory(prefix="pg") as name:
        folder = Path(name)
        if user is not None:
            shutil.chown(folder, user)

        def run(program: str, *arguments: str) -> None:
            subprocess.run(
                [programs / program, *arguments], check=True, capture_output=True, text=True,
                user=user, cwd=folder,
            )  # fmt: skip

        data = folder / "data"
        run("initdb", "-D", str(data), "-A", "trust", "-U", "tester", "--no-locale", "-E", "UTF8",
            "--no-sync")  # fmt: skip
        options = f"-c listen_addresses= -k {folder}"
        log = str(folder / "log")
        run("pg_ctl", "-D", str(data), "-l", log, "-w", "-o", options, "start")
        try:
            yield f"postgresql://tester@/postgres?host={folder}"
        finally:
            run("pg_ctl", "-D", str(data), "-m", "immediate", "-w", "stop")
