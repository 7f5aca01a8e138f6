"""Arrays find the frames that the framer finds: cut anywhere, clean or damaged."""

from __future__ import annotations

import random

import pytest

from analyzer import dialects
from analyzer.columns import framing
from analyzer.columns.framing import Framing, Row
from analyzer.context import Context
from analyzer.framer import Framer
from benchmarks.framing_noise import damage, traffic
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


def check(name, chunks, most, byte_ns):
    dialect = dialects.get(name)
    expected, stands = one_by_one(chunks, Framer("line", [dialect], Context(), byte_ns=byte_ns))
    got, stands_too, in_rows = by_arrays(chunks, Framer("line", [dialect], Context(), byte_ns=byte_ns), most)
    for one, other in zip(got, expected, strict=False):
        assert one == other
    assert got == expected
    assert stands_too == stands
    return in_rows


@pytest.mark.parametrize("share", [0, 0.001, 0.05])
@pytest.mark.parametrize("name", SERIAL)
@pytest.mark.parametrize("seed", range(8))
def test_the_same_frames(name, seed, share, monkeypatch):
    monkeypatch.setattr(framing, "SHORTEST_ROW", 1)
    chance = random.Random(f"{name} {seed} {share}")
    line, placed = damage(traffic([name], 600, chance), share, chance)
    chunks = list(chunks_of(line, chance, [p.stop for p in placed], longest=chance.choice((3, 40, 5000))))
    in_rows = check(name, chunks, chance.choice((1, 3, 50, 10_000)), chance.choice((0, 86_806)))
    assert in_rows or share or len(chunks) > 50
