"""Pastes in which the words count: lists that were never sent, makers, reports of libraries, consoles, late replies."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from analyzer.cli import main

LIST = """const char stop[] = {0x3E, 0x80, 0x05, 0x00, 0xC3};
const char still[] = {0x3E, 0x81, 0x05, 0x00, 0xC4};
void send_all() { write(fd, stop, 5); }
"""
AGAIN = "".join(f"[10:00:0{n}][D][uart_debug:114]: <<< 11:01:00:10:00:01:FE:9F\n" for n in range(3))
LATE = """DEBUG:send: 0x5 0x3 0x0 0x0 0x0 0x2 0xc5 0x8f
DEBUG:send: 0x4 0x3 0x0 0x0 0x0 0x1 0x84 0x5f
DEBUG:recv: 0x5 0x3 0x4 0x0 0x1f 0x0 0x20 0x8f 0xed
DEBUG:recv: 0x4 0x3 0x2 0x0 0x1 0xb5 0x84
"""


SAID = "ValueError: {}\n\nvalue = instrument.read_registers(2012, 2, 3)\nthis code has been working for a year\n"
LIBRARY = "if I run this\n\n6 1 16 FF FF\n\nI get this error\nRequest result: {}\n"


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (LIST, None),
        (f"{LIST}// the motor does not answer\n", "no_reply"),
        ("notes on the arm\n  cansend can0 001#3132\n", None),
        (AGAIN, "no_reply"),
        (LATE, "late_reply"),
        ("Tx 11 03 00 10 00 02 C7 5E\nRx 6C 6F 67 69 6E 3A 20", "unsupported_dialect"),
        ("Tx 7E 02 33 00 FD 0D\nRx 7E 02 33 01 55 A7 0D", "unsupported_dialect"),
        ("Tx DD A5 03 00 FF FD 77\nRx DD 03 00 01 20 FF DF 77", "unsupported_dialect"),
        ("$ candump can0\n  can0  003   [8]  FF FF FF FF FF FF FF FC\n", "unsupported_dialect"),
        (
            SAID.format(r"Wrong functioncode: 4 instead of 3. The response is: '\x01\x04\x04\x00\x00\x00\x00û\x84'"),
            "late_reply",
        ),
        (
            SAID.format(r"Wrong slave address: 2 instead of 1. The response is: '\x02\x03\x00\x00\x00\x02\xc4\x38'"),
            "two_masters",
        ),
        (LIBRARY.format("0x1"), "wrong_function"),
        (LIBRARY.format("0x02"), "wrong_register"),
        (LIBRARY.format("0x3"), "value_out_of_range"),
        (LIBRARY.format("0xE4"), "no_reply"),
        ("No answer of the ODrive:\n0x029 [8] 00 00 00 00 00 00 00 00\n", "unsupported_dialect"),
    ],
)
def test_a_paste_with_its_words(text: str, cause: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "paste"
    path.write_text(text)
    assert main(["diagnose", str(path), "--json"]) == (cause is not None)
    found = json.loads(capsys.readouterr().out)["causes"]
    assert [each["cause"] for each in found[:1]] == ([cause] if cause else [])
