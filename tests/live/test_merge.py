"""Spools as one row in the order of time, as far as that is certain."""

from __future__ import annotations

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer.live.spool import NEVER_NS, RecordKind, SpoolWriter, pack
from analyzer.live.spool_merge import PATIENCE_NS, Merger

MS = 1_000_000
T0 = 10_000 * MS


def put(writer, ms, kind=RecordKind.DATA, data=b"x"):
    writer.write(pack(kind, T0 + ms * MS, 0, data))


def taken(merger, ms):
    now = None if ms is None else T0 + ms * MS
    return [(spool.stem, (record.t_ns - T0) // MS) for spool, record in merger.take(now)]


def test_a_record_waits_until_the_others_have_gone_beyond(tmp_path):
    a, b = SpoolWriter(tmp_path, "1-a"), SpoolWriter(tmp_path, "2-b")
    merger = Merger(tmp_path, ["1-a", "2-b"])
    put(a, 10)
    put(a, 20)
    assert taken(merger, 30) == []
    put(b, 15)
    assert taken(merger, 31) == [("1-a", 10), ("2-b", 15)]
    put(b, 25, RecordKind.IDLE)
    assert taken(merger, 32) == [("1-a", 20)]
    assert taken(merger, 33) == []
    # A silent port is waited for 200 ms and no longer.
    put(a, 40)
    assert taken(merger, 40 + PATIENCE_NS // MS - 1) == [("2-b", 25)]
    assert taken(merger, 41 + PATIENCE_NS // MS) == [("1-a", 40)]


def test_all_of_it_when_nobody_writes_any_more(tmp_path):
    a, b = SpoolWriter(tmp_path, "1-a"), SpoolWriter(tmp_path, "2-b")
    for ms in range(5):
        put(a, 2 * ms)
    put(b, 3)
    merger = Merger(tmp_path, ["1-a", "2-b", "3-none"])
    rows = []
    while not merger.drained:
        rows += taken(merger, None)
    assert rows == [("1-a", 0), ("1-a", 2), ("2-b", 3), ("1-a", 4), ("1-a", 6), ("1-a", 8)]
    assert merger.horizon_ns == NEVER_NS
    assert merger.behind_ns(10**12) == 0


@settings(max_examples=50)
@given(st.integers(0, 10_000), st.integers(1, 4))
def test_any_row_in_any_steps(tmp_path_factory, seed, count):
    """However records and looks alternate: all come once, in order, if none is stored more than the patience late."""
    folder = tmp_path_factory.mktemp("merge")
    chance = random.Random(seed)
    stems = [f"{n}-x" for n in range(count)]
    writers = {stem: SpoolWriter(folder, stem, segment_size=200) for stem in stems}
    merger = Merger(folder, stems)
    rows, sent = [], []
    for ms in range(300):
        for stem in stems:
            if chance.random() < 0.2:
                put(writers[stem], ms)
                sent.append(ms)
        if chance.random() < 0.3:
            rows += taken(merger, ms)
    while not merger.drained:
        rows += taken(merger, None)
    assert [ms for _, ms in rows] == sorted(sent)


def test_it_says_how_far_it_is_behind_also_of_what_it_has_not_read_yet(tmp_path):
    a = SpoolWriter(tmp_path, "1-a")
    for ms in range(5000):
        put(a, ms)
    merger = Merger(tmp_path, ["1-a"])
    now_ns = T0 + 5000 * MS
    assert merger.behind_ns(now_ns) == 0, "nothing is known yet"
    list(merger.take(now_ns))
    first = merger.behind_ns(now_ns)
    assert 1000 * MS < first < 5000 * MS
    while merger.horizon_ns < now_ns - 200 * MS:
        list(merger.take(now_ns))
    assert merger.behind_ns(now_ns) < first - 1000 * MS
