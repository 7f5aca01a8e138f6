"""`servotap show`: the table, the filter, JSON lines, pipes."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from analyzer.cli import main
from tests import CAPTURES, ROOT

BENCH = str(CAPTURES / "mks_rs485.log")


def lines(capsys):
    return capsys.readouterr().out.splitlines()


def test_a_line_a_frame_with_findings_below(capsys):
    assert main(["show", BENCH]) == 0
    shown = lines(capsys)
    assert sum(" request " in line or " reply " in line for line in shown) == 39
    at = next(i for i, line in enumerate(shown) if "current=6000" in line)
    assert "out_of_range: current: got 6000 mA, expected 0..5200 mA, section 5.2.3" in shown[at + 1]


def test_the_filter_of_the_manual_page(capsys):
    assert main(["show", BENCH, "--filter", 'address == 1 and command == "read_speed" and speed > 300']) == 0
    assert len(lines(capsys)) == 3


def test_a_filter_on_findings(capsys):
    main(["show", BENCH, "--filter", '"bad_checksum" in findings'])
    shown = lines(capsys)
    assert len(shown) == 4
    assert "read_enabled" in shown[2]


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        (["--filter", "speed > 2000"], "the filter"),
        (["--since", "2027-01-01"], "the time range"),
        (["--filter", "speed > 300", "--since", "+9.5s"], "the filter and the time range"),
    ],
)
def test_an_empty_table_says_why(cli, words, asked):
    assert f"note: no frame fits {asked}" in cli("show", BENCH, *words).err


def test_a_filter_that_is_none_is_wrong_use(cli):
    assert main(["show", BENCH, "--filter", "__import__('os')"]) == 2
    assert "did you mean speed" in cli("show", BENCH, "--filter", "sped > 3", status=2).err


def test_json_lines(capsys):
    assert main(["show", BENCH, "--json", "--limit", "14"]) == 0
    shown = [json.loads(line) for line in lines(capsys)]
    assert len(shown) == 14
    assert shown[12]["command"] == "run_speed"
    assert shown[12]["speed"] == 320
    assert shown[13]["latency"] == pytest.approx(0.003)


def test_a_log_shows_as_its_capture(tmp_path, capsys):
    main(["decode", BENCH, "-o", str(tmp_path / "o.mcap")])
    capsys.readouterr()
    main(["show", BENCH, "--filter", "True"])
    first = lines(capsys)
    main(["show", str(tmp_path / "o.mcap"), "--filter", "True"])
    assert lines(capsys) == first


def test_a_pipe_shows_frames_before_it_ends():
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "analyzer", "show", "-"], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    rows = (CAPTURES / "mks_can.candump.log").read_bytes().splitlines(keepends=True)
    process.stdin.write(b"".join(rows[:4]))
    process.stdin.flush()
    assert b"command" in process.stdout.readline()
    assert b"2026-03-02" in process.stdout.readline()
    assert b"read_encoder_carry" in process.stdout.readline()
    out, _ = process.communicate(b"".join(rows[4:]), timeout=20)
    assert out.count(b"\n") >= 20


@pytest.mark.parametrize("value", ["-1", "x", "1.5", ""])
def test_a_limit_is_a_number_of_lines(value, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["show", BENCH, f"--limit={value}"])
    assert "expected a number from 0 on" in capsys.readouterr().err
