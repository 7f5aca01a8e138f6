"""The guard against a suite that goes wrong, and the suite against a guard that dies: real processes on a pseudo-terminal."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from analyzer.encoder import build
from analyzer.errors import UsageError
from analyzer.live import endpoint as endpoints
from analyzer.system import own_process
from conformance.bus import open_line
from conformance.bus.line import LineLost
from conformance.claim import Claim, Inconclusive, NotStopped, Outcome, RigFault, Theme
from conformance.drives.serial_bus import SerialBus
from conformance.gate.gate import Gate, Refused
from conformance.gate.permissions import READS, Allowance, parse_allow
from conformance.motion import motion
from conformance.motion.declared import GENTLE
from conformance.pytest_plugin import plugin
from conformance.safety import guard as guard_process
from conformance.safety import guarded_line
from conformance.safety import messages as say
from conformance.safety.guard import Guard
from conformance.safety.guarded_line import GuardedLine, beginning
from conformance.safety.stopping import stop, stopping
from conformance.serve.clock import Clock
from conformance.serve.pty import PtyPort
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.target import parse
from conformance.talk.probe import plain_probe
from tests.conformance.drives.served import drives, on_logged_pty, on_port, on_pty, wait_for

ROOT = Path(__file__).parents[3]
MOVING = parse_allow("setting,motion,torque,unbounded")
NO_STOPS = "mks-rs485@1,work_mode=sr_vfoc,fault=speed-stop-ignored,fault=move-stop-ignored,fault=emergency-stop-ignored"
KNOWN = {"": {"work_mode": "cr_vfoc", "subdivision": "16"}}


def open_rig(path, tmp_path, risks=MOVING, **more):
    plan = suite.Plan(
        (parse("mks-rs485@1", f"serial:{path},baud=38400"),), Allowance(frozenset(risks), 300.0),
        settings=more.pop("settings", KNOWN), journal=str(tmp_path / "j"), **more,
    )  # fmt: skip
    return suite.open_rig(plan, plan.targets[0])


def probe_of(rig):
    return rig.probe(claim(lambda p: None))


def claim(check, *risks):
    return Claim("mks-rs485/state/x", Theme.STATE, "mks-rs485", "x", "", "x", check, risks=frozenset(risks))


def speed_of(path):
    line = open_line(endpoints.parse(f"serial:{path},baud=38400"))
    try:
        dialect = parse("mks-rs485@1").dialect
        return motion.speed(plain_probe(dialect, 1, Gate(line, Allowance(READS)))).value
    finally:
        line.close()


def test_a_suite_whose_own_gate_is_wide_open_sends_no_more_than_was_allowed(tmp_path):
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as path:
        rig = open_rig(path, tmp_path, READS)
        try:
            # As if the suite had been changed: its own gate lets everything through.
            rig.gate = Gate(rig.gate.line, Allowance(MOVING, alone=True))
            rig.allowed = MOVING
            probe = probe_of(rig)
            with pytest.raises(Refused, match="needs motion"):
                probe.ask("enable", {"enabled": 1})
            with pytest.raises(Refused, match="meant for 2"):
                probe.ask("read_speed", address=2)
            verdict = engine.run_claim(claim(lambda p: motion.run_at(p, 60)), rig)
            assert verdict.outcome is Outcome.NOT_RUN
            assert "needs motion" in verdict.reason
            # A stop always passes.
            assert stop(rig.gate.under(stopping(1)), rig.dialect, 1).failure == ""
        finally:
            rig.close()


def test_a_run_without_an_end_is_stopped_after_its_time_and_the_suite_goes_on(tmp_path):
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as path:
        rig = open_rig(path, tmp_path, longest_run=0.4)
        try:

            def check(probe):
                motion.ready_to_move(probe)
                motion.run_at(probe, 60)
                probe.wait(900_000_000)

            verdict = engine.run_claim(claim(check), rig)
            assert verdict.outcome is Outcome.INCONCLUSIVE
            assert "longer than 0.4 s (--max-run)" in verdict.reason
            assert engine.run_claim(claim(lambda p: p.read("read_speed") and None), rig).outcome is Outcome.CONFIRMED
        finally:
            rig.close()


def test_where_the_guard_dies_another_one_stops_the_motor_and_puts_back(tmp_path, capfd):
    with on_pty("mks-rs485@1") as path:
        rig = open_rig(path, tmp_path)
        probe = probe_of(rig)
        motion.ready_to_move(probe, "sr_vfoc")
        motion.run_at(probe, 60)
        rig.gate.line._process.kill()
        rig.gate.line._process.wait(10)
        rig.close()
        assert not (tmp_path / "j").exists(), "all was put back"
        assert speed_of(path) == 0
    assert "another one takes over" in capfd.readouterr().err


def test_where_the_second_guard_dies_too_the_power_is_cut_and_the_motor_is_not_stopped(tmp_path, capfd, monkeypatch):
    with on_pty("mks-rs485@1") as path:
        rig = open_rig(path, tmp_path, cut_power=f"touch {tmp_path / 'cut'}")
        probe = probe_of(rig)
        motion.ready_to_move(probe, "sr_vfoc")
        motion.run_at(probe, 60)

        def die():
            rig._line._process.kill()
            rig._line._process.wait(10)

        die()
        monkeypatch.setattr(rig.keeper, "use_gate", lambda gate: die())
        with pytest.raises(NotStopped, match=r"NOT STOPPED: mks-rs485@1: .*has gone"):
            rig.close()
        assert (tmp_path / "cut").exists()
        assert (tmp_path / "j").exists(), "what was not put back stands there"
    assert "NOT STOPPED" in capfd.readouterr().err


def test_a_suite_that_asks_nothing_while_the_motor_turns_is_taken_for_gone(tmp_path):
    """Suspended by Ctrl-Z, hanging, or waiting for a terminal that takes no more: the pipe does not end then."""
    with on_logged_pty("mks-rs485@1,work_mode=sr_vfoc") as port:
        dialect = parse("mks-rs485@1").dialect
        endpoint = endpoints.parse(port.on)
        begin = beginning(endpoint, [(dialect, 1)], Allowance(MOVING))
        line = GuardedLine(endpoint, msgspec.structs.replace(begin, longest_silence_ns=300_000_000))
        try:
            line.tell(say.DriveFound())
            gate = Gate(line, Allowance(MOVING))
            gate.send(build(dialect, "enable", 1, {"enabled": 1}))
            gate.send(build(dialect, "run_speed", 1, {"speed": 60, "acceleration": 200}))
            assert wait_for(lambda: build(dialect, "stop_speed", 1, {"acceleration": GENTLE}) in port.heard, 20)
            with pytest.raises(Inconclusive, match=r"asked nothing for 0\.3 s while a motor may turn"):
                gate.receive(0)
            assert motion.speed(plain_probe(dialect, 1, gate)).value == 0
            assert not line._process.poll()
        finally:
            line.close()


def test_a_silent_suite_whose_motor_stands_is_left_in_peace(tmp_path):
    with on_logged_pty("mks-rs485@1,work_mode=sr_vfoc") as port:
        guard = Guard(beginning(endpoints.parse(port.on), [(parse("mks-rs485@1").dialect, 1)], Allowance(MOVING)))
        try:
            assert guard.stop_unattended(1e6) == ""
            assert port.heard == b""
        finally:
            guard.line.close()


def test_a_motor_is_stopped_by_a_port_that_has_gone_and_come_back(tmp_path):
    """An adapter whose plug slips, or that enumerates anew: what was started before is stopped after."""
    bus, clock = SerialBus(drives("mks-rs485@1,work_mode=sr_vfoc")), Clock()
    link = tmp_path / "port"
    with on_port(bus, PtyPort(speed=38400), clock) as path:
        link.symlink_to(path)
        rig = open_rig(link, tmp_path)
        probe = probe_of(rig)
        motion.ready_to_move(probe, "sr_vfoc")
        motion.run_at(probe, 60)
    with pytest.raises(LineLost):
        probe.read("read_speed")
    with on_port(bus, PtyPort(speed=38400), clock) as path:
        link.unlink()
        link.symlink_to(path)
        rig.close()
        assert speed_of(path) == 0
        assert not (tmp_path / "j").exists(), "all was put back"


def test_where_nothing_stops_the_motor_the_guard_cuts_the_power_by_itself(tmp_path):
    cut = tmp_path / "cut"
    with on_pty(NO_STOPS) as path:
        rig = open_rig(path, tmp_path, cut_power=f"touch {cut}")
        probe = probe_of(rig)
        probe.do("enable", {"enabled": 1})
        motion.run_at(probe, 60)
        assert rig.gate.line.abandon() == 20
        assert cut.exists()
        rig._not_stopped = True
        rig.close()


@pytest.mark.parametrize("status", [0, None, 20, say.STANDS])
def test_a_guard_left_alone_is_believed_by_its_own_status_alone(status, tmp_path, monkeypatch):
    cut = tmp_path / "cut"
    with on_pty("mks-rs485@1") as path:
        rig = open_rig(path, tmp_path, cut_power=f"touch {cut}")
        rig._moved = True
        monkeypatch.setattr(rig, "_last", fails)
        left, rig._line.abandon = rig._line.abandon, lambda: status
        with pytest.raises(ZeroDivisionError if status == say.STANDS else NotStopped):
            rig.close()
        left()
    # One that says itself that it could not has cut the power.
    assert cut.exists() is (status in (0, None))


def fails():
    raise ZeroDivisionError


def test_a_drive_that_does_not_tell_its_position_is_not_stopped(tmp_path, monkeypatch):
    """Unplugged while it may be moving: a stop cannot be proved."""
    with on_pty("mks-rs485@1") as path:
        rig = open_rig(path, tmp_path, cut_power=f"touch {tmp_path / 'cut'}")
        monkeypatch.setattr("conformance.safety.stopping._RAMP_NS", 300_000_000)
        monkeypatch.setattr("conformance.safety.stopping._AT_ONCE_NS", 300_000_000)
        monkeypatch.setattr("conformance.motion.motion.position", _unread)
        rig._moved = True
        with pytest.raises(NotStopped, match="no position"):
            rig.settle()
        assert (tmp_path / "cut").exists()
        rig.close()


def _unread(probe, patience_ns=None):
    raise Inconclusive("no position")


def test_the_budget_holds_in_the_guard_too(tmp_path):
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as path:
        plan = suite.Plan((parse("mks-rs485@1", f"serial:{path},baud=38400"),), Allowance(MOVING), journal=str(tmp_path / "j"))
        limited = replace(plan.allowance.budget, commands=1)
        plan = replace(plan, allowance=replace(plan.allowance, budget=limited))
        rig = suite.open_rig(plan, plan.targets[0])
        try:
            rig.gate = Gate(rig.gate.line, Allowance(MOVING))
            rig.gate.send(build(rig.dialect, "enable", 1, {"enabled": 1}))
            with pytest.raises(Refused, match="budget of 1 commands"):
                rig.gate.send(build(rig.dialect, "enable", 1, {"enabled": 1}))
        finally:
            rig.close()


# --- whole runs -------------------------------------------------------------------------------------------------------

RUN = ["-c", "import sys; from analyzer.cli import main; sys.exit(main(sys.argv[1:]))", "test", "mks-rs485@1"]


def started(path, tmp_path, *more):
    words = [*RUN, "--on", f"serial:{path},baud=38400", "--allow", "setting,motion,torque,unbounded", "--subdivision", "16",
             "--settings", str(tmp_path / "s.json"), "--journal", str(tmp_path / "j"), *more]  # fmt: skip
    (tmp_path / "s.json").write_text('{"work_mode": "cr_vfoc", "subdivision": 16}')
    return subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip


@pytest.mark.parametrize("signals", [(signal.SIGINT, signal.SIGINT, signal.SIGINT), (signal.SIGTERM,)])
def test_ctrl_c_once_or_again_and_again_stops_the_motor_and_puts_back(signals, tmp_path):
    with on_pty("mks-rs485@1") as path:
        report = tmp_path / "r.html"
        process = started(path, tmp_path, "--claim", "*/motion/run_speed/*", "--json", "--report", str(report))
        process.stdout.readline()
        time.sleep(0.3)
        for number in signals:
            process.send_signal(number)
            time.sleep(0.15)
        _, err = process.communicate(timeout=60)
        assert process.returncode in (130, 0, 1) if len(signals) > 1 else process.returncode == 128 + signals[0], err
        assert "stopped after" in err
        assert "Traceback" not in err
        assert speed_of(path) == 0
        assert not (tmp_path / "j").exists()
        assert report.exists(), "verdicts so far are told"


def test_a_motor_that_does_not_stop_ends_the_run_with_20(tmp_path):
    cut = tmp_path / "cut"
    with on_pty(NO_STOPS) as path:
        process = started(
            path, tmp_path, "--claim", "*/motion/stop_speed/by-ramp", "--claim", "*/shape/read_speed/once",
            "--cut-power", f"echo cut >> {cut}", "--report", str(tmp_path / "r.html"),
        )  # fmt: skip
        out, err = process.communicate(timeout=90)
    assert process.returncode == 20, err
    assert "NOT STOPPED" in err
    assert cut.read_text().split() == ["cut"], "once"
    assert "1 of 2 claims ran" in out, "what was judged before is told"
    assert (tmp_path / "r.html").exists()


@pytest.mark.parametrize("workers", [(), ("-n", "2")], ids=["alone", "xdist"])
def test_a_motor_that_does_not_stop_ends_pytest_with_20(workers, tmp_path):
    (tmp_path / "s.json").write_text('{"work_mode": "cr_vfoc", "subdivision": 16}')
    with on_pty(NO_STOPS) as path:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "--pyargs", "conformance", "-q", "-p", "no:cacheprovider", *workers,
             "--drive", "mks-rs485@1", "--on", f"serial:{path},baud=38400", "--settings", "s.json", "--journal", "j",
             "--allow", "setting,motion,torque,unbounded", "--claim", "*/motion/stop_speed/*"],
            cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
    assert done.returncode == 20, done.stdout[-2000:]
    assert "NOT STOPPED" in done.stdout + done.stderr
    assert done.stdout.count("FAILED") <= 1, "no other worker went on with the port"


# --- motion that no claim declared, and a guard that does not answer --------------------------------------------------


def run_behind_the_probe(probe):
    """Send a run by the gate itself: no risk is declared, and the rig is not told."""
    run = build(probe.dialect, "run_speed", 1, {"speed": 60, "acceleration": 200})
    probe.gate.send(run)
    probe.gate.wait(300_000_000)


def test_a_claim_that_declares_no_motion_leaves_none(tmp_path):
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as path:
        rig = open_rig(path, tmp_path)
        try:
            rig.probe(claim(lambda p: None)).do("enable", {"enabled": 1})
            assert engine.run_claim(claim(run_behind_the_probe), rig).outcome is Outcome.CONFIRMED
            assert motion.speed(probe_of(rig)).value == 0
        finally:
            rig.close()


def test_what_was_sent_going_behind_the_rig_is_stopped_at_the_end_of_the_run(tmp_path):
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as path:
        rig = open_rig(path, tmp_path)
        probe = probe_of(rig)
        probe.do("enable", {"enabled": 1})
        run_behind_the_probe(probe)
        # As if the suite knew nothing: the guard does it alone.
        rig._moved, rig._line.moving = False, False
        rig.close()
        assert speed_of(path) == 0


@pytest.mark.parametrize("frozen", ["SIGSTOP"])
def test_a_guard_that_does_not_answer_is_killed_and_another_stops_the_motor(tmp_path, capfd, frozen):
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as path:
        rig = open_rig(path, tmp_path)
        probe = probe_of(rig)
        motion.ready_to_move(probe, "sr_vfoc")
        motion.run_at(probe, 60)
        first = rig.gate.line._process
        first.send_signal(getattr(signal, frozen))
        begun = time.monotonic()
        with pytest.raises(RigFault, match="did not answer"):
            probe.read("read_speed")
        rig.close()
        assert first.returncode == -signal.SIGKILL
        assert time.monotonic() - begun < 30
        assert speed_of(path) == 0
    assert "another one takes over" in capfd.readouterr().err


def test_a_guard_that_hangs_in_its_driver_and_cannot_be_killed_holds_nothing_up(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(guarded_line, "_KILLED_SECONDS", 0.2)
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as path:
        rig = open_rig(path, tmp_path, cut_power=f"touch {tmp_path / 'cut'}")
        probe = probe_of(rig)
        motion.ready_to_move(probe, "sr_vfoc")
        motion.run_at(probe, 60)
        first = rig.gate.line._process
        first.send_signal(signal.SIGSTOP)
        try:
            # The kernel kills no process that waits in a driver.
            monkeypatch.setattr(first, "kill", lambda: None)
            with pytest.raises(NotStopped, match="is in use by"):
                rig.close()
            assert first.poll() is None
        finally:
            first.send_signal(signal.SIGKILL)
            first.wait(10)
        assert (tmp_path / "cut").exists()
    assert "NOT STOPPED" in capfd.readouterr().err


@pytest.mark.parametrize("moving", [True, False])
def test_where_the_suite_has_gone_and_the_port_hangs_the_power_is_cut(tmp_path, capsys, monkeypatch, moving):
    ended = []
    monkeypatch.setattr(guard_process, "_ALONE_SECONDS", 0)
    monkeypatch.setattr(own_process, "end", ended.append)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.setattr(sys.stderr, "close", lambda: None)
    gone = threading.Thread()
    gone.start()
    with on_pty("mks-rs485@1") as path:
        begin = beginning(endpoints.parse(f"serial:{path},baud=38400"), [(parse("mks-rs485@1").dialect, 1)], Allowance(READS))
        guard = Guard(msgspec.structs.replace(begin, cut_power=f"touch {tmp_path / 'cut'}", moving=moving))
        guard_process._watch(gone, guard)
        guard.line.close()
    assert ended == [20] * moving
    assert (tmp_path / "cut").exists() is moving
    assert ("NOT STOPPED: mks-rs485@1: the suite has gone" in sys.stderr.getvalue()) is moving


def test_a_second_beginning_does_not_end_the_guard(tmp_path):
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as path:
        rig = open_rig(path, tmp_path)
        try:
            with pytest.raises(UsageError, match="open already"):
                rig.gate.line._ask(rig._begin())
            assert motion.speed(probe_of(rig)).value == 0
        finally:
            rig.close()


def children_of(pid):
    """Return the processes that a process has started."""
    found = []
    for each in Path("/proc").glob("[0-9]*"):
        try:
            words = (each / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(words[1]) == pid:
            found.append(int(each.name))
    return found


@contextlib.contextmanager
def adopting():
    """Take over processes whose parent is killed, so that this one can ask how they ended."""
    system = ctypes.CDLL(None, use_errno=True)
    assert system.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) == 0
    try:
        yield
    finally:
        system.prctl(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


_PR_SET_CHILD_SUBREAPER = 36


@pytest.mark.skipif(not Path("/proc").exists(), reason="needs /proc to see processes")
def test_workers_end_at_once_when_their_controller_is_killed(tmp_path):
    (tmp_path / "s.json").write_text('{"work_mode": "cr_vfoc", "subdivision": 16}')
    with adopting(), on_pty("mks-rs485@1") as path:
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "--pyargs", "conformance", "-v", "-p", "no:cacheprovider", "-n", "4",
             "--drive", "mks-rs485@1", "--on", f"serial:{path},baud=38400", "--settings", "s.json", "--journal", "j",
             "--allow", "setting,motion,torque,unbounded", "--claim", "*/motion/run_speed/*"],
            cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert any("run_speed" in line and ("PASSED" in line or "FAILED" in line) for line in process.stdout)
        workers = children_of(process.pid)
        assert len(workers) >= 4
        process.kill()
        process.communicate(timeout=20)
        ends = [os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1]) for worker in workers]
        # Workers without a test end by themselves. The one at the drive would go on for seconds, and end otherwise.
        assert sorted(ends)[-1] == plugin._GONE
        assert set(ends) <= {0, plugin._GONE}
