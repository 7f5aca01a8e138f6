"""The checkpoint of a recording: all that a process needs to go on where another was killed.

    after each flush of the log:  place in the log and its index, place in each spool, each bus, and the state of the decoding
    checkpoint.0, checkpoint.1:   crc32 u32 | MessagePack; written by turns, the one with the greater number counts

Where the newer one is damaged, the one before it counts: what it needs is kept in the spools and in the index.

Going on, the log is cut at that place and the spools are read from theirs, so no byte is lost or stands twice. The state of
decoding (half frames, open requests) are records of this program, and only those are read back: a folder of spools may come
from anywhere. The state of another program version is left out. Half frames are then decoded anew: the checkpoint also
holds their bytes.
"""

from __future__ import annotations

import io
import os
import pickle
import zlib
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec

from analyzer.catalogue import Role
from analyzer.codec import Violation
from analyzer.context import Context, Request, RequestOutcome, State
from analyzer.errors import UnreadableError
from analyzer.framer import Mark
from analyzer.records import CanFrame, Frame, Lane, Message
from analyzer.sinks.object_table import Table, TablePickler, TableUnpickler
from analyzer.system.decoding import UNDECODABLE

NAMES = ("checkpoint.0", "checkpoint.1")
_CHECK = 4


#: Numbers as their places in a log bound them. The upper half is left for what a recording that goes on adds.
Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 62)]
Number2 = Annotated[int, msgspec.Meta(ge=0, lt=1 << 15)]
Number4 = Annotated[int, msgspec.Meta(ge=0, lt=1 << 31)]


class BusState(msgspec.Struct, kw_only=True):
    """One bus. `pending`: bytes that are in the log as they came and not in a frame yet; `pending_ns`: their time."""

    offset: Count = 0
    last_ns: Count = 0
    sounded: bool = False
    sent: bool = False
    dialects: list[str] = []
    guessing: bool = False
    reason: str = ""
    pending: bytes = b""
    pending_ns: Count = 0
    notes: list[str] = []
    lost: dict[str, int] = {}
    speed: int | None = None
    byte_ns: int | None = None


class SpoolState(msgspec.Struct, kw_only=True):
    """One spool: where to go on, what should come next, and up to when it was seen to be quiet."""

    segment: Annotated[int, msgspec.Meta(ge=-1, lt=1 << 62)]
    place: Count
    expected: Count | None = None
    quiet_ns: int = 0
    ended: bool = False


class FileState(msgspec.Struct, kw_only=True, rename=lambda name: f"_{name}"):
    """What `McapFile.state` returns."""

    position: Count
    counts: dict[Number2, Count]
    first_ns: Count
    last_ns: Count
    messages: Count
    chunks: Number4
    metadata: Number4
    schemas: Number2
    channels: Number2


class LogState(msgspec.Struct, kw_only=True):
    """What `RecordingLog.state` returns."""

    last_ns: Count
    seconds: dict[str, Annotated[list[int | None], msgspec.Meta(min_length=7)]]


class BeforeState(msgspec.Struct, kw_only=True):
    """The counts of a recording where its part began."""

    bytes: Count
    frames: Count
    frame_bytes: Count
    junk_bytes: Count
    marks: Count
    findings: Count


class CountsState(msgspec.Struct, kw_only=True):
    """What `RecordingCounts.state` returns."""

    bytes: Count
    frames: Count
    frame_bytes: Count
    junk_bytes: Count
    marks: Count
    findings: dict[str, Count]
    before: BeforeState


class Checkpoint(msgspec.Struct, kw_only=True):
    """The whole of it. `number` counts them; `position` 0: the part was not begun yet."""

    number: Count
    part: Number4
    path: str
    position: Count
    previous: str = ""
    begun_ns: int | None = None
    index_length: Count = 0
    index_crc: int = 0
    file: FileState | None = None
    log: LogState | None = None
    spools: dict[str, SpoolState] = {}
    buses: dict[str, BusState] = {}
    counts: CountsState | None = None
    clock_ns: Count = 0
    sequence: Count = 0
    digest: str = ""
    decoding: bytes = b""
    ended: str = ""
    drift_ns: int = 0
    moved: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        if not self.path or Path(self.path).name != self.path or "\0" in self.path:
            raise ValueError(f"expected the name of a log, got {self.path!r}")
        if self.position and None in (self.file, self.log, self.counts):
            raise ValueError("a part of it is missing")

    def save(self, folder: Path) -> None:
        """Store it in the folder of the spools. Raises OSError with the one before still there."""
        data = msgspec.msgpack.encode(self)
        part = folder / "checkpoint.part"
        try:
            part.write_bytes(zlib.crc32(data).to_bytes(_CHECK, "little") + data)
        except OSError:
            part.unlink(missing_ok=True)
            raise
        os.replace(part, folder / NAMES[self.number % 2])


def load(folder: Path) -> Checkpoint | None:
    """Return the checkpoint of a folder, None where there is none. Raises UnreadableError where all are damaged."""
    found = []
    damaged = []
    for path in (folder / name for name in NAMES):
        try:
            data = path.read_bytes()
            if zlib.crc32(data[_CHECK:]) != int.from_bytes(data[:_CHECK], "little"):
                raise ValueError("its check does not fit")
            found.append(msgspec.msgpack.decode(data[_CHECK:], type=Checkpoint))
        except FileNotFoundError:
            continue
        except UNDECODABLE as error:
            damaged.append(f"{path} cannot be read ({error})")
    if damaged and not found:
        raise UnreadableError("; ".join(damaged))
    return max(found, key=lambda each: each.number, default=None)


# --- the state of decoding ------------------------------------------------------------------------------------------


def _lane(*about: Any) -> Lane:
    dialect, topic, *rest = about
    lane = Lane(dialect, *rest)
    lane.topic = topic
    return lane


class _Pickler(TablePickler):
    """Writes lanes as what they are made of."""

    def reducer_override(self, obj: Any) -> Any:
        """Return how an object is made again."""
        if isinstance(obj, Lane):
            about = (obj.topic, obj.role, obj.address, obj.command, obj.form, obj.start, obj.stop)
            return _lane, (self._table.dialect(obj.dialect), *about)
        return NotImplemented


#: All that may stand in a state.
_ALLOWED: Mapping[tuple[str, str], Any] = {
    (each.__module__, each.__qualname__): each
    for each in (CanFrame, Context, Frame, Message, RequestOutcome, Request, Role, State, Violation, Mark, _lane, deque)
}


class _Unpickler(TableUnpickler):
    """Makes only records of this program."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a class that is allowed. Raises UnpicklingError for any other."""
        try:
            return _ALLOWED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"{module}.{name} has no place in a checkpoint") from None


def dump_state(state: Mapping[str, Any], table: Table) -> bytes:
    """Return the state of a pipeline as bytes."""
    stream = io.BytesIO()
    _Pickler(stream, table).dump(dict(state))
    return stream.getvalue()


def load_state(data: bytes, table: Table) -> dict[str, Any]:
    """Return the state of a pipeline. Raises ValueError for what is none."""
    try:
        state = _Unpickler(io.BytesIO(data), table).load()
    # A damaged pickle makes its reader stumble over anything.
    except Exception as error:
        raise ValueError(f"the decoder's state cannot be read: {error}") from None
    if not isinstance(state, dict):
        raise ValueError("the decoder's state cannot be read: expected a table")
    return state
