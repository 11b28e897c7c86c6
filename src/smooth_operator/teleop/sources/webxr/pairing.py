"""Pairing code: proves that the user of the page sees the operator's terminal."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable
from typing import Final, Literal, TypeAlias

from smooth_operator.errors import ConfigError
from smooth_operator.web.auth import same_secret

Verdict: TypeAlias = Literal["paired", "wrong", "locked"]

DIGITS: Final = 6
WINDOW: Final = 60.0
"""Seconds for which a wrong code is remembered."""
PER_ADDRESS: Final = 5
"""Wrong codes from one address within the window; more are not even looked at."""
IN_ALL: Final = 30
"""The same from all addresses: at this pace half of a million codes take eleven days."""


class Pairing:
    """Compares codes, and does so only so often.

    Args:
        code: letters and digits; a random one of six digits if left out.
        clock: seconds that never go back.

    Raises:
        ConfigError: the code is too short, or holds other characters.
    """

    def __init__(self, code: str | None, clock: Callable[[], float] = time.monotonic) -> None:
        self.code = draw_code() if code is None else plain(code)
        check_code(self.code)
        self.refused = 0
        self._clock = clock
        self._wrong: deque[tuple[float, str]] = deque()

    @property
    def spoken(self) -> str:
        """The code as a person reads it out: in groups of three."""
        return " ".join(self.code[i : i + 3] for i in range(0, len(self.code), 3))

    def check(self, code: str, address: str) -> Verdict:
        """Whether a client at this address may try."""
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


def draw_code() -> str:
    """A random code of six digits."""
    return f"{secrets.randbelow(10**DIGITS):0{DIGITS}}"


def check_code(code: str) -> None:
    """Refuse a code that is too easy to guess, or hard to type.

    Raises:
        ConfigError: saying what a code is made of.
    """
    code = plain(code)
    if not (DIGITS <= len(code) <= 64 and code.isascii() and code.isalnum()):
        raise ConfigError(f"a pairing code is {DIGITS} to 64 letters and digits, not {code!r}")


def plain(code: str) -> str:
    """Without the spaces and dashes that people put in."""
    return "".join(code.split()).replace("-", "").lower()
