"""The configuration of a recording: a file beside its spools, read by the decoding process and by `servotap recover`.

It is a file instead of arguments: so the log of a killed recording can be finished without knowing how it was started.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from analyzer.errors import UnreadableError

NAME = "recording.json"
#: Stem of the spool that holds what happened to the recording itself: marks, steps of the wall clock, the end.
CONTROL = "0-control"


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
    `max_total`: 0 means none. `foxglove`: HOST:PORT or empty.
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
    foxglove: str = ""
    command: str = ""
    notes: tuple[str, ...] = ()

    def utc_ns(self, monotonic_ns: int) -> int:
        """Return the log's time of a monotonic time."""
        return self.anchor_utc_ns + monotonic_ns - self.anchor_monotonic_ns

    def save(self, folder: Path) -> None:
        """Write it into the folder of the spools, whole or not at all."""
        part = folder / (NAME + ".part")
        part.write_bytes(msgspec.json.format(msgspec.json.encode(self), indent=1))
        part.replace(folder / NAME)


def load(folder: Path) -> RecordingConfig:
    """Return the recording of a folder of spools. Raises UnreadableError where there is none."""
    try:
        return msgspec.json.decode((folder / NAME).read_bytes(), type=RecordingConfig)
    except (OSError, msgspec.MsgspecError) as error:
        raise UnreadableError(f"{folder / NAME}: expected the configuration of a recording, got: {error}") from None
