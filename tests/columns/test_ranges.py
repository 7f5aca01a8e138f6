"""A capture that several processes read in ranges gives what one process gives frame by frame, wherever ranges end."""

from __future__ import annotations

import json
import random

import pytest

from analyzer import dialects, sources
from analyzer.cli import decode, main
from analyzer.sinks import mcap_file, shared
from analyzer.sinks.forked import available
from analyzer.sinks.object_table import Table
from analyzer.sources import lines, pcap, pcapng, stream
from benchmarks.framing_noise import damage
from tests.columns.both_ways import messages, short_runs
from tests.columns.can_traffic import frames
from tests.columns.serial_traffic import POLLS, polls
from tests.columns.test_readers import blf, candump, pcap_short, pcapng_big_short
from tests.columns.test_readers import pcap as pcap_of
from tests.columns.test_readers import pcapng as pcapng_of
from tests.fuzz.mutators import mutated

pytestmark = pytest.mark.skipif(not available(), reason="no fork on this machine, or one core")


def both(capture, folder, capsys, monkeypatch, dialect, together):
    """Check that both ways write and say the same. Return the log that several processes wrote."""
    outcomes, log = [], folder / "out.mcap"
    monkeypatch.setattr(mcap_file, "ROWS", 300)
    monkeypatch.setattr(shared, "_LARGE", 16)
    for module in (stream, sources):
        # The first read is never part of a range.
        monkeypatch.setattr(module, "BLOCK", 400)
    for module in (lines, pcap, pcapng):
        monkeypatch.setattr(module, "TOGETHER", together)
    for long, jobs in ((1 << 30, 1), (0, 3)):
        monkeypatch.setattr(decode, "LONG_CAPTURE", long)
        with short_runs():
            status = main([
                "decode", str(capture), "-o", str(log), "--force", "--json", "--jobs", str(jobs), "--dialect", dialect,
            ])  # fmt: skip
        said = capsys.readouterr()
        outcomes.append((status, said.err, json.loads(said.out) if status == 0 else "", messages(log.read_bytes())))
    assert outcomes[0] == outcomes[1]
    return log.read_bytes()


WRITERS = {
    "candump": candump,
    "pcap": pcap_of,
    "pcap, big": pcap_short,
    "pcapng": pcapng_of,
    "pcapng, big": pcapng_big_short,
    "blf": blf,
}


def rows(name, odd):
    """Return traffic of a CAN dialect as the writers take it."""
    for frame in frames(dialects.get(name), random.Random(6), 750, 0.02, odd):
        special = "error" if frame.error else "extended" if frame.extended else ""
        yield frame.t_ns // 1000 * 1000, frame.id, frame.data, special


@pytest.mark.parametrize("together", [40, 333, 5000])
@pytest.mark.parametrize("odd", [0, 0.05])
@pytest.mark.parametrize("name", WRITERS)
def test_can(name, odd, together, tmp_path, capsys, monkeypatch):
    capture = tmp_path / "capture"
    WRITERS[name](list(rows("mks-can", odd)), capture)
    assert b"frames_by_columns" in both(capture, tmp_path, capsys, monkeypatch, "mks-can", together) or together == 40


@pytest.mark.parametrize("name", WRITERS)
def test_damaged_can(name, tmp_path, capsys, monkeypatch):
    whole, capture = tmp_path / "whole", tmp_path / "capture"
    WRITERS[name](list(rows("mks-can", 0.02)), whole)
    data = whole.read_bytes()
    for seed in range(6):
        # Its beginning stays, and with it the format.
        capture.write_bytes(data[:2000] + mutated(random.Random(seed), data[2000:]))
        both(capture, tmp_path, capsys, monkeypatch, "mks-can", 333)


@pytest.mark.parametrize("share", [0, 0.01])
@pytest.mark.parametrize("together", [97, 1000])
@pytest.mark.parametrize("name", POLLS)
def test_serial(name, share, together, tmp_path, capsys, monkeypatch):
    capture = tmp_path / "line.bin"
    line, _ = damage(polls(name, random.Random(3), 1500), share, random.Random(4))
    capture.write_bytes(b"\x00\x80" + line)
    both(capture, tmp_path, capsys, monkeypatch, name, together)


def test_a_slot_is_free_once_nothing_looks_at_it():
    import numpy as np

    memory = shared.Shared(Table([]), 1)
    slot = memory.slot()
    assert memory.slot() is None
    column, data = np.arange(5000), bytes(range(256)) * 100
    message = memory.dumped((column, data), slot.number)
    assert len(message) < 1000
    here, also = memory.loaded(message, slot)
    del slot
    assert (here == column).all()
    assert also == data
    assert memory.place(here) is not None
    part = here[10:20]
    del here
    assert memory.slot() is None
    assert part[0] == 10
    del part
    assert memory.slot() is not None


def test_what_has_no_room_goes_through_the_pipe(monkeypatch):
    memory = shared.Shared(Table([]), 1)
    data = b"x" * (shared._SIZE + 1)
    slot = memory.slot()
    assert memory.loaded(memory.dumped(data, slot.number), slot) == data
    assert memory.loaded(memory.dumped(data, None)) == data
