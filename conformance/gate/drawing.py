"""Room: what bounds leave of a field's values, so that what may not be sent is never drawn.

    span(field, Room(Bounds(speed=300)), command)      first and last value, as sent, that manual and bounds allow

    speed           fields in rpm or deg/s       a speed limit of 0 may mean that there is none: it is left out
    turns           pulses, counts, degrees      a move to a place from where the shaft is, if that is known
    acceleration    as sent, 1..255              0 changes the speed at once, which is more than any
    current         mA, A once the model is known; numbers of another unit have no room

Rules kept here:
- The same rules as those of the gate (`conformance.gate.bounds`), seen from the other side: what is drawn here it lets pass.
- A subdivision that is not known counts as the one that makes the most of a number: 1.
- Without a bound nothing is narrowed.

Not known here: which risks are allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil, floor

from analyzer.catalogue import Command, Form, Verb
from analyzer.layout import Field
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.gate.bounds import MOVES, OWN_WAYS, PLAIN_SUBDIVISIONS, RUNS, SPEED_SUBDIVISION, STEPS_PER_TURN, Bounds

#: First and last of a stretch of values, as sent; empty where the first is higher.
Span = tuple[int, int]
EMPTY: Span = (1, 0)

_WIDEST = 256
_TO_A_PLACE = (Verb.MOVE_ABSOLUTE_PULSES, Verb.MOVE_ABSOLUTE_AXIS)


@dataclass(frozen=True)
class Room:
    """Bounds, and what is known of the drive that they are for.

    `subdivision`: what it is set to (0 is 256). `degrees`: where its shaft is over all turns; `pulses`: its count of them.
    None: not known.
    """

    bounds: Bounds = field(default_factory=Bounds)
    subdivision: int | None = None
    degrees: float | None = None
    pulses: int | None = None

    @property
    def speed_factor(self) -> Fraction:
        """Rpm of the shaft for one rpm as sent."""
        known = 1 if self.subdivision is None else self.subdivision or _WIDEST
        return Fraction(1) if known in PLAIN_SUBDIVISIONS else Fraction(SPEED_SUBDIVISION, known)

    @property
    def pulses_per_turn(self) -> int:
        """Pulses of one turn of the shaft, at the least."""
        return STEPS_PER_TURN * (1 if self.subdivision is None else self.subdivision or _WIDEST)


ROOMY = Room()


def span(declared: Field, room: Room = ROOMY, command: Command | None = None) -> Span:
    """Return the first and last value of a field, as sent, that manual and bounds allow. `command`: the one that has it."""
    low, high = declared.low, declared.high
    for rule in (_speed, _turns, _acceleration, _current):
        narrowed = rule(declared, room, command)
        if narrowed is not None:
            low, high = max(low, narrowed[0]), min(high, narrowed[1])
    return (low, high) if low <= high else EMPTY


def untold(command: Command, form: Form, bounds: Bounds) -> bool:
    """Say whether a bound is about something that a request moves by and does not tell, so that nothing of it may be sent."""
    moves = command.verb in MOVES | RUNS | OWN_WAYS
    if not moves:
        return False
    fields = form.layout.named.values()
    speed = any(f.unit in ("rpm", "deg/s") and f.fixed is None for f in fields)
    if bounds.speed is not None and not speed:
        return True
    return bounds.turns is not None and command.verb is Verb.MOVE_SINGLE_TURN and bounds.turns < 1


# --- one rule for each bound ------------------------------------------------------------------------------------------


def _even(limit: Fraction) -> Span:
    return -floor(limit), floor(limit)


def _speed(declared: Field, room: Room, command: Command | None) -> Span | None:
    bound = room.bounds.speed
    if bound is None or declared.unit not in ("rpm", "deg/s"):
        return None
    if declared.unit == "rpm":
        return _even(Fraction(bound) / room.speed_factor)
    low, high = _even(Fraction(bound) * 6 / declared.scale)
    return (1, high) if declared.name == "max_speed" else (low, high)


def _turns(declared: Field, room: Room, command: Command | None) -> Span | None:
    turns = room.bounds.turns
    per_turn = _PER_TURN.get(declared.unit)
    moves = command is None or command.verb in MOVES
    if turns is None or per_turn is None or declared.name not in ("pulses", "position") or not moves:
        return None
    units = per_turn(declared, room)
    reach = Fraction(turns) * units
    if command is None or command.verb not in _TO_A_PLACE:
        return _even(reach)
    at = room.pulses if declared.unit == "pulses" else room.degrees
    if at is None:
        return EMPTY
    here = Fraction(at) if declared.unit == "pulses" else Fraction(at) * units / 360
    return ceil(here - reach), floor(here + reach)


_PER_TURN: Mapping[str, Callable[[Field, Room], Fraction]] = {
    "pulses": lambda declared, room: Fraction(room.pulses_per_turn),
    "counts": lambda declared, room: Fraction(COUNTS_PER_TURN),
    "deg": lambda declared, room: 360 / declared.scale,
}


def _acceleration(declared: Field, room: Room, command: Command | None) -> Span | None:
    bound = room.bounds.acceleration
    if bound is None or declared.name != "acceleration":
        return None
    return 1, floor(bound)


def _current(declared: Field, room: Room, command: Command | None) -> Span | None:
    bound = room.bounds.current
    if bound is None or not _is_current(declared):
        return None
    if declared.unit not in ("mA", "A"):
        return EMPTY
    return _even(Fraction(bound) / (1 if declared.unit == "mA" else 1000) / declared.scale)


def _is_current(declared: Field) -> bool:
    named = declared.name.endswith("current") or declared.name in ("torque_limit", "power")
    return declared.unit == "mA" or named
