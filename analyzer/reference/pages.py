"""Reference pages of the catalogue as plain text, of one width everywhere, so that they can be piped and compared."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from analyzer.catalogue import Command, Dialect, Erratum, Form, RiskRule, Role, Vector, all_fields
from analyzer.codec import codec
from analyzer.decoder import slots_of
from analyzer.dialects import code_text
from analyzer.encoder import SLOTS, assemble
from analyzer.layout import Effect, Field, Layout
from analyzer.reference.bit_diagram import bit_diagram
from analyzer.reference.columns import WIDTH, columns, paragraph, styled
from analyzer.reference.field_table import field_table
from analyzer.reference.hex_frame import write_frame
from analyzer.reference.objects import concerns, risk_values
from analyzer.values import value_text

_INDENT = "  "
#: More kinds of risk than this are not listed in the overview.
_RISKS_LISTED = 4
#: Longer frames are not spelt out.
_SHOWN_BYTES = 32
#: Of more codes than this only the first are named.
_CODES_LISTED = 4


# --- overview ---------------------------------------------------------------------------------------------------------


def overview(dialect: Dialect) -> Iterator[str]:
    """Yield the lines of a dialect's overview: what it is, and a line for each command."""
    yield styled(f"{dialect.name}: {dialect.title}", "bold")
    first, last = dialect.addresses
    everyone = "none for all" if dialect.broadcast is None else f"{dialect.broadcast} for all"
    examples = sum(len(c.vectors) for c in dialect.commands)
    facts = [
        ("manual", dialect.manual),
        ("bus", f"{dialect.bus}, {', '.join(str(r) for r in dialect.baud_rates)} (the first is the default)"),
        ("addresses", f"{first}..{last}; {everyone}"),
        ("models", ", ".join(dialect.models) + (f" (shown: {dialect.model})" if dialect.model else "")),
        ("content", f"{len(dialect.commands)} commands, {examples} worked examples, {len(dialect.errata)} errata"),
    ]
    yield from columns([(n, v) for n, v in facts if v.strip()], indent=_INDENT)
    yield ""
    yield from listing(dialect.commands)


def listing(commands: Iterable[Command]) -> Iterator[str]:
    """Yield a line for each command: code, name, section, risk, summary."""
    rows = [("code", "name", "section", "risk", "summary")]
    for command in commands:
        risks = sorted(command.all_risks)
        shown = ", ".join(risks) if len(risks) <= _RISKS_LISTED else "by its content"
        rows.append((_code(command), command.name, command.section, shown, command.summary))
    yield from columns(rows, indent=_INDENT)


def _code(command: Command) -> str:
    code = code_text(command.code, command.function)
    return code if command.function is None else f"{command.function:02X}:{code}"


# --- one command ------------------------------------------------------------------------------------------------------


def page(dialect: Dialect, command: Command) -> Iterator[str]:
    """Yield the lines of a command's page."""
    model = f" ({dialect.model})" if dialect.model else ""
    yield styled(f"{command.name}  {_code(command)}  {dialect.name}{model}  section {command.section}", "bold")
    yield from paragraph(command.summary)
    yield ""
    yield from columns(list(_facts(dialect, command)), width=WIDTH, indent=_INDENT)
    yield from _forms(dialect, command, Role.REQUEST)
    if [f.layout for f in command.reply_forms] == [f.layout for f in command.request_forms] and command.reply_forms:
        # Several forms: a reply has one of them, but need not repeat what was sent.
        like = "the layouts of the request" if len(command.request_forms) > 1 else "the same as the request"
        yield from ("", styled("reply", "bold"), _INDENT + like)
    else:
        yield from _forms(dialect, command, Role.REPLY)
    yield from _status_lines(command)
    yield from _vector_lines(dialect, command)
    errata = [e for e in dialect.errata if concerns(e, command)]
    if errata:
        yield from ("", styled("errata", "bold"))
        for erratum in errata:
            yield from erratum_lines(erratum, indent=_INDENT)


def _facts(dialect: Dialect, command: Command) -> Iterator[tuple[str, str]]:
    if command.verb != command.name:
        yield "does", command.verb.value
    if command.printed:
        yield "printed", command.printed
    if command.function is not None:
        count = f", {command.quantity} registers" if command.quantity > 1 else ""
        yield "function", f"0x{command.function:02X}{count}"
    yield "risk", _risk_text(command)
    yield "modes", ", ".join(command.modes) or "any"
    if dialect.models:
        yield "models", ", ".join(command.models) or "all"
    yield "answered", _answered(dialect, command)
    for note in command.notes:
        yield "note", note


def _risk_text(command: Command) -> str:
    """Return the risks of a command, with the values on which they depend."""
    texts: dict[str, list[str]] = {}
    for rule in command.risk:
        where = texts.setdefault(", ".join(sorted(rule.risks)) + (f" where {rule.field} is " if rule.field else ""), [])
        if rule.field:
            where.append(_risk_values(rule, command))
    return "; ".join(text + ", ".join(values) for text, values in texts.items())


