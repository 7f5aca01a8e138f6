"""Processes that read ranges of a capture and pack batches of its log, so that what needs the order has a core of its own.

    ranges of the file -> Workers | pipe | worker -> frames as columns -> the pipeline
    McapFile -> batch  -> Workers | pipe | worker -> packed chunks -> McapFile

All that a task needs goes with it, so it does not matter who does it. Two threads for each worker wait for its answers: while
it works on one task, the next one lies in its pipe.

Rules: what waits is bounded. The process that waits for a task does it itself, if no worker has begun it, or others meanwhile.
What a worker was given when it died is done here, and no more is given to it.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from importlib import import_module
from queue import SimpleQueue
from threading import Lock
from typing import Any, Generic, TypeVar

from analyzer.sinks.forked import Ends, Forked
from analyzer.sinks.mcap_chunk import Batch, Packed
from analyzer.sinks.object_table import Table
from analyzer.sinks.shared import Shared

#: More workers would idle: the first process, which keeps the order, has no tasks for them. Each takes 50 MiB.
MOST = 2
#: Tasks that a worker has at once: one under way, one in its pipe.
_AT_ONCE = 2
#: Slots of shared memory: for blocks under way in the pipeline, and more for each worker.
_SLOTS, _SLOTS_EACH = 6, 4

T = TypeVar("T")
R = TypeVar("R")


class Task(Generic[R]):
    """Something that is done here or by a worker: a function of one argument, both known there by name and by value."""

    def __init__(self, workers: Workers, function: Callable[[Any], R], argument: Any) -> None:
        self._workers, self._function, self._argument = workers, function, argument
        self._future: Future[R] = workers.threads.submit(self._there)

    def _there(self) -> R:
        return self._workers.done(self._function, self._argument)

    def begun(self) -> bool:
        return self._future.running() or self._future.done()

    def done(self) -> bool:
        return self._future.done()

    def here(self) -> bool:
        """Do it now, if no worker has begun it; say so."""
        if not self._future.cancel():
            return False
        self._future = Future()
        try:
            self._future.set_result(self._function(self._argument))
        except Exception as error:
            self._future.set_exception(error)
        return True

    def result(self) -> R:
        if not self.here():
            while not self._future.done():
                if not self._workers.help():
                    wait((self._future,))
        # What it was made of is held no longer.
        self._argument = None
        return self._future.result()


class Workers:
    """Does tasks in `count` other processes. `table`: of all dialects that may come up."""

    def __init__(self, count: int, table: Table) -> None:
        #: How the workers that died ended.
        self.died: list[str] = []
        #: Tasks of each kind that may wait.
        self.ahead = count * _AT_ONCE
        # What is loaded before the workers begin, they share.
        import_module("analyzer.columns.rows")
        self._shared = Shared(table, _SLOTS + _SLOTS_EACH * count)
        self._workers = [_Worker(self._shared) for _ in range(count)]
        self._free: SimpleQueue[_Worker] = SimpleQueue()
        for worker in self._workers * _AT_ONCE:
            self._free.put(worker)
        #: What no one may have begun.
        self._waiting: deque[Task[Any]] = deque()
        self._packing: deque[Task[list[Packed]]] = deque()
        # No thread exists before the last worker was forked.
        self.threads = ThreadPoolExecutor(count * _AT_ONCE, thread_name_prefix="servotap-worker")

    def _task(self, function: Callable[[Any], R], argument: Any) -> Task[R]:
        task = Task(self, function, argument)
        self._waiting = deque(each for each in self._waiting if not each.begun())
        self._waiting.append(task)
        return task

    def submit(self, batch: Batch) -> Task[list[Packed]]:
        """Have a batch packed; where enough waits, it is packed now."""
        self._packing = deque(task for task in self._packing if not task.done())
        task = self._task(Batch.packed, batch)
        if len(self._packing) >= self.ahead or len(self.died) == len(self._workers):
            task.here()
        self._packing.append(task)
        return task

    def parsed(self, function: Callable[[T], R], ranges: Iterator[T]) -> Iterator[tuple[T, R]]:
        """Yield ranges with what a function makes of each, in their order; a few are looked at ahead."""
        tasks: deque[tuple[T, Task[R]]] = deque()
        error: Exception | None = None
        more = True
        while True:
            while more and len(tasks) < self.ahead:
                try:
                    own = next(ranges)
                except StopIteration:
                    more = False
                except Exception as caught:
                    # What came before the fault is given first.
                    more, error = False, caught
                else:
                    tasks.append((own, self._task(function, own)))
            if not tasks:
                break
            own, task = tasks.popleft()
            yield own, task.result()
        if error is not None:
            raise error

    def help(self) -> bool:
        """Do a task here that no worker has begun; say whether there was one."""
        while self._waiting:
            if self._waiting.popleft().here():
                return True
        return False

    def done(self, function: Callable[[Any], R], argument: Any) -> R:
        """Return what a worker makes of an argument; if it has died, what comes out here."""
        worker = self._free.get()
        try:
            good, result = worker.ask((function, argument))
        except EOFError:
            self.died += worker.buried()
            return function(argument)
        finally:
            self._free.put(worker)
        if not good:
            raise result
        made: R = result
        return made

    def settle(self) -> None:
        """Wait until all that was given is done."""
        while self.help():
            pass
        for task in self._packing:
            with contextlib.suppress(Exception):
                task.result()

    def shutdown(self, *, at_once: bool = False) -> None:
        """End the workers. `at_once`: with nothing finished."""
        if at_once:
            for worker in self._workers:
                worker.kill()
        self.threads.shutdown(cancel_futures=True)
        for worker in self._workers:
            worker.ended()


class _Worker:
    """A process that does tasks, in the order in which they are given."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._giving, self._taking, self._ending = Lock(), Lock(), Lock()
        self._forked = Forked(lambda ends: _work(ends, shared))
        self.process = self._forked.process
        self.kill, self.ended = self._forked.kill, self._forked.ended

    def buried(self) -> list[str]:
        """Wait for its end; return how it came, once."""
        with self._ending:
            return [self._forked.ended()] if self._forked.alive else []

    def ask(self, task: tuple[Callable[[Any], Any], Any]) -> tuple[bool, Any]:
        """Return whether a task was done, and what came out. Raises EOFError if the worker has died."""
        slot = self._shared.slot()
        data = self._shared.dumped(task, None if slot is None else slot.number)
        with contextlib.suppress(OSError, ValueError):
            with self._giving:
                self._forked.give(data)
                # Answers come in the order of the tasks, so the locks are taken in that order, too.
                self._taking.acquire()
            try:
                answer = self._forked.take()
            finally:
                self._taking.release()
            if answer:
                told: tuple[bool, Any] = self._shared.loaded(answer, slot)
                return told
        raise EOFError


def _work(ends: Ends, shared: Shared) -> None:
    """Do tasks until there are no more."""
    while data := ends.take():
        try:
            function, argument = shared.loaded(data)
            answer: tuple[bool, Any] = (True, function(argument))
        except Exception as error:
            # The parent raises the same error again.
            answer = (False, error)
        ends.give(shared.dumped(answer, shared.number_of(data), answer=True))
