"""Packages whose own slot is each of the five: what stands in it is done as when it is sent alone, beside other drives' slots.

    FC | 02 .. | 03 .. | 01 FD 01 04 F8 00 00 01 BC 00 | 04 .. | 05 .. | sum

Rules kept here:
- Motion turns either way; a move is followed to its end. The slots of the others ask for the other way.
- Of settings those are tried that show soon: whether the motor is on, and how far a pulse goes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import cycle

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims.addressing.package import frame_of, motions, of, of_packages, others_of, rpm_of
from conformance.claims.control_reads import expect_silence, plain_read
from conformance.claims.declare import Case
from conformance.claims.motion.stops import expect_ended
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe

#: The ramp of a run, 1.3 ms for a rpm, and how long it rises: to 60 rpm. How far a motion would go (degrees).
_RISING, _RISES_NS, _FAR = 230, 80 * MS, 10 * 360
#: How far a move goes, of a count and pulses with two bytes each (degrees), how fast at most (rpm), and its ramp.
_WAY, _RPM, _RAMP = 50, 260, 254
#: How long a shaft may go on behind a move by the law or a stop; how long a setting and a stop are listened to.
_LATE_NS, _SETTING_NS, _HALTS_NS = 300 * MS, 20 * MS, 20 * MS
#: Subdivisions that a slot sets, in turns.
_SUBDIVISIONS = (8, 32)


# --- motion -----------------------------------------------------------------------------------------------------------


def _in_every_slot(dialect: Dialect) -> Iterator[Case]:
    """Yield each motion twice: what turns one way in a slot turns the other way in the next, so that half of it shows much."""
    for case in motions(dialect):
        for begins, name, slots in ((1, "every-slot", "first"), (-1, "every-slot-other-way", "second")):
            yield Case(dialect, case.command, {"run": case["run"], "begins": begins, "name": name, "slots": slots}, case.facts)


@of_packages("a shaft that stays, turns the other way, is slow, or goes elsewhere", name="{run}/{name}", each=_in_every_slot)
def _in_each_slot(probe: Probe, command: Command, run: Command, begins: int) -> None:
    """{run} in each slot of a package turns the shaft, and a move as far, as alone: one way from the {slots} slot on, by turns.

    The slots of other drives stand beside it. A stop in each slot ends a run.
    """
    assert command.slots is not None
    motion.prepare(probe, run)
    motion.begin(probe, run, _FAR, acceleration=_RISING)
    probe.wait(_RISES_NS)
    alone = math.copysign(1, motion.turning(probe).value)
    rest = motion.stand_still(probe)
    for number, way in zip(range(command.slots.count), cycle((begins, -begins)), strict=False):
        sent, seen, rest = undamaged(probe, _turned_in_slot, command, run, number, way, rest=rest)
        key = f"{run.name} in a slot of a package does not turn the shaft as when it is sent alone"
        text = key.replace("a slot", f"slot {number + 1}")
        went = seen * alone * way
        if declared.of(run).kind is MotionKind.RUN:
            probe.expect(went, at_least=CALM / 2, unit="rpm that way", refutes=text, exchange=sent, key=key)
        else:
            # A shaft may rest between two pulses, and the place that is read is one of them.
            unit = 360 / declared.units_per_turn(probe.dialect, run, SUBDIVISION)
            asked, within = round(_WAY / unit) * unit, motion.miss(probe) + motion.same(probe) + unit
            probe.expect(went, near=asked, within=within, unit="degrees that way", refutes=text, exchange=sent, key=key)


def _turned_in_slot(
    probe: Probe, command: Command, run: Command, number: int, way: int, rest: motion.Sample
) -> tuple[Exchange, float, motion.Sample]:
    """Turn the shaft by a slot; return the package, the speed of a run or how far a move went, and where the shaft rests."""
    assert command.slots is not None
    runs = declared.of(run).kind is MotionKind.RUN
    start, degrees = motion.place(probe, run), _FAR if runs else _WAY
    how = {"acceleration": _RISING if runs else _RAMP}
    own, other = (
        declared.values_of(probe.dialect, run, w * degrees, rpm=rpm_of(run, w), start=start, **how) for w in (way, -way)
    )
    slots = [
        {"address": address, "command": run.name, **other}
        for address in others_of(probe.dialect, probe.address, command.slots.count - 1)
    ]
    slots.insert(number, {"address": probe.address, "command": run.name, **own})
    frame = frame_of(probe, command, slots)
    if runs:
        sent = probe.send(frame, timeout_ns=_RISES_NS)
        seen = motion.turning(probe).value
        stops = probe.dialect.stops_of(run)
        stop = stops[0 if way > 0 else -1]
        how = {"acceleration": 0} if declared.of(stop).acceleration else {}
        slots[number] = {"address": probe.address, "command": stop.name, **how}
        ended = probe.send(frame_of(probe, command, slots), timeout_ns=_HALTS_NS)
        text = f"{stop.name} in slot {number + 1} of a package does not stop the shaft"
        return sent, seen, expect_ended(probe, ended, text, _LATE_NS)
    sent = probe.send(frame, timeout_ns=int(ramp.move_ns(_WAY / 360, _RPM, _RAMP)))
    try:
        end = motion.wait_standing(probe, limit_ns=_LATE_NS)
    except Inconclusive:
        # A slow one is on its way still.
        end = motion.stand_still(probe)
    return sent, end.value - rest.value, end


# --- settings ---------------------------------------------------------------------------------------------------------


def _set_in_every_slot(dialect: Dialect) -> Iterator[Case]:
    verbs = (Verb.ENABLE, Verb.SET_SUBDIVISION, Verb.MOVE_RELATIVE_PULSES)
    risks = frozenset[Risk]().union(*(dialect.by_verb[verb].all_risks for verb in verbs)) if of(dialect) else frozenset[Risk]()
    for command in of(dialect):
        facts = {"risks": declared.risks(dialect, *risks), "settings": declared.settings(dialect, "subdivision")}
        yield Case(dialect, command, facts=facts)


@of_packages("a setting that is as it was", name="settings/every-slot", each=_set_in_every_slot)
def _set_in_each_slot(probe: Probe, command: Command) -> None:
    """A setting in each slot of a package is made as when it is sent alone: the motor is on or off, and pulses go as far."""
    assert command.slots is not None
    move = probe.command(Verb.MOVE_RELATIVE_PULSES)
    motion.prepare(probe, move)
    for number in range(command.slots.count):
        where = f"in slot {number + 1} of a package"
        for enabled in (0, 1):
            sent = _set(probe, command, number, Verb.ENABLE, "enabled", enabled)
            text, key = f"enabling by {enabled} {where} does not do so", "enabling in a slot"
            probe.expect(motion.is_on(probe), equal=bool(enabled), refutes=text, exchange=sent, key=key)
        subdivision = _SUBDIVISIONS[number % len(_SUBDIVISIONS)]
        sent = _set(probe, command, number, Verb.SET_SUBDIVISION, "subdivision", subdivision)
        went = arriving.follow(probe, move, _WAY, rpm=CALM, subdivision=subdivision)
        text, key = f"pulses do not go by the subdivision that was set {where}", "a subdivision in a slot"
        within = motion.miss(probe) + motion.same(probe)
        probe.expect(abs(went.degrees), near=went.asked, within=within, unit="degrees", refutes=text, exchange=sent, key=key)


def _set(probe: Probe, command: Command, number: int, verb: Verb, field: str, value: int) -> Exchange:
    """Send a setting in a slot, beside reads of other drives."""
    assert command.slots is not None
    others = others_of(probe.dialect, probe.address, command.slots.count - 1)
    slots = [{"address": address, "command": plain_read(probe.dialect).name} for address in others]
    slots.insert(number, {"address": probe.address, "command": probe.command(verb).name, field: value})
    sent = probe.send(frame_of(probe, command, slots), timeout_ns=_SETTING_NS)
    expect_silence(probe, sent, f"{verb.value} in a slot of a package is answered")
    return sent
