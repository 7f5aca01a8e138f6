"""The gate: what is allowed, for whom, how much of it; and that nothing leaves otherwise."""

from __future__ import annotations

import argparse
import threading
from io import FileIO
from pathlib import Path

import pytest

from analyzer import dialects
from analyzer.catalogue import Risk, Role
from analyzer.encoder import build
from analyzer.errors import UsageError
from analyzer.records import CanFrame, Chunk
from conformance.bus.emulated import EmulatedLine
from conformance.bus.line import Line, LineLost
from conformance.drives import make
from conformance.gate import budget as budgets
from conformance.gate.budget import Budget, Cost, parse_budget
from conformance.gate.gate import Allowance, Gate, Judge, Refused, add_gate_arguments, allowance_from, parse_allow
from conformance.gate.permissions import WORDS
from tests.conformance.vectors import EVERYTHING, on_can

MKS, CAN, LK = (dialects.get(n) for n in ("mks-rs485", "mks-can", "lk-rs485"))
READ = build(MKS, "read_speed", 1)
RUN = build(MKS, "run_speed", 1, {"speed": 60, "acceleration": 200})
STOP = build(MKS, "stop_speed", 1, {"acceleration": 200})
SECOND_NS = 1_000_000_000


def emulated(*names: str) -> EmulatedLine:
    return EmulatedLine([make.make(make.parse(name)) for name in names or ("mks-rs485@1,work_mode=sr_vfoc",)])


def reasons(judge: Judge, item: bytes | CanFrame, now_ns: int = 0) -> list[str]:
    return [reason for o in judge.objections(item, now_ns) for reason in o.reasons]


# --- a gate on a line -------------------------------------------------------------------------------------------------


def test_a_read_leaves_and_is_answered():
    gate = Gate(emulated(), Allowance())
    end_ns = gate.send(READ)
    got = gate.receive(SECOND_NS)
    assert isinstance(got, Chunk)
    assert got.data == build(MKS, "read_speed", 1, {}, Role.REPLY)
    assert got.t_ns is not None
    assert got.t_ns > end_ns > 0
    assert gate.sent == 1


