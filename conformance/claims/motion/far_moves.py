"""Moves so far that they would take long: the shaft begins the way that it was told, and does not end soon.

    F5 .. 7F FF FF FF     as far as the field can say
    F5 .. 00 01 00 00     a position whose low bytes are 0, which is no stop

Rules kept here:
- A stop is told by its speed of 0, so no position ends a motion.
- Only the begin is looked at.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from analyzer.catalogue import Command, MotionKind, Risk
from conformance.claims.declare import motions
from conformance.claims.motion.motion_claim import expect_taken, has_direction, of_motion
from conformance.claims.motion.moves import takes_counts
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.declared import CALM, MOVES, QUICK
from conformance.talk.probe import MS, Probe

#: What a field of 16 bits cannot hold.
_WORD = 1 << 16
#: How fast the shaft goes (rpm), how long it is watched, and how far it has to go meanwhile (degrees).
_RPM, _BEGINS_NS, _LEAST = 4 * CALM, 240 * MS, 180
_counted = motions(*MOVES, where=takes_counts)


def _expect_begins(probe: Probe, command: Command, ends: Mapping[int, int]) -> None:
    """Refute a shaft that does not begin to turn to each end: `ends` by side, 0 where a short move goes, 1 the other."""
    field = declared.field_of(command, declared.of(command).distance)
    short = arriving.follow(probe, command, 36, rpm=_RPM)
    back = 0.0
    for side, value in ends.items():
        before = motion.position(probe)
        exchange = motion.ask(probe, command, 36, rpm=_RPM, acceleration=QUICK, more={field.name: value})
        expect_taken(probe, exchange, f"{command.name} by {value} is refused")
        probe.wait(_BEGINS_NS + int(ramp.move_ns(back / 360, _RPM, QUICK)))
        went = (motion.stand_still(probe).value - before.value) * math.copysign(1, short.degrees) * (-1) ** side
        text = f"{command.name} with {field.name} {value} does not begin that way, or ends soon"
        probe.expect(went, at_least=back + _LEAST, unit="degrees", refutes=text, exchange=exchange)
        # A place near 0 lies the other way from here too: the next end has to lead beyond where this one began.
        back = went if declared.of(command).kind is MotionKind.MOVE_TO else 0.0


@of_motion(each=_counted, refuted_by="a shaft that turns the other way, or ends at once", risks={Risk.UNBOUNDED})
def _widest(probe: Probe, command: Command) -> None:
    """{command} as far as its field can say begins the way that it was told, and does not end soon."""
    motion.prepare(probe, command)
    field = declared.field_of(command, declared.of(command).distance)
    _expect_begins(probe, command, {0: field.high} if has_direction(command) else {0: field.high, 1: field.low})


@of_motion(each=_counted, refuted_by="a shaft that stays, or turns the other way", parameters={})
def _low_word(probe: Probe, command: Command) -> None:
    """{command} with a number whose low 16 bits are 0 begins the way that it was told: only a speed of 0 stops."""
    motion.prepare(probe, command)
    # A place of its own on each side of the shaft, more than 16 bits away from it.
    word = motion.place(probe, command) // _WORD if declared.of(command).kind is MotionKind.MOVE_TO else 0
    ends = {0: (word + 2) * _WORD, 1: (word - 1) * _WORD}
    _expect_begins(probe, command, {0: ends[0]} if has_direction(command) else ends)
