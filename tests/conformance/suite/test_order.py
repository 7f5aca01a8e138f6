"""The order of a real run, and the short run: tables that name what there is, the same order again, what fits in 90 s."""

from __future__ import annotations

from itertools import pairwise

import pytest

from analyzer.catalogue import Risk
from benchmarks.order import SEARCHED, Measured, greedy, known
from conformance.claim import Claim, Theme
from conformance.cli.test import time_left
from conformance.gate.permissions import Allowance
from conformance.suite import order
from conformance.suite import plan as suite
from conformance.suite.plan import Plan
from conformance.suite.target import Target, parse
from conformance.tools import mutants

_PLACES = {
    "mks-rs485@1,model=42D": "serial:none,baud=38400",
    "mks-modbus@1,model=42D": "serial:none,baud=38400",
    "mks-can@1,model=42E": "can:virtual:none,bitrate=500000",
    "lk-rs485@1,model=MF": "serial:none,baud=38400",
}
_TARGETS = [parse(drive, place) for drive, place in _PLACES.items()]
_EVERYTHING = Allowance(frozenset(Risk), alone=True)
#: Of the claims, those that a table may not know: they get an estimate.
_UNKNOWN_SHARE = 0.1

each_target = pytest.mark.parametrize("target", _TARGETS, ids=lambda target: target.dialect.name)


def _seconds(plan: Plan, target: Target) -> float:
    return sum(order.seconds(claim, target.rate) for claim in plan.selected(target))


@each_target
def test_a_table_names_claims_that_there_are_and_knows_nearly_all_kinds(target: Target) -> None:
    known, claims = order.table(target.dialect.name), suite.every_claim(target)
    assert set(known.first) <= {claim.id.split("/", 1)[1] for claim in claims}
    possible = [claim for claim in claims if not claim.emulated and not claim.by_name]
    unknown = [claim.id for claim in possible if order.kind(claim) not in known.kinds]
    assert len(unknown) <= _UNKNOWN_SHARE * len(possible), f"make the tables anew (benchmarks/order.py): {unknown}"


@each_target
def test_what_was_searched_for_is_of_faults_and_claims_that_there_are(target: Target) -> None:
    claims = {claim.id for claim in suite.every_claim(target)}
    faults = {fault.name for fault in mutants.faults_of(target.dialect)}
    for fault, refuted in known((SEARCHED,))[target.dialect.name].items():
        assert fault in faults
        assert refuted <= claims, fault


@each_target
def test_the_order_is_the_same_again_and_leaves_nothing_out(target: Target) -> None:
    claims = suite.every_claim(target)
    found = order.ordered(claims, target.rate)
    assert [c.id for c in found] == [c.id for c in order.ordered(tuple(claims), target.rate)]
    assert sorted(c.id for c in found) == sorted(c.id for c in claims)


@each_target
def test_settings_are_proved_to_need_no_distance_before_one_is_changed(target: Target) -> None:
    found = order.ordered(suite.every_claim(target), target.rate)
    hasty = [number for number, claim in enumerate(found) if claim.hasty]
    assert all(Risk.SETTING not in claim.risks for claim in found[: min(hasty, default=0)])


@each_target
def test_a_short_run_fits_into_90_seconds_and_fills_them(target: Target) -> None:
    short = Plan((target,), _EVERYTHING, settings={"": {"work_mode": "2", "subdivision": "16"}}, short=True)
    before = order.start_seconds(target.dialect.name, target.rate, alone=True)
    assert 60 < before + _seconds(short, target) <= order.SHORT_SECONDS
    reads = Plan((target,), short=True)
    assert all(not claim.risks for claim in reads.selected(target))
    assert _seconds(reads, target) <= order.SHORT_SECONDS


def test_a_slower_line_gets_fewer_claims() -> None:
    fast, slow = (parse("mks-modbus@1,model=42D", f"serial:none,baud={rate}") for rate in (115200, 9600))
    counts = [len(Plan((t,), _EVERYTHING, short=True).selected(t)) for t in (fast, slow)]
    assert counts[0] > counts[1] > 0


@pytest.mark.parametrize(("left", "ran"), [(90.0, ["recorder", "judge", "read"]), (60.0, ["read"]), (60.5, ["read"])])
def test_what_judges_a_recording_that_is_left_out_is_left_out_too(monkeypatch, left: float, ran: list[str]) -> None:
    first = {"shape/recorder": order.Cost(20.0, 0), "shape/judge": order.Cost(0.0, 0), "shape/read": order.Cost(1.0, 0)}
    known = order.Table(first=first, behind={"shape/judge": ("shape/recorder",)})
    monkeypatch.setattr(order, "table", lambda dialect: known)
    claims = [Claim(f"x/{name}", Theme.SHAPE, "x", "x", "", "y", lambda probe: None) for name in first]
    assert [c.id for c in order.fitting(claims, 38400, left)] == [f"x/shape/{name}" for name in ran]
    assert [c.id for c in order.fitting(claims[1:], 38400, left)] == [f"x/shape/{name}" for name in ran if name != "recorder"]


