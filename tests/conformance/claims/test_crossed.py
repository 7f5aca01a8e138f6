"""Motions crossed: each command has each speed either way, the rows are short, and bounds leave rows out, not all of them."""

from __future__ import annotations

from itertools import product

import pytest

from analyzer import dialects
from analyzer.catalogue import Risk
from conformance.claim import Outcome
from conformance.claims import every
from conformance.claims.crossed import course, stops
from conformance.claims.motion import slowing
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.motion import ramp
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig

MKS = ("mks-rs485", "mks-modbus", "mks-can")


@pytest.mark.parametrize("name", MKS)
def test_each_command_has_each_speed_either_way(name):
    dialect = dialects.get(name)
    found = {(row.command, row.way, row.rpm) for row in course.table(dialect)}
    commands = {command.name for command in course.motions_of(dialect)}
    speeds = {rpm for _, _, rpm in found}
    # The slowest is one of runs alone: no move at it is short.
    assert found == {row for row in product(commands, (1, -1), speeds) if row[2] > min(speeds) or row[0] == "run_speed"}
    assert len(commands) == 5


@pytest.mark.parametrize("name", MKS)
def test_the_rows_are_short(name):
    for row in course.table(dialects.get(name)):
        moving_ns = ramp.move_ns(row.turns, row.rpm, row.acceleration) + (1 + abs(row.start)) * ramp.ramp_ns(
            0, row.rpm if not row.turns else 0, row.acceleration
        )
        assert moving_ns < 1_200_000_000, row


def test_a_drive_without_a_law_of_ramps_has_none():
    assert course.motions_of(dialects.get("lk-rs485")) == ()


def test_what_the_bounds_forbid_is_left_out_and_the_rest_is_judged():
    moving = frozenset({Risk.SETTING, Risk.MOTION, Risk.TORQUE})
    verdicts = {}
    for speed in (300, 10):
        rig = EmulatedRig(make.parse("mks-rs485@1"), allowance=Allowance(moving, speed=speed, turns=2, subdivision=16))
        claim = next(c for c in every(rig.dialect) if c.id.endswith("move_relative_axis/crossed-ends"))
        verdicts[speed] = engine.run_claim(claim, rig).outcome
    assert verdicts == {300: Outcome.CONFIRMED, 10: Outcome.NOT_RUN}


@pytest.mark.parametrize("name", ["mks-rs485", "mks-can"])
def test_few_rows_of_stops_and_of_what_comes_meanwhile_come_first_and_once(name):
    dialect = dialects.get(name)
    first, rows = stops.first_rows(dialect), stops.table(dialect)
    assert set(first) <= set(rows)
    assert 4 * len(first) <= len(rows)

    def meetings(rows):
        return {(met, row.stop == -1) for row in rows for met in (row.command, (row.mode, row.way))}

    assert meetings(first) == meetings(rows)
    assert {row.rpm for row in first} == {row.rpm for row in rows}
    few = slowing.first_rows(dialect)
    assert {row.comes for row in few} == {row.comes for row in slowing.table(dialect)}
    rig = EmulatedRig(make.parse(f"{name}@1"))
    claim = next(c for c in every(rig.dialect) if c.id.endswith("read_pulses/behind-stops"))
    shown = rig.probe(claim).recorded(stops.stopped, stops.first_rows)
    whole = rig.probe(claim).recorded(stops.stopped, stops.table)
    assert whole[: len(shown)] == shown
    assert sorted(tried.row for tried in whole) == sorted(rows)


@pytest.mark.parametrize(
    ("fault", "claim"),
    [
        ("fast-stop-ignored", "stop_speed/first-stops"),
        ("closed-cw-emergency-ignored", "emergency_stop/ends-move_absolute_pulses-first"),
        ("stops-lose-pulses", "read_pulses/behind-first-stops"),
        ("falling-motion-undone", "move_absolute_pulses/while-slowing-first"),
        ("moves-stay-enabled", "enable/while-slowing-first"),
    ],
)
def test_the_first_rows_refute_too(fault, claim):
    rig = EmulatedRig(make.parse(f"mks-rs485@1,fault={fault}"))
    found = next(c for c in every(rig.dialect) if c.id == f"mks-rs485/motion/{claim}")
    assert engine.run_claim(found, rig).outcome is Outcome.REFUTED
