"""The command `emulate`: what it takes, what it says, how it ends, what it leaves."""

from __future__ import annotations

import argparse
import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import serial

from analyzer import cli as analyzer_cli
from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.errors import UsageError
from analyzer.live import lock
from analyzer.live.lock import Lock
from conformance.cli import HELP, emulate
from conformance.drives import make
from conformance.serve.state import StateFile, claimed
from tests.conformance.drives.plain_drive import PlainDrive
from tests.conformance.drives.served import Emulated, wait_for
from tests.logs import messages

MKS = dialects.get("mks-rs485")
MODBUS = dialects.get("mks-modbus")


def run(*words: str) -> int:
    return analyzer_cli._run("emulate", emulate, words)


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert run(*words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    return err


def exchange(path: str, request: bytes, size: int, baud: int = 38400) -> bytes:
    with serial.Serial(path, baud, timeout=1) as port:
        port.write(request)
        data: bytes = port.read(size)
        return data


# --- in another process -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_a_whole_log_and_no_link(tmp_path: Path, number: int) -> None:
    log, link = tmp_path / "bus.mcap", tmp_path / "servo"
    with Emulated("mks-rs485@1", "mks-rs485@2,model=57D", "--pty", str(link), "--log", str(log)) as emulated:
        assert emulated.place == str(link)
        for address in (1, 2):
            request, reply = build(MKS, "read_speed", address), build(MKS, "read_speed", address, {}, Role.REPLY)
            assert exchange(emulated.place, request, 6) == reply
        assert emulated.end(number) == (0, "")
    assert not link.is_symlink()
    topics = [topic for topic, _ in messages(log)]
    for address in (1, 2):
        for role in ("request", "reply"):
            assert topics.count(f"/bus/{address}/read_speed/{role}") == 1
    assert "/findings" not in topics


def test_the_log_is_there_while_it_is_written(tmp_path: Path) -> None:
    log = tmp_path / "bus.mcap"
    with Emulated("mks-rs485@1", "--pty", "--log", str(log)) as emulated:
        exchange(emulated.place, build(MKS, "read_speed", 1), 6)
        before = log.stat().st_size
        assert wait_for(lambda: log.stat().st_size > before + 200)
        emulated.process.kill()


def test_settings_are_kept_over_runs(tmp_path: Path) -> None:
    state = tmp_path / "drive.json"
    words = ("mks-rs485@1", "mks-rs485@1,baud=9600", "--pty", "--state", str(state))
    with Emulated(*words, "--set", "work_mode=sr_vfoc", "--set", "current=1200") as emulated:
        done = build(MKS, "set_baud_rate", 1, {"status": 1}, Role.REPLY)
        assert exchange(emulated.place, build(MKS, "set_baud_rate", 1, {"baud_rate": 6}), 5) == done
        assert wait_for(lambda: json.loads(state.read_text())["drives"]["mks-rs485@1"]["settings"]["baud_rate"] == 6)
        assert emulated.end()[0] == 0
    with Emulated(*words) as emulated:
        read = build(MKS, "read_speed", 1)
        for baud in (115200, 9600):
            assert exchange(emulated.place, read, 6, baud) == build(MKS, "read_speed", 1, {}, Role.REPLY)
        assert emulated.end()[0] == 0
    kept = json.loads(state.read_text())["drives"]
    assert sorted(kept) == ["mks-rs485@1", "mks-rs485@1#2"]
    for name, baud in (("mks-rs485@1", 6), ("mks-rs485@1#2", 1)):
        settings = kept[name]["settings"]
        assert (settings["work_mode"], settings["current"], settings["baud_rate"]) == (5, 1200, baud)


def test_two_runs_with_one_state_keep_what_the_other_has_kept(tmp_path: Path) -> None:
    path = tmp_path / "drives.json"
    drives = {name: PlainDrive("mks-rs485", 1, current=0) for name in ("one", "two")}
    runs = {name: StateFile(str(path), {name: drive}) for name, drive in drives.items()}
    for current, name in enumerate(("one", "two", "one", "two"), 1):
        drives[name].settings["current"] = current
        runs[name].save()
    assert {name: kept["settings"]["current"] for name, kept in json.loads(path.read_text())["drives"].items()} == {
        "one": 3, "two": 4,
    }  # fmt: skip
    path.write_text("mine")
    drives["one"].settings["current"] = 5
    with pytest.raises(UsageError, match="does not hold the state of drives"):
        runs["one"].save()
    assert path.read_text() == "mine"


def test_a_state_that_another_run_keeps_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    state = tmp_path / "drives.json"
    with claimed(str(state)):
        told = refused(capsys, "mks-rs485@1", "--pty", "--state", str(state))
        assert f"{state} is kept by another servotap emulate" in told
    assert run("mks-rs485@1", "--pty", "--duration", "0.01", "--state", str(state)) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["drives.json"], "no lock is left"


def test_a_lock_that_was_removed_between_opening_and_locking_is_taken_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Lock(tmp_path, "x.lock", removed=True)
    flock, opened = lock.fcntl.flock, []

    def late(fd: int, how: int) -> None:
        # The one before goes as the next has opened its file.
        if not opened:
            first.close()
        opened.append(fd)
        flock(fd, how)

    monkeypatch.setattr(lock.fcntl, "flock", late)
    with Lock(tmp_path, "x.lock", removed=True):
        assert len(opened) == 2
        with pytest.raises(UsageError, match="held by another process"):
            Lock(tmp_path, "x.lock", removed=True)
        assert (tmp_path / "x.lock").exists(), "one that is refused removes nothing"
    assert not (tmp_path / "x.lock").exists()


def test_where_a_medium_has_no_locks_nothing_is_held_and_nothing_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(fd: int, how: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(lock.fcntl, "flock", without)
    with Lock(tmp_path, lock.RUNNING), Lock(tmp_path, lock.RUNNING, removed=True):
        assert not lock.running(tmp_path)


def test_tcp_a_duration_and_a_noisy_wire(tmp_path: Path) -> None:
    words = ("mks-modbus@1", "--tcp", ":0", "--duration", "1.5", "--wire-fault", "flip=1", "--seed", "3")
    with Emulated(*words, "--no-wire-time", "--reply-delay", "0") as emulated:
        host, _, port = emulated.place.partition(":")
        assert host == "127.0.0.1"
        with serial.serial_for_url(f"socket://{host}:{port}", timeout=0.3) as client:
            client.write(build(MODBUS, "read_speed", 1))
            assert client.read(7) == b""
        assert emulated.process.wait(10) == 0
        assert emulated.process.stderr is not None
        assert "8 x flip" in emulated.process.stderr.read()


# --- in this process --------------------------------------------------------------------------------------------------


def test_a_log_does_not_replace_the_state(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["mks-rs485@1", "--pty", "--duration", "0.05", "--state", str(tmp_path / "s")]
    assert run(*words) == 0
    capsys.readouterr()
    kept = (tmp_path / "s").read_bytes()
    assert "--state and --log name the same file" in refused(capsys, *words, "--log", str(tmp_path / "s"), "--force")
    assert (tmp_path / "s").read_bytes() == kept


def test_a_state_that_cannot_be_written_replaces_no_log(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, data: bytes) -> None:
        raise UsageError(f"cannot write {path}: No space left on device")

    log = tmp_path / "a.mcap"
    log.write_text("of yesterday")
    monkeypatch.setattr("conformance.serve.state.write_whole", refuse)
    words = ("mks-rs485@1", "--pty", "--log", str(log), "--force", "--state", str(tmp_path / "s"))
    assert "cannot write" in refused(capsys, *words)
    assert log.read_text() == "of yesterday"


@pytest.mark.parametrize("limit", [0, 4])
def test_a_log_that_cannot_be_begun_replaces_none(limit: int, tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    log.write_text("of yesterday")
    begun = (
        f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit})); import sys; sys.argv[0] = 'servotap'"
    )
    words = ["emulate", "mks-rs485@1", "--pty", "--duration", "0.05", "--log", str(log), "--force"]
    program = [sys.executable, "-c", f"{begun}; from analyzer.__main__ import main; sys.exit(main())", *words]
    ended = subprocess.run(program, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (
        2,
        f"servotap emulate: cannot write {log}: File too large; the incomplete file was removed\n",
    )
    assert log.read_text() == "of yesterday"
    assert list(tmp_path.iterdir()) == [log]


def test_a_clock_that_no_log_can_hold_is_told(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.time_ns", lambda: -1)
    words = ("mks-rs485@1", "--pty", "--duration", "0.05", "--log", str(tmp_path / "a.mcap"))
    assert "set it to a time before 2116" in refused(capsys, *words)
    assert list(tmp_path.iterdir()) == []


def test_it_ends_by_itself_and_echoes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    assert run("mks-rs485@1", "--echo", "--pty", "--duration", "0.05", "--log", str(log)) == 0
    out, err = capsys.readouterr()
    assert out.startswith("listening on /dev/")
    assert err == ""
    assert messages(log) == []
    assert "exists; --force replaces it" in refused(capsys, "mks-rs485@1", "--pty", "--log", str(log))
    assert run("mks-rs485@1", "--pty", "--duration", "0.05", "--log", str(log), "--force") == 0


def test_a_drive_behind_pty_is_no_link(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--duration", "0.05", "--pty", "mks-rs485@1") == 0
    assert capsys.readouterr().out.startswith("listening on /dev/")


@pytest.mark.parametrize("what", ["quirk", "fault"])
def test_lists(capsys: pytest.CaptureFixture[str], what: str) -> None:
    assert run(f"--list-{what}s") == 0
    out = capsys.readouterr().out
    changes = make.every_quirk() if what == "quirk" else make.every_fault()
    assert changes
    assert len({change.name for change in changes}) == len(changes)
    for change in changes:
        assert f"{change.name}  ({', '.join(change.dialects)})\n    {change.text}\n" in out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "expected at least one DRIVE"),
        (("mks-rs485@1",), "expected --pty, --tcp HOST:PORT or --can"),
        (("mks-rs485", "--pty"), "expected DIALECT@ADDRESS, as in mks-rs485@1"),
        (("mks-rs486@1", "--pty"), "did you mean mks-rs485?"),
        (("mks-rs485@0", "--pty"), "got the address '0', expected 1..255"),
        (("mks-rs485@x", "--pty"), "expected 1..255"),
        (("mks-modbus@248", "--pty"), "expected 1..247"),
        (("mks-rs485@1,model=57C", "--pty"), "no model '57C', expected 42D or 57D"),
        (("mks-rs485@1,model", "--pty"), "expected NAME=VALUE"),
        (("mks-rs485@1,baud=1234", "--pty"), "expected one of 9600, 19200, 25000"),
        (("mks-rs485@1,bitrate=500000", "--pty"), "expected baud"),
        (("mks-can@1", "--pty"), "mks-can@1 is a drive on can, which --pty is not"),
        (("mks-rs485@1", "--can", "virtual:x"), "mks-rs485@1 is a drive on serial, which --can is not"),
        (("mks-can@1", "--can", "virtual:x", "--echo"), "--echo is of serial adapters"),
        (("mks-rs485@1", "--pty", "--set", "wrk_mode=5"), "no drive here has a setting 'wrk_mode'; did you mean work_mode"),
        (("mks-rs485@1", "--pty", "--set", "work_mode"), "expected NAME=VALUE"),
        (("mks-rs485@1", "--pty", "--set", "work_mode=9"), "work_mode: got 9"),
        (("mks-rs485@1", "--pty", "--set", "work_mode=sr_foc"), "did you mean sr_vfoc"),
        (("mks-rs485@1", "--pty", "--set", "address=5"), "the address of a drive stands in its name"),
        (("mks-rs485@1,model=42d,current=99999", "--pty"), "current: got 99999 mA, expected 0..3000 mA"),
        (("mks-rs485@1,curent=1", "--pty"), "has no setting 'curent'; did you mean current"),
        (("mks-rs485@1", "--pty", "--wire-fault", "flop=0.1"), "no wire fault 'flop'; did you mean flip"),
        (("mks-rs485@1", "--pty", "--state", "/"), "/: Is a directory"),
        (("mks-rs485@1", "--pty", "--log", "/no/such/folder/a.mcap"), "cannot write /no/such/folder/a.mcap"),
        (("mks-rs485@1", "--tcp", "x"), "expected HOST:PORT"),
    ],
)  # fmt: skip
def test_wrong_use_is_told(capsys: pytest.CaptureFixture[str], words: tuple[str, ...], told: str) -> None:
    assert told in refused(capsys, *words)


def test_a_state_that_does_not_fit_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    for text in ("", "[]", "{}", "[" * 100_000, '{"servotap": "drives", "version": 2, "drives": {}}', '{"servotap": 5}'):
        state.write_text(text)
        told = refused(capsys, "mks-rs485@1", "--pty", "--state", str(state))
        assert "does not hold the state of drives" in told
        assert "Error" not in told, "no name of Python's"
    kept: dict[str, object] = {"settings": {}}
    for top, drive in (({"by": "newer"}, kept), ({}, kept | {"motor": 3})):
        state.write_text(json.dumps({"servotap": "drives", "version": 1, "drives": {"mks-rs485@9": drive}} | top))
        before = state.read_bytes()
        told = refused(capsys, "mks-rs485@1", "--pty", "--state", str(state))
        assert told.endswith(": not known to this version of servotap\n")
        assert state.read_bytes() == before
    for value in ("1", 1.0, True, None, [], float("nan")):
        whole = {"servotap": "drives", "version": 1, "drives": {"mks-rs485@1": {"settings": {"saved_run": value}}}}
        state.write_text(json.dumps(whole))
        told = refused(capsys, "mks-rs485@1", "--pty", "--state", str(state))
        assert told.endswith(f"state of drives: mks-rs485@1: saved_run: expected a whole number, got {value!r}\n")
    whole = {"servotap": "drives", "version": 1, "drives": {"mks-rs485@1": {"settings": {"no_such": 1}}}}
    state.write_text(json.dumps(whole))
    assert "mks-rs485@1, as " in refused(capsys, "mks-rs485@1", "--pty", "--state", str(state))
    assert run("mks-rs485@2", "--pty", "--duration", "0.01", "--state", str(state)) == 0
    assert sorted(json.loads(state.read_text())["drives"]) == ["mks-rs485@1", "mks-rs485@2"]


# --- names of drives --------------------------------------------------------------------------------------------------


def test_near_names_of_faults_and_quirks() -> None:
    fault = next(f for f in make.every_fault() if f.name.startswith("lk-"))
    with pytest.raises(UsageError, match=rf"has no fault '{fault.name}x'; did you mean .*{fault.name}"):
        make.parse(f"lk-rs485@1,fault={fault.name}x")
    assert make.parse(f"lk-rs485@1,fault={fault.name}").faults == (fault,)
    without_family = fault.name.removeprefix("lk-")
    assert make.parse(f"lk-rs485@1,fault={without_family.replace('-', '_')}").faults == (fault,)
    for dialect in make.KINDS:
        assert [f.name for f in make.parse(f"{dialect}@3,fault=late-reply").faults] == ["late-reply"]
    of_one = next(f for f in make.every_fault() if "lk-rs485" not in f.dialects)
    with pytest.raises(UsageError, match=f"it belongs to {', '.join(sorted(of_one.dialects))}"):
        make.parse(f"lk-rs485@1,fault={of_one.name}")


def test_a_drive_with_each_fault_and_quirk_can_be_made() -> None:
    named = [("fault", each) for each in make.every_fault()] + [("quirk", each) for each in make.every_quirk()]
    texts = [(dialect, f"{dialect}@1,{what}={each.name}") for what, each in named for dialect in each.dialects]
    assert len(texts) > 700
    assert [text for dialect, text in texts if make.make(make.parse(text)).dialect.name != dialect] == []


@pytest.mark.parametrize("dialect", make.KINDS)
def test_settings_by_every_name(dialect: str) -> None:
    specification = make.parse(f"{dialect}@3")
    names = make.plain_drive(dialect).settings
    plain = make.make(specification)
    for name in names.names:
        setting = names.find(name)
        assert setting is not None
        assert names.find(name.replace("_", "-")) == setting
        assert setting in plain.settings
    assert plain.address == 3
    speed = sorted(plain.dialect.baud_rates)[-1]
    word = "bitrate" if plain.dialect.bus == "can" else "baud"
    fast = make.make(make.parse(f"{dialect}@3,{word}={speed}"))
    assert fast.speed == speed
    assert fast.settings != plain.settings


def test_settings_as_people_write_them() -> None:
    written = {"direction": "ccw", "set_current": "1500", "baud_rate": "115200", "subdivision": "0", "active": "off"}
    [given] = make.start_settings([make.parse("mks-rs485@1")], list(written.items()))
    assert given == {"motor_direction": 1, "current": 1500, "baud_rate": 6, "subdivision": 0, "active": 0}
    both = make.start_settings([make.parse("mks-rs485@1"), make.parse("lk-rs485@2")], [("work_mode", "5")])
    assert both == [{"work_mode": 5}, {}]


def test_the_reply_delay_moves_with_the_drives_own_time() -> None:
    plain = make.make(make.parse("mks-rs485@1"), reply_delay_ns=3_000_000)
    assert plain.reply_delay_ns == 3_000_000  # type: ignore[attr-defined]


def test_the_command_is_listed_without_importing_it() -> None:
    assert HELP["emulate"]
    parser = argparse.ArgumentParser()
    emulate.add_arguments(parser)
    assert "DRIVE" in parser.format_help()
    assert os.linesep not in HELP["emulate"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_second_signal_ends_what_hangs_in_a_driver(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(bus: object, arguments: argparse.Namespace) -> None:
        signal.raise_signal(number)
        signal.raise_signal(number)
        pytest.fail("nobody can end it")

    monkeypatch.setattr(emulate, "_open", hang)
    with pytest.raises(KeyboardInterrupt):
        run("mks-can@1", "--can", "virtual:x")
