"""What goes through columns comes out the same as frame by frame."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from msgspec.structs import replace

from analyzer import dialects
from analyzer.sinks.mcap_log import McapLog
from tests.columns.both_ways import blocks, outcome, same, same_capture, short_runs
from tests.columns.can_traffic import frames, interleaved
from tests.fuzz.mutators import mutated
from tests.toy.dialect import DIALECT as TOY

MKS = dialects.get("mks-can")
CAPTURES = Path(__file__).parents[2] / "captures"


@pytest.fixture(name="short_runs")
def with_short_runs():
    with short_runs():
        yield


@pytest.mark.parametrize(("busy", "odd"), [(0, 0), (0.01, 0), (0, 0.02), (0.05, 0.05), (0.5, 0.5)])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("dialect", [MKS, TOY], ids=lambda dialect: dialect.name)
def test_exchanges(dialect, seed, busy, odd, short_runs):
    most = random.Random(seed).choice((7, 100, 250, 1000))
    pipeline = same(list(frames(dialect, random.Random(seed), 600, busy, odd)), dialect, most)
    assert pipeline.in_runs or most < 10 or busy + odd > 0.05


def test_odd_frames_leave_one_by_one():
    # A reply that is lost, an echo and a frame of another node stop their own exchange and nothing else.
    polls = list(frames(MKS, random.Random(3), 2000, 0, 0, polls=("read_speed", "read_position", "read_pulses")))
    odd = [*polls[:801], *polls[802:1200], polls[1200], *polls[1200:]]
    pipeline = same(odd, MKS, 1000)
    assert pipeline.in_runs > 0.9 * len(odd)


@pytest.mark.parametrize(("odd", "share"), [(0, 0.3), (0, 0.9), (0.05, 0.5)])
@pytest.mark.parametrize("dialect", [MKS, TOY], ids=lambda dialect: dialect.name)
def test_exchanges_of_several_drives_interleave(dialect, odd, share, short_runs):
    chance = random.Random(4)
    rows = interleaved(dialect, list(frames(dialect, chance, 1000, 0.02, odd)), chance, share)
    pipeline = same(rows, dialect, 300)
    # On a bus where nothing is wrong, they need not go one by one.
    assert pipeline.in_runs > (0.25 if odd else 0.8) * len(rows)


@pytest.mark.parametrize("every", [3, 97])
def test_what_stands_near_a_late_reply(every, short_runs):
    late, after_ns = [], 0
    for number, frame in enumerate(frames(MKS, random.Random(8), 1500, 0, 0, polls=("read_speed", "read_position"))):
        after_ns += 200_000_000 * (number % 2 and number // 2 % every == 0)
        late.append(replace(frame, t_ns=frame.t_ns + after_ns))
    assert same(late, MKS, 300).in_runs > 1400


def test_frames_of_other_nodes_within_exchanges(short_runs):
    polls = list(frames(MKS, random.Random(6), 2000, 0, 0, polls=("read_speed", "read_position", "read_pulses")))
    rows = [each for n, frame in enumerate(polls) for each in (frame, *[replace(frame, id=0x701, data=b"\5")] * (n % 97 == 0))]
    pipeline = same(rows, MKS, 1000)
    assert pipeline.in_runs > 0.9 * len(polls)


CAN_CAPTURES = [p for p in sorted(CAPTURES.glob("mks_can.*")) if p.suffix not in (".golden", ".mf4")]


@pytest.mark.parametrize("path", CAN_CAPTURES, ids=lambda path: path.name)
def test_captures(path, short_runs):
    same_capture(path, MKS)


@pytest.mark.parametrize("name", ["mks_can.blf", "mks_can.candump.log", "mks_can.socketcan.pcap", "mks_can.socketcan.pcapng"])
def test_damaged_captures(name, short_runs, tmp_path):
    data, path = (CAPTURES / name).read_bytes(), tmp_path / name
    in_runs = 0
    for seed in range(20):
        path.write_bytes(mutated(random.Random(seed), data))
        in_runs += same_capture(path, MKS)
    assert in_runs


def set_back(items, by_ns):
    """Return items whose clock is set back in the middle."""
    half = len(items) // 2
    return [*items[:half], *(replace(item, t_ns=item.t_ns - by_ns) for item in items[half:])]


@pytest.mark.parametrize("by_s", [0.5, 1.2, 3600])
@pytest.mark.parametrize("odd", [0, 0.02])
def test_behind_a_clock_that_is_set_back(by_s, odd, short_runs):
    """By 1.2 s the times come back to where they were; by 3600 s each message says how far."""
    rows = set_back(list(frames(MKS, random.Random(8), 3000, 0, odd)), int(by_s * 1e9))
    pipeline = same(rows, MKS, 400)
    assert pipeline.in_runs > (0.4 if odd else 0.9) * len(rows)


def test_a_clock_that_is_set_back_costs_no_frame_its_columns(monkeypatch):
    singly = []
    entry = McapLog.entry

    def counted(self, each):
        singly.append(each)
        entry(self, each)

    monkeypatch.setattr(McapLog, "entry", counted)
    polls = list(frames(MKS, random.Random(9), 3000, 0, 0, polls=("read_speed", "read_position", "read_pulses")))
    counts = []
    for rows in (polls, set_back(polls, 3600 * 10**9)):
        singly.clear()
        outcome(list(blocks(rows, 1000)), MKS)
        counts.append(len(singly))
    # Those that open a block alone.
    assert counts[1] - counts[0] < 10
