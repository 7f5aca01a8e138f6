"""Cost: doubling any element that can stand repeatedly in a capture costs less than three times.

Work is counted, not timed: calls of functions and of methods in C, and the bytes that those take or give where they copy. Only
what happens inside one pattern cannot be counted; there a line twice as long is timed, as the best of several.
"""

from __future__ import annotations

import gzip
import struct
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
import zstandard

from analyzer.errors import ServotapError
from analyzer.records import Chunk
from analyzer.sources import open_source, prose
from tests.sources import builders

COUNT = 150
ALLOWED = 3
TEXTS = [name for name in builders.SAMPLES if name not in builders.BINARY]


def calls(path: Path, format: str) -> int:
    """Return how many calls it takes to read a capture."""
    counted = 0

    def count(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal counted
        counted += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        read(path, format)
    finally:
        sys.setprofile(before)
    return counted


def read(path: Path, format: str) -> None:
    try:
        with open_source(path, format=format, baud=115200) as source:
            for _ in source:
                pass
            assert source.notes is not None
    except ServotapError:
        pass


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: str) -> bytes:
    return struct.pack("<L", len(value)) + value.encode()


def mcap(*records: bytes) -> bytes:
    return b"\x89MCAP0\r\n" + record(1, text("servotap") + text("test")) + CHANNEL + b"".join(records)


def message(n: int, data: bytes, channel: int = 1) -> bytes:
    return record(5, struct.pack("<HLQQ", channel, n, n, n) + data)


def chunk(records: bytes) -> bytes:
    packed = zstandard.ZstdCompressor().compress(records)
    return record(6, struct.pack("<QQQL", 0, 9, len(records), 0) + text("zstd") + struct.pack("<Q", len(packed)) + packed)


CHANNEL = record(4, struct.pack("<HH", 1, 0) + text("/left/raw") + text("json") + struct.pack("<L", 0))
BLF_HEAD = b"LOGG" + struct.pack("<L", 144) + bytes(136)


def blf_object(size: int = 48, kind: int = 86) -> bytes:
    return struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, size, kind, 2, 0, 0, 1) + struct.pack("<HBBL8s", 1, 0, 2, 1, bytes(8))


def blf(*contents: bytes) -> bytes:
    packed = [zlib.compress(each) for each in contents]
    return BLF_HEAD + b"".join(
        struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(p), 10, 2, 0) + p + bytes((32 + len(p)) % 4) for p in packed
    )


def raw(n: int, offset: int) -> bytes:
    return message(n, b'{"_raw": "FA 01", "_offset": %d}' % offset)


