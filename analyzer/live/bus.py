"""The buses of a recording: their ports and spools, how far each has come, its dialects, and the records held until
these are known.

At the first traffic of a bus of unknown dialect everything stops, for half a second of traffic at most (`Detection`). So the
log stays in order, and its decoded frames bear their own times. A dialect that is found later waits for a pause on its bus:
within a frame it would cut it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from analyzer.catalogue import Dialect, Role
from analyzer.detect import Choice
from analyzer.live.checkpoint import BusState
from analyzer.live.config import PortConfig, RecordingConfig
from analyzer.live.detection import Detection
from analyzer.live.spool import CAN_HEAD, CanFlag, Record, RecordKind
from analyzer.live.spool_merge import Spool
from analyzer.records import CanFrame, Chunk
from analyzer.sinks.mcap_log import Speed
from analyzer.sources.marks import ReceivedMarks
from analyzer.system.decoding import UNDECODABLE

#: Notes of a bus that are kept.
NOTES_LIMIT = 20
#: The longest that a new dialect waits for a pause on its bus.
CHANGE_LIMIT_NS = 2_000_000_000
#: Time between two checks whether the dialect has changed.
CHECK_NS = 1_000_000_000


class Bus:
    """One bus; two ports of one name are the two directions of one bus.

    `known`: every dialect by name; `devices`: those of them that files describe.
    """

    def __init__(self, ports: Sequence[PortConfig], known: Mapping[str, Dialect], devices: Sequence[Dialect] = ()) -> None:
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
        self.heard = ReceivedMarks()
        given = [known[name] for name in first.dialects if name in known and known[name].bus == first.kind]
        own = [device for device in devices if device.bus == first.kind and device not in given]
        self.dialects = (*own, *given) if given else ()
        self.reason = "as given" if self.dialects else ""
        self.detection = None if self.dialects else Detection(first.kind, list(known.values()), own)
        #: Who is a drive, None: the frames tell.
        self.ids = first.ids
        self.notes: list[str] = []
        #: What was lost, by unit.
        self.lost: dict[str, int] = {}

    @property
    def load(self) -> Speed:
        if self.kind == "can":
            return Speed(0, 1_000_000_000 // self.speed if self.speed else 0)
        return Speed(self.byte_ns, 0)

    def can_frame(self, record: Record, t_ns: int) -> CanFrame:
        """Return the CAN frame that a record holds, as it came at a time of the log."""
        can_id, flags, data = record.can
        return CanFrame(
            t_ns,
            self.name,
            can_id,
            data,
            self.heard(Role.REQUEST if flags & CanFlag.TX else Role.REPLY),
            bool(flags & CanFlag.EXTENDED),
            bool(flags & CanFlag.REMOTE),
            bool(flags & CanFlag.ERROR),
            bool(flags & CanFlag.FD),
        )

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
            values["dialects"] = [d.name for d in self.dialects]
        if self.ids is not None:
            values["ids"] = list(self.ids)
        return values

    def state(self) -> BusState:
        """Return what `restore` needs."""
        return BusState(
            offset=self.offset,
            last_ns=self.last_ns,
            sounded=self.sounded,
            sent=self.heard.sent,
            dialects=[d.name for d in self.dialects],
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
        self.heard = ReceivedMarks(state.sent)
        self.dialects = tuple(known[name] for name in state.dialects if name in known)
        self.reason, self.notes, self.lost = state.reason, list(state.notes), dict(state.lost)
        if self.detection is not None and self.dialects:
            self.detection.resume(self.dialects, state.guessing)

    def about(self) -> dict[str, str]:
        """Return its metadata for a log."""
        prefix = f"bus.{self.name}."
        values = {
            "endpoint": "; ".join(p.endpoint for p in self.ports),
            "dialect": ",".join([d.name for d in self.dialects]),
            "dialect_reason": self.reason,
            "bit_rate" if self.kind == "can" else "baud": str(self.speed or ""),
            "direction": "; ".join(p.direction for p in self.ports if p.direction != Role.UNKNOWN),
            "bytes": str(self.offset),
            "lost": ", ".join(f"{count} {unit}" for unit, count in self.lost.items()),
            "notes": "; ".join(self.notes),
        }
        return {prefix + name: value for name, value in values.items() if value}


class Follow:
    """What is known of a spool apart from its records."""

    def __init__(self, bus: Bus | None, port: PortConfig | None) -> None:
        self.bus = bus
        self.role = Role(port.direction) if port is not None else Role.UNKNOWN
        self.byte_ns = port.byte_ns if port is not None else 0
        #: `before` of the next record.
        self.expected: int | None = 0
        #: Its reader has ended.
        self.ended = False

    def stores(self, record: Record) -> bool:
        """Say whether a record is one that the reader of this spool stores; without a bus it is of the recording itself."""
        if record.kind == RecordKind.DATA:
            return self.bus is not None and self.bus.kind == "serial"
        if record.kind == RecordKind.CAN:
            return self.bus is not None and self.bus.kind == "can" and len(record.data) >= CAN_HEAD.size
        if record.kind == RecordKind.EVENT:
            with contextlib.suppress(*UNDECODABLE):
                return bool(record.event)
            return False
        return True


def buses_of(config: RecordingConfig, known: Mapping[str, Dialect], devices: Sequence[Dialect]) -> dict[str, Bus]:
    """Return the buses of a recording by name. `known`, `devices`: as `Bus` takes them."""
    grouped: dict[str, list[PortConfig]] = {}
    for port in config.ports:
        grouped.setdefault(port.bus, []).append(port)
    return {name: Bus(ports, known, devices) for name, ports in grouped.items()}


class HeldRecords:
    """Records held back until the dialect of their bus is known.

    `change` gets a bus, the choice of its dialects, and the monotonic time of the traffic that decided it.
    """

    def __init__(self, change: Callable[[Bus, Choice, int], None]) -> None:
        self._change = change
        self._held: list[tuple[Spool, Record]] | None = None
        self._bus: Bus
        self._first_ns = 0
        #: Dialects that were found later and wait for a pause: since when, and which.
        self._wanted: dict[str, tuple[int, Choice]] = {}
        self._looked_ns = 0

    @property
    def active(self) -> bool:
        """Something is held back."""
        return self._held is not None

    def begin(self, bus: Bus, record: Record) -> None:
        """Hold back from this record on, the first of a bus of which it is not known what it is in."""
        self._held, self._bus, self._first_ns = [], bus, record.t_ns

    def add(self, spool: Spool, record: Record, bus: Bus | None) -> None:
        """Hold a record back. `bus`: of its spool."""
        assert self._held is not None
        self._held.append((spool, record))
        detection = self._bus.detection
        if bus is not self._bus or detection is None:
            return
        if record.kind == RecordKind.DATA:
            detection.add(Chunk(record.t_ns, bus.name, record.data))
        elif record.kind == RecordKind.CAN:
            can_id, flags, data = record.can
            detection.add(CanFrame(record.t_ns, bus.name, can_id, data, extended=bool(flags & CanFlag.EXTENDED)))

    def release(self, t_ns: int, *, final: bool = False) -> list[tuple[Spool, Record]]:
        """Decide what the bus is in, if that can be or has to be, and return what was held back; else nothing."""
        assert self._held is not None
        detection = self._bus.detection
        assert detection is not None  # or nothing would be held
        choice = detection.first(t_ns, final=final)
        if choice is None:
            return []
        held, self._held = self._held, None
        self._change(self._bus, choice, self._first_ns)
        return held

    def look_again(self, buses: Iterable[Bus], now_ns: int) -> None:
        """Once a second: find out whether what a bus is in has changed; make the change where a pause has come."""
        known = {bus.name: bus for bus in buses}
        for name, (since_ns, choice) in list(self._wanted.items()):
            if not known[name].sounded or now_ns - since_ns > CHANGE_LIMIT_NS:
                del self._wanted[name]
                self._change(known[name], choice, now_ns)
        if now_ns - self._looked_ns < CHECK_NS:
            return
        self._looked_ns = now_ns
        for name, bus in known.items():
            detection = bus.detection
            if detection is not None and detection.dialects and name not in self._wanted:
                found = detection.recheck(now_ns)
                if found is not None:
                    self._wanted[name] = now_ns, found
