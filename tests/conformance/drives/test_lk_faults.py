"""Each named fault of the LK drive shows on the bus: an exchange whose answer differs from the conforming drive's."""

from __future__ import annotations

import random
from collections import defaultdict
from functools import cache, partial

import pytest

from conformance.drives.drive import Fault
from conformance.drives.make import every_fault
from tests.conformance.claims.test_refuted import pairs
from tests.conformance.drives.lk_bench import SECOND, STEP_NS, Bench, Script
from tests.conformance.drives.lk_story import SCRIPTS, multi_turn
from tests.conformance.drives.test_mks_faults import any_request

#: The faults that only an LK drive has; the others are shown by the claims that refute them.
REFUTED = pairs()
FAULTS = [f for f in every_fault() if f.dialects == ("lk-rs485",) and ("lk-rs485", f.name) not in REFUTED]


def played(script: Script, *faults: Fault) -> list[list[tuple[int, str]]]:
    bench = Bench(model="MF", faults=faults)
    script(bench)
    return bench.trace


@cache
def conforming(script: Script) -> list[list[tuple[int, str]]]:
    return played(script)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.name)
def test_fault_shows(fault: Fault) -> None:
    shown = any(played(script, fault) != conforming(script) for script in SCRIPTS)
    assert shown, "no claim of REFUTES refutes it, and no exchange of lk_story shows it"


def test_a_script_goes_the_same_every_time() -> None:
    for script in SCRIPTS:
        assert played(script) == conforming(script)


@pytest.mark.parametrize("model", ["MF", "MS"])
def test_no_fault_makes_a_drive_raise(model: str) -> None:
    chance = random.Random(model)
    for fault in [f for f in every_fault() if "lk-rs485" in f.dialects]:
        bench = Bench(model=model, faults=(fault,))
        for _ in range(30):
            if chance.random() < 0.1:
                chance.choice([bench.drive.block, partial(bench.drive.hot, 300), partial(bench.drive.supply, 5)])()
            bench.send(any_request(chance, bench.drive.dialect)[0])
            bench.t_ns += chance.choice([0, STEP_NS, SECOND])
            bench.drive.advance(bench.t_ns)


def test_no_two_faults_are_one() -> None:
    """Over all exchanges, two faults differ somewhere; those that differ already are not played again."""
    alike = [list(FAULTS)]
    for script in SCRIPTS:
        shown = defaultdict(list)
        for number, group in enumerate(alike):
            for fault in group:
                shown[number, repr(played(script, fault))].append(fault)
        alike = [group for group in shown.values() if len(group) > 1]
    assert alike == []


def test_faults_of_one_drive_are_not_those_of_another() -> None:
    faulty, good = Bench(faults=FAULTS[:1]), Bench()
    multi_turn(faulty)
    multi_turn(good)
    assert good.trace == conforming(multi_turn)
    assert faulty.trace != good.trace
