"""How much of what comes is read: no more than a line can bring.

A server on a network, or a program behind a terminal, can send hundreds of megabytes a second. To decode them takes all the
time that a stop and a time-out have. So what comes faster than any line is left out and counted. As long as that lasts, the
rest is read at the rate of the line.

What may come is far more than the rate of the line, for emulated drives may answer at once, without a wire. No program that
asks and waits gets near it.
"""

from __future__ import annotations

SECOND_NS = 1_000_000_000
#: Bytes a second that no line brings, but one of more than 1 Mbit/s.
FLOOD = 100_000


class Intake:
    """What is read of what comes. `left_out`: bytes that were not."""

    def __init__(self) -> None:
        self.left_out = 0
        self._room = 0.0
        self._last_ns: int | None = None
        #: When more came than a line can bring, for the last time; None: it did not, or long ago.
        self._flooded_ns: int | None = None

    def take(self, t_ns: int, count: int, brings: int) -> int:
        """Return how many of `count` bytes that have come are to be read; the others are left out.

        `brings`: bytes that the line brings in a second.
        """
        rate = max(FLOOD, brings) if self._flooded_ns is None else brings
        elapsed_ns = SECOND_NS if self._last_ns is None else t_ns - self._last_ns
        self._last_ns = t_ns
        # At most what comes in a second: a process may stand still so long, and a network too.
        self._room = min(rate, self._room + elapsed_ns * rate / SECOND_NS)
        taken = min(count, int(self._room))
        self._room -= taken
        if taken < count:
            self.left_out += count - taken
            self._flooded_ns = t_ns
        elif self._flooded_ns is not None and t_ns - self._flooded_ns >= SECOND_NS:
            self._flooded_ns = None
        return taken
