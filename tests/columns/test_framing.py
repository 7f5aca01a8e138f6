"""Arrays find the frames that the framer finds: cut anywhere, clean or damaged."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from analyzer import dialects
from analyzer.catalogue import Form, Role
from analyzer.columns import framing
from analyzer.columns.framing import Framing, Row
from analyzer.columns.gaps import GapReader
from analyzer.context import Context
from analyzer.framer import Framer
from analyzer.layout import Layout, u8
from analyzer.protocols.modbus_slave import slave
from analyzer.records import Chunk, JunkReason
from benchmarks.framing_noise import SentFrame, damage, traffic
from tests.columns.both_ways import standing
from tests.columns.serial_traffic import byte_blocks, chunks_of

SERIAL = ("mks-rs485", "lk-rs485", "mks-modbus")


def one_by_one(chunks, framer):
    """Return what a framer finds, with how many chunks it took, and where it stands."""
    events = [(event, number) for number, chunk in enumerate(chunks, 1) for event in framer.feed(chunk)]
    state = framer.state()
    return events + [(event, len(chunks)) for event in framer.close()], standing(state)


def by_arrays(chunks, framer, most):
    """Return the same by blocks, and how many frames stood in rows."""
    events, in_rows, before = [], 0, 0
    found = Framing(framer)
    for block in byte_blocks(chunks, most):
        for event in found.feed(block):
            if isinstance(event, Row):
                frames = list(event.frames.frames(framer.dialects[0], event.start, event.stop))
                events += zip(frames, (event.decided + before).tolist(), strict=True)
                in_rows += len(frames)
            else:
                events.append((event, before + block.taken))
        before += len(block)
    state = framer.state()
    return events + [(event, len(chunks)) for event in framer.close()], standing(state), in_rows


def check(dialect, chunks, most, byte_ns):
    expected, stands = one_by_one(chunks, Framer("line", [dialect], Context(), byte_ns=byte_ns))
    got, stands_too, in_rows = by_arrays(chunks, Framer("line", [dialect], Context(), byte_ns=byte_ns), most)
    for one, other in zip(got, expected, strict=False):
        assert one == other
    assert got == expected
    assert stands_too == stands
    return in_rows


@pytest.mark.parametrize("share", [0, 0.001, 0.01, 0.05])
@pytest.mark.parametrize("name", SERIAL)
@pytest.mark.parametrize("seed", range(8))
def test_the_same_frames(name, seed, share, monkeypatch):
    monkeypatch.setattr(framing, "SHORTEST_ROW", 1)
    chance = random.Random(f"{name} {seed} {share}")
    line, placed = damage(traffic([name], 600, chance), share, chance)
    chunks = list(chunks_of(line, chance, [p.stop for p in placed], longest=chance.choice((3, 40, 5000, 50_000))))
    in_rows = check(dialects.get(name), chunks, chance.choice((1, 3, 50, 10_000)), chance.choice((0, 86_806)))
    assert in_rows or share or len(chunks) > 50


@pytest.mark.parametrize("name", SERIAL)
def test_gaps_between_rows_need_no_framer(name, monkeypatch):
    chance, told = random.Random(name), []
    pieces = GapReader.pieces

    def kept(self, gap):
        told.append(pieces(self, gap))
        return told[-1]

    monkeypatch.setattr(GapReader, "pieces", kept)
    line = damage(traffic([name], 6000, chance), 0.001, chance)[0]
    chunks = [Chunk(at * 1000, "line", line[at : at + 30_000]) for at in range(0, len(line), 30_000)]
    check(dialects.get(name), chunks, 2, 1000)
    reasons = {piece.reason for found in told if found is not None for piece in found}
    # Modbus has no rare heads, so that no piece is the beginning of a frame that was cut off.
    assert reasons >= {None, JunkReason.NOISE}
    assert len(told) > 0.6 * len(line) * 0.001
    assert sum(found is not None for found in told) > 0.9 * len(told)


def layout(size):
    return Layout(*(u8(f"byte_{number}") for number in range(size)))


#: A code whose frames have several lengths, two of them one apart.
SIZES = {Role.REQUEST: (0, 1), Role.REPLY: (3, 4, 9)}
CODE = 0x31
_SPEED = next(command for command in dialects.get("mks-rs485").commands if command.code == CODE)
_FORMS = {role: tuple(Form(layout(size)) for size in sizes) for role, sizes in SIZES.items()}
TWO_LENGTHS = replace(
    dialects.get("mks-rs485"), commands=(replace(_SPEED, request=_FORMS[Role.REQUEST], reply=_FORMS[Role.REPLY], vectors=()),)
)
#: Slaves at two of the addresses that are on the line.
UNITS = slave("units", "Slaves at two addresses", "", units=(1, 3))


def of_several_lengths(count, chance):
    """Return frames of the code whose frames have several lengths."""
    found = []
    for _ in range(count):
        role = chance.choice(list(SIZES))
        head = next(byte for byte, own in TWO_LENGTHS.link.heads.items() if own is role)
        body = bytes((head, 1, CODE, *(chance.choice((0, 1, 2)) for _ in range(chance.choice(SIZES[role])))))
        found.append(SentFrame(TWO_LENGTHS.link.completed(body), role, TWO_LENGTHS))
    return found


@pytest.mark.parametrize("share", [0, 0.01])
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    ("dialect", "frames"),
    [(TWO_LENGTHS, of_several_lengths), (UNITS, partial(traffic, ["mks-modbus"]))],
    ids=["several lengths", "two of the slaves"],
)
def test_other_dialects(dialect, frames, share, seed, monkeypatch):
    monkeypatch.setattr(framing, "SHORTEST_ROW", 1)
    chance = random.Random(f"{dialect.name} {seed} {share}")
    line, placed = damage(frames(600, chance), share, chance)
    chunks = list(chunks_of(line, chance, [p.stop for p in placed], longest=chance.choice((40, 5000, 50_000))))
    check(dialect, chunks, chance.choice((3, 50, 10_000)), 86_806)


def like_frames(dialect, heads, chance):
    """Return bytes of which many look like the beginning of a frame, and many like the end."""
    # Small numbers are functions, counts and lengths.
    line = bytearray(chance.choice((0, 1, 3, 4, 16, CODE, chance.randrange(256), *heads[:3])) for _ in range(60_000))
    for at in range(0, len(line) - 300, 12):
        line[at] = chance.choice(heads[:4])
        # Of some links, the head has a check of its own.
        for size in (4, chance.choice((3, 4, 5, 6, 7, 38, 60))):
            checked = dialect.link.completed(bytes(line[at : at + size]))
            line[at : at + len(checked)] = checked
    return bytes(line)


@pytest.mark.parametrize("dialect", [*map(dialects.get, SERIAL), TWO_LENGTHS, UNITS], ids=[*SERIAL, "several lengths", "units"])
@pytest.mark.parametrize("seed", range(6))
def test_where_a_frame_begins_is_found_or_unsure(dialect, seed):
    chance = random.Random(f"{dialect.name} {seed}")
    slicer = dialect.link.slicer(dialect.commands, lambda address, function: 0)
    if seed % 2:
        line = like_frames(dialect, slicer.heads, chance)
    else:
        frames = (
            of_several_lengths(2000, chance)
            if dialect is TWO_LENGTHS
            else traffic(["mks-modbus" if dialect is UNITS else dialect.name], 2000, chance)
        )
        line = damage(frames, 0.01, chance)[0]
    found = slicer.scan(np.frombuffer(line, dtype=np.uint8))
    told, unsure = dict(zip(found.starts.tolist(), found.sizes.tolist(), strict=True)), set(found.unsure.tolist())
    looked = {at: slicer.look(line, at, len(line), True) if line[at] in slicer.heads else 0 for at in range(len(line))}
    assert {at: size for at, size in told.items() if looked[at] != size} == {}
    known = {*told, *unsure, *range(len(line) - slicer.longest, len(line))}
    assert {at: size for at, size in looked.items() if size and at not in known} == {}
    assert len(told) > 50
    # Few places are unsure, or all damage would have to be weighed.
    assert len(unsure) < len(line) / (5 if seed % 2 or dialect is TWO_LENGTHS else 100)
