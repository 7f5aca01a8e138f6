"""What a reader does with what it has read: into the spool, in order, counted; in memory while the disk is full.

    chunk, can, idle, event  ->  batch  -> flush ->  spool
                                             `-> held (disk full, at most HELD_LIMIT) -> spool when there is room again
                                                   `-> dropped and counted, told by an event in its place

Rules: times never go back; a record stands once or not at all; what is dropped is counted in `before` of what follows, so
that a gap shows its size. Nothing here knows a port.
"""

from __future__ import annotations

import contextlib
import io
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from analyzer.live.reader_hand import Hand
from analyzer.live.spool import RecordKind, SpoolWriter, pack, pack_can, pack_event

#: Bytes of records kept in memory while they cannot be stored.
HELD_LIMIT = 32 << 20
#: Time between two attempts to store what is held.
RETRY_NS = 250_000_000
#: How long a reader that is to end goes on trying.
LAST_TRIES_NS = 3_000_000_000


class StatusLine:
    """Tells events to the parent process, a line of JSON each, and never waits. None: tells none."""

    def __init__(self, fd: int | None) -> None:
        self._file = None if fd is None else io.FileIO(fd, "wb", closefd=False)

    def __call__(self, t_ns: int, event: str, about: dict[str, Any]) -> None:
        """Write one line, if there is room for it."""
        if self._file is not None:
            # It is for the eye: the event itself stands in the spool.
            with contextlib.suppress(OSError):
                self._file.write(msgspec.json.encode({"event": event, "t_ns": t_ns, **about}) + b"\n")


