"""Numbers for the objects of the catalogue, so that records with such objects can go to another process.

Both sides have the same dialects and send only their numbers; a lane is made anew from what it is of. If the other process
may be another version of this program, `digest` tells whether the dialects are the same.
"""

from __future__ import annotations

import io
import pickle
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

from analyzer import __version__
from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.records import Lane

#: Groups of lanes that are kept.
_GROUPS = 16


class Table:
    """The objects of some dialects, numbered."""

    def __init__(self, dialects: Sequence[Dialect]) -> None:
        self.dialects = tuple(dialects)
        self.objects: list[Dialect | Command | Form] = []
        for dialect in dialects:
            self.objects.append(dialect)
            if dialect.exception is not None:
                self.objects.append(dialect.exception)
            for command in (*dialect.commands, *dialect.fallbacks.values()):
                self.objects += [command, *command.request_forms, *command.reply_forms]
        self.numbers = {id(each): number for number, each in enumerate(self.objects)}
        #: What tells of some lanes, and the lanes that are told of: a capture mostly has the same from block to block.
        self.told: Callable[[tuple[Lane, ...]], bytes] = lru_cache(_GROUPS)(lambda lanes: dumped(lanes, self))
        self.lanes: Callable[[bytes], tuple[Lane, ...]] = lru_cache(_GROUPS)(
            lambda told: TableUnpickler(io.BytesIO(told), self).load()
        )

    @property
    def digest(self) -> str:
        """What is the same only where the numbers mean the same."""
        names = "\n".join(f"{type(each).__name__} {each.name}" for each in self.objects)
        return f"{__version__} {len(self.objects)} {zlib.crc32(names.encode()):08x}"


class TablePickler(pickle.Pickler):
    """Writes objects of the table as their numbers."""

    def __init__(self, stream: io.BytesIO, table: Table) -> None:
        super().__init__(stream, pickle.HIGHEST_PROTOCOL)
        self._numbers = table.numbers
        self._dialects = {dialect.name: dialect for dialect in table.dialects}

    def reducer_override(self, obj: Any) -> Any:
        """Return how a lane is made."""
        if not isinstance(obj, Lane):
            return NotImplemented
        about = (obj.role, obj.address, obj.command, obj.form, obj.start, obj.stop, obj.topic)
        return _lane, (self._dialects[obj.dialect], *about)

    def persistent_id(self, obj: Any) -> int | None:
        """Return the number of an object of the catalogue."""
        return self._numbers.get(id(obj)) if isinstance(obj, (Dialect, Command, Form)) else None


class TableUnpickler(pickle.Unpickler):
    """Reads what `TablePickler` wrote."""

    def __init__(self, stream: io.BytesIO, table: Table) -> None:
        super().__init__(stream)
        self._objects = table.objects

    def persistent_load(self, pid: Any) -> Any:
        """Return an object of the catalogue by its number."""
        return self._objects[pid]


def _lane(dialect: Dialect, role: Role, address: int, command: Command, form: Form, start: int, stop: int, topic: str) -> Lane:
    lane = Lane(dialect, role, address, command, form, start, stop)
    lane.topic = topic
    return lane


def dumped(what: Any, table: Table) -> bytes:
    """Return something as bytes for the other process."""
    stream = io.BytesIO()
    TablePickler(stream, table).dump(what)
    return stream.getvalue()
