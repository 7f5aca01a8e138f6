"""Where a claim saw the shaft stand, one stop and one look are enough; a shaft that turns is stopped all the same."""

from __future__ import annotations

import random
from fractions import Fraction

import pytest
from msgspec.structs import replace

from analyzer.catalogue import MotionKind, Risk, Role
from analyzer.encoder import assemble, build
from analyzer.records import CanFrame, Chunk
from conformance import claims as registry
from conformance.bus.emulated import EmulatedLine
from conformance.bus.line import LineLost
from conformance.claim import Inconclusive, NotStopped
from conformance.drives import make
from conformance.gate.gate import Gate
from conformance.gate.permissions import Allowance
from conformance.motion import motion, resting
from conformance.motion.declared import GENTLE
from conformance.safety import following, settings, stopping
from conformance.suite import target
from conformance.suite.dry_run import StandInRig
from conformance.suite.plan import Plan
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.probe import SECOND_NS, Probe, plain_probe

_DRIVE = "mks-rs485@1,work_mode=sr_vfoc"
#: In rpm: below what three looks tell.
_CREEP = Fraction(1, 20)
_PORT = target.parse("mks-rs485@1", "serial:none,baud=38400")


def _turning(drive: str = _DRIVE) -> tuple[EmulatedRig, Probe, float]:
    """Return a drive that runs, and where it stood before."""
    rig = EmulatedRig(make.parse(drive))
    probe = rig.probe(next(c for c in registry.every(rig.dialect) if resting.can_turn(rig.dialect, c)))
    motion.ready_to_move(probe)
    stood = motion.position(probe).value
    motion.run_at(probe, 60)
    probe.wait(SECOND_NS)
    return rig, probe, stood


def test_where_a_shaft_was_seen_standing_one_look_is_the_last_of_three():
    _, probe, _ = _turning()
    place = motion.stand_still(probe).value
    before = len(probe.traffic)
    assert stopping.prove_standing(probe, SECOND_NS, place) == ""
    assert len(probe.traffic) == before + 2, "its speed and its position"


@pytest.mark.parametrize("faults", ["", ",fault=speed-stop-ignored,fault=move-stop-ignored"])
def test_a_shaft_that_turns_although_it_was_seen_standing_is_stopped(faults):
    rig, probe, stood = _turning(_DRIVE + faults)
    assert stopping.stop(probe.gate, rig.dialect, 1, stood).failure == ""
    assert motion.speed(probe).value == 0


@pytest.mark.parametrize(
    ("noise", "rpm", "at_once", "thoroughly"),
    [
        ("", 0, True, True),
        ("", 0.05, None, False),
        ("", 0.15, False, False),
        (",encoder-noise=2", 0, None, True),
        (",encoder-noise=2", 0.05, None, False),
    ],
)
def test_a_shaft_that_creeps_does_not_stand(noise, rpm, at_once, thoroughly):
    _, probe, _ = _turning(_DRIVE + noise)
    motion.stand_still(probe)
    assert probe.drive is not None
    probe.drive.motor.run(probe.gate.now_ns(), Fraction(rpm).limit_denominator(100), 0)
    assert motion.speed(probe).value == 0, "whole rpm do not tell it"
    seen = stopping.prove_standing(probe, 4 * SECOND_NS, thoroughly=True)
    assert (seen == "") is thoroughly
    if at_once is not None:
        assert (stopping.prove_standing(probe, 4 * SECOND_NS) == "") is at_once


def test_a_run_ends_as_not_stopped_where_the_shaft_creeps(monkeypatch):
    rig = StandInRig(Plan((_PORT,), Allowance(frozenset(Risk), alone=True)), _PORT, make.parse(_DRIVE))
    probe = rig.probe(next(c for c in registry.every(rig.dialect) if resting.can_turn(rig.dialect, c)))
    motion.ready_to_move(probe)
    motion.run_at(probe, 60)
    motion.stand_still(probe)
    assert rig.settle(probe) == ""
    line = rig.gate.line
    assert isinstance(line, EmulatedLine)
    motor = line.bus.drives[0].motor
    halted, run = motor.halt, motor.run
    # What a stop leaves is a creep, which no claim moved the shaft by.
    monkeypatch.setattr(motor, "run", lambda t, rpm, step_ns: run(t, rpm or _CREEP, step_ns))
    monkeypatch.setattr(motor, "halt", lambda t: (halted(t), run(t, _CREEP, 0)))
    run(rig.gate.now_ns(), _CREEP, 0)
    with pytest.raises(NotStopped, match="speed 0 rpm"):
        rig.close()