def test_what_is_refused_does_not_leave():
    gate = Gate(emulated(), Allowance())
    with pytest.raises(Refused) as refused:
        gate.send(RUN)
    assert gate.sent == 0
    assert gate.receive(SECOND_NS // 10) is None
    text = str(refused.value)
    assert "FA 01 F6 00 3C C8 F5" in text
    assert "mks-rs485@1 run_speed" in text
    assert "--allow motion,unbounded" in text
    assert refused.value.item == RUN
    assert refused.value.objections[0].interpretation.risks == {Risk.MOTION, Risk.UNBOUNDED}


def test_a_refused_item_is_as_if_it_had_not_been_tried():
    gate = Gate(emulated(), Allowance())
    with pytest.raises(Refused):
        gate.send(RUN[:3])
    gate.send(READ)
    assert gate.receive(SECOND_NS) is not None


def test_who_listens_is_told_what_left_and_the_log_gets_both_ways():
    told, logged = [], []
    gate = Gate(emulated(), Allowance(), log=logged.append)
    gate.on_sent.append(lambda t_ns, item: told.append((t_ns, item)))
    end_ns = gate.send(READ)
    assert gate.wait(SECOND_NS)
    assert told == [(end_ns, READ)]
    assert [(r.direction, r.data[:1]) for r in logged] == [(Role.REQUEST, b"\xfa"), (Role.REPLY, b"\xfb")]


def test_can_frames_pass_too():
    logged = []
    gate = Gate(emulated("mks-can@1"), Allowance(), log=logged.append)
    gate.send(on_can(1, build(CAN, "read_speed", 1)))
    assert isinstance(gate.receive(SECOND_NS), CanFrame)
    assert [r.direction for r in logged] == [Role.REQUEST, Role.REPLY]
    with pytest.raises(TypeError):
        gate.line.write(b"\x31")


def test_gates_of_one_line_know_what_the_other_sent():
    gate = Gate(emulated(), Allowance())
    other = gate.under(Allowance(EVERYTHING))
    gate.send(RUN[:2])
    with pytest.raises(Refused):
        gate.send(RUN[2:])
    other.send(RUN[2:])
    got = other.receive(SECOND_NS)
    assert got is not None
    assert got.data == build(MKS, "run_speed", 1, {"status": 1}, Role.REPLY)


def test_a_rehearsal_sends_and_spends_nothing():
    gate = Gate(emulated(), Allowance(EVERYTHING, budget=Budget(commands=1)))
    judge = gate.rehearsal()
    judge.admit(RUN)
    assert "budget" in reasons(judge, RUN)[0]
    judge.admit(READ[:2])
    assert gate.objections(RUN) == []
    gate.send(RUN)
    assert gate.sent == 1


def test_a_closed_line_is_lost():
    gate = Gate(emulated(), Allowance())
    gate.close()
    with pytest.raises(LineLost):
        gate.send(READ)


class Deaf(Line):
    """A line that fails while it sends."""

    def __init__(self) -> None:
        self.endpoint = emulated().endpoint

    def now_ns(self) -> int:
        return 0

    def write(self, item: bytes | CanFrame) -> int:
        raise LineLost("unplugged")

    def receive(self, timeout_ns: int) -> None:
        return None

    def set_speed(self, bits_per_second: int) -> None: ...
    def close(self) -> None: ...


def test_a_failed_write_counts_as_sent_for_what_can_be_read_next():
    gate = Gate(Deaf(), Allowance(frozenset({Risk.UNKNOWN})))
    with pytest.raises(LineLost):
        gate.send(b"\xfa\x01")
    # Some of it may have left: what would complete it is judged so.
    assert [r.command.name for r in gate.interpret(b"\xf7\xf2") if r.command] == ["emergency_stop"]
    assert gate.sent == 0


# --- risks ------------------------------------------------------------------------------------------------------------


def test_risks_by_name():
    assert parse_allow("") == {Risk.READ}
    assert parse_allow("motion, Power-On,power_on") == {Risk.READ, Risk.MOTION, Risk.POWER_ON}
    with pytest.raises(UsageError) as refused:
        parse_allow("motoin")
    for word in WORDS:
        assert word in str(refused.value)
    assert "did you mean motion" in str(refused.value)


def test_motion_brings_neither_torque_nor_unbounded():
    allowed = Allowance(parse_allow("motion")).risks
    assert allowed == {Risk.READ, Risk.MOTION}
    judge = Judge(Allowance(allowed))
    assert judge.objections(STOP) == []
    assert reasons(judge, RUN) == ["needs unbounded"]
    assert reasons(judge, build(MKS, "enable", 1, {"enabled": 0})) == ["needs torque"]
    assert judge.objections(build(MKS, "enable", 1, {"enabled": 1})) == []


def test_unbounded_alone_brings_no_motion():
    judge = Judge(Allowance(frozenset({Risk.UNBOUNDED})))
    assert reasons(judge, RUN) == ["needs motion"]
    assert reasons(judge, build(LK, "run_speed", 1, {"speed": 100})) == ["needs motion"]


# --- neighbours -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("item", "why"),
    [
        (build(MKS, "read_speed", 2), "meant for 2, and the drive is 1"),
        (build(MKS, "read_speed", 0), "meant for all drives"),
        (build(MKS, "run_speed", 2, {"speed": 1}), "meant for 2"),
        (build(MKS, "set_baud_rate", 1, {"baud_rate": 4}), "changes the link"),
        (build(MKS, "long_package", 0, {"slots": [{"address": 1, "command": "read_speed"}]}), "package"),
        (on_can(0, build(CAN, "read_speed", 0)), "meant for all drives"),
        (on_can(0x50, build(CAN, "read_speed", 0x50)), "meant for 80"),
    ],
)
def test_neighbours_need_alone(item: bytes | CanFrame, why: str):
    near = Judge(Allowance(EVERYTHING, addresses=frozenset({1})))
    assert why in reasons(near, item)[0]
    assert "--alone" in str(near.objections(item)[0])
    assert Judge(Allowance(EVERYTHING, addresses=frozenset({1}), alone=True)).objections(item) == []


def test_without_named_addresses_any_one_drive_may_be_asked():
    anyone = Judge(Allowance(EVERYTHING))
    assert anyone.objections(build(MKS, "read_speed", 7)) == []
    assert anyone.objections(build(MKS, "run_speed", 7, {"speed": 1})) == []
    assert anyone.objections(build(MKS, "run_speed", 0, {"speed": 1}))


def test_a_garbled_read_has_no_address():
    near = Judge(Allowance(addresses=frozenset({1})))
    assert near.objections(bytes.fromhex("FA 02 32 99")) == []


# --- budget -----------------------------------------------------------------------------------------------------------


class Killed(FileIO):
    """A file whose process dies as it writes."""

    def write(self, data):
        raise KeyboardInterrupt


def test_a_process_that_dies_as_it_spends_leaves_what_was_spent_before(tmp_path, monkeypatch):
    path = tmp_path / "budget.json"
    path.touch()
    budget, cost = Budget(commands=10, path=path), Cost(commands=7)
    assert budget.take(cost, 1) == ""
    with monkeypatch.context() as dying:
        dying.setattr(Path, "open", lambda self, mode, **how: Killed(self, mode))
        with pytest.raises(KeyboardInterrupt):
            budget.take(Cost(commands=1), 2)
    assert "budget of 10 commands is spent" in budget.take(cost, 3)


