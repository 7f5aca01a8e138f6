"""`--since` and `--until`, `cut` and `merge`: parts of logs and several as one, complete by themselves."""

from __future__ import annotations

import io
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from analyzer.cli import main
from analyzer.errors import UsageError
from analyzer.sources import open_source
from analyzer.sources.times import iso, parse_time
from tests import CAPTURES
from tests.collect import sum8
from tests.live.spooled import UTC, Spools, content, port, raw_of, read
from tests.logs import metadata

SECOND = 1_000_000_000
#: A stretch that begins and ends between exchanges.
FIRST, LAST = 9_950_000_000, 11_950_000_000
LEFT = port("1-left", "left", byte_ns=260_416, speed=38400)
ARM = port("2-arm", "arm", "can", ("mks-can",))


def log(folder, name="out.mcap", seconds=30, ports=(LEFT, ARM), anchor=0, parts=False):
    folder.mkdir(exist_ok=True)
    spools = Spools(folder, *ports, name=name, rotate_ns=8 * SECOND if parts else 0)
    if anchor:
        from msgspec.structs import replace

        replace(spools.config, anchor_utc_ns=UTC + anchor).save(spools.folder)
    for n in range(seconds * 10):
        for each in ports:
            if each.kind == "can":
                spools.can(each.stem, 100 * n, "001#3031")
                spools.can(each.stem, 100 * n + 2, "001#3000000000123477")
            else:
                spools.data(each.stem, 100 * n, sum8("FA 01 32"))
                spools.data(each.stem, 100 * n + 3, sum8("FB 01 32 FE D4") if n % 50 else "FF")
    spools.event("0-control", 1000 * seconds - 500, "mark", text="near the end")
    spools.end(1000 * seconds)
    if parts:
        from tests.live.test_rotation import recorded_in_steps

        recorded_in_steps(spools, 1)
    else:
        spools.record()
    return spools.log


def decoded(path, *words):
    out = Path(path).with_name("decoded.mcap")
    assert main(["decode", str(path), "-o", str(out), "--force", *words]) == 0
    return out


def findings_of(log):
    """What a log's findings say, and when."""
    return {(v["name"], v["message"], m.log_time) for t, m, v in read(log) if t == "/findings"}


def within(rows, first, last):
    """Frames and findings of a log between two times in seconds from its start."""
    return [
        (t, v) for t, m, v in rows
        if first * SECOND <= m.log_time - UTC <= last * SECOND and not t.endswith(("/raw", "/stats", "recording"))
    ]  # fmt: skip


def bare(rows):
    """Rows without sequence numbers, which count from the beginning of what is read, and what its end leaves open."""
    return [
        (t, {k: v for k, v in value.items() if k not in ("_request_sequence", "line")})
        for t, value in rows
        if "the capture ends here" not in value.get("message", "")
    ]


