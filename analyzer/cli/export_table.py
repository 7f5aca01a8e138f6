"""Export as a table: decode a capture, keep its rows, and write them once all is known."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import IO

from analyzer import __version__
from analyzer.cli.reading import OpenCapture, open_reading, progress, showing_progress
from analyzer.cli.signals import Interrupt
from analyzer.errors import UnreadableError, UsageError
from analyzer.pipeline import Item
from analyzer.sources.times import Clock
from analyzer.table.extras import needed
from analyzer.table.files import KINDS
from analyzer.table.rows import Recorded, Rows
from analyzer.table.tables import Chosen, Long, Table, Wide
from analyzer.values import counted


def export_table(arguments: argparse.Namespace, stream: IO[bytes], interrupt: Interrupt, target: Path | None) -> list[str]:
    """Write a table; return the lines that tell of it."""
    place = target or "standard output"
    kind = KINDS[arguments.to]
    if kind.package:
        needed(kind.package)
    reading = interrupt.opened(partial(open_reading, arguments.file, arguments))
    chosen = Chosen(_split(arguments.topics), _split(arguments.fields))
    with contextlib.closing(reading.source) as source, progress(source, f"decoding {source.name}"):
        chosen.check_possible(reading.possible)
        recorded = keep_rows(reading, interrupt.items(reading), None if target is None else target.parent)
    with contextlib.closing(recorded):
        if interrupt.asked:
            return []
        if not recorded.count:
            raise UsageError(f"{source.name} holds no traffic to export")
        wide = arguments.wide or arguments.rate is not None
        table: Table = Wide(recorded, chosen, arguments.rate) if wide else Long(recorded, chosen)
        written = 0

        def lines() -> Iterable[list[object]]:
            nonlocal written
            for line in interrupt.items(table.lines()):
                written += 1
                yield line

        with showing_progress(f"writing {place}", recorded.size, recorded.position):
            kind.write(table, lines(), stream)
    rows = [
        f"{source.name} ({source.title}) -> {place}",
        f"  {counted(written, 'row')}, {counted(len(table.columns), 'column')}",
    ]
    if recorded.comments:
        rows.append(f"left out: {counted(recorded.comments, 'comment')}: a table has no place for them")
    return rows + [f"note: {text}" for text in (*source.notes, *_notes(recorded, reading.has_times))]


def keep_rows(reading: OpenCapture, items: Iterable[Item], folder: Path | None = None) -> Recorded:
    """Decode a capture, or what is given of it, and keep its rows. `folder`: where they wait if they are many.

    Raises UnreadableError for one that breaks off before anything was read.
    """
    rows = Rows(folder)
    pipeline = reading.pipeline((rows,))
    recorded = rows.recorded
    source = reading.source
    try:
        try:
            for item in items:
                pipeline.feed(item)
        except UnreadableError as error:
            if not pipeline.sequence:
                raise
            recorded.about["incomplete"] = str(error)
        pipeline.close()
        rows.finish()
    except BaseException:
        recorded.close()
        raise
    recorded.dialects = tuple(reading.dialects)
    recorded.clock = source.clock
    recorded.times = reading.time_range.shown
    recorded.about |= {
        "version": __version__,
        "source": source.name,
        "format": source.format,
        "dialect": ",".join(d.name for d in reading.dialects),
        "manual": "; ".join(d.manual for d in reading.dialects),
        "model": reading.model,
        "time_source": reading.time_source,
        "clock": Clock(source.clock).value,
    }
    recorded.about = {name: text for name, text in recorded.about.items() if text}
    return recorded


def _split(given: Iterable[str]) -> list[str]:
    return [word.strip() for text in given for word in text.split(",") if word.strip()]


def _notes(recorded: Recorded, timed: bool) -> Iterable[str]:
    if "incomplete" in recorded.about:
        yield f"the capture is incomplete: {recorded.about['incomplete']}"
    if not timed:
        yield recorded.about["time_source"]
    elif not recorded.dated:
        yield "the capture has no dates: times are seconds" + (" of the day" if recorded.clock is Clock.DAY else "")
