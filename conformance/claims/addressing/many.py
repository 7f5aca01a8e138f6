"""What is sent to several drives: all of them (broadcast), a group, and packages without motion. Executed, never answered.

FA 00 F4 ..          every drive moves, none answers
FA 50 F4 ..          every drive of the group 50h moves, none answers; each still answers its own address
FC 00 .. 01 F3 00 .. drive 1 is disabled, and does not answer; motions in a package stand in `addressing.package`
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from conformance.claims.addressing import guarded_commands
from conformance.claims.addressing.ways import (
    BROADCAST,
    BYTE,
    GROUPS,
    HIGH_GROUPS,
    PACKAGES,
    Many,
    addresses,
    addressing,
    read_of,
    send_to,
    ways,
)
from conformance.claims.control_reads import (
    ask_first,
    expect_silence,
    is_answered,
    judge_next,
    plain_read,
    plain_reads,
    received_text,
)
from conformance.claims.declare import Case, Cases
from conformance.claims.known_reads import every_read
from conformance.claims.motion.motion_claim import expect_not_turned
from conformance.claims.motion.stops import expect_standing
from conformance.claims.ranges import edges
from conformance.claims.settings import setting_effects
from conformance.claims.settings.setting_effects import differing
from conformance.gate.gate import Item
from conformance.motion import declared, effects, motion, ramp
from conformance.motion.declared import CALM, MOVES, QUICK
from conformance.motion.effects import STEP_NS, Observable
from conformance.talk import restarts
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.noise import TOLD_LATE_NS
from conformance.talk.probe import Probe, Until
from conformance.talk.settings import changes_link

#: Settings that decide whether and to whom a drive answers: what claims about them say.
_OF_REPLIES = frozenset({Verb.SET_RESPOND, Verb.SET_GROUP_ADDRESS})
#: How long a motion or a stop is listened to: its ramp takes 24 ms.
_TURNS_NS = 100_000_000
#: How long the shaft has until it is looked at, by an address that is not the drive's: at its ramp it turns at 60 rpm by then.
_BETWEEN_NS = 30_000_000
#: A ramp of 2.5 ms for a rpm, by which a shaft rises in a while; how long a stop at once may take, and is then looked at.
_HALTED_RAMP, _RISES_NS, _HALTS_NS, _LOOK_NS = 206, 160_000_000, 15_000_000, 40_000_000
#: A speed of two bytes, whose low byte alone is slow; subdivisions that few claims set, at which a speed is as sent.
_RPM, _SUBDIVISION = 260, 32
#: How far a move goes that is followed to its end, and one that is sent to the drive itself (degrees).
_SHORT, _OWN_WAY = 45, 36
#: How long a setting is listened to; that a setting by several addresses is silent shows with the first of them too.
_SETTING_NS = 60_000_000


def _of(many: Many) -> Cases:
    """Return one case of an address of several drives, where a dialect has it."""
    return lambda dialect: [Case(dialect, given={"many": many, "what": many.what})] if many in addresses(dialect) else []


def _expect_silence(probe: Probe, sent: Exchange, what: str) -> None:
    expect_silence(probe, sent, f"{what} is answered")


# --- reads ------------------------------------------------------------------------------------------------------------


def _samples(dialect: Dialect) -> list[Command]:
    return plain_reads(dialect)[:4]


@addressing("any answer", _of(BROADCAST), name="{many}/read")
def _broadcast_read(probe: Probe, many: Many) -> None:
    """A read by broadcast is not answered."""
    ask_first(probe)
    for command in _samples(probe.dialect):
        sent = probe.send(probe.build(command, address=many.join(probe)).item())
        _expect_silence(probe, sent, many.what)


@addressing("silence, or another answer", _of(BROADCAST), name="{many}/next")
def _behind_broadcast(probe: Probe, many: Many) -> None:
    """The next request to the drive behind a broadcast is answered."""
    ask_first(probe)
    judge_next(probe, many.what, lambda: read_of(probe, many.join(probe)))


@addressing("any answer", _of(GROUPS), name="{many}/read")
def _group_read(probe: Probe, many: Many) -> None:
    """A read to the group address is not answered."""
    ask_first(probe)
    _expect_silence(probe, read_of(probe, many.join(probe)), many.what)


@addressing("silence, or another answer", _of(GROUPS), name="{many}/own")
def _own_address(probe: Probe, many: Many) -> None:
    """A drive in a group still answers its own address."""
    ask_first(probe)
    many.join(probe)
    tries = [probe.ask(plain_read(probe.dialect)) for _ in range(2)]
    probe.expect(
        received_text(tries[-1]),
        holds=any(is_answered(each) for each in tries),
        expected=f"a reply to {hex_of(tries[-1].sent or b'')}",
        refutes="a drive in a group no longer answers its own address",
        exchange=tries[-1],
    )


# --- commands ---------------------------------------------------------------------------------------------------------


def _changes(dialect: Dialect) -> Iterator[Case]:
    """Yield each address of several drives with a command whose effect can be seen."""
    shown = effects.observable(dialect)
    for many in addresses(dialect) if shown is not None else ():
        yield Case(dialect, given={"many": many, "what": many.what, "shown": shown})


def _changes_and_high_groups(dialect: Dialect) -> Iterator[Case]:
    yield from _changes(dialect)
    for case in _group_changes(dialect):
        yield Case(dialect, given={**case.given, "many": HIGH_GROUPS, "what": HIGH_GROUPS.what})


@addressing("no effect of it", _changes_and_high_groups, name="{many}/executed")
def _executed(probe: Probe, many: Many, shown: Observable) -> None:
    """A command by {what} is executed."""
    shown.prepare(probe)
    to = many.join(probe)
    change = shown.change(probe)
    sent = send_to(probe, to, change, shown.settle_ns)
    done = shown.done(probe, change)
    if not done:
        shown.control(probe)
    probe.expect(
        f"{change.before} is read",
        holds=done,
        expected=f"{change.after} to be read after {hex_of(sent.sent or b'')}",
        refutes=f"{change.command.name} by {many.what} is not executed",
        exchange=sent,
        key=f"{many.what} is not executed",
    )


@addressing("any answer", _changes, name="{many}/silent")
def _silent(probe: Probe, many: Many, shown: Observable) -> None:
    """A command by {what} is not answered, neither when it begins nor when it is done."""
    shown.prepare(probe)
    to = many.join(probe)
    _expect_silence(probe, send_to(probe, to, shown.change(probe), shown.settle_ns), many.what)


def _motions(dialect: Dialect) -> Iterator[Case]:
    """Yield each address of several drives with each motion and its stops."""
    for many in addresses(dialect):
        for run in dialect.motions(MotionKind.RUN, *MOVES):
            for stop in dialect.stops_of(run):
                risks = many.risks(dialect) | declared.risks(dialect, *run.all_risks)
                settings = (*declared.settings(dialect), *many.settings)
                given = {"many": many, "what": many.what, "run": run, "stop": stop}
                yield Case(dialect, given=given, facts={"risks": risks, "settings": settings})


@addressing("a shaft that stands, or one that turns on", _motions, name="{many}/{run}/{stop}")
def _turns_and_stops(probe: Probe, many: Many, run: Command, stop: Command) -> None:
    """{run} by {what} turns the shaft by its ramp and as far as sent, {stop} lets it stand, and neither is answered."""
    counted = declared.takes_pulses(run)
    motion.ready_to_move(probe, subdivision=_SUBDIVISION if counted else None)
    to, first = many.join(probe), stop is probe.dialect.stops_of(run)[0]
    if many is GROUPS and first:
        _expect_stays(probe, run, _near_groups(probe, to))
    # By its ramp the shaft would go on for 0.3 s.
    ramped = declared.of(run).acceleration
    scale = {"subdivision": _SUBDIVISION} if counted else {}
    how = {"rpm": _RPM, "acceleration": _HALTED_RAMP} if ramped else {}
    values = declared.values_of(probe.dialect, run, 10 * 360, start=motion.place(probe, run), **scale, **how)
    begun = probe.send(probe.build(run, values, address=to).item(), timeout_ns=_RISES_NS if ramped else _TURNS_NS)
    text = f"{run.name} by {many.what} does not turn the shaft"
    seen = motion.turning(probe)
    probe.expect(abs(seen.value), at_least=CALM / 2, unit="rpm", refutes=text, exchange=begun)
    if ramped:
        text = f"{run.name} by {many.what} does not keep to the acceleration that was sent"
        most = (seen.t_ns + seen.spread_ns - begun.sent_ns) / ramp.step_ns(_HALTED_RAMP) + _BESIDE
        probe.expect(abs(seen.value), at_most=most, unit="rpm", refutes=text, exchange=begun)
    at_once = declared.of(stop).acceleration or stop.verb is Verb.EMERGENCY_STOP
    how = {"acceleration": 0} if declared.of(stop).acceleration else {}
    ended = probe.send(probe.build(stop, how, address=to).item(), timeout_ns=_HALTS_NS if at_once else _TURNS_NS)
    text = f"{stop.name} by {many.what} does not stop the shaft"
    if at_once:
        # A shaft that settles swings behind a halt.
        probe.wait(_LOOK_NS if probe.noise.live else 0)
        halted = motion.position(probe).value
        probe.wait(_LOOK_NS)
        went, most = abs(motion.position(probe).value - halted), motion.same(probe) + probe.noise.swing
        expected = "a shaft that stands at once"
        probe.expect(went, at_most=most, unit="degrees", expected=expected, refutes=text, exchange=ended)
    expect_standing(probe, ended, text)
    for sent in (begun, ended):
        _expect_silence(probe, sent, many.what)
    way = math.copysign(1, seen.value)
    if first and declared.of(run).kind in MOVES:
        _expect_goes_back(probe, many, run, to, way)
    if many is GROUPS and first:
        rest = motion.position(probe).value
        values = declared.values_of(probe.dialect, run, _OWN_WAY, start=motion.place(probe, run), **scale)
        own = probe.ask(run, values)
        went = motion.stand_still(probe).value - rest
        text = f"a drive in a group no longer answers {run.name} to its own address"
        probe.expect(received_text(own), holds=not own.silent, expected="a reply", refutes=text, exchange=own)
        text = f"{run.name} by {many.what} turns the shaft another way than to the drive itself"
        probe.expect(went * way, at_least=-1, unit="degrees that way", refutes=text, exchange=begun)


def _expect_goes_back(probe: Probe, many: Many, move: Command, to: int, way: float) -> None:
    """Refute a move the other way that is answered, or does not go as far as was sent. `way`: that of the move before."""
    rest = motion.position(probe)
    scale = {"subdivision": _SUBDIVISION} if declared.takes_pulses(move) else {}
    values = declared.values_of(probe.dialect, move, -_SHORT, acceleration=QUICK, start=motion.place(probe, move), **scale)
    law_ns = int(ramp.move_ns(_SHORT / 360, CALM, QUICK))
    sent = probe.send(probe.build(move, values, address=to).item(), timeout_ns=law_ns)
    went, within = (motion.wait_standing(probe).value - rest.value) * way, motion.miss(probe) + motion.same(probe)
    text = f"{move.name} by {many.what} does not go as far as was sent"
    probe.expect(went, near=-_SHORT, within=within, unit="degrees", refutes=text, exchange=sent)
    _expect_silence(probe, sent, many.what)


def _expect_stays(probe: Probe, run: Command, addresses: list[int]) -> None:
    """Refute a drive that any of these addresses turns."""
    values = declared.values_of(probe.dialect, run, 10 * 360, start=motion.place(probe, run))
    for address in addresses:
        sent = probe.send(probe.build(run, values, address=address).item(), timeout_ns=_BETWEEN_NS)
        went = abs(motion.speed(probe).value)
        text, key = f"{run.name} by the group {address} turns a drive of another group", f"{run.name} by another group"
        probe.expect(went, at_most=CALM / 8, unit="rpm", refutes=text, exchange=sent, key=key)


def _ramped(dialect: Dialect) -> Iterator[Case]:
    """Yield each way to several drives with a run whose ramp is known; with a package, as no other claim does, each move."""
    every = dialect.motions(MotionKind.RUN, *MOVES) if dialect.ramp is not None else ()
    for many in ways(dialect) if every else ():
        chosen = every if many is PACKAGES else every[:1]
        risks = many.risks(dialect) | declared.risks(dialect, *(risk for command in chosen for risk in command.all_risks))
        facts = {"risks": risks, "settings": declared.settings(dialect, *many.settings)}
        yield Case(dialect, given={"many": many, "what": many.what, "chosen": chosen}, facts=facts)


@addressing("another speed", _ramped, name="{many}/as-sent")
def _as_sent(probe: Probe, many: Many, chosen: tuple[Command, ...]) -> None:
    """Motion by {what} keeps to the ramp that is sent: at its begin, and at the end of a run."""
    for command in chosen:
        motion.prepare(probe, command)
        to = many.join(probe)
        runs = declared.of(command).kind is MotionKind.RUN
        how: dict[str, Any] = {"rpm": -CALM if runs else CALM, "acceleration": _RAMP}
        values = declared.values_of(probe.dialect, command, -_WAY, start=motion.place(probe, command), **how)
        _expect_on_ramp(probe, many.frame(probe, command, values, to), 0, f"{command.name} by {many.what}")
        if runs:
            probe.wait(STEP_NS)
            stop = probe.dialect.stops_of(command)[0]
            ended = many.frame(probe, stop, {"acceleration": _RAMP}, to)
            sent = _expect_on_ramp(probe, ended, CALM, f"{stop.name} by {many.what}")
            if declared.of(stop).tells_end:
                over_ns = sent.sent_ns + CALM * ramp.step_ns(_RAMP) + TOLD_LATE_NS
                heard = probe.listen(max(0, round(over_ns) - probe.gate.now_ns()))
                text = f"{stop.name} by {many.what} is answered when the shaft stands"
                probe.expect(received_text(heard), holds=heard.silent, expected="silence", refutes=text, exchange=heard)
        motion.stand_still(probe)


#: A ramp of 5 ms for a rpm; a way of whole pulses on which a move has its speed for a while; when the ramp is looked at.
_RAMP, _WAY, _ON_RAMP_NS = 156, 144, 110_000_000
#: By how much a speed on its way may be off the law (rpm).
_BESIDE = 15


def _expect_on_ramp(probe: Probe, item: Item | bytes, first: int, what: str) -> Exchange:
    sent = probe.send(item, timeout_ns=_ON_RAMP_NS)
    seen = motion.speed(probe)
    gone = min(CALM, (seen.t_ns - sent.sent_ns) / ramp.step_ns(_RAMP))
    text = f"{what} does not keep to the acceleration that was sent"
    within = _BESIDE + seen.spread_ns / ramp.step_ns(_RAMP)
    probe.expect(abs(seen.value), near=abs(first - gone), within=within, unit="rpm", refutes=text, exchange=sent)
    return sent


def _group_changes(dialect: Dialect) -> Iterator[Case]:
    return (case for case in _changes(dialect) if case["many"] is GROUPS)


def _near_groups(probe: Probe, group: int) -> list[int]:
    """Return other groups' addresses: those that differ in one bit, that below, and the low byte; none a drive's own."""
    last = probe.dialect.addresses[1]
    near = (*(group ^ 1 << bit for bit in range(last.bit_length())), group - 1, group & BYTE)
    mine = (group, probe.address, probe.rig.group, probe.dialect.broadcast)
    return [each for each in dict.fromkeys(near) if each not in mine and each <= last]


@addressing("an answer, or an effect of it", _group_changes, name="{many}/other")
def _other_group(probe: Probe, many: Many, shown: Observable) -> None:
    """A command to a group address that differs from the drive's in one bit or more is neither executed nor answered."""
    shown.prepare(probe)
    group = many.join(probe)
    change = shown.change(probe)
    for address in _near_groups(probe, group):
        sent = send_to(probe, address, change, shown.settle_ns)
        probe.expect(
            received_text(sent) if not sent.silent else "it is executed",
            holds=sent.silent and not shown.done(probe, change),
            expected=f"no answer and no effect of {hex_of(sent.sent or b'')}",
            refutes=f"the group {address} is heard, and the drive is in {group}",
            exchange=sent,
            key="another group is heard",
        )
    shown.control(probe)


