"""The filter: what it understands, what it refuses, and that nothing in it can do harm."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer.cli.filter import Filter
from analyzer.errors import UsageError

MESSAGE = {"address": 1, "command": "read_speed", "role": "reply", "speed": 320, "findings": ["late_reply"], "time": 2.5}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("address == 1", True),
        ("address == 1 and command == 'read_speed' and speed > 300", True),
        ("address == 2 or speed < 0", False),
        ("not (address == 2)", True),
        ("1 < speed <= 320", True),
        ("address in [1, 2, 3]", True),
        ("address not in (2, 3)", True),
        ("'late_reply' in findings", True),
        ("speed % 100 == 20", True),
        ("speed == -320", False),
        ("-speed == -320", True),
        ("acceleration == 1", False),
        ("acceleration != 1", False),
        ("not acceleration == 1", True),
        ("speed > 'x'", False),
        ("findings", True),
        ("acceleration", False),
        ("0xF6 == 246", True),
        ("speed & 1 == 0", True),
        ("True", True),
    ],
)
def test_what_is_understood(text, wanted):
    assert Filter(text)(MESSAGE) is wanted


@pytest.mark.parametrize(
    "text",
    [
        "", "address = 1", "address ==", "__import__('os')", "().__class__", "command.upper()", "[x for x in findings]",
        "lambda: 1", "speed ** 99999999", "findings[0]", "f'{speed}'", "address if 1 else 2", "1 << 99999", "print(1)",
        "address; speed", "(" * 500 + "1" + ")" * 500, "not " * 200 + "1", "a" * 3000, "speed := 1", "b'x'", "...",
    ],
)  # fmt: skip
def test_what_is_refused(text):
    with pytest.raises(UsageError, match="filter"):
        Filter(text)


def test_texts_do_not_calculate():
    assert Filter("command * 1000000000 == 'x'")(MESSAGE) is False
    assert Filter("findings + findings == 1")(MESSAGE) is False


def test_an_unknown_field_names_the_near_one():
    with pytest.raises(UsageError, match="did you mean speed"):
        Filter("sped > 3", frozenset({"speed"}))


@given(st.text(max_size=60))
def test_any_text_is_a_filter_or_an_error_of_use(text):
    try:
        made = Filter(text)
    except UsageError:
        return
    assert made(MESSAGE) in (True, False)
