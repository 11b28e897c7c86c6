"""Numbers as a reader expects them: a minus sign, no ``-0``, p-values without needless digits."""

from __future__ import annotations

import math
import re

MINUS = "\N{MINUS SIGN}"


def number(value: float | None, digits: int = 2) -> str:
    """A number with so many decimals; a dash where there is none, ∞ for infinity."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    text = f"{value:.{digits}f}"
    if text.startswith("-"):
        text = text[1:] if not text.strip("-0.") else MINUS + text[1:]
    return text


def signed(value: float | None, digits: int = 2) -> str:
    """A number with its sign, + or minus; none for a zero."""
    text = number(value, digits)
    plain = value is None or not math.isfinite(value) or not text.strip("0.")
    return text if plain or text.startswith(MINUS) else f"+{text}"


def span(lower: float | None, upper: float | None, digits: int = 2, *, sign: bool = False) -> str:
    """An interval."""
    shown = signed if sign else number
    return f"{shown(lower, digits)} to {shown(upper, digits)}"


def with_minus(text: str) -> str:
    """A sentence with minus signs for the hyphens of its numbers."""
    return re.sub(r"(?<![\w.,)-])-(?=\d)", MINUS, text)


def p_text(p: float | None) -> str:
    """A p-value as it is printed."""
    if p is None or math.isnan(p):
        return "–"
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def p_said(p: float | None) -> str:
    """``p = 0.012`` or ``p < 0.001``."""
    text = p_text(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"
