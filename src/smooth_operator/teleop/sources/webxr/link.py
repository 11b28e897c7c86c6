"""Protocol of the WebSocket between the headset's page and this program: pairing, hands and state.

Text messages are JSON objects with a ``type``; hands are binary (``.packet``).

===========  ========================================================================  ============
from page    content                                                                   answer
===========  ========================================================================  ============
``hello``    ``protocol``: 1; ``code``                                                 ``welcome``
``ping``     ``at``: time by the page's clock [s]; ``round_trip`` and ``offset`` [s],  ``pong``
             or null; ``tracking``: true while the headset tracks
``stop``     nothing; the page repeats it until ``pong`` has the mode *stopped*
``look``     ``number`` of the shapes that the page has; 0 for none                    ``view``
``button``   ``name`` of a button of a controller that was pressed: ``a``, ``left-stick``
``picture``  ``camera``: its place in ``cameras`` of ``view``                          ``PICTURE``
===========  ========================================================================  ============

``welcome`` contains the ``session``; ``buttons``, name -> action of each button that has an action
(for the action ``stop``, the page sends ``stop``); and ``pulses``: true if this program will send
``pulse``. That message lets the controllers of a ``side`` vibrate with a ``strength`` of 0 to 1 for
a number of ``seconds``, and replaces the previous one. ``pong`` repeats ``at`` and contains
``host``, the time by the host's clock [s]; ``rate``, the rate of arriving frames with a hand [Hz];
and ``mode``, the state of the loop (``Mailbox.mode``). ``offset`` is host clock minus page clock,
from the fastest of the last round trips (as in NTP: RFC 5905, 8 and 10): ``stamp + offset`` is the
time of a frame by the host's clock, to within half the round trip.

``view`` describes the robot for drawing. Its ``number`` is 0 if there is no robot. ``nodes`` follow
if the shapes have changed. Each has a ``parent`` (its place in the list; -1 for none) and a number
of values (``count``). Unless it is a frame, it also has ``vertices`` (float32, 3 each [m]) and
``faces`` (uint32, 3 each) in base64, ``opacity``, ``flat`` (shading) and the ``side`` of the robot
that it belongs to. ``middle`` is the middle of the picture in the first frame, whose x points
right, y ahead and z up [m]. ``changed`` lists nodes, and ``values`` contains their values in the
same sequence, float32 in base64. The values of a frame are its pose in its parent (x y z [m],
quaternion w x y z). The values of a mesh are, for each instance, its pose, three scales and linear
red, green and blue from 0 to 1. The values of a hidden node are NaN. ``hands`` are the robot hands
by side: ``node`` (the frame of the palm), ``name``, ``mode``, ``latched`` (fingers that pinch) and,
while the operator's hand is seen, ``palm``, the pose of the robot's palm in the frame of the
operator's wrist joint, and ``size``, that of the robot over the operator's. ``cameras`` are the
states of the cameras, as ``Cameras.states`` gives them, and a picture older than ``late_s`` is
late. The page sends ``look`` after the answer to the previous one.

The first message must be ``hello``. A refused connection is closed with one of the codes below.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import struct
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.io.documents import json_object
from smooth_operator.landmarks import FROM_WEBXR_25, METACARPALS_WEBXR_25
from smooth_operator.poses import to_ours
from smooth_operator.teleop.sources.live import LATEST_STAMP_S, Mailbox
from smooth_operator.types import HandFrame, Side
from smooth_operator.web.auth import same_secret

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

PROTOCOL: Final = 1
NOT_UNDERSTOOD: Final = 4400
WRONG_CODE: Final = 4401
REPLACED: Final = 4409
LOCKED: Final = 4429

PICTURE: Final = struct.Struct("<IId")
"""Head of a picture, before the JPEG: camera, number, time by the host's clock [s]."""

_HELLO_WITHIN: Final = 5.0
_MOST_ANSWERS: Final = 16  # that a slow link has not taken yet
_BAD_IN_A_ROW: Final = 50  # unreadable messages after which the link is closed
_RATE_OVER: Final = 1.0


@dataclass
class LinkState:
    """State of the link to the headset.

    Attributes:
        address: address of the headset; None if no headset is connected.
        session: number of this connection, counted from 1; 0 before the first connection.
        tracking: True while the headset's page tracks.
        bad: number of unreadable messages.
        refused: number of wrong pairing codes.
        rate_hz: rate of frames with a hand over the last second [Hz].
        round_trip_s: round trip as the page measures it; NaN if unknown.
        clock_offset_s: this machine's clock minus the page's; NaN if unknown. Added to a stamp, it
            gives the time by this machine's clock, to within half a round trip.
    """

    address: str | None = None
    session: int = 0
    tracking: bool = False
    bad: int = 0
    refused: int = 0
    rate_hz: float = 0.0
    round_trip_s: float = float("nan")
    clock_offset_s: float = float("nan")


