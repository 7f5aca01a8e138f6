"""Workers: processes that run inputs under limits, and a watchdog that notices what a worker cannot tell.

An input is known by its target, seed and number alone, so a worker that dies in the midst has told enough: the watchdog
makes the input again. A worker stops by itself, and says where it was, when an input takes too long; one that only waits is
woken to say it. Findings are shrunk in processes of their own, too.
"""

from __future__ import annotations

import faulthandler
import gc
import mmap
import multiprocessing
import os
import random
import resource
import signal
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from tests.fuzz.corpus import INPUT, Input
from tests.fuzz.running import heard
from tests.fuzz.targets import TARGETS, attempt, key_of

#: Memory that inputs may take beside what the program takes by itself.
MEMORY = 2 << 30
WRITTEN = 256 << 20
#: A worker that waits without working is given up after so long.
WAITING_S = 60.0
#: A target runs so long before another takes its turn, and a worker before a fresh one takes its place.
TURN_S = 0.25
LIFE_S = 60.0
#: What a mutator that raised is told by.
MUTATOR = "mutator"
FORK = multiprocessing.get_context("fork")


class Finding(NamedTuple):
    """`key`: the same for the same fault. `number`: of the input, under the seed."""

    target: str
    seed: int
    number: int
    key: str
    text: str


def made(target: str, seed: int, number: int, seeds: Sequence[Input]) -> Input:
    """Return an input by its number: the seeds as they are first."""
    if number < len(seeds):
        return seeds[number]
    chance = random.Random(f"{target} {seed} {number}")
    return TARGETS[target].mutate(chance, chance.choice(seeds), seeds)


class Board:
    """What the watchdog sees of a worker: the target and number of its input, since when it runs, counts and times."""

    _NOW = struct.Struct("<qqd")
    _OF = struct.Struct("<qd")

    def __init__(self) -> None:
        self._map = mmap.mmap(-1, 1 << 14)

    @property
    def now(self) -> tuple[int, int, float]:
        """Index of the target, number of the input, monotonic time."""
        return self._NOW.unpack_from(self._map)  # type: ignore[return-value]

    def begin(self, target: int, number: int) -> None:
        self._NOW.pack_into(self._map, 0, target, number, time.monotonic())

    def of(self, target: int) -> tuple[int, float]:
        """Inputs and seconds of a target."""
        return self._OF.unpack_from(self._map, 64 + 16 * target)  # type: ignore[return-value]

    def add(self, target: int, count: int, seconds: float) -> None:
        before, spent = self.of(target)
        self._OF.pack_into(self._map, 64 + 16 * target, before + count, spent + seconds)


def confine(stacks: int) -> None:
    """Bound memory and files of this process, and have it say on `stacks` where it is when its time is up."""
    # Memory that can be written, and not the addresses: threads and the allocators of libraries reserve far more of these than
    # they use. Where there were none left, the process ended, or waited for a thread that could not begin.
    used = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_DATA, (used + MEMORY, used + MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (WRITTEN, WRITTEN))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.enable(stacks)
    # Its default action comes after the stack: the process ends.
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    faulthandler.register(signal.SIGPROF, stacks, all_threads=False, chain=True)
    os.environ["SERVOTAP_TRACEBACK"] = "1"


