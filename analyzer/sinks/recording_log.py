"""The log of a live recording: all that `McapLog` writes, and the bytes as received.

    /<bus>/raw    every chunk with its offset and direction, every CAN frame where decoding is left for later, every pause
                  that ended a wait

From `/<bus>/raw` a recording can be decoded again with the same result. A log can continue in another file (rotation); each
file is complete by itself. A process can continue the log of a killed process (`state`, `restore`).
"""

from __future__ import annotations

from binascii import hexlify
from collections.abc import Mapping
from typing import Any

import msgspec

from analyzer.catalogue import Role
from analyzer.port import topic_name
from analyzer.records import CanFrame, Chunk
from analyzer.sinks import schemas
from analyzer.sinks.mcap_file import LogFile, McapFile
from analyzer.sinks.mcap_log import McapLog, Second, Speed, can_flags

#: What the metadata of a raw topic says where all that came stands there.
COMPLETE = {"complete": "true"}


class RecordingLog(McapLog):
    """A sink that writes the log of a recording."""

    def __init__(self, file: LogFile, *, speeds: Mapping[str, Speed] | None = None) -> None:
        super().__init__(file, speeds=speeds)
        self._raws: dict[str, int] = {}
        self._described = False

    # --- raw ------------------------------------------------------------------------------------------------------

    def declare(self, bus: str, kind: str) -> None:
        """Declare the raw topic of a bus before anything of it stands in the log. `kind`: `serial` or `can`."""
        topic = f"/{topic_name(bus)}/raw"
        lane = self._add_lane(topic, "servotap.raw", schemas.raw_schema, {"bus_kind": kind, **COMPLETE})
        self._raws[bus] = lane.channel

    def raw(self, chunk: Chunk, offset: int, publish_ns: int) -> None:
        """Write a chunk as it came. `offset`: bytes of its bus before it; `publish_ns`: when its first byte began."""
        raw = hexlify(chunk.data, " ").upper()
        if chunk.direction is Role.UNKNOWN:
            text = b'{"_raw":"%b","_offset":%d}' % (raw, offset)
        else:
            text = b'{"_raw":"%b","_offset":%d,"_direction":"%b"}' % (raw, offset, chunk.direction.encode())
        log_ns = self._clock(chunk.t_ns or 0)
        self._file.add_message(self._raws[chunk.port], 0, log_ns, publish_ns, text)

    def raw_can(self, can: CanFrame, offset: int) -> None:
        shown: dict[str, Any] = {"_raw": can.data.hex(" ").upper(), "_offset": offset, "_can_id": can.id}
        flags = can_flags(can)
        if flags:
            shown["_can_flags"] = flags
        if can.direction is not Role.UNKNOWN:
            shown["_direction"] = can.direction.value
        log_ns = self._clock(can.t_ns or 0)
        self._file.add_message(self._raws[can.port], 0, log_ns, log_ns, msgspec.json.encode(shown))

    def silence(self, t_ns: int, bus: str, offset: int) -> None:
        log_ns = self._clock(t_ns)
        self._file.add_message(self._raws[bus], 0, log_ns, log_ns, b'{"_raw":"","_offset":%d,"_silence":true}' % offset)

    # --- time -----------------------------------------------------------------------------------------------------

    @property
    def last_ns(self) -> int:
        return self._last_ns

    def learn(self, bus: str, speed: Speed) -> None:
        """Take the speed that a bus has from the next second on."""
        self._speeds[bus] = speed

    def tick(self, t_ns: int) -> None:
        """Write the counts of the seconds that are over by this time."""
        for bus in [bus for bus, second in self._seconds.items() if second.end_ns <= t_ns]:
            self._write_second(bus, self._seconds.pop(bus))

    # --- files ----------------------------------------------------------------------------------------------------

    def describe(self, name: str, metadata: Mapping[str, str]) -> None:
        self._file.add_metadata(name, metadata)

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Make the file whole. Raises OSError; it may be called again, the metadata stand once."""
        self._end_seconds()
        if not self._described:
            self._file.add_metadata("servotap", metadata)
            self._described = True
        self._file.finish()

    def go_over(self, file: LogFile) -> None:
        """Write to another file from here on; the one before was finished."""
        self._file = file
        self._described = False
        self._lanes.clear()
        self._schemas.clear()
        self._channels.clear()
        self._raws.clear()

    # --- for another process --------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """Return what `restore` needs, as plain values, right after a `flush`."""
        seconds = {
            bus: [getattr(second, name) for name in _COUNTS] + list(second.speed) for bus, second in self._seconds.items()
        }
        return {"last_ns": self._last_ns, "seconds": seconds}

    def restore(self, state: Mapping[str, Any], file: McapFile) -> None:
        """Go on where another log stood. `file`: what it wrote to, without anything that may stand before it."""
        self._last_ns = state["last_ns"]
        for bus, values in state["seconds"].items():
            second = self._seconds[bus] = Second(0, Speed(*values[len(_COUNTS) :]))
            for name, value in zip(_COUNTS, values, strict=False):
                setattr(second, name, value)
        self._schemas = {schema.name: schema.id for schema in file.schemas()}
        self._channels = {channel.topic: channel.id for channel in file.channels()}


_COUNTS = ("end_ns", "frames", "bytes", "junk_bytes", "errors", "warnings", "wire_ns")