def _risk_values(rule: RiskRule, command: Command) -> str:
    low, high = risk_values(rule, command)
    if low != high:
        return f"{low}..{high}"
    field = all_fields(command.request_forms).get(rule.field)
    name = field.choice_names.get(low) if field is not None else None
    return str(low) if name is None else f"{low} {name}"


def _answered(dialect: Dialect, command: Command) -> str:
    if not command.reply_forms:
        return "never"
    silent = []
    if dialect.broadcast is not None:
        if not command.broadcastable:
            silent.append("not for all")
        elif not command.answers_broadcast:
            silent.append("not when sent to all")
    if not command.answers_group and dialect.effect(Effect.GROUP):
        silent.append("not when sent to a group")
    if command.silenced:
        silent.append("not while respond is 0")
    return "yes" + (f", but {', '.join(silent)}" if silent else "")


# --- forms ------------------------------------------------------------------------------------------------------------


def _forms(dialect: Dialect, command: Command, role: Role) -> Iterator[str]:
    forms = command.request_forms if role is Role.REQUEST else command.reply_forms
    own = [f for f in forms if f.code is None]
    for form in own:
        yield ""
        yield styled(_form_title(form, role, len(own) > 1), "bold")
        yield from _form_lines(dialect, command, form, role)
    elsewhere = [f for f in forms if f.code is not None]
    if elsewhere:
        yield from ("", styled(f"{role}, under the code of the requested parameter", "bold"))
        yield from columns(_elsewhere(dialect, elsewhere), width=WIDTH, indent=_INDENT)


def _form_title(form: Form, role: Role, several: bool) -> str:
    words = [str(role)]
    if several and form.name != role:
        words.append(form.name)
    if form.models:
        words.append(f"({', '.join(form.models)})")
    if form.needs_request:
        words.append("(told by the open request)")
    return " ".join(words)


def _form_lines(dialect: Dialect, command: Command, form: Form, role: Role) -> Iterator[str]:
    layout = form.layout
    slots = command.slots if role is Role.REQUEST else None
    facts = [("data", _length(layout)), ("as bytes", _skeleton(dialect, command, form, role))]
    if slots is not None:
        facts[0] = ("data", f"{slots.count} slots of {slots.size} bytes: address, code, the data of that command, zeros")
    yield from columns(facts, width=WIDTH, indent=_INDENT)
    if slots is not None or not layout.fields:
        return
    yield ""
    yield from (_INDENT + line for line in bit_diagram(layout))
    yield ""
    yield from field_table(layout, indent=_INDENT)


def _length(layout: Layout) -> str:
    if not layout.fields:
        return "none"
    more = " or more" if layout.open_ended else ""
    return f"{layout.byte_length}{more} byte{'' if layout.byte_length == 1 and not more else 's'}"


def _skeleton(dialect: Dialect, command: Command, form: Form, role: Role) -> str:
    """Return the frame with every field at its default, to the first address, its own data between bars."""
    address = dialect.addresses[0]
    values: Mapping[str, Sequence[object]] = {SLOTS: []} if command.slots is not None and role is Role.REQUEST else {}
    built = assemble(dialect, command, address, values, role, form)
    frame, can_id = built.frame, built.can_id
    head = dialect.link.parse(frame, can_id)
    if len(frame) > _SHOWN_BYTES:
        return f"{write_frame(frame[: head.start])} | {head.stop - head.start} bytes | {write_frame(frame[head.stop :])}"
    parts = [write_frame(frame[: head.start], can_id), write_frame(frame[head.start : head.stop])]
    parts.append(write_frame(frame[head.stop :]))
    return " | ".join(p for p in parts if p)


def _elsewhere(dialect: Dialect, forms: Sequence[Form]) -> list[tuple[str, str, str]]:
    """Return a line for each layout that replies have under other codes; those without names share one."""
    lines: dict[tuple[str, ...], list[str]] = {}
    for form in forms:
        assert form.code is not None
        fields = ", ".join(form.layout.named) + (f" ({', '.join(form.models)})" if form.models else "")
        owner = _owner(dialect, form.code, form.layout)
        lines.setdefault((form.name, owner, fields), []).append(code_text(form.code))
    rows = [("form", "layout", "codes")]
    for (name, owner, fields), codes in lines.items():
        like = f"{fields}, as in {owner}" if owner else fields
        listed = codes if len(codes) <= _CODES_LISTED else [*codes[:2], "...", f"{len(codes)} codes"]
        rows.append((name, like, ", ".join(listed)))
    return rows


