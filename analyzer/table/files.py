"""Tables in files: CSV, Parquet, Excel. Which one, the end of the file's name says.

    CSV       time as ISO 8601 to the nanosecond, units in the header, nothing where there is no value
    Parquet   types and nanoseconds kept, unit, section and manual in the metadata of each column
    Excel     times to the millisecond, as shown; a second sheet says what the columns mean

A file is written from the beginning to the end, in bounded memory.
"""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Callable, Iterable
from datetime import datetime, timedelta
from typing import IO, Any, NamedTuple

from analyzer.codec import EXACT
from analyzer.errors import UsageError
from analyzer.sources.times import Clock
from analyzer.table.arrow import write_parquet
from analyzer.table.columns import Kind
from analyzer.table.extras import needed
from analyzer.table.tables import Table
from analyzer.values import SECOND_NS

_EPOCH = datetime(1970, 1, 1)
#: What Excel holds: rows of a sheet, the header aside; columns; characters of a cell.
EXCEL_ROWS, EXCEL_COLUMNS = 1_048_575, 16_384
_EXCEL_TEXT = 32_000
_SHEET = "servotap"


class TableFile(NamedTuple):
    """A kind of file. `package`: what writes it, empty for nothing besides Python."""

    title: str
    write: Callable[[Table, Iterable[list[Any]], IO[bytes]], None]
    package: str = ""


def _time_text(table: Table) -> Callable[[int], str]:
    recorded = table.recorded
    return recorded.times.iso if recorded.dated else _seconds


def _seconds(t_ns: int) -> str:
    return f"{'-' if t_ns < 0 else ''}{abs(t_ns) // SECOND_NS}.{abs(t_ns) % SECOND_NS:09d}"


def headings(table: Table) -> list[str]:
    """Return the header of a table whose file has no other place for units."""
    texts = [c.heading for c in table.columns]
    return texts if table.recorded.dated else [text + " [s]" if text == "time" else text for text in texts]


def write_csv(table: Table, lines: Iterable[list[Any]], stream: IO[bytes]) -> None:
    """Write CSV in UTF-8."""
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=False)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings(table))
    shown = _time_text(table)
    flags = [n for n, c in enumerate(table.columns) if c.kind is Kind.FLAG]
    for line in lines:
        line[0] = shown(line[0])
        for n in flags:
            if line[n] is not None:
                line[n] = "true" if line[n] else "false"
        writer.writerow(line)
    text.flush()
    text.detach()


def write_xlsx(table: Table, lines: Iterable[list[Any]], stream: IO[bytes]) -> None:
    """Write Excel; what does not fit one sheet goes on in the next."""
    if len(table.columns) > EXCEL_COLUMNS:
        raise UsageError(
            f"{len(table.columns)} columns, and Excel holds {EXCEL_COLUMNS}: choose some with --topics or --fields"
        )
    writer, out = needed("xlsxwriter"), _Released(stream)
    # What it keeps of each sheet until the end goes away with the folder, however this ends.
    with tempfile.TemporaryDirectory(prefix=".", dir=table.recorded.folder) as folder:
        try:
            _write_book(writer.Workbook(out, {"constant_memory": True, "tmpdir": folder}), table, lines)
        except writer.exceptions.FileCreateError as error:
            raise error.args[0] from None
        finally:
            out.release()


class _Released:
    """A file as an archive writes it. Once released, it drops what is written and only counts it.

    XlsxWriter leaves its archive open when it fails, and the archive closes itself, and writes, at any later time.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream: IO[bytes] = stream

    def release(self) -> None:
        self._stream = _Counting(self._stream.tell())

    def write(self, data: bytes) -> int:
        return self._stream.write(data)

    def seek(self, place: int, whence: int = 0) -> int:
        return self._stream.seek(place, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def flush(self) -> None:
        self._stream.flush()


class _Counting(io.BytesIO):
    """A place in a file, without the file."""

    def __init__(self, place: int) -> None:
        super().__init__()
        self._place = place

    def write(self, data: Any) -> int:
        self._place += len(data)
        return len(data)

    def seek(self, place: int, whence: int = 0) -> int:
        self._place = place + (self._place if whence else 0)
        return self._place

    def tell(self) -> int:
        return self._place


def _write_book(book: Any, table: Table, lines: Iterable[list[Any]]) -> None:
    # A text that begins with = is written as a text; what is longer than a cell holds is cut.
    bold = book.add_format({"bold": True})
    moment = book.add_format({"num_format": "yyyy-mm-dd hh:mm:ss.000"})
    recorded = table.recorded
    dated, zone_ns = recorded.dated, recorded.times.zone_ns
    names = headings(table)
    if dated and recorded.clock is not Clock.PRINTED:
        names[0] = f"time [{recorded.times.zone or 'UTC'}]"
    sheet, row, number = None, 0, 0
    for line in lines:
        if sheet is None or row > EXCEL_ROWS:
            number += 1
            sheet = _sheet(book, bold, names, number)
            row = 1
        if dated:
            sheet.write_datetime(row, 0, _EPOCH + timedelta(microseconds=(line[0] + zone_ns(line[0])) // 1000), moment)
        else:
            sheet.write_number(row, 0, line[0] / SECOND_NS)
        for place, value in enumerate(line[1:], 1):
            if value is None:
                continue
            if isinstance(value, bool):
                sheet.write_boolean(row, place, value)
            elif isinstance(value, str) or (isinstance(value, int) and abs(value) > EXACT):
                text = str(value)
                sheet.write_string(row, place, text if len(text) <= _EXCEL_TEXT else text[:_EXCEL_TEXT] + " ...")
            else:
                sheet.write_number(row, place, value)
        row += 1
    if sheet is None:
        _sheet(book, bold, names, 1)
    about = book.add_worksheet("columns")
    for place, (heading, column) in enumerate([("column", None), *zip(names, table.columns, strict=True)]):
        told = {} if column is None else column.about
        words = ("unit", "section", "manual", "note", "choices")
        for at, text in enumerate([heading, *(words if column is None else [told.get(word, "") for word in words])]):
            about.write_string(place, at, text, bold if column is None else None)
    book.close()


def _sheet(book: Any, bold: Any, names: list[str], number: int) -> Any:
    sheet = book.add_worksheet(_SHEET if number == 1 else f"{_SHEET} {number}")
    sheet.freeze_panes(1, 1)
    sheet.set_column(0, 0, 24)
    for place, name in enumerate(names):
        sheet.write_string(0, place, name, bold)
    return sheet


#: By the end of a file's name.
KINDS: dict[str, TableFile] = {
    "csv": TableFile("CSV", write_csv),
    "parquet": TableFile("Parquet", write_parquet, "pyarrow"),
    "xlsx": TableFile("Excel", write_xlsx, "xlsxwriter"),
}
