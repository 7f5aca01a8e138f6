"""A lake holds each capture once, and all of a batch or none of it, whatever happens in between."""

from __future__ import annotations

import os
import re
import shutil
import socket
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pyarrow as pa
import pytest
from deltalake import DeltaTable
from deltalake.exceptions import CommitFailedError
from deltalake.table import TableAlterer
from pyarrow import parquet
from pyarrow.fs import PyFileSystem

import servotap
from analyzer.cli import main
from analyzer.errors import UnreadableError, UsageError
from analyzer.fleet import ask
from analyzer.fleet import place as places
from analyzer.fleet.ask import Question, sql_name
from analyzer.fleet.files import PARTITIONS, DataFile
from analyzer.fleet.ingest import Outcome, Pattern, tasks, works
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Found, Place
from analyzer.fleet.rows import Work, take
from analyzer.sinks import parquet as parquet_tables
from tests.fleet.lakes import candump, hall, ingest, options, rows


def lake(folder):
    return Lake(Place(str(folder)), make=True)


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    return hall(tmp_path_factory.mktemp("hall"), 4)


@pytest.fixture(scope="module")
def clean(captures, tmp_path_factory):
    """What stands in a lake after a run in which nothing went wrong."""
    made = lake(tmp_path_factory.mktemp("clean") / "lake")
    ingest(made, captures)
    return rows(made)


def test_rows_are_those_of_decode_to_parquet(tmp_path):
    path = tmp_path / "in" / "one.log"
    path.parent.mkdir()
    path.write_text(candump(5, 400, busy=0.3))
    assert main(["decode", str(path), "--to", "parquet", "-o", str(tmp_path / "one.parquet")]) == 0
    made = lake(tmp_path / "lake")
    assert ingest(made, path.parent).new == 1
    question, compared = Question(made), 0
    for file in sorted((tmp_path / "one.parquet").iterdir()):
        if file.stem == "metadata":
            continue
        dialect, _, rest = file.stem.partition(".")
        name = file.stem if not rest else f"messages/{dialect}/" + "/".join(rest.rsplit(".", 1))
        own = question.dataset(sql_name(name)).to_table().to_pylist()
        alone = parquet.read_table(file).to_pylist()
        for row, one in zip(own, alone, strict=True):
            assert len(row.pop("capture")) == 64
            assert (str(row.pop("date")), row.pop("machine")) == ("2026-03-02", None)
            # What microseconds tell is not told twice.
            assert row.pop("time_ns") == (one["time"].value if one["time"].nanosecond else None)
            assert one.pop("time").floor("us").to_pydatetime() == row.pop("time")
            assert row == one
            compared += 1
    assert compared > 400


@pytest.mark.parametrize(
    ("second", "kept", "asked", "micros"),
    [
        ("1772442000.000001", None, 1_772_442_000_000_001_000, 1_772_442_000_000_001),
        ("1772442000.000001009", 1_772_442_000_000_001_009, 1_772_442_000_000_001_009, 1_772_442_000_000_001),
        ("12.5", 12_500_000_000, 12_500_000_000, None),
    ],
)
def test_times_are_told_once_in_the_files_and_whole_to_who_asks(tmp_path, second, kept, asked, micros):
    path = tmp_path / "one.log"
    path.write_text(f"({second}) can0 001#3233\n")
    made, name = lake(tmp_path / "lake"), "mks_can.read_speed_request"
    assert ingest(made, path).new == 1
    assert Question(made).dataset(name).to_table()["time_ns"].to_pylist() == [kept]
    told = Question(made).sql(f"select time_ns, epoch_us(time) from {name}").fetchall()
    assert told == [(asked, micros)]
    frame = servotap.lake(tmp_path / "lake").table(name).collect()
    assert (frame["time_ns"].to_list(), frame["time"].dt.epoch("us").to_list()) == ([asked], [micros])


def test_a_file_has_the_columns_that_have_values_and_another_one_those_that_come_later(tmp_path):
    schema = pa.schema([(name, pa.string() if name == "capture" else pa.int64()) for name in ("capture", "a", "b", "c")])
    parts = [
        pa.table({"capture": ["x"] * 2, "a": a, "b": b, "c": c}, schema)
        for a, b, c in (([1, 2], [3, None], [None] * 2), ([4, 5], [6, 7], [None] * 2), ([8, None], [9, 9], [None, 10]))
    ]
    place, files = Place(str(tmp_path)), []
    first = DataFile("states", schema, {})
    first.write(parts[0], ["x"])
    assert [first.fits(part) for part in parts] == [True, True, False]
    first.write(parts[1], ["x"])
    second = DataFile("states", schema, {}, first)
    second.write(parts[2], ["x"])
    # It takes all that came before, too: the number of files is bounded by that of the columns.
    assert [second.fits(part) for part in parts] == [True] * 3
    files = [each.finish(place) for each in (first, second)]
    written = [parquet.read_schema(tmp_path / "states" / each.path) for each in files]
    assert [{each.name: each.nullable for each in one} for one in written] == [
        {"capture": False, "a": False, "b": True},
        {"capture": False, "a": True, "b": True, "c": True},
    ]
    assert [each.schema for each in files] == [schema, schema]


