"""Motions without a law of ramps crossed: each has each speed, start and interruption either way, and rows are short."""

from __future__ import annotations

from itertools import chain, product

import pytest

from analyzer import dialects
from conformance.claim import Outcome
from conformance.claims import every
from conformance.claims.crossed import goals
from conformance.claims.crossed.goals import OFF, ON, STOP
from conformance.drives import make
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig

LK = dialects.get("lk-rs485")


def _outcome(drive: str, name: str) -> Outcome:
    rig = EmulatedRig(make.parse(drive))
    return engine.run_claim(next(c for c in every(rig.dialect) if c.id.endswith(f"/{name}")), rig).outcome


@pytest.mark.parametrize("model", LK.models)
def test_each_motion_has_each_start_and_what_can_come_on_its_way_either_way(model):
    table = goals.table(LK.for_model(model))
    commands = {row.command for row in table}
    assert len(commands) == 8
    assert {(*row[:2], row.start) for row in table} == set(product(commands, (1, -1), (0, 1, -1)))
    assert {(*row[:2], row.meets) for row in table if row.meets} == set(product(commands, (1, -1), (STOP, OFF, ON)))


@pytest.mark.parametrize("name", ["mks-rs485", "mks-modbus", "mks-can"])
def test_a_drive_with_a_law_of_ramps_has_none(name):
    assert goals.motions_of(dialects.get(name)) == ()
    assert goals.reads_of(dialects.get(name)) == []


def test_few_rows_show_each_condition_once_and_each_end_either_way():
    first, rows = goals.first_rows(LK.for_model("MF")), goals.table(LK.for_model("MF"))
    far = [row for row in rows if "multi" not in row.command and (row.turns > 0.2 or row.command.startswith("run"))]
    assert len(first) <= 10
    assert [row for row in rows if row in first] == list(first)
    assert {*chain(*map(enumerate, first))} == {*chain(*map(enumerate, far))}
    assert {(row.way, row.meets) for row in first} == {(row.way, row.meets) for row in far}


def test_the_rows_are_short():
    for row in goals.table(LK.for_model("MF")):
        assert row.turns * 60 / (row.rpm or 110) <= 1.5, row


@pytest.mark.parametrize(
    ("fault", "claim"),
    [
        ("lk-motion-speed-0", "move_single_turn/crossed-tells"),
        ("lk-whole-turns-ignored", "move_increment_limited/crossed-ends"),
        ("lk-max-speed-ignored", "move_multi_turn_limited/crossed-speed"),
        ("lk-max-speed-half-below", "move_multi_turn_limited/crossed-speed"),
        ("lk-stop-ignored-backwards", "run_torque/crossed-stopped"),
        ("lk-on-resumes", "move_increment/crossed-stopped"),
        ("lk-stop-drops-turns-of-a-run", "read_position/crossed"),
        ("lk-state-always-on", "read_state_1/standing"),
        ("lk-position-single-turn", "read_position/standing"),
        ("lk-single-turn-runs-on", "read_single_turn/standing"),
        ("lk-phases-doubled", "read_state_3/crossed"),
        ("lk-stalled-while-turning", "read_state_1/crossed-first"),
        ("lk-off-keeps-torque", "run_torque/crossed-first"),
        ("lk-torque-told-after-stop", "read_state_2/crossed"),
        ("lk-no-torque-ignored", "run_torque/newer"),
        ("lk-phases-told-while-off", "read_state_3/crossed"),
        ("lk-increment-of-stopped-move", "move_increment/after-stop"),
        ("lk-single-turn-by-position", "move_single_turn/after-new-position"),
        ("lk-slow-runs-stand", "run_speed/slow"),
        ("lk-brake-reads-on-after-motion", "reads/run_speed"),
        ("lk-run-without-data-repeats", "run_speed/other-length"),
    ],
)
def test_a_fault_of_one_condition_is_refuted(fault, claim):
    assert _outcome(f"lk-rs485@1,model=MF,fault={fault}", claim) is Outcome.REFUTED


@pytest.mark.parametrize(
    "claim",
    [
        "move_multi_turn_limited/crossed-ends",
        "read_state_2/standing",
        "run_open_loop/crossed-tells",
        "run_open_loop/crossed-first",
        "read_state_1/crossed-first",
    ],
)
def test_an_honest_drive_on_a_poor_line_is_not(claim):
    assert _outcome("lk-rs485@1,model=MS,real=poor", claim) is Outcome.CONFIRMED
