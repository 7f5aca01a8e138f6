"""ASC, BLF, TRC, CSV and MF4, written by python-can, and what real files hold besides."""

from __future__ import annotations

import random
import struct
import zlib
from pathlib import Path

import can
import pytest

from analyzer.catalogue import Role
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame
from analyzer.sources import open_source
from analyzer.system import bounded
from tests.contracts.source_contract import read_all
from tests.sources import builders

#: Digits that a text format prints after the second; the others are good to 1 us.
ENDINGS = (".asc", ".blf", ".trc", ".csv", ".mf4")


@pytest.fixture(autouse=True)
def utc(monkeypatch: pytest.MonkeyPatch) -> None:
    # python-can's ASC writer prints local time, which the format does not name.
    import time

    monkeypatch.setenv("TZ", "UTC")
    time.tzset()


def frames(path: Path) -> list[CanFrame]:
    return [r for r in read_all(path)[1] if isinstance(r, CanFrame)]


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_python_can_wrote(ending: str, tmp_path: Path) -> None:
    given = builders.messages()
    got = frames(builders.by_python_can(tmp_path / f"capture{ending}", given))
    assert len(got) == len(given)
    # ASC and BLF count channels from 1, MF4 as they came; CSV has none.
    port = {".csv": "can", ".mf4": "can0"}.get(ending, "can1")
    start = round(given[0].timestamp * 1e9)
    for frame, message in zip(got, given, strict=True):
        assert (frame.id, frame.data) == (message.arbitration_id, bytes(message.data))
        assert (frame.extended, frame.remote, frame.error, frame.fd) == (False, False, False, False)
        assert frame.port == port
        assert frame.direction is (Role.UNKNOWN if message.is_rx or ending == ".csv" else Role.REQUEST)
        assert frame.t_ns is not None
        # TRC and ASC round the start of the measurement to what their headers can say.
        coarse = 1_000_000 if ending in (".asc", ".blf", ".trc") else 1_000
        assert abs(frame.t_ns - message.timestamp * 1e9) <= coarse + 300
        assert got[0].t_ns is not None
        assert abs((frame.t_ns - got[0].t_ns) - (round(message.timestamp * 1e9) - start)) <= 1_000 + 300


@pytest.mark.parametrize("ending", [".asc", ".blf", ".csv", ".mf4"])
def test_every_kind_of_frame(ending: str, tmp_path: Path) -> None:
    given = [
        can.Message(timestamp=1.0, arbitration_id=0x1ABCDE, is_extended_id=True, data=b"\1\2", channel=1),
        can.Message(timestamp=2.0, arbitration_id=0x12, is_extended_id=False, is_remote_frame=True, dlc=3, channel=1),
        can.Message(timestamp=3.0, is_error_frame=True, channel=1),
    ]
    if ending != ".csv":
        given.append(can.Message(timestamp=4.0, arbitration_id=1, is_extended_id=False, is_fd=True, data=bytes(12), channel=1))
    got = frames(builders.by_python_can(tmp_path / f"capture{ending}", given))
    assert [(f.extended, f.remote, f.error, f.fd) for f in got] == [
        (True, False, False, False),
        (False, True, False, False),
        (False, False, True, False),
        (False, False, False, True),
    ][: len(given)]
    assert got[0].id == 0x1ABCDE
    assert got[0].data == b"\1\2"
    assert got[1].data == b""


ASC = """\
date Sun Apr 30 10:40:55.899 pm 2023
base hex  timestamps absolute
no internal events logged
// version 9.0.0
Begin Triggerblock Sun Apr 30 10:40:55.899 pm 2023
   0.000000 Start of measurement
   0.000123 1  001             Tx   d 5 F6 01 40 02 3A  Length = 0 BitCount = 0
   0.000123 1  001             TxRq d 5 F6 01 40 02 3A
   0.001000 CAN 1 Status:chip status error active
   0.002000123 2  1ABCDEx         Rx   d 1 FF
   0.003000 1  ErrorFrame
   1.000000 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
End TriggerBlock
"""


def test_asc_of_canalyzer(tmp_path: Path) -> None:
    path = tmp_path / "capture.asc"
    path.write_text(ASC)
    start = 1_682_894_455_899_000_000
    assert frames(path) == [
        CanFrame(start + 123_000, "can1", 1, bytes.fromhex("F60140023A"), Role.REQUEST),
        CanFrame(start + 2_000_123, "can2", 0x1ABCDE, b"\xff", Role.UNKNOWN, extended=True),
        CanFrame(start + 3_000_000, "can1", 0, b"", Role.UNKNOWN, error=True),
    ]


