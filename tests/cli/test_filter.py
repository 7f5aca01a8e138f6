"""The filter: what it understands, what it refuses, and that nothing in it can do harm."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.cli.filter import Filter, vocabulary
from analyzer.errors import UsageError

KNOWN = vocabulary(dialects.by_name("").values())
MESSAGE = {
    "address": 1, "dialect": "mks-rs485", "command": "run_speed", "role": "reply", "speed": 320, "time": 2.5, "latency": 5.5,
    "findings": ["late_reply", "warning"], "status": 2, "status_name": "complete", "checksum_ok": True,
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("address == 1", True),
        ("address == 1 and command == 'run_speed' and speed > 300", True),
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
        ("findings", True),
        ("acceleration", False),
        ("0xF6 == 246", True),
        ("speed & 1 == 0", True),
        ("True", True),
        ("status == 'complete'", True),
        ("status == 2 and status != 'failed'", True),
        ("status in ['failed', 2]", True),
        ("status not in ['failed', 2]", False),
        ("'warning' in findings", True),
        ("'error' in findings", False),
        ("'run' in command", True),
        ("latency > 5", True),
        ("latency > 5ms and latency < 0.006 s", True),
        ("latency > 5600us", False),
        ("5ms < latency", True),
        ("speed > 300 rpm", True),
        ("speed > 1801deg/s", True),
        ("speed == -320rpm", False),
        ("speed > 1e2", True),
    ],
)
def test_what_is_understood(text, wanted):
    assert Filter(text, KNOWN)(MESSAGE) is wanted


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
        Filter(text, KNOWN)


def test_texts_do_not_calculate():
    assert Filter("command * 1000000000 == 'x'", KNOWN)(MESSAGE) is False
    assert Filter("findings + findings == 1", KNOWN)(MESSAGE) is False


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sped > 3", "no field 'sped'.*did you mean speed"),
        ("status == 'complet'", "status is never 'complet'; did you mean complete"),
        ("command == 'read_sped'", "command is never 'read_sped'; did you mean read_speed"),
        ("role == 'replay'", "did you mean reply"),
        ("address == '1'", "address is a number, got the text '1'; write it without quotes"),
        ("command == 3", "command is a text, got 3; write it in quotes"),
        ("address == 0x20000000", "can never be: it is 0..536870911"),
        ("address in [1, 0x20000000]", "can never be"),
        ("'eror' in findings", "findings never has 'eror'; did you mean error"),
        ("latency > 5rpm", "latency in 'rpm': it is in ms"),
        ("address > 5ms", "address in 'ms': it has no unit"),
        ("speed > 5 furlong", "speed in 'furlong': it is in deg/s or rpm"),
        ("status > 'complete'", "texts are compared by == and !="),
        ("1 in address", "expected a list"),
        ("speed = 3", "such as 'address == 1'; equality is ==, not ="),
    ],
)
def test_what_can_never_match_is_an_error(text, said):
    with pytest.raises(UsageError, match=said):
        Filter(text, KNOWN)


def test_a_value_beyond_the_bits_of_every_command_can_never_be():
    known = vocabulary([dialects.get("mks-rs485")])
    with pytest.raises(UsageError, match="acceleration > 255 can never be: it is 0"):
        Filter("acceleration > 255", known)
    Filter("acceleration > 254", known)


def test_a_number_with_a_unit_is_converted_to_what_each_command_counts_in():
    over = Filter("speed > 300rpm", KNOWN)
    assert not over({"dialect": "lk-rs485", "command": "run_speed", "speed": 1799.0})
    assert over({"dialect": "lk-rs485", "command": "run_speed", "speed": 1801.0})


@given(st.text(max_size=60))
def test_any_text_is_a_filter_or_an_error_of_use(text):
    try:
        made = Filter(text, KNOWN)
    except UsageError:
        return
    assert made(MESSAGE) in (True, False)


@pytest.mark.parametrize("many", [60, 100, 199, 330, 450, 660])
@pytest.mark.parametrize(
    "grow", [lambda n: "~" * n + "speed", lambda n: "speed" + ".a" * n, lambda n: "speed" + "()" * n, lambda n: "1" + "+1" * n]
)
def test_what_is_nested_deep_is_refused(grow, many):
    with pytest.raises(UsageError, match="nested deeper than 50"):
        Filter(grow(many), KNOWN)


@pytest.mark.parametrize(
    "text", [f"latency > 1{'0' * 1000} ms", f"-{'9' * 400} A == speed", "1e400 < speed", f"speed in [0x{'F' * 1900}]"]
)
def test_a_number_that_no_field_holds_is_refused(text):
    with pytest.raises(UsageError, match=r"a number beyond 1\.84e\+19 can never be compared"):
        Filter(text, KNOWN)
