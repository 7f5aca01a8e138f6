"""Printed times as integer nanoseconds, exact to their digits.

Floats are avoided throughout: a float of today's epoch resolves 238 ns only. Times of day without a date count from
zero; a date without a zone is taken as UTC, so that a capture reads the same everywhere.
"""

from __future__ import annotations

from datetime import date
from decimal import Decimal, InvalidOperation
from functools import lru_cache
from itertools import pairwise

SECOND = 1_000_000_000
DAY = 86_400 * SECOND
_EPOCH_DAY = date(1970, 1, 1).toordinal()
#: Digits of a number that is a time.
_DIGITS = 24
_POWERS: tuple[int, ...] = tuple(10**n for n in range(10))

#: Nanoseconds of a unit, by how it is printed.
UNITS = {"s": SECOND, "sec": SECOND, "ms": 1_000_000, "us": 1_000, "µs": 1_000, "ns": 1}


def number_ns(text: str, unit: int = SECOND) -> int:
    """Return a printed number of units (nanoseconds each) as nanoseconds; what is finer than 1 ns is cut off.

    Raises ValueError for what is no number.
    """
    whole, _, fraction = text.partition(".")
    if unit == SECOND and len(fraction) <= 9 and len(whole) <= _DIGITS and whole.isdecimal():
        if not fraction:
            return int(whole) * SECOND
        if fraction.isdecimal():
            return int(whole) * SECOND + int(fraction) * _POWERS[9 - len(fraction)]
    if len(text) > 4 * _DIGITS:
        raise ValueError(f"expected a time, got {text[:_DIGITS]}...")
    try:
        value = Decimal(text) * unit
        if not value.is_finite() or value.adjusted() > _DIGITS:
            raise ValueError(f"expected a time, got {text}")
        return int(value)
    except InvalidOperation:
        raise ValueError(f"expected a time, got {text!r}") from None


@lru_cache(maxsize=64)
def day_ns(year: int, month: int, day: int) -> int:
    """Return the start of a day since the epoch. Raises ValueError for a day that is none."""
    return (date(year, month, day).toordinal() - _EPOCH_DAY) * DAY


def clock_ns(hour: str, minute: str, second: str, fraction: str | None) -> int:
    """Return a time of day. Raises ValueError for one that is none."""
    h, m, s = int(hour), int(minute), int(second)
    if h > 24 or m > 59 or s > 60:
        raise ValueError(f"expected a time of day, got {hour}:{minute}:{second}")
    whole = ((h * 60 + m) * 60 + s) * SECOND
    return whole + int((fraction or "")[:9].ljust(9, "0"))


def zone_ns(zone: str | None) -> int:
    """Return what a printed zone (`Z`, `+02:00`, `-0530`) adds to UTC."""
    if not zone or zone in "Zz":
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    offset = (int(digits[:2]) * 60 + int(digits[2:4])) * 60 * SECOND
    return -offset if zone[0] == "-" else offset


class DayCount:
    """Adds a day to times of day each time they pass midnight."""

    def __init__(self) -> None:
        self._days = 0
        self._last = 0

    def __call__(self, clock: int) -> int:
        """Return a time of day as time since the first midnight."""
        # A step back of less than half a day is disorder in the capture, not midnight.
        if self._last - clock > DAY // 2:
            self._days += 1
        self._last = clock
        return self._days * DAY + clock


class Deltas:
    """Sums times that are each counted from the one before."""

    def __init__(self) -> None:
        self._sum = 0

    def __call__(self, delta: int) -> int:
        """Return a delta as time since the first."""
        self._sum += delta
        return self._sum


def falls(values: list[int]) -> bool:
    """Say whether a row of times goes back anywhere: then they are deltas, not times since a start."""
    return any(b < a for a, b in pairwise(values))
