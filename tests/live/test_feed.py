"""The feed: its counts are those of the traffic, its snapshots are bounded, and the pipe never blocks."""

from __future__ import annotations

import io
import os
from collections import Counter

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.findings import RULES
from analyzer.live import snapshot_sink as feeds
from analyzer.live.snapshot import BusCounts, Snapshot, SnapshotWriter, decode, encode
from analyzer.live.snapshot_sink import SnapshotSink
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, Comment, Event
from tests.collect import Collect, sum8

MS = 1_000_000
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
POLL = sum8("FA 01 32") + sum8("FB 01 32 01 40")


def feed_of(items, names="mks-rs485", **options):
    feed, collect = SnapshotSink(**options), Collect()
    Pipeline([dialects.get(n) for n in names.split()], (feed, collect), Options()).run(items)
    return feed, collect


def polls(count, bus="left", every_ns=10 * MS):
    """Yield requests and replies a few ms apart."""
    for n in range(count):
        t_ns = START + n * every_ns
        yield Chunk(t_ns, bus, bytes.fromhex(sum8("FA 01 32")))
        yield Chunk(t_ns + 3 * MS, bus, bytes.fromhex(sum8("FB 01 32 01 40")))


def test_counts_are_those_of_the_traffic():
    items = [*polls(10), Chunk(START + SECOND, "left", bytes.fromhex("00 55 AA")), *polls(4, "right")]
    feed, collect = feed_of(items)
    last = feed.snapshot(START + 2 * SECOND)
    buses = {bus.bus: bus for bus in last.buses}
    assert (buses["left"].frames, buses["left"].bytes, buses["left"].junk, buses["left"].junk_bytes) == (20, 100, 1, 3)
    assert (buses["right"].frames, buses["right"].bytes) == (8, 40)
    assert {(r.bus, r.command, r.role): r.count for r in last.rows} == {
        ("left", "read_speed", "request"): 10, ("left", "read_speed", "reply"): 10,
        ("right", "read_speed", "request"): 4, ("right", "read_speed", "reply"): 4,
    }  # fmt: skip
    assert last.rules == dict(Counter(collect.rules))
    assert sum(b.warnings for b in last.buses) == len(collect.findings) == 1


def test_latency_is_last_mean_and_most():
    items = []
    for n, late_ms in enumerate((3, 9, 6)):
        items.append(Chunk(START + n * SECOND, "left", bytes.fromhex(sum8("FA 01 32"))))
        items.append(Chunk(START + n * SECOND + late_ms * MS, "left", bytes.fromhex(sum8("FB 01 32 00 01"))))
    feed, _ = feed_of(items)
    row = next(r for r in feed.snapshot(START + 4 * SECOND).rows if r.role == "reply")
    assert (row.latencies, row.latency_last_ns, row.latency_max_ns) == (3, 6 * MS, 9 * MS)
    assert row.latency_sum_ns == 18 * MS


def test_rates_and_load_are_of_the_last_second():
    feed = SnapshotSink(byte_ns={"left": 1 * MS})
    pipeline = Pipeline([dialects.get("mks-rs485")], (feed,), Options())
    feed.snapshot(START)
    pipeline.run(polls(10))
    counts = feed.snapshot(START + 1 * SECOND).buses[0]
    assert (counts.frame_rate, counts.byte_rate, counts.load) == (20.0, 100.0, 0.1)
    counts = feed.snapshot(START + 3 * SECOND).buses[0]
    assert (counts.frame_rate, counts.byte_rate, counts.load) == (0.0, 0.0, 0.0)
    assert counts.frames == 20


def test_the_load_of_a_can_bus_counts_bits():
    frames = [CanFrame(START + n * MS, "arm", 1, bytes.fromhex("32 33")) for n in range(100)]
    feed, _ = feed_of([], "mks-can", byte_ns={"": 7}, bit_ns={"": 1000})
    pipeline = Pipeline([dialects.get("mks-can")], (feed,), Options())
    feed.snapshot(START)
    pipeline.run(frames)
    assert feed.snapshot(START + SECOND).buses[0].load == pytest.approx(100 * (47 + 16) * 1000 / 1e9, abs=1e-4)


def test_the_load_is_left_out_where_the_speed_is_not_known():
    feed, _ = feed_of(polls(3))
    feed.snapshot(START)
    assert b"load" not in encode(feed.snapshot(START + SECOND))


@settings(max_examples=20)
@given(st.lists(st.integers(0, 200), max_size=8), st.randoms(use_true_random=False))
def test_each_frame_is_shown_once_or_counted_as_left_out(sizes, random):
    feed = SnapshotSink()
    pipeline = Pipeline([dialects.get("mks-rs485")], (feed,), Options())
    shown: list[int] = []
    left_out = count = 0
    for size in sizes:
        for _ in range(size):
            data = bytes.fromhex(POLL) if random.random() < 0.9 else random.randbytes(5)
            pipeline.feed(Chunk(START + count * MS, "left", data))
            count += 1
        snapshot = feed.snapshot(START + count * MS)
        assert len(snapshot.frames) <= feeds.NEWEST + feeds.MARKED + feeds.FROM_ROWS + feeds.EVENTS
        shown += [line.sequence for line in snapshot.frames]
        left_out += snapshot.left_out
    pipeline.close()
    last = feed.snapshot(START + count * MS)
    shown += [line.sequence for line in last.frames]
    assert len(shown) == len(set(shown))
    assert shown == sorted(shown)
    assert len(shown) + left_out + last.left_out == sum(b.frames + b.junk for b in last.buses) == pipeline.sequence


