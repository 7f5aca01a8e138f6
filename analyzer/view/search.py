"""A search for a line in small steps, so that the view stays responsive over millions of lines."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from analyzer.live.snapshot import FrameLine
from analyzer.view.kept import Lines
from analyzer.view.lines import search_text

Hop = Callable[[int, int], int]


class Search:
    """Looks from a line on (not that line itself), forwards or backwards, for one that passes a test.

    `hop`: given a number and the step, says where the next line is that is worth a look.
    """

    def __init__(
        self, lines: Lines, test: Callable[[FrameLine], bool], start: int, step: int, *, hop: Hop | None = None, what: str = ""
    ) -> None:
        self.lines = lines
        self.step = step
        self.what = what
        self._test = test
        self._hop = hop
        self._at = start + step
        self.found: int | None = None
        self.done = False

    def look(self, seconds: float) -> None:
        until = time.perf_counter() + seconds
        looked = 0
        while not self.done:
            if self._hop is not None:
                self._at = self._hop(self._at, self.step)
            if not self.lines.first <= self._at < self.lines.stop:
                self.done = True
            elif self._test(self.lines.line(self._at)):
                self.found, self.done = self._at, True
            else:
                self._at += self.step
                looked += 1
                if looked % 16 == 0 and time.perf_counter() >= until:
                    return

    @property
    def place(self) -> str:
        span = max(1, self.lines.stop - self.lines.first)
        return f"{min(100, 100 * (self._at - self.lines.first) // span)} %"


class Seeker:
    """What is being looked for, if anything, and the text that was searched for last."""

    def __init__(self) -> None:
        self.text = ""
        self.search: Search | None = None

    def for_text(self, lines: Lines, start: int, step: int) -> None:
        """Begin to look for the next line with the text; hex digits alone are bytes too."""
        text = self.text.lower()
        wanted = (text, bytes.fromhex(text).hex(" ")) if re.fullmatch("([0-9a-f]{2}){2,}", text) else (text,)

        def test(line: FrameLine) -> bool:
            whole = search_text(line)
            return any(each in whole for each in wanted)

        self.search = Search(lines, test, start, step, what=f"'{self.text}'")

    def for_finding(self, lines: Lines, start: int, step: int, hop: Hop | None) -> None:
        self.search = Search(lines, lambda line: bool(line.rules), start, step, hop=hop, what="a finding")

    def look(self, seconds: float) -> Search | None:
        """Go on looking for about this long; return the search once it is done."""
        search = self.search
        if search is None:
            return None
        search.look(seconds)
        if not search.done:
            return None
        self.search = None
        return search
