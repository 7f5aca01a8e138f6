"""Memory that processes share. What is large in a message stands there, and need not pass through a pipe.

    message: number of a slot | a pickle, which says where in the memory bytes and columns stand

Rules: the first process gives slots out, and has one again when nothing looks at what stands in it. Where no slot is free, or
one is too small, the pipe carries all.
"""

from __future__ import annotations

import io
import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analyzer.records import Lane
from analyzer.sinks.object_table import Table, TablePickler, TableUnpickler

#: Bytes of a slot, and from how many on something stands in one.
_SIZE, _LARGE = 4 << 20, 4 << 10
_ALIGNED = 64
_NUMBER = 4
_NONE = (1 << 8 * _NUMBER) - 1


class Slot:
    """A part of the memory, until nothing looks at it any more."""

    def __init__(self, shared: Shared, number: int) -> None:
        self._shared, self.number = shared, number

    def __del__(self) -> None:
        self._shared.free.append(self.number)

    @property
    def __array_interface__(self) -> dict[str, Any]:
        """What NumPy makes a column of: it holds the slot."""
        own = self._shared.codes[self.number * _SIZE : (self.number + 1) * _SIZE]
        interface: dict[str, Any] = own.__array_interface__
        return interface


class Shared:
    """Slots, for messages with objects of a table. It is made before the processes are."""

    def __init__(self, table: Table, count: int) -> None:
        self.table = table
        self._memory = mmap.mmap(-1, count * _SIZE)
        self.codes: NDArray[np.uint8] = np.frombuffer(self._memory, dtype=np.uint8)
        self._first = self.codes.ctypes.data
        self.free = list(range(count))

    def slot(self) -> Slot | None:
        try:
            return Slot(self, self.free.pop())
        except IndexError:
            return None

    def place(self, column: NDArray[Any]) -> int | None:
        """Return where in the memory a column stands; None where it does not."""
        at: int = column.__array_interface__["data"][0] - self._first
        return at if 0 <= at < len(self.codes) else None

    def dumped(self, what: Any, number: int | None, *, answer: bool = False) -> bytes:
        """Return a message. `number`: of the slot that takes what is large.

        Of columns that stand in another slot the place is told; but not in an answer, whose slot alone is held.
        """
        stream = io.BytesIO()
        stream.write((_NONE if number is None else number).to_bytes(_NUMBER, "little"))
        _Pickler(stream, self, number, refers=not answer).dump(what)
        return stream.getvalue()

    def loaded(self, data: bytes | bytearray, slot: Slot | None = None) -> Any:
        """Return what a message holds. `slot`: is held by the columns that stand in it."""
        stream = io.BytesIO(data)
        stream.seek(_NUMBER)
        return _Unpickler(stream, self, slot).load()

    @staticmethod
    def number_of(data: bytes | bytearray) -> int | None:
        """Return the number of the slot that came with a message."""
        number = int.from_bytes(data[:_NUMBER], "little")
        return None if number == _NONE else number


class _Pickler(TablePickler):
    def __init__(self, stream: io.BytesIO, shared: Shared, number: int | None, *, refers: bool) -> None:
        super().__init__(stream, shared.table)
        self._shared, self._refers = shared, refers
        self._at, self._end = (0, 0) if number is None else (number * _SIZE, (number + 1) * _SIZE)

    def persistent_id(self, obj: Any) -> Any:
        """Return the number of an object of the catalogue, where bytes or a column stand, or what tells of lanes."""
        if type(obj) is np.ndarray:
            if obj.nbytes < _LARGE or not obj.flags.c_contiguous:
                return None
            place = self._shared.place(obj) if self._refers else None
            if place is None:
                place = self._put(obj.reshape(-1).view(np.uint8))
            return None if place is None else (place, obj.dtype.str, obj.shape)
        if type(obj) is bytes:
            place = self._put(np.frombuffer(obj, dtype=np.uint8)) if len(obj) >= _LARGE else None
            return None if place is None else (place, "", len(obj))
        if type(obj) is tuple and obj and type(obj[0]) is Lane:
            return self._shared.table.told(obj)
        return super().persistent_id(obj)

    def _put(self, codes: NDArray[np.uint8]) -> int | None:
        at, end = self._at, self._at + len(codes)
        if end > self._end:
            return None
        self._shared.codes[at:end] = codes
        self._at = end + -end % _ALIGNED
        return at


class _Unpickler(TableUnpickler):
    def __init__(self, stream: io.BytesIO, shared: Shared, slot: Slot | None) -> None:
        super().__init__(stream, shared.table)
        self._shared = shared
        self._codes = shared.codes
        self._first = 0
        if slot is not None:
            self._codes, self._first = np.asarray(slot), slot.number * _SIZE

    def persistent_load(self, pid: Any) -> Any:
        """Return an object of the catalogue, lanes, bytes, or a column that stands where it stood."""
        if isinstance(pid, int):
            return super().persistent_load(pid)
        if isinstance(pid, bytes):
            return self._shared.table.lanes(pid)
        place, kind, shape = pid
        if not kind:
            return self._codes[place - self._first : place - self._first + shape].tobytes()
        size = int(np.prod(shape)) * np.dtype(kind).itemsize
        return self._codes[place - self._first : place - self._first + size].view(kind).reshape(shape)
