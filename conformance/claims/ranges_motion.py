"""Ranges of motion commands (MKS): limits of speed, acceleration and distance, and that all their bits count.

Other than with a setting, a speed above the limit is no mistake: the drive runs at the highest speed of its work mode and
answers success. Which speed that is stands in the manual's table of modes (CAN has none: 3000 rpm).

    lowest, highest, inside    accepted                  above    speed: run at the highest; others: refused
    listed, unlisted           the direction             width    every byte counts: what it would be without one is not done

Rules kept here:
- A move to a far place is begun slowly and stopped after a turn at most; whether it was begun is what counts.
- Speeds are those of the shaft at 16 subdivisions.
- Distances go from where the shaft is, absolute places too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from analyzer.layout import Field, Kind
from analyzer.protocols.mks_shared import MODE_MAXIMUM_SPEEDS
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims import effects, ranges
from conformance.claims.declare import declare
from conformance.claims.requests import with_reserved
from conformance.model import limits
from conformance.motion import motion, moves
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.acceptance import expect_accepted, expect_refused
from conformance.talk.probe import Probe, Until

RUNS = frozenset(moves.STOP_OF)
STOPS = frozenset(moves.STOP_OF.values())

#: How slow a move is whose distance does not matter, and how steep the ramp of one that is to reach a high speed. (Not 250:
#: that byte begins a frame, and what follows it would have to be allowed as one.)
SLOW, STEEP = 10, 248
#: How long such a move is watched.
WATCH_NS = SECOND_NS
#: A speed that reads so much off (a share) is another one.
SPEED_SHARE = 0.015
#: Turns of a move that is to reach the highest speed and is stopped then.
FAR_TURNS = 160
#: What the speed rests on.
#: Speeds one bit pattern of which has both bytes filled.
_TELLING_RPM = 257


def turns(command: Command) -> bool:
    """Say whether a command is a run, a move or the stop of one."""
    return command.verb in RUNS | STOPS and bool(command.replies.failed or command.replies.failed_forms)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about the ranges of motion commands."""
    if not moves.is_mks(dialect):
        return
    for command in dialect.commands:
        if turns(command):
            for field in command.request_forms[0].layout.named.values():
                if field.fixed is None:
                    yield from _of_field(dialect, command, field)
        if command.verb in RUNS and _reserved_bits(command):
            yield _reserved(dialect, command)
    for mode in motion.bus_modes(dialect):
        yield _mode_limit(dialect, mode)