FRAME = bytes.fromhex("FA01F601400234")
NG = builders.section() + builders.interface(147, "a")
#: Format and how a capture with so many elements is made.
ELEMENTS: dict[str, tuple[str, Callable[[int], bytes]]] = {
    "pcap-record": ("pcap", lambda n: builders.pcap_file(147, [(at, FRAME) for at in range(n)])),
    "pcapng-record": ("pcapng", lambda n: NG + builders.enhanced(0, 1, FRAME) * n),
    "pcapng-comment": ("pcapng", lambda n: NG + builders.enhanced(0, 1, FRAME, builders.option(1, b"abc") * n)),
    "pcapng-option": ("pcapng", lambda n: NG + builders.enhanced(0, 1, FRAME, builders.option(77, b"") * n)),
    "pcapng-interface": ("pcapng", lambda n: NG + b"".join(builders.interface(147, f"if{at}") for at in range(n))),
    "pcapng-section": ("pcapng", lambda n: (NG + builders.enhanced(0, 1, FRAME)) * n),
    "pcapng-unknown-block": ("pcapng", lambda n: NG + builders.block(0xBAD, b"abcd") * n),
    "blf-object": ("blf", lambda n: blf(blf_object() * n)),
    "blf-container": ("blf", lambda n: blf(*[blf_object()] * n)),
    "blf-container-of-a-byte": ("blf", lambda n: blf(*[b"x"] * n, blf_object())),
    "blf-object-of-size-0": ("blf", lambda n: blf(blf_object(0) * n)),
    "blf-object-of-16-mib": ("blf", lambda n: blf(*[blf_object(16 << 20, 65)] * n)),
    "blf-damaged-container": ("blf", lambda n: BLF_HEAD + struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32, 10, 2, 0) * n),
    "mcap-message": ("mcap", lambda n: mcap(*[raw(at, 2 * at) for at in range(n)])),
    "mcap-message-in-a-chunk": ("mcap", lambda n: mcap(chunk(b"".join(raw(at, 2 * at) for at in range(n))))),
    "mcap-chunk": ("mcap", lambda n: mcap(*[chunk(raw(at, 2 * at)) for at in range(n)])),
    "mcap-gap": ("mcap", lambda n: mcap(*[raw(at, 20 * at) for at in range(n)], *[raw(at, 20 * at + 10) for at in range(n)])),
    "mcap-damaged-message": ("mcap", lambda n: mcap(raw(0, 0), *[message(at, b'{"_raw": 5}') for at in range(n)])),
    "mcap-short-record": ("mcap", lambda n: mcap(raw(0, 0), *[record(5, b"x")] * n)),
    "mcap-channel": ("mcap", lambda n: mcap(*[CHANNEL.replace(b"left", b"l%03d" % (at % 999)) for at in range(n)], raw(0, 0))),
    "hexdump-star": ("hexdump", lambda n: b"".join(b"%08x  fa 01\n*\n" % (at * 20) for at in range(n))),
    "raw-byte": ("raw", lambda n: FRAME * 1000 * n),
}
PACKED: dict[str, Callable[[bytes, int], bytes]] = {
    "gzip-member": lambda data, n: gzip.compress(data) * n,
    "gzip-empty-member": lambda data, n: gzip.compress(b"") * n + gzip.compress(data),
    "zstd-frame": lambda data, n: zstandard.ZstdCompressor().compress(data) * n,
    "zstd-empty-frame": lambda data, n: (
        zstandard.ZstdCompressor().compress(b"") * n + zstandard.ZstdCompressor().compress(data)
    ),
}


def compare(path: Path, format: str, make: Callable[[int], bytes], count: int = COUNT) -> None:
    path.write_bytes(make(2))
    read(path, format)
    once = calls(path, format)
    path.write_bytes(make(count))
    some = calls(path, format) - once
    path.write_bytes(make(2 * count))
    more = calls(path, format) - once
    assert more < ALLOWED * max(some, 100)


@pytest.mark.parametrize("element", ELEMENTS)
def test_elements_of_binary_formats(element: str, tmp_path: Path) -> None:
    compare(tmp_path / "x", *ELEMENTS[element])


@pytest.mark.parametrize("packing", PACKED)
def test_members_of_compressed_files(packing: str, tmp_path: Path) -> None:
    compare(tmp_path / "x", "hex", lambda n: PACKED[packing](b"TX: FA 01 32 2D\n", n))


