"""Finding the rate of a serial port: it is listened to at one rate after the other. It only reads.

On Linux the port is opened once, read-only, and set to each rate; elsewhere pyserial opens it anew for each.
"""

from __future__ import annotations

import os
import select
import sys
import threading
import time
from collections.abc import Callable, Sequence

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from analyzer.live.autobaud import Found, Listener, rates, search
from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import Lost, Stop, Unopened
from analyzer.live.reader_store import Store
from analyzer.live.spool import SpoolWriter
from analyzer.records import Chunk
from analyzer.values import quote

_PORT = "line"
Enough = Callable[[Sequence[Chunk]], bool]


def find(
    endpoint: Endpoint,
    *,
    seconds: float = 3.0,
    say: Callable[[str], None] = lambda text: None,
    candidates: Sequence[Dialect] | None = None,
) -> Found:
    """Return the rate that was found for a serial endpoint, with the dialects and the evidence.

    `candidates`: the dialects that may be spoken, all serial ones if None. Raises UsageError where no rate is clear, or where
    the port cannot be opened.
    """
    if endpoint.kind != "serial":
        raise UsageError(f"{quote(str(endpoint))}: baud=auto is for serial ports, which can be set to a rate")
    fitting = [d for d in (candidates if candidates is not None else registry.every()) if d.bus == "serial" and d.baud_rates]
    if not fitting:
        raise UsageError("baud=auto: expected a dialect of serial lines, got none")
    listener = listener_for(endpoint, rates(fitting)[0])
    try:
        return search(endpoint, listener, fitting, seconds=seconds, say=say)
    finally:
        listener.close()


def listener_for(endpoint: Endpoint, first_rate: int, *, plain: bool = False) -> Listener:
    """Return what listens to a serial endpoint. `plain`: as where there is no Linux.

    Raises UsageError where the port cannot be opened.
    """
    if plain or sys.platform != "linux":
        return PyserialListener(endpoint)
    return LinuxListener(endpoint, first_rate)


class LinuxListener:
    """Listens to a port that is opened once. Raises UsageError where it cannot be opened, or is lost."""

    def __init__(self, endpoint: Endpoint, first_rate: int) -> None:
        from analyzer.live.reader_serial import SerialPort

        self._endpoint = endpoint
        self._port = SerialPort(endpoint.at(first_rate))
        try:
            self._port.open(Stop())
        except Unopened as error:
            raise UsageError(f"{endpoint}: {error}") from None

    def listen(self, rate: int, seconds: float, enough: Enough) -> Sequence[Chunk]:
        import termios

        from analyzer.live.reader_serial import set_raw

        fd = self._port.descriptor()
        assert fd is not None  # it was opened
        try:
            set_raw(fd, rate, self._endpoint.parity, self._endpoint.stop_bits)
        except OSError:
            # An adapter without this rate cannot hear it.
            return []
        # What the rate before has garbled.
        termios.tcflush(fd, termios.TCIFLUSH)
        chunks: list[Chunk] = []
        until = time.monotonic() + seconds
        waiting = select.poll()
        waiting.register(fd, select.POLLIN)
        while (left := until - time.monotonic()) > 0 and waiting.poll(left * 1000):
            data = self._read(fd)
            if data:
                chunks.append(Chunk(time.monotonic_ns(), _PORT, data))
                if enough(chunks):
                    break
        return chunks

    def _read(self, fd: int) -> bytes:
        try:
            data = os.read(fd, 1 << 16)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise UsageError(f"{self._endpoint}: the port was lost while listening: {error.strerror}") from None
        if not data:
            raise UsageError(f"{self._endpoint}: the port disconnected while listening (unplugged?)")
        return data

    def close(self) -> None:
        self._port.close()


class PyserialListener:
    """Listens through pyserial, which opens the port anew for each rate."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint

    def listen(self, rate: int, seconds: float, enough: Enough) -> Sequence[Chunk]:
        from analyzer.live.reader_pyserial import PlainPort

        port = PlainPort(self._endpoint.at(rate))
        stop = Stop()
        collected = _Collected(stop, enough)
        over = threading.Timer(seconds, stop.ask, ("the time is over",))
        try:
            port.open(stop)
            over.start()
            port.listen(collected, stop)
        except (Unopened, Lost) as error:
            raise UsageError(f"{self._endpoint}: {error}") from None
        finally:
            over.cancel()
            port.close()
        return collected.chunks

    def close(self) -> None:
        """Give back nothing: no port stays open."""


class _Nowhere(SpoolWriter):
    """Takes records and stores none."""

    def __init__(self) -> None:
        pass

    def write(self, record: bytes) -> None:
        """Store nothing."""

    def close(self) -> None:
        """Close nothing."""


class _Collected(Store):
    """Keeps what a port brings, until it is enough."""

    def __init__(self, stop: Stop, enough: Enough) -> None:
        super().__init__(_Nowhere(), lambda t_ns, event, about: None)
        self._stop = stop
        self._enough = enough
        self.chunks: list[Chunk] = []

    def chunk(self, t_ns: int, data: bytes) -> None:
        super().chunk(t_ns, data)
        self.chunks.append(Chunk(t_ns, _PORT, data))
        if not self._stop.asked and self._enough(self.chunks):
            self._stop.ask("enough was heard")
