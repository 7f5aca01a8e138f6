"""The catalogue as plain objects, for programs: dialects, commands, forms, fields, worked examples and errata.

Every number of a field is the integer as sent; a physical value is that number times `scale`, in `unit`. `bit_offset`
counts from the first bit of the command's own data. What is not known or not declared is left out, never null.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from analyzer.catalogue import Command, Dialect, Erratum, Form, RiskRule, Vector, all_fields
from analyzer.dialects import code_text
from analyzer.layout import Field, FieldKind, Layout, ModelLimits


def reference(
    dialects: Sequence[Dialect], commands: Mapping[str, Sequence[Command]] | None = None, *, errata_only: bool = False
) -> dict[str, Any]:
    """Return the reference of dialects; `commands`: only these, by the dialect's name."""
    return {"dialects": [_dialect(d, None if commands is None else commands[d.name], errata_only) for d in dialects]}


def _dialect(dialect: Dialect, commands: Sequence[Command] | None, errata_only: bool) -> dict[str, Any]:
    shown: dict[str, Any] = {"name": dialect.name, "title": dialect.title, "manual": dialect.manual, "bus": dialect.bus}
    shown["models"] = list(dialect.models)
    if dialect.model:
        shown["model"] = dialect.model
    shown["addresses"] = list(dialect.addresses)
    if dialect.broadcast is not None:
        shown["broadcast"] = dialect.broadcast
    shown["baud_rates"] = list(dialect.baud_rates)
    if not errata_only:
        shown["commands"] = [command_object(c) for c in (dialect.commands if commands is None else commands)]
    chosen = dialect.errata if commands is None else [e for e in dialect.errata if any(concerns(e, c) for c in commands)]
    shown["errata"] = [erratum_object(e) for e in chosen]
    return shown


def command_object(command: Command) -> dict[str, Any]:
    """Return a command as an object."""
    shown: dict[str, Any] = {
        "name": command.name,
        "code": code_text(command.code, command.function),
        "section": command.section,
        "summary": command.summary,
        "verb": command.verb.value,
        "risk": sorted(command.all_risks),
        "risk_rules": [_risk_rule(rule, command) for rule in command.risk],
    }
    if command.function is not None:
        shown["function"] = code_text(command.function)
    if command.quantity:
        shown["quantity"] = command.quantity
    if command.printed:
        shown["printed"] = command.printed
    for name in ("modes", "models", "notes"):
        if getattr(command, name):
            shown[name] = list(getattr(command, name))
    if command.slots is not None:
        shown["slots"] = {"count": command.slots.count, "size": command.slots.size}
    shown["answers_broadcast"] = command.answers_broadcast
    shown["answers_group"] = command.answers_group
    shown["request"] = _union(command.request_forms)
    if len(command.request_forms) > 1:
        shown["requests"] = [_form(f) for f in command.request_forms]
    shown["replies"] = [_form(f) for f in command.reply_forms]
    statuses = _statuses(command)
    if statuses:
        shown["statuses"] = statuses
    shown["vectors"] = [_vector(v, command) for v in command.vectors]
    return shown


def _risk_rule(rule: RiskRule, command: Command) -> dict[str, Any]:
    shown: dict[str, Any] = {"risks": sorted(rule.risks)}
    if not rule.field:
        return shown
    low, high = risk_values(rule, command)
    return {**shown, "field": rule.field, "low": low, "high": high}


def risk_values(rule: RiskRule, command: Command) -> tuple[int, int]:
    """Return the first and the last value for which a rule holds, of those that its field can hold."""
    field = all_fields(command.request_forms).get(rule.field)
    if field is None:
        return rule.low, rule.high
    return max(rule.low, field.wire_minimum), min(rule.high, field.wire_maximum)


def _statuses(command: Command) -> dict[str, Any]:
    replies = command.replies
    shown: dict[str, Any] = {n: sorted(v) for n in ("interim", "final", "failed") if (v := getattr(replies, n))}
    if shown:
        shown["field"] = replies.status
    if replies.failed_forms:
        shown["failed_forms"] = sorted(replies.failed_forms)
    return shown


def _form(form: Form) -> dict[str, Any]:
    shown: dict[str, Any] = {"name": form.name, "fields": fields_of(form.layout)}
    if form.code is not None:
        shown["code"] = code_text(form.code)
    if form.models:
        shown["models"] = list(form.models)
    if form.needs_request:
        shown["needs_request"] = True
    if form.request_values:
        shown["request_values"] = dict(form.request_values)
    return shown


