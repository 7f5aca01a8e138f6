"""The source of the view: a live recording or a capture, with one interface. Neither knows the terminal."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Protocol

from analyzer.catalogue import Dialect
from analyzer.sources.times import ShownTime
from analyzer.view.condition import Condition
from analyzer.view.kept import Lines, Wanted
from analyzer.view.series import Point
from analyzer.view.watch import Watch


class Plot(Protocol):
    """Points of some series over some time, as far as they have been looked for. `done`: all of them."""

    @property
    def done(self) -> bool: ...

    def look(self, seconds: float) -> None:
        """Go on looking for about this long."""

    def points(self, name: str) -> list[Point]:
        """Return the points of a series that were found so far."""


class ViewSource(ABC):
    """A recording or a capture. `live`: more comes as time passes, and marks can be made.

    `growing`: the newest frames are what one looks for, as of a recording or a log that is followed. `dialects`: of the frames.
    `broken`: why it broke off; `note`: what to know about it before all else; empty where there is nothing.
    """

    live: bool
    growing: bool
    watch: Watch
    lines: Lines
    dialects: Sequence[Dialect]
    times: ShownTime
    broken = ""
    note = ""

    @property
    @abstractmethod
    def state(self) -> str:
        """How far it is, in a few words for the head of the view."""

    @property
    @abstractmethod
    def done(self) -> bool:
        """Whether nothing more will come."""

    @property
    def not_shown(self) -> int:
        """Frames and junk that were counted but are not among the lines, because there were too many."""
        return 0

    @abstractmethod
    def take(self) -> bool:
        """Take what is new, never waiting and never much at once; say whether there was anything."""

    def pause(self, paused: bool) -> int:
        """Stop or go on adding to the lines; return how many wait. The lines of a capture stay where they are."""
        return 0

    @abstractmethod
    def wanted(self, condition: Condition) -> Wanted:
        """Return those lines for which a condition holds."""

    def hop(self, number: int, step: int) -> int:
        """Return the next number from here on, this one included, that may have findings."""
        return number

    @abstractmethod
    def series(self) -> dict[str, str]:
        """Return the series that can be plotted, by name, and their units."""

    @abstractmethod
    def span(self) -> tuple[int, int]:
        """Return the times of the first and the last frame."""

    @abstractmethod
    def plot(self, names: Sequence[str], low_ns: int, high_ns: int) -> Plot:
        """Return the points of series over a time."""

    @abstractmethod
    def mark(self, text: str) -> str:
        """Write a note into the log; return what to tell. Raises ServotapError where that cannot be."""

    def close(self) -> None:  # noqa: B027 (a recording has a supervisor, who ends it)
        """Let go of what is held."""