def test_transactions_say_what_became_of_requests(tmp_path):
    path = tmp_path / "one.log"
    path.write_text(
        "(1772442000.000000) can0 001#3233\n(1772442000.002000) can0 001#32012C5F\n"
        "(1772442001.000000) can0 001#3031\n(1772442009.000000) can0 001#3233\n(1772442009.001000) can0 001#32012C60\n"
    )
    made = lake(tmp_path / "lake")
    ingest(made, path)
    found = (
        Question(made).sql("select command, outcome, round(latency, 6) from transactions order by sequence, outcome").fetchall()
    )
    assert found == [
        ("read_speed", "damaged", 0.002), ("read_encoder_carry", "unanswered", None), ("read_speed", "answered", 0.001)
    ]  # fmt: skip


def test_ingesting_again_renamed_or_twice_changes_nothing(captures, clean, tmp_path):
    made = lake(tmp_path / "lake")
    assert (ingest(made, captures).new, ingest(made, captures).new) == (4, 0)
    moved = tmp_path / "moved"
    shutil.copytree(captures, moved)
    (moved / "m0").rename(moved / "m7")
    shutil.copy(moved / "m1" / "2026-03-01" / "1.log", moved / "again.log")
    outcome = ingest(made, moved)
    assert (outcome.new, outcome.known) == (0, 6)
    assert rows(made) == clean


def test_copies_in_one_ingest_come_once(captures, clean, tmp_path, monkeypatch):
    copies = tmp_path / "copies"
    shutil.copytree(captures, copies)
    for path in sorted(captures.glob("m*/*/*.log")):
        shutil.copy(path, copies / path.parts[-3] / path.parts[-2] / f"copy-{path.name}")
    monkeypatch.setattr("analyzer.fleet.ingest.TASK_FILES", 3)
    made = lake(tmp_path / "lake")
    outcome = ingest(made, copies)
    assert (outcome.new, outcome.known) == (4, 4)
    assert rows(made) == clean


def test_a_lake_that_is_partitioned_by_date_has_the_same_rows_in_fewer_files(captures, clean, tmp_path):
    made, by_date = (Lake(Place(str(tmp_path / f"{len(by)}")), make=True, partitions=by) for by in (PARTITIONS, ("date",)))
    assert ingest(made, captures).new == ingest(by_date, captures).new == 4
    again = Lake(by_date.place)
    assert (rows(made), rows(again)) == (clean, clean)
    assert (
        again.open("states").metadata().partition_columns == again.open("transactions").metadata().partition_columns == ["date"]
    )
    assert made.open("states").metadata().partition_columns == ["date", "machine"]
    files = [len(list((tmp_path / name).rglob("*.parquet"))) for name in "21"]
    assert files[0] > 1.5 * files[1]
    asked = "select machine, count(*) from transactions where date = '2026-03-01' and machine = 'm1' group by all"
    assert Question(made).sql(asked).fetchall() == Question(again).sql(asked).fetchall() != []
    again.compact(0)
    assert rows(Lake(by_date.place)) == clean


def test_a_lake_stays_partitioned_as_it_is(captures, tmp_path, capsys):
    words = ["ingest", str(captures / "m0" / "2026-03-01" / "0.log"), "--to", str(tmp_path / "lake"), "--workers", "1"]
    assert main([*words, "--partition-by", "date"]) == main(words) == 0
    assert main([*words, "--partition-by", "date,machine"]) == 2
    assert "is partitioned by date, and stays so" in capsys.readouterr().err


def test_many_small_files_are_told_where_a_lake_could_have_fewer(captures, tmp_path, monkeypatch):
    monkeypatch.setattr("analyzer.fleet.ingest._MANY", 10)
    assert "--partition-by date" in ingest(lake(tmp_path / "lake"), captures).notes[0]
    assert ingest(Lake(Place(str(tmp_path / "by date")), make=True, partitions=("date",)), captures).notes == []


def test_few_captures_are_work_for_all_and_many_stand_together():
    def shared(count, size, machines):
        found = [Found(f"/{n}", f"{n}", size, "") for n in range(count)]
        return [len(task) for task in tasks([Work(Place("memory://x"), f, f"m{n % machines}") for n, f in enumerate(found)], 4)]

    assert shared(10, 6 << 20, 10) == [1] * 10
    assert shared(24, 1 << 20, 24) == [2] * 12
    assert shared(1000, 4000, 500) == [200] * 5
    # A machine is not divided where it can be avoided.
    assert set(shared(360, 4000, 3)) == {120}


def test_what_was_made_of_captures_is_none(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "a.log").write_text(candump(1))
    for to in ("mcap", "parquet"):
        assert main(["decode", str(folder / "a.log"), "--to", to]) == 0
    made = lake(folder / "lake")
    assert [ingest(made, folder).files for _ in range(2)] == [1, 1]


def taken(made, captures):
    found = works([Place(str(captures))], made, Pattern("{machine}/{date}/*"), False, Outcome())
    return [take(task, made.destination, options()) for task in tasks(found, 1)]


