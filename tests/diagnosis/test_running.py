"""Diagnosis while traffic comes: a cause is told once, kept up to date, and again at the end."""

from __future__ import annotations

import json
import threading

import pytest

from analyzer.cli.record_display import Display, JsonDisplay
from analyzer.diagnosis import running as running_module
from analyzer.diagnosis.diagnose import diagnosis, lines
from analyzer.diagnosis.running import Running
from analyzer.diagnosis.watch import Watch
from analyzer.live.snapshot import Snapshot
from analyzer.live.snapshot_sink import SnapshotSink
from analyzer.pipeline import Pipeline
from tests.diagnosis.test_diagnosis import NATIVE
from tests.diagnosis.test_diagnosis import lines as chunks

WRONG = [("> FA 01 31 32"), ("> FA 01 3A 3B"), ("> FA 01 F3 01 F5")]
S = 1_000_000_000


def fed(watch: Watch, rows: list[str]) -> Pipeline:
    pipeline = Pipeline([NATIVE], [watch])
    for item in chunks(*rows):
        watch.take(item)
        pipeline.feed(item)
    pipeline.close()
    return pipeline


def waited(running: Running) -> None:
    for thread in threading.enumerate():
        if thread.name == "servotap-diagnosis":
            thread.join(20)


def test_a_cause_is_told_once_and_stands_at_the_end_as_diagnose_has_it():
    running, watch = Running(), Watch()
    fed(running, WRONG)
    fed(watch, WRONG)
    assert running.look(0, [NATIVE]) == []
    assert running.look(2 * S, [NATIVE]) == []
    waited(running)
    whole = lines(diagnosis(watch, [NATIVE]))
    assert running.look(3 * S, [NATIVE]) == whole
    assert running.look(90 * S, [NATIVE]) == []
    assert running.end(99 * S, [NATIVE]) == []
    assert [line for told in running.causes.values() for line in told] == whole
    assert list(running.causes) == ["wrong_checksum_rule"]


def test_a_diagnosis_that_fails_is_told_once_and_hides_nothing_else(monkeypatch):
    def fails(scenes):
        raise RuntimeError("no")

    monkeypatch.setattr(running_module, "weighed", fails)
    running = Running()
    fed(running, WRONG)
    running.look(0, [NATIVE])
    running.look(2 * S, [NATIVE])
    waited(running)
    told = "a fault of servotap in the diagnosis: RuntimeError: no; the recording goes on, please report it"
    assert running.look(3 * S, [NATIVE]) == [told]
    fed(running, WRONG)
    assert running.look(90 * S, [NATIVE]) == running.end(99 * S, [NATIVE]) == []
    assert running.causes == {}


def test_clean_traffic_is_never_looked_at():
    running = Running()
    fed(running, ["> FA 01 30 2B", "< FB 01 30 00 00 00 00 00 01 2D"])
    before = threading.active_count()
    assert running.look(9 * S, [NATIVE]) == running.end(10 * S, [NATIVE]) == []
    assert threading.active_count() == before


def test_what_is_forgotten_counts_on(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("analyzer.diagnosis.watch._MOST_FINDINGS", 2)
    running = Running()
    fed(running, WRONG)
    assert running.full
    running.end(0, [NATIVE])
    assert not running.full
    fed(running, ["> FA 01 30 2B", "< FB 01 30 00 00 00 00 00 01 2D"])
    running.end(S, [NATIVE])
    assert list(running.causes) == ["wrong_checksum_rule"]


def test_a_recording_prints_a_cause_once(capsys: pytest.CaptureFixture[str]):
    feed = SnapshotSink()
    feed.causes = {"echo": ["1. The adapter echoes.", "   next: switch it off"]}
    first, second = feed.snapshot(1), feed.snapshot(2)
    for display in (Display(), JsonDisplay()):
        for snapshot in (first, second):
            display.snapshot(snapshot)
        display.tell_notes()
    output = capsys.readouterr()
    assert output.err == "1. The adapter echoes.\n   next: switch it off\n"
    assert [json.loads(line)["text"] for line in output.out.splitlines()] == feed.causes["echo"]


def test_the_last_snapshot_leaves_causes_to_the_summary(capsys: pytest.CaptureFixture[str]):
    Display().snapshot(Snapshot(1, 1, causes={"echo": ["1. It echoes."]}, ended=True))
    assert capsys.readouterr().err == ""
