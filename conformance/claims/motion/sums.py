"""The sums of many replies to one move: whether some are off, and whether that is the drive's doing or the line's.

Rules kept here:
- A line damages what it carries: replies to a read too, as often. A drive that gets a sum of one command wrong does not.
- How many reads must be good for that follows from how many replies were bad: chance alone would spare them once in a
  thousand times. Few bad replies tell too little, so the move is asked for again until there are more.
- The known quirk of real drives is a last sum that is off by little. Any other damage is none of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from analyzer.catalogue import Command, Dialect
from conformance.claim import Inconclusive
from conformance.claims.control_reads import is_answered, plain_read
from conformance.claims.declare import Case
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import command_of, of_motion
from conformance.claims.motion.moves import takes_place, with_max_speed
from conformance.motion import motion
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: Moves whose replies are looked at for their sums; how many at most where few of them are bad, and what is not few.
_MANY, _MOST, _ENOUGH = 300, 1000, 3
#: How likely reads may be good by chance, though their line damages replies as often as those to the move.
_CHANCE = 1 / 1000
_OFF_SUM = "lk-off-sum"
#: What drives with that quirk were seen to do: how often at most, and how far off a sum was.
_OFF_SHARE, _OFF_BY = 0.05, 4


def _moves(dialect: Dialect) -> list[Case]:
    return [case for case in with_max_speed(dialect) if takes_place(command_of(case))]


@of_motion(
    each=_moves,
    refuted_by="a sum that is off",
    quirks=may_meet(_OFF_SUM),
    statement=f"Each of {_MANY} replies has the sums that fit it.",
)
def _sums(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    start = motion.place(probe, command)
    bad, count = _bad_replies(probe, lambda: motion.ask(probe, command, start=start, quiet_ns=0))
    if len(bad) == count:
        raise Inconclusive(f"no reply to {command.name} can be read")
    if not bad:
        return
    if len(bad) <= _OFF_SHARE * count and all(_is_off(probe.dialect, e) for e in bad) and _OFF_SUM in probe.claim.quirks:
        probe.meets(_OFF_SUM)
        return
    text = f"replies to {command.name} have sums that do not fit"
    probe.expect(count - len(bad), equal=count, unit="good replies", refutes=text, exchange=bad[0], key=text)


def _bad_replies(probe: Probe, ask: Callable[[], Exchange]) -> tuple[list[Exchange], int]:
    """Ask again and again; return the exchanges without a good reply, and how many there were.

    Raises Inconclusive where the line may have damaged them.
    """
    asked = [ask() for _ in range(_MANY)]
    bad = [e for e in asked if not is_answered(e)]
    while 0 < len(bad) < _ENOUGH and len(asked) < _MOST:
        asked.append(ask())
        bad += [e for e in asked[-1:] if not is_answered(e)]
    if not bad or len(bad) == len(asked):
        return bad, len(asked)
    if len(bad) < _ENOUGH:
        raise Inconclusive(f"{len(bad)} of {len(asked)} replies cannot be read: too few to tell from what a line damages")
    read = plain_read(probe.dialect)
    # The last bad ones of all replies come among the moves alone by this chance.
    for _ in range(math.ceil(len(asked) * (_CHANCE ** (-1 / len(bad)) - 1))):
        if not is_answered(probe.ask(read, quiet_ns=0)):
            raise Inconclusive(f"replies to {read.name} are damaged too, which another claim judges")
    return bad, len(asked)


def _is_off(dialect: Dialect, exchange: Exchange) -> bool:
    """Say whether a reply has a last check that is off by as little as was seen on real drives, and no other fault."""
    if len(exchange.answers) != 1 or exchange.junk:
        return False
    *others, check = dialect.link.checks(exchange.answers[0].data)
    off = (check.got[0] - check.expected[0] + 128) % 256 - 128
    return all(other.ok for other in others) and 0 < abs(off) <= _OFF_BY
