"""Matching of replies: the bytes that came back, compared part by part with the reply that the manual describes.

    expected   FB | 01 | 31 | 6 bytes | sum        head, address, code, length, checksum
    received   FF 00 55   FB | 01 | 32 | 6 bytes | sum
               before     one part differs, the rest fits: so this is the reply, and its code is wrong

A listener calls bytes with a wrong head or length junk; a claim wants to know which part is wrong. So the received bytes are
compared with each possible reply, at each place and in each length, and the closest fit is taken.

Rules kept here:
- Bytes that are no reply to the request (less than half of its parts fit, or neither its code nor its last check)
  are not taken for one.
- A reply that lacks exactly its last check is one whose check is missing, not one that is too short.
- Further replies (a second one, a completion) are found in what follows the first.

Not known here: whether a difference is wrong; claims say so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from analyzer.catalogue import Command, Dialect, Form, Role, Trait
from analyzer.codec import codec
from analyzer.link import Check
from conformance.talk.exchange import Exchange

ADDRESS, CODE = "address", "code"
#: Parts of a head that count bytes.
COUNTS = frozenset({"length", "byte count"})
#: Names of the parts of heads in claims: a Modbus function is a code.
NAMES: Mapping[str, str] = {"function": CODE}
#: The most replies that are looked for behind one request.
_MOST = 4
#: Bytes in which a reply is looked for: on a line that is flooded there is no end to them.
_SEARCHED = 512
_HALF = 2


class Part(NamedTuple):
    """A part of a reply's head: its name, the bytes received and those expected."""

    name: str
    got: bytes
    expected: bytes

    @property
    def ok(self) -> bool:
        """Whether it is as expected."""
        return self.got == self.expected


@dataclass(frozen=True)
class Template:
    """A reply that could come: its form, its bytes with zeros as data, and where the parts of its head are."""

    form: Form
    frame: bytes
    can_id: int | None
    parts: tuple[tuple[str, int, int], ...]
    checks: tuple[str, ...]
    check_size: int

    @property
    def count(self) -> int:
        """How many things about a reply can fit or not: the parts, the checks and the length."""
        return len(self.parts) + len(self.checks) + 1 + int(not any(name == ADDRESS for name, _, _ in self.parts))


@dataclass(frozen=True)
class MatchedReply:
    """One reply as it came. `checks`: those that it has; `offset`: of its first byte."""

    template: Template
    dialect: Dialect
    data: bytes
    can_id: int | None
    parts: tuple[Part, ...]
    checks: tuple[Check, ...]
    offset: int = 0

    @property
    def length_fits(self) -> bool:
        """Whether it has as many bytes as the reply that it is taken for."""
        return len(self.data) == len(self.template.frame)

    @property
    def lacks_check(self) -> bool:
        """Whether it is exactly its last check that is not there."""
        template = self.template
        short = len(self.data) == len(template.frame) - template.check_size
        return bool(template.checks) and short and not (self.checks and self.checks[-1].ok)

    @property
    def fitting(self) -> int:
        """How many of its parts, checks and length fit."""
        good = sum(p.ok for p in self.parts) + sum(c.ok for c in self.checks if c.name in self.template.checks)
        return good + self.length_fits

    @property
    def checked(self) -> bool:
        """Whether it ends in a check that fits."""
        return bool(self.checks) and self.checks[-1].ok and self.checks[-1].name == self.template.checks[-1]

    @property
    def plausible(self) -> bool:
        """Whether its code or its last check fits: without either, bytes are no reply to anything."""
        # Where no part of the frame is the code, the identifier tells it.
        told = CODE if any(p.name == CODE for p in self.parts) else ADDRESS
        return self.checked or any(p.ok for p in self.parts if p.name == told)

    @property
    def own(self) -> bytes:
        """The reply's own data: what stands between head and check."""
        head = self.dialect.link.parse(self.data, self.can_id)
        return self.data[head.start :] if self.lacks_check else self.data[head.start : head.stop]

    def part(self, name: str) -> Part | None:
        """Return a part by its name, None where this reply has none of it."""
        return next((p for p in self.parts if p.name == name), None)

    def check(self, name: str) -> Check | None:
        """Return a check by its name, None where it is not there."""
        return next((c for c in self.checks if c.name == name), None)


@dataclass(frozen=True)
class Replies:
    """What came back after one request: replies, in order, and pieces of bytes that are no part of any."""

    readings: tuple[MatchedReply, ...]
    leftover: tuple[bytes, ...]

    @property
    def first(self) -> MatchedReply | None:
        """The first reply, None where nothing like one came."""
        return self.readings[0] if self.readings else None


# --- what could come --------------------------------------------------------------------------------------------------


def templates(dialect: Dialect, command: Command, address: int, values: Mapping[str, Any]) -> list[Template]:
    """Return the replies of all forms that could come to a request with these values."""
    link = dialect.link
    result = []
    for form in command.reply_forms:
        if any(values.get(name, wanted) != wanted for name, wanted in (form.request_values or {}).items()):
            continue
        data = codec(form.layout).encode({})
        frame = link.build(command, form, address, data, Role.REPLY)
        can_id = link.identifier(command, address)
        checks = link.checks(frame, can_id)
        parts = tuple((NAMES.get(p.name, p.name), p.start, p.stop) for p in link.parts(frame, can_id))
        size = len(checks[-1].expected) if checks else 0
        result.append(Template(form, frame, can_id, parts, tuple(c.name for c in checks), size))
    return result


