"""Ranges of the LK commands: they have no reply that refuses, so what a drive takes shows in what it does.

    run_torque, run_open_loop     obeyed within the limits, not obeyed beyond: the shaft stays
    run_speed, moves              the limits of the type are obeyed, in the direction of their sign
    angle, direction, brake       the listed values are obeyed, others change nothing
    set_position                  what is set is read, up to the limits of the type
    write_parameter               the limits of the type: what a drive holds then is observed
    models                        a motor has the torque of an MF, MG or MH, or the power of an MS, and not both

What has choices or an angle stands in `ranges_lk_angles`, parameters and models in `ranges_lk_parameters`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Claim, Inconclusive, Refuted
from conformance.claims.ranges_lk_angles import angles, brake, positions
from conformance.claims.ranges_lk_looks import LEAST, STILL, WIDE, begun, claim_of, moderate, obeyed, stays
from conformance.claims.ranges_lk_parameters import models, parameters
from conformance.model import limits
from conformance.motion import motion
from conformance.motion.motion import MS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

ZERO_SPEED = "lk-zero-speed-moves"
#: A move that is to be looked at on its way is over by then.
LATE_NS = 500 * MS
_STRONG = (Verb.RUN_TORQUE, Verb.RUN_OPEN_LOOP)
_MOVES = (Verb.MOVE_ABSOLUTE_AXIS, Verb.MOVE_RELATIVE_AXIS)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about the ranges of LK commands."""
    if Verb.MOTOR_ON not in dialect.by_verb:
        return
    for command in dialect.commands:
        named = command.request_forms[0].layout.named
        for verbs, field, make in _MAKERS:
            if command.verb in verbs and field in named:
                yield from make(dialect, command, named[field])
    if Verb.WRITE_PARAMETER in dialect.by_verb:
        yield from parameters(dialect, dialect.by_verb[Verb.WRITE_PARAMETER])
    yield from models(dialect)


# --- torque, power, speeds, distances: numbers with a sign ------------------------------------------------------------


