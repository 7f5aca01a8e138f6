"""Logs made whole: with their spools nothing is lost, without them all that can be read is kept and the rest is told."""

from __future__ import annotations

import io
import os
import random
import shutil
import struct
import zlib
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Header, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from analyzer.cli import main
from analyzer.live.lock import RUNNING, Lock
from analyzer.sinks.mcap_chunk import record_bytes
from analyzer.sinks.mcap_repair import repair
from analyzer.sinks.mcap_sound import is_whole
from analyzer.sources import magic
from analyzer.sources.mcap_scan import HEAD
from tests.collect import sum8
from tests.live.spooled import Spools, content, decoded_of, port, raw_of, read
from tests.live.test_recorder_killed import ARM, LEFT, RIGHT, fill
from tests.logs import metadata


def killed(tmp_path, steps=300, **about):
    """A recording that was killed in the midst, with its spools; and the same that ran to its end."""
    folders = [tmp_path / name for name in ("straight", "killed")]
    for folder in folders:
        folder.mkdir(parents=True)
    straight, broken = (Spools(folder, LEFT, RIGHT, ARM, **about) for folder in folders)
    for spools in (straight, broken):
        fill(spools, 11)
    straight.record()
    broken.record_and_be_killed(steps, flush_every=100)
    return straight, broken


def test_with_its_spools_nothing_is_lost(tmp_path, cli):
    straight, broken = killed(tmp_path)
    assert not is_whole(broken.log)
    assert "whole; went on where the recording had stopped" in cli("recover", str(broken.log)).out
    assert content(broken.log) == content(straight.log)
    assert not broken.folder.exists()
    assert "nothing was changed" in cli("recover", str(broken.log)).out


def test_on_a_copy_all_stays_as_it_was(tmp_path, cli):
    straight, broken = killed(tmp_path)
    before = broken.log.read_bytes(), sorted(p.name for p in broken.folder.iterdir())
    out = tmp_path / "whole.mcap"
    assert main(["recover", str(broken.log), "-o", str(out)]) == 0
    assert content(out) == content(straight.log)
    assert (broken.log.read_bytes(), sorted(p.name for p in broken.folder.iterdir() if p.name != RUNNING)) == before
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
    assert "--force" in cli("recover", str(broken.log), "-o", out, status=2).err


@pytest.mark.parametrize("about", [{}, {"rotate_bytes": 1 << 30}])
def test_a_copy_under_another_name_is_what_is_gone_on_with(about, tmp_path, cli):
    straight, broken = killed(tmp_path, **about)
    (part,) = broken.log.parent.glob("out*.mcap")
    before = part.read_bytes()
    copy = part.with_name(part.name.replace("out", "copy"))
    shutil.copy(part, copy)
    shutil.copytree(broken.folder, broken.folder.with_name("copy.mcap.spool"))
    assert f"{copy.name}: whole; went on" in cli("recover", str(copy)).out
    assert content(copy) == content(straight.log.with_name(part.name))
    assert part.read_bytes() == before


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to(path.name)])
@pytest.mark.parametrize("name", ["checkpoint.0", "decoding.lock", "other"])
def test_what_is_no_file_among_the_spools_is_told_before_anything_is_done(name, make, tmp_path, cli):
    _, broken = killed(tmp_path)
    path = broken.folder / name
    path.unlink(missing_ok=True)
    make(path)
    before = broken.log.read_bytes(), sorted(broken.log.parent.iterdir())
    assert f"{name} is not a regular file" in cli("recover", str(broken.log), status=2).err
    assert (broken.log.read_bytes(), sorted(broken.log.parent.iterdir())) == before


def test_not_while_it_runs(tmp_path, capsys):
    _, broken = killed(tmp_path)
    with Lock(broken.folder, RUNNING, shared=True):
        assert main(["recover", str(broken.log)]) == 2
    assert "is being recorded" in capsys.readouterr().err