def test_asc_with_relative_times_and_decimal_numbers(tmp_path: Path) -> None:
    path = tmp_path / "capture.asc"
    path.write_text(
        "date Son Mär 5 14:00:00 2023\nbase dec  timestamps relative\n"
        " 0.5 1  16  Rx   d 2 255 1\n 0.25 CAN 1 Status:x\n 0.25 1  16  Rx   d 1 10\n"
    )
    start = 1_678_024_800 * 10**9
    assert [(f.t_ns, f.id, f.data) for f in frames(path)] == [
        (start + 500_000_000, 16, b"\xff\x01"),
        (start + 1_000_000_000, 16, b"\x0a"),
    ]


def test_asc_without_a_header_loses_no_frame(tmp_path: Path) -> None:
    path = tmp_path / "capture.asc"
    path.write_text(" 0.5 1  16  Rx   d 1 FF\n 0.6 1  16  Rx   d 1 FE\n")
    assert [f.data for f in frames(path)] == [b"\xff", b"\xfe"]


TRC_11 = """\
;$FILEVERSION=1.1
;$STARTTIME=45046.9450914352
;
;   Message Number, Time Offset (ms), Type, ID (hex), Data Length Code, Data Bytes
     1)         1.2  Rx         0001  5  F6 01 40 02 3A
     2)         2.3  Tx     001ABCDE  1  FF
     3)         3.4  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY
     4)         4.5  Rx         0001  1  FE
"""


def test_trc_of_pcan_view(tmp_path: Path) -> None:
    path = tmp_path / "capture.trc"
    path.write_text(TRC_11)
    source, records = read_all(path)
    start = 1_682_894_455_900_001_280
    assert records == [
        CanFrame(start + 1_200_000, "can", 1, bytes.fromhex("F60140023A")),
        CanFrame(start + 2_300_000, "can", 0x1ABCDE, b"\xff", Role.REQUEST, extended=True),
        CanFrame(start + 4_500_000, "can", 1, b"\xfe"),
    ]
    assert source.notes == ["1 line left out: not frames (bus status, errors)"]


def test_trc_version_1_0(tmp_path: Path) -> None:
    path = tmp_path / "capture.trc"
    path.write_text(";   PCAN trace\n     1)      10 0001 2 F6 01\n     2)      20 0001 1 F7\n")
    assert [(f.t_ns, f.data) for f in frames(path)] == [(10_000_000, b"\xf6\x01"), (20_000_000, b"\xf7")]


def test_every_kind_of_frame_in_trc(tmp_path: Path) -> None:
    path = tmp_path / "capture.trc"
    rows = (
        "0 1.0 RR 1 001ABCDE Rx 3",
        "1 2.0 FD 1 0001 Tx 9 " + "11 " * 12,
        "2 3.0 FB 2 0001 Rx 2 F6 01",
        "3 4.0 DT 1 0001 Rx 0",
    )
    path.write_text(";$FILEVERSION=2.0\n;$COLUMNS=N,O,T,B,I,d,L,D\n" + "\n".join(rows) + "\n")
    assert frames(path) == [
        CanFrame(1_000_000, "can1", 0x1ABCDE, b"", extended=True, remote=True),
        CanFrame(2_000_000, "can1", 1, b"\x11" * 12, Role.REQUEST, fd=True),
        CanFrame(3_000_000, "can2", 1, b"\xf6\x01", fd=True),
        CanFrame(4_000_000, "can1", 1, b""),
    ]


def test_trc_of_an_unknown_version(tmp_path: Path) -> None:
    path = tmp_path / "capture.trc"
    path.write_text(";$FILEVERSION=9.9\n 1) 1.2 Rx 0001 1 FF\n")
    with pytest.raises(UnreadableError, match=r"TRC version 9.9 is not supported, expected one of 1.0"):
        open_source(path)


@pytest.mark.parametrize("ending", [".asc", ".trc", ".csv"])
def test_a_bad_line_costs_one_line(ending: str, tmp_path: Path) -> None:
    path = builders.by_python_can(tmp_path / f"capture{ending}", builders.messages())
    lines = path.read_text().splitlines()
    where = len(lines) - 10
    bad = {".asc": " 0.001 1  XYZ Rx d 2 GG", ".trc": " 1 x DT 1 0001 Rx - 5 F6", ".csv": "1.5,zz,0,0,0,1,!"}[ending]
    lines.insert(where, bad)
    path.write_text("\n".join(lines) + "\n")
    source, records = read_all(path)
    assert len(records) == 40
    assert [p.line for p in source.problems] == [where + 1]


