"""`servotap test` and the pytest plugin as people run them: exit statuses, reports, baselines, stored failures."""

from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from analyzer.cli import main
from analyzer.cli.output import Output, write_whole
from analyzer.errors import UsageError
from conformance.cli import test as test_command
from conformance.report.html import matrix
from conformance.report.log import METADATA
from conformance.suite import target
from conformance.suite.record import VerdictRecord
from tests.conformance.drives.served import on_pty
from tests.logs import messages, metadata

ROOT = Path(__file__).parents[3]
FEW = ["--claim", "*/shape/read_speed/*", "--jobs", "1"]


def pytest_run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "pytest", "--pyargs", "conformance", "-q", "-p", "no:cacheprovider", *arguments]
    return subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=120, check=False)


# --- exit statuses ----------------------------------------------------------------------------------------------------


def test_a_drive_as_the_manual_has_it_exits_with_0(cli):
    out = cli("test", "mks-rs485@1", *FEW).out
    assert "passed" in out
    assert "REFUTED" not in out


def test_a_refuted_claim_exits_with_1_and_shows_everything(cli):
    out = cli("test", "mks-rs485@1,fault=checksum-wrong", *FEW, status=1).out
    assert "FAILED  mks-rs485/shape/read_speed/checksum  (mks-rs485@1,fault=checksum-wrong)" in out
    assert "FA 01 32 2D" in out
    assert "servotap test mks-rs485@1,fault=checksum-wrong --claim mks-rs485/shape/read_speed/checksum" in out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["mks-rs485"], ""),
        (["mks-rs485@1", "--claim", "nothing/*"], "no claim 'nothing/*'"),
        (["mks-rs485@1", "--theme", "shapes"], "no theme 'shapes'"),
        (["mks-rs485@1", "--allow", "moton"], "did you mean motion"),
        (["mks-rs485@1", "--on", "can:virtual:0"], "is a drive on serial"),
        (["--on", "serial:/dev/null,baud=38400"], "which drive"),
        (["mks-rs485@1,fault=nothing"], "no fault 'nothing'"),
        (["mks-rs485", "--on", "serial:/dev/nowhere,baud=38400"], "which address"),
        (["mks-rs485@1", "--on", "serial:/dev/nowhere,baud=38400"], "/dev/nowhere"),
        (["mks-rs485@1", "mks-rs485@2", "mks-rs485@3", "--on", "emulated", "--on", "emulated"], "3 drives and 2 places"),
    ],
)
def test_wrong_use_exits_with_2_and_says_what_was_expected(words, told, cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if words == ["mks-rs485"]:
        assert main(["test", *words, *FEW]) == 0, "an emulated drive needs no address"
        return
    err = cli("test", *words, "--jobs", "1", status=2).err
    assert told in err
    assert "Traceback" not in err


def test_a_drive_that_is_not_there_exits_with_10(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with on_pty("mks-rs485@2") as path:
        status = main(["test", "mks-rs485@1", "--on", f"serial:{path},baud=38400", *FEW])
    assert status == 10
    assert "mks-rs485@1" in capsys.readouterr().err


def test_reads_alone_are_sent_to_a_real_port_unless_more_is_allowed(capsys):
    with on_pty("mks-rs485@1") as path:
        arguments = ["test", "mks-rs485@1", "--on", f"serial:{path},baud=38400", "--claim", "*/shape/*/answered", "--json"]
        assert main(arguments) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    outcomes = {r["id"]: r["outcome"] for r in records if "id" in r}
    assert outcomes["mks-rs485/shape/read_speed/answered"] == "confirmed"
    assert outcomes["mks-rs485/shape/run_speed/answered"] == "not run"
    assert all("--allow" in r["reason"] or "alone" in r["reason"] or "name it" in r["reason"]
               for r in records if r.get("outcome") == "not run")  # fmt: skip


# --- reports ----------------------------------------------------------------------------------------------------------


def test_the_reports_of_a_run_say_the_same(tmp_path, capsys):
    page, junit, log, failures = (tmp_path / name for name in ("r.html", "j.xml", "run.mcap", "failures"))
    words = ["--report", str(page), "--junitxml", str(junit), "--log", str(log), "--failures", str(failures)]
    assert main(["test", "mks-can@1,fault=checksum-wrong", *FEW, *words]) == 1
    text = page.read_text()
    assert not re.search(r'(src|href)="(?!#)|url\(|@import', text), "a page that needs nothing else"
    assert "mks-can/shape/read_speed/checksum" in text
    cases = ElementTree.parse(junit).getroot().findall("./testsuite/testcase")
    assert len(cases) == len({c.get("name") for c in cases}) > 3
    refuted = [c.get("name") for c in cases if c.find("failure") is not None]
    assert "mks-can/shape/read_speed/checksum" in refuted
    told = [value for topic, value in messages(log) if topic == "/tests"]
    assert {t["claim"] for t in told if t["event"] == "end"} == {c.get("name") for c in cases}
    assert {t["claim"] for t in told if t.get("outcome") == "refuted"} == set(refuted)
    stored = sorted(failures.iterdir())
    assert len(stored) == len(refuted)
    assert metadata(stored[0], METADATA)["claim"] in refuted


@pytest.mark.parametrize(("fault", "status"), [("", 2), (",fault=checksum-wrong", 1)])
def test_a_report_that_cannot_be_written_costs_neither_the_others_nor_the_verdict(fault, status, tmp_path, cli):
    junit = tmp_path / "j.xml"
    words = ["--claim", "*/shape/read_speed/checksum", "--report", str(tmp_path / "none" / "r.html"), "--junitxml", str(junit)]
    shown = cli("test", f"mks-rs485@1{fault}", *words, "--jobs", "1", status=status)
    assert "cannot write" in shown.err
    assert "1 of 1 claims ran" in shown.out
    assert ElementTree.parse(junit).getroot().find("./testsuite/testcase") is not None


def test_an_older_report_stays_where_the_new_one_finds_no_room(tmp_path, monkeypatch):
    page = tmp_path / "r.html"
    page.write_text("<html>old")
    monkeypatch.setattr(Output, "keep", lambda self: (_ for _ in ()).throw(OSError(errno.ENOSPC, "No space left on device")))
    with pytest.raises(UsageError, match="No space left"):
        write_whole(page, b"<html>new")
    assert page.read_text() == "<html>old"
    assert list(tmp_path.iterdir()) == [page]


def test_a_log_of_a_run_is_a_log_like_any_other(tmp_path, cli):
    log = tmp_path / "run.mcap"
    assert main(["test", "mks-rs485@1", *FEW, "--log", str(log)]) == 0
    assert "read_speed" in cli("decode", log, "-o", tmp_path / "again.mcap").out


def test_a_log_that_another_program_writes_during_the_run_is_kept(tmp_path, monkeypatch, capsys):
    log, of_run = tmp_path / "run.mcap", test_command._run_record

    def and_write(*arguments):
        log.write_bytes(b"mine")
        return of_run(*arguments)

    monkeypatch.setattr(test_command, "_run_record", and_write)
    assert main(["test", "mks-rs485@1", "--claim", "*/shape/read_speed/checksum", "--jobs", "1", "--log", str(log)]) == 2
    assert "run.mcap exists; --force replaces it" in capsys.readouterr().err
    assert log.read_bytes() == b"mine"


def test_a_stored_failure_is_run_again(tmp_path, cli):
    failures = tmp_path / "failures"
    words = ["--claim", "*/shape/read_speed/checksum", "--jobs", "1", "--failures", str(failures)]
    assert main(["test", "mks-rs485@1,fault=checksum-wrong", *words]) == 1
    (stored,) = failures.iterdir()
    assert "failing: 3 of 3" in cli("rerun", stored, status=1).out
    assert "fixed: 3 of 3" in cli("rerun", stored, "--drive", "mks-rs485@1").out
    assert "expected a stored failure" in cli("rerun", str(ROOT / "README.md"), status=2).err


# --- baselines --------------------------------------------------------------------------------------------------------


def test_a_baseline_accepts_what_is_known_and_nothing_else(tmp_path, capsys, cli):
    baseline = tmp_path / "known.json"
    faulty = ["test", "mks-rs485@1,fault=checksum-wrong", "--jobs", "1"]
    assert main([*faulty, "--claim", "*/shape/read_speed/*", "--write-baseline", str(baseline)]) == 1
    assert main([*faulty, "--claim", "*/shape/read_speed/*", "--baseline", str(baseline)]) == 0
    assert main([*faulty, "--claim", "*/shape/read_*/*", "--baseline", str(baseline)]) == 1
    assert "new: mks-rs485/shape/read_position/checksum" in capsys.readouterr().err
    assert "fixed: mks-rs485/shape/read_speed/checksum" in cli("test", "mks-rs485@1", *FEW, "--baseline", baseline).err
    assert main([*faulty, "--claim", "*/shape/read_position/answered", "--baseline", str(baseline)]) == 1
    assert "not looked at: mks-rs485/shape/read_speed/checksum" in capsys.readouterr().err


def test_a_baseline_with_lists_among_the_parameters_knows_its_claims_again(tmp_path, capsys):
    baseline = tmp_path / "known.json"
    words = ["test", "mks-rs485@1,fault=current-unlimited", "--jobs", "1", "--claim", "*/ranges/set_current/*"]
    assert main([*words, "--write-baseline", str(baseline)]) == 1
    assert any(isinstance(v, list) for each in json.loads(baseline.read_text()) for v in each["parameters"].values())
    assert main([*words, "--baseline", str(baseline)]) == 0
    capsys.readouterr()


def test_a_baseline_that_is_missing_is_told_before_the_run(tmp_path, cli):
    assert "none.json: No such file" in cli("test", "mks-rs485@1", "--baseline", tmp_path / "none.json", status=2).err


def test_one_wrong_command_paints_no_other_refuted():
    covers = (("read_speed", "shape"), ("run_speed", "shape"))
    about = {"target": "mks-rs485@1", "theme": "state", "dialect": "mks-rs485", "statement": "x", "section": "x"}
    about |= {"certainty": "certain", "refuted_by": "x"}
    wrong = VerdictRecord(id="a", outcome="refuted", asked="run_speed", covers=covers, **about)
    fine = VerdictRecord(id="b", outcome="confirmed", covers=covers[:1], **about)
    rows = matrix([wrong, fine], "mks-rs485@1")
    assert (rows["read_speed"]["shape"], rows["run_speed"]["shape"]) == (("confirmed", (fine,)), ("refuted", (wrong,)))
    rows = matrix([wrong], "mks-rs485@1")
    assert rows["read_speed"]["shape"] == ("never", ())
    assert rows["read_speed"]["boundary"] == ("nothing", ())


# --- pytest -----------------------------------------------------------------------------------------------------------


def test_pytest_runs_the_claims(tmp_path):
    done = pytest_run("--drive", "mks-can@1", "--claim", "*/shape/read_speed/*", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert "passed" in done.stdout


def test_pytest_fails_what_is_refuted_and_junit_carries_claim_ids(tmp_path):
    junit = tmp_path / "j.xml"
    words = ["--drive", "mks-rs485@1,fault=checksum-wrong", "--claim", "*/shape/read_speed/*", f"--junitxml={junit}"]
    done = pytest_run(*words, "-n", "2", cwd=tmp_path)
    assert done.returncode == 1, done.stdout
    cases = ElementTree.parse(junit).getroot().iter("testcase")
    found = {
        p.get("value"): c.find("failure") is not None
        for c in cases for p in c.iter("property") if p.get("name") == "claim"
    }  # fmt: skip
    assert found["mks-rs485/shape/read_speed/checksum"]
    assert not found["mks-rs485/shape/read_speed/answered"]


def test_pytest_says_wrong_use_in_one_line(tmp_path):
    done = pytest_run("--drive", "mks-rs485@1,fault=nothing", cwd=tmp_path)
    assert done.returncode not in (0, 1)
    assert "no fault 'nothing'" in done.stdout + done.stderr


def test_other_peoples_runs_import_nothing_of_the_suite(tmp_path):
    (tmp_path / "test_mine.py").write_text(
        "def test_mine():\n    assert True\n\ndef test_drive(servo_drive):\n    assert False, 'without a drive it is skipped'\n"
    )
    code = (
        "import sys, pytest; status = pytest.main(['-q', '-p', 'no:cacheprovider', '-p', 'no:hypothesispytest']);"
        "bad = [m for m in sys.modules if m.startswith(('conformance.', 'analyzer')) and "
        "m not in ('conformance.pytest_plugin', 'conformance.pytest_plugin.plugin')];"
        "bad += ['hypothesis'] * ('hypothesis' in sys.modules); print('LOADED', bad); sys.exit(status)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "LOADED []" in done.stdout


# --- targets ----------------------------------------------------------------------------------------------------------


def test_one_place_is_for_all_drives_and_several_are_for_each():
    both = target.parse_all(["mks-rs485@1", "mks-rs485@2"], ["serial:/dev/ttyUSB0,baud=38400"])
    assert [t.port for t in both] == ["serial:/dev/ttyUSB0"] * 2
    each = target.parse_all(["mks-rs485@1", "lk-rs485@1"], ["serial:/dev/a", "tcp:127.0.0.1:5000"])
    assert [t.port for t in each] == ["serial:/dev/a", "tcp:127.0.0.1:5000"]
    with pytest.raises(UsageError, match="twice"):
        target.parse_all(["mks-rs485@1", "mks-rs485@1"], ["serial:/dev/a"])
    assert {t.dialect.name for t in target.parse_all([], [])} == {"mks-rs485", "mks-modbus", "mks-can", "lk-rs485"}


def test_reports_of_a_command_line_that_is_no_utf_8_are_written(tmp_path, monkeypatch, capsys):
    words = ["test", "mks-rs485@1", "--claim", "*/shape/read_speed/code", "--report", str(tmp_path / "r\udcff.html")]
    monkeypatch.setattr("sys.argv", ["servotap", *words])
    assert main([*words, "--log", str(tmp_path / "l.mcap"), "--json"]) == 0
    assert r"r\udcff.html" in (tmp_path / "r\udcff.html").read_text()


@pytest.mark.parametrize("link", [None, os.link, os.symlink])
@pytest.mark.parametrize(
    ("one", "two"),
    [
        ("--report", "--junitxml"),
        ("--log", "--report"),
        ("--journal", "--report"),
        ("--settings", "--write-baseline"),
        ("--baseline", "--junitxml"),
    ],
)
def test_no_two_options_name_one_file(one, two, link, tmp_path, cli):
    path, other = tmp_path / "x", tmp_path / "x"
    if link is not None:
        path.write_text("[]")
        link(path, other := tmp_path / "y")
    err = cli("test", "mks-rs485@1", *FEW, one, path, two, other, "--force", status=2).err
    assert f"{one} and {two} name the same file" in err
    assert not path.exists() or path.read_text() == "[]"


@pytest.mark.parametrize(
    ("option", "kept"), [("--log", b"\x89MCAP"), ("--report", b"PK"), ("--junitxml", b"PK"), ("--write-baseline", b"PK")]
)
def test_a_file_of_another_kind_is_replaced_only_when_told(option, kept, tmp_path, capsys):
    path = tmp_path / "kept"
    path.write_bytes(kept)
    words = ["test", "mks-rs485@1", "--claim", "*/shape/read_speed/code", option, str(path)]
    assert main(words) == 2
    assert "--force replaces it" in capsys.readouterr().err
    assert path.read_bytes() == kept
    assert main([*words, "--force"]) == 0
    assert path.read_bytes() != kept


@pytest.mark.parametrize("option", ["--log", "--report", "--junitxml", "--write-baseline"])
def test_a_file_that_was_written_during_the_run_is_kept(option, tmp_path, capsys, monkeypatch):
    path = tmp_path / "kept"
    # The first look finds nothing there.
    monkeypatch.setattr(test_command, "check_places", lambda places, **how: path.write_bytes(b"PK"))
    assert main(["test", "mks-rs485@1", "--claim", "*/shape/read_speed/code", option, str(path)]) == 2
    told = capsys.readouterr()
    assert "--force replaces it" in told.err
    assert "1 of 1 claims ran" in told.out
    assert path.read_bytes() == b"PK"


@pytest.mark.parametrize("option", ["--log", "--report"])
def test_pytest_replaces_reports_alone(option, tmp_path):
    (tmp_path / "kept").write_bytes(b"PK")
    done = pytest_run("--drive", "mks-can@1", "--claim", "*/shape/read_speed/code", option, "kept", cwd=tmp_path)
    assert done.returncode == 4, done.stdout
    assert f"kept exists and is not what {option} writes; name another file" in done.stderr
    assert (tmp_path / "kept").read_bytes() == b"PK"
