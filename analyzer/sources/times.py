"""Printed times as integer nanoseconds, exact to their digits, and the times of `--since` and `--until`.

Floats are avoided throughout: a float of today's epoch resolves 238 ns only. Times of day without a date count from
zero; a date without a zone is taken as UTC, so that a capture reads the same everywhere.

    2026-11-21T16:22:11Z  2026-11-21T16:22:11.5+01:00  2026-11-21     a time; without a zone it is as times are shown
    09:00:05  09:00:05.123                                           a time of day of the recording, as it is shown
    43384.123                                                        seconds on the recording's own clock
    5s  +10s  +1.5min  +2h  +1:30                                    from the start of the recording
    -5min  -1:30                                                     before its end
"""

from __future__ import annotations

import re
import time
from datetime import date
from decimal import Decimal, InvalidOperation
from enum import StrEnum
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

from analyzer.errors import UsageError
from analyzer.values import SECOND_NS, quote

DAY = 86_400 * SECOND_NS
_EPOCH_DAY = date(1970, 1, 1).toordinal()
#: Times between these are of the epoch; others count from a beginning of their own.
DATED = 365 * DAY, 7 * 10**18
#: Digits of a number that is a time.
_DIGITS = 24
_POWERS: tuple[int, ...] = tuple(10**n for n in range(10))

#: How the time source of a capture without times begins, in words; that of a log made of it has a prefix.
ESTIMATED = "timestamps estimated"

#: Nanoseconds of a unit, by how it is printed.
UNITS = {"s": SECOND_NS, "sec": SECOND_NS, "ms": 1_000_000, "us": 1_000, "µs": 1_000, "μs": 1_000, "ns": 1}


def number_ns(text: str, unit: int = SECOND_NS) -> int:
    """Return a printed number of units (nanoseconds each) as nanoseconds; what is finer than 1 ns is cut off.

    Raises ValueError for any other text.
    """
    whole, _, fraction = text.partition(".")
    if unit == SECOND_NS and len(fraction) <= 9 and len(whole) <= _DIGITS and whole.isdecimal():
        if not fraction:
            return int(whole) * SECOND_NS
        if fraction.isdecimal():
            return int(whole) * SECOND_NS + int(fraction) * _POWERS[9 - len(fraction)]
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
    whole = ((h * 60 + m) * 60 + s) * SECOND_NS
    return whole + int((fraction or "")[:9].ljust(9, "0"))


def zone_ns(zone: str | None) -> int:
    """Return what a printed zone (`Z`, `+02:00`, `-0530`) adds to UTC."""
    if not zone or zone in "Zz":
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    offset = (int(digits[:2]) * 60 + int(digits[2:4])) * 60 * SECOND_NS
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

_OPTION_UNITS = UNITS | {"min": 60 * SECOND_NS, "h": 3600 * SECOND_NS, "d": DAY}
_NUMBER = r"(?P<number>\d{1,12}(?:\.\d{1,9})?)"
_RELATIVE = re.compile(rf"(?P<sign>[+-]?){_NUMBER}(?P<unit>ms|s|sec|min|h|d)?")
_MINUTES = re.compile(r"(?P<sign>[+-])(?:(?P<hour>\d{1,4}):)?(?P<minute>\d{1,4}):(?P<second>\d\d)(?:\.(?P<fraction>\d{1,9}))?")
_OF_DAY = re.compile(r"(?P<hour>\d\d):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:\.(?P<fraction>\d{1,9}))?)?")
_ISO = re.compile(
    r"(?P<year>\d{4})-(?P<month>\d\d)-(?P<day>\d\d)"
    r"(?:[T ](?P<hour>\d\d):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:\.(?P<fraction>\d{1,9}))?)?(?P<zone>Z|[+-]\d\d:?\d\d)?)?"
)


class Clock(StrEnum):
    """What the times of a capture are.

    `UTC`: since the epoch; those of the first year are seconds since some beginning. `PRINTED`: dates as the capture has them,
    without a zone. `DAY`: times of day without a date.
    """

    UTC = "utc"
    PRINTED = "printed"
    DAY = "day"


def is_dated(t_ns: int) -> bool:
    """Say whether a time is of the epoch, and not since some beginning."""
    return DATED[0] < t_ns < DATED[1]


def is_estimated(time_source: str) -> bool:
    """Say whether times were made up, since the capture has none."""
    return time_source.removeprefix("log: ").startswith(ESTIMATED)


