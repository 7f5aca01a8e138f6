"""Strategies for bytes of a serial line, made from the catalogue: values, frames, exchanges, noise, cuts.

A `SentFrame` is one frame as it was sent; `traffic` draws whole exchanges (a request with valid values, then its reply or
replies) of several drives and dialects; `cuttings` cuts bytes into reads.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Form, Role, Vector
from analyzer.codec import codec
from analyzer.layout import Field, FieldKind, Layout
from analyzer.link import READS, WRITE_ONE

SERIAL = ("mks-rs485", "mks-modbus", "lk-rs485")
#: Bytes that begin frames, name codes, functions and lengths, or fill values: the worst noise there is.
HOSTILE = bytes.fromhex("FA FB FC 3E 00 01 02 03 04 06 10 30 80 83 90 9A A2 F6 FD FF")
#: Bytes that no frame of a serial dialect begins with and no function has.
HARMLESS = bytes.fromhex("55 AA F8 F9 FD FE FF")


class SentFrame(NamedTuple):
    """A frame as it was sent, and the name of its dialect."""

    data: bytes
    role: Role
    dialect: str


class Placed(NamedTuple):
    """A sent frame and its offset on the line."""

    at: int
    sent: SentFrame


def placed(frames: Sequence[SentFrame]) -> list[Placed]:
    """Return where each frame lies when all are sent one after the other."""
    result, at = [], 0
    for frame in frames:
        result.append(Placed(at, frame))
        at += len(frame.data)
    return result


def joined(frames: Sequence[SentFrame]) -> bytes:
    """Return the bytes of frames sent one after the other."""
    return b"".join(frame.data for frame in frames)


# --- values -----------------------------------------------------------------------------------------------------------


def values(field: Field) -> st.SearchStrategy[int]:
    """Draw an integer as sent that the field allows."""
    if field.fixed is not None:
        return st.just(field.fixed)
    listed = sorted(v for v in (field.values or field.choice_names) if field.allows(v))
    return st.sampled_from(listed) if listed else st.integers(field.low, field.high)


@st.composite
def layout_values(draw: st.DrawFn, layout: Layout, known: dict[str, int] | None = None) -> dict[str, int]:
    """Draw valid values for a layout; fields that have the name of a `known` one take its value where they may."""
    result = {}
    for field in layout.fields:
        if field.kind not in (FieldKind.RESERVED, FieldKind.BYTES):
            kept = (known or {}).get(field.name)
            result[field.name] = kept if kept is not None and field.allows(kept) else draw(values(field))
    return result


@st.composite
def package_slots(draw: st.DrawFn, dialect: Dialect, command: Command) -> bytes:
    """Draw the slots of a package."""
    assert command.slots is not None
    inner = [c for c in dialect.commands if c.slots is None]
    data = b""
    for address in range(1, draw(st.integers(1, command.slots.count)) + 1):
        slot = draw(st.sampled_from(inner))
        layout = slot.request_forms[0].layout
        body = bytes((address, slot.code)) + codec(layout).encode(draw(layout_values(layout)))
        data += body.ljust(command.slots.size, b"\0")
    return data.ljust(command.slots.count * command.slots.size, b"\0")


# --- frames and exchanges ---------------------------------------------------------------------------------------------


def answering(forms: Sequence[Form], asked: dict[str, int]) -> list[Form]:
    """Return the reply forms that agree with a request's values."""
    return [f for f in forms if all(asked.get(x.name, x.fixed) == x.fixed for x in f.layout.fields if x.fixed is not None)]


