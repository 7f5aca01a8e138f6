"""Ask a lake in SQL (DuckDB); without a question, list its tables, columns and units."""

from __future__ import annotations

import argparse
import contextlib
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

from analyzer.cli.option_types import positive
from analyzer.cli.output import free_target, whole
from analyzer.errors import UsageError
from analyzer.fleet.ask import Question
from analyzer.fleet.cli.stores import add_store_argument, beside, lake
from analyzer.table.extras import needed
from analyzer.values import printable

EXAMPLES = """\
examples:
  servotap ask lake/                                           tables
  servotap ask lake/ mks_can.read_speed_reply                  columns of one, with units
  servotap ask lake/ "select machine, count(*) from captures group by machine"
  servotap ask lake/ "select * from findings where date > '2026-11-01'" -o findings.parquet
  servotap ask s3://plant/lake "from states limit 5" --store endpoint_url=http://minio:9000
"""
#: Characters of a cell that are shown.
_SHOWN = 2000
_SUFFIXES = (".csv", ".parquet")
#: Types of DuckDB that a table of CSV has as they are.
_PLAIN = frozenset(
    {"tinyint", "smallint", "integer", "bigint", "utinyint", "usmallint", "uinteger", "ubigint"}
    | {"boolean", "float", "double", "varchar", "date", "timestamp", "timestamp with time zone"}
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("lake", metavar="LAKE", help="a folder, or s3://, gs://, abfs://")
    parser.add_argument("query", nargs="?", metavar="SQL", help="a query, or the name of a table")
    parser.add_argument("-o", "--output", metavar="FILE", help="write the answer to FILE.csv or FILE.parquet")
    parser.add_argument("--force", action="store_true", help="replace a file that exists")
    parser.add_argument("--rows", type=positive, default=100, metavar="N", help="rows that are shown at most (default 100)")
    parser.add_argument(
        "--seconds", type=positive, default=60, metavar="N", help="seconds after which a question is stopped (default 60)"
    )
    add_store_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Answer; return 0."""
    for package in ("pyarrow", "deltalake", "duckdb"):
        needed(package)
    target = None if arguments.output is None else free_target(Path(arguments.output), arguments.force)
    if target is not None and target.suffix not in _SUFFIXES:
        raise UsageError(f"-o {target}: expected a name that ends in {' or '.join(_SUFFIXES)}")
    question = Question(lake(arguments.lake, arguments.store))
    if target is not None:
        beside(target, arguments.lake)
    query = arguments.query
    if query is None:
        _show(["table", "columns"], [[name, str(len(list(question.columns(name))))] for name in question.tables])
    elif query in question.tables and target is None:
        _show(["column", "type", "unit", "note"], [list(each) for each in question.columns(query)])
    elif target is None:
        with question.bounded(arguments.seconds):
            answer = question.sql(query)
            names, rows = answer.columns, answer.limit(arguments.rows + 1).to_arrow_table().to_pylist()
        _show(names, [[_text(value) for value in row.values()] for row in rows[: arguments.rows]])
        if len(rows) > arguments.rows:
            print(f"the first {arguments.rows} rows are shown: --rows N shows more, -o FILE.csv writes all", file=sys.stderr)
    else:
        with question.bounded(arguments.seconds):
            _write(question, f"from {query}" if query in question.tables else query, target)
    return 0


def _write(question: Question, query: str, target: Path) -> None:
    answer = question.sql(query)
    if target.suffix == ".csv":
        # A cell of CSV holds no list, structure or interval: it holds their text.
        answer = answer.project(", ".join(_cell(*each) for each in zip(answer.columns, answer.types, strict=True)))
    reader: Any = answer.to_arrow_reader(1 << 16)
    with contextlib.closing(reader), whole(target) as stream:
        if target.suffix == ".csv":
            writer = needed("pyarrow.csv").CSVWriter(stream, reader.schema)
        else:
            writer = needed("pyarrow.parquet").ParquetWriter(stream, reader.schema, compression="zstd")
        with writer:
            for batch in reader:
                writer.write_batch(batch)


def _cell(name: str, kind: Any) -> str:
    column = '"' + name.replace('"', '""') + '"'
    return column if kind.id in _PLAIN else f"cast({column} as varchar) as {column}"


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, datetime):
        return value.isoformat()
    text = "" if value is None else ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return printable(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}... ({len(text)} characters)")


def _show(names: list[str], rows: list[list[str]]) -> None:
    from rich.text import Text

    from analyzer.cli.console import Console, table

    shown = table(*map(printable, names))
    for row in rows:
        shown.add_row(*map(Text, row))
    Console(highlight=False, width=None if sys.stdout.isatty() else 160).print(shown)
