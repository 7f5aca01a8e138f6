"""The contract, run on a capture of every format, as it is, compressed, and in UTF-16."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
import zstandard

from analyzer.records import Chunk
from analyzer.sources import FORMATS
from tests.contracts.source_contract import check_source, read_all
from tests.sources import builders
from tests.sources.builders import SAMPLES

COMPRESSORS = {"gzip": gzip.compress, "zstd": lambda data: zstandard.ZstdCompressor().compress(data)}


@pytest.mark.parametrize("name", SAMPLES)
def test_contract(name: str, tmp_path: Path) -> None:
    sample = SAMPLES[name]
    check_source(sample.make(tmp_path), format=sample.format, kind=sample.kind, baud=sample.baud)


def test_contract_mf4(tmp_path: Path) -> None:
    path = builders.by_python_can(tmp_path / "capture.mf4", builders.messages())
    # Each reading starts a process: few cuts.
    records = check_source(path, format="mf4", kind="can", parts=2)
    assert len(records) == 40


def test_every_format_has_a_sample() -> None:
    assert {s.format for s in SAMPLES.values()} | {"mf4"} == set(FORMATS)


@pytest.mark.parametrize("packed", COMPRESSORS)
@pytest.mark.parametrize("name", SAMPLES)
def test_compressed(name: str, packed: str, tmp_path: Path) -> None:
    sample = SAMPLES[name]
    path = sample.make(tmp_path)
    plain = read_all(path, baud=sample.baud)[1]
    small = tmp_path / "small.bin"
    small.write_bytes(COMPRESSORS[packed](path.read_bytes()))
    source, records = read_all(small, baud=sample.baud)
    assert source.format == sample.format
    assert records == plain
    assert source.position() == small.stat().st_size


@pytest.mark.parametrize("packed", COMPRESSORS)
def test_cut_compressed_data_gives_what_is_there(packed: str, tmp_path: Path) -> None:
    path = tmp_path / "cut.bin"
    lines = b"".join(b"TX FA 01 F6 %02X %02X 02 34\n" % (n & 255, n * n * 7 >> 3 & 255) for n in range(40_000))
    whole = COMPRESSORS[packed](lines)
    path.write_bytes(whole[: len(whole) * 2 // 3])
    source, records = read_all(path)
    assert 5_000 < len(records) < 40_000
    assert any("ends too early" in note for note in source.notes)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "utf-16-be"])
def test_text_of_windows_shells(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "redirected.txt"
    bom = "\ufeff" if encoding == "utf-16-be" else ""
    path.write_bytes((bom + "TX FA 01 F6\r\nRX FB 01 F6\r\n").encode(encoding))
    records = read_all(path)[1]
    assert [r.data.hex() for r in records if isinstance(r, Chunk)] == ["fa01f6", "fb01f6"]
