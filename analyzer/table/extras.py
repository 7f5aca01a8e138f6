"""Packages that only some users need: imported where they are used, named with how to install them where they are missing."""

from __future__ import annotations

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


def needed(package: str) -> ModuleType:
    """Return a package, or a module of it. Raises UsageError, with how to install it, where it is missing."""
    top = package.partition(".")[0]
    try:
        return import_module(package)
    except ImportError as error:
        if error.name != top:
            raise
        raise UsageError(f"this needs {top}, which is not installed: pip install '{_EXTRAS[top]}'") from None
