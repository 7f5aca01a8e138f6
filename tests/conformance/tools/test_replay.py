"""`servotap replay`: requests at their times, by permission alone, compared with then; and motors that stand in the end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import uuid
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from analyzer import cli as analyzer_cli
from analyzer import dialects
from analyzer.catalogue import Risk, Role
from analyzer.encoder import build
from analyzer.pipeline import Pipeline
from analyzer.records import CanFrame, Chunk
from benchmarks.gate import sound
from conformance.bus.emulated import EmulatedLine
from conformance.bus.python_can import LibraryPort
from conformance.claim import Inconclusive
from conformance.cli import replay as command
from conformance.drives import make
from conformance.drives.can_bus import CanBus
from conformance.drives.serial_bus import SerialBus
from conformance.gate.budget import Budget
from conformance.gate.gate import Allowance, Gate, Item, Judge
from conformance.serve.pty import PtyPort
from conformance.tools import replay as tool
from conformance.tools.replay import PATIENCE_NS, Match, Replay, compare, rehearse
from conformance.tools.replay_plan import Plan, make_plan
from tests.conformance.drives.served import LoggedPty, drives, on_logged_pty, on_port, on_pty, wait_for
from tests.conformance.drives.served import on_can as serve_can
from tests.conformance.safety.test_guard import guards
from tests.conformance.vectors import EVERYTHING, on_can

MKS, CAN, LK = (dialects.get(n) for n in ("mks-rs485", "mks-can", "lk-rs485"))
MS = 1_000_000
SECOND_NS = 1_000_000_000
READ = build(MKS, "read_speed", 1)
REPLY = build(MKS, "read_speed", 1, {}, Role.REPLY)
RUN = build(MKS, "run_speed", 1, {"speed": 60, "acceleration": 250})
RUNS = build(MKS, "run_speed", 1, {"status": 1}, Role.REPLY)
STOP = build(MKS, "stop_speed", 1, {"acceleration": 250})
ENABLE = build(MKS, "enable", 1, {"enabled": 1})


def log(path: Path, *rows: tuple[float, str, bytes]) -> str:
    """Write a text log: seconds, `>` or `<`, bytes."""
    path.write_text("".join(f"{t:.6f} {way} {data.hex(' ').upper()}\n" for t, way, data in rows))
    return str(path)


def plan_of(*rows: tuple[float, str, bytes], **options: Any) -> Plan:
    roles = {">": Role.REQUEST, "<": Role.REPLY}
    items = [Chunk(int(t * 1e9), "bus", data, roles[way], True) for t, way, data in rows]
    return make_plan(items, partial(Pipeline, (MKS, LK)), **options)


def polls(count: int, gap_s: float = 0.01) -> list[tuple[float, str, bytes]]:
    rows = []
    for n in range(count):
        rows += [(n * gap_s, ">", READ), (n * gap_s + 0.003, "<", REPLY)]
    return rows


class Watched:
    """A replay on an emulated line, with the times at which its items left."""

    def __init__(self, *names: str, speed: float = 1.0, allow: frozenset[Risk] = EVERYTHING, **options: Any) -> None:
        self.drives = [make.make(make.parse(n), **options) for n in names or ("mks-rs485@1,work_mode=sr_vfoc",)]
        self.line = EmulatedLine(self.drives)
        self.gate = Gate(self.line, Allowance(allow))
        self.left: list[tuple[int, Item]] = []
        self.gate.on_sent.append(lambda t_ns, item: self.left.append((self.line.now_ns(), item)))
        self.replay = Replay(self.gate, [d.dialect for d in self.drives], speed=speed)

    def times(self) -> list[float]:
        """Seconds since the first one left."""
        return [(t - self.left[0][0]) / 1e9 for t, _ in self.left]


# --- the plan ---------------------------------------------------------------------------------------------------------


def test_requests_are_taken_with_their_replies():
    plan = plan_of(*polls(2), (1.0, ">", RUN), (1.1, "<", RUNS), (1.2, "<", b"\x00\x55"))
    assert [(s.name, s.t_ns, s.item) for s in plan.steps] == [
        ("read_speed", 0, READ), ("read_speed", 10 * MS, READ), ("run_speed", SECOND_NS, RUN),
    ]  # fmt: skip
    assert [len(s.replies) for s in plan.steps] == [1, 1, 1]
    assert plan.steps[2].replies[0].kind == ("run_speed", "reply", 1)
    assert plan.left_out == {"pieces of junk": 1}
    assert plan.duration_ns == SECOND_NS
    assert plan.period_ns == SECOND_NS + SECOND_NS // 2


def test_an_echo_was_not_sent_by_anybody():
    plan = plan_of((0, ">", READ), (0.001, ">", READ), (0.003, "<", REPLY))
    assert [s.item for s in plan.steps] == [READ]
    assert plan.left_out == {"echoes of an adapter": 1}


def test_addresses_and_buses_are_chosen():
    other = build(MKS, "read_speed", 2)
    rows = ((0.0, ">", READ), (0.1, ">", other))
    assert [s.address for s in plan_of(*rows, addresses=frozenset({2})).steps] == [2]
    items = [Chunk(1, "left", READ, Role.REQUEST, True), Chunk(2, "right", other, Role.REQUEST, True)]
    plan = make_plan(items, partial(Pipeline, (MKS,)), bus="right")
    assert [s.address for s in plan.steps] == [2]
    assert dict(plan.buses) == {"left": 1, "right": 1}


def test_what_nobody_can_tell_is_left_out():
    frames = [CanFrame(1, "can0", 1, b"\x31\x32", extended=True), CanFrame(2, "can0", 1, b"\x31\x32")]
    plan = make_plan(frames, partial(Pipeline, (CAN,)))
    assert [s.item for s in plan.steps] == [on_can(1, b"\x31\x32")]
    assert plan.left_out == {"frames that are not of this dialect": 1}


# --- comparing --------------------------------------------------------------------------------------------------------


def replies(*rows: tuple[str, dict[str, int]]) -> list[Any]:
    built = [build(MKS, name, 1, values, Role.REPLY) for name, values in rows]
    requests = {name: build(MKS, name, 1, {"speed": 1} if "move" in name else {}) for name, _ in rows}
    items = [(0.0, ">", next(iter(requests.values()))), *((0.1 + n, "<", data) for n, data in enumerate(built))]
    return plan_of(*items).steps[0].replies


SPEED_0 = replies(("read_speed", {"speed": 0}))
SPEED_5 = replies(("read_speed", {"speed": 5}))
DONE = replies(("move_relative_axis", {"status": 1}), ("move_relative_axis", {"status": 2}))
LIMIT = replies(("move_relative_axis", {"status": 1}), ("move_relative_axis", {"status": 3}))


@pytest.mark.parametrize(
    ("then", "now", "match"),
    [
        (SPEED_0, SPEED_0, Match.SAME), (SPEED_0, SPEED_5, Match.VALUES), (SPEED_0, [], Match.MISSING),
        ([], SPEED_0, Match.MORE), ([], [], Match.SILENT), (DONE, DONE, Match.SAME), (DONE, LIMIT, Match.DIFFERENT),
        (DONE, DONE[:1], Match.MISSING), (DONE[:1], DONE, Match.MORE), (SPEED_0, DONE[:1], Match.DIFFERENT),
    ],
)  # fmt: skip
def test_comparing(then: list[Any], now: list[Any], match: Match):
    assert compare(then, now) is match


# --- times ------------------------------------------------------------------------------------------------------------


def test_requests_leave_at_their_times():
    watched = Watched()
    rows = [(0.0, READ), (0.0105, READ), (0.5, READ), (7.25, READ)]
    plan = plan_of(*((t, ">", data) for t, data in rows))
    result = watched.replay.run(plan.steps)
    assert watched.times() == [t for t, _ in rows]
    assert result.sent == 4
    assert result.lateness_ns(1.0) == 0
    assert result.matches == {("read_speed", Match.MORE): 4}


def test_faster_slower_and_over_again():
    plan = plan_of(*polls(3, 0.1))
    watched = Watched(speed=2)
    watched.replay.run(plan.steps, plan.period_ns, 2)
    assert watched.times() == pytest.approx([0, 0.05, 0.1, 0.15, 0.2, 0.25])
    watched = Watched(speed=0.5)
    watched.replay.run(plan.steps)
    assert watched.times() == pytest.approx([0, 0.2, 0.4])


def test_nothing_drifts_over_an_hour():
    plan = plan_of(*((n * 10.0, ">", READ) for n in range(360)))
    watched = Watched()
    watched.replay.run(plan.steps)
    assert watched.times()[-1] == 3590.0


def test_a_slow_drive_is_waited_for_and_makes_no_other_late():
    # The reply takes 30 ms where it took 3, and the next request is due after 10.
    plan = plan_of(*polls(3), (0.5, ">", READ), (0.503, "<", REPLY))
    watched = Watched(reply_delay_ns=30 * MS)
    result = watched.replay.run(plan.steps)
    assert result.held == 2
    assert result.matches == {("read_speed", Match.SAME): 4}
    assert watched.times()[-1] == 0.5
    silent = Watched("mks-rs485@9")
    result = silent.replay.run(plan.steps)
    assert result.matches == {("read_speed", Match.MISSING): 4}
    assert silent.times()[1] == pytest.approx(PATIENCE_NS / 1e9, rel=0.05)


def test_a_late_step_does_not_run_into_a_completion_that_had_come_before_it():
    ends = [build(MKS, "stop_speed", 1, {"status": n}, Role.REPLY) for n in (1, 2)]
    moved = [(0.0, ">", ENABLE), (0.1, ">", RUN), (0.103, "<", RUNS), (1.0, ">", STOP)]
    moved += [(1.003, "<", ends[0]), (1.02, "<", ends[1])]
    reads = [(1.05 + t, way, data) for t, way, data in polls(20)]
    watched = Watched()

    def stand_still(t_ns: int, item: Item) -> None:
        """Let this process stand still once the motor runs, until all that follows is late."""
        if item == RUN:
            watched.line.bus.run_until(t_ns + 2 * SECOND_NS)

    watched.gate.on_sent.append(stand_still)
    result = watched.replay.run(plan_of(*moved, *reads).steps)
    assert result.matches["stop_speed", Match.SAME] == 1
    assert {match: n for (name, match), n in result.matches.items() if name == "read_speed"} == {Match.SAME: 20}


def test_on_can_nothing_is_held():
    frames = [CanFrame(n * 10 * MS, "can0", 1, build(CAN, "read_speed", 1), Role.REQUEST) for n in range(3)]
    plan = make_plan(frames, partial(Pipeline, (CAN,)))
    watched = Watched("mks-can@1", reply_delay_ns=30 * MS)
    result = watched.replay.run(plan.steps)
    assert watched.times() == pytest.approx([0, 0.01, 0.02], abs=0.001)
    assert result.held == 0


def test_a_reply_that_the_next_request_overtook_is_late_and_not_missing():
    said = build(CAN, "read_speed", 1, {}, Role.REPLY)
    frames = []
    for n in range(4):
        frames.append(CanFrame(n * 10 * MS, "can0", 1, build(CAN, "read_speed", 1), Role.REQUEST))
        frames.append(CanFrame((n * 10 + 2) * MS, "can0", 1, said, Role.REPLY))
    plan = make_plan(frames, partial(Pipeline, (CAN,)))
    result = Watched("mks-can@1", reply_delay_ns=25 * MS).replay.run(plan.steps)
    assert result.matches == {("read_speed", Match.SAME): 4}
    assert result.others == 0
    # What does not come at all is missing.
    result = Watched("mks-can@2", reply_delay_ns=25 * MS).replay.run(plan.steps)
    assert result.matches == {("read_speed", Match.MISSING): 4}


def test_measured_values_may_differ_and_statuses_may_not():
    turned = build(MKS, "read_position", 1, {"position": 12345}, Role.REPLY)
    refused = build(MKS, "run_speed", 1, {"status": 0}, Role.REPLY)
    rows = [(0, ">", build(MKS, "read_position", 1)), (0.003, "<", turned), (0.1, ">", RUN), (0.103, "<", refused)]
    watched = Watched()
    result = watched.replay.run(plan_of(*rows, (0.2, ">", STOP)).steps)
    assert result.matches["read_position", Match.VALUES] == 1
    assert result.matches["run_speed", Match.DIFFERENT] == 1
    assert result.examples["run_speed", Match.DIFFERENT].replies[0].data == RUNS


def test_a_completion_that_came_after_the_last_request_is_waited_for():
    move = build(MKS, "move_relative_pulses", 1, {"speed": 60, "acceleration": 250, "pulses": 6400})
    begun, done = (build(MKS, "move_relative_pulses", 1, {"status": status}, Role.REPLY) for status in (1, 2))
    rows = [(0, ">", move), (0.003, "<", begun), (0.5, ">", READ), (0.503, "<", REPLY), (2.1, "<", done)]
    result = Watched().replay.run(plan_of(*rows).steps)
    assert result.matches["move_relative_pulses", Match.SAME] == 1
    assert not result.deviations


# --- permission -------------------------------------------------------------------------------------------------------


def test_all_is_judged_before_anything_leaves():
    plan = plan_of(*polls(2), (1, ">", RUN), (2, ">", RUN), (3, ">", STOP), (4, ">", READ))
    judge = Judge(Allowance(frozenset({Risk.MOTION})))
    found = rehearse(judge, plan, 1.0)
    assert [s.name for s in found.allowed] == ["read_speed", "read_speed", "stop_speed", "read_speed"]
    assert [(name, count) for name, count, _ in found.by_command()] == [("mks-rs485@1 run_speed", 2)]


def test_a_budget_is_rehearsed_too():
    plan = plan_of(*((n * 1.0, ">", RUN) for n in range(5)))
    judge = Judge(Allowance(EVERYTHING, budget=Budget(commands=3)))
    found = rehearse(judge.rehearsal(), plan, 1.0)
    assert len(found.allowed) == 3
    assert rehearse(judge.rehearsal(), plan, 1.0).allowed == found.allowed
    seconds = Judge(Allowance(EVERYTHING, budget=Budget(seconds=2)))
    assert len(rehearse(seconds.rehearsal(), plan, 1.0).allowed) == 3
    assert len(rehearse(seconds.rehearsal(), plan, 2.0).allowed) == 5


# --- what moves -------------------------------------------------------------------------------------------------------


def stands(drive: Any) -> bool:
    return drive.motor.speed(drive.now_ns) == 0


def test_a_run_that_was_left_running_is_stopped_at_the_end():
    watched = Watched()
    result = watched.replay.run(plan_of((0, ">", RUN), (0.003, "<", RUNS)).steps)
    assert not result.stopped
    assert not result.left_moving
    assert stands(watched.drives[0])
    assert STOP[:5] in [item[:5] for _, item in watched.left if isinstance(item, bytes)]


def test_a_run_that_was_stopped_is_left_alone():
    watched = Watched()
    watched.replay.run(plan_of((0, ">", RUN), (0.5, ">", STOP)).steps)
    assert [item for _, item in watched.left] == [RUN, STOP]


@pytest.mark.parametrize("name", ["mks-rs485@1,work_mode=sr_vfoc", "mks-can@1,work_mode=bus_closed", "lk-rs485@1"])
def test_ctrl_c_stops_the_motor_by_a_ramp(name: str):
    watched = Watched(name)
    dialect = watched.drives[0].dialect
    speed = {"speed": 36000} if dialect is LK or dialect.name == "lk-rs485" else {"speed": 60, "acceleration": 200}
    frame = build(dialect, "run_speed", 1, speed)
    read = build(dialect, "read_position", 1)
    items: list[Chunk | CanFrame] = []
    for t_ns, data in ((0, frame), (SECOND_NS, read), (60 * SECOND_NS, read)):
        serial = dialect.bus == "serial"
        items.append(Chunk(t_ns, "x", data, Role.REQUEST, True) if serial else CanFrame(t_ns, "x", 1, data, Role.REQUEST))

    def interrupt(sent: Any) -> None:
        if sent.step.t_ns == SECOND_NS:
            raise KeyboardInterrupt

    result = watched.replay.run(make_plan(items, partial(Pipeline, (dialect,))).steps, advance=interrupt)
    assert result.stopped == "Ctrl-C"
    assert result.left_moving == []
    assert result.sent == 2
    last = watched.gate.now_ns()
    watched.gate.wait(SECOND_NS)
    position = watched.drives[0].motor
    before = position.position if dialect.name == "lk-rs485" else position.position(last)
    watched.gate.wait(SECOND_NS)
    after = position.position if dialect.name == "lk-rs485" else position.position(watched.gate.now_ns())
    assert float(before) == pytest.approx(float(after))


@pytest.mark.parametrize("broken_into", [RUN, STOP[:5]], ids=["the run", "the stop at the end"])
def test_ctrl_c_that_falls_into_a_sending_leaves_no_motor_turning(broken_into: bytes):
    """The motor turns as soon as the bytes have left, even while the sending is not over."""
    watched = Watched()
    left: list[bytes] = []

    def interrupt(t_ns: int, item: Item) -> None:
        if isinstance(item, bytes) and item.startswith(broken_into) and not left:
            left.append(item)
            raise KeyboardInterrupt

    watched.gate.on_sent.append(interrupt)
    result = watched.replay.run(plan_of((0, ">", RUN), (0.003, "<", RUNS)).steps)
    assert left
    assert result.stopped == "Ctrl-C"
    assert result.left_moving == []
    watched.gate.on_sent.clear()
    watched.gate.wait(SECOND_NS)
    assert stands(watched.drives[0])


def test_a_broadcast_run_is_stopped_by_broadcast():
    watched = Watched()
    watched.gate = watched.gate.under(Allowance(EVERYTHING, alone=True))
    watched.replay = Replay(watched.gate, [MKS])
    everybody = build(MKS, "run_speed", 0, {"speed": 60, "acceleration": 250})
    result = watched.replay.run(plan_of((0, ">", everybody)).steps)
    assert "cannot be asked of all" in result.left_moving[0]
    watched.gate.wait(SECOND_NS)
    assert stands(watched.drives[0])


def test_a_guard_that_has_stopped_the_motor_ends_the_replay():
    watched = Watched()

    def stopped(sent: object) -> None:
        raise Inconclusive("the guard has stopped the motor")

    result = watched.replay.run(plan_of((0, ">", RUN), (1, ">", READ)).steps, advance=stopped)
    assert result.stopped == "the guard has stopped the motor"
    assert not result.left_moving
    assert stands(watched.drives[0])


def test_a_drive_that_cannot_be_stopped_is_told():
    watched = Watched("mks-rs485@1,work_mode=sr_vfoc,fault=speed-stop-ignored")
    result = watched.replay.run(plan_of((0, ">", RUN)).steps)
    # The stops of moves stop it too; which one did is not the user's business.
    assert stands(watched.drives[0]) != bool(result.left_moving)
    gone = Watched("mks-rs485@1,work_mode=sr_vfoc")
    result = gone.replay.run(plan_of((0, ">", RUN), (1, ">", READ)).steps, advance=lambda sent: gone.line.close())
    assert "closed" in result.stopped
    assert "mks-rs485@1: " in result.left_moving[0]


# --- the command ------------------------------------------------------------------------------------------------------


def run(*words: str) -> int:
    return analyzer_cli._run("replay", command, words)


def test_on_a_port(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    # A real drive has a clock of its own. This one shares a process with its host, and both may stand still.
    monkeypatch.setattr(tool, "PATIENCE_NS", SECOND_NS)
    stops = [build(MKS, "stop_speed", 1, {"status": n}, Role.REPLY) for n in (1, 2)]
    moved = [(0.35, ">", RUN), (0.353, "<", RUNS), (0.4, ">", STOP), (0.403, "<", stops[0]), (0.42, "<", stops[1])]
    path = log(tmp_path / "poll.log", *polls(30), *moved, (0.8, ">", READ), (0.803, "<", REPLY))
    with on_pty("mks-rs485@1,work_mode=sr_vfoc") as port:
        on = ("--on", f"serial:{port},baud=38400")
        assert run(path, *on) == 2
        err = capsys.readouterr().err
        assert "nothing was sent: 2 of 33 requests are not allowed" in err
        assert "1 x mks-rs485@1 run_speed" in err
        assert run(path, *on, "--skip-refused") == 0
        out = capsys.readouterr().out
        assert "31 requests sent" in out
        assert "2 were left out as not allowed" in out
        status = run(path, *on, "--allow", "motion,unbounded", "--speed", "2", "--loop", "2", "--json")
        found = json.loads(capsys.readouterr().out)
        assert (status, found["deviating"]) == (0, []), found["matches"]
        assert found["sent"] == 66
        assert found["matches"]["run_speed"] == {"same bytes": 2}
        assert found["matches"]["stop_speed"] == {"same bytes": 2}
        assert found["late"]["p50"] < 0.05


def test_on_can(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    rows = []
    for n in range(10):
        rows.append(f"({n * 0.01:.6f}) can0 001#{build(CAN, 'read_speed', 1).hex()}\n")
        rows.append(f"({n * 0.01 + 0.002:.6f}) can0 001#{build(CAN, 'read_speed', 1, {}, Role.REPLY).hex()}\n")
    path = tmp_path / "can.log"
    path.write_text("".join(rows))
    channel = f"test {uuid.uuid4()}"
    with serve_can(CanBus(drives("mks-can@1")), LibraryPort("virtual", channel)):
        assert run(str(path), "--on", f"can:virtual:{channel}") == 0
    out = capsys.readouterr().out
    assert "10 requests sent" in out
    assert "10 same bytes" in out


@pytest.mark.parametrize("speed", ["1e-320", "0", "-1", "nan", "inf", "1e7"])
def test_a_speed_by_which_no_time_can_be_divided(speed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        run(log(tmp_path / "poll.log", *polls(2)), "--dry-run", f"--speed={speed}")
    assert "expected a factor of 1e-6 to 1e6" in capsys.readouterr().err


def test_a_dry_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = log(tmp_path / "poll.log", *polls(3), (1.0, ">", RUN))
    assert run(path, "--dry-run") == 2
    out = capsys.readouterr().out
    assert "4 requests over 1.0 s" in out
    assert "3 x mks-rs485@1 read_speed" in out
    assert "not allowed: mks-rs485@1 run_speed" in out
    assert run(path, "--dry-run", "--allow", "motion,unbounded") == 0
    assert run(path, "--dry-run", "--allow", "motion,unbounded", "--max-speed", "10") == 2
    assert "--subdivision" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "where? expected --on"),
        (("--on", "can:virtual:x"), "is of a serial bus"),
        (("--on", "tcp:127.0.0.1:1"), "cannot connect"),
        (("--dry-run", "--bus", "left"), "has no bus 'left'"),
        (("--dry-run", "--address", "9"), "has no request to send (3 requests to other addresses)"),
        (("--dry-run", "--address", "x"), "got 'x', expected addresses from 1 to 2047"),
    ],
)
def test_wrong_use(words: tuple[str, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run(log(tmp_path / "poll.log", *polls(3)), *words) == 2
    assert told in capsys.readouterr().err


def test_a_file_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run(str(tmp_path / "none"), "--dry-run") == 2
    assert "none" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_stop_the_motor(number: int, tmp_path: Path):
    path = log(tmp_path / "run.log", (0, ">", RUN), (0.003, "<", RUNS), *((1.0 + n, ">", READ) for n in range(60)))
    bus = SerialBus(drives("mks-rs485@1,work_mode=sr_vfoc"))
    drive: Any = bus.drives[0]
    with on_port(bus, PtyPort(speed=38400)) as port:
        words = [path, "--on", f"serial:{port},baud=38400", "--allow", "motion,unbounded"]
        code = "import sys; from analyzer.cli import main; sys.exit(main(['replay', *sys.argv[1:]]))"
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}
        process = subprocess.Popen(
            [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        )
        assert wait_for(lambda: drive.motor.speed(drive.now_ns) > 0 or process.poll() is not None, 20)
        assert process.poll() is None
        process.send_signal(number)
        out, err = process.communicate(timeout=20)
        assert stands(drive), out + err
        assert drive.memory.enabled
    assert process.returncode == 128 + number, out + err
    assert "stopped: Ctrl-C" in out
    assert "NOT KNOWN TO STAND" not in out


ALLOWED = ("--allow", "motion,unbounded,torque")
RUN_ALL = build(MKS, "run_speed", 0, {"speed": 60, "acceleration": 250})


def turning(port: LoggedPty) -> bool:
    return not stands(port.bus.drives[0])


@pytest.mark.parametrize(("sent", "more"), [(RUN, ()), (RUN_ALL, ("--alone",))], ids=["one", "all"])
def test_a_replay_that_is_killed_leaves_no_motor_turning(sent: bytes, more: tuple[str, ...], tmp_path: Path):
    """The guard owns the port: it stops what the replay has set going."""
    path = log(tmp_path / "run.log", (0, ">", ENABLE), (0.2, ">", sent), (60, ">", STOP))
    with on_logged_pty("mks-rs485@1,work_mode=sr_vfoc") as port:
        process = subprocess.Popen(
            [sys.executable, "-c", "import sys; from analyzer.cli import _run; from conformance.cli import replay;"
             "sys.exit(_run('replay', replay, sys.argv[1:]))", path, "--on", port.on, *ALLOWED, *more],
            cwd=Path(__file__).parents[3],
        )  # fmt: skip
        assert wait_for(lambda: turning(port), 30)
        process.kill()
        process.wait()
        assert wait_for(lambda: not turning(port), 30)
        assert port.heard.startswith(ENABLE + sent) or ENABLE + sent in port.heard
        acts = [s.command.name for s in sound([port.heard]) if not s.risks <= {Risk.READ}]
    assert acts[:2] == ["enable", "run_speed"]
    assert acts[2:]
    assert all(name.startswith("stop_") for name in acts[2:])


@pytest.mark.skipif(not Path("/proc").exists(), reason="needs /proc to see processes")
@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_where_the_guard_of_a_replay_is_lost_another_stops_the_motor(number: int, tmp_path: Path, capsys):
    path = log(tmp_path / "run.log", (0, ">", ENABLE), (0.2, ">", RUN), *((0.5 + n / 4, ">", READ) for n in range(200)))
    with on_logged_pty("mks-rs485@1,work_mode=sr_vfoc") as port:

        def lose() -> None:
            if wait_for(lambda: turning(port), 30):
                os.kill(guards(os.getpid())[0], number)

        loser = threading.Thread(target=lose)
        loser.start()
        assert run(path, "--on", port.on, *ALLOWED) == 1
        loser.join()
        assert not turning(port)
        assert [s.command.name for s in sound([port.heard]) if not s.risks <= {Risk.READ}][:3] == [
            "enable",
            "run_speed",
            "stop_speed",
        ]
    out, err = capsys.readouterr()
    assert "the process that owns the port" in out
    assert "NOT KNOWN TO STAND" not in out
    assert "another one takes over" in err
