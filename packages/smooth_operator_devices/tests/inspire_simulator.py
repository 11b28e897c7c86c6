"""A simulated Inspire RH56 hand that speaks Modbus on TCP (raw sockets) and RTU (a pty).

Written from the published register map. It shares no code with the driver, and none with pymodbus.
"""

import contextlib
import socket
import struct
import threading
import time
from typing import Protocol

import numpy as np
from hand_servos import Faults, Servos
from serial_port import SerialPort

ANGLE_SET, FORCE_SET, SPEED_SET = 1486, 1498, 1522
ANGLE_ACT, FORCE_ACT, CURRENT = 1546, 1582, 1594
ERROR, STATUS, TEMP = 1606, 1612, 1618
CLEAR_ERROR, HAND_ID = 1004, 1000


class InspireHand:
    """The hand behind the bus: registers and six motors, 0 closed to 1000 open.

    Order: little, ring, middle and index finger, thumb bending, thumb rotation.
    """

    def __init__(self, start: float = 1000.0, unit: int = 1) -> None:
        self.servos = Servos([start] * 6, speed=8000.0, lower=0.0, upper=1000.0)
        self.unit = unit
        self.faults = Faults()
        self.errors, self.temperatures = [0] * 6, [31, 32, 33, 34, 35, 36]
        self.force_limit, self.speed = [1000] * 6, [1000] * 6
        self.cleared = 0
        self.requests = 0

    def registers(self, address: int, count: int) -> list[int] | None:
        """Words from an address; None if there is no such group."""
        load = self.servos.load()
        words = {
            HAND_ID: [self.unit],
            ANGLE_SET: np.rint(self.servos.target).astype(int).tolist(),
            FORCE_SET: self.force_limit,
            SPEED_SET: self.speed,
            ANGLE_ACT: np.rint(self.servos.positions()).astype(int).tolist(),
            FORCE_ACT: np.rint(-load / 2).astype(int).tolist(),
            CURRENT: np.rint(np.minimum(np.abs(load) * 3, 1500)).astype(int).tolist(),
            ERROR: _packed(self.errors),
            STATUS: _packed([2 if abs(x) < 5 else 1 for x in load]),
            TEMP: _packed(self.temperatures),
        }.get(address)
        return None if words is None or count > len(words) else [w & 0xFFFF for w in words[:count]]

    def write(self, address: int, words: list[int]) -> bool:
        """Take words at an address; False if they can't be written."""
        if address == CLEAR_ERROR and words == [1]:
            self.cleared += 1
            self.errors = [0] * 6
            return True
        if len(words) != 6:
            return False
        if address == ANGLE_SET:  # 0xFFFF: this motor keeps its target
            signed = [w - 65536 if w > 32767 else w for w in words]
            self.servos.aim([np.nan if w == -1 else w for w in signed])
        elif address == FORCE_SET:
            self.force_limit = list(words)
        elif address == SPEED_SET:
            self.speed = list(words)
        else:
            return False
        return True

    def answer(self, pdu: bytes) -> bytes | None:
        """The answer to a request, both without frame; None for no answer."""
        self.requests += 1
        if self.faults.delay_s:
            time.sleep(self.faults.delay_s)
        if self.faults.mute:
            return None
        code, address = pdu[0], int.from_bytes(pdu[1:3], "big")
        count = int.from_bytes(pdu[3:5], "big")
        if self.faults.refuse:
            return bytes([code | 0x80, 4])
        if code in (3, 4):
            words = self.registers(address, count)
            if words is None:
                return bytes([code | 0x80, 2])
            if self.faults.garble:  # values that no motor can have
                words = [0x7ABC] * len(words)
            return bytes([code, 2 * len(words)]) + struct.pack(f">{len(words)}H", *words)
        if code == 16:
            words = list(struct.unpack(f">{count}H", pdu[6 : 6 + 2 * count]))
            return pdu[:5] if self.write(address, words) else bytes([code | 0x80, 3])
        return bytes([code | 0x80, 1])


def _packed(values: list[int]) -> list[int]:
    """Six bytes in three words, the first in the low half."""
    return [values[i] | values[i + 1] << 8 for i in range(0, 6, 2)]


class TcpServer:
    """The hand's Modbus TCP server on a free port of this machine."""

    def __init__(self, hand: InspireHand) -> None:
        self.hand = hand
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._connections: list[socket.socket] = []
        self._closed = False
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while not self._closed:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self._connections.append(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        try:
            while True:
                head = _exactly(connection, 7)
                transaction, protocol, length, unit = struct.unpack(">HHHB", head)
                pdu = _exactly(connection, length - 1)
                answer = self.hand.answer(pdu) if protocol == 0 else None
                if answer is not None:
                    connection.sendall(
                        struct.pack(">HHHB", transaction, 0, len(answer) + 1, unit) + answer
                    )
        except (OSError, EOFError):
            connection.close()

    def drop(self) -> None:
        """Cut all connections, as a pulled cable or a restart does."""
        for connection in self._connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()
        self._connections = []

    def close(self) -> None:
        self._closed = True
        self._listener.close()
        self.drop()


def _exactly(connection: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = connection.recv(count - len(data))
        if not more:
            raise EOFError
        data += more
    return data


class Slave(Protocol):
    """A device on a Modbus RTU line."""

    unit: int
    faults: Faults

    def answer(self, pdu: bytes) -> bytes | None:
        """The answer to a request, both without frame; None for no answer."""


class RtuServer:
    """A hand's Modbus RTU port: the far end of a pty."""

    def __init__(self, hand: Slave) -> None:
        self.hand = hand
        self.bad_checksums = 0
        self._data = bytearray()
        self._port = SerialPort(self._serve)
        self.port = self._port.path

    def _serve(self, arrived: bytes) -> None:
        self._data += arrived
        while frame := self._take(self._data):
            if frame[0] != self.hand.unit:
                continue
            answer = self.hand.answer(frame[1:-2])
            if answer is not None:
                reply = bytes([frame[0]]) + answer
                check = crc16(reply) ^ (0xFF if self.hand.faults.garble else 0)
                self._port.write(reply + check.to_bytes(2, "little"))

    def _take(self, data: bytearray) -> bytes:
        """A whole request, taken off the front; empty while there is none."""
        if len(data) < 8:
            return b""
        size = 8 if data[1] in (3, 4, 6) else 9 + data[6]
        if len(data) < size:
            return b""
        frame = bytes(data[:size])
        if int.from_bytes(frame[-2:], "little") != crc16(frame[:-2]):
            self.bad_checksums += 1
            data.clear()  # a real device waits for silence on the line
            return b""
        del data[:size]
        return frame

    def drop(self) -> None:
        """Pull the adapter."""
        self.close()

    def close(self) -> None:
        self._port.close()


def crc16(data: bytes) -> int:
    """The checksum of Modbus RTU, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return value
