"""What callers of the Python API may give. It is checked where it comes in, so that no error speaks of our inside."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Collection, Mapping
from decimal import Decimal
from numbers import Real
from typing import Any, NamedTuple

from analyzer.errors import UsageError

_LONGEST = 60


class _Kind(NamedTuple):
    """What an argument may be: a test, and the words for it."""

    fits: Callable[[Any], bool]
    words: str


def _optional(kind: _Kind) -> _Kind:
    return _Kind(lambda value: value is None or kind.fits(value), f"{kind.words} or None")


def _is_number(value: Any) -> bool:
    if isinstance(value, (Real, Decimal)) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError, ValueError):
            return math.isfinite(float(value))
    return False


def _list_of(kind: _Kind) -> _Kind:
    def fits(value: Any) -> bool:
        return isinstance(value, Collection) and not isinstance(value, (str, bytes)) and all(map(kind.fits, value))

    return _Kind(fits, f"a list, each of them {kind.words}")


_TEXT = _Kind(lambda value: isinstance(value, str), "a text")
_PATH = _Kind(lambda value: isinstance(value, (str, os.PathLike)) and isinstance(os.fspath(value), str), "a path")
_NUMBER = _Kind(lambda value: isinstance(value, int) and not isinstance(value, bool), "a whole number")
_REAL = _Kind(_is_number, "a number")
#: Of a time: nanoseconds of it still fit into 64 bits.
_SECONDS = _Kind(lambda value: _is_number(value) and 0 <= value < 1e9, "seconds from 0 on, below 1e9")
_VALUE = _Kind(lambda value: isinstance(value, (str, bytes, bool)) or _is_number(value), "a number, or a text")
_FLAG = _Kind(lambda value: isinstance(value, bool), "True or False")
_FRAME = _Kind(lambda value: isinstance(value, (str, bytes, bytearray, memoryview)), "hex as a text, or bytes")
_KINDS: Mapping[str, _Kind] = {
    "path": _Kind(lambda value: _PATH.fits(value) and bool(os.fspath(value)), "a path, as str or os.PathLike"),
    "dialect": _TEXT,
    "model": _optional(_TEXT),
    "baud": _optional(_NUMBER),
    "format": _optional(_TEXT),
    "channels": _list_of(_TEXT),
    "uart": _TEXT,
    "groups": _list_of(_NUMBER),
    "ids": _TEXT,
    "dbc": _list_of(_PATH),
    "modbus_map": _list_of(_PATH),
    "since": _optional(_TEXT),
    "until": _optional(_TEXT),
    "names": _list_of(_TEXT),
    "name": _TEXT,
    "on": _TEXT,
    "allow": _Kind(lambda value: _TEXT.fits(value) or _list_of(_TEXT).fits(value), "risks, as {'motion'}"),
    "max_speed": _optional(_REAL),
    "max_turns": _optional(_REAL),
    "max_acceleration": _optional(_REAL),
    "max_current": _optional(_REAL),
    "subdivision": _optional(_NUMBER),
    "alone": _FLAG,
    "max_run": _SECONDS,
    "cut_power": _TEXT,
    "timeout": _SECONDS,
    "log": _optional(_PATH),
    "command": _TEXT,
    "field": _TEXT,
    "seconds": _SECONDS,
    "frame": _FRAME,
    "request": _optional(_FRAME),
    "listed": _Kind(lambda value: _TEXT.fits(value) or _list_of(_TEXT).fits(value), "names, as a text or a list of texts"),
    "url": _PATH,
    "table": _TEXT,
    "query": _TEXT,
}


def check(**given: Any) -> None:
    """Raise UsageError for the first argument that is not of its kind."""
    for name, value in given.items():
        _check(name, value, _KINDS[name])


def check_values(values: Mapping[str, Any]) -> None:
    """Raise UsageError for the first value of a command that is neither a number nor a text."""
    for name, value in values.items():
        _check(name, value, _VALUE)


def _check(name: str, value: Any, kind: _Kind) -> None:
    if not kind.fits(value):
        text = repr(value)
        shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
        raise UsageError(f"{name}: expected {kind.words}, got {shown}")
