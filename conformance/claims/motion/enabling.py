"""Switching the motor on and off: what is read of it, what it does to motion, and what it leaves.

Rules kept here:
- Off ends motion, and on does not take it up again.
- LK motors answer while they are off, and are on when power comes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from analyzer.link import CanLink
from conformance.claims import bench
from conformance.claims.bench import lk_drive
from conformance.claims.declare import Case, commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import expect_stays, expect_taken, of_motion, risks_by
from conformance.claims.motion.stops import expect_standing, set_going
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import MOVES, QUICK, SUBDIVISION
from conformance.talk.probe import MS, SECOND_NS, Probe

_enable, _off, _on = commands(Verb.ENABLE), commands(Verb.MOTOR_OFF), commands(Verb.MOTOR_ON)


@of_motion(
    each=_enable,
    statement="A motor that was enabled reads as enabled, and one that was disabled as disabled.",
    refuted_by="the other state, or always the same",
)
@of_motion(each=_off, statement="A motor that is off reads state 10h, one that is on 00h.", refuted_by="the other")
def _is_read(probe: Probe) -> None:
    motion.ready_to_move(probe)
    for on in (False, True, False):
        exchange = motion.switch(probe, on)
        seen = motion.is_on(probe)
        names = {False: "off", True: "on", None: "neither on nor off"}
        text = f"a motor that was switched {names[on]} reads as {names[seen]}"
        probe.expect(names[seen], equal=names[on], refutes=text, exchange=exchange)
    motion.switch(probe, True)


def _switch_off_going(probe: Probe) -> None:
    """Switch the motor off on a run, and refute unless that ends it."""
    set_going(probe, probe.command(Verb.RUN_SPEED))
    exchange = probe.ask(*declared.switching(probe.dialect, False))
    expect_taken(probe, exchange, "switching a turning motor off is refused")
    if declared.tells_on(probe.dialect):
        text = "a motor that was switched off does not read as off while it runs out"
        seen = motion.is_on(probe)
        probe.expect("on", holds=seen is False, expected="off", refutes=text, exchange=exchange, key="off at once")
    # Without torque the shaft runs out, and slowly in the end.
    motion.wait_until(probe, lambda: abs(motion.speed(probe).value) < 1 + probe.noise.rpm, limit_ns=3 * SECOND_NS // 2)
    probe.wait(SECOND_NS // 2)
    expect_standing(probe, exchange, "the shaft still turns after the motor was switched off")
    if declared.tells_on(probe.dialect):
        text = "a motor that was switched off while it turned does not read as off when it stands"
        seen = motion.is_on(probe)
        probe.expect("on", holds=seen is False, expected="off", refutes=text, exchange=exchange, key="off at rest")


@of_motion(each=_off, refuted_by="a shaft that is still driven", risks=risks_by(Verb.RUN_SPEED), at_best=Certainty.LIKELY)
def _ends_motion(probe: Probe) -> None:
    """Switching the motor off ends a motion, and it reads as off at once and when the shaft stands."""
    _switch_off_going(probe)


@of_motion(
    each=_enable,
    name="{command}/off-ends-motion",
    statement="Disabling the motor ends a motion, and enabling it does not take the motion up again.",
    refuted_by="a shaft that is still driven",
    risks=risks_by(Verb.RUN_SPEED),
    at_best=Certainty.LIKELY,
)
@of_motion(
    each=_on,
    statement="Switching the motor on does not take up what was ended.",
    refuted_by="motion",
    risks=risks_by(Verb.RUN_SPEED, Verb.MOTOR_OFF),
    at_best=Certainty.LIKELY,
)
def _does_not_resume(probe: Probe) -> None:
    _switch_off_going(probe)
    exchange = motion.switch(probe, True)
    probe.wait(400 * MS)
    expect_standing(probe, exchange, "switching the motor on takes up the motion again")
    if declared.tells_on(probe.dialect):
        text = "a motor that was switched off while it turned does not read as on when it is on again"
        probe.expect("off", holds=motion.is_on(probe) is True, expected="on", refutes=text, exchange=exchange)


def _levels_of_pulse_modes(dialect: Dialect) -> Iterator[Case]:
    """Yield the level of the En pin where the manual says that it is without effect in bus modes."""
    if isinstance(dialect.link, CanLink):
        yield from commands(Verb.SET_ENABLE_LEVEL)(dialect)


@of_motion(
    each=_levels_of_pulse_modes,
    name="{command}/not-in-bus-modes",
    refuted_by="a motor that the pin enables or disables",
    at_best=Certainty.LIKELY,
    settings=("enable_level",),
    risks=risks_by(Verb.ENABLE),
)
def _not_in_bus_modes(probe: Probe, command: Command) -> None:
    """In a bus mode only the command enables the motor, at any setting of the En pin's level."""
    motion.ready_to_move(probe)
    for level in (0, 1, 2):
        exchange = probe.do(command, {"enable_level": level})
        for on in (False, True):
            motion.switch(probe, on)
            probe.wait(200 * MS)
            text = f"with enable_level {level} a motor that was told to be {'on' if on else 'off'} is not"
            probe.expect(motion.is_on(probe), equal=on, refutes=text, exchange=exchange)


