"""A huge capture in ranges brings the rows of the whole, wherever the borders lie."""

from __future__ import annotations

import random
from collections import defaultdict
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa
import pytest

from analyzer.cli.signals import Interrupt
from analyzer.errors import UnreadableError
from analyzer.fleet import files, ranges
from analyzer.fleet.ingest import Ingest, Outcome, works
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from analyzer.fleet.ranges import Range, Scan, joined, scan, take_range, waiting
from analyzer.fleet.rows import take
from analyzer.sources import source
from benchmarks.framing_noise import damage, traffic
from tests import CAPTURES
from tests.columns.both_ways import short_runs
from tests.columns.serial_traffic import chunks_of, polls
from tests.fleet.lakes import Finished, candump, hall, ingest, options, rows

FILES = [path for path in sorted(CAPTURES.iterdir()) if path.is_file() and path.suffix not in (".golden", ".md", ".py", ".mf4")]


class Kept:
    """A data file that is kept as its rows: hundreds of ranges have thousands of them."""

    def __init__(self, table, schema, values, before):
        self.table, self.values, self.rows = table, values, []

    def fits(self, table):
        return True

    def write(self, table, captures):
        self.rows += table.to_pylist()

    def finish(self, place):
        return self


def brought(taken):
    """Return all that a capture brings: its row, and the rows of each table and partition."""
    found = defaultdict(list)
    for each in taken.added:
        found[each.table, *sorted(each.values.items())] += each.rows
    row = {name: value for name, value in taken.captures[0].items() if name != "ingested_at"}
    return row, {name: sorted(table, key=repr) for name, table in found.items()}


def compared(path, folder, monkeypatch, size):
    """Check that a capture comes out the same in ranges. Return how many there were."""
    made, own = Lake(Place(str(folder / "lake")), make=True), options()
    [work] = works([Place(str(path))], made, None, False, Outcome())
    monkeypatch.setattr(files, "DataFile", Kept)
    whole = take([work], made.destination, own)
    monkeypatch.setattr(ranges, "RANGE_BYTES", size)
    task = Scan(work)
    scanned = scan(task, made.destination, own)
    if not scanned.ranges:
        assert [whole.captures[0][name] for name in ("status", "reason")] == [
            scanned.captures[0][name] for name in ("status", "reason")
        ]
        return 0
    assert waiting(made.place, task) == scanned.ranges
    # Workers take them in any order.
    order = random.Random(size).sample(range(scanned.ranges), scanned.ranges)
    parts = [take_range(Range(task, number), made.destination, own) for number in order]
    assert brought(joined(scanned, parts)) == brought(whole)
    return scanned.ranges


