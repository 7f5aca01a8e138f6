"""What a drive makes of bytes, in which pieces, and when."""

from __future__ import annotations

import random

import pytest

from analyzer import dialects
from analyzer.catalogue import Role, Vector
from analyzer.encoder import build
from conformance.drives.receiver import PAUSE_NS, Receiver

BYTE_NS = 260_416
SERIAL = ("mks-rs485", "mks-modbus", "lk-rs485")
READS = {
    "mks-rs485": bytes.fromhex("FA 01 30 2B"),
    "mks-modbus": build(dialects.get("mks-modbus"), "read_speed", 1),
    "lk-rs485": bytes.fromhex("3E 92 01 00 D1"),
}


def receiver(dialect: str) -> Receiver:
    return Receiver(dialects.get(dialect), byte_ns=BYTE_NS)


def feed(listener: Receiver, data: bytes, start_ns: int = 0) -> list[tuple[bytes, int, bool]]:
    """Feed bytes that begin at `start_ns`; return the data, the time and the check of each frame."""
    frames = listener.feed(data, start_ns + BYTE_NS, BYTE_NS)
    return [(frame.data, frame.last_ns, frame.checksum_ok) for frame in frames]


def feed_bytewise(listener: Receiver, data: bytes) -> list[tuple[bytes, int, bool]]:
    found = []
    for i in range(len(data)):
        found += feed(listener, data[i : i + 1], i * BYTE_NS)
    return found


def vectors(dialect: str) -> list[bytes]:
    """Return every frame that the manual prints, whole and right."""

    def text(vector: Vector) -> str:
        return vector.corrected or vector.printed

    return [
        bytes.fromhex(text(v))
        for c in dialects.get(dialect).commands
        for v in c.vectors
        if v.checksum and (v.corrected or not v.erratum)
    ]


@pytest.mark.parametrize("dialect", SERIAL)
def test_a_frame_is_there_with_its_last_byte(dialect: str) -> None:
    data = READS[dialect]
    assert feed(receiver(dialect), data) == [(data, len(data) * BYTE_NS, True)]
    assert feed_bytewise(receiver(dialect), data) == [(data, len(data) * BYTE_NS, True)]


@pytest.mark.parametrize("dialect", SERIAL)
def test_every_printed_frame_is_found_whole_bytewise_and_behind_noise(dialect: str) -> None:
    for data in vectors(dialect):
        assert [f[0] for f in feed(receiver(dialect), data)] == [data], data.hex(" ")
        assert [f[0] for f in feed_bytewise(receiver(dialect), data)] == [data], data.hex(" ")
        assert [f[0] for f in feed(receiver(dialect), data + data)] == [data, data], data.hex(" ")
        if dialect != "mks-modbus":
            assert [f[0] for f in feed(receiver(dialect), b"\x00\xff\x55" + data)] == [data], data.hex(" ")


@pytest.mark.parametrize("dialect", SERIAL)
def test_chunks_do_not_matter(dialect: str) -> None:
    chance = random.Random(7)
    stream = b"".join(chance.choices(vectors(dialect), k=40))
    damaged = bytes(b ^ 0x10 if chance.random() < 0.02 else b for b in stream)
    whole = feed(receiver(dialect), damaged)
    for _ in range(5):
        listener, found, at = receiver(dialect), [], 0
        while at < len(damaged):
            size = chance.randint(1, 20)
            found += feed(listener, damaged[at : at + size], at * BYTE_NS)
            at += size
        assert found == whole
    assert len(whole) > 20


def test_replies_and_packages_of_others_are_stepped_over() -> None:
    package = bytes.fromhex(
        "FC 01 F6 00 32 0A 00 00 00 00 00 02 F6 80 64 20 00 00 00 00 00 03 FD 01 2C 02 00 04 E2 00 00"
        " 04 F4 02 58 64 00 19 00 00 00 05 F5 04 B0 C8 00 0C 80 00 00 11"
    )
    reply = build(dialects.get("mks-rs485"), "read_position", 2, {"position": 0xFA0130}, Role.REPLY)
    read = READS["mks-rs485"]
    assert [f[0] for f in feed_bytewise(receiver("mks-rs485"), reply + package + read)] == [reply, package, read]