def _of_field(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    if limits.listed(field) is not None:
        yield _accepted(dialect, command, field, "listed", limits.edges(field), "Every listed value")
        unlisted = ranges.unlisted(dialect, command, field)
        if unlisted:
            yield _refused(dialect, command, field, "unlisted", unlisted, "A value that is not listed")
        return
    yield _accepted(dialect, command, field, "lowest", (field.low,), "The lowest value")
    yield _accepted(dialect, command, field, "highest", (field.high,), "The highest value")
    yield _accepted(dialect, command, field, "inside", None, "A value between the limits")
    below = tuple(v for v in limits.beyond(field) if v < field.low)
    above = tuple(v for v in limits.beyond(field) if v > field.high)
    if below:
        yield _refused(dialect, command, field, "below", below, "A value below the lowest")
    if above and field.name == "speed":
        yield _too_fast(dialect, command, field, above)
    elif above:
        yield _refused(dialect, command, field, "above", above, "A value above the highest")
    if field.name == "speed":
        yield _speed_width(dialect, command)
    if field.name in ("pulses", "position") and command.verb in RUNS:
        yield _width(dialect, command, field)


# --- moving -----------------------------------------------------------------------------------------------------------


def base(probe: Probe, command: Command) -> int:
    """Return what a distance is added to: where an absolute move begins, 0 for others."""
    start = moves.place(probe, command)
    if moves.is_absolute(command):
        # A gate that bounds turns has to know where the shaft is.
        probe.gate.note_position(motion.position(probe).value, probe.address, start if moves.by_pulses(command) else None)
    return start


def values_for(probe: Probe, command: Command, **changed: int) -> dict[str, Any]:
    """Return a slow move of a tenth of a turn (a run, a stop) with some values changed."""
    named = command.request_forms[0].layout.named
    values: dict[str, Any] = dict.fromkeys(named, 0)
    if command.verb in STOPS:
        return values | {"acceleration": motion.GENTLE} | changed
    values |= {"speed": SLOW, "acceleration": motion.GENTLE}
    tenth = moves.units_per_turn(command) // 10
    if "pulses" in named:
        values["pulses"] = tenth
    if "position" in named:
        values["position"] = base(probe, command) + tenth
    return values | changed


def far_values(probe: Probe, command: Command, turns: int = FAR_TURNS) -> dict[str, int]:
    """Return the distance field of a move so far that it is stopped before it ends; nothing for a run."""
    named = command.request_forms[0].layout.named
    units = turns * moves.units_per_turn(command)
    if "pulses" in named:
        return {"pulses": units}
    if "position" in named:
        start = base(probe, command)
        field = named["position"]
        return {"position": start + units if start + units <= field.high else start - units}
    return {}


def end(probe: Probe, command: Command) -> None:
    """Stop what a command began, and wait until the shaft stands."""
    stop = moves.STOP_OF.get(command.verb)
    if stop is not None:
        # The end of a stop is told unasked: a request that is sent meanwhile would collide with it.
        probe.ask(stop, {"acceleration": motion.GENTLE}, until=Until.DONE)
    motion.wait_standing(probe)


def ready(probe: Probe, mode: str = "") -> None:
    """Make the drive ready, at a subdivision at which speeds are plain."""
    motion.ready_to_move(probe, mode, subdivision=moves.SUBDIVISION)


def _needs(dialect: Dialect, command: Command, *, stands: bool = False) -> dict[str, Any]:
    """Return what a claim must declare that begins a motion; `stands`: only at speed 0."""
    more = {Risk.UNBOUNDED} if command.verb is Verb.RUN_SPEED and not stands else set()
    return {"risks": motion.risks(dialect, *more), "settings": motion.settings(dialect)}


# --- accepted and refused ---------------------------------------------------------------------------------------------


def _accepted(dialect: Dialect, command: Command, field: Field, what: str, values: tuple[int, ...] | None, words: str) -> Claim:
    def check(probe: Probe) -> None:
        ready(probe)
        for value in ranges.inner(dialect, command, field) if values is None else values:
            expect_accepted(probe, command, values_for(probe, command, **{field.name: value}), ranges.shown(field, value))
            probe.wait(100 * MS)
            end(probe, command)

    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{what}", f"{words} of {field.name} is accepted.", "a refusal",
        check, command=command, aspect=Aspect.BOUNDARY if what in ("lowest", "highest") else Aspect.RANGE,
        rests_on=(Doubt.LIMITS,),
        fields=(field.name,), parameters={"field": field.name, "values": values or ()},
        **_needs(dialect, command, stands=field.name == "speed" and values == (0,)),
    )  # fmt: skip


def _refused(dialect: Dialect, command: Command, field: Field, what: str, values: tuple[int, ...], words: str) -> Claim:
    def check(probe: Probe) -> None:
        ready(probe)
        start = motion.position(probe)
        for value in values:
            built = probe.build(command, values_for(probe, command, **{field.name: value}))
            exchange = expect_refused(probe, built, ranges.shown(field, value))
            probe.wait(100 * MS)
            now = motion.position(probe)
            if abs(now.value - start.value) > 1:
                raise Refuted(
                    f"{command.name}: {ranges.shown(field, value)} is refused and moves the shaft",
                    expected="a shaft that stays", got=f"{now.value - start.value:+.1f} deg", exchange=exchange,
                    key=f"{command.name} refused and moved",
                )  # fmt: skip

    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{what}", f"{words} of {field.name} is refused.",
        "success, silence, or a shaft that moves", check, command=command, rests_on=(Doubt.LIMITS,), at_best=Certainty.LIKELY,
        aspect=Aspect.BOUNDARY if what != "unlisted" else Aspect.RANGE, fields=(field.name,),
        parameters={"field": field.name, "values": values}, **_needs(dialect, command),
    )  # fmt: skip


