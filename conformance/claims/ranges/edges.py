"""Values at, inside and outside the limits of a field, and what claims about ranges share.

    lowest, highest    the limits themselves         below, above    just outside them, and the last that the bits hold
    inside             some values between           listed          every choice
    unlisted           the gaps between choices

All are made from the fields of the catalogue. Settings stand in `ranges.settings`, motion in `ranges.motions`, what changes the
link in `ranges.link`. Dialects without replies that refuse have theirs in `ranges.obeyed` and `ranges.parameters`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from analyzer.catalogue import Command, Dialect, Doubt, Form, Risk, Verb
from analyzer.layout import Field, FieldKind
from conformance.claim import Aspect, NotRun, Theme
from conformance.claims.declare import Case, claim
from conformance.claims.requests import needs_motion
from conformance.model import limits
from conformance.motion import declared, motion
from conformance.talk import samples
from conformance.talk.acceptance import need_plain_replies
from conformance.talk.probe import Probe

#: Declares a check as claims about ranges.
of_ranges = partial(claim, Theme.RANGES, first=need_plain_replies)
#: What a value is called, by where it lies.
WHERE: Mapping[str, str] = {
    "lowest": "The lowest value",
    "highest": "The highest value",
    "inside": "A value between the limits",
    "listed": "Every listed value",
    "unlisted": "A value that is not listed",
    "below": "A value below the lowest",
    "above": "A value above the highest",
}
OUTSIDE = ("unlisted", "below", "above")
_BOUNDARIES = ("lowest", "highest", "below", "above")
#: How many values between the limits, and far outside them, are tried.
_INNER, _OUTER = 2, 3
#: Bits that a firmware may forget to look at.
_ALIASES = (0x10, 0x80, 0x100, 0x8000)

# --- values -----------------------------------------------------------------------------------------------------------


def _drawn(dialect: Dialect, command: Command, name: str, where: str, count: int) -> tuple[int, ...]:
    """Return values of a field that are drawn, its limits left out; the same in each run."""
    kept: dict[tuple[str, str, str], tuple[int, ...]] = dialect.__dict__.setdefault("_drawn", {})
    key = (command.name, name, where)
    if key not in kept:
        field = next(f.layout.named[name] for f in command.request_forms if name in f.layout.named)
        spans = limits.allowed(field) if where == "inside" else limits.forbidden(field)
        kept[key] = limits.between(spans, count, " ".join(key))
    return kept[key]


def inner(dialect: Dialect, command: Command, field: Field) -> tuple[int, ...]:
    """Return some values between the limits: the middle, one with both bytes filled, and drawn ones."""
    middle = (field.low + field.high) // 2
    return tuple(dict.fromkeys((middle, *_drawn(dialect, command, field.name, "inside", _INNER))))


def unlisted(dialect: Dialect, command: Command, field: Field) -> tuple[int, ...]:
    """Return the gaps of a field's choices, what they are with one bit more, and drawn values."""
    near = limits.beyond(field)
    if not near:
        return ()
    aliases = (v | bit for v in limits.edges(field)[:2] for bit in _ALIASES)
    outer = _drawn(dialect, command, field.name, "outside", _OUTER)
    more = (v for v in (*aliases, *outer) if v <= field.wire_maximum and not field.allows(v))
    return tuple(dict.fromkeys((*near, *more)))


def below(field: Field) -> tuple[int, ...]:
    """Return the values just below the limits of a field, and the last that its bits hold."""
    return tuple(v for v in limits.beyond(field) if v < field.low)


def above(field: Field) -> tuple[int, ...]:
    """Return the values just above the limits of a field, and the last that its bits hold."""
    return tuple(v for v in limits.beyond(field) if v > field.high)


def allowed(field: Field) -> dict[str, tuple[int, ...]]:
    """Return the values that a field allows, by where they lie. Those inside are drawn when they are needed (`tried`)."""
    if limits.listed(field) is not None:
        return {"listed": limits.edges(field)}
    found: dict[str, tuple[int, ...]] = {"lowest": (field.low,)}
    if field.high > field.low:
        found["highest"] = (field.high,)
    if field.high - field.low > 1:
        found["inside"] = ()
    return found