class View(Protocol):
    """What the headset's page draws around the operator."""

    def look(self, number: object) -> Mapping[str, Any]:
        """Returns the message ``view`` for a page whose shapes have this number."""

    def picture(self, camera: object) -> bytes | None:
        """Returns the newest picture of a camera with its ``PICTURE`` header; None if there is
        none."""


class Link:
    """Connection to a headset. A newer connection replaces it.

    Attributes:
        view: what the page draws; None for the operator's hands alone.
    """

    def __init__(self, mailbox: Mailbox, pairing: Pairing, pulses: bool = False) -> None:
        self._pulses = pulses
        self._loop: asyncio.AbstractEventLoop | None = None
        self._pulse: Future[None] | None = None  # the last one
        self._mailbox = mailbox
        self._pairing = pairing
        self._clock = mailbox.clock
        self.view: View | None = None
        self._current: ServerConnection | None = None
        self._state = LinkState()
        self._bad_in_a_row = 0
        self._received: deque[float] = deque(maxlen=512)
        self._sources: dict[Side, bool] = {}  # True if the last hand was that of a controller
        self._changes = Counter[Side]()  # of these
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def state(self) -> LinkState:
        """Copy of the link's state; safe from any thread."""
        return replace(self._state, refused=self._pairing.refused, rate_hz=self._rate())

    def pulse(self, side: Side, strength: float, seconds: float) -> None:
        """Sends a pulse to the controllers of a side; safe from any thread.

        Without a headset, or while it has not yet taken the previous pulse, nothing is sent.
        """
        connection, loop = self._current, self._loop
        if connection is None or loop is None or (self._pulse and not self._pulse.done()):
            return
        content = {"type": "pulse", "side": side, "strength": strength, "seconds": seconds}
        sending = connection.send(json.dumps(content))
        self._pulse = asyncio.run_coroutine_threadsafe(sending, loop)

    async def serve(self, connection: ServerConnection) -> None:
        """Serves one page until it disconnects or is closed."""
        from websockets.exceptions import ConnectionClosed

        self._loop = asyncio.get_running_loop()
        address = str((connection.remote_address or ("unknown",))[0])
        try:
            if not await self._paired(connection, address):
                return
            self._take_over(connection, address)
            buttons = {
                source.removeprefix("button:"): action
                for source, action in self._mailbox.bindings.items()
                if source.startswith("button:")
            }
            welcome = {
                "type": "welcome",
                "session": self._state.session,
                "buttons": buttons,
                "pulses": self._pulses,
            }
            await connection.send(json.dumps(welcome))
            async for message in connection:
                received = self._clock()
                if self._current is not connection:
                    break
                if isinstance(message, bytes):
                    self._hands(message, received)
                else:
                    self._talk(connection, message, received)
                if self._bad_in_a_row >= _BAD_IN_A_ROW:
                    await connection.close(NOT_UNDERSTOOD, "messages that can't be read")
        except ConnectionClosed as closed:
            if self._current is connection and closed.sent is not None and closed.sent.code == 1009:
                self._state.bad += 1  # longer than any message of the page
        finally:
            if self._current is connection:
                self._current = None
                self._begin(None)

    async def _paired(self, connection: ServerConnection, address: str) -> bool:
        """True if the first message is a greeting with the right code; else closes the link."""
        try:
            hello = await asyncio.wait_for(connection.recv(), _HELLO_WITHIN)
        except TimeoutError:
            await connection.close(NOT_UNDERSTOOD, "no greeting received")
            return False
        answer = json_object(hello) or {}
        code = answer.get("code")
        if answer.get("type") != "hello" or not isinstance(code, str):
            await connection.close(NOT_UNDERSTOOD, "expected a greeting with the pairing code")
            return False
        if answer.get("protocol") != PROTOCOL:
            await connection.close(
                NOT_UNDERSTOOD, "this page is from another version of the program: reload it"
            )
            return False
        verdict = self._pairing.check(code, address)
        if verdict == "wrong":
            await connection.close(WRONG_CODE, "wrong pairing code")
        elif verdict == "locked":
            await connection.close(LOCKED, "too many wrong pairing codes: wait a minute")
        return verdict == "paired"

    def _take_over(self, connection: ServerConnection, address: str) -> None:
        old, self._current = self._current, connection
        self._begin(address)
        self._state.session += 1
        self._bad_in_a_row = 0
        if old is not None:
            # On its own: a headset that is asleep must not keep the new one waiting.
            self._keep(asyncio.create_task(old.close(REPLACED, "another headset took over")))

    def _begin(self, address: str | None) -> None:
        """Resets the state for a new page."""
        state = self._state
        state.address, state.tracking = address, False
        state.round_trip_s = state.clock_offset_s = float("nan")
        self._received.clear()

    def _hands(self, message: bytes, received: float) -> None:
        try:
            packet = read_packet(message)
        except RecordingError:
            self._count_bad()
            return
        self._bad_in_a_row = 0
        if any(frame.valid is not None and frame.valid.any() for frame in packet.frames):
            self._received.append(received)
        for frame in packet.frames:
            by_controller = frame.side in packet.controllers
            if self._sources.get(frame.side, by_controller) != by_controller:
                self._changes[frame.side] += 1  # a new session, to which the robot moves smoothly
            self._sources[frame.side] = by_controller
            session = self._state.session + self._changes[frame.side]
            self._mailbox.post(frame, received=received, session=session)

    def _talk(self, connection: ServerConnection, message: str, received: float) -> None:
        content = json_object(message) or {}
        if content.get("type") == "stop":
            self._mailbox.stop()
            return
        if content.get("type") == "look":
            nothing = {"type": "view", "number": 0}
            view = nothing if self.view is None else self.view.look(content.get("number"))
            self._answer(connection, json.dumps(view))
            return
        if content.get("type") == "button":
            self._mailbox.press(f"button:{content.get('name')}")
            return
        if content.get("type") == "picture":
            picture = None if self.view is None else self.view.picture(content.get("camera"))
            if picture is not None:
                self._answer(connection, picture)
            return
        at = content.get("at")
        if content.get("type") != "ping" or not isinstance(at, int | float):
            self._count_bad()
            return
        self._bad_in_a_row = 0
        self._state.tracking = content.get("tracking") is True
        self._state.round_trip_s = _number(content.get("round_trip"))
        self._state.clock_offset_s = _number(content.get("offset"))
        answer = {
            "type": "pong",
            "at": at,
            "host": received,
            "rate": round(self._rate(), 1),
            "mode": self._mailbox.mode(),
        }
        self._answer(connection, json.dumps(answer))

    def _answer(self, connection: ServerConnection, content: str | bytes) -> None:
        """Sends without a wait, so that pictures on a slow link don't delay the page's next stop; a
        link that is far behind gets no answer."""

        async def send() -> None:
            from websockets.exceptions import ConnectionClosed

            with contextlib.suppress(ConnectionClosed):
                await connection.send(content)

        if len(self._tasks) < _MOST_ANSWERS:
            self._keep(asyncio.create_task(send()))

    def _keep(self, task: asyncio.Task[None]) -> None:
        """Keeps a reference to a task until it ends, which the event loop does not."""
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _count_bad(self) -> None:
        self._state.bad += 1
        self._bad_in_a_row += 1

    def _rate(self) -> float:
        """Frames with a hand in the last second [Hz]."""
        since = self._clock() - _RATE_OVER
        return sum(at > since for at in self._received.copy()) / _RATE_OVER  # more may come


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


