"""Makes waveforms of UART bytes and CAN frames, and writes them as each logic analyzer does. Independent of the readers."""

from __future__ import annotations

import random
import struct
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

SECOND_NS = 1_000_000_000


@dataclass
class Wave:
    """One channel: the level before its first edge, and the times of its edges in ns as floats; `end_ns`: of all of it."""

    name: str = "D0"
    first: int = 1
    edges: list[float] = field(default_factory=list)
    end_ns: float = 0.0

    @property
    def level(self) -> int:
        return self.first ^ len(self.edges) & 1

    def hold(self, level: int, length_ns: float) -> None:
        """Be at a level for a time."""
        if level != self.level:
            self.edges.append(self.end_ns)
        self.end_ns += length_ns

    def inverted(self, name: str = "D0") -> Wave:
        return Wave(name, self.first ^ 1, list(self.edges), self.end_ns)

    def disturbed(self, jitter_ns: float = 0.0, glitches: int = 0, glitch_ns: float = 0.0, seed: int = 1) -> Wave:
        """Return the wave with edges moved by up to so much, and so many short pulses where it is at rest."""
        chance = random.Random(seed)
        edges = [t + chance.uniform(-jitter_ns, jitter_ns) for t in self.edges]
        for _ in range(glitches):
            at = chance.uniform(0, self.end_ns - glitch_ns)
            # Apart from other edges, where it would be one of them.
            if all(abs(t - at) > 2 * glitch_ns + jitter_ns for t in edges):
                edges += [at, at + glitch_ns]
        return Wave(self.name, self.first, sorted(edges), self.end_ns)


def uart(
    messages: Iterable[tuple[float, bytes]],
    baud: float,
    form: str = "8N1",
    *,
    name: str = "D0",
    wrong_stops: Sequence[int] = (),
    tail_ns: float | None = None,
) -> tuple[Wave, list[tuple[int, int]]]:
    """Return the wave of messages (start in ns, bytes), and (end of its stop bit in ns, value) of each byte.

    `wrong_stops`: numbers of bytes whose stop bit is low; the line is idle for two bits behind those.
    """
    bit = SECOND_NS / baud
    size, parity, stops = int(form[0]), form[1], int(form[2])
    wave, sent = Wave(name), []
    for start, data in messages:
        assert start >= wave.end_ns
        wave.hold(1, start - wave.end_ns)
        for value in data:
            ones = (value & (1 << size) - 1).bit_count() & 1
            bits = [0, *(value >> n & 1 for n in range(size))]
            bits += {"N": [], "E": [ones], "O": [1 - ones]}[parity]
            wrong = len(sent) in wrong_stops
            bits += [0 if wrong else 1] + [1] * (stops - 1 + 2 * wrong)
            ended = wave.end_ns + (2 + size + (parity != "N")) * bit
            for level in bits:
                wave.hold(level, bit)
            sent.append((round(ended), value))
    wave.hold(1, 20 * bit if tail_ns is None else tail_ns)
    return wave, sent


def crc15(bits: Sequence[int]) -> int:
    """Return the CRC of CAN bit by bit, as ISO 11898-1 writes it."""
    value = 0
    for bit in bits:
        invert = bit ^ value >> 14 & 1
        value = value << 1 & 0x7FFF
        if invert:
            value ^= 0x4599
    return value


def can_bits(number: int, data: bytes, *, extended: bool = False, remote: bool = False, acknowledged: bool = True) -> list[int]:
    """Return the bits of a frame on the wire, from SOF to the end of EOF, stuffed."""
    bits = [0]
    if extended:
        bits += [number >> n & 1 for n in range(28, 17, -1)] + [1, 1]
        bits += [number >> n & 1 for n in range(17, -1, -1)] + [int(remote), 0, 0]
    else:
        bits += [number >> n & 1 for n in range(10, -1, -1)] + [int(remote), 0, 0]
    bits += [len(data) >> n & 1 for n in range(3, -1, -1)]
    if not remote:
        bits += [byte >> n & 1 for byte in data for n in range(7, -1, -1)]
    bits += [crc15(bits) >> n & 1 for n in range(14, -1, -1)]
    stuffed: list[int] = []
    for bit in bits:
        stuffed.append(bit)
        if len(stuffed) >= 5 and len(set(stuffed[-5:])) == 1:
            stuffed.append(1 - bit)
            # The stuff bit counts for the next five.
    return [*stuffed, 1, 0 if acknowledged else 1, 1] + [1] * 7


def can(
    frames: Iterable[tuple[float, list[int]]], bitrate: float, *, name: str = "D0", tail_ns: float | None = None
) -> tuple[Wave, list[int]]:
    """Return the wave of frames (earliest start in ns, bits), low for dominant, and the end of each in ns."""
    bit = SECOND_NS / bitrate
    wave, ends = Wave(name), []
    for start, bits in frames:
        wave.hold(1, max(start - wave.end_ns, 3 * bit))
        for level in bits:
            wave.hold(level, bit)
        ends.append(round(wave.end_ns))
    wave.hold(1, 30 * bit if tail_ns is None else tail_ns)
    return wave, ends


# --- formats ------------------------------------------------------------------------------------------------------------


