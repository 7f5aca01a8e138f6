"""Which captures a lake takes, whose they are, and what is said of those that it does not take."""

from __future__ import annotations

import os
import shutil

import pytest

from analyzer.cli import main
from analyzer.errors import UsageError
from analyzer.fleet.ask import Question
from analyzer.fleet.files import PARTITIONS
from analyzer.fleet.ingest import Pattern, tasks
from analyzer.fleet.lake import JOURNAL, RANGES, Lake
from analyzer.fleet.place import Found, Place
from analyzer.fleet.rows import Work
from tests.fleet.lakes import candump, hall, ingest, lake, rows


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


def test_files_of_another_lake_are_no_captures(tmp_path):
    folder = hall(tmp_path / "in", 2)
    another = lake(folder / "older")
    ingest(another, folder / "m0")
    for name in (JOURNAL, RANGES):
        (folder / "older" / name).mkdir(exist_ok=True)
        (folder / "older" / name / "left.json").write_text("{}")
    # What else stands there is a capture like any other.
    (folder / "older" / "mine.log").write_text(candump(7))
    made = lake(tmp_path / "lake")
    outcome = ingest(made, folder, pattern=None)
    assert outcome.files == 4
    assert sorted(row["name"] for row in made.rows("name") if row["name"]) == [
        "m0/2026-03-01/0.log", "m1/2026-03-01/1.log", "notes.txt", "older/mine.log",
    ]  # fmt: skip
    assert ingest(lake(tmp_path / "third"), folder / "older").files == 1


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


def test_what_is_no_file_is_told_and_not_waited_for(tmp_path):
    (tmp_path / "in").mkdir()
    os.mkfifo(tmp_path / "in" / "pipe.log")
    (tmp_path / "in" / "endless.log").symlink_to("/dev/zero")
    (tmp_path / "in" / "gone.log").symlink_to("nowhere")
    outcome = ingest(lake(tmp_path / "lake"), tmp_path / "in")
    special = "a pipe, a socket or a device: expected a file"
    assert outcome.unread == [("endless.log", special), ("gone.log", "No such file or directory"), ("pipe.log", special)]


def test_a_name_that_is_no_text_is_taken_once(tmp_path):
    folder = tmp_path / "in\udcff"
    folder.mkdir()
    (folder / "\udcfe.log").write_text(candump(1))
    made = lake(tmp_path / "lake")
    assert (ingest(made, folder).new, ingest(made, folder).known) == (1, 1)
    assert Question(made).sql("select name from captures").fetchall() == [("\\udcfe.log",)]


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
