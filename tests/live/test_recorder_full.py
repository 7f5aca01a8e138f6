"""A disk that is full: the spools keep what comes, the log goes on when there is room again, and nothing in it is torn."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
import time

import pytest
from mcap.reader import make_reader

from analyzer.cli import main
from analyzer.live import recorder
from analyzer.live.config import WHOLE
from analyzer.sources import open_source
from tests.collect import sum8
from tests.live.recorded import small_disk
from tests.live.spooled import Spools, decoded_of, port, raw_of, read
from tests.logs import metadata

EXCHANGE = bytes.fromhex(sum8("FA 01 32") + sum8("FB 01 32 FE D4"))
LIMIT = 30_000


def fill(spools, count=600, size=10):
    for n in range(count):
        # Different each time, or it would be packed into nothing.
        spools.data("1-left", 1 + n, EXCHANGE * size + bytes.fromhex(sum8(f"FB 01 32 {n % 256:02X} {n // 256:02X}")))
    spools.end(count + 10)


class Process:
    """The decoding process; what it says on standard error as it comes."""

    def __init__(self, folder, limit=None):
        def limited():
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))

        self.process = subprocess.Popen(
            # A module compiled under the limit would be kept cut off.
            [sys.executable, "-B", "-m", "analyzer.live.recorder", str(folder)],
            stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=limited if limit else None,
        )  # fmt: skip

    def line(self):
        return self.process.stderr.readline()

    def end(self, timeout=60):
        _, rest = self.process.communicate(timeout=timeout)
        return self.process.returncode, rest


def test_it_goes_on_when_there_is_room_again(tmp_path):
    spools = Spools(tmp_path, port("1-left", "left"))
    fill(spools)
    process = Process(spools.folder, LIMIT)
    try:
        assert "cannot write" in process.line()
        assert spools.log.stat().st_size <= LIMIT
        # Whole as far as it goes: no half chunk stands at its end.
        with open_source(spools.log) as source:
            before = sum(len(item.data) for item in source if hasattr(item, "data"))
            assert not [p for p in source.problems if "incomplete" not in p.text]
        resource.prlimit(process.process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        status, rest = process.end()
    finally:
        process.process.kill()
    assert status == WHOLE
    assert "is written again after" in rest
    assert raw_of([spools.log], "left") == decoded_of([spools.log], "left") == spools.sent["left"]
    assert before < len(spools.sent["left"])
    found = [v for t, _, v in read(spools.log) if t == "/findings" and v["name"] == "log_stalled"]
    assert len(found) == 1
    assert "File too large" in found[0]["message"]
    assert "ended" in metadata(spools.log)


def test_killed_while_the_disk_is_full(tmp_path):
    spools = Spools(tmp_path, port("1-left", "left"))
    fill(spools)
    process = Process(spools.folder, LIMIT)
    assert "cannot write" in process.line()
    process.process.kill()
    process.end()
    assert main(["recover", str(spools.log)]) == 0
    assert raw_of([spools.log], "left") == decoded_of([spools.log], "left") == spools.sent["left"]


def test_a_disk_that_is_really_full(tmp_path):
    disk = tmp_path / "disk"
    with small_disk(disk, "4m"):
        spools = Spools(disk, port("1-left", "left"), segment_size=1 << 16)
        fill(spools)
        used = sum(p.stat().st_size for p in spools.folder.iterdir())
        filler = disk / "filler"
        filler.write_bytes(bytes(((4 << 20) - used - 40_000) & ~0xFFF))
        process = Process(spools.folder)
        try:
            said = process.line()
            assert "No space left on device" in said
            time.sleep(0.5)
            assert process.process.poll() is None
            filler.unlink()
            status, _ = process.end()
        finally:
            process.process.kill()
        assert status == WHOLE
        assert raw_of([spools.log], "left") == decoded_of([spools.log], "left") == spools.sent["left"]


class Full(Exception):
    """What the test's own disk raises is an OSError; this is none."""


@pytest.mark.parametrize("rotating", [False, True])
def test_every_write_may_fail_once(tmp_path, monkeypatch, rotating):
    """After a failure in any write, at any byte, a retry gives the same log."""
    from analyzer.sinks import mcap_index

    spools = Spools(tmp_path, port("1-left", "left"), rotate_bytes=4000 if rotating else 0)
    fill(spools, count=200, size=3)
    count = 0
    real = mcap_index.write_whole

    def flaky(stream, at, data):
        nonlocal count
        count += 1
        if count % 2:
            real(stream, at, data[: len(data) // 2])
            stream.truncate(at)
            raise OSError(28, "No space left on device")
        real(stream, at, data)

    def patiently(step):
        for _ in range(200):
            try:
                step()
                return
            except OSError:
                continue
        raise Full

    recording = spools.begin()
    monkeypatch.setattr(mcap_index, "write_whole", flaky)
    for number, each in enumerate(recording.merger.take(None)):
        recording.take([each])
        if number % 20 == 0:
            patiently(recording.flush)
        if recording.rotation_due:
            recording.rotate(patiently)
    while not recording.merger.drained:
        recording.take(recording.merger.take(None))
    recording.finish(patiently)
    paths = sorted(tmp_path.glob("*.mcap"))
    assert (len(paths) > 2) == rotating
    for path in paths:
        make_reader(path.open("rb"), validate_crcs=True).get_summary()
    assert raw_of(paths, "left") == decoded_of(paths, "left") == spools.sent["left"]


@pytest.mark.parametrize("code", [errno.EINVAL, errno.ENOTSUP, errno.EIO, errno.ENOSPC])
def test_a_medium_without_fsync_is_none_that_is_full_or_broken(tmp_path, monkeypatch, code):
    def refused(descriptor):
        raise OSError(code, os.strerror(code))

    spools = Spools(tmp_path, port("1-left", "left"))
    fill(spools, count=5)
    monkeypatch.setattr(os, "fsync", refused)
    monkeypatch.setattr(recorder, "LAST_TRIES_NS", 0)
    monkeypatch.setattr(recorder, "RETRY_S", 0)
    if code in (errno.EINVAL, errno.ENOTSUP):
        assert spools.record(final=True) == []
        assert raw_of([spools.log], "left") == spools.sent["left"]
    else:
        advice = "Free some space;" if code == errno.ENOSPC else "Mend that, or move it with out.mcap.spool to another disk;"
        with pytest.raises(recorder.Stalled, match=f"{os.strerror(code)}. {advice} then servotap recover"):
            spools.record(final=True)
