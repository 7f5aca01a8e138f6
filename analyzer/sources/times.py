"""Printed times as integer nanoseconds, exact to their digits, and the times of `--since` and `--until`.

Floats are avoided throughout: a float of today's epoch resolves 238 ns only. Times of day without a date count from
zero; a date without a zone is taken as UTC, so that a capture reads the same everywhere.

    2026-11-21T16:22:11Z  2026-11-21T16:22:11.5+01:00  2026-11-21     a time; without a zone it is UTC
    +10s  +1.5min  +2h                                               from the start of the recording
    -5min                                                            before its end
"""

from __future__ import annotations

import re
import time
from datetime import date
from decimal import Decimal, InvalidOperation
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

from analyzer.errors import UsageError
from analyzer.values import quote

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

    Raises ValueError for any other text.
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
    """Return the start of a day since the epoch. Raises ValueError for a day that does not exist."""
    return (date(year, month, day).toordinal() - _EPOCH_DAY) * DAY


def clock_ns(hour: str, minute: str, second: str, fraction: str | None) -> int:
    """Return a time of day. Raises ValueError for an impossible one."""
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
    """Say whether times run backwards anywhere: then they are deltas, not times since a start."""
    return any(b < a for a, b in pairwise(values))


# --- options ------------------------------------------------------------------------------------------------------------

_OPTION_UNITS = {"ms": 1_000_000, "s": SECOND, "sec": SECOND, "min": 60 * SECOND, "h": 3600 * SECOND, "d": 86_400 * SECOND}
_RELATIVE = re.compile(r"(?P<sign>[+-])(?P<number>\d{1,12}(?:\.\d{1,9})?)(?P<unit>ms|s|sec|min|h|d)?")
_ISO = re.compile(
    r"(?P<year>\d{4})-(?P<month>\d\d)-(?P<day>\d\d)"
    r"(?:[T ](?P<hour>\d\d):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:\.(?P<fraction>\d{1,9}))?)?(?P<zone>Z|[+-]\d\d:?\d\d)?)?"
)


class TimeOption(NamedTuple):
    """A time that a user wrote. `ns` counts from `anchor`: `utc`, `start` or `end`. `text`: as it was written."""

    anchor: str
    ns: int
    text: str

    def resolve(self, start_ns: int, end_ns: int) -> int:
        """Return it on the clock of a recording that lasts from `start_ns` to `end_ns`."""
        return self.ns + {"utc": 0, "start": start_ns, "end": end_ns}[self.anchor]


def parse_time(text: str) -> TimeOption:
    """Return the time that a text means. Raises UsageError for any other text."""
    relative = _RELATIVE.fullmatch(text)
    if relative is not None:
        ns = number_ns(relative["number"], _OPTION_UNITS[relative["unit"] or "s"])
        return TimeOption("start", ns, text) if relative["sign"] == "+" else TimeOption("end", -ns, text)
    match = _ISO.fullmatch(text)
    try:
        if match is None:
            raise ValueError
        ns = day_ns(int(match["year"]), int(match["month"]), int(match["day"]))
        if match["hour"] is not None:
            ns += clock_ns(match["hour"], match["minute"], match["second"] or "0", match["fraction"])
            ns -= zone_ns(match["zone"])
    except ValueError:
        raise UsageError(
            f"{quote(text)} is not a time, expected 2026-11-21T16:22:11Z, +10s (from the start) or -5min (from the end)"
        ) from None
    return TimeOption("utc", ns, text)


def iso(t_ns: int) -> str:
    """Return a time since the epoch as text in UTC, exact to the nanosecond."""
    seconds, rest = divmod(t_ns, SECOND)
    try:
        day = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    except (OverflowError, ValueError, OSError):
        return f"{seconds}.{rest:09d} s"
    return f"{day}.{rest:09d}Z"