def test_two_ingests_at_once_bring_each_content_once(captures, clean, tmp_path):
    first, second = lake(tmp_path / "lake"), Lake(Place(str(tmp_path / "lake")))
    both = taken(first, captures), taken(second, captures)
    # Each has seen the lake before the other commits.
    assert first.known() == second.known() == {}
    assert first.commit(both[0]) == 4
    assert second.commit(both[1]) == 0
    assert rows(first) == rows(second) == clean


def test_a_race_is_lost_by_who_has_read_the_table_before(captures, clean, tmp_path, monkeypatch):
    first, second = lake(tmp_path / "lake"), Lake(Place(str(tmp_path / "lake")))
    half = taken(first, captures / "m0")
    whole = taken(second, captures)
    write = Lake._commit_captures

    def late(self, *rest):
        if self is second and not first.known():
            assert first.commit(half) == 2
        return write(self, *rest)

    monkeypatch.setattr(Lake, "_commit_captures", late)
    assert second.commit(whole) == 2
    assert [row["capture"] for row in rows(second)["captures"]] == [row["capture"] for row in clean["captures"]]
    count = "select count(*) from transactions"
    assert Question(second).sql(count).fetchall()[0][0] == len(clean["transactions"])


def test_a_table_that_another_client_makes_at_the_same_time_is_taken(tmp_path, monkeypatch):
    """Both see that there is none; Delta Lake refuses the commit of the later one."""
    create = DeltaTable.create

    def late(*given, **named):
        create(*given, **named)
        raise CommitFailedError("Protocol changed since last commit")

    def never(*given, **named):
        raise CommitFailedError("refused")

    schema = pa.schema([pa.field("capture", pa.string())])
    monkeypatch.setattr(DeltaTable, "create", late)
    made = lake(tmp_path / "lake")
    assert made.fitting("states", schema) == "states"
    assert made.tables() == ["captures", "states"]
    monkeypatch.setattr(DeltaTable, "create", never)
    with pytest.raises(UsageError, match="cannot be written: refused"):
        lake(tmp_path / "none")


def test_columns_that_two_clients_add_at_the_same_time_are_all_there(tmp_path, monkeypatch):
    first, second = lake(tmp_path / "lake"), Lake(Place(str(tmp_path / "lake")))
    schema = pa.schema([pa.field("capture", pa.string())])
    assert first.fitting("states", schema) == "states"
    add, rivals = TableAlterer.add_columns, ["torque"]

    def late(table, columns):
        if rivals:
            # The other client comes between the look at the columns and the commit.
            second.fitting("states", schema.append(pa.field(rivals.pop(), pa.float64())))
        add(table, columns)

    monkeypatch.setattr(TableAlterer, "add_columns", late)
    assert first.fitting("states", schema.append(pa.field("power", pa.float64()))) == "states"
    assert {"torque", "power"} < {each.name for each in Lake(first.place).open("states").schema().fields}


def test_what_cannot_be_read_says_why_and_is_tried_again(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "a.log").write_text(candump(1))
    (folder / "b.txt").write_text("nothing of use\n")
    made = lake(tmp_path / "lake")
    outcome = ingest(made, folder)
    assert [name for name, _ in outcome.unread] == ["b.txt"]
    assert "not a recognised capture format" in outcome.unread[0][1]
    assert ingest(made, folder).unread == []
    assert [name for name, _ in ingest(made, folder, retry=True).unread] == ["b.txt"]
    statuses = Question(made).sql("select status, count(*) from captures group by 1 order by 1").fetchall()
    assert statuses == [("decoded", 1), ("unreadable", 1)]


def test_a_capture_that_cannot_be_read_is_named_once(tmp_path):
    folder = tmp_path / "in" / "m1"
    folder.mkdir(parents=True)
    (folder / "empty.log").write_bytes(b"")
    (folder / "broken.mcap").write_bytes(b"\x89MCAP0\r\n")
    (folder / "a.log").write_text("a.log is no capture\n")
    said = dict(ingest(lake(tmp_path / "lake"), folder.parent).unread)
    assert said["m1/empty.log"] == "is empty"
    assert said["m1/a.log"].startswith("is not a recognised capture format")
    assert "broken.mcap" not in said["m1/broken.mcap"]


def test_a_place_that_cannot_be_read_is_replaced_by_its_content(tmp_path, monkeypatch):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "a.log").write_text(candump(1))
    made = lake(tmp_path / "lake")

    def fails(self, found):
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as broken:
        broken.setattr(Place, "as_file", fails)
        assert len(ingest(made, folder).unread) == 1
    assert ingest(made, folder, retry=True).new == 1
    assert [row["status"] for row in rows(made)["captures"]] == ["decoded"]


def test_a_capture_that_grows_while_it_is_read_is_not_taken(tmp_path, monkeypatch):
    path = tmp_path / "a.log"
    path.write_text(candump(1))
    made = lake(tmp_path / "lake")
    from analyzer.fleet import rows as rows_module

    decoded = rows_module.decoded

    def grows(*given):
        found = decoded(*given)
        with path.open("a") as stream:
            stream.write(candump(2))
        return found

    with monkeypatch.context() as busy:
        busy.setattr(rows_module, "decoded", grows)
        assert "changed while it was read" in ingest(made, path).unread[0][1]
    assert list(rows(made)) == ["captures"]
    assert ingest(made, path).new == 1


