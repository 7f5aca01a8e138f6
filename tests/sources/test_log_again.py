"""A log of this program, read back as the traffic it was made of."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType

from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources import budget
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


def recorded(path: Path, *hostile: dict[str, object], kind: str = "serial") -> Path:
    """A log of a recording with two exchanges, and events between them."""
    setup = {"event": "port", "bus": "left", "text": "", "kind": kind, "dialects": ["mks-rs485"], "offset": 0}
    given: list[tuple[str, int, dict[str, object]]] = [("/recording", 1, setup)]
    given.append(("/left/1/run_speed/request", 2, {"_raw": "FA 01 F6 01 40 02 34", "_offset": 0}))
    given += [("/recording", 3, event) for event in hostile]
    given.append(("/left/1/run_speed/reply", 4, {"_raw": "FB 01 F6 01 F3", "_offset": 7}))
    return builders.mcap_log(path, given)


HOSTILE: list[tuple[str, object]] = [
    ("dialects", 5),
    ("dialects", [5]),
    ("dialects", ["nope"]),
    ("dialects", ["mks-can"]),
    ("late", 1e308),
    ("gap", "x"),
    ("gap", 1e308),
    ("drift", [1]),
    ("step", None),
    ("offset", -1),
    ("offset", 2**70),
    ("byte_ns", 1e3),
    ("byte_ns", 2**60),
    ("ids", {"a": 1}),
    ("groups", [2**70]),
    ("speed", "fast"),
    ("kind", "spi"),
    ("kind", 3),
    ("bytes", -1),
    ("frames", [[]]),
    ("count", {}),
    ("reason", ["\x1b[2J"]),
    ("bus", [1]),
    ("details", "{"),
    ("details", '{"gap": "x"}'),
    ("event", None),
]


@pytest.mark.parametrize(
    "name", ["port", "part", "lost", "back", "dropped", "overrun", "bus_error", "clock_step", "clock_drift"]
)
def test_a_hostile_event_costs_its_value_alone(name: str, tmp_path: Path) -> None:

    for n, (key, value) in enumerate(HOSTILE):
        path = recorded(tmp_path / f"{n}.mcap", {"event": name, "bus": "left", "text": "", key: value})
        source, records = read_all(path)
        assert b"".join(r.data for r in records if isinstance(r, Chunk)).hex() == "fa01f601400234fb01f601f3"
        said = " ".join(source.notes)
        assert (key in said or "event" in said) or (value in (["nope"], ["mks-can"], None, "{") or key in ("bus", "event"))
    everything = [{"event": name, "bus": "left", key: value} for key, value in HOSTILE]
    path = recorded(tmp_path / "all.mcap", *everything)
    assert main(["decode", str(path), "-o", str(tmp_path / "decoded.mcap")]) == 0
    assert main(["export", str(path), "-o", str(tmp_path / "decoded.csv")]) == 0
    assert sum(1 for row in (tmp_path / "decoded.csv").read_text().splitlines() if "run_speed" in row) == 2


def test_a_bus_that_has_both_serial_bytes_and_can_frames_is_two(tmp_path: Path) -> None:
    given: list[tuple[str, int, dict[str, object]]] = [
        ("/left/1/run_speed/request", 2, {"_raw": "FA 01 F6 01 40 02 34", "_offset": 0}),
        ("/left/1/run_speed/request", 3, {"_raw": "F6 01 40 02 3A", "_offset": 7, "_can_id": 1}),
        ("/left/1/run_speed/request", 4, {"_raw": "F6 01 40 02 3A", "_offset": 12, "_can_id": -1}),
        ("/left/1/run_speed/request", 5, {"_raw": "00" * 65, "_offset": 17, "_can_id": 1}),
    ]
    source, records = read_all(builders.mcap_log(tmp_path / "log.mcap", given))
    assert records == [
        Chunk(2, "left", bytes.fromhex("FA01F601400234")),
        CanFrame(3, "left_can", 1, bytes.fromhex("F60140023A")),
    ]
    assert source.problem_count == 2
    assert "left has serial bytes and CAN frames: they are kept apart as left and left_can" in source.notes


@pytest.mark.parametrize(
    ("record", "limit"), [(struct.pack("<BQ", 200, 0), "records"), (bytes((200, 247)) + bytes(254), "bytes")]
)
def test_a_chunk_bomb_is_refused_in_bounded_memory(
    record: bytes, limit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two kilobytes that are heads of records and nothing else, or records of zeros, in many chunks."""
    monkeypatch.setattr(budget, "FREE_BYTES", 1 << 20)
    monkeypatch.setattr(budget, "FREE_RECORDS", 10_000)
    inner = record * ((200 << 10) // len(record))
    packed = zstandard.ZstdCompressor().compress(inner)
    chunk = struct.pack("<QQQII", 0, 0, len(inner), 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    head = struct.pack("<BQ", 1, 20) + struct.pack("<I", 8) + b"servotap" + struct.pack("<I", 4) + b"test"
    path = tmp_path / "bomb.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + head + (struct.pack("<BQ", 6, len(chunk)) + chunk) * 40)
    tracemalloc.start()
    try:
        with pytest.raises(UnreadableError, match=f"became more than \\d+ {limit}, expected .* taken for a decompression bomb"):
            read_all(path)
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()


def test_a_damaged_record_in_a_chunk_costs_itself(tmp_path: Path) -> None:
    short = struct.pack("<BQ", 5, 10) + bytes(10)
    channel = struct.pack("<BQ", 4, 3) + b"\xff\xff\xff"
    whole = recorded(tmp_path / "log.mcap").read_bytes()
    at = 8 + 9 + struct.unpack_from("<Q", whole, 9)[0]
    path = tmp_path / "damaged.mcap"
    path.write_bytes(whole[:at] + short + channel + whole[at:])
    source, records = read_all(path)
    assert len([r for r in records if isinstance(r, Chunk)]) == 2
    assert source.problem_count == 2


def test_times_that_run_backwards_come_back_as_they_were(tmp_path: Path) -> None:
    capture, log = tmp_path / "capture.log", tmp_path / "log.mcap"
    rows = [(0, "FA 01 30 2B"), (1, "FB 01 30 FF FF FF FF 22 69 B3"), (59, "FA 01 31 2C"), (2, "FA 01 32 2D"), (3, "00 FF")]
    capture.write_text("".join(f"2026-03-02 09:00:{second:02d}.000 {data}\n" for second, data in rows))
    assert main(["decode", str(capture), "-o", str(log)]) == 0
    given, again = (read_all(path)[1] for path in (capture, log))
    assert [(r.t_ns, r.data) for r in again if isinstance(r, Chunk)] == [
        (r.t_ns, r.data) for r in given if isinstance(r, Chunk)
    ]