def _switches(dialect: Dialect) -> Iterator[Case]:
    """Yield each way to several drives with what switches, homes, sets the zero and writes ports."""
    for many in ways(dialect):
        for case in guarded_commands.switches(dialect):
            risks = many.risks(dialect) | guarded_commands.risks(case)
            settings = case.facts.get("settings", declared.settings(dialect))
            facts = {**case.facts, "risks": risks, "settings": (*settings, *many.settings)}
            given = {"many": many, "what": many.what, "switch": case.command, "shown": case["guarded"]}
            yield Case(dialect, given=given, facts=facts)


@addressing("no effect of it, or an answer", _switches, name="{many}/{switch}")
def _switched(probe: Probe, many: Many, switch: Command, shown: guarded_commands.Guarded) -> None:
    """{switch} by {what} is executed, and not answered."""
    shown.ready(probe)
    to = many.join(probe)
    values = shown.values(probe, switch)
    before = shown.see(probe)
    sent = probe.send(many.frame(probe, switch, values, to), timeout_ns=STEP_NS)
    after = shown.see(probe)
    guarded_commands.leave(probe, shown)
    text = f"{switch.name} by {many.what} is not executed"
    holds = shown.shows(probe, before, after)
    probe.expect(f"{after:g}", holds=holds, expected=f"another value than {before:g}", refutes=text, exchange=sent)
    _expect_silence(probe, sent, many.what)