def test_csv_that_was_appended_to(tmp_path: Path) -> None:
    path = builders.by_python_can(tmp_path / "capture.csv", builders.messages(2))
    path.write_text(path.read_text() * 2)
    assert len(frames(path)) == 4


def test_csv_times_are_exact(tmp_path: Path) -> None:
    path = tmp_path / "capture.csv"
    head = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
    path.write_text(head + "1483389946.123456789,0x1,0,0,0,1,/w==\n1e-05,0x1,0,0,0,1,/w==\n")
    assert [f.t_ns for f in frames(path)] == [1_483_389_946_123_456_789, 10_000]


def blf_of(tmp_path: Path) -> tuple[Path, bytes]:
    # Data that does not compress well, so that there are several containers.
    noise = random.Random(1)
    given = [
        can.Message(timestamp=1e9 + n, arbitration_id=1, is_extended_id=False, data=noise.randbytes(8), channel=0)
        for n in range(9000)
    ]
    path = builders.by_python_can(tmp_path / "capture.blf", given)
    return path, path.read_bytes()


def test_a_damaged_blf_container_costs_that_container(tmp_path: Path) -> None:
    path, data = blf_of(tmp_path)
    assert data.count(b"LOBJ") > 2
    at = data.index(b"LOBJ") + 3000
    path.write_bytes(data[:at] + bytes(200) + data[at + 200 :])
    source, records = read_all(path)
    assert 3000 < len(records) < 9000
    assert source.problems


def test_a_cut_blf_gives_what_is_there(tmp_path: Path) -> None:
    path, data = blf_of(tmp_path)
    path.write_bytes(data[: len(data) * 5 // 6])
    source, records = read_all(path)
    assert 6000 < len(records) < 9000
    assert any("breaks off after" in str(p) for p in source.problems)


def test_a_blf_bomb_is_refused(tmp_path: Path) -> None:
    path, data = blf_of(tmp_path)
    bomb = zlib.compress(bytes(80 << 20), 9)
    container = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(bomb), 10) + struct.pack("<H6xL4x", 2, 100) + bomb
    path.write_bytes(data[:144] + container)
    with pytest.raises(UnreadableError, match="decompression bomb"):
        read_all(path)


def blf_object(kind: int, body: bytes, size: int | None = None, version: int = 1) -> bytes:
    """One object; `size`: what it claims to have."""
    times = struct.pack("<LHHQ", 2, 0, 0, 5_000_000_000) + bytes(8 if version == 2 else 0)
    whole = 16 + len(times) + len(body)
    head = struct.pack("<4sHHLL", b"LOBJ", 16 + len(times), version, whole if size is None else size, kind)
    return head + times + body + bytes(-whole % 4)


def blf_file(tmp_path: Path, *containers: bytes) -> Path:
    path, data = blf_of(tmp_path)
    out = data[:144]
    for inner in containers:
        packed = zlib.compress(inner)
        out += struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(packed), 10, 2, len(inner)) + packed
        out += bytes((32 + len(packed)) % 4)
    path.write_bytes(out)
    return path


ONE = struct.pack("<HBBL8s", 1, 0, 2, 0x12, b"\xf6\x01" + bytes(6))


@pytest.mark.parametrize("size", [0, 15, 31, 33, 1000, 5000, 1 << 20, 0xFFFF_FFFF])
@pytest.mark.parametrize("kind", [1, 10, 65])
def test_a_size_that_a_blf_object_cannot_have_costs_that_object(kind: int, size: int, tmp_path: Path) -> None:
    good = blf_object(86, ONE)
    path = blf_file(tmp_path, good * 3 + blf_object(kind, ONE, size) + good * 3)
    source, records = read_all(path)
    assert 6 <= len([r for r in records if isinstance(r, CanFrame) and r.id == 0x12]) <= 7
    assert source.problem_count
    assert f"claims {size} bytes" in source.problems[0].text or "header" in source.problems[0].text


def test_a_blf_object_that_goes_on_in_the_next_container(tmp_path: Path) -> None:
    good = blf_object(1, ONE)
    path = blf_file(tmp_path, good * 2 + good[:20], good[20:] + good)
    source, records = read_all(path)
    assert len(records) == 4
    assert not source.problems


