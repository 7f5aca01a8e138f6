"""A port to a CAN bus, for emulated drives and for lines to real drives, and which frames it reads.

Rule: `receive` gives only frames of other senders.

A full bus brings ten thousand frames a second, and most of them are of others. To decode one takes ten times as long as to
read it. So who waits for single drives says so (`Acceptance`): frames of other nodes are then counted and not decoded.

What cannot be read is counted, and told on standard error: the first at once, the count at the end.
"""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Collection

from analyzer.catalogue import Role
from analyzer.errors import ServotapError
from analyzer.live.spool import CanFlag
from analyzer.records import CanFrame
from analyzer.values import printable

#: So many frames of an identifier that is not accepted are read all the same: they tell who else is on the bus.
_READ_OF_OTHERS = 32
_EXTENDED = int(CanFlag.EXTENDED)


class Acceptance:
    """Which frames are read: by default all. `passed`: bytes of data of those that were not."""

    def __init__(self) -> None:
        self._ids: frozenset[int] | None = None
        self._others: dict[int, int] = {}
        self.passed = 0

    def only(self, ids: Collection[int]) -> None:
        """Read the frames of these identifiers of 11 bits, and of each other identifier the first few."""
        self._ids = frozenset(ids)

    def takes(self, can_id: int, flags: int, size: int) -> bool:
        """Say whether a frame is read; `size`: bytes of its data."""
        if self._ids is None or (can_id in self._ids and not flags & _EXTENDED):
            return True
        if not flags & _EXTENDED:
            seen = self._others.get(can_id, 0)
            if seen < _READ_OF_OTHERS:
                self._others[can_id] = seen + 1
                return True
        self.passed += size
        return False


class CanPort(ABC):
    """A port to a CAN bus. `heard_as`: the role of those on the other end; `bitrate`: as it was given."""

    def __init__(self, name: str, heard_as: Role, bitrate: int | None) -> None:
        self.name = name
        self.bitrate = bitrate
        self.acceptance = Acceptance()
        #: Frames that the interface did not take.
        self.lost = 0
        #: What came that could not be read, and why the last of it could not.
        self.unread, self._why = 0, ""
        self._heard_as = heard_as

    @abstractmethod
    def receive(self, timeout_ns: int) -> CanFrame | None:
        """Return the next frame of the others, None where none comes in time. Raises ServotapError when the port is gone."""

    @abstractmethod
    def put(self, frame: CanFrame) -> None:
        """Send a frame of any kind. Raises ServotapError for one that the interface does not take."""

    def send(self, frame: CanFrame) -> None:
        """Send a frame of a drive; one that the interface does not take is lost."""
        try:
            self.put(frame)
        except ServotapError:
            self.lost += 1

    def close(self) -> None:
        """Close the interface; it may be done twice."""
        if self.unread > 1:
            text = f"servotap: {self.name} said {self.unread} things that cannot be read, the last: {printable(self._why)}"
            print(text, file=sys.stderr, flush=True)
        self.unread = 0

    def _frame(self, can_id: int, flags: int, data: bytes) -> CanFrame:
        extended, remote = bool(flags & CanFlag.EXTENDED), bool(flags & CanFlag.REMOTE)
        error, fd = bool(flags & CanFlag.ERROR), bool(flags & CanFlag.FD)
        return CanFrame(None, self.name, can_id, data, self._heard_as, extended, remote, error, fd)

    def _not_read(self, why: str) -> None:
        self.unread, self._why = self.unread + 1, why
        if self.unread == 1:
            print(f"servotap: {self.name} said what cannot be read: {printable(why)}", file=sys.stderr, flush=True)
