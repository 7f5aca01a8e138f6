"""Columns of tables: how a field is called, what it holds, its unit, and where the manual says so.

A table of any kind takes the columns of decoded fields from `fields_of`, made from the layout of a form. What several forms
have in common (`merged`) is one column where the unit is the same; a field with several units has a column for each.

Choices are texts: the name, or the number where it has none. A field whose number may not be exact has a twin, the exact text.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import reduce
from typing import Any

from analyzer.catalogue import Command, Dialect, Form
from analyzer.codec import codec
from analyzer.layout import NOT_NUMERIC, STATE_UNITS, Field, FieldKind

TWIN = "_text"


class Kind(StrEnum):
    """What a column holds. `TIME`: nanoseconds since the epoch, or since some beginning."""

    TIME = "time"
    TEXT = "text"
    INTEGER = "integer"
    NUMBER = "number"
    FLAG = "flag"


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column. `field`: the field's own name; `name`: what no other column of the table has.

    `sections`, `manuals`, `dialects`: where it is described and used; `choices`: the texts that the manual lists.
    """

    field: str
    kind: Kind
    unit: str = ""
    name: str = ""
    note: str = ""
    sections: tuple[str, ...] = ()
    manuals: tuple[str, ...] = ()
    dialects: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()

    @property
    def heading(self) -> str:
        """The name with the unit, where nothing else can tell it; of a field with several units without the suffix."""
        return f"{self.name.removesuffix(suffix(self.unit))} [{self.unit}]" if self.unit else self.name

    @property
    def about(self) -> dict[str, str]:
        """Metadata: the unit, what it means, and where the manual says so."""
        values = {
            "unit": self.unit,
            "note": self.note,
            "section": ", ".join(sorted(self.sections, key=_in_order)),
            "manual": "; ".join(self.manuals),
            "dialect": ",".join(self.dialects),
            "choices": ", ".join(self.choices),
        }
        return {name: value for name, value in values.items() if value}


def _in_order(section: str) -> list[int]:
    return [int(part) if part.isdecimal() else 0 for part in section.split(".")]


def own(field: str, kind: Kind, unit: str = "", note: str = "") -> Column:
    """Return a column that is no field of a command."""
    return Column(field=field, name=field, kind=kind, unit=unit, note=note)


#: What every message has, before its fields and behind them.
HEAD = (
    own("time", Kind.TIME, note="when the last byte came"),
    own("elapsed", Kind.NUMBER, "s", "since the first message"),
    own("bus", Kind.TEXT),
    own("dialect", Kind.TEXT),
    own("address", Kind.INTEGER, note="of the drive; of a foreign CAN frame its identifier"),
    own(
        "role",
        Kind.TEXT,
        note="request, reply, unknown, foreign (not of this dialect); junk; finding: told later than its message",
    ),
    own("command", Kind.TEXT),
)
TAIL = (
    own("latency", Kind.NUMBER, "ms", "from the end of the request to the start of the reply"),
    own("checksum_ok", Kind.FLAG),
    own("junk", Kind.TEXT, note="why these bytes belong to no frame"),
    own("severity", Kind.TEXT, note="of the worst finding"),
    own("findings", Kind.TEXT, note="the rules that are broken"),
    own("finding_texts", Kind.TEXT, note="what is wrong, in words"),
    own("raw", Kind.TEXT, note="bytes of the frame, hex; on CAN the data bytes"),
    own("offset", Kind.INTEGER, note="bytes of this bus before the frame"),
    own("sequence", Kind.INTEGER, note="number of the message; of a finding that of the message it is about"),
    own("request_sequence", Kind.INTEGER, note="sequence of the request that is answered"),
)
SLOTS = own("slots", Kind.TEXT, note="requests in a package, as JSON")


def suffix(unit: str) -> str:
    """Return a unit as the end of a name: `_rpm`, `_deg_per_s`."""
    return "_" + re.sub(r"\W+", "_", unit.replace("/", "_per_")).strip("_")