def test_a_capture_that_is_replaced_before_it_is_read_is_not_taken(tmp_path, monkeypatch):
    path = tmp_path / "a.log"
    path.write_text(candump(1))
    from analyzer.fleet import rows as rows_module

    opened = rows_module.open_reading

    def replaced(*given):
        about = path.stat()
        path.write_text(candump(1).replace("can0", "can1"))
        os.utime(path, ns=(about.st_atime_ns, about.st_mtime_ns))
        return opened(*given)

    made = lake(tmp_path / "lake")
    monkeypatch.setattr(rows_module, "open_reading", replaced)
    # Size and time are as before: what the decoder has read tells.
    assert "changed while it was read" in ingest(made, path).unread[0][1]
    assert list(rows(made)) == ["captures"]


def test_long_captures_have_files_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr("analyzer.fleet.rows.HELD", 50)
    monkeypatch.setattr("analyzer.fleet.files.GROUP", 20)
    monkeypatch.setattr("analyzer.fleet.files.FILE_BYTES", 3000)
    monkeypatch.setattr("analyzer.sinks.parquet.HELD", 50)
    folder = hall(tmp_path / "in", 3)
    made, plain = lake(tmp_path / "lake"), lake(tmp_path / "plain")
    ingest(made, folder)
    monkeypatch.undo()
    ingest(plain, folder)
    assert rows(made) == rows(plain)
    # What is full is written at once, and the next rows have another file.
    assert len(list((tmp_path / "lake" / "states").rglob("*.parquet"))) > len(
        list((tmp_path / "plain" / "states").rglob("*.parquet"))
    )


def test_a_new_column_is_added_and_another_unit_is_another_version(tmp_path):
    made = lake(tmp_path / "lake")
    speed = pa.field("speed", pa.float64(), metadata={"unit": "rpm"})
    first = pa.schema([pa.field("capture", pa.string()), speed])
    assert made.fitting("states", first) == "states"
    assert made.fitting("states", first.append(pa.field("torque", pa.float64()))) == "states"
    assert "torque" in {each.name for each in made.open("states").schema().fields}
    other = pa.schema([first[0], speed.with_metadata({"unit": "deg/s"})])
    assert (made.fitting("states", other), made.fitting("states", other)) == ("states@2", "states@2")
    assert made.notes == ["states: a column has another unit or type than before; its rows go to states@2"]


def test_what_a_later_version_adds_or_changes_stands_beside_what_was_there(captures, tmp_path, monkeypatch):
    made = lake(tmp_path / "lake")
    before = ingest(made, captures / "m0").notes[:]
    monkeypatch.setattr(parquet_tables, "STATE_UNITS", parquet_tables.STATE_UNITS | {"torque": "Nm"})
    added = ingest(made, captures / "m1" / "2026-03-01" / "1.log").notes[:]
    monkeypatch.setattr(parquet_tables, "STATE_UNITS", parquet_tables.STATE_UNITS | {"speed": "deg/s"})
    changed = ingest(made, captures / "m1").notes
    assert (before, added) == ([], [])
    assert changed == ["states: a column has another unit or type than before; its rows go to states@2"]
    question = Question(Lake(made.place))
    units = [{column.name: column.unit for column in question.columns(name)} for name in ("states", "states_v2")]
    assert [each["speed"] for each in units] == ["rpm", "deg/s"]
    assert units[0]["torque"] == "Nm"
    both = "select count(*), count(torque) from states union all select count(*), count(torque) from states_v2 order by 1 desc"
    (first, none), (second, no) = question.sql(both).fetchall()
    assert first > second > none == no == 0


def test_compacting_keeps_the_rows(captures, clean, tmp_path):
    made = lake(tmp_path / "lake")
    for number in range(4):
        ingest(made, captures / f"m{number % 2}" / "2026-03-01" / f"{number}.log", pattern=None)
    before = Question(made).sql("select count(*), sum(time_ns) from transactions").fetchall()
    joined, removed = made.compact(0)
    assert joined > 4
    assert removed >= joined
    assert Question(Lake(made.place)).sql("select count(*), sum(time_ns) from transactions").fetchall() == before


@pytest.mark.parametrize(
    ("pattern", "name", "machine", "day"),
    [
        ("{machine}/{date}/*", "press 3/2026-03-01/a.log", "press 3", "2026-03-01"),
        ("**/{machine}-{date}.log", "x/y/arm-20260301.log", "arm", "2026-03-01"),
        ("{machine}/*", "a/b/c.log", "", "None"),
    ],
)
def test_a_pattern_reads_machine_and_date(pattern, name, machine, day):
    assert tuple(map(str, Pattern(pattern).read(name))) == (machine, day)


@pytest.mark.parametrize("pattern", ["{name}/*", "{machine}/{machine}/*"])
def test_what_is_no_pattern_is_told(pattern):
    with pytest.raises(UsageError, match="--machine"):
        Pattern(pattern)


def test_what_is_no_lake_is_told(tmp_path):
    with pytest.raises(UnreadableError, match="is no lake"):
        Lake(Place(str(tmp_path)))
    with pytest.raises(UsageError, match="cannot commit"):
        Lake(Place("memory://lake"), make=True)


