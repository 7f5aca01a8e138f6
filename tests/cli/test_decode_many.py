"""Several captures decoded at once: where their logs go, and what one of them does to the others."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader

from analyzer.cli import decode as command
from analyzer.cli import decode_many, main
from analyzer.cli.decode_targets import Capture, captures
from analyzer.cli.signals import handled
from analyzer.errors import UnreadableError
from analyzer.sinks.forked import available
from tests import CAPTURES, ROOT

JOBS = pytest.mark.parametrize(
    "jobs", ["1", pytest.param("2", marks=pytest.mark.skipif(not available(), reason="no fork on this machine, or one core"))]
)


def tree(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@pytest.fixture(name="week")
def with_week(tmp_path):
    for name in ("mon", "mon/deep", "tue"):
        (tmp_path / "week" / name).mkdir(parents=True)
        shutil.copy(CAPTURES / "mks_can.asc", tmp_path / "week" / name)
    shutil.copy(CAPTURES / "mks_rs485.log", tmp_path / "week")
    return tmp_path / "week"


MIRRORED = ["mks_rs485.log.mcap", "mon/deep/mks_can.asc.mcap", "mon/mks_can.asc.mcap", "tue/mks_can.asc.mcap"]


@JOBS
def test_the_folders_of_a_folder_are_mirrored(jobs, week, tmp_path, capsys):
    logs = tmp_path / "logs"
    assert main(["decode", str(week), "-o", str(logs), "--jobs", jobs]) == 0
    assert tree(logs) == MIRRORED
    out = capsys.readouterr().out
    assert "decoded 4 of 4 captures" in out
    assert "114 frames" in out
    # One summary: what three captures have in common is said once.
    assert out.count("A value is outside the range of the manual: subdivision") == 1
    assert f"{week}/mon/deep/mks_can.asc and 2 others: 1. A value" in out
    for name in MIRRORED:
        with (logs / name).open("rb") as stream:
            assert make_reader(stream, validate_crcs=True).get_summary().statistics.message_count > 25


@JOBS
def test_json_is_a_line_a_capture_in_their_order(jobs, week, tmp_path, capsys):
    assert main(["decode", str(week), "-o", str(tmp_path / "logs"), "--json", "--jobs", jobs]) == 0
    said = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [Path(each["log"]).relative_to(tmp_path / "logs").as_posix() for each in said] == MIRRORED
    assert [each["frames"] for each in said] == [39, 25, 25, 25]


def test_links_that_lead_back_end(week, tmp_path):
    (week / "mon" / "up").symlink_to("..")
    (week / "again").symlink_to("tue")
    logs = week / "logs"
    logs.mkdir()
    for _ in range(2):
        # The folder of the logs is none of captures, and the link to a folder stands for it.
        assert main(["decode", str(week), "-o", str(logs), "--force"]) == 0
    assert tree(logs) == ["again/mks_can.asc.mcap", *MIRRORED[:3]]


@pytest.fixture(name="deep")
def with_deep(tmp_path):
    """Change into a folder, and yield another one in it: a capture lies in it deeper than Python calls."""
    before, place = Path.cwd(), tmp_path / "deep"
    place.mkdir()
    os.chdir(place)
    for _ in range(sys.getrecursionlimit() + 50):
        os.mkdir("d")
        os.chdir("d")
    shutil.copy(CAPTURES / "mks_can.asc", "deep.asc")
    os.chdir(place)
    yield Path("d")
    os.chdir(before)
    # What shutil removes may not lie so deep either.
    subprocess.run(["rm", "-r", place], check=True)


@pytest.mark.skipif(os.name != "posix", reason="the system's own limit of a path is shorter")
def test_folders_may_lie_deeper_than_python_calls(deep):
    assert main(["decode", str(deep), "-o", "logs"]) == 0
    (log,) = subprocess.run(["find", "logs", "-type", "f"], capture_output=True, text=True, check=True).stdout.split()
    assert log.endswith("/deep.asc.mcap")


@pytest.mark.parametrize("leads", ["x" * 300, "link", "nowhere"])
def test_a_link_that_cannot_be_looked_at_ends_no_other_capture(leads, week, tmp_path, capsys):
    (week / "link").symlink_to(leads)
    assert main(["decode", str(week), "-o", str(tmp_path / "logs")]) == 2
    assert tree(tmp_path / "logs") == MIRRORED
    assert f"{week}/link" in capsys.readouterr().err


@pytest.mark.parametrize("letter", ["n", "\N{GREEK SMALL LETTER ALPHA}", "\N{CJK UNIFIED IDEOGRAPH-4E00}"])
def test_names_as_long_as_a_file_system_has_them_get_shorter_logs(letter, week, tmp_path, cli):
    size = len(os.fsencode(letter))
    names = [letter * ((250 - len(end)) // size) + end for end in ("_1.log", "_2.log")]
    for name in names:
        shutil.copy(CAPTURES / "mks_rs485.log", week / name)
    logs = tmp_path / "logs"
    assert "decoded 6 of 6 captures" in cli("decode", week, "-o", logs).out
    assert len(tree(logs)) == 6
    assert set(MIRRORED) < set(tree(logs))


def test_a_folder_that_is_called_as_a_log_is_none(week, tmp_path, cli):
    (week / "tue").rename(week / "tue.mcap")
    assert main(["decode", str(week), "-o", str(tmp_path / "logs")]) == 0
    assert "tue.mcap/mks_can.asc.mcap" in tree(tmp_path / "logs")
    shutil.copy(CAPTURES / "mks_rs485.mcap", week)
    assert "read_encoder_carry" in cli("show", week, "--limit", "1").out


def test_logs_of_a_folder_are_one_log(week, tmp_path):
    assert main(["decode", str(week / "mks_rs485.log"), "-o", str(week / "tue" / "part.mcap")]) == 0
    assert main(["decode", str(week), "-o", str(tmp_path / "logs")]) == 0
    assert tree(tmp_path / "logs") == sorted([*MIRRORED, "tue.mcap"])


def test_no_two_share_a_log(week, tmp_path, capsys):
    logs = tmp_path / "logs"
    assert main(["decode", str(week / "mon"), str(week / "tue"), "-o", str(logs)]) == 0
    assert tree(logs) == ["mon/deep/mks_can.asc.mcap", "mon/mks_can.asc.mcap", "tue/mks_can.asc.mcap"]
    files = [str(week / name / "mks_can.asc") for name in ("mon", "tue")]
    flat = tmp_path / "flat"
    flat.mkdir()
    assert main(["decode", *files, "-o", str(flat)]) == 0
    assert tree(flat) == ["mks_can.asc-2.mcap", "mks_can.asc.mcap"]
    err = capsys.readouterr().err
    assert "mks_can.asc.mcap is the log of another capture" in err
    assert "goes to mks_can.asc-2.mcap" in err


def test_each_of_many_captures_of_one_name_finds_its_log_at_once(tmp_path, monkeypatch):
    tried, with_name = 0, Path.with_name

    def counting(path, name):
        nonlocal tried
        tried += 1
        return with_name(path, name)

    monkeypatch.setattr(Path, "with_name", counting)
    files = ["a/x-2", *["a/x"] * 100]
    found = captures(argparse.Namespace(files=files, output=str(tmp_path), to="mcap", force=False, dbc=[], modbus_map=[]))
    assert [each.target.name for each in found[:4]] == ["x-2.mcap", "x.mcap", "x-3.mcap", "x-4.mcap"]
    assert len({each.target for each in found}) == 101
    assert tried <= 110


def test_the_summary_of_very_many_captures_is_printed_in_parts(capsys, monkeypatch):
    monkeypatch.setattr(decode_many, "_ROWS", 40)
    whole = {"format": "hex", "dialects": [], "frames": 2, "bytes": {"junk": {}}, "findings": [], "notes": [], "log": "x"}
    outcomes = [(Capture(f"{number}.log", Path(f"{number}.mcap"), 9), decode_many.Outcome(whole)) for number in range(100)]
    decode_many._print_summary(outcomes, 100, 1.0, "")
    lines = capsys.readouterr().out.splitlines()
    assert [n for n, line in enumerate(lines) if line.startswith("capture")] == [0, 41, 82]
    assert [line.split()[0] for line in lines if ".log" in line] == [f"{number}.log" for number in range(100)]
    assert lines[-1].startswith("decoded 100 of 100 captures: 900 bytes, 200 frames")


@JOBS
def test_what_is_no_capture_is_named_once(jobs, week, tmp_path, cli):
    (week / "photo.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    (week / "empty").mkdir()
    (week / "empty" / "nothing.log").touch()
    logs = tmp_path / "logs"
    captured = cli("decode", week, "-o", logs, "--jobs", jobs, status=2)
    assert captured.err.count("week/photo.png") == captured.err.count("week/empty/nothing.log") == 1
    assert captured.err.count("\n") == 2
    assert "photo.png" not in captured.out
    assert "decoded 4 of 6 captures" in captured.out
    assert tree(logs) == MIRRORED
    assert not (logs / "empty").exists()


@JOBS
def test_a_fault_in_one_ends_no_other(jobs, week, tmp_path, capsys, monkeypatch):
    opened = command.open_reading

    def broken(path, arguments):
        if path.endswith("tue/mks_can.asc"):
            raise ZeroDivisionError("a fault")
        return opened(path, arguments)

    monkeypatch.setattr(command, "open_reading", broken)
    monkeypatch.setenv("SERVOTAP_FAULTS", str(tmp_path))
    assert main(["decode", str(week), "-o", str(tmp_path / "logs"), "--jobs", jobs]) == 70
    assert tree(tmp_path / "logs") == MIRRORED[:3]
    assert any(path.name.startswith("servotap-fault-") for path in tmp_path.iterdir())


@pytest.mark.skipif(not available(), reason="no fork on this machine, or one core")
def test_a_process_that_dies_takes_one_capture_with_it(week, tmp_path, cli, monkeypatch):
    parent, opened = os.getpid(), command.open_reading

    def deadly(path, arguments):
        if os.getpid() != parent and path.endswith("mks_rs485.log"):
            os.kill(os.getpid(), signal.SIGKILL)
        return opened(path, arguments)

    monkeypatch.setattr(command, "open_reading", deadly)
    captured = cli("decode", week, "-o", tmp_path / "logs", "--jobs", "2", status=2)
    assert "mks_rs485.log: the process that decoded it died (signal 9)" in captured.err
    assert tree(tmp_path / "logs") == MIRRORED[1:]


def test_strict_is_1_if_one_has_errors(tmp_path, capsys):
    good = [str(CAPTURES / "lk_rs485.log"), str(CAPTURES / "lk_rs485.bin")]
    assert main(["decode", *good, "-o", str(tmp_path), "--strict", "--force"]) == 0
    assert main(["decode", good[0], str(CAPTURES / "mks_rs485.log"), "-o", str(tmp_path), "--strict", "--force"]) == 1


@JOBS
def test_ctrl_c_leaves_valid_logs_and_ends_all(jobs, tmp_path):
    fifos = [tmp_path / f"pipe{n}" for n in range(3)]
    for fifo in fifos:
        os.mkfifo(fifo)
    logs = tmp_path / "logs"
    logs.mkdir()
    words = ["decode", *map(str, fifos), "-o", str(logs), "--jobs", jobs, "--format", "candump"]
    process = subprocess.Popen(
        [sys.executable, "-m", "analyzer", *words], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    data = (CAPTURES / "mks_can.candump.log").read_bytes()
    # Each open waits for its reader; no pipe ends, so each process waits for more. The last is the first to be read.
    begun = [fifo.open("wb", buffering=0) for fifo in reversed(fifos[-int(jobs) :])]
    for each in begun:
        each.write(data)
    while sum(".part" in name for name in os.listdir(logs)) < int(jobs):
        assert process.poll() is None
        os.sched_yield()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert b"stopped by Ctrl-C" in out
    assert tree(logs) == sorted(f"{fifo.name}.mcap" for fifo in fifos[-int(jobs) :])
    for name in tree(logs):
        with (logs / name).open("rb") as stream:
            assert make_reader(stream, validate_crcs=True).get_summary() is not None


def test_an_order_that_is_wrong_ends_before_anything_is_made(week, tmp_path, cli):
    (tmp_path / "logs" / "mon").mkdir(parents=True)
    (tmp_path / "logs" / "mon" / "mks_can.asc.mcap").touch()
    assert "exists; --force replaces it" in cli("decode", week, "-o", tmp_path / "logs", status=2).err
    assert tree(tmp_path / "logs") == ["mon/mks_can.asc.mcap"]
    assert "is the folder of the captures itself" in cli("decode", week, "-o", week, status=2).err


def test_how_far_all_are_is_shown(monkeypatch):
    captures = [command.Capture(name, Path(name), size) for name, size in (("a", 100), ("b", 50))]
    shown = []

    def decode(capture, arguments, far):
        far.put(capture.size // 2, 7)
        shown.append((what(), position(), frames()))
        if capture.path == "a":
            raise UnreadableError("a: no capture")
        return decode_many.Outcome({"frames": 20})

    work = decode_many._Work(captures, None, decode, 1)
    monkeypatch.setattr(decode_many, "showing_progress", lambda *given: given)
    what, total, position, frames = work.display()
    work.one_by_one()
    assert total == 150
    assert shown == [("decoding 2 captures, 0 done", 50, 7), ("decoding 2 captures, 1 done", 125, 7)]
    assert (what(), position(), frames()) == ("decoding 2 captures, 2 done", 150, 20)


def test_a_process_without_its_parent_ends(monkeypatch):
    monkeypatch.setattr(decode_many, "_LOOK", 0.001)
    arrived = threading.Event()

    def tell(told):
        raise BrokenPipeError

    with handled(lambda number, frame: arrived.set()), decode_many.Far(tell).noting(lambda: 5, lambda: 6):
        assert arrived.wait(20)
