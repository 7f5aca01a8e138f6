"""The real clock as a bus takes it: nanoseconds since the start, monotonic, anchored to UTC once."""

from __future__ import annotations

import time


class Clock:
    """Time since it was made. `anchor_ns`: UTC at that moment; steps of the wall clock are not followed."""

    def __init__(self) -> None:
        self._start_ns = time.monotonic_ns()
        self.anchor_ns = time.time_ns()

    def now_ns(self) -> int:
        """Return the nanoseconds since the start; it never goes back."""
        return time.monotonic_ns() - self._start_ns