def _reserved_bits(command: Command) -> tuple[int, ...]:
    return limits.reserved_masks(command.request_forms[0].layout)


def _reserved(dialect: Dialect, command: Command) -> Claim:
    """Make the claim about reserved bits of a motion: they change nothing, as far as anybody can say."""
    form = command.request_forms[0]

    def check(probe: Probe) -> None:
        ready(probe)
        for mask in _reserved_bits(command):
            values = values_for(probe, command)
            exchange = probe.ask_built(with_reserved(probe, command, form, values, mask))
            probe.reply(exchange)
            refused = probe.refused(exchange)
            probe.wait(200 * MS)
            rpm = abs(motion.speed(probe).value)
            end(probe, command)
            if refused or abs(rpm - SLOW) > 2:
                got = "a refusal" if refused else f"{rpm:.0f} rpm"
                raise Refuted(
                    f"{command.name} with the reserved bit {mask:#x}: {got}", expected=f"{SLOW} rpm", got=got, exchange=exchange
                )

    return declare(
        dialect, Theme.RANGES, f"{command.name}/reserved", "Reserved bits of a motion change nothing.",
        "a refusal, or another speed", check, command=command, at_best=Certainty.OPEN, aspect=Aspect.RANGE,
        parameters={"masks": _reserved_bits(command)}, **_needs(dialect, command),
    )  # fmt: skip


# --- speeds -----------------------------------------------------------------------------------------------------------


def run_up(probe: Probe, command: Command, speed: int) -> tuple[float, Any]:
    """Begin a run or a far move at a speed by a steep ramp, measure the shaft's speed, and stop; rpm and the exchange.

    Raises Refuted where the drive refuses it.
    """
    values = values_for(probe, command, **far_values(probe, command), speed=speed, acceleration=STEEP)
    exchange = expect_accepted(probe, command, values, f"speed {speed}")
    probe.wait(min(speed, 3100) * (256 - STEEP) * 50_000 + 200 * MS)
    rpm = abs(effects.steady_speed(probe))
    end(probe, command)
    if rpm < 1 and speed:
        raise Inconclusive(f"{command.name} at speed {speed} is over already: how far it goes is another claim's")
    return rpm, exchange


def _judge(command: Command, speed: int, expected: int, rpm: float, exchange: Any, why: str) -> None:
    if abs(rpm - expected) > max(2.0, expected * SPEED_SHARE):
        raise Refuted(
            f"{command.name} at speed {speed} turns the shaft at {rpm:.0f} rpm, {why}", expected=f"{expected} rpm",
            got=f"{rpm:.0f} rpm", exchange=exchange, key=f"{command.name} speed {expected}",
        )  # fmt: skip


def _too_fast(dialect: Dialect, command: Command, field: Field, values: tuple[int, ...]) -> Claim:
    mode = motion.bus_modes(dialect)[-1]
    highest = MODE_MAXIMUM_SPEEDS.get(mode, field.high)

    def check(probe: Probe) -> None:
        ready(probe, mode)
        for value in values:
            rpm, exchange = run_up(probe, command, value)
            _judge(command, value, highest, rpm, exchange, f"expected the highest of {mode}")

    return declare(
        dialect, Theme.RANGES, f"{command.name}/speed/above", f"A speed above {field.high} runs at the highest of the mode.",
        "a refusal, or another speed", check, command=command, rests_on=(Doubt.LIMITS,), aspect=Aspect.BOUNDARY,
        fields=("speed",), parameters={"field": "speed", "values": values}, **_needs(dialect, command),
    )  # fmt: skip


