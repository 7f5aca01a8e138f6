"""The tables of faults, and the changes that faults of all dialects are made of."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from analyzer import dialects
from analyzer.layout import Field, i16, u16
from analyzer.protocols import lk_rs485, mks_can
from conformance.drives.faults import numbers
from conformance.drives.faults.numbers import Judge
from conformance.drives.faults.places import CAN, EVERY, LK, MKS, SERIAL, asked, keeping, limit, reply, unstored
from conformance.drives.make import every_fault, every_quirk

GOLDEN = Path(__file__).parents[1] / "golden" / "faults.jsonl"
SIGNED, UNSIGNED = i16("speed"), u16("current", minimum=1, maximum=3000)


def test_each_fault_is_one_whose_refutations_are_kept() -> None:
    kept = [(each["dialect"], each["fault"]) for each in map(json.loads, GOLDEN.read_text().splitlines())]
    listed = [(dialect, fault.name) for fault in every_fault() for dialect in fault.dialects]
    assert sorted(listed) == sorted(kept)


def test_each_fault_and_quirk_says_what_it_is_and_touches_something() -> None:
    each = (*every_fault(), *every_quirk())
    assert len({change.name for change in each}) == len(each)
    known = {dialect.name for dialect in dialects.every()}
    for change in each:
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", change.name)
        assert set() < set(change.dialects) <= known, change.name
        assert change.name.startswith("lk-") == (set(change.dialects) == set(LK)), change.name
        assert 0 < len(change.text) < 110
        assert not change.text.endswith("."), change.name
    assert all(fault.breaks for fault in every_fault())


def test_the_bytes_of_a_number() -> None:
    assert numbers.swap_bytes(0x0102, UNSIGNED) == 0x0201
    assert numbers.swap_bytes(0x00FE, SIGNED) == -0x0200
    assert numbers.half_width(-1, SIGNED) == 0xFF
    assert numbers.half_signed(200, SIGNED) == -56
    assert numbers.low_bits(4)(0x123, SIGNED) == 3
    assert [numbers.scaled(1, 10)(value, SIGNED) for value in (15, 25, -31)] == [2, 2, -3]
    assert [numbers.exchanged(0, 1)(value, UNSIGNED) for value in (0, 1, 2)] == [1, 0, 2]


@pytest.mark.parametrize(
    ("judge", "allowed"),
    [
        (numbers.one_more, [1, 3000, 3001]),
        (numbers.one_less, [0, 1, 3000]),
        (numbers.highest_refused, [1]),
        (numbers.lowest_refused, [3000]),
        (numbers.unlimited, [0, 1, 3000, 3001]),
        (numbers.accepts(0), [0, 1, 3000]),
        (numbers.refuses(1), [3000]),
    ],
)
def test_judges(judge: Judge, allowed: list[int]) -> None:
    def verdict(field: Field, value: int) -> bool:
        return judge.verdict if judge.concerns(field, value) else field.allows(value)

    assert [value for value in (0, 1, 3000, 3001) if verdict(UNSIGNED, value)] == allowed
    assert judge.differs(UNSIGNED)
    assert not numbers.accepts(5).differs(UNSIGNED)


def test_the_dialects_follow_from_the_catalogue() -> None:
    assert reply("angle_error", numbers.negated).dialects == MKS
    assert reply("voltage", numbers.negated).dialects == LK
    assert asked("max_speed", numbers.negated).dialects == LK
    assert limit("stall_tolerance", numbers.one_more).dialects == CAN
    assert limit("holding_current", numbers.accepts(9)).dialects == SERIAL
    assert unstored("user_id").dialects == CAN
    assert keeping("a name of the drive's own") == EVERY


def test_what_is_accepted_is_right_in_its_other_fields() -> None:
    from conformance.drives.drive import Hooks
    from conformance.drives.lk.drive import LkDrive

    hooks = Hooks()
    limit("angle", numbers.unlimited)(hooks)
    drive, command = LkDrive(lk_rs485.DIALECT, 1), lk_rs485.DIALECT.by_name["move_single_turn"]
    judged = [hooks.allow[0](drive, command, {"direction": way, "angle": 40_000}, False) for way in (0, 1, 2)]
    assert judged == [True, True, False]
    assert hooks.allow[0](drive, mks_can.DIALECT.by_name["set_current"], {"current": 5000}, False) is False
