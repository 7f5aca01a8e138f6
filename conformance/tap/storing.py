"""The storage of a tap: a separate thread, so that a slow disk delays no bytes.

    tap: pass on -> put into a queue -> go on          thread: queue -> Store (spool, memory while the disk is full)

Times. Bytes from the adapter are stamped like those of any reader. Bytes from the program are stamped with the end of their
transmission. It is computed from the speed, and is never later than the first byte of the reply. Rules: the queue is bounded;
bytes that do not fit are counted, and an event marks their place. Events of the adapter stand with the replies.
"""

from __future__ import annotations

import contextlib
import os
import queue
import struct
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from analyzer.live.reader_store import Store
from analyzer.live.reader_stream import Piece, settle

REQUEST = "request"
REPLY = "reply"
#: Bytes that may wait for the thread.
QUEUE_LIMIT = 64 << 20


class Taken:
    """How much a process has taken of each stream, in a file that outlives it: a u64 for each stream.

    `before`: the counts that a process which died has left, None where there was none.
    """

    _COUNT = struct.Struct("<Q")

    def __init__(self, path: Path, stored: dict[str, int]) -> None:
        size = self._COUNT.size
        self._places = {direction: at * size for at, direction in enumerate(stored)}
        left = path.read_bytes() if path.exists() else b""
        whole = len(left) == size * len(stored)
        self.before = {d: self._COUNT.unpack_from(left, at)[0] for d, at in self._places.items()} if whole else None
        self.counts = dict(self.before or stored)
        # In place: a death here leaves the counts of before. On a full disk this is an error, not a death at the first byte.
        self._file = open(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "r+b", buffering=0)  # noqa: SIM115
        self._file.write(b"".join(self._COUNT.pack(count) for count in self.counts.values()))

    @classmethod
    def at(cls, path: Path, stored: dict[str, int]) -> Taken | None:
        """Return the counts; None where they have no place, as on a full disk."""
        try:
            return cls(path, stored)
        except OSError:
            return None

    def add(self, direction: str, size: int) -> None:
        """Count what was taken, before anything is done with it."""
        self.counts[direction] += size
        # Where it cannot be kept, a death tells less; the bytes themselves come first.
        with contextlib.suppress(OSError):
            self._file.seek(self._places[direction])
            self._file.write(self._COUNT.pack(self.counts[direction]))


class Storing:
    """Stores both directions. `stores`: by direction."""

    def __init__(self, stores: dict[str, Store], *, queue_limit: int = QUEUE_LIMIT) -> None:
        self._stores = stores
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._limit = queue_limit
        self._put = self._taken = 0
        #: What did not fit: bytes and times of the first and the last, by direction.
        self._left_out: dict[str, tuple[int, int, int]] = {}
        self._thread = threading.Thread(target=self._run, name="servotap-store", daemon=True)
        self._thread.start()

    # --- for the one who passes the bytes on ----------------------------------------------------------------------

    def pieces(self, direction: str, pieces: Sequence[Piece], byte_ns: int) -> None:
        """Take bytes with the times of their last ones."""
        size = sum(len(data) for _, data in pieces)
        if self._put - self._taken + size > self._limit:
            count, from_ns, _ = self._left_out.get(direction, (0, pieces[0][0], 0))
            self._left_out[direction] = (count + size, from_ns, pieces[-1][0])
            return
        self._tell_left_out()
        self._put += size
        self._queue.put(lambda: self._store(direction, pieces, byte_ns, size))

    def dropped(self, direction: str, count: int, from_ns: int, reason: str) -> None:
        """Tell of bytes that were taken and are not stored."""
        self._queue.put(lambda: self._drop(direction, count, from_ns, time.monotonic_ns(), reason))

    def event(self, direction: str, event: str, t_ns: int | None = None, **about: Any) -> None:
        self._queue.put(lambda: self._stores[direction].event(event, t_ns, **about))

    def quiet(self, direction: str, t_ns: int) -> None:
        """Note that nothing came up to a time."""
        self._queue.put(lambda: self._stores[direction].quiet(t_ns))

    def still_there(self, t_ns: int) -> None:
        """Store a sign of life: processes that follow the spools see that they are still written."""

        def store() -> None:
            self._stores[REPLY].idle = False
            self._stores[REPLY].quiet(t_ns)

        self._queue.put(store)

    def flush(self) -> None:
        """Try again what could not be stored."""
        self._tell_left_out()
        self._queue.put(self._flush)

    def close(self, reason: str) -> None:
        """Store what is left and the end; returns when it is done."""
        self._tell_left_out()
        for direction in self._stores:
            self._queue.put(lambda store=self._stores[direction]: store.close(reason))  # type: ignore[misc]
        self._queue.put(None)
        self._thread.join()

    def _tell_left_out(self) -> None:
        if not self._left_out:
            return
        left_out, self._left_out = self._left_out, {}
        for direction, (count, from_ns, to_ns) in left_out.items():
            self._queue.put(lambda d=direction, c=count, a=from_ns, b=to_ns: self._drop(d, c, a, b))  # type: ignore[misc]

    # --- the thread -----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while (work := self._queue.get()) is not None:
            work()

    def _store(self, direction: str, pieces: Sequence[Piece], byte_ns: int, size: int) -> None:
        store = self._stores[direction]
        for t_ns, data in settle(pieces, byte_ns, store.last_ns, after_idle=store.idle):
            store.chunk(t_ns, data)
        store.flush()
        self._taken += size

    def _drop(self, direction: str, count: int, from_ns: int, to_ns: int, reason: str = "the disk did not keep up") -> None:
        self._stores[direction].lose(count, from_ns, to_ns, reason)

    def _flush(self) -> None:
        for store in self._stores.values():
            store.flush()


class SendQueue:
    """What the program wrote and the line is still sending: held back until its end is certain.

    No clock: times are arguments.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, bytes]] = []
        self._free_ns = 0

    def add(self, now_ns: int, data: bytes, byte_ns: int) -> None:
        """Take bytes that were given to the adapter at `now_ns`."""
        self._free_ns = max(self._free_ns, now_ns) + len(data) * byte_ns
        self._waiting.append((now_ns, self._free_ns, data))

    def ended(self, now_ns: int) -> list[Piece]:
        """Return what has been sent by now, with the times of its ends."""
        done = [(end_ns, data) for _, end_ns, data in self._waiting if end_ns <= now_ns]
        if done:
            self._waiting = [each for each in self._waiting if each[1] > now_ns]
        return done

    def answered(self, first_ns: int) -> list[Piece]:
        """Return all that waits: something came in, whose first byte was on the line at `first_ns`."""
        done = [(max(given_ns, min(end_ns, first_ns)), data) for given_ns, end_ns, data in self._waiting]
        if done:
            self._waiting.clear()
            self._free_ns = min(self._free_ns, max(first_ns, done[-1][0]))
        return done

    @property
    def next_ns(self) -> int | None:
        """When the first of what waits has been sent, None if nothing waits."""
        return self._waiting[0][1] if self._waiting else None
