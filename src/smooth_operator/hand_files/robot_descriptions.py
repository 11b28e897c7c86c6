"""Finds models of the package ``robot_descriptions``, which downloads them from their makers.

The package is optional (https://github.com/robot-descriptions/robot_descriptions.py). It clones a
repository on the first request, into its own cache; its environment variable
``ROBOT_DESCRIPTIONS_CACHE`` names another folder.
"""

from __future__ import annotations

import contextlib
import importlib
import pkgutil
import sys
from pathlib import Path
from typing import Final

from smooth_operator.errors import ConfigError, HandModelError, UnknownNameError

PREFIX: Final = "robot_descriptions:"
"""Prefix of a description's name that is given instead of a model file."""
_SUFFIX: Final = "_description"


def description_file(name: str) -> Path:
    """Model file that ``robot_descriptions`` has under a name, downloaded if necessary.

    Args:
        name: name of the description, such as ``panda_mj``, with or without ``_description``.

    Returns:
        its MJCF file, or its URDF file if it has no MJCF.

    Raises:
        ConfigError: the package is not installed.
        UnknownNameError: the package has no description of that name.
        HandModelError: it can't be downloaded, or it has neither MJCF nor URDF.
    """
    try:
        package = importlib.import_module("robot_descriptions")
    except ImportError as error:
        raise ConfigError(
            f"{PREFIX}{name} needs the package robot_descriptions: "
            "python -m pip install robot_descriptions"
        ) from error
    modules = {found.name for found in pkgutil.iter_modules(package.__path__)}
    names = {found.removesuffix(_SUFFIX) for found in modules if found.endswith(_SUFFIX)}
    name = name.removesuffix(_SUFFIX)
    if name not in names:
        raise UnknownNameError("description of robot_descriptions", name, names)
    try:
        with contextlib.redirect_stdout(sys.stderr):  # the package reports its download there
            module = importlib.import_module(f"robot_descriptions.{name}{_SUFFIX}")
    except Exception as error:  # whatever git or the network raise
        raise HandModelError(
            f"robot_descriptions can't download {name!r}: {' '.join(str(error).split())[:300]}. "
            "Try again with a network connection, or name a model file"
        ) from error
    file = getattr(module, "MJCF_PATH", None) or getattr(module, "URDF_PATH", None)
    if file is None:
        raise HandModelError(
            f"the description {name!r} has neither an MJCF nor a URDF file; name another one"
        )
    return Path(file)
