"""The spool: what a reader process stores and the decoding process takes, in files that outlive both.

    <log>.spool/<number>-<bus>[-<direction>].<segment>.raw

    record:  magic 0x5A | kind u8 | length u32 | t_ns u64 | before u64 | data      (little endian)

One reader writes one spool, whole records only, so a killed reader leaves whole ones but perhaps the last; one consumer
follows it. A segment is closed when it has grown to `SEGMENT_SIZE`; a consumer deletes the segments that it needs no more,
but never the last one: a reader that is started again counts on from there. Times are `CLOCK_MONOTONIC` nanoseconds and
never go back within a spool. `before`: bytes (serial) or frames (CAN) of the port before this record, with those that had
to be dropped, so that what is missing can be counted.

Kinds: DATA (bytes of a serial line, t_ns: arrival of the last one), CAN (one frame: id u32, flags u8, payload), EVENT
(JSON object with "event": what happened), IDLE (nothing came up to t_ns: the bytes of later records came after it, and the
pause before them is longer than the framer's silence, also as the framer reckons it from the stored times alone).

Events of a port, with what they hold:

    open      notes [text], precision text      the port was taken up; notes: what cannot be guaranteed
    note      text                              something that became known later; with `kept`, from_ns, gap_ns: another
                                                reader has taken over from one that died, and nothing is missing
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

import os
import struct
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import IO, Any, NamedTuple

import msgspec

MAGIC = 0x5A
HEAD = struct.Struct("<BBIQQ")
#: Bytes after which a reader begins a new segment.
SEGMENT_SIZE = 4 << 20
#: The longest data of a record.
DATA_LIMIT = 1 << 20
_CAN_HEAD = struct.Struct("<IB")


class RecordKind(IntEnum):
    """What a record is."""

    DATA = 1
    CAN = 2
    EVENT = 3
    IDLE = 4


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
        """The object of an EVENT."""
        decoded: dict[str, Any] = msgspec.json.decode(self.data)
        return decoded

    @property
    def units(self) -> int:
        """How far this record moves `before` on: its bytes, or one frame."""
        return len(self.data) if self.kind == RecordKind.DATA else int(self.kind == RecordKind.CAN)

    @property
    def can(self) -> tuple[int, int, bytes]:
        """Identifier, flags and payload of a CAN record."""
        can_id, flags = _CAN_HEAD.unpack_from(self.data)
        return can_id, flags, self.data[_CAN_HEAD.size :]


def pack(kind: int, t_ns: int, before: int, data: bytes) -> bytes:
    """Return a record as bytes."""
    return HEAD.pack(MAGIC, kind, len(data), t_ns, before) + data


def pack_can(t_ns: int, before: int, can_id: int, flags: int, payload: bytes) -> bytes:
    """Return a CAN record as bytes."""
    return (
        HEAD.pack(MAGIC, RecordKind.CAN, _CAN_HEAD.size + len(payload), t_ns, before) + _CAN_HEAD.pack(can_id, flags) + payload
    )


def pack_event(t_ns: int, before: int, event: str, **about: Any) -> bytes:
    """Return an EVENT record as bytes."""
    return pack(RecordKind.EVENT, t_ns, before, msgspec.json.encode({"event": event, **about}))


class SpoolWriter:
    """Writes one port's records. `folder` exists; `stem` is `<number>-<bus>`. Raises OSError when a write fails."""

    def __init__(self, folder: Path, stem: str, *, segment_size: int = SEGMENT_SIZE) -> None:
        self._folder = folder
        self._stem = stem
        self._segment_size = segment_size
        # A reader that is started again goes on behind what its forerunner left.
        self._segment = max((s for s, _ in segments(folder, stem)), default=-1)
        self._file: IO[bytes] | None = None
        self._size = 0

    def write(self, record: bytes) -> None:
        """Store one record (or several whole ones), whole or not at all.

        Raises OSError with nothing stored, as on a full disk; it may be tried again.
        """
        file = self._file
        if file is None or self._size >= self._segment_size:
            file = self._next()
        at = self._size
        rest = memoryview(record)
        try:
            while rest:
                # A part is what there was room for; why not for more says the next attempt.
                rest = rest[file.write(rest) or 0 :]
        except OSError:
            # Half a record would hide all that follows it.
            file.truncate(at)
            file.seek(at)
            raise
        self._size = at + len(record)

    def _next(self) -> IO[bytes]:
        file = open(self._folder / f"{self._stem}.{self._segment + 1:06d}.raw", "xb", buffering=0)  # noqa: SIM115
        if self._file is not None:
            self._file.close()
        self._segment += 1
        self._file, self._size = file, 0
        return file

    def close(self) -> None:
        """Close the segment."""
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

    def read(self, most: int = 1 << 20) -> Iterator[Record]:
        """Yield the whole records that are there now, of about `most` bytes; none only if there is none."""
        taken = given = 0
        # What a consumer left that stopped in the midst stands here still.
        for record in self._split():
            given += 1
            yield record
        while taken < most or not given:
            data = self._more(max(HEAD.size, min(1 << 18, most - taken)))
            if not data:
                return
            taken += len(data)
            self._rest += data
            for record in self._split():
                given += 1
                yield record

    def _more(self, size: int) -> bytes:
        """Return further bytes, of the next segment where this one has no more; nothing if there are none."""
        while True:
            if self._file is None and not self._open():
                return b""
            assert self._file is not None
            data = self._file.read(size)
            # Only when a younger segment exists is nothing more to come in this one; look once more after seeing it.
            if not data and self._has_next():
                data = self._file.read(size)
                if not data:
                    self.damaged += len(self._rest)
                    self._advance()
                    continue
            return data

    def _split(self) -> Iterator[Record]:
        rest, at, limit = self._rest, 0, len(self._rest)
        try:
            while at + HEAD.size <= limit:
                magic, kind, length, t_ns, before = HEAD.unpack_from(rest, at)
                if magic != MAGIC or length > DATA_LIMIT:
                    found = rest.find(MAGIC, at + 1)
                    skip = (found if found >= 0 else limit) - at
                    self.damaged += skip
                    at += skip
                    self._place += skip
                    continue
                stop = at + HEAD.size + length
                if stop > limit:
                    break
                self._place += stop - at
                data = rest[at + HEAD.size : stop]
                at = stop
                yield Record(kind, t_ns, before, data, self._segment, self._place)
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
        self._file = open(path, "rb", buffering=0)  # noqa: SIM115
        self._file.seek(self._place)
        self._rest = b""
        return True

    def _has_next(self) -> bool:
        return any(n > self._segment for n, _ in segments(self._folder, self._stem))

    def _advance(self) -> None:
        assert self._file is not None
        self._file.close()
        self._file = None
        later = [n for n, _ in segments(self._folder, self._stem) if n > self._segment]
        self._segment, self._place = later[0], 0
        self._rest = b""

    def drop_before(self, segment: int) -> None:
        """Delete the segments before one: they are needed no more."""
        for number, path in segments(self._folder, self._stem):
            if number < segment:
                path.unlink(missing_ok=True)

    def close(self) -> None:
        """Close the segment."""
        if self._file is not None:
            self._file.close()
            self._file = None


def last_record(folder: Path, stem: str) -> Record | None:
    """Return the last whole record of a spool, None of one that is empty: where a reader that is started again goes on."""
    for number, _ in reversed(segments(folder, stem)):
        reader = SpoolReader(folder, stem, (number, 0))
        last = None
        for record in reader.read(SEGMENT_SIZE + 2 * DATA_LIMIT):
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
    """Return the spools of a folder by their stems, in order of their numbers."""
    found = {name.rsplit(".", 2)[0] for name in os.listdir(folder) if name.endswith(".raw")}
    return sorted(found, key=lambda stem: (int(stem.split("-", 1)[0]), stem))
