"""An ingest that is killed or finds no room leaves all of a batch or nothing; the next one brings the rest, once each."""

from __future__ import annotations

import itertools
import json
import random
import signal
import subprocess
import sys

import pytest

from analyzer.fleet import ingest as ingesting
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from tests.fleet.lakes import candump, hall, ingest, rows


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    return hall(tmp_path_factory.mktemp("hall"), 2) / "m0"


@pytest.fixture(scope="module")
def mortal(captures):
    """What has a process ingest, and returns how it ended."""
    command = [sys.executable, "-B", "-m", "tests.fleet.mortal"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:

        def run(lake, **how):
            print(json.dumps({"captures": str(captures), "lake": str(lake), **how}), file=process.stdin, flush=True)
            return json.loads(process.stdout.readline())

        yield run
        process.stdin.close()


def healed(lake, captures, clean):
    """Check that a lake has all of the batch or nothing, and after the next ingest all, once each. Say what that found."""
    made = Lake(Place(str(lake)), make=True)
    there = rows(made)
    assert there in ({}, clean)
    outcome = ingest(made, captures)
    assert rows(made) == clean
    made.recover()
    assert list(made.pending()) == []
    return bool(there), outcome.recovered, outcome.new


def test_a_client_that_is_killed_before_any_step(mortal, captures, clean, tmp_path):
    killed, every, _, said, _ = mortal(tmp_path / "whole")
    assert (killed, said) == (0, "")
    assert every > 12
    seen = set()
    for step in range(1, every + 1):
        assert mortal(tmp_path / str(step), step=step)[0] == signal.SIGKILL
        seen.add(healed(tmp_path / str(step), captures, clean))
    # Its captures count from the commit of `captures` on: then what is missing is finished, else they are taken anew.
    assert {(False, 0, 1), (False, 1, 0)} <= seen


def test_a_client_that_is_killed_at_any_instant(mortal, captures, clean, tmp_path):
    _, _, work, *_ = mortal(tmp_path / "whole")
    chance, killed = random.Random(5), 0
    for number in itertools.count():
        ended, _, cpu, *_ = mortal(tmp_path / str(number), cpu=chance.uniform(0.2, 1) * work)
        healed(tmp_path / str(number), captures, clean)
        killed += ended == signal.SIGPROF
        if killed == 6:
            break
        if not ended:
            # It needed less than was thought: how much work it is depends on what else the machine does.
            work = min(work, cpu)
            assert number < 100


def test_a_disk_that_is_full_is_told_and_costs_no_rows(mortal, captures, clean, tmp_path):
    told = []
    for number, longest in enumerate((300, 900, 1500, 2000, 3000, 4000)):
        killed, _, _, said, _ = mortal(tmp_path / str(number), longest=longest)
        assert killed == 0
        told.append(said)
        assert "Traceback" not in said, said
        healed(tmp_path / str(number), captures, clean)
    assert len([said for said in told if "cannot be written" in said]) > 3


@pytest.fixture
def small_disk(tmp_path):
    """A folder on a disk of its own, and what sets its size."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4k", "none", disk], capture_output=True).returncode:
        pytest.skip("may not mount")
    yield disk, lambda size: subprocess.run(["mount", "-o", f"remount,size={size}", disk], check=True)
    subprocess.run(["umount", disk], check=True)


def test_a_small_disk(small_disk, mortal, captures, clean):
    disk, resize = small_disk
    for pages in itertools.count(4, 6):
        resize(f"{4 * pages}k")
        killed, _, _, said, _ = mortal(disk / str(pages))
        assert killed == 0
        assert "Traceback" not in said, said
        resize("64m")
        healed(disk / str(pages), captures, clean)
        subprocess.run(["rm", "-rf", disk / str(pages)], check=True)
        if not said:
            break
    assert pages > 10


def test_ingests_at_once_bring_each_content_once(mortal, captures, clean, tmp_path):
    for number in range(3):
        both = mortal(tmp_path / str(number), at_once=3)
        assert [killed for killed, *_ in both] == [0, 0, 0], both
        assert [said for *_, said, _ in both] == ["", "", ""]
        assert sum(new for *_, new in both) == 1
        healed(tmp_path / str(number), captures, clean)


def test_many_small_files(tmp_path, monkeypatch):
    # More than one task has room for.
    monkeypatch.setattr(ingesting, "TASK_FILES", 80)
    for number in range(120):
        path = tmp_path / "in" / f"m{number % 3}" / "2026-03-01" / f"{number}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(candump(number, 6))
    made = Lake(Place(str(tmp_path / "lake")), make=True)
    assert (ingest(made, tmp_path / "in").new, ingest(made, tmp_path / "in").known) == (120, 120)
    found = rows(made)
    assert len({row["capture"] for row in found["captures"]}) == len(found["captures"]) == 120
    frames = sum(row["frames"] for row in found["captures"])
    assert frames == sum(len(table) for name, table in found.items() if "." in name or name in ("unknown", "foreign"))
    # A file holds many captures: it is the tables that count, not they.
    assert len(list((tmp_path / "lake").rglob("*.parquet"))) < 3 * len(found) + 5
