"""The source of the view: a live recording or a capture, with one interface. Neither knows the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from analyzer.catalogue import Dialect
from analyzer.sources.times import ShownTime
from analyzer.view.condition import Condition
from analyzer.view.kept import Lines, Wanted
from analyzer.view.series import Point
from analyzer.view.watch import Watch


class Plot(Protocol):
    """Points of some series over some time, as far as they have been looked for."""

    @property
    def done(self) -> bool:
        """Whether all have been looked for."""

    def look(self, seconds: float) -> None:
        """Go on looking for about this long."""

    def points(self, name: str) -> list[Point]:
        """Return the points of a series that were found so far."""


class ViewSource(Protocol):
    """A recording or a capture. `live`: more comes as time passes, and marks can be made."""

    @property
    def live(self) -> bool:
        """Whether it goes on."""

    @property
    def growing(self) -> bool:
        """Whether the newest are what one looks for: a recording, or a log that is followed."""

    @property
    def watch(self) -> Watch:
        """The counts."""

    @property
    def lines(self) -> Lines:
        """The frames."""

    @property
    def dialects(self) -> Sequence[Dialect]:
        """The dialects that frames are explained in."""

    @property
    def times(self) -> ShownTime:
        """How times are shown."""

    @property
    def broken(self) -> str:
        """Why it broke off, empty where it did not."""

    @property
    def note(self) -> str:
        """What to know about it before all else, if anything."""

    @property
    def state(self) -> str:
        """How far it is, in a few words for the head of the view."""

    @property
    def not_shown(self) -> int:
        """Frames and junk that were counted but are not among the lines, because there were too many."""

    @property
    def done(self) -> bool:
        """Whether nothing more will come."""

    def take(self) -> bool:
        """Take what is new, never waiting and never much at once; say whether there was anything."""

    def pause(self, paused: bool) -> int:
        """Stop or go on adding to the lines; return how many wait."""

    def wanted(self, condition: Condition) -> Wanted:
        """Return those lines for which a condition holds."""

    def hop(self, number: int, step: int) -> int:
        """Return the next number from here on, this one included, that may have findings."""

    def series(self) -> dict[str, str]:
        """Return the series that can be plotted, by name, and their units."""

    def span(self) -> tuple[int, int]:
        """Return the times of the first and the last frame."""

    def plot(self, names: Sequence[str], low_ns: int, high_ns: int) -> Plot:
        """Return the points of series over a time."""

    def mark(self, text: str) -> str:
        """Write a note into the log; return what to tell. Raises ServotapError where that cannot be."""

    def close(self) -> None:
        """End it."""
