"""Scales of a chart: round ticks of values and of times."""

from __future__ import annotations

from math import ceil, floor, log10

from analyzer.sources.times import ShownTime

SECOND = 1_000_000_000
#: Steps of a time axis: decimal ones below ten seconds, those of a clock from there on.
_STEPS_NS = (
    *(factor * 10**power for power in range(3, 10) for factor in (1, 2, 5)),
    *(n * SECOND for n in (10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 43200, 86400)),
)


def round_ticks(least: float, greatest: float, most: int) -> list[float]:
    """Return at most `most` round numbers, at equal steps, between which all values lie; at least two."""
    if greatest <= least:
        room = abs(least) * 0.1 or 1.0
        least, greatest = least - room, greatest + room
    parts = max(1, most - 1)
    rough = greatest / parts - least / parts
    power = 10.0 ** floor(log10(rough)) if rough else 0.0
    if not power:
        return [least, greatest]
    for step in (power * factor for factor in (1, 2, 2.5, 5, 10, 20, 50)):
        first, last = floor(least / step), ceil(greatest / step)
        if last - first + 1 <= max(2, most):
            # Whole steps, counted: sums of floats would drift.
            return [n * step for n in range(first, last + 1)]
    return [least, greatest]


def time_ticks(first_ns: int, last_ns: int, times: ShownTime, most: int) -> list[tuple[int, str]]:
    """Return about `most` round times of a stretch, as they are shown: with as many digits as their step needs."""
    span = max(1, last_ns - first_ns)
    step = next((s for s in _STEPS_NS if span // s <= most), _STEPS_NS[-1] * ceil(span / most / _STEPS_NS[-1]))
    digits = next(n for n in range(7) if step % 10 ** (9 - n) == 0) if step < SECOND else 0
    zone_ns = times.zone_ns(first_ns)
    start = -(-(first_ns + zone_ns) // step) * step - zone_ns
    ticks = range(start, last_ns + 1, step)
    return [(t, _cut(times.text(t), digits)) for t in ticks]


def _cut(text: str, digits: int) -> str:
    """Return a time with fewer digits behind the point; it is printed with six."""
    return (text[: len(text) - 6 + digits] if digits else text[:-7]).strip()