# --- what was received --------------------------------------------------------------------------------------------------------


class _Unit(NamedTuple):
    """Bytes in which replies are looked for: all of a serial line, one frame of CAN."""

    data: bytes
    can_id: int | None


def _units(exchange: Exchange, dialect: Dialect) -> list[_Unit]:
    if dialect.link.kind != "can" and any(a.bare for a in exchange.answers):
        # Without checksums nothing but the time tells where one reply ends and the next begins.
        pieces = [(a.last_ns, a.data) for a in exchange.answers] + [(j.last_ns, j.data) for j in exchange.junk]
        return [_Unit(data, None) for _, data in sorted(pieces)]
    if dialect.link.kind != "can":
        return [_Unit(exchange.received, None)] if exchange.received else []
    frames = [a.message.frame for a in exchange.answers]
    return [_Unit(f.data, f.can.id if f.can is not None else None) for f in frames]


def replies(exchange: Exchange, dialect: Dialect) -> Replies:
    """Compare the received bytes with the possible replies to the request of an exchange.

    The exchange must have been asked of a command (`Probe.ask`).
    """
    command, address = exchange.command, exchange.address
    assert command is not None  # asked, not sent as bytes
    assert address is not None
    possible = templates(dialect, command, address, exchange.values)
    readings: list[MatchedReply] = []
    leftover: list[bytes] = []
    for unit in _units(exchange, dialect):
        rest = unit.data
        while rest and possible:
            found = _closest(dialect, possible, rest[:_SEARCHED], unit.can_id) if len(readings) < _MOST else None
            if found is None:
                break
            if found.offset:
                leftover.append(rest[: found.offset])
            readings.append(found)
            rest = rest[found.offset + len(found.data) :]
        if rest:
            leftover.append(rest)
    whole = [reading for reading in readings if reading.fitting == reading.template.count]
    if whole and len(whole) < len(readings):
        # Beside a reply that is right in every part, what is only like one is noise.
        leftover += [reading.data for reading in readings if reading not in whole]
        readings = whole
    return Replies(tuple(readings), tuple(leftover))


def in_order(exchange: Exchange, dialect: Dialect, commands: Sequence[Command], address: int) -> bool:
    """Say whether what came back is one good reply to each of these commands, in this order, and nothing else.

    For what was sent as bytes, where the analyzer knows of no request.
    """
    units = _units(exchange, dialect)
    for command in commands:
        possible = templates(dialect, command, address, {})
        size = next((n for t in possible if units and (n := _begun(dialect, t, units[0]))), 0)
        if not size:
            return False
        rest = units[0].data[size:]
        units = [_Unit(rest, None), *units[1:]] if rest else units[1:]
    return not units


def _begun(dialect: Dialect, template: Template, unit: _Unit) -> int:
    """Return how many bytes of a unit are a reply that is whole, or bare where such drives are known; 0: it is none."""
    whole = len(template.frame)
    data = unit.data if unit.can_id is not None else unit.data[:whole]
    if _reading(dialect, template, data, unit.can_id, 0).fitting == template.count:
        return len(data)
    bare = whole - template.check_size
    reading = _reading(dialect, template, unit.data[:bare], unit.can_id, 0)
    known = Trait.SEEN_WITHOUT_CHECKSUM in dialect.traits and reading.lacks_check and all(p.ok for p in reading.parts)
    return bare if known else 0


def _closest(dialect: Dialect, possible: Sequence[Template], data: bytes, can_id: int | None) -> MatchedReply | None:
    """Return the place in `data` that is most like one of the replies, None where nothing is."""
    best: tuple[tuple[float, int, int, int, int], MatchedReply] | None = None
    for rank, template in enumerate(possible):
        for reading in _candidates(dialect, template, data, can_id):
            if reading.fitting * _HALF < template.count or not reading.plausible:
                continue
            whole = reading.fitting == template.count
            left = 0 if whole else len(data) - len(reading.data)
            matches = codec(template.form.layout).matches(reading.own)
            # Of what fits equally well: what leaves least, ends in a fitting check, has the fixed values, comes first.
            share = reading.fitting / template.count
            key = (share, -left, int(reading.checked), int(matches), -reading.offset - rank)
            if best is None or key > best[0]:
                best = key, reading
    return best[1] if best is not None else None


def _candidates(dialect: Dialect, template: Template, data: bytes, can_id: int | None) -> Iterator[MatchedReply]:
    if can_id is not None:
        yield _reading(dialect, template, data, can_id, 0)
        return
    size = len(template.frame)
    first = _reading(dialect, template, data[:size], can_id, 0)
    if first.fitting == template.count:
        yield first
        return
    for offset in range(len(data)):
        left = len(data) - offset
        for length in {size, left, *range(min(left, size + _MOST) + 1)}:
            if 0 < length <= left:
                yield _reading(dialect, template, data[offset : offset + length], None, offset)


def _reading(dialect: Dialect, template: Template, data: bytes, can_id: int | None, offset: int) -> MatchedReply:
    parts = [Part(name, data[start:stop], template.frame[start:stop]) for name, start, stop in template.parts]
    if can_id is not None and template.can_id is not None:
        parts.insert(0, Part(ADDRESS, can_id.to_bytes(2, "big"), template.can_id.to_bytes(2, "big")))
    checks = dialect.link.checks(data, can_id) if data else ()
    return MatchedReply(template, dialect, data, can_id, tuple(parts), tuple(checks), offset)
