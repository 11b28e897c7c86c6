"""A bus of Feetech servos: packets as in Dynamixel's protocol 1, words in the order of the series.

Facts, by the maker: packets, instructions, byte order and signs from ``ftservo-python-sdk`` 2.0.1
(``scservo_sdk``). That the SCS0009 does not answer a sync read, and the model numbers, are from
LeRobot (``motors/feetech/tables.py``). The SDK itself is not used: it waits in a loop without
sleep, at least 50 ms for an answer that is missing.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from smooth_operator.errors import SinkError
from smooth_operator_devices.hands.actuator_map import UNITS
from smooth_operator_devices.hands.device import WrongAnswerError
from smooth_operator_devices.hands.drivers.servo_bank import TRIES, ServoBus, open_port

_READ, _SYNC_READ, _SYNC_WRITE, _BROADCAST = 0x02, 0x82, 0x83, 0xFE
_MODEL: Final = (3, 5)
"""Address and bytes; the model's number is in the first two. An answer of five bytes is longer than
the question, so an adapter that returns what it sends does no harm."""


@dataclass(frozen=True)
class Series:
    """Registers of one series.

    Attributes:
        per_radian: steps in a radian.
        order: order of the bytes in a word.
        sync_read: True if several servos can be asked in one packet.
        torque_limit: True if the servo has a volatile limit of torque.
    """

    per_radian: float
    order: Literal["big", "little"]
    sync_read: bool
    torque_limit: bool


SERIES: Final[Mapping[str, Series]] = {
    "scs": Series(UNITS["scs_step"], "big", False, False),
    "sts": Series(UNITS["step"], "little", True, True),
}
MODELS: Final[Mapping[int, str]] = {0x0504: "scs", 0x0405: "scs", 0x0903: "sts"}
"""The two bytes of the model's number -> series: 1284 for the SCS0009, whose order of bytes here no
text states; 777 for the STS3215."""


class FeetechBus(ServoBus):
    """The servos of one port; see ``ServoBus``."""

    _answer_s = 0.0
    series: Series

    def open(self, series: str | None) -> None:
        """Open the port, and check that every servo answers and is of the same series.

        Args:
            series: series of all servos; None to find it by their model numbers.

        Raises:
            SinkError: the port can't be opened, or servos do not answer or are of another series.
        """
        self._line, answer_ms = open_port(self.port, self.baud)
        self._answer_s = 1e-3 * answer_ms
        models = range(0x10000) if series else list(MODELS)
        expected = "SCS0009 or STS3215 (1284 or 777); for another servo set series=scs or sts"
        found = {series or MODELS[number] for number in self._find(models, expected)}
        if len(found) > 1:
            raise SinkError(f"{self.port}: the servos are of both series, SCS and STS")
        self.series = SERIES[found.pop()]

    def close(self) -> None:
        """Give the port back; a second call does nothing."""
        line, self._line = self._line, None
        if line is not None:
            with contextlib.suppress(Exception):  # it may be unplugged
                line.flush()
                line.close()

    def set(self, address: int, rows: Sequence[bytes], ids: Sequence[int] | None = None) -> None:
        """Write registers of servos, in one packet that is not answered."""
        pairs = zip(self.ids if ids is None else ids, rows, strict=True)
        data = b"".join(bytes([number]) + row for number, row in pairs)
        self._send(_BROADCAST, _SYNC_WRITE, bytes([address, len(rows[0])]) + data)

    def get(self, address: int, size: int) -> list[bytes]:
        """Read registers of all servos: the error byte and the registers.

        Raises:
            WrongAnswerError: a servo gives no valid answer in time.
            DeviceLostError: the port is gone.
        """
        where = bytes([address, size])
        with self._lost():
            if self.series.sync_read:
                self._open().reset_input_buffer()  # answers that came too late
                self._send(_BROADCAST, _SYNC_READ, where + bytes(self.ids))
                found = self._answers(self.ids, size)
            else:
                found = {}
                for number in self.ids:
                    found |= self._ask(number, address, size)
        for number, name in zip(self.ids, self.names, strict=True):
            if number not in found:
                raise WrongAnswerError(f"{self.port}: no valid answer from servo {number} ({name})")
        return [found[number] for number in self.ids]

    def word(self, value: int) -> bytes:
        """A number as a word, with its sign in bit 15."""
        return (abs(value) | (0x8000 if value < 0 else 0)).to_bytes(2, self.series.order)

    def number(self, word: bytes, sign: int = 15) -> int:
        """The number in a word, with its sign in a bit."""
        value = int.from_bytes(word, self.series.order)
        size = value & ((1 << sign) - 1)
        return -size if value >> sign & 1 else size

    def _model(self, number: int) -> int | None:
        with self._lost():
            for _ in range(TRIES):
                if row := self._ask(number, *_MODEL):
                    return int.from_bytes(row[number][1:3], "big")
        return None

    def _ask(self, number: int, address: int, size: int) -> dict[int, bytes]:
        self._open().reset_input_buffer()
        self._send(number, _READ, bytes([address, size]))
        return self._answers([number], size)

    def _send(self, number: int, instruction: int, parameters: bytes) -> None:
        body = bytes([number, len(parameters) + 2, instruction]) + parameters
        with self._lost():
            self._open().write(b"\xff\xff" + body + bytes([~sum(body) & 0xFF]))

    def _answers(self, ids: Sequence[int], size: int) -> dict[int, bytes]:
        """Answers of servos by their id; everything else on the line is skipped."""
        line, length = self._open(), size + 6
        end = time.perf_counter() + self._answer_s + 10 * len(ids) * (length + 8) / self.baud
        data, found = b"", dict[int, bytes]()
        while len(found) < len(ids) and time.perf_counter() < end:
            data += line.read(max(1, line.in_waiting))
            while (start := data.find(b"\xff\xff")) >= 0 and len(data) >= start + length:
                packet = data[start : start + length]
                right = packet[3] == size + 2 and ~sum(packet[2:-1]) & 0xFF == packet[-1]
                if right and packet[2] in ids:
                    found[packet[2]] = packet[4:-1]
                data = data[start + (length if right else 1) :]
        return found
