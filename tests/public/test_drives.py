"""`servotap.drive`: emulated and real drives under the gate of `servotap send`, stopped in the end."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from datetime import UTC, datetime, timedelta

import pytest

import servotap
from analyzer import dialects
from conformance.pytest_plugin.fixtures import port_of
from conformance.safety import messages as say
from conformance.safety.guarded_line import GuardedLine
from tests import ROOT

RUN = {"direction": "cw", "speed": 60, "acceleration": 250}
READY = "mks-rs485@1,work_mode=sr_vfoc"


def running(drive):
    drive.send("run_speed", **RUN, allow={"motion", "unbounded"})
    drive.wait(1)


def test_values_are_read_in_their_units():
    with servotap.drive("mks-rs485@1,subdivision=32") as drive:
        assert drive.emulated
        assert drive.read("read_speed") == 0
        assert drive.read("read_enabled") in ("enabled", "disabled")
        assert drive.read("read_io", "in_1") in ("low", "high")
        assert set(drive.ask("read_io")) == {"in_1", "in_2", "out_1", "out_2"}
        with pytest.raises(servotap.UsageError, match="several fields: name one of"):
            drive.read("read_io")
        with pytest.raises(servotap.UsageError, match="did you mean read_speed"):
            drive.read("read_sped")
        with pytest.raises(servotap.UsageError, match="does more than read"):
            drive.read("enable", enabled=True)


@pytest.mark.parametrize("name", ["mks-rs485@1", "mks-modbus@1", "mks-can@1", "lk-rs485@1"])
def test_every_dialect_answers(name):
    with servotap.drive(name) as drive:
        assert drive.speed() == 0
        assert isinstance(drive.position(), float)
        assert "read_speed" in drive.commands or "read_state_2" in drive.commands


def test_what_is_not_allowed_is_not_sent():
    with servotap.drive(READY) as drive:
        with pytest.raises(servotap.Refused, match="needs motion, unbounded") as refused:
            drive.send("run_speed", **RUN)
        assert refused.value.__notes__ == ["from Python: allow=['motion', 'unbounded']"]
        with pytest.raises(servotap.Refused, match="needs motion"):
            drive.send("run_speed", **RUN, allow={"unbounded"})
        with pytest.raises(servotap.UsageError, match="needs acceleration"):
            drive.send("run_speed", direction="cw", speed=60, allow={"motion", "unbounded"})
        with pytest.raises(servotap.UsageError, match=r"expected 0\.\.3000 rpm"):
            drive.send("run_speed", **RUN | {"speed": 4000}, allow={"motion", "unbounded"})
        with pytest.raises(servotap.UsageError, match="--allow: got 'moton'"):
            drive.send("run_speed", **RUN, allow={"moton"})
        drive.wait(1)
        assert drive.speed() == 0


def test_bounds_hold():
    with servotap.drive(READY, allow={"motion", "unbounded"}, max_speed=50, subdivision=16) as drive:
        with pytest.raises(servotap.Refused, match="speed"):
            drive.send("run_speed", **RUN)
        drive.send("run_speed", **RUN | {"speed": 40})
        drive.wait(1)
        assert abs(drive.speed()) == pytest.approx(40, abs=1)


@pytest.mark.parametrize(
    "bound",
    [{"subdivision": 0}, {"subdivision": -16}, {"subdivision": 100_000}, {"subdivision": "16"}, {"max_speed": 0},
     {"max_turns": "2"}, {"max_acceleration": -1}, {"max_current": float("nan")}],
)  # fmt: skip
def test_a_bound_that_bounds_nothing_is_refused(bound):
    with pytest.raises(servotap.UsageError, match=f"{next(iter(bound))}: expected"):
        servotap.drive(READY, **bound)


def test_a_stop_needs_no_permission_and_the_end_stops():
    with servotap.drive(READY) as drive:
        running(drive)
        assert drive.speed() == pytest.approx(-60, abs=1)
        drive.send("stop_speed", acceleration=250, wait=True)
        assert drive.speed() == 0
        running(drive)
        line = drive._line
    shaft = line.bus.stations[0].drive
    assert shaft.motor.path.speed(shaft.now_ns) == 0
    with pytest.raises(servotap.UsageError, match="is closed"):
        drive.read("read_speed")


def test_leaving_with_an_error_stops():
    drive = servotap.drive(READY)
    with pytest.raises(ZeroDivisionError), drive:
        fails_while_running(drive)
    assert not drive._moving


def fails_while_running(drive):
    running(drive)
    1 / 0  # noqa: B018


def test_a_drive_that_does_not_stop_is_told():
    drive = servotap.drive("mks-rs485@1,work_mode=sr_open,fault=open-mode-stops-ignored")
    running(drive)
    with pytest.raises(servotap.NotStopped, match="NOT STOPPED: mks-rs485@1"):
        drive.close()


def test_a_move_is_waited_for():
    with servotap.drive(READY) as drive:
        reply = drive.send("move_relative_axis", speed=300, acceleration=250, position=16384, allow={"motion"}, wait=True)
        assert reply.outcome == "done"
        assert [frame["status"] for frame in reply.frames] == ["starting", "complete"]
        assert reply["status"] == "complete"
        assert abs(drive.position()) == pytest.approx(360, abs=1)


def test_a_refusal_raises_unless_it_may_be():
    with servotap.drive("mks-rs485@1,work_mode=cr_open", allow={"motion", "unbounded"}) as drive:
        with pytest.raises(servotap.NotDone, match=r"run_speed: mks-rs485@1 refused it or failed .status failed") as refused:
            drive.send("run_speed", **RUN)
        assert refused.value.reply.outcome == "failed"
        assert drive.send("run_speed", **RUN, must=False)["status"] == "failed"


def test_silence_raises_unless_it_may_be():
    with servotap.drive("mks-rs485@1", timeout=0.0001) as drive:
        with pytest.raises(servotap.NotDone, match=r"read_speed: mks-rs485@1 did not answer within 0\.1 ms"):
            drive.read("read_speed")
        assert drive.send("read_speed", must=False).outcome == "silent"


def test_settings_keep_a_distance():
    """Real drives drop hasty ones."""
    with servotap.drive("mks-rs485@1", allow={"setting", "torque", "wear"}) as drive:
        before = drive._line.now_ns()
        for current in (800, 900, 1000):
            drive.send("set_current", current=current)
        assert drive._line.now_ns() - before > 1_000_000_000


def test_what_was_done_is_in_the_log(tmp_path):
    path = tmp_path / "ramp.mcap"
    with servotap.drive(READY, allow={"motion", "unbounded"}, log=path) as drive:
        drive.send("run_speed", **RUN)
        for _ in range(10):
            drive.wait(0.1)
            drive.speed()
    capture = servotap.open(path)
    assert not list(capture.findings)
    commands = [each.first.command for each in capture.transactions]
    assert commands[0] == "run_speed"
    assert commands.count("read_speed") >= 10
    assert "stop_speed" in commands
    speeds = capture.to_polars(wide=True, topics="state", fields="speed")
    assert speeds["/emulated/1/state.speed"].min() == -60
    assert speeds["elapsed"][-1] > 1
    with pytest.raises(servotap.UsageError, match="exists; replace_log=True replaces it"):
        servotap.drive(READY, log=path)
    servotap.drive(READY, log=path, replace_log=True).close()
    assert not list(servotap.open(path).frames)


def test_no_field_is_hidden_by_an_option():
    fields = {
        name
        for dialect in dialects.every()
        for command in dialect.commands
        for form in command.request_forms
        for name in form.layout.named
    }
    assert not fields & {"self", "command", "field", "allow", "wait", "must", "force"}


# --- at an endpoint -----------------------------------------------------------------------------------------------------


@pytest.fixture
def port():
    with port_of(READY) as name:
        yield f"serial:{name},baud=38400"


def test_a_drive_at_an_endpoint_is_read_run_and_stopped(port, tmp_path):
    with servotap.drive("mks-rs485@1", port, subdivision=16, log=tmp_path / "a.mcap") as drive:
        assert not drive.emulated
        assert drive.read("read_speed") == 0
        drive.send("run_speed", **RUN, allow={"motion", "unbounded"})
        drive.wait(0.5)
        assert abs(drive.speed()) > 10
    with servotap.drive("mks-rs485@1", port) as drive:
        assert drive.speed() == 0
    asked = [each for each in servotap.open(tmp_path / "a.mcap").transactions if each.first.command == "run_speed"]
    assert [each.outcome for each in asked] == ["answered"]
    age = datetime.now(UTC) - asked[0].first.time
    assert timedelta(0) < age < timedelta(minutes=5)


def test_a_program_may_sleep_while_the_drive_turns(port, monkeypatch):
    begun, opened = [], GuardedLine.__init__

    def kept(line, endpoint, begin):
        begun.append(begin)
        opened(line, endpoint, begin)

    monkeypatch.setattr(GuardedLine, "__init__", kept)
    with servotap.drive("mks-rs485@1", port, max_run=7):
        pass
    assert (begun[0].longest_silence_ns, begun[0].longest_run_ns) == (say.NO_END_NS, 7_000_000_000)


def test_a_program_that_dies_leaves_no_motor_turning(port):
    program = f"""
        import os, servotap
        drive = servotap.drive("mks-rs485@1", {port!r})
        drive.send("run_speed", direction="cw", speed=60, acceleration=250, allow={{"motion", "unbounded"}})
        drive.wait(0.5)
        print(abs(drive.speed()) > 10, flush=True)
        os.kill(os.getpid(), 9)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.stdout == "True\n", done.stderr
    with servotap.drive("mks-rs485@1", port) as drive:
        assert drive.speed() == 0


