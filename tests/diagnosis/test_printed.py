"""Numbers that a program or a person writes beside the frames, against what the fields say."""

from __future__ import annotations

import pytest

from tests.diagnosis.test_who_answers import native


def speeds(printed):
    """Return a log of a speed of -450 rpm, and of what the program makes of it."""
    rows = ((native("FA 03 32"), native("FB 03 32 FE 3E")),) * 3
    return "".join(f"10:00:0{n}.000 TX: {a}\n10:00:0{n}.010 RX: {b}\n{printed}\n" for n, (a, b) in enumerate(rows))


@pytest.mark.parametrize(
    ("printed", "found"),
    [
        ("the motor's speed is 65086 now", ["unit_or_sign"]),
        ("the motor's speed is -450 now", []),
        # Both: the program knows.
        ("the raw speed is 65086, which means -450 now", []),
        ("the motor's speed is 65087 now", []),
    ],
)
def test_a_signed_field_that_is_printed_as_unsigned(printed, found, causes_of):
    assert causes_of(speeds(printed)) == found


def test_a_position_of_48_bits_that_is_printed_as_unsigned(causes_of):
    log = f"TX: {native('FA 02 31')}\nRX: {native('FB 02 31 FF FF FF FE 80 00')}\nthe encoder now says 281474976612352 counts\n"
    assert causes_of(log) == ["unit_or_sign"]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("The motor has to turn at 750 rpm, so this is sent:", ["decimal_as_hex"]),
        ("The motor has to turn at 1872 rpm, so this is sent:", []),
        ("The motor turns at 750 rpm, no, at 1872 rpm, so this is sent:", []),
        # What is wanted, and what came of it.
        ("I want 750 rpm, and the tacho has 1872 rpm. This is sent:", ["decimal_as_hex"]),
        ("It should turn at 750 r/min and turns at 1872 r/min.", ["decimal_as_hex"]),
        # A number of something else.
        ("The motor is 750 mm away from the host, and this is sent:", []),
    ],
)
def test_a_number_that_is_sent_with_its_decimal_digits_as_hexadecimal_ones(words, found, causes_of):
    text = f"{words}\n\nTX: {native('FA 02 F6 07 50 04')}\nRX: {native('FB 02 F6 01')}\n"
    assert causes_of(text) == found


@pytest.mark.parametrize(
    ("words", "sent", "cause"),
    [
        ("set 1600 mA", "16", "decimal_as_hex"),
        # Nobody means 22 mA, and 20 somebody may.
        ("set the current", "16", "decimal_as_hex"),
        ("set the current", "14", "wrong_byte_order"),
    ],
)
def test_digits_of_the_words_are_more_than_a_swap_that_is_as_round(words, sent, cause, causes_of):
    rows = [(native(f"FA 02 83 {each} 00"), native("FB 02 83 00")) for each in (sent, "12", sent)]
    log = "".join(f"10:00:0{n}.000 TX: {a}\n10:00:0{n}.010 RX: {b}\n" for n, (a, b) in enumerate(rows))
    assert causes_of(f"{words}\n{log}") == [cause]


def test_a_call_with_the_number_that_is_meant_stands_before_the_frame(causes_of):
    sent = native("FA 02 83 16 00")
    refused = f"      rx {native('FB 02 83 00')}\n"
    assert causes_of(f"set_current(1600)  tx {sent}\n{refused}" * 2) == ["decimal_as_hex"]
    swapped = native("FA 02 83 28 00")
    assert causes_of(f"set_current(40)  tx {swapped}\n{refused}" * 2) == ["wrong_byte_order"]


@pytest.mark.parametrize(
    ("words", "frame", "found"),
    [
        ("move to 90 degrees", "TX 3E A4 01 0C EF 5A 00 00 00 00 00 00 00 A0 8C 00 00 86", ["unit_or_sign"]),
        ("move to 0.9 degrees", "TX 3E A4 01 0C EF 5A 00 00 00 00 00 00 00 A0 8C 00 00 86", []),
        ("move from 0.9 degrees up to 90 degrees", "TX 3E A4 01 0C EF 5A 00 00 00 00 00 00 00 A0 8C 00 00 86", []),
        ("the belt is 90 mm long", "TX 3E A4 01 0C EF 5A 00 00 00 00 00 00 00 A0 8C 00 00 86", []),
        ("it shows 2390 V of the supply", "RX 3E 9A 01 07 E0 1F 56 09 0C 00 00 00 8A", ["unit_or_sign"]),
        ("it shows 23.9 V of the supply", "RX 3E 9A 01 07 E0 1F 56 09 0C 00 00 00 8A", []),
        # 60 deg/s are 10 rpm.
        ("it has to turn at 60 rpm", "TX 3E A2 01 04 E5 70 17 00 00 87", ["unit_or_sign"]),
        ("it has to turn at 60 dps", "TX 3E A2 01 04 E5 70 17 00 00 87", []),
        ("it has to turn at 10 rpm", "TX 3E A2 01 04 E5 70 17 00 00 87", []),
    ],
)
def test_a_number_in_another_unit_than_that_of_the_field(words, frame, found, causes_of):
    asked = "TX 3E 9A 01 00 D9\n" if frame.startswith("RX") else ""
    reply = "RX 3E A2 01 07 E8 1E 09 00 3C 00 6F 00 D2\n" if " A2 " in frame else ""
    reply = "RX 3E A4 01 07 EA 1E 04 00 02 00 42 04 6A\n" if " A4 " in frame else reply
    assert causes_of(f"{words}\n{asked}{frame}\n{reply}") == found