def test_commands_are_counted_reads_and_stops_are_not():
    judge = Judge(Allowance(EVERYTHING, budget=Budget(commands=2)))
    for item in (RUN, READ, STOP, RUN, READ, STOP):
        judge.admit(item)
    with pytest.raises(Refused, match="budget of 2 commands"):
        judge.admit(RUN)
    judge.admit(STOP)
    judge.admit(READ)


def test_seconds_count_from_the_first_command():
    judge = Judge(Allowance(EVERYTHING, budget=Budget(seconds=10)))
    judge.admit(READ, 0)
    judge.admit(RUN, 50 * SECOND_NS)
    judge.admit(RUN, 59 * SECOND_NS)
    with pytest.raises(Refused, match="budget of 10 s"):
        judge.admit(RUN, 61 * SECOND_NS)
    judge.admit(STOP, 61 * SECOND_NS)


def test_turns_of_moves_and_runs_add_up():
    judge = Judge(Allowance(EVERYTHING, subdivision=16, budget=Budget(turns=10)))
    move = build(MKS, "move_relative_axis", 1, {"speed": 60, "position": 4 * 16384})
    judge.admit(move)
    assert judge.allowance.budget.spent.turns == 4
    # A minute's run at 60 rpm is counted when it ends: by then the budget is long spent, and the stop leaves all the same.
    judge.admit(RUN, 0)
    judge.admit(STOP, 3 * SECOND_NS)
    assert judge.allowance.budget.spent.turns == pytest.approx(7)
    assert "of the budget of 10 there are 3 left" in reasons(judge, move, 4 * SECOND_NS)[0]
    home = build(MKS, "home", 1)
    assert "how far it turns cannot be told" in reasons(judge, home)[0]


def test_wear_is_capped_on_real_drives():
    wearing = build(LK, "set_zero", 1)
    judge = Judge(Allowance(EVERYTHING, budget=parse_budget(["wear=2"])))
    judge.admit(wearing)
    judge.admit(wearing)
    with pytest.raises(Refused, match="wear the flash"):
        judge.admit(wearing)
    assert parse_budget([]).wear == budgets.DEFAULT_WEAR
    gate = Gate(emulated("lk-rs485@1"), Allowance(EVERYTHING, budget=parse_budget(["wear=0"])))
    gate.send(wearing)


def test_a_budget_is_shared_by_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "budget"
    path.write_bytes(b"")
    monkeypatch.setenv(budgets.FILE, str(path))
    shared = [parse_budget(["commands=100"]) for _ in range(4)]
    taken = []

    def spend(budget: Budget) -> None:
        for _ in range(40):
            taken.append(budget.take(Cost(1), 5) == "")

    threads = [threading.Thread(target=spend, args=(budget,)) for budget in shared]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(taken) == 100
    assert "spent" in shared[0].refusal(Cost(1), 6)
    assert shared[0].refusal(Cost(0), 6) == ""
    rehearsal = parse_budget(["commands=101"]).rehearsal()
    assert rehearsal.take(Cost(1), 6) == ""
    assert "spent" in rehearsal.take(Cost(1), 6)
    assert parse_budget(["commands=101"]).refusal(Cost(1), 6) == ""


@pytest.mark.parametrize("text", ["commands", "commands=", "commands=-1", "minutes=3", "commands=x", "turns=nan"])
def test_a_budget_that_is_none(text: str):
    with pytest.raises(UsageError, match="--budget"):
        parse_budget([text])


# --- options ----------------------------------------------------------------------------------------------------------


def parsed(*words: str) -> Allowance:
    parser = argparse.ArgumentParser()
    add_gate_arguments(parser)
    return allowance_from(parser.parse_args(words))


def test_options():
    assert parsed().risks == {Risk.READ}
    allowance = parsed(
        "--allow", "motion", "--allow", "setting,torque", "--max-speed", "300", "--max-turns", "2.5", "--max-acceleration",
        "200", "--max-current", "1500", "--alone", "--budget", "commands=500,seconds=60", "--budget", "turns=9",
        "--subdivision", "32",
    )  # fmt: skip
    assert allowance.risks == {Risk.READ, Risk.MOTION, Risk.SETTING, Risk.TORQUE}
    assert (allowance.speed, allowance.turns, allowance.acceleration, allowance.current) == (300, 2.5, 200, 1500)
    assert allowance.alone
    assert allowance.described() == {
        "max-speed": "300", "max-turns": "2.5", "max-acceleration": "200", "max-current": "1500", "subdivision": "32",
        "budget": "commands=500,seconds=60,turns=9", "alone": "yes",
    }  # fmt: skip
    assert parsed().described() == {}


@pytest.mark.parametrize("words", [("--max-speed", "0"), ("--max-turns", "-1"), ("--subdivision", "300")])
def test_options_that_are_none(words: tuple[str, str], capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        parsed(*words)
    assert words[0] in capsys.readouterr().err
