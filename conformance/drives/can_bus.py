"""A CAN bus: frames take their time, the lowest identifier goes first, all but the sender receive a frame.

    host    [01: 31 32] |                        |
    drives              | [01: 31 00 .. 3B]      |  [02: F4 02 F8]

Rules:

1. When the bus is free, the ready frame with the lowest identifier is sent first. The frames of one sender keep their
   order.
2. A drive at another bit rate than the bus receives nothing and cannot send. Where the bus has no rate (`speed` None),
   every drive's rate is right.
3. Frames of two senders with one identifier that become ready together are a collision. A comment says so, and they are
   sent one after the other, as after an error frame.
4. Extended, remote, error and FD frames go over the bus and reach no drive.
5. No bus carries more than its rate. If frames come faster, the host's controller keeps `room` of them and loses the others.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.records import CanFrame, Comment, Frame
from conformance.drives.bus import Bus, Station
from conformance.drives.can_bits import frame_bits
from conformance.drives.drive import Drive, Outgoing
from conformance.drives.uart import SECOND_NS
from conformance.drives.wire_faults import WireFaults

HOST = -1
#: The longest data of a CAN 2.0 frame.
_LONGEST = 8
#: The rate that times are made from where the bus has none.
_ANY_RATE = 500_000


class _Waiting(NamedTuple):
    """A frame that is waiting to be sent."""

    ready_ns: int
    order: int
    sender: int
    frame: CanFrame

    @property
    def rank(self) -> tuple[int, int, int]:
        """What arbitration goes by: the identifier; a standard frame before an extended one of the same bits."""
        frame = self.frame
        return (frame.id if frame.extended else frame.id << 18, int(frame.extended), self.order)


class CanBus(Bus):
    """Drives and one host on one CAN bus.

    `arbitration` False: frames go in the order in which they are ready.
    `room`: frames that may wait for the bus; the host's next ones are lost. None: all wait.
    """

    def __init__(
        self,
        drives: Sequence[Drive],
        *,
        name: str = "bus",
        speed: int | None = None,
        wire_time: bool = True,
        arbitration: bool = True,
        room: int | None = None,
        faults: WireFaults | None = None,
    ) -> None:
        super().__init__(drives, name=name, speed=speed, wire_time=wire_time)
        self.arbitration = arbitration
        self.room = room
        #: Frames of the host that found no room.
        self.overrun = 0
        self.faults = faults
        self._inbox: deque[CanFrame] = deque()
        self._waiting: list[_Waiting] = []
        self._carried: _Waiting | None = None
        self._free_ns = 0
        self._started_ns = 0
        self._bytes = 0

    # --- the host -------------------------------------------------------------------------------------------------

    def send(self, can_id: int, data: bytes = b"", *, extended: bool = False, remote: bool = False) -> None:
        """Send a frame from the host as soon as the bus lets it."""
        self.put(CanFrame(self.now_ns, self.name, can_id, bytes(data), Role.REQUEST, extended, remote))

    def put(self, frame: CanFrame) -> None:
        """Send a frame of any kind from the host."""
        if self.room is not None and len(self._waiting) >= self.room:
            self.overrun += 1
            return
        for wait_ns, data in self._damaged(frame.data):
            changed = CanFrame(None, self.name, frame.id, data, Role.REQUEST, frame.extended, frame.remote,
                               frame.error, frame.fd)  # fmt: skip
            self._add(_Waiting(self.now_ns + wait_ns, next(self._order), HOST, changed))
        self._refresh()
        self._carry(self.now_ns)
        self._begin(self.now_ns)

    def receive(self, timeout_ns: int = 0) -> CanFrame | None:
        """Return the next frame that the host hears, letting time pass until it is there; None after the timeout."""
        return self._inbox.popleft() if self._run_to_input(self._inbox, timeout_ns) else None

    def received(self) -> list[CanFrame]:
        """Return all that the host has heard by now and not taken yet."""
        frames = list(self._inbox)
        self._inbox.clear()
        return frames

    @property
    def busy_ns(self) -> int:
        """For how long the frame that is on the wire will keep it busy."""
        return 0 if self._carried is None else max(0, self._free_ns - self.now_ns)

    # --- drives ---------------------------------------------------------------------------------------------------

    def _on_bus(self, speed: int) -> bool:
        return self.speed is None or speed == self.speed

    def _changed(self, station: Station) -> None:
        """A CAN drive keeps its dialect, and its rate is asked for with each frame."""

    def _forget(self, station: Station) -> None:
        self._waiting = [waiting for waiting in self._waiting if waiting.sender != station.index]

    def _queue(self, station: Station, ready_ns: int, outgoing: Outgoing, speed: int) -> None:
        if not self._on_bus(speed):
            return
        can_id = station.drive.address if outgoing.can_id is None else outgoing.can_id
        for wait_ns, data in self._damaged(outgoing.data[:_LONGEST]):
            frame = CanFrame(None, self.name, can_id, data, Role.REPLY)
            self._add(_Waiting(ready_ns + wait_ns, next(self._order), station.index, frame))

    def _damaged(self, data: bytes) -> tuple[tuple[int, bytes], ...]:
        return ((0, data),) if self.faults is None else self.faults.on_can(data)

    # --- the wire -------------------------------------------------------------------------------------------------

    def _add(self, waiting: _Waiting) -> None:
        self._waiting.append(waiting)
        self._waiting.sort()

    def _wire_ns(self) -> int | None:
        if self._carried is not None:
            return self._free_ns
        return max(self._waiting[0].ready_ns, self._free_ns) if self._waiting else None

    def _begin(self, t_ns: int) -> None:
        if self._carried is not None or t_ns < self._free_ns:
            return
        heads: dict[int, _Waiting] = {}
        for waiting in self._waiting:
            if waiting.ready_ns <= t_ns:
                heads.setdefault(waiting.sender, waiting)
        if not heads:
            return
        ready = list(heads.values())
        chosen = min(ready, key=lambda w: w.rank) if self.arbitration else ready[0]
        rivals = [w for w in ready if w is not chosen and w.rank[:2] == chosen.rank[:2]]
        if rivals and self.arbitration and any(w.frame.data != chosen.frame.data for w in rivals):
            self.collisions += 1
            names = " and ".join(self._name_of(w.sender) for w in (chosen, *rivals))
            self._show(Comment(t_ns, self.name, f"collision: {names} send 0x{chosen.frame.id:X} at once"))
        self._waiting.remove(chosen)
        self._carried = chosen
        self._started_ns = t_ns
        self._free_ns = t_ns + (self._length_ns(chosen.frame) if self.wire_time else 0)

    def _length_ns(self, frame: CanFrame) -> int:
        bits = frame_bits(frame.id, frame.data, extended=frame.extended)
        rate = self.speed or (self.stations[0].speed if self.stations else _ANY_RATE)
        return bits * SECOND_NS // rate

    def _name_of(self, sender: int) -> str:
        return "the host" if sender == HOST else self.stations[sender].name

    def _carry(self, t_ns: int) -> None:
        carried = self._carried
        if carried is None or self._free_ns > t_ns:
            return
        self._carried = None
        sent = carried.frame
        end_ns = self._free_ns
        frame = CanFrame(end_ns, self.name, sent.id, sent.data, sent.direction, sent.extended, sent.remote,
                         sent.error, sent.fd)  # fmt: skip
        offset = self._bytes
        self._bytes += len(sent.data)
        self._show(frame)
        if carried.sender != HOST:
            self._inbox.append(frame)
        if frame.extended or frame.remote or frame.error or frame.fd:
            return
        for station in self.stations:
            if station.index == carried.sender or not self._on_bus(station.speed):
                continue
            dialect = station.drive.dialect
            good = all(check.ok for check in dialect.link.checks(frame.data, frame.id))
            heard = Frame(self.name, self._started_ns, end_ns, offset, frame.data, dialect, Role.REQUEST, good, frame)
            self._give(station, heard)
