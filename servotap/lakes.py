"""A lake from Python: its tables as data frames, and questions to it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from analyzer.fleet.ask import Question, has_times
from analyzer.fleet.lake import Lake as _Lake
from analyzer.fleet.lake import store_of
from analyzer.fleet.place import Place
from analyzer.table.extras import needed
from servotap.arguments import check

if TYPE_CHECKING:
    import polars
    import pyarrow
    import pyarrow.dataset


class Lake:
    """A lake that `servotap ingest` made, as it is when it is opened: a folder, or a URL.

    `store`: options of fsspec, as `endpoint_url`. Raises UnreadableError for a place without a lake, UsageError for a store
    that cannot be used.
    """

    def __init__(self, url: str | os.PathLike[str], **store: Any) -> None:
        check(url=url)
        text = os.fspath(url)
        store_of(text)
        self._question = Question(_Lake(Place(text, store)))

    @property
    def tables(self) -> tuple[str, ...]:
        """The names of all tables."""
        return tuple(self._question.tables)

    def dataset(self, table: str) -> pyarrow.dataset.Dataset:
        """Return a table as a dataset of Arrow, which reads what is needed alone. Raises UsageError for no table.

        It has `time_ns` as the files have it: empty where `time` tells the same.
        """
        return self._question.dataset(table)

    def table(self, table: str) -> polars.LazyFrame:
        """Return a table as a lazy frame of polars. Raises UsageError for no table, or without polars."""
        pl, found = needed("polars"), self.dataset(table)
        frame: polars.LazyFrame = pl.scan_pyarrow_dataset(found)
        if has_times(found.schema):
            return frame.with_columns(pl.coalesce("time_ns", pl.col("time").dt.epoch("us") * 1000).alias("time_ns"))
        return frame

    def sql(self, query: str) -> pyarrow.Table:
        """Return the answer to a query of DuckDB's SQL. Raises UsageError for what is none."""
        check(query=query)
        answer: pyarrow.Table = self._question.sql(query).to_arrow_table()
        return answer
