"""Reading a serial port through pyserial, where there is no Linux: macOS, Windows. It never writes.

Of the port that pyserial opens nothing is kept but the ways to read and to close. RTS and DTR are inactive from before it
is opened, as far as the driver honours that. A read returns what is there, or waits for a byte; it is stamped when it
returns, so the times are as good as the system wakes a waiting program: mostly within a few milliseconds (on Windows up to
16), and what the adapter holds back comes on top. These systems tell no counts of lost bytes.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any

from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import IDLE_NS, Lost, Opened, Stop, Ticks, Unopened
from analyzer.live.reader_store import Store
from analyzer.live.reader_stream import LAST_READS_NS, settle

#: The longest wait for a byte: how late the wish to end is noticed.
_WAIT_S = 0.02
_READ_SIZE = 1 << 16
_PRECISION = "read through pyserial, within some milliseconds; what the adapter holds back comes on top"
_UNCOUNTED = "this system does not tell how many bytes it had no room for: they would go unnoticed"


class PlainPort:
    """A serial port of pyserial."""

    unit = "bytes"

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._read: Any = None
        self._waiting: Any = None
        self._close: Any = None

    def open(self, stop: Stop) -> Opened:
        """Open the port."""
        import serial

        endpoint = self._endpoint
        port = serial.Serial()
        port.port = _find(endpoint.adapter) if endpoint.adapter else endpoint.place
        port.baudrate = endpoint.bits_per_second
        port.parity, port.stopbits, port.timeout = endpoint.parity, endpoint.stop_bits, _WAIT_S
        port.dtr = port.rts = False
        try:
            port.exclusive = True
        except ValueError:
            # Windows lets nobody else in anyway.
            port.exclusive = None
        try:
            port.open()
        except (OSError, ValueError) as error:
            raise Unopened(str(error)) from None
        self._read, self._close, self._waiting = port.read, port.close, lambda: port.in_waiting
        return Opened(_PRECISION, (_UNCOUNTED,))

    def adopt(self, fd: int) -> Opened:
        """Refuse: a port of pyserial is more than a descriptor."""
        raise Unopened("pyserial's ports cannot be handed over")

    def descriptor(self) -> int | None:
        """Return None."""
        return None

    def listen(self, store: Store, stop: Stop) -> None:
        """Store what comes. Raises Lost when reading fails."""
        byte_ns = self._endpoint.byte_ns
        quiet_since_ns = time.monotonic_ns()
        ticks = Ticks()
        asked_ns: int | None = None
        while True:
            # Asked before the last read, so that what had come before the wish is taken.
            seen_ns = time.monotonic_ns()
            if stop.asked and asked_ns is None:
                asked_ns = seen_ns
            try:
                data: bytes = self._read(min(max(1, self._waiting()), _READ_SIZE))
                rest: bytes = self._read(min(self._waiting(), _READ_SIZE)) if data else b""
            # A port that is unplugged raises whatever comes to the system's mind.
            except Exception as error:
                raise Lost(str(error) or type(error).__name__) from None
            data += rest
            if data:
                quiet_since_ns = time.monotonic_ns()
                for t_ns, part in settle([(quiet_since_ns, data)], byte_ns, store.last_ns, after_idle=store.idle):
                    store.chunk(t_ns, part)
                store.flush()
            elif not store.idle and seen_ns - quiet_since_ns >= IDLE_NS + 2 * byte_ns:
                store.quiet(seen_ns)
            if ticks.due(seen_ns):
                store.tick()
            # A busy line never falls silent.
            if asked_ns is not None and (not data or seen_ns - asked_ns > LAST_READS_NS):
                return

    def close(self) -> None:
        """Close the port."""
        close, self._close, self._read, self._waiting = self._close, None, None, None
        if close is not None:
            # An adapter that is gone cannot be asked to close.
            with contextlib.suppress(OSError):
                close()


def _find(number: str) -> str:
    from analyzer.live.reader_serial import find_adapter

    return find_adapter(number)
