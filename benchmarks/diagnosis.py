#!/usr/bin/env python3
"""What diagnosis costs on clean traffic, beside decoding the same.

    python benchmarks/diagnosis.py [--frames N] [--rounds N]

Each dialect's reads of a position and a speed with their replies, one every millisecond. Decoding: the pipeline with a sink
that counts. With diagnosis: the watch beside it, and the causes at the end. Seconds are those of the processor, the best of the
rounds counts, and `extra` is for a million frames.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from analyzer import dialects
from analyzer.catalogue import Dialect, Role, Verb
from analyzer.diagnosis.diagnose import diagnosis
from analyzer.diagnosis.watch import Watch
from analyzer.encoder import assemble
from analyzer.entries import Entry
from analyzer.pipeline import Pipeline
from analyzer.records import CanFrame, Chunk, Comment, Finding, Frame, Junk, Lane

VERBS = (Verb.READ_POSITION, Verb.READ_SPEED, Verb.READ_STATE_1, Verb.READ_STATE_2)
PERIOD_NS = 1_000_000
#: Seconds that a million frames may cost beside decoding.
LIMIT = 1.0


class Counting:
    """A sink that counts frames."""

    frames = 0

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        """Count a frame that is in order."""
        self.frames += 1

    def entry(self, entry: Entry) -> None:
        """Count a frame."""
        self.frames += 1

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        """Pass it over."""

    def finding(self, found: Finding) -> None:
        """Pass it over."""

    def comment(self, comment: Comment) -> None:
        """Pass it over."""


def items(dialect: Dialect) -> Iterator[Chunk | CanFrame]:
    """Yield requests and replies without an end."""
    reads = [dialect.by_verb[verb] for verb in VERBS if verb in dialect.by_verb]
    pairs = [assemble(dialect, command, 1, {}, role).item() for command in reads for role in (Role.REQUEST, Role.REPLY)]
    t_ns = 1_700_000_000_000_000_000
    while True:
        for item in pairs:
            t_ns += PERIOD_NS
            if isinstance(item, CanFrame):
                yield CanFrame(t_ns, "can0", item.id, item.data)
            else:
                yield Chunk(t_ns, "bus", item)


def seconds(dialect: Dialect, frames: int, *, watched: bool) -> float:
    """Return how long it takes."""
    counting, watch = Counting(), Watch()
    pipeline = Pipeline([dialect], [counting, watch] if watched else [counting])
    given = list(islice(items(dialect), frames))
    gc.collect()
    gc.freeze()
    began = time.process_time()
    if watched:
        for item in given:
            watch.take(item)
            pipeline.feed(item)
    else:
        for item in given:
            pipeline.feed(item)
    pipeline.close()
    found = diagnosis(watch, [dialect]) if watched else None
    took = time.process_time() - began
    assert counting.frames == frames, f"{counting.frames} frames of {frames}"
    assert found is None or found.verdict == "ok", found
    return took


def main() -> int:
    """Run the command line; return 1 where diagnosis costs more than it may."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=2)
    arguments = parser.parse_args()
    worst = 0.0
    print(f"{'dialect':<12} {'frames':>9} {'decoding s':>11} {'with diagnosis s':>17} {'extra s/million':>16}")
    for dialect in dialects.every():
        rounds = [
            [seconds(dialect, arguments.frames, watched=watched) for watched in (False, True)] for _ in range(arguments.rounds)
        ]
        took = [min(column) for column in zip(*rounds, strict=True)]
        extra = (took[1] - took[0]) * 1e6 / arguments.frames
        worst = max(worst, extra)
        print(f"{dialect.name:<12} {arguments.frames:>9} {took[0]:>11.2f} {took[1]:>17.2f} {extra:>16.2f}", flush=True)
    # A small run measures what loading costs.
    return int(worst > LIMIT and arguments.frames >= 1_000_000)


if __name__ == "__main__":
    sys.exit(main())