def test_a_log_that_was_cut_is_written_anew_from_spools_that_hold_it_all(tmp_path, cli):
    straight, broken = killed(tmp_path)
    broken.log.write_bytes(broken.log.read_bytes()[:3000])
    assert "it was cut or replaced" in cli("recover", str(broken.log)).out
    assert content(broken.log) == content(straight.log)
    assert sorted(p.name for p in broken.log.parent.iterdir()) == ["out.mcap"]


def test_another_log_under_the_name_stays_as_it_is(tmp_path, cli):
    straight, broken = killed(tmp_path)
    with broken.log.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        writer.add_attachment(1, 1, "a.bin", "", random.Random(1).randbytes(100_000))
        writer.finish()
    foreign = broken.log.read_bytes()
    assert "is not the log of this recording" in cli("recover", str(broken.log)).out
    assert broken.log.read_bytes() == foreign
    assert content(broken.log.with_name("out-spools.mcap")) == content(straight.log)


def test_without_its_spools_what_was_flushed_is_kept(tmp_path, cli):
    straight, broken = killed(tmp_path)
    broken.folder.rename(tmp_path / "away")
    said = cli("recover", str(broken.log)).out
    assert "whole;" in said
    assert is_whole(broken.log)
    whole, saved = content(straight.log), content(broken.log)
    assert len(saved) > 100
    assert saved == whole[: len(saved)]
    about = metadata(broken.log)
    assert about["incomplete"] == "the recording was killed"
    assert about["bus.left.endpoint"] == "serial:/dev/ttyUSB0"
    assert raw_of([broken.log], "left") == straight.sent["left"][: len(raw_of([broken.log], "left"))]


def whole_log(tmp_path, count=4000):
    spools = Spools(tmp_path, port("1-left", "left"))
    for n in range(count):
        spools.data("1-left", 5 * n, sum8("FA 01 32") if n % 2 == 0 else sum8(f"FB 01 32 {n % 256:02X} D4"))
    spools.end(6 * count)
    spools.record_in_chunks(200)
    shutil.rmtree(spools.folder)
    return spools


def messages(data):
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [(c.topic, m.sequence, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]


def repaired(path):
    out = io.BytesIO()
    outcome = repair(path, out)
    return outcome, messages(out.getvalue())


def test_cut_anywhere(tmp_path):
    """A log cut at any place keeps all messages before the cut, also those of a torn chunk."""
    spools = whole_log(tmp_path)
    data = spools.log.read_bytes()
    wanted = messages(data)
    chance = random.Random(3)
    kept_before = -1
    for cut in sorted(chance.sample(range(200, len(data)), 25)):
        spools.log.write_bytes(data[:cut])
        outcome, kept = repaired(spools.log)
        assert kept == wanted[: len(kept)]
        assert len(kept) >= kept_before
        assert outcome.faults
        kept_before = len(kept)
    assert kept_before > 0.9 * len(wanted)


def test_a_torn_chunk_is_read_as_far_as_it_goes(tmp_path):
    path = tmp_path / "big.mcap"
    chance = random.Random(1)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=1 << 22)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b'{"type":"object"}')
        channel = writer.register_channel("/x", "json", schema)
        for n in range(20000):
            writer.add_message(channel, n, b'{"x":"%b"}' % chance.randbytes(20).hex().encode(), n, n)
        writer.finish()
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    outcome, kept = repaired(path)
    assert len(kept) > 5000
    assert "a truncated chunk" in str(outcome.faults[0])


def test_garbage_at_the_end_and_in_the_midst(tmp_path):
    spools = whole_log(tmp_path)
    data = spools.log.read_bytes()
    wanted = messages(data)
    summary = make_reader(io.BytesIO(data)).get_summary()
    seam = summary.chunk_indexes[3].chunk_start_offset
    for garbage in (b"\0" * 500, random.Random(1).randbytes(5000), b"\x06" * 100):
        spools.log.write_bytes(data[:seam] + garbage + data[seam:])
        outcome, kept = repaired(spools.log)
        assert kept == wanted
        assert [(f.offset, f.size) for f in outcome.faults if f.size] == [(seam, len(garbage))]
        last = summary.chunk_indexes[-1]
        end = last.chunk_start_offset + last.chunk_length
        spools.log.write_bytes(data[:end] + garbage)
        outcome, kept = repaired(spools.log)
        assert kept == wanted


