"""Ranges of the LK commands: they have no reply that refuses, so what a drive takes shows in what it does.

    run_torque, run_open_loop     obeyed within the limits, not obeyed beyond: the shaft stays
    run_speed, moves              the limits of the type are obeyed, in the direction of their sign
    angle, direction, brake       the listed values are obeyed, others change nothing
    set_position                  what is set is read, up to the limits of the type
    write_parameter               the limits of the type: what a drive holds then is observed
    models                        a motor has the torque of an MF, MG or MH, or the power of an MS, and not both

Rules kept here:
- A motion that is to show that it was obeyed is looked at for a moment and stopped.
- Moves that have a `max_speed` are given 60 rpm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Certainty, Command, Dialect, Form, Risk, Verb
from analyzer.layout import Field
from conformance import limits, moving
from conformance.claim import Aspect, Claim, Inconclusive, Observed, Refuted, Theme
from conformance.claims import ranges
from conformance.claims.answers import with_reserved
from conformance.claims.declare import declare
from conformance.exchange import Exchange
from conformance.moving import MS
from conformance.probe import Probe

OTHER_FIRMWARE = "lk-firmware-235"
ZERO_SPEED = "lk-zero-speed-moves"
#: 60 rpm as sent, and 116 rpm, which needs more than 16 bits.
MODERATE, WIDE = 36_000, 70_000
#: How long a motion is looked at.
LOOK_NS = 60 * MS
#: A move that is to be looked at on its way is over by then.
LATE_NS = 500 * MS
#: Degrees in which a shaft counts as one that stayed, and in which two angles are one.
STILL, SAME = 1.0, 0.3
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
    for form in dialect.by_verb[Verb.WRITE_PARAMETER].request_forms:
        yield from _parameter(dialect, dialect.by_verb[Verb.WRITE_PARAMETER], form)
    yield from _models(dialect)


# --- doing and looking ------------------------------------------------------------------------------------------------


def moderate(command: Command, **values: int) -> dict[str, int]:
    """Return values of a move with a moderate speed where it takes one."""
    has_limit = "max_speed" in command.request_forms[0].layout.named
    return ({"max_speed": MODERATE} if has_limit else {}) | values


def begun(probe: Probe, command: Command, values: dict[str, int]) -> tuple[float, Exchange]:
    """Ask for a motion of a shaft that stands, look for a moment, and stop; return how far it went (deg).

    Raises Inconclusive where it is not answered.
    """
    start = moving.position(probe)
    exchange = probe.ask(command, values)
    probe.reply(exchange)
    probe.wait(LOOK_NS)
    gone = moving.position(probe).value - start.value
    moving.stand_still(probe)
    return gone, exchange


def _obeyed(command: Command, shown: str, gone: float, sign: int, exchange: Exchange) -> None:
    if gone * sign <= 0 or abs(gone) < 0.05:
        got = "a shaft that stays" if abs(gone) < 0.05 else f"{gone:+.2f} deg"
        way = "clockwise" if sign > 0 else "counter-clockwise"
        raise Refuted(
            f"{command.name}: {shown} is not obeyed", expected=f"a shaft that turns {way}",
            got=got, exchange=exchange, key=f"{command.name} not obeyed",
        )  # fmt: skip


def _stays(command: Command, shown: str, gone: float, exchange: Exchange) -> None:
    if abs(gone) > STILL:
        raise Refuted(
            f"{command.name}: {shown} is obeyed", expected="a shaft that stays: the manual does not allow it",
            got=f"{gone:+.2f} deg", exchange=exchange, key=f"{command.name} obeyed",
        )  # fmt: skip


def _sign(value: int) -> int:
    return 1 if value > 0 else -1


def _claim(
    dialect: Dialect, command: Command, field: Field, what: str, statement: str, refuted_by: str,
    check: Callable[[Probe], None], values: tuple[int, ...], risks: set[Risk], **rest: Any,
) -> Claim:  # fmt: skip
    aspect = Aspect.BOUNDARY if what in ("lowest", "highest", "below", "above") else Aspect.RANGE
    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{what}", statement, refuted_by, check, command=command,
        aspect=aspect, fields=(field.name,), parameters={"field": field.name, "values": values},
        risks=moving.risks(dialect, *risks), **rest,
    )  # fmt: skip


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


def _obeying(dialect: Dialect, command: Command, field: Field, what: str, values: tuple[int, ...]) -> Claim:
    def check(probe: Probe) -> None:
        for value in values:
            moving.ready_to_move(probe)
            gone, exchange = begun(probe, command, moderate(command, **{field.name: value}))
            _obeyed(command, f"{field.name} {value}", gone, _sign(value), exchange)

    words = {"lowest": "The lowest value", "highest": "The highest value"}.get(what, "A value between the limits")
    return _claim(
        dialect, command, field, what, f"{words} of {field.name} is obeyed, its sign the direction.",
        "a shaft that stays, or turns the other way", check, values, set(command.all_risks), errata=("lk-rs485-28",),
    )  # fmt: skip


def _ignoring(dialect: Dialect, command: Command, field: Field, what: str, values: tuple[int, ...]) -> Claim:
    def check(probe: Probe) -> None:
        moving.ready_to_move(probe)
        gone, _ = begun(probe, command, {field.name: field.high // 4})
        if abs(gone) < 0.05:
            raise Inconclusive(f"{command.name} turns nothing, so nothing can be said of values that it ignores")
        for value in values:
            gone, exchange = begun(probe, command, {field.name: value})
            _stays(command, f"{field.name} {value}", gone, exchange)

    return _claim(
        dialect, command, field, what, f"A {field.name} {what} the limit is not obeyed.", "a shaft that turns", check, values,
        set(command.all_risks), at_best=Certainty.LIKELY,
    )  # fmt: skip


def _far(dialect: Dialect, command: Command, field: Field) -> Claim:
    """Make the claim that every byte of a distance counts: a place 256^n away is not near."""
    shifts = range(16, field.bit_width - 1, 8)
    distances = tuple(s * (1 << n) for n in shifts for s in (1, -1) if (1 << n) <= field.high)

    def check(probe: Probe) -> None:
        for distance in distances:
            moving.ready_to_move(probe)
            probe.do("set_position", {"position": 0})
            gone, exchange = begun(probe, command, moderate(command, **{field.name: distance}))
            _obeyed(command, f"{field.name} {distance}", gone, _sign(distance), exchange)

    return _claim(
        dialect, command, field, "width", f"All bytes of {field.name} count.", "a move by what its low bytes say", check,
        distances, {Risk.SETTING}, settings=("position",),
    )  # fmt: skip


def _speeds(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    yield from _signed(dialect, command, field)

    def check(probe: Probe) -> None:
        for value in (WIDE, -WIDE):
            moving.ready_to_move(probe)
            exchange = probe.ask(command, {field.name: value}, quiet_ns=0)
            probe.reply(exchange)
            probe.wait(600 * MS)
            rpm = moving.speed(probe).value
            moving.stand_still(probe)
            _judge_width(command, field, value, rpm, exchange)

    yield _claim(
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
        moving.ready_to_move(probe)
        gone, exchange = begun(probe, command, values(probe, field.high))
        _obeyed(command, f"{field.name} {field.high}", gone, 1, exchange)

    def lowest(probe: Probe) -> None:
        moving.ready_to_move(probe)
        gone, exchange = begun(probe, command, values(probe, 0))
        if abs(gone) > STILL:
            probe.meets(ZERO_SPEED)
        else:
            _stays(command, f"{field.name} 0", gone, exchange)

    def width(probe: Probe) -> None:
        moving.ready_to_move(probe)
        exchange = probe.ask(command, values(probe, WIDE), quiet_ns=0)
        probe.reply(exchange)
        probe.wait(250 * MS)
        rpm = moving.speed(probe).value
        late_ns = probe.gate.now_ns() - exchange.sent_ns
        moving.stand_still(probe)
        if late_ns > LATE_NS:
            raise Inconclusive("the speed was read when the move was over: replies are lost or late")
        _judge_width(command, field, WIDE, rpm, exchange)

    risks = {Risk.SETTING} if command.verb is Verb.MOVE_ABSOLUTE_AXIS else set()
    changed = ("position",) if risks else ()
    yield _claim(
        dialect, command, field, "highest", f"The highest {field.name} is obeyed.", "a shaft that stays", highest,
        (field.high,), risks, settings=changed,
    )  # fmt: skip
    yield _claim(
        dialect, command, field, "lowest", f"With {field.name} 0 nothing moves.", "a shaft that moves", lowest, (0,), risks,
        errata=("lk-rs485-30",), quirks=(ZERO_SPEED,), settings=changed,
    )  # fmt: skip
    yield _claim(
        dialect, command, field, "width", f"All bytes of {field.name} count.", "the speed of its low bytes alone", width,
        (WIDE,), risks, settings=changed,
    )  # fmt: skip


# --- angles, directions, brake ----------------------------------------------------------------------------------------


def _apart(probe: Probe, angle: int) -> None:
    """Bring the shaft away from an angle within the turn, so that a move to it shows."""
    now = probe.read("read_single_turn")
    if min((now - angle) % 36_000, (angle - now) % 36_000) < 3_000:
        probe.do("move_increment_limited", {"position": 6_000, "max_speed": MODERATE})
        moving.wait_standing(probe)


def _angles(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    def there(probe: Probe, value: int, direction: int) -> None:
        moving.ready_to_move(probe)
        _apart(probe, value)
        exchange = probe.ask(command, moderate(command, direction=direction, angle=value))
        probe.reply(exchange)
        moving.wait_standing(probe)
        now = probe.read("read_single_turn")
        off = min((now - value) % 36_000, (value - now) % 36_000) / 100
        if off > SAME:
            raise Refuted(
                f"{command.name}: angle {value} in direction {direction} ends at {now}", expected=f"{value}", got=f"{now}",
                exchange=exchange, key=f"{command.name} angle",
            )  # fmt: skip

    def nothing(probe: Probe, values: dict[str, int]) -> None:
        moving.ready_to_move(probe)
        _apart(probe, values["angle"] % 36_000)
        gone, exchange = begun(probe, command, moderate(command, **values))
        _stays(command, " ".join(f"{n} {v}" for n, v in values.items()), gone, exchange)

    def reached(*values: int) -> Callable[[Probe], None]:
        def check(probe: Probe) -> None:
            for number, value in enumerate(values):
                there(probe, value, number % 2)

        return check

    def ignored(*every: dict[str, int]) -> Callable[[Probe], None]:
        def check(probe: Probe) -> None:
            for values in every:
                nothing(probe, values)

        return check

    inner = ranges.inner(dialect, command, field)
    for what, values in (("lowest", (field.low,)), ("highest", (field.high,)), ("inside", inner)):
        words = {"lowest": "The lowest angle", "highest": "The highest angle"}.get(what, "An angle between the limits")
        yield _claim(
            dialect, command, field, what, f"{words} is reached.", "another angle", reached(*values), values, set(),
        )  # fmt: skip
    above = tuple(v for v in limits.beyond(field) if v > field.high)
    yield _claim(
        dialect, command, field, "above", "An angle of a turn or more is not obeyed.", "a shaft that turns",
        ignored(*({"direction": 0, "angle": v} for v in above)), above, set(), at_best=Certainty.LIKELY,
    )  # fmt: skip
    direction = command.request_forms[0].layout.named["direction"]

    def both(probe: Probe) -> None:
        for value in limits.edges(direction):
            there(probe, 9_000, value)

    yield _claim(
        dialect, command, direction, "listed", "Both directions lead to the angle.", "another angle", both,
        limits.edges(direction), set(),
    )  # fmt: skip
    wrong = ranges.unlisted(dialect, command, direction)
    yield _claim(
        dialect, command, direction, "unlisted", "A direction that is not listed is not obeyed.", "a shaft that turns",
        ignored(*({"direction": v, "angle": 9_000} for v in wrong)), wrong, set(), at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield _reserved_move(dialect, command)


def _reserved_move(dialect: Dialect, command: Command) -> Claim:
    form = command.request_forms[0]
    mask = sum(limits.reserved_masks(form.layout))

    def check(probe: Probe) -> None:
        moving.ready_to_move(probe)
        _apart(probe, 9_000)
        exchange = probe.ask_built(with_reserved(probe, command, form, moderate(command, direction=0, angle=9_000), mask))
        probe.reply(exchange)
        probe.wait(LOOK_NS)
        rpm = moving.speed(probe).value
        moving.stand_still(probe)
        if rpm < 1:
            raise Refuted(f"{command.name} with its reserved byte set is not obeyed", expected="a shaft that turns",
                          got="a shaft that stays", exchange=exchange)  # fmt: skip

    return declare(
        dialect, Theme.RANGES, f"{command.name}/reserved", "The reserved byte of a move changes nothing.", "a shaft that stays",
        check, command=command, at_best=Certainty.OPEN, aspect=Aspect.RANGE, risks=moving.risks(dialect),
        parameters={"mask": mask},
    )  # fmt: skip


def _brake(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    wrong = ranges.unlisted(dialect, command, field)

    def check(probe: Probe) -> None:
        for held in (0, 1):
            probe.do(command, {field.name: held})
            before = probe.read(command, "", {field.name: 0x10})
            for value in wrong:
                exchange = probe.ask(command, {field.name: value})
                now = probe.read(command, "", {field.name: 0x10})
                if now != before:
                    raise Refuted(
                        f"brake control {value:#x} switches the brake", expected=f"state {before} as before",
                        got=f"state {now}", exchange=exchange, key="brake unlisted",
                    )  # fmt: skip

    risks = set().union(*(command.risks({field.name: v}) for v in (0, 1, *wrong)))
    yield declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/unlisted", "A brake control that is not listed switches nothing.",
        "another state of the brake", check, command=command, aspect=Aspect.RANGE, fields=(field.name,), risks=risks,
        at_best=Certainty.LIKELY, parameters={"field": field.name, "values": wrong},
    )  # fmt: skip


# --- positions and parameters -----------------------------------------------------------------------------------------


def _positions(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    def read(values: tuple[int, ...]) -> Callable[[Probe], None]:
        def check(probe: Probe) -> None:
            moving.stand_still(probe)
            for value in values:
                exchange = probe.do(command, {field.name: value})
                now = probe.read(Verb.READ_POSITION)
                if abs(now - value) > SAME * 100:
                    raise Refuted(
                        f"set_position {value} is read as {now}", expected=f"{value}", got=f"{now}", exchange=exchange,
                        key="set_position not stored",
                    )  # fmt: skip

        return check

    inner = (0x01020304, -0x01020304, 1, -1, 0)
    for what, values in (("lowest", (field.low,)), ("highest", (field.high,)), ("inside", inner)):
        words = {"lowest": "The lowest position", "highest": "The highest position"}.get(what, "A position between the limits")
        yield _claim(
            dialect, command, field, what, f"{words} that is set is read.", "another position",
            read(values), values, {Risk.SETTING}, settings=("position",),
        )  # fmt: skip


def read_parameter(probe: Probe, number: int) -> dict[str, int]:
    """Return a control parameter. Raises Observed where the firmware does not have the command."""
    exchange = probe.ask(Verb.READ_PARAMETER, {"parameter": number})
    if exchange.silent and OTHER_FIRMWARE in probe.claim.quirks:
        probe.meets(OTHER_FIRMWARE)
        raise Observed("control parameters cannot be read: as firmware 2.35 was seen to be")
    values = {n: int(v) for n, v in probe.reply(exchange).values.items()}
    if values.get("parameter") != number:
        raise Inconclusive(f"a read of parameter {number} is answered for {values.get('parameter')}")
    return values


def _parameter(dialect: Dialect, command: Command, form: Form) -> Iterator[Claim]:
    number = form.layout.named["parameter"].fixed
    if number is None:
        yield _unlisted_parameter(dialect, command)
        return
    risks = command.risks({"parameter": number})
    for field in form.layout.named.values():
        for what, value in (("lowest", field.low), ("highest", field.high)):
            if field.fixed is None:
                yield _parameter_edge(dialect, command, form, field, what, value)
    masks = limits.reserved_masks(form.layout)
    if masks:

        def check(probe: Probe) -> None:
            before = read_parameter(probe, number)
            probe.do(command, before)
            if read_parameter(probe, number) != before:
                raise Inconclusive(f"{form.name} is not held as it was read: another claim is about that")
            exchange = probe.ask_built(with_reserved(probe, command, form, before, sum(masks)))
            probe.reply(exchange)
            now = read_parameter(probe, number)
            if now != before:
                text = f"{form.name} changes by its reserved bytes"
                raise Refuted(text, expected=str(before), got=str(now), exchange=exchange)

        yield declare(
            dialect, Theme.RANGES, f"{command.name}/{form.name}/reserved", f"The reserved bytes of {form.name} change nothing.",
            "another value of the parameter", check, command=command, errata=("lk-rs485-49",), aspect=Aspect.RANGE,
            risks=risks, quirks=(OTHER_FIRMWARE,), settings=(form.name,), parameters={"mask": sum(masks)},
        )  # fmt: skip


def _parameter_edge(dialect: Dialect, command: Command, form: Form, field: Field, what: str, value: int) -> Claim:
    number = form.layout.named["parameter"].fixed or 0

    def check(probe: Probe) -> None:
        before = read_parameter(probe, number)
        exchange = probe.ask(command, before | {field.name: value}, form=form)
        probe.reply(exchange)
        now = read_parameter(probe, number)
        probe.ask(command, before, form=form)
        if now.get(field.name) != value:
            raise Refuted(
                f"{field.name} {value} is held as {now.get(field.name)}", expected=f"{value}", got=f"{now.get(field.name)}",
                exchange=exchange,
            )  # fmt: skip

    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{what}", f"The {what} {field.name} is held as it was sent.",
        "another value", check, command=command, errata=("lk-rs485-36", "lk-rs485-48"), aspect=Aspect.BOUNDARY,
        fields=(field.name,), risks=command.risks({"parameter": number}), quirks=(OTHER_FIRMWARE,), settings=(form.name,),
        parameters={"field": field.name, "value": value},
    )  # fmt: skip


def _unlisted_parameter(dialect: Dialect, command: Command) -> Claim:
    listed = [int(f.layout.named["parameter"].fixed or 0) for f in command.request_forms]
    numbers = tuple(n for n in (0, 9, 13, 29, 31, 33, 35, 37, 39, 255) if n not in listed)

    def check(probe: Probe) -> None:
        before = {n: read_parameter(probe, n) for n in listed if n}
        for number in numbers:
            exchange = probe.ask(command, {"parameter": number, "parameter_bytes": 0x0102_0304_0506})
            now = {n: read_parameter(probe, n) for n in listed if n}
            if now != before:
                raise Refuted(
                    f"writing parameter {number}, which is not listed, changes another", expected=str(before), got=str(now),
                    exchange=exchange, key="unlisted parameter",
                )  # fmt: skip

    risks = set().union(*(command.risks({"parameter": n}) for n in numbers))
    statement = "Writing a parameter that is not listed changes no listed one."
    return declare(
        dialect, Theme.RANGES, f"{command.name}/parameter/unlisted", statement,
        "another value of a listed parameter", check, command=command, at_best=Certainty.LIKELY, aspect=Aspect.RANGE,
        fields=("parameter",), risks=risks, quirks=(OTHER_FIRMWARE,), parameters={"values": numbers},
    )  # fmt: skip


# --- models -----------------------------------------------------------------------------------------------------------


def _models(dialect: Dialect) -> Iterator[Claim]:
    """Make the claim that a drive obeys the torque command or the power command, by its model, and not both."""
    whole = registry.get(dialect.name)
    torque, power = whole.by_verb[Verb.RUN_TORQUE], whole.by_verb[Verb.RUN_OPEN_LOOP]

    def check(probe: Probe) -> None:
        obeyed = []
        for command in (torque, power):
            moving.ready_to_move(probe)
            name, field = next(iter(command.request_forms[0].layout.named.items()))
            start = moving.position(probe)
            probe.send(probe.item(probe_frame(probe, whole, command, {name: field.high // 4})), timeout_ns=LOOK_NS)
            gone = moving.position(probe).value - start.value
            moving.stand_still(probe)
            if abs(gone) > STILL:
                obeyed.append(command)
        foreign = [c for c in obeyed if probe.rig.model and probe.rig.model not in c.models]
        if len(obeyed) == 2 or foreign:
            names = " and ".join(c.name for c in obeyed)
            raise Refuted(f"the drive obeys {names}", expected=_whose(torque, power), got=f"{names} obeyed", key="model")
        if not obeyed:
            raise Inconclusive("neither command turns the shaft")

    yield declare(
        dialect, Theme.RANGES, "models", f"A motor obeys one of {torque.name} and {power.name}: {_whose(torque, power)}.",
        "a motor that obeys both, or the other model's", check, section=f"{power.section}, {torque.section}",
        at_best=Certainty.LIKELY, risks=moving.risks(dialect, Risk.UNBOUNDED, Risk.TORQUE),
        commands=(torque.name, power.name),
    )  # fmt: skip


def probe_frame(probe: Probe, dialect: Dialect, command: Command, values: dict[str, int]) -> bytes:
    """Return the frame of a command that the drive's own model may not have."""
    from analyzer import encoder

    return encoder.build(dialect, command, probe.address, values)


def _whose(torque: Command, power: Command) -> str:
    return f"{torque.name} belongs to {', '.join(torque.models)}, {power.name} to {', '.join(power.models)}"


_Make = Callable[[Dialect, Command, Field], Iterator[Claim]]
#: What is claimed of which field of which commands.
_MAKERS: tuple[tuple[tuple[Verb, ...], str, _Make], ...] = (
    (_STRONG, "torque_current", _signed),
    (_STRONG, "power", _signed),
    ((Verb.RUN_SPEED,), "speed", _speeds),
    (_MOVES, "position", _signed),
    ((*_MOVES, Verb.MOVE_SINGLE_TURN), "max_speed", _max_speeds),
    ((Verb.MOVE_SINGLE_TURN,), "angle", _angles),
    ((Verb.BRAKE,), "brake_control", _brake),
    ((Verb.OTHER,), "position", _positions),
)
