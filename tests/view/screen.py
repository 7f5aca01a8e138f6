"""What the tests of the view share: sources, a view without a terminal driven by keys, and what stands on its screen."""

from __future__ import annotations

import argparse
import asyncio
import html
import re
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from textual.keys import _character_to_key

from analyzer.cli.reading import add_reading_arguments, open_reading
from analyzer.live.snapshot import Snapshot
from analyzer.sources.tail import Follow
from analyzer.view.app import ViewApp
from analyzer.view.capture import CaptureSource
from analyzer.view.live import LiveSource, SnapshotQueue
from analyzer.view.source import ViewSource

SMALL = (80, 24)


def reading_of(path: Path | str, *options: str, follow: Follow | None = None):
    """Open a capture with the options of the command."""
    parser = argparse.ArgumentParser()
    add_reading_arguments(parser)
    return open_reading(str(path), parser.parse_args(options), follow)


def capture_of(path: Path | str, *options: str) -> CaptureSource:
    """Return a capture that has been read to its end."""
    source = CaptureSource(reading_of(path, *options))
    assert source._ended.wait(20)
    source.take()
    assert source.done
    return source


class Live:
    """A recording under way: snapshots are put into its queue, marks come out."""

    def __init__(self) -> None:
        self.marks: list[str] = []
        self.refusal: Exception | None = None
        self.snapshots = SnapshotQueue()
        self.source = LiveSource(self.snapshots, mark=self._mark, log="week.mcap")

    def _mark(self, text: str) -> str:
        if self.refusal is not None:
            raise self.refusal
        self.marks.append(text)
        return ""

    def put(self, *snapshots: Snapshot) -> None:
        """Put snapshots into the queue."""
        for snapshot in snapshots:
            assert self.snapshots.offer(snapshot)


def drive(source: ViewSource, steps: Callable[[Driver], Awaitable[None]], size: tuple[int, int] = SMALL, **options):
    """Run a view without a terminal and drive it; return what the view returned."""

    async def go():
        app = ViewApp(source, **options)
        async with app.run_test(size=size) as pilot:
            await steps(Driver(app, pilot))
        return app.return_value

    try:
        return asyncio.run(go())
    finally:
        source.close()


def driven(path: Path | str, *arguments: str, size: tuple[int, int] = SMALL, **options):
    """Make a test of steps with a driver: they drive the view of a capture that has been read to its end."""

    def test_of(steps: Callable[[Driver], Awaitable[None]]) -> Callable[[], None]:
        def test() -> None:
            drive(capture_of(path, *arguments), steps, size, **options)

        test.__name__ = steps.__name__
        return test

    return test_of


class Driver:
    """A view under test."""

    def __init__(self, app: ViewApp, pilot) -> None:
        self.app = app
        self.pilot = pilot

    async def press(self, *keys: str) -> None:
        """Press keys, and let the view do what it does then."""
        await self.pilot.press(*keys)
        await self.settle()

    async def type(self, text: str) -> None:
        """Type a text into the line at the foot, and Enter."""
        await self.press(*(_character_to_key(each) for each in text))
        assert text in self.text, f"what is typed is not seen:\n{self.text}"
        await self.press("enter")

    async def settle(self) -> None:
        """Let the view take what is new."""
        self.app.tick()
        await self.pilot.pause()

    async def until(self, test: Callable[[], object], what: str = "") -> None:
        """Let the view work until something holds."""
        late = time.monotonic() + 10
        while not test():
            assert time.monotonic() < late, what or self.text
            await self.settle()

    @property
    def rows(self) -> list[str]:
        """The rows of the screen as texts."""
        svg = self.app.export_screenshot()
        rows: dict[float, list[tuple[float, str]]] = {}
        for x, y, text in re.findall(r'<text class="[^"]*" x="([\d.]+)" y="([\d.]+)"[^>]*>(.*?)</text>', svg, re.DOTALL):
            rows.setdefault(float(y), []).append((float(x), html.unescape(text).replace("\xa0", " ")))
        width = 12.2
        result = []
        for _, parts in sorted(rows.items()):
            row = ""
            for x, text in sorted(parts):
                row = row.ljust(round(x / width)) + text
            result.append(row.rstrip())
        return result[1:] if result and "servotap view" in result[0] else result

    @property
    def text(self) -> str:
        """The screen as one text."""
        return "\n".join(self.rows)
