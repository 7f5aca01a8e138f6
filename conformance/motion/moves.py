"""Journeys: one move of an MKS drive, by any of its four commands, asked for and followed to its end.

    journey = travel(probe, command, 1 / 4)        a quarter of a turn, by pulses or counts, relative or absolute
    journey.degrees                                how far the shaft went
    journey.statuses                               what was answered, in order

A dialect that tells the end of a move by a reply (native, CAN) is listened to; with one that does not (Modbus) the shaft is
watched. Either way the end of a journey is a shaft that stands.

Rules kept here:
- Amounts are in the command's own unit, signed; `direction` is the sign of a command that has one, 0 being positive.
- An absolute move goes from where the drive says that it is, so that nothing depends on its zero.
- What does not work raises Inconclusive: a claim about it judges it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.claim import Inconclusive
from conformance.motion import motion, ramp
from conformance.motion.motion import MS, SECOND_NS, Sample
from conformance.talk.exchange import Answer, Exchange
from conformance.talk.probe import Until

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

MOVES = (Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_ABSOLUTE_PULSES, Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS)
#: Each run or move and the stop that belongs to it.
STOP_OF: Mapping[Verb, Verb] = {
    Verb.RUN_SPEED: Verb.STOP_SPEED,
    Verb.MOVE_RELATIVE_PULSES: Verb.STOP_RELATIVE_PULSES,
    Verb.MOVE_ABSOLUTE_PULSES: Verb.STOP_ABSOLUTE_PULSES,
    Verb.MOVE_RELATIVE_AXIS: Verb.STOP_RELATIVE_AXIS,
    Verb.MOVE_ABSOLUTE_AXIS: Verb.STOP_ABSOLUTE_AXIS,
}
#: Full steps of a turn, and the subdivision at which the suite counts pulses.
STEPS_PER_TURN = 200
SUBDIVISION = 16
#: Where each absolute move counts from.
_COUNTED: Mapping[Verb, Verb] = {Verb.MOVE_ABSOLUTE_PULSES: Verb.READ_PULSES, Verb.MOVE_ABSOLUTE_AXIS: Verb.READ_POSITION}
#: So much farther than where it stands a claim may send the shaft, in units: no claim goes more than twenty turns.
_ROOM = 400_000
#: What a journey takes longer than the law at most before it is given up.
_PATIENCE = 1.5
_GRACE_NS = 3 * SECOND_NS


def is_mks(dialect: Dialect) -> bool:
    """Say whether a dialect has the four moves and the ramp of the MKS drives."""
    return dialect.family == "mks"


def tells(dialect: Dialect) -> bool:
    """Say whether the end of a move is told by a reply of its own."""
    return any(c.motion is not None and c.motion.tells_end for c in moves(dialect))


def moves(dialect: Dialect) -> tuple[Command, ...]:
    """Return the moves of a dialect, in the manual's order."""
    return tuple(c for c in dialect.commands if c.verb in MOVES)


def by_pulses(command: Command) -> bool:
    """Say whether a move counts in pulses, not in counts of the encoder."""
    return command.verb in (Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_ABSOLUTE_PULSES)


def is_absolute(command: Command) -> bool:
    """Say whether a move goes to a place, not by a distance."""
    return command.verb in _COUNTED


def units_per_turn(command: Command, subdivision: int = SUBDIVISION) -> int:
    """Return how many of a move's units make a turn."""
    return STEPS_PER_TURN * subdivision if by_pulses(command) else COUNTS_PER_TURN


def widest(command: Command) -> int:
    """Return the largest speed that the bits of a run or move can hold."""
    return command.request_forms[0].layout.named["speed"].wire_maximum


def values_of(command: Command, amount: int, speed: int, acceleration: int, base: int = 0) -> dict[str, int]:
    """Return the values of a move by `amount` units from `base` (of absolute moves)."""
    named = command.request_forms[0].layout.named
    values = {"speed": speed, "acceleration": acceleration}
    if "pulses" in named:
        return values | {"direction": int(amount < 0), "pulses": abs(amount)}
    return values | {"position": base + amount if is_absolute(command) else amount}


def place(probe: Probe, command: Command) -> int:
    """Return where the shaft is in the unit of an absolute move; 0 for a relative one."""
    verb = _COUNTED.get(command.verb)
    if verb is None:
        return 0
    read = probe.command(verb)
    now = probe.read(read, next(iter(read.reply_forms[0].layout.named)))
    target = command.request_forms[0].layout.named["position"]
    if not target.low + _ROOM <= now <= target.high - _ROOM:
        raise Inconclusive(f"{read.name} reads {now}, from where {command.name} cannot go on")
    # A gate that bounds turns has to know where the shaft is.
    degrees = motion.position(probe).value
    probe.gate.note_position(degrees, probe.address, now if by_pulses(command) else None)
    return now


