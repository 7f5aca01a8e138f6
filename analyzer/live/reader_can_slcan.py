"""Listening to an slcan adapter (CANable, Lawicel, USBtin): opened by python-can, read here.

    t 123 2 0A0B CR      T 00000123 2 0A0B CR      r 123 0 CR      R ...      d, D, b, B: CAN FD

python-can tells the adapter its bit rate and to listen only, then takes a hundred microseconds for a frame, byte by byte: too
long for a full bus. So what the adapter says is read from its descriptor in one piece. Nothing is said to the adapter from
here. The frames of one read bear its time.
"""

from __future__ import annotations

import os
import re
import time

from analyzer.live.reader_can_library import CanLibraryPort
from analyzer.live.reader_port import BadCount, Lost, Stop, listen, readable
from analyzer.live.reader_store import Store
from analyzer.live.spool import CanFlag
from analyzer.values import CAN_ID_LIMIT, CAN_ID_MASK, FD_LENGTHS

_READ_SIZE = 1 << 16
#: The longest line: an extended FD frame with 64 bytes and a time.
_LINE_LIMIT = 160
#: How long an adapter may take to answer what it was told at its opening.
_SETTINGS_NS = 1_000_000_000
_REFUSED = "the adapter answered a setting with an error: it may not know the bit rate, or how to listen only"
#: First letter of a frame -> digits of its identifier, flags, whether its length is a code of CAN FD, whether data follow.
_FRAMES: dict[int, tuple[int, int, bool, bool]] = {
    ord("t"): (3, 0, False, True),
    ord("T"): (8, CanFlag.EXTENDED, False, True),
    # The letter of a CANDapter for the same.
    ord("x"): (8, CanFlag.EXTENDED, False, True),
    ord("r"): (3, CanFlag.REMOTE, False, False),
    ord("R"): (8, CanFlag.EXTENDED | CanFlag.REMOTE, False, False),
    ord("d"): (3, CanFlag.FD, True, True),
    ord("D"): (8, CanFlag.FD | CanFlag.EXTENDED, True, True),
    ord("b"): (3, CanFlag.FD, True, True),
    ord("B"): (8, CanFlag.FD | CanFlag.EXTENDED, True, True),
}
#: Python's numbers can have a sign, blanks and underlines, too.
_DIGITS = re.compile(rb"[0-9A-Fa-f]*")
#: Lines that are answers: z and Z to a frame sent, a version, a serial number, flags; and nothing at all.
_ANSWERS = frozenset(b"zZvVNF")


def dissect_line(line: bytes) -> tuple[int, int, bytes] | None:
    """Return identifier, flags and payload of a line without its end; None for an answer that is no frame.

    Raises ValueError for what is neither.
    """
    if not line or line[0] in _ANSWERS:
        return None
    digits, flags, coded, has_data = _FRAMES.get(line[0], (0, 0, False, False))
    if not digits or len(line) < digits + 2 or not _DIGITS.fullmatch(line, 1, digits + 2):
        raise ValueError(f"{line[:20]!r} is no frame")
    can_id = int(line[1 : digits + 1], 16)
    if can_id > (CAN_ID_MASK if flags & CanFlag.EXTENDED else CAN_ID_LIMIT):
        raise ValueError(f"{line[:20]!r} has an identifier of too many bits")
    length = int(line[digits + 1 : digits + 2], 16)
    if coded:
        length = FD_LENGTHS[length]
    elif length > 8:
        raise ValueError(f"{line[:20]!r} says a length of {length}")
    if not has_data:
        return can_id, flags, b""
    text = line[digits + 2 : digits + 2 + 2 * length]
    if len(text) != 2 * length or not _DIGITS.fullmatch(text):
        raise ValueError(f"{line[:20]!r} breaks off")
    return can_id, flags, bytes.fromhex(text.decode("ascii"))


class SlcanPort(CanLibraryPort):
    """An slcan adapter that python-can has opened."""

    def listen(self, store: Store, stop: Stop) -> None:
        fd = int(self._number())
        wait = readable(fd, stop)
        bad = BadCount("lines of the adapter that are not frames")
        self._rest = b""
        self._settings_until_ns = time.monotonic_ns() + _SETTINGS_NS

        def take(ready: bool) -> int:
            if not ready:
                return 0
            bad.count += self._take_lines(fd, store)
            return time.monotonic_ns()

        listen(store, stop, take, wait=wait, tick=lambda now_ns: bad.tell(store, now_ns))
        if wait(0):
            self._take_lines(fd, store)
        store.flush()

    def _take_lines(self, fd: int, store: Store) -> int:
        """Store the frames that are there; return how many lines were none."""
        try:
            data = os.read(fd, _READ_SIZE)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise Lost(error.strerror or str(error)) from None
        t_ns = time.monotonic_ns()
        if not data:
            raise Lost("the adapter disconnected (unplugged?)")
        # A bell is the answer to what the adapter did not understand, and ends a line as well.
        if b"\a" in data and t_ns < self._settings_until_ns:
            self._settings_until_ns = 0
            store.event("note", text=_REFUSED)
        *lines, rest = (self._rest + data).replace(b"\a", b"\r").split(b"\r")
        self._rest = rest[-_LINE_LIMIT:]
        bad = 0
        for line in lines:
            try:
                found = dissect_line(line)
            except ValueError:
                bad += 1
                continue
            if found is not None:
                store.can(t_ns, *found)
        return bad
