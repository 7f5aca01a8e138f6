"""Ranges of motion commands that can be refused: limits of speed, acceleration and distance, and that all their bits count.

Other than with a setting, a speed above the limit is no mistake: the drive runs at the highest speed of its work mode and
answers success. The manual's table of modes says which speed that is (CAN has none: 3000 rpm).

Rules kept here:
- A move to a far place is begun slowly and stopped after a turn at most; the claim judges whether it was begun.
- Speeds are those of the shaft at 16 subdivisions.
- Distances go from where the shaft is, absolute places too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk
from analyzer.layout import Field, FieldKind
from conformance.claim import Aspect, Inconclusive
from conformance.claims.declare import Case
from conformance.claims.known_quirks import LATE, may_meet
from conformance.claims.motion.speed_limits import expect_spun
from conformance.claims.ranges import edges
from conformance.claims.ranges.edges import of_ranges
from conformance.claims.requests import with_reserved
from conformance.model import limits
from conformance.motion import declared, motion
from conformance.motion.declared import QUICK, RUNS_AND_MOVES, SUBDIVISION
from conformance.talk.acceptance import can_refuse, expect_accepted, expect_refused
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe, Until

#: How slow a move is whose distance does not matter, and how steep the ramp of one that is to reach a high speed. (Not 250:
#: that byte begins a frame, and what follows it would have to be allowed as one.)
SLOW, STEEP = 10, 252
#: How long a move at 300 rpm is watched that is to go half a turn.
_WAY_NS = 150 * MS
#: From the highest speed a stop takes 1.2 s by the law; one that does nothing is not waited for as a long move is.
_STOPS_NS = 5000 * MS
#: A speed both bytes of which are filled, and what is left of one of which a drive drops the highest bit.
_TWO_BYTE_RPM, _LEFT = 257, 60


def turns(command: Command) -> bool:
    """Say whether a command is a run, a move or the stop of one by a ramp, and can be refused."""
    moving = command.motion
    kinds = (*RUNS_AND_MOVES, MotionKind.STOP)
    return can_refuse(command) and moving is not None and moving.kind in kinds and bool(moving.acceleration)


def _commands(dialect: Dialect) -> Iterator[Command]:
    return (command for command in dialect.commands if turns(command))


def _runs(dialect: Dialect) -> Iterator[Command]:
    return (command for command in _commands(dialect) if declared.of(command).kind in RUNS_AND_MOVES)


def _needs(dialect: Dialect, command: Command, *, stands: bool = False) -> dict[str, Any]:
    """Return what a claim must declare that begins a motion; `stands`: only at speed 0."""
    more = {Risk.UNBOUNDED} if declared.of(command).kind is MotionKind.RUN and not stands else set()
    return {"risks": declared.risks(dialect, *more), "settings": declared.settings(dialect)}


# --- moving -----------------------------------------------------------------------------------------------------------


def _values(probe: Probe, command: Command, **changed: int) -> dict[str, int]:
    """Return a slow move of a tenth of a turn (a run, a stop) with some values changed."""
    moving = declared.of(command)
    values: dict[str, int] = dict.fromkeys(command.request_forms[0].layout.named, 0) | {"acceleration": QUICK}
    if moving.kind is not MotionKind.STOP:
        values["speed"] = SLOW
    if moving.distance:
        tenth = declared.units_per_turn(probe.dialect, command) // 10
        values[moving.distance] = tenth if moving.direction else motion.place(probe, command) + tenth
    return values | changed


def _end(probe: Probe, command: Command) -> None:
    """Stop what a command began, and wait until the shaft stands."""
    stops = probe.dialect.stops_of(command)
    if stops:
        # The end of a stop is told unasked: a request that is sent meanwhile would collide with it.
        probe.ask(stops[0], {"acceleration": QUICK}, until=Until.DONE, timeout_ns=_STOPS_NS)
    motion.wait_standing(probe, stopped=bool(stops))


def _ready(probe: Probe, mode: str = "") -> None:
    """Make the drive ready, at a subdivision at which the shaft turns at the speed as sent."""
    motion.ready_to_move(probe, mode, subdivision=SUBDIVISION)


# --- accepted and refused ---------------------------------------------------------------------------------------------


def _allowed(dialect: Dialect) -> Iterator[Case]:
    for command in _commands(dialect):
        for field in edges.fields(command):
            rests_on = (Doubt.LIMITS,) if field.name in ("speed", "position") else ()
            for where, values in edges.allowed(field).items():
                needs = _needs(dialect, command, stands=field.name == "speed" and values == (0,))
                yield edges.case(dialect, command, field, where, values, rests_on=rests_on, **needs)


def _forbidden(dialect: Dialect) -> Iterator[Case]:
    for command in _commands(dialect):
        for field in edges.fields(command):
            rests_on = (Doubt.LIMITS,) if field.name == "position" else ()
            for where, values in edges.forbidden(dialect, command, field, far=False).items():
                if (field.name, where) != ("speed", "above"):
                    yield edges.case(dialect, command, field, where, values, rests_on=rests_on, **_needs(dialect, command))


@of_ranges(each=_allowed, refuted_by="a refusal")
def _accepted(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """{where} of {field} is accepted."""
    _ready(probe)
    for value in edges.tried(probe, command, field, values):
        expect_accepted(probe, command, _values(probe, command, **{field.name: value}), edges.text(field, value))
        _end(probe, command)


@of_ranges(each=_forbidden, refuted_by="success, silence, or a shaft that moves", at_best=Certainty.LIKELY)
def _refused(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """{where} of {field} is refused."""
    _ready(probe)
    start = motion.position(probe)
    for value in values:
        built = probe.build(command, _values(probe, command, **{field.name: value}))
        exchange = expect_refused(probe, built, edges.text(field, value))
        probe.wait(50 * MS)
        gone = motion.position(probe).value - start.value
        probe.expect(
            f"{gone:+.1f} deg",
            holds=abs(gone) <= 1 + probe.noise.place,
            expected="a shaft that stays",
            refutes=f"{command.name}: {edges.text(field, value)} is refused and moves the shaft",
            exchange=exchange,
            key=f"{command.name} refused and moved",
        )


def _with_reserved_bits(dialect: Dialect) -> Iterator[Case]:
    for command in _runs(dialect):
        masks = limits.reserved_masks(command.request_forms[0].layout)
        if masks:
            yield Case(dialect, command, {"masks": masks}, _needs(dialect, command))


@of_ranges(each=_with_reserved_bits, refuted_by="a refusal, or another speed", at_best=Certainty.OPEN, aspect=Aspect.RANGE)
def _reserved(probe: Probe, command: Command, masks: tuple[int, ...]) -> None:
    """Reserved bits of a motion change nothing."""
    _ready(probe)
    for mask in masks:
        exchange = probe.ask_built(with_reserved(probe, command, command.request_forms[0], _values(probe, command), mask))
        probe.reply(exchange)
        refused = probe.refused(exchange)
        probe.wait(200 * MS)
        rpm = abs(motion.speed(probe).value)
        _end(probe, command)
        got = "a refusal" if refused else f"{rpm:.0f} rpm"
        probe.expect(
            got,
            holds=not refused and abs(rpm - SLOW) <= 1 + probe.within("rpm", SLOW) + SLOW * CLOCK_SHARE,
            expected=f"{SLOW} rpm",
            refutes=f"{command.name} with the reserved bit {mask:#x}: {got}",
            exchange=exchange,
        )


# --- speeds -----------------------------------------------------------------------------------------------------------


def _with_speed(dialect: Dialect) -> Iterator[tuple[Command, Field]]:
    for command in _runs(dialect):
        yield command, command.request_forms[0].layout.named["speed"]


def too_fast(field: Field) -> tuple[int, ...]:
    """Return two speeds above a field's highest: one of which little is left in fewer bits, or with a sign, and its last."""
    left = (1 << field.bit_width - 1) + _LEFT
    return (left, field.wire_maximum) if left > field.high else edges.above(field)