MAGIC: Final = b"XRH1"
SPACES: Final = ("local", "local-floor")
"""Reference spaces of the page; a message contains the index of one of them."""
JOINTS: Final = 25
VALUES: Final = 8
HEADER: Final = struct.Struct("<4sIdII")
_HAND_BYTES: Final = JOINTS * VALUES * 4
MAX_BYTES: Final = HEADER.size + 2 * _HAND_BYTES
_SIDES: Final[tuple[tuple[int, Side], ...]] = ((1, "left"), (2, "right"))

_LANDMARKS: Final = np.array(FROM_WEBXR_25)
_METACARPALS: Final = np.array(METACARPALS_WEBXR_25)
_WXYZ: Final = np.array([6, 3, 4, 5])
_FAR: Final = 100.0  # farther from the headset's start than any room is large [m]


@dataclass(frozen=True, eq=False)
class Packet:
    """Message with the hands of one XR frame.

    Attributes:
        frames: visible hands, left first, with stamps by the page's clock.
        controllers: sides whose hand was computed from a controller.
    """

    frames: tuple[HandFrame, ...]
    controllers: frozenset[Side] = frozenset()


def read_packet(message: bytes) -> Packet:
    """Reads a message from the page; RecordingError if it is not valid."""
    if len(message) < HEADER.size or message[:4] != MAGIC:
        raise RecordingError(f"expected a message that begins with {MAGIC!r}, got {message[:4]!r}")
    _, _, stamp, hands, space = HEADER.unpack_from(message)
    if not abs(stamp) < LATEST_STAMP_S:
        raise RecordingError(f"the timestamp must be a finite number of seconds, not {stamp:.6g}")
    sides = [side for bit, side in _SIDES if hands & bit]
    controllers = frozenset(side for bit, side in _SIDES if hands & 4 * bit)
    if (
        hands > 15
        or not controllers <= set(sides)
        or len(message) != HEADER.size + len(sides) * _HAND_BYTES
    ):
        raise RecordingError(
            f"expected {len(sides)} hands in {HEADER.size + len(sides) * _HAND_BYTES} bytes, "
            f"got {len(message)}"
        )
    values = np.frombuffer(message, "<f4", offset=HEADER.size).astype(np.float64)
    joints = values.reshape(len(sides), JOINTS, VALUES)
    world = f"webxr/{SPACES[space]}" if space < len(SPACES) else "webxr"
    frames = tuple(_frame(joints[i], stamp, side, world) for i, side in enumerate(sides))
    return Packet(frames, controllers)


