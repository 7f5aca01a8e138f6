"""The checkpoint of a recording: all that a process needs to go on where another was killed.

    after each flush of the log:  place in the log and its index, place in each spool, each bus, and the state of the decoding
    checkpoint.0, checkpoint.1:   crc32 u32 | MessagePack; written by turns, the one with the greater number counts

Where the newer one is damaged, the one before it counts: what it needs is kept in the spools and in the index.

Going on, the log is cut at that place and the spools are read from theirs, so no byte is lost or stands twice. The state of
decoding (half frames, open requests) are records of this program, and only those are read back: a folder of spools may come
from anywhere. Where another version of the program wrote it, the state is left out and half frames are decoded
anew from their bytes, which stand beside it.
"""

from __future__ import annotations

import io
import os
import pickle
import zlib
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from analyzer.catalogue import Role
from analyzer.codec import Violation
from analyzer.context import Context, Request, RequestOutcome, State
from analyzer.errors import UnreadableError
from analyzer.framer import _Mark
from analyzer.records import CanFrame, Frame, Lane, Message
from analyzer.sinks.object_table import Table, TablePickler, TableUnpickler

NAMES = ("checkpoint.0", "checkpoint.1")
_CHECK = 4


class BusState(msgspec.Struct, kw_only=True):
    """One bus. `pending`: bytes that are in the log as they came and not in a frame yet; `pending_ns`: their time."""

    offset: int = 0
    last_ns: int = 0
    sounded: bool = False
    sent: bool = False
    dialects: list[str] = []
    guessing: bool = False
    reason: str = ""
    pending: bytes = b""
    pending_ns: int = 0
    pending_direction: str = "unknown"
    notes: list[str] = []
    lost: dict[str, int] = {}
    speed: int | None = None
    byte_ns: int | None = None


class SpoolState(msgspec.Struct, kw_only=True):
    """One spool: where to go on, what should come next, and up to when it was seen to be quiet."""

    segment: int
    place: int
    expected: int | None = None
    quiet_ns: int = 0
    ended: bool = False


class Checkpoint(msgspec.Struct, kw_only=True):
    """The whole of it. `number` counts them; `position` 0: the part was not begun yet."""

    number: int
    part: int
    path: str
    position: int
    previous: str = ""
    begun_ns: int | None = None
    index_length: int = 0
    index_crc: int = 0
    file: dict[str, Any] = {}
    log: dict[str, Any] = {}
    spools: dict[str, SpoolState] = {}
    buses: dict[str, BusState] = {}
    counts: dict[str, Any] = {}
    clock_ns: int = 0
    sequence: int = 0
    digest: str = ""
    decoding: bytes = b""
    ended: str = ""
    drift_ns: int = 0
    moved: tuple[int, int] = (0, 0)

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
        except (ValueError, msgspec.MsgspecError) as error:
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

    def __init__(self, stream: io.BytesIO, table: Table) -> None:
        super().__init__(stream, table)
        self._dialects = {d.name: d for d in table.dialects}

    def reducer_override(self, obj: Any) -> Any:
        """Return how an object is made again."""
        if isinstance(obj, Lane):
            dialect = self._dialects[obj.dialect]
            return _lane, (dialect, obj.topic, obj.role, obj.address, obj.command, obj.form, obj.start, obj.stop)
        return NotImplemented


#: All that may stand in a state.
_ALLOWED: Mapping[tuple[str, str], Any] = {
    (each.__module__, each.__qualname__): each
    for each in (CanFrame, Context, Frame, Message, RequestOutcome, Request, Role, State, Violation, _Mark, _lane, deque)
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