def _whatever_happens(dialect: Dialect) -> Iterator[Case]:
    """Yield each way to several drives with what is refused while the motor is off."""
    for many in ways(dialect) if declared.can_move(dialect) else ():
        chosen = dialect.motions(MotionKind.RUN, *MOVES)
        sent = many.risks(dialect).union(*(c.all_risks for c in chosen)) - {Risk.UNKNOWN}
        risks = declared.risks(dialect, Risk.TORQUE, *sent)
        facts = {"risks": risks, "settings": declared.settings(dialect, *many.settings)}
        yield Case(dialect, given={"many": many, "what": many.what, "chosen": chosen}, facts=facts)


@addressing("any answer, or motion", _whatever_happens, name="{many}/outcomes")
def _never_answered(probe: Probe, many: Many, chosen: tuple[Command, ...]) -> None:
    """Nothing by {what} is answered: no read, and no motion of a motor that is off, or in a pulse mode; that turns nothing."""
    motion.ready_to_move(probe)
    to = many.join(probe)
    for read, values in every_read(probe.dialect) if many is not PACKAGES else ():
        _expect_silence(probe, probe.ask(read, values, address=to, until=Until.TIMEOUT), many.what)
    way = -1 if many is GROUPS else 1
    motion.switch(probe, False)
    _expect_not_moved(probe, many, chosen, to, way, "of a motor that is off")
    motion.set_mode(probe, declared.pulse_modes(probe.dialect)[0])
    _expect_not_moved(probe, many, chosen, to, -way, "in a pulse mode")


