"""What a reader stores: in order, counted, and nothing silently lost when the disk is full."""

from __future__ import annotations

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer.live.reader_store import RETRY_NS, StatusLine, Store
from analyzer.live.spool import CanFlag, RecordKind, SpoolReader, SpoolWriter, size_of

STEM = "1-a"


class Disk:
    """A spool on a disk that can be full."""

    def __init__(self, folder):
        self.writer = SpoolWriter(folder, STEM)
        self.full = False

    def write(self, data):
        if self.full:
            raise OSError(28, "No space left on device")
        self.writer.write(data)

    def close(self):
        self.writer.close()


class Bench:
    """A store on a clock that is set by hand."""

    def __init__(self, folder, **options):
        self.folder = folder
        self.disk = Disk(folder)
        self.now_ns = 1_000
        self.told = []
        self.store = Store(
            self.disk, lambda t_ns, event, about: self.told.append((event, about)), clock=lambda: self.now_ns, **options
        )

    def records(self):
        return list(SpoolReader(self.folder, STEM).read(1 << 30))

    def pass_ns(self, ns):
        self.now_ns += ns


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_chunks_are_counted_from_what_came_before(bench):
    bench.store.chunk(10, b"abc")
    bench.store.chunk(20, b"de")
    bench.store.flush()
    assert [(r.kind, r.t_ns, r.before, r.data) for r in bench.records()] == [
        (RecordKind.DATA, 10, 0, b"abc"), (RecordKind.DATA, 20, 3, b"de"),
    ]  # fmt: skip


def test_a_successor_counts_on(tmp_path):
    bench = Bench(tmp_path, count=100, last_ns=50)
    bench.store.chunk(40, b"x")
    bench.store.flush()
    assert [(r.t_ns, r.before) for r in bench.records()] == [(50, 100)]


def test_frames_of_a_can_bus_are_counted_one_by_one(tmp_path):
    bench = Bench(tmp_path, unit="frames")
    bench.store.can(5, 0x123, CanFlag.TX, b"\1\2")
    bench.store.can(6, 0x124, 0, b"")
    bench.store.close("over")
    first, second, closed = bench.records()
    assert (first.before, second.before, closed.before) == (0, 1, 2)
    assert first.can == (0x123, CanFlag.TX, b"\1\2")
    assert closed.event == {"event": "closed", "reason": "over", "records": 2, "frames": 2}


def test_a_pause_is_told_once(bench):
    bench.store.chunk(10, b"a")
    bench.store.flush()
    for t_ns in (20, 30, 40):
        bench.store.quiet(t_ns)
    bench.store.chunk(50, b"b")
    bench.store.flush()
    bench.store.quiet(60)
    assert [(r.kind, r.t_ns) for r in bench.records()] == [
        (RecordKind.DATA, 10), (RecordKind.IDLE, 20), (RecordKind.DATA, 50), (RecordKind.IDLE, 60),
    ]  # fmt: skip


def test_an_event_is_stored_in_its_place_and_told(bench):
    bench.store.chunk(10, b"a")
    bench.store.event("lost", 30, reason="gone")
    assert [r.kind for r in bench.records()] == [RecordKind.DATA, RecordKind.EVENT]
    assert bench.told == [("lost", {"reason": "gone"})]


def test_on_a_full_disk_all_is_held_and_stored_in_order_when_there_is_room(bench):
    bench.store.chunk(10, b"a")
    bench.store.flush()
    bench.disk.full = True
    for n in range(20):
        bench.store.chunk(20 + n, bytes((n,)))
        bench.store.flush()
    assert len(bench.records()) == 1
    assert bench.told == [("note", {"text": "cannot store: No space left on device; data is kept in memory, retrying"})]
    bench.disk.full = False
    bench.pass_ns(RETRY_NS)
    bench.store.flush()
    assert [r.data for r in bench.records()] == [b"a", *(bytes((n,)) for n in range(20))]
    assert bench.store.dropped == 0


def test_beyond_the_memory_it_is_dropped_counted_and_told_in_its_place(tmp_path):
    bench = Bench(tmp_path, held_limit=100)
    bench.disk.full = True
    for n in range(10):
        bench.store.chunk(10 + n, b"x" * 20)
        bench.store.flush()
    # Two records of 42 bytes fit.
    bench.store.event("overrun", 30, overrun=1)
    bench.disk.full = False
    bench.pass_ns(RETRY_NS)
    bench.store.chunk(50, b"after")
    bench.store.flush()
    # What came while the dropping lasted belongs to it: the order would be lost.
    kinds = [(r.kind, r.event["event"] if r.kind == RecordKind.EVENT else len(r.data)) for r in bench.records()]
    assert kinds == [(RecordKind.DATA, 20), (RecordKind.DATA, 20), (RecordKind.EVENT, "overrun"), (RecordKind.EVENT, "dropped")]
    event = bench.records()[-1]
    assert event.event == {
        "event": "dropped", "bytes": 8 * 20 + 5, "from_ns": 12, "to_ns": 50, "reason": "No space left on device",
    }  # fmt: skip
    assert event.before == 10 * 20 + 5
    assert bench.store.dropped == 165
    bench.store.chunk(60, b"more")
    bench.store.flush()
    assert (bench.records()[-1].data, bench.records()[-1].before) == (b"more", 205)


