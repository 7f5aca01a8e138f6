"""A move and its end: followed until the shaft stands, and what the replies said.

    move = follow(probe, command, 90)           a move by 90 degrees, relative, absolute or within the turn, to its end
    move.degrees, move.statuses                 how far the shaft went, and what was answered

A dialect that tells the end of a move by a reply is listened to; with one that does not the shaft is watched.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect
from conformance.claim import Inconclusive
from conformance.motion import declared, motion, ramp
from conformance.motion.declared import CALM, MOVES, QUICK, SUBDIVISION
from conformance.talk.exchange import Answer, Exchange
from conformance.talk.noise import TOLD_LATE_NS
from conformance.talk.probe import MS, SECOND_NS, Until

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: How long a move without a known ramp has to get going before the shaft is watched.
_SET_OFF_NS = 500 * MS
#: How long a shaft may take to come to rest whose motion is over, by its time.
_SOON_NS = SECOND_NS // 2


@dataclass(frozen=True)
class Move:
    """A move that was followed to its end.

    `asked`: by how many degrees, after rounding to the command's unit. `start`, `end`: where the shaft stood.
    """

    command: Command
    exchange: Exchange
    asked: float
    start: motion.Sample
    end: motion.Sample

    @property
    def degrees(self) -> float:
        """How far the shaft went, signed."""
        return self.end.value - self.start.value

    @property
    def statuses(self) -> list[int]:
        """What the replies said, in order."""
        return self.exchange.status(self.command.replies.status)


def follow(
    probe: Probe,
    command: Command,
    degrees: float,
    *,
    rpm: float = CALM,
    acceleration: int = QUICK,
    subdivision: int = SUBDIVISION,
    **how: Any,
) -> Move:
    """Move by so many degrees and follow the shaft until it stands.

    Raises Inconclusive where the move is refused or the shaft does not come to rest.
    """
    start = motion.position(probe)
    tells = declared.of(command).tells_end
    turn = declared.units_per_turn(probe.dialect, command, subdivision)
    asked = round(degrees * turn / 360) * 360 / turn
    how |= {"rpm": rpm, "acceleration": acceleration, "subdivision": subdivision}
    exchange = motion.ask(probe, command, degrees, until=Until.DONE if tells else Until.REPLY, **how)
    if motion.refused(probe, exchange) and not (tells and len(exchange.answers) > 1):
        raise Inconclusive(f"{command.name} was refused")
    if not tells and probe.dialect.ramp is None:
        _wait_set_off(probe, start, asked)
    elif not tells:
        probe.wait(int(ramp.move_ns(asked / 360, rpm, acceleration)))
    return Move(command, exchange, asked, start, motion.wait_standing(probe))


def _wait_set_off(probe: Probe, start: motion.Sample, degrees: float) -> None:
    """Wait until a shaft is on its way: a degree from where it stood, or half of what it was asked for."""
    least = min(1.0, abs(degrees) / 2) + motion.same(probe)
    motion.wait_until(probe, lambda: abs(motion.position(probe).value - start.value) > least, limit_ns=_SET_OFF_NS)


def come_to_rest(probe: Probe, exchange: Exchange, least_ns: int, most_ns: int) -> motion.Sample:
    """Wait until a motion of at least and at most so long, from its request on, is over; return where the shaft stands.

    Nothing is asked before its end is told, where it is: a request could run into that. A shaft that goes on is stopped.
    """
    command = exchange.command
    assert command is not None  # it was asked for
    until_ns, since = exchange.sent_ns + most_ns + TOLD_LATE_NS, len(probe.traffic)
    if declared.of(command).tells_end:
        final = command.replies.final
        while not final.intersection(statuses([exchange, *probe.traffic[since:]], command)) and probe.gate.now_ns() < until_ns:
            probe.listen(until_ns - probe.gate.now_ns(), Until.REPLY)
    probe.wait(exchange.sent_ns + least_ns - probe.gate.now_ns())
    while abs(motion.speed(probe).value) >= CALM / 2:
        if probe.gate.now_ns() >= until_ns:
            return motion.stand_still(probe)
        probe.wait(motion.QUIET_LOOK_NS)
    try:
        return motion.wait_standing(probe, limit_ns=max(0, until_ns - probe.gate.now_ns()) + _SOON_NS)
    except Inconclusive:
        return motion.stand_still(probe)


def replies(exchanges: Iterable[Exchange], command: Command) -> list[Answer]:
    """Return the answers with a status to a command in several exchanges, in the order in which they came."""
    code, status = command.code, command.replies.status
    found = (a for e in exchanges for a in e.answers if a.command is not None and a.command.code == code and status in a.values)
    return sorted(found, key=lambda answer: answer.last_ns)


def statuses(exchanges: Iterable[Exchange], command: Command) -> list[int]:
    """Return the statuses of those answers."""
    return [answer.values[command.replies.status] for answer in replies(exchanges, command)]


def tells_end(dialect: Dialect) -> bool:
    """Say whether the end of a move is told by a reply of its own."""
    return any(declared.of(command).tells_end for command in dialect.motions(*MOVES))
