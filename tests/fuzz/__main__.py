"""Fuzz by the clock: `make fuzz`, or

    python -m tests.fuzz --seconds 7200 --jobs 2              hours by hand
    python -m tests.fuzz --target decode --target show        some targets only
    python -m tests.fuzz --target show --seed 7 --number 123  one input again
    python -m tests.fuzz --replay                             the corpus alone, as `make test` does
    python -m tests.fuzz --coverage --target pipeline         led by coverage (needs atheris)

Without --seed half of the time runs seed 1, the other half a new one, which is printed. A finding is shrunk and written
into the corpus under the kind of its fault, its seed and its number. Ends with 1 if there are findings.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from multiprocessing.connection import wait
from pathlib import Path

from tests.fuzz.corpus import FOLDER, INPUT, Input, entries, save
from tests.fuzz.engine import MUTATOR, Finding, Worker, eprint, fuzzing, made, outcomes, shrunk, warm
from tests.fuzz.targets import TARGETS, key_of

PROGRESS_S = 10.0


class Session:
    """One run with one seed after the other, and what it found."""

    def __init__(self, targets: list[str], jobs: int, corpus: Path, shrink_s: float) -> None:
        self._targets = targets
        self._jobs = jobs
        self._corpus = corpus
        self._shrink_s = shrink_s
        self._seeds = {name: TARGETS[name].seeds() for name in targets}
        warm([name for name in targets if TARGETS[name].forks], self._seeds)
        self._told = 0.0
        self.found: dict[tuple[str, str], Finding] = {}
        self.counts: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()

    def run(self, seed: int, seconds: float) -> None:
        """Fuzz with a seed for so long."""
        until = time.monotonic() + seconds
        done: Counter[tuple[int, str]] = Counter()
        workers: dict[int, Worker] = {}
        try:
            while workers or time.monotonic() < until:
                for slot in range(self._jobs):
                    if slot not in workers and time.monotonic() < until:
                        starts = {t: slot + self._jobs * done[slot, t] for t in self._targets}
                        workers[slot] = Worker(fuzzing(self._targets, seed, starts, self._jobs, until, self._seeds))
                wait([w.pipe for w in workers.values()], 0.5)
                for slot, worker in list(workers.items()):
                    if self._heard_all(worker):
                        self._end(slot, workers.pop(slot), seed, done)
                if time.monotonic() > self._told + PROGRESS_S:
                    self._told = time.monotonic()
                    self._tell(workers)
        finally:
            for slot, worker in workers.items():
                worker.process.kill()
                self._count(slot, worker, done)

    def _heard_all(self, worker: Worker) -> bool:
        """Take what a worker has found so far; say whether it has ended."""
        while worker.pipe.poll():
            try:
                self._take(worker.pipe.recv())
            except EOFError:
                return True
        worker.watch()
        return False

    def _end(self, slot: int, worker: Worker, seed: int, done: Counter[tuple[int, str]]) -> None:
        """Note what a worker did that has ended, and what it died of."""
        worker.process.join()
        self._count(slot, worker, done)
        if worker.died:
            index, number, _ = worker.board.now
            target = list(TARGETS)[index]
            self._take(Finding(target, seed, number, key_of(worker.died), worker.died))
            # The next worker of this slot goes on behind it.
            done[slot, target] = max(done[slot, target], (number - slot) // self._jobs + 1)
        worker.close()

    def _count(self, slot: int, worker: Worker, done: Counter[tuple[int, str]]) -> None:
        for target in self._targets:
            count, seconds = worker.board.of(list(TARGETS).index(target))
            self.counts[target] += count
            self.seconds[target] += seconds
            done[slot, target] += count

    def _take(self, finding: Finding) -> None:
        """Shrink a finding that is new and write it into the corpus."""
        if (finding.target, finding.key) in self.found:
            return
        once = f"{finding.key} once, not again: {_options(finding)}"
        if finding.key == MUTATOR:
            if "MemoryError" in finding.text:
                # Inputs before this one have left memory behind: here it is made, or what was wrong comes again.
                made(finding.target, finding.seed, finding.number, self._seeds[finding.target])
                eprint(once)
                return
            self.found[finding.target, finding.key] = finding
            eprint(f"FOUND {finding.text} ({_options(finding)})")
            return
        given = made(finding.target, finding.seed, finding.number, self._seeds[finding.target])
        if finding.key.startswith(("hang", "MemoryError")) and not outcomes(finding.target, [given])[0]:
            # A busy machine charges a process for more than it worked, and inputs before this one have left memory behind.
            eprint(once)
            return
        self.found[finding.target, finding.key] = finding
        path = self._corpus / finding.target / f"{finding.key}-{finding.seed}-{finding.number}"
        eprint(f"FOUND {finding.target}: {finding.key} ({_options(finding)})")
        save(shrunk(finding, given, self._shrink_s), path)
        lines = finding.text.strip().splitlines()
        # A stack begins with where it was, a traceback ends with it.
        shown = lines[:6] if finding.key.startswith("hang") else lines[-6:]
        eprint(f"  {path}\n" + "".join(f"  | {line}\n" for line in shown))

    def _tell(self, workers: dict[int, Worker]) -> None:
        now = self.counts.copy()
        for worker in workers.values():
            now.update({t: worker.board.of(list(TARGETS).index(t))[0] for t in self._targets})
        spent = time.monotonic() - START
        eprint(f"{spent:6.0f} s  {now.total()} inputs, {now.total() / spent:.0f}/s  {len(self.found)} findings")

    def summary(self) -> str:
        """Return inputs and findings of each target, and at the end how each finding is repeated."""
        rows = [
            f"{name:<15} {self.counts[name]:>9} inputs {self.counts[name] / max(0.001, self.seconds[name]):>7.0f}/s"
            f"  {', '.join(key for target, key in self.found if target == name)}"
            for name in self._targets
        ]
        found = [f"FOUND {each.target}: {each.key} ({_options(each)})" for each in self.found.values()]
        return "\n".join([*rows, f"{'all':<15} {self.counts.total():>9} inputs, {len(self.found)} findings", *found])


def _options(finding: Finding) -> str:
    """Return the options that repeat the input of a finding."""
    return f"--target {finding.target} --seed {finding.seed} --number {finding.number}"


def replay(targets: list[str], corpus: Path) -> int:
    """Run the corpus; return how many entries show a fault."""
    failed = 0
    for target in targets:
        named: list[tuple[str, Input]] = list(entries(target, corpus))
        for (name, _), text in zip(named, outcomes(target, [given for _, given in named]), strict=True):
            if text:
                failed += 1
                eprint(f"{target}/{name}: {text}")
    return failed


def again(target: str, seed: int, number: int) -> str:
    """Run one input; return what is wrong."""
    return outcomes(target, [made(target, seed, number, TARGETS[target].seeds())])[0]


def led_by_coverage(targets: list[str], seconds: float, seeds: list[int], corpus: Path) -> int:
    """Fuzz one target after the other led by coverage, each in a process of its own."""
    alone = [t for t in targets if list(TARGETS[t].seeds()[0]) == [INPUT]]
    words = [[t, str(seconds / len(alone) / len(seeds)), str(seed), str(corpus)] for t in alone for seed in seeds]
    return max(subprocess.run([sys.executable, "-m", "tests.fuzz.coverage", *each]).returncode for each in words)


START = time.monotonic()


def main() -> int:
    """Run as the options say; return 1 if there are findings."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, action="append", default=[])
    parser.add_argument("--number", type=int)
    parser.add_argument("--target", choices=TARGETS, action="append", default=[])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--corpus", type=Path, default=FOLDER, help="where findings are written (default: %(default)s)")
    parser.add_argument("--shrink", type=float, default=20.0, metavar="S", help="time to shrink a finding")
    parser.add_argument("--replay", action="store_true")
    parser.add_argument("--coverage", action="store_true")
    arguments = parser.parse_args()
    targets = arguments.target or list(TARGETS)
    arguments.corpus = arguments.corpus.resolve()
    if arguments.replay:
        failed = replay(targets, arguments.corpus)
        print(f"{failed} entries of the corpus show a fault" if failed else "the corpus holds")
        return int(failed > 0)
    if arguments.number is not None:
        text = again(targets[0], arguments.seed[0] if arguments.seed else 1, arguments.number)
        print(text or "all holds")
        return int(bool(text))
    if arguments.coverage:
        return led_by_coverage(targets, arguments.seconds, arguments.seed or [1], arguments.corpus)
    seeds = arguments.seed or [1, int.from_bytes(os.urandom(4), "little")]
    print(f"seeds: {' '.join(map(str, seeds))}; targets: {' '.join(targets)}", flush=True)
    session = Session(targets, arguments.jobs, arguments.corpus, arguments.shrink)
    # Ended early, by Ctrl-C or kill, it tells what it did so far.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        for seed in seeds:
            session.run(seed, arguments.seconds / len(seeds))
    print(session.summary())
    return int(bool(session.found))


if __name__ == "__main__":
    sys.exit(main())
