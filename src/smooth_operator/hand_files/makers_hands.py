"""Hands whose models are not included here, but are in the repositories of their makers.

This project does not carry these models. ``MAKERS_HANDS`` names repository, commit, file and digest
of each; the user clones the repository. Nothing here uses the network.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smooth_operator.errors import ConfigError
from smooth_operator.hands.registry import MAKERS_HANDS
from smooth_operator.types import Side


@dataclass(frozen=True)
class MakersHand:
    """One side of a hand whose model is in its maker's repository.

    Attributes:
        name: name of the hand.
        side: the side.
        maker: author of the model: the maker of the hand, or a user.
        repository: address of the author's repository.
        commit: commit at which the model was checked.
        file: path of the model file in the repository.
        sha256: digest of the model file that was checked, with LF line ends.
        options: options of ``hands add`` that the model needs.
    """

    name: str
    side: Side
    maker: str
    repository: str
    commit: str
    file: str
    sha256: str
    options: Mapping[str, Any]

    @property
    def steps(self) -> str:
        """Commands that add the hand, one per line."""
        folder = self.repository.rpartition("/")[2]
        side = "" if self.side == "right" else f" --side {self.side}"
        return (
            f"\n  git clone {self.repository}\n  git -C {folder} checkout {self.commit}"
            f"\n  smooth-operator hands add {self.name} --from {folder}{side}"
        )

    def find(self, clone: Path | None) -> Path:
        """Finds the model file in a clone of the repository.

        Raises:
            ConfigError: there is no clone, or it has no such file; with the commands to type.
        """
        if clone is None:
            raise ConfigError(
                f"the model of {self.name} is in the repository of its maker, {self.maker}, and "
                f"this program does not download it. Type:{self.steps}"
            )
        file = clone / self.file
        if not file.is_file():
            raise ConfigError(
                f"there is no {self.file} in {clone}; expected a clone of the maker's "
                f"repository:{self.steps}"
            )
        return file

    def was_checked(self, file: Path) -> bool:
        """True if a file has the same content as the model that was checked."""
        text = file.read_bytes().replace(b"\r\n", b"\n")
        return hashlib.sha256(text).hexdigest() == self.sha256


def makers_hand(name: str, side: Side) -> MakersHand:
    """Returns one side of a hand in ``MAKERS_HANDS``; ConfigError if its maker has no model of that
    side."""
    entry = MAKERS_HANDS[name]
    if side not in entry:
        raise ConfigError(f"the maker of {name} has published no model of the {side} hand")
    about = {key: entry[key] for key in ("maker", "repository", "commit")}
    own = dict(entry[side])
    return MakersHand(
        name,
        side,
        **about,
        file=own.pop("file"),
        sha256=own.pop("sha256"),
        options=entry.get("options", {}) | own,
    )