class Store:
    """Stores what one port brings. `unit`: `bytes` or `frames`, what `count` counts; `count`: from a forerunner on.

    `tell` is called with each event. `last_ns`: time of the last record; `idle`: the last one was IDLE. `hand`: learns what is
    taken and what is stored.
    """

    def __init__(
        self,
        writer: SpoolWriter,
        tell: Callable[[int, str, dict[str, Any]], None],
        *,
        unit: str = "bytes",
        count: int = 0,
        last_ns: int = 0,
        idle: bool = False,
        held_limit: int = HELD_LIMIT,
        hand: Hand | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._writer = writer
        self._tell = tell
        self._unit = unit
        self._clock = clock
        self.count = count
        self.last_ns = last_ns
        self.idle = idle
        self.hand = hand
        #: Chunks (or frames) taken.
        self.records = 0
        self._told = count
        self._batch: list[bytes] = []
        self._batch_count = 0
        self._batch_ns = 0
        self._held: deque[tuple[bytes, int]] = deque()
        self._held_bytes = 0
        #: Events that came while traffic was being dropped.
        self._events: deque[bytes] = deque()
        self._held_limit = held_limit
        self._tried_ns = 0
        self._why = ""
        #: What is being dropped: how much, of which times; and the sum of all.
        self._dropping = 0
        self._dropped_from_ns = self._dropped_to_ns = 0
        self.dropped = 0

    def chunk(self, t_ns: int, data: bytes) -> None:
        """Take bytes of a serial line whose last one arrived at `t_ns`."""
        t_ns = self._stamp(t_ns)
        self._batch.append(pack(RecordKind.DATA, t_ns, self.count, data))
        self.count += len(data)
        self._batch_count += len(data)
        self.records += 1
        self.idle = False

    def can(self, t_ns: int, can_id: int, flags: int, payload: bytes) -> None:
        t_ns = self._stamp(t_ns)
        self._batch.append(pack_can(t_ns, self.count, can_id, flags, payload))
        self.count += 1
        self._batch_count += 1
        self.records += 1
        self.idle = False

    def quiet(self, t_ns: int) -> None:
        """Note that nothing came up to `t_ns`; told once, until something comes again."""
        if not self.idle:
            self.idle = True
            self._batch.append(pack(RecordKind.IDLE, self._stamp(t_ns), self.count, b""))
            self.flush()

    def tick(self) -> None:
        """Once a second: retry records that could not be stored, and report the counts."""
        self.flush()
        if self.count != self._told:
            self._told = self.count
            self._tell(self.last_ns, "count", {self._unit: self.count, "records": self.records})

    def event(self, event: str, t_ns: int | None = None, **about: Any) -> None:
        """Note what happened to the port, now or at `t_ns`, and store it."""
        self.flush()
        t_ns = self._stamp(self._clock() if t_ns is None else t_ns)
        self._batch.append(pack_event(t_ns, self.count, event, **about))
        self.flush()
        self._tell(t_ns, event, about)

    def kernel_counts(self, now: Sequence[int], *, adopted: bool) -> Sequence[int]:
        """Return the kernel's counts of a port as they were told last.

        `now`: as they are. `adopted`: a reader that died had the port before, and what was lost since it told them is still
        to be told.
        """
        before = self.hand.counts if adopted and self.hand is not None else ()
        told = before if len(before) == len(now) else now
        self.told_counts(told)
        return told

    def told_counts(self, counts: Sequence[int]) -> None:
        """Keep the kernel's counts for the next reader: they have been told."""
        if self.hand is not None:
            self.hand.counts = counts

    def lose(self, count: int, from_ns: int, to_ns: int, reason: str) -> None:
        """Note that so much was read and is not stored."""
        self.count += count
        self.event("dropped", to_ns, **{self._unit: count}, from_ns=from_ns, to_ns=to_ns, reason=reason)

    def _stamp(self, t_ns: int) -> int:
        if t_ns < self.last_ns:
            return self.last_ns
        self.last_ns = t_ns
        if not self._batch:
            self._batch_ns = t_ns
        return t_ns

    # --- out ------------------------------------------------------------------------------------------------------

    @property
    def _waiting(self) -> bool:
        """Something could not be stored yet."""
        return bool(self._held or self._events or self._dropping)

    def flush(self) -> None:
        """Store what was taken; what cannot be stored is held, or dropped and counted."""
        self._flush()
        if self.hand is not None:
            self.hand.keep(self.count, self.last_ns, stored=not self._waiting)

    def _flush(self) -> None:
        if not self._batch:
            if self._waiting:
                self._retry()
            return
        data = b"".join(self._batch)
        count, from_ns = self._batch_count, self._batch_ns
        self._batch.clear()
        self._batch_count = 0
        if not self._waiting:
            try:
                self._writer.write(data)
                return
            except OSError as error:
                self._why = error.strerror or str(error)
                self._tried_ns = self._clock()
                self._tell(self.last_ns, "note", {"text": f"cannot store: {self._why}; data is kept in memory, retrying"})
        self._hold(data, count, from_ns)
        self._retry()

    def _hold(self, data: bytes, count: int, from_ns: int) -> None:
        if not self._dropping and not self._events and self._held_bytes + len(data) <= self._held_limit:
            self._held.append((data, count))
            self._held_bytes += len(data)
            return
        if not count:
            self._events.append(data)
            return
        # From here to when all that is held has been stored, or the order would be lost.
        if not self._dropping:
            self._dropped_from_ns = from_ns
            self._tell(from_ns, "note", {"text": f"cannot store: {self._why}; memory is full, new data is lost"})
        self._dropping += count
        self._dropped_to_ns = self.last_ns
        self.dropped += count

    def _retry(self, force: bool = False) -> None:
        now_ns = self._clock()
        if not force and now_ns - self._tried_ns < RETRY_NS:
            return
        self._tried_ns = now_ns
        try:
            while self._held:
                self._writer.write(self._held[0][0])
                self._held_bytes -= len(self._held.popleft()[0])
            while self._events:
                self._writer.write(self._events[0])
                self._events.popleft()
            if self._dropping:
                about = self._drop_event()
                self._writer.write(pack_event(self.last_ns, self.count, "dropped", **about))
                self._dropping = 0
                self._tell(self.last_ns, "dropped", about)
        except OSError as error:
            self._why = error.strerror or str(error)

    def _drop_event(self) -> dict[str, Any]:
        about = {"from_ns": self._dropped_from_ns, "to_ns": self._dropped_to_ns, "reason": self._why}
        return {self._unit: self._dropping, **about}

    def close(self, reason: str, wait: Callable[[float], None] = time.sleep) -> None:
        self.event("closed", reason=reason, records=self.records, **{self._unit: self.count})
        self.finish(wait)

    def finish(self, wait: Callable[[float], None] = time.sleep) -> bool:
        """Store what is left, for as long as `LAST_TRIES_NS`; what then is left is told, and lost. Say if all is stored."""
        # A limit is for what comes, not for the rest that is in memory.
        self._writer.limit = 0
        self.flush()
        until_ns = self._clock() + LAST_TRIES_NS
        while self._waiting and self._clock() < until_ns:
            self._retry(force=True)
            if self._waiting:
                wait(0.1)
        if self._waiting:
            left = sum(count for _, count in self._held) + self._dropping
            self._tell(self.last_ns, "unstored", {self._unit: left, "reason": self._why})
        self._writer.close()
        return not self._waiting
