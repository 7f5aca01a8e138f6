"""What the commands about lakes share: stores and their options."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from analyzer.errors import UsageError
from analyzer.fleet.files import PARTITIONS
from analyzer.fleet.lake import Lake, store_of
from analyzer.fleet.place import Place
from analyzer.values import quote

#: Options of fsspec for a store.
Options = Sequence[tuple[str, str]]


def add_store_argument(
    parser: argparse.ArgumentParser,
    name: str = "--store",
    help: str = "an option of fsspec for buckets and servers, as endpoint_url=http://minio:9000; may be repeated",
) -> None:
    """Add an option for what a store needs: `Options`."""
    parser.add_argument(name, action="append", default=[], type=_option, metavar="NAME=VALUE", help=help)


def _option(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name.isidentifier():
        raise argparse.ArgumentTypeError(f"expected NAME=VALUE, as endpoint_url=http://minio:9000, got {quote(text)}")
    return name, value


def lake(url: str, options: Options, *, make: bool = False, partitions: str | None = None) -> Lake:
    """Return a lake. `make`: make it if it is not there; `partitions`: what it has to be partitioned by.

    Raises UsageError for a place where none can be, or for a lake that is partitioned otherwise.
    """
    # What a lake cannot be at is told before a package for it is asked for.
    store_of(url)
    found = Lake(place(url, options), make=make, partitions=PARTITIONS if partitions is None else partitions.split(","))
    own = ",".join(found.destination.partitions)
    if partitions not in (None, own):
        raise UsageError(f"{found.place.url} is partitioned by {own}, and stays so: --partition-by is for a new lake")
    return found


def beside(target: Path, url: str) -> None:
    """Raise UsageError where a file that is to be written lies in the lake that is read."""
    if target.resolve().is_relative_to(Path(url.removeprefix("file://")).resolve()):
        raise UsageError(f"{target} lies in the lake, which is only read: choose another name with -o")


def place(url: str, options: Options) -> Place:
    """Return a place; a folder takes no options. Raises UsageError."""
    return Place(url, dict(options) if "://" in url and not url.startswith("file://") else {})
