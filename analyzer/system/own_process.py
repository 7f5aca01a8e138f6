"""What other packages may not do in the program's own process: end it without a word, and load what nothing here needs.

Drivers and packages that add to the program can call `os._exit`, and a command that ends so with 0 seems to have done well: the
motor would stand, the log would be whole. So it raises `Ended` there, as any failure of a package.

python-can loads asammdf for MF4 files, and pyarrow loads pandas, wherever these are installed: a second, and 150 MB, for work
that needs neither. The program reads MF4 files in another process, and makes no data frames on the command line. A process of
another program may need both, so nothing is kept out there.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

#: Whether this process is the program's own. Its main function sets it.
is_own = False
#: Ends a process at once, also where `os._exit` raises.
end = os._exit


class Ended(SystemExit):
    """A package has called `os._exit`."""


def raising() -> Callable[[int], NoReturn]:
    """Return what raises Ended in this process, in place of `os._exit`. Processes that a package forks end as they wish."""
    own = os.getpid()

    def ended(status: int) -> NoReturn:
        if os.getpid() != own:
            end(status)
        raise Ended(f"os._exit({status}) was called")

    return ended


def take() -> None:
    """Make this process the program's own, and have `os._exit` raise Ended from now on."""
    global is_own
    is_own = True
    os._exit = raising()  # type: ignore[assignment]  # the name of its parameter alone differs


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
