"""Values that several commands take as options, and how such values are shown.

A type of an option returns the value of a text, or says what it expected. Times are written as 10s, 5min, 2h; sizes as 500kB,
100MB, 2GiB.
"""

from __future__ import annotations

import argparse
import contextlib
import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple, TypeVar

from analyzer.errors import UsageError
from analyzer.values import SECOND_NS, addresses, quote, storable

Number = TypeVar("Number", int, float)

DURATIONS = {
    "ms": SECOND_NS // 1000,
    "s": SECOND_NS,
    "min": 60 * SECOND_NS,
    "m": 60 * SECOND_NS,
    "h": 3600 * SECOND_NS,
    "d": 86400 * SECOND_NS,
}
SIZES = {
    "B": 1,
    "kB": 1000, "MB": 1000**2, "GB": 1000**3, "TB": 1000**4,
    "KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30, "TiB": 1 << 40,
}  # fmt: skip
_ANY_CASE = {name.lower(): size for name, size in SIZES.items()}
_AMOUNT = re.compile(r"(\d+(?:\.\d+)?)\s*([A-Za-z]+)")


def number(expected: str, read: Callable[[str], Number], fits: Callable[[Number], bool]) -> Callable[[str], Number]:
    """Return the type of an option that takes a number. `expected`: which, in words, for the error about any other text."""

    def taken(text: str) -> Number:
        with contextlib.suppress(ValueError):
            value = read(text)
            if fits(value):
                return value
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text}")

    return taken


positive = number("a number above 0", int, lambda value: value > 0)
whole = number("a number from 0 on", int, lambda value: value >= 0)
#: Of any dialect.
address = number("an address 0..0x7FF", lambda text: int(text, 0), lambda value: 0 <= value <= 0x7FF)
milliseconds = number("milliseconds above 0", float, lambda value: 0 < value < 1e9)


def utf8(text: str) -> str:
    """Return a text that is UTF-8: what the parts of a recording tell each other is."""
    if text != storable(text):
        raise argparse.ArgumentTypeError(f"expected a name in UTF-8, got {quote(text)}")
    return text


class Ids(NamedTuple):
    """Who is a drive, as the user says: on all buses, or by bus."""

    everywhere: frozenset[int] | None = None
    by_bus: Mapping[str, frozenset[int]] = {}

    def of(self, bus: str) -> frozenset[int] | None:
        """Return who is a drive on a bus, None where it was not said."""
        return self.by_bus.get(bus, self.everywhere)


def ids_of(texts: Sequence[str]) -> Ids:
    """Return who is a drive: texts as `1,2,0x123-0x12F`, or `BUS=1,2` for one bus. Raises UsageError."""
    found: dict[str, frozenset[int]] = {}
    for text in texts:
        bus, _, listed = text.rpartition("=")
        found[bus] = found.get(bus, frozenset()) | frozenset(addresses(listed, "--ids", 0))
    return Ids(found.pop("", None), found)


def add_model_argument(parser: argparse.ArgumentParser, **more: Any) -> None:
    """Add the option --model."""
    parser.add_argument("--model", metavar="M", help="limits and units of a model: 42D 57D 28D 35D 42E 57E MF MG MH MS", **more)


def add_device_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options for files that describe other devices of a bus."""
    parser.add_argument(
        "--dbc", action="append", default=[], metavar="FILE", help="messages of other CAN nodes; may be repeated"
    )
    parser.add_argument(
        "--modbus-map", action="append", default=[], metavar="FILE.csv",
        help="registers of other Modbus slaves; may be repeated",
    )  # fmt: skip


def add_group_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option --group."""
    parser.add_argument(
        "--group", action="append", type=address, default=[], metavar="ADDRESS",
        help="a group address: several drives listen, none answers; may be repeated",
    )  # fmt: skip


def add_ids_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option --ids."""
    parser.add_argument(
        "--ids", action="append", default=[], metavar="[BUS=]LIST",
        help="who is a drive, as 1,2,0x123-0x12F: frames of others are kept, and nothing is found wrong with them",
    )  # fmt: skip


def duration_ns(text: str) -> int:
    """Return a time in nanoseconds: 10s, 1.5h, 250ms. Raises UsageError."""
    found = _amount(text, DURATIONS)
    if not found:
        raise UsageError(f"got {quote(text)}, expected a time above 0, as in 10s, 5min or 2h")
    return found


def size_bytes(text: str) -> int:
    """Return a size in bytes: 500kB, 100MB, 2GiB; the letters' case does not count. Raises UsageError."""
    found = _amount(text.lower(), _ANY_CASE)
    if not found:
        raise UsageError(f"got {quote(text)}, expected a size above 0, as in 100MB or 2GiB")
    return found


def is_size(text: str) -> bool:
    """Say whether a text has the unit of a size."""
    match = _AMOUNT.fullmatch(text.strip())
    return match is not None and match[2].lower() in _ANY_CASE


def _amount(text: str, units: dict[str, int]) -> int:
    match = _AMOUNT.fullmatch(text.strip())
    if match is None or match[2] not in units:
        return 0
    return int(Fraction(match[1]) * units[match[2]])


def size_text(size: float) -> str:
    """Return a size for reading: 1.4 MB."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:.1f} {unit}"
    return f"{size:.0f} B"


def duration_text(ns: int) -> str:
    """Return a time for reading: 2.5 s, 4:07 min, 1:02:33 h."""
    seconds = ns / 1e9
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(int(seconds), 60)
    if minutes < 60:
        return f"{minutes}:{rest:02d} min"
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d} h"
