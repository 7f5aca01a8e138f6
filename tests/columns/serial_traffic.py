"""Bytes of serial lines, plain and damaged, cut into chunks with all that a capture can say of one."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.columns.block import DIRECTIONS, ByteBlock
from analyzer.framer import SILENCE_NS
from analyzer.records import Chunk
from benchmarks.framing_noise import SentFrame
from tests.columns.can_traffic import data_of

#: What is asked of drives again and again.
POLLS = {
    "mks-rs485": ("read_encoder_carry", "read_speed", "read_pulses", "read_position", "read_angle_error", "read_io"),
    "lk-rs485": ("read_state_1", "read_state_2", "read_state_3", "read_encoder", "read_position"),
    "mks-modbus": ("read_encoder_carry", "read_speed", "read_pulses", "read_position", "read_angle_error", "read_io"),
}

#: Pauses before a chunk, in nanoseconds, most of them none beyond the time of its bytes.
_PAUSES = (0, 0, 0, 0, 300_000, 2_000_000, SILENCE_NS // 2, 2 * SILENCE_NS)


def polls(name: str, chance: random.Random, count: int) -> list[SentFrame]:
    """Return exchanges that read, each with its reply."""
    dialect = dialects.get(name)
    reads = [command for command in dialect.commands if command.name in POLLS[name]]
    frames: list[SentFrame] = []
    while len(frames) < count:
        command, address = chance.choice(reads), chance.choice((1, 2, 3))
        for form, role in ((command.request_forms[0], Role.REQUEST), (chance.choice(command.reply_forms), Role.REPLY)):
            data = data_of(form.layout, chance)
            frames.append(SentFrame(dialect.link.build(command, form, address, data, role), role, dialect))
    return frames


def chunks_of(
    line: bytes,
    chance: random.Random,
    ends: Sequence[int] = (),
    *,
    longest: int = 4096,
    byte_ns: int = 86_806,
    steady: bool = False,
) -> Iterator[Chunk]:
    """Yield a line in chunks. `ends`: where its frames end: some captures cut there, and only they know who sent."""
    t_ns, at, direction = 1_772_442_000_000_000_000, 0, Role.UNKNOWN
    by_frames = bool(ends) and chance.random() < 0.5
    marked, bursting = not steady and chance.random() < 0.3, chance.random() < 0.5
    quiet = steady or chance.random() < 0.5
    stops = [*ends, len(line)] if by_frames else []
    while at < len(line):
        stop = next(s for s in stops if s > at) if by_frames and chance.random() < 0.98 else at + chance.randint(1, longest)
        data = line[at:stop]
        at = stop
        t_ns += len(data) * byte_ns + (0 if quiet else chance.choice(_PAUSES))
        if not steady and chance.random() < 0.002:
            t_ns -= chance.choice((1_000, 40_000_000, 3_000_000_000))
        if marked and chance.random() < 0.05:
            direction = chance.choice(DIRECTIONS)
        yield Chunk(t_ns, "line", data, direction, bursting and chance.random() < 0.9)


def byte_blocks(chunks: Sequence[Chunk], most: int) -> Iterator[ByteBlock]:
    """Yield chunks as a reader of blocks does."""
    held: list[Chunk] = []
    for chunk in chunks:
        if held and (len(held) == most or (chunk.t_ns or 0) < (held[-1].t_ns or 0)):
            yield ByteBlock.of(held)
            held = []
        held.append(chunk)
    if held:
        yield ByteBlock.of(held)
