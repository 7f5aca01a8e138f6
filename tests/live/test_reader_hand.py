"""A reader can be killed at every instant: its successor finds what it had taken from the port and not stored."""

from __future__ import annotations

import os
import signal
import sys
from itertools import count
from pathlib import Path

from analyzer.live import reader_hand, reader_store, reader_stream, spool
from analyzer.live.reader_hand import Hand
from analyzer.live.reader_store import Store
from analyzer.live.reader_stream import drain, settle, take_over
from analyzer.live.spool import RecordKind, SpoolReader, SpoolWriter, last_record
from tests.live.recorded import pty_pair

STEM = "1-a"
ROUNDS = (b"\xfa\x01\x30\x2b", b"\xfb\x01\x30", b"\x00", b"\x00" * 70)
#: The code in which a byte passes from the port to the spool.
WATCHED = {module.__file__ for module in (reader_hand, reader_store, reader_stream, spool)}


def store_of(folder, hand):
    """The store of a reader, or of its successor, as `reader.main` makes it."""
    before = last_record(folder, STEM)
    left = hand.left(0 if before is None else before.before + before.units)
    store = Store(
        SpoolWriter(folder, STEM), lambda *about: None, count=0 if left is None else left.stored,
        last_ns=0 if left is None else left.last_ns, hand=hand,
    )  # fmt: skip
    if left is not None:
        take_over(store, left, 0)
    return store


def read_rounds(master, slave, folder, memory, written, dies_at):
    """Be a reader, killed before the opcode of this number that is run."""
    store = store_of(folder, Hand(memory))
    store.event("open")
    done = 0

    def trace(frame, event, argument):
        nonlocal done
        if frame.f_code.co_filename not in WATCHED:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            done += 1
            if done == dies_at:
                os.kill(os.getpid(), signal.SIGKILL)
        return trace

    for data in ROUNDS:
        os.write(master, data)
        os.write(written, data)
        sys.settrace(trace)
        take(slave, store)
        sys.settrace(None)


def take(slave, store):
    for t_ns, piece in settle(drain(slave, store)[0], 0, store.last_ns, after_idle=store.idle):
        store.chunk(t_ns, piece)
    store.flush()


def made(folder):
    folder.mkdir()
    return folder


def kill_at_each_instant(folder, step):
    """Return how many instants there are, and those after which a byte was missing."""
    wrong = []
    with pty_pair() as (master, path):
        slave = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        heard, written = os.pipe()
        for at in count(1, step):
            place, memory = made(folder / str(at)), Hand.make()
            child = os.fork()
            if not child:
                read_rounds(master, slave, place, memory, written, at)
                os._exit(0)
            if os.waitpid(child, 0)[1] != signal.SIGKILL:
                return at, wrong
            store = store_of(place, Hand(memory))
            # What the other one did not come to read is still in the terminal.
            take(slave, store)
            os.close(memory)
            records = list(SpoolReader(place, STEM).read(1 << 20, final=True))
            found = b"".join(r.data for r in records if r.kind == RecordKind.DATA)
            dropped = [r for r in records if r.kind == RecordKind.EVENT and r.event["event"] == "dropped"]
            if found != os.read(heard, 1000) or dropped or len(found) != store.count:
                wrong.append(at)


def test_a_reader_killed_at_any_instant_costs_no_byte(tmp_path):
    """All instants in a row: python -m tests.live.test_reader_hand FOLDER"""
    instants, wrong = kill_at_each_instant(tmp_path, 61)
    assert instants > 1000
    assert wrong == []


if __name__ == "__main__":
    print(kill_at_each_instant(Path(sys.argv[1]), int(sys.argv[2])))
