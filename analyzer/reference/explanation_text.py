"""An explanation as text for people: a line for each part of the frame, from its first byte to its last.

    offset  hex    bits                 meaning
    3-4     01 40  0... .... .... ....  direction 0 ccw (0 ccw, 1 cw)
                   .000 .... .... ....  reserved 0
                   .... 0001 0100 0000  speed 320 rpm (0..3000 rpm)

Fields that share bytes stand in one block with the bits of each; `!` marks what the manual does not allow. Offsets count
from 0; on CAN from the first data byte, the identifier stands before it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

from analyzer.catalogue import Command, Form, Risk, Role
from analyzer.codec import codec
from analyzer.decoder import slots_of
from analyzer.dialects import code_text
from analyzer.findings import RULES
from analyzer.layout import Field, FieldKind, Order, ReadLayout
from analyzer.records import Message
from analyzer.reference.columns import COLOURS, columns, styled
from analyzer.reference.explanation import Explanation
from analyzer.reference.hex_frame import write_frame
from analyzer.values import range_text, value_text

_BYTES_A_ROW = 8
_CHOICES_SHOWN = 6


class Row(NamedTuple):
    """One line of the table: where, the bytes, the bits among them, what they mean."""

    offset: str
    hex: str
    bits: str
    meaning: str


def explanation_lines(found: Explanation) -> list[str]:
    """Return an explanation as lines."""
    lines = [styled(_title(found), "bold")]
    if found.message.command is not None:
        lines.append(found.message.command.summary)
    lines.append("")
    lines += columns([Row("offset", "hex", "bits", "meaning"), *rows(found)])
    if len(found.readings) > 1:
        lines += ["", "its bytes do not tell who sent it; both readings:"]
        lines += columns([(f"as a {m.role}:", _reading_text(m)) for m in found.readings], indent="  ")
    command = found.message.command
    if command is not None and found.message.role is not Role.REPLY and found.message.form is not None:
        lines += ["", f"risk: {', '.join(sorted(_risks(found, command))) or 'none'}"]
    lines += ["", *finding_lines(found)]
    return lines


def _risks(found: Explanation, command: Command) -> frozenset[str]:
    """Return what a request risks; a package risks what its slots do."""
    if command.slots is None:
        return frozenset(command.risks(found.message.values))
    risks: set[str] = set()
    for slot in slots_of(found.dialect, command, found.message.data):
        if slot.command is None or slot.form is None:
            risks.add(Risk.UNKNOWN)
        else:
            risks |= slot.command.risks(codec(slot.form.layout).wire(slot.data))
    return frozenset(risks)


def _title(found: Explanation) -> str:
    message, dialect = found.message, found.dialect
    words = [dialect.name + (f" ({dialect.model})" if dialect.model else "")]
    words.append("request" if message.role is Role.REQUEST else "reply" if message.role is Role.REPLY else "role unknown")
    everyone = " (all)" if message.address == dialect.broadcast else ""
    words.append(f"address {message.address if everyone else message.who}{everyone}")
    words.append(message.command.name if message.command is not None else "unknown command")
    if found.head.code is not None:
        words.append(code_text(found.head.code, found.head.function))
    if message.command is not None:
        words.append(f"section {message.command.section}")
    return "  ".join(words)


def finding_lines(found: Explanation) -> list[str]:
    """Return the findings, the right frame where it is another one, and the dialects that fit as well."""
    lines = []
    for issue in found.issues:
        severity = issue.severity or RULES[issue.rule].severity
        lines.append(styled(f"{severity.value:<7}  {issue.rule}: {issue.text}", COLOURS[severity]))
    if not found.issues:
        lines.append("no findings")
    if found.right is not None and found.right != found.sent:
        lines.append(f"the right frame: {write_frame(found.right, found.can_id)}")
    nameless = found.head.code is None and found.head.exception is None and found.message.role is Role.REPLY
    if nameless and "unknown_command" in (i.rule for i in found.issues):
        lines.append("only the request tells the meaning of such a reply: --request FRAME")
    if found.maybe_unchecked:
        lines.append("if the bytes are given without their checksum: --no-checksum")
    if found.also:
        words = "fits equally well" if found.checks_ok else "could as well be"
        lines.append(f"{words}: {', '.join(found.also)} (choose with --dialect)")
    return lines


# --- the table --------------------------------------------------------------------------------------------------------


def rows(found: Explanation) -> Iterator[Row]:
    """Yield the lines of the table."""
    data, message = found.message.frame.data, found.message
    start = found.data_start
    if found.can_id is not None:
        coded = not any(part.name == "code" for part in found.dialect.link.parts(data, found.can_id))
        code = f", code 0x{found.head.code:02X}" if coded and found.head.code is not None else ""
        yield Row("ID", f"{found.can_id:03X}", "", f"address {found.message.who}{code}")
    middle: list[tuple[int, Row]] = []
    for part in found.dialect.link.parts(data, found.can_id):
        if part.start < start:
            meaning = f"{part.name} {part.text}".rstrip() if part.name != "head" else f"head: {part.text}".rstrip(": ")
            if part.name in ("code", "register") and message.command is not None:
                meaning += f" {message.command.name}"
            middle.append((part.start, Row(_span(part.start, part.stop), _hex(data[part.start : part.stop]), "", meaning)))
    for check in found.checks:
        stop = check.start + len(check.expected)
        absent = check in found.absent
        if absent:
            meaning = f"{check.name}: none given, computed {_hex(check.expected)}"
        elif check.ok:
            meaning = f"{check.name}: as computed"
        else:
            meaning = f"! {check.name}: got {_hex(check.got)}, computed {_hex(check.expected)}"
        middle.append((check.start, Row(_span(check.start, stop), "" if absent else _hex(check.got), "", meaning)))
    before = [row for at, row in sorted(middle, key=lambda m: m[0]) if at < start]
    after = [row for at, row in sorted(middle, key=lambda m: m[0]) if at >= start]
    yield from chain(before, _data_rows(found, message, start), after)


def _data_rows(found: Explanation, message: Message, start: int) -> Iterator[Row]:
    if message.command is not None and message.command.slots is not None and message.form is not None:
        yield from _slot_rows(found, message.command, start)
    elif message.form is not None and isinstance(message.form.layout, ReadLayout):
        yield from _read_rows(message, start, found.head.stop)
    elif message.form is not None:
        yield from field_rows(message.form, message.data, start)
    else:
        yield from _raw_rows(message.data, start, "! data that match no layout of this command" if message.command else "data")


def _raw_rows(data: bytes, start: int, meaning: str) -> Iterator[Row]:
    for at in range(0, len(data), _BYTES_A_ROW):
        part = data[at : at + _BYTES_A_ROW]
        yield Row(_span(start + at, start + at + len(part)), _hex(part), "", meaning if at == 0 else "")


def _slot_rows(found: Explanation, package: Command, start: int) -> Iterator[Row]:
    """Yield the lines of a package's slots; the last one may be cut short."""
    assert package.slots is not None
    size = package.slots.size
    for number, at in enumerate(range(0, len(found.message.data), size), 1):
        raw = found.message.data[at : at + size]
        used = slots_of(found.dialect, package, raw)
        base = start + at
        if not used:
            yield Row(_span(base, base + len(raw)), _hex(raw), "", f"slot {number}: unused")
            continue
        slot = used[0]
        name = slot.command.name if slot.command is not None else "unknown command"
        yield Row(_span(base, base + 1), _hex(raw[:1]), "", f"slot {number}: address {slot.address}")
        yield Row(_span(base + 1, base + 2), _hex(raw[1:2]), "", f"code {code_text(slot.code)} {name}")
        body = raw[2:]
        length = 0
        if slot.form is not None:
            length = slot.form.layout.byte_length
            yield from field_rows(slot.form, slot.data, base + 2)
        rest = body[length:]
        if rest:
            filled = "filled up with zeros" if not any(rest) else "data" if slot.form is None else "! expected zeros"
            yield Row(_span(base + 2 + length, base + 2 + len(body)), _hex(rest), "", filled)