def test_every_type_of_blf_object_as_python_can_reads_it(tmp_path: Path) -> None:
    payload = bytes(range(64))
    objects = blf_object(1, struct.pack("<HBBL8s", 2, 0x01, 3, 0x8000_0123, payload[:8]))
    objects += blf_object(86, struct.pack("<HBBL8s", 1, 0x80, 3, 0x7FF, payload[:8]), version=2)
    objects += blf_object(73, struct.pack("<HHLBBBxLLH2x8s", 1, 0, 0, 0, 0, 2, 0, 0x11, 0, payload[:8]))
    objects += blf_object(100, struct.pack("<HBBLLBBB5x64s", 1, 1, 9, 0x22, 0, 0, 1, 12, payload))
    objects += blf_object(101, struct.pack("<BBBBLLLLLLLHBBL", 3, 15, 64, 0, 0x33, 0, 0x1000, 0, 0, 0, 0, 0, 1, 0, 0) + payload)
    objects += blf_object(101, struct.pack("<BBBBLLLLLLLHBBL", 3, 15, 64, 0, 0x33, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0) + payload[:10])
    path = blf_file(tmp_path, objects)
    ours = frames(path)
    theirs = list(can.LogReader(path))
    assert len(ours) == len(theirs) == 6
    for frame, message in zip(ours, theirs, strict=True):
        assert frame.t_ns is not None
        assert abs(frame.t_ns - message.timestamp * 1e9) < 1000
        assert (frame.id, frame.remote, frame.error) == (
            message.arbitration_id,
            message.is_remote_frame,
            message.is_error_frame,
        )
        assert frame.data == (b"" if message.is_remote_frame else bytes(message.data))
        assert frame.port == f"can{message.channel + 1}"
        assert frame.extended == (message.is_extended_id and not message.is_error_frame)
        assert frame.fd == message.is_fd
        assert (frame.direction is Role.REQUEST) == (not message.is_rx)


def test_an_identifier_that_no_can_frame_has(tmp_path: Path) -> None:
    path = tmp_path / "capture.trc"
    path.write_text(TRC_11.replace("1)         1.2  Rx         0001", "1)         1.2  Rx  -9223372036854775808"))
    source, records = read_all(path)
    assert len(records) == 2
    assert "expected an identifier of 29 bits" in source.problems[0].text


def test_blf_objects_outside_containers(tmp_path: Path) -> None:
    path, data = blf_of(tmp_path)
    body = struct.pack("<HBBL8s", 1, 0, 2, 0x12, b"\xf6\x01" + bytes(6))
    one = struct.pack("<4sHHLL", b"LOBJ", 32, 1, 32 + len(body), 1) + struct.pack("<LHHQ", 2, 0, 0, 5_000_000_000) + body
    path.write_bytes(data[:144] + one * 3)
    got = frames(path)
    assert [(f.id, f.data, f.port) for f in got] == [(0x12, b"\xf6\x01", "can1")] * 3


def test_mf4_without_asammdf_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    path = tmp_path / "capture.mf4"
    path.write_bytes(b"MDF     4.10    " + bytes(200))
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(UnreadableError, match=r"needs asammdf: pip install 'servotap\[mf4\]'"):
        open_source(path)


def test_a_crash_of_the_mf4_reader_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from analyzer.sources import mf4

    path = tmp_path / "capture.mf4"
    path.write_bytes(b"MDF     4.10    " + bytes(200))
    monkeypatch.setattr(mf4, "_installed", lambda: True)
    monkeypatch.setattr(bounded, "CHILD", "import os; os.abort()")
    with pytest.raises(UnreadableError, match=r"asammdf crashed on it \(exit code -6\)"):
        read_all(path)


def test_an_mf4_that_lacks_memory_is_not_called_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from analyzer.sources import mf4

    path = tmp_path / "capture.mf4"
    path.write_bytes(b"MDF     4.10    " + bytes(200))
    monkeypatch.setattr(mf4, "_installed", lambda: True)
    lacking = "import can.io.mf4\ndef MF4Reader(path): raise MemoryError\ncan.io.mf4.MF4Reader = MF4Reader\n"
    monkeypatch.setattr(bounded, "CHILD", lacking + bounded.CHILD)
    with pytest.raises(UnreadableError, match=r"capture.mf4: reading the MF4 file takes more memory .*: MemoryError"):
        read_all(path)


def test_an_mf4_leaves_no_file_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = builders.by_python_can(tmp_path / "capture.mf4", builders.messages())
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    assert read_all(path)
    assert list(folder.iterdir()) == []


def test_a_broken_mf4_is_refused(tmp_path: Path) -> None:
    path = builders.by_python_can(tmp_path / "capture.mf4", builders.messages())
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(UnreadableError, match="damaged or broken off"):
        read_all(path)
