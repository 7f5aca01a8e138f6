"""The spool: what a reader process stores and the decoding process takes, in files that outlive both.

    <log>.spool/<number>-<bus>[-<direction>].<segment>.raw

    record:  magic 0x5B | kind u8 | length u32 | t_ns u64 | before u64 | crc32 u32 | data      (little endian)

The CRC covers the rest of the record. The consumer skips and counts bytes that form no whole record, up to the next one.

One reader writes a spool and one consumer follows it. Records are written whole, so a kill can only break the last one.
A segment is closed when it has grown to `SEGMENT_SIZE`. The consumer deletes segments that it has read, but never the last
one: a restarted reader continues its count. Times are `CLOCK_MONOTONIC` nanoseconds and never go back within a spool.
`before` counts the bytes (serial) or frames (CAN) of the port before this record. It includes dropped ones, so a loss shows.

Kinds:

    DATA    bytes of a serial line; t_ns: arrival of the last one
    CAN     one frame: id u32, flags u8, payload
    EVENT   a JSON object; its "event" says what happened
    IDLE    nothing came up to t_ns. Later bytes came after it, and the stored times alone show a pause longer than the
            framer's silence

Events of a port, with what they hold:

    open      notes [text], precision text      the port was taken up; notes: what cannot be guaranteed
    note      text                              something that became known later; with `kept`, from_ns, gap_ns: another
                                                reader has taken over from one that died; the kernel buffered
    speed     speed, byte_ns, text              the line runs at another speed from here on (a tap follows its program)
    lost      reason                            the port is gone
    back      gap_ns, from_ns, reason, notes    reconnected; traffic in between is missing
    overrun   from_ns, and those of overrun, buf_overrun, frame, parity, brk that rose: the kernel's counters
    kernel_dropped  frames, from_ns             the kernel had no room for frames (CAN)
    bus_error reason, from_ns, count            trouble of a CAN bus: bus off, error states, an adapter that talks nonsense
    dropped   bytes or frames, from_ns, to_ns, reason   came in and could not be stored
    closed    reason                            the reader has ended; nothing follows but what another reader stores

Events of the recording, in the spool `config.CONTROL`:

    begin        host, version, system          first of all
    clock_step   step_ns, cause                 the wall clock was set, or the machine slept; times here do not follow
    clock_drift  offset_ns                      wall clock minus this clock since the start, once a minute
    mark         text                           a note of the user
    restarted    what (reader, decoding), stem, reason      a process that had died was started again
    end          reason                         last of all: every reader has ended

A supervisor that is killed writes no `end`. Readers and the decoding process hold a pipe from it as standard input, and its
end tells them: each reader ends with `closed`, and the decoding process ends when it has read what there is.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import struct
import zlib
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import IO, Any, NamedTuple

import msgspec

MAGIC = 0x5B
#: What the configuration of a recording says of its spools; those of format 1 had no CRC.
FORMAT = 2
HEAD = struct.Struct("<BBIQQI")
_CHECKED = struct.Struct("<BBIQQ")
#: Bytes after which a reader begins a new segment.
SEGMENT_SIZE = 4 << 20
#: The longest data of a record.
DATA_LIMIT = 1 << 20
#: Why nothing more is stored where the spools have reached their limit.
FULL = "the spools have reached their limit (--max-spool), decoding does not keep up"
#: Times of records are smaller.
NEVER_NS = 1 << 63
CAN_HEAD = struct.Struct("<IB")
#: The most data bytes of a CAN frame: those of CAN FD.
MOST_BYTES = 64
_SEGMENT_NAME = re.compile(r"(?P<stem>\d+-.+)\.\d+\.raw", re.DOTALL)


class RecordKind(IntEnum):
    """What a record is."""

    DATA = 1
    CAN = 2
    EVENT = 3
    IDLE = 4


_KINDS = frozenset(RecordKind)


class CanFlag(IntEnum):
    """Bits of a CAN record's flags. RX: received from others; TX: sent by this host."""

    EXTENDED = 1
    REMOTE = 2
    ERROR = 4
    FD = 8
    TX = 16


class Record(NamedTuple):
    """A record as it stands in a spool. `end`: the place after it, in bytes of the segment."""

    kind: int
    t_ns: int
    before: int
    data: bytes
    segment: int = 0
    end: int = 0

    @property
    def event(self) -> dict[str, Any]:
        """The object of an EVENT. Raises one of UNDECODABLE where it is none."""
        return msgspec.json.decode(self.data, type=dict[str, Any])

    @property
    def units(self) -> int:
        """How far this record moves `before` on: its bytes, or one frame."""
        return len(self.data) if self.kind == RecordKind.DATA else int(self.kind == RecordKind.CAN)

    @property
    def can(self) -> tuple[int, int, bytes]:
        """Identifier, flags and payload of a CAN record."""
        can_id, flags = CAN_HEAD.unpack_from(self.data)
        return can_id, flags, self.data[CAN_HEAD.size :]