def fields_of(dialect: Dialect, command: Command, form: Form) -> tuple[Column, ...]:
    """Return the columns of one form of a command, named as their fields."""
    columns: list[Column] = []
    for field in form.layout.named.values():
        column = _column(dialect, command, field)
        columns.append(column)
        if field.has_text_twin:
            note = "the exact value, where it is beyond 2**53"
            columns.append(replace(column, field=field.name + TWIN, name=field.name + TWIN, kind=Kind.TEXT, note=note))
    return tuple(columns)


def _column(dialect: Dialect, command: Command, field: Field) -> Column:
    if field.kind in NOT_NUMERIC or field.choices is not None:
        kind = Kind.TEXT
    else:
        kind = Kind.INTEGER if field.scale == 1 and field.kind is not FieldKind.NUMBER else Kind.NUMBER
    return Column(
        field=field.name,
        name=field.name,
        kind=kind,
        unit=field.unit,
        note=field.note,
        sections=(command.section,),
        manuals=(dialect.manual,),
        dialects=(dialect.name,),
        choices=tuple(field.choice_names.values()),
    )


def reader_of(form: Form) -> Callable[[bytes], list[Any]]:
    """Return what reads data of a form into the values of its columns; None for a value or a text twin that is not there."""
    physical = codec(form.layout).physical
    names = [(name, field.choices is not None, field.has_text_twin) for name, field in form.layout.named.items()]

    def read(data: bytes) -> list[Any]:
        got = physical(data)
        values: list[Any] = []
        for name, chosen, wide in names:
            value = got.get(name)
            if chosen and value is not None:
                value = got.get(name + "_name", str(value))
            values.append(" ".join(map(str, value)) if isinstance(value, list) else value)
            if wide:
                values.append(got.get(name + TWIN))
        return values

    return read


def state_columns() -> dict[str, Column]:
    """Return the columns of the derived state of a drive, by quantity."""
    note = "from every reply that carries it, in one unit for all dialects"
    return {name: own(name, Kind.NUMBER, unit, note) for name, unit in STATE_UNITS.items()}


def merged(columns: Iterable[Column]) -> Column:
    """Return columns of one name and unit as one. Texts and numbers together are texts."""
    return reduce(_merge, columns)


def _merge(one: Column, other: Column) -> Column:
    if one == other:
        return one
    kinds = {one.kind, other.kind}
    kind = one.kind if len(kinds) == 1 else Kind.NUMBER if kinds == {Kind.INTEGER, Kind.NUMBER} else Kind.TEXT

    def both(a: tuple[str, ...], b: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*a, *b)))

    return replace(
        one,
        kind=kind,
        note=one.note if one.note == other.note else "",
        sections=both(one.sections, other.sections),
        manuals=both(one.manuals, other.manuals),
        dialects=both(one.dialects, other.dialects),
        choices=both(one.choices, other.choices),
    )


def units_of_dialects(dialects: Iterable[Dialect]) -> Mapping[str, frozenset[str]]:
    """Return the units that each field has anywhere in some dialects."""
    units: dict[str, set[str]] = {}
    for dialect in dialects:
        for command in (*dialect.commands, *dialect.fallbacks.values()):
            exception = (dialect.exception,) if dialect.exception is not None else ()
            for form in (*command.request_forms, *command.reply_forms, *exception):
                for column in fields_of(dialect, command, form):
                    units.setdefault(column.field, set()).add(column.unit)
    return {name: frozenset(each) for name, each in units.items()}


def told_apart(columns: Iterable[Column], units: Mapping[str, frozenset[str]]) -> list[Column]:
    """Return columns with names that tell their units apart, where the dialects have several.

    So a name depends on the dialects alone, not on what happens to be in a capture.
    """
    return [replace(c, name=c.name + suffix(c.unit)) if c.unit and len(units.get(c.field, ())) > 1 else c for c in columns]