@pytest.mark.parametrize("url", ["memory://hall", "zip://::{}/hall.zip", "zip://m1::{}/hall.zip"])
def test_captures_lie_wherever_fsspec_reads(url, captures, clean, tmp_path):
    shutil.make_archive(str(tmp_path / "hall"), "zip", captures)
    there = Place(url.format(tmp_path))
    if url.startswith("memory"):
        there.fs.put(str(captures), "/hall", recursive=True)
    made = lake(tmp_path / "lake")
    pattern = "{date}/*" if "m1" in url else "{machine}/{date}/*"
    assert ingest(made, there, pattern=pattern).new == (2 if "m1" in url else 4)
    assert "m1" in url or rows(made) == clean
    assert ingest(made, there, pattern=pattern).new == 0


def test_what_a_store_gives_no_mark_for_is_looked_at_again(captures, tmp_path, monkeypatch):
    there, made = Place(str(captures)), lake(tmp_path / "lake")
    monkeypatch.setattr(places, "_MODIFIED", ())
    assert ingest(made, there).wanted == ingest(made, there).wanted == 5


def test_a_folder_that_may_not_be_listed_is_told_and_one_that_fails_now_and_then_is_asked_again(
    captures, tmp_path, monkeypatch
):
    there, fails = Place(str(captures)), [ConnectionError("cut off")]
    ls = type(there.fs).ls

    def closed(self, path, **named):
        if path.endswith("m0"):
            raise PermissionError(13, "Permission denied", path)
        if path.endswith("m1") and fails:
            raise fails.pop()
        return ls(self, path, **named)

    monkeypatch.setattr(places, "FIRST_WAIT", 0)
    with monkeypatch.context() as shut:
        shut.setattr(type(there.fs), "ls", closed)
        outcome = ingest(lake(tmp_path / "lake"), there)
    assert (outcome.new, fails) == (2, [])
    assert (str(captures / "m0"), "it may not be listed") in outcome.unread
    assert ingest(Lake(Place(str(tmp_path / "lake"))), there).new == 2


@pytest.mark.parametrize("call", ["glob", "ls"])
def test_a_lake_whose_store_has_gone_is_told_in_a_line(captures, tmp_path, capsys, monkeypatch, call):
    made = lake(tmp_path / "lake")
    ingest(made, captures)

    real = getattr(type(made.place.fs), call)

    def gone(self, path, **named):
        if path.endswith("_delta_log"):
            raise ConnectionError("the store is gone")
        return real(self, path, **named)

    monkeypatch.setattr(type(made.place.fs), call, gone)
    monkeypatch.setattr(places, "FIRST_WAIT", 0)
    assert main(["ask", str(tmp_path / "lake"), "select count(*) from captures"]) == 2
    told = capsys.readouterr().err
    assert (told.count("\n"), "cannot be read: the store is gone" in told) == (1, True)


def test_a_download_that_was_cut_is_fetched_again(captures, tmp_path, monkeypatch):
    there = Place("memory://cut")
    there.fs.put(str(captures / "m0"), "/cut/m0", recursive=True)
    fetch, cut = there.fs.get_file, []

    def cuts(key, target, **named):
        fetch(key, target, **named)
        if len(cut) < 2:
            cut.append(key)
            os.truncate(target, 10)

    monkeypatch.setattr(there.fs, "get_file", cuts)
    monkeypatch.setattr(places, "FIRST_WAIT", 0)
    assert (ingest(lake(tmp_path / "lake"), there).new, len(cut)) == (2, 2)


@pytest.mark.parametrize("url", ["sftp://host/lake", "zip://lake.zip", "memory://lake", "https://host/lake"])
@pytest.mark.parametrize("command", ["ingest", "ask", "fleet", "compact"])
def test_where_no_lake_can_be_is_told_in_a_line(command, url, tmp_path, capsys):
    words = {"ingest": [str(tmp_path), "--to", url], "fleet": [url, "-o", str(tmp_path / "page.html")]}.get(command, [url])
    assert main([command, *words]) == 2
    told = capsys.readouterr().err
    assert (told.count("\n"), "cannot commit" in told) == (1, True)


def test_a_source_whose_package_is_missing_names_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "paramiko", None)
    monkeypatch.delitem(sys.modules, "fsspec.implementations.sftp", raising=False)
    # What a test before this one has loaded is kept in a registry.
    monkeypatch.delitem(sys.modules["fsspec.registry"]._registry, "sftp", raising=False)
    assert main(["ingest", "sftp://host/captures", "--to", str(tmp_path / "lake")]) == 2
    assert "paramiko" in capsys.readouterr().err


def test_profiles_beside_captures_say_whose_they_are(captures, tmp_path):
    hall = tmp_path / "hall"
    shutil.copytree(captures, hall)
    (hall / "servotap.toml").write_text('machine = "press"\n')
    (hall / "m1" / "servotap.toml").write_text('machine = "arm"\n[drive.arm]\nport = "/dev/ttyUSB0"\ndialect = "mks-can"\n')
    made = lake(tmp_path / "lake")
    assert ingest(made, hall, pattern=None).files == 5
    asked = "select machine, count(*) from captures group by all order by all"
    assert Question(made).sql(asked).fetchall() == [("arm", 2), ("press", 3)]
    one = lake(tmp_path / "one")
    ingest(one, hall / "m1" / "2026-03-01" / "1.log", pattern=None)
    ingest(one, hall / "m1", pattern="{machine}/*")
    assert Question(one).sql(asked).fetchall() == [("2026-03-01", 1), (None, 1)]