def pack(kind: int, t_ns: int, before: int, data: bytes) -> bytes:
    """Return a record as bytes."""
    head = _CHECKED.pack(MAGIC, kind, len(data), t_ns, before)
    return b"%b%b%b" % (head, zlib.crc32(data, zlib.crc32(head)).to_bytes(4, "little"), data)


def pack_can(t_ns: int, before: int, can_id: int, flags: int, payload: bytes) -> bytes:
    """Return a CAN record as bytes."""
    return pack(RecordKind.CAN, t_ns, before, CAN_HEAD.pack(can_id, flags) + payload)


def pack_event(t_ns: int, before: int, event: str, **about: Any) -> bytes:
    """Return an EVENT record as bytes."""
    return pack(RecordKind.EVENT, t_ns, before, msgspec.json.encode({"event": event, **about}))


class SpoolWriter:
    """Writes one port's records. `folder` exists; `stem` is `<number>-<bus>`. Raises OSError when a write fails.

    `limit`: bytes of all spools of the folder beyond which no segment is begun, 0 for none.
    """

    def __init__(self, folder: Path, stem: str, *, segment_size: int = SEGMENT_SIZE, limit: int = 0, first: int = 0) -> None:
        self._folder = folder
        self._stem = stem
        self._segment_size = segment_size
        self.limit = limit
        # A reader that is started again goes on behind what its forerunner left, also where that was deleted.
        self._segment = max((s for s, _ in segments(folder, stem)), default=-1)
        self._segment = max(self._segment, first - 1)
        self._file: IO[bytes] | None = None
        self._size = 0

    def write(self, record: bytes) -> None:
        """Store one record (or several whole ones), whole or not at all.

        Raises OSError with nothing stored, as on a full disk; it may be tried again.
        """
        file = self._file
        if file is None or self._size >= self._segment_size:
            file = self._next()
        elif os.fstat(file.fileno()).st_nlink == 0:
            file = self._store_again(file)
        at = self._size
        rest = memoryview(record)
        try:
            while rest:
                # A part is what there was room for; why not for more says the next attempt.
                written = file.write(rest)
                if not written:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                rest = rest[written:]
        except OSError:
            # Half a record would hide all that follows it.
            file.truncate(at)
            file.seek(at)
            raise
        self._size = at + len(record)

    def _next(self) -> IO[bytes]:
        if self.limit and size_of(self._folder) >= self.limit:
            raise OSError(errno.EDQUOT, FULL)
        file = self._create(self._segment + 1)
        if self._file is not None:
            self._file.close()
        self._segment += 1
        self._file, self._size = file, 0
        return file

    def _create(self, number: int) -> IO[bytes]:
        return open(self._folder / f"{self._stem}.{number:06d}.raw", "x+b", buffering=0)

    def _store_again(self, deleted: IO[bytes]) -> IO[bytes]:
        """Write a segment that was deleted anew: its consumer may not have read it. Raises OSError."""
        deleted.seek(0)
        data = deleted.read(self._size)
        file = self._create(self._segment)
        if file.write(data) != len(data):
            file.close()
            Path(file.name).unlink()
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        deleted.close()
        self._file = file
        return file

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def segments(folder: Path, stem: str) -> list[tuple[int, Path]]:
    """Return the segments of a spool with their numbers, in order."""
    found = []
    for path in folder.glob(f"{stem}.*.raw"):
        number = path.name[len(stem) + 1 : -4]
        if number.isdigit():
            found.append((int(number), path))
    return sorted(found)


