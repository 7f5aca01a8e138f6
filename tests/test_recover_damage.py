"""Any damaged byte, any prefix: `recover` ends, the `mcap` library reads what it made, and only what was hit is missing."""

from __future__ import annotations

import functools
import os
import random
import tempfile
from pathlib import Path

import pytest
from mcap.reader import make_reader

from analyzer.cli import main
from analyzer.cli.recover import _unbroken
from analyzer.live.spool import HEAD, RecordKind, SpoolReader, SpoolWriter, pack, segments, stems
from analyzer.sources.stream import ZSTD_MAGIC
from tests import CAPTURES
from tests.collect import sum8
from tests.fuzz.corpus import lay_out
from tests.live.spooled import Spools, port, read

LOG = "out.mcap"
SPOOL = f"{LOG}.spool"
#: Damaged bytes of each kind of file that are tried; all of them take minutes.
TRIED = 6


def frames(count):
    """Frames that are all different."""
    return [sum8(f"FB 01 32 {n >> 8:02X} {n & 255:02X}").replace(" ", "").upper() for n in range(count)]


@functools.cache
def killed(whole):
    """The files of a recording that was killed, and its frames. `whole`: its spools hold it from the beginning."""
    sent = frames(160)
    with tempfile.TemporaryDirectory() as folder:
        spools = Spools(folder, port("1-left", "left", byte_ns=260_416), segment_size=1 << 20 if whole else 500)
        for n, frame in enumerate(sent):
            spools.data("1-left", 10 * n, frame)
        spools.close()
        spools.record_and_be_killed(110, flush_every=20)
        found = {str(p.relative_to(folder)): p.read_bytes() for p in sorted(Path(folder).rglob("*")) if p.is_file()}
    return found, set(sent)


def frames_in(path):
    """The frames of a log as they came, also where their declarations are lost."""
    raw = [v["_raw"] for topic, _, v in read(path) if topic.endswith("/raw") or ("/lost/" in topic and "_raw" in v)]
    return {each.replace(" ", "") for each in raw}


def recovered(files, folder):
    """The frames of all logs there are after `recover`, each of which the library reads."""
    lay_out(files, folder)
    assert main(["recover", str(folder / LOG)]) == 0
    assert not list(folder.glob("*.spool"))
    found = set()
    for path in folder.glob("*.mcap"):
        with path.open("rb") as stream:
            make_reader(stream, validate_crcs=True).get_summary()
        found |= frames_in(path)
    return found


def in_chunk(data, at, folder):
    """The frames of the chunk of a log in which a place lies."""
    path = folder / "before.mcap"
    path.write_bytes(data)
    assert main(["recover", str(path)]) == 0
    path_data = path.read_bytes()
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    found = set()
    for chunk in chunks:
        # `recover` copies chunks unchanged.
        start = data.find(path_data[chunk.chunk_start_offset : chunk.chunk_start_offset + chunk.chunk_length])
        if 0 <= start <= at < start + chunk.chunk_length:
            found = {
                v["_raw"].replace(" ", "")
                for topic, message, v in read(path)
                if topic.endswith("/raw") and chunk.message_start_time <= message.log_time <= chunk.message_end_time
            }
    path.unlink()
    return found