@st.composite
def exchanges(draw: st.DrawFn, dialect: Dialect, address: int, packages: bool = True) -> list[SentFrame]:
    """Draw the frames of one exchange with a drive: a request, then none, one or two replies."""
    command = draw(st.sampled_from([c for c in dialect.commands if packages or c.slots is None]))
    form = draw(st.sampled_from(command.request_forms))
    asked = draw(layout_values(form.layout))
    data = draw(package_slots(dialect, command)) if command.slots else codec(form.layout).encode(asked)
    if command.function not in READS and draw(st.integers(0, 19)) == 0:
        address = dialect.broadcast or 0
    frames = [SentFrame(dialect.link.build(command, form, address, data, Role.REQUEST), Role.REQUEST, dialect.name)]
    if address == dialect.broadcast or not command.reply_forms or draw(st.integers(0, 19)) == 0:
        return frames
    reply = draw(st.sampled_from(answering(command.reply_forms, asked) or list(command.reply_forms)))
    told = draw(layout_values(reply.layout, asked))
    body = codec(reply.layout).encode(told)
    if command.function in WRITE_ONE and reply.name != "refused":
        body = data
    frames.append(SentFrame(dialect.link.build(command, reply, address, body, Role.REPLY), Role.REPLY, dialect.name))
    if told.get(command.replies.status) in command.replies.interim and command.replies.final:
        told[command.replies.status] = draw(st.sampled_from(sorted(command.replies.final)))
        body = codec(reply.layout).encode(told)
        frames.append(SentFrame(dialect.link.build(command, reply, address, body, Role.REPLY), Role.REPLY, dialect.name))
    return frames


@st.composite
def traffic(
    draw: st.DrawFn, names: Sequence[str] = SERIAL, minimum: int = 1, maximum: int = 12, packages: bool = True
) -> list[SentFrame]:
    """Draw exchanges with several drives, each of one of the named dialects."""
    frames: list[SentFrame] = []
    for _ in range(draw(st.integers(minimum, maximum))):
        dialect = dialects.get(draw(st.sampled_from(names)))
        low, high = dialect.addresses
        address = draw(st.sampled_from((1, 2, 3, 17)) | st.integers(low, high))
        frames += draw(exchanges(dialect, address, packages))
    return frames


def wires() -> st.SearchStrategy[tuple[str, ...]]:
    """Draw which dialects may be on a wire."""
    return st.sampled_from([(n,) for n in SERIAL] + [("mks-rs485", "mks-modbus"), ("mks-rs485", "lk-rs485"), SERIAL])


# --- noise, damage and cuts -------------------------------------------------------------------------------------------


def noise(maximum: int = 80) -> st.SearchStrategy[bytes]:
    """Draw noise: any bytes, or those that look most like frames."""
    hostile = st.lists(st.sampled_from(HOSTILE), max_size=maximum).map(bytes)
    return st.binary(max_size=maximum) | hostile


@st.composite
def lines(draw: st.DrawFn, names: Sequence[str]) -> bytes:
    """Draw what can be on a damaged line: frames, pieces of frames and noise."""
    parts = []
    for frame in draw(traffic(names, 0, 6)):
        first = draw(st.sampled_from((0, 0, 0, 0, 1, 2)))
        last = draw(st.sampled_from((0, 0, 0, 0, 1, 2)))
        parts.append(frame.data[first : len(frame.data) - last])
        parts.append(draw(st.just(b"") | noise(12)))
    return b"".join(parts) + draw(st.just(b"") | noise())


@st.composite
def cuttings(draw: st.DrawFn, data: bytes) -> list[bytes]:
    """Draw a way to cut bytes into reads; now and then one byte each."""
    if not data or draw(st.integers(0, 5)) == 0:
        return [data[i : i + 1] for i in range(len(data))]
    at = sorted(draw(st.sets(st.integers(1, len(data)), max_size=8)) | {len(data)})
    return [data[a:b] for a, b in zip([0, *at], at, strict=False)]


def true_frame(dialect: Dialect, vector: Vector) -> bytes | None:
    """Return the frame of a vector as we take it as true, with its check; None where the manual leaves that open."""
    if vector.corrected:
        return bytes.fromhex(vector.corrected)
    if not vector.checksum:
        return dialect.link.completed(vector.data)
    return vector.data if all(c.ok for c in dialect.link.checks(vector.data)) else None


def vectors() -> list[Any]:
    """Return (dialect name, command name, frame) of every vector of the serial dialects."""
    result = []
    for name in SERIAL:
        dialect = dialects.get(name)
        for command in dialect.commands:
            for vector in command.vectors:
                frame = true_frame(dialect, vector)
                if frame is not None:
                    result.append((name, command.name, frame))
    return result
