"""Every worked example of the manuals as what leaves: bytes, or a CAN frame."""

from __future__ import annotations

from typing import NamedTuple

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Risk, Role
from analyzer.codec import codec
from analyzer.decoder import slots_of
from analyzer.records import CanFrame
from conformance.gate.gate import Item

READS = frozenset({Risk.READ})
EVERYTHING = frozenset(Risk)


class Sending(NamedTuple):
    """A request of a manual. `risks`: what the catalogue gives its values."""

    dialect: Dialect
    command: Command
    item: Item
    risks: frozenset[Risk]

    @property
    def data(self) -> bytes:
        assert isinstance(self.item, bytes)
        return self.item

    @property
    def name(self) -> str:
        text = self.item.data.hex() if isinstance(self.item, CanFrame) else self.item.hex()
        return f"{self.dialect.name}-{self.command.name}-{text}"


def on_can(can_id: int, data: bytes) -> CanFrame:
    return CanFrame(None, "host", can_id, data)


def _risks(dialect: Dialect, command: Command, frame: bytes, can_id: int | None) -> frozenset[Risk]:
    head = dialect.link.parse(frame, can_id)
    data = frame[head.start : head.stop]
    if command.slots is not None:
        slots = slots_of(dialect, command, data)
        return frozenset().union(*(s.command.risks(codec(s.form.layout).wire(s.data)) for s in slots))
    form = next(f for f in command.request_forms if codec(f.layout).matches(data))
    return command.risks(codec(form.layout).wire(data))


def sendings() -> list[Sending]:
    """Return the requests that the manuals print, as they are right."""
    found = []
    for dialect in dialects.every():
        for command in dialect.commands:
            for vector in command.vectors:
                if vector.role is not Role.REQUEST:
                    continue
                raw = bytes.fromhex(vector.corrected or vector.printed)
                can_id = raw[0] if dialect.bus == "can" else None
                frame = raw if can_id is None else raw[1:]
                if not vector.checksum and not vector.corrected:
                    frame = dialect.link.completed(frame, can_id)
                item: Item = frame if can_id is None else on_can(can_id, frame)
                found.append(Sending(dialect, command, item, _risks(dialect, command, frame, can_id)))
    return list({s.name: s for s in found}.values())


ALL = sendings()
SERIAL = [s for s in ALL if s.dialect.bus == "serial"]
SAFE = [s for s in ALL if s.risks <= READS]
RISKY = [s for s in ALL if not s.risks <= READS]


def ids(chosen: list[Sending]) -> list[str]:
    return [s.name for s in chosen]
