"""Captures of serial lines come out the same by blocks of bytes as chunk by chunk."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from msgspec.structs import replace

from analyzer import dialects
from analyzer.columns import framing
from analyzer.records import Chunk
from benchmarks.framing_noise import damage, traffic
from tests.columns.both_ways import same_capture, same_line, short_runs
from tests.columns.serial_traffic import chunks_of, polls

SERIAL = ("mks-rs485", "lk-rs485", "mks-modbus")
CAPTURES = Path(__file__).parents[2] / "captures"


@pytest.fixture(name="short_runs")
def with_short_runs():
    with short_runs():
        yield


@pytest.mark.parametrize("share", [0, 0.001, 0.05])
@pytest.mark.parametrize("name", SERIAL)
@pytest.mark.parametrize("seed", range(3))
def test_exchanges(name, seed, share, short_runs):
    chance = random.Random(f"{name} {seed} {share}")
    frames = polls(name, chance, 150) + traffic([name], 150, chance) + polls(name, chance, 150)
    line, placed = damage(frames, share, chance)
    chunks = list(chunks_of(line, chance, [p.stop for p in placed], longest=chance.choice((3, 40, 5000)), steady=not seed))
    in_runs = same_line(chunks, dialects.get(name), chance.choice((5, 50, 10_000)) if seed else 10_000, timed=seed != 1)
    assert in_runs > 100 or seed or share


@pytest.mark.parametrize("by_s", [0.5, 1.2, 3600])
def test_behind_a_clock_that_is_set_back(by_s, short_runs):
    chance = random.Random(by_s)
    frames = polls("mks-rs485", chance, 900)
    line, placed = damage(frames, 0.001, chance)
    chunks = list(chunks_of(line, chance, [p.stop for p in placed], longest=40, steady=True))
    half = len(chunks) // 2
    chunks = [replace(chunk, t_ns=chunk.t_ns - int(by_s * 1e9) * (n >= half)) for n, chunk in enumerate(chunks)]
    assert same_line(chunks, dialects.get("mks-rs485"), 100) > 200


@pytest.mark.parametrize(("count", "together"), [(framing.SHORTEST_TOGETHER - 20, False), (1200, True)])
def test_short_rows_go_one_by_one(count, together):
    line = b"".join(frame.data for frame in polls("mks-rs485", random.Random(2), count))
    assert bool(same_line([Chunk(9_000_000_000, "line", line)], dialects.get("mks-rs485"), 1)) is together


@pytest.mark.parametrize("name", SERIAL)
def test_damage_costs_the_frames_near_it_alone(name):
    chance = random.Random(name)
    frames = polls(name, chance, 4000)
    line, _ = damage(frames, 0.001, chance)
    assert same_line([Chunk(9_000_000_000, "line", line)], dialects.get(name), 1) > 0.7 * len(frames)


SERIAL_CAPTURES = [
    (path, dialect)
    for dialect in SERIAL
    for path in sorted(CAPTURES.glob(dialect.replace("-", "_") + ".*"))
    if path.suffix not in (".golden", ".mf4")
]


@pytest.mark.parametrize(("path", "dialect"), SERIAL_CAPTURES, ids=lambda each: getattr(each, "name", each))
def test_captures(path, dialect, short_runs):
    same_capture(path, dialects.get(dialect))
