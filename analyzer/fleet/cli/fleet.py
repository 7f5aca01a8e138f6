"""Write a page about a lake: how machines and drives are, and what got worse in the last days."""

from __future__ import annotations

import argparse
from pathlib import Path

from analyzer.cli.output import free_target, write_whole
from analyzer.fleet.ask import Question, answering
from analyzer.fleet.cli.stores import add_store_argument, beside, lake
from analyzer.fleet.health import health, html
from analyzer.table.extras import needed
from analyzer.values import counted

EXAMPLES = """\
examples:
  servotap fleet lake/ -o fleet.html
  servotap fleet s3://plant/lake -o fleet.html --force
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("lake", metavar="LAKE", help="a folder, or s3://, gs://, abfs://")
    parser.add_argument("-o", "--output", required=True, metavar="OUT.html", help="the page")
    parser.add_argument("--force", action="store_true", help="replace a page that exists")
    add_store_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write the page; return 0."""
    for package in ("pyarrow", "deltalake", "duckdb"):
        needed(package)
    target = free_target(Path(arguments.output), arguments.force)
    question = Question(lake(arguments.lake, arguments.store))
    beside(target, arguments.lake)
    with answering():
        found = health(question)
    data = html(found).encode(errors="backslashreplace")
    write_whole(target, data, replace=arguments.force)
    worse = sum(each.worse for each in found.changes)
    print(f"{arguments.lake}: {counted(found.totals['captures'], 'capture')}, {worse} got worse; wrote {target}")
    return 0
