"""Causes that come about in another way than the usual one, each by rows of a host's log, without times where none are told."""

from __future__ import annotations

import pytest

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.records import CanFrame, Chunk
from tests.diagnosis.spoiled_line import levels, received
from tests.diagnosis.test_diagnosis import diagnosed
from tests.diagnosis.test_layouts import lk, native, reply, unit

NATIVE, MODBUS, CAN, LK = (registry.get(n) for n in ("mks-rs485", "mks-modbus", "mks-can", "lk-rs485"))
_ROLES = {">": Role.REQUEST, "<": Role.REPLY}


def rows(*pairs):
    """Return rows of requests with their replies; None: no reply."""
    return [row for sent, came in pairs for row in ((">", sent), *([("<", came)] if came is not None else []))]


def causes(given, step_ns=None, unit_ns=1):
    """Return what is suspected of rows, in this order. `unit_ns`: the resolution of the times."""
    items = [
        Chunk(None if step_ns is None else number * step_ns // unit_ns * unit_ns, "bus", data, _ROLES[mark], True)
        for number, (mark, data) in enumerate(given)
    ]
    return [each.suspicion.cause for each in diagnosed(items).causes]


def can(*frames):
    """Return what is suspected of frames on CAN: `> ID DATA` at a time in milliseconds."""
    items = []
    for ms, text in frames:
        mark, number, data = text.split(" ", 2)
        items.append(CanFrame(int(ms * 1e6), "can0", int(number, 16), bytes.fromhex(data), _ROLES.get(mark, Role.UNKNOWN)))
    return [each.suspicion.cause for each in diagnosed(items).causes]


def position(n, address=4):
    return reply(address, 0x31, 0, 0, 0, 0, n, 7 * n & 0xFF)


POSITION, SPEED, STATUS, ENCODER = native(4, 0x31), native(4, 0x32), native(4, 0xF1), native(4, 0x30)
GOOD = [row for n in range(1, 9) for row in ((POSITION, position(n)), (SPEED, reply(4, 0x32, 0, 60 + n)))]
MOVES = [build(NATIVE, "run_speed", 4, {"direction": 0, "speed": v, "acceleration": 9}) for v in (90, 120, 200, 310)]
READ = unit(7, 4, 0, 0x32, 0, 1)
GOOD_UNIT = [(READ, unit(7, 4, 2, 0, n)) for n in range(1, 9)]
WRITE = unit(7, 6, 0, 0xF3, 0, 1)
STATES = [(lk(0x92, 6), lk(0x92, 6, n, 3, 0, 0, 0, 0, 0, 0)) for n in range(1, 9)]
TURNS = [(lk(0x94, 6), lk(0x94, 6, n, 3, 0, 0)) for n in range(1, 9)]


def crc(data, value, poly, final=0):
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (poly if value & 1 else 0)
    return data + (value ^ final).to_bytes(2, "little")


BARE = [unit(7, 4, 0, n, 0, 1)[:-2] for n in (0x32, 0x3A, 0xF1)]


@pytest.mark.parametrize(
    ("given", "cause"),
    [
        # The moves of a program have no sum, and its reads have theirs.
        (rows(*GOOD, *((move[:-1], None) for move in MOVES[:3]), *GOOD), "missing_checksum"),
        # A write whose CRC was typed wrong, again and again, to a unit that answers.
        (rows(*GOOD_UNIT, *[(WRITE[:-1] + b"\xdb", None)] * 3, *GOOD_UNIT), "wrong_checksum"),
        # CRCs of libraries.
        (rows(*((crc(body, 0xFFFF, 0x8408), None) for body in BARE)), "wrong_checksum_rule"),
        (rows(*((crc(body, 0xFFFF, 0x8408, 0xFFFF), None) for body in BARE)), "wrong_checksum_rule"),
        (rows(*((crc(body, 0xFFFF, 0xA001, 0xFFFF), None) for body in BARE)), "wrong_checksum_rule"),
        # Stray bytes before a few of many replies, and nothing else.
        (rows(*GOOD * 3, *((SPEED, b"\xfe" + reply(4, 0x32, 0, n)) for n in (1, 2, 3)), *GOOD * 3), "leading_glitch"),
        # The data bits alone are turned round.
        (rows(*((p, bytes(b ^ 0xFF for b in came)) for p, came in GOOD)), "inverted_lines"),
        # Short replies at one and a half times the speed: a byte and most of the next tell whose they are.
        (
            rows(*((ask, received(levels(came), ratio=1.5)) for ask, came in (
                *GOOD[:4], (ENCODER, reply(4, 0x30, 0, 0, 0, 1, 0x20, 0)), (native(4, 0x3E), reply(4, 0x3E, 0)),
                (native(4, 0x33), reply(4, 0x33, 0, 0, 2, 9)),
            ))),
            "wrong_baud",
        ),
        # All bytes have seven bits, and some replies have no other.
        (rows(*GOOD_UNIT[1:2] * 0, *[(READ, unit(7, 4, 2, 0, n)) for n in range(60) if max(unit(7, 4, 2, 0, n)) < 128][:6] * 3,
              *[(READ, bytes(b & 127 for b in unit(7, 4, 2, 0, n))) for n in (3, 5, 6) if max(unit(7, 4, 2, 0, n)) > 127]),
         "wrong_parity"),
        # The host reads as many bytes as a reply has, and its own are before them.
        (rows(*((ask, (ask + came)[: len(came)]) for ask, came in GOOD)), "echo"),
        # One read was a byte short; all behind it have the sizes of their replies.
        (
            rows(*((GOOD[n][0], (b"".join(came for _, came in GOOD[:n])[-1:] + GOOD[n][1][:-1]) if n else GOOD[0][1][:-1])
                   for n in range(8))),
            "read_misaligned",
        ),
        # All went well before.
        (rows(*(STATES + TURNS)[::1], (STATES[0][0], None), *((TURNS[n][0] if n % 2 == 0 else STATES[n][0],
              STATES[n][1] if n % 2 == 0 else TURNS[n][1]) for n in range(6))), "late_reply"),
        (rows(*GOOD * 4, *((ask, None) for ask, _ in GOOD[:6])), "no_reply"),
        # A restart is answered; what is sent in the meantime is not.
        (
            rows(*GOOD, (native(4, 0x41), reply(4, 0x41, 1)), *((ask, None) for ask in (POSITION, SPEED, STATUS) * 2), *GOOD),
            "too_fast",
        ),
        # Without times each motion closes the one before it.
        (rows(*(row for n, move in enumerate(MOVES) for row in ((move, None), GOOD[n]))), "respond_off"),
        # Numbers of registers: of old controllers, one below, with their bytes turned.
        (rows(*((unit(7, 4, *(30001 + n).to_bytes(2, "big"), 0, 1), None) for n in (0x32, 0x3A))), "wrong_register"),
        (rows(*((unit(7, 6, 0, n - 1, 0, 1), None) for n in (0x82, 0xF3))), "wrong_register"),
        (rows(*((unit(7, 4, n, 0, 1, 0), None) for n in (0x32, 0x3A))), "wrong_byte_order"),
        (rows(*((unit(7, 6, 0, n, 0, 5), None) for n in (82, 84))), "decimal_as_hex"),
        # The CRC stands behind the header of Modbus TCP, too.
        (rows(*((bytes((0, n, 0, 0, 0, 8)) + READ, None) for n in (1, 2, 3))), "tcp_framing"),
        (rows(*((" ".join(map(str, move)).encode(), None) for move in MOVES[:2])), "text_mode"),
        # Twenty bytes of an adapter, with a frame of CAN in them.
        (
            rows(*((b"\xaa\x55" + body + bytes((sum(body) & 0xFF,)), None) for data in (b"\x31\x35", b"\x32\x36")
                   for body in (b"\1\1\1\4\0\0\0\2" + data + bytes(7),))),
            "adapter_framing",
        ),
    ],
)  # fmt: skip
def test_a_cause_is_named_first(given, cause):
    assert causes(given)[:1] == [cause]


@pytest.mark.parametrize("changed", [lambda d: bytes((~sum(d) & 0xFF,)), lambda d: bytes((-sum(d) & 0xFF,))])
def test_both_sums_of_lk_by_another_rule(changed):
    heads = [bytes((0x3E, 0xA2, 6, 4)) for _ in range(3)]
    data = [bytes((n, 3, 1, 0)) for n in (7, 70, 99)]
    frames = [h + changed(h) + d + changed(d) for h, d in zip(heads, data, strict=True)]
    assert causes(rows(*((frame, None) for frame in frames)))[:1] == ["wrong_checksum_rule"]


def test_one_request_without_its_last_byte_lacks_a_field_or_its_sum():
    assert causes(rows(*GOOD, (MOVES[0][:-1], None), *GOOD)) == ["wrong_length", "missing_checksum"]


def test_times_of_whole_seconds_do_not_show_a_pace():
    given = rows(*(row for pair in GOOD for row in (pair, (STATUS, None))))
    assert "too_fast" not in causes(given, 20_000_000, 1_000_000_000)


def test_settings_on_can_that_follow_each_other_at_once():
    given = []
    for n in range(4):
        given += [(900 * n, "> 4 84 10 98"), (900 * n + 2, "< 4 84 01 89"), (900 * n + 6, "> 4 83 03 E8 72")]
    assert can(*given)[:1] == ["too_fast"]


def test_an_address_that_was_changed_on_can_and_requests_that_are_sent_twice():
    asked = ("> 6 3A 40", "> 6 3A 40", "> 6 34 3A", "> 6 34 3A")
    given = ["> 6 32 38", "< 6 32 FF EE 25", "> 6 8B 00 07 98", "< 6 8B 01 92", *asked]
    assert can(*((50 * n, text) for n, text in enumerate(given)))[:1] == ["address_changed"]


@pytest.mark.parametrize(
    ("frames", "cause"),
    [
        # 140h and 600h are identifiers of other makers; the sums are those of drive 5.
        (("> 145 31 36", "> 145 32 37", "> 145 F3 01 F9"), "can_wrong_id"),
        (("> 605 31 36", "> 605 32 37", "> 605 F3 01 F9"), "can_wrong_id"),
        # An unknown code with fields, among requests that are all answered; nothing tells who has sent it.
        (("? 5 32 37", "? 5 32 00 01 38", "? 5 A6 01 84 2C 5C", "? 5 A6 00 AB 8C E2", "? 5 32 37", "? 5 32 00 02 39"),
         "unknown_command"),
    ],
)  # fmt: skip
def test_frames_on_can(frames, cause):
    assert can(*((100 * n, text) for n, text in enumerate(frames)))[:1] == [cause]
