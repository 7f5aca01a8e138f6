"""Printed times in front of a line or in a column of their own: one table of patterns, and what they mean in their order.

    2024-03-05 12:00:00.120   2024-03-05T12:00:00Z   05.03.2024 12:00:00   05.03.24 12:00:00   3/5/2024 12:00:00
    Mar  5 12:00:00   12:00:00.120   12:00:00:120   +0.012   0.012   12.5 ms   1500us   1709640000120

Rules: exact to their digits. Without a date they count from zero, and a time of day that passes midnight goes on. `+0.012`
counts from the start, or from the line before where the values go back. `3/5/2024` has the month first, unless a day above 12
or a later date on the first place shows otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

from analyzer.sources.source import Source
from analyzer.sources.times import UNITS, Clock, DayCount, Deltas, clock_ns, day_ns, falls, number_ns, zone_ns

_DAYTIME = r"\d{1,2}:\d\d:\d\d(?:[.,:]\d{1,9})?(?:\s?[AaPp][Mm]\b)?"
_UNIT = r"(?:\s?(?:ms|us|µs|ns|sec|s)(?![0-9A-Za-z]))"
_MONTH = r"(?:Jan|Feb|Mar|Apr|May|Jun|Jul|Aug|Sep|Oct|Nov|Dec)"
#: Times by kind, each a pattern; the first that fits wins.
STAMPS: dict[str, str] = {
    "date": rf"\d{{4}}[-/.]\d{{1,2}}[-/.]\d{{1,2}}(?:[T_,]|\s){{1,2}}{_DAYTIME}(?:\s?Z\b|\s?[+-]\d\d:?\d\d\b)?",
    "dmy": rf"(?:\d{{1,2}}\.\d{{1,2}}\.\d{{4}}|(?:0[1-9]|[12]\d|3[01])\.(?:0[1-9]|1[0-2])\.\d\d)(?:[T_,]|\s){{1,2}}{_DAYTIME}",
    "slashed": rf"\d{{1,2}}/\d{{1,2}}/\d{{4}}(?:[T_,]|\s){{1,2}}{_DAYTIME}",
    "month": rf"(?:{_MONTH}\s+\d{{1,2}}|\d{{1,2}}\s+{_MONTH})\s+{_DAYTIME}",
    "clock": _DAYTIME,
    "step": rf"\+\s{{0,8}}\d{{1,19}}(?:\.\d{{1,12}}{_UNIT}?|{_UNIT})",
    "seconds": rf"\d{{1,19}}\.\d{{1,12}}{_UNIT}?",
    "units": rf"\d{{1,19}}{_UNIT}",
    "epoch_ms": r"\d{13}",
    "epoch_s": r"1[4-9]\d{8}",
}
ANY = "|".join(f"(?P<{kind}>{pattern})" for kind, pattern in STAMPS.items())
#: Those that nothing else looks like, wherever they stand.
DAYS = "(?:" + "|".join(f"(?P<{kind}>{STAMPS[kind]})" for kind in ("date", "dmy", "slashed", "clock")) + ")"
_ANY = re.compile(ANY)

_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?(?:\s?([AaPp])[Mm])?$")
_DATED = re.compile(
    r"(\d{1,4})[-/.](\d{1,2})[-/.](\d{1,4})[T_,\s]{1,2}(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?(?:\s?([AaPp])[Mm])?"
    r"\s?(Z|[+-]\d\d:?\d\d)?"
)
_NUMBER = re.compile(r"\+?\s*(\d+(?:\.\d+)?)\s?([a-zμ]*)")
_MONTHS = 12

_SOURCES = {
    "date": "dates as printed, taken as UTC where they name no zone",
    "dmy": "dates as printed, taken as UTC",
    "slashed": "dates as printed, taken as UTC",
    "month": "times of day as printed, their date has no year",
    "clock": "times of day as printed, without a date",
    "step": "seconds as printed",
    "seconds": "seconds as printed",
    "units": "numbers as printed",
    "epoch_ms": "milliseconds as printed",
    "epoch_s": "seconds as printed",
    "millis": "milliseconds as printed",
}
#: Kinds of stamps that are no times since the epoch.
_CLOCKS = {"clock": Clock.DAY, "month": Clock.DAY, "date": Clock.PRINTED, "dmy": Clock.PRINTED, "slashed": Clock.PRINTED}


class Stamp(NamedTuple):
    """A printed time and its kind in `STAMPS`; both empty where there is none."""

    kind: str = ""
    text: str = ""


def stamp_of(text: str) -> Stamp:
    """Return a text that is nothing but a time as a stamp, an empty one if it is none."""
    text = text.strip().strip("[]() ")
    found = _ANY.fullmatch(text)
    return Stamp(found.lastgroup or "", text) if found is not None else Stamp()


class StampClock:
    """Reads the printed times of one capture, in the order of its lines."""

    def __init__(self, stamps: Iterable[Stamp], source: Source) -> None:
        """Look at the first stamps of a capture, and tell it what its times are."""
        known = [stamp for stamp in stamps if stamp.kind]
        self._counts_millis = _are_times([int(stamp.text) for stamp in known if stamp.kind == "millis"])
        if not self._counts_millis:
            known = [stamp for stamp in known if stamp.kind != "millis"]
        self._days = DayCount()
        self._day_first = self._order([stamp.text for stamp in known if stamp.kind == "slashed"], source)
        steps = [_number_ns(stamp.text) for stamp in known if stamp.kind == "step"]
        step: Callable[[int], int] = Deltas() if falls(steps) else int
        self._kinds: dict[str, Callable[[str], int]] = {
            "date": self._dated_ns,
            "dmy": self._dated_ns,
            "slashed": self._dated_ns,
            "month": lambda text: self._days(_daytime_ns(text)),
            "clock": lambda text: self._days(_daytime_ns(text)),
            "step": lambda text: step(_number_ns(text)),
            "seconds": _number_ns,
            "units": _number_ns,
            "epoch_ms": lambda text: int(text) * 1_000_000,
            "epoch_s": lambda text: int(text) * 1_000_000_000,
            "millis": lambda text: int(text) * 1_000_000,
        }
        if known:
            source.time_source = f"capture: {_SOURCES[known[0].kind]}, exact to their digits"
            zoned = any((dated := _DATED.match(stamp.text)) is not None and dated[dated.re.groups] for stamp in known)
            source.clock = Clock.UTC if zoned else _CLOCKS.get(known[0].kind, Clock.UTC)

    def __call__(self, stamp: Stamp) -> int | None:
        """Return the time of a stamp, None for an empty one. Raises ValueError for a time that is none."""
        if not stamp.kind or (stamp.kind == "millis" and not self._counts_millis):
            return None
        return self._kinds[stamp.kind](stamp.text)

    @staticmethod
    def _order(texts: list[str], source: Source) -> bool:
        """Say whether dates with slashes have the day first."""
        if not texts:
            return False
        dates = [[int(part) for part in text.split("/")[:2]] for text in texts]
        if any(second > _MONTHS for _, second in dates):
            return False
        if any(first > _MONTHS for first, _ in dates):
            return True
        source.note(f"dates as {texts[0].split()[0]} are read with the month first: no day above 12 shows the order")
        return False

    def _dated_ns(self, text: str) -> int:
        found = _DATED.match(text)
        if found is None:
            raise ValueError(f"expected a date, got {text!r}")
        first, month, last, hour, minute, second, fraction, half, zone = found.groups()
        year, day = (first, last) if len(first) == 4 else (last if len(last) > 2 else f"20{last}", first)
        if "/" in text and len(first) != 4 and not self._day_first:
            month, day = day, month
        ns = day_ns(int(year), int(month), int(day)) + clock_ns(_hour(hour, half), minute, second, fraction)
        return ns - zone_ns(zone) if zone is not None else ns


def _are_times(numbers: Sequence[int]) -> bool:
    """Say whether numbers without a unit are times, rather than those of a process or of lines."""
    steps = {b - a for a, b in pairwise(numbers)}
    return not steps or (min(steps) >= 0 and max(steps) > 1)


def _hour(hour: str, half: str | None) -> str:
    return hour if half is None else str(int(hour) % 12 + 12 * (half in "Pp"))


def _number_ns(text: str) -> int:
    # Patterns that ignore case take a long s for an s, and the Greek letter for the micro sign.
    found = _NUMBER.fullmatch(text.strip().casefold())
    if found is None:
        raise ValueError(f"expected a number, got {text!r}")
    return number_ns(found[1], UNITS.get(found[2] or "s", UNITS["s"]))


def _daytime_ns(text: str) -> int:
    found = _CLOCK.search(text)
    if found is None:
        raise ValueError(f"expected a time of day, got {text!r}")
    hour, minute, second, fraction, half = found.groups()
    return clock_ns(_hour(hour, half), minute, second, fraction)
