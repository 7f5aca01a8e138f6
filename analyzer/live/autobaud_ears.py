"""Listening to a serial port at one rate after the other, for `autobaud`. It only reads.

On Linux the port is opened once, read-only, and set to each rate; elsewhere pyserial opens it anew for each.
"""

from __future__ import annotations

import os
import select
import sys
import threading
import time
from collections.abc import Callable, Sequence

from analyzer.errors import UsageError
from analyzer.live.autobaud import Ear
from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import Lost, Stop, Unopened
from analyzer.live.reader_store import Store
from analyzer.live.spool import SpoolWriter
from analyzer.records import Chunk

_PORT = "line"
Enough = Callable[[Sequence[Chunk]], bool]


def ear_of(endpoint: Endpoint, first_rate: int, *, plain: bool = False) -> Ear:
    """Return what listens to a serial endpoint. `plain`: as where there is no Linux.

    Raises UsageError where the port cannot be opened.
    """
    if plain or sys.platform != "linux":
        return PlainEar(endpoint)
    return LinuxEar(endpoint, first_rate)


class LinuxEar:
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
        """Return what came at a rate."""
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
            raise UsageError(f"{self._endpoint}: the port hung up while listening (unplugged?)")
        return data

    def close(self) -> None:
        """Give the port back."""
        self._port.close()


class PlainEar:
    """Listens through pyserial, which opens the port anew for each rate."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint

    def listen(self, rate: int, seconds: float, enough: Enough) -> Sequence[Chunk]:
        """Return what came at a rate."""
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
        """Take bytes."""
        super().chunk(t_ns, data)
        self.chunks.append(Chunk(t_ns, _PORT, data))
        if not self._stop.asked and self._enough(self.chunks):
            self._stop.ask("enough was heard")