class Worker:
    """One worker and what its watchdog knows of it. `job` runs in the process, and may send findings."""

    def __init__(self, job: Callable[[Board, Connection], None]) -> None:
        self.board = Board()
        self.pipe, told = FORK.Pipe(duplex=False)
        self._stacks = tempfile.TemporaryFile()  # noqa: SIM115
        self.process = FORK.Process(target=self._run, args=(job, told))
        self.process.start()
        told.close()
        self._woken = 0.0

    def _run(self, job: Callable[[Board, Connection], None], told: Connection) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        # What was loaded stays: the collector need not look at it each time.
        gc.freeze()
        confine(self._stacks.fileno())
        job(self.board, told)

    def watch(self) -> None:
        """Wake the worker to say where it is if its input has waited too long; end it if it does not wake."""
        since = self.board.now[2]
        waited = time.monotonic() - since if since else 0.0
        if waited > WAITING_S and self.process.pid:
            os.kill(self.process.pid, signal.SIGKILL if waited > WAITING_S + 5 else signal.SIGPROF)

    @property
    def died(self) -> str:
        """How it ended, nothing if it ended by itself or still runs."""
        code = self.process.exitcode
        if not code:
            return ""
        self._stacks.seek(0)
        stack = self._stacks.read(20_000).decode("utf-8", "replace")
        how = signal.Signals(-code).name if code < 0 else f"exit status {code}"
        return f"{'hang' if how in ('SIGPROF', 'SIGKILL') else how}: {how}\n{stack}"

    def close(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()
        self._stacks.close()


def scratch() -> tempfile.TemporaryDirectory[str]:
    """Return a folder to run in; in memory where there is such a place."""
    memory = Path("/dev/shm")
    return tempfile.TemporaryDirectory(prefix="fuzz.", dir=memory if memory.is_dir() and os.access(memory, os.W_OK) else None)


def warm(targets: Sequence[str], seeds: dict[str, list[Input]]) -> None:
    """Run one input of each target here, so that no worker has to load what it needs."""
    with scratch() as name, heard() as said:
        for target in targets:
            attempt(target, seeds[target][0], Path(name), said)


def timed(target: str) -> None:
    """Start the processor time of an input."""
    signal.setitimer(signal.ITIMER_PROF, TARGETS[target].seconds)


def fuzzing(
    targets: Sequence[str], seed: int, starts: dict[str, int], step: int, until: float, seeds: dict[str, list[Input]]
) -> Callable[[Board, Connection], None]:
    """Return the job of a worker: inputs of all targets by turns, each `step`th from its start."""

    def job(board: Board, told: Connection) -> None:
        numbers = dict(starts)
        known: set[tuple[str, str]] = set()
        names = list(TARGETS)
        with scratch() as name, heard() as said:
            folder = Path(name)
            end = min(until, time.monotonic() + LIFE_S)
            while time.monotonic() < end:
                target = min(targets, key=lambda each: board.of(names.index(each))[1] / TARGETS[each].share)
                index, begun, count = names.index(target), time.monotonic(), 0
                while time.monotonic() < begun + TURN_S:
                    number = numbers[target]
                    board.begin(index, number)
                    timed(target)
                    try:
                        given = made(target, seed, number, seeds[target])
                    except Exception as error:
                        # A fault of the mutator ends no run of hours, but it is told, and the run fails.
                        text = f"{MUTATOR}: {error!r}"
                    else:
                        text = attempt(target, given, folder, said)
                    signal.setitimer(signal.ITIMER_PROF, 0)
                    numbers[target] += step
                    count += 1
                    if text and (found := (target, key_of(text))) not in known:
                        known.add(found)
                        told.send(Finding(target, seed, number, found[1], text))
                board.add(index, count, time.monotonic() - begun)

    return job


def outcomes(target: str, inputs: Sequence[Input], *, until: float | None = None) -> list[str]:
    """Run inputs in a process of their own; return for each what is wrong, nothing if all holds."""
    found: list[str] = []
    while len(found) < len(inputs):
        rest = inputs[len(found) :]

        def job(board: Board, told: Connection, rest: Sequence[Input] = rest) -> None:
            with scratch() as name, heard() as said:
                for number, given in enumerate(rest):
                    board.begin(0, number)
                    timed(target)
                    told.send(attempt(target, given, Path(name), said))

        worker = Worker(job)
        try:
            before = len(found)
            while len(found) - before < len(rest):
                if worker.pipe.poll(0.5):
                    try:
                        found.append(worker.pipe.recv())
                    except EOFError:
                        worker.process.join()
                        found.append(worker.died or "the process ended without a word")
                        break
                worker.watch()
                if until is not None and time.monotonic() > until:
                    return found + [""] * (len(inputs) - len(found))
        finally:
            worker.close()
    return found


# --- shrinking ----------------------------------------------------------------------------------------------------------


def shrunk(finding: Finding, given: Input, seconds: float) -> Input:
    """Return a smaller input with the same fault: files, then ever smaller pieces of bytes are left out while it stays."""
    until = time.monotonic() + seconds

    def fails(tries: Sequence[Input]) -> int | None:
        """Return which of some inputs has the fault, the first of them."""
        texts = outcomes(finding.target, tries, until=until)
        return next((n for n, text in enumerate(texts) if text and key_of(text) == finding.key), None)

    best = dict(given)
    for name in [n for n in best if n != INPUT]:
        smaller = {n: d for n, d in best.items() if n != name}
        if fails([smaller]) is not None:
            best = smaller
    for name in list(best):
        size = max(1, len(best[name]) // 2)
        while time.monotonic() < until:
            at = 0
            while at < len(best[name]) and time.monotonic() < until:
                data = best[name]
                # Several at once: a process for each would cost more than the inputs.
                places = range(at, min(len(data), at + 16 * size), size)
                hit = fails([{**best, name: data[:p] + data[p + size :]} for p in places])
                if hit is None:
                    at += 16 * size
                else:
                    at = places[hit]
                    best[name] = data[:at] + data[at + size :]
            if size == 1:
                break
            size //= 2
    return best


def eprint(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
