"""Sinks in a process of their own: the same log as here, and what went wrong there is raised here."""

from __future__ import annotations

import io
import os
import signal

import pytest
from mcap.reader import make_reader

from analyzer import dialects
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sinks.forked import available
from analyzer.sinks.mcap_log import McapLog
from analyzer.sinks.object_table import Table
from analyzer.sinks.process import SinkProcess
from analyzer.sinks.summary import Summary
from tests.collect import crc, sum8

pytestmark = pytest.mark.skipif(not available(), reason="no fork on this machine, or one core")


def items():
    for n in range(400):
        yield Chunk(n * 10_000_000, "left", bytes.fromhex(sum8("FA 01 31")))
        yield Chunk(n * 10_000_000 + 3_000_000, "left", bytes.fromhex(sum8(f"FB 01 31 00 00 00 00 {n % 256:02X} 00")))
        if n % 50 == 0:
            yield Chunk(n * 10_000_000 + 5_000_000, "left", bytes.fromhex("00 11 22"))
            yield Chunk(n * 10_000_000 + 6_000_000, "left", bytes.fromhex(sum8("FA 01 F6 0F A0 02")))
            yield Chunk(n * 10_000_000 + 7_000_000, "left", bytes.fromhex(crc("01 04 00 32 00 01")))
            yield Comment(n * 10_000_000, "left", "a comment")
        yield CanFrame(n * 10_000_000, "can0", 2, bytes.fromhex("3234"))
        yield CanFrame(n * 10_000_000 + 500_000, "can0", 2, bytes.fromhex("32006498"))


CHOSEN = [dialects.get(n) for n in ("mks-rs485", "mks-modbus", "mks-can")]


def read(path):
    with path.open("rb") as stream:
        return [
            (c.topic, m.sequence, m.log_time, m.publish_time, m.data)
            for _, c, m in make_reader(stream).iter_messages(log_time_order=False)
        ]


def run(path, in_process):
    with path.open("wb") as stream:
        sinks = [McapLog(stream, byte_ns=260_416), Summary()] if not in_process else None
        process = SinkProcess(Table(CHOSEN), lambda: (McapLog(stream, byte_ns=260_416), Summary())) if in_process else None
        pipeline = Pipeline(CHOSEN, (process,) if process else sinks, Options(byte_ns=260_416))
        pipeline.run(items())
        if process is None:
            sinks[0].finish({"a": "b"})
            return sinks[1].as_object()
        summary = process.call(1, "").as_object()
        process.call(0, "finish", {"a": "b"})
        process.close()
        return summary


def test_the_log_and_the_summary_are_the_same(tmp_path):
    here = run(tmp_path / "here.mcap", False)
    there = run(tmp_path / "there.mcap", True)
    assert there == here
    assert read(tmp_path / "there.mcap") == read(tmp_path / "here.mcap")
    assert len(read(tmp_path / "here.mcap")) > 2000


class _Full(io.RawIOBase):
    def writable(self):
        return True

    def write(self, data):
        raise OSError(28, "No space left on device")


def test_what_goes_wrong_there_is_raised_here():
    process = SinkProcess(Table(CHOSEN), lambda: (McapLog(_Full()), Summary()))
    with pytest.raises(OSError, match="No space left"):
        process.call(0, "flush")
    process.abandon()


def test_a_worker_that_is_killed_is_an_error_and_no_hang(tmp_path):
    with (tmp_path / "x.mcap").open("wb") as stream:
        process = SinkProcess(Table(CHOSEN), lambda: (McapLog(stream), Summary()))
        os.kill(process._worker.process, signal.SIGKILL)
        pipeline = Pipeline(CHOSEN, (process,))
        with pytest.raises(OSError, match="died"):
            pipeline.run(item for _ in range(100) for item in items())
        process.abandon()