def forbidden(dialect: Dialect, command: Command, field: Field, *, far: bool) -> dict[str, tuple[int, ...]]:
    """Return the values that a field forbids, by where they lie. `far`: drawn ones above the highest too."""
    if limits.listed(field) is not None:
        found = {"unlisted": unlisted(dialect, command, field)}
    else:
        found = {"below": below(field), "above": above(field)}
        if far and found["above"]:
            drawn = _drawn(dialect, command, field.name, "outside", _OUTER)
            found["above"] += tuple(v for v in drawn if v > field.high)
    return {where: values for where, values in found.items() if values}


def tried(probe: Probe, command: Command, field: Field, values: tuple[int, ...]) -> tuple[int, ...]:
    """Return the values of a case: those that were given, or some between the limits."""
    return values or inner(probe.dialect, command, field)


# --- cases ------------------------------------------------------------------------------------------------------------


def case(dialect: Dialect, command: Command, field: Field, where: str, values: tuple[int, ...], **facts: Any) -> Case:
    """Return a case about values of a field. Its check can take `field`, `values`, and `where` for texts."""
    return Case(
        dialect,
        command,
        {"field": field, "values": values, "where": WHERE.get(where, where)},
        {
            "name": f"{{command}}/{field.name}/{where}",
            "aspect": Aspect.BOUNDARY if where in _BOUNDARIES else Aspect.RANGE,
            "fields": (field.name,),
            "parameters": {"field": field.name, "values": values},
            **facts,
        },
    )


def fields(command: Command) -> Iterator[Field]:
    """Yield the fields of all forms of a request that have a choice of values, each name once."""
    seen: set[str] = set()
    for form in command.request_forms:
        for name, field in form.layout.named.items():
            if name not in seen and field.fixed is None and field.kind is not FieldKind.BYTES:
                seen.add(name)
                yield field


def form_of(command: Command, field: Field) -> Form:
    """Return the form of a request that has a field."""
    return next(f for f in command.request_forms if field.name in f.layout.named)


def doubts(where: str) -> tuple[Doubt, ...]:
    """Return what a claim about values of a field rests on."""
    return (Doubt.VALUES, Doubt.LAYOUT, *((Doubt.LIMITS,) if where in OUTSIDE else ()))


def needs(dialect: Dialect, command: Command, every: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what a claim must declare that sends a command with these values."""
    risks: set[Risk] = set()
    for values in every:
        risks |= command.risks(values)
    names = [name for form in command.request_forms for name in form.layout.named] if Risk.SETTING in risks else []
    if needs_motion(command):
        risks |= declared.risks(dialect)
        names += declared.settings(dialect)
    return {
        "risks": frozenset(risks) - {Risk.READ},
        "settings": tuple(dict.fromkeys(n for n in names if n != "execute")),
        "alone": Risk.LINK in risks,
        "by_name": Risk.DESTRUCTIVE in risks or command.verb is Verb.CALIBRATE,
    }


# --- what checks do ---------------------------------------------------------------------------------------------------


def plain(probe: Probe, command: Command, form: Form, **changed: int) -> dict[str, Any]:
    """Return plain values of a form with some changed."""
    return samples.sample(probe.dialect, command, form, address=probe.address) | changed


def prepare(probe: Probe, command: Command) -> None:
    """Bring the drive into a state in which only the values of a command can be wrong."""
    if needs_motion(command):
        motion.ready_to_move(probe)


def need_model(probe: Probe, field: Field) -> None:
    """Raise NotRun where a limit differs by model and the model of the drive was not given."""
    if field.models and not probe.rig.model and not probe.rig.emulated:
        known = " or ".join(sorted(field.models))
        raise NotRun(f"the limit of {field.name} is one of the model, and it is not known: add model={known} to the drive")


def text(field: Field, value: int) -> str:
    """Return a field and its value for people."""
    number = f"{value:#x}" if field.choices is not None else str(value)
    return f"{field.name} {number}"
