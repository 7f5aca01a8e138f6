"""Listening to a stream of bytes behind a descriptor: a serial port of Linux, or a TCP connection.

    poll -> read, stamp, read, stamp ... until nothing is left -> times settled -> stored -> poll

Times. A read is stamped right after it, so its last byte had arrived by then. If several reads in a row were needed, their
bytes had been waiting. Each byte takes `byte_ns` on the line, so a chunk ended at least n byte times before the n bytes
behind it. Its stamp is set back to that time (`settle`), but never before a time that is stored already.

Pauses. When nothing has come for 50 ms this is stored once (IDLE), with a time at which the port was seen empty. Later bytes
begin after that time for the framer too. The framer spreads the bytes of a chunk backwards from the chunk's time. So the
first chunk after a pause is cut behind its first byte if it would reach back into the pause.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence

from analyzer.framer import SLOWEST_BYTE_NS
from analyzer.live.reader_hand import DRAIN_LIMIT, READ_SIZE, Left
from analyzer.live.reader_port import IDLE_NS, Lost, Stop, listen, readable
from analyzer.live.reader_store import Store

#: How long a reader that is to end goes on reading what keeps coming.
LAST_READS_NS = 200_000_000
_DIED = "the reader process died before it could store them"

Piece = tuple[int, bytes]


def settle(pieces: Sequence[Piece], byte_ns: int, floor_ns: int, *, after_idle: bool = False) -> list[Piece]:
    """Return reads (stamp, bytes) in a row with the times at which their last bytes can have arrived at the latest.

    `byte_ns`: 0 unknown. `floor_ns`: time of what was stored before them, `after_idle`: that was an IDLE.
    """
    settled: list[Piece] = []
    limit_ns: int | None = None
    for stamp_ns, data in reversed(pieces):
        t_ns = stamp_ns if limit_ns is None else min(stamp_ns, limit_ns)
        t_ns = max(t_ns, floor_ns)
        settled.append((t_ns, data))
        limit_ns = t_ns - len(data) * byte_ns
    settled.reverse()
    if after_idle and settled:
        t_ns, data = settled[0]
        if len(data) > 1 and t_ns - len(data) * (byte_ns or SLOWEST_BYTE_NS) <= floor_ns:
            first_ns = max(t_ns - (len(data) - 1) * byte_ns, floor_ns)
            settled[:1] = [(first_ns, data[:1]), (t_ns, data[1:])]
    return settled


def drain(fd: int, store: Store) -> tuple[list[Piece], str | None]:
    """Return what is there now, read by read with stamps, and why the port is gone, `None` if it is not."""
    pieces: list[Piece] = []
    size = 0
    hand = store.hand
    if hand is not None:
        hand.begin(store.count)
    while size < DRAIN_LIMIT:
        waiting = None if hand is None else _waiting(fd)
        if pieces and waiting == 0:
            break
        try:
            # Nothing waits where the port has ended, and only a read tells.
            data = os.read(fd, READ_SIZE) if hand is None or waiting is None else hand.read(fd, min(waiting or 1, READ_SIZE))
        except BlockingIOError:
            return pieces, None
        except OSError as error:
            return pieces, error.strerror or str(error)
        stamp_ns = time.monotonic_ns()
        if not data:
            return pieces, ""
        pieces.append((stamp_ns, data))
        size += len(data)
    return pieces, None


def _waiting(fd: int) -> int | None:
    """Return how many bytes wait to be read; None where the port does not say."""
    from fcntl import ioctl
    from termios import FIONREAD

    try:
        return int.from_bytes(ioctl(fd, FIONREAD, bytes(4)), sys.byteorder)
    except OSError:
        return None


def take_over(store: Store, left: Left, byte_ns: int) -> None:
    """Store what a reader that died has left, and tell what it has lost."""
    if left.lost:
        store.lose(left.lost, left.last_ns, left.last_ns, _DIED)
    if left.data:
        _store(store, [(max(left.t_ns, left.last_ns), left.data)], byte_ns)


def listen_to_stream(
    fd: int, store: Store, stop: Stop, *, byte_ns: int, ended: str, tick: Callable[[int], None] | None = None
) -> None:
    """Store what comes from `fd` until the end is requested.

    `ended`: what the end of the stream means, in words. `tick` is called about once a second. Raises Lost.
    """

    def take(ready: bool) -> int:
        pieces, gone = drain(fd, store)
        if pieces:
            _store(store, pieces, byte_ns)
        if gone is not None:
            raise Lost(gone or ended)
        return pieces[-1][0] if pieces else 0

    listen(store, stop, take, wait=readable(fd, stop), idle_ns=IDLE_NS + 2 * byte_ns, tick=tick)
    _last_reads(fd, store, byte_ns, tick)


def _store(store: Store, pieces: Sequence[Piece], byte_ns: int) -> None:
    for t_ns, data in settle(pieces, byte_ns, store.last_ns, after_idle=store.idle):
        store.chunk(t_ns, data)
    store.flush()


def _last_reads(fd: int, store: Store, byte_ns: int, tick: Callable[[int], None] | None) -> None:
    """Take what had come before the end."""
    until_ns = time.monotonic_ns() + LAST_READS_NS
    while True:
        pieces, gone = drain(fd, store)
        if pieces:
            _store(store, pieces, byte_ns)
        if not pieces or gone is not None or time.monotonic_ns() > until_ns:
            break
    if tick is not None:
        tick(time.monotonic_ns())
