"""The way to other ROS 2 programs: settings, names of topics, and the protocol of a transport."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias

from smooth_operator.errors import (
    ConfigError,
    RecordingError,
    SinkError,
    SourceError,
)
from smooth_operator.teleop.ros2.messages import M, Message, Time

Network: TypeAlias = Literal["localhost", "subnet"]
"""Who can be heard and hears: programs on this machine, or on the whole network."""

Received: TypeAlias = tuple[str, Message | RecordingError]
"""A topic, and a message that came on it, or why that can't be read."""

LARGEST_DOMAIN: Final = 232
"""Domains above need ports above 65535."""
DEPTH: Final = 10
"""Messages that are kept for a slow subscriber, as ROS 2 does by default."""
MANY: Final = 256
"""Messages that are taken in one go, so that a flood can't keep a source from stopping."""
TF_DEPTH: Final = 100
"""Messages that are kept on ``/tf``."""

_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


class Transport(Protocol):
    """An open way to other ROS 2 programs; for one thread."""

    label: str
    """What it is, and whom it reaches, in a few words."""

    def publisher(self, kind: type[M], topic: str, depth: int = DEPTH) -> Callable[[M], None]:
        """A function that publishes messages: reliable, volatile, the last ``depth`` are kept."""

    def subscribe(self, kind: type[Message], topic: str, depth: int) -> None:
        """Receive the messages of a topic from now on, best effort: from any publisher."""

    def receive(self, timeout: float) -> list[Received]:
        """Wait up to ``timeout`` [s] for messages; all that are here.

        Raises:
            SinkError, SourceError: the library gave up.
        """

    def now(self) -> Time:
        """The time that headers carry."""

    def close(self) -> None:
        """Give everything back."""


@dataclass(frozen=True)
class Endpoint:
    """Settings of a transport.

    Attributes:
        feature: what needs it, for messages of errors: ``the ros2 sink``.
        error: class of its errors.
        domain: ROS domain; None for ``ROS_DOMAIN_ID``, or 0.
        network: whom it reaches; None for what the variables of the environment say.

    Raises:
        ConfigError: a setting is outside its range.
    """

    feature: str
    error: type[SinkError] | type[SourceError]
    domain: int | None = None
    network: Network | None = None

    def __post_init__(self) -> None:
        if self.domain is not None and not 0 <= self.domain <= LARGEST_DOMAIN:
            raise ConfigError(
                f"{self.feature}: domain must be 0 to {LARGEST_DOMAIN}, not {self.domain}"
            )

    def domain_id(self) -> int:
        """The domain.

        Raises:
            ConfigError: ``ROS_DOMAIN_ID`` is no domain.
        """
        if self.domain is not None:
            return self.domain
        text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
        if not (text.isdecimal() and int(text) <= LARGEST_DOMAIN):
            raise ConfigError(f"ROS_DOMAIN_ID must be 0 to {LARGEST_DOMAIN}, not {text!r}")
        return int(text)


def topic_name(template: str, feature: str, **words: str) -> str:
    """A topic from its template.

    Args:
        template: the name, in which ``{word}`` stands for a word.
        feature: what has the setting, for the error.
        words: word -> what it stands for.

    Raises:
        ConfigError: it can't be the name of a topic.
    """
    try:
        topic = template.format(**{k: re.sub(r"\W+|__+", "_", word) for k, word in words.items()})
    except (KeyError, IndexError, ValueError, AttributeError):
        topic = ""
    if not _TOPIC.fullmatch(topic) or "__" in topic:
        raise ConfigError(
            f"{feature}: {template!r} can't be a topic; expected words of letters, digits and _ "
            f"with / between, in which {_listed(words)} may stand"
        )
    return topic


def _listed(words: Collection[str]) -> str:
    return " and ".join(f"{{{word}}}" for word in words)


def describe(error: Exception) -> str:
    """An error of a library in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
