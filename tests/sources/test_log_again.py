"""A log of this program, read back as the traffic it was made of."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import CompressionType

from analyzer.catalogue import Role
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk, Comment
from tests.contracts.source_contract import read_all
from tests.sources import builders


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_serial(compression: CompressionType, tmp_path: Path) -> None:
    path = builders.mcap_log(
        tmp_path / "log.mcap",
        [
            ("/left/1/run_speed/request", 10, {"_raw": "FA 01 F6 01 40 02 34", "_offset": 0, "_direction": "request"}),
            ("/left/1/state", 10, {"speed": 320}),
            ("/left/junk", 20, {"_raw": "00 FF", "_offset": 7, "reason": "noise"}),
            ("/findings", 20, {"message": "junk", "level": 3}),
            ("/left/1/run_speed/reply", 30, {"_raw": "FB 01 F6 01 F3", "_offset": 9}),
            ("/comments", 31, {"message": "look", "level": 2}),
            ("/right/unknown", 40, {"_raw": "3E", "_offset": 0}),
        ],
        compression=compression,
    )
    source, records = read_all(path)
    assert (source.format, source.kind) == ("mcap", "log")
    assert source.time_source == "log: capture: test"
    assert records == [
        Chunk(10, "left", bytes.fromhex("FA01F601400234"), Role.REQUEST),
        Chunk(20, "left", b"\x00\xff"),
        Chunk(30, "left", bytes.fromhex("FB01F601F3")),
        Comment(31, "left", "look"),
        Chunk(40, "right", b"\x3e"),
    ]
    assert source.notes == []


def test_can(tmp_path: Path) -> None:
    path = builders.mcap_log(
        tmp_path / "log.mcap",
        [
            ("/can0/1/run_speed/request", 10, {"_raw": "F6 01 40 02 3A", "_offset": 0, "_can_id": 1}),
            ("/can0/unknown", 11, {"_raw": "", "_offset": 5, "_can_id": 0x1ABCDE, "_can_flags": ["extended", "remote"]}),
            ("/can0/unknown", 12, {"_raw": "00", "_offset": 5, "_can_id": 4, "_can_flags": ["error"]}),
        ],
        kind="can",
    )
    assert read_all(path)[1] == [
        CanFrame(10, "can0", 1, bytes.fromhex("F60140023A")),
        CanFrame(11, "can0", 0x1ABCDE, b"", Role.UNKNOWN, extended=True, remote=True),
        CanFrame(12, "can0", 4, b"\x00", Role.UNKNOWN, error=True),
    ]


def test_bytes_that_stand_twice_are_given_once(tmp_path: Path) -> None:
    path = builders.mcap_log(
        tmp_path / "log.mcap",
        [
            ("/a/raw", 1, {"_raw": "01 02 03 04", "_offset": 0}),
            ("/a/1/x/request", 2, {"_raw": "01 02 03", "_offset": 0}),
            ("/a/1/x/reply", 3, {"_raw": "04 05 06", "_offset": 3}),
            ("/a/raw", 4, {"_raw": "05 06 07", "_offset": 4}),
        ],
    )
    assert b"".join(r.data for r in read_all(path)[1] if isinstance(r, Chunk)) == bytes(range(1, 8))


def test_messages_out_of_order_and_missing_bytes(tmp_path: Path) -> None:
    path = builders.mcap_log(
        tmp_path / "log.mcap",
        [
            ("/a/1/x/request", 1, {"_raw": "01 02", "_offset": 0}),
            ("/a/1/x/reply", 2, {"_raw": "07 08", "_offset": 6}),
            ("/a/junk", 3, {"_raw": "03 04", "_offset": 2}),
        ],
    )
    source, records = read_all(path)
    assert [r.data.hex() for r in records if isinstance(r, Chunk)] == ["0102", "0708", "0304"]
    assert source.notes == ["2 bytes of a missing in the log", "1 message of a out of order in the log"]


def test_messages_that_are_no_json(tmp_path: Path) -> None:
    path = builders.mcap_log(
        tmp_path / "log.mcap",
        [
            ("/a/junk", 1, {"_raw": "01 02", "_offset": 0}),
            ("/a/junk", 2, {"_raw": "zz", "_offset": 2}),
            ("/a/junk", 3, {"_raw": 5, "_offset": 2}),
        ],
    )
    source, records = read_all(path)
    assert len(records) == 1
    assert source.problem_count == 2


def test_an_unfinished_log_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = builders.log(tmp_path / "log.mcap")
    whole = read_all(path)[1]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    source, records = read_all(path)
    assert 0 < len(records) < len(whole)
    assert records == whole[: len(records)]
    assert any("the log is incomplete" in note for note in source.notes)


def test_a_damaged_chunk_costs_that_chunk(tmp_path: Path) -> None:
    path = builders.log(tmp_path / "log.mcap")
    whole = read_all(path)[1]
    data = bytearray(path.read_bytes())
    at = data.index(b"\x28\xb5\x2f\xfd") + 40
    data[at : at + 8] = bytes(8)
    path.write_bytes(data)
    source, records = read_all(path)
    assert 0 < len(records) < len(whole)
    assert any("a chunk of the log cannot be read" in str(p) for p in source.problems)


def test_a_log_of_another_program(tmp_path: Path) -> None:
    path = builders.mcap_log(tmp_path / "log.mcap", [("/imu", 1, {"x": 1})], profile="ros2")
    with pytest.raises(UnreadableError, match="expected an MCAP log of servotap, got one of profile 'ros2'"):
        read_all(path)