def test_a_damaged_chunk_costs_that_chunk_and_is_told(tmp_path, cli):
    spools = whole_log(tmp_path)
    data = bytearray(spools.log.read_bytes())
    wanted = messages(bytes(data))
    index = make_reader(io.BytesIO(bytes(data))).get_summary().chunk_indexes[10]
    at = index.chunk_start_offset + 200
    data[at : at + 8] = bytes(8)
    spools.log.write_bytes(bytes(data[:-50]))
    outcome, kept = repaired(spools.log)
    assert 0 < len(kept) < len(wanted)
    assert set(kept) < set(wanted)
    assert "is damaged" in str(outcome.faults[0])
    assert "is damaged" in cli("recover", str(spools.log)).out
    assert messages(spools.log.read_bytes()) == kept


def test_lost_declarations_do_not_lose_messages(tmp_path):
    """The first chunk declares the topics; what follows it is still there."""
    spools = whole_log(tmp_path)
    data = bytearray(spools.log.read_bytes())
    chunks = make_reader(io.BytesIO(bytes(data))).get_summary().chunk_indexes
    first = chunks[0]
    data[first.chunk_start_offset + 80 : first.chunk_start_offset + 100] = bytes(20)
    wanted = messages(spools.log.read_bytes())
    # With the old summary the topics are known; without it they are not, but their messages are kept.
    spools.log.write_bytes(bytes(data))
    _, kept = repaired(spools.log)
    assert set(kept) < set(wanted)
    spools.log.write_bytes(bytes(data[:-30]))
    outcome, kept = repaired(spools.log)
    assert {m[3] for m in kept} < {m[3] for m in wanted}
    assert any(topic.startswith("/lost/") for topic, *_ in kept)
    assert any("declaration of channel" in str(f) for f in outcome.faults)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
@pytest.mark.parametrize("chunked", [True, False])
def test_logs_of_other_programs(tmp_path, compression, chunked):
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, use_chunking=chunked, chunk_size=1000)
        writer.start("ros2", "other 1.0")
        schema = writer.register_schema("x", "jsonschema", b'{"type":"object"}')
        channel = writer.register_channel("/x", "json", schema)
        writer.add_attachment(1, 1, "a.txt", "text/plain", b"hello")
        writer.add_metadata("about", {"a": "b"})
        for n in range(200):
            writer.add_message(channel, n, b'{"x":%d}' % n, n, n)
        writer.finish()
    data = path.read_bytes()
    wanted = messages(data)
    path.write_bytes(data[:-100])
    out = io.BytesIO()
    outcome = repair(path, out)
    kept = messages(out.getvalue())
    assert kept == wanted[: len(kept)]
    assert len(kept) >= 190
    reader = make_reader(io.BytesIO(out.getvalue()))
    assert reader.get_header().profile == "ros2"
    assert [a.data for a in reader.iter_attachments()] == [b"hello"]
    assert {m.name for m in reader.iter_metadata()} == {"about", "servotap.recovered"}
    assert outcome.messages == len(kept)


def test_what_is_no_log(tmp_path, cli):
    path = tmp_path / "x.mcap"
    path.write_bytes(b"hello")
    assert "is not an MCAP log" in cli("recover", path, status=2).err
    assert path.read_bytes() == b"hello"
    assert main(["recover", str(tmp_path / "none.mcap")]) == 2


def test_a_recording_in_parts(tmp_path):
    straight, broken = killed(tmp_path, rotate_bytes=1 << 30)
    part = broken.log.with_name("out-0001.mcap")
    assert part.exists()
    assert main(["recover", str(part)]) == 0
    assert content(part) == content(straight.log.with_name("out-0001.mcap"))
    assert decoded_of([part], "left") == broken.sent["left"]
    assert read(part)