# --- moments --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "anchor", "ns"),
    [
        ("+10s", "start", 10 * SECOND), ("+1.5min", "start", 90 * SECOND), ("-5min", "end", -300 * SECOND),
        ("+250ms", "start", 250_000_000), ("-2h", "end", -7200 * SECOND), ("+3", "start", 3 * SECOND),
        ("1970-01-01T00:01:00Z", "clock", 60 * SECOND), ("1970-01-01T01:00:00+01:00", "clock", 0),
        ("1970-01-02", "shown", 86400 * SECOND), ("1970-01-01 00:00:01.000000001", "shown", SECOND + 1),
        ("5s", "start", 5 * SECOND), ("+1:30", "start", 90 * SECOND), ("-1:00:00.5", "end", -3600 * SECOND - SECOND // 2),
        ("09:00:05", "day", 32405 * SECOND), ("23:59:59.25", "day", 86399 * SECOND + SECOND // 4),
        ("5.25", "clock", 5250000000),
    ],
)  # fmt: skip
def test_moments(text, anchor, ns):
    assert parse_time(text)[:2] == (anchor, ns)


@pytest.mark.parametrize("text", ["", "10q", "1:30", "yesterday", "2026-13-01", "+5y", "2026-11-21T25:00:00Z", "+-3s"])
def test_no_moments(text):
    with pytest.raises(UsageError, match="is not a time"):
        parse_time(text)


def test_a_time_as_text_is_a_moment():
    assert parse_time(iso(UTC + 123)).ns == UTC + 123


def zoned(monkeypatch, name):
    monkeypatch.setenv("TZ", name)
    time.tzset()


@pytest.fixture
def berlin(monkeypatch):
    zoned(monkeypatch, "Europe/Berlin")
    yield
    monkeypatch.undo()
    time.tzset()


def shown_times(cli, path, *words):
    rows = [row for row in cli("show", path, *words).out.splitlines()[1:] if row.strip()]
    return [row.split("  # ")[1] if "  # " in row else row.split()[0] for row in rows if "!" not in row]


def test_times_are_shown_in_the_local_zone_or_in_utc_with_the_date_where_it_changes(tmp_path, cli, berlin):
    path = tmp_path / "can.log"
    path.write_text("(1764629990.5) can0 001#3031\n(1764630010.25) can0 001#3031\n")
    local = ["2025-12-01 CET (UTC+01:00)", "23:59:50.500000", "2025-12-02 CET (UTC+01:00)", "00:00:10.250000"]
    assert shown_times(cli, path) == local
    assert shown_times(cli, path, "--utc") == ["2025-12-01 UTC", "22:59:50.500000", "23:00:10.250000"]
    for since in ("00:00:05", "2025-12-02 00:00:05", "2025-12-01T23:00:05Z", "1764630005"):
        assert shown_times(cli, path, "--since", since) == local[2:], since
    assert shown_times(cli, path, "--utc", "--since", "23:00:05") == ["2025-12-01 UTC", "23:00:10.250000"]


def test_times_of_day_are_shown_and_taken_as_the_capture_prints_them(tmp_path, capsys, cli, berlin):
    path = tmp_path / "term.log"
    path.write_text("23:59:58.100 FA 01 32 2D\n23:59:58.110 FB 01 32 00 00 2E\n00:00:04.000 FA 01 32 2D\n")
    assert shown_times(cli, path) == ["23:59:58.100000", "23:59:58.110000", "day 2", "00:00:04.000000"]
    assert shown_times(cli, path, "--since", "00:00:01") == ["day 2", "00:00:04.000000"]
    out = decoded(path)
    capsys.readouterr()
    assert shown_times(cli, out, "--until", "23:59:58.105") == ["23:59:58.100000"]
    cli("cut", out, "--until", "23:59:59", "-o", tmp_path / "cut.mcap")
    assert shown_times(cli, tmp_path / "cut.mcap") == ["23:59:58.100000", "23:59:58.110000"]


def test_dates_without_a_zone_are_shown_as_printed(tmp_path, cli, berlin):
    path = tmp_path / "term.log"
    path.write_text("2026-03-02 09:00:00.100 FA 01 32 2D\n2026-03-02 09:00:00.110 FB 01 32 00 00 2E\n")
    assert shown_times(cli, path) == ["2026-03-02", "09:00:00.100000", "09:00:00.110000"]
    assert shown_times(cli, path, "--since", "09:00:00.105") == ["2026-03-02", "09:00:00.110000"]


# --- since and until ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        ("--since", "+9.95s", "--until", "+11.95s"), ("--since=-20.05s", "--until=-18.05s"),
        ("--since", iso(UTC + FIRST), "--until", iso(UTC + LAST)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("kind", ["whole", "unfinished", "parts"])
def test_a_stretch_is_decoded_as_in_the_whole(tmp_path, words, kind):
    path = log(tmp_path / "logs", parts=kind == "parts")
    whole = [row for part in sorted(path.parent.glob("*.mcap")) for row in read(part)]
    if kind == "unfinished":
        path.write_bytes(path.read_bytes()[:-60])
    out = decoded(path.parent if kind == "parts" else path, *words)
    got = within(read(out), 0, 100)
    assert bare(got) == bare(within(whole, 9.95, 11.95))
    about = metadata(out)
    assert (about["since"], about["until"]) == (iso(UTC + FIRST), iso(UTC + LAST))


def test_show_a_stretch(tmp_path, cli):
    path = log(tmp_path / "logs")
    rows = [json.loads(line) for line in cli("show", path, "--since=-1s", "--json").out.splitlines()]
    assert len(rows) == 40
    assert "lies before" in cli("show", path, "--since", "+5s", "--until", "+1s", status=2).err


def test_of_any_capture(tmp_path, cli):
    path = tmp_path / "can.log"
    path.write_text("".join(f"({100 + n}.000000) can0 001#3031\n" for n in range(100)))
    assert len(cli("show", path, "--since", "+10s", "--until", "+14s", "--json").out.splitlines()) == 5
    assert len(cli("show", path, "--since=-3s", "--json").out.splitlines()) == 4
    path.write_text("FA 01 32 2D\n" * 5)
    assert "has no times" in cli("show", path, "--since", "+10s", status=2).err


def test_comments_before_all_traffic_do_not_begin_a_log_in_1970(tmp_path, capsys, cli):
    """With a comment at no time, `--since +9.9s` and a time of day counted from 1970, and took all."""
    path = decoded(Path(shutil.copy(CAPTURES / "mks_rs485.log", tmp_path)))
    for since in ("+9.9s", "09:00:09.9"):
        capsys.readouterr()
        shown = cli("show", path, "--utc", "--since", since, "--json")
        assert len(shown.out.splitlines()) == 4
        # What a time range leaves out is not missing.
        assert "missing" not in shown.err
    cut = tmp_path / "cut.mcap"
    assert "from 2026-03-02T09:00:09.9" in cli("cut", path, "--utc", "--since", "09:00:09.9", "-o", cut).out
    assert "serial begins at byte 250: what came before is not in the log" in cli("show", cut).err


def test_what_lies_before_is_not_read(tmp_path):
    """Of a whole log only the chunks of the stretch are read, and its hash is not told."""
    spools = Spools(tmp_path, LEFT)
    for n in range(600):
        spools.data("1-left", 100 * n, sum8("FA 01 32"))
    spools.end(60_000)
    spools.record_in_chunks(20)
    data = bytearray(spools.log.read_bytes())
    chunks = make_reader(io.BytesIO(bytes(data))).get_summary().chunk_indexes
    for chunk in chunks[2:20]:
        # What is damaged there is not even noticed.
        data[chunk.chunk_start_offset + 80 : chunk.chunk_start_offset + 90] = bytes(10)
    spools.log.write_bytes(bytes(data))
    with open_source(spools.log) as source:
        source.skip_before_ns = UTC + 50 * SECOND
        times = [item.t_ns for item in source if hasattr(item, "data")]
        assert source.notes == []
    assert len(times) == 100
    assert min(times) == UTC + 50 * SECOND
    with open_source(spools.log) as source:
        assert len(list(source)) < 600
        assert any("18 problems" in note for note in source.notes)


# --- cut ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["whole", "unfinished", "parts"])
def test_a_cut_is_complete_by_itself(tmp_path, cli, kind):
    path = log(tmp_path / "logs", parts=kind == "parts")
    whole = [row for part in sorted(path.parent.glob("*.mcap")) for row in read(part)]
    if kind == "unfinished":
        path.write_bytes(path.read_bytes()[:-60])
    out = tmp_path / "cut.mcap"
    given = str(path.parent if kind == "parts" else path)
    said = cli("cut", given, "--since", "+9.95s", "--until", "+11.95s", "-o", out)
    assert "from 2026-09-21T14:13:30" in said.out
    assert ("is incomplete" in said.err) == (kind == "unfinished")
    assert bare(within(read(out), 0, 100)) == bare(within(whole, 9.95, 11.95))
    make_reader(io.BytesIO(out.read_bytes()), validate_crcs=True).get_summary()
    about = metadata(out)
    assert (about["since"], about["bus.left.endpoint"]) == (iso(UTC + FIRST), "serial:/dev/ttyUSB0")
    raw = [v for t, _, v in read(out) if t == "/left/raw"]
    assert raw[0]["_offset"] > 0
    again = decoded(out)
    assert {t for t, _, _ in read(again)} == {t for t, _, _ in read(out) if not t.endswith("/raw")}
    frames = [v["_offset"] for t, _, v in read(again) if t == "/left/1/read_speed/request"]
    assert frames == [v["_offset"] for t, _, v in read(out) if t == "/left/1/read_speed/request"]
    assert metadata(again)["dialect"] == "mks-rs485,mks-can"


def test_a_cut_of_one_bus(tmp_path, cli):
    path = log(tmp_path / "logs")
    out = tmp_path / "cut.mcap"
    assert main(["cut", str(path), "--bus", "arm", "-o", str(out)]) == 0
    assert {t.split("/")[1] for t, _, _ in read(out)} == {"arm", "recording", "comments"}
    assert {v["bus"] for t, _, v in read(out) if t == "/recording"} == {"arm", ""}
    assert "no bus none in out.mcap; there are" in cli("cut", path, "--bus", "none", "-o", tmp_path / "x.mcap", status=2).err
    assert not (tmp_path / "x.mcap").exists()


def test_wrong_cuts(tmp_path, cli):
    path = log(tmp_path / "logs", seconds=2)
    for words, text in (
        (("--since", "2020-01-01", "--until", "2020-01-02"), "nothing of out.mcap lies there"),
        (("--since", "+2s", "--until", "+1s"), "lies before"),
    ):
        assert text in cli("cut", path, *words, "-o", tmp_path / "x.mcap", status=2).err
    assert "is one of the files that are read" in cli("cut", path, "-o", path, status=2).err
    capture = tmp_path / "x.log"
    capture.write_text("(1.0) can0 001#3031\n")
    assert "expected an MCAP log" in cli("cut", capture, "-o", tmp_path / "x.mcap", status=2).err


@pytest.mark.parametrize("capture", ["mks_rs485.log", "mks_can.asc", "mks_modbus.log"])
def test_a_cut_makes_no_findings_that_the_whole_has_not(tmp_path, capsys, capture):
    whole = decoded(shutil.copy(CAPTURES / capture, tmp_path))
    whole = whole.rename(tmp_path / "whole.mcap")
    known = findings_of(whole)
    times = sorted({m.log_time for _, m, _ in read(whole)})
    for number, at in enumerate(times[1:-1:7]):
        for option in ("--since", "--until"):
            out = tmp_path / f"{number}{option}.mcap"
            assert main(["cut", str(whole), option, f"{at // SECOND}.{at % SECOND:09d}", "-o", str(out)]) == 0
            assert findings_of(decoded(out)) <= known, (option, at)
    capsys.readouterr()


# --- merge ----------------------------------------------------------------------------------------------------------


def test_a_log_is_merged_once(tmp_path, cli):
    path = log(tmp_path / "a", "a.mcap", seconds=1)
    copied = shutil.copy(path, tmp_path / "copy.mcap")
    for twice in (path, copied):
        assert "has the same messages as" in cli("merge", path, twice, "-o", tmp_path / "out.mcap", status=2).err
    assert not (tmp_path / "out.mcap").exists()


def test_logs_with_buses_of_one_name(tmp_path, cli):
    first = log(tmp_path / "a", "a.mcap", seconds=3)
    second = log(tmp_path / "b", "b.mcap", seconds=3, ports=(LEFT,), anchor=10_000_000)
    out = tmp_path / "both.mcap"
    assert "renamed: b_left" in cli("merge", first, second, "-o", out).out
    rows = read(out)
    assert len(rows) == len(read(first)) + len(read(second))
    times = [m.log_time for _, m, _ in rows]
    assert times == sorted(times)
    assert raw_of([out], "left") == raw_of([first], "left")
    assert raw_of([out], "b_left") == raw_of([second], "left")
    numbers = {}
    for topic, message, value in rows:
        if "_request_sequence" in value:
            assert numbers[value["_request_sequence"]] == topic.replace("/reply", "/request")
        if topic not in ("/findings",) and message.sequence and not topic.endswith("/state"):
            assert message.sequence not in numbers
            numbers[message.sequence] = topic
    for topic, _, value in rows:
        if topic == "/findings":
            assert numbers[value["line"]] == value["file"]
            assert value["file"].split("/")[1] in (value["bus"], "recording")
    again = decoded(out)
    assert {t for t, _, _ in read(again) if "left" in t} == {t for t, _, _ in rows if "left" in t and not t.endswith("/raw")}


def test_parts_become_one(tmp_path):
    path = log(tmp_path / "logs", parts=True)
    parts = sorted(path.parent.glob("*.mcap"))
    out = tmp_path / "week.mcap"
    assert main(["merge", str(path.parent), "-o", str(out)]) == 0
    whole = [row for part in parts for row in content(part)]
    assert content(out) == whole
    out.unlink()
    assert main(["merge", *map(str, parts), "-o", str(out)]) == 0
    assert content(out) == whole
    assert content(decoded(out)) == whole


def test_a_merge_that_fails_leaves_nothing(tmp_path, capsys):
    first = log(tmp_path / "a", seconds=1)
    assert main(["merge", str(first), str(tmp_path / "none.mcap"), "-o", str(tmp_path / "x.mcap")]) == 2
    assert main(["merge", str(first), "-o", str(tmp_path / "no" / "x.mcap")]) == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a"]


# --- follow ---------------------------------------------------------------------------------------------------------


class Following:
    """`servotap show --follow` in a process."""

    def __init__(self, path, *words):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "analyzer", "show", "--follow", "--json", str(path), *words],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0, env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )  # fmt: skip

    def lines(self, count):
        rows = []
        for _ in range(count):
            assert select.select([self.process.stdout], [], [], 20)[0], f"only {len(rows)} of {count} lines"
            rows.append(json.loads(self.process.stdout.readline()))
        return rows

    def end(self, timeout=20):
        out, err = self.process.communicate(timeout=timeout)
        return [json.loads(line) for line in out.splitlines()], err.decode()


