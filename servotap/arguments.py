"""What callers of the Python API may give. It is checked where it comes in, so that no error speaks of our inside."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

from analyzer.errors import UsageError

_LONGEST = 60


class _Kind(NamedTuple):
    """What an argument may be: a test, and the words for it."""

    fits: Callable[[Any], bool]
    words: str


def _optional(kind: _Kind) -> _Kind:
    return _Kind(lambda value: value is None or kind.fits(value), f"{kind.words} or None")


def _list_of(kind: _Kind) -> _Kind:
    def fits(value: Any) -> bool:
        return isinstance(value, Collection) and not isinstance(value, (str, bytes)) and all(map(kind.fits, value))

    return _Kind(fits, f"a list, each of them {kind.words}")


_TEXT = _Kind(lambda value: isinstance(value, str), "a text")
_PATH = _Kind(lambda value: isinstance(value, (str, os.PathLike)) and isinstance(os.fspath(value), str), "a path")
_NUMBER = _Kind(lambda value: isinstance(value, int) and not isinstance(value, bool), "a whole number")
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
}


def check(**given: Any) -> None:
    """Raise UsageError for the first argument that is not of its kind."""
    for name, value in given.items():
        kind = _KINDS[name]
        if not kind.fits(value):
            text = repr(value)
            shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
            raise UsageError(f"{name}: expected {kind.words}, got {shown}")
