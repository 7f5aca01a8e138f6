"""Libraries that other libraries import by themselves, kept out of the program's own process.

python-can loads asammdf for MF4 files, and pyarrow loads pandas, wherever these are installed: a second, and 150 MB, for work
that needs neither. The program reads MF4 files in another process, and makes no data frames on the command line. A process of
another program may need both, so nothing is kept out there.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

#: Whether this process is the program's own. Its main function sets it.
is_own = False


class _Hidden:
    """Finds one module before all others do, as one that is not installed."""

    def __init__(self, name: str) -> None:
        self._name = name

    def find_spec(self, fullname: str, path: object, target: object = None) -> None:
        """Raise for this module; leave others to the other finders."""
        if fullname == self._name:
            raise ModuleNotFoundError(f"No module named {fullname!r}", name=fullname)


@contextmanager
def without(name: str) -> Iterator[None]:
    """Have imports of a module within fail as if it were not installed, unless it was loaded before."""
    if not is_own:
        yield
        return
    hidden = _Hidden(name)
    sys.meta_path.insert(0, hidden)
    try:
        yield
    finally:
        sys.meta_path.remove(hidden)
