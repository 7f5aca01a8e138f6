"""Moments as people write them: `--since` and `--until`.

    2026-11-21T16:22:11Z  2026-11-21T16:22:11.5+01:00  2026-11-21     a time of day; without a zone it is UTC
    +10s  +1.5min  +2h                                               from the start of the recording
    -5min                                                            from its end

Integer nanoseconds; nothing here knows a recording.
"""

from __future__ import annotations

import re
import time
from typing import NamedTuple

from analyzer.errors import UsageError
from analyzer.sources.times import SECOND, clock_ns, day_ns, number_ns, zone_ns
from analyzer.values import quote

_UNITS = {"ms": 1_000_000, "s": SECOND, "sec": SECOND, "min": 60 * SECOND, "h": 3600 * SECOND, "d": 86_400 * SECOND}
_RELATIVE = re.compile(r"(?P<sign>[+-])(?P<number>\d{1,12}(?:\.\d{1,9})?)(?P<unit>ms|s|sec|min|h|d)?")
_ISO = re.compile(
    r"(?P<year>\d{4})-(?P<month>\d\d)-(?P<day>\d\d)"
    r"(?:[T ](?P<hour>\d\d):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:\.(?P<fraction>\d{1,9}))?)?(?P<zone>Z|[+-]\d\d:?\d\d)?)?"
)


class Moment(NamedTuple):
    """A moment. `anchor`: `utc`, `start` or `end`: what `ns` counts from; `text`: as it was written."""

    anchor: str
    ns: int
    text: str

    def resolve(self, start_ns: int, end_ns: int) -> int:
        """Return it on the clock of a recording that lasts from `start_ns` to `end_ns`."""
        return self.ns + {"utc": 0, "start": start_ns, "end": end_ns}[self.anchor]


def parse(text: str) -> Moment:
    """Return a moment as it was written. Raises UsageError for what is none."""
    relative = _RELATIVE.fullmatch(text)
    if relative is not None:
        ns = number_ns(relative["number"], _UNITS[relative["unit"] or "s"])
        return Moment("start", ns, text) if relative["sign"] == "+" else Moment("end", -ns, text)
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
            f"{quote(text)} is no moment, expected 2026-11-21T16:22:11Z, +10s (from the start) or -5min (from the end)"
        ) from None
    return Moment("utc", ns, text)


def iso(t_ns: int) -> str:
    """Return a time since the epoch as text in UTC, exact to the nanosecond."""
    seconds, rest = divmod(t_ns, SECOND)
    try:
        day = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    except (OverflowError, ValueError, OSError):
        return f"{seconds}.{rest:09d} s"
    return f"{day}.{rest:09d}Z"
