"""A bus of emulated drives and one host: what serial lines and CAN buses share. No I/O, no clock: time is an argument.

    host.send -> wire -> every drive's receiver -> Drive.receive -> Outgoing -> wire -> other drives' receivers, host.receive

A bus knows the time of its next event: bytes arrive, a reply is ready, a drive acts, a pause ends. With a
virtual clock `receive` and `run_until` jump from one event to the next; a server on the real clock sleeps until the next
event. The same calls in the same order give the same bytes at the same times.

Rules:

1. Events are handled in the order of their times, for each drive separately.
2. A drive receives everything but its own bytes.
3. A drive sends at the speed that it had when it began to answer: the reply to a change of speed is the last one at the
   old speed.

Watchers get all traffic as the analyzer's records (`watch`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count

from analyzer.records import CanFrame, Chunk, Comment, Frame
from conformance.drives.drive import Drive, Outgoing

Traffic = Chunk | CanFrame | Comment
Watcher = Callable[[Traffic], None]

#: Steps without any time passing, after which a drive is taken to be stuck.
_STUCK = 10_000


class Station:
    """One drive at its place on the bus. `due_ns`: when it will do something by itself."""

    def __init__(self, index: int, drive: Drive) -> None:
        self.index = index
        self.drive = drive
        self.name = f"{drive.dialect.name}@{drive.address}"
        self.due_ns = drive.next_ns()
        self.last_ns = drive.now_ns

    @property
    def speed(self) -> int:
        """The bits per second at which the drive listens and sends."""
        return self.drive.speed


class Bus(ABC):
    """Drives and one host on one wire.

    `name`: the bus in logs. `speed`: the host's bits per second, None: the rate of each drive. `wire_time` False:
    bytes and frames take no time.
    """

    def __init__(self, drives: Sequence[Drive], *, name: str = "bus", speed: int | None = None, wire_time: bool = True) -> None:
        self.name = name
        self.wire_time = wire_time
        self.now_ns = max((drive.now_ns for drive in drives), default=0)
        self.collisions = 0
        self.stations = [Station(i, drive) for i, drive in enumerate(drives)]
        self._speed = speed
        self._watchers: list[Watcher] = []
        self._order = count()
        self._stuck = 0

    @property
    def drives(self) -> list[Drive]:
        """The drives, in the order in which they were given."""
        return [station.drive for station in self.stations]

    @property
    def speed(self) -> int | None:
        """The host's bits per second; None: the rate of each drive."""
        return self._speed

    @speed.setter
    def speed(self, speed: int | None) -> None:
        if speed != self._speed:
            self._speed = speed
            self._tell_speeds()

    def watch(self, watcher: Watcher) -> None:
        """Call `watcher` with all that goes over the wire from now on, when its last byte has gone."""
        self._watchers.append(watcher)

    def power_cycle(self, index: int) -> None:
        """Switch a drive off and on: replies that are not sent yet and half-received frames are lost."""
        station = self.stations[index]
        self._advance(station, self.now_ns)
        self._forget(station)
        station.drive.power_cycle(self.now_ns)
        station.due_ns = station.drive.next_ns()
        self._changed(station)

    # --- time -----------------------------------------------------------------------------------------------------

    def next_ns(self) -> int | None:
        """Return when something will happen without the host, or None while nothing is under way."""
        times = [s.due_ns for s in self.stations if s.due_ns is not None]
        wire = self._wire_ns()
        if wire is not None:
            times.append(wire)
        return max(min(times), self.now_ns) if times else None

    def run_until(self, t_ns: int) -> None:
        """Let time pass until `t_ns`; all drives have reached it afterwards.

        Raises ValueError for a time that has passed.
        """
        if t_ns < self.now_ns:
            raise ValueError(f"expected a time from {self.now_ns} ns on, got {t_ns}")
        self._refresh()
        while (due := self.next_ns()) is not None and due <= t_ns:
            self._step(due)
        self.now_ns = t_ns
        self._carry(t_ns)
        for station in self.stations:
            self._advance(station, t_ns)

    def _run_to_input(self, waiting: deque[Chunk] | deque[CanFrame], timeout_ns: int) -> bool:
        """Let time pass until something waits for the host or the time is out; say whether there is something."""
        deadline = self.now_ns + timeout_ns
        self._refresh()
        while not waiting:
            due = self.next_ns()
            if due is None or due > deadline:
                self.run_until(deadline)
                break
            self._step(due)
        return bool(waiting)

    def _refresh(self) -> None:
        """Ask every drive anew when it will act: it may have been changed from outside."""
        for station in self.stations:
            station.due_ns = station.drive.next_ns()
        self._stuck = 0

    def _step(self, t_ns: int) -> None:
        """Do all that is due at `t_ns`, the time of the next event."""
        self._stuck = self._stuck + 1 if t_ns == self.now_ns else 0
        if self._stuck > _STUCK:
            late = ", ".join(s.name for s in self.stations if s.due_ns is not None and s.due_ns <= t_ns)
            raise RuntimeError(f"time stands still at {t_ns} ns; due and never done: {late or 'the wire'}")
        self.now_ns = t_ns
        self._carry(t_ns)
        for station in self.stations:
            if station.due_ns is not None and station.due_ns <= t_ns:
                self._advance(station, t_ns)
        self._begin(t_ns)

    # --- drives ---------------------------------------------------------------------------------------------------

    def _advance(self, station: Station, t_ns: int) -> None:
        if t_ns > station.last_ns or (station.due_ns is not None and station.due_ns <= t_ns):
            before = station.speed
            station.last_ns = t_ns
            self._answers(station, station.drive.advance(t_ns), before)

    def _give(self, station: Station, frame: Frame) -> None:
        """Give a frame to a drive at the time of its end, after all that the drive does by itself before."""
        t_ns = max(frame.last_ns, station.last_ns)
        if station.due_ns is not None and station.due_ns <= t_ns:
            self._advance(station, t_ns)
        before = station.speed
        station.last_ns = t_ns
        self._answers(station, station.drive.receive(frame, t_ns), before)

    def _answers(self, station: Station, outgoing: Sequence[Outgoing], speed: int) -> None:
        for each in outgoing:
            self._queue(station, each.at_ns, each, speed)
        station.due_ns = station.drive.next_ns()
        self._changed(station)

    # --- watchers -------------------------------------------------------------------------------------------------

    def _show(self, traffic: Traffic) -> None:
        for watcher in self._watchers:
            watcher(traffic)

    def _tell_speeds(self) -> None:
        """Tell the watchers which drives listen at another speed than the host's."""
        if self._speed is None:
            return
        other = [(s.name, s.speed) for s in self.stations if s.speed != self._speed]
        if other:
            listed = ", ".join(f"{name} at {speed}" for name, speed in other)
            self._show(Comment(self.now_ns, self.name, f"the host is at {self._speed} baud, {listed}"))

    # --- what the kinds of bus differ in --------------------------------------------------------------------------

    @abstractmethod
    def _wire_ns(self) -> int | None:
        """Return when something will happen on the wire, or None."""

    @abstractmethod
    def _carry(self, t_ns: int) -> None:
        """Deliver what is complete by `t_ns` to its listeners."""

    @abstractmethod
    def _begin(self, t_ns: int) -> None:
        """Put on the wire what is ready by `t_ns`, where the wire allows it."""

    @abstractmethod
    def _queue(self, station: Station, ready_ns: int, outgoing: Outgoing, speed: int) -> None:
        """Take what a drive sends."""

    @abstractmethod
    def _forget(self, station: Station) -> None:
        """Drop the replies that a drive has not sent yet, and half-received frames."""

    @abstractmethod
    def _changed(self, station: Station) -> None:
        """Notice that a drive may have changed its dialect or speed."""