def _signed(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    """Make the claims about a number whose sign is the direction."""
    # A shaft needs more than a little torque to move.
    inside = tuple(v // 4 for v in (field.low, field.high))
    for what, values in (("lowest", (field.low,)), ("highest", (field.high,)), ("inside", inside)):
        yield _obeying(dialect, command, field, what, values)
    below = tuple(v for v in limits.beyond(field) if v < field.low)
    above = tuple(v for v in limits.beyond(field) if v > field.high)
    for what, values in (("below", below), ("above", above)):
        if values:
            yield _ignoring(dialect, command, field, what, values)
    if command.verb in _MOVES:
        yield _far(dialect, command, field)


def _sign(value: int) -> int:
    return 1 if value > 0 else -1


def _obeying(dialect: Dialect, command: Command, field: Field, what: str, values: tuple[int, ...]) -> Claim:
    def check(probe: Probe) -> None:
        for value in values:
            motion.ready_to_move(probe)
            gone, exchange = begun(probe, command, moderate(command, **{field.name: value}))
            obeyed(command, f"{field.name} {value}", gone, _sign(value), exchange)

    words = {"lowest": "The lowest value", "highest": "The highest value"}.get(what, "A value between the limits")
    return claim_of(
        dialect, command, field, what, f"{words} of {field.name} is obeyed, its sign the direction.",
        "a shaft that stays, or turns the other way", check, values, set(command.all_risks), rests_on=(Doubt.SIGN,),
    )  # fmt: skip


def _ignoring(dialect: Dialect, command: Command, field: Field, what: str, values: tuple[int, ...]) -> Claim:
    def check(probe: Probe) -> None:
        motion.ready_to_move(probe)
        gone, _ = begun(probe, command, {field.name: field.high // 4})
        if abs(gone) < LEAST:
            raise Inconclusive(f"{command.name} turns nothing, so nothing can be said of values that it ignores")
        for value in values:
            gone, exchange = begun(probe, command, {field.name: value})
            stays(command, f"{field.name} {value}", gone, exchange)

    return claim_of(
        dialect, command, field, what, f"A {field.name} {what} the limit is not obeyed.", "a shaft that turns", check, values,
        set(command.all_risks), at_best=Certainty.LIKELY,
    )  # fmt: skip


def _far(dialect: Dialect, command: Command, field: Field) -> Claim:
    """Make the claim that every byte of a distance counts: a place 256^n away is not near."""
    shifts = range(16, field.bit_width - 1, 8)
    distances = tuple(s * (1 << n) for n in shifts for s in (1, -1) if (1 << n) <= field.high)

    def check(probe: Probe) -> None:
        for distance in distances:
            motion.ready_to_move(probe)
            probe.do("set_position", {"position": 0})
            gone, exchange = begun(probe, command, moderate(command, **{field.name: distance}))
            obeyed(command, f"{field.name} {distance}", gone, _sign(distance), exchange)

    return claim_of(
        dialect, command, field, "width", f"All bytes of {field.name} count.", "a move by what its low bytes say", check,
        distances, {Risk.SETTING}, settings=("position",),
    )  # fmt: skip


def _speeds(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    yield from _signed(dialect, command, field)

    def check(probe: Probe) -> None:
        for value in (WIDE, -WIDE):
            motion.ready_to_move(probe)
            exchange = probe.ask(command, {field.name: value}, quiet_ns=0)
            probe.reply(exchange)
            probe.wait(600 * MS)
            rpm = motion.speed(probe).value
            motion.stand_still(probe)
            _judge_width(command, field, value, rpm, exchange)

    yield claim_of(
        dialect, command, field, "width", "All bytes of a speed count.", "the speed of its low bytes alone", check,
        (WIDE, -WIDE), set(command.all_risks),
    )  # fmt: skip


def _judge_width(command: Command, field: Field, value: int, rpm: float, exchange: Exchange) -> None:
    """Refute where a speed is nearer to what the low 16 bits say than to what was sent."""
    expected, low = abs(value) / 600, (abs(value) & 0xFFFF) / 600
    if abs(rpm) < (expected + low) / 2:
        raise Refuted(
            f"{command.name}: with {field.name} {value} the shaft turns at {rpm:.1f} rpm", expected=f"about {expected:.0f} rpm",
            got=f"{rpm:.1f} rpm; the low 16 bits say {low:.1f}", exchange=exchange, key=f"{command.name} speed",
        )  # fmt: skip


def _max_speeds(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    """Make the claims about the speed limit of a move."""
    named = command.request_forms[0].layout.named

    def values(probe: Probe, limit: int) -> dict[str, int]:
        """Return a move of two turns by a limit; within a turn, of nearly one."""
        if "angle" in named:
            now = probe.read("read_single_turn")
            return {"direction": 0, "angle": (now - 2000) % 36_000, field.name: limit}
        if command.verb is Verb.MOVE_ABSOLUTE_AXIS:
            probe.do("set_position", {"position": 0})
        return {"position": 72_000, field.name: limit}

    def highest(probe: Probe) -> None:
        motion.ready_to_move(probe)
        gone, exchange = begun(probe, command, values(probe, field.high))
        obeyed(command, f"{field.name} {field.high}", gone, 1, exchange)

    def lowest(probe: Probe) -> None:
        motion.ready_to_move(probe)
        gone, exchange = begun(probe, command, values(probe, 0))
        if abs(gone) > STILL:
            probe.meets(ZERO_SPEED)
        else:
            stays(command, f"{field.name} 0", gone, exchange)

    def width(probe: Probe) -> None:
        motion.ready_to_move(probe)
        exchange = probe.ask(command, values(probe, WIDE), quiet_ns=0)
        probe.reply(exchange)
        probe.wait(250 * MS)
        rpm = motion.speed(probe).value
        late_ns = probe.gate.now_ns() - exchange.sent_ns
        motion.stand_still(probe)
        if late_ns > LATE_NS:
            raise Inconclusive("the speed was read when the move was over: replies are lost or late")
        _judge_width(command, field, WIDE, rpm, exchange)

    risks = {Risk.SETTING} if command.verb is Verb.MOVE_ABSOLUTE_AXIS else set()
    changed = ("position",) if risks else ()
    yield claim_of(
        dialect, command, field, "highest", f"The highest {field.name} is obeyed.", "a shaft that stays", highest,
        (field.high,), risks, settings=changed,
    )  # fmt: skip
    yield claim_of(
        dialect, command, field, "lowest", f"With {field.name} 0 nothing moves.", "a shaft that moves", lowest, (0,), risks,
        rests_on=(Doubt.MEANING,), quirks=(ZERO_SPEED,), settings=changed,
    )  # fmt: skip
    yield claim_of(
        dialect, command, field, "width", f"All bytes of {field.name} count.", "the speed of its low bytes alone", width,
        (WIDE,), risks, settings=changed,
    )  # fmt: skip


_Make = Callable[[Dialect, Command, Field], Iterator[Claim]]
#: What is claimed of which field of which commands.
_MAKERS: tuple[tuple[tuple[Verb, ...], str, _Make], ...] = (
    (_STRONG, "torque_current", _signed),
    (_STRONG, "power", _signed),
    ((Verb.RUN_SPEED,), "speed", _speeds),
    (_MOVES, "position", _signed),
    ((*_MOVES, Verb.MOVE_SINGLE_TURN), "max_speed", _max_speeds),
    ((Verb.MOVE_SINGLE_TURN,), "angle", angles),
    ((Verb.BRAKE,), "brake_control", brake),
    ((Verb.OTHER,), "position", positions),
)
