"""Simulator of a MANUS glove and its bridge, for tests and benchmarks (extra ``zmq``).

As a program: ``python tests/glove_simulator.py --address tcp://127.0.0.1:8000 --drop 0.1``.
"""

from __future__ import annotations

import functools
import math
import random
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Final

import numpy as np
import tyro

from smooth_operator.errors import ConfigError, SourceError
from smooth_operator.formats.readers import read_recording
from smooth_operator.landmarks import FROM_MANUS_25, METACARPALS_MANUS_25
from smooth_operator.synthetic.operator import SyntheticOperator
from smooth_operator.synthetic.tracker import TrackerModel, check_range, check_seed
from smooth_operator.teleop.sources.inboxes import load_zmq
from smooth_operator.teleop.sources.live import Clock, on_time
from smooth_operator.teleop.sources.manus_gloves import NODES
from smooth_operator.teleop.sources.stream import Hands, sides_of
from smooth_operator.types import HandFrame, HandRecording, Side

ROUND_S: Final = 20.0
"""How long the built-in operator's motion is; it is played there and back [s]."""
LATE_S: Final = 0.002
"""Messages later than this are counted [s]."""

_DEFAULT_RATE_HZ = 100.0
_GLOVES: Final[dict[Side, int]] = {"right": 1001, "left": 1002}
_OTHER: Final[dict[Side, Side]] = {"right": "left", "left": "right"}
_FINGER: Final = (slice(1, 5), slice(5, 9), slice(9, 13), slice(13, 17), slice(17, 21))
_QUEUE = 64  # of a subscriber that does not read; what is more is not sent to it


_SHARES: Final = ("drop", "missing", "duplicate", "reorder", "swap", "garbage")


def write_manus(frame: HandFrame) -> bytes:
    """The nodes of a hand as JSON, without what is around them.

    Metacarpal bases have no orientation here, and what is missing is null.

    Returns:
        a list of 25 ``{"id", "pos", "quat"}``.
    """
    positions = np.full((NODES, 3), np.nan)
    positions[list(FROM_MANUS_25)] = frame.landmarks
    if frame.metacarpals is not None:
        positions[list(METACARPALS_MANUS_25)] = frame.metacarpals
    quaternions = np.full((NODES, 4), np.nan)
    if frame.orientations is not None:
        quaternions[list(FROM_MANUS_25)] = frame.orientations
    present = np.isfinite(positions).all(axis=1), np.isfinite(quaternions).all(axis=1)
    numbers = np.hstack([positions, quaternions])[np.repeat(np.stack(present, 1), (3, 4), axis=1)]
    return (
        _template(*(tuple(flags.tolist()) for flags in present)) % tuple(numbers.tolist())
    ).encode()


@functools.lru_cache(maxsize=64)
def _template(placed: tuple[bool, ...], turned: tuple[bool, ...]) -> str:
    """The text of a hand with these positions and quaternions, to be filled with the numbers.

    Numbers go to the micrometre; the gloves' own, float32, are no finer.
    """
    nodes = (
        f'{{"id":{i},"pos":{"[%.6f,%.6f,%.6f]" if p else "null"},'
        f'"quat":{"[%.6f,%.6f,%.6f,%.6f]" if q else "null"}}}'
        for i, (p, q) in enumerate(zip(placed, turned, strict=True))
    )
    return f"[{','.join(nodes)}]"


@dataclass(frozen=True)
class GloveFaults:
    """Faults of a glove or its bridge; none by default. Shares are of the ticks, drawn at random.

    Attributes:
        drop: share of ticks whose messages are never sent.
        silence_every: every so often the glove falls silent [s]; 0 is never.
        silence: for so long [s].
        missing: share of ticks with missing nodes: a finger, or the whole hand, by turns.
        duplicate: share of ticks that repeat the stamp of the one before.
        reorder: share of ticks whose messages are sent after those of the next tick.
        swap: share of ticks with the hands' sides exchanged.
        garbage: share of ticks whose messages are cut off in the middle.
        restart_every: time between restarts of the glove [s]: another session, stamps from 0;
            0 is never.

    Raises:
        ConfigError: a figure is outside its range.
    """

    drop: float = 0.0
    silence_every: float = 0.0
    silence: float = 2.0
    missing: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    swap: float = 0.0
    garbage: float = 0.0
    restart_every: float = 0.0

    def __post_init__(self) -> None:
        for each in fields(self):
            share = each.name in _SHARES
            check_range(
                each.name, getattr(self, each.name), 0.0, 1.0 if share else math.inf,
                "" if share else "s",
            )  # fmt: skip
        if 0.0 < self.silence_every <= self.silence:
            raise ConfigError(
                f"silence_every must be longer than the silence of {self.silence:g} s, not "
                f"{self.silence_every:g} s"
            )

    def silent_at(self, time: float) -> bool:
        """Whether it is silent at a time since the start [s]: at the end of each stretch."""
        if not self.silence_every:
            return False
        return time % self.silence_every >= self.silence_every - self.silence


