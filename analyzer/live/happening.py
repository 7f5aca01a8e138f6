"""What readers and the supervisor noted in their spools, as events of the log: times of day, durations in seconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from analyzer.sources.moments import iso

#: Moments of the monotonic clock, and durations, by what they are called in a spool and in the log.
_MOMENTS = {"from_ns": "from", "to_ns": "to"}
_SPANS = {"gap_ns": "gap", "step_ns": "step", "offset_ns": "drift"}
_SIMPLE = (str, int, float)


def values_of(noted: Mapping[str, Any], utc_ns: Callable[[int], int]) -> dict[str, Any]:
    """Return the values of an event from what was noted; `utc_ns` gives the log's time of a monotonic one."""
    values: dict[str, Any] = {}
    for name, value in noted.items():
        if name == "event" or value is None:
            continue
        if name in _MOMENTS and isinstance(value, int):
            values[_MOMENTS[name]] = iso(utc_ns(value))
        elif name in _SPANS and isinstance(value, int):
            values[_SPANS[name]] = value / 1e9
        elif isinstance(value, (list, tuple)):
            values[name] = [str(each) for each in value]
        elif isinstance(value, _SIMPLE):
            values[name] = value
        else:
            values[name] = str(value)
    return values