@pytest.mark.parametrize("name", TEXTS)
def test_lines(name: str, tmp_path: Path) -> None:
    sample = builders.SAMPLES[name]
    lines = sample.make(tmp_path).read_bytes().split(b"\n")
    last = next(line for line in reversed(lines) if line)
    damaged = last[: len(last) // 2]
    for each in (last, damaged, b"", b"# words of a comment", b"%%%", lines[0]):
        compare(tmp_path / "x", sample.format, lambda n, each=each: b"\n".join((*lines, *[each] * n, b"")), 40)


#: What a line is filled with: pieces of bytes, marks, times, quotes, and signs that patterns look for.
FILLS = (
    "FA ",
    "fa",
    "0x01, ",
    " ",
    "a",
    "1 ",
    "12:00:00 ",
    "[",
    '"',
    "\\x01",
    "=",
    "-",
    "-> ",
    "TX: FA 01 ",
    "(",
    ".",
    "| ",
    "{",
)


def lengths(lines: list[str], fill: str) -> Iterator[list[bytes]]:
    """Yield a text with a long line and one with a line twice as long: each three times, for lines that came are remembered."""
    half = len(lines) // 2
    for size in (3000, 6000):
        long = f"{lines[half]} {(fill * size)[:size]}"
        yield ["\n".join((*lines[:half], f"{long} {n}", *lines[half:])).encode() for n in range(3)]


def seconds(path: Path, texts: Sequence[bytes], format: str) -> float:
    """Return the CPU time that reading takes, the best of several texts."""
    best = 9.0
    for data in texts:
        path.write_bytes(data)
        begin = time.process_time()
        read(path, format)
        best = min(best, time.process_time() - begin)
    return best


def test_comments_of_one_block(tmp_path: Path) -> None:
    some, more = (
        seconds(tmp_path / "x", [NG + builders.enhanced(0, 1, FRAME, builders.option(1, b"x" * 12) * n)] * 3, "pcapng")
        for n in (30_000, 60_000)
    )
    assert more < max(ALLOWED * some, 0.1)


@pytest.mark.parametrize("name", TEXTS)
def test_a_line_that_is_twice_as_long(name: str, tmp_path: Path) -> None:
    sample = builders.SAMPLES[name]
    lines = sample.make(tmp_path).read_text().split("\n")[:12]
    path = tmp_path / "x"
    for fill in FILLS:
        some, more = (seconds(path, texts, sample.format) for texts in lengths(lines, fill))
        # Under a few milliseconds the clock tells nothing; the square of a line of 6000 characters takes far more.
        assert more < max(ALLOWED * some, 0.03), fill


@pytest.mark.parametrize(
    "fill",
    [
        "I sent FA 01 31 2C and got FB 01 31 00 00 00 00 00 00 2D. ",
        "> FA 01 31 2C < FB 01 31 00 00 00 00 00 00 2D ",
        "old data: FA 01 31 2C, processing FA 01 30 2B. ",
        "b'\\xfa\\x011,' sent, then b'\\xfa\\x010+' ",
    ],
)
def test_a_line_with_twice_as_many_frames(fill: str, tmp_path: Path) -> None:
    """So many that what is looked at anew for each would be most of the work."""
    some, more = (
        seconds(tmp_path / "x", [f"{fill * (size // len(fill))}{n}".encode() for n in range(3)], "hex")
        for size in (70_000, 140_000)
    )
    assert more < max(ALLOWED * some, 0.1)


@pytest.mark.parametrize("fill", [*FILLS, "--1", "'\\", "\"'\\", "1-", "<-", "FA-"])
def test_a_long_line_is_looked_through_for_bytes_in_words(fill: str) -> None:
    def look(size: int) -> float:
        best = 9.0
        # What was looked through is remembered, so no line comes twice.
        for n in range(3):
            line = f"{(fill * size)[:size]} {n}"
            begin = time.process_time()
            prose.mentions(line)
            best = min(best, time.process_time() - begin)
        return best

    assert look(20_000) < max(ALLOWED * look(10_000), 0.1)


def test_a_note_about_a_long_line_is_short(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text("I sent FA 01 31 2C and got FB 01 31 00 00 00 00 00 00 2D. " * 500)
    with open_source(path) as source:
        assert sum(isinstance(each, Chunk) for each in source) == 1000
        assert [note for note in source.notes if "and 990 more: who sent" in note]
        assert max(map(len, source.notes)) < 200


@pytest.mark.parametrize("fill", ["250 1 48 43 ", "12:00:00 ", "b'\\xfa' ", "FA,FA "])
def test_runs_of_no_frame_in_a_line_are_looked_at_with_what_is_near_them(fill: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Counting:
        looked = 0

        def split(self, text: str) -> list[str]:
            self.looked += len(text)
            return SENTENCE.split(text)

    some, more = Counting(), Counting()
    SENTENCE = prose._SENTENCE
    for counting, size in ((some, 20_000), (more, 40_000)):
        monkeypatch.setattr(prose, "_SENTENCE", counting)
        prose.mentions((fill * size)[:size])
    assert 20_000 < more.looked < ALLOWED * some.looked


def test_lines_that_come_again_cost_little_more_than_being_read(tmp_path: Path) -> None:
    """A small compressed file unpacks to such lines."""

    def work(end: str) -> int:
        counts = []
        for size in (200, 400):
            lines = ("the drive at 12 gets FA 01 30 2B from me" + end.format(1000 * size + n) for n in range(size))
            (tmp_path / "x").write_text("\n".join(lines) + "\n")
            counts.append(calls(tmp_path / "x", "hex"))
        return counts[1] - counts[0]

    assert 2 * work("") < work(" at last, {}")
