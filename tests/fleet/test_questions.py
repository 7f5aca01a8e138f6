"""A question reads the lake alone, within bounds; what stands in its way is told in a line."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet

from analyzer.cli import main
from analyzer.errors import ServotapError, UnreadableError
from analyzer.fleet import ask
from analyzer.fleet.ask import Question
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from tests import ROOT
from tests.fleet.lakes import hall, ingest, lake


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
def test_a_question_without_an_answer_is_told(tmp_path, cli, query, told):
    lake(tmp_path / "lake")
    assert told in cli("ask", tmp_path / "lake", query, status=2).err


def test_lists_and_intervals_are_text_in_csv(tmp_path):
    lake(tmp_path / "lake")
    target = tmp_path / "answer.csv"
    assert main(["ask", str(tmp_path / "lake"), "select [1, 2] l, interval 1 day i, 1.5 n", "-o", str(target)]) == 0
    assert target.read_text().splitlines()[1] == '"[1, 2]","1 day","1.5"'


@pytest.mark.parametrize(("words", "name"), [("ask {lake} captures", "x.parquet"), ("fleet {lake}", "x.html")])
def test_no_file_of_the_lake_is_replaced(tmp_path, capsys, words, name):
    lake(tmp_path / "lake")
    own = tmp_path / "lake" / "captures" / name
    own.write_text("rows")
    assert main([*words.format(lake=tmp_path / "lake").split(), "-o", str(own), "--force"]) == 2
    assert "lies in the lake, which is only read" in capsys.readouterr().err
    assert own.read_text() == "rows"


@pytest.mark.parametrize("name", ["captures/_delta_log/00000000000000000000.json", "journal/batch.json"])
def test_a_damaged_lake_is_told_in_a_line(tmp_path, name):
    made = lake(tmp_path / "lake")
    damaged = tmp_path / "lake" / name
    damaged.parent.mkdir(exist_ok=True)
    damaged.write_text("}{")
    with pytest.raises(UnreadableError, match=damaged.parts[-2] if "journal" in name else "captures cannot be read"):
        Question(Lake(made.place)).dataset("captures")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes with names")
@pytest.mark.parametrize("what", ["captures/*.parquet", "states/**/*.parquet", "captures/_delta_log/*.json", "journal"])
def test_a_pipe_in_a_lake_is_told_and_not_waited_for(captures, tmp_path, what, capsys):
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    place = tmp_path / "lake"
    pipe = place / "journal" / "left.json" if what == "journal" else min(place.glob(what))
    pipe.parent.mkdir(exist_ok=True)
    pipe.unlink(missing_ok=True)
    os.mkfifo(pipe)
    table = what.partition("/")[0] if what != "journal" else "captures"
    assert main(["ask", str(place), f"select * from {table}"]) == 2
    assert f"{pipe} is a pipe, a socket or a device: expected a file" in capsys.readouterr().err


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


@pytest.mark.parametrize("version", [2**64 - 1, 2**63 - 1, -5, '"one"'])
@pytest.mark.parametrize("table", ["captures", "states"])
@pytest.mark.parametrize("words", [["ask", "select * from states"], ["ingest"]])
def test_a_count_of_batches_that_is_damaged_is_told_with_its_table(captures, tmp_path, cli, words, table, version):
    at = tmp_path / "lake"
    made = lake(at)
    ingest(made, captures)
    changed_in_log(made, table, '"version":1', f'"version":{version}')
    if words[0] == "ask":
        told = cli("ask", at, *words[1:], status=2).err
    else:
        with pytest.raises(ServotapError) as raised:
            ingest(Lake(Place(str(at))), hall(tmp_path / "more", 1, 77))
        told = str(raised.value)
    assert str(at) in told
    assert "fault" not in told
    assert "restore" in told


@pytest.mark.parametrize("path", ["../secret.parquet", "states/../../../secret.parquet"])
def test_a_lake_whose_log_names_a_file_outside_of_it_is_not_read(captures, tmp_path, path, cli):
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    parquet.write_table(pa.table({"capture": ["is-to-read-this"]}), tmp_path / "lake" / "secret.parquet")
    parquet.write_table(pa.table({"capture": ["is-to-read-this"]}), tmp_path / "secret.parquet")
    (own,) = {each.name for each in (tmp_path / "lake" / "captures").glob("*.parquet")}
    again = changed_in_log(made, "captures", own, path)
    with pytest.raises(UnreadableError, match="captures cannot be read"):
        Question(again).dataset("captures")
    assert "is-to-read-this" not in "".join(cli("ask", tmp_path / "lake", "select capture from captures", status=2))


def test_the_stack_of_a_library_is_not_told(tmp_path):
    made = lake(tmp_path / "lake")
    told = r"states cannot be read: damaged: expected a number; if its"
    with pytest.raises(UnreadableError, match=told), made.reading("states"):
        raise OSError(
            "damaged:\n\x1b[31mexpected a number\x1b[0m\n\n   0: <unknown>\n   1: start_thread\n             at x.c:1\n"
        )


class PanicException(BaseException):
    """What a library in Rust raises for what it has not expected."""


def test_a_panic_of_a_library_is_told_with_the_table(tmp_path):
    made = lake(tmp_path / "lake")
    with pytest.raises(UnreadableError, match="states cannot be read: no such protocol; if its"), made.reading("states"):
        raise PanicException("no such protocol")


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
def test_a_question_reads_the_lake_alone(tmp_path, cli, monkeypatch, query, output):
    lake(tmp_path / "lake")
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "other.csv"
    file.write_text("a\nkeep out\n")
    secret = pa.table({"a": ["keep out"]})  # noqa: F841 (DuckDB would find it by its name)
    told = cli("ask", "lake", query.format(file=file), *output, status=2)
    assert "keep out" not in told.out + told.err
    assert file.read_text() == "a\nkeep out\n"
    assert not (tmp_path / "answer.csv").exists()


def test_the_memory_of_a_question_is_bounded(tmp_path, capsys, cli, monkeypatch):
    resource = pytest.importorskip("resource")
    if not Path("/proc/self/status").exists():
        pytest.skip("what this process has already taken is not known")
    before = resource.getrlimit(resource.RLIMIT_DATA)
    lake(tmp_path / "lake")
    used = int(re.search(r"VmData:\s+(\d+)", Path("/proc/self/status").read_text())[1]) << 10
    monkeypatch.setattr(ask, "_memory", lambda: used + (64 << 20))
    assert main(["ask", str(tmp_path / "lake"), "select sum(length(repeat('x', 99000000 + range::int))) from range(9)"]) == 2
    assert "memory" in capsys.readouterr().err.lower()
    assert "(5000 characters)" in cli("ask", tmp_path / "lake", "select repeat('x', 5000) as long").out
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_the_time_of_a_question_is_bounded(tmp_path, capsys):
    lake(tmp_path / "lake")
    endless = "with recursive t(n) as (select 1 union all select n + 1 from t) select count(*) from t"
    assert main(["ask", str(tmp_path / "lake"), endless, "--seconds", "1", "-o", str(tmp_path / "answer.csv")]) == 2
    assert "takes more than 1 s" in capsys.readouterr().err
    assert not (tmp_path / "answer.csv").exists()


def test_a_question_that_is_nested_too_deeply_is_told(tmp_path, cli):
    lake(tmp_path / "lake")
    assert "nested too deeply" in cli("ask", tmp_path / "lake", "select " + "[" * 600 + "1" + "]" * 600, status=2).err


def test_a_commit_that_was_emptied_is_told(captures, tmp_path, cli):
    made = lake(tmp_path / "lake")
    ingest(made, captures)
    commits = sorted((tmp_path / "lake" / "captures" / "_delta_log").glob("*.json"))
    commits[-1].write_bytes(b"")
    for words in (["select count(*) from captures"], ["captures"], []):
        assert f"{commits[-1].name} is empty" in cli("ask", tmp_path / "lake", *words, status=2).err


@pytest.mark.parametrize("table", ["captures", "states"])
def test_a_log_that_has_lost_its_newest_commit_is_told(table, captures, tmp_path, cli):
    at = tmp_path / "lake"
    made = lake(at)
    ingest(made, captures)
    assert main(["ask", str(at), f"select count(*) from {table}"]) == 0
    newest = max((at / table / "_delta_log").glob("*.json"))
    kept = newest.rename(tmp_path / newest.name)
    told = f"{at}/{table}: its log has lost its newest commits, and with them rows: restore it"
    assert told in cli("ask", at, f"select count(*) from {table}", status=2).err
    # Nothing is taken twice, and nothing beside what is gone.
    more = captures if table == "captures" else hall(tmp_path / "more", 1, 77)
    with pytest.raises(UnreadableError, match=re.escape(told)):
        ingest(Lake(Place(str(at))), more)
    kept.rename(newest)
    assert main(["ask", str(at), f"select count(*) from {table}"]) == 0


_DOCS = ROOT / "docs" / "fleet.md"
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
