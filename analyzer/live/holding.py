"""Records that are held back while it is not known yet what a bus is in; and what is found out later.

At the first traffic of such a bus everything stops, for half a second of traffic at most (`Detection`), so that the log stays
in order and its decoded frames bear their own times. A dialect that is found later waits for a pause on its bus: in the
midst of a frame it would cut it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from analyzer.detect import Choice
from analyzer.live.bus import Bus
from analyzer.live.merge import Spool
from analyzer.live.spool import CanFlag, Kind, Record
from analyzer.records import CanFrame, Chunk

#: What a new dialect waits for at most: a pause on its bus.
CHANGE_NS = 2_000_000_000
#: Time between two looks whether something has changed.
LOOK_NS = 1_000_000_000


class Holding:
    """What is held back. `change`: told of a bus and what it is in, and the time of what decided it (monotonic)."""

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
        if record.kind == Kind.DATA:
            detection.add(Chunk(record.t_ns, bus.name, record.data))
        elif record.kind == Kind.CAN:
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
            if not known[name].sounded or now_ns - since_ns > CHANGE_NS:
                del self._wanted[name]
                self._change(known[name], choice, now_ns)
        if now_ns - self._looked_ns < LOOK_NS:
            return
        self._looked_ns = now_ns
        for name, bus in known.items():
            detection = bus.detection
            if detection is not None and detection.dialects and name not in self._wanted:
                found = detection.again(now_ns)
                if found is not None:
                    self._wanted[name] = now_ns, found
