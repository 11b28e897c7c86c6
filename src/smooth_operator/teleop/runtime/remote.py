"""Remote control of a running loop by other programs.

A ZeroMQ socket (extra ``zmq``) takes one command as text or as JSON and answers with JSON; a REQ
socket is all that the other end needs (``RemoteTeleop``
is one):

    {"do": "stop"}    emergency stop          {"do": "release"}  ends it
    {"do": "pause"}   releases the clutch   {"do": "resume"}   takes it
    {"do": "quit"}    ends the run            {"do": "status"}   changes nothing

    {"ok": true, "modes": {"right": "stopped"}, "rate_hz": 99.8}
    {"ok": false, "error": "can't do 'halt'; expected one of stop, release, ..."}

A stop is done before whatever else waits, and a release that waited is refused then: it was meant
for an earlier stop. A status does not reach the loop, so that it may be asked for at any rate.

Who starts the loop may add commands; those of ``smooth-operator teleop`` are in
``smooth_operator.teleop.control.rpc_handlers``. An added command may take long, as compiling a
method does: each is done on its own thread, so that a stop is answered meanwhile, and
``busy`` in the status says what is under way.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.rpc_server import Reply, RpcHandler, RpcServer
from smooth_operator.terminal import print_note

_TURN_MS: Final = 20
_SOON_MS: Final = 1  # while an answer waits for the loop
_LARGEST: Final = 1 << 16  # [bytes]
_FRAMES: Final = 8
"""Most parts of a message: an address for each relay, an empty one, the command."""
_GULP: Final = 256
"""Messages that are heard before the next one is done."""
_END_S: Final = 2.0


@contextlib.contextmanager
def remote(
    loop: TeleopLoop,
    address: str,
    handlers: Mapping[str, RpcHandler] = {},
    status: Callable[[], Mapping[str, Any]] = dict,
) -> Iterator[str]:
    """Listen for commands of other programs while the loop runs.

    Args:
        loop: what they are said to.
        address: where to listen, such as ``tcp://127.0.0.1:5558``; ``tcp://127.0.0.1:*`` takes any
            free port.
        handlers: more commands than the loop's own -> what is done for each, on a thread of its
            own.
        status: more fields of the status; must be quick.

    Yields:
        the address.

    Raises:
        MissingExtraError: pyzmq is not installed.
        SourceError: the address can't be listened on.
    """
    context, socket = _listening(address)
    bound = str(socket.last_endpoint.decode()).rstrip("\0")
    server = RpcServer(loop, handlers, status)
    answers: queue.SimpleQueue[list[bytes]] = queue.SimpleQueue()
    done = threading.Event()

    def send_all() -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                socket.send_multipart(answers.get_nowait())

    def reply_to(envelope: list[bytes]) -> Reply:
        return lambda text: answers.put([*envelope, text])

    def hear() -> None:
        """Take what has come, so that a stop is done before what came ahead of it."""
        for _ in range(_GULP):
            if not socket.poll(0):
                return
            frames = socket.recv_multipart()
            if len(frames) <= _FRAMES:
                *envelope, message = frames
                server.hear(message, reply_to(envelope))

    def listen() -> None:
        try:
            while not done.is_set():
                if server.idle:
                    socket.poll(_TURN_MS)
                elif not server.queued:
                    socket.poll(_SOON_MS)
                try:
                    hear()
                    server.turn()
                    send_all()
                except Exception as error:  # nothing that is sent may end the listening
                    print_note(f"note: {address}: {type(error).__name__}: {error}")
            server.finish()
            send_all()
        finally:
            socket.close()

    thread = threading.Thread(target=listen, name="remote", daemon=True)
    thread.start()
    try:
        yield bound
    finally:
        done.set()
        thread.join(_END_S)
        if not thread.is_alive():  # the context waits for its sockets to be closed
            context.term()


def check_address(address: str) -> None:
    """Find out whether ``remote`` can listen there, before anything slow is done.

    Raises:
        MissingExtraError, SourceError: as ``remote``.
    """
    context, socket = _listening(address)
    socket.close(0)
    context.term()


def _listening(address: str) -> tuple[Any, Any]:
    """A ZeroMQ context and its socket, which listens."""
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
    return context, socket