@pytest.mark.parametrize("text", ["machine = 3", "machine = ", 'machine = "a\\u0000"'])
def test_a_profile_that_names_no_machine_is_told(text, tmp_path):
    (tmp_path / "servotap.toml").write_text(text)
    (tmp_path / "a.log").write_text(candump(1))
    with pytest.raises(UsageError, match=r"servotap\.toml: expected"):
        ingest(lake(tmp_path / "lake"), tmp_path)


@pytest.mark.parametrize(
    ("given", "of_lake"),
    [
        (["--store", "key=source"], {"key": "source"}),
        (["--store", "key=source", "--lake-store", "key=lake", "--lake-store", "token=x=y"], {"key": "lake", "token": "x=y"}),
    ],
)
def test_a_lake_has_the_options_of_the_sources_or_its_own(monkeypatch, given, of_lake):
    asked = []

    def opened(place, **how):
        asked.append(place)
        raise UsageError("no lake is made here")

    def from_source(url, options):
        asked.append(Place(url, dict(options)))
        return asked[-1]

    monkeypatch.setattr("analyzer.fleet.cli.stores.Lake", opened)
    monkeypatch.setattr("analyzer.fleet.cli.ingest.place", from_source)
    assert main(["ingest", "s3://source/in", "--to", "s3://plant/lake", *given]) == 2
    assert [place.options for place in asked] == [{"key": "source"}, of_lake]


def test_a_store_that_fails_now_and_then_is_asked_again():
    waits, answers = [], iter([OSError("cut off"), OSError(104, "reset"), "fine"])

    def call():
        answer = next(answers)
        if isinstance(answer, OSError):
            raise answer
        return answer

    assert places.again(call, waits.append) == "fine"
    assert waits == [0.1, 0.2]
    with pytest.raises(OSError, match="EOFError: the server went"):
        places.again(lambda: (_ for _ in ()).throw(EOFError("the server went")), lambda seconds: None)
    with pytest.raises(OSError, match="No space"):
        places.again(lambda: (_ for _ in ()).throw(OSError(28, "No space")), waits.append)
    assert len(waits) == 2


@pytest.fixture
def waits(monkeypatch):
    """The seconds that were waited between attempts; in truth, none."""
    waited = []
    monkeypatch.setattr(places, "again", partial(places.again, wait=waited.append))
    return waited


