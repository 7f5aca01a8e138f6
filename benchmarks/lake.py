"""A lake: what ingesting costs beside decoding alone, how it grows with captures and workers, and what a question costs.

    python benchmarks/lake.py [--frames 500000] [--files 4] [--rounds 1] [--small 10000] [--rows 100000000]

Captures are made: candump logs of four drives that are polled, with values that the manual allows. One worker of
Dask and then two ingest the long ones, whole and in ranges; `servotap decode --to parquet --jobs 1` decodes them. Where the
machine has other work, the clock says nothing: CPU seconds of the busiest process then say what two workers would take. Small
ones are taken here, without Dask: CPU seconds of decoding alone, of taking them into files of a lake, of committing; 0 leaves
a part out. For the question, rows of `states` are generated as drives of 100 machines would give them.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
import pyarrow as pa

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer import dialects  # noqa: E402
from analyzer.cli.reading import add_reading_arguments, open_reading  # noqa: E402
from analyzer.cli.signals import Interrupt  # noqa: E402
from analyzer.fleet import ingest as ingesting  # noqa: E402
from analyzer.fleet import ranges as splitting  # noqa: E402
from analyzer.fleet.ask import Question  # noqa: E402
from analyzer.fleet.files import PARTITIONS  # noqa: E402
from analyzer.fleet.ingest import Ingest, Outcome, Pattern, tasks, workers, works  # noqa: E402
from analyzer.fleet.lake import Lake  # noqa: E402
from analyzer.fleet.place import Place  # noqa: E402
from analyzer.fleet.ranges import do  # noqa: E402
from analyzer.fleet.rows import decoded  # noqa: E402
from analyzer.sinks.parquet import ParquetTables  # noqa: E402
from tests.columns.can_traffic import frames  # noqa: E402

POLLS = ("read_encoder_carry", "read_speed", "read_pulses", "read_position", "read_angle_error")
#: Frames of a small capture.
SMALL = 100
QUESTION = (
    "select machine, avg(speed), max(temperature) from states where date = '2026-03-07' group by all order by 2 desc limit 5"
)
WHOLE = "select machine, address, quantile_cont(speed, 0.99), count(*) from states group by all order by 3 desc limit 5"


def capture(path: Path, count: int, seed: int) -> None:
    """Write a candump log."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as out:
        for f in frames(dialects.get("mks-can"), random.Random(seed), count, 0, 0, polls=POLLS):
            seconds, us = divmod((f.t_ns or 0) // 1000, 1_000_000)
            out.write(f"({seconds}.{us:06d}) can0 {f.id:03X}#{f.data.hex().upper()}\n")


def clock(call: Callable[[], object]) -> float:
    """Return the seconds that a call takes."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def cpu(call: Callable[[], object]) -> float:
    """Return the CPU seconds of this process that a call takes."""
    started = time.process_time()
    call()
    return time.process_time() - started


def options() -> argparse.Namespace:
    """Return the options of reading as they are by default."""
    parser = argparse.ArgumentParser()
    add_reading_arguments(parser)
    return parser.parse_args([])


class Nowhere:
    """A table that is not kept."""

    def write(self, rows: pa.Table) -> None:
        """Forget the rows."""

    def close(self) -> None:
        """Nothing is held."""


def decoded_alone(path: str, given: argparse.Namespace) -> None:
    """Decode a capture into tables that are not kept."""
    reading = open_reading(path, given)
    tables = ParquetTables(lambda name, schema: Nowhere(), reading.source.clock)
    decoded(reading, (tables,), lambda pipeline, item: pipeline.feed(item))
    tables.finish({})


class Cost(NamedTuple):
    """What some work took, in seconds: by the clock, and of CPU of the process that had most of it and of all together."""

    clock: float
    busiest: float
    all: float

    def __str__(self) -> str:
        return f"{self.clock:.1f} s, CPU {self.all:.1f} s, of the busiest process {self.busiest:.1f} s"


def of_decode(path: Path, folder: Path) -> Cost:
    """Return the cost of decoding captures into tables, one after the other, each by one process."""
    command = [sys.executable, "-m", "analyzer", "decode", "--to", "parquet", "--jobs", "1", "--force", "-o", str(folder)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = clock(lambda: subprocess.run([*command, path], check=True, stdout=subprocess.DEVNULL, cwd=ROOT))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(seconds, used, used)


def of_ingest(source: Path, lake: Lake, number: int, *, ranges: int = 0) -> Cost:
    """Return the cost of ingesting captures by workers that have loaded all. `ranges`: the size of one; 0: none is split."""
    found = works([Place(str(source))], lake, Pattern("{machine}/{date}/*"), False, Outcome())
    with patch.object(ingesting, "HUGE", 1 if ranges else 1 << 62), workers("local", number) as client:
        client.run(prepare, found[0].found.key, options(), ranges)
        before, own = client.run(time.process_time), time.process_time()
        seconds = clock(lambda: Ingest(lake, options(), Outcome(), Interrupt()).run(client, found))
        after = client.run(time.process_time)
        own = time.process_time() - own
    used = [after[each] - before[each] for each in after]
    return Cost(seconds, max(*used, own), sum(used) + own)


def prepare(path: str, given: argparse.Namespace, size: int) -> None:
    """Have a worker load all that it needs, and make ranges of a size."""
    decoded_alone(path, given)
    import_module("pyarrow.parquet")
    splitting.RANGE_BYTES = size or splitting.RANGE_BYTES


def median(costs: Sequence[Cost]) -> Cost:
    """Return the cost in the middle, by all CPU seconds."""
    return sorted(costs, key=lambda cost: cost.all)[len(costs) // 2]


def long_captures(folder: Path, files: int, count: int, rounds: int) -> None:
    """Print what one and two workers take for long captures, beside decoding alone, and for one capture in ranges."""
    source, small, frames = folder / "long", folder / "few" / "m" / "2026-03-01" / "a.log", files * count
    for number in range(files):
        capture(source / f"m{number}" / "2026-03-01" / "a.log", count, number)
    # What a start costs is no decoding.
    capture(small, SMALL, 0)
    paths, ways = sorted(source.rglob("*.log")), (("", 0), (", in ranges", 8 << 20))

    def decoding() -> Cost:
        start = of_decode(small, folder)
        each = [of_decode(path, folder) for path in paths]
        return Cost(*(sum(column) - files * least for column, least in zip(zip(*each, strict=True), start, strict=True)))

    def taking(number: int, size: int) -> Cost:
        place = Place(str(folder / "lake"))
        cost = of_ingest(source, Lake(place, make=True), number, ranges=size)
        shutil.rmtree(place.root)
        return cost

    found: dict[tuple[str, int], list[Cost]] = {}
    # In turns: the machine may have other work.
    for _ in range(rounds):
        found.setdefault(("", 0), []).append(decoding())
        for what, size in ways:
            for number in (1, 2):
                found.setdefault((what, number), []).append(taking(number, size))
    alone = median(found["", 0])
    print(f"| decode --to parquet, one process, without its start | {frames:,} frames | {alone} | |")
    for what, _ in ways:
        one, two = median(found[what, 1]), median(found[what, 2])
        told = f"{one}, {frames / one.all:,.0f} frames/s"
        ratios = f"{alone.all / one.all:.2f} of decode, without the client {alone.all / one.busiest:.2f}"
        print(f"| ingest{what}, 1 worker | {frames:,} frames | {told} | {ratios} |")
        told = f"{one.busiest / two.busiest:.2f} times one, by the clock {one.clock / two.clock:.2f}"
        print(f"| ingest{what}, 2 workers | {frames:,} frames | {two} | {told} |")


def small_captures(folder: Path, count: int, a_day: int, partitions: tuple[str, ...], first: int) -> None:
    """Print what small captures cost, in steps of ten times as many. `a_day`: of them for each of 200 machines."""
    source = folder / f"small{a_day}"
    for number in range(0 if source.exists() else count):
        day, machine = divmod(number // a_day, 200)
        capture(source / f"m{machine}" / f"2026-{1 + day // 28:02d}-{1 + day % 28:02d}" / f"{number}.log", SMALL, number)
    size = first
    while size <= count:
        lake = Lake(Place(str(folder / f"lake{a_day}{len(partitions)}-{size}")), make=True, partitions=partitions)
        found = works([Place(str(source))], lake, Pattern("{machine}/{date}/*"), False, Outcome())[:size]
        alone = cpu(lambda found=found: [decoded_alone(work.found.key, options()) for work in found])
        made: list = []
        to = lake.destination
        taking = cpu(lambda found=found, to=to, made=made: made.extend(do(each, to, options()) for each in tasks(found, 1)))
        committing = cpu(lambda lake=lake, made=made: lake.commit(made))
        more = (taking + committing - alone) / size * 1000
        files = sum(len(each.added) for each in made)
        told = f"decoding {alone:.2f}, files {taking - alone:.2f}, commit {committing:.2f} CPU s, {files:,} files"
        what = f"small captures, {a_day} a machine and day, by {' and '.join(partitions)}"
        print(f"| {what} | {size:,} | {told} | {more:.2f} ms more than decoding each |", flush=True)
        size *= 10


def states(rows: int) -> Iterator[tuple[str, int, pa.Table]]:
    """Yield rows of `states` by day and machine: 30 days of 100 machines."""
    chance, each = np.random.default_rng(7), max(1, rows // 3000)
    for day in range(30):
        for machine in range(100):
            base = 1_772_323_200_000_000_000 + day * 86_400_000_000_000
            times = base + np.sort(chance.integers(0, 86_400_000_000_000, each))
            table = {
                "capture": np.full(each, f"{day:032}{machine:032}"),
                "time": pa.array(times // 1000).cast(pa.timestamp("us", "UTC")),
                "time_ns": times,
                "bus": np.full(each, "can0"),
                "address": chance.integers(1, 5, each),
                "sequence": np.arange(each),
            }
            normal = {
                "position": (0, 1e4),
                "speed": (600, 200),
                "current": (1, 0.2),
                "voltage": (24, 0.1),
                "temperature": (40, 5),
            }
            yield f"m{machine}", day, pa.table(table | {name: chance.normal(*of, each) for name, of in normal.items()})


def questions(folder: Path, rows: int) -> None:
    """Print what questions over many rows cost."""
    import pyarrow.parquet as parquet

    lake = Lake(Place(str(folder / "asked")), make=True)
    made, schema = [], None
    for machine, day, table in states(rows):
        schema = table.schema
        path = folder / "asked" / "states" / f"{machine}-{day}.parquet"
        path.parent.mkdir(exist_ok=True)
        parquet.write_table(table, path, compression="zstd", compression_level=1)
        values = {"date": f"2026-03-{day + 1:02d}", "machine": machine}
        made.append({"path": path.name, "size": path.stat().st_size, "values": values, "count": table.num_rows})
    lake.table("states", schema)
    lake._commit_files("made", "states", made)
    for name, query in (("one day of thirty", QUESTION), ("all rows", WHOLE)):
        question = Question(lake)
        seconds = clock(lambda question=question, query=query: question.sql(query).to_arrow_table())
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        size = sum(each["size"] for each in made) / 1e9
        print(f"| a question, {name} | {rows:,} rows, {size:.2f} GB | {seconds:.2f} s | {peak:.0f} MiB |")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=500_000)
    parser.add_argument("--files", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=1, help="turns of decoding and ingesting, of which the middle one counts")
    parser.add_argument("--small", type=int, default=10_000)
    parser.add_argument("--rows", type=int, default=100_000_000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print("| work | size | cost | ratio |\n| --- | --- | --- | --- |")
        print(f"load before: {os.getloadavg()[0]:.1f}", file=sys.stderr)
        if arguments.files:
            long_captures(Path(folder), arguments.files, arguments.frames, arguments.rounds)
        if arguments.small:
            small_captures(Path(folder), arguments.small, 20, PARTITIONS, 10)
            small_captures(Path(folder), arguments.small, 2, PARTITIONS, arguments.small)
            small_captures(Path(folder), arguments.small, 2, ("date",), 10)
        if arguments.rows:
            questions(Path(folder), arguments.rows)


if __name__ == "__main__":
    main()
