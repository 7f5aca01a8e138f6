"""Ranges of motion commands that have no reply that refuses (LK): the shaft shows what the drive obeys.

    torque, power        obeyed within the limits, not obeyed beyond: the shaft stays
    speeds, distances    the limits of the type are obeyed, in the direction of their sign
    angle, direction     0 to 359.99 degrees are reached by both listed directions; others are not obeyed
    brake                a value that is not listed switches nothing
    models               a motor has the torque of an MF, MG or MH, or the power of an MS, and not both

Rules kept here:
- A motion that is to show that it was obeyed is watched for a moment and stopped.
- Moves with a speed limit are given 60 rpm.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import log2
from typing import Any

from analyzer import encoder
from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk, Verb
from analyzer.layout import Effect, Field
from conformance.claim import Aspect, Inconclusive
from conformance.claims.declare import Case
from conformance.claims.ranges import edges
from conformance.claims.ranges.edges import of_ranges
from conformance.claims.requests import with_reserved
from conformance.model import limits
from conformance.model.lk_parameters import need_room
from conformance.motion import declared, motion
from conformance.talk.acceptance import can_refuse
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe

ZERO_SPEED = "lk-zero-speed-moves"
_TURN = 36_000
#: 60 rpm as sent, and 116 rpm, which needs more than 16 bits.
_MODERATE, _WIDE = 36_000, 70_000
#: How long a motion is watched.
_WATCH_NS = 60 * MS
#: A move whose speed is measured on its way is over by then.
_LATE_NS = 500 * MS
#: A shaft that went less than this (deg) stayed where it was; one that went less than `_LEAST` did not obey.
_STILL, _LEAST = 1.0, 0.05
#: Two angles (deg) that differ by less are one.
_SAME = 0.3
_MOVES = (MotionKind.MOVE_BY, MotionKind.MOVE_TO)


def _motions(dialect: Dialect, *kinds: MotionKind) -> Iterator[Command]:
    """Yield the motions of these kinds whose replies cannot say that they were refused."""
    return (command for command in dialect.motions(*kinds) if not can_refuse(command))


def _speed_limits(dialect: Dialect) -> Iterator[tuple[Command, Field]]:
    for command in _motions(dialect, *_MOVES, MotionKind.MOVE_IN_TURN):
        if declared.of(command).speed:
            yield command, declared.field_of(command, declared.of(command).speed)


def _needs(dialect: Dialect, command: Command) -> dict[str, Any]:
    return {"risks": declared.risks(dialect, *command.all_risks)}


# --- what is seen of a motion -----------------------------------------------------------------------------------------


def _values(command: Command, **values: int) -> dict[str, int]:
    """Return values of a motion, with a moderate speed where it has a speed limit."""
    moving = declared.of(command)
    limit = moving.speed if moving.kind is not MotionKind.RUN else ""
    return ({limit: _MODERATE} if limit else {}) | values


def _begun(probe: Probe, command: Command, values: Mapping[str, int]) -> tuple[float, Exchange]:
    """Ask a standing shaft for a motion, watch it for a moment, and stop; return how far it went (deg).

    Raises Inconclusive where it is not answered.
    """
    start = motion.position(probe)
    exchange = probe.ask(command, values)
    probe.reply(exchange)
    probe.wait(_WATCH_NS)
    gone = motion.position(probe).value - start.value
    motion.stand_still(probe)
    return gone, exchange


def _expect_obeyed(probe: Probe, command: Command, values: Mapping[str, int], shown: str, sign: int) -> None:
    gone, exchange = _begun(probe, command, values)
    probe.expect(
        "a shaft that stays" if abs(gone) < _LEAST else f"{gone:+.2f} deg",
        holds=gone * sign >= _LEAST,
        expected=f"a shaft that turns {'clockwise' if sign > 0 else 'counter-clockwise'}",
        refutes=f"{command.name}: {shown} is not obeyed",
        exchange=exchange,
        key=f"{command.name} not obeyed",
    )


def _expect_ignored(probe: Probe, command: Command, gone: float, shown: str, exchange: Exchange) -> None:
    probe.expect(
        f"{gone:+.2f} deg",
        holds=abs(gone) <= _STILL,
        expected="a shaft that stays: the manual does not allow it",
        refutes=f"{command.name}: {shown} is obeyed",
        exchange=exchange,
        key=f"{command.name} obeyed",
    )


def _expect_all_bytes(probe: Probe, command: Command, field: Field, value: int, rpm: float, exchange: Exchange) -> None:
    """Refute where a speed is nearer to what the low 16 bits say than to what was sent."""
    expected, low = abs(value) / 600, (abs(value) & 0xFFFF) / 600
    probe.expect(
        f"{rpm:.1f} rpm; the low 16 bits say {low:.1f}",
        holds=abs(rpm) >= (expected + low) / 2,
        expected=f"about {expected:.0f} rpm",
        refutes=f"{command.name}: with {field.name} {value} the shaft turns at {rpm:.1f} rpm",
        exchange=exchange,
        key=f"{command.name} speed",
    )


# --- torque, power, speeds, distances: numbers with a sign ------------------------------------------------------------


def _signed(dialect: Dialect) -> Iterator[tuple[Command, Field]]:
    """Yield the fields whose sign is the direction."""
    for command in _motions(dialect, MotionKind.TORQUE):
        for field in edges.fields(command):
            if field.effect is Effect.CURRENT:
                yield command, field
    for command in _motions(dialect, MotionKind.RUN):
        yield command, command.request_forms[0].layout.named["speed"]
    for command in _motions(dialect, *_MOVES):
        yield command, declared.field_of(command, declared.of(command).distance)


def _within(dialect: Dialect) -> Iterator[Case]:
    for command, field in _signed(dialect):
        # A shaft needs more than a little torque to move. Of a power of two a field that is narrowed leaves nothing.
        quarter = 1 << round(log2(field.high / 4))
        inside = (-quarter, quarter)
        for where, values in (("lowest", (field.low,)), ("highest", (field.high,)), ("inside", inside)):
            yield edges.case(dialect, command, field, where, values, **_needs(dialect, command))


@of_ranges(each=_within, refuted_by="a shaft that stays, or turns the other way", rests_on=(Doubt.SIGN,))
def _obeyed(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """{where} of {field} is obeyed, its sign the direction."""
    for value in values:
        motion.ready_to_move(probe)
        asked = _values(command, **{field.name: value})
        _expect_obeyed(probe, command, asked, f"{field.name} {value}", 1 if value > 0 else -1)


def _beyond(dialect: Dialect) -> Iterator[Case]:
    for command, field in _signed(dialect):
        for where, values in (("below", edges.below(field)), ("above", edges.above(field))):
            if values:
                case = edges.case(dialect, command, field, where, values, **_needs(dialect, command))
                yield Case(dialect, command, {**case.given, "where": where}, case.facts)


@of_ranges(each=_beyond, refuted_by="a shaft that turns", at_best=Certainty.LIKELY)
def _ignored(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """A {field} {where} the limit is not obeyed."""
    motion.ready_to_move(probe)
    gone, _ = _begun(probe, command, {field.name: field.high // 4})
    if abs(gone) < _LEAST:
        raise Inconclusive(f"{command.name} turns nothing, so nothing can be said of values that it ignores")
    for value in values:
        gone, exchange = _begun(probe, command, {field.name: value})
        _expect_ignored(probe, command, gone, f"{field.name} {value}", exchange)


def _far(dialect: Dialect) -> Iterator[Case]:
    """Yield distances of 256^n: without a high byte nothing is left."""
    for command in _motions(dialect, *_MOVES):
        field = declared.field_of(command, declared.of(command).distance)
        shifts = range(16, field.bit_width - 1, 8)
        values = tuple(s * (1 << n) for n in shifts for s in (1, -1) if (1 << n) <= field.high)
        facts = {"risks": declared.risks(dialect, Risk.SETTING), "settings": ("position",)}
        yield edges.case(dialect, command, field, "width", values, **facts)


@of_ranges(each=_far, refuted_by="a move by what its low bytes say")
def _distance_width(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """All bytes of {field} count."""
    for distance in values:
        motion.ready_to_move(probe)
        probe.do("set_position", {"position": 0})
        asked = _values(command, **{field.name: distance})
        _expect_obeyed(probe, command, asked, f"{field.name} {distance}", 1 if distance > 0 else -1)


def _speeds(dialect: Dialect) -> Iterator[Case]:
    for command in _motions(dialect, MotionKind.RUN):
        field = command.request_forms[0].layout.named["speed"]
        yield edges.case(dialect, command, field, "width", (_WIDE, -_WIDE), **_needs(dialect, command))


@of_ranges(each=_speeds, refuted_by="the speed of its low bytes alone")
def _speed_width(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """All bytes of a speed count."""
    for value in values:
        motion.ready_to_move(probe)
        exchange = probe.ask(command, {field.name: value}, quiet_ns=0)
        probe.reply(exchange)
        probe.wait(600 * MS)
        rpm = motion.speed(probe).value
        motion.stand_still(probe)
        _expect_all_bytes(probe, command, field, value, rpm, exchange)


# --- speed limits of moves --------------------------------------------------------------------------------------------


def _at_limit(where: str, value: int | None = None) -> Any:
    def cases(dialect: Dialect) -> Iterator[Case]:
        for command, field in _speed_limits(dialect):
            more = (Risk.SETTING,) if command.verb is Verb.MOVE_ABSOLUTE_AXIS else ()
            facts = {"risks": declared.risks(dialect, *more), "settings": ("position",) if more else ()}
            yield edges.case(dialect, command, field, where, (field.high if value is None else value,), **facts)

    return cases


def _move(probe: Probe, command: Command, field: Field, limit: int) -> dict[str, int]:
    """Return a move of two turns by a speed limit; within a turn, of nearly one."""
    moving = declared.of(command)
    if moving.kind is MotionKind.MOVE_IN_TURN:
        now = probe.read(moving.counted_by)
        return {moving.direction: 0, moving.distance: (now - 2000) % _TURN, field.name: limit}
    if moving.kind is MotionKind.MOVE_TO:
        need_room(probe)
        probe.do("set_position", {"position": 0})
    return {moving.distance: 2 * _TURN, field.name: limit}


@of_ranges(each=_at_limit("highest"), refuted_by="a shaft that stays")
def _highest_limit(probe: Probe, command: Command, field: Field) -> None:
    """The highest {field} is obeyed, and the highest power of two, of which a narrowed field leaves nothing."""
    for limit in (field.high, 1 << field.bit_width - 1):
        motion.ready_to_move(probe)
        _expect_obeyed(probe, command, _move(probe, command, field, limit), f"{field.name} {limit}", 1)


@of_ranges(each=_at_limit("lowest", 0), refuted_by="a shaft that moves", rests_on=(Doubt.MEANING,), quirks=(ZERO_SPEED,))
def _zero_limit(probe: Probe, command: Command, field: Field) -> None:
    """With {field} 0 nothing moves."""
    motion.ready_to_move(probe)
    gone, _ = _begun(probe, command, _move(probe, command, field, 0))
    if abs(gone) > _STILL:
        probe.meets(ZERO_SPEED)


@of_ranges(each=_at_limit("width", _WIDE), refuted_by="the speed of its low bytes alone")
def _limit_width(probe: Probe, command: Command, field: Field) -> None:
    """All bytes of {field} count."""
    motion.ready_to_move(probe)
    exchange = probe.ask(command, _move(probe, command, field, _WIDE), quiet_ns=0)
    probe.reply(exchange)
    probe.wait(250 * MS)
    rpm = motion.speed(probe).value
    late_ns = probe.gate.now_ns() - exchange.sent_ns
    motion.stand_still(probe)
    if late_ns > _LATE_NS:
        raise Inconclusive("the speed was read when the move was over: replies are lost or late")
    _expect_all_bytes(probe, command, field, _WIDE, rpm, exchange)


# --- angles and directions of moves within a turn ---------------------------------------------------------------------


def _move_apart(probe: Probe, angle: int) -> None:
    """Bring the shaft away from an angle within the turn, so that a move to it shows."""
    now = probe.read(Verb.READ_SINGLE_TURN)
    if _between(now, angle) < 3_000:
        probe.do("move_increment_limited", {"position": 6_000, "max_speed": _MODERATE})
        motion.wait_standing(probe)


def _between(one: int, other: int) -> int:
    return min((one - other) % _TURN, (other - one) % _TURN)


def _expect_reached(probe: Probe, command: Command, angle: int, direction: int) -> None:
    motion.ready_to_move(probe)
    _move_apart(probe, angle)
    exchange = probe.ask(command, _values(command, direction=direction, angle=angle))
    probe.reply(exchange)
    motion.wait_standing(probe)
    now = probe.read(Verb.READ_SINGLE_TURN)
    probe.expect(
        now,
        holds=_between(now, angle) <= (_SAME + probe.noise.place) * 100 and 0 <= now < _TURN,
        expected=f"{angle}",
        refutes=f"{command.name}: angle {angle} in direction {direction} ends at {now}",
        exchange=exchange,
        key=f"{command.name} angle",
    )


def _in_turn(name: str, *where: str) -> Any:
    """Return cases of the angle or the direction of moves within a turn, by where their values lie."""

    def cases(dialect: Dialect) -> Iterator[Case]:
        for command in _motions(dialect, MotionKind.MOVE_IN_TURN):
            field = command.request_forms[0].layout.named.get(name)
            if field is not None and "direction" in command.request_forms[0].layout.named:
                known = edges.allowed(field) | edges.forbidden(dialect, command, field, far=False)
                for each in (kind for kind in where if kind in known):
                    values = known[each] or edges.inner(dialect, command, field)
                    yield edges.case(dialect, command, field, each, values, risks=declared.risks(dialect))

    return cases


@of_ranges(
    each=_in_turn("angle", "lowest", "highest", "inside"),
    statement=lambda case: case["where"].replace("A value", "An angle").replace("value", "angle") + " is reached.",
    refuted_by="another angle",
)
def _reached(probe: Probe, command: Command, values: tuple[int, ...]) -> None:
    for number, value in enumerate(values):
        _expect_reached(probe, command, value, number % 2)


@of_ranges(each=_in_turn("direction", "listed"), refuted_by="another angle")
def _both_directions(probe: Probe, command: Command, values: tuple[int, ...]) -> None:
    """Both directions lead to the angle."""
    for value in values:
        _expect_reached(probe, command, 9_000, value)


@of_ranges(
    each=_in_turn("angle", "above"),
    statement="An angle of a turn or more is not obeyed.",
    refuted_by="a shaft that turns",
    at_best=Certainty.LIKELY,
)
@of_ranges(
    each=_in_turn("direction", "unlisted"),
    statement="A direction that is not listed is not obeyed.",
    refuted_by="a shaft that turns",
    at_best=Certainty.LIKELY,
)
def _not_obeyed(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    for value in values:
        asked = {"direction": 0, "angle": 9_000} | {field.name: value}
        motion.ready_to_move(probe)
        _move_apart(probe, asked["angle"] % _TURN)
        gone, exchange = _begun(probe, command, _values(command, **asked))
        _expect_ignored(probe, command, gone, " ".join(f"{n} {v}" for n, v in asked.items()), exchange)


def _with_reserved_bytes(dialect: Dialect) -> Iterator[Case]:
    for command in _motions(dialect, MotionKind.MOVE_IN_TURN):
        if "direction" in command.request_forms[0].layout.named:
            mask = sum(limits.reserved_masks(command.request_forms[0].layout))
            yield Case(dialect, command, {"mask": mask}, {"risks": declared.risks(dialect)})


@of_ranges(each=_with_reserved_bytes, refuted_by="a shaft that stays", at_best=Certainty.OPEN, aspect=Aspect.RANGE)
def _reserved(probe: Probe, command: Command, mask: int) -> None:
    """The reserved byte of a move changes nothing."""
    motion.ready_to_move(probe)
    _move_apart(probe, 9_000)
    asked = _values(command, direction=0, angle=9_000)
    exchange = probe.ask_built(with_reserved(probe, command, command.request_forms[0], asked, mask))
    probe.reply(exchange)
    probe.wait(_WATCH_NS)
    rpm = motion.speed(probe).value
    motion.stand_still(probe)
    text = f"{command.name} with its reserved byte set is not obeyed"
    probe.expect(rpm, at_least=1, unit="rpm", refutes=text, exchange=exchange)


# --- the brake, and commands of other models --------------------------------------------------------------------------


def _brakes(dialect: Dialect) -> Iterator[Case]:
    command = dialect.by_verb.get(Verb.BRAKE)
    if command is not None:
        field = command.request_forms[0].layout.named["brake_control"]
        wrong = edges.unlisted(dialect, command, field)
        risks = frozenset().union(*(command.risks({field.name: v}) for v in (0, 1, *wrong)))
        yield edges.case(dialect, command, field, "unlisted", wrong, risks=risks)


@of_ranges(each=_brakes, refuted_by="another state of the brake", at_best=Certainty.LIKELY)
def _switches_nothing(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> None:
    """A brake control that is not listed switches nothing."""
    for held in (0, 1):
        probe.do(command, {field.name: held})
        before = probe.read(command, "", {field.name: 0x10})
        for value in values:
            exchange = probe.ask(command, {field.name: value})
            now = probe.read(command, "", {field.name: 0x10})
            text = f"brake control {value:#x} switches the brake"
            probe.expect(now, equal=before, refutes=text, exchange=exchange, key="brake unlisted")


def _models(dialect: Dialect) -> Iterator[Case]:
    known = dialect.whole.by_verb
    if Verb.MOTOR_ON in dialect.by_verb and {Verb.RUN_TORQUE, Verb.RUN_OPEN_LOOP} <= known.keys():
        torque, power = known[Verb.RUN_TORQUE], known[Verb.RUN_OPEN_LOOP]
        facts = {
            "section": f"{power.section}, {torque.section}",
            "risks": declared.risks(dialect, Risk.UNBOUNDED, Risk.TORQUE),
            "commands": (torque.name, power.name),
            "parameters": {},
        }
        given = {"whose": _whose(torque, power), "names": f"{torque.name} and {power.name}"}
        yield Case(dialect, None, given, facts)


def _whose(torque: Command, power: Command) -> str:
    return f"{torque.name} belongs to {', '.join(torque.models)}, {power.name} to {', '.join(power.models)}"


@of_ranges(each=_models, refuted_by="a motor that obeys both, or the other model's", at_best=Certainty.LIKELY)
def models(probe: Probe, whose: str) -> None:
    """A motor obeys one of {names}: {whose}."""
    whole = probe.dialect.whole
    obeyed = []
    for command in (whole.by_verb[Verb.RUN_TORQUE], whole.by_verb[Verb.RUN_OPEN_LOOP]):
        motion.ready_to_move(probe)
        name, field = next(iter(command.request_forms[0].layout.named.items()))
        start = motion.position(probe)
        frame = encoder.build(whole, command, probe.address, {name: field.high // 4})
        probe.send(frame, timeout_ns=_WATCH_NS)
        gone = motion.position(probe).value - start.value
        motion.stand_still(probe)
        if abs(gone) > _STILL:
            obeyed.append(command)
    if not obeyed:
        raise Inconclusive("neither command turns the shaft")
    others = [c for c in obeyed if probe.rig.model and probe.rig.model not in c.models]
    names = " and ".join(c.name for c in obeyed)
    holds = len(obeyed) == 1 and not others
    probe.expect(f"{names} obeyed", holds=holds, expected=whose, refutes=f"the drive obeys {names}", key="model")
