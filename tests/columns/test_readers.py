"""Readers give the same frames singly and in blocks, with any others between plain ones."""

from __future__ import annotations

import random
import struct

import can
import pytest

from analyzer.columns.block import CanBlock
from analyzer.records import CanFrame
from analyzer.sources import blf_blocks, found, open_source
from tests.sources.builders import enhanced, interface, option, pcap_file, section, socketcan

T = 1_682_894_455_899_123_000


def frames(chance, count):
    """Make frames, most of them plain: identifier, data, what is special, time."""
    t_ns = T
    for _ in range(count):
        t_ns += chance.choice((0, 1, 100, 250)) * 1000
        odd = chance.choice(("extended", "remote", "error", "fd", "back", "far")) if chance.random() < 0.03 else ""
        if odd == "back":
            t_ns -= 5000_000
        number = chance.choice((1, 2, 3, 0x7FF)) if odd != "far" else 0x1234567
        yield t_ns, number, chance.randbytes(chance.choice((0, 1, 3, 6, 8, 8))), odd


def candump(rows, path):
    tail = {"remote": "R", "fd": "#1AABB", "error": ""}
    lines = []
    for number, (t_ns, ident, data, odd) in enumerate(rows):
        shown = f"{ident:08X}" if odd in ("extended", "far") else f"{ident | (0x20000000 if odd == 'error' else 0):03X}"
        bus = "can1" if number % 400 > 370 else "can0"
        lines.append(f"({t_ns // 10**9}.{t_ns % 10**9 // 1000:06d}) {bus} {shown}#{tail.get(odd, data.hex().upper())}")
        if number % 311 == 0:
            lines.append("something else")
    path.write_text("\n".join(lines) + "\n")


def pcap(rows, path, padding=8, order="<"):
    marks = {"extended": 0x8000_0000, "far": 0x8000_0000, "remote": 0x4000_0000, "error": 0x2000_0000}
    made = [
        (
            t_ns,
            socketcan(ident | marks.get(odd, 0), data.ljust(padding, b"\0") if odd != "fd" else data, 4 if odd == "fd" else 0),
        )
        for t_ns, ident, data, odd in rows
    ]
    # The length counts the data alone, also where more is stored.
    made = [
        (t_ns, record[:4] + bytes((len(data),)) + record[5:])
        for (t_ns, record), (_, _, data, _) in zip(made, rows, strict=True)
    ]
    path.write_bytes(pcap_file(227, made, order))


def pcap_short(rows, path):
    pcap(rows, path, 0, ">")


def pcapng(rows, path, padding=8, order="<", resolution=9):
    marks = {"extended": 0x8000_0000, "far": 0x8000_0000, "remote": 0x4000_0000, "error": 0x2000_0000}
    head = section(order) + interface(227, "can0", resolution, order) + interface(227, "can1", resolution, order)
    out = [head]
    for number, (t_ns, ident, data, odd) in enumerate(rows):
        frame = socketcan(
            ident | marks.get(odd, 0), data.ljust(padding, b"\0") if odd != "fd" else data, 4 if odd == "fd" else 0
        )
        frame = frame[:4] + bytes((len(data),)) + frame[5:]
        options = option(1, b"a comment", order) + option(0, b"", order) if number % 211 == 0 else b""
        out.append(enhanced(number % 400 > 300, t_ns // 10 ** (9 - resolution), frame, options, order))
        if number % 251 == 0:
            # Some statistics; a block that is damaged; a new section.
            out.append(struct.pack(order + "LL4xL", 5, 16, 16))
        if number % 733 == 700:
            out[-1] = out[-1][:-1] + bytes((out[-1][-1] ^ 1,))
        if number == 1000:
            out.append(head)
    path.write_bytes(b"".join(out))


def pcapng_big_short(rows, path):
    pcapng(rows, path, 0, ">", 6)


def blf(rows, path):
    with can.BLFWriter(str(path)) as writer:
        for number, (t_ns, ident, data, odd) in enumerate(rows):
            writer.on_message_received(
                can.Message(
                    t_ns / 1e9, ident, odd in ("extended", "far"), odd == "remote", odd == "error", number % 900 > 850,
                    0 if odd == "remote" else len(data), b"" if odd == "remote" else data, odd == "fd",
                    is_rx=number % 3 > 0,
                )
            )  # fmt: skip


@pytest.mark.parametrize("write", [candump, pcap, pcap_short, pcapng, pcapng_big_short, blf], ids=lambda write: write.__name__)
@pytest.mark.parametrize("seed", range(3))
def test_the_same_frames(write, seed, tmp_path, monkeypatch):
    monkeypatch.setattr(found, "SHORTEST", 8)
    path = tmp_path / "capture"
    write(list(frames(random.Random(seed), 1500)), path)
    single, together = open_source(str(path)), open_source(str(path))
    together.in_blocks = True
    expected = list(single)
    got, in_blocks = [], 0
    for item in together.items():
        if isinstance(item, CanBlock):
            got += item.frames()
            in_blocks += len(item)
        else:
            got.append(item)
    assert got == expected
    assert in_blocks > 500
    assert (together.notes, together.problems) == (single.notes, single.problems)
    assert {type(item) for item in got} <= {CanFrame, *map(type, expected)}


class Looked(bytearray):
    """Bytes that count how many of them were looked at."""

    total = 0

    def __getitem__(self, place):
        self.total += len(range(*place.indices(len(self))))
        return super().__getitem__(place)


def test_looking_for_like_objects_costs_as_much_as_there_are():
    one, other = (bytes([mark]) * blf_blocks.SIZE for mark in (1, 2))
    buffer, at, counts = Looked((one * blf_blocks.SHORTEST + other) * 300), 0, []
    while at < len(buffer):
        counts.append(blf_blocks.alike(buffer, at))
        at += counts[-1] * blf_blocks.SIZE
    assert counts == [blf_blocks.SHORTEST, 1] * 300
    assert buffer.total < 5 * len(buffer)
