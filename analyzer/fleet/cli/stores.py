"""What the commands about lakes share: stores and their options."""

from __future__ import annotations

import argparse

from analyzer.errors import UsageError
from analyzer.fleet.files import PARTITIONS
from analyzer.fleet.lake import Lake, store_of
from analyzer.fleet.place import Place
from analyzer.values import quote


def add_store_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option for what a store needs."""
    parser.add_argument(
        "--store", action="append", default=[], metavar="NAME=VALUE",
        help="an option of fsspec for buckets and servers, as endpoint_url=http://minio:9000; may be repeated",
    )  # fmt: skip


def lake(arguments: argparse.Namespace, url: str, *, make: bool = False, partitions: str | None = None) -> Lake:
    """Return a lake. `make`: make it if it is not there; `partitions`: what it has to be partitioned by.

    Raises UsageError for a place where none can be, or for a lake that is partitioned otherwise.
    """
    # What a lake cannot be at is told before a package for it is asked for.
    store_of(url)
    found = Lake(place(url, arguments), make=make, partitions=PARTITIONS if partitions is None else partitions.split(","))
    own = ",".join(found.destination.partitions)
    if partitions not in (None, own):
        raise UsageError(f"{found.place.url} is partitioned by {own}, and stays so: --partition-by is for a new lake")
    return found


def place(url: str, arguments: argparse.Namespace) -> Place:
    """Return a place with the options that the user gave. Raises UsageError."""
    options = {}
    for word in arguments.store:
        name, equals, value = word.partition("=")
        if not equals or not name.isidentifier():
            raise UsageError(f"--store {quote(word)}: expected NAME=VALUE, as endpoint_url=http://minio:9000")
        options[name] = value
    return Place(url, options if "://" in url and not url.startswith("file://") else {})
