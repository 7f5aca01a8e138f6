"""Small captures, and what stands in a lake."""

from __future__ import annotations

import argparse
import random
from pathlib import Path

from analyzer import dialects
from analyzer.cli.reading import add_reading_arguments
from analyzer.cli.signals import Interrupt
from analyzer.fleet.ask import Question
from analyzer.fleet.ingest import Ingest, Outcome, Pattern, tasks, works
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from analyzer.fleet.ranges import do
from tests.columns.can_traffic import frames


def candump(seed: int, count: int = 40, busy: float = 0.0) -> str:
    """Return a candump log of MKS drives, some of its exchanges odd."""
    sent = frames(dialects.get("mks-can"), random.Random(seed), count, busy, 0.1, polls=("read_speed", "read_enabled"))
    return "".join(f"({f.t_ns / 1e9:.6f}) can0 {f.id:03X}#{f.data.hex()}\n" for f in sent if not f.extended)


def hall(folder: Path, count: int, first: int = 0) -> Path:
    """Write captures of two machines into a folder, and something that is none."""
    for number in range(first, first + count):
        path = folder / f"m{number % 2}" / "2026-03-01" / f"{number}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(candump(number))
    (folder / "notes.txt").write_text("the hall was cold\n")
    return folder


def lake(folder: Path) -> Lake:
    """Return a new lake in a folder."""
    return Lake(Place(str(folder)), make=True)


def options() -> argparse.Namespace:
    """Return the options of reading as they are by default."""
    parser = argparse.ArgumentParser()
    add_reading_arguments(parser)
    return parser.parse_args([])


class Finished:
    """A future of a client without workers."""

    def __init__(self, call, *arguments):
        self.status = "finished"
        try:
            self._result = call(*arguments)
        except Exception as error:
            self.status, self._error = "error", error

    def result(self):
        return self._result

    def exception(self):
        return self._error


def ingest(lake: Lake, *folders: Path | Place, retry: bool = False, pattern: str | None = "{machine}/{date}/*") -> Outcome:
    """Take captures into a lake, here and now."""
    outcome = Outcome()
    outcome.recovered = lake.recover()
    said = None if pattern is None else Pattern(pattern)
    found = works([each if isinstance(each, Place) else Place(str(each)) for each in folders], lake, said, retry, outcome)
    work = Ingest(lake, options(), outcome, Interrupt())
    left = tasks(found, 1)
    while left:
        task = left.pop(0)
        left += work.ended(task, Finished(do, task, lake.destination, options()))
    work.commit()
    return outcome


def rows(lake: Lake) -> dict[str, list[dict]]:
    """Return all rows of a lake by table, in a fixed order, without what differs from one ingest to the next."""
    question = Question(lake)
    found = {}
    for name in question.tables:
        table = question.dataset(name).to_table().to_pylist()
        for row in table:
            for changing in ("batch", "ingested_at", "source", "mark", "name"):
                row.pop(changing, None)
        found[name] = sorted(table, key=repr)
    return {name: table for name, table in found.items() if table}
