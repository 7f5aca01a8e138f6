"""`servotap export` to tables: what pandas, polars, DuckDB and openpyxl read is what `show` shows."""

from __future__ import annotations

import csv
import errno
import gc
import io
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from datetime import datetime, timedelta
from itertools import pairwise

import duckdb
import openpyxl
import pandas
import polars
import pytest
from pyarrow import parquet

from analyzer import dialects
from analyzer.cli import main
from analyzer.encoder import build
from analyzer.sources.times import Clock, ShownTime
from analyzer.table import files
from analyzer.table.columns import HEAD, TAIL, units_of_dialects
from analyzer.table.tables import Long, parse_rate
from tests import CAPTURES, ROOT

EVERY = ("mks_rs485.log", "mks_modbus.log", "mks_can.asc", "lk_rs485.log", "mks_rs485.bin")


def exported(capsys, source, target, *options):
    status = main(["export", str(source), "-o", str(target), "--force", *options])
    told = capsys.readouterr()
    assert status == 0, told.err
    return told.out


def refused(cli, *words):
    return cli("export", *words, status=2).err


def shown(capsys, source):
    assert main(["show", str(source), "--json"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def read_csv(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def messages(path):
    return polars.read_parquet(path).filter(polars.col("role") != "finding")


def bare(heading):
    return re.sub(r" \[.*\]$", "", heading)


def hex_log(path, *lines):
    """Write a capture of hex text; lines are (bus, mark, bytes)."""
    rows = [
        f"2026-03-02 09:00:{n:02d}.000000000 {mark} [bus:{bus}] {data.hex(' ')}" for n, (bus, mark, data) in enumerate(lines)
    ]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("name", EVERY)
def test_csv_holds_what_show_shows(name, tmp_path, capsys):
    told = exported(capsys, CAPTURES / name, tmp_path / "a.csv")
    rows = read_csv(tmp_path / "a.csv")
    frames = shown(capsys, CAPTURES / name)
    assert f"{len(rows)} rows" in told
    told_once = [row for row in rows if row["role"] != "finding"]
    assert len(told_once) == len(frames)
    for row, frame in zip(told_once, frames, strict=True):
        values = {bare(heading): text for heading, text in row.items() if text}
        assert values["raw"] == (frame["raw"] if frame["dialect"] != "mks-can" else frame["raw"].split(" ", 1)[1])
        assert values.get("findings", "").split("; ") == (frame["findings"] or [""])
        for key in ("bus", "dialect", "role", "command", "address", "sequence", "offset"):
            assert values[key] == str(frame[key])
        assert float(values.get("latency", "nan")) == pytest.approx(1e3 * frame.get("latency", float("nan")), nan_ok=True)
        known = {c.name for c in (*HEAD, *TAIL)} | {"section"}
        fields = {k for k in frame if k not in known and not (k.endswith(("_name", "_text")) and k[:-5] in frame)}
        # A field with several units is one column for each; this message has one of them.
        assert fields - {"slots"} == set(values) - known - {"slots"}
        for field in fields - {"slots"}:
            expected = frame.get(field + "_name", frame[field])
            assert values[field] == str(expected) or float(values[field]) == expected


@pytest.mark.parametrize("name", EVERY)
def test_parquet_is_the_same_to_pandas_polars_and_duckdb(name, tmp_path, capsys):
    path = tmp_path / "a.parquet"
    exported(capsys, CAPTURES / name, path)
    exported(capsys, CAPTURES / name, tmp_path / "a.csv")
    texts = read_csv(tmp_path / "a.csv")
    table = parquet.read_table(path)
    as_pandas, as_polars = pandas.read_parquet(path), polars.read_parquet(path)
    as_duckdb = duckdb.sql(f"from '{path}'")
    assert list(as_pandas.columns) == as_polars.columns == as_duckdb.columns == table.column_names
    rows = as_polars.drop("time").rows(named=True)
    assert as_duckdb.project("* exclude time").fetchall() == [tuple(row.values()) for row in rows]
    assert as_pandas["sequence"].tolist() == [row["sequence"] for row in rows]
    for row, text in zip(rows, texts, strict=True):
        written = list(text.values())[1:]
        assert ["" if v is None else str(v).lower() if isinstance(v, bool) else str(v) for v in row.values()] == written


def test_units_stand_in_the_header_or_in_the_metadata(tmp_path, capsys):
    source = CAPTURES / "mks_rs485.log"
    exported(capsys, source, tmp_path / "a.csv")
    assert {"time", "elapsed [s]", "speed [rpm]", "position [counts]", "latency [ms]"} <= set(read_csv(tmp_path / "a.csv")[0])
    exported(capsys, source, tmp_path / "a.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    speed = {k.decode(): v.decode() for k, v in table.schema.field("speed").metadata.items()}
    assert speed["unit"] == "rpm"
    assert speed["section"] == "5.1.3, 6.5.1, 6.5.2, 6.6.1, 6.8.1"
    assert speed["manual"] == dialects.get("mks-rs485").manual
    assert table.schema.field("position_counts").metadata[b"unit"] == b"counts"
    assert "complete" in table.schema.field("status").metadata[b"choices"].decode()
    assert table.schema.metadata[b"servotap.source"] == b"mks_rs485.log"
    assert table.schema.metadata[b"servotap.dialect"] == b"mks-rs485"


def test_times_are_exact_to_the_nanosecond(tmp_path, capsys):
    source = hex_log(tmp_path / "a.log", ("left", ">", bytes.fromhex("FA01322D")))
    source.write_text(source.read_text().replace("09:00:00.000000000", "09:00:00.123456789"))
    exported(capsys, source, tmp_path / "a.parquet")
    times = parquet.read_table(tmp_path / "a.parquet")["time"]
    assert str(times.type) in ("timestamp[ns, tz=UTC]", "timestamp[ns]")
    assert times[0].value == 1_772_442_000_123_456_789
    exported(capsys, source, tmp_path / "a.csv", "--utc")
    assert read_csv(tmp_path / "a.csv")[0]["time"].removesuffix("Z") == "2026-03-02T09:00:00.123456789"


def test_iso_times_carry_the_zone_they_are_shown_in(monkeypatch):
    t_ns = 1_772_442_000_123_456_789
    monkeypatch.setenv("TZ", "America/St_Johns")
    time.tzset()
    try:
        assert ShownTime().iso(t_ns) == "2026-03-02T05:30:00.123456789-03:30"
        assert ShownTime(utc=True).iso(t_ns) == "2026-03-02T09:00:00.123456789Z"
        assert ShownTime(Clock.PRINTED).iso(t_ns) == "2026-03-02T09:00:00.123456789"
        assert pandas.Timestamp(ShownTime().iso(t_ns)).value == t_ns
    finally:
        monkeypatch.undo()
        time.tzset()


def test_times_without_a_date_are_seconds_and_durations(tmp_path, capsys):
    told = exported(capsys, CAPTURES / "mks_rs485.bin", tmp_path / "a.csv")
    assert "note: timestamps estimated" in told
    first, second = read_csv(tmp_path / "a.csv")[:2]
    assert 0 < float(first["time [s]"]) < float(second["time [s]"]) < 1
    assert first["elapsed [s]"] == "0.0"
    exported(capsys, CAPTURES / "mks_rs485.bin", tmp_path / "a.parquet")
    assert str(polars.read_parquet(tmp_path / "a.parquet")["time"].dtype) == "Duration(time_unit='ns')"


def test_excel(tmp_path, capsys):
    exported(capsys, CAPTURES / "mks_can.asc", tmp_path / "a.xlsx")
    exported(capsys, CAPTURES / "mks_can.asc", tmp_path / "a.csv")
    book = openpyxl.load_workbook(tmp_path / "a.xlsx")
    assert book.sheetnames == ["servotap", "columns"]
    names, *rows = book["servotap"].iter_rows(values_only=True)
    texts = read_csv(tmp_path / "a.csv")
    assert list(names)[1:] == list(texts[0])[1:]
    assert len(rows) == len(texts)
    for row, text in zip(rows, texts, strict=True):
        cells = dict(zip(names, row, strict=True))
        assert abs(cells["time"] - datetime.fromisoformat(text["time"][:26])) <= timedelta(milliseconds=1)
        assert str(cells["raw"] or "") == text["raw"]
        assert cells["speed [rpm]"] == (int(text["speed [rpm]"]) if text["speed [rpm]"] else None)
        assert cells["checksum_ok"] is (text["checksum_ok"] == "true")
    about = {row[0]: row[1:] for row in book["columns"].iter_rows(values_only=True)}
    assert about["speed [rpm]"][0] == "rpm"


def test_a_full_disk_is_told_of_excel_too(tmp_path, capsys, monkeypatch):
    """XlsxWriter leaves its archive open then, which closes itself later on a file that is gone."""
    late = []
    monkeypatch.setattr(sys, "unraisablehook", late.append)
    for full_at in (0, 3000):
        monkeypatch.setattr(files, "_Released", type("Full", (Full,), {"room": full_at}))
        assert main(["export", str(CAPTURES / "mks_can.asc"), "-o", str(tmp_path / "a.xlsx")]) == 2
        assert "No space left on device; the incomplete file was removed" in capsys.readouterr().err
        gc.collect()
    assert late == []
    assert not list(tmp_path.iterdir())


class Full(files._Released):
    """A file on a disk that has room for so many bytes."""

    room = 0

    def write(self, data):
        if not isinstance(self._stream, files._Counting) and self.tell() + len(data) > self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data)


def test_a_sheet_that_is_full_goes_on_in_the_next(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("analyzer.table.files.EXCEL_ROWS", 30)
    exported(capsys, CAPTURES / "mks_rs485.log", tmp_path / "a.xlsx")
    book = openpyxl.load_workbook(tmp_path / "a.xlsx")
    assert book.sheetnames == ["servotap", "servotap 2", "columns"]
    assert (book["servotap"].max_row, book["servotap 2"].max_row) == (31, 10)
    assert book["servotap 2"]["A1"].value == book["servotap"]["A1"].value


def test_pandas_reads_csv_with_its_times_and_units(tmp_path, capsys):
    exported(capsys, CAPTURES / "mks_rs485.log", tmp_path / "a.csv", "--utc", "--fields", "speed")
    table = pandas.read_csv(tmp_path / "a.csv", parse_dates=["time"])
    assert table["time"].is_monotonic_increasing
    assert table.loc[table.role == "reply", "speed [rpm]"].tolist() == [320]
    found = duckdb.sql(f"select max(\"speed [rpm]\") from read_csv('{tmp_path / 'a.csv'}')").fetchall()
    assert found == [(600,)]


# --- what is in a capture -----------------------------------------------------------------------------------------------


def test_two_dialects_have_a_column_for_each_unit(tmp_path, capsys):
    mks, lk = dialects.get("mks-rs485"), dialects.get("lk-rs485")
    source = hex_log(
        tmp_path / "a.log",
        ("left", ">", build(mks, "read_speed", 1)),
        ("left", "<", bytes.fromhex("FB013201406F")),
        ("right", ">", build(lk, "run_speed", 1, {"speed": 360}, physical=True)),
        ("right", ">", build(lk, "run_speed", 1, {"speed": 90.25}, physical=True)),
    )
    exported(capsys, source, tmp_path / "a.parquet", "--dialect", "mks-rs485,lk-rs485")
    table = messages(tmp_path / "a.parquet")
    assert table["dialect"].to_list() == ["mks-rs485"] * 2 + ["lk-rs485"] * 2
    assert table["speed_rpm"].to_list() == [None, 320, None, None]
    assert table["speed_deg_per_s"].to_list() == [None, None, 360.0, 90.25]
    exported(capsys, source, tmp_path / "a.csv", "--dialect", "mks-rs485,lk-rs485")
    assert [row["speed [deg/s]"] for row in read_csv(tmp_path / "a.csv") if row["role"] != "finding"] == [
        "",
        "",
        "360.0",
        "90.25",
    ]


def test_names_do_not_depend_on_what_is_in_a_capture(tmp_path, capsys):
    """Position has two units in this dialect, even if only one of them came."""
    source = hex_log(tmp_path / "a.log", ("left", "<", bytes.fromhex("FB0131000000007FF09C")))
    exported(capsys, source, tmp_path / "a.parquet")
    assert polars.read_parquet(tmp_path / "a.parquet")["position_counts"].to_list() == [32752]


@pytest.mark.parametrize(("sent", "exact"), [(2**63 - 1, "92233720368547758.07"), (-(2**62) - 1, "-46116860184273879.05")])
def test_a_number_beyond_doubles_has_its_text(sent, exact, tmp_path, capsys):
    data = build(dialects.get("lk-rs485"), "move_multi_turn", 1, {"position": sent})
    source = hex_log(tmp_path / "a.log", ("left", ">", data), ("left", ">", build(dialects.get("lk-rs485"), "read_state_1", 1)))
    exported(capsys, source, tmp_path / "a.parquet")
    table = messages(tmp_path / "a.parquet")
    assert table["position_text"].to_list() == [exact, None]
    assert table["position"][0] == pytest.approx(sent / 100)


def test_junk_and_findings_have_their_columns(tmp_path, capsys):
    source = hex_log(
        tmp_path / "a.log",
        ("left", ">", bytes.fromhex("FA01322D")),
        ("left", "<", bytes.fromhex("005577")),
        ("left", ">", bytes.fromhex("FA01831770 05".replace(" ", ""))),
        ("left", ">", bytes.fromhex("FA01DDD8")),
    )
    exported(capsys, source, tmp_path / "a.csv", "--dialect", "mks-rs485")
    rows = read_csv(tmp_path / "a.csv")
    junk = next(row for row in rows if row["role"] == "junk")
    assert (junk["junk"], junk["raw"], junk["findings"], junk["address"]) == ("noise", "00 55 77", "junk_noise", "")
    wrong = next(row for row in rows if row["command"] == "set_current" and row["role"] == "request")
    assert (wrong["current [mA]"], wrong["severity"], wrong["findings"]) == ("6000", "error", "out_of_range")
    assert wrong["finding_texts"] == "current: got 6000 mA, expected 0..5200 mA"
    unknown = next(row for row in rows if row["findings"] == "unknown_command")
    assert (unknown["command"], unknown["raw"]) == ("", "FA 01 DD D8")
    late = [row for row in rows if row["role"] == "finding"]
    assert {(row["findings"], row["command"], row["sequence"]) for row in late} >= {("unanswered", "read_speed", "1")}


def test_frames_of_other_nodes_are_rows_without_fields(tmp_path, capsys, cli):
    source = tmp_path / "a.log"
    source.write_text(
        "(1436509052.249713) can0 001#F60140023A\n(1436509052.269713) can0 12345678#AABBCC\n(1436509052.279713) can0 223#1122\n"
    )
    exported(capsys, source, tmp_path / "a.parquet", "--ids", "1")
    table = messages(tmp_path / "a.parquet")
    assert table.select("address", "role", "dialect", "command", "checksum_ok", "raw", "findings").rows()[1:] == [
        (0x12345678, "foreign", None, None, None, "AA BB CC", None), (0x223, "foreign", None, None, None, "11 22", None),
    ]  # fmt: skip
    assert "--ids is for csv and parquet and xlsx" in refused(cli, source, "-o", tmp_path / "a.pcapng", "--ids", "1")


@pytest.mark.parametrize("seed", range(3))
def test_every_byte_of_a_damaged_capture_stands_once(seed, tmp_path, capsys):
    chance = random.Random(seed)
    data = bytearray(
        (CAPTURES / "mks_rs485.bin").read_bytes() + (CAPTURES / "lk_rs485.bin").read_bytes() + chance.randbytes(40)
    )
    for _ in range(30):
        data[chance.randrange(len(data))] = chance.randrange(256)
    (tmp_path / "a.bin").write_bytes(data)
    exported(capsys, tmp_path / "a.bin", tmp_path / "a.parquet", "--dialect", "mks-rs485,lk-rs485")
    rows = messages(tmp_path / "a.parquet").select("offset", "raw").rows()
    assert b"".join(bytes.fromhex(raw) for _, raw in sorted(rows)) == data


def test_every_finding_stands_once(tmp_path, capsys, cli):
    for name in EVERY:
        exported(capsys, CAPTURES / name, tmp_path / "a.csv")
        told = [rule for row in read_csv(tmp_path / "a.csv") for rule in row["findings"].split("; ") if rule]
        counts = json.loads(cli("decode", CAPTURES / name, "-o", tmp_path / "a.mcap", "--force", "--json").out)["findings"]
        assert {rule: told.count(rule) for rule in told} == {each["rule"]: each["count"] for each in counts}


def test_no_field_has_the_name_of_another_column():
    names = {c.name for c in (*HEAD, *TAIL)}
    assert not names & set(units_of_dialects(dialects.every()))


# --- wide ---------------------------------------------------------------------------------------------------------------


def test_wide_holds_the_last_value(tmp_path, capsys):
    exported(capsys, CAPTURES / "mks_rs485.log", tmp_path / "a.parquet", "--wide")
    table = polars.read_parquet(tmp_path / "a.parquet")
    lines = table.drop("time", "elapsed").rows()
    assert all(a != b for a, b in pairwise(lines))
    speed = table["/serial/1/read_speed/reply.speed"].to_list()
    assert speed[0] is None
    assert speed[speed.index(320) :] == [320] * speed.count(320)
    # Its frame is damaged: it stands in the long table alone.
    assert "/serial/1/read_enabled/reply.enabled" not in table.columns


@pytest.mark.parametrize("name", ["mks_rs485.log", "mks_can.asc", "lk_rs485.log"])
def test_a_rate_samples_what_the_changes_show(name, tmp_path, capsys):
    exported(capsys, CAPTURES / name, tmp_path / "a.parquet", "--wide")
    exported(capsys, CAPTURES / name, tmp_path / "b.parquet", "--rate", "7Hz")
    changes, steps = (polars.read_parquet(tmp_path / f"{each}.parquet") for each in "ab")
    assert changes.columns == steps.columns
    begin = changes["time"].cast(polars.Int64)[0]
    at = steps["time"].cast(polars.Int64).to_list()
    assert at == [begin + k * 10**9 // 7 for k in range(len(at))]
    times, lines = changes["time"].cast(polars.Int64).to_list(), changes.drop("time", "elapsed").rows()
    for t_ns, line in zip(at, steps.drop("time", "elapsed").rows(), strict=True):
        assert line == next(held for t, held in reversed(list(zip(times, lines, strict=True))) if t <= t_ns)
    exported(capsys, CAPTURES / name, tmp_path / "c.parquet")
    last = parquet.read_table(tmp_path / "c.parquet")["time"].to_pylist()[-1].value
    assert at[-2] < last <= at[-1]


@pytest.mark.parametrize(
    ("text", "hertz"), [("100Hz", 100), ("2.5 khz", 2500), ("10ms", 100), ("250us", 4000), ("2s", 0.5), ("50", 50)]
)
def test_rates(text, hertz):
    assert parse_rate(text) == hertz


def test_a_clock_that_jumps_by_years_gives_no_endless_table(tmp_path, cli):
    source = hex_log(tmp_path / "a.log", *[("left", "<", bytes.fromhex("FB013201406F"))] * 2)
    source.write_text(source.read_text().replace("2026-03-02 09:00:01", "2046-03-02 09:00:01"))
    assert "choose a lower rate" in refused(cli, source, "-o", tmp_path / "a.csv", "--rate", "1kHz")
    assert not (tmp_path / "a.csv").exists()


# --- what is chosen -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--topics", "read_speed"], ["/serial/1/read_speed/reply.speed"]),
        (["--topics", "/serial/1/read_sp*/reply"], ["/serial/1/read_speed/reply.speed"]),
        (["--topics", "1/state", "--fields", "speed,pos*"], ["/serial/1/state.position", "/serial/1/state.speed"]),
        (["--topics", "read_speed", "--fields", "latency"], ["/serial/1/read_speed/reply.latency"]),
        (["--topics", "2"], [f"/serial/2/read_io/reply.{name}" for name in ("in_1", "in_2", "out_1", "out_2")]),
    ],
)
def test_topics_and_fields_are_chosen_by_patterns(options, expected, tmp_path, capsys):
    exported(capsys, CAPTURES / "mks_rs485.log", tmp_path / "a.parquet", "--wide", *options)
    assert polars.read_parquet(tmp_path / "a.parquet").columns == ["time", "elapsed", *expected]


def test_long_rows_without_a_chosen_field_are_left_out(tmp_path, capsys):
    exported(capsys, CAPTURES / "mks_rs485.log", tmp_path / "a.csv", "--fields", "speed", "--topics", "1")
    rows = read_csv(tmp_path / "a.csv")
    assert [row["speed [rpm]"] for row in rows] == ["320", "320", "0", "320", "600"]
    assert "position [counts]" not in rows[0]


@pytest.mark.parametrize(
    ("option", "told"),
    [
        (["--topics", "read_sped"], "did you mean read_speed"),
        (["--fields", "sped"], "did you mean speed"),
        (["--fields", "voltage"], "no field here is 'voltage'"),
        (["--fields", "volt_age"], "no command has a field 'volt_age'"),
        (["--rate", "fast"], "expected 100Hz"),
        (["--chunks"], "--chunks is for candump and pcapng and hex, and this is csv"),
    ],
)
def test_what_cannot_be_chosen_is_told_with_the_near_word(option, told, tmp_path, capsys, cli):
    words = [CAPTURES / "mks_rs485.log", "-o", tmp_path / "a.csv", *option]
    try:
        error = refused(cli, *words)
    except SystemExit:
        error = capsys.readouterr().err
    assert told in error
    assert not list(tmp_path.iterdir())


def test_the_end_of_the_name_says_the_format(tmp_path, capsys, cli):
    exported(capsys, CAPTURES / "mks_rs485.log", tmp_path / "a.pcapng")
    assert (tmp_path / "a.pcapng").read_bytes()[:4] == b"\x0a\x0d\x0d\x0a"
    assert ".csv, .parquet, .xlsx" in refused(cli, CAPTURES / "mks_rs485.log", "-o", tmp_path / "a.doc")
    error = refused(cli, CAPTURES / "mks_rs485.log", "-o", tmp_path / "b.pcapng", "--wide")
    assert "--wide is for csv and parquet and xlsx, and this is pcapng" in error


# --- files that are whole -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "package"), [("parquet", "pyarrow"), ("xlsx", "xlsxwriter")])
def test_a_missing_package_is_named_with_its_extra(kind, package, tmp_path, cli, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    error = refused(cli, CAPTURES / "mks_rs485.log", "-o", tmp_path / f"a.{kind}")
    assert f"needs {package}, which is not installed: pip install 'servotap[table]'" in error
    assert not list(tmp_path.iterdir())


def test_csv_needs_no_extra(tmp_path):
    code = (
        "import sys; from analyzer.cli import main; "
        f"status = main(['export', {str(CAPTURES / 'mks_rs485.log')!r}, '-o', {str(tmp_path / 'a.csv')!r}]); "
        "print(status, {'pyarrow', 'pandas', 'polars', 'numpy', 'xlsxwriter'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 set()"


def test_to_standard_output(capfdbinary):
    assert main(["export", str(CAPTURES / "mks_rs485.log"), "--to", "csv", "-o", "-"]) == 0
    told = capfdbinary.readouterr()
    assert len(list(csv.reader(io.StringIO(told.out.decode())))) == 40
    assert b"39 rows" in told.err


@pytest.mark.parametrize("kind", ["csv", "parquet", "xlsx"])
def test_an_interrupt_leaves_no_file(kind, tmp_path):
    (tmp_path / "in").mkdir()
    source = tmp_path / "in" / "big.bin"
    source.write_bytes((CAPTURES / "mks_rs485.bin").read_bytes() * 3000)
    command = [sys.executable, "-m", "analyzer", "export", str(source), "-o", str(tmp_path / f"a.{kind}")]
    running = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob(".a.*.part")):
        assert time.monotonic() < deadline
        assert running.poll() is None
    running.send_signal(signal.SIGINT)
    assert running.communicate(timeout=60)[1] == "servotap: interrupted; nothing more was written\n"
    assert running.returncode == 130
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


@pytest.mark.parametrize("kind", ["csv", "parquet", "xlsx"])
def test_a_full_disk_leaves_no_file(kind, tmp_path, cli, monkeypatch):
    class Full(Long):
        def lines(self):
            yield from list(super().lines())[:5]
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("analyzer.cli.export_table.Long", Full)
    error = refused(cli, CAPTURES / "mks_rs485.log", "-o", tmp_path / f"a.{kind}")
    assert error == (
        f"servotap export: cannot write {tmp_path / f'a.{kind}'}: No space left on device; the incomplete file was removed\n"
    )
    assert not list(tmp_path.iterdir())


def test_more_columns_than_excel_holds_are_told(tmp_path, cli, monkeypatch):
    monkeypatch.setattr("analyzer.table.files.EXCEL_COLUMNS", 20)
    assert "choose some with --topics" in refused(cli, CAPTURES / "mks_rs485.log", "-o", tmp_path / "a.xlsx")
    assert not list(tmp_path.iterdir())


def test_texts_that_look_like_formulas_stay_texts(tmp_path, capsys):
    source = hex_log(tmp_path / "a.log", ("left", "<", bytes.fromhex("FB013201406F")))
    source.write_text(source.read_text().replace("[bus:left]", "[bus:--1]"))
    exported(capsys, source, tmp_path / "a.xlsx")
    cell = openpyxl.load_workbook(tmp_path / "a.xlsx")["servotap"]["C2"]
    assert (cell.value, cell.data_type) == ("--1", "s")


def test_a_file_that_exists_stays(tmp_path, cli):
    (tmp_path / "a.csv").write_text("mine")
    assert "--force replaces it" in refused(cli, CAPTURES / "mks_rs485.log", "-o", tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == "mine"


def test_many_rows_wait_beside_the_file_and_come_back(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "full"))
    monkeypatch.setattr("analyzer.table.rows._IN_MEMORY", 4096)
    monkeypatch.setattr("analyzer.table.rows._BATCH", 7)
    monkeypatch.setattr("analyzer.table.arrow.BATCH", 10)
    exported(capsys, CAPTURES / "mks_rs485.log", tmp_path / "a.parquet")
    assert parquet.ParquetFile(tmp_path / "a.parquet").num_row_groups == 4
    assert polars.read_parquet(tmp_path / "a.parquet")["sequence"].to_list() == list(range(1, 40))
    assert [path.name for path in tmp_path.iterdir()] == ["a.parquet"]


@pytest.mark.skipif(sys.platform != "linux", reason="the system keeps no such limit")
@pytest.mark.parametrize("mebibytes", [200, 244, 293, 342, 600])
def test_with_too_little_memory_for_a_package_that_is_told_before_it_is_loaded(mebibytes, tmp_path):
    target = tmp_path / "a.parquet"
    limited = f"ulimit -v {mebibytes << 10}; exec {sys.executable} -m analyzer export {CAPTURES}/mks_rs485.log -o {target}"
    done = subprocess.run(["sh", "-c", limited], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2
    said = f"servotap export: this needs pyarrow, and that 640 MiB of memory: ulimit -v allows {mebibytes} MiB\n"
    assert said in done.stderr
    assert not target.exists()
