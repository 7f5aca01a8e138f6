"""Fuzzing led by coverage: atheris keeps what reaches new code and goes on from there, with the mutators of `mutators.py`.

    python -m tests.fuzz.coverage TARGET SECONDS SEED CORPUS

Started by `python -m tests.fuzz --coverage`. Only the analyzer is instrumented; so it must not be imported before. A finding
goes into the corpus, and the run goes on; a hang or too much memory ends it, and libFuzzer writes the input beside.
"""

from __future__ import annotations

import os
import random
import sys
import time
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["analyzer"], enable_loader_override=False):
    from tests.fuzz.corpus import INPUT, save
    from tests.fuzz.engine import scratch
    from tests.fuzz.running import heard
    from tests.fuzz.targets import TARGETS, attempt, key_of

PROGRESS_S = 10.0
SIZE_LIMIT = 1 << 16


def main(target: str, seconds: str, seed: str, corpus: str) -> None:
    """Fuzz one target; libFuzzer ends the process."""
    seeds = [given for given in TARGETS[target].seeds() if list(given) == [INPUT]]
    found: set[str] = set()
    screen = os.fdopen(os.dup(2), "w", buffering=1)
    count, told = 0, time.monotonic()

    def run(data: bytes) -> None:
        nonlocal count, told
        count += 1
        given = {INPUT: data}
        text = attempt(target, given, folder, said)
        if text and key_of(text) not in found:
            found.add(key_of(text))
            save(given, Path(corpus) / target / f"{key_of(text)}-{seed}-coverage-{count}")
            screen.write(f"FOUND {target}: {key_of(text)}\n{text}\n")
        if time.monotonic() > told + PROGRESS_S:
            told = time.monotonic()
            screen.write(
                f"{target}: {count} inputs, {len(found)} findings, {len(list(kept.iterdir()))} inputs that reach new code\n"
            )

    def mutate(data: bytes, limit: int, number: int) -> bytes:
        if data == b"\n":
            return seeds[number % len(seeds)][INPUT]
        made = TARGETS[target].mutate(random.Random(number), {INPUT: data}, seeds)[INPUT]
        return made if len(made) <= limit else data

    with scratch() as name, scratch() as work, heard() as said:
        folder, kept = Path(name), Path(work)
        for number, each in enumerate(seeds):
            (kept / str(number)).write_bytes(each[INPUT])
        options = (
            f"-max_total_time={int(float(seconds))}", f"-seed={int(seed) & 0x7FFFFFFF or 1}", f"-max_len={SIZE_LIMIT}",
            "-len_control=0", f"-timeout={int(TARGETS[target].seconds) * 4}",
            f"-artifact_prefix={Path(corpus).resolve() / target}/coverage-",
        )  # fmt: skip
        (Path(corpus) / target).mkdir(parents=True, exist_ok=True)
        atheris.Setup(["fuzz", *options, work], run, custom_mutator=mutate)
        atheris.Fuzz()


if __name__ == "__main__":
    main(*sys.argv[1:])
