"""Logs of this program for python-can's own tools: reader and writer of `.mcap`, found by entry points.

    can_logger -i socketcan -c can0 -f bus.mcap          decoded like any other log; its options: --dialect=D --model=M
    can_player -i virtual -c 0 bus.mcap                  sends the CAN frames of a log again
    for message in can.LogReader("bus.mcap"): ...        can.Message with time, flags, channel

Rules of writing: while it is written, the file is complete up to the last second; a separate thread flushes it. After `stop`
it is finished. The check of each frame tells its CAN dialect, so there is no wait for detection.

Losses: python-can's times are floating-point seconds, good to about 0.2 us. A log has no place for the length of a remote
frame, nor for the flags BRS and ESI of CAN FD.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, cast

import can
from can.io.generic import BinaryIOMessageReader, BinaryIOMessageWriter

from analyzer import dialects
from analyzer.catalogue import Dialect, Role
from analyzer.errors import UsageError
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame
from analyzer.sinks.mcap_log import McapLog
from analyzer.sinks.summary import Summary
from analyzer.sources import open_source
from analyzer.sources.source import clean_port
from analyzer.values import SECOND_NS

FLUSH_S = 1.0


class McapWriter(BinaryIOMessageWriter):
    """Writes what python-can received to a log, decoded.

    `file`: a path or a stream open for binary writing. `dialect`: `auto`, or names of CAN dialects with commas. `model`: as
    for `servotap decode`. `bitrate`: bits per second, for the bus load, 0 unknown. What else python-can's tools pass on is
    not used. Raises ValueError for `append`, which no MCAP file allows, and UsageError for a wrong dialect or model.
    """

    def __init__(
        self, file: Any, append: bool = False, *, dialect: str = "auto", model: str = "", bitrate: int = 0, **rest: Any
    ) -> None:
        if append:
            raise ValueError("an MCAP log cannot be appended to; give another name (servotap merge makes one of several)")
        self._dialects = dialects.for_model(_chosen(dialect), model)
        super().__init__(file, mode="wb")
        self._lock = threading.Lock()
        self._about = {"model": model} if model else {}
        self._bitrate = int(bitrate)
        self._log = McapLog(cast(IO[bytes], self.file), bit_ns=SECOND_NS // self._bitrate if self._bitrate else 0)
        self._summary = Summary()
        self._pipeline = Pipeline(self._dialects, (self._log, self._summary), Options())
        self._ports: dict[Any, str] = {}
        self._failed: OSError | None = None
        self._stopped = threading.Event()
        self._flusher = threading.Thread(target=self._keep_flushing, name="servotap-flush", daemon=True)
        self._flusher.start()

    def on_message_received(self, msg: can.Message) -> None:
        """Take a message. Raises OSError when the file could not be written."""
        port = self._ports.get(msg.channel)
        if port is None:
            port = self._ports[msg.channel] = _port(msg.channel)
        frame = CanFrame(
            # A message made by hand has no time.
            _nanoseconds(msg.timestamp) if msg.timestamp else time.time_ns(),
            port,
            msg.arbitration_id,
            b"" if msg.is_remote_frame else bytes(msg.data),
            Role.UNKNOWN if msg.is_rx else Role.REQUEST,
            msg.is_extended_id and not msg.is_error_frame,
            msg.is_remote_frame,
            msg.is_error_frame,
            msg.is_fd,
        )
        with self._lock:
            if self._failed is not None:
                raise self._failed
            if not self._stopped.is_set():
                self._pipeline.feed(frame)

    def _keep_flushing(self) -> None:
        while not self._stopped.wait(FLUSH_S):
            with self._lock:
                if self._stopped.is_set():
                    return
                try:
                    self._log.flush()
                except OSError as error:
                    # The logging thread has to learn of it, and this thread has no caller.
                    self._failed = error
                    return

    def stop(self) -> None:
        """Write what is left and close the file; it is whole after this. Stopping twice is fine."""
        with self._lock:
            if self._stopped.is_set():
                return
            self._stopped.set()
            try:
                self._pipeline.close()
                self._log.finish(self._metadata())
            except BaseException:
                self._log.abandon()
                raise
            finally:
                with contextlib.suppress(OSError):
                    super().stop()
        if threading.current_thread() is not self._flusher:
            self._flusher.join()

    def _metadata(self) -> dict[str, str]:
        rate = {"bit_rate": str(self._bitrate)} if self._bitrate else {}
        time_source = "python-can: floating-point seconds of its interface, good to about 0.2 us"
        traffic = self._summary.about(self._dialects, self._pipeline.bytes_in)
        return {"format": "python-can", "time_source": time_source, **traffic, **rate, **self._about}


def _chosen(names: str) -> Sequence[Dialect]:
    if names == "auto":
        return [d for d in dialects.every() if d.bus == "can"]
    chosen = [dialects.get(name.strip()) for name in names.split(",")]
    for each in chosen:
        if each.bus != "can":
            raise UsageError(f"{each.name} is a dialect of serial lines, and python-can logs CAN")
    return chosen


def _port(channel: object) -> str:
    """Return the bus of a channel: its own name where it has one, can0 for the number 0."""
    if channel is None:
        return "can"
    if isinstance(channel, int):
        return f"can{channel}"
    return clean_port(str(channel)) or "can"


class McapReader(BinaryIOMessageReader):
    """Gives the CAN frames of a log as python-can's messages; skips serial buses.

    `file`: a path, or an open file that has one (as python-can opens `.mcap.gz`). Raises UnreadableError for a file
    that is not a log, ValueError for a stream without a name.
    """

    def __init__(self, file: Any, **rest: Any) -> None:
        path = file if isinstance(file, str | os.PathLike) else getattr(file, "name", None)
        if not isinstance(path, str | os.PathLike):
            raise ValueError("a log is read by its name: give a path, or a file that has one")
        # What python-can has opened is held, to be closed by `stop`; the log is read by way of its own stream.
        self._opened = None if file is path else file
        self._source = open_source(Path(path), format="mcap")

    def __iter__(self) -> Iterator[can.Message]:
        """Yield the messages in the order of the log."""
        for item in self._source:
            if isinstance(item, CanFrame):
                yield _message(item)

    def stop(self) -> None:
        self._source.close()
        if self._opened is not None:
            self._opened.close()


def _nanoseconds(seconds: float) -> int:
    """Return a time without losing more of it than the number has lost."""
    whole = int(seconds)
    return whole * SECOND_NS + round((seconds - whole) * 1e9)


def _message(frame: CanFrame) -> can.Message:
    whole, rest = divmod(frame.t_ns or 0, SECOND_NS)
    return can.Message(
        timestamp=whole + rest / 1e9,
        arbitration_id=frame.id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_error_frame=frame.error,
        is_fd=frame.fd,
        is_rx=frame.direction is not Role.REQUEST,
        channel=frame.port,
        data=frame.data,
    )
