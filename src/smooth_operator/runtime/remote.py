"""Switches of a running loop for other programs: a pedal, a red button, a study's console.

A ZeroMQ socket (REP, extra ``zmq``) takes one word as text or as JSON and answers with JSON:

    {"do": "stop"}    emergency stop          {"do": "release"}  ends it
    {"do": "pause"}   lets go of the clutch   {"do": "resume"}   takes it
    {"do": "quit"}    ends the run            {"do": "status"}   changes nothing

    {"ok": true, "modes": {"right": "stopped"}, "rate_hz": 99.8}
    {"ok": false, "error": "unknown word 'halt'; expected stop, release, ..."}
"""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from typing import Any, Final

from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.runtime.loop import TeleopLoop

_TURN_MS: Final = 50
_LARGEST: Final = 4096  # [bytes]
_PATIENCE_S: Final = 0.5
"""How long an answer waits for the loop to have done what it was told [s]."""


def answer(loop: TeleopLoop, message: bytes) -> dict[str, Any]:
    """Do what a message says.

    Args:
        loop: what it is said to.
        message: a word, or a JSON object with ``do``.

    Returns:
        ``ok``, and the modes after it, or the error.
    """
    controls = loop.controls
    known: dict[str, Callable[[], None]] = {
        "stop": controls.stop,
        "release": controls.release,
        "pause": controls.pause,
        "resume": controls.resume,
        "quit": controls.quit,
        "status": lambda: None,
    }
    try:
        text = message.decode().strip()
        word = json.loads(text)["do"] if text.startswith("{") else text
        action = known[word]
    except (ValueError, KeyError, TypeError):
        shown = message[:60].decode(errors="replace")
        return {"ok": False, "error": f"can't do {shown!r}; expected one of {', '.join(known)}"}
    action()
    if word != "quit":
        # The loop wakes for it at once, and does first what was asked for first.
        done = threading.Event()
        controls.change(lambda hand: done.set())
        if not done.wait(_PATIENCE_S):
            return {"ok": False, "error": "the loop does not answer"}
    modes = {side: hand.mode_now.value for side, hand in loop.pipelines.items()}
    return {"ok": True, "modes": modes, "rate_hz": loop.statistics.rate_hz}


@contextlib.contextmanager
def remote(loop: TeleopLoop, address: str) -> Iterator[str]:
    """Listen for words while the loop runs.

    Args:
        loop: what they are said to.
        address: where to listen, such as ``tcp://127.0.0.1:5558``; ``tcp://127.0.0.1:*`` takes any
            free port.

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
    socket = context.socket(zmq.REP)
    socket.setsockopt(zmq.LINGER, 0)
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
    done = threading.Event()

    def listen() -> None:
        while not done.is_set():
            if socket.poll(_TURN_MS):
                socket.send(json.dumps(answer(loop, socket.recv())).encode())
        socket.close()

    thread = threading.Thread(target=listen, name="remote", daemon=True)
    thread.start()
    try:
        yield bound
    finally:
        done.set()
        thread.join(2.0)
        context.term()
