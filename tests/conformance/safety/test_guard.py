"""The guard: after any end of the suite, the motor stands and the settings are restored."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from analyzer import dialects
from analyzer.catalogue import Risk
from analyzer.cli.boundary import FOLDER
from analyzer.errors import UnreadableError
from analyzer.live import endpoint as endpoints
from conformance.bus import open_line
from conformance.claim import RigFault
from conformance.gate.gate import Allowance, Gate
from conformance.motion import motion
from conformance.safety import journal
from conformance.safety import messages as say
from conformance.safety.guard import Aside
from conformance.safety.guarded_line import GuardedLine
from conformance.safety.stopping import GuardLost
from conformance.talk.probe import plain_probe
from tests.conformance.drives.served import on_pty, wait_for

ROOT = Path(__file__).parents[3]
#: A suite that sets the work mode, runs the motor at 60 rpm, says so, and then does what the test says.
SUITE = """
import os, signal, sys, time
from analyzer.catalogue import Risk
from analyzer.cli.boundary import FOLDER
from conformance.motion import motion
from conformance.suite import plan as suite
from conformance.gate.gate import Allowance
from conformance.talk.probe import plain_probe
from conformance.suite.target import parse

path, ending = sys.argv[1:3]
risks = frozenset({Risk.READ, Risk.SETTING, Risk.MOTION, Risk.TORQUE, Risk.UNBOUNDED})
plan = suite.Plan((parse("mks-can@1" if path.startswith("can") else "mks-rs485@1", path),), Allowance(risks, 300.0),
                  settings={"": {"work_mode": "cr_vfoc", "subdivision": "16"}}, journal=sys.argv[3])
rig = suite.open_rig(plan, plan.targets[0])
from conformance.claim import Claim, Theme
probe = rig.probe(Claim("mks-rs485/state/x", Theme.STATE, "mks-rs485", "x", "", "x", lambda p: None))
motion.ready_to_move(probe, "sr_vfoc")
motion.run_at(probe, 60)
probe.wait(500_000_000)
print("speed", motion.speed(probe).value, flush=True)
if ending == "raise":
    raise RuntimeError("a claim went wrong")
if ending == "close":
    rig.close()
    sys.exit(0)
time.sleep(60)
"""


def started(path: str, ending: str, journal_path: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", SUITE, f"serial:{path},baud=38400", ending, str(journal_path)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("speed"), line + (process.stderr.read() if process.stderr else "")
    assert float(line.split()[1]) == pytest.approx(60, abs=2)
    return process


def looked_at(path: str) -> tuple[float, bool]:
    """Return the drive's speed, and whether the bus may enable it (it may not in the work mode that was put back)."""
    line = open_line(endpoints.parse(f"serial:{path},baud=38400"))
    try:
        gate = Gate(line, Allowance(frozenset({Risk.READ, Risk.MOTION, Risk.TORQUE}), addresses=frozenset({1})))
        probe = plain_probe(dialects.get("mks-rs485"), 1, gate)
        speed = motion.speed(probe).value
        return speed, not probe.refused(probe.ask("enable", {"enabled": 1}))
    finally:
        line.close()


def guards(of: int | None = None) -> list[int]:
    """Return the guards that run, or those that a process has started."""
    found = []
    for each in Path("/proc").iterdir():
        if each.name.isdigit():
            try:
                words = (each / "cmdline").read_bytes()
            except OSError:
                continue
            if b"conformance.safety.guard" in words and (of is None or f"\nPPid:\t{of}\n" in _status(each)):
                found.append(int(each.name))
    return found


def _status(process: Path) -> str:
    try:
        return (process / "status").read_text()
    except OSError:
        return ""


@pytest.mark.skipif(not Path("/proc").exists(), reason="needs /proc to see processes")
@pytest.mark.parametrize("ending", ["SIGKILL", "SIGHUP", "raise", "close"])
def test_the_motor_stands_and_settings_are_back_whatever_ends_the_suite(ending, tmp_path):
    path_of_journal = tmp_path / "run.journal"
    with on_pty("mks-rs485@1") as path:
        process = started(path, ending, path_of_journal)
        mine = set(guards(process.pid))
        assert mine
        if ending.startswith("SIG"):
            process.send_signal(getattr(signal, ending))
        process.communicate(timeout=60)
        assert wait_for(lambda: not mine & set(guards()), 60)
        speed, enabled = looked_at(path)
    assert speed == 0
    assert not enabled, "the work mode was not put back"
    if path_of_journal.exists():
        assert journal.open_changes(journal.read(path_of_journal)) == []
    if ending == "close":
        assert not path_of_journal.exists(), "a clean end leaves no journal"