@given(st.lists(st.sampled_from(["chunk", "event", "quiet", "full", "room", "flush"]), max_size=60), st.integers(0, 300))
def test_whatever_the_disk_does_every_byte_is_stored_or_counted(tmp_path_factory, steps, held_limit):
    bench = Bench(tmp_path_factory.mktemp("store"), held_limit=held_limit)
    sent = 0
    for step in steps:
        bench.pass_ns(RETRY_NS)
        if step == "chunk":
            bench.store.chunk(bench.now_ns, b"%04d" % (sent // 4 % 10_000))
            sent += 4
        elif step == "event":
            bench.store.event("note", text="x")
        elif step == "quiet":
            bench.store.quiet(bench.now_ns)
        elif step == "flush":
            bench.store.flush()
        else:
            bench.disk.full = step == "full"
    bench.disk.full = False
    bench.store.close("over", wait=lambda seconds: bench.pass_ns(RETRY_NS))
    records = bench.records()
    stored = sum(len(r.data) for r in records if r.kind == RecordKind.DATA)
    dropped = sum(r.event["bytes"] for r in records if r.kind == RecordKind.EVENT and r.event["event"] == "dropped")
    assert stored + dropped == sent
    times = [r.t_ns for r in records]
    assert times == sorted(times)
    # A jump of `before` is what was dropped, and nothing else jumps.
    missing = expected = 0
    for record in records:
        missing += record.before - expected
        expected = record.before + record.units
        if record.kind == RecordKind.DATA:
            assert record.data == b"%04d" % (record.before // 4 % 10_000)
    assert missing == dropped
    closed = [r.event for r in records if r.kind == RecordKind.EVENT and r.event["event"] == "closed"]
    assert [c["bytes"] for c in closed] == [sent]


def test_what_cannot_be_stored_in_the_end_is_told(tmp_path):
    bench = Bench(tmp_path)
    bench.disk.full = True
    bench.store.chunk(10, b"abc")
    bench.store.close("over", wait=lambda seconds: bench.pass_ns(int(seconds * 1e9)))
    assert bench.told[-1][0] == "unstored"
    assert bench.told[-1][1]["bytes"] == 3


def test_a_status_line_never_waits():
    read, write = os.pipe()
    os.set_blocking(write, False)
    tell = StatusLine(write)
    for n in range(10_000):
        tell(n, "note", {"text": "x" * 100})
    first = os.read(read, 10_000).splitlines()[0]
    assert first == b'{"event":"note","t_ns":0,"text":"' + b"x" * 100 + b'"}'
    os.close(read)
    os.close(write)


def test_beyond_the_limit_of_all_spools_it_is_dropped_counted_and_told(tmp_path):
    """A flood: decoding does not keep up, and the disk is not filled."""
    now_ns, told = [0], []
    writer = SpoolWriter(tmp_path, STEM, segment_size=100, limit=2000)
    store = Store(writer, lambda t_ns, event, about: told.append((event, about)), held_limit=300, clock=lambda: now_ns[0])
    for n in range(100):
        now_ns[0] += RETRY_NS
        store.chunk(n + 1, bytes(50))
        store.flush()
    assert 2000 <= size_of(tmp_path) < 2300
    assert store.dropped > 2000
    # The consumer has come after it.
    reader = SpoolReader(tmp_path, STEM)
    stored = sum(len(r.data) for r in reader.read(1 << 20) if r.kind == RecordKind.DATA)
    reader.drop_before(reader.position[0])
    now_ns[0] += RETRY_NS
    store.tick()
    after = list(reader.read(1 << 20))
    stored += sum(len(r.data) for r in after if r.kind == RecordKind.DATA)
    (dropped,) = (r.event for r in after if r.kind == RecordKind.EVENT)
    assert dropped["bytes"] == store.dropped == 5000 - stored
    assert "--max-spool" in dropped["reason"]
    assert [about["bytes"] for event, about in told if event == "dropped"] == [store.dropped]
