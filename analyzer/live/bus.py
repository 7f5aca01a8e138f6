"""One bus of a recording while it is recorded: its ports, how far it has come, and what it is in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from analyzer.catalogue import Dialect, Role
from analyzer.live.checkpoint import BusState
from analyzer.live.config import PortConfig, RecordingConfig
from analyzer.live.detection import Detection
from analyzer.setups import names
from analyzer.sinks.mcap_log import Speed
from analyzer.sources.marks import Heard

#: Notes of a bus that are kept.
NOTES_LIMIT = 20


class Bus:
    """One bus; two ports of one name are the two directions of one bus. `known`: every dialect by name."""

    def __init__(self, ports: Sequence[PortConfig], known: Mapping[str, Dialect]) -> None:
        first = ports[0]
        self.ports = list(ports)
        self.name = first.bus
        self.kind = first.kind
        self.speed = next((p.speed for p in ports if p.speed), None)
        self.byte_ns = max(p.byte_ns for p in ports)
        #: Bytes that have come.
        self.offset = 0
        self.start = 0
        self.last_ns = 0
        #: Something came since the last pause.
        self.sounded = False
        self.heard = Heard()
        self.dialects = tuple(known[name] for name in first.dialects if name in known and known[name].bus == first.kind)
        self.reason = "as given" if self.dialects else ""
        self.detection = None if self.dialects else Detection(first.kind, list(known.values()))
        self.notes: list[str] = []
        #: What was lost, by unit.
        self.lost: dict[str, int] = {}

    @property
    def load(self) -> Speed:
        """How long a byte and a bit take, as far as known."""
        if self.kind == "can":
            return Speed(0, 1_000_000_000 // self.speed if self.speed else 0)
        return Speed(self.byte_ns, 0)

    def note(self, text: str) -> None:
        """Keep something to be said of the bus; the same once."""
        if text and text not in self.notes and len(self.notes) < NOTES_LIMIT:
            self.notes.append(text)

    def lose(self, unit: str, count: int) -> None:
        """Count what is missing."""
        self.lost[unit] = self.lost.get(unit, 0) + count

    def setup(self) -> dict[str, Any]:
        """Return what is known of how it is to be read, as the values of an event."""
        values: dict[str, Any] = {
            "endpoint": "; ".join(p.endpoint for p in self.ports),
            "kind": self.kind,
            "byte_ns": self.byte_ns,
            "offset": self.offset,
        }
        if self.speed:
            values["speed"] = self.speed
        directions = [p.direction for p in self.ports if p.direction != Role.UNKNOWN]
        if directions:
            values["direction"] = " and ".join(directions)
        if self.dialects:
            values["dialects"] = names(self.dialects)
        return values

    def state(self) -> BusState:
        """Return what `restore` needs."""
        return BusState(
            offset=self.offset,
            last_ns=self.last_ns,
            sounded=self.sounded,
            sent=self.heard.sent,
            dialects=names(self.dialects),
            guessing=self.detection is not None and self.detection.guessing,
            reason=self.reason,
            notes=list(self.notes),
            lost=dict(self.lost),
            speed=self.speed,
            byte_ns=self.byte_ns,
        )

    def restore(self, state: BusState, known: Mapping[str, Dialect]) -> None:
        """Go on where another process stood."""
        self.offset, self.last_ns, self.sounded = state.offset, state.last_ns, state.sounded
        self.heard = Heard(state.sent)
        self.dialects = tuple(known[name] for name in state.dialects if name in known)
        self.reason, self.notes, self.lost = state.reason, list(state.notes), dict(state.lost)
        if self.detection is not None and self.dialects:
            self.detection.resume(self.dialects, state.guessing)

    def about(self) -> dict[str, str]:
        """Return what the metadata of a log says of it."""
        prefix = f"bus.{self.name}."
        values = {
            "endpoint": "; ".join(p.endpoint for p in self.ports),
            "dialect": ",".join(names(self.dialects)),
            "dialect_reason": self.reason,
            "bit_rate" if self.kind == "can" else "baud": str(self.speed or ""),
            "direction": "; ".join(p.direction for p in self.ports if p.direction != Role.UNKNOWN),
            "bytes": str(self.offset),
            "lost": ", ".join(f"{count} {unit}" for unit, count in self.lost.items()),
            "notes": "; ".join(self.notes),
        }
        return {prefix + name: value for name, value in values.items() if value}


def buses_of(config: RecordingConfig, known: Mapping[str, Dialect]) -> dict[str, Bus]:
    """Return the buses of a recording by name."""
    grouped: dict[str, list[PortConfig]] = {}
    for port in config.ports:
        grouped.setdefault(port.bus, []).append(port)
    return {name: Bus(ports, known) for name, ports in grouped.items()}
