"""The result of retargeting a recording: ``OUT.npz`` and its configuration, ``OUT.json``."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import OutputError, RecordingError, brief
from smooth_operator.extras import UPGRADE
from smooth_operator.formats.arrays import open_arrays
from smooth_operator.formats.episode import check_command_shapes, check_commands
from smooth_operator.formats.registry import file_kind
from smooth_operator.io.jsonable import to_json
from smooth_operator.types import CommandTrajectory, Status

_HANDS = ("landmarks", "joints", "data")
STATUS_NAMES: Final = tuple(
    {int(status): status.name for status in Status}.get(code, "") for code in range(max(Status) + 1)
)
"""Name of each code of ``Status`` at its index. Files contain these names to explain their codes.
"""

_KEYS = ("joint_positions", "joint_names", "timestamps", "latency_ms", "status")


def config_path(path: str | os.PathLike[str]) -> Path:
    """Path of the configuration of a result: ``OUT.json`` for ``OUT.npz``."""
    return Path(path).with_suffix(".json")


def write_commands(
    path: str | os.PathLike[str], commands: CommandTrajectory, config: Mapping[str, Any]
) -> None:
    """Writes a trajectory of commands and the resolved configuration from which it was computed.

    ``OUT.npz`` holds ``joint_positions`` (T, n) float64 [rad], ``joint_names`` (n,) text,
    ``timestamps`` (T,) float64 [s], ``latency_ms`` (T,) float64, ``status`` (T,) int8 codes of
    ``Status``, and ``status_names``, the name of code i at index i. Files are written atomically.
    The configuration is written first, so a result always has its configuration.

    Args:
        path: ``OUT.npz``; its folder must exist; an existing file is replaced.
        commands: commands to write.
        config: the configuration to write with it; see ``to_json``.

    Raises:
        OutputError: the name does not end in ``.npz``, or the files can't be written.
        RecordingError: the arrays of the trajectory do not match.
        ConfigError: the configuration contains a value that JSON can't represent.
    """
    write_encoded_commands(path, encode_commands(commands), config)


def encode_commands(commands: CommandTrajectory) -> bytes:
    """Encodes ``OUT.npz`` as bytes. Equal commands give equal bytes at any time and on any machine.
    Raises RecordingError if the arrays of the trajectory do not match."""
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **command_arrays(commands))  # members without a date
    return stream.getvalue()


def command_arrays(commands: CommandTrajectory) -> dict[str, np.ndarray]:
    """Returns the arrays of ``OUT.npz`` by name; RecordingError if the arrays of the trajectory do
    not match."""
    arrays = {
        "joint_positions": np.asarray(commands.joint_positions, np.float64),
        "joint_names": np.asarray(commands.joint_names, np.str_),
        "timestamps": np.asarray(commands.stamps, np.float64),
        "latency_ms": np.asarray(commands.latency_ms, np.float64),
        "status": np.asarray(commands.status),
    }
    check_command_shapes({name: array.shape for name, array in arrays.items()}, "the commands")
    arrays["status"] = translate_status(arrays["status"], None, "the commands")
    return {**arrays, "status_names": np.array(STATUS_NAMES)}


def write_encoded_commands(
    path: str | os.PathLike[str], encoded: bytes, config: Mapping[str, Any]
) -> None:
    """Writes the bytes from ``encode_commands`` in the same way as ``write_commands``.

    For callers that store a digest of one file in the other.

    Raises:
        OutputError: the name does not end in ``.npz``, or the files can't be written.
        ConfigError: the configuration contains a value that JSON can't represent.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise OutputError(
            f"can't write {str(path)!r}: the name must end in .npz, for example {path.name}.npz"
        )
    with written_result(path, config) as file:
        file.write(encoded)


@contextlib.contextmanager
def written_result(path: Path, config: Mapping[str, Any] | None) -> Iterator[IO[bytes]]:
    """Writes ``OUT.npz`` and, if given, its configuration. Writes both files or neither.

    The result is written to the disk before the configuration is moved to its place, and is itself
    moved after the configuration. Therefore a full disk leaves the earlier files unchanged, and a
    result always has its configuration.

    Yields:
        The file to which the result must be written.

    Raises:
        OutputError: the files can't be written.
        ConfigError: the configuration contains a value that JSON can't represent.
    """
    text = None if config is None else to_json(dict(config), indent=2)
    with atomic_write(path) as file:
        yield file
        if text is not None:
            try:
                file.flush()
                os.fsync(file.fileno())
            except OSError as error:
                raise output_error(path, error) from error
            with atomic_write(config_path(path)) as config_file:
                config_file.write(text.encode() + b"\n")


def read_commands(path: str | os.PathLike[str]) -> CommandTrajectory:
    """Reads what ``write_commands`` wrote.

    Args:
        path: ``OUT.npz``.

    Returns:
        The trajectory.

    Raises:
        RecordingError: the file does not exist, is damaged or contains pickles; arrays are missing
            or do not match; stamps are not finite; a joint name occurs twice; or this version does
            not know a status.
    """
    path = Path(path)
    if file_kind(path) != "npz":
        raise RecordingError(
            f"{path}: not a file of commands; expected the OUT.npz that retarget writes"
        )
    arrays = open_arrays(path)
    missing = [key for key in _KEYS if key not in arrays]
    if missing:
        raise RecordingError(
            f"{path}: not a file of commands: it lacks {', '.join(missing)} (it contains "
            f"{arrays.describe()}); expected the OUT.npz that retarget writes"
        )
    check_command_shapes({key: arrays[key].shape for key in _KEYS}, str(path))
    commands = CommandTrajectory(
        joint_positions=arrays["joint_positions"].numbers(),
        joint_names=tuple(arrays["joint_names"].texts()),
        stamps=arrays["timestamps"].numbers(),
        latency_ms=arrays["latency_ms"].numbers(),
        status=translate_status(
            arrays["status"].load(),
            arrays["status_names"].texts() if "status_names" in arrays else None,
            str(path),
        ),
    )
    check_commands(commands, str(path))
    return commands


def only_commands(path: Path) -> bool:
    """True if a file contains commands but no hand; False if it can't be read."""
    try:
        if file_kind(path) not in ("npy", "npz"):
            return False
        arrays = open_arrays(path)
    except (RecordingError, OSError):
        return False
    return all(name in arrays for name in _KEYS[:2]) and not any(n in arrays for n in _HANDS)


def translate_status(codes: np.ndarray, names: list[str] | None, where: str) -> np.ndarray:
    """Converts status codes to those of this version, by name if the file has names. Raises
    RecordingError if the codes are not whole numbers, or if this version does not know one of them.
    """
    if codes.dtype.kind not in "iu":
        raise RecordingError(f"{where}: status must hold whole numbers, not {codes.dtype}")
    own = {status.name: int(status) for status in Status}
    table = {code: code for code in own.values()}
    if names is not None:
        table = {code: own[name] for code, name in enumerate(names) if name in own}
    unknown = sorted(set(codes.tolist()) - table.keys())
    if unknown:
        raise RecordingError(
            f"{where}: status {brief(unknown)} is not one of {own}; if a newer version wrote it, "
            f"upgrade: {UPGRADE}"
        )
    return np.array([table[code] for code in codes.tolist()], np.int8)
