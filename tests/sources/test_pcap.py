"""pcap and pcapng: byte orders, resolutions, link types, directions, damage."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from analyzer.catalogue import Role
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources import Record, Source, open_source
from tests.contracts.source_contract import read_all
from tests.sources.builders import block, enhanced, interface, option, pcap_file, section, socketcan

U, REQUEST, REPLY = Role.UNKNOWN, Role.REQUEST, Role.REPLY
T = 1_682_894_455_899_123_456


def read(tmp_path: Path, data: bytes) -> tuple[Source, list[Record]]:
    path = tmp_path / "capture.bin"
    path.write_bytes(data)
    return read_all(path)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nano", [True, False])
def test_pcap_headers(order: str, nano: bool, tmp_path: Path) -> None:
    source, records = read(tmp_path, pcap_file(227, [(T, socketcan(1, b"\xf6\x01"))], order, nano))
    assert (source.format, source.kind) == ("pcap", "can")
    assert records == [CanFrame(T if nano else T // 1000 * 1000, "can", 1, b"\xf6\x01")]


@pytest.mark.parametrize(
    ("data", "frame"),
    [
        (socketcan(0x80000123, b"\1"), CanFrame(T, "can", 0x123, b"\1", U, extended=True)),
        (socketcan(0x40000123, b""), CanFrame(T, "can", 0x123, b"", U, remote=True)),
        (socketcan(0x20000004, bytes(8)), CanFrame(T, "can", 4, bytes(8), U, error=True)),
        (socketcan(0x123, bytes(12), 0x04), CanFrame(T, "can", 0x123, bytes(12), U, fd=True)),
        (socketcan(0x123, b"\1") + bytes(63), CanFrame(T, "can", 0x123, b"\1", U, fd=True)),
        (socketcan(0x123, b"\1") + bytes(7), CanFrame(T, "can", 0x123, b"\1")),
    ],
)
def test_socketcan(data: bytes, frame: CanFrame, tmp_path: Path) -> None:
    assert read(tmp_path, pcap_file(227, [(T, data)]))[1] == [frame]


@pytest.mark.parametrize("order", ["<", ">"])
def test_linux_cooked(order: str, tmp_path: Path) -> None:
    can = struct.pack(order + "L", 0x80000123) + b"\1\0\0\0" + b"\xaa"
    ip = struct.pack(">HHHQH", 0, 1, 6, 0, 0x0800) + b"\x45"
    sent = struct.pack(">HHHQH", 4, 280, 0, 0, 0x000C) + can
    heard = struct.pack(">HHHQH", 0, 280, 0, 0, 0x000C) + can
    source, records = read(tmp_path, pcap_file(113, [(T, ip), (T, sent), (T, heard)], order))
    assert records == [
        CanFrame(T, "can", 0x123, b"\xaa", REQUEST, extended=True),
        CanFrame(T, "can", 0x123, b"\xaa", U, extended=True),
    ]
    assert "records other than CAN frames were left out" in source.notes
    newer = struct.pack(">HHLHBBQ", 0x000C, 0, 3, 280, 4, 0, 0) + can
    assert read(tmp_path, pcap_file(276, [(T, newer)], order))[1] == records[:1]


def rtac(event: int, data: bytes = b"") -> bytes:
    return struct.pack(">LLBBH", 1, 2, event, 0, 0) + data


def test_rtac(tmp_path: Path) -> None:
    given = [rtac(2, b"\x01"), rtac(1, b"\xfa\x01"), rtac(2, b"\xfb"), rtac(3), rtac(7), rtac(4, b"\xfb\x02")]
    source, records = read(tmp_path, pcap_file(250, [(T + n, d) for n, d in enumerate(given)]))
    assert source.kind == "serial"
    assert records == [
        Chunk(T, "serial", b"\x01", U, True),
        Chunk(T + 1, "serial", b"\xfa\x01", REQUEST, True),
        Chunk(T + 2, "serial", b"\xfb", REPLY, True),
        Comment(T + 4, "serial", "framing error"),
        Chunk(T + 5, "serial", b"\xfb\x02", REPLY, True),
    ]


@pytest.mark.parametrize("link", [147, 155, 162])
def test_user_links_are_raw_bytes(link: int, tmp_path: Path) -> None:
    records = read(tmp_path, pcap_file(link, [(T, b"\xfa\x01"), (T, b"")]))[1]
    assert records == [Chunk(T, "serial", b"\xfa\x01", U, True)]


def test_a_link_type_without_drive_traffic(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match=r"link type 1 \(Ethernet\) carries no drive traffic, expected SocketCAN"):
        read(tmp_path, pcap_file(1, [(T, bytes(60))]))


def test_a_record_longer_than_any_ends_the_reading(tmp_path: Path) -> None:
    data = pcap_file(147, [(T, b"\xfa")]) + struct.pack("<LLLL", 1, 1, 0xFFFFFF00, 5) + bytes(50)
    source, records = read(tmp_path, data)
    assert len(records) == 1
    assert source.problems[0].offset == 24 + 17
    assert "expected at most" in source.problems[0].text


def test_a_cut_pcap(tmp_path: Path) -> None:
    data = pcap_file(147, [(T, b"\xfa\x01")] * 3)
    source, records = read(tmp_path, data[:-1])
    assert len(records) == 2
    assert str(source.problems[0]) == f"byte {24 + 2 * 18}: the last record breaks off after 17 bytes"


@pytest.mark.parametrize(
    ("resolution", "ticks", "t_ns"),
    [(9, T, T), (6, T // 1000, T // 1000 * 1000), (3, T // 10**6, T // 10**6 * 10**6), (0x80 | 10, 1536, 1_500_000_000)],
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_pcapng_resolutions(resolution: int, ticks: int, t_ns: int, order: str, tmp_path: Path) -> None:
    data = section(order) + interface(227, "can7", resolution, order) + enhanced(0, ticks, socketcan(1, b"\xf6"), b"", order)
    source, records = read(tmp_path, data)
    assert (source.format, source.kind) == ("pcapng", "can")
    assert records == [CanFrame(t_ns, "can7", 1, b"\xf6")]


def test_pcapng_with_everything(tmp_path: Path) -> None:
    text = option(1, b"look here") + option(0, b"")
    outgoing, incoming = (option(2, struct.pack("<L", n)) + option(0, b"") for n in (2, 1))
    data = (
        section(options=option(1, "a séction".encode()) + option(0, b""))
        + interface(227, "can0")
        + interface(147, "COM3")
        + interface(1, "eth0")
        + block(5, bytes(12))
        + enhanced(0, T, socketcan(1, b"\xf6"), text)
        + enhanced(1, T, b"\x01", incoming)
        + enhanced(1, T, b"\xfa", outgoing)
        + enhanced(1, T + 1, b"\xfb", incoming)
        + enhanced(2, T, bytes(60))
        + enhanced(9, T, b"\0")
        + block(3, struct.pack("<L", 9) + socketcan(2, b"\1") + bytes(3))
        + section(">")
        + interface(147, "", 6, ">")
        + enhanced(0, T // 1000, b"\x3e", b"", ">")
    )
    source, records = read(tmp_path, data)
    assert records == [
        Comment(1682894455899123456, "can", "a séction"),
        Comment(T, "can0", "look here"),
        CanFrame(T, "can0", 1, b"\xf6"),
        Chunk(T, "COM3", b"\x01", U, True),
        Chunk(T, "COM3", b"\xfa", REQUEST, True),
        Chunk(T + 1, "COM3", b"\xfb", REPLY, True),
        CanFrame(T + 1, "can0", 2, b"\1"),
        Chunk(T // 1000 * 1000, "can", b"\x3e", U, True),
    ]
    texts = [p.text for p in source.problems]
    assert any("link type 1 (Ethernet)" in t for t in texts)
    assert any("interface 9, which the section does not declare" in t for t in texts)


def test_pcapng_blocks_of_impossible_length(tmp_path: Path) -> None:
    data = section() + interface(147) + enhanced(0, T, b"\xfa") + struct.pack("<LL", 6, 0xFFFFFFF0) + bytes(100)
    source, records = read(tmp_path, data)
    assert len(records) == 1
    assert "a block of 4294967280 bytes" in source.problems[0].text


def test_pcapng_packet_that_claims_more_than_its_block(tmp_path: Path) -> None:
    lying = block(6, struct.pack("<LLLLL", 0, 0, 0, 99, 99) + b"\xfa")
    source, records = read(tmp_path, section() + interface(147) + lying + enhanced(0, T, b"\xfb"))
    assert [r.data for r in records if isinstance(r, Chunk)] == [b"\xfb"]
    assert "a record of 99 bytes" in source.problems[0].text


def test_forced_on_something_else(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"FA 01 F6\n")
    for name in ("pcap", "pcapng"):
        with pytest.raises(UnreadableError, match="expected a pcap"):
            open_source(path, format=name)


def test_a_block_whose_lengths_differ_is_a_problem(tmp_path: Path) -> None:
    damaged = bytearray(enhanced(0, 1, b"\xfa\x01"))
    damaged[-4] ^= 4
    source, records = read(tmp_path, section() + interface(147, "tty") + bytes(damaged) + block(77, bytes(8)))
    assert len(records) == 1
    assert "a block says at its end that it has" in source.problems[0].text
    assert any("1 block of types that pcapng does not have" in note for note in source.notes)