@pytest.mark.parametrize("command", [["ask", "s3://plant/lake"], ["ingest", "s3://plant/hall", "--to", "lake"]])
@pytest.mark.parametrize("option", ["endpoint_url=http://127.0.0.1:{port}", ""])
def test_an_endpoint_at_which_no_server_answers_is_told_within_seconds(command, option, waits, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        # It is bound and does not listen: a connection is refused.
        port = free.getsockname()[1]
        if not option:
            monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
        words = ["--store", option.format(port=port)] if option else []
        assert main([*command, *words]) == 2
    said = capsys.readouterr().err
    assert f"endpoint_url='http://127.0.0.1:{port}': no such server answers there (Connection refused): check" in said
    assert sum(waits) < 1


def test_a_server_that_speaks_no_tls_is_no_endpoint_of_https(waits):
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as pool:

        def answer():
            for _ in range(3):
                with server.accept()[0] as connection:
                    connection.recv(4096)
                    connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

        answered = pool.submit(answer)
        with pytest.raises(UsageError, match="check http or https"):
            Place("s3://plant/hall", {"endpoint_url": f"https://127.0.0.1:{server.getsockname()[1]}"})
        answered.result()


@pytest.mark.parametrize("url", ["minio:9000", "http://", "http://minio:99999", "nonsense"])
def test_what_is_no_endpoint_is_told(url):
    with pytest.raises(UsageError, match="expected a URL of a server"):
        Place("s3://plant/hall", {"endpoint_url": url})


def test_what_is_no_file_is_told_and_not_waited_for(tmp_path):
    (tmp_path / "in").mkdir()
    os.mkfifo(tmp_path / "in" / "pipe.log")
    (tmp_path / "in" / "endless.log").symlink_to("/dev/zero")
    outcome = ingest(lake(tmp_path / "lake"), tmp_path / "in")
    assert outcome.unread == [(name, "a pipe, a socket or a device: expected a file") for name in ("endless.log", "pipe.log")]


def test_a_name_that_is_no_text_is_taken_once(tmp_path):
    folder = tmp_path / "in\udcff"
    folder.mkdir()
    (folder / "\udcfe.log").write_text(candump(1))
    made = lake(tmp_path / "lake")
    assert (ingest(made, folder).new, ingest(made, folder).known) == (1, 1)
    assert Question(made).sql("select name from captures").fetchall() == [("\\udcfe.log",)]


@pytest.mark.parametrize("name", ["läke ü", "a#b?c", "{a,b}*", "日本 'x' & \"y\"; ~$HOME"])
def test_a_lake_may_have_a_strange_name(captures, clean, tmp_path, name, capsys):
    made = lake(tmp_path / name / "lake")
    assert ingest(made, captures).new == 4
    assert rows(Lake(made.place)) == clean
    for number in range(2):
        (tmp_path / f"{number}.log").write_text(candump(40 + number))
        assert ingest(made, tmp_path / f"{number}.log").new == 1
    assert main(["compact", made.place.url, "--keep", "0"]) == 0
    assert main(["ask", made.place.url, "select count(*) from captures"]) == 0
    assert capsys.readouterr().out.split()[-1] == "7"


@pytest.mark.parametrize("machine", ["m=1", "m%41", "m?#", "[m]", "m\\1|^", "日本 ü"])
def test_a_machine_may_have_a_strange_name(tmp_path, machine):
    for partitions in (PARTITIONS, ("date",)):
        made = Lake(Place(str(tmp_path / f"lake{len(partitions)}")), make=True, partitions=partitions)
        for number in range(2):
            path = tmp_path / str(len(partitions)) / machine / "2026-03-01" / f"{number}.log"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(candump(number))
            assert ingest(made, tmp_path / str(len(partitions))).new == 1
        before = rows(made)
        assert made.compact(0)[0] > 4
        assert rows(Lake(made.place)) == before
        assert {row["machine"] for row in before["states"]} == {machine}


@pytest.mark.parametrize("name", ["a%41", "a\udcff", "a\nb", "[x]", "a|b", "a\\b", "a^b"])
def test_a_lake_whose_name_delta_lake_reads_otherwise_is_refused(tmp_path, name):
    with pytest.raises(UsageError, match="without %"):
        lake(tmp_path / name)


@pytest.mark.parametrize(
    ("query", "told"),
    [
        ("", "empty"),
        ("how many", "expected SQL, as in: select"),
        ("select error('x')", "x"),
        ("select 'x'::int", "convert"),
        ("select 'infinity'::timestamp", "range"),
        ("junk", "no table junk (servotap ask"),
        ("captuers", "no table captuers; did you mean captures?"),
        ("mks-can.read_speed_reply", "no table mks-can.read_speed_reply"),
        ("not a table", "expected SQL, as in: select"),
    ],
)
def test_a_question_without_an_answer_is_told(tmp_path, capsys, query, told):
    lake(tmp_path / "lake")
    assert main(["ask", str(tmp_path / "lake"), query]) == 2
    assert told in capsys.readouterr().err


def test_lists_and_intervals_are_text_in_csv(tmp_path):
    lake(tmp_path / "lake")
    target = tmp_path / "answer.csv"
    assert main(["ask", str(tmp_path / "lake"), "select [1, 2] l, interval 1 day i, 1.5 n", "-o", str(target)]) == 0
    assert target.read_text().splitlines()[1] == '"[1, 2]","1 day","1.5"'


@pytest.mark.parametrize("name", ["captures/_delta_log/00000000000000000000.json", "journal/batch.json"])
def test_a_damaged_lake_is_told_in_a_line(tmp_path, name):
    made = lake(tmp_path / "lake")
    damaged = tmp_path / "lake" / name
    damaged.parent.mkdir(exist_ok=True)
    damaged.write_text("}{")
    with pytest.raises(UnreadableError, match=damaged.parts[-2] if "journal" in name else "captures cannot be read"):
        Question(Lake(made.place)).dataset("captures")


def test_arrow_reads_the_files_of_a_folder_itself(captures, tmp_path):
    """By a store of Python, Arrow waits for ever where a file fails in one thread while another begins to read."""
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    datasets = [made.dataset(table) for table in made.tables()]
    assert len(datasets) > 5
    for dataset in datasets:
        assert not isinstance(dataset.filesystem, PyFileSystem)
        assert not isinstance(dataset.filesystem.base_fs, PyFileSystem)


def changed_in_log(made, table, old, new):
    """Write a word of the log of a table anew."""
    commits = Path(made.place.path(f"{table}/_delta_log")).glob("*.json")
    changed = 0
    for path in commits:
        text = path.read_text()
        changed += text.count(old)
        path.write_text(text.replace(old, new))
    assert changed
    return Lake(Place(made.place.url))


@pytest.mark.parametrize("path", ["../secret.parquet", "states/../../../secret.parquet"])
def test_a_lake_whose_log_names_a_file_outside_of_it_is_not_read(captures, tmp_path, path, capsys):
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    parquet.write_table(pa.table({"capture": ["is-to-read-this"]}), tmp_path / "lake" / "secret.parquet")
    parquet.write_table(pa.table({"capture": ["is-to-read-this"]}), tmp_path / "secret.parquet")
    (own,) = {each.name for each in (tmp_path / "lake" / "captures").glob("*.parquet")}
    again = changed_in_log(made, "captures", own, path)
    with pytest.raises(UnreadableError, match="captures cannot be read"):
        Question(again).dataset("captures")
    assert main(["ask", str(tmp_path / "lake"), "select capture from captures"]) == 2
    assert "is-to-read-this" not in "".join(capsys.readouterr())


def test_the_stack_of_a_library_is_not_told(tmp_path):
    made = lake(tmp_path / "lake")
    with pytest.raises(UnreadableError, match=r"states cannot be read: damaged: expected a number$"), made.reading("states"):
        raise OSError(
            "damaged:\n\x1b[31mexpected a number\x1b[0m\n\n   0: <unknown>\n   1: start_thread\n             at x.c:1\n"
        )


def test_what_a_damaged_lake_would_be_partitioned_by_is_told(captures, tmp_path):
    made = lake(tmp_path / "lake")
    with pytest.raises(UnreadableError, match="expected partitions by date or machine, got date,rogue"):
        changed_in_log(made, "captures", "date,machine", "date,rogue")


@pytest.mark.parametrize("output", [[], ["-o", "answer.csv"]])
@pytest.mark.parametrize(
    "query",
    [
        "select * from read_csv('{file}')",
        "select content from read_text('{file}')",
        "from glob('{file}')",
        "from '{file}'",
        "copy (select 1) to '{file}'",
        "attach '{file}.db'",
        "set enable_external_access = true",
        "install httpfs",
        "from secret",
    ],
)
def test_a_question_reads_the_lake_alone(tmp_path, capsys, monkeypatch, query, output):
    lake(tmp_path / "lake")
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "other.csv"
    file.write_text("a\nkeep out\n")
    secret = pa.table({"a": ["keep out"]})  # noqa: F841 (DuckDB would find it by its name)
    assert main(["ask", "lake", query.format(file=file), *output]) == 2
    told = capsys.readouterr()
    assert "keep out" not in told.out + told.err
    assert file.read_text() == "a\nkeep out\n"
    assert not (tmp_path / "answer.csv").exists()


def test_the_memory_of_a_question_is_bounded(tmp_path, capsys, monkeypatch):
    resource = pytest.importorskip("resource")
    if not Path("/proc/self/status").exists():
        pytest.skip("what this process has already taken is not known")
    before = resource.getrlimit(resource.RLIMIT_DATA)
    lake(tmp_path / "lake")
    used = int(re.search(r"VmData:\s+(\d+)", Path("/proc/self/status").read_text())[1]) << 10
    monkeypatch.setattr(ask, "_memory", lambda: used + (64 << 20))
    assert main(["ask", str(tmp_path / "lake"), "select sum(length(repeat('x', 99000000 + range::int))) from range(9)"]) == 2
    assert "memory" in capsys.readouterr().err.lower()
    assert main(["ask", str(tmp_path / "lake"), "select repeat('x', 5000) as long"]) == 0
    assert "(5000 characters)" in capsys.readouterr().out
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_the_time_of_a_question_is_bounded(tmp_path, capsys):
    lake(tmp_path / "lake")
    endless = "with recursive t(n) as (select 1 union all select n + 1 from t) select count(*) from t"
    assert main(["ask", str(tmp_path / "lake"), endless, "--seconds", "1", "-o", str(tmp_path / "answer.csv")]) == 2
    assert "takes more than 1 s" in capsys.readouterr().err
    assert not (tmp_path / "answer.csv").exists()


def test_a_question_that_is_nested_too_deeply_is_told(tmp_path, capsys):
    lake(tmp_path / "lake")
    assert main(["ask", str(tmp_path / "lake"), "select " + "[" * 600 + "1" + "]" * 600]) == 2
    assert "nested too deeply" in capsys.readouterr().err


def test_a_commit_that_was_emptied_is_told(captures, tmp_path, capsys):
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    commits = sorted((tmp_path / "lake" / "captures" / "_delta_log").glob("*.json"))
    commits[-1].write_bytes(b"")
    for words in (["select count(*) from captures"], ["captures"], []):
        assert main(["ask", str(tmp_path / "lake"), *words]) == 2
        assert f"{commits[-1].name} is empty" in capsys.readouterr().err


_DOCS = Path(__file__).parents[2] / "docs" / "fleet.md"
_INDENTED = re.findall(r"\n\n((?: {4}.+\n)+)", _DOCS.read_text())
_QUESTIONS = [" ".join(block.split()) for block in _INDENTED if block.lstrip().startswith("select")]


@pytest.mark.parametrize("question", _QUESTIONS, ids=lambda question: question[:40])
def test_questions_of_the_docs_are_answered(question, captures, tmp_path):
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    answer = Question(made).sql(question)
    answer.fetchall()
    assert answer.description


def test_the_docs_ask_for_the_slowest_drives(captures, tmp_path):
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    answer = Question(made).sql(_QUESTIONS[0]).fetchall()
    assert {row[0] for row in answer} == {"m0", "m1"}
    assert len(_QUESTIONS) == 5


def test_nothing_works_on_for_an_answer_that_is_given_up(tmp_path):
    """It would outlive the program, and bring it down: a disk is full, and the answer is not written."""
    duckdb = pytest.importorskip("duckdb")
    question = Question(lake(tmp_path / "lake"))
    answers = []

    def gives_up():
        with question.bounded(60):
            answers.append(question.sql("select repeat('abcdefg', 100000) from range(200)"))
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        gives_up()
    with pytest.raises(duckdb.Error):
        answers[0].fetchall()
