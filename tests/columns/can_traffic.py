"""Exchanges of CAN drives, most of them plain, and all that spoils one."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence

from analyzer.catalogue import Command, Dialect, Form, Risk, Role
from analyzer.codec import codec
from analyzer.layout import FieldKind, Layout
from analyzer.records import CanFrame

_US = 1_000


def data_of(layout: Layout, chance: random.Random) -> bytes:
    """Return data of a layout with values that its manual allows."""
    values = {}
    for field in layout.fields:
        if field.kind is FieldKind.RESERVED:
            continue
        listed = [v for v in (field.values or field.choice_names) if field.allows(v)]
        if field.fixed is not None:
            values[field.name] = field.fixed
        elif listed:
            values[field.name] = chance.choice(listed)
        else:
            # A number that is exact in JSON.
            low, high = max(field.low, -(1 << 53)), min(field.high, 1 << 53)
            values[field.name] = chance.choice((low, high, 0, chance.randint(low, high)))
            values[field.name] = values[field.name] if field.allows(values[field.name]) else field.low
    return codec(layout).encode(values)


def _usable(form: Form) -> bool:
    return all(field.bit_width > 0 and field.kind is not FieldKind.BYTES for field in form.layout.fields)


def commands(dialect: Dialect) -> list[Command]:
    """Return the commands of a dialect whose frames can be made here."""
    every = dialect.commands
    return [
        c for c in every if c.code is not None and c.request_forms and all(map(_usable, (*c.request_forms, *c.reply_forms)))
    ]


def frames(
    dialect: Dialect, chance: random.Random, count: int, busy: float, odd: float, *, polls: Sequence[str] = ()
) -> Iterator[CanFrame]:
    """Yield about so many frames.

    `busy`: the share of exchanges that are no reads; `odd`: in which something is not plain. `polls`: the reads, by name.
    """
    link, usable = dialect.link, commands(dialect)
    reads = [c for c in usable if c.all_risks == {Risk.READ} and not c.borrows]
    others = [c for c in usable if c not in reads]
    few = [c for c in usable if c.name in polls] or chance.sample(reads, min(6, len(reads)))
    t_ns = 1_772_442_000_000_000_000
    marked = chance.random() < 0.3

    def frame(command: Command, form: Form, address: int, role: Role) -> CanFrame:
        nonlocal t_ns
        t_ns += chance.choice((90, 150, 400, 3000)) * _US
        data = link.build(command, form, address, data_of(form.layout, chance), role)
        return CanFrame(t_ns, "can0", link.identifier(command, address), data, role if marked else Role.UNKNOWN)

    sent = 0
    while sent < count:
        command, address = chance.choice(others if others and chance.random() < busy else few), chance.choice((1, 2, 3))
        request = frame(command, chance.choice(command.request_forms), address, Role.REQUEST)
        reply = frame(command, chance.choice(command.reply_forms), address, Role.REPLY) if command.reply_forms else None
        pair = [request] + [reply] * (reply is not None)
        if chance.random() < odd:
            pair = list(spoiled(pair, chance))
            if chance.random() < 0.1:
                t_ns += chance.choice((20_000_000, 1_500_000_000, 40_000_000_000))
        sent += len(pair)
        yield from pair


def spoiled(pair: list[CanFrame], chance: random.Random) -> Iterator[CanFrame]:
    """Yield an exchange with something wrong, or something else beside it."""
    import msgspec

    replace = msgspec.structs.replace
    which = chance.randrange(12)
    for place, frame in enumerate(pair):
        own = place == len(pair) - 1
        if which == 0 and own:
            continue
        if which == 1 and own and frame.data:
            frame = replace(frame, data=frame.data[:-1] + bytes((frame.data[-1] ^ 0x55,)))
        if which == 2 and not own:
            yield frame
        if which == 3 and own:
            frame = replace(frame, extended=True)
        if which == 4 and own:
            frame = replace(frame, data=frame.data[:-2])
        if which == 5 and own:
            yield replace(frame, id=0x155, data=bytes(chance.randrange(256) for _ in range(chance.randrange(9))))
        if which == 6 and own:
            frame = replace(frame, t_ns=frame.t_ns - chance.choice((20_000_000, 20_000_000_000)))
        if which == 7 and own:
            yield frame
        if which == 8:
            frame = replace(frame, data=bytes(chance.randrange(256) for _ in frame.data))
        if which == 9 and own:
            yield replace(frame, error=True, data=b"")
        if which == 10 and own:
            frame = replace(frame, t_ns=frame.t_ns + 80_000_000)
        if which == 11 and own:
            frame = replace(frame, direction=Role.REQUEST)
        yield frame


def interleaved(dialect: Dialect, frames: Sequence[CanFrame], chance: random.Random, share: float) -> list[CanFrame]:
    """Swap some frames with the one before them, if that is of another drive."""
    import msgspec

    def drive(frame: CanFrame) -> int:
        return dialect.link.parse(frame.data, frame.id).address

    rows = list(frames)
    for later in range(1, len(rows)):
        one, other = rows[later - 1 : later + 1]
        if drive(one) != drive(other) and chance.random() < share:
            rows[later - 1] = msgspec.structs.replace(other, t_ns=one.t_ns)
            rows[later] = msgspec.structs.replace(one, t_ns=other.t_ns)
    return rows
