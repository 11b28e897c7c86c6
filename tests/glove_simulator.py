"""Simulator of a MANUS glove and its bridge, for tests and benchmarks (extra ``zmq``).

As a program: ``python tests/glove_simulator.py --address tcp://127.0.0.1:8000 --drop 0.1``.
"""

import json
import random
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro
import zmq

from smooth_operator import SyntheticOperator, read_recording
from smooth_operator.landmarks import FROM_MANUS_25, METACARPALS_MANUS_25
from smooth_operator.synthetic.tracker import TrackerModel
from smooth_operator.teleop.sources.live import on_time
from smooth_operator.teleop.sources.programs import NODES
from smooth_operator.teleop.sources.stream import Hands, sides_of
from smooth_operator.types import HandFrame, HandRecording, Side

_GLOVES: Final[dict[Side, int]] = {"right": 1001, "left": 1002}
_OTHER: Final[dict[Side, Side]] = {"right": "left", "left": "right"}
_NO_HAND: Final = HandFrame(np.full((21, 3), np.nan))


def write_manus(frame: HandFrame) -> bytes:
    """The nodes of a hand as JSON: a list of 25 ``{"id", "pos", "quat"}``, null where missing.

    Metacarpal bases have no orientation. Numbers go to the micrometre, as the gloves' float32.
    """
    rows = np.full((NODES, 7), np.nan)
    rows[list(FROM_MANUS_25), :3] = frame.landmarks
    if frame.metacarpals is not None:
        rows[list(METACARPALS_MANUS_25), :3] = frame.metacarpals
    if frame.orientations is not None:
        rows[list(FROM_MANUS_25), 3:] = frame.orientations
    nodes = [
        {
            name: values.round(6).tolist() if np.isfinite(values).all() else None
            for name, values in (("pos", row[:3]), ("quat", row[3:]))
        }
        for row in rows
    ]
    return json.dumps([{"id": k, **node} for k, node in enumerate(nodes)]).encode()


@dataclass(frozen=True)
class GloveFaults:
    """Faults of a glove or its bridge; none by default. Shares are of the ticks, drawn at random.

    Attributes:
        drop: share of ticks whose messages are never sent.
        silence_every: time from one silence of the glove to the next [s]; 0 for none.
        silence: length of a silence [s].
        missing: share of ticks with missing nodes: a finger, or the whole hand, by turns.
        duplicate: share of ticks that repeat the stamp of the one before.
        reorder: share of ticks whose messages are sent after those of the next tick.
        swap: share of ticks with the hands' sides exchanged.
        garbage: share of ticks whose messages are cut off in the middle.
        restart_every: time between restarts of the glove [s]: another session, stamps from 0;
            0 for none.
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


def messages(
    recording: HandRecording,
    rate: float,
    side: Hands,
    faults: GloveFaults,
    seed: int = 0,
    start: str = "0",
) -> Iterator[tuple[float, bytes]]:
    """(time due [s], message), without an end; the recording is played there and back.

    Args:
        recording: the hand, mirrored for the other side.
        rate: ticks a second [Hz].
        side: hands to send.
        faults: what goes wrong.
        seed: seed of the faults.
        start: name of this start of the glove in the messages' sessions.
    """
    draw, count = random.Random(seed), len(recording)
    held: list[bytes] = []
    session = begun = tick = faulty = 0
    last = 0.0
    while True:
        due = tick / rate
        if faults.restart_every and due >= (session + 1) * faults.restart_every:
            session, begun = session + 1, tick
        stamp = (tick - begun) / rate
        # All are drawn in each tick, so that one fault leaves the others where they are.
        names = ("drop", "missing", "duplicate", "reorder", "swap", "garbage")
        wrong = {name: draw.random() < getattr(faults, name) for name in names}
        last = stamp = last if wrong["duplicate"] and tick > begun else stamp
        faulty += wrong["missing"]
        place = tick % (2 * count - 2 or 1)
        frame = recording[min(place, 2 * count - 2 - place)]
        tick += 1
        if wrong["missing"]:
            landmarks = frame.landmarks.copy()
            landmarks[1 + 4 * (place % 5) :][:4] = np.nan
            frame = _NO_HAND if faulty % 2 else replace(frame, landmarks=landmarks)
        sent = []
        for name in sides_of(side):
            shown = frame if recording.side == name else _mirrored(frame)
            head: dict[str, Any] = {
                "glove_id": _GLOVES[name],
                "side": _OTHER[name] if wrong["swap"] else name,
                "session": f"{start}-{session}",
                "stamp": round(stamp, 6),
            }
            text = json.dumps(head)[:-1].encode() + b',"nodes":' + write_manus(shown) + b"}"
            text = head["side"].upper().encode() + b" " + text
            sent.append(text[: len(text) // 2] if wrong["garbage"] else text)
        every = faults.silence_every
        if every and due % every >= every - faults.silence:
            held = []
        elif wrong["reorder"] and not held and not wrong["drop"]:
            held = sent
        elif not wrong["drop"]:
            yield from ((due, message) for message in (*sent, *held))
            held = []


def _mirrored(frame: HandFrame) -> HandFrame:
    """The other hand: positions and rotations mirrored in y (docs/reference/conventions.md)."""
    flip = np.array([1.0, -1.0, 1.0])
    turns = frame.orientations
    return replace(
        frame,
        landmarks=frame.landmarks * flip,
        metacarpals=None if frame.metacarpals is None else frame.metacarpals * flip,
        orientations=None if turns is None else turns * np.array([1.0, -1.0, 1.0, -1.0]),
    )


def publish(
    address: str = "tcp://127.0.0.1:8000",
    rate: float | None = None,
    side: Hands = "right",
    recording: Path | None = None,
    duration: float | None = None,
    noise: float = 0.0,
    seed: int = 0,
    faults: GloveFaults = GloveFaults(),
) -> None:
    """Publish hands as a glove bridge does, until Ctrl-C.

    Args:
        address: address to listen on; ``tcp://127.0.0.1:*`` for any free port.
        rate: messages a second of each hand [Hz]; None for the recording's own, or 100.
        side: hands; of a recording the one that it has, mirrored for the other.
        recording: recording to play in place of 20 s of the built-in operator.
        duration: length [s]; None for no end.
        noise: shake of the operator's fingertips: standard deviation of each coordinate [mm].
        seed: seed of the operator and the faults.
        faults: what goes wrong.
    """
    if recording is not None:
        played = read_recording(recording)
        rate = rate or played.rate_hz
    else:
        rate = rate or 100.0
        tracker = TrackerModel(shake=noise * 1e-3, seed=seed)
        played = SyntheticOperator(seed=seed, rate_hz=rate, tracker=tracker).record(20.0)
    publisher = zmq.Context().socket(zmq.PUB)
    publisher.setsockopt(zmq.LINGER, 0)
    publisher.setsockopt(zmq.SNDHWM, 64)
    publisher.bind(address)
    print(publisher.last_endpoint.decode(), flush=True)  # for a script that waits for it
    due = messages(played, rate, side, faults, seed, start=f"{time.time_ns():x}")
    timed = ((at, (at, message)) for at, message in due)
    for _, (at, message) in on_time(timed, time.perf_counter, threading.Event()):
        if duration is not None and at >= duration:
            break
        publisher.send(message)


if __name__ == "__main__":
    tyro.cli(publish, config=(tyro.conf.OmitArgPrefixes,))
