"""What LK motors say of their health: error flags, voltage, temperature, phase currents.

Most need a hand on the drive: those claims are of emulated ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.protocols.lk_rs485 import ERROR_BITS
from conformance.claims import conditions
from conformance.claims.bench import lk_drive
from conformance.claims.declare import Case, commands
from conformance.claims.known_reads import every_read
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.motion import motion
from conformance.motion.declared import CALM
from conformance.talk.acceptance import need_reliable_replies
from conformance.talk.probe import SECOND_NS, Probe

_state = partial(of_motion, each=commands(Verb.READ_STATE_1), still=True)
_clear = partial(of_motion, each=commands(Verb.CLEAR_ERRORS), emulated=True, still=True)


# --- error flags ------------------------------------------------------------------------------------------------------


def _flags(dialect: Dialect) -> Iterator[Case]:
    for case in commands(Verb.READ_STATE_1)(dialect):
        for field in ERROR_BITS:
            yield Case(dialect, case.command, {"flag": field.name}, {"parameters": {}})


def _expect_flags(probe: Probe, wanted: set[str], when: str) -> None:
    values = probe.reply(probe.ask(Verb.READ_STATE_1)).values
    seen = {f.name for f in ERROR_BITS if values.get(f.name)}
    names = [", ".join(sorted(each)) or "none" for each in (wanted, seen)]
    probe.expect(names[1], equal=names[0], refutes=f"the error flags {when} are others")


@of_motion(
    each=_flags,
    name="{command}/flag-{flag}",
    refuted_by="another flag, or none",
    emulated=True,
    still=True,
    risks=risks_by(Verb.CLEAR_ERRORS),
)
def _flag(probe: Probe, flag: str) -> None:
    """Where {flag} is the matter, its flag is set, and no other; each read is answered as before."""
    drive = lk_drive(probe)
    _expect_flags(probe, set(), "at first")
    reads = [(read, values) for read, values in every_read(probe.dialect) if probe.ask(read, values, quiet_ns=0).reply]
    drive.trip(flag)
    _expect_flags(probe, {flag}, f"with {flag}")
    for read, values in reads:
        exchange = probe.ask(read, values, quiet_ns=0)
        if exchange.silent:
            need_reliable_replies(probe)
            exchange = probe.ask(read, values)
        text = f"{read.name} is not answered with {flag}"
        probe.expect("silence", holds=not exchange.silent, expected="a reply", refutes=text, exchange=exchange)
    drive.trip(flag, False)
    probe.do(Verb.CLEAR_ERRORS)
    _expect_flags(probe, set(), f"after {flag} was cleared")


@of_motion(
    each=commands(Verb.READ_STATE_1),
    refuted_by="no flag, or a flag without a cause",
    emulated=True,
    risks=risks_by(Verb.RUN_SPEED, Verb.CLEAR_ERRORS),
    at_best=Certainty.OPEN,
)
def _stalls(probe: Probe, command: Command) -> None:
    """A motor that is held for seconds while it is to turn sets the flag of a stall."""
    drive = lk_drive(probe)
    motion.ready_to_move(probe)
    motion.run_at(probe, CALM)
    drive.block()
    probe.wait(3 * SECOND_NS)
    _expect_flags(probe, {"stalled"}, "of a motor that is held")
    drive.block(False)
    probe.do(Verb.CLEAR_ERRORS)
    _expect_flags(probe, set(), "of a motor that was let go")


#: All flags, by name.
_EVERY = tuple(field.name for field in ERROR_BITS)


def _set_without_cause(probe: Probe, *flags: str) -> None:
    drive = lk_drive(probe)
    for present in (True, False):
        for flag in flags:
            drive.trip(flag, present)
    _expect_flags(probe, set(flags), "before 9B")


@_clear(refuted_by="a flag that stays, or one that a read clears")
def _clears(probe: Probe, command: Command) -> None:
    """9B clears each flag whose cause is gone, one alone and all together; no read clears it."""
    for flags in (*((name,) for name in _EVERY), _EVERY):
        _set_without_cause(probe, *flags)
        for read, values in every_read(probe.dialect):
            probe.ask(read, values, quiet_ns=0)
        _expect_flags(probe, set(flags), "after each read, before 9B,")
        probe.do(command)
        _expect_flags(probe, set(), f"after 9B, the cause of {' and '.join(flags)} being gone,")


@_clear(refuted_by="the flags of before", at_best=Certainty.OPEN)
def _tells_what_is_left(probe: Probe, command: Command) -> None:
    """9B is answered with the flags that it leaves: those whose cause lasts."""
    for gone, lasting in pairwise((*_EVERY, _EVERY[0])):
        _set_without_cause(probe, gone)
        lk_drive(probe).trip(lasting)
        for left in ({lasting}, set[str]()):
            exchange = probe.do(command)
            told = probe.reply(exchange).values
            seen = {name for name in _EVERY if told.get(name)}
            text = "9B is answered with other flags than it leaves"
            probe.expect(", ".join(sorted(seen)), equal=", ".join(left), refutes=text, exchange=exchange)
            lk_drive(probe).trip(lasting, False)


def _conditions(dialect: Dialect) -> Iterator[Case]:
    """Yield each condition but that of an error, in which the flags are cleared."""
    for case in commands(Verb.CLEAR_ERRORS)(dialect):
        for condition in conditions.every(dialect):
            if condition.name != "error":
                needs = {*dialect.by_verb[Verb.CLEAR_ERRORS].all_risks}
                facts = condition.facts(dialect, *needs) | {"emulated": True, "parameters": {}}
                yield Case(
                    dialect, case.command, {"condition": condition}, {**facts, "name": f"{{command}}/clears-{condition.name}"}
                )


@of_motion(
    each=_conditions,
    refuted_by="a flag that stays",
    statement="{command} clears a flag whose cause is gone in every condition.",
)
def _clears_then(probe: Probe, condition: conditions.Condition) -> None:
    motion.ready_to_move(probe)
    condition.enter(probe)
    _set_without_cause(probe, *_EVERY)
    probe.do(Verb.CLEAR_ERRORS)
    _expect_flags(probe, set(), f"after 9B {condition.when}")
    condition.leave(probe)


def _others(dialect: Dialect) -> Iterator[Case]:
    for case in commands(Verb.CLEAR_ERRORS)(dialect):
        for name in ("motor_on", "motor_off", "stop"):
            yield Case(dialect, case.command, {"other": dialect.by_name[name]})


@of_motion(
    each=_others,
    name="{command}/alone-not-{other}",
    refuted_by="a flag that is cleared",
    risks={Risk.TORQUE},
    at_best=Certainty.OPEN,
    emulated=True,
    still=True,
)
def _alone(probe: Probe, command: Command, other: Command) -> None:
    """{other} clears no flag: that is what {command} is for."""
    _set_without_cause(probe, *_EVERY)
    probe.do(other)
    _expect_flags(probe, set(_EVERY), f"after {other.name}")
    probe.do(command)
    motion.switch(probe, True)


@_clear(refuted_by="a flag that is cleared")
def _keeps(probe: Probe, command: Command) -> None:
    """9B leaves each flag whose cause lasts, also where others are cleared."""
    drive, lasting = lk_drive(probe), set[str]()
    for name in _EVERY:
        drive.trip(name)
        lasting.add(name)
        probe.do(command)
        _expect_flags(probe, lasting, f"after 9B, the cause of {name} lasting,")
    for name in _EVERY:
        drive.trip(name, False)
        lasting.discard(name)
        probe.do(command)
        _expect_flags(probe, lasting, f"after 9B, the cause of {name} being gone and of others not,")
    for name in _EVERY:
        drive.trip(name)
        probe.do(command)
        _expect_flags(probe, {name}, f"after 9B, the cause of {name} lasting alone,")
        drive.trip(name, False)
        probe.do(command)


# --- voltage, temperature, phases -------------------------------------------------------------------------------------


@_state(refuted_by="another voltage", emulated=True)
def _voltage(probe: Probe, command: Command) -> None:
    """The voltage is that of the supply, in 0.01 V."""
    for volts in (23.45, 6.5, 51.9, 60.0, 24.0):
        lk_drive(probe).supply(volts)
        seen = probe.read(command, "voltage") / 100
        probe.expect(seen, near=volts, within=0.01, unit="V", refutes="the voltage is another one")


@_state(refuted_by="another voltage", at_best=Certainty.LIKELY)
def _plausible(probe: Probe, command: Command) -> None:
    """The voltage is one that a drive can have: 5 to 60 V."""
    seen = probe.read(command, "voltage")
    probe.expect(seen, at_least=500, at_most=6_000, refutes="no drive works at this voltage")
