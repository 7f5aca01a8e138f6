"""What stands beside the bytes: bytes that are not read, words that nothing came, cells of a table."""

from __future__ import annotations

import pytest

from tests.diagnosis.test_layouts import POSITION, READ, native, reply


def test_bytes_that_are_not_read_may_be_the_replies(causes_of):
    """The wires are not to blame while lines of bytes stand between the requests."""
    other = native(9, 0x3A, 0xBE)
    log = "".join(f"13:04:0{n}.000 write {POSITION.hex()}\n13:04:0{n}.002 (chunk) {{}}\n" for n in range(4))
    assert causes_of(log.format(*[other.hex()] * 4)) == []
    assert causes_of(log.format(*["end"] * 4)) == ["no_reply"]


@pytest.mark.parametrize("said", ["TimeoutError", "None", "recv(timeout=1.0) -> None", "no answer", "SerialTimeoutException"])
def test_a_word_that_nothing_came_is_none_of_the_traffic(said, causes_of):
    group = [native(0x50, 0xF3, 1), native(0x50, 0xFD, 1, 0x2C, 100, 0, 0, 12, 0x80), native(0x50, 0xF7)]
    sets = "".join(f"{native(n, 0x8D, 0x50).hex(' ')} => {reply(n, 0x8D, 1).hex(' ')}\n" for n in (1, 2, 3))
    assert causes_of("chat: all move\n" + sets + "".join(f"{each.hex(' ')} => {said}\n" for each in group)) == [
        "broadcast_no_reply"
    ]


def test_a_program_of_modbus_tcp_that_gets_nothing(causes_of):
    """The words of its library do not say that the drive takes the header."""
    asked = [bytes((0, n, 0, 0, 0, 6)) + READ[:-2] for n in range(1, 6)]
    rows = "\n".join(f"{12 * n:08X}  {each.hex(' ')}" for n, each in enumerate(asked))
    said = "(ModbusTcpClient: every read raises ModbusIOException: No response received)"
    assert causes_of(f"{rows}\n\n{said}") == ["tcp_framing"]


def test_a_check_that_two_frames_have_was_not_computed(causes_of):
    """Of one of them it is the XOR by chance."""
    right = native(1, 0xF6, 1, 0x40, 2)
    stale = "".join(f"  {right[:3].hex(' ')} {body} 34   -> nothing\n" for body in ("02 58 02", "00 64 02", "81 40 02"))
    assert causes_of(f"{right.hex(' ')} works (it answers {reply(1, 0xF6, 1).hex(' ')}).\n{stale}") == ["wrong_checksum"]


def test_the_number_of_a_cell_belongs_to_no_frame(causes_of):
    sent = {16: native(1, 0x84, 16), 32: native(1, 0x84, 32), 64: native(1, 0x84, 64)}
    rows = "".join(f"step {n};{each.hex(' ')};{reply(1, 0x84, 1).hex(' ')};ok\n" for n, each in sent.items())
    assert causes_of(f"Parameter;Sent;Received;Result\n{rows}") == []


@pytest.mark.parametrize(("status", "speed", "causes"), [(3, 0, ["firmware_quirk"]), (3, 9, []), (1, 0, [])])
def test_a_status_that_stays_when_the_shaft_stands(status, speed, causes, causes_of):
    rows = [(native(1, 0xF1), reply(1, 0xF1, status)), (native(1, 0x32), reply(1, 0x32, 0, speed))]
    one, other = ("".join(f"tx {asked.hex(' ')}\nrx {came.hex(' ')}\n" for asked, came in rows[at:]) for at in (0, 1))
    assert causes_of(one * 4) == causes
    assert causes_of(one + other * 3) == []


@pytest.mark.parametrize(
    ("before", "polls", "causes"),
    [
        ("", [(0xF1, 1)] * 4, ["firmware_quirk"]),
        # Who has switched the report off, asks no more, or logs what the drive does, does not miss it.
        ("active off", [(0xF1, 1)] * 4, []),
        ("", [(0xF1, 1)] * 2, []),
        ("", [(0xF1, 1), (0x3A, 1)] * 4, []),
    ],
)
def test_a_host_that_waits_for_the_end_of_a_motion(before, polls, causes, causes_of):
    rows = [(native(1, 0x8C, 1, 0), reply(1, 0x8C, 1))] if before else []
    rows += [(native(1, 0xF4, 3, 0xE8, 16, 0, 0, 0x40, 0), reply(1, 0xF4, 1))]
    rows += [(native(1, code), reply(1, code, status)) for code, status in polls]
    assert causes_of("".join(f"tx {asked.hex(' ')}\nrx {came.hex(' ')}\n" for asked, came in rows)) == causes
