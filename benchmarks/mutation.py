"""The mutation score of the conformance suite: every named fault of every dialect, every claim.

    python benchmarks/mutation.py [--dialect D] [--jobs N]

It prints for each fault how many claims refute it, and how many of these run on hardware without hands on the drive. Then it
prints the faults that survive, the claims that refute no fault, and the time of the suite alone. A full run takes about an
hour on two cores.
"""

from __future__ import annotations

import argparse
import os
import sys
import time

from conformance.drives import make
from conformance.suite import plan
from conformance.suite.target import every_emulated, parse
from conformance.tools.mutants import run_mutants


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dialect", choices=list(make.KINDS), help="only this one")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--quick", action="store_true", help="a mutant ends at its first refutation (some minutes)")
    arguments = parser.parse_args()
    targets = every_emulated() if arguments.dialect is None else [parse(f"{arguments.dialect}@1")]
    started = time.perf_counter()
    count = sum(1 for _ in plan.run(plan.Plan(tuple(targets)), arguments.jobs))
    seconds = time.perf_counter() - started
    print(f"the suite itself: {count} claims in {seconds:.1f} s with {arguments.jobs} processes", flush=True)
    return run_mutants(plan.Plan(tuple(targets)), jobs=arguments.jobs, full=not arguments.quick)


if __name__ == "__main__":
    sys.exit(main())
