"""Transport of ROS 2 messages over DDS with CycloneDDS's Python binding; needs no ROS 2.

A ROS 2 topic ``/a/b`` is the DDS topic ``rt/a/b``, and the samples are plain CDR (XCDR 1).
"""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from cyclonedds.core import (
    DDSException,
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from smooth_operator.errors import ConfigError, RecordingError, SinkError, SourceError
from smooth_operator.settings import check_range
from smooth_operator_devices.ros2.messages import M, Message, time_of, type_name

Network: TypeAlias = Literal["localhost", "subnet"]
"""Reach of a participant: programs on this machine, or on the whole network."""

Received: TypeAlias = tuple[str, Message | RecordingError]
"""A topic, and a message on it or the error of reading it."""

LARGEST_DOMAIN: Final = 232
"""Largest domain; a larger one would need ports above 65535."""
DEPTH: Final = 10
"""Number of messages that wait for a slow subscriber, as in ROS 2 by default."""
MANY: Final = 256
"""Largest number of messages per call, so that a flood can't keep a source from stopping."""

_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
Reach: TypeAlias = Literal["localhost", "subnet", "own"]
"""``own``: as in the user's settings file for CycloneDDS (``CYCLONEDDS_URI``)."""

_CONFIG: Final = """<CycloneDDS><Domain id="any"><General>{general}</General><Discovery>
<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery><Internal><MaxSampleSize>128 kB
</MaxSampleSize></Internal></Domain></CycloneDDS>"""
# Only the loopback interface: programs find each other by unicast to the first ports of the domain,
# as in ROS 2.
_GENERAL: Final[dict[Reach, str]] = {
    "localhost": '<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>',
    "subnet": "",
}
_WHOM: Final[dict[Reach, str]] = {
    "localhost": "this machine only",
    "subnet": "the whole network",
    "own": "as CYCLONEDDS_URI says",
}


class Transport:
    """A participant of a DDS domain, for one thread.

    Args:
        endpoint: settings.

    Raises:
        SinkError, SourceError: the domain can't be joined.
        ConfigError: a variable of the environment can't be read, or another part of this process
            is in the domain with another network.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        number, reach = endpoint.domain_id(), reach_of(endpoint)
        self._domain = _Domains.join(endpoint, number, reach)
        try:
            self._participant = DomainParticipant(number)
            self._waitset = WaitSet(self._participant)
        except DDSException as error:
            _Domains.leave(number)
            raise endpoint.error(_refused(number, error)) from error
        self._number = number
        self._readers: list[tuple[str, type[Message], DataReader[Any], ReadCondition]] = []
        self._error = endpoint.error
        self.label = f"CycloneDDS, domain {number}, {_WHOM[reach]}"

    def publisher(self, kind: type[M], topic: str) -> Callable[[M], None]:
        """Returns a function that publishes messages (reliable, volatile, with a queue of
        ``DEPTH``)."""
        # It never waits for a slow subscriber: older messages are overwritten.
        qos = _qos(Policy.Reliability.Reliable(duration(milliseconds=100)), DEPTH)
        writer = DataWriter(self._participant, self._topic(kind, topic), qos=qos)
        publish: Callable[[M], None] = writer.write
        return publish

    def subscribe(self, kind: type[Message], topic: str, depth: int) -> None:
        """Receive the messages of a topic from now on, best effort, from any publisher."""
        qos = _qos(Policy.Reliability.BestEffort, depth)
        reader = DataReader(self._participant, self._topic(kind, topic), qos=qos)
        condition = ReadCondition(reader, ViewState.Any | SampleState.Any | InstanceState.Any)
        self._waitset.attach(condition)
        self._readers.append((topic, kind, reader, condition))

    def receive(self, timeout: float) -> list[Received]:
        """Wait up to ``timeout`` [s] for messages, and return all of them.

        Raises:
            SinkError, SourceError: the library failed.
        """
        received: list[Received] = []
        try:
            self._waitset.wait(duration(seconds=timeout))
            for topic, kind, reader, condition in self._readers:
                for _ in range(MANY):
                    messages = _take(reader, condition, kind)
                    if messages is None:
                        break
                    received += [(topic, message) for message in messages]
        except DDSException as error:
            raise self._error(f"DDS domain {self._number}: {describe(error)}") from error
        return received

    def now(self) -> Message:
        """The current ``Time`` for headers, by this machine's clock."""
        return time_of(time.time_ns())

    def close(self) -> None:
        """Close the participant."""
        self._readers.clear()
        del self._waitset, self._participant
        _Domains.leave(self._number)

    def _topic(self, kind: type[Message], topic: str) -> Topic[Any]:
        return Topic(self._participant, f"rt/{topic.lstrip('/')}", kind)


def reach_of(endpoint: Endpoint) -> Reach:
    """Reach of a participant: its setting, else that of the environment, else localhost.

    Raises:
        ConfigError: a variable of ROS 2 has an unknown value.
    """
    if endpoint.network is not None:
        return endpoint.network
    if os.environ.get("CYCLONEDDS_URI"):
        return "own"
    discovery = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    reaches: dict[str, Reach] = {"LOCALHOST": "localhost", "SUBNET": "subnet", "": "localhost"}
    if discovery not in reaches:
        raise ConfigError(
            f"{endpoint.feature}: ROS_AUTOMATIC_DISCOVERY_RANGE must be LOCALHOST or SUBNET, "
            f"not {discovery!r}; or set network=localhost or network=subnet"
        )
    if not discovery and os.environ.get("ROS_LOCALHOST_ONLY") == "0":
        return "subnet"
    return reaches[discovery]


def _take(
    reader: DataReader[Any], condition: ReadCondition, kind: type[Message]
) -> list[Message | RecordingError] | None:
    """The next message of a reader, empty at a publisher's end; None when all are read."""
    try:
        samples = reader.take(1, condition)  # one invalid message would lose all of a batch
    except DDSException:
        raise
    except Exception as error:  # a publisher may send any bytes
        return [RecordingError(f"a message of another type than {type_name(kind)}: {error}")]
    if not samples:
        return None
    return [sample for sample in samples if isinstance(sample, kind)]


def _qos(reliability: Any, depth: int) -> Qos:
    return Qos(
        reliability,
        Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def _refused(number: int, error: Exception) -> str:
    return (
        f"DDS domain {number} can't be joined: {describe(error)}; check that the network "
        "interface named by CYCLONEDDS_URI or by the setting network exists"
    )


class _Domains:
    """Domains of this process; all participants of a domain share its settings."""

    _lock = threading.Lock()
    _joined: dict[int, tuple[Reach, Any, int]] = {}  # noqa: RUF012  (guarded by the lock)

    @classmethod
    def join(cls, endpoint: Endpoint, number: int, reach: Reach) -> None:
        with cls._lock:
            present, domain, users = cls._joined.get(number, (reach, None, 0))
            if present != reach:
                raise ConfigError(
                    f"{endpoint.feature}: DDS domain {number} is already used in this "
                    f"process with network {present!r}; use the same network, or another "
                    "domain"
                )
            if not users and reach != "own":
                try:
                    domain = Domain(number, _CONFIG.format(general=_GENERAL[reach]))
                except DDSException as error:
                    raise endpoint.error(_refused(number, error)) from error
            cls._joined[number] = reach, domain, users + 1

    @classmethod
    def leave(cls, number: int) -> None:
        with cls._lock:
            reach, domain, users = cls._joined.pop(number)
            if users > 1:
                cls._joined[number] = reach, domain, users - 1


@dataclass(frozen=True)
class Endpoint:
    """Settings of a transport.

    Attributes:
        feature: name of the part for errors, such as ``the ros2 sink``.
        error: class of its errors.
        domain: ROS domain; None for ``ROS_DOMAIN_ID``, or 0.
        network: reach of the participant; None for that of the environment's variables.

    Raises:
        ConfigError: a setting is out of its range.
    """

    feature: str
    error: type[SinkError] | type[SourceError]
    domain: int | None = None
    network: Network | None = None

    def __post_init__(self) -> None:
        check_range(f"{self.feature}: domain", self.domain, 0, LARGEST_DOMAIN)

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
    """Makes the name of a topic from its template.

    Args:
        template: the name, with ``{word}`` for a word.
        feature: owner of the setting, for the error.
        words: word -> its text.

    Raises:
        ConfigError: the result is not a valid name of a topic.
    """
    try:
        topic = template.format(**{k: re.sub(r"\W+|__+", "_", word) for k, word in words.items()})
    except (KeyError, IndexError, ValueError, AttributeError):
        topic = ""
    if not _TOPIC.fullmatch(topic) or "__" in topic:
        placeholders = " and ".join(f"{{{word}}}" for word in words)
        raise ConfigError(
            f"{feature}: {template!r} can't be a topic name; expected words of letters, "
            f"digits and _ separated by /; the placeholders {placeholders} are allowed"
        )
    return topic


def describe(error: Exception) -> str:
    """Describes an error of a library in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
