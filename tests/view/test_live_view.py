"""The view of a recording, driven by keys: what comes is shown, held, marked; a full bus is kept up with by showing less."""

from __future__ import annotations

import re

import pytest

from analyzer import dialects
from analyzer.errors import UsageError
from analyzer.live.snapshot_sink import SnapshotSink
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import Chunk, Comment, Event
from tests.collect import sum8
from tests.view.screen import SMALL, Live, drive

MS = 1_000_000
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


class Bus:
    """A feed with traffic of its own."""

    def __init__(self) -> None:
        self.feed = SnapshotSink(byte_ns={"left": 260_000})
        self.pipeline = Pipeline([dialects.get("mks-rs485")], (self.feed,), Options())
        self.t_ns = START

    def poll(self, count=1, speed=320):
        for _ in range(count):
            self.t_ns += 7 * MS
            self.pipeline.feed(Chunk(self.t_ns, "left", bytes.fromhex(sum8("FA 01 32"))))
            self.t_ns += 3 * MS
            reply = sum8(f"FB 01 32 {speed.to_bytes(2, 'big', signed=True).hex(' ')}")
            self.pipeline.feed(Chunk(self.t_ns, "left", bytes.fromhex(reply)))
        self.pipeline.silence("left")
        return self

    def snapshot(self, **options):
        return self.feed.snapshot(self.t_ns, **options)


@pytest.fixture
def live():
    return Live()


@pytest.fixture
def bus():
    return Bus()


def watched(size=SMALL, ends=None):
    """Make a test of steps with a driver: they drive the view of a recording. `ends`: what it ends with."""

    def test_of(steps):
        def test(live, bus):
            ended = drive(live.source, lambda driver: steps(driver, live, bus), size)
            assert ends is None or ended == ends

        test.__name__ = steps.__name__
        return test

    return test_of


@watched()
async def test_frames_come_and_the_newest_is_followed(driver, live, bus):
    for n in range(5):
        live.put(bus.poll(20, speed=n).snapshot())
        await driver.settle()
    text = driver.text
    assert "week.mcap  LIVE" in text
    assert "200 frames" in text
    assert text.count("speed=4") > 5
    assert driver.app.frames.line.values == {"speed": 4}
    await driver.press("up")
    number = driver.app.frames.cursor
    live.put(bus.poll(20).snapshot())
    await driver.settle()
    assert driver.app.frames.cursor == number
    await driver.press("end")
    live.put(bus.poll(20).snapshot())
    await driver.settle()
    assert driver.app.frames.cursor == live.source.lines.stop - 1


@watched()
async def test_pausing_holds_the_lines_and_not_the_counts(driver, live, bus):
    live.put(bus.poll(10, speed=1).snapshot())
    await driver.settle()
    await driver.press("space")
    live.put(bus.poll(10, speed=2).snapshot())
    await driver.settle()
    assert "PAUSED, 20 wait" in driver.text
    assert "40 frames" in driver.text
    assert "speed=2" not in driver.text
    await driver.press("space")
    assert "speed=2" in driver.text
    assert "PAUSED" not in driver.text


@watched()
async def test_a_mark_goes_out_and_comes_back(driver, live, bus):
    await driver.press("m")
    await driver.type("coupling [red]loose[/red]")
    assert live.marks == ["coupling [red]loose[/red]"]
    assert "marked: coupling [red]loose[/red]" in driver.text
    bus.pipeline.feed(Comment(START, "left", live.marks[0]))
    live.put(bus.snapshot())
    await driver.settle()
    assert re.search(r"\* comment +coupling \[red\]loose", driver.text)
    live.refusal = UsageError("the log is closed")
    await driver.press("m")
    await driver.type("late")
    assert "the log is closed" in driver.text
    await driver.press("m", "escape")
    assert live.marks == ["coupling [red]loose[/red]"]


@watched(ends="quit")
async def test_ending_a_recording_is_asked_for(driver, live, bus):
    await driver.press("q")
    assert "End the recording?" in driver.text
    await driver.press("n")
    assert "End the recording?" not in driver.text
    await driver.press("q", "y")


