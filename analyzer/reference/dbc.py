"""The commands of a CAN dialect as a DBC file: what other tools for CAN read.

The frames of one identifier are one message, multiplexed by the code. Where the identifier holds the code, each command is a
message. In DBC an identifier has one sender, so a file has either the replies or the requests.

What DBC cannot express is left out and listed: checksums, whose place depends on the length; data without an end; forms that
only the open request tells apart; a second form of one code.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.dialects import code_text
from analyzer.layout import Field, FieldKind, Order
from analyzer.reference.objects import number
from analyzer.table.extras import needed

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

#: The longest data of a classic CAN frame.
_LONGEST = 8


@dataclass(frozen=True, slots=True)
class Shape:
    """A form of a command that the file has: `identifier` and `head`, the frame's first bytes, tell it from others."""

    command: Command
    form: Form
    identifier: int
    head: bytes


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A form that the file does not have, and why."""

    command: Command
    form: Form
    why: str

    def __str__(self) -> str:
        return f"{self.command.name} ({self.form.name}): {self.why}"


def shapes(dialect: Dialect, address: int, role: Role) -> tuple[list[Shape], list[LeftOut]]:
    """Return what a file of one drive has, and what it leaves out, in the manual's order."""
    taken: dict[tuple[int, bytes], Shape] = {}
    left_out = []
    # A form without fixed values stands for its code, even behind others: a run for run and stop.
    every = sorted(_forms(dialect, role), key=lambda entry: any(f.fixed is not None for f in entry[1].layout.fields))
    for command, form in every:
        why = _inexpressible(form)
        identifier = dialect.link.identifier(command, address)
        if not why and identifier is not None:
            frame = dialect.link.build(command, form, address, bytes(form.layout.byte_length), role)
            head = frame[: dialect.link.parse(frame, identifier).start]
            other = taken.setdefault((identifier, head), Shape(command, form, identifier, head))
            if (other.command, other.form) == (command, form):
                continue
            why = f"{code_text(command.code, command.function)} is read as {other.command.name} ({other.form.name})"
        left_out.append(LeftOut(command, form, why))
    order = {command.name: number for number, command in enumerate(dialect.commands)}
    return (
        sorted(taken.values(), key=lambda shape: order[shape.command.name]),
        sorted(left_out, key=lambda entry: order[entry.command.name]),
    )


def _forms(dialect: Dialect, role: Role) -> Iterator[tuple[Command, Form]]:
    for command in dialect.commands:
        for form in command.request_forms if role is Role.REQUEST else command.reply_forms:
            yield command, form


def _inexpressible(form: Form) -> str:
    if form.needs_request:
        return "only the open request tells this reply from others"
    if form.layout.open_ended:
        return "its length is open"
    return ""


def dbc(dialect: Dialect, addresses: Iterable[int], role: Role) -> str:
    """Return the text of a DBC file with the frames of some drives. Raises UsageError where cantools is not installed."""
    can = needed("cantools.database.can")
    nodes, messages = [can.Node("host", None)], []
    for address in addresses:
        drive = f"drive_{address}"
        nodes.append(can.Node(drive, f"{dialect.title}, address {address}"))
        found, _ = shapes(dialect, address, role)
        by_identifier: dict[int, list[Shape]] = {}
        for shape in found:
            by_identifier.setdefault(shape.identifier, []).append(shape)
        sender, receiver = ("host", drive) if role is Role.REQUEST else (drive, "host")
        messages += [_message(dialect, drive, group, sender, receiver) for group in by_identifier.values()]
    text: str = can.Database(messages, nodes, version=dialect.manual, sort_signals=None).as_dbc_string(sort_signals=None)
    return text


def _message(dialect: Dialect, drive: str, group: Sequence[Shape], sender: str, receiver: str) -> Message:
    can = needed("cantools.database.can")
    several = bool(group[0].head)
    signals = [_code(group, receiver)] if several else []
    for shape in group:
        signals += _signals(shape, several, receiver)
    first = group[0].command
    return can.Message(  # type: ignore[no-any-return]
        group[0].identifier,
        drive if several else f"{drive}_{first.name}",
        _LONGEST if several else group[0].form.layout.byte_length,
        signals,
        comment=dialect.manual if several else _about(first),
        senders=[sender],
        sort_signals=None,
    )


def _code(group: Sequence[Shape], receiver: str) -> Signal:
    can, conversion = needed("cantools.database.can"), needed("cantools.database.conversion").BaseConversion
    choices = OrderedDict((int.from_bytes(shape.head, "big"), shape.command.name) for shape in group)
    return can.Signal(  # type: ignore[no-any-return]
        "code", 7, 8 * len(group[0].head), "big_endian", is_multiplexer=True, receivers=[receiver],
        conversion=conversion.factory(choices=choices), minimum=min(choices), maximum=max(choices),
    )  # fmt: skip


def _signals(shape: Shape, several: bool, receiver: str) -> Iterator[Signal]:
    can, conversion = needed("cantools.database.can"), needed("cantools.database.conversion").BaseConversion
    for offset, field in shape.form.layout:
        if field.kind is FieldKind.RESERVED:
            continue
        yield can.Signal(
            signal_name(shape.command, field) if several else field.name,
            _start(8 * len(shape.head) + offset, field),
            field.bit_width,
            "little_endian" if field.order is Order.LITTLE else "big_endian",
            field.kind is FieldKind.INT,
            conversion=conversion.factory(scale=number(field), choices=OrderedDict(field.choice_names) or None),
            minimum=field.physical(field.low),
            maximum=field.physical(field.high),
            unit=field.unit or None,
            comment=_about(shape.command),
            receivers=[receiver],
            multiplexer_ids=[int.from_bytes(shape.head, "big")] if several else None,
            multiplexer_signal="code" if several else None,
        )


def signal_name(command: Command, field: Field) -> str:
    """Return the name of a field's signal in a message that several commands share."""
    return f"{command.name}_{field.name}"


def _start(offset: int, field: Field) -> int:
    """Return where DBC says that a field begins: at its highest bit, or at its lowest where its low byte comes first."""
    return offset if field.order is Order.LITTLE else 8 * (offset // 8) + 7 - offset % 8


def _about(command: Command) -> str:
    return f"{command.section}: {command.summary}"