def _expect_not_moved(probe: Probe, many: Many, chosen: tuple[Command, ...], to: int, way: int, when: str) -> None:
    """Refute where a motion that must be refused is answered, or turns the shaft."""
    before = motion.position(probe)
    for command in chosen:
        # What moves turns nothing, or a tenth of a turn: a drive may run all the same.
        rpm = way * CALM if declared.of(command).kind is MotionKind.RUN else CALM
        values = declared.values_of(probe.dialect, command, way * 36, rpm=rpm, start=motion.place(probe, command))
        sent = probe.send(many.frame(probe, command, values, to), timeout_ns=probe.rig.silence_ns)
        if not sent.silent:
            motion.stand_still(probe)
            motion.ready_to_move(probe)
        _expect_silence(probe, sent, many.what)
    expect_not_turned(probe, before, sent, f"a motion by {many.what} turns the shaft {when}")


# --- settings ---------------------------------------------------------------------------------------------------------


def _readable_settings(dialect: Dialect) -> Iterator[Case]:
    """Yield each address of several drives with the settings that can be read."""
    own = [c for c in dialect.commands if c.readable and not changes_link(c) and c.verb not in _OF_REPLIES]
    for many in addresses(dialect) if own and Verb.RESTART in dialect.by_verb else ():
        needed = [edges.needs(dialect, c, [differing(c.request_forms[0])[0]]) for c in own]
        facts = {
            "risks": many.risks(dialect).union(dialect.by_verb[Verb.RESTART].all_risks, *(each["risks"] for each in needed)),
            "settings": (*many.settings, *(name for each in needed for name in each["settings"])),
        }
        yield Case(dialect, given={"many": many, "what": many.what, "chosen": own}, facts=facts)


