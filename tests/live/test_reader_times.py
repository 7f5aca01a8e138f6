"""When bytes arrived: times set back by byte time, pauses that are told, and what both mean to the framer."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.context import Context
from analyzer.framer import SLOWEST_BYTE_NS, Framer
from analyzer.live.reader_port import IDLE_NS
from analyzer.live.reader_stream import settle
from analyzer.records import Chunk

BYTE_NS = st.sampled_from([0, 2_500, 86_805, 260_416, 1_041_666, 33_333_333])
PIECES = st.lists(st.tuples(st.integers(0, 10_000_000), st.binary(min_size=1, max_size=50)), min_size=1, max_size=8)


def in_order(pieces, start_ns):
    """Gaps between stamps -> stamps."""
    stamped, now = [], start_ns
    for gap_ns, data in pieces:
        now += gap_ns
        stamped.append((now, data))
    return stamped


@given(PIECES, BYTE_NS, st.integers(0, 10**12), st.booleans())
def test_times_are_possible(pieces, byte_ns, floor_ns, after_idle):
    pieces = in_order(pieces, floor_ns)
    settled = settle(pieces, byte_ns, floor_ns, after_idle=after_idle)
    assert b"".join(data for _, data in settled) == b"".join(data for _, data in pieces)
    times = [t_ns for t_ns, _ in settled]
    assert times == sorted(times)
    assert times[0] >= floor_ns
    # The last byte of a read had arrived when it was read; nothing is stamped later than that.
    ends = {}
    size = 0
    for stamp_ns, data in pieces:
        size += len(data)
        ends[size] = stamp_ns
    size = 0
    for t_ns, data in settled:
        size += len(data)
        if size in ends:
            assert t_ns <= ends[size]
    assert times[-1] == max(pieces[-1][0], floor_ns)


@given(PIECES, BYTE_NS, st.integers(0, 10**12))
def test_bytes_of_a_backlog_lie_a_byte_time_apart_where_there_was_time(pieces, byte_ns, floor_ns):
    settled = settle(in_order(pieces, floor_ns), byte_ns, floor_ns)
    for (t_ns, _), (after_ns, after) in pairwise(settled):
        assert t_ns <= after_ns - len(after) * byte_ns or t_ns == floor_ns


@given(PIECES, BYTE_NS, st.integers(IDLE_NS, 10**12))
def test_the_first_chunk_after_a_pause_begins_after_it_as_the_framer_reckons(pieces, byte_ns, idle_ns):
    settled = settle(in_order(pieces, idle_ns), byte_ns, idle_ns, after_idle=True)
    t_ns, data = settled[0]
    before_ns = idle_ns - IDLE_NS - 2 * byte_ns
    pause = t_ns - before_ns - len(data) * (byte_ns or SLOWEST_BYTE_NS)
    assert pause > 25_000_000


TRAFFIC = (
    b"\xfa\x01\x31\x2c", b"\xfb\x01\x31\x00\x00\x00\x00\x40\x00\x6d", b"\xfa", b"\xfb\x01\x31", b"\x01\x04\x00\x31",
    b"\xfa\x01\xf6\x01\x40\x02\x34", b"\xff\xff", b"\x00\x40\x00\x6d", b"\x3e\x9a\x01\x00\xd9", b"\xfa\x01\x3a",
)  # fmt: skip


PAUSES = st.sampled_from([0, 300_000, 5_000_000, 24_000_000, 60_000_000, 900_000_000])


@given(st.lists(st.tuples(st.sampled_from(TRAFFIC), PAUSES)), BYTE_NS, st.sampled_from(["mks-rs485", "mks-modbus", "lk-rs485"]))
def test_ending_waits_at_an_idle_changes_nothing(traffic, byte_ns, name):
    """What comes of the stored times is the same with and without the silences that were told live."""
    idle_after_ns = IDLE_NS + 2 * byte_ns
    items, now_ns, last_ns, idle = [], 10**9, 10**9, False
    for data, pause_ns in traffic:
        now_ns += pause_ns
        if now_ns - last_ns > idle_after_ns and not idle and items:
            items.append(last_ns + idle_after_ns)
            idle = True
        floor_ns = items[-1] if idle else last_ns
        for t_ns, part in settle([(now_ns, data)], byte_ns, floor_ns, after_idle=idle):
            items.append(Chunk(t_ns, "p", part))
            last_ns = t_ns
        idle = False

    def frames(with_idle):
        framer = Framer("p", [dialects.get(name)], Context(), byte_ns=byte_ns)
        found = []
        for item in items:
            if isinstance(item, Chunk):
                found += framer.feed(item)
            elif with_idle:
                found += framer.silence()
        return found + list(framer.close())

    assert [_plain(e) for e in frames(True)] == [_plain(e) for e in frames(False)]


def _plain(event):
    return type(event).__name__, event.first_ns, event.last_ns, event.offset, event.data
