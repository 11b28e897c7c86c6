"""Converts errors and warnings of MuJoCo to messages."""

from __future__ import annotations

import logging
import re
from functools import lru_cache
from pathlib import Path
from typing import Final

import mujoco

from smooth_operator.errors import HandModelError

MUJOCO_ERRORS: Final = (ValueError, RuntimeError, MemoryError, mujoco.FatalError)


def refused(what: str, path: Path, error: Exception) -> HandModelError:
    """Returns the error for a model that MuJoCo can't read or compile, with MuJoCo's reason."""
    reason = re.sub(r"\b(XML )?Error: *", "", " ".join(str(error).split()))
    return HandModelError(
        f"MuJoCo can't {what} {path}: {reason}; correct this in the file, or export the model again"
    )


@lru_cache(maxsize=256)  # a model is compiled up to four times, and warned of once
def _warn(text: str) -> None:
    logging.getLogger("smooth_operator.mujoco").warning(text)


# Without its own listener MuJoCo writes its warnings to a file in the working folder.
if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(_warn)