def test_a_proof_counts_until_something_is_sent_that_may_move_the_shaft():
    rig = StandInRig(Plan((_PORT,), Allowance(frozenset(Risk), alone=True)), _PORT, make.parse(_DRIVE))
    stops = {command.name for command in rig.dialect.motions(MotionKind.STOP)}
    sent: list[str] = []
    rig.gate.on_sent.append(lambda t_ns, item: sent.extend(r.command.name for r in rig.gate.interpret(item) if r.command))
    probe = rig.probe(next(c for c in registry.every(rig.dialect) if resting.can_turn(rig.dialect, c)))

    def stops_of_settling() -> int:
        sent.clear()
        assert rig.settle(probe) == ""
        return sum(name in stops for name in sent)

    motion.ready_to_move(probe)
    motion.run_at(probe, 60)
    motion.stand_still(probe)
    assert stops_of_settling() == 1
    motion.run_at(probe, 60)
    motion.stand_still(probe)
    motion.run_at(probe, 60)
    assert stops_of_settling() > 1
    assert motion.speed(probe).value == 0
    rig.close()


# --- others send on the line ------------------------------------------------------------------------------------------


def _lossy(probe: Probe, monkeypatch: pytest.MonkeyPatch, *, heard, answered) -> list[bytes]:
    """Lose what is sent where `heard` does not say yes to its number and bytes, and what comes where `answered` does not.

    Return the list of what is sent.
    """
    line = probe.gate.line
    write, receive, sent, came = line.write, line.receive, list[bytes](), list[object]()

    def lossy_write(item):
        sent.append(item)
        return write(item if heard(len(sent), item) else b"\x55" * len(item))

    def lossy_receive(timeout_ns):
        got = receive(timeout_ns)
        if got is None:
            return None
        came.append(got)
        return got if answered(len(came)) else replace(got, data=b"\x99" * len(got.data))

    monkeypatch.setattr(line, "write", lossy_write)
    monkeypatch.setattr(line, "receive", lossy_receive)
    return sent


def test_stops_and_replies_that_are_lost_are_sent_once_more(monkeypatch):
    """A second host on the line: what runs into its frames is lost, and the first stops are among it."""
    rig, probe, _ = _turning()
    drive = probe.drive
    assert drive is not None
    sent = _lossy(probe, monkeypatch, heard=lambda number, item: number > 12, answered=lambda number: number % 3 == 0)
    assert stopping.stop(probe.gate, rig.dialect, 1).failure == ""
    assert drive.motor.speed(drive.now_ns) == 0
    assert sent.count(build(rig.dialect, "stop_speed", 1, {"acceleration": GENTLE})) > 1


@pytest.mark.parametrize("name", ["mks-rs485", "mks-modbus", "mks-can", "lk-rs485"])
def test_what_another_drive_answers_tells_nothing_of_this_one(name, monkeypatch):
    """The drive hangs, and another host asks its neighbour for what this one is asked."""
    drives = [make.make(make.parse(f"{name}@{address}")) for address in (1, 2)]
    dialect, line = drives[0].dialect, EmulatedLine(drives)
    gate = Gate(line, Allowance())
    command = next((c for c in dialect.commands if settings.readable(dialect, c) and settings.changes(c)), None)
    probe = plain_probe(dialect, 1, gate)
    assert stopping.standing_failure(gate, dialect, 1) == ""
    write = line.write

    def of_the_other_host(item):
        asked = next(r for r in gate.interpret(item) if r.fits and r.dialect.name == name)
        assert asked.command is not None
        return write(assemble(dialect, asked.command, asked.address + 1, asked.values).item())

    monkeypatch.setattr(line, "write", of_the_other_host)
    assert "not answered" in stopping.standing_failure(gate, dialect, 1)
    assert "not answered" in stopping.stop(gate.under(stopping.stopping(1)), dialect, 1).failure
    assert not following.answers(probe)
    if command is not None:
        assert settings.read(probe, command, settings.every_selector(command)[0]) is None


def test_a_drive_that_ignores_its_only_stop_is_stopped_by_speed_0(monkeypatch):
    rig, probe, _ = _turning("lk-rs485@1")
    stop = build(rig.dialect, "stop", 1)
    sent = _lossy(probe, monkeypatch, heard=lambda number, item: item != stop, answered=lambda number: True)
    assert stopping.stop(probe.gate.under(stopping.stopping(1)), rig.dialect, 1) == ("by speed 0", "")
    assert sent.count(stop) > 1
    assert motion.speed(probe).value == 0


def test_an_echo_of_the_request_tells_no_setting():
    drive = make.make(make.parse("lk-rs485@1,fault=echo"))
    probe = plain_probe(drive.dialect, 1, Gate(EmulatedLine([drive]), Allowance()))
    assert settings.read(probe, drive.dialect.by_name[settings.SET_POSITION], {}) is None


def test_a_shaft_that_turns_on_is_told_to_stop_each_second(monkeypatch):
    """Every reply comes, so the looks tell that the stops were lost."""
    rig, probe, _ = _turning()
    stops = {build(rig.dialect, c, 1, stopping._gentle(c)) for c in stopping.ramped_stops(rig.dialect)}
    lost: list[bytes] = []
    _lossy(
        probe,
        monkeypatch,
        heard=lambda number, item: item not in stops or len(lost) >= len(stops) or lost.append(item),
        answered=lambda number: True,
    )
    assert stopping.stop(probe.gate, rig.dialect, 1) == ("by a ramp", "")