class SpoolReader:
    """Follows a spool while it is written. `start`: segment and place to go on from."""

    def __init__(self, folder: Path, stem: str, start: tuple[int, int] | None = None) -> None:
        self._folder = folder
        self._stem = stem
        self._segment, self._place = start or (-1, 0)
        self._file: IO[bytes] | None = None
        self._rest = b""
        #: Bytes that were no record: a spool that was damaged.
        self.damaged = 0

    @property
    def position(self) -> tuple[int, int]:
        """Segment and place after the last record given."""
        return self._segment, self._place

    def read(self, most: int = 1 << 20, *, final: bool = False) -> Iterator[Record]:
        """Yield the whole records that are there now, of about `most` bytes; none only if there is none.

        `final`: no process writes any more, so what is half a record at the end will not become a whole one.
        """
        taken = given = 0
        # What a consumer left that stopped in the midst stands here still.
        for record in self._split():
            given += 1
            yield record
        while taken < most or not given:
            if self._file is None and not self._open():
                return
            assert self._file is not None
            size = max(HEAD.size, min(1 << 18, most - taken))
            data = self._file.read(size)
            if not data and self._stored_again():
                data = self._file.read(size)
            over = False
            # Only when a younger segment exists is nothing more to come in this one; look once more after seeing it.
            if not data and (final or self._has_next()):
                data = self._file.read(size)
                over = not data
            taken += len(data)
            self._rest += data
            for record in self._split(over=over):
                given += 1
                yield record
            if not data and not (over and self._advance()):
                return

    def _split(self, *, over: bool = False) -> Iterator[Record]:
        """Yield the whole records of what was read; `over`: nothing follows in this segment."""
        rest, at, limit = self._rest, 0, len(self._rest)
        try:
            while at + HEAD.size <= limit or (over and at < limit):
                stop = at
                if at + HEAD.size <= limit:
                    magic, kind, length, t_ns, before, check = HEAD.unpack_from(rest, at)
                    if magic == MAGIC and length <= DATA_LIMIT:
                        stop = at + HEAD.size + length
                if stop > limit and not over:
                    break
                if at < stop <= limit and kind in _KINDS and t_ns < NEVER_NS:
                    data = rest[at + HEAD.size : stop]
                    if zlib.crc32(data, zlib.crc32(rest[at : at + _CHECKED.size])) == check:
                        self._place += stop - at
                        at = stop
                        yield Record(kind, t_ns, before, data, self._segment, self._place)
                        continue
                found = rest.find(MAGIC, at + 1)
                skip = (found if found >= 0 else limit) - at
                self.damaged += skip
                self._place += skip
                at += skip
        finally:
            self._rest = rest[at:]

    def _open(self) -> bool:
        known = segments(self._folder, self._stem)
        path = next((p for n, p in known if n == self._segment), None)
        if path is None:
            later = [(n, p) for n, p in known if n > self._segment]
            if not later:
                return False
            self._segment, path = later[0]
            self._place = 0
        try:
            self._file = open(path, "rb", buffering=0)  # noqa: SIM115
        except FileNotFoundError:
            # Its folder was deleted this moment.
            return False
        self._file.seek(self._place)
        self._rest = b""
        return True

    def _stored_again(self) -> bool:
        """Reopen the segment if its file was deleted and written anew."""
        assert self._file is not None
        if os.fstat(self._file.fileno()).st_nlink:
            return False
        path = next((path for number, path in segments(self._folder, self._stem) if number == self._segment), None)
        if path is None:
            return False
        self._file.close()
        self._file = open(path, "rb", buffering=0)  # noqa: SIM115
        self._file.seek(self._place + len(self._rest))
        return True

    def _has_next(self) -> bool:
        return any(n > self._segment for n, _ in segments(self._folder, self._stem))

    def _advance(self) -> bool:
        """Go over to the next segment; say whether there is one."""
        later = [n for n, _ in segments(self._folder, self._stem) if n > self._segment]
        if later:
            self.close()
            self._segment, self._place = later[0], 0
        return bool(later)

    def drop_before(self, segment: int) -> None:
        """Delete the segments before one: they are needed no more. One that cannot be deleted stays, and costs its room."""
        for number, path in segments(self._folder, self._stem):
            if number < segment:
                with contextlib.suppress(OSError):
                    path.unlink()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def last_record(folder: Path, stem: str) -> Record | None:
    """Return the last whole record of a spool, None of one that is empty: where a reader that is started again goes on."""
    for number, _ in reversed(segments(folder, stem)):
        reader = SpoolReader(folder, stem, (number, 0))
        last = None
        for record in reader.read(SEGMENT_SIZE + 2 * DATA_LIMIT, final=True):
            if record.segment != number:
                break
            last = record
        reader.close()
        if last is not None:
            return last
    return None


def spool_folder(log: Path) -> Path:
    """Return the folder of a log's spools: beside it, `<log>.spool`."""
    return log.with_name(log.name + ".spool")


def stems(folder: Path) -> list[str]:
    """Return the spools of a folder by their stems, in order of their numbers; other files are none."""
    found = {match["stem"] for name in os.listdir(folder) if (match := _SEGMENT_NAME.fullmatch(name))}
    return sorted(found, key=lambda stem: (int(stem.split("-", 1)[0]), stem))


def size_of(folder: Path) -> int:
    """Return how many bytes the spools of a folder have."""
    size = 0
    with os.scandir(folder) as entries:
        for entry in entries:
            # The consumer deletes them at any moment.
            with contextlib.suppress(FileNotFoundError):
                size += entry.stat().st_size if entry.name.endswith(".raw") else 0
    return size
