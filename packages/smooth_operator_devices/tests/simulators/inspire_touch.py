"""An Inspire RH56DFTP hand with touch cells, on Modbus TCP or RTU.

Sources:

- User manual "RH56DFTP R1", HWK V1.0.0 (maker: Inspire Robots), in github.com/laurent-19/
  inspire_hand_ws, commit c246b938 (2026-04-29), `inspire_R1/`: chapters 2.5 (frames) and 2.6
  (registers, ranges, units, order, fault bits, touch).
- `inspire_hand_sdk/inspire_sdkpy/{inspire_sdk,inspire_hand_defaut}.py` there (maker of the SDK:
  Unitree): addresses and shapes of the touch data, status codes, calls.

Facts: TCP port 6000; functions 3, 6 (not here) and 16. **Addresses count bytes**: six
shorts from 1546 end at 1557, and one register of Modbus covers two addresses. Order: little, ring,
middle, index, thumb bending, thumb rotation. Angle 0 to 1000 (1000 is open), -1 leaves a finger as
it is. At speed 1000 a finger needs 0.6 s for its range.
Force in grams, threshold 0 to 3000; current in mA; faults: bit 0 stall, 1 heat, 2 current, 3 motor,
4 communication; clearing (1004) does not clear heat, which goes by itself. Touch cells: a word
each; per finger 3 x 3, 12 x 8 and 10 x 8 (thumb: 3 x 3, 12 x 8, 3 x 3, 12 x 8), by rows; palm 8
rows of 14, by columns, and each column from its eighth row to its first.

The transaction number of an answer is that of its request, says the manual. Users have met hands
whose answers carry another number: `transaction_shift`.

Not found: which half of a register is the first of two bytes (faults, status and temperature at
1606 to 1623). The manual's words are low byte first, and a 1 written to 1004 clears faults, so the
first byte is the low half here; Unitree's SDK takes the high half. Neither
found: defaults of speed and force at power on (here 1000), largest value of a cell (here 4095),
what an address outside the table brings (here error 2), the number of clients (here any), and what
happens to a client that never reads its answers.
"""

from __future__ import annotations

import contextlib
import socket
import socketserver
import struct
import threading

import numpy as np

from .common import Faults, Motors
from .modbus_rtu import RtuDevice

FINGERS = ("little", "ring", "middle", "index", "thumb_bend", "thumb_rotation")
_FINGER = {"tip": (0, (3, 3)), "nail": (18, (12, 8)), "pad": (210, (10, 8))}
_THUMB = {"tip": (0, (3, 3)), "nail": (18, (12, 8)), "middle": (210, (3, 3)), "pad": (228, (12, 8))}
TOUCH = {  # name: byte address, shape
    **{
        (finger, part): (start + offset, shape)
        for finger, start in (("little", 3000), ("ring", 3370), ("middle", 3740), ("index", 4110))
        for part, (offset, shape) in _FINGER.items()
    },
    **{("thumb", part): (4480 + offset, shape) for part, (offset, shape) in _THUMB.items()},
    ("palm", "palm"): (4900, (8, 14)),
}
RELEASING, GRASPING, REACHED, FORCE_REACHED, OVER_CURRENT, STALLED, FAULT = 0, 1, 2, 3, 5, 6, 7
_RANGES = (range(1000, 1056), range(1474, 1624), range(1700, 1704), range(3000, 5124))


