"""The log of a bus that this program serves or talks on: all traffic, through the analyzer's pipeline, into an MCAP file.

While it is written, the file is complete up to the last second; `finish` completes it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

from msgspec.structs import replace

from analyzer.catalogue import Dialect
from analyzer.cli.output import write_whole
from analyzer.errors import UsageError
from analyzer.framer import SILENCE_NS
from analyzer.live.clock import checked_utc
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.sinks.mcap_log import McapLog
from analyzer.sinks.summary import Summary
from analyzer.sources import magic
from conformance.drives.bus import Bus, Traffic
from conformance.drives.uart import BITS, SECOND_NS

_FLUSH_NS = SECOND_NS


class BusLog:
    """Writes what goes over a bus to a file. `speed`: bits per second. `anchor_ns`: UTC at the bus's time 0.

    Raises UsageError where the file cannot be written.
    """

    def __init__(
        self,
        name: str,
        path: str,
        dialects: Sequence[Dialect],
        *,
        speed: int,
        byte_ns: int,
        anchor_ns: int,
        force: bool = False,
        format: str = "emulated bus",
    ) -> None:
        self.path = Path(path)
        if self.path.exists() and not force:
            raise UsageError(f"{path} exists; --force replaces it")
        checked_utc(anchor_ns)
        # One that cannot be begun replaces none.
        write_whole(self.path, magic.MCAP, replace=force)
        try:
            self._stream: IO[bytes] = self.path.open("r+b")
        except OSError as error:
            raise UsageError(f"cannot write {path}: {error.strerror}") from None
        self._bus = name
        self._format = format
        self._dialects = tuple(dialects)
        self._anchor_ns = anchor_ns
        self._speed = speed
        serial = dialects[0].bus == "serial"
        self.summary = Summary()
        self._log = McapLog(self._stream, byte_ns=byte_ns, bit_ns=0 if serial else SECOND_NS // speed)
        self._pipeline = Pipeline(self._dialects, (self._log, self.summary), Options(byte_ns=byte_ns))
        self._heard_ns = 0
        self._flushed_ns = 0
        self._quiet = True
        self._broken = False

    @classmethod
    def of(cls, bus: Bus, path: str, dialects: Sequence[Dialect], *, anchor_ns: int, force: bool = False) -> BusLog:
        """Return the log of all that goes over an emulated bus from now on."""
        speed = bus.stations[0].speed
        byte_ns = BITS * SECOND_NS // speed if dialects[0].bus == "serial" and bus.wire_time else 0
        log = cls(bus.name, path, dialects, speed=speed, byte_ns=byte_ns, anchor_ns=anchor_ns, force=force)
        bus.watch(log.take)
        return log

    def take(self, traffic: Traffic) -> None:
        """Write a piece of traffic, with its time on the bus's clock."""
        t_ns = traffic.t_ns or 0
        self._heard_ns = t_ns
        self._quiet = False
        with self._writing():
            self._pipeline.feed(replace(traffic, t_ns=t_ns + self._anchor_ns))

    def tick(self, now_ns: int) -> None:
        """Write what there is to the file, once a second; end waits for more bytes when the line has been silent."""
        with self._writing():
            if not self._quiet and now_ns - self._heard_ns > SILENCE_NS:
                self._quiet = True
                self._pipeline.silence(self._bus)
            if now_ns - self._flushed_ns >= _FLUSH_NS:
                self._flushed_ns = now_ns
                self._log.flush()

    def finish(self, about: Mapping[str, str]) -> None:
        """Write what is left and the metadata, and close the file; it is whole after this."""
        if self._broken:
            return
        with self._writing():
            self._pipeline.close()
            speed = {"bit_rate" if self._dialects[0].bus == "can" else "baud": str(self._speed)}
            how = {"format": self._format, "time_source": "the bus, on a monotonic clock anchored to UTC at the start"}
            traffic = self.summary.about(self._dialects, self._pipeline.bytes_in)
            self._log.finish({**how, **traffic, **speed, **about})
            self._stream.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._broken = True
            self._log.abandon()
            raise UsageError(f"cannot write {self.path}: {error.strerror or error}") from None