def test_a_scaled_field_that_is_printed_as_unsigned(causes_of):
    log = "TX 01 04 00 39 00 02 A1 C6\nRX 01 04 04 FF FF FF CE 3B C4\nangle error = 4294967246\n"
    assert causes_of(log) == ["unit_or_sign"]


@pytest.mark.parametrize(
    ("words", "frame", "found"),
    [
        ("One full turn (360 degrees) should come of it:", "FA 02 F4 00 64 02 00 00 0C 80", ["unit_or_sign"]),
        ("One full turn (360 degrees) should come of it:", "FA 02 F4 00 64 02 00 00 40 00", []),
        ("One full turn should come of it:", "FA 02 FD 00 64 02 00 00 40 00", ["unit_or_sign"]),
        ("One full turn should come of it:", "FA 02 FD 00 64 02 00 00 0C 80", []),
        # A document.
        ("One full turn of FD is 3200. F4 counts otherwise:", "FA 02 F4 00 64 02 00 00 0C 80", []),
        ("It should have 1.6 A and has no torque:", "FA 02 83 00 10", ["unit_or_sign"]),
        ("It should have 1.6 A and has no torque:", "FA 02 83 06 40", []),
        ("It should have 1.6 A and has no torque; with 0.016 A too:", "FA 02 83 00 10", []),
        # Degrees in counts and in pulses; the speed of a turn in other units.
        ("Turn by 90 deg (it hardly moves):", "FA 02 F4 00 64 02 00 00 00 5A", ["unit_or_sign"]),
        ("Turn by 180° (it hardly moves):", "FA 02 FD 00 64 02 00 00 00 B4", ["unit_or_sign"]),
        ("Turn by 90 counts (it hardly moves, 90 deg are meant):", "FA 02 F4 00 64 02 00 00 00 5A", []),
        ("It should run at 100 deg/s:", "FA 02 F6 00 64 02", ["unit_or_sign"]),
        ("It should run at 100 rpm, which is 600 deg/s:", "FA 02 F6 00 64 02", []),
        # The bytes of a number that the words have.
        ("moveTo(axis=16384), and it should stop:", "FA 02 F5 02 58 02 00 40 00 00", ["wrong_byte_order"]),
        ("moveTo(axis=4194304), 16384 rpm at 256:", "FA 02 F5 02 58 02 00 40 00 00", []),
        # The sign of 16 or 24 bits in 32.
        ("It should go to -16384 and goes on and on:", "FA 02 F5 02 58 02 00 FF C0 00", ["unit_or_sign"]),
        ("It should go to -16384 and goes on and on:", "FA 02 F5 02 58 02 00 00 C0 00", ["unit_or_sign"]),
        ("It should go to -16384 and goes on and on:", "FA 02 F5 02 58 02 FF FF C0 00", []),
        ("It should go to 49152, not to -16384:", "FA 02 F5 02 58 02 00 00 C0 00", []),
    ],
)
def test_a_number_in_steps_of_something_else(words, frame, found, causes_of):
    code = frame.split()[2]
    assert causes_of(f"{words}\n\nTX: {native(frame)}\nRX: {native(f'FB 02 {code} 01')}\n") == found


@pytest.mark.parametrize(
    ("printed", "found"), [("42949668.96", ["unit_or_sign"]), ("-4.00", []), ("42949668.96 (-4.00)", []), ("429496.96", [])]
)
def test_an_angle_of_64_bits_that_is_printed_as_unsigned_of_32(printed, found, causes_of):
    log = "TX 3E 92 01 00 D1\nRX 3E 92 01 08 D9 70 FE FF FF FF FF FF FF 68\n"
    assert causes_of(f"{log}the program now says angle = {printed} deg\n") == found
