"""Spots: where in a run of bytes a frame may begin, and what it may mean. For a gate, which must not overlook one.

A framer looks for what is there; these are for what somebody could take to be there. A spot is a frame that can be read at
one place, however bad its checks, and however much of it is still to come. Nothing here says whether it counts: that is
for `conformance.gate.interpretations`; nothing here knows a link: that is for `conformance.gate.links`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from analyzer.catalogue import Command, Dialect, Form, Risk
from analyzer.codec import codec
from analyzer.layout import Kind


class Meaning(NamedTuple):
    """What a request may tell a drive. `values`: integers as sent, those that are there; `form` None: none fits."""

    command: Command
    form: Form | None
    values: dict[str, int]
    risks: frozenset[Risk]


@dataclass(frozen=True, slots=True)
class Spot:
    """A frame that can be read from `start` to `stop` (as far as its bytes are there).

    `known`: its code is in the catalogue; `sound`: whole, and its checks fit; `complete`: whole. `code_at`: the last byte
    that tells the code. `until`: behind the last byte that it is judged by; what comes later changes nothing about it.
    `only_first`: an unsound one counts only where a sending begins. `weak`: an unsound one does not count. `slot`: number
    of the slot of a package it stands in, from 1; 0: none. `address` None: it has not come yet.
    """

    dialect: Dialect
    start: int
    stop: int
    address: int | None
    code: int
    code_at: int
    until: int
    known: bool
    sound: bool
    complete: bool
    meanings: tuple[Meaning, ...]
    slot: int = 0
    only_first: bool = False
    weak: bool = False
    note: str = ""


class Found(NamedTuple):
    """What may begin at one place. `open`: bytes to come can still make or change it."""

    spots: tuple[Spot, ...]
    open: bool


NOTHING = Found((), False)
OPEN = Found((), True)


class Ear(ABC):
    """Reads what may be a frame of one dialect at a place."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect

    @abstractmethod
    def look(self, buffer: bytes, at: int) -> Found:
        """Return what may begin at `at`."""


def meanings(commands: Sequence[Command], data: bytes, size: int | None) -> tuple[Meaning, ...]:
    """Return what data of these commands (of one code) may mean.

    `data`: what is there of `size` bytes; None: how many there will be is not known. Whole data mean one thing, the first
    form that fits, as in the catalogue; data that are cut off may mean several; data of no layout the worst of each.
    """
    if size is not None and len(data) >= size:
        for command in commands:
            for form in command.request_forms:
                if codec(form.layout).matches(data):
                    values = codec(form.layout).wire(data)
                    return (Meaning(command, form, values, command.risks(values)),)
        return tuple(Meaning(c, None, {}, c.risks({})) for c in commands)
    found = []
    for command in commands:
        for form in command.request_forms:
            if size is not None and form.layout.byte_length != size:
                continue
            known = _partly(form, data)
            if known is not None:
                found.append(Meaning(command, form, known, command.risks(known)))
    return tuple(found) or tuple(Meaning(c, None, {}, c.risks({})) for c in commands)


def _partly(form: Form, data: bytes) -> dict[str, int] | None:
    """Return the values of the fields that are there in full; None where a field that makes the layout has another one."""
    layout = form.layout
    have = 8 * len(data)
    whole = codec(layout).wire(data[: layout.byte_length].ljust(layout.byte_length, b"\0"))
    values: dict[str, int] = {}
    for offset, field in layout:
        if field.kind in (Kind.RESERVED, Kind.BYTES) or offset + field.bit_width > have:
            continue
        value = whole[field.name]
        if field.fixed is not None and value != field.fixed:
            return None
        values[field.name] = value
    return values


def sizes_of(commands: Sequence[Command]) -> tuple[int, ...]:
    """Return the lengths of the requests of commands of one code, ascending; a package has none."""
    forms = (f for c in commands if c.slots is None for f in c.request_forms if not f.layout.open_ended)
    return tuple(sorted({f.layout.byte_length for f in forms}))