def test_a_bad_check_is_given_on_as_such() -> None:
    bad = bytes.fromhex("FA 01 30 2C")
    assert feed(receiver("mks-rs485"), bad) == [(bad, 4 * BYTE_NS, False)]
    bad = bytes.fromhex("3E A2 01 04 E5 10 27 00 00 38")
    assert feed(receiver("lk-rs485"), bad) == [(bad, 10 * BYTE_NS, False)]
    bad = READS["mks-modbus"][:-1] + b"\0"
    listener = receiver("mks-modbus")
    found = feed(listener, bad) + [(f.data, f.last_ns, f.checksum_ok) for f in listener.expire(10**9)]
    assert [(data, good) for data, _, good in found] == [(bad, False)]


def test_a_good_frame_behind_a_broken_one_counts() -> None:
    cut, read = bytes.fromhex("FA 01 F6 01"), READS["mks-rs485"]
    assert feed_bytewise(receiver("mks-rs485"), cut + read) == [(read, 8 * BYTE_NS, True)]


def test_the_pause_drops_what_is_incomplete() -> None:
    listener, read = receiver("mks-rs485"), READS["mks-rs485"]
    assert feed(listener, read[:2]) == []
    assert feed(listener, read[2:], PAUSE_NS + 3 * BYTE_NS) == []
    late = receiver("mks-rs485")
    assert feed(late, read[:2]) == []
    assert feed(late, read[2:], PAUSE_NS) == [(read, PAUSE_NS + 2 * BYTE_NS, True)]


def test_the_pause_frees_a_frame_that_noise_seemed_to_hold() -> None:
    listener, read = receiver("mks-rs485"), READS["mks-rs485"]
    assert feed(listener, b"\xfc" + read) == []
    due = listener.next_ns()
    assert due == 6 * BYTE_NS + PAUSE_NS
    assert listener.expire(due - 1) == []
    assert [f.data for f in listener.expire(due)] == [read]
    assert listener.next_ns() is None


def test_modbus_waits_for_three_and_a_half_characters() -> None:
    dialect = dialects.get("mks-modbus")
    assert dialect.link.silence_ns(10_000_000_000 // 9600) == int(3.5 * 1_041_666)
    assert dialect.link.silence_ns(10_000_000_000 // 115200) == 1_750_000
    listener, read = receiver("mks-modbus"), READS["mks-modbus"]
    assert feed(listener, read[:4]) == []
    assert feed(listener, read[4:], 4 * BYTE_NS + 1_800_000) == []
    close = receiver("mks-modbus")
    assert feed(close, read[:4]) == []
    assert [f[0] for f in feed(close, read[4:], 4 * BYTE_NS + 1_700_000)] == [read]


@pytest.mark.parametrize(
    ("dialect", "body"), [("mks-rs485", "FA 01 77"), ("mks-modbus", "01 07"), ("mks-modbus", "01 2B 0E 01 00")]
)
def test_a_frame_of_unknown_code_is_there_at_the_pause(dialect: str, body: str) -> None:
    listener = receiver(dialect)
    data = dialects.get(dialect).link.completed(bytes.fromhex(body))
    assert feed(listener, data) == []
    assert [f.data for f in listener.expire(10**9)] == [data]


def test_noise_without_end_is_not_kept() -> None:
    listener = receiver("mks-rs485")
    for i in range(100):
        feed(listener, bytes(100), i * 100 * BYTE_NS)
    assert len(listener._buffer) < 1000
    read = READS["mks-rs485"]
    assert [f[0] for f in feed(listener, read, 10_000 * BYTE_NS)] == [read]


def test_offsets_count_all_that_was_heard() -> None:
    listener, read = receiver("mks-rs485"), READS["mks-rs485"]
    frames = listener.feed(b"\0\0" + read + b"\0" + read, BYTE_NS, BYTE_NS)
    assert [f.offset for f in frames] == [2, 7]
    assert frames[0].first_ns == 2 * BYTE_NS
    assert frames[0].role is Role.REQUEST
