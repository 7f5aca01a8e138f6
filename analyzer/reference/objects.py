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


def _known(**values: Any) -> dict[str, Any]:
    """Return an object without what is not known or does not apply: None, and an empty text."""
    return {name: value for name, value in values.items() if value is not None and value != ""}


def _dialect(dialect: Dialect, commands: Sequence[Command] | None, errata_only: bool) -> dict[str, Any]:
    chosen = dialect.errata if commands is None else [e for e in dialect.errata if any(concerns(e, c) for c in commands)]
    return _known(
        name=dialect.name,
        title=dialect.title,
        manual=dialect.manual,
        bus=dialect.bus,
        models=list(dialect.models),
        model=dialect.model,
        addresses=list(dialect.addresses),
        broadcast=dialect.broadcast,
        baud_rates=list(dialect.baud_rates),
        commands=None if errata_only else [command_object(c) for c in (dialect.commands if commands is None else commands)],
        errata=[erratum_object(e) for e in chosen],
    )


def command_object(command: Command) -> dict[str, Any]:
    """Return a command as an object."""
    slots, several = command.slots, len(command.request_forms) > 1
    return _known(
        name=command.name,
        code=code_text(command.code, command.function),
        section=command.section,
        summary=command.summary,
        verb=command.verb.value,
        risk=sorted(command.all_risks),
        risk_rules=[_risk_rule(rule, command) for rule in command.risk],
        function=None if command.function is None else code_text(command.function),
        quantity=command.quantity or None,
        printed=command.printed,
        modes=list(command.modes) or None,
        models=list(command.models) or None,
        notes=list(command.notes) or None,
        slots=None if slots is None else {"count": slots.count, "size": slots.size},
        answers_broadcast=command.answers_broadcast,
        answers_group=command.answers_group,
        request=_union(command.request_forms),
        requests=[_form(f) for f in command.request_forms] if several else None,
        replies=[_form(f) for f in command.reply_forms],
        statuses=_statuses(command) or None,
        vectors=[_vector(v, command) for v in command.vectors],
    )


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
    return _known(
        name=form.name,
        fields=fields_of(form.layout),
        code=None if form.code is None else code_text(form.code),
        models=list(form.models) or None,
        needs_request=form.needs_request or None,
        request_values=dict(form.request_values or {}) or None,
    )


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
    is_number = field.kind is not FieldKind.BYTES
    free = is_number and field.choices is None and field.values is None and field.fixed is None
    return _known(
        name=field.name,
        printed=field.printed,
        bit_offset=offset,
        bit_width=field.bit_width,
        type=field.kind.value,
        order=field.order.value if is_number else None,
        minimum=field.low if free or field.minimum is not None else None,
        maximum=field.high if free or field.maximum is not None else None,
        choices=None if field.choices is None else {str(v): n for v, n in sorted(field.choice_names.items())},
        values=None if field.values is None else sorted(field.values),
        unit=field.unit,
        scale=number(field) if is_number else None,
        default=None if field.default is None else int(field.default),
        fixed=None if field.fixed is None else int(field.fixed),
        note=field.note,
        models={model: _limits(limits) for model, limits in field.models.items()} if field.models else None,
    )


def number(field: Field | ModelLimits) -> int | float:
    """Return a scale as a number."""
    scale = field.scale
    assert scale is not None
    return scale.numerator if scale.denominator == 1 else scale.numerator / scale.denominator


def _limits(limits: ModelLimits) -> dict[str, Any]:
    numbers = {name: getattr(limits, name) for name in ("minimum", "maximum", "default")}
    shown = _known(
        **{name: None if value is None else int(value) for name, value in numbers.items()},
        scale=None if limits.scale is None else number(limits),
    )
    # An empty unit is one, too: the model has none.
    return shown if limits.unit is None else shown | {"unit": limits.unit}


def _vector(vector: Vector, command: Command) -> dict[str, Any]:
    return _known(
        frame=vector.printed,
        role=vector.role.value,
        section=vector.section or command.section,
        checksum=vector.checksum,
        values={n: int(v) for n, v in vector.values.items()},
        computed=vector.computed,
        erratum=vector.erratum,
        corrected=vector.corrected,
        models=list(vector.models) or None,
    )


def erratum_object(erratum: Erratum) -> dict[str, Any]:
    """Return an erratum as an object."""
    names = ("id", "section", "printed", "wrong", "taken_as", "why", "certainty", "damage")
    return {name: str(getattr(erratum, name)) for name in names} | _known(commands=list(erratum.commands) or None)


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