def fields_of(layout: Layout) -> list[dict[str, Any]]:
    """Return the fields of a layout as objects, reserved bits left out."""
    return [field_object(offset, field) for offset, field in layout if field.kind is not FieldKind.RESERVED]


def _union(forms: tuple[Form, ...]) -> list[dict[str, Any]]:
    """Return the fields of all forms of a request, each name once; what only one of several forms fixes is left out."""
    result: dict[str, dict[str, Any]] = {}
    for form in forms:
        for shown in fields_of(form.layout):
            known = result.setdefault(shown["name"], shown)
            if known.get("fixed") != shown.get("fixed"):
                known.pop("fixed", None)
    return list(result.values())


def field_object(offset: int, field: Field) -> dict[str, Any]:
    """Return a field as an object; `offset`: its first bit in the command's own data."""
    shown: dict[str, Any] = {"name": field.name}
    if field.printed:
        shown["printed"] = field.printed
    shown |= {"bit_offset": offset, "bit_width": field.bit_width, "type": field.kind.value}
    if field.kind is not FieldKind.BYTES:
        shown["order"] = field.order.value
        free = field.choices is None and field.values is None and field.fixed is None
        if free or field.minimum is not None:
            shown["minimum"] = field.low
        if free or field.maximum is not None:
            shown["maximum"] = field.high
        if field.choices is not None:
            shown["choices"] = {str(v): n for v, n in sorted(field.choice_names.items())}
        if field.values is not None:
            shown["values"] = sorted(field.values)
        if field.unit:
            shown["unit"] = field.unit
        shown["scale"] = number(field)
    for name in ("default", "fixed"):
        if getattr(field, name) is not None:
            shown[name] = int(getattr(field, name))
    if field.note:
        shown["note"] = field.note
    if field.models:
        shown["models"] = {model: _limits(limits) for model, limits in field.models.items()}
    return shown


def number(field: Field | ModelLimits) -> int | float:
    """Return a scale as a number."""
    scale = field.scale
    assert scale is not None
    return scale.numerator if scale.denominator == 1 else scale.numerator / scale.denominator


def _limits(limits: ModelLimits) -> dict[str, Any]:
    shown: dict[str, Any] = {}
    for name in ("minimum", "maximum", "default"):
        if getattr(limits, name) is not None:
            shown[name] = int(getattr(limits, name))
    if limits.scale is not None:
        shown["scale"] = number(limits)
    if limits.unit is not None:
        shown["unit"] = limits.unit
    return shown


def _vector(vector: Vector, command: Command) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "frame": vector.printed,
        "role": vector.role.value,
        "section": vector.section or command.section,
        "checksum": vector.checksum,
        "values": {n: int(v) for n, v in vector.values.items()},
        "computed": vector.computed,
    }
    if vector.erratum:
        shown["erratum"] = vector.erratum
    if vector.corrected:
        shown["corrected"] = vector.corrected
    if vector.models:
        shown["models"] = list(vector.models)
    return shown


def erratum_object(erratum: Erratum) -> dict[str, Any]:
    """Return an erratum as an object."""
    shown: dict[str, Any] = {
        "id": erratum.id,
        "section": erratum.section,
        "printed": erratum.printed,
        "wrong": erratum.wrong,
        "taken_as": erratum.taken_as,
        "why": erratum.why,
        "certainty": erratum.certainty.value,
        "damage": erratum.damage.value,
    }
    if erratum.commands:
        shown["commands"] = list(erratum.commands)
    return shown


def concerns(erratum: Erratum, command: Command) -> bool:
    """Say whether an erratum is about a command.

    It is if it names the command or one of its worked examples. It is also if its section is the command's, a part of it,
    or a section or range of sections around it.
    """
    if command.name in erratum.commands or any(v.erratum == erratum.id for v in command.vectors):
        return True
    return any(_touches(place.strip(), command.section) for place in erratum.section.split(","))


def _touches(place: str, section: str) -> bool:
    """Say whether a place, one section or a range `8.3.3 to 8.3.7`, lies in a section or around it."""
    first, _, last = place.partition(" to ")
    if not last:
        return _within(first, section) or _within(section, first)
    low, high, own = _numbers(first), _numbers(last), _numbers(section)
    return bool(low and high and own) and low <= own[: len(low)] and own[: len(high)] <= high


def _within(section: str, whole: str) -> bool:
    return section == whole or section.startswith(whole + ".")


def _numbers(section: str) -> tuple[int, ...]:
    """Return the numbers of a section; empty for one that goes by words."""
    parts = section.split(".")
    return tuple(int(p) for p in parts) if all(p.isdecimal() for p in parts) else ()