@addressing("a setting that stays as it was, or an answer", _readable_settings, name="{many}/settings")
def _settings(probe: Probe, many: Many, chosen: list[Command]) -> None:
    """Settings by {what} are stored, and not answered; a restart keeps them."""
    to = many.join(probe)
    if Verb.SET_WORK_MODE in probe.dialect.by_verb:
        # Some settings are refused in a pulse mode.
        mode = probe.command(Verb.SET_WORK_MODE)
        probe.ask(mode, {"work_mode": declared.choice(mode, "work_mode", declared.bus_modes(probe.dialect)[-1])})
    held: list[tuple[Command, dict[str, int]]] = []
    for command in chosen:
        before, _ = setting_effects.stored(probe, command)
        values = next(v for v in differing(command.request_forms[0]) if v != before)
        sent = probe.ask(command, values, address=to, until=Until.TIMEOUT, timeout_ns=_SETTING_NS)
        _expect_silence(probe, sent, many.what)
        after, _ = setting_effects.stored(probe, command)
        wanted = {n: values[n] for n in after}
        held.append((command, wanted))
        text = f"{command.name} by {many.what} is not stored"
        probe.expect(after, equal=wanted, refutes=text, exchange=sent)
    exchange = restarts.restart(probe)
    for command, wanted in held:
        text = f"{command.name} by {many.what} is another one after a restart"
        probe.expect(setting_effects.stored(probe, command)[0], equal=wanted, refutes=text, exchange=exchange)
