"""Motions without a law of ramps crossed: each has each speed, start and interruption either way, and rows are short."""

from __future__ import annotations

from itertools import chain, product

import pytest

from analyzer import dialects
from conformance.claim import Outcome
from conformance.claims.crossed import goals
from conformance.claims.crossed.goals import OFF, ON, STOP
from tests.conformance.theme_runs import judge

LK = dialects.get("lk-rs485")


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
    assert judge("lk-rs485@1,model=MS,real=poor", f"motion/{claim}").outcome is Outcome.CONFIRMED