def test_what_was_measured_fills_the_seconds_left_and_an_estimate_does_not(monkeypatch) -> None:
    first = {"shape/one": order.Cost(9.0, 0), "shape/two": order.Cost(9.0, 0), "shape/long": order.Cost(9.0, 0)}
    known = order.Table(first={**first, "shape/quick": order.Cost(1.0, 0)}, kinds={"shape/guess": order.Cost(0.1, 0)})
    monkeypatch.setattr(order, "table", lambda dialect: known)
    claims = [Claim(f"x/{name}", Theme.SHAPE, "x", "x", "", "y", lambda p: None) for name in ("shape/guess", *known.first)]
    monkeypatch.setattr(order, "LONGEST", 0.5)
    names = [c.id for c in order.fitting([*claims[1:], claims[0]], 38400, 20.0)]
    assert names == ["x/shape/one", "x/shape/two", "x/shape/quick"]
    assert claims[0] in order.fitting(claims[:1], 38400, 20.0)


@pytest.mark.parametrize(("pace", "count"), [(0.5, 20), (1.0, 10), (2.0, 5)])
def test_a_run_takes_as_many_claims_as_its_clock_lets_it(monkeypatch, pace: float, count: int) -> None:
    known = order.Table(first={f"shape/{number}": order.Cost(4.0, 0) for number in range(30)})
    monkeypatch.setattr(order, "table", lambda dialect: known)
    claims = [Claim(f"x/{name}", Theme.SHAPE, "x", "x", "", "y", lambda probe: None) for name in known.first]
    ran: list[Claim] = []
    for claim in order.fitting(claims, 38400, 42.0, lambda: 4.0 * pace * len(ran)):
        ran.append(claim)
    assert ran == claims[:count]


def test_a_short_run_says_what_the_user_could_give_for_more_claims() -> None:
    lacks = Plan((_TARGETS[0],), Allowance(frozenset(Risk) - {Risk.TORQUE}, alone=True), short=True).left_out(_TARGETS[0])
    assert lacks["it needs --allow torque"] > 100
    assert any("--settings FILE" in text for text in lacks)
    assert not Plan((_TARGETS[3],), _EVERYTHING, short=True).left_out(_TARGETS[3])


def test_what_no_table_knows_runs_behind_by_an_estimate() -> None:
    claims = list(suite.every_claim(_TARGETS[0]))
    own = Claim("mks-rs485/motion/of-a-package", Theme.MOTION, "mks-rs485", "x", "", "y", lambda probe: None)
    found = order.ordered([own, *claims], _TARGETS[0].rate)
    assert order.cost(own).waits > 0
    assert found.index(own) > len(order.table("mks-rs485").first) // 2


def test_claims_that_need_the_drive_ready_stand_together() -> None:
    plain = [f"mks-rs485/{name}" for name in order.table("mks-rs485").first]
    by_id = {claim.id: claim for claim in suite.every_claim(_TARGETS[0])}
    found = [c.id for c in order.ordered(by_id.values(), _TARGETS[0].rate) if c.id in set(plain)]

    def switches(ids: list[str]) -> int:
        return sum(by_id[one].settings != by_id[other].settings for one, other in pairwise(ids))

    assert switches(found) < switches(plain)


def test_the_time_left_is_what_was_planned_and_then_what_it_turned_out_to_be() -> None:
    assert time_left(90, 0, 5) == 90
    assert time_left(90, 30, 60) == 120
    assert time_left(90, 95, 60) == 0


def test_a_run_plans_no_time_for_claims_that_cannot_run() -> None:
    planned = Plan((_TARGETS[0],)).seconds(_TARGETS[0])
    assert planned["mks-rs485/motion/run_speed/speed-60"] == 0
    assert sum(planned.values()) > 0


def _measured(name: str, rest: float, **parts: float) -> Measured:
    return Measured(
        Claim(f"x/shape/{name}", Theme.SHAPE, "x", "x", "", "y", lambda probe: None), order.Cost(rest, 0), rest, parts, ()
    )


def test_claims_that_judge_one_recording_are_weighed_together() -> None:
    shared = {f"judge-{n}": _measured(f"judge-{n}", 0.0, motion=10.0) for n in range(5)}
    costs = {**shared, "alone": _measured("alone", 4.0), "late": _measured("late", 9.0)}
    refuted_by = {**{f"fault-{name}": {name} for name in costs}, "again": {"judge-0"}}
    assert greedy(costs, refuted_by) == [*shared, "alone", "late"]


def test_a_claim_whose_faults_others_refute_too_is_left_out() -> None:
    costs = {"first": _measured("first", 1.0), "one": _measured("one", 1.2), "two": _measured("two", 1.2)}
    refuted_by = {"a": {"first", "one"}, "b": {"first", "two"}, "c": {"one"}, "d": {"two"}, "e": {"first", "one"}}
    assert greedy(costs, refuted_by) == ["one", "two"]
