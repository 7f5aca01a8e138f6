"""Packages that only some users need: imported where they are used, named with how to install them where they are missing."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

from analyzer.errors import UsageError

#: Package -> what to install for it.
_EXTRAS = {
    "pyarrow": "servotap[table]",
    "xlsxwriter": "servotap[table]",
    "pandas": "pandas",
    "polars": "polars",
    "matplotlib": "servotap[plot]",
    "cantools": "servotap[dbc]",
    **dict.fromkeys(("dask", "deltalake", "distributed", "duckdb", "fsspec"), "servotap[fleet]"),
}
#: Package -> bytes of address space that it takes. With less some die of a signal while they are loaded, without a word.
_ROOM = {"pyarrow": 640 << 20}


def needed(package: str) -> ModuleType:
    """Return a package, or a module of it.

    Raises UsageError, with how to install it, where it is missing, and where this process may not have the memory for it.
    """
    top = package.partition(".")[0]
    if top not in sys.modules and _ROOM.get(top, 0) > (room := _room()):
        raise UsageError(f"this needs {top}, and that {_ROOM[top] >> 20} MiB of memory: ulimit -v allows {room >> 20} MiB")
    try:
        return import_module(package)
    except ImportError as error:
        if error.name != top:
            raise
        raise UsageError(f"this needs {top}, which is not installed: pip install '{_EXTRAS[top]}'") from None


def _room() -> int:
    """Return how much address space this process may have, in bytes."""
    try:
        import resource
    except ImportError:  # a system without such limits
        return sys.maxsize
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return sys.maxsize if limit == resource.RLIM_INFINITY else limit