def test_what_is_rare_is_shown_among_thousands():
    rare = Chunk(START, "left", bytes.fromhex(sum8("FA 05 F6 01 40 02")))
    wrong = Chunk(START, "left", bytes.fromhex(sum8("FA 01 32")[:-2] + "00"))
    feed, _ = feed_of([rare, wrong, *polls(3000)])
    snapshot = feed.snapshot(START + 60 * SECOND)
    assert ("run_speed", "5") in {(line.command, line.who) for line in snapshot.frames}
    assert "bad_checksum" in {rule for line in snapshot.frames for rule in line.rules}
    assert snapshot.left_out > 5000


def test_a_snapshot_stays_small_on_a_hostile_bus():
    frames = [CanFrame(START + n, "arm", n % 0x800, bytes((n % 251, n // 0x800 % 256, 7))) for n in range(30_000)]
    feed, collect = feed_of(frames, "mks-can")
    snapshot = feed.snapshot(START + SECOND)
    assert len(snapshot.rows) <= feeds.ROWS_SENT
    assert len(encode(snapshot)) < 200_000
    assert sum(bus.frames for bus in snapshot.buses) == len(collect.entries) == 30_000
    rows = {}
    for n in range(30):
        rows |= {(r.bus, r.who, r.command, r.role): r for r in feed.snapshot(START + n * SECOND).rows}
    assert len(rows) <= feeds.ROW_LIMIT + 1
    assert sum(row.count for row in rows.values()) == 30_000
    assert rows["arm", "", "others", ""].count > 0


def test_the_last_snapshot_has_every_row():
    frames = [CanFrame(START + n, "arm", n % 0x400, bytes.fromhex("32 33")) for n in range(0x400)]
    feed, _ = feed_of(frames, "mks-can")
    assert len(feed.snapshot(START, ended=True).rows) == 0x400


def test_lines_say_what_a_frame_says():
    feed, _ = feed_of(polls(1))
    request, reply = feed.snapshot(START).frames
    assert (request.role, request.who, request.command, request.raw) == (Role.REQUEST, "1", "read_speed", "FA 01 32 2D")
    assert (reply.values, reply.state, reply.latency_ns) == ({"speed": 320}, {"speed": 320.0}, reply.latency_ns)
    assert reply.request_sequence == request.sequence
    assert reply.section


def test_events_and_comments_are_lines():
    feed, _ = feed_of([
        Event(START, "left", "lost", {"reason": "unplugged"}),
        Event(START, "left", "clock_drift", {"drift": 0.1}),
        Comment(START, "left", "hello"),
    ])  # fmt: skip
    feed.event(START, "", "stalled", "the disk is full")
    snapshot = feed.snapshot(START)
    assert [(line.command, line.text, line.severity) for line in snapshot.frames] == [
        ("lost", "unplugged", RULES["port_lost"].severity),
        ("comment", "hello", ""),
        ("stalled", "the disk is full", "warning"),
    ]
    assert snapshot.left_out == 0


def test_a_snapshot_survives_json():
    feed, _ = feed_of([*polls(3), Chunk(START, "left", b"\x00\xff"), Comment(None, "left", "\x1b[31mred")])
    snapshot = feed.snapshot(START + SECOND, ended=True)
    line = encode(snapshot)
    assert line.count(b"\n") == 1
    assert decode(line) == snapshot


# --- the pipe ---------------------------------------------------------------------------------------------------------


class PipeEnd(io.FileIO):
    """The reading end of a pipe. `take` returns the whole snapshots that are there."""

    rest = b""

    def take(self):
        *lines, self.rest = (self.rest + (self.readall() or b"")).split(b"\n")
        return [decode(line) for line in lines]


@pytest.fixture
def pipe():
    read, write = os.pipe()
    os.set_blocking(read, False)
    with PipeEnd(read) as reader:
        writer = SnapshotWriter(write)
        yield reader, writer
        writer.close()


def big(number):
    return Snapshot(START, number, buses=[BusCounts("left", frames=number)], log="x" * 200_000)


def test_a_full_pipe_drops_snapshots_and_never_waits(pipe):
    reader, writer = pipe
    arrive = [number for number in range(1, 100) if writer.offer(big(number))]
    assert writer.dropped == 99 - len(arrive) > 50
    got = reader.take()
    assert [s.number for s in got] == arrive[: len(got)]
    # What was under way is finished when there is room, and what comes then is whole.
    assert writer.offer(big(200))
    got += reader.take()
    writer.close()
    got += reader.take()
    assert [s.number for s in got] == [*arrive, 200]
    assert got[-1].buses[0].frames == 200
    assert reader.readall() == b""


def test_a_reader_that_is_gone_is_noticed(pipe):
    reader, writer = pipe
    reader.close()
    assert not writer.offer(big(1))
    assert writer.gone
    assert not writer.offer(big(2))
    assert writer.dropped == 2


def test_the_line_of_a_snapshot_is_checked():
    with pytest.raises(msgspec.MsgspecError):
        decode(b"[]")
