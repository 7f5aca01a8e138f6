"""A lake holds each capture once, and all of a batch or none of it, even if others write to it at the same time."""

from __future__ import annotations

import shutil

import pyarrow as pa
import pytest
from deltalake import DeltaTable
from deltalake.exceptions import CommitFailedError
from deltalake.table import TableAlterer
from pyarrow import parquet

import servotap
from analyzer.cli import main
from analyzer.errors import UsageError
from analyzer.fleet.ask import Question, sql_name
from analyzer.fleet.files import PARTITIONS, DataFile
from analyzer.fleet.ingest import Outcome, Pattern, tasks, works
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from analyzer.fleet.rows import take
from analyzer.sinks import parquet as parquet_tables
from tests.fleet.lakes import candump, ingest, lake, options, rows


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


def test_a_lake_stays_partitioned_as_it_is(captures, tmp_path, cli):
    words = ["ingest", str(captures / "m0" / "2026-03-01" / "0.log"), "--to", str(tmp_path / "lake"), "--workers", "1"]
    assert main([*words, "--partition-by", "date"]) == main(words) == 0
    assert "is partitioned by date, and stays so" in cli(*words, "--partition-by", "date,machine", status=2).err


def test_many_small_files_are_told_where_a_lake_could_have_fewer(captures, tmp_path, monkeypatch):
    monkeypatch.setattr("analyzer.fleet.ingest._MANY", 10)
    assert "--partition-by date" in ingest(lake(tmp_path / "lake"), captures).notes[0]
    assert ingest(Lake(Place(str(tmp_path / "by date")), make=True, partitions=("date",)), captures).notes == []


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


def test_compacting_removes_nothing_behind_a_link(captures, tmp_path, cli):
    """Delta Lake follows links, and takes what no table names for left: files of others, anywhere."""
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "mine.parquet").write_bytes(b"x")
    link = tmp_path / "lake" / "findings" / "date=2020-01-01"
    link.symlink_to(outside)
    assert f"{link} is a link to a folder" in cli("compact", made.place.url, "--keep", "0", status=2).err
    assert (outside / "mine.parquet").exists()
    link.unlink()
    assert main(["compact", made.place.url, "--keep", "0"]) == 0


def test_compacting_keeps_the_rows(captures, clean, tmp_path):
    made = lake(tmp_path / "lake")
    for number in range(4):
        ingest(made, captures / f"m{number % 2}" / "2026-03-01" / f"{number}.log", pattern=None)
    before = Question(made).sql("select count(*), sum(time_ns) from transactions").fetchall()
    joined, removed = made.compact(0)
    assert joined > 4
    assert removed >= joined
    assert Question(Lake(made.place)).sql("select count(*), sum(time_ns) from transactions").fetchall() == before
