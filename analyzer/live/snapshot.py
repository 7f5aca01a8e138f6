"""A snapshot: what a viewer of a recording gets about ten times a second, as one line of JSON.

    SnapshotSink (decoding process) -> Snapshot -> one line -> pipe -> terminal view, counts a line a second, anything else

A snapshot can be lost without harm: all counts are cumulative, and `number` shows that one is missing. What is too much for
one is left out and counted, never queued. It holds what the capture says, unchanged: who shows it on a terminal makes control
characters visible.

Times are nanoseconds of the log's clock. Defaults are left out of the JSON.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from typing import Any

import msgspec

from analyzer.errors import UsageError

if sys.platform == "linux":
    from fcntl import F_SETPIPE_SZ, fcntl

#: Wished size of the pipe's buffer in the kernel: a few snapshots.
PIPE_BYTES = 1 << 20
#: Roles of a line that is neither a request nor a reply.
JUNK = "junk"
EVENT = "event"
#: The command of frames that are no drive's.
FOREIGN = "foreign"


class FrameLine(msgspec.Struct, omit_defaults=True, gc=False):
    """A frame, a piece of junk, or something that happened to the recording.

    `role`: request, reply, unknown, foreign, `junk` or `event`; `who`: the address as text, on CAN the identifier in
    hexadecimal, `all` for a package, empty for junk.
    `command`: its name, `unknown 0xNN`, the reason of junk, or the kind of event. `values`: fields by name, with name
    twins (`slots` for a package), `units`: of those that have one; `state`: quantities of the derived state that it
    carries. `raw`: hex with blanks, on CAN without the identifier. `rules`: findings known when it was decoded; `severity`:
    the worst of them. `text`: of an event. `sequence` 0: it has no message in the log (an event).
    """

    sequence: int
    t_ns: int
    bus: str
    role: str
    command: str = ""
    who: str = ""
    address: int = -1
    dialect: str = ""
    section: str = ""
    topic: str = ""
    values: dict[str, Any] = {}
    units: dict[str, Any] = {}
    state: dict[str, float] = {}
    raw: str = ""
    offset: int = 0
    can_id: int | None = None
    extended: bool = False
    latency_ns: int | None = None
    request_sequence: int | None = None
    checksum_ok: bool = True
    rules: tuple[str, ...] = ()
    severity: str = ""
    text: str = ""


class FindingLine(msgspec.Struct, omit_defaults=True, gc=False):
    """A finding. `sequence`: of the message it is about; it can be older than the frames beside it."""

    t_ns: int
    bus: str
    rule: str
    severity: str
    text: str
    section: str = ""
    address: int = -1
    who: str = ""
    topic: str = ""
    sequence: int = 0
    offset: int = 0


class BusCounts(msgspec.Struct, omit_defaults=True, gc=False):
    """Counts of one bus since the beginning, and rates over about the last second.

    `lost`: bytes or frames that came in and are not in the log; `foreign`: of its frames, those of nodes that are no drives;
    `bytes`: in frames; `load`: share 0..1 of the time in
    which the line was busy, None where its speed is not known.
    """

    bus: str
    frames: int = 0
    bytes: int = 0
    junk: int = 0
    junk_bytes: int = 0
    errors: int = 0
    warnings: int = 0
    infos: int = 0
    foreign: int = 0
    lost: int = 0
    frame_rate: float = 0.0
    byte_rate: float = 0.0
    load: float | None = None


class RowCounts(msgspec.Struct, omit_defaults=True, gc=False):
    """Counts of one command of one address in one role since the beginning; `rate` a second, over about the last one."""

    bus: str
    who: str
    command: str
    role: str
    dialect: str = ""
    count: int = 0
    rate: float = 0.0
    latencies: int = 0
    latency_last_ns: int = 0
    latency_sum_ns: int = 0
    latency_max_ns: int = 0


class Snapshot(msgspec.Struct, omit_defaults=True, gc=False):
    """What is new since the snapshot before, and the counts of everything so far.

    `number` counts from 1. `frames`: newest last, by sequence; `left_out`: frames and junk since the snapshot before that
    are not among them. `rows`: those that changed; all come again within some seconds. `rules`: findings by rule. `log`,
    `log_bytes`: the file; `behind_ns`: how far decoding lags behind the wire; `ended`: the last one. `causes`: the lines of
    each cause of trouble that became likely, by its id.
    """

    t_ns: int
    number: int
    frames: list[FrameLine] = []
    left_out: int = 0
    findings: list[FindingLine] = []
    buses: list[BusCounts] = []
    rows: list[RowCounts] = []
    rules: dict[str, int] = {}
    log: str = ""
    log_bytes: int = 0
    behind_ns: int = 0
    first_ns: int = 0
    ended: bool = False
    causes: dict[str, list[str]] = {}


_encoder = msgspec.json.Encoder()
_decoder = msgspec.json.Decoder(Snapshot)


def encode(snapshot: Snapshot) -> bytes:
    """Return a snapshot as one line of JSON, its line end included."""
    return _encoder.encode(snapshot) + b"\n"


def decode(line: bytes) -> Snapshot:
    """Return the snapshot of a line. Raises one of UNDECODABLE for a line that is none."""
    return _decoder.decode(line)


class SnapshotWriter:
    """Writes snapshots into a pipe (or a file, a socket) that it owns, without ever waiting.

    A line is finished before the next one begins. `dropped`: snapshots that found no room. `gone`: the pipe has no
    reader any more; from then on everything is dropped.
    """

    def __init__(self, fd: int) -> None:
        self._file = io.FileIO(fd, "wb")
        if not hasattr(os, "set_blocking"):
            raise UsageError("watching needs Python 3.12 on this system, for pipes that do not block")
        os.set_blocking(fd, False)
        # A larger buffer is a wish: a user may have used up his share, and files have none at all.
        if sys.platform == "linux":
            with contextlib.suppress(OSError):
                fcntl(fd, F_SETPIPE_SZ, PIPE_BYTES)
        self._rest = b""
        self.dropped = 0
        self.gone = False

    def offer(self, snapshot: Snapshot) -> bool:
        """Write a snapshot if there is room now; say whether it will arrive."""
        self._push()
        if self._rest or self.gone:
            self.dropped += 1
            return False
        self._rest = encode(snapshot)
        self._push()
        self.dropped += self.gone
        return not self.gone

    def _push(self) -> None:
        while self._rest and not self.gone:
            try:
                written = self._file.write(self._rest)
            except OSError:
                # The reader has ended: watching ends, recording goes on.
                self.gone, self._rest = True, b""
                return
            if written is None:
                return
            self._rest = self._rest[written:]

    def close(self) -> None:
        """Close the pipe; what did not fit is lost."""
        self._push()
        self._file.close()
