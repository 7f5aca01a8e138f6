"""Replies that fit their request except for the address, or except for the function."""

from __future__ import annotations

import pytest

from tests.collect import rtu
from tests.diagnosis.test_diagnosis import told


def causes(*rows: tuple[str, str]) -> list[str]:
    return [each.cause for each in told(*((mark, rtu(text)) for mark, text in rows))]


@pytest.mark.parametrize("asked", ["00", "09"])
@pytest.mark.parametrize("times", [1, 3])
def test_a_unit_answers_under_its_own_address(asked, times):
    rows = [row for _ in range(times) for row in ((">", f"{asked} 03 00 10 00 01"), ("<", "04 03 02 00 17"))]
    assert causes((">", "04 03 00 10 00 01"), ("<", "04 03 02 00 17"), *rows)[0] == "wrong_address"


def test_a_reply_that_is_still_owed_is_late():
    rows = ((">", "04 03 00 10 00 01"), (">", "09 03 00 10 00 01"), ("<", "04 03 02 00 17"))
    assert "wrong_address" not in causes(*rows)


def test_replies_of_the_units_that_are_asked_are_in_order():
    rows = [row for unit in ("04", "09") for row in ((">", f"{unit} 03 00 10 00 01"), ("<", f"{unit} 03 02 00 17"))]
    assert causes(*rows, *rows) == []


def test_a_unit_answers_in_another_function():
    rows = ((">", "11 03 00 C0 00 01"), ("<", "11 03 02 00 04"), (">", "11 10 00 C0 00 01 02 00 00"), ("<", "11 01 00"))
    assert causes(*rows)[0] == "wrong_function"


def test_a_function_that_was_asked_before_may_be_answered_late():
    rows = ((">", "11 01 00 00 00 08"), (">", "11 03 00 C0 00 01"), ("<", "11 01 01 05"))
    assert "wrong_function" not in causes(*rows)
