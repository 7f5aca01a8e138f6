"""A Parquet file of one table, written some rows at a time: how its columns are packed."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analyzer.table.extras import needed

if TYPE_CHECKING:
    import pyarrow

    from analyzer.sinks.parquet import Target

#: Numbers of which there are few, beside words: for each of these stands its place among those that occur.
_FEW = frozenset(("_latency", "latency"))
#: Words that stand in order, so that their least and greatest values say where to search. Of all others each group has any.
_IN_ORDER = frozenset(("capture", "machine"))
#: How integers are written: their differences from row to row, in as few bits as they need.
_DIFFERENCES = "DELTA_BINARY_PACKED"
#: What packs all else: every reader knows it, and zstd would take as long as all other work on a column.
_CODEC = "snappy"
#: Values that are encoded at once.
_TOGETHER = 1 << 14


class _Writing:
    """A thread that writes rows while the next ones are made: that needs no Python. One piece of work waits at most."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="servotap-tables")
        self._last: Future[None] | None = None

    def begin(self, work: Callable[[], None]) -> None:
        """Have something done, once all before it is. Raises what that raised."""
        self.wait()
        self._last = self._thread.submit(work)

    def wait(self) -> None:
        """Return once all is done. Raises what it raised."""
        last, self._last = self._last, None
        if last is not None:
            last.result()


class File:
    """A Parquet file of one table; a table without rows leaves none."""

    def __init__(self, path: Path, schema: pyarrow.Schema, writing: _Writing) -> None:
        self._path = path
        self._schema = schema
        self._writing = writing
        self._writer: Any = None

    def write(self, rows: pyarrow.Table) -> None:
        """Write the next rows as one row group, soon: what goes wrong is raised by the next call for any file of the folder."""
        self._writing.begin(lambda: self._write(rows))

    def _write(self, rows: pyarrow.Table) -> None:
        if self._writer is None:
            # A name that is no UTF-8 is none for pyarrow.
            self._stream = self._path.open("wb")
            self._writer = needed("pyarrow.parquet").ParquetWriter(self._stream, self._schema, **packing(self._schema))
        self._writer.write_table(rows)

    def close(self) -> None:
        self._writing.wait()
        if self._writer is not None:
            self._writer.close()
            self._stream.close()


def files_in(folder: Path) -> Callable[[str, pyarrow.Schema], Target]:
    """Return what gives each table its file in a folder that exists."""
    writing = _Writing()
    return lambda name, schema: File(folder / f"{name}.parquet", schema, writing)


def packing(schema: pyarrow.Schema) -> dict[str, Any]:
    """Return how the columns of a table are written, for a ParquetWriter.

    Integers, and what has few values, are not compressed: their encoding makes them small. Bytes have no dictionary: most rows
    of a long table have other ones.
    """
    kinds = {field.name: str(field.type) for field in schema}
    paths = {name: f"{name}.list.element" if kind.startswith("list") else name for name, kind in kinds.items()}
    whole = [name for name, kind in kinds.items() if kind.startswith(("int", "uint", "timestamp"))]
    told = [name for name, kind in kinds.items() if name in whole or kind == "double"]
    few = _FEW & kinds.keys()
    return {
        "compression": {path: _CODEC for name, path in paths.items() if name not in few.union(whole)},
        "use_dictionary": [
            path for name, path in paths.items() if name in few or (name not in told and kinds[name] != "binary")
        ],
        "column_encoding": dict.fromkeys(whole, _DIFFERENCES),
        "write_statistics": [*told, *(_IN_ORDER & kinds.keys())],
        "write_batch_size": _TOGETHER,
    }
