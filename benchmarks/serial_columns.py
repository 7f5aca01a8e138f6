"""Serial lines by columns: framing compared with the framer that goes byte by byte and with pymodbus; whole decodes.

    python benchmarks/serial_columns.py [--frames 400000] [--rounds 3]

Framing: exchanges of all commands of a dialect (`framing_noise.traffic`), repeated, as raw bytes in reads of 64 KiB. Damage is
that of `framing_noise.py`: 0.1 % of the bytes are flipped, dropped or have one inserted before them. What is found are frames
with their places, times and junk. pymodbus gets each frame cut out, requests and replies apart: it has to search nothing.

Whole decodes: polls with values that the manual allows, as raw bytes, clean and damaged in the same way. They go from bytes to
the messages of a log, by blocks and by chunks in the same process.

All figures are CPU seconds of one process, the least of some rounds, which take turns.
"""

from __future__ import annotations

import argparse
import io
import logging
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.columns import memory
from analyzer.columns.block import ByteBlock
from analyzer.columns.framing import Framing, Row
from analyzer.context import Context
from analyzer.framer import Framer
from analyzer.pipeline import Item, Pipeline
from analyzer.port import Options
from analyzer.records import Chunk, Frame
from analyzer.sinks.mcap_log import McapLog
from analyzer.sources.source import JOINED
from analyzer.sources.stream import BLOCK
from benchmarks.framing_noise import BYTE_NS, SentFrame, damage, traffic
from tests.columns.serial_traffic import POLLS, polls

#: Frames that are made; they are repeated up to the number that is asked for.
MADE = 50_000
DAMAGES = (0.0, 0.001)


def chunks_of(line: bytes) -> list[Chunk]:
    """Return a line as a reader of raw bytes gives it."""
    return [Chunk(min(at + BLOCK, len(line)) * BYTE_NS, "line", line[at : at + BLOCK]) for at in range(0, len(line), BLOCK)]


def blocks_of(chunks: Sequence[Chunk]) -> list[ByteBlock]:
    """Return chunks in blocks as `servotap decode` joins them."""
    count = JOINED // BLOCK
    return [ByteBlock.of(chunks[at : at + count]) for at in range(0, len(chunks), count)]


def by_framer(name: str, chunks: Sequence[Chunk]) -> int:
    """Return how many frames the framer finds."""
    framer = Framer("line", [dialects.get(name)], Context(), byte_ns=BYTE_NS)
    return sum(isinstance(event, Frame) for chunk in chunks for event in framer.feed(chunk))


def by_columns(name: str, blocks: Sequence[ByteBlock]) -> int:
    """Return how many frames are found by blocks."""
    framing = Framing(Framer("line", [dialects.get(name)], Context(), byte_ns=BYTE_NS))
    found = 0
    for block in blocks:
        for event in framing.feed(block):
            found += event.stop - event.start if isinstance(event, Row) else isinstance(event, Frame)
    return found


def by_pymodbus(frames: Sequence[SentFrame]) -> int:
    """Return how many frames pymodbus takes, each cut out."""
    from pymodbus.framer import FramerRTU
    from pymodbus.pdu import DecodePDU

    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    framers = {Role.REQUEST: FramerRTU(DecodePDU(True)), Role.REPLY: FramerRTU(DecodePDU(False))}
    return sum(bool(framers[frame.role].decode(frame.data)[0]) for frame in frames)


def decoded(name: str, items: Sequence[Item]) -> int:
    """Return how many messages the log of a line has."""
    log = McapLog(io.BytesIO())
    options = Options(byte_ns=BYTE_NS, synthetic_byte_ns=BYTE_NS, timed=False)
    Pipeline([dialects.get(name)], [log], options).run(items)
    log.finish({})
    return log.messages


def by_blocks(name: str, chunks: Sequence[Chunk]) -> int:
    """Return the same, decoded by blocks."""
    return decoded(name, blocks_of(chunks))


def least(rounds: int, *works: Callable[[], int]) -> list[tuple[float, int]]:
    """Return the least CPU seconds of each work, and what it returned."""
    seconds, results = [1e9] * len(works), [0] * len(works)
    for _ in range(rounds):
        for number, work in enumerate(works):
            started = time.process_time()
            results[number] = work()
            seconds[number] = min(seconds[number], time.process_time() - started)
    return list(zip(seconds, results, strict=True))


def framing_rows(frames: int, rounds: int) -> None:
    """Print the figures of framing."""
    print("| framing | damage | MB/s | million frames/s | by framer | found by both |\n| --- | --- | --- | --- | --- | --- |")
    for name in POLLS:
        for share in DAMAGES:
            chance = Random(f"{name} {share}")
            line = damage(traffic([name], min(MADE, frames), chance), share, chance)[0] * max(1, frames // MADE)
            chunks = chunks_of(line)
            blocks = blocks_of(chunks)
            (ours, found), (theirs, wanted) = least(rounds, partial(by_columns, name, blocks), partial(by_framer, name, chunks))
            same = "yes" if found == wanted else f"NO: {found} and {wanted}"
            speeds = f"{len(line) / ours / 1e6:.0f} | {found / ours / 1e6:.2f} | {theirs / ours:.1f} x"
            print(f"| {name} | {share:.1%} | {speeds} | {same} |")
    made = traffic(["mks-modbus"], min(MADE, frames), Random(1))
    line = b"".join(frame.data for frame in made)
    blocks = blocks_of(chunks_of(line * 4))
    works = partial(by_columns, "mks-modbus", blocks), partial(by_pymodbus, made)
    (ours, found), (theirs, taken) = least(rounds, *works)
    each, other = ours / found, theirs / len(made)
    print(f"\nmks-modbus against pymodbus on frames cut out ({taken} of {len(made)} taken): {other / each:.1f} x")


def decode_rows(frames: int, rounds: int) -> None:
    """Print the figures of whole decodes."""
    print("\n| decode | damage | by columns, s | by chunks, s | times | messages |\n| --- | --- | --- | --- | --- | --- |")
    for name in POLLS:
        for share in DAMAGES:
            chance = Random(1)
            made = damage(list(polls(name, chance, min(MADE, frames))), share, chance)[0] * max(1, frames // MADE)
            chunks = [Chunk(None, "line", chunk.data) for chunk in chunks_of(made)]
            works = partial(by_blocks, name, chunks), partial(decoded, name, chunks)
            (ours, found), (theirs, wanted) = least(rounds, *works)
            same = f"{found}" if found == wanted else f"NO: {found} and {wanted}"
            print(f"| {name} | {share:.1%} | {ours:.2f} | {theirs:.2f} | {theirs / ours:.1f} x | {same} |")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=400_000)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    # As `servotap decode` does.
    memory.keep()
    framing_rows(arguments.frames, arguments.rounds)
    decode_rows(arguments.frames, arguments.rounds)


if __name__ == "__main__":
    main()
