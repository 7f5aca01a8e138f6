"""Join the small files of a lake, and remove files that no table has needed for some days."""

from __future__ import annotations

import argparse

from analyzer.errors import UsageError
from analyzer.fleet.cli.stores import add_store_argument, lake
from analyzer.table.extras import needed
from analyzer.values import counted

EXAMPLES = """\
examples:
  servotap compact lake/
  servotap compact s3://plant/lake --keep 30          old versions of tables can be read for 30 days
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("lake", metavar="LAKE", help="a folder, or s3://, gs://, abfs://")
    parser.add_argument(
        "--keep", type=float, default=7.0, metavar="DAYS",
        help="files that readers or writers may still need are kept so long (default 7)",
    )  # fmt: skip
    add_store_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Compact; return 0."""
    needed("deltalake")
    if not 0 <= arguments.keep <= 36_500:
        raise UsageError(f"--keep {arguments.keep:g}: expected days, 0 or more")
    opened = lake(arguments.lake, arguments.store)
    opened.recover()
    joined, removed = opened.compact(arguments.keep)
    print(f"{arguments.lake}: joined {counted(joined, 'file')}, removed {counted(removed, 'file')}")
    return 0
