"""The configuration of a recording: a file beside its spools, read by the decoding process and by `servotap recover`.

It is a file instead of arguments: so the log of a killed recording can be finished without knowing how it was started.
It stands there twice, each time with its CRC.
"""

from __future__ import annotations

import zlib
from pathlib import Path

import msgspec

from analyzer.devices import DeviceText
from analyzer.errors import UnreadableError
from analyzer.live.spool import FORMAT
from analyzer.system.decoding import UNDECODABLE

NAME = "recording.json"
COPY = "recording.copy.json"
FILES = (NAME, COPY)
#: Stem of the spool that holds what happened to the recording itself: marks, steps of the wall clock, the end.
CONTROL = "0-control"
#: Exit status of a decoding process with a whole log. A library of an added dialect can end it with 0 at any moment.
WHOLE = 21


class PortConfig(msgspec.Struct, frozen=True, kw_only=True):
    """One spool of the recording.

    `stem`: its name in the folder; `bus`: the bus in the topics; `endpoint`: as the user gave it; `kind`: `serial` or
    `can`; `direction`: `request`, `reply` or `unknown`: who is heard; `speed`: bits per second, None where no line has
    one; `byte_ns`: time of one byte on the line, 0 unknown; `dialects`: names, empty: to be found out from the traffic; `ids`:
    who is a drive, None: the frames tell.
    """

    stem: str
    bus: str
    endpoint: str
    kind: str
    direction: str = "unknown"
    speed: int | None = None
    byte_ns: int = 0
    dialects: tuple[str, ...] = ()
    ids: tuple[int, ...] | None = None


class RecordingConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The whole recording.

    `log`: the first (or only) log. `anchor_monotonic_ns`, `anchor_utc_ns`: one moment on both clocks; a record of
    monotonic time t stands in the log at `anchor_utc_ns + t - anchor_monotonic_ns`. `rotate_bytes`, `rotate_ns`, `keep`,
    `max_total`: 0 means none. `max_spool`: bytes that the spools may have, 0 for any. `mode`: permissions of the log, if
    it replaces another. `foxglove`: HOST:PORT or empty. `devices`: files that describe other devices, so that
    nothing else is needed to decode again. `spools`: their format; `crc`: of all else.
    """

    log: str
    ports: tuple[PortConfig, ...]
    anchor_monotonic_ns: int
    anchor_utc_ns: int
    model: str = ""
    groups: tuple[int, ...] = ()
    late_ns: int = 1_000_000_000
    raw_only: bool = False
    rotate_bytes: int = 0
    rotate_ns: int = 0
    keep: int = 0
    max_total: int = 0
    max_spool: int = 0
    mode: int | None = None
    foxglove: str = ""
    command: str = ""
    notes: tuple[str, ...] = ()
    devices: tuple[DeviceText, ...] = ()
    spools: int = 1
    crc: int = 0

    def utc_ns(self, monotonic_ns: int) -> int:
        """Return the log's time of a monotonic time."""
        return self.anchor_utc_ns + monotonic_ns - self.anchor_monotonic_ns

    def save(self, folder: Path) -> None:
        """Write it into the folder of the spools, whole or not at all."""
        told = msgspec.structs.replace(self, spools=FORMAT, crc=0)
        data = msgspec.json.encode(msgspec.structs.replace(told, crc=zlib.crc32(msgspec.json.encode(told))))
        for name in FILES:
            part = folder / (NAME + ".part")
            part.write_bytes(msgspec.json.format(data, indent=1))
            part.replace(folder / name)


def load(folder: Path) -> RecordingConfig:
    """Return the recording of a folder of spools. Raises UnreadableError where there is none that can be read."""
    reasons = []
    for path in (folder / name for name in FILES):
        try:
            told = msgspec.json.decode(path.read_bytes(), type=RecordingConfig)
        except (OSError, *UNDECODABLE) as error:
            reasons.append(f"{path}: expected the configuration of a recording, got: {error}")
            continue
        if told.spools != FORMAT and not told.crc:
            raise UnreadableError(
                f"{folder} was recorded by another version of servotap, whose spools have format {told.spools}, not {FORMAT}; "
                "recover it with that version"
            )
        if zlib.crc32(msgspec.json.encode(msgspec.structs.replace(told, crc=0))) == told.crc:
            return told
        reasons.append(f"{path}: its check does not fit")
    raise UnreadableError("; ".join(reasons))
