"""Client of ``teleop --control``, which commands a running teleoperation.

    teleop = RemoteTeleop("tcp://127.0.0.1:5558")
    teleop.request("method", method="dexpilot", preset="published")
    teleop.request("status")["method"]

``smooth_operator.teleop.control.rpc`` describes the commands and their answers.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from typing import Any, Final

from smooth_operator.errors import ConfigError, MissingExtraError, RemoteError, RemoteRefusedError
from smooth_operator.io.documents import json_object
from smooth_operator.web.addresses import is_zmq_address

LONGEST_S: Final = 600.0
"""Longest time to wait for a busy teleoperation [s]."""

_LOOK_MS: Final = 100
_BUSY: Final = json.dumps({"do": "status"}).encode()


class RemoteTeleop:
    """A running ``smooth-operator teleop --control ADDRESS``. Safe from any thread.

    Every request has its own connection. A teleoperation may therefore end and start between two
    requests, and a stop does not wait for the answer to another request, such as a change of method
    that has to be compiled.

    Args:
        address: address of the teleoperation, such as ``tcp://127.0.0.1:5558``.
        timeout_s: longest time without an answer [s]. During a longer command, such as compiling a
            method, the client waits as long as the teleoperation reports that it is busy.

    Raises:
        ConfigError: the text is not a ZeroMQ address, or the time is not positive.
        MissingExtraError: pyzmq is not installed.
    """

    def __init__(self, address: str, timeout_s: float = 5.0) -> None:
        if not is_zmq_address(address):
            raise ConfigError(
                f"{address!r} is not a ZeroMQ address; expected an address such as "
                "tcp://127.0.0.1:5558, as given to teleop --control"
            )
        if not 0.0 < timeout_s <= LONGEST_S:
            raise ConfigError(f"timeout_s must be over 0 to {LONGEST_S:g} s, not {timeout_s}")
        try:
            import zmq
        except ImportError:
            raise MissingExtraError("communicating with a running teleop", "zmq") from None
        self.address, self.timeout_s = address, timeout_s
        self._zmq: Any = zmq

    def request(self, do: str, **fields: Any) -> dict[str, Any]:
        """Sends a command and waits for the reply.

        Args:
            do: the command: ``status``, ``stop``, ``method``, ``task``, ...
            fields: its fields, as JSON values.

        Returns:
            the answer, in which ``ok`` is true.

        Raises:
            RemoteRefusedError: the teleoperation refuses, with its message.
            RemoteError: there is no answer, or it is not from a teleoperation.
            ConfigError: a field has no JSON form, or the address is not valid.
        """
        try:
            message = json.dumps({**fields, "do": do}, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{do}: the message can't be written as JSON: {error}") from error
        answer = self._exchange(message, self._still_busy)
        if answer.get("ok") is not True:
            why = answer.get("error")
            raise RemoteRefusedError(str(why) if why else f"{do}: refused without a reason")
        return answer

    def _still_busy(self) -> bool:
        return bool(self._exchange(_BUSY, lambda: False).get("busy"))

    def _exchange(self, message: bytes, patient: Callable[[], bool]) -> dict[str, Any]:
        """Send a message and return its answer; waits on after a timeout if ``patient`` is true."""
        zmq = self._zmq
        with zmq.Context() as context, context.socket(zmq.REQ) as socket:
            socket.setsockopt(zmq.LINGER, 0)  # drop a message that was not received
            try:
                socket.connect(self.address)
                socket.send(message)
                self._wait(socket, patient)
                return self._read(socket.recv())
            except zmq.ZMQError as error:
                raise ConfigError(f"{self.address!r} can't be reached: {error}") from error

    def _wait(self, socket: Any, patient: Callable[[], bool]) -> None:
        begun = time.monotonic()
        until = begun + self.timeout_s
        while not socket.poll(min(_LOOK_MS, 1 + math.ceil(1e3 * self.timeout_s))):
            now = time.monotonic()
            if now < until:
                continue
            if now - begun < LONGEST_S and patient():
                until = time.monotonic() + self.timeout_s
                continue
            if socket.poll(0):
                return
            raise RemoteError(
                f"no answer from {self.address} within {self.timeout_s:g} s; is "
                f"smooth-operator teleop --control {self.address} running?"
            )

    def _read(self, answer: bytes) -> dict[str, Any]:
        content = json_object(answer)
        if content is None:
            raise RemoteError(
                f"the program at {self.address} is not a running teleop; it answered "
                f"{answer[:60].decode(errors='replace')!r}"
            )
        return content
