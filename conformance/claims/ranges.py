"""Ranges: a drive takes the values that the manual lists and refuses all others, and a refused value changes nothing.

    lowest, highest    the limits themselves         below, above    just outside them, and the last that the bits hold
    inside             some values between           listed          every choice
    unlisted           the gaps between choices      reserved        bits that are to be 0
    unchanged          what a drive had before a value that it refused

One claim for each field and each of these, made from the fields of the catalogue. This module has the commands whose replies
can say that they were refused; motion stands in `ranges_motion`, settings of the link in `ranges_link`, LK in `ranges_lk`.

Rules kept here:
- All fields but the one in question have plain values (`conformance.talk.samples`).
- Where the limit is one of the model, a drive on hardware is only judged when its model is known.
- That a value outside is refused is likely, not certain: the manuals list the values and say "set fail" without saying when.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Form, Risk, Verb
from analyzer.layout import Field, Kind
from conformance.claim import Aspect, Claim, Inconclusive, NotRun, Refuted, Theme
from conformance.claims import effects, ranges_link, ranges_lk, ranges_motion
from conformance.claims.declare import declare, made
from conformance.claims.requests import needing_plain_replies, needs_motion, with_reserved
from conformance.model import limits
from conformance.motion import motion
from conformance.talk import samples
from conformance.talk.acceptance import Acceptance, can_refuse, expect_accepted, expect_refused, sent
from conformance.talk.probe import Probe

#: Values of these do something that no claim about ranges needs; that they are executed is judged elsewhere.
NOT_ACCEPTED = frozenset({Verb.RESTART, Verb.RESTORE, Verb.CALIBRATE, Verb.HOME})
#: How many values between the limits, and far outside them, are tried.
INNER, OUTER = 2, 3
#: Bits that a firmware may forget to look at.
_ALIASES = (0x10, 0x80, 0x100, 0x8000)

_OUTSIDE = ("unlisted", "below", "above")

Check = Callable[[Probe], None]


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    for part in (_of_commands, ranges_motion.claims, ranges_link.claims, ranges_lk.claims):
        yield from made(dialect, Theme.RANGES, part.__module__.rpartition(".")[2], partial(_resting, part))


def _resting(make: Callable[[Dialect], Iterator[Claim]], dialect: Dialect) -> Iterator[Claim]:
    return map(needing_plain_replies, make(dialect))


def _of_commands(dialect: Dialect) -> Iterator[Claim]:
    for command in dialect.commands:
        if judgeable(command):
            yield from _of_command(dialect, command)


def judgeable(command: Command) -> bool:
    """Say whether the values of a command are judged here: its reply can say no, and it moves nothing."""
    reads = command.all_risks <= {Risk.READ}
    return can_refuse(command) and not reads and command.slots is None and not ranges_motion.turns(command)


def _of_command(dialect: Dialect, command: Command) -> Iterator[Claim]:
    seen: set[str] = set()
    for form in command.request_forms:
        for name, field in form.layout.named.items():
            if name not in seen and field.fixed is None and field.kind is not Kind.BYTES:
                seen.add(name)
                yield from _of_field(dialect, command, form, field)
    if limits.reserved_masks(command.request_forms[0].layout):
        yield _reserved(dialect, command, command.request_forms[0])


def _of_field(dialect: Dialect, command: Command, form: Form, field: Field) -> Iterator[Claim]:
    name = field.name
    accepts = command.verb not in NOT_ACCEPTED and name not in effects.LINK_FIELDS
    if limits.listed(field) is not None:
        if accepts:
            yield _accepted(dialect, command, form, field, "listed", limits.edges(field), "Every listed value")
        outside = unlisted(dialect, command, field)
        if outside:
            yield _refused(dialect, command, form, field, "unlisted", outside, "A value that is not listed")
    else:
        if accepts:
            yield _accepted(dialect, command, form, field, "lowest", (field.low,), "The lowest value")
            if field.high > field.low:
                yield _accepted(dialect, command, form, field, "highest", (field.high,), "The highest value")
            if field.high - field.low > 1:
                yield _accepted(dialect, command, form, field, "inside", None, "A value between the limits")
        below = tuple(v for v in limits.beyond(field) if v < field.low)
        above = tuple(v for v in limits.beyond(field) if v > field.high)
        if below:
            yield _refused(dialect, command, form, field, "below", below, "A value below the lowest")
        if above:
            far = tuple(v for v in outer(dialect, command, field) if v > field.high)
            yield _refused(dialect, command, form, field, "above", (*above, *far), "A value above the highest")
    effect = effects.of(dialect, command)
    if effect is not None and limits.beyond(field):
        yield _unchanged(dialect, command, form, field, effect)


# --- values -----------------------------------------------------------------------------------------------------------


def _drawn(dialect: Dialect, command: Command, name: str, where: str, count: int) -> tuple[int, ...]:
    """Return values of a field drawn by Hypothesis; the same in each run."""
    from conformance.model import strategies

    kept: dict[tuple[str, str, str], tuple[int, ...]] = dialect.__dict__.setdefault("_drawn", {})
    key = (command.name, name, where)
    if key not in kept:
        field = next(f.layout.named[name] for f in command.request_forms if name in f.layout.named)
        strategy = strategies.inside(field) if where == "inside" else strategies.outside(field)
        ends = set(limits.edges(field))
        drawn = strategies.drawn(strategy, count + len(ends & {field.low, field.high}))
        kept[key] = tuple(v for v in drawn if v not in ends)[:count]
    return kept[key]


def inner(dialect: Dialect, command: Command, field: Field) -> tuple[int, ...]:
    """Return some values between the limits: the middle, one with both bytes filled, and drawn ones."""
    middle = (field.low + field.high) // 2
    return tuple(dict.fromkeys((middle, *_drawn(dialect, command, field.name, "inside", INNER))))


def outer(dialect: Dialect, command: Command, field: Field) -> tuple[int, ...]:
    """Return some drawn values outside the limits."""
    return _drawn(dialect, command, field.name, "outside", OUTER)


def unlisted(dialect: Dialect, command: Command, field: Field) -> tuple[int, ...]:
    """Return the gaps of a field's choices, what they are with one bit more, and drawn values."""
    near = limits.beyond(field)
    if not near:
        return ()
    aliases = (v | bit for v in limits.edges(field)[:2] for bit in _ALIASES)
    more = (v for v in (*aliases, *outer(dialect, command, field)) if v <= field.wire_maximum and not field.allows(v))
    return tuple(dict.fromkeys((*near, *more)))