def field_rows(form: Form, data: bytes, base: int) -> Iterator[Row]:
    """Yield a line for each field of a layout; fields that share bytes follow one another under the same bytes."""
    block: list[tuple[int, Field]] = []
    for offset, field in form.layout:
        if offset % 8 == 0 and block:
            yield from _block_rows(block, data, base)
            block = []
        block.append((offset, field))
    if block:
        yield from _block_rows(block, data, base)


def _read_rows(message: Message, start: int, stop: int) -> Iterator[Row]:
    """Yield the bytes of data whose reader alone knows where its values stand, and a line for each value."""
    assert message.form is not None
    layout = message.form.layout
    yield from _raw_rows(message.frame.data[start:stop], start, "data")
    shown = codec(layout).physical(message.data)
    for name, value in shown.items():
        if not (name.endswith(("_name", "_text")) and name[:-5] in shown):
            named = f"{value} {shown[name + '_name']}" if name + "_name" in shown else f"{value} {layout.units.get(name, '')}"
            yield Row("", "", "", f"{name} {named}".rstrip())


def _block_rows(block: list[tuple[int, Field]], data: bytes, base: int) -> Iterator[Row]:
    first, (last, final) = block[0][0] // 8, block[-1]
    stop = len(data) if final.bit_width == 0 else (last + final.bit_width) // 8
    raw = data[first:stop]
    if len(block) == 1:
        field = block[0][1]
        if field.kind is FieldKind.BYTES:
            yield from _raw_rows(raw, base + first, field.name)
            return
        yield Row(_span(base + first, base + stop), _hex(raw), "", _meaning(field, _value(field, raw, 0, len(raw) * 8)))
        return
    where, shown = _span(base + first, base + stop), _hex(raw)
    for offset, field in block:
        at = offset - first * 8
        yield Row(where, shown, _bits(raw, at, field.bit_width), _meaning(field, _value(field, raw, at, len(raw) * 8)))
        where = shown = ""


