"""The spool: written records are read in order, from any place, after any end of the writer."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer.live import spool
from analyzer.live.spool import (
    HEAD,
    RecordKind,
    SpoolReader,
    SpoolWriter,
    last_record,
    pack,
    pack_can,
    pack_event,
    segments,
    spool_folder,
    stems,
)

STEM = "1-left"
TIMES = st.integers(0, spool.NEVER_NS - 1)
RECORDS = st.lists(st.tuples(st.sampled_from(list(RecordKind)), TIMES, TIMES, st.binary(max_size=60)), max_size=30)


def plain(records):
    return [(r.kind, r.t_ns, r.before, r.data) for r in records]


def write_all(folder, records, segment_size=spool.SEGMENT_SIZE):
    writer = SpoolWriter(folder, STEM, segment_size=segment_size)
    for record in records:
        writer.write(pack(*record))
    writer.close()


@given(RECORDS, st.integers(1, 300), st.integers(1, 200))
def test_what_was_written_is_read_whatever_the_segments_and_the_portions(tmp_path_factory, records, segment_size, most):
    folder = tmp_path_factory.mktemp("spool")
    write_all(folder, records, segment_size)
    reader = SpoolReader(folder, STEM)
    found = []
    while part := list(reader.read(most)):
        found += part
    reader.close()
    assert plain(found) == records
    assert reader.damaged == 0


@given(RECORDS, st.integers(1, 300), st.data())
def test_reading_goes_on_at_any_record(tmp_path_factory, records, segment_size, data):
    folder = tmp_path_factory.mktemp("spool")
    write_all(folder, records, segment_size)
    whole = list(SpoolReader(folder, STEM).read())
    at = data.draw(st.integers(0, len(whole)))
    start = (whole[at - 1].segment, whole[at - 1].end) if at else None
    assert plain(SpoolReader(folder, STEM, start).read()) == records[at:]


@given(RECORDS, st.integers(1, 300), st.data())
def test_a_reader_that_stops_in_the_midst_loses_nothing(tmp_path_factory, records, segment_size, data):
    folder = tmp_path_factory.mktemp("spool")
    write_all(folder, records, segment_size)
    reader = SpoolReader(folder, STEM)
    found = []
    while True:
        portion = reader.read()
        wanted = data.draw(st.integers(1, 5))
        taken = [record for _, record in zip(range(wanted), portion, strict=False)]
        portion.close()
        if not taken:
            break
        found += taken
        assert reader.position == (taken[-1].segment, taken[-1].end)
    assert plain(found) == records


@given(RECORDS.filter(bool), st.data())
def test_damage_costs_no_record_but_those_it_hit(tmp_path_factory, records, data):
    folder = tmp_path_factory.mktemp("spool")
    write_all(folder, records)
    path = segments(folder, STEM)[0][1]
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    reader = SpoolReader(folder, STEM)
    hit = next(i for i, end in enumerate(_ends(records)) if at < end)
    assert plain(reader.read(final=True)) == records[:hit] + records[hit + 1 :]
    assert reader.damaged == HEAD.size + len(records[hit][3])


def _ends(records):
    end = 0
    for _, _, _, data in records:
        end += HEAD.size + len(data)
        yield end


@pytest.mark.parametrize("cut", [1, HEAD.size - 1, HEAD.size, HEAD.size + 2])
def test_half_a_record_of_a_killed_writer_is_skipped_and_counted(tmp_path, cut):
    write_all(tmp_path, [(RecordKind.DATA, 1, 0, b"whole")])
    path = segments(tmp_path, STEM)[0][1]
    with path.open("ab") as file:
        file.write(pack(RecordKind.DATA, 2, 5, b"lost")[:cut])
    reader = SpoolReader(tmp_path, STEM)
    assert [r.data for r in reader.read()] == [b"whole"]
    assert [r.data for r in reader.read()] == []
    # A successor begins a segment of its own.
    write_all(tmp_path, [(RecordKind.DATA, 3, 9, b"after")])
    assert [r.data for r in reader.read()] == [b"after"]
    assert reader.damaged == cut


def test_a_reader_follows_while_it_is_written(tmp_path, monkeypatch):
    reader = SpoolReader(tmp_path, STEM)
    assert list(reader.read()) == []
    writer = SpoolWriter(tmp_path, STEM, segment_size=40)
    for number in range(5):
        writer.write(pack(RecordKind.DATA, number, 0, b"x" * 30))
        assert [r.t_ns for r in reader.read()] == [number]
        assert list(reader.read()) == []
    assert len(segments(tmp_path, STEM)) == 5
    with monkeypatch.context() as held:
        # What cannot be deleted ends nothing.
        held.setattr(Path, "unlink", lambda self: self.rmdir())
        reader.drop_before(reader.position[0])
    assert len(segments(tmp_path, STEM)) == 5
    reader.drop_before(reader.position[0])
    assert len(segments(tmp_path, STEM)) == 1


class Full:
    """A file on a disk that takes `room` bytes."""

    def __init__(self, file, room):
        self.file, self.room = file, room

    def write(self, data):
        part = data[: self.room]
        self.file.write(part)
        self.room -= len(part)
        if data and not part:
            raise OSError(28, "No space left on device")
        return len(part)

    def __getattr__(self, name):
        return getattr(self.file, name)


@pytest.mark.parametrize("room", range(27))
def test_on_a_full_disk_a_record_is_stored_whole_or_not_at_all(tmp_path, room):
    writer = SpoolWriter(tmp_path, STEM)
    writer.write(pack(RecordKind.DATA, 1, 0, b"a"))
    writer._file = Full(writer._file, room)
    with pytest.raises(OSError, match="No space"):
        writer.write(pack(RecordKind.DATA, 2, 1, b"second"))
    writer._file = writer._file.file
    writer.write(pack(RecordKind.DATA, 3, 1, b"third"))
    reader = SpoolReader(tmp_path, STEM)
    assert [r.data for r in reader.read()] == [b"a", b"third"]
    assert reader.damaged == 0


def test_a_file_size_limit_is_an_error_and_leaves_whole_records(tmp_path):
    code = (
        "import resource, sys; from pathlib import Path; from analyzer.live.spool import *\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        f"w = SpoolWriter(Path(sys.argv[1]), {STEM!r})\n"
        "try:\n"
        "    for n in range(100): w.write(pack(RecordKind.DATA, n, 0, b'x' * 50))\n"
        "except OSError as error: print(type(error).__name__, error.errno)\n"
    )
    done = subprocess.run([sys.executable, "-B", "-c", code, str(tmp_path)], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("OSError")
    reader = SpoolReader(tmp_path, STEM)
    found = list(reader.read())
    assert [r.t_ns for r in found] == list(range(1000 // (HEAD.size + 50)))
    assert reader.damaged == 0


def test_a_writer_killed_at_any_moment_leaves_whole_records(tmp_path):
    code = (
        "import sys; from pathlib import Path; from analyzer.live.spool import *\n"
        f"w = SpoolWriter(Path(sys.argv[1]), {STEM!r}, segment_size=4000)\n"
        "n = 0\n"
        "while True:\n"
        "    w.write(pack(RecordKind.DATA, n, n, n.to_bytes(4, 'big') * 30)); n += 1\n"
        "    if n == 100: print(flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE)
    process.stdout.readline()
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    found = list(SpoolReader(tmp_path, STEM).read(1 << 30))
    assert len(found) >= 100
    assert [r.t_ns for r in found] == list(range(len(found)))
    assert all(r.data == r.t_ns.to_bytes(4, "big") * 30 for r in found)
    assert last_record(tmp_path, STEM) == found[-1]


def test_the_last_record_is_found_behind_an_empty_segment(tmp_path):
    assert last_record(tmp_path, STEM) is None
    write_all(tmp_path, [(RecordKind.DATA, 1, 0, b"abc"), (RecordKind.EVENT, 2, 3, b"{}")])
    (tmp_path / f"{STEM}.000001.raw").write_bytes(b"")
    found = last_record(tmp_path, STEM)
    assert (found.kind, found.t_ns, found.before) == (RecordKind.EVENT, 2, 3)


def test_what_a_record_counts():
    def record(kind, data):
        return spool.Record(kind, 0, 10, data)

    assert record(RecordKind.DATA, b"abc").units == 3
    assert record(RecordKind.CAN, b"\0" * 13).units == 1
    assert record(RecordKind.EVENT, b"{}").units == 0
    assert record(RecordKind.IDLE, b"").units == 0


def test_a_can_record_and_an_event_come_back(tmp_path):
    writer = SpoolWriter(tmp_path, STEM)
    writer.write(pack_can(5, 7, 0x1FFFFFFF, spool.CanFlag.EXTENDED | spool.CanFlag.TX, b"\x01\x02"))
    writer.write(pack_event(6, 8, "lost", reason="unplugged"))
    frame, event = SpoolReader(tmp_path, STEM).read()
    assert frame.can == (0x1FFFFFFF, spool.CanFlag.EXTENDED | spool.CanFlag.TX, b"\x01\x02")
    assert (frame.t_ns, frame.before) == (5, 7)
    assert event.event == {"event": "lost", "reason": "unplugged"}


def test_spools_of_a_folder_by_their_numbers(tmp_path):
    for stem in ("10-a", "2-b", "0-control", "2-b.1"):
        SpoolWriter(tmp_path, stem).write(pack(RecordKind.IDLE, 0, 0, b""))
    assert stems(tmp_path) == ["0-control", "2-b", "2-b.1", "10-a"]
    assert len(segments(tmp_path, "2-b")) == 1
    assert spool_folder(tmp_path / "x.mcap") == tmp_path / "x.mcap.spool"


def test_a_number_of_a_segment_is_not_used_again_though_it_was_deleted(tmp_path):
    """Or a consumer goes on in a new segment at the place that it had reached in the old one."""
    first = SpoolWriter(tmp_path, STEM)
    first.write(pack(RecordKind.DATA, 1, 0, b"old"))
    reader = SpoolReader(tmp_path, STEM)
    assert [r.data for r in reader.read()] == [b"old"]
    first.close()
    for _, path in segments(tmp_path, STEM):
        path.unlink()
    SpoolWriter(tmp_path, STEM, first=1_000_000).write(pack(RecordKind.DATA, 2, 3, b"new"))
    assert [(r.segment, r.data) for r in reader.read()] == [(1_000_000, b"new")]