def test_a_guard_that_is_killed_leaves_no_motor_turning(port, tmp_path):
    drive = servotap.drive("mks-rs485@1", port, allow={"motion", "unbounded"}, cut_power=f"touch {tmp_path / 'cut'}")
    drive.send("run_speed", **RUN)
    drive._line._process.kill()
    drive.close()
    assert not (tmp_path / "cut").exists()
    with servotap.drive("mks-rs485@1", port) as again:
        assert again.speed() == 0


def test_a_drive_that_no_other_guard_reaches_is_not_stopped(port, tmp_path):
    drive = servotap.drive("mks-rs485@1", port, allow={"motion", "unbounded"}, cut_power=f"touch {tmp_path / 'cut'}")
    drive.send("run_speed", **RUN)
    drive._line._process.kill()
    drive._open_line = lambda: servotap.drive("mks-rs485@1", "serial:/dev/none,baud=38400")
    with pytest.raises(servotap.NotStopped, match="/dev/none"):
        drive.close()
    assert (tmp_path / "cut").exists()


def test_a_drive_whose_second_guard_dies_too_is_not_stopped(port, tmp_path):
    drive = servotap.drive("mks-rs485@1", port, allow={"motion", "unbounded"}, cut_power=f"touch {tmp_path / 'cut'}")
    drive.send("run_speed", **RUN)
    drive._line._process.kill()
    opened = drive._open_line

    def dying():
        line = opened()
        line._process.kill()
        line._process.wait(10)
        return line

    drive._open_line = dying
    with pytest.raises(servotap.NotStopped, match="has gone"):
        drive.close()
    assert (tmp_path / "cut").exists()


def test_a_drive_that_is_not_there_is_told(port):
    with pytest.raises(servotap.DriveNotFound, match="mks-rs485@1 does"):
        servotap.drive("mks-rs485@2", port)
    with pytest.raises(servotap.UsageError):
        servotap.drive("mks-rs485@1", "serial:/dev/no-such-port,baud=38400")
