"""Take captures into a lake: find them, share them out to workers, commit batch by batch.

    files -> not known by place and mark -> tasks of one machine -> workers -> batches -> one commit each
                                            huge ones in ranges ----'

Rules: the client alone commits. A worker that dies takes its task with it, which another one begins anew. A task that kills
workers is split until the capture that does it is alone; that one is noted as failed.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import posixpath
import re
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from datetime import date
from functools import partial
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import Any

from analyzer.cli.signals import Interrupt
from analyzer.errors import ServotapError, UnreadableError, UsageError
from analyzer.fleet.files import PARTITIONS
from analyzer.fleet.lake import CAPTURES, JOURNAL, LOG, RANGES, Lake
from analyzer.fleet.place import Found, Place, again
from analyzer.fleet.ranges import HUGE, Range, Scan, Task, do, is_split, joined, waiting, works_of
from analyzer.fleet.rows import TAKEN, Taken, Work
from analyzer.live import profile
from analyzer.live.spool import spool_folder
from analyzer.system.scratch import scratch_folder
from analyzer.table.extras import needed
from analyzer.values import counted, printable, quote

#: A task has at most so many bytes, or one capture; and so many captures.
TASK_BYTES, TASK_FILES = 64 << 20, 200
#: Tasks that each worker has at least, where they have so many bytes: fewer tasks make fewer files.
TASKS_EACH, LEAST_BYTES = 3, 1 << 20
#: A batch is committed after so many bytes or seconds.
BATCH_BYTES, BATCH_SECONDS = 1 << 30, 60.0
#: From how many data files on an ingest calls them too many, and below how many bytes it calls one small.
_MANY, _SMALL = 1000, 16 << 10
#: Seconds in which a scheduler has to answer, and the level of logs of Dask that are shown.
_SECONDS, _QUIET = 30, logging.CRITICAL
#: States of a task that a scheduler took with it; seconds between two looks for them.
_GONE, _LOOK = ("lost", "cancelled"), 2.0
#: How often the processes of Dask look at themselves. By default it is a hundred times a second, for tasks of milliseconds;
#: each worker would lose 2 % of its time, and the client as much.
_RARE = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
_DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
#: Endings of folders that hold what was made of captures.
_MADE = (".parquet", spool_folder(Path("log")).suffix)
_PARTS = {"machine": r"(?P<machine>[^/]+)", "date": r"(?P<date>\d{4}-?\d\d-?\d\d)", "**": r".*", "*": r"[^/]*"}
_PART = re.compile(r"\{(\w+)\}|\*\*|\*")


class Pattern:
    """What the path of a capture says of its machine and date: `{machine}/{date}/*`. Raises UsageError for no such pattern."""

    def __init__(self, text: str) -> None:
        found, place = "", 0
        for part in _PART.finditer(text):
            name = part[1] or part[0]
            if name not in _PARTS:
                raise UsageError(f"--machine {quote(text)}: expected {{machine}}, {{date}}, * and **, got {{{name}}}")
            found += re.escape(text[place : part.start()]) + _PARTS[name]
            place = part.end()
        if text.count("{machine}") > 1 or text.count("{date}") > 1:
            raise UsageError(f"--machine {quote(text)}: expected each of {{machine}} and {{date}} once")
        self._regex = re.compile(found + re.escape(text[place:]))

    def read(self, name: str) -> tuple[str, date | None]:
        """Return machine and date of a path, "" and None where it does not say."""
        found = self._regex.fullmatch(name)
        said = {} if found is None else found.groupdict()
        day = None
        with contextlib.suppress(ValueError):
            day = date.fromisoformat(said.get("date") or "")
        return said.get("machine") or "", day


@dataclass
class Outcome:
    """What an ingest has done so far, in captures and bytes. `files`: found; `wanted`, `size`: those that are to be read.

    `unread`: what could not be taken, with the reason.
    """

    files: int = 0
    wanted: int = 0
    size: int = 0
    done: int = 0
    read: int = 0
    frames: int = 0
    new: int = 0
    known: int = 0
    unread: list[tuple[str, str]] = field(default_factory=list)
    batches: int = 0
    recovered: int = 0
    notes: list[str] = field(default_factory=list)

    def told(self) -> str:
        failed = f", {len(self.unread):,} not read" if self.unread else ""
        return f"ingesting {self.wanted:,} captures, {self.done:,} done{failed}"

    def as_object(self) -> dict[str, Any]:
        unread = [{"name": name, "reason": reason} for name, reason in self.unread]
        return {"files": self.files, "bytes": self.read, "frames": self.frames, "new": self.new, "known": self.known,
                "batches": self.batches, "recovered": self.recovered, "unread": unread, "notes": self.notes}  # fmt: skip


def works(sources: Sequence[Place], lake: Lake, pattern: Pattern | None, retry: bool, outcome: Outcome) -> list[Work]:
    """Return the captures to take: those of the sources of which the lake does not know place, size and mark already."""
    rows = lake.rows("capture", "status", "source", "name", "size", "mark")
    there = {
        (row["source"], row["name"], row["size"], row["mark"]) for row in rows if not (retry and row["status"] not in TAKEN)
    }
    known: dict[int, set[str]] = {}
    for row in rows:
        if row["status"] in TAKEN or not retry:
            known.setdefault(row["size"], set()).add(row["capture"])
    found = []
    for source in sources:
        files = source.files()
        outcome.unread += [(folder, "it may not be listed") for folder in source.closed]
        machines = Machines(source, files)
        for each in _captures(source, files, lake.place):
            outcome.files += 1
            if each.mark and (source.url, each.name, each.size, each.mark) in there:
                outcome.known += 1
                continue
            machine, day = pattern.read(each.name) if pattern is not None else ("", None)
            machine = machine or machines.of(each.name)
            found.append(Work(source, each, machine, day, frozenset(known.get(each.size, ()))))
    outcome.wanted = len(found)
    outcome.size = sum(work.found.size for work in found)
    return found


class Machines:
    """Whose captures are: the profiles beside them say it, each for its folder and those below."""

    def __init__(self, source: Place, files: Sequence[Found]) -> None:
        self._names: dict[str, str] = {}
        beside = posixpath.join(posixpath.dirname(source.root), profile.FILE)
        there = {posixpath.dirname(each.name): each.key for each in files if posixpath.basename(each.name) == profile.FILE}
        if [each.key for each in files] == [source.root] and again(lambda: source.fs.exists(beside)):
            # The source is one capture.
            there[""] = beside
        for folder, key in there.items():
            data = again(partial(source.fs.cat_file, key))
            self._names[folder] = profile.machine_of(data, printable(key))

    def of(self, name: str) -> str:
        """Return the machine of a capture, "" where no profile says it."""
        while name:
            name = posixpath.dirname(name)
            if self._names.get(name):
                return self._names[name]
        return ""


def _captures(source: Place, files: Sequence[Found], lake: Place) -> Iterator[Found]:
    """Yield those of a source's files that are captures: no profiles, nor what `decode`, `record` and `ingest` made."""
    names = {each.name for each in files}
    lakes = _of_lakes(names)
    own = f"{lake.root}/" if type(lake.fs) is type(source.fs) else ""
    for each in files:
        folders = each.name.split("/")[:-1]
        made = each.name.removesuffix(".mcap") in names and each.name.endswith(".mcap")
        made |= posixpath.basename(each.name) == profile.FILE or each.name.startswith(lakes)
        if not made and not any(name.endswith(_MADE) for name in folders) and not (own and each.key.startswith(own)):
            yield each