def _speed_width(dialect: Dialect, command: Command) -> Claim:
    def check(probe: Probe) -> None:
        ready(probe)
        rpm, exchange = run_up(probe, command, _TELLING_RPM)
        _judge(command, _TELLING_RPM, _TELLING_RPM, rpm, exchange, "expected the speed that was sent")

    return declare(
        dialect, Theme.RANGES, f"{command.name}/speed/width", "All bits of a speed count.", "the speed of its low byte alone",
        check, command=command, aspect=Aspect.RANGE, fields=("speed",), parameters={"field": "speed"},
        **_needs(dialect, command),
    )  # fmt: skip


def _mode_limit(dialect: Dialect, mode: str) -> Claim:
    command = dialect.by_verb[Verb.RUN_SPEED]
    declared = command.request_forms[0].layout.named["speed"]
    highest = MODE_MAXIMUM_SPEEDS.get(mode, declared.high)
    below, above = highest - 50, min(highest + 100, declared.wire_maximum)

    def check(probe: Probe) -> None:
        ready(probe, mode)
        for speed, expected in ((below, below), (highest, highest), (above, highest)):
            rpm, exchange = run_up(probe, command, speed)
            _judge(command, speed, expected, rpm, exchange, f"in {mode}, whose highest speed is {highest}")

    statement = f"In {mode} the shaft turns at {highest} rpm at most, and at less as sent."
    return declare(
        dialect, Theme.RANGES, f"run_speed/speed/{mode}", statement,
        "a refusal, or another speed", check, command=command, rests_on=(Doubt.LIMITS,), aspect=Aspect.BOUNDARY,
        fields=("speed", "work_mode"), parameters={"mode": mode}, **_needs(dialect, command),
    )  # fmt: skip


# --- distances --------------------------------------------------------------------------------------------------------


def _width(dialect: Dialect, command: Command, field: Field) -> Claim:
    """Make the claim that every byte of a distance counts: a move of 256^n + a little is not one of a little."""
    signs = (1, -1) if field.kind is Kind.INT else (1,)
    units = moves.units_per_turn(command)
    little = units // 64
    distances = tuple(s * ((1 << shift) + little) for s in signs for shift in range(8, field.bit_width - (len(signs) - 1), 8))

    def check(probe: Probe) -> None:
        ready(probe)
        ways: set[bool] = set()
        for distance in distances:
            start = base(probe, command)
            if not field.low <= start + distance <= field.high:
                raise Inconclusive(f"from {start} no move by {distance} fits the field")
            before = motion.position(probe)
            values = values_for(probe, command, speed=60, acceleration=STEEP, **{field.name: start + distance})
            exchange = expect_accepted(probe, command, values, f"a distance of {distance}")
            probe.wait(WATCH_NS)
            gone = (motion.position(probe).value - before.value) / 360 * units
            end(probe, command)
            least = min(abs(distance), units // 2)
            ways.add(gone * distance > 0)
            if abs(gone) < least * 0.95 or abs(gone) > abs(distance) * 1.05 + units * 0.01 or len(ways) > 1:
                raise Refuted(
                    f"{command.name} by {distance} {field.unit} moves the shaft by {gone:.0f} in the first second",
                    expected=f"{least} or more, and the other way for the other sign",
                    got=f"{gone:.0f}", exchange=exchange, key=f"{command.name} width",
                )  # fmt: skip

    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/width", f"All bytes of {field.name} count, and its sign.",
        "a move by what its low bytes say", check, command=command, aspect=Aspect.RANGE, fields=(field.name,),
        parameters={"field": field.name, "values": distances}, **_needs(dialect, command),
    )  # fmt: skip
