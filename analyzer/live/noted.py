"""What a reader or the recorder notes of what happened, as the values of an event of the log.

    {"event": "stalled", "from_ns": 120, "to_ns": 450, "reason": "..."}  ->  from="2026-...", to="2026-...", reason="..."

A monotonic time becomes one of the log, a duration in ns one in seconds. A value of no plain kind becomes text.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from analyzer.sources.times import iso

#: Monotonic times and durations: name in a spool -> name in the log.
_TIMES = {"from_ns": "from", "to_ns": "to"}
_DURATIONS = {"gap_ns": "gap", "step_ns": "step", "offset_ns": "drift"}


def event_values(noted: Mapping[str, Any], utc_ns: Callable[[int], int]) -> dict[str, Any]:
    """Return the values of an event from what was noted; `utc_ns` gives the log's time of a monotonic one."""
    values: dict[str, Any] = {}
    for name, value in noted.items():
        if name == "event" or value is None:
            continue
        if name in _TIMES and isinstance(value, int):
            values[_TIMES[name]] = iso(utc_ns(value))
        elif name in _DURATIONS and isinstance(value, int):
            values[_DURATIONS[name]] = value / 1e9
        elif isinstance(value, (list, tuple)):
            values[name] = [str(each) for each in value]
        elif isinstance(value, (str, int, float)):
            values[name] = value
        else:
            values[name] = str(value)
    return values