@watched(ends="ended")
async def test_it_ends_with_the_recording(driver, live, bus):
    live.put(bus.poll().snapshot(ended=True))
    await driver.settle()


@watched(ends="ended")
async def test_it_ends_when_no_more_snapshots_come(driver, live, bus):
    live.snapshots.close()
    await driver.settle()


@watched(size=(100, 24))
async def test_a_full_bus_is_kept_up_with_by_showing_less(driver, live, bus):
    for _ in range(4):
        live.put(bus.poll(2000).snapshot())
        await driver.settle()
    assert "16000 frames" in driver.text
    kept = live.source.lines.stop - live.source.lines.first
    assert kept < 700
    assert f"{16000 - kept} not shown" in driver.text


@watched(size=(120, 24))
async def test_snapshots_that_were_lost_are_told_and_leave_the_counts_right(driver, live, bus):
    live.put(bus.poll(5).snapshot())
    for _ in range(3):
        bus.poll(5).snapshot()
    live.put(bus.poll(5).snapshot())
    await driver.settle()
    assert "50 frames" in driver.text
    assert "3 snapshots missed" in driver.text
    assert "30 not shown" in driver.text


@watched()
async def test_a_filter_goes_on_with_what_comes(driver, live, bus):
    live.put(bus.poll(5, speed=1).snapshot())
    await driver.press("f")
    await driver.type("speed == 2")
    assert "0 frames shown" in driver.text
    live.put(bus.poll(5, speed=2).snapshot())
    await driver.settle()
    assert "5 frames shown" in driver.text
    assert "speed=1" not in driver.text


@watched()
async def test_findings_of_earlier_frames_are_marked_when_they_come(driver, live, bus):
    bus.pipeline.feed(Chunk(START, "left", bytes.fromhex(sum8("FA 01 30"))))
    bus.t_ns += 5 * SECOND
    bus.poll()
    late = bus.snapshot()
    assert [f.rule for f in late.findings] == ["unanswered"]
    late.frames, early = [line for line in late.frames if line.sequence > 1], late.frames[:1]
    early[0].rules = ()
    live.source.lines.append(early[0])
    live.put(late)
    await driver.press("home", "e", "E")
    assert driver.app.frames.line.rules == ("unanswered",)
    assert re.search(r"^[WE] .*!unanswered", driver.text, re.MULTILINE)


@watched()
async def test_what_happens_to_the_recording_stands_among_the_frames(driver, live, bus):
    bus.poll(3)
    bus.pipeline.feed(Event(bus.t_ns, "left", "lost", {"reason": "unplugged"}))
    live.put(bus.poll(3).snapshot())
    await driver.settle()
    assert re.search(r"W .*\* lost +!port_lost unplugged", driver.text)


def test_a_reply_is_explained_with_its_request(live):
    feed = SnapshotSink()
    pipeline = Pipeline([dialects.get("mks-modbus")], (feed,), Options())
    for at, text in ((0, "01 04 00 32 00 01 90 05"), (5, "01 04 02 01 40 B9 50")):
        pipeline.feed(Chunk(START + at * MS, "left", bytes.fromhex(text), burst=True))
    pipeline.close()

    async def steps(driver):
        live.put(feed.snapshot(START + SECOND))
        # A key that comes before the frames opens none.
        await driver.until(lambda: any("read_speed" in row and "320" in row for row in driver.rows))
        await driver.press("end", "enter")
        assert re.search(r"speed 320 rpm", driver.text)

    drive(live.source, steps, size=(100, 40))


@watched()
async def test_a_plot_follows(driver, live, bus):
    await driver.press("4")
    for n in range(10):
        live.put(bus.poll(3, speed=n * 10).snapshot())
        await driver.settle()
    assert "[1] left/1 speed  last 90" in driver.text
    await driver.press("minus", "plus", "plus", "plus")
    assert "plot: 10 s" in driver.text
