"""Reading a serial port through pyserial, where there is no Linux: macOS, Windows. It never writes.

Of the port that pyserial opens nothing is kept but the ways to read and to close. RTS and DTR are inactive from before it
is opened, as far as the driver honours that. A read returns what is there, or waits for a byte; it is stamped when it
returns, so the times are as good as the system wakes a waiting program: mostly within a few milliseconds (on Windows up to
16), and plus the delay of the adapter. These systems tell no counts of lost bytes.
"""

from __future__ import annotations

import time
from typing import Any

from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import IDLE_NS, LibraryPort, Lost, Opened, Stop, Unopened, find_adapter, listen
from analyzer.live.reader_store import Store
from analyzer.live.reader_stream import LAST_READS_NS, settle
from analyzer.plugins import close_bounded

#: The longest wait for a byte: how late the wish to end is noticed.
_WAIT_S = 0.02
_READ_SIZE = 1 << 16
_PRECISION = "read through pyserial, within some milliseconds; plus the delay of the adapter"
_UNCOUNTED = "this system does not count lost bytes: they would go unnoticed"


class PlainPort(LibraryPort):
    """A serial port of pyserial."""

    unit = "bytes"
    library = "pyserial"

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._read: Any = None
        self._waiting: Any = None
        self._close: Any = None

    def open(self, stop: Stop) -> Opened:
        import serial

        endpoint = self._endpoint
        port = serial.Serial()
        port.port = find_adapter(endpoint.adapter) if endpoint.adapter else endpoint.place
        port.baudrate = endpoint.bits_per_second
        port.parity, port.stopbits, port.timeout = endpoint.parity, endpoint.stop_bits, _WAIT_S
        port.dtr = port.rts = False
        try:
            port.exclusive = True
        except ValueError:
            # Windows opens a port exclusively anyway.
            port.exclusive = None
        try:
            port.open()
        except (OSError, ValueError) as error:
            raise Unopened(str(error)) from None
        self._read, self._close, self._waiting = port.read, port.close, lambda: port.in_waiting
        return Opened(_PRECISION, (_UNCOUNTED,))

    def listen(self, store: Store, stop: Stop) -> None:
        byte_ns = self._endpoint.byte_ns
        listen(store, stop, lambda ready: self._take(store), idle_ns=IDLE_NS + 2 * byte_ns)
        # What had come before the end; a busy line never falls silent.
        until_ns = time.monotonic_ns() + LAST_READS_NS
        while self._take(store) and time.monotonic_ns() < until_ns:
            pass

    def _take(self, store: Store) -> int:
        """Store what is there, or comes within `_WAIT_S`; return when it was read, 0 for nothing."""
        try:
            data: bytes = self._read(min(max(1, self._waiting()), _READ_SIZE))
            data += self._read(min(self._waiting(), _READ_SIZE)) if data else b""
        # Each system raises its own errors where a port is unplugged.
        except Exception as error:
            raise Lost(str(error) or type(error).__name__) from None
        if not data:
            return 0
        t_ns = time.monotonic_ns()
        for at_ns, part in settle([(t_ns, data)], self._endpoint.byte_ns, store.last_ns, after_idle=store.idle):
            store.chunk(at_ns, part)
        store.flush()
        return t_ns

    def close(self) -> None:
        close, self._close, self._read, self._waiting = self._close, None, None, None
        if close is not None:
            close_bounded(self._endpoint.place, close)
