"""Parts of a log: each complete by itself, no byte lost or doubled at the seams, the oldest dropped."""

from __future__ import annotations

import errno
import json
import os
import random
from pathlib import Path

import pytest

from analyzer.cli import main
from analyzer.errors import UsageError
from analyzer.live import config
from analyzer.live.recorder import Recorder
from analyzer.records import Chunk
from analyzer.sources import open_source
from analyzer.sources.recording_parts import base_of, look, part_path, parts_named
from tests.collect import sum8
from tests.live.spooled import START, Spools, content, decoded_of, port, raw_of, read
from tests.live.test_recorder_killed import ARM, LEFT, RIGHT, fill, once
from tests.logs import metadata


def recorded_in_steps(spools, seed, killed=False):
    """Record with a flush after every few records; return the parts."""
    chance = random.Random(seed)
    recording = spools.begin()
    now_ns = START
    while not recording.merger.drained:
        now_ns += chance.randint(1, 300) * 1_000_000
        final = now_ns > START + 10_000_000_000
        for each in recording.merger.take(None if final else now_ns):
            recording.take([each])
            if chance.random() < 0.02:
                recording.flush()
            if recording.rotation_due:
                recording.rotate(once)
        recording.settle(recording.merger.horizon_ns)
        if killed and chance.random() < 0.2:
            recording.abandon()
            recording = spools.begin()
    recording.finish(once)
    return parts_named(spools.log)


@pytest.mark.parametrize(("seed", "killed"), [(1, False), (2, True), (3, True)])
def test_no_byte_is_lost_or_doubled_at_the_seams(tmp_path, seed, killed):
    spools = Spools(tmp_path, LEFT, RIGHT, ARM, rotate_bytes=12_000)
    fill(spools, seed)
    paths = recorded_in_steps(spools, seed, killed)
    assert len(paths) > 3
    assert not spools.log.exists()
    for bus in ("left", "right"):
        assert raw_of(paths, bus) == decoded_of(paths, bus) == spools.sent[bus]
    rows = [row for path in paths for row in read(path)]
    sequences = [m.sequence for t, m, _ in rows if m.sequence and not t.endswith(("/state", "/findings"))]
    assert sequences == list(range(1, len(sequences) + 1))
    for number, path in enumerate(paths, 1):
        about = metadata(path)
        assert about["part"] == str(number)
        assert about.get("previous", "") == (paths[number - 2].name if number > 1 else "")
        assert about.get("next", "") == (paths[number].name if number < len(paths) else "")
        assert look(path).recording == look(paths[0]).recording
        events = [v["event"] for t, _, v in read(path) if t == "/recording"]
        assert events[:4] == ["part", "port", "port", "port"]


def test_parts_are_read_as_one_and_each_alone(tmp_path, capsys, cli):
    spools = Spools(tmp_path, LEFT, RIGHT, ARM, rotate_bytes=12_000)
    fill(spools, 5)
    paths = recorded_in_steps(spools, 5)
    for name in (str(tmp_path), str(spools.log)):
        out = tmp_path.parent / f"{tmp_path.name}.again.mcap"
        assert main(["decode", name, "-o", str(out), "--force"]) == 0
        whole = [row for path in paths for row in content(path)]
        assert content(out) == whole
        out.unlink()
    capsys.readouterr()
    for path in paths:
        assert main(["show", str(path), "--limit", "5"]) == 0
        with open_source(path) as source:
            size = sum(len(item.data) for item in source if hasattr(item, "data"))
            assert size
            assert not [note for note in source.notes if "missing in the log" in note]
    paths[1].unlink()
    assert "between part 1 and part 3 are missing" in cli("show", tmp_path, "--limit", "1").err


def test_frames_are_not_cut_where_that_can_be(tmp_path):
    """On a line with pauses each part ends between frames, so each by itself decodes without junk."""
    spools = Spools(tmp_path, port("1-left", "left"), rotate_bytes=3_000)
    stream = bytes.fromhex(sum8("FA 01 32") + sum8("FB 01 32 FE D4"))
    for n in range(600):
        for at in range(0, 10, 5):
            spools.data("1-left", 10 * n + at / 5, stream[at : at + 5])
        if n % 10 == 9:
            spools.idle("1-left", 10 * n + 59)
    spools.end(7000)
    paths = recorded_in_steps(spools, 1)
    assert len(paths) > 2
    for path in paths:
        with open_source(path) as source:
            assert sum(len(item.data) for item in source if hasattr(item, "data")) % 10 == 0


