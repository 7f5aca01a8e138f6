"""The corpus holds; mutators damage what is inside a container and leave the container; the engine notices each end."""

from __future__ import annotations

import contextlib
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.writer import Writer

from analyzer.errors import ServotapError
from analyzer.live import checkpoint
from analyzer.live.spool import SpoolReader
from analyzer.sources import open_source
from tests import ROOT
from tests.fuzz import engine, targets
from tests.fuzz.__main__ import Session
from tests.fuzz.corpus import INPUT, captures
from tests.fuzz.engine import Finding, made, outcomes, shrunk
from tests.fuzz.mutators import kind_of, mutated, packed
from tests.fuzz.seeds import recordings, samples
from tests.fuzz.targets import TARGETS, Fault, Target, key_of

ROUNDS = 24


def test_the_corpus_holds():
    root = ROOT
    ended = subprocess.run([sys.executable, "-m", "tests.fuzz", "--replay"], cwd=root, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr + ended.stdout


# --- mutators -----------------------------------------------------------------------------------------------------------


def read(data, folder):
    """Return how many records a capture gives; 0 if it is none."""
    path = folder / "capture"
    path.write_bytes(data)
    count = 0
    try:
        with open_source(path) as source:
            for _ in source:
                count += 1
    except ServotapError:
        pass
    return count


@pytest.mark.parametrize("name", ["asc", "blf", "mcap", "pcap", "pcapng", "packed"])
def test_what_is_mutated_is_still_a_capture(name, tmp_path):
    data = samples()[name] if name != "packed" else packed(random.Random(7), samples()["candump"])
    made = [mutated(random.Random(number), data) for number in range(ROUNDS)]
    assert sum(each != data for each in made) > ROUNDS * 0.9
    assert len(set(made)) > ROUNDS * 0.7
    assert sum(kind_of(each) == kind_of(data) for each in made) > ROUNDS * 0.7
    assert sum(read(each, tmp_path) > 0 for each in made) > ROUNDS * 0.4


def test_a_mutated_spool_still_holds_records(tmp_path):
    (name, data), *_ = ((n, d) for n, d in recordings()[0].items() if "left" in n)
    counts = []
    for number in range(ROUNDS):
        (tmp_path / Path(name).name).write_bytes(mutated(random.Random(number), data, kind="spool"))
        reader = SpoolReader(tmp_path, "1-left")
        counts.append(sum(1 for _ in reader.read()))
        reader.close()
    assert sum(count > 3 for count in counts) > ROUNDS * 0.6


def test_a_mutated_checkpoint_is_still_one(tmp_path):
    name, data = next((Path(name).name, data) for name, data in recordings()[1].items() if "checkpoint" in name)
    good = 0
    for number in range(ROUNDS):
        (tmp_path / name).write_bytes(mutated(random.Random(number), data, kind="checkpoint"))
        with contextlib.suppress(ServotapError):
            good += checkpoint.load(tmp_path) is not None
    assert good > ROUNDS * 0.25


@pytest.mark.parametrize("target", TARGETS)
def test_an_input_is_known_by_its_number(target):
    seeds = TARGETS[target].seeds()
    number = len(seeds) + 5
    assert made(target, 3, number, seeds) == made(target, 3, number, seeds) != made(target, 4, number, seeds)


# --- the engine ---------------------------------------------------------------------------------------------------------


def spin(given, place):
    while True:
        pass


def wait(given, place):
    time.sleep(100)


def crash(given, place):
    os.kill(os.getpid(), 11)


def devour(given, place):
    bytearray(4 << 30)


def shout(given, place):
    sys.stdout.write("\x1b[31m")
    targets.run_words(["--version"], place)


def raise_it(given, place):
    raise ValueError(given[INPUT])


def fill(given, place):
    (place.folder / "log").touch()
    os.truncate(place.folder / "log", 100 << 20)
    targets.run_words(["--version"], place)


ENDS = {
    spin: "hang",
    wait: "hang",
    crash: "SIGSEGV",
    devour: "MemoryError",
    shout: "an escape",
    raise_it: "ValueError",
    fill: "was written",
}


@pytest.mark.parametrize("run", ENDS, ids=lambda run: run.__name__)
def test_every_kind_of_end_is_noticed(run, monkeypatch):
    monkeypatch.setattr(engine, "WAITING_S", 0.5)
    monkeypatch.setitem(TARGETS, "framer", Target(run, list, lambda *_: {}, seconds=0.2))
    (text,) = outcomes("framer", [{INPUT: b""}])
    assert ENDS[run] in text


def test_one_that_dies_does_not_stop_the_others(monkeypatch):
    def run(given, place):
        if given[INPUT] == b"dies":
            os.kill(os.getpid(), 9)

    monkeypatch.setitem(TARGETS, "framer", Target(run, list, lambda *_: {}))
    texts = outcomes("framer", [{INPUT: each} for each in (b"", b"dies", b"")])
    assert [bool(text) for text in texts] == [False, True, False]


def test_a_finding_is_shrunk_to_what_it_needs(monkeypatch):
    def run(given, place):
        if b"FA 01" in given[INPUT] and "other" in given:
            raise Fault("both are there")

    monkeypatch.setitem(TARGETS, "framer", Target(run, list, lambda *_: {}))
    given = {INPUT: b"x" * 40 + b"FA 01" + b"y" * 17, "other": b"z" * 9, "third": b""}
    found = Finding("framer", 1, 1, key_of("both are there"), "both are there")
    assert shrunk(found, given, 10) == {INPUT: b"FA 01", "other": b""}


def test_the_framer_of_the_target_loses_nothing_and_would_tell(monkeypatch):
    monkeypatch.setattr(targets._Line, "take", lambda self, pieces: [(0, b"".join(pieces)[1:])])
    (text,) = outcomes("framer", [{INPUT: captures()[0]}])
    assert "other bytes came out" in text


def test_a_key_that_the_view_falls_over_is_told(monkeypatch):
    def fall(self, on):
        raise LookupError("the help")

    monkeypatch.setattr("analyzer.view.app.ViewApp.action_order", fall, raising=False)
    given = {INPUT: captures()[0], "keys": b"\x18o"}
    monkeypatch.setattr("tests.fuzz.two_ends._NAMES", ("o",) * 256)
    (text,) = outcomes("view", [given])
    assert "fall" in text
    assert outcomes("view", [{**given, "keys": b""}]) == [""]


def test_what_clients_send_reaches_an_emulated_drive(monkeypatch):
    def fall(self, *given):
        raise LookupError(given)

    monkeypatch.setattr("conformance.drives.drive.Drive.receive", fall)
    (text,) = outcomes("emulate-tcp", [{INPUT: b"\xfa\x01\x30\x2b"}])
    assert "LookupError" in text


def test_a_mutator_that_raises_is_told_and_ends_nothing(monkeypatch, tmp_path):
    monkeypatch.setitem(TARGETS, "framer", TARGETS["framer"]._replace(mutate=lambda *_: 1 / 0))
    session = Session(["framer"], 1, tmp_path, 1)
    session.run(1, 0.3)
    assert list(session.found) == [("framer", "mutator")]
    assert session.counts["framer"] > 0


def test_a_byte_that_a_log_lacks_is_told(tmp_path):
    (tmp_path / "log").write_bytes(samples()["mcap"])
    size = targets.fed(tmp_path / "log")
    targets.check_log(tmp_path / "log", size)
    with pytest.raises(Fault, match=f"{size + 1} bytes came in, {size} stand in the log"):
        targets.check_log(tmp_path / "log", size + 1)


@pytest.mark.parametrize("name", ["recover-bytes", "decode", "export-pcapng"])
def test_a_command_that_loses_all_is_told(name, monkeypatch):
    def lose(words, place):
        with (place.folder / words[words.index("-o") + 1] if "-o" in words else place.folder / "out.mcap").open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            writer.finish()
        return 0

    monkeypatch.setattr(targets, "run_words", lose)
    given = recordings()[0] if name == "recover-bytes" else {INPUT: captures()[0]}
    (text,) = outcomes(name, [given])
    assert "not in the log" in text or "came in" in text or "come back" in text
