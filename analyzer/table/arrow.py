"""Tables as Arrow: for data frames, and Parquet files. Columns carry their metadata: unit, section, manual.

Times with a date are timestamps in nanoseconds: in UTC, without a zone where the capture names none. Others are durations.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import IO, TYPE_CHECKING, Any

from analyzer.sources.times import Clock
from analyzer.table.columns import Column, Kind
from analyzer.table.extras import needed
from analyzer.table.tables import Table

if TYPE_CHECKING:
    import pyarrow

#: Lines that are held in memory, and stand together in a Parquet file.
BATCH = 32_768


def schema_of(table: Table) -> pyarrow.Schema:
    """Return the schema of a table. Raises UsageError where pyarrow is not installed."""
    pa = needed("pyarrow")
    fields = [pa.field(c.name, _type(pa, c, table), metadata=c.about) for c in table.columns]
    schema: pyarrow.Schema = pa.schema(
        fields, metadata={f"servotap.{name}": text for name, text in table.recorded.about.items()}
    )
    return schema


def _type(pa: Any, column: Column, table: Table) -> Any:
    if column.kind is Kind.TIME:
        recorded = table.recorded
        if not recorded.dated:
            return pa.duration("ns")
        return pa.timestamp("ns", None if recorded.clock is Clock.PRINTED else "UTC")
    kinds = {Kind.TEXT: pa.string(), Kind.INTEGER: pa.int64(), Kind.NUMBER: pa.float64(), Kind.FLAG: pa.bool_()}
    return kinds[column.kind]


def batches(table: Table, lines: Iterable[list[Any]] | None = None) -> Iterator[pyarrow.RecordBatch]:
    """Yield a table in pieces. `lines`: its lines, where someone else reads them from it."""
    pa = needed("pyarrow")
    schema = schema_of(table)
    left = iter(table.lines() if lines is None else lines)
    while some := list(islice(left, BATCH)):
        columns = zip(*some, strict=True)
        arrays = [pa.array(values, type=field.type) for values, field in zip(columns, schema, strict=True)]
        yield pa.record_batch(arrays, schema=schema)


def arrow_table(table: Table) -> pyarrow.Table:
    """Return a table as one of Arrow."""
    whole: pyarrow.Table = needed("pyarrow").Table.from_batches(batches(table), schema=schema_of(table))
    return whole


def write_parquet(table: Table, lines: Iterable[list[Any]], stream: IO[bytes]) -> None:
    """Write a Parquet file, a row group at a time."""
    needed("pyarrow")
    from pyarrow import parquet

    with parquet.ParquetWriter(stream, schema_of(table), compression="zstd") as writer:
        for batch in batches(table, lines):
            writer.write_batch(batch)