@dataclass(frozen=True)
class Sent:
    """What a simulator has done.

    Attributes:
        messages: sent.
        late: of these, by more than ``LATE_S``.
        worst_s: the greatest lateness [s].
        seconds: how long it ran [s].
    """

    messages: int = 0
    late: int = 0
    worst_s: float = 0.0
    seconds: float = 0.0


@dataclass(frozen=True)
class GloveSimulator:
    """Publishes hands as a glove bridge does.

    The frames are made before the first is sent, and then played there and back without an end, so
    that the hand never jumps. Stamps count from 0 at the start.

    Attributes:
        address: to listen on; ``tcp://127.0.0.1:*`` for any free port.
        rate: messages a second of each hand [Hz]; None for the recording's own, or 100.
        side: the hands; of a recording the one that it has, mirrored for the other.
        recording: to play in place of the built-in operator.
        duration: how long [s]; None until it is stopped.
        noise: standard deviation of each coordinate of the built-in operator [mm].
        seed: of the operator and the faults.
        faults: what goes wrong.

    Raises:
        ConfigError: a setting is outside its range.
    """

    address: str = "tcp://127.0.0.1:8000"
    rate: float | None = None
    side: Hands = "right"
    recording: Path | None = None
    duration: float | None = None
    noise: float = 0.0
    seed: int = 0
    faults: GloveFaults = field(default_factory=GloveFaults)

    def __post_init__(self) -> None:
        sides_of(self.side)
        check_seed("seed", self.seed)
        if self.rate is not None:
            check_range("rate", self.rate, 1.0, 2000.0, "Hz")
        if self.duration is not None:
            check_range("duration", self.duration, 0.0, 1e9, "s")

    def open(self) -> Glove:
        """Read or make the frames and listen on the address.

        Raises:
            MissingExtraError: pyzmq is not installed.
            RecordingError: the recording can't be read.
            SourceError: the address can't be listened on.
        """
        return Glove(self)

    def prepare(self) -> Prepared:
        """The frames.

        Raises:
            RecordingError: the recording can't be read, or is not of this hand.
        """
        if self.recording is not None:
            played = read_recording(self.recording)
            rate = self.rate or played.rate_hz
            if not np.isfinite(rate):
                raise ConfigError(f"{self.recording} holds a single frame: give a rate")
        else:
            rate = self.rate or _DEFAULT_RATE_HZ
            operator = SyntheticOperator(
                seed=self.seed,
                rate_hz=rate,
                tracker=TrackerModel(noise=self.noise * 1e-3, seed=self.seed),
            )
            played = operator.record(ROUND_S)
        return Prepared({side: _Written(played, side) for side in sides_of(self.side)}, rate)