class InspireTouchHand:
    """A simulated Inspire hand with touch cells, a TCP server on the loopback; angles 0 to 1000."""

    def __init__(self) -> None:
        self.transaction_shift = 0
        self.faults = Faults("unit", "short")
        self.motors = Motors(np.full(6, 1000.0), 1000 / 0.6)
        self.errors = np.zeros(6, dtype=int)
        self.forces = np.zeros(6, dtype=int)
        self.touch = {name: np.zeros(shape, dtype=int) for name, (_, shape) in TOUCH.items()}
        self.received: list[bytes] = []
        self._memory = bytearray(6000)
        self._clients: list[socket.socket] = []
        for i in range(6):
            self._put(1032 + 2 * i, 1000)
            self._put(1044 + 2 * i, 1000)
        self._memory[1000] = 1
        self.reboot()
        self._server: socketserver.ThreadingTCPServer | None = None

    def reboot(self) -> None:
        """Switch the hand off and on: speeds and thresholds at their stored defaults."""
        for i in range(6):
            self._put(1498 + 2 * i, self.word(1044 + 2 * i))
            self._put(1522 + 2 * i, self.word(1032 + 2 * i))
            self.motors.set_speed(i, self.word(1522 + 2 * i) / 0.6)
        self.errors[:] = 0
        self.motors.place(self.motors.positions)
        for i, position in enumerate(self.motors.positions):
            self._put(1486 + 2 * i, round(position))

    def __enter__(self) -> InspireTouchHand:
        hand = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                hand._clients.append(self.request)
                buffer = b""
                while True:
                    try:
                        data = self.request.recv(4096)
                    except OSError:
                        return
                    if not data:
                        return
                    buffer += data
                    while len(buffer) >= 6 and len(buffer) >= 6 + (
                        n := int.from_bytes(buffer[4:6])
                    ):
                        request, buffer = buffer[: 6 + n], buffer[6 + n :]
                        answer = hand.receive(request)
                        if answer:
                            self.request.sendall(answer)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = True
            daemon_threads = True

            def handle_error(self, request: object, client_address: object) -> None:
                pass  # the client went away

        self._server = Server(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.02,), daemon=True
        )
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.shutdown()
        self.hang_up()
        self._server.server_close()
        self._thread.join()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of the server."""
        assert self._server is not None
        return self._server.server_address[:2]  # type: ignore[return-value]

    def hang_up(self) -> None:
        """Close all connections, as a pulled cable that is put in again."""
        for client in self._clients:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)
            client.close()
        self._clients.clear()

    def word(self, address: int) -> int:
        """The signed short at a byte address."""
        return int.from_bytes(self._memory[address : address + 2], "little", signed=True)

    def _put(self, address: int, value: int) -> None:
        self._memory[address : address + 2] = (value & 0xFFFF).to_bytes(2, "little")

    def receive(self, request: bytes) -> bytes:
        """Answer one request."""
        if self.faults.silent or len(request) < 8:
            return b""
        self.received.append(request)
        transaction, _, _, unit = struct.unpack(">HHHB", request[:7])
        body = self.answer(request[7], request[8:])
        wrong = self.faults.next_wrong()
        transaction = (transaction + self.transaction_shift) & 0xFFFF
        unit = (unit + 1) & 0xFF if wrong == "unit" else unit
        answer = struct.pack(">HHHB", transaction, 0, len(body) + 1, unit) + body
        return answer[:-3] if wrong == "short" else answer

    def answer(self, function: int, body: bytes) -> bytes:
        """Function code and data that answer a request."""
        if function not in (3, 16) or len(body) < 4:
            return bytes([function | 0x80, 1])
        address, count = struct.unpack(">HH", body[:4])
        if function == 3:
            if not 1 <= count <= 125:
                return bytes([0x83, 3])
            if not self._known(address, count):
                return bytes([0x83, 2])
            self._refresh()
            registers = [
                int.from_bytes(self._memory[address + 2 * i : address + 2 * i + 2], "little")
                for i in range(count)
            ]
            return bytes([3, 2 * count]) + struct.pack(f">{count}H", *registers)
        if not self._known(address, count):
            return bytes([function | 0x80, 2])
        for i, value in enumerate(struct.unpack(f">{count}H", body[5:])):
            self._write(address + 2 * i, value)
        return bytes([function]) + body[:4]

    def _known(self, address: int, count: int) -> bool:
        return any(address in r and address + 2 * count - 1 in r for r in _RANGES)

    def _write(self, address: int, value: int) -> None:
        if 1534 <= address < 1624 or address >= 3000:
            return
        if address == 1004:
            self.errors &= 2
            return
        self._put(address, value)
        signed = value - 0x10000 if value & 0x8000 else value
        finger = (address - 1486) // 2
        if 1486 <= address < 1498 and 0 <= signed <= 1000:
            self.motors.move([signed], [finger])
        if 1522 <= address < 1534:
            self.motors.set_speed((address - 1522) // 2, signed / 0.6)

    def _refresh(self) -> None:
        motors = self.motors
        self.errors = np.where(motors.temperatures > 70, self.errors | 2, self.errors & ~2)
        pressed = [
            force >= self.word(1498 + 2 * i) > 0 and motors.targets[i] < motors.positions[i]
            for i, force in enumerate(self.forces)
        ]
        for i in range(6):
            motors.set_power(not (self.errors[i] or pressed[i]), [i])
        positions, currents = motors.positions, motors.currents
        status = []
        for i in range(6):
            away = motors.targets[i] - positions[i]
            if self.errors[i]:
                status.append(OVER_CURRENT if self.errors[i] == 4 else FAULT)
            elif pressed[i]:
                status.append(FORCE_REACHED)
            elif abs(away) < 0.5:
                status.append(REACHED)
            elif i in motors.stuck:
                status.append(STALLED)
            else:
                status.append(RELEASING if away > 0 else GRASPING)
            self._put(1546 + 2 * i, round(positions[i]))
            self._put(1582 + 2 * i, int(self.forces[i]))
            self._put(1594 + 2 * i, round(currents[i]))
        for start, values in ((1606, self.errors), (1612, status), (1618, motors.temperatures)):
            data = bytes(int(value) for value in values)
            self._memory[start : start + 6] = data
        for name, (address, _) in TOUCH.items():
            cells = self.touch[name]
            if name[0] == "palm":
                cells = cells[::-1].T
            self._memory[address : address + 2 * cells.size] = cells.astype("<u2").tobytes()


class InspireSerialHand(RtuDevice, InspireTouchHand):
    """The same hand on a serial line: ``with SerialLine(InspireSerialHand()) as line``."""

    node = 1

    def __init__(self) -> None:
        super().__init__()
        self.faults = Faults(*self.WRONG)
