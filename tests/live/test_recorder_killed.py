"""A decoding process that is killed at any moment: nothing is lost, nothing stands twice, the file can be read meanwhile."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from analyzer.cli import main
from analyzer.live import checkpoint, recorder
from analyzer.live.config import WHOLE
from analyzer.records import Chunk
from analyzer.sources import open_source
from tests.collect import sum8
from tests.conformance.drives.served import wait_for
from tests.live.spooled import MS, START, UTC, Spools, content, decoded_of, port, raw_of, read, traffic
from tests.logs import metadata

LEFT = port("1-left", "left", byte_ns=260_416, speed=38400)
RIGHT = port("2-right", "right", dialects=())
ARM = port("3-arm", "arm", "can", ("mks-can",))


def fill(spools, seed, seconds=4.0):
    """Random traffic on three buses, chunks cut anywhere."""
    chance = random.Random(seed)
    for stem in ("1-left", "2-right"):
        ms = 1.0
        stream = b"".join(piece for _, piece in traffic(seed, 400))
        at = 0
        while at < len(stream) and ms < seconds * 1000:
            size = chance.randint(1, 20)
            ms += chance.choice((0, 0.2, 1, 3, 5, 30))
            spools.data(stem, ms, stream[at : at + size])
            at += size
            if chance.random() < 0.1:
                ms += 60
                spools.idle(stem, ms)
    for n in range(200):
        spools.can("3-arm", n * seconds * 5, "001#3031")
        spools.can("3-arm", n * seconds * 5 + 1, "001#3000000000123477")
    spools.end(seconds * 1000 + 500)


def once(step):
    """What a process does with a step that can write."""
    step()


@pytest.mark.parametrize("seed", range(4))
def test_gone_on_with_after_each_kill(tmp_path, seed):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    straight, killed = (Spools(tmp_path / name, LEFT, RIGHT, ARM, segment_size=4000) for name in "ab")
    for spools in (straight, killed):
        fill(spools, seed)
    straight.record()
    chance = random.Random(seed)
    recording = killed.begin()
    now_ns = START
    kills = 0
    while not recording.merger.drained:
        now_ns += chance.randint(1, 400) * 1_000_000
        final = now_ns > START + 10_000_000_000
        for spool, record in recording.merger.take(None if final else now_ns):
            recording.take([(spool, record)])
            if chance.random() < 0.001:
                recording.flush()
        recording.settle(recording.merger.horizon_ns)
        if chance.random() < 0.3:
            recording.flush()
        if chance.random() < 0.3 and kills < 8:
            # Killed: what was in memory is gone, and perhaps it had written more than its checkpoint says.
            kills += 1
            recording.abandon()
            with recording.parts.path.open("ab") as stream:
                stream.write(chance.randbytes(chance.randint(0, 3000)))
            recording = killed.begin()
    recording.finish(once)
    assert kills
    for bus in ("left", "right"):
        assert raw_of([killed.log], bus) == decoded_of([killed.log], bus) == killed.sent[bus]
    assert content(killed.log) == content(straight.log)
    assert metadata(killed.log) == metadata(straight.log)


def test_another_version_goes_on(tmp_path):
    spools = Spools(tmp_path, LEFT, RIGHT, ARM)
    fill(spools, 3)
    recording = spools.begin()
    for number, each in enumerate(recording.merger.take(START + 10**12)):
        recording.take([each])
        if number == 300:
            break
    recording.flush()
    recording.abandon()
    state = checkpoint.load(spools.folder)
    state.digest = "0.0.1"
    state.save(spools.folder)
    spools.record()
    for bus in ("left", "right"):
        assert raw_of([spools.log], bus) == decoded_of([spools.log], bus) == spools.sent[bus]
    notes = [v["text"] for t, _, v in read(spools.log) if t == "/recording" and v["event"] == "note"]
    assert any("another version" in text for text in notes)


def test_a_checkpoint_from_elsewhere_can_do_nothing(tmp_path):
    """A pickle that would run a command is not even looked at."""
    import os
    import pickle

    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "evil"),)

    with pytest.raises(ValueError, match="no place in a checkpoint"):
        checkpoint.load_state(pickle.dumps({"ports": Evil()}), _table())
    assert not (tmp_path / "evil").exists()


def _table():
    from analyzer import dialects
    from analyzer.sinks.object_table import Table

    return Table(dialects.every())


def start(folder):
    return subprocess.Popen(
        [sys.executable, "-m", "analyzer.live.recorder", str(folder)], stdin=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def _decoded(folder: Path) -> int:
    """Return how far the checkpoint of a recording has come, 0 where there is none yet."""
    found = checkpoint.load(folder)
    return found.buses["left"].offset if found is not None and "left" in found.buses else 0


def test_a_real_process_killed_at_random_moments(tmp_path):
    """The spools hold some seconds of work; each process gets a part of it done and dies."""
    spools = Spools(tmp_path, port("1-left", "left", byte_ns=2500), segment_size=1 << 18)
    exchange = bytes.fromhex(sum8("FA 01 32") + sum8("FB 01 32 FE D4"))
    ms = 1.0
    for n in range(3000):
        spools.data("1-left", ms + n, exchange * 20)
    spools.event("1-left", 6001, "closed", reason="test")
    chance = random.Random(7)
    seen = 0
    for _ in range(3):
        process = start(spools.folder)
        assert wait_for(lambda least=seen: _decoded(spools.folder) > least, 60)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(chance.uniform(0.0, 0.5))
        process.send_signal(signal.SIGKILL)
        process.wait()
        if spools.log.exists():
            with open_source(spools.log) as source:
                size = sum(len(item.data) for item in source if hasattr(item, "data"))
                assert any("servotap recover" in note for note in source.notes)
            # A checkpoint is at most a second old, and what it says is in the file.
            assert size >= checkpoint.load(spools.folder).buses["left"].offset >= seen
            seen = checkpoint.load(spools.folder).buses["left"].offset
    assert seen
    assert main(["show", str(spools.log), "--limit", "3"]) == 0
    spools.event("0-control", 6002, "end", reason="test")
    process = start(spools.folder)
    assert process.wait(60) == WHOLE
    assert process.stderr.read() == b""
    process.stderr.close()
    assert raw_of([spools.log], "left") == decoded_of([spools.log], "left") == spools.sent["left"]
    sequences = [m.sequence for t, m, _ in read(spools.log) if "read_speed" in t or t == "/recording"]
    assert sequences == list(range(1, len(sequences) + 1))
    assert not spools.folder.exists()


class Killed(Exception):
    """The process is gone at this moment."""


@pytest.mark.parametrize("seed", range(3))
def test_what_came_is_in_the_file_within_a_second_whenever_it_is_killed(tmp_path, monkeypatch, seed):
    """On a clock of its own: a silent bus beside one that is never quiet, and death at any moment."""
    spools = Spools(tmp_path, LEFT, RIGHT)
    dies_ms = random.Random(seed).randint(1500, 4000)
    clock = SimpleNamespace(now_ns=START, told_ms=0)

    def sleep(seconds):
        clock.now_ns += int(seconds * 1e9)
        while clock.told_ms * MS < clock.now_ns - START:
            spools.data("1-left", clock.told_ms, sum8("FA 01 32"))
            clock.told_ms += 5

    def until():
        if clock.now_ns - START > dies_ms * MS:
            raise Killed
        return False

    monkeypatch.setattr(recorder, "time", SimpleNamespace(monotonic_ns=lambda: clock.now_ns, sleep=sleep))
    process = recorder.Recorder(spools.folder, say=print)
    with pytest.raises(Killed):
        process.run(until=until)
    process.close()
    with open_source(spools.log) as source:
        last_ns = max(item.t_ns for item in source if isinstance(item, Chunk))
    assert clock.now_ns - START - (last_ns - UTC) <= 1000 * MS
