"""Work spread over processes that end with it. One that dies ends the run, where a pool of `multiprocessing` waits for ever."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from conformance.claim import RigFault

W = TypeVar("W")
R = TypeVar("R")


def spread(work: Sequence[W], call: Callable[[W], R], jobs: int, begin: Callable[..., None], *about: Any) -> Iterator[R]:
    """Yield what a call makes of each piece of work, in order. Each process begins with `begin(*about)`.

    A forked process has the claims and the catalogue already; where there is no fork it makes them anew. Raises RigFault where
    a process dies, and what the call raises.
    """
    methods = multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("fork" if "fork" in methods else "spawn")
    pieces = iter(enumerate(work))
    found: dict[int, R] = {}
    processes = []
    busy: list[Connection] = []
    try:
        for piece in (next(pieces) for _ in range(min(jobs, len(work)))):
            ours, theirs = context.Pipe()
            processes.append(context.Process(target=_work, args=(ours, theirs, call, begin, about), daemon=True))
            processes[-1].start()
            # The process alone holds its end: when it dies, even in the middle of a result, reading ends.
            theirs.close()
            busy.append(ours)
            ours.send(piece)
        told = 0
        while busy:
            for ours in wait(busy):
                assert isinstance(ours, Connection)  # nothing else is waited for
                number, result, error = ours.recv()
                if error is not None:
                    raise error
                found[number] = result
                if (more := next(pieces, None)) is None:
                    busy.remove(ours)
                else:
                    ours.send(more)
            while told in found:
                yield found.pop(told)
                told += 1
    except (EOFError, BrokenPipeError, ConnectionResetError):
        raise RigFault("a process of this run died, or had no more memory; --jobs 1 runs all in one process") from None
    finally:
        # What runs still is of no use any more: the run was left.
        for process in processes:
            process.terminate()
            process.join()


def _work(
    ours: Connection, given: Connection, call: Callable[[Any], Any], begin: Callable[..., None], about: tuple[Any, ...]
) -> None:
    """Do pieces of work until the process is ended. Signals are left to the process that began this one."""
    # Reading ends with the process that began this one only if no copy of its end is left.
    ours.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    begin(*about)
    # The process that began this one may die.
    with contextlib.suppress(EOFError, ConnectionResetError, BrokenPipeError):
        while True:
            number, piece = given.recv()
            result = failure = None
            try:
                result = call(piece)
            except Exception as error:
                error.add_note(traceback.format_exc())
                failure = error
            given.send((number, result, failure))