def prepare(probe: Probe, command: Command | None = None) -> None:
    """Make a drive ready for a command; one that counts pulses gets the subdivision of the suite."""
    pulses = command is not None and by_pulses(command)
    motion.ready_to_move(probe, subdivision=SUBDIVISION if pulses else None)


# --- a move and its end -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Journey:
    """A move that was followed to its end. `start`, `end`: where the shaft stood. `exchange`: the request and its replies."""

    command: Command
    exchange: Exchange
    start: Sample
    end: Sample

    @property
    def degrees(self) -> float:
        """How far the shaft went, signed."""
        return self.end.value - self.start.value

    @property
    def statuses(self) -> list[int]:
        """What the replies said, in order."""
        return self.exchange.status(self.command.replies.status)


def refused(probe: Probe, exchange: Exchange) -> bool:
    """Say whether a motion was refused. Raises Inconclusive where there is no readable answer."""
    probe.reply(exchange)
    return probe.refused(exchange)


def ask(
    probe: Probe,
    command: Command,
    turns: float = 0.0,
    *,
    speed: int = 120,
    acceleration: int = motion.GENTLE,
    amount: int | None = None,
    subdivision: int = SUBDIVISION,
    until: Until = Until.REPLY,
    quiet_ns: int | None = None,
) -> Exchange:
    """Ask for a move by `turns` (or by `amount` units) and return what came back, whatever it is."""
    units = round(turns * units_per_turn(command, subdivision)) if amount is None else amount
    values = values_of(command, units, speed, acceleration, place(probe, command))
    limit_ns = None
    if until is Until.DONE:
        limit_ns = patience_ns(units / units_per_turn(command, subdivision), speed, acceleration)
    return probe.ask(command, values, until=until, timeout_ns=limit_ns, quiet_ns=quiet_ns)


def begin(probe: Probe, command: Command, turns: float, **how: Any) -> Exchange:
    """Ask for a move, as `ask` does. Raises Inconclusive where it is refused or not answered."""
    exchange = ask(probe, command, turns, **how)
    if refused(probe, exchange):
        raise Inconclusive(f"{command.name} was refused")
    return exchange


def patience_ns(turns: float, speed: float, acceleration: int) -> int:
    """Return how long a move is waited for."""
    return int(ramp.move_ns(turns, speed, acceleration) * _PATIENCE) + _GRACE_NS


def travel(
    probe: Probe,
    command: Command,
    turns: float = 0.0,
    *,
    speed: int = 120,
    acceleration: int = motion.GENTLE,
    amount: int | None = None,
    subdivision: int = SUBDIVISION,
) -> Journey:
    """Move by `turns` (or by `amount` units) and follow the shaft until it stands.

    Raises Inconclusive where the move is refused or the shaft does not come to rest.
    """
    start = motion.position(probe)
    per_turn = units_per_turn(command, subdivision)
    units = round(turns * per_turn) if amount is None else amount
    telling = tells(probe.dialect)
    until = Until.DONE if telling else Until.REPLY
    how: dict[str, Any] = {"speed": speed, "acceleration": acceleration, "amount": units, "subdivision": subdivision}
    exchange = ask(probe, command, until=until, **how)
    if refused(probe, exchange) and not (telling and len(exchange.answers) > 1):
        raise Inconclusive(f"{command.name} was refused")
    if not telling:
        probe.wait(int(ramp.move_ns(units / per_turn, speed, acceleration)))
    return Journey(command, exchange, start, motion.wait_standing(probe))


def pair(probe: Probe, command: Command, there: int, back: int) -> tuple[Journey, Journey]:
    """Make a drive ready and travel by `there` units and then by `back` units."""
    prepare(probe, command)
    return travel(probe, command, amount=there), travel(probe, command, amount=back)


# --- replies that come while others are asked for ---------------------------------------------------------------------


def told(exchanges: list[Exchange], command: Command) -> list[Answer]:
    """Return the answers to a command in several exchanges, in the order in which they came."""
    found = [a for e in exchanges for a in e.answers if a.command is not None and a.command.code == command.code]
    return sorted((a for a in found if command.replies.status in a.values), key=lambda a: a.last_ns)


def watch(probe: Probe, look: Callable[[], bool], *, every_ns: int = 20 * MS, limit_ns: int = 20 * SECOND_NS) -> None:
    """Call `look` again and again until it says True or the time is over."""
    until_ns = probe.gate.now_ns() + limit_ns
    while not look() and probe.gate.now_ns() < until_ns:
        probe.wait(every_ns)
