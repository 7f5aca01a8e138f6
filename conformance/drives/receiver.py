"""The receiver of a drive: it finds frames in the bytes on the line.

Unlike the analyzer's framer it does not look ahead: a drive acts when the last byte of a frame has arrived.
Bytes and times in, frames out; no I/O, no clock.

Rules:

1. Every frame on the line is read: requests to other drives, replies of other drives, the FC package. Each is skipped as
   a whole, so that start bytes inside it are data.
2. A frame is passed on at the time of its last byte.
3. A known frame whose check does not fit is passed on with `checksum_ok` False, unless a frame begins inside it: then
   that one counts. Where one may still be arriving, the pause decides.
   A Modbus write of several registers with a wrong byte count has the length of that count.
4. A byte that begins no frame is skipped. Where two lengths check, one byte apart, the longer one counts.
5. A pause ends every wait: an incomplete frame is dropped, and the bytes after its first are searched again. Under Modbus
   it is 3.5 characters (1.75 ms above 19200 baud), elsewhere `PAUSE_NS`, the silence that no adapter puts inside a frame.
6. A frame of unknown code is passed on at the pause: its head and check fit, and it fills the time between two pauses or
   frames.

Every frame is passed on as a request unless its head says otherwise: a drive does not know who sent it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from analyzer.catalogue import Dialect, Role
from analyzer.framer import SILENCE_NS
from analyzer.link import MORE, TIE, WRITE_MANY, ModbusLink, modbus_crc
from analyzer.records import Frame

#: The pause that ends a frame of a dialect without a silence of its own.
PAUSE_NS = SILENCE_NS
#: A Modbus write of several registers: bytes before its data, the most registers, how far off a byte count may be.
_MANY_HEAD, _MOST_WRITTEN, _BESIDE = 7, 123, 8
#: Bytes that begin no frame and are kept until the pause.
_KEPT = 512


class Receiver:
    """Finds the frames of one dialect in the bytes that a drive receives.

    `byte_ns`: the time of a byte at the drive's own speed.
    """

    def __init__(self, dialect: Dialect, port: str = "bus", *, byte_ns: int) -> None:
        self.dialect = dialect
        self.port = port
        self.byte_ns = byte_ns
        self.pause_ns = dialect.link.silence_ns(byte_ns) or PAUSE_NS
        self._slicer = dialect.link.slicer(dialect.commands, _expect_nothing)
        self._buffer = b""  # received since the last frame or pause
        self._times: list[int] = []  # when each byte of the buffer was complete
        self._at = 0  # what is before it begins no frame
        self._cut = False  # bytes were dropped from the buffer's beginning
        self._offset = 0  # bytes received before the buffer
        self._last_ns = 0

    def next_ns(self) -> int | None:
        """Return when a pause will end the wait for more bytes, or None while there is none."""
        return self._last_ns + self.byte_ns + self.pause_ns if self._buffer else None

    def feed(self, data: bytes, first_ns: int, step_ns: int) -> list[Frame]:
        """Take bytes, the first complete at `first_ns`, each other one `step_ns` later; return the frames they end."""
        frames: list[Frame] = []
        deadline = self.next_ns()
        if deadline is not None and first_ns > deadline:
            frames = self.expire(deadline)
        size = len(data)
        self._last_ns = first_ns + (size - 1) * step_ns
        if not self._buffer and self._slicer.look(data, 0, size, False) == size:
            frames.append(self._frame(data, first_ns, self._last_ns, True))
            self._offset += size
            return frames
        self._buffer += data
        self._times.extend(range(first_ns, self._last_ns + 1, step_ns) if step_ns else [first_ns] * size)
        self._scan(frames, False)
        return frames

    def expire(self, t_ns: int) -> list[Frame]:
        """Say that nothing was received until `t_ns`; return the frames that this pause ends."""
        deadline = self.next_ns()
        frames: list[Frame] = []
        if deadline is None or t_ns < deadline:
            return frames
        buffer = self._buffer
        if not self._cut and not self._slicer.look(buffer, 0, len(buffer), True) and self._slicer.whole(buffer):
            self._take(frames, 0, len(buffer), True, deadline)
        else:
            self._scan(frames, True, deadline)
        self.reset()
        return frames

    def reset(self) -> None:
        self._offset += len(self._buffer)
        self._buffer = b""
        self._times = []
        self._at = 0
        self._cut = False

    # --- where frames are -----------------------------------------------------------------------------------------

    def _scan(self, frames: list[Frame], closed: bool, ended_ns: int | None = None) -> None:
        slicer = self._slicer
        while self._at < len(self._buffer):
            at, buffer, end = self._at, self._buffer, len(self._buffer)
            length = slicer.look(buffer, at, end, closed)
            if length == TIE:
                length = slicer.lengths(buffer, at, end)[1]
            if length > 0:
                self._take(frames, at, length, True, ended_ns)
                continue
            if length == 0 and not at and not self._cut and isinstance(self.dialect.link, ModbusLink):
                length = _counted(buffer, closed)
            if length > 0:
                self._take(frames, at, length, True, ended_ns)
                continue
            if length == MORE:
                return
            damaged = self._damaged(at, closed)
            if damaged == MORE:
                return
            if damaged:
                self._take(frames, at, damaged, False, ended_ns)
                continue
            self._at += 1
            if self._at > _KEPT:
                self._drop(self._at)
                self._cut = True

    def _damaged(self, at: int, closed: bool) -> int:
        """Return the length of a known frame at `at` whose check does not fit, 0 for none, MORE if that is open."""
        slicer, buffer, end = self._slicer, self._buffer, len(self._buffer)
        if not slicer.strong_head and (at or self._cut):
            return 0
        length = max((n for n in slicer.damaged(buffer, at, end) if n != MORE), default=0)
        for start in range(at + 1, at + length):
            inner = slicer.look(buffer, start, end, closed)
            if inner:
                return MORE if inner == MORE else 0
        return length

    def _take(self, frames: list[Frame], at: int, length: int, good: bool, ended_ns: int | None) -> None:
        stop = at + length
        last_ns = self._times[stop - 1] if ended_ns is None else ended_ns
        first_ns = self._times[at]
        self._drop(at)
        frames.append(self._frame(self._buffer[:length], first_ns, last_ns, good))
        self._drop(length)
        self._cut = False

    def _drop(self, count: int) -> None:
        self._buffer = self._buffer[count:]
        del self._times[:count]
        self._offset += count
        self._at = 0

    def _frame(self, data: bytes, first_ns: int, last_ns: int, good: bool) -> Frame:
        start_ns = first_ns - self.byte_ns
        return Frame(self.port, start_ns, last_ns, self._offset, data, self.dialect, Role.REQUEST, good)


class MultiReceiver:
    """A receiver that also passes on the good frames of other dialects."""

    def __init__(self, dialect: Dialect, port: str = "bus", *, byte_ns: int, others: Sequence[Dialect]) -> None:
        self.dialect = dialect
        self.byte_ns = byte_ns
        self._own = Receiver(dialect, port, byte_ns=byte_ns)
        self._others = [Receiver(other, port, byte_ns=byte_ns) for other in others if other is not dialect]

    def next_ns(self) -> int | None:
        """Return when the first pause will end a wait."""
        times = [receiver.next_ns() for receiver in (self._own, *self._others)]
        return min((t for t in times if t is not None), default=None)

    def feed(self, data: bytes, first_ns: int, step_ns: int) -> list[Frame]:
        """Take bytes; return the frames they end, of all dialects."""
        return _merged(self._own.feed(data, first_ns, step_ns), (o.feed(data, first_ns, step_ns) for o in self._others))

    def expire(self, t_ns: int) -> list[Frame]:
        """Say that nothing was received until `t_ns`; return the frames that this pause ends."""
        return _merged(self._own.expire(t_ns), (other.expire(t_ns) for other in self._others))

    def reset(self) -> None:
        for receiver in (self._own, *self._others):
            receiver.reset()


def _merged(own: list[Frame], others: Iterable[list[Frame]]) -> list[Frame]:
    good = [frame for frames in others for frame in frames if frame.checksum_ok]
    return sorted([*own, *good], key=lambda frame: frame.last_ns) if good else own


def _counted(buffer: bytes, closed: bool) -> int:
    """Return the length of a Modbus write of several registers by its own byte count, where that is not its registers'.

    0: it is none, or its CRC does not fit; `MORE`: it may still be arriving. A drive answers it by an exception.
    """
    if len(buffer) < _MANY_HEAD:
        return 0
    quantity, count = int.from_bytes(buffer[4:6], "big"), buffer[6]
    if buffer[1] not in WRITE_MANY or not 0 < quantity <= _MOST_WRITTEN or count > 2 * quantity + _BESIDE:
        return 0
    length = _MANY_HEAD + count + 2
    if len(buffer) < length:
        return 0 if closed else MORE
    return length if modbus_crc(buffer[:length]) == 0 else 0


def _expect_nothing(address: int, function: int) -> int:
    return 0
