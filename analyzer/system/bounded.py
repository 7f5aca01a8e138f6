"""Processes that read a file with a library that has no bounds: it can crash on a stranger's file, or take all memory.

Such a process finds this package where its parent did. What its library prints goes nowhere: its answer has its own stream.
"""

from __future__ import annotations

import contextlib
import json
import sys

#: Arguments: the module, the parent's search path, then those of the module's `main`, which takes the stream first.
CHILD = """\
import json, os, sys
sys.path[:] = json.loads(sys.argv[2])
out = os.fdopen(os.dup(1), "wb")
os.dup2(2, 1)
from importlib import import_module
from analyzer.system import own_process
own_process.is_own = True
import_module(sys.argv[1]).main(out, *sys.argv[3:])
"""


def command(module: str, *arguments: object) -> list[str]:
    """Return the command line of a process that runs `main(out, *arguments)` of a module; the arguments arrive as text."""
    return [sys.executable, "-c", CHILD, module, json.dumps(sys.path), *map(str, arguments)]


def limit(memory: int, seconds: int) -> None:
    """Give this process so many bytes of memory and seconds of CPU time, where the system has such limits.

    Windows has none, and macOS bounds no memory: who waits for the process needs a deadline by the clock, too.
    """
    with contextlib.suppress(ImportError):
        import resource

        for what, most in ((resource.RLIMIT_DATA, memory), (resource.RLIMIT_CPU, seconds)):
            before = resource.getrlimit(what)[1]
            most = most if before == resource.RLIM_INFINITY else min(most, before)
            resource.setrlimit(what, (most, most))
