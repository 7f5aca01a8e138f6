"""Which dialects a bus is in, found from traffic as it comes."""

from __future__ import annotations

from analyzer import dialects
from analyzer.live.detection import HOLD_NS, Detection
from analyzer.records import CanFrame, Chunk
from tests.collect import crc, sum8

MS = 1_000_000
POLL = bytes.fromhex(sum8("FA 01 32") + sum8("FB 01 32 FE D4"))


def fed(detection, pieces, start_ms=0):
    """SnapshotSink pieces 10 ms apart; return what was decided first and when, in ms."""
    for number, data in enumerate(pieces):
        at = (start_ms + 10 * number) * MS
        detection.add(Chunk(at, "x", data))
        choice = detection.first(at)
        if choice is not None:
            return [d.name for d in choice.dialects], start_ms + 10 * number
    return None, None


def names(choice):
    return [d.name for d in choice.dialects]


def test_sure_after_a_few_exchanges():
    found, at = fed(Detection("serial", dialects.every()), [POLL] * 50)
    assert found == ["mks-rs485"]
    assert at < 100


def test_noise_is_waited_out_and_all_are_tried():
    detection = Detection("serial", dialects.every())
    found, at = fed(detection, [b"\x00\x55\x10\x77\x99\x01"] * 200)
    assert found == ["mks-rs485", "mks-modbus", "lk-rs485"]
    assert at * MS == HOLD_NS
    assert detection.guessing
    assert detection.recheck(1000 * MS) is None  # too soon
    assert detection.recheck(3000 * MS) is None  # nothing new
    for n in range(1000):
        detection.add(Chunk((3000 + 10 * n) * MS, "x", POLL))
    assert names(detection.recheck(13_000 * MS)) == ["mks-rs485"]
    assert not detection.guessing
    assert detection.recheck(60_000 * MS) is None


def test_nothing_more_comes():
    detection = Detection("serial", dialects.every())
    detection.add(Chunk(0, "x", POLL[:5]))
    assert detection.first(0) is None
    assert detection.first(0, final=True) is not None


def test_a_dialect_that_joins():
    detection = Detection("serial", dialects.every())
    fed(detection, [POLL] * 10)
    other = [crc("05 04 00 32 00 01"), crc("05 04 02 00 10")]
    for n in range(400):
        data = POLL + bytes.fromhex(other[n % 2])
        detection.add(Chunk((1000 + 10 * n) * MS, "x", data))
        detection.junk(7)
    assert names(detection.recheck(6000 * MS)) == ["mks-rs485", "mks-modbus"]


def test_some_junk_is_no_cause():
    detection = Detection("serial", dialects.every())
    fed(detection, [POLL] * 10)
    for n in range(1000):
        detection.add(Chunk((1000 + 10 * n) * MS, "x", POLL))
    detection.junk(100)
    assert detection.recheck(12_000 * MS) is None


def test_the_only_dialect_of_a_kind_is_it():
    detection = Detection("can", dialects.every())
    detection.add(CanFrame(0, "x", 1, b"\x30\x31"))
    assert names(detection.first(0)) == ["mks-can"]