def record_at(data, at):
    """The frame of the record of a spool in which a place lies, as a set."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "1-left.000000.raw").write_bytes(data)
        records = list(SpoolReader(Path(folder), "1-left").read())
    return {r.data.hex().upper() for r in records if r.end - len(r.data) - HEAD.size <= at < r.end}


@pytest.mark.parametrize("whole", [True, False], ids=["spools-hold-all", "spools-hold-the-end"])
@pytest.mark.parametrize("kind", ["checkpoint", "index", "recording", "raw", LOG])
def test_a_damaged_byte_costs_what_it_hit(tmp_path, kind, whole):
    files, sent = killed(whole)
    chance = random.Random(f"{kind} {whole}")
    names = [name for name in files if kind in Path(name).name]
    assert names
    for number in range(TRIED):
        name = chance.choice(names)
        at = chance.randrange(len(files[name]))
        data = bytearray(files[name])
        data[at] ^= 1 << chance.randrange(8)
        folder = tmp_path / str(number)
        folder.mkdir()
        found = recovered({**files, name: bytes(data)}, folder)
        hit = set()
        if kind == "raw":
            hit = record_at(files[name], at)
        elif kind == LOG and not whole:
            hit = in_chunk(files[name], at, folder)
        assert sent - found <= hit, f"{name} byte {at}"


@pytest.mark.parametrize("whole", [True, False], ids=["spools-hold-all", "spools-hold-the-end"])
def test_the_end_of_a_log_that_is_zeros_costs_at_most_that(tmp_path, whole, capsys):
    """As after a loss of power. The folder goes only when what was in it can be read elsewhere."""
    files, sent = killed(whole)
    cut = len(files[LOG]) - 2500
    found = recovered({**files, LOG: files[LOG][:cut] + bytes(2500)}, tmp_path)
    assert "cannot be gone on with" in capsys.readouterr().out
    if whole:
        assert found == sent
    else:
        assert len(sent - found) < 60
        assert frames(160)[-1] in found


def test_any_prefix_of_a_log_recovers(tmp_path):
    data = killed(True)[0][LOG]
    before = -1
    for number, cut in enumerate(sorted(random.Random(5).sample(range(8, len(data)), TRIED))):
        folder = tmp_path / str(number)
        folder.mkdir()
        found = recovered({LOG: data[:cut]}, folder)
        assert len(found) >= before
        before = len(found)
    assert before > 60


def test_a_frame_of_zstd_that_promises_a_check_at_its_end_keeps_its_messages(tmp_path):
    """One bit says that a check follows the data: all data is there, and yet the library reads none of it."""
    whole = tmp_path / "whole.mcap"
    assert main(["decode", "captures/mks_rs485.log", "-o", str(whole)]) == 0
    data = bytearray(whole.read_bytes())
    begin = data.index(ZSTD_MAGIC)
    data[begin + len(ZSTD_MAGIC)] ^= 0x04
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    assert main(["recover", str(damaged)]) == 0
    assert read(damaged) == read(whole)


def test_a_stray_file_is_no_spool(tmp_path):
    files, sent = killed(True)
    for name in ("notes.raw", "x.000000.raw", "-1-x.0.raw"):
        files = {**files, f"{SPOOL}/{name}": b"anything"}
    lay_out(files, tmp_path)
    assert stems(tmp_path / SPOOL) == ["1-left"]
    assert main(["recover", str(tmp_path / LOG)]) == 0
    assert frames_in(tmp_path / LOG) == sent


@pytest.mark.parametrize("pattern", ["recording*.json", "checkpoint.?", "*.raw"])
def test_what_is_missing_is_said_with_what_to_do(tmp_path, pattern, capsys, cli):
    files, sent = killed(True)
    files = {name: data for name, data in files.items() if not Path(name).match(pattern)}
    if pattern == "recording*.json":
        lay_out(files, tmp_path)
        assert "repairs the log alone" in cli("recover", tmp_path / LOG, status=2).err
        assert (tmp_path / LOG).read_bytes() == files[LOG]
        return
    found = recovered(files, tmp_path)
    if pattern == "checkpoint.?":
        assert "there is no checkpoint" in capsys.readouterr().out
        assert found == sent
    else:
        assert len(found) >= 100


@pytest.mark.parametrize(
    ("befores", "deleted", "unbroken"),
    [
        ((0, 2, 4), (), True),
        ((0, 2, 4), (0,), False),
        ((0, 2, 4), (1,), False),
        ((0, 2, 6), (), False),
        ((4,), (), False),
        ((), (), False),
    ],
)
def test_spools_hold_all_of_a_recording_where_nothing_is_missing_in_their_count(befores, deleted, unbroken, tmp_path):
    writer = SpoolWriter(tmp_path, "1-a", segment_size=1)
    for before in befores:
        writer.write(pack(RecordKind.DATA, before, before, b"xx"))
    for number in deleted:
        dict(segments(tmp_path, "1-a"))[number].unlink()
    assert _unbroken(tmp_path, "1-a") is unbroken


@pytest.mark.parametrize("name", [".", "", "./", "/"])
def test_a_folder_is_no_log(name, tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    assert "is a folder, expected a log" in cli("recover", name, status=2).err


@pytest.mark.parametrize("command", ["recover", "decode", "test"])
def test_what_is_no_file_is_not_replaced(command, tmp_path, cli):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    link = tmp_path / "link"
    link.symlink_to(fifo)
    capture = str(CAPTURES / "mks_rs485.mcap")
    for target in map(str, (fifo, link)):
        words = (
            [capture, "-o", target]
            if command != "test"
            else ["mks-rs485@1", "--claim", "*/shape/read_speed/code", "--log", target]
        )
        assert "is not a regular file" in cli(command, *words, "--force", status=2).err
    assert fifo.is_fifo()


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file that fails to be read")
def test_a_log_that_the_disk_does_not_give_is_named(capsys):
    assert main(["recover", "/proc/self/mem"]) == 2
    assert capsys.readouterr().err == "servotap recover: /proc/self/mem: reading failed: Input/output error\n"
