"""Levels as Saleae's programs export them in binary, little endian.

    Logic 2, one channel a file   <SALEAE> | version 0 | type 0 | initial state | begin | end | n | n times in seconds
                                  <SALEAE> | version 1 | type 0 | chunks | (state | rate | begin | end | n | n times) ...
    Logic 1, on each change       (sample number of 64 bits | levels in a word of 8, 16, 32 or 64 bits) ...

Rules: a file must have as many times as it claims, or it is refused. Times before the trigger are all moved to begin at zero.
The files of a folder `digital_0.bin`, `digital_1.bin` ... are the channels of one capture, and begin at the same time. In a gap
between two chunks the line stays as it was. Logic 1 says no sample rate, so its times need the line speed (`--baud`). Its other
form, a word for each sample, has nothing to tell it by, and is taken for raw bytes.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.codec import Integers
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk, Event
from analyzer.sources.logic.heads import MAGIC, SAMPLE_LIMIT, word_size
from analyzer.sources.logic.traffic import records
from analyzer.sources.logic.waveform import Stretch, Waveform, changes, of_bit
from analyzer.sources.source import Source
from analyzer.sources.stream import BLOCK
from analyzer.values import SECOND_NS, counted

_HEAD = struct.Struct("<8sii")  # identifier, version, type
_CHUNK = (struct.Struct("<IddQ"), struct.Struct("<IdddQ"))  # state, (samples a second,) begin, end, transitions
_COUNT = struct.Struct("<Q")
_DIGITAL, _ANALOG = 0, 1
_VERSIONS = (0, 1)
#: Bytes of one time, and of those that are taken at once.
_TIME, _PIECE = 8, 1 << 20
#: Times of a capture in seconds, either way.
_LONGEST_S = 1e9


def _rows(data: bytes, width: int) -> NDArray[np.void]:
    return np.frombuffer(data, dtype=np.dtype([("number", "<u8"), ("word", f"<u{width}")]))


def read(source: Source) -> Iterator[Chunk | CanFrame | Event]:
    """Read the traffic. Raises UnreadableError for another type of export, and where the head is damaged."""
    if not source.head.startswith(MAGIC):
        return _read_changes(source)
    source.time_source = "capture: times of changes as a logic analyzer measured them"
    files = source.files
    wave = Waveform([path.stem.removeprefix("digital_") for path in files] if len(files) > 1 else ["0"], iter(()))
    wave.stretches = _stretches(source, wave) if len(files) == 1 else iter([_joined(source, wave)])
    return records(source, wave)


def _joined(source: Source, wave: Waveform) -> Stretch:
    """Return the channels of an export, which stand in files one after the other."""
    channels, end_ns, more = [], 0, True
    while more:
        stretches = list(_stretches(source, wave))
        channels.append(np.concatenate([each.edges[0] for each in stretches]))
        end_ns = max(end_ns, stretches[-1].end_ns)
        more = source.next_part()
    return Stretch(channels, end_ns)


def _version(source: Source) -> int:
    """Return the version of the file that is read. Raises UnreadableError for another type of export."""
    head = source.stream.exactly(_HEAD.size)
    if len(head) < _HEAD.size:
        raise UnreadableError(f"{source.stream.name}: the Saleae export breaks off at byte {len(head)}, in its head")
    magic, version, kind = _HEAD.unpack(head)
    if magic == MAGIC and kind == _ANALOG:
        raise UnreadableError(f"{source.stream.name} is an analog export of Saleae, without bits: export the digital channels")
    if magic != MAGIC or version not in _VERSIONS or kind != _DIGITAL:
        raise UnreadableError(
            f"{source.stream.name}: byte 8: expected version 0 or 1 and type 0 of a digital export, got {version} and {kind}: "
            "export as CSV"
        )
    return int(version)


def _exactly(source: Source, size: int, at: int, what: str) -> bytes:
    data = source.stream.exactly(size)
    if len(data) < size:
        raise UnreadableError(
            f"{source.stream.name}: the Saleae export breaks off at byte {at + len(data)}: "
            f"expected {counted(size, 'byte')} of {what}"
        )
    return data


def _stretches(source: Source, wave: Waveform) -> Iterator[Stretch]:
    """Yield the edges of one channel, a file."""
    version = _version(source)
    at = _HEAD.size
    count = 1
    if version:
        count = _COUNT.unpack(_exactly(source, _COUNT.size, at, "the number of chunks"))[0]
        at += _COUNT.size
        if count > 1:
            source.note(f"the capture has {count - 1} gaps, in which the line is taken to stay as it was")
    layout = _CHUNK[version]
    level = end = -1
    shift = None
    for number in range(count):
        state, *rate, begin, last, transitions = layout.unpack(_exactly(source, layout.size, at, f"chunk {number + 1}"))
        source.stream.budget.record()
        if state > 1 or not all(math.isfinite(t) and abs(t) < _LONGEST_S for t in (begin, last)) or last < begin:
            raise UnreadableError(
                f"{source.stream.name}: byte {at}: expected a state of 0 or 1 and times that rise, "
                f"got {state}, {begin:g} and {last:g}"
            )
        at += layout.size
        if rate and 0 < rate[0] < _LONGEST_S * 1000:
            wave.step_ns = SECOND_NS / rate[0]
        if shift is None:
            shift = max(0.0, -begin)
            wave.first.append(state)
            if shift:
                source.note(f"times before the trigger: all are moved by {shift:g} s")
        begin_ns, last_ns = (round((t + shift) * SECOND_NS) for t in (begin, last))
        if begin_ns < end:
            raise UnreadableError(f"{source.stream.name}: byte {at}: a chunk begins before the one before it ends")
        if level not in (-1, state):
            yield Stretch([np.array([begin_ns], dtype=np.int64)], begin_ns)
        end = begin_ns
        for taken in range(0, transitions, _PIECE // _TIME):
            size = min(_PIECE, (transitions - taken) * _TIME)
            times = np.frombuffer(_exactly(source, size, at, f"its {counted(transitions, 'transition')}"), dtype="<f8")
            with np.errstate(invalid="ignore", over="ignore"):
                edges: Integers = np.rint((times + shift) * SECOND_NS).astype(np.int64)
            wrong = np.flatnonzero(~(np.diff(edges, prepend=end) >= 0) | ~(np.abs(times) < _LONGEST_S))
            if len(wrong):
                place = at + _TIME * int(wrong[0])
                raise UnreadableError(
                    f"{source.stream.name}: byte {place}: expected a time behind the one before, got {times[wrong[0]]:g} s"
                )
            at += size
            end = int(edges[-1])
            yield Stretch([edges], end)
        end = max(end, last_ns)
        level = state ^ transitions & 1
        yield Stretch([np.array([], dtype=np.int64)], end)
    if source.stream.block():
        source.problem("bytes behind the last transition are left out", offset=at)


def _read_changes(source: Source) -> Iterator[Chunk | CanFrame | Event]:
    width = word_size(source.head)
    if not width:
        shown = source.head[:8].hex(" ").upper()
        raise UnreadableError(f"{source.name}: expected <SALEAE>, or rows of a sample number and a word, got {shown}")
    bits = int(np.bitwise_or.reduce(_rows(source.head[: (8 + width) * (len(source.head) // (8 + width))], width)["word"]))
    wave = Waveform([str(bit) for bit in range(max(1, bits.bit_length()))], iter(()), 1.0, rated=False)
    wave.stretches = _changes(source, wave, width)
    return records(source, wave)


def _changes(source: Source, wave: Waveform, width: int) -> Iterator[Stretch]:
    size, at, number = 8 + width, 0, -1
    before: int | None = None
    while data := source.stream.exactly(BLOCK // size * size):
        if len(data) % size:
            raise UnreadableError(
                f"{source.name}: the Saleae export breaks off at byte {at + len(data)}: expected {size} a row"
            )
        rows = _rows(data, width)
        numbers, words = rows["number"].astype(np.int64), np.ascontiguousarray(rows["word"])
        wrong = np.flatnonzero(np.diff(numbers, prepend=number) <= 0)
        if len(wrong) or numbers[-1] >= SAMPLE_LIMIT:
            place = at + size * int(wrong[0] if len(wrong) else len(numbers) - 1)
            raise UnreadableError(f"{source.name}: byte {place}: expected a sample number behind the one before")
        if before is None:
            before = int(words[0])
            wave.first[:] = [before >> bit & 1 for bit in range(len(wave.names))]
        places, changed = changes(words, before)
        yield Stretch([numbers[of_bit(places, changed, bit)] for bit in range(len(wave.names))], int(numbers[-1]))
        before, number = int(words[-1]), int(numbers[-1])
        at += len(data)