def _frame(joints: Float[np.ndarray, "25 8"], stamp: float, side: Side, world: str) -> HandFrame:
    points = joints[:, :3]
    with np.errstate(invalid="ignore"):
        points = np.where((np.abs(points) < _FAR).all(axis=1, keepdims=True), points, np.nan)
        turns = joints[:, _WXYZ]
        size = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = np.where(np.abs(size - 1.0) < 0.1, turns / np.where(size > 0, size, 1.0), np.nan)
    return HandFrame(
        points[_LANDMARKS],
        stamp,
        side,
        metacarpals=points[_METACARPALS],
        orientations=turns[_LANDMARKS],
        T_world_wrist=to_ours(np.concatenate([points[0], turns[0]])),
        world=world,
    )


Verdict: TypeAlias = Literal["paired", "wrong", "locked"]

DIGITS: Final = 6
WINDOW: Final = 60.0
"""Time for which a wrong code counts [s]."""
PER_ADDRESS: Final = 5
"""Number of wrong codes within ``WINDOW`` that locks their address."""
IN_ALL: Final = 30
"""Number of wrong codes within ``WINDOW`` that locks all addresses. Trying half of a million codes
then takes eleven days."""


class Pairing:
    """Checks pairing codes, and limits the number of wrong codes.

    Args:
        code: letters and digits; None for six random digits.
        clock: monotonic clock [s].

    Raises:
        ConfigError: the code is too short, or has other characters.
    """

    def __init__(self, code: str | None, clock: Callable[[], float] = time.monotonic) -> None:
        self.code = f"{secrets.randbelow(10**DIGITS):0{DIGITS}}" if code is None else plain(code)
        check_code(self.code)
        self.refused = 0
        self._clock = clock
        self._wrong: deque[tuple[float, str]] = deque()

    @property
    def spoken(self) -> str:
        """The code for display, in groups of three characters."""
        return " ".join(self.code[i : i + 3] for i in range(0, len(self.code), 3))

    def check(self, code: str, address: str) -> Verdict:
        """Checks the code that a client sent; limits the wrong codes that its address may send."""
        now = self._clock()
        while self._wrong and now - self._wrong[0][0] > WINDOW:
            self._wrong.popleft()
        own = sum(address == other for _, other in self._wrong)
        if own >= PER_ADDRESS or len(self._wrong) >= IN_ALL:
            self.refused += 1
            return "locked"
        if same_secret(plain(code), self.code):
            return "paired"
        self._wrong.append((now, address))
        self.refused += 1
        return "wrong"


def check_code(code: str) -> None:
    """Raises ConfigError for a code that is easy to guess or hard to type."""
    code = plain(code)
    if not (DIGITS <= len(code) <= 64 and code.isascii() and code.isalnum()):
        raise ConfigError(f"a pairing code is {DIGITS} to 64 letters and digits, not {code!r}")


def plain(code: str) -> str:
    """Removes spaces and dashes from a code."""
    return "".join(code.split()).replace("-", "").lower()
