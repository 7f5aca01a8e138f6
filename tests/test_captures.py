"""The captures of the project: each format of a session decodes to the meanings that were written by hand beside it."""

from __future__ import annotations

import argparse
import gzip
import hashlib
import importlib.util
import sys

import pytest

from analyzer.cli import main
from analyzer.cli.reading import add_reading_arguments, open_reading
from analyzer.decoder import physical
from analyzer.pipeline import Pipeline
from tests import CAPTURES
from tests.collect import Collect

FILES = sorted(p for p in CAPTURES.iterdir() if p.suffix not in (".py", ".golden", ".md") and p.is_file())


def options(*words):
    parser = argparse.ArgumentParser()
    add_reading_arguments(parser)
    return parser.parse_args(list(words))


def decode(path, *words):
    reading = open_reading(str(path), options(*words))
    sink = Collect()
    with reading.source:
        pipeline = Pipeline(reading.dialects, (sink,), reading.options)
        pipeline.run(reading)
    return reading, sink, pipeline


def meaning(entry):
    """Put a message into the words of the golden files."""
    message = entry.message
    fields = physical(message)
    if "slots" in fields:
        shown = [f"{s['address']}:{s['command']}" for s in fields["slots"]]
    else:
        names = [n for n in fields if not (n.endswith("_name") and n[:-5] in fields)]
        shown = [f"{n}={_text(fields.get(n + '_name', fields[n]))}" for n in names]
    who = "all" if "slots" in fields else message.address
    words = [str(who), message.command.name, message.role.value, *shown]
    rules = [f.rule for f in entry.findings]
    return " ".join(words) + (f" ! {' '.join(rules)}" if rules else "")


def _text(value):
    return f"{value:g}" if isinstance(value, float) else str(value)


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_each_capture_decodes_to_its_golden(path):
    golden = (CAPTURES / f"{path.name.split('.')[0]}.golden").read_text().splitlines()
    if path.suffix == ".mf4":
        pytest.importorskip("asammdf")
    reading, sink, pipeline = decode(path)
    assert [meaning(e) for e in sink.entries] == golden
    assert sink.pieces == []
    frames = sum(len(e.message.frame.data) for e in sink.entries)
    assert frames == sum(p.bytes_in for p in pipeline.ports.values())
    plain = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    assert reading.source.sha256 in (hashlib.sha256(path.read_bytes()).hexdigest(), hashlib.sha256(plain).hexdigest())


@pytest.mark.parametrize("name", ["mks_rs485.log", "mks_can.asc", "lk_rs485.log", "mks_rs485.user.pcap"])
def test_times_are_those_that_were_written(name):
    sys.path.insert(0, str(CAPTURES))
    from make import START_NS
    from sessions import SESSIONS

    rows = SESSIONS[name.split(".")[0]]
    _, sink, _ = decode(CAPTURES / name)
    assert [e.message.frame.last_ns for e in sink.entries] == [START_NS + round(r.at * 1_000_000) for r in rows]


def test_a_log_decodes_again_to_the_same(tmp_path):
    for name in ("mks_rs485.log", "mks_can.candump.log", "lk_rs485.bin"):
        log = tmp_path / f"{name}.mcap"
        assert main(["decode", str(CAPTURES / name), "-o", str(log)]) == 0
        _, first, _ = decode(CAPTURES / name)
        _, again, _ = decode(log)
        assert [meaning(e) for e in again.entries] == [meaning(e) for e in first.entries]
        assert [e.message.frame.data for e in again.entries] == [e.message.frame.data for e in first.entries]


def test_the_generator_makes_what_stands_here(tmp_path):
    spec = importlib.util.spec_from_file_location("make_captures", CAPTURES / "make.py")
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    for file, build in make.FILES.items():
        assert build() == (CAPTURES / file).read_bytes(), file
    for name in make.SESSIONS:
        assert make.golden(name) == (CAPTURES / f"{name}.golden").read_text()


@pytest.mark.parametrize("dialect", ["mks-rs485", "mks-modbus", "lk-rs485", "mks-can"])
def test_long_captures_of_any_seed_decode_whole(dialect, tmp_path):
    spec = importlib.util.spec_from_file_location("make_captures", CAPTURES / "make.py")
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    target = tmp_path / "long"
    make.make_long(dialect, 2000, 11, target)
    _, sink, _ = decode(target)
    assert len(sink.entries) == 2000
    assert sink.pieces == []
    assert {f.rule for f in sink.findings} <= {"late_reply"}
    assert {e.message.frame.dialect.name for e in sink.entries} == {dialect}
