"""Many captures decoded at once: each by one process, with one progress display and one summary over all.

    captures -> the longest first -> processes, one capture at a time each -> outcomes -> one summary

Rules: an error of one capture ends no other. Ctrl-C is passed on to every process; what each has read stays as a valid log, and
what was not begun is left. A process that dies takes its present capture with it, and no other.
"""

from __future__ import annotations

import argparse
import contextlib
import glob
import json
import os
import pickle
import selectors
import shutil
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from analyzer.cli.boundary import FAULT, refused, report
from analyzer.cli.decode_targets import Capture
from analyzer.cli.reading import meanwhile, showing_progress
from analyzer.cli.signals import ENDING, handled
from analyzer.errors import ServotapError
from analyzer.sinks.forked import Ends, Forked, available
from analyzer.values import counted, printable

#: Seconds between two looks at what the processes have done.
_LOOK = 0.2
#: Rows of the summary below one heading: a table takes 7 kB a row before it is printed, and a folder may have 100,000 captures.
_ROWS = 1000


@dataclass
class Outcome:
    """What became of a capture. `whole`: its summary as an object; `causes`: what is most likely wrong on the bus.

    `failed`: why there is none; `stopped`: a signal ended it early; `status`: of the command, were this its only capture.
    """

    whole: dict[str, Any] = field(default_factory=dict)
    causes: list[str] = field(default_factory=list)
    failed: str = ""
    stopped: bool = False
    status: int = 0


class Far:
    """How far a process is with its present capture: bytes and frames. `tell`: told so, too."""

    def __init__(self, tell: Callable[[tuple[int, int]], None] | None = None) -> None:
        self.position = self.frames = 0
        self._tell = tell

    def put(self, position: int, frames: int) -> None:
        self.position, self.frames = position, frames
        if self._tell is not None:
            self._tell((position, frames))

    @contextlib.contextmanager
    def noting(self, position: Callable[[], int], frames: Callable[[], int]) -> Iterator[None]:
        """While this is entered, note both again and again; where none is left to be told, end as at a signal."""

        def note(done: threading.Event) -> None:
            while not done.wait(_LOOK):
                try:
                    self.put(position(), frames())
                except BrokenPipeError:
                    os.kill(os.getpid(), signal.SIGTERM)
                    return

        with meanwhile(note):
            yield


#: Decodes a capture, and notes how far it is.
Decode = Callable[[Capture, argparse.Namespace, Far], Outcome]


