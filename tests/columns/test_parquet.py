"""Tables of a capture hold what the log does, by blocks and frame by frame, and other programs read them."""

from __future__ import annotations

import io
import json
import os
import random
import shutil
import subprocess
import sys

import duckdb
import pandas
import polars
import pytest
from pyarrow import parquet

from analyzer import dialects, sources
from analyzer.cli import decode, main
from analyzer.cli.output import OutputFolder
from analyzer.errors import UsageError
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.sinks import parquet as tables
from analyzer.sinks.mcap_log import McapLog
from analyzer.sinks.parquet_file import files_in
from analyzer.sources import open_source, stream
from tests.columns.both_ways import blocks, messages, short_runs
from tests.columns.can_traffic import frames
from tests.columns.serial_traffic import POLLS, polls
from tests.test_captures import CAPTURES

MKS = dialects.get("mks-can")


def written(items, folder, dialect, ports=()):
    folder.mkdir()
    sink, log = tables.ParquetTables(files_in(folder)), io.BytesIO()
    kept = McapLog(log)
    Pipeline([dialect], [sink, kept], Options()).run(items)
    sink.finish({"source": "made"})
    kept.finish({})
    read = {path.stem: parquet.read_table(path) for path in sorted(folder.iterdir())}
    return {name: table.to_pylist() for name, table in read.items()}, messages(log.getvalue())


def of_log(row):
    """Return a row as the log has it: what is absent is left out."""
    shown = {name: value for name, value in row.items() if value is not None}
    for name in ("time", "bus", "sequence"):
        shown.pop(name)
    if "_raw" in shown:
        shown["_raw"] = shown["_raw"].hex(" ").upper()
    if "slots" in shown:
        shown["slots"] = json.loads(shown["slots"])
    return shown


def check(read, logged):
    """Compare the tables of commands, of states, junk and findings with the messages of a log."""
    found = {}
    for name, rows in read.items():
        kind = name.partition(".")[2].replace(".", "/") or name
        found |= {(kind, row["sequence"]): of_log(row) for row in rows if name not in ("metadata", "findings", "comments")}
    count = 0
    for topic, _, sequence, *_, data in logged:
        kind = topic.split("/", 3)[-1] if topic.count("/") > 2 else topic.rpartition("/")[2]
        kind = "states" if kind == "state" else kind
        if kind in ("stats", "findings", "comments", "foreign", "unknown"):
            continue
        row = found.pop((kind, sequence))
        row.pop("address", None)
        data.pop("_can_flags", None)
        data.pop("_backward_ns", None)
        assert row == data, (topic, sequence)
        count += 1
    return count


@pytest.mark.parametrize("held", [tables.HELD, 300])
def test_both_ways_and_the_log(held, tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "HELD", held)
    made = list(frames(MKS, random.Random(6), 400, 0.1, 0.05))
    with short_runs():
        together, logged = written(list(blocks(made, 250)), tmp_path / "together", MKS)
    assert written(made, tmp_path / "single", MKS) == (together, logged)
    assert check(together, logged) > 350
    assert [row["rule"] for row in together["findings"]] == [m[-1]["name"] for m in logged if m[0] == "/findings"]
    assert len(together["unknown"]) == sum(m[0].endswith("/unknown") for m in logged)


@pytest.mark.parametrize("name", ["lk_rs485.log", "mks_modbus.log", "mks_rs485.log"])
def test_serial_captures(name, tmp_path):
    dialect = dialects.get(name.removesuffix(".log").replace("_", "-"))
    with open_source(CAPTURES / name) as source:
        assert check(*written(list(source), tmp_path / "tables", dialect)) > 10


@pytest.mark.parametrize("jobs", ["1", "2"])
@pytest.mark.parametrize("name", POLLS)
def test_serial_lines_by_blocks(name, jobs, tmp_path, capsys, monkeypatch):
    capture = tmp_path / "line.bin"
    capture.write_bytes(b"\x00\x80" + b"".join(frame.data for frame in polls(name, random.Random(5), 1500)))
    for module in (stream, sources):
        # The first read is never part of a block.
        monkeypatch.setattr(module, "BLOCK", 1000)
    made = []
    for long in (1 << 30, 0):
        monkeypatch.setattr(decode, "LONG_CAPTURE", long)
        folder = tmp_path / f"{long}"
        assert main(["decode", str(capture), "-o", str(folder), "--dialect", name, "--to", "parquet", "--jobs", jobs]) == 0
        made.append({path.stem: parquet.read_table(path).to_pylist() for path in sorted(folder.iterdir())})
    single, together = made
    in_runs = ["frames_by_columns" in [row["name"] for row in each.pop("metadata")] for each in made]
    assert in_runs == [False, True]
    assert together == single


