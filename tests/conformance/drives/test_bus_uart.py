"""What a UART reads: the same bytes at its own speed, the same garbled ones at another, ANDed ones in a collision."""

from __future__ import annotations

import pytest

from conformance.drives.uart import SentBytes, byte_ns, hear

DATA = bytes(range(256))


def read(sent: list[SentBytes], baud: int, *muted: tuple[int, int]) -> bytes:
    return bytes(each.byte for each in hear(sent, baud, muted))


@pytest.mark.parametrize("baud", [9600, 25000, 38400, 115200, 256000, 4_000_000])
def test_the_same_speed_reads_the_same(baud: int) -> None:
    heard = hear([SentBytes(1000, baud, DATA)], baud)
    assert bytes(each.byte for each in heard) == DATA
    for number, each in enumerate(heard, 1):
        assert abs(each.t_ns - 1000 - number * byte_ns(baud)) < number + 2


def test_speeds_three_per_cent_apart_read_the_same() -> None:
    assert read([SentBytes(0, 9600, b"\x55\xaa\x00\xff")], 9888) == b"\x55\xaa\x00\xff"
    assert read([SentBytes(0, 9600, b"\x55\xaa\x00\xff")], 9312) == b"\x55\xaa\x00\xff"


def test_another_speed_reads_the_same_rubbish_each_time() -> None:
    sent = [SentBytes(0, 9600, b"\xfa\x01\x30\x2b")]
    fast, slow = read(sent, 38400), read(sent, 1200)
    assert fast == read(sent, 38400)
    assert len(fast) > 4
    assert b"\xfa" not in fast
    assert 0 < len(slow) < 4


def test_low_levels_win() -> None:
    assert read([SentBytes(0, 9600, b"\xf0\xcc"), SentBytes(0, 9600, b"\x3c\xaa")], 9600) == b"\x30\x88"


def test_who_does_not_listen_hears_only_the_rest() -> None:
    step = byte_ns(9600)
    sent = [SentBytes(0, 9600, b"\x11\x22\x33")]
    assert read(sent, 9600, (0, step + 1)) == b"\x22\x33"


def test_a_silent_line_has_no_bytes() -> None:
    assert read([], 9600) == b""