def _value(field: Field, raw: bytes, at: int, total: int) -> int:
    """Return a field's integer as sent from the bytes of its block, `at` bits behind their begin."""
    if field.order is Order.LITTLE:
        value = int.from_bytes(raw, "little")
    else:
        value = int.from_bytes(raw, "big") >> (total - at - field.bit_width) & ((1 << field.bit_width) - 1)
    if field.kind is FieldKind.INT and value >> (field.bit_width - 1) & 1:
        value -= 1 << field.bit_width
    return value


def _bits(raw: bytes, at: int, width: int) -> str:
    digits = "".join(f"{byte:08b}" for byte in raw)
    shown = "".join(d if at <= i < at + width else "." for i, d in enumerate(digits))
    return " ".join(shown[i : i + 4] for i in range(0, len(shown), 4))


def _meaning(field: Field, value: int) -> str:
    mark = "" if field.allows(value) else "! "
    if field.kind is FieldKind.RESERVED:
        return f"{mark}{field.name} {value}" + ("" if value == 0 else " (expected 0)")
    text = f"{mark}{field.name} {value_text(field, value)}"
    if field.scale != 1:
        text += f", sent as {value}"
    if field.fixed is None:
        text += f" ({range_text(field, _CHOICES_SHOWN)})"
    return f"{text}; {field.note}" if field.note else text


def _reading_text(message: Message) -> str:
    assert message.command is not None
    assert message.form is not None
    fields = message.form.layout.named
    shown = [f"{n} {value_text(fields[n], v)}" for n, v in message.values.items() if n in fields]
    return f"{message.command.name}" + (f": {', '.join(shown)}" if shown else ", without data")


def _span(start: int, stop: int) -> str:
    return str(start) if stop - start <= 1 else f"{start}-{stop - 1}"


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()
