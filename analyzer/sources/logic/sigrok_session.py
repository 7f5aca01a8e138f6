"""The session file of sigrok (.sr): a zip archive of samples, as PulseView and sigrok-cli save them.

    version      1 or 2
    metadata     [device 1] capturefile=logic-1, samplerate=4 MHz, unitsize=1, total probes=8, probe1=RX ...
    logic-1-1    samples of `unitsize` bytes, the lowest bit is probe1; logic-1-2, ...; before version 2 one file logic-1
    analog-...   passed over, with a note

Rules: samples are unpacked in pieces and forgotten; only edges are kept. What the archive claims to unpack to is paid for
before anything is unpacked. A damaged archive is refused whole. Its times count from the first sample.
"""

from __future__ import annotations

import configparser
import re
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from itertools import pairwise
from typing import IO

import numpy as np

from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk, Event
from analyzer.sources.logic.heads import SCALES
from analyzer.sources.logic.traffic import records
from analyzer.sources.logic.waveform import CHANNEL_LIMIT, Stretch, Waveform, Words, changes, of_bit, sample_times
from analyzer.sources.source import Source, quote
from analyzer.values import SECOND_NS, counted

_METADATA = "metadata"
#: Bytes of the metadata, and of the samples that are unpacked at once.
_METADATA_LIMIT, _PIECE = 1 << 20, 1 << 20
_RATE = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([kMG]?)Hz\s*", re.IGNORECASE)
#: Widths of a sample that are words of their own.
_WORDS = (1, 2, 4, 8)
#: What zipfile raises for archives that are damaged, or packed in a way it does not know.
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, KeyError, OSError)
_SALEAE = "meta.json"


def read(source: Source) -> Iterator[Chunk | CanFrame | Event]:
    """Read the traffic. Raises UnreadableError for an archive that is damaged, or no session."""
    file = _file(source)
    try:
        archive = zipfile.ZipFile(file)
    except _DAMAGE as error:
        raise UnreadableError(f"{source.name} is a zip archive that is broken, at its directory of files: {error}") from None
    names = archive.namelist()
    if _METADATA not in names:
        raise UnreadableError(f"{source.name} is {_other(names)}")
    device = _device(source, archive)
    return records(source, _waveform(source, archive, file, device))


def _other(names: list[str]) -> str:
    """Return what an archive without metadata is, and what to do."""
    if _SALEAE in names:
        return (
            "a capture of Saleae Logic 2 (.sal), whose levels only that program reads: there choose File > Export Data, "
            "digital channels, as CSV or binary, or as VCD"
        )
    shown = f" (it holds {', '.join(map(quote, names[:3]))})" if names else ""
    return f"a zip archive and no session of sigrok, which has a file 'metadata'{shown}: unpack it"


def _file(source: Source) -> IO[bytes]:
    """Return the capture as a file that can be sought: a pipe, or what is packed once more, is copied first."""
    stream = source.stream
    if source.size is not None and not stream.compression:
        return open(stream.path, "rb")
    copy = tempfile.TemporaryFile()  # noqa: SIM115
    while block := stream.block():
        copy.write(block)
    return copy


def _device(source: Source, archive: zipfile.ZipFile) -> configparser.SectionProxy:
    """Return the section of the first device that has samples."""
    parser = configparser.ConfigParser(strict=False, interpolation=None, delimiters=("=",))
    try:
        with archive.open(_METADATA) as stream:
            parser.read_string(stream.read(_METADATA_LIMIT).decode("utf-8", "replace"))
    except (*_DAMAGE, configparser.Error) as error:
        what = " ".join(str(error).split())
        raise UnreadableError(f"{source.name}: the session is broken in its file 'metadata': {quote(what, 200)}") from None
    devices = [parser[name] for name in parser.sections() if parser[name].get("capturefile")]
    if not devices:
        analog = " but analog ones, which carry no bits" if any(n.startswith("analog-") for n in archive.namelist()) else ""
        raise UnreadableError(f"{source.name}: the session has no logic channels{analog}: expected capturefile= in 'metadata'")
    if len(devices) > 1:
        source.note(f"the session has {len(devices)} devices: only {devices[0].name} is read")
    return devices[0]


def _number(source: Source, device: configparser.SectionProxy, key: str, least: int, most: int) -> int:
    text = device.get(key, "")
    if not (text.isdecimal() and len(text) < 10 and least <= int(text) <= most):
        where = f"expected {key} from {least} to {most} in 'metadata'"
        raise UnreadableError(f"{source.name}: the session is broken: {where}, got {quote(text) or 'nothing'}")
    return int(text)


