"""Switches of a running loop for other programs: a pedal, a red button, a study's console.

A ZeroMQ socket (extra ``zmq``) takes one word as text or as JSON and answers with JSON; a REQ
socket is all that the other end needs (:class:`~smooth_operator.runtime.remote_client.RemoteTeleop`
is one):

    {"do": "stop"}    emergency stop          {"do": "release"}  ends it
    {"do": "pause"}   lets go of the clutch   {"do": "resume"}   takes it
    {"do": "quit"}    ends the run            {"do": "status"}   changes nothing

    {"ok": true, "modes": {"right": "stopped"}, "rate_hz": 99.8}
    {"ok": false, "error": "can't do 'halt'; expected one of stop, release, ..."}

Who starts the loop may add words; those of ``smooth-operator teleop`` are in
:mod:`smooth_operator.live.orders`. An added word may take long, as compiling a method does: each is
done on a thread of its own, so that a stop is answered meanwhile, and ``busy`` in the status says
what is under way.
"""

from __future__ import annotations

import contextlib
import json
import queue
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, TypeAlias

from smooth_operator.errors import MissingExtraError, SmoothOperatorError, SourceError
from smooth_operator.recording.jsonable import to_json
from smooth_operator.runtime.loop import TeleopLoop

Word: TypeAlias = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""What is done for a word: from the message's fields to the answer's; errors of the family are
answered, too."""

_TURN_MS: Final = 20
_LARGEST: Final = 1 << 16  # [bytes]
_PATIENCE_S: Final = 0.5
"""How long an answer waits for the loop to have done what it was told [s]."""
_AT_ONCE: Final = 16
"""Words that may be under way; a program that asks for more goes wrong."""


class Switchboard:
    """Does what messages say.

    Args:
        loop: what it is said to.
        words: more words than the loop's own.
        status: more fields of the status; must be quick.
    """

    def __init__(
        self,
        loop: TeleopLoop,
        words: Mapping[str, Word] = {},
        status: Callable[[], Mapping[str, Any]] = dict,
    ) -> None:
        controls = loop.controls
        self._loop, self._more, self._status = loop, dict(words), status
        self._own: dict[str, Callable[[], None]] = {
            "stop": controls.stop,
            "release": controls.release,
            "pause": controls.pause,
            "resume": controls.resume,
            "quit": controls.quit,
            "status": lambda: None,
        }
        self._under_way: list[str] = []

    @property
    def words(self) -> tuple[str, ...]:
        """All that it knows."""
        return (*self._own, *self._more)

    def answer(self, message: bytes, reply: Callable[[bytes], None]) -> None:
        """Do what a message says.

        Args:
            message: a word, or a JSON object with ``do``.
            reply: called with the answer, from this thread or from another, now or later.
        """
        try:
            text = message.decode().strip()
            fields = json.loads(text) if text.startswith("{") else {"do": text}
            word = fields["do"]
            known = word in self.words
        except (ValueError, KeyError, TypeError):
            known = False
        if not known:
            shown = message[:60].decode(errors="replace")
            error = f"can't do {shown!r}; expected one of {', '.join(self.words)}"
            reply(_encoded({"ok": False, "error": error}))
        elif word in self._own:
            reply(_encoded(self._switched(word)))
        elif len(self._under_way) >= _AT_ONCE:
            reply(_encoded({"ok": False, "error": "too much is asked for at once"}))
        else:
            self._under_way.append(word)
            threading.Thread(
                target=lambda: reply(self._done(word, fields)), name=f"remote {word}", daemon=True
            ).start()

    def _switched(self, word: str) -> dict[str, Any]:
        """One of the loop's own words."""
        self._own[word]()
        if word != "quit":
            # The loop wakes for it at once, and does first what was asked for first.
            done = threading.Event()
            self._loop.controls.change(lambda hand: done.set())
            if not done.wait(_PATIENCE_S):
                return {"ok": False, "error": "the loop does not answer: it just starts, or hangs"}
        modes = {side: hand.mode_now.value for side, hand in self._loop.pipelines.items()}
        head = {"ok": True, "modes": modes, "rate_hz": self._loop.statistics.rate_hz}
        if word != "status":
            return head
        return {**head, **self._status(), "busy": list(self._under_way)}

    def _done(self, word: str, fields: Mapping[str, Any]) -> bytes:
        """One of the others."""
        try:
            return _encoded({"ok": True, **self._more[word](fields)})
        except SmoothOperatorError as error:
            return _encoded({"ok": False, "error": str(error)})
        except Exception as error:  # a word that goes wrong must not leave its caller waiting
            return _encoded({"ok": False, "error": f"{word}: {type(error).__name__}: {error}"})
        finally:
            self._under_way.remove(word)


@contextlib.contextmanager
def remote(
    loop: TeleopLoop,
    address: str,
    words: Mapping[str, Word] = {},
    status: Callable[[], Mapping[str, Any]] = dict,
) -> Iterator[str]:
    """Listen for words while the loop runs.

    Args:
        loop: what they are said to.
        address: where to listen, such as ``tcp://127.0.0.1:5558``; ``tcp://127.0.0.1:*`` takes any
            free port.
        words: more words than the loop's own, each done on a thread of its own.
        status: more fields of the status; must be quick.

    Yields:
        the address.

    Raises:
        MissingExtraError: pyzmq is not installed.
        SourceError: the address can't be listened on.
    """
    try:
        import zmq
    except ImportError:
        raise MissingExtraError("listening for switches (--control)", "zmq") from None
    context = zmq.Context()
    # Not REP, which would have a stop wait for the answer to whatever was asked before.
    socket = context.socket(zmq.ROUTER)
    socket.setsockopt(zmq.LINGER, 200)
    socket.setsockopt(zmq.MAXMSGSIZE, _LARGEST)
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        socket.close()
        context.term()
        raise SourceError(
            f"can't listen for switches on {address!r} ({error}); an address looks like "
            "tcp://127.0.0.1:5558"
        ) from error
    bound = str(socket.getsockopt_string(zmq.LAST_ENDPOINT)).rstrip("\0")
    board = Switchboard(loop, words, status)
    answers: queue.SimpleQueue[list[bytes]] = queue.SimpleQueue()
    done = threading.Event()

    def send_all() -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                socket.send_multipart(answers.get_nowait())

    def reply_to(envelope: list[bytes]) -> Callable[[bytes], None]:
        return lambda text: answers.put([*envelope, text])

    def listen() -> None:
        while not done.is_set():
            if socket.poll(_TURN_MS):
                *envelope, message = socket.recv_multipart()
                board.answer(message, reply_to(envelope))
            send_all()
        send_all()
        socket.close()

    thread = threading.Thread(target=listen, name="remote", daemon=True)
    thread.start()
    try:
        yield bound
    finally:
        done.set()
        thread.join(2.0)
        context.term()


def _encoded(answer: Mapping[str, Any]) -> bytes:
    return to_json(answer).encode()
