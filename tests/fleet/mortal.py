"""Ingests that die, each a process of its own: `python -m tests.fleet.mortal` reads what to do, a line of JSON each.

    {"captures": folder, "lake": folder, "step": N}       killed (SIGKILL) before it changes the lake for the Nth time
    {..., "cpu": seconds}                                 killed by the kernel after so much work
    {..., "longest": bytes}                               no file can grow longer (RLIMIT_FSIZE)
    {..., "at_once": N}                                   so many ingests at the same time

It answers for each with [signal or 0, steps, CPU seconds, what was told, new captures]. All are forked
from a process that has loaded everything.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import traceback
from pathlib import Path

import deltalake

from analyzer.errors import ServotapError
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place
from tests.fleet.lakes import ingest

#: What changes a lake.
STEPS = (
    (Place, "write"), (Place, "remove"), (deltalake, "write_deltalake"),
    (deltalake.DeltaTable, "create_write_transaction"), (deltalake.DeltaTable, "create"),
)  # fmt: skip


def watch(dies: int, count: list[int]) -> None:
    """Count what changes the lake, and die before one of these steps."""

    def watched(owner: object, name: str) -> None:
        real = getattr(owner, name)

        def step(*arguments: object, **named: object) -> object:
            count[0] += 1
            if count[0] == dies:
                os.kill(os.getpid(), signal.SIGKILL)
            return real(*arguments, **named)

        setattr(owner, name, step)

    for owner, name in STEPS:
        watched(owner, name)


def work(task: dict[str, object], told: int) -> None:
    """Take captures into a lake that is there, as the task says."""
    count = [0]
    watch(int(task.get("step", 0)), count)
    if "longest" in task:
        resource.setrlimit(resource.RLIMIT_FSIZE, (task["longest"], task["longest"]))
    if "cpu" in task:
        # The kernel ends the process; nothing of it runs any more.
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, task["cpu"])
    said, new = "", 0
    try:
        new = ingest(Lake(Place(task["lake"]), make=True), Path(task["captures"])).new
    except ServotapError as error:
        said = str(error)
    except BaseException:
        said = traceback.format_exc()
    os.write(told, json.dumps([count[0], said, new]).encode())


def main() -> None:
    """Do what stands in each line."""
    for line in sys.stdin:
        task = json.loads(line)
        begun = []
        for _ in range(task.get("at_once", 1)):
            answer, told = os.pipe()
            child = os.fork()
            if not child:
                work(task, told)
                os._exit(0)
            os.close(told)
            begun.append((child, answer))
        found = []
        for child, answer in begun:
            with open(answer, "rb") as stream:
                steps, said, new = json.loads(stream.read() or '[0, "", 0]')
            _, status, usage = os.wait4(child, 0)
            found.append([os.WTERMSIG(status), steps, usage.ru_utime + usage.ru_stime, said, new])
        print(json.dumps(found if "at_once" in task else found[0]), flush=True)


if __name__ == "__main__":
    main()