def _owner(dialect: Dialect, code: int, layout: Layout) -> str:
    """Return the name of the command of a code whose request has this layout, or nothing."""
    commands = dialect.by_code.get(code, ())
    return next((c.name for c in commands if any(f.layout == layout for f in c.request_forms)), "")


# --- statuses, examples, errata ---------------------------------------------------------------------------------------


def _status_lines(command: Command) -> Iterator[str]:
    replies = command.replies
    field = next((f.layout.named[replies.status] for f in command.reply_forms if replies.status in f.layout.named), None)
    rows = []
    for meaning, values in (("goes on", replies.interim), ("done", replies.final), ("failed", replies.failed)):
        if values and field is not None:
            rows.append((", ".join(value_text(field, v) for v in sorted(values)), meaning))
    rows += [(f"form {name}", "failed") for name in sorted(replies.failed_forms)]
    if rows:
        yield from ("", styled("what a reply means", "bold"))
        yield from columns(rows, indent=_INDENT)


def _vector_lines(dialect: Dialect, command: Command) -> Iterator[str]:
    if not command.vectors:
        return
    yield from ("", styled("worked examples", "bold"))
    for vector in command.vectors:
        words = [f"{vector.role}, section {vector.section or command.section}"]
        if vector.models:
            words.append("/".join(vector.models))
        if vector.computed:
            words.append("computed, not printed")
        if not vector.checksum:
            words.append("printed without its checksum")
        if vector.erratum:
            words.append(f"does not hold, see {vector.erratum}")
        yield from paragraph(vector.printed, indent=_INDENT)
        yield from paragraph(", ".join(words), indent=_INDENT * 2, hang=_INDENT)
        for decoded in _decoded(dialect, command, vector):
            yield from paragraph(decoded, indent=_INDENT * 2, hang=_INDENT)
        if vector.corrected:
            yield from paragraph(f"right: {vector.corrected}", indent=_INDENT * 2, hang=_INDENT)


def _decoded(dialect: Dialect, command: Command, vector: Vector) -> Iterator[str]:
    """Yield what a worked example says; of a package a line for each slot."""
    if command.slots is not None:
        head = dialect.link.parse(vector.data)
        slots = () if vector.erratum else slots_of(dialect, command, vector.data[head.start : head.stop])
        for number, slot in enumerate(slots, 1):
            if slot.command is not None and slot.form is not None:
                named = slot.form.layout.named
                shown = _values_text(named, codec(slot.form.layout).wire(slot.data))
                yield f"slot {number}: address {slot.address}, {slot.command.name}, {shown}"
        return
    forms = command.request_forms if vector.role is Role.REQUEST else command.reply_forms
    fields: Mapping[str, Field] = {}
    for form in forms:
        named = form.layout.named
        if vector.values.keys() == named.keys() and all(f.fixed in (None, vector.values[n]) for n, f in named.items()):
            fields = named
            break
    if fields:
        yield _values_text(fields, vector.values)


def _values_text(fields: Mapping[str, Field], values: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {value_text(fields[n], v)}" for n, v in values.items() if n in fields)


def erratum_lines(erratum: Erratum, *, indent: str = "", whose: bool = False) -> Iterator[str]:
    """Yield the lines of an erratum; `whose`: with the commands that it names."""
    damage = "damage of the scan, " if erratum.damage.value == "scan" else ""
    yield indent + styled(f"{erratum.id}  {damage}{erratum.certainty}  section {erratum.section}", "bold")
    facts = [("printed", erratum.printed), ("wrong", erratum.wrong), ("taken as", erratum.taken_as), ("why", erratum.why)]
    if whose and erratum.commands:
        facts.append(("commands", ", ".join(erratum.commands)))
    yield from columns(facts, width=WIDTH, indent=indent + _INDENT)


def errata(dialect: Dialect, chosen: Iterable[Erratum]) -> Iterator[str]:
    """Yield the lines of a dialect's errata."""
    listed = list(chosen)
    counts = ", ".join(f"{sum(e.certainty is c for e in listed)} {c}" for c in dict.fromkeys(e.certainty for e in listed))
    yield styled(f"{dialect.name}: {dialect.manual}: {len(listed)} errata" + (f" ({counts})" if counts else ""), "bold")
    for erratum in listed:
        yield ""
        yield from erratum_lines(erratum, whose=True)


def statements(dialect: Dialect) -> Iterator[str]:
    """Yield the lines of what a dialect's manual says a drive does."""
    listed = dialect.statements
    claimed = sum(bool(s.claims) for s in listed)
    yield styled(f"{dialect.name}: {dialect.manual}: {len(listed)} statements, {claimed} with claims", "bold")
    for statement in listed:
        yield ""
        yield f"{statement.id}"
        yield f"  {statement.says}"
        yield f"  {'claims  ' + ', '.join(statement.claims) if statement.claims else 'none    ' + statement.unclaimed}"
