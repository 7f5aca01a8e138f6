"""What is sent to several drives while the shaft turns: it is executed as at rest, and not answered.

    a run at 60 rpm, then each motion and homing to address 0, or to the group, at 120 rpm the other way
    then the emergency stop, or disabling, to the same address

Rules kept here:
- Of what comes the speed alone is looked at, and of a run the way: of moves and homing that is other claims' matter.
- Every second run that is taken over was begun by the same address.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from conformance.claims.addressing.ways import Many, addresses, addressing
from conformance.claims.control_reads import expect_silence
from conformance.claims.declare import Case
from conformance.claims.motion import homing
from conformance.claims.motion.stops import expect_ended
from conformance.motion import declared, motion
from conformance.motion.declared import CALM, MOVES, QUICK, SUBDIVISION
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe

#: How fast what comes turns the shaft (rpm), and how far a move is to go (degrees).
_RPM, _FAR = 2 * CALM, 720
#: How long the shaft turns before, until a newer motion surely has its speed, and how long what ends it is listened to.
_GOING_NS, _RUNS_NS, _ENDS_NS = 60 * MS, 130 * MS, 60 * MS
#: How long the shaft has to stand, and to run out.
_STANDS_NS, _RUNS_OUT_NS = 500 * MS, 4_000 * MS
#: What turns the shaft, and what ends that, with its values.
Ended = tuple[Command, tuple[Command, dict[str, int]]]


def _cases(dialect: Dialect) -> Iterator[Case]:
    motions = dialect.motions(MotionKind.RUN, *MOVES) if dialect.ramp is not None and declared.can_move(dialect) else ()
    homes = [dialect.by_verb[v] for v in (Verb.HOME, *homing.SETS_HOME) if v in dialect.by_verb]
    # The emergency stop ends each motion; disabling ends homing and a run, which come once more.
    chosen: list[Ended] = [(each, (dialect.by_verb[Verb.EMERGENCY_STOP], {})) for each in (*motions, *homes[:1]) if motions]
    again = (*homes[:1], *motions[:1]) if Verb.ENABLE in dialect.by_verb else ()
    chosen += [(each, declared.switching(dialect, False)) for each in again]
    risks = frozenset[Risk]().union(*(command.all_risks for command in (*motions, *homes))) - {Risk.UNKNOWN}
    for many in addresses(dialect) if motions else ():
        facts = {
            "risks": declared.risks(dialect, *risks, *many.risks(dialect), Risk.UNBOUNDED, Risk.TORQUE),
            "settings": (*declared.settings(dialect, *homing.fields(dialect)), *many.settings),
        }
        yield Case(dialect, given={"many": many, "what": many.what, "chosen": chosen}, facts=facts)


@addressing("a shaft that goes on as before, or an answer", _cases, name="{many}/while-turning")
def _while_turning(probe: Probe, many: Many, chosen: list[Ended]) -> None:
    """By {what} each motion and homing takes over from a run, emergency stop and disabling end it; none is answered."""
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    homing.set_home(probe, home_speed=_RPM)
    to = many.join(probe)
    run = probe.command(Verb.RUN_SPEED)
    going = declared.values_of(probe.dialect, run)
    for number, (command, (stop, values)) in enumerate(chosen):
        begun = many.frame(probe, run, going, to) if number % 2 else probe.build(run, going).item()
        probe.send(begun, timeout_ns=_GOING_NS)
        before = motion.speed(probe).value if command is run else 0.0
        sent = [probe.send(many.frame(probe, command, _values(probe, command), to), timeout_ns=_RUNS_NS)]
        seen = motion.speed(probe)
        sent.append(probe.send(many.frame(probe, stop, values, to), timeout_ns=_ENDS_NS))
        # Without torque the shaft runs out.
        limit_ns = _RUNS_OUT_NS if values else _STANDS_NS
        expect_ended(probe, sent[-1], f"{stop.name} by {many.what} does not end {command.name}", limit_ns)
        if values:
            motion.switch(probe, True)
        text = f"{command.name} by {many.what} is not executed while the shaft turns"
        within = 2 + 2 * CLOCK_SHARE * _RPM + seen.noise
        probe.expect(abs(seen.value), near=_RPM, within=within, unit="rpm", refutes=text, exchange=sent[0])
        text = f"{command.name} by {many.what} turns the shaft the other way than to the drive itself"
        got = f"{before:+g} rpm, then {seen.value:+g} rpm"
        probe.expect(got, holds=before * seen.value <= 0, expected="one way, then the other", refutes=text, exchange=sent[0])
        for each in sent:
            expect_silence(probe, each, f"{command.name} by {many.what} is answered while the shaft turns")


def _values(probe: Probe, command: Command) -> dict[str, int]:
    if command.verb is Verb.HOME:
        return dict.fromkeys(command.request_forms[0].layout.named, 1)
    rpm = -_RPM if declared.of(command).kind is MotionKind.RUN else _RPM
    return declared.values_of(probe.dialect, command, -_FAR, rpm=rpm, acceleration=QUICK, start=motion.place(probe, command))
