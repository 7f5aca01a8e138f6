"""What other packages add by entry points: dialects, claims, commands.

One that fails is named on standard error and left out: a recording does not end because some package is broken.
`analyzer.link.guarded` holds the same for a dialect that fails while its frames are read.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from analyzer.system import own_process
from analyzer.values import printable

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

T = TypeVar("T")
#: The packages of this project: what fails in them is a fault of servotap.
OWN = frozenset(("analyzer", "conformance", "servotap"))
#: The groups of entry points begin so, also those of python-can's drivers.
PREFIXES = ("servotap.", "can.")
#: How long a driver may take to close a port.
CLOSE_SECONDS = 5.0
#: What finds modules in folders; and the folders, beside these, that tell of a package.
_FOLDERS, _ABOUT = "_frozen_importlib_external", (".dist-info", "egg-info")


def points(group: str) -> list[EntryPoint]:
    """Return the entry points of a group."""
    if not _may_have(group):
        return []
    from importlib.metadata import distributions, entry_points

    try:
        return list(entry_points(group=group))
    # The files of any package that is installed can be damaged.
    except Exception:
        return [point for package in distributions() for point in attempt(_named(package), partial(_of, package, group)) or ()]


def _may_have(group: str) -> bool:
    """Say whether a package that is installed may have entry points of a group.

    To look for its name in their lists is faster than to load what reads them. Archives and unreadable folders count as yes.
    """
    if any(hasattr(finder, "find_distributions") and finder.__module__ != _FOLDERS for finder in sys.meta_path):
        return True
    heading = f"[{group}]".encode()
    try:
        for folder in filter(os.path.exists, (path or "." for path in sys.path)):
            with os.scandir(folder) as there:
                lists = [Path(each.path, "entry_points.txt") for each in there if each.name.lower().endswith(_ABOUT)]
            if any(heading in each.read_bytes() for each in lists if each.exists()):
                return True
    except OSError:
        return True
    return False


def _of(package: Distribution, group: str) -> list[EntryPoint]:
    return [point for point in package.entry_points if point.group == group]


def whose(error: BaseException) -> str:
    """Return the package that adds to servotap and has code in the traceback of an error; empty where none has."""
    from importlib.metadata import distributions

    seen, at = set(), error.__traceback__
    while at is not None:
        seen.add(str(at.tb_frame.f_globals.get("__name__")).partition(".")[0])
        at = at.tb_next
    for package in distributions() if seen - OWN else ():
        with contextlib.suppress(Exception):
            for point in package.entry_points:
                if point.group.startswith(PREFIXES) and point.module.partition(".")[0] in seen - OWN:
                    return f"{package.name} {package.version} ({point.module})"
    return ""


def _named(package: Distribution) -> str:
    # Its own word for its name can be what is damaged.
    return f"the list of entry points in {getattr(package, '_path', 'a package')}"


@contextlib.contextmanager
def _ending_raises() -> Iterator[None]:
    """Have `os._exit` raise Ended within, also in a process of another program."""
    before = os._exit
    os._exit = own_process.raising()  # type: ignore[assignment]  # the name of its parameter alone differs
    try:
        yield
    finally:
        os._exit = before


def attempt(what: str, call: Callable[[], T]) -> T | None:
    """Return what a call into another package returns; None where it fails, which is said."""
    try:
        # What is printed is the output of a command, which others may read.
        with contextlib.redirect_stdout(sys.stderr), _ending_raises():
            return call()
    except BaseException as error:
        if not is_failure(error):
            if isinstance(error, KeyboardInterrupt):
                # The user has ended something that waited: tell what it was.
                print(f"servotap: interrupted in {printable(what)}", file=sys.stderr)
            raise
        leave_out(what, error)
        return None


def is_failure(error: BaseException) -> bool:
    """Say whether an error is that of another package. An interrupt of this program is none; what ends the program is.

    Where the process ignores Ctrl-C, as workers do, an interrupt is one that the package has raised.
    """
    if isinstance(error, KeyboardInterrupt):
        return signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return isinstance(error, (Exception, SystemExit)) or type(error).__module__.partition(".")[0] not in OWN


@contextlib.contextmanager
def passed_over() -> Iterator[None]:
    """Pass over what another package raises within: nothing depends on it."""
    try:
        yield
    except BaseException as error:
        if not is_failure(error):
            raise


def close_bounded(name: str, close: Callable[[], object]) -> None:
    """Have another package close what it has opened. Where that hangs, it is left behind, which is said."""

    def closed() -> None:
        # No interrupt of the user falls into this thread.
        with contextlib.suppress(BaseException):
            close()

    closing = threading.Thread(target=closed, daemon=True)
    try:
        closing.start()
    except RuntimeError:
        # The system gives no more threads.
        closed()
        return
    closing.join(CLOSE_SECONDS)
    if closing.is_alive():
        print(f"servotap: {printable(name)} is left open, for its driver hangs while it closes", file=sys.stderr, flush=True)


def reason(error: BaseException) -> str:
    """Return what an error of another package is and says."""
    why = printable(type(error).__name__)
    # What it says of itself can fail, too.
    with contextlib.suppress(Exception):
        why += printable(f": {error}")
    return why


def leave_out(what: str, error: BaseException) -> str:
    """Say that something of another package is left out; return why."""
    why = reason(error)
    print(f"servotap: {printable(what)} failed and is left out: {why}", file=sys.stderr)
    return why


def loaded(group: str) -> Iterator[tuple[str, Any]]:
    """Yield what the entry points of a group name, by their names, without those that cannot be loaded."""
    for point in points(group):
        found = attempt(f"{point.name} ({point.value}) of {group}", point.load)
        if found is not None:
            yield point.name, found
