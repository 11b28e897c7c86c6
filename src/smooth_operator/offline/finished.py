"""Recognises complete results of an earlier run with the same configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smooth_operator.errors import DocumentError, RecordingError
from smooth_operator.formats.commands import config_path, read_commands
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.planning import read_configuration
from smooth_operator.result_cache import content_digest


def identity(path: Path) -> dict[str, Any]:
    """Identity of a file's content: its size, date and digest.

    Raises:
        RecordingError: it can't be read.
    """
    try:
        check_plain_file(path)  # or a pipe would be waited for
        stat = path.stat()
        return {
            "bytes": stat.st_size,
            "modified_ns": stat.st_mtime_ns,
            "sha256": content_digest(path),
        }
    except DocumentError as error:
        raise RecordingError(f"{path}: {error}; give the file of a recording") from error
    except OSError as error:
        raise RecordingError(f"{path}: can't be opened: {error.strerror or error}") from error


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
        made_by: digest from ``code_of_commands``.

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
        if recorded["modified_ns"] != stat.st_mtime_ns and recorded["sha256"] != content_digest(
            source
        ):
            return None
        return config if config["commands"]["sha256"] == content_digest(output) else None
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