def _of_lakes(names: Collection[str]) -> tuple[str, ...]:
    """Return how names of files in lakes begin: below the folders of tables, and what a lake keeps of batches beside them."""
    tables = {name[:at] for name in names if (at := f"/{name}".find(f"/{LOG}/")) >= 0}
    beside = {f"{table.removesuffix(f'{CAPTURES}/')}{folder}/" for table in tables for folder in (JOURNAL, RANGES)
              if f"/{table}".endswith(f"/{CAPTURES}/")}  # fmt: skip
    return tuple(tables | beside)


def tasks(found: Sequence[Work], number: int) -> list[Task]:
    """Share captures out to a number of workers.

    Those of one day and machine stand together, the greatest tasks come first, huge ones are split.
    """
    most = min(TASK_BYTES, max(LEAST_BYTES, sum(work.found.size for work in found) // (TASKS_EACH * number)))
    in_order = sorted(found, key=lambda each: (str(each.date), each.machine, each.found.name))
    of_machines = groupby(in_order, key=lambda each: (each.date, each.machine))
    parts = [part for _, works in of_machines for part in _packed([[work] for work in works], most)]
    shared = _packed(parts, most)
    shared.sort(key=lambda task: -sum(work.found.size for work in task))
    return [Scan(task[0]) if len(task) == 1 and task[0].found.size >= HUGE else task for task in shared]


def _packed(parts: Sequence[list[Work]], most: int) -> list[list[Work]]:
    """Join lists that follow each other, while they have so many bytes and captures at most."""
    packed: list[list[Work]] = []
    size = 0
    for part in parts:
        more = sum(work.found.size for work in part)
        if not packed or size + more > most or len(packed[-1]) + len(part) > TASK_FILES:
            packed.append([])
            size = 0
        packed[-1] += part
        size += more
    return packed


@contextlib.contextmanager
def workers(scheduler: str, count: int) -> Iterator[Any]:
    """Yield a client of Dask: of a scheduler that runs (`tcp://…`), or of processes of this machine.

    Raises UsageError where no scheduler answers.
    """
    distributed = needed("distributed")
    # A worker that has died is noticed after seconds, not minutes. Ctrl-C is for the client, which ends them.
    settings: dict[str, Any] = {"distributed.comm.timeouts.connect": "10s", "distributed.worker.preload": [_DEAF]}
    needed("dask").config.set(settings | _RARE)
    with contextlib.ExitStack() as opened:
        address: Any = scheduler
        if scheduler == "local":
            # Dask leaves a folder behind in the one for temporary files.
            folder = str(opened.enter_context(scratch_folder()))
            needed("dask").config.set({"temporary-directory": folder})
            try:
                address = opened.enter_context(
                    distributed.LocalCluster(
                        n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=_QUIET
                    )
                )
            except RuntimeError as error:
                # Dask says the same for all that a process may lack: descriptors, processes, memory.
                raise UsageError(
                    f"{counted(count, 'worker')} of Dask cannot be started: {error} Fewer need less of the system: --workers"
                ) from None
            if find_spec("bokeh"):
                print(f"Dask's dashboard: {address.dashboard_link}", file=sys.stderr)
        try:
            client = opened.enter_context(distributed.Client(address, timeout=_SECONDS))
        except (OSError, ValueError, TimeoutError) as error:
            raise UsageError(f"--scheduler {scheduler}: no scheduler of Dask answers there: {error}") from None
        yield client


def _ended(client: Any, running: Collection[Any], *, patient: bool) -> list[Any]:
    """Wait for tasks that have ended, or are gone with their scheduler; it may be back. Raises UsageError where it is not.

    `patient`: until there are some.
    """
    looked = False
    while True:
        # With its scheduler, a task is gone without an end.
        found = [future for future in running if future.done() or future.status in _GONE]
        if found or (looked and not patient):
            return found
        looked = True
        if client.status == "closed":
            raise UsageError("the scheduler of Dask is gone: what was committed stays, ingest again for the rest")
        with contextlib.suppress(TimeoutError, CancelledError):
            needed("distributed").wait(list(running), timeout=_LOOK, return_when="FIRST_COMPLETED")


@dataclass
class _Split:
    """A capture of which the ranges are taken. `begun`: those that were given to workers; `scanned`: what the scan brought."""

    begun: int = 0
    taken: list[Taken] = field(default_factory=list)
    scanned: Taken | None = None


class Ingest:
    """An ingest that runs. `options`: of reading, as `decode` has them; `interrupt`: a signal ends it between two commits."""

    def __init__(self, lake: Lake, options: argparse.Namespace, outcome: Outcome, interrupt: Interrupt) -> None:
        self.lake, self._options, self.outcome, self._interrupt = lake, options, outcome, interrupt
        self._waiting: list[Taken] = []
        self._since = time.monotonic()
        self._splits: dict[str, _Split] = {}
        self._sizes: list[int] = []

    def run(self, client: Any, found: Sequence[Work]) -> None:
        """Take captures. What was taken when a signal ends this is committed."""
        running: dict[Any, Task] = {}
        number = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
        left = tasks(found, number)[::-1]
        while left or running:
            while left and len(running) < 2 * number:
                task = left.pop()
                running[client.submit(do, task, self.lake.destination, self._options, pure=False)] = task
            scans = [task for task in running.values() if isinstance(task, Scan)]
            try:
                ended = self._interrupt.opened(partial(_ended, client, running, patient=not scans))
            except KeyboardInterrupt:
                client.cancel(list(running), force=True)
                break
            for task in scans:
                left += self._begin(task, waiting(self.lake.place, task))
            for future in ended:
                left += self.ended(running.pop(future), future)
                future.release()
            if sum(each.read for each in self._waiting) >= BATCH_BYTES or time.monotonic() - self._since >= BATCH_SECONDS:
                self.commit()
        for task in (*running.values(), *left):
            if not isinstance(task, list):
                self._forget(task.scan if isinstance(task, Range) else task)
        self.commit()

    def ended(self, task: Task, future: Any) -> list[Task]:
        """Take what a task brought. Return the tasks that come next, or in its place where it failed."""
        if isinstance(task, Range) and task.scan.name not in self._splits:
            # Its capture has failed, or is scanned anew.
            return []
        if future.status == "finished":
            return self._brought(task, future.result())
        if future.status not in _GONE:
            return self._failed(task, future)
        if isinstance(task, Scan):
            self._forget(task)
            return [Scan(task.work)]
        return [task]

    def _brought(self, task: Task, taken: Taken) -> list[Task]:
        if isinstance(task, list):
            self._take(taken)
            return []
        scan, more = task.scan if isinstance(task, Range) else task, []
        split = self._splits.setdefault(scan.name, _Split())
        if isinstance(task, Range):
            split.taken.append(taken)
        elif is_split(taken):
            split.scanned = taken
            more = self._begin(scan, taken.ranges)
        else:
            self._forget(scan)
            self._take(taken)
        if split.scanned is not None and len(split.taken) == split.scanned.ranges:
            self._forget(scan)
            try:
                self._take(joined(split.scanned, split.taken))
            except UnreadableError as error:
                self._give_up(scan.work, str(error))
        return more

    def _begin(self, scan: Scan, written: int) -> list[Task]:
        """Return the ranges that a scan has written and that no worker has."""
        if not written:
            return []
        split = self._splits.setdefault(scan.name, _Split())
        begun, split.begun = split.begun, max(split.begun, written)
        return [Range(scan, number) for number in range(begun, split.begun)]

    def _forget(self, scan: Scan) -> None:
        self._splits.pop(scan.name, None)
        self.lake.place.remove_folder(scan.folder)

    def _failed(self, task: Task, future: Any) -> list[Task]:
        error = future.exception()
        if isinstance(error, OSError):
            raise UsageError(f"{self.lake.place.url} cannot be written: {error.strerror or error}") from None
        if isinstance(task, list) and len(task) > 1:
            middle = len(task) // 2
            return [task[:middle], task[middle:]]
        if not isinstance(task, list):
            self._forget(task.scan if isinstance(task, Range) else task)
        why = str(error) if isinstance(error, ServotapError) else f"its worker died or failed: {type(error).__name__}"
        self._give_up(works_of(task)[0], why)
        return []

    def _give_up(self, work: Work, reason: str) -> None:
        self._take(Taken([work.row(status="failed", reason=reason)], read=work.found.size))

    def _take(self, taken: Taken) -> None:
        outcome = self.outcome
        self._waiting.append(taken)
        outcome.done += len(taken.captures)
        outcome.read += taken.read
        outcome.frames += taken.frames
        for row in taken.captures:
            if row["status"] not in TAKEN and row["status"] != "known":
                outcome.unread.append((row["name"], row["reason"]))

    def _of_small_files(self) -> list[str]:
        count, partitions = len(self._sizes), self.lake.destination.partitions
        if count < _MANY or sum(self._sizes) > _SMALL * count or partitions != PARTITIONS:
            return []
        small = f"{count:,} data files of {sum(self._sizes) / count / 1000:.1f} kB on average"
        return [f"{small}: a new lake with --partition-by date has fewer and larger ones"]

    def commit(self) -> None:
        if self._waiting:
            self._sizes += [file.size for each in self._waiting for file in each.added]
            new = self.lake.commit(self._waiting)
            self.outcome.new += new
            self.outcome.known += (
                sum(row["status"] in (*TAKEN, "known") for each in self._waiting for row in each.captures) - new
            )
            self.outcome.batches += 1
            self._waiting = []
        self.outcome.notes = self.lake.notes + self._of_small_files()
        self._since = time.monotonic()