def test_where_nothing_can_be_read_the_stops_are_sent_again_and_again_and_why_is_said(monkeypatch):
    rig, probe, _ = _turning()
    drive = probe.drive
    assert drive is not None
    chance = random.Random(1)
    sent = _lossy(probe, monkeypatch, heard=lambda number, item: number > 40, answered=lambda number: False)
    receive = probe.gate.line.receive

    def flooded(timeout_ns):
        return receive(min(timeout_ns, 5_000_000)) or Chunk(probe.gate.now_ns(), "line", chance.randbytes(20), Role.REPLY)

    monkeypatch.setattr(probe.gate.line, "receive", flooded)
    failure = stopping.stop(probe.gate, rig.dialect, 1).failure
    assert "others send on this bus (" in failure
    assert drive.motor.speed(drive.now_ns) == 0, "the shaft stands all the same"
    assert sent.count(build(rig.dialect, "emergency_stop", 1)) > 3


_CAN = "mks-can@1,work_mode=bus_closed"


def _others_on_can(probe: Probe, monkeypatch: pytest.MonkeyPatch, rate: int, frames: list[bytes], *, heard: bool) -> list[int]:
    """Let others send frames with the drive's identifier, so many a second; `heard`: by the drive, too. Return their times."""
    line = probe.gate.line
    assert isinstance(line, EmulatedLine)
    receive, came = line.receive, [line.now_ns()]

    def crowded(timeout_ns):
        left_ns = came[-1] + 1_000_000_000 // rate - line.now_ns()
        if left_ns > timeout_ns:
            return receive(timeout_ns)
        if left_ns > 0 and (got := receive(left_ns)) is not None:
            return got
        came.append(line.now_ns())
        data = frames[len(came) % len(frames)]
        if heard:
            line.bus.put(CanFrame(None, "bus", 1, data))
        return CanFrame(line.now_ns(), "bus", 1, data, Role.REPLY)

    monkeypatch.setattr(line, "receive", crowded)
    return came


def test_a_flood_with_the_drives_own_identifier_hides_no_stop(monkeypatch):
    """More than any CAN bus carries; some of it begins like the answers that are waited for."""
    rig, probe, _ = _turning(_CAN)
    chance = random.Random(2)
    frames = [bytes((chance.choice((0x31, 0x32, 0xF6, 0xF7, chance.randrange(256))), *chance.randbytes(4))) for _ in range(997)]
    frames = [each for each in frames if (1 + sum(each[:-1])) & 0xFF != each[-1]]
    came = _others_on_can(probe, monkeypatch, 20_000, frames, heard=False)
    assert stopping.stop(probe.gate, rig.dialect, 1).failure == ""
    assert probe.drive is not None
    assert probe.drive.motor.speed(probe.drive.now_ns) == 0
    assert len(came) > 2_000


def test_that_another_host_sets_the_shaft_in_motion_again_is_told(monkeypatch):
    rig, probe, _ = _turning(_CAN)
    run = build(rig.dialect, "run_speed", 1, {"direction": 0, "speed": 60, "acceleration": 0})
    _others_on_can(probe, monkeypatch, 20, [run], heard=True)
    failure = stopping.stop(probe.gate, rig.dialect, 1).failure
    assert "others tell address 1 to move: " in failure
    assert f"the last run_speed: {run.hex(' ').upper()}" in failure
    assert probe.drive is not None
    assert probe.drive.motor.speed(probe.drive.now_ns) != 0, "which is true: its last order was to run"


@pytest.mark.parametrize("lost", [1, 2])
def test_a_stop_is_tried_once_more_where_the_line_goes(lost, monkeypatch):
    rig, probe, _ = _turning()
    write, left = rig.gate.line.write, [LineLost("the port is gone")] * lost

    def once(item):
        if left:
            raise left.pop()
        return write(item)

    monkeypatch.setattr(rig.gate.line, "write", once)
    if lost > 1:
        with pytest.raises(LineLost):
            stopping.stop(probe.gate, rig.dialect, 1)
    else:
        assert stopping.stop(probe.gate, rig.dialect, 1).failure == ""
        assert motion.speed(probe).value == 0


def test_a_guard_that_was_faster_is_no_failed_stop(monkeypatch):
    rig, probe, _ = _turning()
    write, left = rig.gate.line.write, [Inconclusive("the guard has stopped the motor")]

    def once(item):
        if left:
            write(build(rig.dialect, "stop_speed", 1, {"acceleration": GENTLE}))
            raise left.pop()
        return write(item)

    monkeypatch.setattr(rig.gate.line, "write", once)
    stopping.stop_or_cut(probe.gate, rig.dialect, 1, "false")
    assert motion.speed(probe).value == 0
