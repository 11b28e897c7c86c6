"""Messages of a gRPC server's stream, with another connection where one ends."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any, Final

from smooth_operator.errors import MissingExtraError
from smooth_operator.teleop.sources.message_receiver import Message
from smooth_operator.teleop.sources.stream import KEPT

_RETRY_S: Final = (0.2, 2.0)  # first and longest wait before another try
_SILENT_S: Final = 3.0  # a stream that says nothing for so long is begun again: the headset slept
_WORDS: Final = 200


class GrpcInbox:
    """A stream of encoded messages from a method with an empty request.

    A message is its bytes and the number of the connection. Nothing is decoded, so no generated
    code is needed.

    Args:
        feature: what needs it, for the message where grpcio is missing.
        extra: the extra that has grpcio.
        address: HOST:PORT of the server, which need not be there yet.
        method: path of the method: ``/package.Service/Method``.
        longest: messages beyond are refused [bytes].

    Attributes:
        address: as it was given.
        problem: why there is no stream; empty while there is one.

    Raises:
        MissingExtraError: grpcio is not installed.
    """

    def __init__(self, feature: str, extra: str, address: str, method: str, longest: int) -> None:
        try:
            import grpc
        except ImportError as error:
            raise MissingExtraError(feature, extra) from error
        self._grpc = grpc
        self.address = address
        self.problem = ""
        self._method = method
        self._longest = longest
        self._newest: deque[Message] = deque(maxlen=KEPT)
        self._arrived = threading.Condition()
        self._closing = threading.Event()
        self._last = time.monotonic()
        self._call: Any = None
        self._thread = threading.Thread(target=self._run, name=f"gRPC {address}", daemon=True)
        self._thread.start()

    def receive(self, timeout: float) -> list[Message]:
        """See ``Inbox``."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._newest, timeout)
            messages = list(self._newest)
            self._newest.clear()
        call = self._call
        if not messages and call is not None and time.monotonic() - self._last > _SILENT_S:
            call.cancel()
        return messages

    def close(self) -> None:
        """End the stream and wait for its thread a while."""
        self._closing.set()
        call = self._call
        if call is not None:
            call.cancel()
        self._thread.join(5.0)

    def _run(self) -> None:
        connection, wait = 0, _RETRY_S[0]
        while not self._closing.is_set():
            connection += 1
            if self._listen(str(connection).encode()):
                wait = _RETRY_S[0]
            self._closing.wait(wait)
            wait = min(2.0 * wait, _RETRY_S[1])

    def _listen(self, connection: bytes) -> bool:
        """One stream, until it ends; whether a message came."""
        grpc, heard = self._grpc, False
        options = [
            ("grpc.max_receive_message_length", self._longest),
            ("grpc.enable_retries", 0),
            # Without this, channels of one process share a connection that broke.
            ("grpc.use_local_subchannel_pool", 1),
        ]
        try:
            with grpc.insecure_channel(self.address, options=options) as channel:
                self._last = time.monotonic()
                self._call = call = channel.unary_stream(self._method)(b"")
                if self._closing.is_set():  # close() came before there was a call to cancel
                    call.cancel()
                for data in call:
                    heard, self._last = True, time.monotonic()
                    with self._arrived:
                        self.problem = ""
                        self._newest.append((data, connection))
                        self._arrived.notify_all()
            self.problem = f"{self.address} ended the stream; connecting again"
        except grpc.RpcError as error:
            self.problem = self._words(error)
        finally:
            self._call = None
        return heard

    def _words(self, error: Any) -> str:
        code = error.code().name if callable(getattr(error, "code", None)) else "error"
        if code == "CANCELLED":
            return f"{self.address} sends nothing; connecting again"
        if code == "UNIMPLEMENTED":
            return f"{self.address} is a gRPC server, but has no hand tracking: another program"
        if code == "RESOURCE_EXHAUSTED":
            return f"{self.address} sends messages longer than {self._longest} bytes"
        text = " ".join(str(error.details() or "").split())[:_WORDS]
        return (
            f"can't connect to {self.address} ({code}: {text}); is the app started, the address "
            "the one that it shows, and the headset on this network? Trying again"
        )