def _run_and_move(dialect: Dialect) -> tuple[Command, ...]:
    """Return a run and a move, by a distance where there is one; some dialects lack one of them."""
    moves = (*dialect.motions(MotionKind.MOVE_BY), *dialect.motions(MotionKind.MOVE_TO))
    return (*(c for c in dialect.motions(MotionKind.RUN) if c.verb is Verb.RUN_SPEED), *moves[:1])


@of_motion(
    each=lambda dialect: (*_enable(dialect), *_on(dialect)),
    name="{command}/on-goes-on",
    refuted_by="a shaft that stands, or one that turns on behind a stop",
    risks=lambda case: declared.risks(case.dialect).union(*(c.all_risks for c in _run_and_move(case.dialect))),
    at_best=Certainty.LIKELY,
)
def _on_goes_on(probe: Probe) -> None:
    """Switching a motor on that is on and turns leaves it on and turning, until it is stopped, at once too; then it stands."""
    motion.ready_to_move(probe)
    set_going(probe, probe.command(Verb.RUN_SPEED))
    before = motion.speed(probe)
    exchange = motion.switch(probe, True)
    is_on = motion.is_on(probe)
    probe.wait(100 * MS)
    after = motion.speed(probe)
    motion.stand_still(probe)
    text, within = "switching a motor on that turns changes its speed", 2 + before.noise + after.noise
    probe.expect(after.value, near=before.value, within=within, unit="rpm", refutes=text, exchange=exchange)
    text = "a motor that was switched on while it turned reads as off"
    probe.expect("off", holds=is_on is not False, expected="on", refutes=text, exchange=exchange)
    for command in _run_and_move(probe.dialect):
        set_going(probe, command)
        probe.ask(Verb.EMERGENCY_STOP if Verb.EMERGENCY_STOP in probe.dialect.by_verb else Verb.STOP)
        motion.wait_standing(probe)
        exchange = motion.switch(probe, True)
        probe.wait(100 * MS)
        expect_standing(probe, exchange, f"switching the motor on takes up {command.name}, which was stopped")


#: What may switch a motor on or off, and what is not sent: it is of the link, wears, begins anew, or goes on without end.
_SWITCHING = frozenset(
    {Verb.ENABLE, Verb.MOTOR_ON, Verb.MOTOR_OFF, Verb.SET_WORK_MODE, Verb.SET_AXIS_LOCK, Verb.SET_ENABLE_LEVEL}
)
_NOT_SENT = frozenset({Risk.LINK, Risk.WEAR, Risk.DESTRUCTIVE, Risk.POWER_ON, Risk.READ, Risk.UNBOUNDED})


def _not_switching(dialect: Dialect) -> list[Command]:
    """Return the moves, the stops and what has no values: none of them switches a motor on."""
    sent = (c for c in dialect.commands if c.slots is None and c.verb not in _SWITCHING and not c.all_risks & _NOT_SENT)
    return [c for c in sent if c.motion is not None or all(f.low == f.high for f in c.request_forms[0].layout.named.values())]


def _staying_off(dialect: Dialect) -> Iterator[Case]:
    risks = frozenset[Risk]().union(*(c.all_risks for c in _not_switching(dialect)))
    for case in (*_enable(dialect), *_off(dialect)):
        yield Case(dialect, case.command, facts={"risks": declared.risks(dialect, Risk.TORQUE, *risks)})


@of_motion(each=_staying_off, name="{command}/stays-off", refuted_by="a motor that is on", at_best=Certainty.LIKELY)
def _stays_off(probe: Probe) -> None:
    """A motor that is off stays off at moves, stops, a release and a new zero."""
    motion.ready_to_move(probe)
    motion.switch(probe, False)
    for command in _not_switching(probe.dialect):
        kind = declared.of(command).kind if command.motion is not None else None
        values = declared.values_of(probe.dialect, command, 36, start=motion.place(probe, command)) if kind in MOVES else {}
        if kind is MotionKind.STOP and declared.of(command).acceleration:
            values = {"acceleration": QUICK}
        exchange = probe.ask(command, values, quiet_ns=0)
        text = f"{command.name} switches on a motor that is off"
        probe.expect("on", holds=motion.is_on(probe) is not True, expected="off", refutes=text, exchange=exchange)
    motion.switch(probe, True)


