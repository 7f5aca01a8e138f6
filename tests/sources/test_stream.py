"""Pipes, compression, bombs, long lines: what lies below the formats."""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import pytest
import zstandard

from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk
from analyzer.sources import budget, open_source
from tests.contracts.source_contract import read_all
from tests.sources import builders


class Pipe:
    """Standard input that is fed by the test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.out, self._in = os.pipe()
        self._stdin = os.fdopen(self.out, "rb")
        monkeypatch.setattr("sys.stdin", self._stdin)
        self.open = True

    def write(self, data: bytes) -> None:
        os.write(self._in, data)

    def end(self) -> None:
        if self.open:
            os.close(self._in)
        self.open = False

    def close(self) -> None:
        self.end()
        self._stdin.close()


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[Pipe]:
    made = Pipe(monkeypatch)
    yield made
    made.close()


def test_frames_of_a_pipe_come_as_they_are_written(pipe: Pipe) -> None:
    pipe.write(b"(1.000001) can0 001#F601F8\n")
    with open_source("-") as source:
        assert (source.format, source.name, source.size, source.path) == ("candump", "standard input", None, "-")
        records = iter(source)
        assert next(records) == CanFrame(1_000_001_000, "can0", 1, bytes.fromhex("F601F8"))
        pipe.write(b"(1.000002) can0 001#F6\n(1.0000")
        assert next(records) == CanFrame(1_000_002_000, "can0", 1, b"\xf6")
        pipe.write(b"03) can0 001#F7\n")
        assert next(records) == CanFrame(1_000_003_000, "can0", 1, b"\xf7")
        assert source.sha256 is None
        pipe.end()
        assert list(records) == []
        assert source.sha256 is not None


def test_a_pipe_that_begins_with_a_title_is_waited_for(pipe: Pipe) -> None:
    pipe.write(b"Logging started by me\n")
    pipe.write(b"TX: FA 01 F6 01 40 02 34\n")
    pipe.end()
    with open_source("-") as source:
        assert source.format == "hex"
        assert len(list(source)) == 2


@pytest.mark.parametrize("sample", ["raw", "pcap", "blf", "mcap", "spy", "trc"])
def test_a_pipe_gives_what_a_file_gives(sample: str, pipe: Pipe, tmp_path: Path) -> None:
    path = builders.SAMPLES[sample].make(tmp_path)
    whole = read_all(path)[1]
    pipe.write(path.read_bytes())
    pipe.end()
    with open_source("-") as source:
        given = list(source)
        assert source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    if sample == "raw":
        assert b"".join(r.data for r in given if isinstance(r, Chunk)) == path.read_bytes()
    else:
        assert given == whole


def test_bytes_of_a_pipe_one_by_one(pipe: Pipe) -> None:
    frame = bytes.fromhex("FA01F601400234")
    pipe.write(frame[:3])
    pipe.write(frame[3:])
    pipe.end()
    with open_source("-") as source:
        assert source.format == "raw"
        assert b"".join(r.data for r in source if isinstance(r, Chunk)) == frame


def test_an_empty_pipe(pipe: Pipe) -> None:
    pipe.end()
    with pytest.raises(UnreadableError, match="standard input is empty"):
        open_source("-")


def test_closed_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(UnreadableError, match="standard input cannot be read"):
        open_source("-")
    monkeypatch.setattr("sys.stdin", io.StringIO("FA 01"))
    with pytest.raises(UnreadableError, match="standard input cannot be read"):
        open_source("-")


def test_gzip_members_follow_each_other(tmp_path: Path) -> None:
    path = tmp_path / "two.gz"
    path.write_bytes(gzip.compress(b"FA 01 F6\n") + gzip.compress(b"FB 01 F6\n") + bytes(100))
    source, records = read_all(path)
    assert len(records) == 2
    assert source.notes == []


def test_what_follows_gzip_data_is_a_problem(tmp_path: Path) -> None:
    path = tmp_path / "tail.gz"
    path.write_bytes(gzip.compress(b"FA 01 F6\n") + b"tail")
    source, records = read_all(path)
    assert len(records) == 1
    assert "not gzip data (74 61 69 6C ...)" in source.problems[0].text


def test_gzip_data_with_a_wrong_checksum(tmp_path: Path) -> None:
    path = tmp_path / "wrong.gz"
    packed = bytearray(gzip.compress(b"FA 01 F6\n" * 10))
    packed[-6] ^= 0xFF
    path.write_bytes(packed)
    source, records = read_all(path)
    assert len(records) == 10
    assert "incorrect data check" in source.problems[0].text


def test_zstd_frames_follow_each_other(tmp_path: Path) -> None:
    path = tmp_path / "two.zst"
    packer = zstandard.ZstdCompressor()
    path.write_bytes(packer.compress(b"FA 01 F6\n") + packer.compress(b"FB 01 F6\n"))
    assert len(read_all(path)[1]) == 2


@pytest.mark.parametrize("packed", ["gzip", "zstd"])
def test_compressed_nothing_and_broken_beginnings(packed: str, tmp_path: Path) -> None:
    compress = gzip.compress if packed == "gzip" else zstandard.ZstdCompressor().compress
    path = tmp_path / "x"
    path.write_bytes(compress(b""))
    with pytest.raises(UnreadableError, match="is empty once unpacked"):
        open_source(path)
    path.write_bytes(compress(b"FA 01\n")[:5])
    with pytest.raises(UnreadableError, match=f"{packed} data: ends too early"):
        open_source(path)
    path.write_bytes(compress(b"FA 01\n")[:4] + b"\xff" * 40)
    with pytest.raises(UnreadableError, match=f"{packed} data: "):
        open_source(path)


def test_compressed_twice(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(gzip.compress(gzip.compress(b"FA 01\n")))
    with pytest.raises(UnreadableError, match="compressed twice"):
        open_source(path)


@pytest.mark.parametrize("packed", ["gzip", "zstd"])
@pytest.mark.parametrize("content", [b"\0", b"FA 01 F6\n", b" "])
def test_bombs_are_refused_in_bounded_memory(
    packed: str, content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(budget, "FREE_BYTES", 8 << 20)
    monkeypatch.setattr(budget, "BYTES_PER_BYTE", 150)
    size = 48 << 20
    data = content * (size // len(content))
    path = tmp_path / "bomb"
    path.write_bytes(gzip.compress(data, 6) if packed == "gzip" else zstandard.ZstdCompressor().compress(data))
    del data
    tracemalloc.start()
    try:
        with pytest.raises(UnreadableError, match="taken for a decompression bomb"), open_source(path, format="raw") as source:
            for _ in source:
                pass
        assert tracemalloc.get_traced_memory()[1] < 24 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("format", ["hex", "candump", "spy", "saleae", "sigrok", "asc", "trc", "can-csv", "hexdump", "raw"])
def test_a_line_of_ten_megabytes(format: str, tmp_path: Path) -> None:
    sample = next(s for s in builders.SAMPLES.values() if s.format == format)
    path = sample.make(tmp_path)
    path.write_bytes(path.read_bytes() + b"FA " * (10 * 350_000) + b"\n" + path.read_bytes()[-80:])
    tracemalloc.start()
    try:
        source, records = read_all(path, format=format)
        assert tracemalloc.get_traced_memory()[1] < 96 << 20
    finally:
        tracemalloc.stop()
    assert records
    if format != "raw":
        assert any("a line of 10500000 bytes, expected at most 1048576" in str(p) for p in source.problems)


def test_a_line_of_wide_characters_that_is_cut_is_told(tmp_path: Path) -> None:
    path = tmp_path / "wide.log"
    row, wide = b"FA 01 30 2B\n" * 20, "\u3000".encode()
    path.write_bytes(row + b"FA 01 32 2D " + wide * 399_360 + b" FA 01 33 2E " + wide * 61_440 + b" FA 01 34 2F\n" + row)
    source = read_all(path)[0]
    assert [problem.line for problem in source.problems] == [21]
    assert "only its beginning is used" in source.problems[0].text


def test_lines_across_blocks(tmp_path: Path) -> None:
    path = tmp_path / "long.txt"
    rows = [f"TX: {bytes((0xFA, n & 255, n >> 8 & 255)).hex(' ')}" for n in range(30_000)]
    path.write_text("\n".join(rows))
    records = read_all(path)[1]
    assert [r.data for r in records if isinstance(r, Chunk)] == [bytes((0xFA, n & 255, n >> 8)) for n in range(30_000)]


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "long.log"
    line = b"(1682894455.899123) can0 001#F60140023A\n"
    peaks = []
    for count in (6_000, 30_000):
        path.write_bytes(line * count)
        tracemalloc.start()
        with open_source(path) as source:
            assert sum(1 for _ in source) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] * 1.2


@pytest.mark.parametrize("line", [b"\n", b"TX: FA 01 32 2D\n"])
def test_too_many_lines_for_each_byte_are_refused(line: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "FREE_RECORDS", 1000)
    path = tmp_path / "lines.gz"
    path.write_bytes(gzip.compress(line * 8_000, 9))
    with pytest.raises(UnreadableError, match=r"became more than .* records, .*; if it is harmless, unpack it"):
        read_all(path, format="hex")
    path.write_bytes(line * 8_000)
    if line.strip():
        assert len(read_all(path, format="hex")[1]) == 8_000
