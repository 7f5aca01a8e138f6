"""Whether a drive is set to answer motion as it does by default, with `respond` and `active` 1; and how it is set so.

    respond 0     reads are answered, and no command that moves or stops
    active 0      a move is answered when it begins, and not when it is done

Users set them to 0, and most claims about motion listen for its replies. So a run looks before it judges.

Rules kept here:
- A drive is set otherwise where it answers as it should once both are set to 1. One that is silent all the same is a liar.
- One command that is not answered, or one time, says nothing of a setting.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from analyzer.catalogue import Command, MotionKind, Verb
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import MOVES, QUICK
from conformance.talk.probe import SECOND_NS, Until

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: What is said where a drive is not set to answer, and may not be.
UNHEARD = (
    "the drive obeys motion and does not answer it, or not its end: set respond and active to 1, "
    "or allow settings and say in --settings FILE what both are"
)
LOUD: Mapping[str, int] = {"respond": 1, "active": 1}
_DEGREES, _RPM, _LISTEN_NS = 36, 120, 2 * SECOND_NS


def is_loud(probe: Probe) -> bool:
    """Say whether a resting drive answers motion, and tells the end of a move. Raises Inconclusive."""
    return answers(probe) and tells_ends(probe)


def answers(probe: Probe) -> bool:
    """Say whether a resting drive answers any of its stops, or nothing at all."""
    stops = {stop.name: stop for run in probe.dialect.motions(MotionKind.RUN, *MOVES) for stop in probe.dialect.stops_of(run)}
    silenced = [stop for stop in stops.values() if stop.silenced]
    asked = (probe.ask(stop, {"acceleration": QUICK}, quiet_ns=0) for stop in silenced)
    return not silenced or any(e.reply is not None for e in asked) or probe.ask(declared.reads_position(probe.dialect)).silent


def tells_ends(probe: Probe) -> bool:
    """Say whether a drive tells the end of a short move, there or back, or refuses it. Raises Inconclusive."""
    if not arriving.tells_end(probe.dialect):
        return True
    motion.ready_to_move(probe)
    return any(_tells_end(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), degrees) for degrees in (_DEGREES, -_DEGREES))


def _tells_end(probe: Probe, move: Command, degrees: float) -> bool:
    exchange = motion.ask(probe, move, degrees, rpm=_RPM, acceleration=QUICK, until=Until.DONE, timeout_ns=_LISTEN_NS)
    statuses, replies = arriving.statuses([exchange], move), move.replies
    return any(status in (*replies.final, *replies.failed) for status in statuses)


def set_loud(probe: Probe) -> bool:
    """Set a drive to answer motion; say whether it has such a setting. Raises Inconclusive, Refused, NotRun."""
    if Verb.SET_RESPOND not in probe.dialect.by_verb:
        return False
    probe.do(Verb.SET_RESPOND, LOUD)
    return True