#: How far a hand turns the shaft of a disabled motor, in counts, and how long one that is enabled again is watched.
_BY_HAND, _WATCH_NS = (3000, -20_000), 200 * MS


@of_motion(
    each=_enable,
    name="{command}/on-holds-here",
    refuted_by="a shaft that turns back, or a move from elsewhere",
    emulated=True,
    risks=lambda case: frozenset().union(*(c.all_risks for c in case.dialect.motions(*MOVES))),
    at_best=Certainty.LIKELY,
)
def _on_holds_here(probe: Probe) -> None:
    """A motor that a hand turned while disabled holds the shaft there when enabled, and each move begins there."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    for move, turned in product(probe.dialect.motions(*MOVES), _BY_HAND):
        motion.switch(probe, False)
        bench.drive_of(probe).turn_shaft(turned)
        before = motion.position(probe)
        exchange = motion.switch(probe, True)
        probe.wait(_WATCH_NS)
        text = "enabling turns a shaft that a hand has turned"
        expect_stays(before, motion.position(probe), exchange, text, motion.same(probe))
        went = arriving.follow(probe, move, 45)
        text = f"{move.name} does not begin where a hand has turned the shaft"
        within = declared.near(probe.dialect) + motion.same(probe)
        probe.expect(abs(went.degrees), near=45, within=within, unit="degrees", refutes=text, exchange=went.exchange)


def expect_obeys(probe: Probe, refutes: str) -> None:
    """Refute unless a move turns the shaft."""
    move = arriving.follow(probe, declared.any_move(probe.dialect), 45)
    probe.expect(abs(move.degrees), near=45, within=1, unit="degrees", refutes=refutes, exchange=move.exchange)


@of_motion(each=_on, refuted_by="no motion", risks=risks_by(Verb.MOTOR_OFF))
def _obeys(probe: Probe) -> None:
    """A motor that was switched off and on obeys the next command."""
    for _ in range(2):
        motion.switch(probe, False)
        motion.switch(probe, True)
        expect_obeys(probe, "the motor does not obey after it was switched on")


@of_motion(each=_on, refuted_by="state 10h, or no motion", emulated=True, risks=risks_by(Verb.MOTOR_OFF))
def _at_power_up(probe: Probe) -> None:
    """When power comes on the motor is on and obeys."""
    motion.switch(probe, False)
    lk_drive(probe).power_cycle(probe.gate.now_ns())
    probe.wait(500 * MS)
    probe.expect("off", holds=bool(motion.is_on(probe)), expected="on", refutes="the motor is not on at power-up")
    expect_obeys(probe, "the motor does not obey at power-up")


def _expect_turns_kept_turning(probe: Probe, command: Command) -> None:
    """Refute where a command that ends a run drops the turns of it."""
    set_going(probe, probe.command(Verb.RUN_SPEED))
    before = motion.position(probe)
    exchange = probe.do(command)
    went = motion.wait_standing(probe).value - before.value
    motion.switch(probe, True)
    text = f"{command.name} drops the turns of a shaft that turns"
    # As far as the shaft runs out in a second or two.
    probe.expect(went, at_least=-1, at_most=1000, unit="degrees", refutes=text, exchange=exchange)


@of_motion(
    each=_off,
    statement="Switching the motor off and on leaves the counted turns.",
    refuted_by="another position",
    risks=risks_by(Verb.RUN_SPEED),
    at_best=Certainty.LIKELY,
    quirks=may_meet("lk-off-clears-turns"),
)
@of_motion(
    each=commands(Verb.STOP),
    statement="The stop leaves the counted turns.",
    refuted_by="another position",
    risks=risks_by(Verb.RUN_SPEED),
    at_best=Certainty.LIKELY,
)
def _keeps_turns(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for _ in range(2):
        arriving.follow(probe, declared.any_move(probe.dialect), 420)
    before = motion.position(probe)
    exchange = probe.do(command)
    motion.switch(probe, True)
    change = motion.position(probe).value - before.value
    if "lk-off-clears-turns" in probe.claim.quirks and abs(change) > 1 and abs(change - 360 * round(change / 360)) <= 1:
        probe.meets("lk-off-clears-turns")
    else:
        text = f"{command.name} changes the position of a shaft that stands"
        probe.expect(change, near=0, within=1, unit="degrees", refutes=text, exchange=exchange)
        _expect_turns_kept_turning(probe, command)
