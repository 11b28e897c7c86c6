"""Recognises complete results of an earlier run with the same configuration."""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import claimed as claimed
from smooth_operator.errors import DocumentError, HandModelError, RecordingError
from smooth_operator.formats.commands import config_path, read_commands
from smooth_operator.formats.environment import versions
from smooth_operator.formats.registry import READERS
from smooth_operator.io.documents import read_json
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.planning import PROGRAM, RetargetRequest
from smooth_operator.result_cache import key_digest, outside_code
from smooth_operator.source_digest import code_digest
from smooth_operator.types import Side

SIDES: Final[tuple[Side, Side]] = ("right", "left")
_MOST_BYTES: Final = 64_000_000  # that of a folder of thousands of recordings lists them

_CODE: Final = (
    *("geometry.py", "landmarks.py", "planning.py", "poses.py", "types.py"),
    *("human", "hands", "objective", "solvers", "methods", "baselines", "compilation"),
    *("io", "formats", "episode_files", "headsets", "teleop/recording", "offline"),
)
"""Files and folders of this package that commands depend on."""

_LEFT_OVER: Final = re.compile(r"\..{1,32}\.[0-9a-f]{8}-\d{1,10}\.[0-9a-f]{8}\.tmp", re.DOTALL)
"""Names that ``temporary_beside`` gives, on any machine."""


def read_configuration(path: Path) -> dict[str, Any] | None:
    """A configuration that this program wrote; None if there is none, or the file is another's."""
    try:
        content = read_json(path, most_bytes=_MOST_BYTES)
    except (OSError, ValueError):
        return None
    ours = isinstance(content, dict) and content.get("program") == PROGRAM
    return content if ours else None


def identity(path: Path) -> dict[str, Any]:
    """Identity of a file's content: its size, date and digest.

    Raises:
        RecordingError: it can't be read.
    """
    try:
        check_plain_file(path)  # or a pipe would be waited for
        stat = path.stat()
        return {"bytes": stat.st_size, "modified_ns": stat.st_mtime_ns, "sha256": digest(path)}
    except DocumentError as error:
        raise RecordingError(f"{path}: {error}; give the file of a recording") from error
    except OSError as error:
        raise RecordingError(f"{path}: can't be opened: {error.strerror or error}") from error


def digest(content: bytes | Path) -> str:
    """SHA-256 of some bytes or of a file, in hexadecimal."""
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    with content.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def made_by(request: RetargetRequest, *readers: str) -> str:
    """Digest of the code and the hands that make the commands of a request.

    It covers this package's code from the reader of a file to the commands, the code of plugins for
    methods and readers, the versions of the libraries that compute, and the descriptions and models
    of both robot hands, wherever these stand on a machine.

    Args:
        request: settings of the retargeting.
        readers: more files and folders of this package that the commands depend on, and modules of
            other distributions, as ``module:attribute``.
    """
    own = [name for name in readers if ":" not in name]
    others = [entry.target for entry in READERS.plugins.values()]
    others += [name for name in readers if ":" in name]
    modules = [target.partition(":")[0] for target in others]
    hands = []
    for side in SIDES:
        with contextlib.suppress(HandModelError):  # there is no hand of this side
            spec = request.load_hand(side).spec
            hands.append((replace(spec, model=Path(spec.model.name)), digest(spec.model)))
    code = code_digest(*_CODE, *own)
    return key_digest([code, outside_code(request.config, *modules), versions(), hands])


def finished(
    output: Path, source: Path, request: Mapping[str, Any], made_by: str
) -> dict[str, Any] | None:
    """The configuration of a result that need not be made again.

    It is one if the result is whole to the last byte, and was made by this code and this robot
    hand, as it is asked for now, from a recording that has not changed since. A recording with
    another date but the same content is the same.

    Args:
        output: ``OUT.npz``.
        request: settings of the retargeting, as JSON has them.
        made_by: digest from ``made_by``.

    Returns:
        the configuration, or None if the result is missing or another's.
    """
    config = read_configuration(config_path(output))
    try:
        if config is None or _but_rate(config["request"]) != _but_rate(request):
            return None
        if config["rate"] not in (None, request["rate"]):  # None: it has stamps
            return None
        if config["made_by"] != made_by:
            return None
        recorded, stat = config["source"], source.stat()
        check_plain_file(source)
        if recorded["bytes"] != stat.st_size:
            return None
        if recorded["modified_ns"] != stat.st_mtime_ns and recorded["sha256"] != digest(source):
            return None
        return config if config["commands"]["sha256"] == digest(output) else None
    except (
        KeyError,
        TypeError,
        AttributeError,
        OSError,
        DocumentError,
    ):  # another command's, or a file is missing
        return None


def _but_rate(request: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in request.items() if name != "rate"}


def foreign(output: Path) -> str | None:
    """Reason why a result can't be written: a file of another origin has its name; None if it can.

    Args:
        output: ``OUT.npz``.
    """
    config_file = config_path(output)
    for existing in (output, config_file):
        if existing.exists() and not existing.is_file():
            return f"can't write {str(existing)!r}: it is not a plain file; remove it first"
    if read_configuration(config_file) is not None:
        return None  # and the other file is its result, complete or cut off
    if config_file.exists():
        return f"can't write {str(config_file)!r}: it holds something else; remove it first"
    if output.exists():
        try:
            read_commands(output)
        except RecordingError:
            return (
                f"can't write {str(output)!r}: it holds something other than commands; remove it "
                "first"
            )
    return None


def remove_leftovers(folders: Iterable[Path]) -> int:
    """Deletes the unfinished files that a killed run has left in some folders.

    Returns:
        how many there were.
    """
    count = 0
    for folder in folders:
        with contextlib.suppress(OSError):
            for path in list(folder.iterdir()):
                if _LEFT_OVER.fullmatch(path.name) and path.is_file():
                    path.unlink()
                    count += 1
    return count
