"""However many processes decode a capture, the log is the same, byte by byte."""

from __future__ import annotations

import io
import json
import os
import random
import signal

import pytest
from mcap.reader import make_reader

from analyzer import dialects, sources
from analyzer.cli import decode, main
from analyzer.pipeline import Pipeline
from analyzer.sinks import mcap_file, workers
from analyzer.sinks.forked import available
from analyzer.sinks.mcap_chunk import Batch, Run
from analyzer.sinks.mcap_file import McapFile
from analyzer.sinks.mcap_log import McapLog
from analyzer.sinks.object_table import Table, TableUnpickler, dumped
from analyzer.sinks.workers import Workers
from analyzer.sources import stream
from benchmarks.framing_noise import damage
from tests.columns.both_ways import blocks, messages, short_runs
from tests.columns.can_traffic import frames
from tests.columns.serial_traffic import POLLS, polls
from tests.fuzz.corpus import CAPTURES, INPUT, quick

pytestmark = pytest.mark.skipif(not available(), reason="no fork on this machine, or one core")

MKS = dialects.get("mks-can")
CAN_CAPTURES = [p.read_bytes() for p in sorted(CAPTURES.glob("mks_can.*")) if p.suffix not in (".golden", ".mf4")]
SERIAL_CAPTURES = [(CAPTURES / name).read_bytes() for name in ("mks_rs485.log", "lk_rs485.log", "mks_modbus.log")]
GIVEN = [*CAN_CAPTURES, *SERIAL_CAPTURES, *(each[INPUT] for each in quick("decode"))]


@pytest.fixture(autouse=True)
def _small_batches(monkeypatch):
    monkeypatch.setattr(mcap_file, "ROWS", 20)
    with short_runs():
        yield


@pytest.mark.parametrize("data", GIVEN, ids=range(len(GIVEN)))
def test_decode_writes_the_same_bytes(data, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(decode, "LONG_CAPTURE", 0)
    monkeypatch.setattr(decode, "now_text", lambda: "now")
    capture, log = tmp_path / "capture", tmp_path / "out.mcap"
    capture.write_bytes(data)
    outcomes = []
    for jobs in "13":
        status = main(["decode", str(capture), "-o", str(log), "--force", "--json", "--jobs", jobs])
        outcomes.append((status, capsys.readouterr(), log.exists() and log.read_bytes()))
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("name", POLLS)
def test_a_serial_line_is_the_same_and_goes_by_columns(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(decode, "LONG_CAPTURE", 0)
    monkeypatch.setattr(decode, "now_text", lambda: "now")
    for module in (stream, sources):
        # The first read is never part of a block.
        monkeypatch.setattr(module, "BLOCK", 1000)
    line, _ = damage(polls(name, random.Random(3), 1000), 0.001, random.Random(4))
    capture, logs = tmp_path / "line.bin", []
    capture.write_bytes(b"\x00\x80" + line)
    for jobs in "12":
        log = tmp_path / f"{jobs}.mcap"
        assert main(["decode", str(capture), "-o", str(log), "--dialect", name, "--json", "--jobs", jobs]) == 0
        logs.append((log.read_bytes(), capsys.readouterr().out.replace(log.name, "")))
    assert logs[0] == logs[1]
    assert b"frames_by_columns" in logs[0][0]


@pytest.mark.parametrize(("cores", "jobs"), [(1, []), (2, []), (3, [3]), (8, [8])])
def test_a_capture_alone_is_decoded_by_one_process_where_that_uses_all_cores(cores, jobs, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(decode, "LONG_CAPTURE", 0)
    monkeypatch.setattr(decode, "cores", lambda: cores)
    made = []

    class Counted(Workers):
        def __init__(self, count, table):
            made.append(count + 1)
            super().__init__(1, table)

    monkeypatch.setattr(workers, "Workers", Counted)
    monkeypatch.setattr(workers, "MOST", 99)
    capture = str(CAPTURES / "mks_can.candump.log")
    assert main(["decode", capture, "-o", str(tmp_path / "log.mcap")]) == 0
    assert made == jobs


def traffic():
    return list(blocks(list(frames(MKS, random.Random(8), 2000, 0.02, 0.02)), 700))


def written(packer=None, spoil=lambda number: None):
    """Return the log of some traffic; `spoil` is called before each item."""
    stream = io.BytesIO()
    log = McapLog(McapFile(stream, profile="servotap", library="servotap", packer=packer))
    pipeline = Pipeline([MKS], [log])
    for number, item in enumerate(traffic()):
        spoil(number)
        pipeline.feed(item)
    pipeline.close()
    log.finish({})
    assert pipeline.in_runs > 1000
    return stream.getvalue()


def test_a_long_log_is_the_same(monkeypatch):
    monkeypatch.setattr(mcap_file, "ROWS", 300)
    alone = written()
    assert written(Workers(2, Table([MKS]))) == alone
    assert len(messages(alone)) > 2000


def test_blocks_that_follow_each_other_share_a_chunk(monkeypatch):
    monkeypatch.setattr(mcap_file, "ROWS", 1 << 14)
    summary = make_reader(io.BytesIO(written())).get_summary()
    assert len(traffic()) > 2
    assert summary.statistics.chunk_count == 1


@pytest.mark.parametrize("killed", [1, 2])
def test_what_a_dead_worker_was_to_do_is_done(killed):
    workers = Workers(2, Table([MKS]))

    def spoil(number):
        if number == 1:
            for worker in workers._workers[:killed]:
                os.kill(worker.process, signal.SIGKILL)

    assert written(workers, spoil) == written()
    assert workers.died == ["signal 9"] * killed


def test_an_error_in_a_worker_is_raised_here():
    workers = Workers(1, Table([MKS]))
    with pytest.raises(IndexError):
        workers.submit(Batch([Run(0, 0, 1)])).result()
    workers.shutdown(at_once=True)


def test_an_abandoned_log_leaves_no_process():
    workers = Workers(2, Table([MKS]))
    log = McapLog(McapFile(io.BytesIO(), profile="", library="", packer=workers))
    pipeline = Pipeline([MKS], [log])
    for item in traffic():
        pipeline.feed(item)
    processes = [worker.process for worker in workers._workers]
    log.abandon()
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_a_death_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(decode, "LONG_CAPTURE", 0)
    monkeypatch.setattr(Workers, "settle", lambda self: self.died.append("signal 9"))
    path = CAPTURES / "mks_can.candump.log"
    assert main(["decode", str(path), "-o", str(tmp_path / "out.mcap"), "--json", "--jobs", "2"]) == 0
    assert any("signal 9" in note for note in json.loads(capsys.readouterr().out)["notes"])


def test_dialects_that_come_up_late_have_the_same_numbers_on_both_sides():
    asked, late = [], dialects.get("lk-rs485")

    def side(name):
        def later():
            asked.append(name)
            return [MKS, late]

        return Table([MKS], later)

    here, there = side("here"), side("there")
    assert TableUnpickler(io.BytesIO(dumped(MKS.commands[0], here)), there).load() is MKS.commands[0]
    assert asked == []
    for each in (late, late.commands[-1], late.commands[-1].reply_forms[0]):
        assert TableUnpickler(io.BytesIO(dumped(each, here)), there).load() is each
    assert asked == ["here", "there"]
