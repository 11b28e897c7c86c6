"""MediaPipe's hand-landmarker model: fetched once, its hash checked, kept in the user's cache."""

from __future__ import annotations

import hashlib
import http.client
import os
import sys
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeAlias

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import SourceError
from smooth_operator.result_cache.own_files import make_private
from smooth_operator.result_cache.user_cache import user_cache

SWITCH: Final = "SMOOTH_OPERATOR_HAND_MODEL"
"""Environment variable: path of the model file."""

MODEL_URL: Final = (
    "https://storage.googleapis.com/mediapipe-models/hand_landmarker/hand_landmarker/float16/1/"
    "hand_landmarker.task"
)
MODEL_SHA256: Final = "fbc2a30080c3c557093b5ddfc334698132eb341044ccee322ccf8bcf3607cde1"
"""Of version 1 as it is published there, 7,819,105 bytes."""

_LARGEST: Final = 64 * 2**20
_CHUNK: Final = 2**16
_NETWORK: Final = "hand_landmarks_detector.tflite"

Progress: TypeAlias = Callable[[int, int | None], None]
"""Called with the bytes that are here, and those that there are, if that is known."""


def model_cache() -> Path:
    """Where the fetched model is kept; it need not exist."""
    return user_cache() / "models" / "hand_landmarker.task"


def hand_model(
    given: Path | None = None,
    *,
    url: str = MODEL_URL,
    sha256: str = MODEL_SHA256,
    progress: Progress | None = None,
) -> Path:
    """The model file: the one that is given, the one of ``SWITCH``, or the published one.

    A file that is given need only be a hand landmarker; what is fetched must have the hash, and so
    must what lies in the cache, each time. A damaged one there is fetched again.

    Args:
        given: a path that the user named.
        url: where it is fetched from.
        sha256: of the published file.
        progress: called in a download; by default a line on standard error, if that is a terminal.

    Raises:
        SourceError: there is no such file, or it is no hand landmarker; it can't be fetched, or
            what came is not the published file.
        OutputError: it can't be kept.
    """
    named = given or Path(os.environ.get(SWITCH, "").strip())
    if str(named) not in ("", "."):
        return _checked(named.expanduser(), "model" if given else SWITCH)
    kept = model_cache()
    if _sha256_of(kept) != sha256:
        _fetch(url, sha256, kept, progress or _line)
    return kept


def _checked(path: Path, asked: str) -> Path:
    """A file that the user named."""
    if not path.is_file():
        raise SourceError(
            f"{asked}: there is no file {str(path)!r}; give the path of a hand_landmarker.task, or "
            f"leave it out to have it fetched from {MODEL_URL}"
        )
    try:
        with zipfile.ZipFile(path) as archive:
            found = _NETWORK in archive.namelist()
    except (zipfile.BadZipFile, OSError):
        found = False
    if not found:
        raise SourceError(
            f"{asked}: {path} is no MediaPipe hand landmarker, an archive that holds {_NETWORK}; "
            f"fetch it again from {MODEL_URL}"
        )
    return path


def _sha256_of(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _fetch(url: str, sha256: str, target: Path, progress: Progress) -> None:
    """Download a file whole, or leave nothing."""
    try:
        make_private(target.parent)
    except OSError as error:
        raise output_error(target, error) from error
    try:
        response = urllib.request.urlopen(url, timeout=20)
    except (urllib.error.URLError, OSError, http.client.HTTPException) as error:
        raise _unreachable(url, target, error) from error
    with response, atomic_write(target) as file:
        length = response.headers.get("Content-Length", "")
        total = int(length) if length.isdigit() else None
        digest, count = hashlib.sha256(), 0
        while count <= _LARGEST:
            try:
                chunk = response.read(_CHUNK)
            except (OSError, http.client.HTTPException) as error:
                raise _unreachable(url, target, error) from error
            if not chunk:
                break
            file.write(chunk)
            digest.update(chunk)
            count += len(chunk)
            progress(count, total)
        if total is not None and count < total:
            cause = f"the connection ended after {count} of {total} bytes"
            raise _unreachable(url, target, cause)
        if digest.hexdigest() != sha256:
            raise SourceError(
                f"what came from {url} is not the published hand landmarker: SHA-256 "
                f"{digest.hexdigest()}, expected {sha256}. It was thrown away. A proxy may have "
                f"answered in its place; get the file another way and name it with model=PATH, or "
                f"in the environment variable {SWITCH}"
            )


def _unreachable(url: str, target: Path, cause: object) -> SourceError:
    reason = cause.reason if type(cause) is urllib.error.URLError else cause
    return SourceError(
        f"the hand-landmarker model can't be fetched ({reason}). Without a network, get {url} on "
        f"another machine and put it at {target}, or anywhere else and name it: model=PATH, or the "
        f"environment variable {SWITCH}"
    )


def _line(count: int, total: int | None) -> None:
    if not sys.stderr.isatty():
        return
    of = "" if total is None else f" of {total / 2**20:.1f}"
    end = "\n" if count == total else ""
    sys.stderr.write(f"\rfetching the hand-landmarker model: {count / 2**20:.1f}{of} MiB{end}")
    sys.stderr.flush()
