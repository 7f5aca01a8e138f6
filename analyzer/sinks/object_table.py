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
from threading import Lock
from typing import Any

from analyzer import __version__
from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.records import Lane

#: Groups of lanes that are kept.
_GROUPS = 16


class Table:
    """The objects of some dialects, numbered. `later`: all dialects that may come up; others than the first are loaded then."""

    def __init__(self, dialects: Sequence[Dialect], later: Callable[[], Sequence[Dialect]] = tuple) -> None:
        self.dialects: tuple[Dialect, ...] = ()
        self.objects: list[Dialect | Command | Form] = []
        self._numbers: dict[int, int] = {}
        self._later = later
        self._loading = Lock()
        self._add(dialects)
        #: What tells of some lanes, and the lanes that are told of: a capture mostly has the same from block to block.
        self.told: Callable[[tuple[Lane, ...]], bytes] = lru_cache(_GROUPS)(lambda lanes: dumped(lanes, self))
        self.lanes: Callable[[bytes], tuple[Lane, ...]] = lru_cache(_GROUPS)(
            lambda told: TableUnpickler(io.BytesIO(told), self).load()
        )

    def _add(self, dialects: Sequence[Dialect]) -> None:
        for dialect in dialects:
            if id(dialect) in self._numbers:
                continue
            self.dialects += (dialect,)
            own: list[Dialect | Command | Form] = [dialect]
            if dialect.exception is not None:
                own.append(dialect.exception)
            for command in (*dialect.commands, *dialect.fallbacks.values()):
                own += [command, *command.request_forms, *command.reply_forms]
            self._numbers |= {id(each): number for number, each in enumerate(own, len(self.objects))}
            self.objects += own

    def _load(self) -> None:
        with self._loading:
            self._add(self._later())
            self._later = tuple

    def number(self, what: Dialect | Command | Form) -> int | None:
        """Return the number of an object, None for one of no dialect."""
        if id(what) not in self._numbers:
            self._load()
        return self._numbers.get(id(what))

    def object(self, number: int) -> Dialect | Command | Form:
        if number >= len(self.objects):
            self._load()
        return self.objects[number]

    def dialect(self, name: str) -> Dialect:
        if all(each.name != name for each in self.dialects):
            self._load()
        return next(each for each in self.dialects if each.name == name)

    @property
    def digest(self) -> str:
        """What is the same only where the numbers mean the same."""
        names = "\n".join(f"{type(each).__name__} {each.name}" for each in self.objects)
        return f"{__version__} {len(self.objects)} {zlib.crc32(names.encode()):08x}"


class TablePickler(pickle.Pickler):
    """Writes objects of the table as their numbers."""

    def __init__(self, stream: io.BytesIO, table: Table) -> None:
        super().__init__(stream, pickle.HIGHEST_PROTOCOL)
        self._table = table

    def reducer_override(self, obj: Any) -> Any:
        """Return how a lane is made."""
        if not isinstance(obj, Lane):
            return NotImplemented
        about = (obj.role, obj.address, obj.command, obj.form, obj.start, obj.stop, obj.topic)
        return _lane, (self._table.dialect(obj.dialect), *about)

    def persistent_id(self, obj: Any) -> int | None:
        """Return the number of an object of the catalogue."""
        return self._table.number(obj) if isinstance(obj, (Dialect, Command, Form)) else None


class TableUnpickler(pickle.Unpickler):
    """Reads what `TablePickler` wrote."""

    def __init__(self, stream: io.BytesIO, table: Table) -> None:
        super().__init__(stream)
        self._table = table

    def persistent_load(self, pid: Any) -> Any:
        """Return an object of the catalogue by its number."""
        return self._table.object(pid)


def _lane(dialect: Dialect, role: Role, address: int, command: Command, form: Form, start: int, stop: int, topic: str) -> Lane:
    lane = Lane(dialect, role, address, command, form, start, stop)
    lane.topic = topic
    return lane


def dumped(what: Any, table: Table) -> bytes:
    """Return something as bytes for the other process."""
    stream = io.BytesIO()
    TablePickler(stream, table).dump(what)
    return stream.getvalue()
