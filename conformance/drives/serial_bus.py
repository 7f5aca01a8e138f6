"""A half-duplex serial line: bytes take their time, every drive receives all of them, two senders at once collide.

    host   FA 01 30 2B |                 | FA 02 30 2C |
    drives             | FB 01 30 ... B3 |             | FB 02 30 ... 5E        ten bits a byte, at the sender's speed

Rules:

1. A drive sends its reply when the line is free, in the order in which replies are ready. Two replies that become ready
   within one bit of each other begin together and collide. The host sends at once.
2. If two send at once, or at another speed than the listener's, a UART reads the levels on the line
   (`conformance.drives.uart`). A sender does not receive while it sends; a host's adapter may echo.
3. The host gets the bytes of a burst when its last byte has gone. A burst is a transmission without a pause of the line.
   Drives get each frame at the time of its last byte.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.records import Chunk, Comment, Frame
from conformance.drives.bus import Bus, Station
from conformance.drives.drive import Drive, Outgoing
from conformance.drives.receiver import MultiReceiver, Receiver
from conformance.drives.uart import BITS, SECOND_NS, SentBytes, byte_ns, hear
from conformance.drives.wire_faults import Damage, WireFaults

#: Senders that are no drive.
HOST = -1
INTRUDER = -2
#: Speeds so close together read the same.
_SAME_SPEED = 0.02
#: What counts as the speed of a host that is at every drive's speed, where there is no drive.
_ANY_SPEED = 38400


class _Waiting(NamedTuple):
    """What a drive will send."""

    ready_ns: int
    order: int
    station: int
    speed: int
    data: bytes


class _Sending:
    """What one sender has on the line: pieces with the times of their first start bits."""

    def __init__(self, sender: int, start_ns: int, speed: int, damage: Damage) -> None:
        self.sender = sender
        self.speed = speed
        self.pieces: list[SentBytes] = []
        self.waits_ns: list[int] = []
        at_ns = start_ns
        waited = 0
        for wait_ns, data in damage.pieces:
            piece = SentBytes(at_ns + wait_ns, speed, data)
            waited += wait_ns
            self.pieces.append(piece)
            self.waits_ns.append(waited)
            at_ns = piece.end_ns
        self.start_ns = start_ns
        self.end_ns = at_ns


class _Segment(NamedTuple):
    """Bytes as a listener gets them: the first is complete at `first_ns`, each other one `step_ns` later."""

    first_ns: int
    step_ns: int
    data: bytes

    @property
    def last_ns(self) -> int:
        return self.first_ns + (len(self.data) - 1) * self.step_ns


class _Burst:
    """What is sent without a free line between, and how much of it each drive has been given."""

    def __init__(self, start_ns: int, listeners: int) -> None:
        self.start_ns = start_ns
        self.end_ns = start_ns
        self.sendings: list[_Sending] = []
        self.given = [0] * listeners
        self.heard: dict[int, list[_Segment]] = {}


class SerialBus(Bus):
    """Drives and one host on one serial line.

    `echo`: the host's adapter hands back what it sends. `faults`: what the wire does to bytes.
    """

    def __init__(
        self,
        drives: Sequence[Drive],
        *,
        name: str = "bus",
        speed: int | None = None,
        wire_time: bool = True,
        echo: bool = False,
        faults: WireFaults | None = None,
    ) -> None:
        super().__init__(drives, name=name, speed=speed, wire_time=wire_time)
        self.echo = echo
        self.faults = faults
        self._receivers = [self._receiver(s) for s in self.stations]
        self._inbox: deque[Chunk] = deque()
        self._host: deque[tuple[int, int, bytes]] = deque()
        self._waiting: list[_Waiting] = []
        self._burst: _Burst | None = None
        #: When what the host has on the line will have gone, and when all that it was given will have.
        self._host_free_ns = 0
        self._host_done_ns = 0

    # --- the host -------------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> int:
        """Send bytes from the host, now or behind what it still sends; return when the last one will have gone."""
        if not data:
            return self.now_ns
        speed = self._host_speed()
        self._host.append((self.now_ns, speed, data))
        taken_ns = len(data) * BITS * SECOND_NS // speed if self.wire_time else 0
        self._host_done_ns = max(self.now_ns, self._host_done_ns) + taken_ns
        self._refresh()
        self._carry(self.now_ns)
        self._begin(self.now_ns)
        return self._host_done_ns

    def receive(self, timeout_ns: int = 0) -> Chunk | None:
        """Return the next bytes that the host hears, letting time pass until they are there; None after the timeout."""
        return self._inbox.popleft() if self._run_to_input(self._inbox, timeout_ns) else None

    def received(self) -> bytes:
        """Return all that the host has heard by now and not taken yet."""
        data = b"".join(chunk.data for chunk in self._inbox)
        self._inbox.clear()
        return data

    @property
    def busy_ns(self) -> int:
        """For how long the host's bytes so far will keep the line busy."""
        return max(0, self._host_done_ns - self.now_ns)

    def _host_speed(self) -> int:
        if self.speed is not None:
            return self.speed
        return self.stations[0].speed if self.stations else _ANY_SPEED

    # --- drives ---------------------------------------------------------------------------------------------------

    def _receiver(self, station: Station) -> Receiver | MultiReceiver:
        drive, taken_ns = station.drive, byte_ns(station.speed)
        if drive.hears:
            return MultiReceiver(drive.dialect, self.name, byte_ns=taken_ns, others=drive.hears)
        return Receiver(drive.dialect, self.name, byte_ns=taken_ns)

    def _changed(self, station: Station) -> None:
        receiver, drive = self._receivers[station.index], station.drive
        if receiver.dialect is not drive.dialect or receiver.byte_ns != byte_ns(station.speed):
            self._receivers[station.index] = self._receiver(station)

    def _forget(self, station: Station) -> None:
        self._waiting = [waiting for waiting in self._waiting if waiting.station != station.index]
        self._receivers[station.index].reset()

    def _queue(self, station: Station, ready_ns: int, outgoing: Outgoing, speed: int) -> None:
        if outgoing.data:
            self._waiting.append(_Waiting(ready_ns, next(self._order), station.index, speed, outgoing.data))
            self._waiting.sort()

    # --- the line -------------------------------------------------------------------------------------------------

    def _wire_ns(self) -> int | None:
        times = []
        if self._burst is not None:
            times.append(self._burst.end_ns)
        if self._host:
            times.append(max(self._host[0][0], self._host_free_ns))
        if self._waiting and self._burst is None:
            times.append(self._waiting[0].ready_ns)
        for receiver in self._receivers:
            ends_ns = receiver.next_ns()
            if ends_ns is not None:
                times.append(ends_ns)
        return min(times) if times else None

    def _begin(self, t_ns: int) -> None:
        if self._host and max(self._host[0][0], self._host_free_ns) <= t_ns:
            _, speed, data = self._host.popleft()
            self._put(HOST, t_ns, speed, data)
        if self._burst is None and self._waiting and self._waiting[0].ready_ns <= t_ns:
            first = self._waiting.pop(0)
            self._put(first.station, t_ns, first.speed, first.data)
            together_ns = first.ready_ns + SECOND_NS // first.speed
            senders = {first.station}
            for other in list(self._waiting):
                if self.wire_time and other.ready_ns <= together_ns and other.station not in senders:
                    self._waiting.remove(other)
                    senders.add(other.station)
                    self._put(other.station, max(t_ns, other.ready_ns), other.speed, other.data)

    def _put(self, sender: int, start_ns: int, speed: int, data: bytes) -> None:
        """Put bytes on the line, even if another sender is sending."""
        burst = self._burst
        damage = self.faults.on_line(data) if self.faults is not None else Damage(((0, data),))
        if not damage.pieces:
            return
        if burst is None:
            burst = self._burst = _Burst(start_ns, len(self.stations))
        elif sender != INTRUDER:
            self._collided(start_ns, sender, burst)
        sending = _Sending(sender, start_ns, speed, damage)
        burst.sendings.append(sending)
        if damage.intruder:
            struck_ns = start_ns + damage.intruder_at * byte_ns(speed)
            burst.sendings.append(_Sending(INTRUDER, struck_ns, speed, Damage(((0, damage.intruder),))))
        end_ns = sending.end_ns if self.wire_time else start_ns + sending.waits_ns[-1]
        if sender == HOST:
            self._host_free_ns = end_ns
            self._host_done_ns = max(self._host_done_ns, end_ns)
        if self.wire_time:
            end_ns = max(end_ns, burst.sendings[-1].end_ns)
        burst.end_ns = max(burst.end_ns, end_ns)
        burst.heard.clear()

    def _collided(self, t_ns: int, sender: int, burst: _Burst) -> None:
        self.collisions += 1
        names = [self._name_of(s) for s in dict.fromkeys([*(s.sender for s in burst.sendings), sender])]
        self._show(Comment(t_ns, self.name, f"collision: {' and '.join(names)} send at once"))

    def _name_of(self, sender: int) -> str:
        if sender >= 0:
            return self.stations[sender].name
        return "the host" if sender == HOST else "an intruder"

    # --- what is heard --------------------------------------------------------------------------------------------

    def _carry(self, t_ns: int) -> None:
        burst = self._burst
        frames: list[tuple[int, int, Frame]] = []
        if burst is not None:
            for station in self.stations:
                self._bring(station, burst, t_ns, frames)
        for index, receiver in enumerate(self._receivers):
            ends_ns = receiver.next_ns()
            if ends_ns is not None and ends_ns <= t_ns:
                frames += [(frame.last_ns, index, frame) for frame in receiver.expire(t_ns)]
        if burst is not None and burst.end_ns <= t_ns:
            self._burst = None
            self._end(burst)
        if len(frames) > 1:
            frames.sort(key=lambda each: each[:2])
        for _, index, frame in frames:
            self._give(self.stations[index], frame)

    def _bring(self, station: Station, burst: _Burst, t_ns: int, frames: list[tuple[int, int, Frame]]) -> None:
        """Give a drive the bytes that it has heard by `t_ns`."""
        index = station.index
        receiver = self._receivers[index]
        before = 0
        for segment in self._heard(burst, index):
            size = len(segment.data)
            new = max(0, burst.given[index] - before)
            before += size
            if new >= size:
                continue
            if segment.first_ns + new * segment.step_ns > t_ns:
                break
            complete = size
            if segment.last_ns > t_ns:
                complete = (t_ns - segment.first_ns) // segment.step_ns + 1
            found = receiver.feed(segment.data[new:complete], segment.first_ns + new * segment.step_ns, segment.step_ns)
            frames += [(frame.last_ns, index, frame) for frame in found]
            burst.given[index] += complete - new

    def _heard(self, burst: _Burst, listener: int) -> list[_Segment]:
        """Return what a listener hears of a burst."""
        known = burst.heard.get(listener)
        if known is None:
            known = burst.heard[listener] = self._hear(burst, listener)
        return known

    def _hear(self, burst: _Burst, listener: int) -> list[_Segment]:
        muted_by_itself = listener >= 0 or not self.echo
        others = [s for s in burst.sendings if s.sender != listener or not muted_by_itself]
        if not others:
            return []
        speed = self._host_speed() if listener == HOST else self.stations[listener].speed
        if len(burst.sendings) == 1 and self._alike(others[0], listener, speed):
            return self._clean(others[0])
        senders = [SentBytes(p.start_ns, self._sent_at(s, listener, speed), p.data) for s in others for p in s.pieces]
        muted = [(s.start_ns, s.end_ns) for s in burst.sendings if s.sender == listener and muted_by_itself]
        heard = hear(senders, speed, muted)
        if self.wire_time:
            return [_Segment(each.t_ns, 0, bytes((each.byte,))) for each in heard]
        return [_Segment(burst.end_ns, 0, bytes(each.byte for each in heard))] if heard else []

    def _sent_at(self, sending: _Sending, listener: int, speed: int) -> int:
        """Return the speed at which a listener takes a sending to be: a host at any speed is always right."""
        free = self.speed is None and HOST in (sending.sender, listener)
        return speed if free else sending.speed

    def _alike(self, sending: _Sending, listener: int, speed: int) -> bool:
        return abs(self._sent_at(sending, listener, speed) / speed - 1) < _SAME_SPEED

    def _clean(self, sending: _Sending) -> list[_Segment]:
        if not self.wire_time:
            waits = zip(sending.pieces, sending.waits_ns, strict=True)
            return [_Segment(sending.start_ns + waited_ns, 0, piece.data) for piece, waited_ns in waits]
        step_ns = byte_ns(sending.speed)
        return [_Segment(piece.start_ns + step_ns, step_ns, piece.data) for piece in sending.pieces]

    def _end(self, burst: _Burst) -> None:
        """Give the host what it has received, and show the burst to the watchers."""
        segments = self._heard(burst, HOST)
        if segments:
            data = b"".join(segment.data for segment in segments)
            self._inbox.append(Chunk(burst.end_ns, self.name, data, Role.REPLY))
        if not self._watchers:
            return
        if len(burst.sendings) == 1:
            sending = burst.sendings[0]
            role = Role.REQUEST if sending.sender == HOST else Role.REPLY
            for segment in self._clean(sending):
                self._show(Chunk(segment.last_ns, self.name, segment.data, role))
            return
        everything = [piece for sending in burst.sendings for piece in sending.pieces]
        heard = hear(everything, burst.sendings[0].speed)
        if heard:
            self._show(Chunk(burst.end_ns, self.name, bytes(each.byte for each in heard)))
