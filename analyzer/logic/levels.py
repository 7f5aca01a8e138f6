"""The levels of one channel, as the times of its edges: an idle second costs nothing, however fast it was sampled.

    ______        ___     ______
          |______|   |___|             first level 1, edges at 4 times; between two edges lies one run

Times are integer nanoseconds and rise. Pulses that are shorter than a receiver would take for a bit are glitches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.codec import Flags, Integers

#: Part of a bit below which a pulse is a glitch.
GLITCH = 0.4
#: Part of a bit by which two levels of a bouncing edge last equally long.
_EVEN = 0.05


@dataclass
class Levels:
    """A stretch of one channel. `first`: the level before its first edge, 0 or 1; `end_ns`: up to where it is known."""

    first: int
    edges: Integers
    start_ns: int
    end_ns: int

    @property
    def last(self) -> int:
        """The level behind the last edge."""
        return self.first ^ (len(self.edges) & 1)

    def inverted(self) -> Levels:
        """Return the same stretch with every level turned round."""
        return replace(self, first=self.first ^ 1)

    def since(self, place: int) -> Levels:
        """Return what begins right before one of the edges."""
        start_ns = int(self.edges[place - 1]) if place else self.start_ns
        return Levels(self.first ^ (place & 1), self.edges[place:], start_ns, self.end_ns)

    def until(self, place: int) -> Levels:
        """Return the stretch before one of the edges."""
        return replace(self, edges=self.edges[:place], end_ns=int(self.edges[place]) - 1)

    def then(self, edges: Integers, end_ns: int) -> Levels:
        """Return the stretch with what follows it."""
        joined = np.concatenate((self.edges, edges)) if len(self.edges) else edges
        return replace(self, edges=joined, end_ns=end_ns)

    def at(self, times: Integers) -> Flags:
        """Return the levels at some times: True is high."""
        passed = np.searchsorted(self.edges, times, side="right")
        return ((passed & 1) ^ self.first).astype(bool)

    def high(self, begins: NDArray[np.float64], length_ns: float) -> NDArray[np.float64]:
        """Return for which share of the time each stretch of a length is high, 0..1. `begins` rise."""
        at_edges = np.concatenate(([0], np.cumsum(np.diff(self.edges) * ((np.arange(1, len(self.edges)) & 1) ^ self.first))))
        high = [np.zeros(len(begins)), np.zeros(len(begins))]
        if not len(self.edges):
            return np.full(len(begins), float(self.first))
        for number, times in enumerate((begins, begins + length_ns)):
            passed = np.searchsorted(self.edges, times, side="right")
            place = np.maximum(passed - 1, 0)
            # Before the first edge the count goes below zero.
            level = np.where(passed > 0, (passed & 1) ^ self.first, self.first)
            high[number] = at_edges[place] + (times - self.edges[place]) * level
        share: NDArray[np.float64] = (high[1] - high[0]) / length_ns
        return share

    def without_glitches(self, bit_ns: float) -> Levels:
        """Return the stretch without pulses too short for a bit. An edge that bounces is where most of the old level ends.

        Short pulses that together are long enough are one pulse: a bit with a glitch in its middle.
        """
        runs = np.diff(self.edges)
        short = runs < GLITCH * bit_ns
        if not short.any():
            return self
        bounds = np.diff(np.concatenate(([False], short, [False])).astype(np.int8))
        starts, stops = np.flatnonzero(bounds == 1), np.flatnonzero(bounds == -1)
        kept = ~(np.concatenate(([False], short)) | np.concatenate((short, [False])))
        # From `start` to `stop` stand edges; an even number of them leaves the level as it was, of an odd number one stays.
        odd = (stops - starts) % 2 == 0
        signed = np.append(np.where(np.arange(len(runs)) % 2, -runs, runs), 0)
        new_less_old = np.add.reduceat(signed, np.column_stack((starts, stops)).ravel())[::2] * np.where(starts % 2, -1, 1)
        kept[np.where(new_less_old >= -_EVEN * bit_ns, starts, stops)[odd]] = True
        pulse = ~odd & (new_less_old >= GLITCH * bit_ns)
        kept[starts[pulse]] = kept[stops[pulse]] = True
        return replace(self, edges=self.edges[kept])