def samples(waves: Sequence[Wave], rate: float) -> np.ndarray:
    """Return the samples of channels, a byte or word each, the first channel in the lowest bit."""
    count = int(max(wave.end_ns for wave in waves) * rate / SECOND_NS) + 1
    kind = next(t for t in (np.uint8, np.uint16, np.uint32) if len(waves) <= 8 * np.dtype(t).itemsize)
    words = np.zeros(count, dtype=kind)
    for bit, wave in enumerate(waves):
        changes = np.zeros(count + 1, dtype=np.int8)
        at = np.minimum(np.ceil(np.array(wave.edges) * rate / SECOND_NS).astype(np.int64), count)
        np.add.at(changes, at, 1)
        levels = (np.cumsum(changes[:-1]) + wave.first) & 1
        words |= levels.astype(kind) << kind(bit)
    return words


def edges_of(words: np.ndarray) -> list[tuple[int, int]]:
    """Return (sample, word) of the first sample and of each change."""
    places = np.flatnonzero(np.diff(words)) + 1
    return [(0, int(words[0]))] + [(int(at), int(words[at])) for at in places]


def write_sr(path: Path, waves: Sequence[Wave], rate: int, *, piece: int = 4 << 20, extra: str = "") -> Path:
    """A session as PulseView writes it."""
    words = samples(waves, rate)
    data = words.astype(words.dtype.newbyteorder("<")).tobytes()
    probes = "".join(f"probe{n}={wave.name}\n" for n, wave in enumerate(waves, 1))
    metadata = (
        f"[global]\nsigrok version=0.5.2\n\n[device 1]\ncapturefile=logic-1\ntotal probes={len(waves)}\n"
        f"samplerate={rate / 1000:g} kHz\ntotal analog=0\n{probes}unitsize={words.itemsize}\n{extra}"
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("version", "2")
        archive.writestr("metadata", metadata)
        for number, at in enumerate(range(0, len(data), piece), 1):
            archive.writestr(f"logic-1-{number}", data[at : at + piece])
    return path


def write_vcd(path: Path, waves: Sequence[Wave], rate: int, scale: str = "1 ns") -> Path:
    """A dump as sigrok-cli and PulseView write it."""
    words = samples(waves, rate)
    number, unit = scale.split()
    steps = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9, "ps": 10**12}[unit] // int(number)
    codes = [chr(33 + n) for n in range(len(waves))]
    text = f"$date Mon $end\n$version made $end\n$comment\n  Acquisition\n$end\n$timescale {scale} $end\n$scope module m $end\n"
    text += "".join(f"$var wire 1 {code} {wave.name} $end\n" for code, wave in zip(codes, waves, strict=True))
    text += "$upscope $end\n$enddefinitions $end\n"
    before = None
    for at, word in edges_of(words):
        changed = [(n, word >> n & 1) for n in range(len(waves)) if before is None or (word ^ before) >> n & 1]
        text += f"#{at * steps // rate} " + " ".join(f"{level}{codes[n]}" for n, level in changed) + "\n"
        before = word
    path.write_text(text + f"#{len(words) * steps // rate}\n")
    return path


def write_saleae_csv(path: Path, waves: Sequence[Wave], rate: int, trigger: int = 0) -> Path:
    """What Logic 2 exports; `trigger`: the sample of time 0."""
    words = samples(waves, rate)
    rows = [*edges_of(words), (len(words) - 1, int(words[-1]))]
    head = ",".join(["Time [s]", *(wave.name for wave in waves)])
    lines = [f"{(at - trigger) / rate:.9f}," + ",".join(str(word >> n & 1) for n in range(len(waves))) for at, word in rows]
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


def write_logic1_csv(path: Path, waves: Sequence[Wave], rate: int) -> Path:
    """What Logic 1 exports with sample numbers, below a line on the rate."""
    rows = edges_of(samples(waves, rate))
    lines = [f"; sample rate: {rate} Hz", ", ".join(["Sample", *(wave.name for wave in waves)])]
    lines += [f"{at}, " + ", ".join(str(word >> n & 1) for n in range(len(waves))) for at, word in rows]
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def write_saleae_binary(path: Path, wave: Wave, rate: int, version: int = 0) -> Path:
    """What Logic 2 exports of one channel."""
    words = samples([wave], rate)
    times = [at / rate for at, _ in edges_of(words)[1:]]
    chunk = struct.pack("<I", int(words[0])) + (struct.pack("<d", rate) if version else b"")
    chunk += struct.pack("<ddQ", 0.0, len(words) / rate, len(times)) + struct.pack(f"<{len(times)}d", *times)
    head = struct.pack("<8sii", b"<SALEAE>", version, 0) + (struct.pack("<Q", 1) if version else b"")
    path.write_bytes(head + chunk)
    return path


def write_logic1_binary(path: Path, waves: Sequence[Wave], rate: int, width: int = 1) -> Path:
    """What Logic 1 exports on each change."""
    letter = {1: "B", 2: "H", 4: "I", 8: "Q"}[width]
    path.write_bytes(b"".join(struct.pack(f"<Q{letter}", at, word) for at, word in edges_of(samples(waves, rate))))
    return path