def decode_many(captures: Sequence[Capture], arguments: argparse.Namespace, decode: Decode) -> int:
    """Decode captures, print one summary, and return the exit status. Raises KeyboardInterrupt after a signal."""
    jobs = min(arguments.jobs, len(captures)) if available() else 1
    arguments.jobs = max(1, arguments.jobs // jobs)
    started = time.monotonic()
    work = _Work(captures, arguments, decode, jobs)
    with handled(work.arrived), work.display():
        work.parallel() if jobs > 1 else work.one_by_one()
    outcomes = [(capture, work.outcomes[n]) for n, capture in enumerate(captures) if n in work.outcomes]
    if arguments.json:
        for _, outcome in outcomes:
            if outcome.whole:
                print(json.dumps(outcome.whole))
    else:
        _print_summary(outcomes, len(captures), time.monotonic() - started, work.asked)
    if work.asked:
        raise KeyboardInterrupt
    return max(outcome.status for _, outcome in outcomes)


class _Work:
    """Captures that are being decoded. `asked`: the signal that ended it, by name."""

    def __init__(self, captures: Sequence[Capture], arguments: argparse.Namespace, decode: Decode, jobs: int) -> None:
        self.asked = ""
        self.outcomes: dict[int, Outcome] = {}
        self._captures = captures
        self._arguments = arguments
        self._decode = decode
        # The longest first: so all processes end at about the same time.
        self._left = sorted(range(len(captures)), key=lambda n: captures[n].size)
        self._far = [Far() for _ in range(jobs)]
        self._children = [Forked(self._serve) for _ in range(jobs)] if jobs > 1 else []

    def arrived(self, number: int, frame: FrameType | None) -> None:
        """Take a signal: nothing more is begun."""
        self.asked = ENDING[number]

    def display(self) -> contextlib.AbstractContextManager[None]:
        """Show how far all captures are together."""
        captures = self._captures
        return showing_progress(
            lambda: f"decoding {len(captures)} captures, {len(self.outcomes)} done",
            sum(capture.size for capture in captures),
            lambda: sum(captures[n].size for n in list(self.outcomes)) + sum(far.position for far in self._far),
            lambda: (
                sum(outcome.whole.get("frames", 0) for outcome in list(self.outcomes.values()))
                + sum(far.frames for far in self._far)
            ),
        )

    def one_by_one(self) -> None:
        while self._left and not self.asked:
            number = self._left.pop()
            outcome = self._attempt(number, self._far[0])
            self._ended(number, outcome, self._far[0])
            if outcome.stopped:
                self.asked = self.asked or "a signal"

    def parallel(self) -> None:
        """Decode in the processes; what is left when all of them have died, here."""
        busy: dict[Forked, int] = {}
        with selectors.DefaultSelector() as waiting:
            for place, child in enumerate(self._children):
                waiting.register(child.source, selectors.EVENT_READ, place)
                self._begin(child, busy)
            while busy:
                for key, _ in waiting.select(_LOOK):
                    child = self._children[key.data]
                    answer = child.take()
                    told: Outcome | tuple[int, int] | None = pickle.loads(answer) if answer else None
                    if isinstance(told, tuple):
                        self._far[key.data].put(*told)
                        continue
                    number = busy.pop(child)
                    if told is not None:
                        self._ended(number, told, self._far[key.data])
                        self._begin(child, busy)
                    else:
                        waiting.unregister(child.source)
                        self._ended(number, self._lost(number, child.ended()), self._far[key.data])
                if self.asked:
                    # Again and again: one that has just begun a capture may not listen yet.
                    for child in busy:
                        os.kill(child.process, signal.SIGINT)
        for child in self._children:
            child.ended()
        self.one_by_one()

    def _begin(self, child: Forked, busy: dict[Forked, int]) -> None:
        if self._left and not self.asked:
            number = self._left.pop()
            busy[child] = number
            # If it has died, its empty answer tells.
            with contextlib.suppress(BrokenPipeError):
                child.give(number.to_bytes(4, "little"))

    def _serve(self, ends: Ends) -> None:
        # It is told of while a capture is decoded, and the outcome follows: the two never write at once.
        far = Far(lambda told: ends.give(pickle.dumps(told)))
        while data := ends.take():
            ends.give(pickle.dumps(self._attempt(int.from_bytes(data, "little"), far)))

    def _attempt(self, number: int, far: Far) -> Outcome:
        try:
            return self._decode(self._captures[number], self._arguments, far)
        except ServotapError as error:
            return Outcome(failed=str(error), status=error.exit_status)
        except KeyboardInterrupt:
            return Outcome(failed="interrupted, and nothing was written", stopped=True)
        except Exception as error:
            if why := refused(error):
                return Outcome(failed=why, status=2)
            report(error)
            return Outcome(failed=f"a fault of servotap: {type(error).__name__}", status=FAULT)

    def _lost(self, number: int, how: str) -> Outcome:
        """Return the outcome of a capture whose process died, and remove what it has left."""
        target = self._captures[number].target
        for part in target.parent.glob(f".{glob.escape(target.name)}.*.part"):
            shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink(missing_ok=True)
        return Outcome(failed=f"the process that decoded it died ({how}): it has no log; decode it again", status=2)

    def _ended(self, number: int, outcome: Outcome, far: Far) -> None:
        far.put(0, 0)
        self.outcomes[number] = outcome
        if outcome.failed and not outcome.stopped:
            path, text = self._captures[number].path, outcome.failed
            if path not in text:
                # An error names the file; here the folder counts, too.
                name = Path(path).name
                text = path + text.removeprefix(name) if text.startswith(name) else f"{path}: {text}"
            print(f"servotap decode: {printable(text)}", file=sys.stderr)


def _print_summary(outcomes: Sequence[tuple[Capture, Outcome]], count: int, seconds: float, asked: str) -> None:
    from rich.text import Text

    from analyzer.cli.console import Console, table

    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else 160)

    def line(text: str, style: str = "") -> None:
        console.print(Text(printable(text), style=style))

    numbers = ("frames", "junk bytes", "findings", "errors")
    heading = partial(table, "capture", "format", "dialect", *numbers, "log", numbers=numbers)
    good = [(capture, outcome) for capture, outcome in outcomes if outcome.whole]
    rows = heading()
    rules: Counter[str] = Counter()
    severity: dict[str, str] = {}
    where: dict[str, Counter[str]] = {}
    said: dict[str, list[str]] = {}
    frames = size = 0
    for capture, outcome in good:
        whole = outcome.whole
        found = whole["findings"]
        counts = (whole["frames"], sum(whole["bytes"]["junk"].values()), sum(each["count"] for each in found))
        errors = sum(each["count"] for each in found if each["severity"] == "error")
        row = (capture.path, whole["format"], ", ".join(whole["dialects"]), *map(str, (*counts, errors)), whole["log"])
        if rows.row_count == _ROWS:
            console.print(rows)
            rows = heading()
        rows.add_row(*(Text(printable(cell)) for cell in row))
        frames, size = frames + whole["frames"], size + (0 if outcome.stopped else capture.size)
        for each in found:
            rules[each["rule"]] += each["count"]
            severity[each["rule"]] = each["severity"]
            where.setdefault(each["rule"], Counter())[capture.path] += each["count"]
        for text in (*(f"note: {note}" for note in whole["notes"]), *outcome.causes):
            said.setdefault(text, []).append(capture.path)
    if good:
        console.print(rows)
    if rules:
        listed = table("finding", "severity", "count", "most of them in", numbers=("count",))
        for rule, times in rules.most_common():
            most, more = where[rule].most_common(1)[0][0], len(where[rule]) - 1
            also = f" and {counted(more, 'other')}" if more else ""
            listed.add_row(rule, severity[rule], str(times), Text(printable(most + also)))
        console.print(listed)
    elif good:
        line("no findings")
    for text, paths in said.items():
        also = f" and {counted(len(paths) - 1, 'other')}" if len(paths) > 1 else ""
        line(f"{paths[0]}{also}: {text}", "yellow" if text.startswith("note: ") else "")
    rate = f", {frames / seconds:,.0f} frames/s" if seconds > 0 and frames else ""
    line(f"decoded {len(good)} of {counted(count, 'capture')}: {counted(size, 'byte')}, {counted(frames, 'frame')}{rate}")
    if asked:
        line(
            f"stopped by {asked}: {counted(count - len(outcomes), 'capture')} not begun; the logs hold what came before",
            "yellow",
        )