class ShownTime:
    """Shows the times of a recording: in the local zone (TZ), in UTC, or as a capture without a zone printed them."""

    def __init__(self, clock: Clock = Clock.UTC, *, utc: bool = False) -> None:
        self._clock = clock
        self._utc = utc
        self._day = -1

    def zone_ns(self, t_ns: int) -> int:
        """Return what is added to a time to show it."""
        if self._utc or self._clock is not Clock.UTC or not is_dated(t_ns):
            return 0
        return time.localtime(t_ns // SECOND_NS).tm_gmtoff * SECOND_NS

    def by_clock(self, t_ns: int) -> bool:
        """Say whether a time has a date, or is at least a time of day."""
        return self._clock is Clock.DAY or is_dated(t_ns)

    @property
    def zone(self) -> str:
        """Which zone it shows, for a heading: `UTC`, `local`, or nothing where the capture has none."""
        if self._clock is not Clock.UTC:
            return ""
        return "UTC" if self._utc or time.localtime().tm_zone == "UTC" else "local"

    def text(self, t_ns: int) -> str:
        """Return a time in 15 characters: of day to the microsecond, or seconds since some beginning."""
        if not self.by_clock(t_ns):
            return f"{t_ns / SECOND_NS:15.6f}"
        seconds, rest = divmod(t_ns + self.zone_ns(t_ns), SECOND_NS)
        minutes, second = divmod(seconds, 60)
        return f"{minutes // 60 % 24:02d}:{minutes % 60:02d}:{second:02d}.{rest // 1000:06d}"

    def iso(self, t_ns: int) -> str:
        """Return a time that has a date as ISO 8601, exact to the nanosecond, with the zone where there is one."""
        zone_ns = self.zone_ns(t_ns)
        text = iso(t_ns + zone_ns).removesuffix("Z")
        if self._clock is Clock.PRINTED:
            return text
        minutes = abs(zone_ns) // (60 * SECOND_NS)
        return text + (f"{'-' if zone_ns < 0 else '+'}{minutes // 60:02d}:{minutes % 60:02d}" if zone_ns else "Z")

    def new_date(self, t_ns: int) -> str:
        """Return the date and the zone where it is another one than at the last call; of a time without a date its number."""
        if self._clock is not Clock.DAY and not is_dated(t_ns):
            return ""
        zone_ns = self.zone_ns(t_ns)
        day = (t_ns + zone_ns) // DAY
        known, self._day = self._day, day
        if day == known:
            return ""
        if self._clock is Clock.DAY:
            return f"day {day + 1}" if day else ""
        return f"{date.fromordinal(day + _EPOCH_DAY).isoformat()} {self._zone(t_ns, zone_ns)}".rstrip()

    def _zone(self, t_ns: int, zone_ns: int) -> str:
        if self._clock is Clock.PRINTED:
            return ""
        if not zone_ns:
            return "UTC"
        hours, minutes = divmod(abs(zone_ns) // (60 * SECOND_NS), 60)
        return f"{time.localtime(t_ns // SECOND_NS).tm_zone} (UTC{'-' if zone_ns < 0 else '+'}{hours:02d}:{minutes:02d})"


class Anchor(StrEnum):
    """What a time of a user counts from: the clock itself, the date or the day as shown, the start or the end."""

    CLOCK = "clock"
    SHOWN = "shown"
    DAY = "day"
    START = "start"
    END = "end"


class TimeOption(NamedTuple):
    """A time that a user wrote. `ns` counts from `anchor`. `text`: as it was written."""

    anchor: Anchor
    ns: int
    text: str

    def resolve(self, start_ns: int, end_ns: int, shown: ShownTime) -> int:
        """Return it on the clock of a recording that lasts from `start_ns` to `end_ns`, and is shown so."""
        if self.anchor is Anchor.SHOWN:
            return self.ns - shown.zone_ns(self.ns - shown.zone_ns(self.ns))
        if self.anchor is Anchor.DAY:
            zone_ns = shown.zone_ns(start_ns)
            t_ns = (start_ns + zone_ns) // DAY * DAY + self.ns - zone_ns
            # Half a day before the start is meant as the day after it.
            return t_ns + DAY if t_ns < start_ns - DAY // 2 else t_ns
        return self.ns + {Anchor.CLOCK: 0, Anchor.START: start_ns, Anchor.END: end_ns}[self.anchor]


def parse_time(text: str) -> TimeOption:
    """Return the time that a text means. Raises UsageError for any other text."""
    try:
        found = _relative(text) or _absolute(text)
    except ValueError:
        found = None
    if found is None:
        known = "2026-11-21T16:22:11Z, 09:00:05, +10s (from the start) or -5min (from the end)"
        raise UsageError(f"{quote(text)} is not a time, expected {known}")
    return TimeOption(*found, text)


def _relative(text: str) -> tuple[Anchor, int] | None:
    """Return a time that counts from the start or the end, or is a number of the clock itself."""
    if (match := _RELATIVE.fullmatch(text)) is not None:
        if not match["sign"] and not match["unit"]:
            return Anchor.CLOCK, number_ns(match["number"])
        ns = number_ns(match["number"], _OPTION_UNITS[match["unit"] or "s"])
    elif (match := _MINUTES.fullmatch(text)) is not None:
        seconds = (int(match["hour"] or 0) * 60 + int(match["minute"])) * 60
        ns = seconds * SECOND_NS + clock_ns("0", "0", match["second"], match["fraction"])
    else:
        return None
    return (Anchor.END, -ns) if match["sign"] == "-" else (Anchor.START, ns)


def _absolute(text: str) -> tuple[Anchor, int] | None:
    if (match := _OF_DAY.fullmatch(text)) is not None:
        return Anchor.DAY, clock_ns(match["hour"], match["minute"], match["second"] or "0", match["fraction"])
    match = _ISO.fullmatch(text)
    if match is None:
        return None
    ns = day_ns(int(match["year"]), int(match["month"]), int(match["day"]))
    if match["hour"] is not None:
        ns += clock_ns(match["hour"], match["minute"], match["second"] or "0", match["fraction"])
    return (Anchor.CLOCK, ns - zone_ns(match["zone"])) if match["zone"] else (Anchor.SHOWN, ns)


def iso(t_ns: int) -> str:
    """Return a time since the epoch as text in UTC, exact to the nanosecond."""
    seconds, rest = divmod(t_ns, SECOND_NS)
    try:
        day = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    except (OverflowError, ValueError, OSError):
        return f"{seconds}.{rest:09d} s"
    return f"{day}.{rest:09d}Z"