def test_follow_one_that_is_written(tmp_path):
    """Frames are shown as they are flushed, over a rotation and a process that goes on, up to the end of the recording."""
    from analyzer.live.lock import RUNNING, Lock

    spools = Spools(tmp_path, LEFT, rotate_bytes=8000)
    lock = Lock(spools.folder, RUNNING, shared=True)
    recording = spools.begin()
    following = None
    shown = []
    try:
        for n in range(60):
            spools.data("1-left", 100 * n, sum8("FA 01 32"))
            spools.data("1-left", 100 * n + 3, sum8("FB 01 32 FE D4"))
            spools.idle("1-left", 100 * n + 60)
            recording.take(recording.merger.take(None))
            recording.settle(recording.merger.horizon_ns)
            recording.flush()
            if recording.rotation_due:
                recording.rotate(lambda step: step())
            if n == 5:
                following = Following(spools.log)
                shown += following.lines(12)
            if n == 20:
                # The pause is in the log, so the reply before it is shown though nothing follows.
                shown += following.lines(30)
            if n == 30:
                recording.abandon()
                recording = spools.begin()
        spools.end(7000)
        while not recording.merger.drained:
            recording.take(recording.merger.take(None))
        recording.finish(lambda step: step())
        rest, errors = following.end()
    finally:
        lock.close()
        if following is not None and following.process.poll() is None:
            following.process.kill()
    shown += rest
    assert recording.parts.number > 2
    assert [row["role"] for row in shown] == ["request", "reply"] * 60
    assert [row["offset"] for row in shown] == sorted(row["offset"] for row in shown)
    assert "problem" not in errors


def test_follow_ends_with_ctrl_c_and_when_nobody_writes(tmp_path):
    path = log(tmp_path / "logs", seconds=1)
    data = path.read_bytes()
    last = make_reader(io.BytesIO(data)).get_summary().chunk_indexes[-1]
    path.write_bytes(data[: last.chunk_start_offset + last.chunk_length])
    following = Following(path)
    following.lines(39)
    following.process.send_signal(signal.SIGINT)
    following.end()
    assert following.process.returncode == 0
    path.with_name("out.mcap.spool").mkdir()
    following = Following(path, "--since=-300ms")
    rows, errors = following.end()
    assert 0 < len(rows) < 20
    assert "no process writes out.mcap any more; servotap recover repairs it" in errors
