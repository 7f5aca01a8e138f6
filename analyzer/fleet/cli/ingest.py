"""Take the captures of a fleet into one lake of tables: each content once, decoded on all cores or on a cluster.

What is there already is passed over, so the same command can run every night. The tables are those of Delta Lake.
"""

from __future__ import annotations

import argparse
import json
import sys
import time

from analyzer.cli.decode import cores
from analyzer.cli.option_types import positive
from analyzer.cli.reading import add_reading_arguments, showing_progress, tell_notes
from analyzer.cli.signals import Interrupt
from analyzer.fleet.cli.stores import add_store_argument, lake, place
from analyzer.fleet.files import PARTITIONS
from analyzer.fleet.ingest import Ingest, Outcome, Pattern, workers, works
from analyzer.table.extras import needed
from analyzer.values import counted, printable

#: What a lake can be partitioned by.
_PARTITIONS = (",".join(PARTITIONS), "date")
#: Captures that are named because they could not be taken.
_NAMED = 20
_WHY = "select name, reason from captures where status in ('unreadable', 'failed')"

EXAMPLES = """\
examples:
  servotap ingest captures/ --to lake/
  servotap ingest hall/ --to lake/ --machine '{machine}/{date}/*'
  servotap ingest s3://plant/captures --to s3://plant/lake --store endpoint_url=http://minio:9000
  servotap ingest sftp://hall/in --to s3://plant/lake --store username=me --lake-store endpoint_url=http://minio:9000
  servotap ingest s3://plant/captures --to s3://plant/lake --scheduler tcp://scheduler:8786
  servotap ingest hall/ --to lake/ --machine '{machine}/{date}/*' --partition-by date      few small captures a machine
  servotap ingest captures/ --to lake/ --retry         those that could not be read, too
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "sources", nargs="+", metavar="SOURCE", help="folders or files, by path or URL of fsspec (s3://, sftp://, ...)"
    )
    parser.add_argument(
        "--to", required=True, metavar="LAKE", help="the lake: a folder, or s3://, gs://, abfs://; made where it is not"
    )
    parser.add_argument(
        "--machine", metavar="PATTERN",
        help="what a path below SOURCE says, as '{machine}/{date}/*' (default: what a servotap.toml beside them names)",
    )  # fmt: skip
    parser.add_argument(
        "--scheduler", default="local", metavar="URL", help="a scheduler of Dask, tcp://HOST:8786 (default: this machine)"
    )
    parser.add_argument(
        "--workers", type=positive, default=cores(), metavar="N", help="processes on this machine (default: the cores)"
    )
    parser.add_argument(
        "--partition-by", choices=_PARTITIONS, metavar="COLUMNS",
        help="for a new lake: date,machine (default), or date where a machine brings few small captures a day",
    )  # fmt: skip
    parser.add_argument("--retry", action="store_true", help="try again what could not be read before")
    parser.add_argument("--json", action="store_true", help="print the outcome as JSON")
    add_store_argument(parser)
    add_store_argument(parser, "--lake-store", "the same for LAKE, where it needs others: --store is then for SOURCE alone")
    add_reading_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Ingest; return 0, or 2 if a capture could not be taken."""
    for package in ("pyarrow", "deltalake", "distributed"):
        needed(package)
    pattern = None if arguments.machine is None else Pattern(arguments.machine)
    sources = [place(url, arguments.store) for url in arguments.sources]
    options = arguments.lake_store or arguments.store
    with Interrupt() as interrupt:
        to = interrupt.opened(lambda: lake(arguments.to, options, make=True, partitions=arguments.partition_by))
        outcome, started = Outcome(), time.monotonic()
        outcome.recovered = to.recover()
        found = interrupt.opened(lambda: works(sources, to, pattern, arguments.retry, outcome))
        if found:
            with (
                workers(arguments.scheduler, min(arguments.workers, len(found))) as client,
                showing_progress(outcome.told, outcome.size, lambda: outcome.read, lambda: outcome.frames),
            ):
                Ingest(to, arguments, outcome, interrupt).run(client, found)
    _report(arguments, outcome, time.monotonic() - started)
    if interrupt.asked:
        raise KeyboardInterrupt
    return 2 if outcome.unread else 0


def _report(arguments: argparse.Namespace, outcome: Outcome, seconds: float) -> None:
    if arguments.json:
        print(json.dumps(outcome.as_object() | {"seconds": round(seconds, 3)}))
        return
    for name, reason in outcome.unread[:_NAMED]:
        print(f"servotap ingest: {printable(name)}: {reason}", file=sys.stderr)
    if len(outcome.unread) > _NAMED:
        more = counted(len(outcome.unread) - _NAMED, "more capture")
        print(f'servotap ingest: and {more}: servotap ask {arguments.to} "{_WHY}"', file=sys.stderr)
    tell_notes(outcome.notes)
    if outcome.recovered:
        print(f"finished what an earlier ingest had begun to commit ({outcome.recovered} at once)")
    rate = f", {outcome.frames / seconds:,.0f} frames/s" if outcome.frames else ""
    print(
        f"{arguments.to}: {counted(outcome.new, 'new capture')} of {outcome.files:,} ({outcome.known:,} known, "
        f"{len(outcome.unread):,} not read): {counted(outcome.read, 'byte')}, {counted(outcome.frames, 'frame')}{rate}"
    )
