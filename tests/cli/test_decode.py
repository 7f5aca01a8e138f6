"""`servotap decode`: what it writes, prints and returns, and what it leaves behind when something goes wrong."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from analyzer.cli import main
from analyzer.cli.signals import ENDING
from tests import CAPTURES, ROOT
from tests.logs import metadata

BENCH = CAPTURES / "mks_rs485.log"


def test_without_o_the_log_stands_beside_the_capture(tmp_path, capsys):
    capture = tmp_path / "wire.log"
    shutil.copy(BENCH, capture)
    assert main(["decode", str(capture)]) == 0
    assert sorted(os.listdir(tmp_path)) == ["wire.log", "wire.log.mcap"]
    out = capsys.readouterr().out
    assert "mks-rs485: 37 good frames" in out
    assert "0 junk" in out
    assert "bad_checksum" in out
    assert "run_speed" in out


def test_the_metadata_accounts_for_every_byte(tmp_path):
    log = tmp_path / "out.mcap"
    main(["decode", str(BENCH), "-o", str(log), "--model", "42D"])
    values = metadata(log)
    assert int(values["bytes_in_frames"]) + int(values["bytes_junk"]) == int(values["bytes_total"])
    for key in ("source", "source_size", "source_sha256", "format", "dialect", "time_source", "version", "model"):
        assert values[key], key


def test_an_existing_log_is_replaced_only_by_force(tmp_path, cli):
    log = tmp_path / "out.mcap"
    log.write_text("precious")
    assert "exists; --force replaces it" in cli("decode", BENCH, "-o", log, status=2).err
    assert log.read_text() == "precious"
    assert main(["decode", str(BENCH), "-o", str(log), "--force"]) == 0


def test_strict_is_1_for_errors_and_0_without(tmp_path):
    log = str(tmp_path / "out.mcap")
    assert main(["decode", str(BENCH), "-o", log, "--strict"]) == 1
    assert main(["decode", str(CAPTURES / "lk_rs485.log"), "-o", log, "--strict", "--force"]) == 0


def test_json_is_one_object_a_file(tmp_path, cli):
    whole = json.loads(cli("decode", BENCH, "-o", tmp_path / "o.mcap", "--json").out)
    assert whole["dialects"] == ["mks-rs485"]
    assert whole["bytes"]["frames"] == whole["bytes"]["total"]
    rows = {(r["address"], r["command"]): r for r in whole["commands"]}
    assert rows["1", "read_speed"]["latency"] == pytest.approx({"median": 0.003, "p99": 0.003, "max": 0.003}, rel=0.02)
    assert {f["rule"] for f in whole["findings"]} == {"out_of_range", "failed_status", "bad_checksum"}


def test_several_files_need_a_folder(tmp_path, cli):
    files = [str(BENCH), str(CAPTURES / "mks_can.asc")]
    assert "give a folder" in cli("decode", *files, "-o", tmp_path / "one.mcap", status=2).err
    assert main(["decode", *files, "-o", str(tmp_path)]) == 0
    assert sorted(os.listdir(tmp_path)) == ["mks_can.asc.mcap", "mks_rs485.log.mcap"]


def test_a_folder_of_captures_becomes_a_folder_of_logs(tmp_path, cli):
    week, logs = tmp_path / "week", tmp_path / "logs"
    week.mkdir()
    assert "without files" in cli("decode", week, "-o", logs, status=2).err
    for name in ("mks_rs485.log", "mks_can.candump.log"):
        shutil.copy(CAPTURES / name, week)
    assert "with -o" in cli("decode", week, status=2).err
    assert main(["decode", str(week), "-o", str(week / "mks_rs485.log")]) == 2
    assert main(["decode", str(week), "-o", str(logs)]) == 0
    assert sorted(os.listdir(logs)) == ["mks_can.candump.log.mcap", "mks_rs485.log.mcap"]
    # A file that is no capture is named, and the others are decoded.
    (week / "a.bin").write_bytes(b"")
    assert main(["decode", str(week), "-o", str(logs), "--force"]) == 2
    assert sorted(os.listdir(logs)) == ["mks_can.candump.log.mcap", "mks_rs485.log.mcap"]
    assert sorted(os.listdir(week)) == ["a.bin", "mks_can.candump.log", "mks_rs485.log"]


def test_the_rest_goes_on_after_an_unreadable_file(tmp_path, cli):
    files = [str(tmp_path / "missing.log"), str(BENCH)]
    assert "missing.log" in cli("decode", *files, "-o", tmp_path, status=2).err
    assert (tmp_path / "mks_rs485.log.mcap").exists()


def test_standard_input_needs_a_name(tmp_path, cli):
    assert "-o" in cli("decode", "-", status=2).err


def test_standard_input_decodes(tmp_path):
    log = tmp_path / "in.mcap"
    data = (CAPTURES / "mks_can.candump.log").read_bytes()
    done = subprocess.run(
        [sys.executable, "-m", "analyzer", "decode", "-", "-o", str(log)], input=data, cwd=ROOT, capture_output=True
    )
    assert done.returncode == 0, done.stderr
    assert metadata(log)["frames"] == "25"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--dialect", "mks-rs458"], "did you mean mks-rs485?"),
        (["--dialect", "mks-can"], "serial"),
        (["--model", "42X"], "42D"),
    ],
)
def test_a_dialect_or_a_model_that_cannot_be(words, said, tmp_path, cli):
    assert said in cli("decode", BENCH, "-o", tmp_path / "o.mcap", *words, status=2).err
    assert os.listdir(tmp_path) == []


def test_the_capture_itself_is_never_the_target(tmp_path, cli):
    log = tmp_path / "a.mcap"
    main(["decode", str(BENCH), "-o", str(log)])
    assert "is one of the files that are read" in cli("decode", log, "-o", log, "--force", status=2).err


@pytest.mark.parametrize("link", [None, os.link, os.symlink])
@pytest.mark.parametrize(
    "words",
    [
        "decode a.log a.log.mcap --force",
        "decode parts -o parts/1.mcap --force",
        "cut parts -o parts/1.mcap --force",
        "merge parts a.log.mcap -o parts/1.mcap --force",
        "report parts -o parts/1.mcap --force",
        "report a.log parts -o parts/1.mcap --force",
        "export parts --to hex -o parts/1.mcap --force",
        "decode a.log --dbc x.dbc -o x.dbc --force",
        "decode a.log --modbus-map x.csv -o x.csv --force",
        "report a.log --dbc x.dbc -o x.dbc --force",
        "export a.log --to hex --dbc x.dbc -o x.dbc --force",
        "export a.log --to csv --modbus-map x.csv -o x.csv --force",
        "plot a.log speed --modbus-map x.csv -o x.csv --force",
    ],
)
def test_nothing_that_is_read_is_replaced(words, link, tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    Path("parts").mkdir()
    shutil.copy(BENCH, "a.log")
    for name in ("a.log.mcap", "parts/1.mcap", "parts/2.mcap"):
        shutil.copy(CAPTURES / "mks_rs485.mcap", name)
    shutil.copy(CAPTURES / "devices" / "battery.dbc", "x.dbc")
    shutil.copy(CAPTURES / "devices" / "meter.csv", "x.csv")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    given = words.split()
    if link is not None and "-o" in given:
        link(tmp_path / given[given.index("-o") + 1], "linked")
        given[given.index("-o") + 1] = "linked"
    assert "is one of the files that are read" in cli(*given, status=2).err
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*.*")}


def test_a_disk_that_is_full_leaves_no_broken_log(tmp_path):
    capture = tmp_path / "long.bin"
    subprocess.run([sys.executable, CAPTURES / "make.py", "--frames", "60000", "-o", capture], check=True, capture_output=True)
    target = tmp_path / "out"
    target.mkdir()
    # With a limit on the file size, a write fails as on a full disk (EFBIG for ENOSPC).
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300000, 300000));"
        f"from analyzer.cli import main; sys.exit(main(['decode', {str(capture)!r}, '-o', {str(target)!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2
    assert "the incomplete log was removed" in done.stderr
    assert "Traceback" not in done.stderr
    assert os.listdir(target) == []


@pytest.mark.parametrize(
    ("number", "older"),
    [(signal.SIGINT, False), (signal.SIGINT, True), (signal.SIGTERM, False), (signal.SIGHUP, False)],
    ids=["Ctrl-C", "Ctrl-C in place of an older one", "SIGTERM", "SIGHUP"],
)
def test_a_signal_leaves_a_whole_shorter_log_or_the_older_one(number, older, tmp_path):
    log = tmp_path / "out.mcap"
    if older:
        log.write_bytes(b"old")
    process = subprocess.Popen(
        [sys.executable, "-m", "analyzer", "decode", "-", "-o", str(log), *(["--force"] * older)],
        cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    process.stdin.write((CAPTURES / "mks_can.candump.log").read_bytes())
    process.stdin.flush()
    deadline = time.monotonic() + 20
    while not list(tmp_path.glob(".out.mcap.*.part")) and time.monotonic() < deadline:
        os.sched_yield()
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert process.returncode == 128 + number, err
    assert os.listdir(tmp_path) == ["out.mcap"]
    if older:
        assert log.read_bytes() == b"old"
        return
    assert f"stopped by {ENDING[number]}".encode() in out
    with log.open("rb") as stream:
        assert make_reader(stream).get_summary() is not None


def test_memory_does_not_grow_with_the_file(tmp_path):
    peaks = []
    for frames in (20_000, 120_000):
        capture = tmp_path / f"{frames}.bin"
        make = [sys.executable, CAPTURES / "make.py", "--frames", str(frames), "-o", capture]
        subprocess.run(make, check=True, capture_output=True)
        code = (
            "import resource, sys; from analyzer.cli import main;"
            f"main(['decode', {str(capture)!r}, '--json']); print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
        )
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
        peaks.append(int(done.stdout.split()[-1]))
    assert peaks[1] < peaks[0] * 1.25, peaks


def test_only_regular_files_are_replaced(tmp_path, cli):
    os.mkfifo(tmp_path / "fifo")
    assert "not a regular file" in cli("decode", BENCH, "-o", tmp_path / "fifo", "--force", status=2).err
    (tmp_path / "real.mcap").write_text("old")
    (tmp_path / "link").symlink_to("real.mcap")
    assert main(["decode", str(BENCH), "-o", str(tmp_path / "link"), "--force"]) == 0
    assert (tmp_path / "link").is_symlink()
    assert metadata(tmp_path / "real.mcap")["frames"] == "39"


def test_the_summary_says_the_severity_that_counts(tmp_path, capsys):
    cut = tmp_path / "cut.bin"
    cut.write_bytes((CAPTURES / "mks_rs485.bin").read_bytes()[:4])
    assert main(["decode", str(cut), "--dialect", "mks-rs485", "--strict", "--json"]) == 0
    assert [f["severity"] for f in json.loads(capsys.readouterr().out)["findings"]] == ["info"]


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="no /dev/full on this machine")
@pytest.mark.parametrize("words", [[str(BENCH)], ["--help"]])
def test_an_output_that_is_full_is_a_message(words):
    command = [sys.executable, "-m", "analyzer", "show", *words]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert "cannot write the output" in done.stderr
    assert "Traceback" not in done.stderr


def test_glued_captures_begin_anew_where_time_goes_back(tmp_path, cli):
    glued = tmp_path / "glued.log"
    glued.write_bytes(BENCH.read_bytes() * 2)
    rows = {(r["address"], r["command"]): r for r in json.loads(cli("decode", glued, "--json").out)["commands"]}
    assert rows["1", "read_speed"]["latency"]["median"] == pytest.approx(0.003, rel=0.05)