def test_a_killed_guard_leaves_a_journal_for_restore(tmp_path):
    path_of_journal = tmp_path / "run.journal"
    with on_pty("mks-rs485@1") as path:
        process = started(path, "wait", path_of_journal)
        (guard,) = guards(process.pid)
        os.kill(guard, signal.SIGKILL)
        process.kill()
        process.communicate(timeout=20)
        changes = journal.open_changes(journal.read(path_of_journal))
        assert [(c.command, c.values) for c in changes] == [("set_work_mode", {"work_mode": 2})]
        done = subprocess.run(
            [sys.executable, "-c", "import sys; from analyzer.cli import _run; from conformance.cli import restore;"
             "sys.exit(_run('restore', restore, sys.argv[1:]))", str(path_of_journal)],
            capture_output=True, text=True, cwd=ROOT, timeout=60, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert "mks-rs485@1: the shaft was not seen standing" in done.stdout, "the shaft was still turning"
        assert "stopped, and it stands" in done.stdout
        assert "all 1 put back" in done.stdout
        assert journal.open_changes(journal.read(path_of_journal)) == []
        speed, enabled = looked_at(path)
        assert speed == 0
        assert not enabled


NEWER = b'{"event":"change","target":"mks-can@1","command":"set_current","values":{"current":800},"why":"newer"}'


@pytest.mark.parametrize(
    "text", [b"\xff{", b"[]", b"[" * 200_000, b"notes of mine", b'{"at":"', b'{"event":"end"}\n[]', NEWER, b'{"event":"pause"}']
)
def test_what_is_no_journal_is_not_taken_for_a_torn_line(text, tmp_path):
    """Else restoring it would say that nothing is left to be put back."""
    path = tmp_path / "run.journal"
    path.write_bytes(text)
    with pytest.raises(UnreadableError, match="expected a line of a journal"):
        journal.read(path)


@pytest.mark.parametrize("torn", [b"{", b'{"ev', b'{"event":"cha', b'{"event":"ch\0\0\0', b"\0" * 400])
def test_each_way_in_which_a_line_is_torn_off_is_known(torn, tmp_path):
    path = tmp_path / "run.journal"
    path.write_bytes(b'{"event":"end"}\n' + torn)
    assert [entry.event for entry in journal.read(path)] == ["end"]


def test_a_torn_last_line_of_a_journal_is_left_out(tmp_path):
    path = tmp_path / "a.journal"
    entry = b'{"event":"change","target":"mks-can@1","command":"set_work_mode","address":1,"values":{"work_mode":2}}\n'
    path.write_bytes(entry + b'{"event":"back","tar')
    assert len(journal.open_changes(journal.read(path))) == 1
    again = journal.Journal(path, again=True)
    again.write(journal.Entry(event="back", target="mks-can@1", command="set_work_mode", address=1, values={"work_mode": 2}))
    again.close(remove=False)
    assert [entry.event for entry in journal.read(path)] == ["change", "back"]


class FullDisk(io.FileIO):
    """A file that takes some bytes and then no more."""

    room = 20

    def write(self, data):
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        taken = super().write(bytes(data)[: self.room])
        self.room -= taken
        return taken


def test_a_line_of_a_journal_is_written_whole_or_refused(tmp_path, monkeypatch, capsys):
    path = tmp_path / "a.journal"
    kept = journal.Journal(path)
    entry = journal.Entry(event="change", target="mks-can@1", command="set_work_mode", address=1, values={"work_mode": 2})
    kept.write(entry)
    whole = path.read_bytes()
    kept._file = FullDisk(path, "r+b")
    with pytest.raises(RigFault, match="nothing was changed"):
        kept.write(entry)
    assert path.read_bytes() == whole
    kept.tell(entry)
    kept.tell(entry)
    assert capsys.readouterr().err.count("it will not say what was put back") == 1
    assert path.read_bytes() == whole


def test_what_the_guard_prints_steers_no_terminal(tmp_path, monkeypatch, capfd):
    (tmp_path / "sitecustomize.py").write_text(
        "import conformance.bus\ndef fails(endpoint): raise RuntimeError('\\x1b[2J')\nconformance.bus.open_line = fails\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv(FOLDER, str(tmp_path))
    with pytest.raises(GuardLost):
        GuardedLine(endpoints.parse("serial:/dev/none,baud=38400"), say.Begin("serial:/dev/none,baud=38400", (), Allowance()))
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "a fault of servotap: RuntimeError: \\x1b[2J;" in error


@pytest.mark.skipif(not hasattr(os, "set_blocking"), reason="a pipe cannot be filled here")
def test_what_the_guard_says_waits_for_no_reader():
    """A motor that is stopped next would turn on."""
    source, target = os.pipe()
    os.set_blocking(target, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(target, bytes(4096)):
            pass
    os.set_blocking(target, True)

    aside = Aside(target)
    words = ("NOT STOPPED: \x1b[31m", "one drive")
    speaker = threading.Thread(target=print, args=words, kwargs={"file": aside, "flush": True}, daemon=True)
    speaker.start()
    speaker.join(60)
    assert not speaker.is_alive()
    # Once it is read again, nothing is lost and nothing steers a terminal.
    said = b""
    while not said.endswith(b"\n"):
        said += os.read(source, 1 << 20)
    assert said.lstrip(b"\0") == b"NOT STOPPED: \\x1b[31m one drive\n"
    aside.close()
    os.close(source)
    os.close(target)