def _too_fast(dialect: Dialect) -> Iterator[Case]:
    for command, field in _with_speed(dialect):
        values = too_fast(field)
        if values:
            yield edges.case(dialect, command, field, "above", values, **_needs(dialect, command))


@of_ranges(
    each=_too_fast,
    refuted_by="a refusal, or another speed",
    statement=lambda case: f"A speed above {case['field'].high} runs at the highest of the mode.",
    rests_on=(Doubt.LIMITS,),
    quirks=may_meet(LATE),
)
def _clipped(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    mode = declared.bus_modes(probe.dialect)[-1]
    for value in values:
        expect_spun(probe, command, value, mode, probe.dialect.mode_speeds.get(mode, field.high))


def _speeds(dialect: Dialect) -> Iterator[Case]:
    for command, field in _with_speed(dialect):
        yield edges.case(dialect, command, field, "width", (), parameters={"field": "speed"}, **_needs(dialect, command))


@of_ranges(each=_speeds, refuted_by="the speed of its low byte alone", quirks=may_meet(LATE))
def _speed_width(probe: Probe, command: Command) -> None:
    """All bits of a speed count."""
    expect_spun(probe, command, _TWO_BYTE_RPM, declared.bus_modes(probe.dialect)[-1], _TWO_BYTE_RPM)


# --- distances --------------------------------------------------------------------------------------------------------


def _distances(dialect: Dialect) -> Iterator[Case]:
    """Yield distances of 256^n and a little: without the high bytes, a little is left; and one that read signed is below 0."""
    for command in _runs(dialect):
        if declared.of(command).distance:
            field = declared.field_of(command, declared.of(command).distance)
            signs = (1, -1) if field.kind is FieldKind.INT else (1,)
            little = declared.units_per_turn(dialect, command) // 64
            shifts = range(8, field.bit_width - (len(signs) - 1), 8)
            values = tuple(s * ((1 << shift) + little) for s in signs for shift in shifts)
            if len(signs) == 1:
                values += ((1 << field.bit_width) - little,)
            yield edges.case(dialect, command, field, "width", values, **_needs(dialect, command))


@of_ranges(each=_distances, refuted_by="a move by what its low bytes say")
def _distance_width(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """All bytes of {field} count, and its sign."""
    units = declared.units_per_turn(probe.dialect, command)
    _ready(probe)
    ways: set[bool] = set()
    for distance in values:
        start = motion.place(probe, command)
        if not field.low <= start + distance <= field.high:
            raise Inconclusive(f"from {start} no move by {distance} fits the field")
        before = motion.position(probe)
        asked = _values(probe, command, speed=300, acceleration=STEEP, **{field.name: start + distance})
        exchange = expect_accepted(probe, command, asked, f"a distance of {distance}")
        probe.wait(_WAY_NS)
        gone = (motion.position(probe).value - before.value) / 360 * units
        _end(probe, command)
        least = min(abs(distance), units // 2)
        ways.add(gone * distance > 0)
        probe.expect(
            f"{gone:.0f}",
            holds=least * 0.95 <= abs(gone) <= abs(distance) * 1.05 + units * 0.01 and len(ways) == 1,
            expected=f"{least} or more, and the other way for the other sign",
            refutes=f"{command.name} by {distance} {field.unit} moves the shaft by {gone:.0f} in the first {_WAY_NS // MS} ms",
            exchange=exchange,
            key=f"{command.name} width",
        )