def test_the_oldest_parts_are_dropped(tmp_path):
    spools = Spools(tmp_path, LEFT, RIGHT, ARM, rotate_bytes=12_000, keep=2)
    fill(spools, 5)
    paths = recorded_in_steps(spools, 5)
    assert len(paths) == 2
    assert int(metadata(paths[0])["part"]) > 2
    with open_source(tmp_path) as source:
        assert list(source)
        assert any("are not there any more" in note for note in source.notes)


def test_links_that_lead_nowhere_under_the_names_of_parts_stay_and_cost_nothing(tmp_path):
    spools = Spools(tmp_path, LEFT, RIGHT, ARM, rotate_bytes=12_000, keep=100)
    fill(spools, 5)
    links = [part_path(spools.log, number) for number in (2, 3, 5)]
    for link in links:
        link.symlink_to(tmp_path / "nowhere")
    os.mkfifo(part_path(spools.log, 4))
    recorded_in_steps(spools, 5, killed=True)
    assert all(link.is_symlink() for link in links)
    assert part_path(spools.log, 4).is_fifo()
    paths = [path for path in parts_named(spools.log) if path.is_file()]
    assert raw_of(paths, "left") == decoded_of(paths, "left") == spools.sent["left"]
    assert not (tmp_path / "nowhere").exists()
    # The folder is read without waiting for what a pipe will never say.
    with open_source(tmp_path) as source:
        assert b"".join(item.data for item in source if isinstance(item, Chunk) and item.port == "left") == spools.sent["left"]


def test_a_part_that_cannot_be_deleted_is_told_and_the_recording_goes_on(tmp_path, monkeypatch):
    spools = Spools(tmp_path, LEFT, RIGHT, ARM, rotate_bytes=12_000, keep=2)
    fill(spools, 5)
    unlink = Path.unlink

    def refuse(path, missing_ok=False):
        if path.name.endswith("-0001.mcap"):
            raise PermissionError(errno.EPERM, "Operation not permitted")
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", refuse)
    paths = recorded_in_steps(spools, 5)
    assert part_path(spools.log, 1) in paths
    said = [json.loads(m.data).get("text", "") for path in paths for t, m, _ in read(path) if t == "/recording"]
    assert any("out-0001.mcap is to be deleted and cannot be: Operation not permitted" in text for text in said)


def test_all_parts_together_stay_below_a_size(tmp_path):
    spools = Spools(tmp_path, LEFT, RIGHT, ARM, rotate_bytes=12_000, max_total=50_000)
    fill(spools, 5)
    paths = recorded_in_steps(spools, 5)
    assert sum(path.stat().st_size for path in paths) < 80_000
    assert int(metadata(paths[0])["part"]) > 1


def test_by_time(tmp_path):
    spools = Spools(tmp_path, port("1-left", "left"), rotate_ns=1_000_000_000)
    for n in range(50):
        spools.data("1-left", 100 * n, sum8("FA 01 32"))
    spools.end(6000)
    paths = recorded_in_steps(spools, 1)
    assert 4 <= len(paths) <= 6


def test_what_somebody_else_wrote_is_not_replaced(tmp_path):
    spools = Spools(tmp_path, port("1-left", "left"))
    spools.log.write_bytes(b"mine")
    with pytest.raises(UsageError, match="exists, and a recording replaces no file"):
        Recorder(spools.folder)
    assert spools.log.read_bytes() == b"mine"


def test_names(tmp_path):
    assert part_path(tmp_path / "week.mcap", 3).name == "week-0003.mcap"
    assert base_of(tmp_path / "week-0003.mcap").name == "week.mcap"
    assert base_of(tmp_path / "week.mcap").name == "week.mcap"


def test_a_folder_with_two_recordings(tmp_path, cli):
    for name in ("a.mcap", "b.mcap"):
        spools = Spools(tmp_path, port("1-left", "left"), name=name, late_ns=1_000_000_000)
        spools.data("1-left", 1, sum8("FA 01 32"))
        spools.end(10)
        if name == "b.mcap":
            told = config.load(spools.folder)
            import msgspec

            msgspec.structs.replace(told, anchor_utc_ns=told.anchor_utc_ns + 1).save(spools.folder)
        spools.record()
    assert "holds 2 recordings, name one of them" in cli("show", tmp_path, status=2).err
