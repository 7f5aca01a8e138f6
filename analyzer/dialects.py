"""Which dialects there are: those of this package, and those that other packages bring by an entry point.

A package adds a dialect by an entry point of the group `servotap.dialects` that names a `Dialect` object. Nothing else is
needed: framing, decoding, logging, `explain` and the reference pages follow from the declaration.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points

from analyzer.catalogue import Dialect
from analyzer.errors import UsageError

#: Dialects of this package: name -> module with a `DIALECT`.
_OWN = {
    "mks-rs485": "analyzer.protocols.mks_rs485",
    "mks-modbus": "analyzer.protocols.mks_modbus",
    "mks-can": "analyzer.protocols.mks_can",
    "lk-rs485": "analyzer.protocols.lk_rs485",
}
GROUP = "servotap.dialects"


@cache
def _added() -> dict[str, Dialect]:
    result = {}
    for point in entry_points(group=GROUP):
        loaded = point.load()
        if not isinstance(loaded, Dialect):
            raise UsageError(f"entry point {point.name} of {GROUP}: expected a Dialect, got {type(loaded).__name__}")
        result[loaded.name] = loaded
    return result


def names() -> list[str]:
    """Return the names of all dialects."""
    return [*_OWN, *sorted(_added())]


@cache
def get(name: str) -> Dialect:
    """Return a dialect by name.

    Raises UsageError for a name there is none of, with the nearest one.
    """
    if name in _OWN:
        dialect: Dialect = import_module(_OWN[name]).DIALECT
        return dialect
    if name in _added():
        return _added()[name]
    near = difflib.get_close_matches(name.lower(), names(), 1, 0.4)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise UsageError(f"no dialect {name!r}{hint} (there are {', '.join(names())})")


def every() -> list[Dialect]:
    """Return all dialects."""
    return [get(name) for name in names()]


def for_model(dialects: Sequence[Dialect], model: str | None) -> list[Dialect]:
    """Return the dialects as one model speaks them; those that do not know the model stay as they are.

    Raises UsageError for a model that none of them has.
    """
    if not model:
        return list(dialects)
    wanted = model.upper()
    if not any(wanted in d.models for d in dialects):
        known = sorted({m for d in dialects for m in d.models})
        raise UsageError(f"no model {model!r} in {', '.join(d.name for d in dialects)}; there are {', '.join(known)}")
    return [d.for_model(wanted) if wanted in d.models else d for d in dialects]
