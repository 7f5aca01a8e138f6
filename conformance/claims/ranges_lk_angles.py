"""Ranges of the LK commands that have choices or an angle: single-turn moves, the brake, and positions that are set.

angle        0 to 359.99 degrees are reached, more is not obeyed
direction    both listed ones lead to the angle, others are not obeyed
brake        what is not listed switches nothing
position     what is set is read, up to the limits of the type
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Aspect, Claim, Refuted, Theme
from conformance.claims import ranges
from conformance.claims.declare import declare
from conformance.claims.ranges_lk_looks import LOOK_NS, MODERATE, SAME, begun, claim_of, moderate, stays
from conformance.claims.requests import with_reserved
from conformance.model import limits
from conformance.motion import motion
from conformance.talk.probe import Probe

# --- angles, directions, brake ----------------------------------------------------------------------------------------


def _apart(probe: Probe, angle: int) -> None:
    """Bring the shaft away from an angle within the turn, so that a move to it shows."""
    now = probe.read("read_single_turn")
    if min((now - angle) % 36_000, (angle - now) % 36_000) < 3_000:
        probe.do("move_increment_limited", {"position": 6_000, "max_speed": MODERATE})
        motion.wait_standing(probe)


def angles(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    """Make the claims about the angle and the direction of a single-turn move."""

    def there(probe: Probe, value: int, direction: int) -> None:
        motion.ready_to_move(probe)
        _apart(probe, value)
        exchange = probe.ask(command, moderate(command, direction=direction, angle=value))
        probe.reply(exchange)
        motion.wait_standing(probe)
        now = probe.read("read_single_turn")
        off = min((now - value) % 36_000, (value - now) % 36_000) / 100
        if off > SAME:
            raise Refuted(
                f"{command.name}: angle {value} in direction {direction} ends at {now}", expected=f"{value}", got=f"{now}",
                exchange=exchange, key=f"{command.name} angle",
            )  # fmt: skip

    def nothing(probe: Probe, values: dict[str, int]) -> None:
        motion.ready_to_move(probe)
        _apart(probe, values["angle"] % 36_000)
        gone, exchange = begun(probe, command, moderate(command, **values))
        stays(command, " ".join(f"{n} {v}" for n, v in values.items()), gone, exchange)

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
        yield claim_of(
            dialect, command, field, what, f"{words} is reached.", "another angle", reached(*values), values, set(),
        )  # fmt: skip
    above = tuple(v for v in limits.beyond(field) if v > field.high)
    yield claim_of(
        dialect, command, field, "above", "An angle of a turn or more is not obeyed.", "a shaft that turns",
        ignored(*({"direction": 0, "angle": v} for v in above)), above, set(), at_best=Certainty.LIKELY,
    )  # fmt: skip
    direction = command.request_forms[0].layout.named.get("direction")
    if direction is None:
        return

    def both(probe: Probe) -> None:
        for value in limits.edges(direction):
            there(probe, 9_000, value)

    yield claim_of(
        dialect, command, direction, "listed", "Both directions lead to the angle.", "another angle", both,
        limits.edges(direction), set(),
    )  # fmt: skip
    wrong = ranges.unlisted(dialect, command, direction)
    yield claim_of(
        dialect, command, direction, "unlisted", "A direction that is not listed is not obeyed.", "a shaft that turns",
        ignored(*({"direction": v, "angle": 9_000} for v in wrong)), wrong, set(), at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield _reserved_move(dialect, command)


def _reserved_move(dialect: Dialect, command: Command) -> Claim:
    form = command.request_forms[0]
    mask = sum(limits.reserved_masks(form.layout))

    def check(probe: Probe) -> None:
        motion.ready_to_move(probe)
        _apart(probe, 9_000)
        exchange = probe.ask_built(with_reserved(probe, command, form, moderate(command, direction=0, angle=9_000), mask))
        probe.reply(exchange)
        probe.wait(LOOK_NS)
        rpm = motion.speed(probe).value
        motion.stand_still(probe)
        if rpm < 1:
            raise Refuted(f"{command.name} with its reserved byte set is not obeyed", expected="a shaft that turns",
                          got="a shaft that stays", exchange=exchange)  # fmt: skip

    return declare(
        dialect, Theme.RANGES, f"{command.name}/reserved", "The reserved byte of a move changes nothing.", "a shaft that stays",
        check, command=command, at_best=Certainty.OPEN, aspect=Aspect.RANGE, risks=motion.risks(dialect),
        parameters={"mask": mask},
    )  # fmt: skip


def brake(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    """Make the claim about brake controls that are not listed."""
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


# --- positions --------------------------------------------------------------------------------------------------------


def positions(dialect: Dialect, command: Command, field: Field) -> Iterator[Claim]:
    """Make the claims about positions that are set."""

    def read(values: tuple[int, ...]) -> Callable[[Probe], None]:
        def check(probe: Probe) -> None:
            motion.stand_still(probe)
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
        yield claim_of(
            dialect, command, field, what, f"{words} that is set is read.", "another position",
            read(values), values, {Risk.SETTING}, settings=("position",),
        )  # fmt: skip