def _waveform(source: Source, archive: zipfile.ZipFile, file: IO[bytes], device: configparser.SectionProxy) -> Waveform:
    size = _number(source, device, "unitsize", 1, CHANNEL_LIMIT // 8)
    probes = {int(key[5:]) - 1: name for key, name in device.items() if re.fullmatch(r"probe\d{1,4}", key)}
    probes = {bit: name for bit, name in sorted(probes.items()) if 0 <= bit < 8 * size}
    if not probes:
        probes = {bit: f"D{bit}" for bit in range(_number(source, device, "total probes", 1, 8 * size))}
    found = _RATE.fullmatch(device.get("samplerate", ""))
    rate = round(float(found[1]) * SCALES[found[2].lower()]) if found is not None else 0
    pieces = _pieces(source, archive, device["capturefile"])
    if any(name.startswith("analog-") for name in archive.namelist()):
        source.note("analog channels are passed over")
    wave = Waveform(list(probes.values()), iter(()), SECOND_NS / rate if rate else 1.0, rated=bool(rate))
    if rate:
        source.time_source = f"capture: samples at {rate:,} Hz since its beginning".replace(",", " ")
    wave.stretches = _stretches(source, wave, archive, pieces, file, size, list(probes), rate or SECOND_NS)
    return wave


def _pieces(source: Source, archive: zipfile.ZipFile, name: str) -> list[zipfile.ZipInfo]:
    """Return the files of samples in their order. Raises UnreadableError where one is missing, or they unpack to too much."""
    numbered = re.compile(rf"{re.escape(name)}(?:-(\d{{1,9}}))?")
    named = [(numbered.fullmatch(info.filename), info) for info in archive.infolist()]
    found = sorted(((int(match[1] or 0), info) for match, info in named if match is not None), key=lambda each: each[0])
    numbers = [number for number, _ in found]
    if not found:
        raise UnreadableError(
            f"{source.name}: the session is broken: no samples, expected a file {quote(name)} or {quote(name)}-1"
        )
    wrong = next(((first, then) for first, then in pairwise(numbers) if then != first + 1), None)
    if wrong is not None:
        first, then = wrong
        what = f"{quote(name)}-{first} stands twice" if then == first else f"{quote(name)}-{first + 1} is missing"
        raise UnreadableError(f"{source.name}: the session is broken: its file {what}")
    source.stream.budget.samples(sum(info.file_size for _, info in found), archive.fp.seek(0, 2) if archive.fp else 0)
    return [info for _, info in found]


def _stretches(
    source: Source,
    wave: Waveform,
    archive: zipfile.ZipFile,
    pieces: list[zipfile.ZipInfo],
    file: IO[bytes],
    size: int,
    bits: list[int],
    rate: int,
) -> Iterator[Stretch]:
    count = 0
    before: list[int] | None = None
    with archive, file:
        for data in _samples(source, archive, pieces, file, size):
            words = _words(data, size)
            if before is None:
                before = [int(word[0]) for word in words]
                wave.first[:] = [before[bit // 64] >> bit % 64 & 1 for bit in bits]
            found = [changes(word, last) for word, last in zip(words, before, strict=True)]
            edges = [sample_times(of_bit(*found[bit // 64], bit % 64) + count, rate) for bit in bits]
            before = [int(word[-1]) for word in words]
            count += len(words[0])
            yield Stretch(edges, int(sample_times(np.array([count]), rate)[0]))


def _words(data: bytes, size: int) -> list[Words]:
    """Return samples as words of at most 64 bits each, the lowest first."""
    if size in _WORDS:
        return [np.frombuffer(data, dtype=f"<u{size}")]
    rows = np.frombuffer(data, dtype=np.uint8).reshape(-1, size)
    padded = np.zeros((len(rows), -(-size // 8) * 8), dtype=np.uint8)
    padded[:, :size] = rows
    return list(padded.view("<u8").T)


def _samples(
    source: Source, archive: zipfile.ZipFile, pieces: list[zipfile.ZipInfo], file: IO[bytes], size: int
) -> Iterator[bytes]:
    """Yield whole samples. Raises UnreadableError where the archive is damaged."""
    rest = b""
    for info in pieces:
        at = 0
        try:
            with archive.open(info) as stream:
                while data := stream.read(_PIECE):
                    at += len(data)
                    # The capture's own stream goes along, for its hash and for those who show how far it is.
                    while source.stream.position < file.tell() and source.stream.block():
                        pass
                    data = rest + data if rest else data
                    whole = len(data) // size * size
                    rest = data[whole:]
                    if whole:
                        yield data[:whole]
            if at < info.file_size:
                raise EOFError(f"expected {info.file_size} bytes, got {at}")
        except _DAMAGE as error:
            raise UnreadableError(
                f"{source.name}: the zip archive is broken in its file {quote(info.filename)}, behind byte {at} of it: {error}"
            ) from None
    if rest:
        source.note(f"the last sample breaks off: {counted(len(rest), 'byte')} of {size}")
