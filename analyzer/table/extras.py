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
}


def needed(package: str) -> ModuleType:
    """Return a package. Raises UsageError, with how to install it, where it is missing."""
    try:
        return import_module(package)
    except ImportError as error:
        if error.name != package:
            raise
        raise UsageError(f"this needs {package}, which is not installed: pip install '{_EXTRAS[package]}'") from None