@dataclass(frozen=True, eq=False)
class Prepared:
    """Hands that are ready to be sent.

    Attributes:
        hands: side -> its frames.
        rate: ticks a second [Hz].
    """

    hands: dict[Side, _Written]
    rate: float

    def messages(
        self, faults: GloveFaults, *, seed: int = 0, start: str = "0"
    ) -> Iterator[tuple[float, bytes]]:
        """(when it is due [s], message), without an end, times not decreasing.

        Args:
            faults: what goes wrong.
            seed: of the faults.
            start: distinguishes this start of the glove from any other, in the messages' sessions.
        """
        draw = random.Random(seed)
        count = next(iter(self.hands.values())).count
        turns = 2 * count - 2 or 1  # there and back
        held: list[bytes] = []
        session, begun, last, faulty = 0, 0, 0.0, 0
        tick = -1
        while True:
            tick += 1
            due = tick / self.rate
            if faults.restart_every and due >= (session + 1) * faults.restart_every:
                session, begun = session + 1, tick
            stamp = (tick - begun) / self.rate
            # All drawn in each tick, so that one fault leaves the others where they are.
            drop, missing, duplicate, reorder, swap, garbage = (
                draw.random() < share
                for share in (faults.drop, faults.missing, faults.duplicate, faults.reorder,
                              faults.swap, faults.garbage)
            )  # fmt: skip
            if duplicate and tick > begun:
                stamp = last
            last = stamp
            faulty += missing
            place = tick % turns
            frame = place if place < count else turns - place
            made = []
            for side, written in self.hands.items():
                nobody = missing and faulty % 2
                nodes = _NOBODY if nobody else written.nodes(frame, without=missing)
                message = _message(_OTHER[side] if swap else side, nodes, f"{start}-{session}",
                                   stamp, _GLOVES[side])  # fmt: skip
                made.append(message[: len(message) // 2] if garbage else message)
            if faults.silent_at(due):
                held = []
                continue
            if drop:
                continue
            if reorder and not held:
                held = made
                continue
            for message in (*made, *held):
                yield due, message
            held = []


class Glove:
    """An open simulator; must be closed, as ``with`` does.

    Attributes:
        address: where it listens.
        rate: ticks a second of each hand [Hz].
    """

    def __init__(self, settings: GloveSimulator) -> None:
        self._settings = settings
        zmq = self._zmq = load_zmq("the glove simulator")
        self._prepared = settings.prepare()
        self.rate = self._prepared.rate
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.SNDHWM, _QUEUE)
        try:
            self._socket.bind(settings.address)
        except zmq.ZMQError as error:
            self.close()
            raise SourceError(
                f"the glove simulator can't listen on {settings.address!r} ({error}); is another "
                "one running? Choose another: --address tcp://127.0.0.1:PORT"
            ) from error
        self.address: str = self._socket.getsockopt(zmq.LAST_ENDPOINT).rstrip(b"\0").decode()
        self.sent = Sent()

    def __enter__(self) -> Glove:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(
        self, stopping: threading.Event | None = None, clock: Clock = time.perf_counter
    ) -> None:
        """Publish until it is to stop, or its time is over. What was done is in ``sent``."""
        settings = self._settings
        start = clock()
        until = float("inf") if settings.duration is None else settings.duration
        messages = self._prepared.messages(
            settings.faults, seed=settings.seed, start=f"{time.time_ns():x}"
        )
        for late, (due, message) in on_time(
            ((due, (due, message)) for due, message in messages),
            clock,
            stopping or threading.Event(),
        ):
            if due >= until:
                break
            self._socket.send(message, copy=True)
            done = self.sent
            self.sent = Sent(
                done.messages + 1, done.late + (late > LATE_S), max(done.worst_s, late),
                clock() - start,
            )  # fmt: skip

    def close(self) -> None:
        """Give the address back; a second call does nothing."""
        if not self._socket.closed:
            self._socket.close(linger=0)
            self._context.term()


_NOBODY: Final = write_manus(HandFrame(np.full((21, 3), np.nan)))


def _message(side: Side, nodes: bytes, session: str, stamp: float, glove: int) -> bytes:
    head = (
        f'{side.upper()} {{"glove_id":{glove},"side":"{side}","session":"{session}",'
        f'"stamp":{stamp:.6f},"nodes":'
    )
    return head.encode() + nodes + b"}"


class _Written:
    """The frames of a hand as JSON, each written when it is first sent."""

    def __init__(self, recording: HandRecording, side: Side) -> None:
        self.count = len(recording)
        self._recording = recording
        self._side = side
        self._made: dict[tuple[int, bool], bytes] = {}

    def nodes(self, index: int, *, without: bool) -> bytes:
        """The nodes of a frame, whole or without a finger."""
        key = index, without
        if key not in self._made:
            frame = self._recording[index]
            assert frame.valid is not None  # filled in by HandFrame
            landmarks = np.where(frame.valid[:, None], frame.landmarks, np.nan)
            if without:
                landmarks[_FINGER[index % 5]] = np.nan
            frame = replace(frame, landmarks=landmarks)
            if frame.side != self._side:
                frame = _mirrored(frame, self._side)
            self._made[key] = write_manus(frame)
        return self._made[key]


def _mirrored(frame: HandFrame, side: Side) -> HandFrame:
    """The other hand: positions and rotations mirrored in y (docs/reference/conventions.md)."""
    flip = np.array([1.0, -1.0, 1.0])
    return HandFrame(
        frame.landmarks * flip,
        frame.stamp,
        side,
        metacarpals=None if frame.metacarpals is None else frame.metacarpals * flip,
        orientations=None
        if frame.orientations is None
        else frame.orientations * np.array([1.0, -1.0, 1.0, -1.0]),
    )


def main() -> None:
    """Publish until the time is over or Ctrl-C."""
    with tyro.cli(GloveSimulator, config=(tyro.conf.OmitArgPrefixes,)).open() as glove:
        print(glove.address, flush=True)  # for a script that waits for it
        glove.run()


if __name__ == "__main__":
    main()
