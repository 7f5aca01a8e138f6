"""The parts of the view that know no terminal: kept lines, the store, series, the chart, searches, conditions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.cli.filter import vocabulary
from analyzer.errors import UsageError
from analyzer.live.snapshot import FrameLine
from analyzer.live.snapshot_lines import frame_line
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources.times import ShownTime
from analyzer.view.capture import CapturePlot, WantedNumbers, _Keeper
from analyzer.view.condition import Condition
from analyzer.view.kept import KeptLines, WantedKept
from analyzer.view.lines import ELAPSED, STEP, Columns
from analyzer.view.scale import Canvas, chart, round_ticks, time_ticks
from analyzer.view.search import Search
from analyzer.view.series import POINTS, Series
from analyzer.view.store import BLOCK, FrameStore
from tests.collect import Collect, sum8

SECOND = 1_000_000_000
MS = 1_000_000
START = 1_700_000_000_000_000_000
MKS = dialects.get("mks-rs485")
KNOWN = vocabulary([MKS])


def line(sequence, **about):
    return FrameLine(sequence, START + sequence * MS, "left", "reply", **about)


# --- kept lines -------------------------------------------------------------------------------------------------------


@given(st.integers(1, 40), st.integers(0, 200))
def test_the_newest_are_kept_under_their_numbers(limit, count):
    kept = KeptLines(limit)
    for n in range(count):
        kept.append(line(n + 1))
    assert kept.stop == count
    assert min(limit, count) <= kept.stop - kept.first <= limit + limit // 8 + 1
    for number in range(kept.first, kept.stop):
        assert kept.line(number).sequence == number + 1
        assert kept.number_of(number + 1) == number
    with pytest.raises(IndexError):
        kept.line(kept.stop)
    if kept.first:
        assert kept.number_of(kept.first) is None


@given(st.lists(st.booleans(), max_size=80))
def test_events_without_a_sequence_do_not_hide_frames(kinds):
    kept = KeptLines(1000)
    places, sequence = {}, 0
    for number, is_event in enumerate(kinds):
        sequence += not is_event
        kept.append(line(0 if is_event else sequence))
        if not is_event:
            places[sequence] = number
    assert {s: kept.number_of(s) for s in places} == places
    assert kept.number_of(sequence + 1) is None


def test_wanted_lines_outlive_the_others():
    lines = KeptLines(10)
    wanted = WantedKept(lines, lambda each: each.sequence % 10 == 0, 100)
    for n in range(100):
        lines.append(line(n + 1))
        wanted.look(1.0)
    assert [wanted.line(n).sequence for n in range(wanted.first, wanted.stop)] == list(range(10, 101, 10))
    assert wanted.number_of(50) == 4
    assert wanted.number_of(51) is None


# --- the store --------------------------------------------------------------------------------------------------------


def traffic(count):
    """Yield requests, replies, noise, wrong sums and comments."""
    texts = [sum8("FA 01 32"), sum8("FB 01 32 01 40"), sum8("FA 02 30"), sum8("FB 02 30 00 00 00 01 12 34"),
             "00 55 AA", sum8("FA 01 32")[:-2] + "00", sum8("FA 01 F6 01 40 02"), sum8("FB 01 F6 01"),
             sum8("FA 03 30")]  # fmt: skip
    for n in range(count):
        yield Chunk(START + n * MS, "left", bytes.fromhex(texts[n % len(texts)]), burst=True)
        if n % 97 == 0:
            yield Comment(START + n * MS, "left", f"comment {n}")


def stored(count, memory=1 << 20):
    store, collect = FrameStore(memory), Collect()
    keeper = _Keeper(store)
    Pipeline([MKS], (keeper, collect), Options(late_ns=100 * MS)).run(traffic(count))
    return store, collect, keeper


@pytest.mark.parametrize("memory", [1 << 20, 4000, 0])
def test_every_line_comes_back_wherever_it_is_kept(memory):
    store, collect, _ = stored(3000, memory)
    assert bool(store.spilled) == (memory < 1 << 20)
    lines = [store.line(n) for n in range(store.stop)]
    frames = [each for each in lines if each.dialect]
    assert len(frames) == len(collect.entries) > 4 * BLOCK
    for each, entry in zip(frames, collect.entries, strict=True):
        frame = entry.message.frame
        assert (each.sequence, each.t_ns, each.offset) == (entry.sequence, frame.last_ns, frame.offset)
        assert each.raw == frame.data.hex(" ").upper()
        assert (each.latency_ns, each.request_sequence) == (entry.latency_ns, entry.request_sequence)
        assert store.line(store.number_of(each.sequence)).sequence == each.sequence
    assert [each.text for each in lines if each.command == "comment"] == [c.text for c in collect.comments]
    assert len(lines) == len(collect.entries) + len(collect.pieces) + len(collect.comments)
    # Backwards, so that no block is there by chance.
    assert [store.line(n).sequence for n in reversed(range(store.stop))] == [each.sequence for each in reversed(lines)]
    store.close()


def test_findings_that_come_late_are_with_their_frames():
    store, collect, _ = stored(2000)
    told = {(f.sequence, f.rule) for f in collect.findings}
    shown = {(each.sequence, rule) for n in range(store.stop) for each in (store.line(n),) for rule in each.rules}
    assert "unanswered" in {rule for _, rule in told}
    assert shown == told


def test_hopping_from_finding_to_finding_leaves_none_out():
    store = FrameStore()
    for n in range(5 * BLOCK):
        store.add_line(line(n + 1, rules=("x",) if n in (700, 701, 1200) else ()))

    def all_from(start, step):
        found = []
        while True:
            search = Search(store, lambda each: bool(each.rules), start, step, hop=store.hop)
            search.look(60)
            if search.found is None:
                return found
            found.append(start := search.found)

    assert all_from(-1, 1) == [700, 701, 1200]
    assert all_from(store.stop, -1) == [1200, 701, 700]


@pytest.mark.parametrize(
    "text",
    [
        'command == "read_speed"', "speed > 300", "address == 2 and role == 'reply'", '"bad_checksum" in findings', "time > 0",
        "checksum_ok == 0", "latency > 0.1",
        "latency > 100us", 'raw == "00 55 AA"', 'role == "junk"', "sequence % 100 == 0", "speed != 0",
        "enabled == 1", "not (address == 1)",
    ],
)  # fmt: skip
def test_a_filter_over_the_store_is_the_filter_over_each_line(text):
    store, _, _ = stored(1500)
    condition = Condition(text, KNOWN)
    wanted = WantedNumbers(store, condition)
    while not wanted.done:
        wanted.look(0.001)
    expected = [each.sequence for n in range(store.stop) if condition(each := store.line(n))]
    assert [wanted.line(n).sequence for n in range(wanted.stop)] == expected
    for at, sequence in enumerate(expected):
        assert not sequence or wanted.number_of(sequence) == at


def test_a_filter_of_unknown_names_is_refused():
    with pytest.raises(UsageError, match="no field 'spede'"):
        Condition("spede > 1", KNOWN)


def test_a_plot_of_the_store_has_the_points_of_its_frames():
    store, collect, keeper = stored(1500)
    name = "left/1/state.speed"
    assert name in keeper.series
    assert "left/1/run_speed.request.speed" in keeper.series
    plot = CapturePlot(store, [name, "left/2/read_encoder_carry.reply.encoder"], START, START + 500 * MS)
    while not plot.done:
        plot.look(0.001)
    expected = [
        (e.message.frame.last_ns, 320.0) for e in collect.entries if e.topic.endswith("read_speed/reply")
        and e.message.frame.last_ns <= START + 500 * MS
    ]  # fmt: skip
    assert plot.points(name) == expected
    assert {value for _, value in plot.points("left/2/read_encoder_carry.reply.encoder")} == {0x1234}


# --- series and chart -------------------------------------------------------------------------------------------------


def test_a_long_series_keeps_its_peaks_in_bounded_memory():
    series = Series()
    count = 40 * POINTS
    for n in range(count):
        series.add(n, 1000.0 if n == 12345 else -1000.0 if n == 99_999 else n % 7)
    points = series.points(0, count)
    assert len(points) <= 2 * POINTS + 4
    assert (12345, 1000.0) in points
    assert (99_999, -1000.0) in points
    assert [t for t, _ in points] == sorted(t for t, _ in points)
    newest = series.points(count - 500, count)
    assert [t for t, _ in newest] == list(range(count - 500, count))


def test_what_is_no_number_is_left_out_of_a_series():
    series = Series()
    for value in (1.0, float("nan"), float("inf"), 2.0):
        series.add(1, value)
    assert [v for _, v in series.points(0, 2)] == [1.0, 2.0]


def test_dots():
    canvas = Canvas(2, 1)
    for x, y in ((0, 0), (1, 3), (2, 1), (9, 9), (-1, 0)):
        canvas.dot(x, y)
    assert canvas.rows() == [chr(0x2800 + 0x40 + 0x08) + chr(0x2800 + 0x04)]


def test_a_rising_line():
    rows = chart([(0, 0.0), (15, 7.0)], (0, 15), (0.0, 7.0), (8, 2))
    assert rows[0].strip()
    assert rows[1].strip()
    assert rows[1].index(rows[1].strip()[0]) < rows[0].index(rows[0].strip()[0])
    assert all(0x2800 <= ord(c) < 0x2900 or c == " " for row in rows for c in row)


@given(
    st.lists(st.tuples(st.integers(0, 10**19), st.floats(-1e300, 1e300)), max_size=50),
    st.integers(1, 40), st.integers(1, 10),
)  # fmt: skip
def test_a_chart_of_anything_has_its_size(points, width, height):
    points.sort()
    values = [v for _, v in points] or [0.0]
    times = [t for t, _ in points] or [0]
    rows = chart(points, (times[0], times[-1]), (min(values), max(values)), (width, height))
    assert [len(row) for row in rows] == [width] * height
    assert any(row.strip() for row in rows) == bool(points)


_ANY = st.floats(-1e200, 1e200).filter(lambda value: value == 0 or abs(value) > 1e-80)


@pytest.mark.parametrize(
    ("least", "greatest", "most", "ticks"),
    [
        (0, 240, 4, [0, 100, 200, 300]),
        (-150, 240, 5, [-200, 0, 200, 400]),
        (320, 320, 3, [200, 300, 400]),
        (0.0013, 0.0041, 4, [0, 0.002, 0.004, 0.006]),
        (0, 0, 3, [-1, 0, 1]),
    ],
)
def test_ticks_are_round_and_lie_around_the_values(least, greatest, most, ticks):
    assert round_ticks(least, greatest, most) == pytest.approx(ticks)


@given(_ANY, _ANY, st.integers(2, 12))
def test_ticks_of_anything(one, other, most):
    least, greatest = sorted((one, other))
    ticks = round_ticks(least, greatest, most)
    assert 2 <= len(ticks) <= most
    assert ticks[0] <= least
    assert greatest <= ticks[-1]
    assert ticks == sorted(ticks)


def test_times_on_an_axis_are_round():
    utc = ShownTime(utc=True)
    assert [label for _, label in time_ticks(START, START + 9 * SECOND, utc, 4)] == [
        "22:13:20", "22:13:22", "22:13:24", "22:13:26", "22:13:28",
    ]  # fmt: skip
    assert [label for _, label in time_ticks(START, START + 50 * MS, utc, 3)] == ["22:13:20.00", "22:13:20.02", "22:13:20.04"]
    assert [label for _, label in time_ticks(0, 3 * SECOND, utc, 3)] == ["0", "1", "2", "3"]
    assert [label for _, label in time_ticks(START, START + 3600 * SECOND, utc, 4)] == [
        "22:15:00",
        "22:30:00",
        "22:45:00",
        "23:00:00",
    ]


# --- rows -------------------------------------------------------------------------------------------------------------


@given(st.text(), st.text(), st.integers(10, 200), st.sampled_from(["reply", "junk", "event", "x"]))
def test_a_row_has_its_width_and_nothing_that_steers(text, command, width, role):
    row = Columns(ShownTime()).row(
        FrameLine(1, START, text, role, command, text, values={text: text}, text=text, rules=(text,), dialect=text), width
    )
    assert row.cell_len == width
    assert row.plain.isprintable()
    assert not row.spans or all(span.style is not None for span in row.spans)


def test_a_frame_of_another_node_is_told_by_its_identifier():
    sink, columns = Collect(), Columns(ShownTime())
    frames = [
        CanFrame(START, "can0", 1, bytes.fromhex("3233")),
        CanFrame(START + MS, "can0", 0x18FEF100, bytes(8), extended=True),
        CanFrame(START + 2 * MS, "can0", 0x701, b"\5"),
    ]
    Pipeline([dialects.get("mks-can")], (sink,), Options()).run(frames)
    lines = [frame_line(entry) for entry in sink.entries]
    rows = [columns.row(line, 100).plain for line in lines]
    assert [line.who for line in lines] == ["0x001", "0x18FEF100", "0x701"]
    assert "18FEF100 00 00 00 00 00 00 00 00" in rows[1]
    # The column is as wide as the widest identifier so far.
    assert "     0x701 · foreign" in rows[2]
    condition = Condition('role == "foreign" and address == 0x701', vocabulary([dialects.get("mks-can")]))
    assert [condition(line) for line in lines] == [False, False, True]


def test_severity_and_role_are_told_without_colour():
    columns = Columns(ShownTime())
    rows = [
        columns.row(FrameLine(1, START, "left", role, "x", severity=severity), 80).plain
        for role, severity in (("request", "error"), ("reply", "warning"), ("unknown", "info"), ("junk", ""), ("event", ""))
    ]
    assert [row[0] for row in rows] == ["E", "W", "i", " ", " "]
    assert [next(sign for sign in "><?~*" if f" {sign} " in row) for row in rows] == [">", "<", "?", "~", "*"]


def test_times():
    assert ShownTime().text(START + 1_234_567) == "22:13:20.001234"
    assert ShownTime().text(5_000_000_000) == "       5.000000"
    columns = Columns(ShownTime())
    columns.first_ns = START
    for mode, before_ns, text in ((ELAPSED, None, "1.500000"), (STEP, START + 1499 * MS, "+0.001000"), (STEP, None, "")):
        columns.time = mode
        at = line(1500)
        assert columns.row(at, 100, before_ns).plain[2:17].strip() == text
