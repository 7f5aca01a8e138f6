"""How long a run over a real line takes, without waiting for it: the rules of a real drive in virtual time, without a guard.

    python -m benchmarks.run_time [--target mks-rs485@1] [--short] [--rate 38400] [--allow RISKS|all] [--longest 15]

Prints the seconds of each theme, the claims that take longest, and the whole. A claim's seconds are those of its exchanges and
waits, of stopping and of putting back; the drive is the ideal one, and the port has no latency of its own.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from analyzer.catalogue import Risk, all_fields
from analyzer.layout import Effect
from analyzer.values import refusal
from conformance.claim import Claim, Outcome, RigFault, Verdict
from conformance.drives import make
from conformance.gate.budget import Budget
from conformance.gate.permissions import READS, Allowance, parse_allow
from conformance.safety.settings import changes
from conformance.suite import plan as suite
from conformance.suite import target as targets
from conformance.suite.dry_run import StandInRig
from conformance.suite.plan import Plan
from conformance.suite.target import Target

#: What is tested where no target is named, at which rate.
TARGETS = ("mks-rs485@1,model=42D", "mks-modbus@1,model=42D", "mks-can@1,model=42E", "lk-rs485@1,model=MF")
_SERIAL, _CAN = 38400, 500_000


class Timed(NamedTuple):
    """A claim, what came of it, and how long it took on the line."""

    claim: Claim
    verdict: Verdict
    seconds: float


def real(text: str, rate: int = 0) -> Target:
    """Return a target as on a port that there is not."""
    can = text.startswith("mks-can")
    place = f"can:virtual:none,bitrate={rate or _CAN}" if can else f"serial:none,baud={rate or _SERIAL}"
    return targets.parse(text, place)


def everything(target: Target, risks: frozenset[Risk] = frozenset(Risk), more: str = "") -> Plan:
    """Return a plan that allows these risks on a drive alone on its bus, and knows the settings that it cannot tell.

    `more`: of the drive's specification, as `in_a_group` has it.
    """
    if risks == READS:
        return Plan((target,), Allowance(risks))
    known = told(target, more)
    return Plan((target,), Allowance(risks, alone=True, budget=Budget(wear=None)), settings={"": known})


def told(target: Target, more: str = "") -> dict[str, str]:
    """Return the settings of a new drive as a user would tell them (`--settings`)."""
    drive = make.make(specification(target, more))
    fields = {n: f for c in drive.dialect.commands if changes(c) for n, f in all_fields(c.request_forms).items()}
    # What a restart forgets is not stored, but a user can say what it is: ports with their own signals.
    held = vars(getattr(drive, "memory", object)) | drive.settings
    known = {name: field for name, field in fields.items() if name in held and not refusal(field, held[name])}
    return {name: f"{field.physical(held[name]):.12g}" for name, field in known.items()}


def in_a_group(target: Target) -> str:
    """Return the setting of a drive that is in a group: a new one is in none, and cannot be put back into none."""
    return ",group_address=200" if target.dialect.effect(Effect.GROUP) is not None else ""


def specification(target: Target, more: str = "") -> make.Specification:
    """Return an emulated drive at the rate of the target's line."""
    assert target.endpoint is not None
    word = "bitrate" if target.dialect.bus == "can" else "baud"
    return make.parse(f"{target.text},{word}={target.endpoint.bits_per_second}{more}")


def timed(plan: Plan, target: Target, rig: StandInRig) -> Iterator[Timed]:
    """Run what a plan selects and yield how long each claim took on the line."""
    began = rig.gate.now_ns()
    for verdict in suite.verdicts(plan, target, plan.selected(target), rig):
        ended = rig.gate.now_ns()
        yield Timed(verdict.claim, verdict, (ended - began) / 1e9)
        began = ended


def show(target: Target, plan: Plan, longest: int) -> None:
    """Run a plan and print what took how long."""
    began = time.monotonic()
    rig = StandInRig(plan, target, specification(target))
    before = rig.gate.now_ns() / 1e9
    rig.noise  # noqa: B018  # it is measured before the first claim
    found = list(timed(plan, target, rig))
    ending = rig.gate.now_ns()
    try:
        rig.close()
    except RigFault as error:
        print(f"    {error}")
    ended = (rig.gate.now_ns() - ending) / 1e9
    total = rig.gate.now_ns() / 1e9
    ran = [each for each in found if each.verdict.outcome is not Outcome.NOT_RUN]
    print(f"{target.text} on {target.on}: {len(ran)} of {len(found)} claims, {total:.1f} s of line time")
    odd = [e for e in ran if e.verdict.outcome in (Outcome.REFUTED, Outcome.INCONCLUSIVE)]
    for each in odd:
        print(f"    {each.verdict.outcome}: {each.claim.id}: {each.verdict.reason}")
    reasons = Counter(e.verdict.reason for e in found if e.verdict.outcome is Outcome.NOT_RUN)
    for reason, count in reasons.most_common(5):
        print(f"    not run: {count} x {reason}")
    themes: dict[str, list[float]] = defaultdict(list)
    for each in ran:
        themes[each.claim.theme.value].append(each.seconds)
    for theme, seconds in sorted(themes.items(), key=lambda item: -sum(item[1])):
        print(f"    {sum(seconds):7.1f} s {len(seconds):5} claims  {theme}")
    print(f"    {before:7.1f} s to find it, {ended:.1f} s at the end")
    for each in sorted(ran, key=lambda e: -e.seconds)[:longest]:
        print(f"        {each.seconds:6.2f} s  {each.claim.id}")
    print(f"    ({time.monotonic() - began:.0f} s by the wall clock)", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", action="append", default=[], help=f"default: {' '.join(TARGETS)}")
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--rate", type=int, default=0, help=f"default {_SERIAL}, on CAN {_CAN}")
    parser.add_argument("--allow", default="all", help="risks, or all (default); read: nothing is allowed")
    parser.add_argument("--longest", type=int, default=15)
    arguments = parser.parse_args()
    risks = frozenset(Risk) if arguments.allow == "all" else parse_allow(arguments.allow)
    for text in arguments.target or TARGETS:
        target = real(text, arguments.rate)
        plan = everything(target, risks)
        show(target, replace(plan, short=arguments.short), arguments.longest)
    return 0


if __name__ == "__main__":
    sys.exit(main())