def serial_capture(path, name, seed, share):
    """Write a log of a serial line, some of it damaged."""
    chance = random.Random(f"{name} {seed}")
    sent = polls(name, chance, 40) + traffic([name], 80, chance) + polls(name, chance, 40)
    line, placed = damage(sent, share, chance)
    with path.open("w") as out:
        for chunk in chunks_of(line, chance, [each.stop for each in placed], longest=40):
            day = datetime.fromtimestamp(chunk.t_ns // 1_000_000_000, UTC)
            out.write(f"{day:%Y-%m-%dT%H:%M:%S}.{chunk.t_ns % 1_000_000_000:09} {chunk.data.hex(' ').upper()}\n")


@pytest.fixture(params=[False, True], ids=["singly", "in blocks"])
def in_blocks(request, monkeypatch):
    """Have small captures be read as long ones are, in blocks of some frames."""
    if not request.param:
        yield
        return
    monkeypatch.setattr("analyzer.fleet.rows.LONG_CAPTURE", 0)
    monkeypatch.setattr(source, "_RECORDS", 16)
    monkeypatch.setattr(source, "TOGETHER", 512)
    with short_runs():
        yield


@pytest.mark.parametrize("name", ["mks-rs485", "lk-rs485", "mks-modbus"])
@pytest.mark.parametrize("share", [0, 0.02])
def test_serial_lines(name, share, in_blocks, tmp_path, monkeypatch):
    path = tmp_path / "line.log"
    serial_capture(path, name, 1, share)
    assert compared(path, tmp_path, monkeypatch, 1 if share else 700) > 5


@pytest.mark.parametrize("size", [1, 1500])
def test_can(size, in_blocks, tmp_path, monkeypatch):
    path = tmp_path / "can.log"
    path.write_text(candump(3, 160, busy=0.5))
    assert compared(path, tmp_path, monkeypatch, size) > 3


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_captures_of_every_format(path, tmp_path, monkeypatch):
    compared(path, tmp_path, monkeypatch, 300)


def test_huge_captures_reach_the_lake_by_ranges(tmp_path, monkeypatch):
    folder = hall(tmp_path / "in", 3)
    plain, made = (Lake(Place(str(tmp_path / name)), make=True) for name in ("plain", "made"))
    assert ingest(plain, folder).new == 3
    monkeypatch.setattr("analyzer.fleet.ingest.HUGE", 1)
    monkeypatch.setattr(ranges, "RANGE_BYTES", 800)
    outcome = ingest(made, folder)
    assert (outcome.new, [name for name, _ in outcome.unread]) == (3, ["notes.txt"])
    assert rows(made) == rows(plain)
    assert made.place.glob("ranges/*") == []
    again = ingest(made, folder)
    assert (again.new, again.known) == (0, 4)


@pytest.fixture
def split(tmp_path, monkeypatch):
    """A lake, the work of one huge capture, its scan and what that brought."""
    monkeypatch.setattr(ranges, "RANGE_BYTES", 800)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.log").write_text(candump(1))
    made = Lake(Place(str(tmp_path / "lake")), make=True)
    [work] = works([Place(str(tmp_path / "in"))], made, None, False, Outcome())
    task = Scan(work)
    return made, task, scan(task, made.destination, options())


def test_a_range_that_another_wrote_is_not_read(split):
    made, task, _ = split
    path = Path(made.place.path(task.path(1)))
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    with pytest.raises(UnreadableError, match="is damaged"):
        take_range(Range(task, 1), made.destination, options())
    with pytest.raises(UnreadableError, match="is damaged"):
        take_range(Range(Scan(task.work, task.name), 0), made.destination, options())
    path.unlink()
    with pytest.raises(UnreadableError, match="is gone"):
        take_range(Range(task, 1), made.destination, options())


def test_a_capture_of_which_a_range_fails_reaches_no_table(split):
    made, task, scanned = split
    run = Ingest(made, options(), Outcome(), Interrupt())
    first, second, *_ = run.ended(task, Finished(lambda: scanned))
    assert run.ended(first, Finished(take_range, first, made.destination, options())) == []
    assert run.ended(second, Finished(lambda: 1 / 0)) == []
    # What comes late of it counts no more.
    assert run.ended(first, Finished(take_range, first, made.destination, options())) == []
    run.commit()
    assert list(rows(made)) == ["captures"]
    assert (made.place.glob("ranges/*"), run.outcome.unread[0][0]) == ([], "a.log")
    assert ingest(made, task.work.source, retry=True).new == 1


def test_a_scan_that_is_gone_with_its_scheduler_begins_anew(split):
    made, task, _ = split
    run, gone = Ingest(made, options(), Outcome(), Interrupt()), Finished(lambda: None)
    gone.status = "cancelled"
    [anew] = run.ended(task, gone)
    assert (anew.work, anew.name == task.name, made.place.glob("ranges/*")) == (task.work, False, [])


def test_what_a_dead_client_left_is_removed_in_time(split):
    made, task, scanned = split
    assert made.compact(1) == (0, 0)
    assert waiting(made.place, task) == scanned.ranges
    assert made.compact(0)[1] == scanned.ranges


def test_arrow_has_its_own_memory_again_afterwards():
    before = pa.default_memory_pool().backend_name
    with ranges.memory_kept():
        assert pa.default_memory_pool().backend_name == "system"
    assert pa.default_memory_pool().backend_name == before
