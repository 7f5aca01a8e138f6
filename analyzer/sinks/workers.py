"""Processes that pack the batches of a log, so that reading and pairing have a core of their own.

    McapFile -> batch -> Workers | pipe | worker -> packed chunks -> McapFile, in order

A batch is all that its chunks need, so it does not matter who packs it. A thread for each worker waits for its answer.

Rules: what waits is bounded; where all workers have enough to do, the process itself packs. What a worker was given when it
died is packed here, and no more is given to it.
"""

from __future__ import annotations

import contextlib
import io
import pickle
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from queue import SimpleQueue
from threading import BoundedSemaphore
from typing import Any

from analyzer.catalogue import Dialect
from analyzer.sinks.forked import Ends, Forked
from analyzer.sinks.mcap_chunk import Batch, Packed
from analyzer.sinks.object_table import Table, TableUnpickler, dumped

#: More processes than this wait for the one that reads and pairs.
MOST = 3
#: Batches that wait for each worker besides the one that it packs.
_AHEAD = 1


class Workers:
    """Packs batches in `count` other processes. `dialects`: all that may come up."""

    def __init__(self, count: int, dialects: Sequence[Dialect]) -> None:
        self._table = Table(dialects)
        #: How the workers that died ended.
        self.died: list[str] = []
        self.ahead = 2 * count * (1 + _AHEAD)
        # What is loaded before the workers begin, they share.
        import_module("analyzer.columns.rows")
        self._workers = [Forked(lambda ends: _work(ends, self._table)) for _ in range(count)]
        self._free: SimpleQueue[Forked] = SimpleQueue()
        for worker in self._workers:
            self._free.put(worker)
        self._most = count * (1 + _AHEAD)
        self._room = BoundedSemaphore(self._most)
        # No thread exists before the last worker was forked.
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="servotap-worker")

    def submit(self, batch: Batch) -> Future[list[Packed]]:
        """Give a batch to a worker; where none has room, pack it now."""
        if len(self.died) < len(self._workers) and self._room.acquire(blocking=False):
            return self._threads.submit(self._packed, batch, dumped(batch, self._table))
        here: Future[list[Packed]] = Future()
        here.set_result(batch.packed())
        return here

    def _packed(self, batch: Batch, data: bytes) -> list[Packed]:
        try:
            worker = self._free.get()
            try:
                answer = _ask(worker, data)
                if not answer and worker.alive:
                    self.died.append(worker.ended())
            finally:
                self._free.put(worker)
            if not answer:
                return batch.packed()
            good, result = pickle.loads(answer)
            if not good:
                raise result
            packed: list[Packed] = result
            return packed
        finally:
            self._room.release()

    def settle(self) -> None:
        """Wait until all that was given is packed."""
        for _ in range(self._most):
            self._room.acquire()
        self._room.release(self._most)

    def shutdown(self, *, at_once: bool = False) -> None:
        """End the workers. `at_once`: with nothing finished."""
        if at_once:
            for worker in self._workers:
                worker.kill()
        self._threads.shutdown(cancel_futures=at_once)
        for worker in self._workers:
            worker.ended()


def _ask(worker: Forked, data: bytes) -> bytearray:
    """Return the answer to a batch; nothing if the worker has died."""
    with contextlib.suppress(OSError, ValueError):
        worker.give(data)
        return worker.take()
    return bytearray()


def _work(ends: Ends, table: Table) -> None:
    """Pack batches until there are no more."""
    while data := ends.take():
        try:
            batch: Batch = TableUnpickler(io.BytesIO(data), table).load()
            answer: tuple[bool, Any] = (True, batch.packed())
        except Exception as error:
            # The parent raises the same error again.
            answer = (False, error)
        ends.give(pickle.dumps(answer, pickle.HIGHEST_PROTOCOL))