# --- what a claim does ------------------------------------------------------------------------------------------------


def plain(probe: Probe, command: Command, form: Form, **changed: int) -> dict[str, Any]:
    """Return plain values of a form with some changed."""
    return samples.sample(probe.dialect, command, form, address=probe.address) | changed


def prepare(probe: Probe, command: Command) -> None:
    """Bring the drive into a state in which nothing but its values can be wrong with a command."""
    if needs_motion(command):
        motion.ready_to_move(probe)


def need_model(probe: Probe, field: Field) -> None:
    """Raise NotRun where the limit is one of the model and nobody said which it is."""
    if field.models and not probe.rig.model and not probe.rig.emulated:
        known = " or ".join(sorted(field.models))
        raise NotRun(f"the limit of {field.name} is one of the model, and it is not known: add model={known} to the drive")


def shown(field: Field, value: int) -> str:
    """Return a field and its value for people."""
    number = f"{value:#x}" if field.choices is not None else str(value)
    return f"{field.name} {number}"


def rests_on(*, outside: bool) -> tuple[Doubt, ...]:
    """Return what a claim about the values of a field rests on."""
    return (Doubt.VALUES, Doubt.LAYOUT, *((Doubt.LIMITS,) if outside else ()))


def needs(dialect: Dialect, command: Command, every: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what a claim must declare that sends a command with these values."""
    risks: set[Risk] = set()
    for values in every:
        risks |= command.risks(values)
    names = [name for form in command.request_forms for name in form.layout.named] if Risk.SETTING in risks else []
    if needs_motion(command):
        risks |= motion.risks(dialect)
        names += motion.settings(dialect)
    wipes = Risk.DESTRUCTIVE in risks or command.verb is Verb.CALIBRATE
    return {
        "risks": frozenset(risks) - {Risk.READ},
        "settings": tuple(dict.fromkeys(n for n in names if n != "execute")),
        "alone": Risk.LINK in risks,
        "by_name": wipes,
    }


def _accepted(
    dialect: Dialect, command: Command, form: Form, field: Field, what: str, values: tuple[int, ...] | None, words: str
) -> Claim:
    def check(probe: Probe) -> None:
        need_model(probe, field)
        prepare(probe, command)
        for value in tried():
            expect_accepted(probe, command, plain(probe, command, form, **{field.name: value}), shown(field, value), form=form)
        after(probe, command)

    def tried() -> tuple[int, ...]:
        return inner(dialect, command, field) if values is None else values

    statement = f"{words} of {field.name} is accepted."
    return _claim(dialect, command, form, field, what, statement, "a refusal", check, values or ())


def after(probe: Probe, command: Command) -> None:
    """Leave the motor enabled and standing where a command may have changed that."""
    if command.verb is Verb.ENABLE:
        probe.ask(command, {"enabled": 1})
    if command.verb is Verb.HOME:
        probe.ask(Verb.EMERGENCY_STOP)


def _refused(
    dialect: Dialect, command: Command, form: Form, field: Field, what: str, values: tuple[int, ...], words: str
) -> Claim:
    def check(probe: Probe) -> None:
        need_model(probe, field)
        prepare(probe, command)
        for value in values:
            built = probe.build(command, plain(probe, command, form, **{field.name: value}), form=form)
            expect_refused(probe, built, shown(field, value))
        after(probe, command)

    statement = f"{words} of {field.name} is refused."
    return _claim(
        dialect, command, form, field, what, statement, "success, or silence", check, values, at_best=Certainty.LIKELY
    )


def _unchanged(dialect: Dialect, command: Command, form: Form, field: Field, effect: effects.Effect) -> Claim:
    wrong = limits.beyond(field)
    bad = (wrong[0], wrong[-1])

    def check(probe: Probe) -> None:
        need_model(probe, field)
        effect.ready(probe)
        prepare(probe, command)
        if effect.set_first:
            probe.do(command, plain(probe, command, form, **kept))
        before = effect.see(probe)
        for value in dict.fromkeys(bad):
            asked = plain(probe, command, form, **other) | {field.name: value}
            taken, exchange = sent(probe, probe.build(command, asked, form=form))
            if taken is not Acceptance.REFUSED:
                raise Inconclusive(f"{shown(field, value)} is {taken.value}: another claim is about that")
            now = effect.see(probe)
            if not effect.same(before, now):
                raise Refuted(
                    f"{command.name}: {shown(field, value)} is refused and changes something",
                    expected=f"as before: {effect.words(before)}",
                    got=effect.words(now),
                    exchange=exchange,
                    key=f"{command.name} refused and stored",
                )

    statement = f"A request with a forbidden {field.name} changes nothing."
    base, (kept, other) = samples.sample(dialect, command, form), effect.pair(form)
    claim_needs = needs(dialect, command, [base | kept, *(base | other | {field.name: v} for v in bad)])
    claim_needs["risks"] |= effect.risks(dialect)
    claim_needs["settings"] = tuple(dict.fromkeys((*claim_needs["settings"], *effect.settings(dialect))))
    claim_needs["alone"] = claim_needs["alone"] or effect.alone
    claim_needs["emulated"] = effect.emulated
    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/unchanged", statement, "what the drive had before has changed",
        check, command=command, rests_on=rests_on(outside=True), at_best=Certainty.LIKELY, aspect=Aspect.RANGE,
        fields=(field.name,), parameters={"field": field.name, "values": bad}, quirks=effect.quirks, **claim_needs,
    )  # fmt: skip


def _reserved(dialect: Dialect, command: Command, form: Form) -> Claim:
    """Make the claim about bits that are to be 0. In a register they are the high byte of the value: another value."""
    masks = limits.reserved_masks(form.layout)
    register = command.function is not None

    def check(probe: Probe) -> None:
        prepare(probe, command)
        values = plain(probe, command, form)
        for mask in masks:
            built = with_reserved(probe, command, form, values, mask)
            expect_refused(probe, built, f"a value with the bit {mask:#x} that is to be 0")

    certainty = Certainty.LIKELY if register else Certainty.OPEN
    demands = needs(dialect, command, [samples.sample(dialect, command, form)])
    words = "A register whose high byte is not 0" if register else "A request whose reserved bits are not 0"
    return declare(
        dialect, Theme.RANGES, f"{command.name}/reserved", f"{words} is refused.", "success, or silence", check,
        command=command, at_best=certainty, aspect=Aspect.RANGE, parameters={"masks": masks}, **demands,
    )  # fmt: skip


def _claim(
    dialect: Dialect,
    command: Command,
    form: Form,
    field: Field,
    what: str,
    statement: str,
    refuted_by: str,
    check: Check,
    values: tuple[int, ...],
    at_best: Certainty = Certainty.CERTAIN,
) -> Claim:
    sent = [samples.sample(dialect, command, form) | {field.name: v} for v in values or (field.low, field.high)]
    inside = what in ("inside", "listed", "unlisted")
    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{what}", statement, refuted_by, check,
        command=command, rests_on=rests_on(outside=what in _OUTSIDE), at_best=at_best,
        aspect=Aspect.RANGE if inside else Aspect.BOUNDARY, fields=(field.name,),
        parameters={"field": field.name, "values": values}, **needs(dialect, command, sent),
    )  # fmt: skip