def test_a_recording_in_parts_without_its_checkpoints(tmp_path, cli):
    _, broken = killed(tmp_path, rotate_bytes=1 << 30)
    for path in broken.folder.glob("checkpoint.*"):
        path.unlink()
    assert "there is no checkpoint" in cli("recover", str(broken.log)).out
    part, rest = broken.log.with_name("out-0001.mcap"), broken.log.with_name("out-spools.mcap")
    assert sorted(broken.log.parent.glob("out*")) == [part, rest]
    assert is_whole(part)
    assert decoded_of([rest], "left") == broken.sent["left"]


def test_killed_when_the_log_was_whole_and_its_spools_still_there(tmp_path):
    spools = Spools(tmp_path, LEFT, RIGHT, ARM)
    fill(spools, 2)
    recording = spools.begin()
    while not recording.merger.drained:
        recording.take(recording.merger.take(None))
        recording.settle(recording.merger.horizon_ns)
        recording.flush()
    recording.finish(lambda step: step())
    whole = content(spools.log)
    assert main(["recover", str(spools.log)]) == 0
    assert content(spools.log) == whole
    assert not spools.folder.exists()


def test_a_private_log_stays_private(tmp_path):
    for name, act in (("alone", shutil.rmtree), ("spools", lambda folder: (folder / "index.0001").unlink())):
        _, broken = killed(tmp_path / name)
        act(broken.folder)
        broken.log.chmod(0o600)
        assert main(["recover", str(broken.log)]) == 0
        assert broken.log.stat().st_mode & 0o777 == 0o600


def record(opcode, body):
    return HEAD.pack(opcode, len(body)) + body


#: Records in a chunk that the `mcap` library cannot read, by what is wrong with them.
UNREADABLE = {
    "a message without its times": record(Opcode.MESSAGE, b"\1\0\0\0"),
    "a schema that breaks off": record(Opcode.SCHEMA, b"\2\0\xff\0\0\0x"),
    "a topic that is no text": record(Opcode.CHANNEL, b"\2\0\0\0\1\0\0\0\xff\0\0\0\0\0\0\0\0"),
    "a channel that is too long": record(Opcode.CHANNEL, b"\2\0\0\0\1\0\0\0x\0\0\0\0\0\0\0\0more"),
}


@pytest.mark.parametrize("what", UNREADABLE)
@pytest.mark.parametrize("place", ["first", "middle", "last"])
def test_what_the_library_cannot_read_in_a_chunk_is_left_out_and_counted(tmp_path, cli, what, place):
    bad = UNREADABLE[what]
    wanted = [(n, b'{"x":%d}' % n) for n in range(20)]
    inner = [record(Opcode.CHANNEL, b"\1\0\0\0\2\0\0\0/x\4\0\0\0json\0\0\0\0")]
    inner += [record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, n, n, n) + data) for n, data in wanted]
    at = {"first": 0, "middle": 11, "last": len(inner)}[place]
    data = b"".join([*inner[:at], bad, *inner[at:]])
    path = tmp_path / "x.mcap"
    chunk = Chunk(
        compression="", data=data, message_start_time=0, message_end_time=19,
        uncompressed_crc=zlib.crc32(data), uncompressed_size=len(data),
    )  # fmt: skip
    path.write_bytes(magic.MCAP + record_bytes(Header("", "")) + record_bytes(chunk))
    said = cli("recover", path).out
    assert "left out of a chunk: 1 damaged record" in said
    assert f"{len(bad)} bytes of x.mcap in total" in said
    found = path.read_bytes()
    assert [(sequence, text) for _, sequence, _, text in messages(found)] == wanted
    # A reader that does not seek reads all of it, too.
    assert sum(isinstance(each, Message) for each in StreamReader(io.BytesIO(found), validate_crcs=True).records) == 20
    assert "nothing was changed" in cli("recover", path).out
