"""Causes in what is asked and answered, on made traffic: exceptions, timing, reads, settings, values."""

from __future__ import annotations

import pytest

from analyzer import dialects as registry
from analyzer.encoder import build
from analyzer.link.modbus import modbus_crc
from tests.diagnosis.test_diagnosis import exchanged, first, told

NATIVE, MODBUS, CAN, LK = (registry.get(n) for n in ("mks-rs485", "mks-modbus", "mks-can", "lk-rs485"))


def rtu(text):
    """Return bytes with the CRC of Modbus behind them."""
    body = bytes.fromhex(text)
    return body + modbus_crc(body).to_bytes(2, "little")


# --- exceptions, and units whose registers are not known ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "refused", "cause"),
    [
        ("11 03 01 00 00 02", "11 83 01", "wrong_function"),
        ("11 03 01 00 00 02", "11 83 02", "wrong_register"),
        ("11 06 01 00 FF FF", "11 86 03", "value_out_of_range"),
        ("11 03 01 00 00 02", "11 83 06", "too_fast"),
        (None, "11 84 02", "wrong_register"),
    ],
)
def test_an_exception_says_what_is_wrong(asked, refused, cause):
    rows = [(">", rtu(asked))] if asked else []
    assert first(*rows, ("<", rtu(refused))) == cause


def test_one_exception_in_good_traffic_is_an_answer():
    good = [(">", rtu("11 03 01 00 00 01")), ("<", rtu("11 03 02 00 07"))] * 4
    refused = [(">", rtu("11 03 02 00 00 01")), ("<", rtu("11 83 02"))]
    assert told(*good, *refused, *good) == []


def test_a_register_of_another_device_is_in_order():
    assert told((">", rtu("11 03 01 00 00 01")), ("<", rtu("11 03 02 00 07"))) == []


def test_the_function_that_nobody_answers():
    good = [(">", rtu("11 04 01 00 00 01")), ("<", rtu("11 04 02 00 07"))]
    found = told(*good, *good, *[(">", rtu("11 03 01 00 00 01"))] * 2, *good)
    assert found[0].cause == "wrong_function"
    assert found[0].frames[0].right == rtu("11 04 01 00 00 01").hex(" ").upper()
