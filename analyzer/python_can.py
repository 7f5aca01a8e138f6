"""python-can without asammdf, where this process is the program's own.

python-can loads asammdf for MF4 files wherever it is installed: a second, and 150 MB, for a capture of any other format. The
program reads MF4 files in another process. A process of someone else may read them by python-can itself, so it keeps all of it.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

_HEAVY = "asammdf"
#: Whether this process is the program's own. Its main function sets it.
own_process = False


def load(name: str) -> ModuleType:
    """Import python-can or a module of it."""
    if not own_process or "can" in sys.modules or _HEAVY in sys.modules:
        return import_module(name)
    # An import of what stands here as None fails, as if it were not installed.
    sys.modules[_HEAVY] = None  # type: ignore[assignment]
    try:
        return import_module(name)
    finally:
        del sys.modules[_HEAVY]