def test_others_read_them(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(decode, "LONG_CAPTURE", 0)
    folder = tmp_path / "can.parquet"
    words = ["decode", str(CAPTURES / "mks_can.candump.log"), "--to", "parquet", "-o", str(folder), "--dialect", "mks-can"]
    assert main(words) == 0
    replies = folder / "mks-can.read_speed.reply.parquet"
    schema = parquet.read_schema(replies)
    assert str(schema.field("time").type) == "timestamp[ns, tz=UTC]"
    assert schema.field("speed").metadata[b"unit"] == b"rpm"
    assert {b"section", b"manual", b"command"} <= set(schema.metadata)
    expected = parquet.read_table(replies)["speed"].to_pylist()
    assert duckdb.sql(f"select speed from '{replies}' order by sequence").fetchall() == [(each,) for each in expected]
    assert polars.read_parquet(replies)["speed"].to_list() == expected
    frame = pandas.read_parquet(replies)
    assert frame["speed"].to_list() == expected
    assert str(frame["time"].dtype) == "datetime64[ns, UTC]"
    assert frame["time"].to_list() == parquet.read_table(replies)["time"].to_pandas().to_list()
    runs = folder / "mks-can.run_speed.reply.parquet"
    assert str(parquet.read_schema(runs).field("status_name").type).startswith("dictionary")
    named = pandas.read_parquet(runs)["status_name"]
    assert isinstance(named.dtype, pandas.CategoricalDtype)
    assert named.to_list() == parquet.read_table(runs)["status_name"].to_pylist()
    for path in folder.iterdir():
        assert len(pandas.read_parquet(path)) == parquet.read_metadata(path).num_rows, path.name
    # What exists stays, unless it is to be replaced and holds tables alone.
    assert main(words) == 2
    (folder / "notes.txt").touch()
    assert main([*words, "--force"]) == 2
    (folder / "notes.txt").unlink()
    assert main([*words, "--force"]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["can.parquet"]


def test_forms_of_one_command_stand_in_order_and_what_tables_do_not_need_is_not_loaded(tmp_path):
    """The two forms of a command have other fields and lengths. To load what is not needed takes as long as to decode much."""
    capture, folder = tmp_path / "forms.log", tmp_path / "forms.parquet"
    every = list(frames(MKS, random.Random(3), 1200, 0, 0, polls=("set_no_limit_home",)))
    # Those that the drive says are done.
    made = [frame for pair in zip(every[::2], every[1::2], strict=True) if pair[1].data[1] == 1 for frame in pair]
    capture.write_text(
        "".join(f"({f.t_ns // 10**9}.{f.t_ns % 10**9 // 1000:06d}) can0 {f.id:03X}#{f.data.hex()}\n" for f in made)
    )
    code = (
        "import sys; from analyzer import __main__ as program; from analyzer import sources; from analyzer.cli import decode; "
        "decode.LONG_CAPTURE = 0; sources.BLOCK = sources.stream.BLOCK = 1000; "
        "assert program.main() == 0; "
        "print([name for name in ('pandas', 'pyarrow.compute', 'analyzer.sinks.mcap_file') if name in sys.modules])"
    )
    words = ["decode", str(capture), "--dialect", "mks-can", "--jobs", "1", "--to", "parquet", "-o", str(folder)]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    rows = parquet.read_table(folder / "mks-can.set_no_limit_home.request.parquet").to_pylist()
    assert [row["_raw"] for row in rows] == [frame.data for frame in made[::2]]
    lengths = {(row["home_current"] is None, len(row["_raw"])) for row in rows}
    assert sorted(lengths) == sorted(lengths, key=lambda each: -each[1])
    assert len(lengths) == 2
    metadata = {row["name"]: row["value"] for row in parquet.read_table(folder / "metadata.parquet").to_pylist()}
    assert int(metadata["frames_by_columns"]) > 300


def test_without_pyarrow_nothing_is_made(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    folder = tmp_path / "can.parquet"
    assert main(["decode", str(CAPTURES / "mks_can.candump.log"), "--to", "parquet", "-o", str(folder)]) == 2
    assert "servotap[table]" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_folder_that_holds_more_than_tables_is_not_replaced(tmp_path, capsys):
    kept = tmp_path / "kept.parquet" / "sub.parquet" / "mine.txt"
    kept.parent.mkdir(parents=True)
    kept.write_text("mine")
    link = tmp_path / "link.parquet"
    link.symlink_to(kept.parent.parent)
    for name, said in (("kept.parquet", "no folder of Parquet files alone"), ("link.parquet", "is a symbolic link")):
        with pytest.raises(UsageError, match=said):
            OutputFolder(tmp_path / name, True)
    assert kept.read_text() == "mine"


def test_a_folder_of_tables_is_replaced_by_a_whole_one(tmp_path):
    (tmp_path / "a.parquet").mkdir()
    (tmp_path / "a.parquet" / "old.parquet").write_text("old")
    output = OutputFolder(tmp_path / "a.parquet", True)
    (output.part / "new.parquet").write_text("new")
    output.keep()
    assert [path.name for path in tmp_path.rglob("*.parquet")] == ["a.parquet", "new.parquet"]
    assert [path.name for path in tmp_path.iterdir()] == ["a.parquet"]


def test_a_capture_whose_name_is_no_utf8_goes_into_tables(tmp_path):
    capture = tmp_path / os.fsdecode(b"caf\xe9.log")
    shutil.copy(CAPTURES / "mks_can.candump.log", capture)
    assert main(["decode", str(capture), "--to", "parquet", "-o", str(tmp_path / os.fsdecode(b"\xff"))]) == 0
    assert parquet.read_table((tmp_path / os.fsdecode(b"\xff") / "states.parquet").open("rb")).num_rows
