"""Garbled frames: requests as noise, a bad cable or a careless host damage them.

    FA 01 31 2C   ->   FA 01 31 2D   a bit of the checksum flipped
                       FA 01 31      cut short
                       FA 01 31 00 2C    a byte too many

Rules kept here:
- They are built from reads and from nothing else, so that what a drive makes of a damaged one cannot move a motor.
- A variant that could be read as anything but a read, in any dialect, is left out (`harmless`): it is held against the same
  judge as all that leaves.
- Variants are (what it is, bytes or CAN frame) pairs; those that come out as a good frame by chance are left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache

from analyzer import dialects as registry
from analyzer import encoder
from analyzer.catalogue import Dialect, Risk, Role
from analyzer.encoder import Built
from analyzer.link import HeadLink
from analyzer.records import CanFrame
from conformance.gate.gate import Allowance, Judge

Item = bytes | CanFrame
#: The damage in words, and the damaged frame.
Variant = tuple[str, Item]

_BITS = 8
_BYTE = 0xFF
_CAN_LONGEST = 8
#: Bytes that begin no frame of any dialect.
NOISE: tuple[bytes, ...] = (b"\0", b"\xff\xff\xff", b"\x55\xaa", bytes(12), b"\xff" * 12)


@cache
def _judge(address: int, risks: frozenset[Risk], names: frozenset[str]) -> Judge:
    spoken = [d for d in registry.every() if not names or d.name in names]
    return Judge(Allowance(risks, addresses=frozenset({address})), spoken)


def harmless(
    item: Item, address: int, behind: bytes = b"", *, beside: frozenset[Risk] = frozenset(), dialect: Dialect | None = None
) -> bool:
    """Say whether every dialect takes these bytes for reads of the drive at `address` alone.

    `behind`: the bytes sent next; a head at the end could begin a frame with them. `beside`: other permitted risks.
    `dialect`: the drive's own. On CAN an identifier belongs to one drive. There the gate judges what drives of other
    dialects make of a frame, because it knows whether there are any.
    """
    on_can = dialect is not None and dialect.bus == "can"
    judge = _judge(address, beside, frozenset({dialect.name, *dialect.siblings}) if dialect and on_can else frozenset())
    if judge.objections(item) or (isinstance(item, bytes) and _open_ended(item)):
        return False
    return not behind or isinstance(item, CanFrame) or not judge.objections(item + behind)


def _open_ended(data: bytes) -> bool:
    """Say whether what follows could be taken for the rest of a frame that begins inside these bytes."""
    links = [dialect.link for dialect in registry.every()]
    packages = {link.package.head for link in links if isinstance(link, HeadLink) and link.package is not None}
    # A package is long; of any other frame the third byte tells what it is.
    return bool(packages & {*data[1:]} or registry.first_bytes() & {*data[1:][-2:]})


class Garbler:
    """Makes variants of one read to the drive at `address`. Raises ValueError for a request that is no read."""

    def __init__(self, dialect: Dialect, built: Built) -> None:
        if built.risks - {Risk.READ} or built.role is not Role.REQUEST:
            raise ValueError(f"{built.command.name}: a garbled frame is built from a read, and this is none")
        self.dialect, self.built = dialect, built
        self.address, self.frame = built.address, built.frame
        self.can_id = built.can_id
        self._checks = dialect.link.checks(self.frame, self.can_id)

    def _kept(self, variants: Iterable[tuple[str, bytes]]) -> Iterator[Variant]:
        link, seen = self.dialect.link, {self.frame}
        for what, frame in variants:
            item = self.built.item(frame)
            if frame not in seen and not link.fits(frame, self.can_id) and self._harmless(item):
                seen.add(frame)
                yield what, item

    def _harmless(self, item: Item) -> bool:
        return harmless(item, self.address, self.frame if isinstance(item, bytes) else b"", dialect=self.dialect)

    # --- checks ---------------------------------------------------------------------------------------------------

    def check_bits(self) -> Iterator[Variant]:
        """Yield the frame with each single bit of its checks flipped."""
        yield from self._kept(
            (f"bit {_BITS * place + bit} of the {check.name} flipped", self._flipped(check.start + place, bit))
            for check in self._checks
            for place in range(len(check.expected))
            for bit in range(_BITS)
        )

    def body_bits(self) -> Iterator[Variant]:
        """Yield the frame with each single bit before the checks flipped, as far as it still reads as a read."""
        checked = {at for c in self._checks for at in range(c.start, c.start + len(c.expected))}
        yield from self._kept(
            (f"bit {bit} of byte {at + 1} flipped", self._flipped(at, bit))
            for at in range(len(self.frame))
            if at not in checked
            for bit in range(_BITS)
        )

    def _flipped(self, at: int, bit: int) -> bytes:
        return self._with(at, bytes((self.frame[at] ^ 1 << bit,)))

    def _with(self, at: int, data: bytes) -> bytes:
        return self.frame[:at] + data + self.frame[at + len(data) :]

    def wrong_checks(self) -> Iterator[Variant]:
        """Yield the frame with checks reckoned otherwise: one off, zero, inverted, swapped, without the first byte."""
        yield from self._kept(
            (f"{what} in place of the {check.name}", self._with(check.start, changed))
            for check in self._checks
            for what, changed in self._otherwise(check.expected, check.start)
        )

    def _otherwise(self, good: bytes, start: int) -> Iterator[tuple[str, bytes]]:
        number, size = int.from_bytes(good, "little"), len(good)
        top = (1 << _BITS * size) - 1
        for what, value in (("one more", number + 1), ("one less", number - 1), ("its complement", number ^ top), ("0", 0)):
            yield what, (value & top).to_bytes(size, "little")
        yield "its bytes swapped", good[::-1]
        yield "the sum of all bytes", (sum(self.frame[:start]) & _BYTE).to_bytes(size, "little")
        yield "the sum without the first byte", (sum(self.frame[1:start]) & _BYTE).to_bytes(size, "little")
        if start:
            yield "the exclusive or of all bytes", _xor(self.frame[:start]).to_bytes(size, "little")

    # --- lengths --------------------------------------------------------------------------------------------------

    def truncated(self) -> Iterator[Variant]:
        """Yield the frame cut short at every length, down to its first byte (CAN: to no byte at all)."""
        least = 1 if self.can_id is None else 0
        for size in range(len(self.frame) - 1, least - 1, -1):
            item = self.built.item(self.frame[:size])
            # Where what is left checks by chance, a drive may take it for a frame.
            fits = size > 1 and self.dialect.link.fits(self.frame[:size], self.can_id)
            if not fits and self._harmless(item):
                yield f"{size} of {len(self.frame)} bytes", item

    def overlong(self) -> Iterator[Variant]:
        """Yield the frame with a byte of data too many and a check that fits."""
        link, form = self.dialect.link, self.built.form
        own = self._own()
        for extra in (b"\0", b"\xff", b"\0\0"):
            frame = link.build(self.built.command, form, self.address, own + extra, Role.REQUEST)
            if len(frame) == len(self.frame):
                # A read of registers has no data of its own: the bytes stand before the check all the same.
                frame = link.completed(self.frame[: self._checks[-1].start] + extra, self.can_id)
            fits = self.can_id is None or len(frame) <= _CAN_LONGEST
            item = self.built.item(frame)
            if fits and self._harmless(item):
                yield f"{extra.hex(' ').upper()} too many before a check that fits", item

    def underlong(self) -> Iterator[Variant]:
        """Yield the frame with less data than its command has, and checks that fit; nothing for a read without data."""
        link, form, own = self.dialect.link, self.built.form, self._own()
        for size in dict.fromkeys((len(own) - 1, len(own) // 2, 0)):
            if not own or size < 0 or size == len(own):
                continue
            frame = link.build(self.built.command, form, self.address, own[:size], Role.REQUEST)
            item = self.built.item(frame)
            if frame != self.frame and self._harmless(item):
                yield f"{size} of {len(own)} bytes of data before a check that fits", item

    def _own(self) -> bytes:
        head = self.dialect.link.parse(self.frame, self.can_id)
        return self.frame[head.start : head.stop]

    def trailing(self) -> Iterator[Variant]:
        """Yield the good frame with stray bytes at once behind it."""
        for extra in (b"\0", b"\xff", b"\0" * 4):
            data = self.frame + extra
            item = self.built.item(data)
            if (self.can_id is None or len(data) <= _CAN_LONGEST) and self._harmless(item):
                yield f"{extra.hex(' ').upper()} behind it", item

    # --- heads ----------------------------------------------------------------------------------------------------

    def other_heads(self, heads: Sequence[int]) -> Iterator[Variant]:
        """Yield the frame with another first byte and checks that fit it."""
        for head in heads:
            body = bytes((head,)) + self.frame[1 : self._checks[0].start]
            for check in self._checks:
                # Each check covers what stands before it, as the link has it.
                stop = check.start + len(check.expected)
                body = self._completed(body) if stop <= len(self.frame) else body
                body += self.frame[stop : next((c.start for c in self._checks if c.start >= stop), len(self.frame))]
            item = self.built.item(body)
            if body != self.frame and self._harmless(item):
                yield f"{head:02X} in place of the head {self.frame[0]:02X}", item

    def _completed(self, body: bytes) -> bytes:
        return self.dialect.link.completed(body, self.can_id)


def _xor(data: bytes) -> int:
    total = 0
    for byte in data:
        total ^= byte
    return total


def reads_of_others(dialect: Dialect, address: int) -> Iterator[Variant]:
    """Yield plain reads of the other dialects of the same kind of bus, to the drive with the same address."""
    for other in registry.every():
        if other.name == dialect.name or other.bus != dialect.bus or not other.addresses[0] <= address <= 247:
            continue
        command = next(c for c in other.commands if c.all_risks == {Risk.READ} and not c.request_forms[0].layout.fields)
        frame = encoder.build(other, command, address)
        if harmless(frame, address):
            yield f"{command.name} in {other.name}", frame
