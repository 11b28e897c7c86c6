"""Digests of the code on which stored clips and the files of a data set depend.

Both have the code of the readers in common, which belong to this package or to plugins. The code of
the pipeline itself counts only where the result depends on it, so a change of the report does not
retarget all clips again.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

from smooth_operator.errors import HandModelError
from smooth_operator.formats.environment import versions
from smooth_operator.formats.registry import READERS
from smooth_operator.planning import CODE_OF_COMMANDS, RetargetRequest, content_of
from smooth_operator.result_cache import key_digest, outside_code
from smooth_operator.source_digest import code_digest
from smooth_operator.types import Side

HOME: Final = Path(__file__).resolve().parents[1]
"""Folder of the package ``smooth_hand_datasets``."""

_CODE_OF_CLIPS: Final = tuple(
    f"pipeline/{name}" for name in ("clip.py", "quality.py", "retargeting.py", "store.py")
)
"""Files of this package that a retargeted clip depends on, in addition to its readers."""

_CODE_OF_FILES: Final = (
    *(f"pipeline/{name}" for name in ("clip.py", "quality.py", "writers", "writing.py")),
    *("flashdex.py", "keypoints.py", "spider.py"),
)
"""Files and folders of this package that the files of a data set depend on, in addition to its
clips."""

_NO_READERS: Final = frozenset(("pipeline", "commands", "__pycache__", "py.typed"))


def code_of_clips(request: RetargetRequest) -> str:
    """Digest of the code and of the hands on which the retargeted clips of a request depend.

    It covers the code from the reader of a file to the commands and the quality tracks, in this
    package, in ``smooth_operator`` and in plugins for methods and readers; the versions of the
    numerical libraries; and the descriptions and models of both robot hands, but not their paths.
    """
    hands = []
    sides: tuple[Side, Side] = ("right", "left")
    for side in sides:
        with suppress(HandModelError):  # there is no hand of this side
            hands.append(content_of(request.load_hand(side).spec))
    readers = sorted(path.name for path in HOME.iterdir() if path.name not in _NO_READERS)
    own = code_digest(*readers, *_CODE_OF_CLIPS, home=HOME)
    modules = filter(_other, (_module(entry.target) for entry in READERS.plugins.values()))
    plugins = outside_code(request.config, *modules)
    return key_digest([code_digest(*CODE_OF_COMMANDS), own, plugins, versions(), hands])


def code_of_files(writer: str) -> list[str]:
    """Digests of the code that writes a data set.

    Args:
        writer: ``package.module:attribute`` of the format.
    """
    own = code_digest(*_CODE_OF_FILES, home=HOME)
    plugin = outside_code(*filter(_other, [_module(writer)]))
    return [own, code_digest("episode_files", "formats"), *plugin]


def _module(target: str) -> str:
    return target.partition(":")[0]


def _other(module: str) -> bool:
    """True for a module that does not belong to this package."""
    return module.partition(".")[0] != HOME.name
