"""A place that cannot be written costs no command more than one line and status 2, and leaves nothing there."""

from __future__ import annotations

import errno
import io
import os
import tempfile
from pathlib import Path

import pytest

from analyzer.cli import output
from analyzer.cli.output import Output, OutputFolder
from analyzer.errors import UsageError
from analyzer.system.scratch import fcntl
from tests import CAPTURES

CAPTURE, LOG = str(CAPTURES / "mks_can.candump.log"), str(CAPTURES / "mks_rs485.mcap")
#: Every command that writes what it is told to, with the ending of the file.
WRITERS = {
    "decode": (["decode", CAPTURE, "-o"], ".mcap"),
    "decode to Parquet": (["decode", CAPTURE, "--to", "parquet", "-o"], ""),
    "export": (["export", CAPTURE, "-o"], ".csv"),
    "export wide": (["export", CAPTURE, "--wide", "-o"], ".csv"),
    "export to Parquet": (["export", CAPTURE, "-o"], ".parquet"),
    "export to Excel": (["export", CAPTURE, "-o"], ".xlsx"),
    "export to candump": (["export", CAPTURE, "--to", "candump", "-o"], ".log"),
    "plot": (["plot", CAPTURE, "*", "-o"], ".svg"),
    "report": (["report", CAPTURE, "-o"], ".html"),
    "wireshark": (["wireshark", "-o"], ".lua"),
    "cut": (["cut", LOG, "--since", "+1ms", "-o"], ".mcap"),
    "recover": (["recover", LOG, "-o"], ".mcap"),
    "emulate": (["emulate", "mks-rs485@1", "--tcp", "127.0.0.1:0", "--duration", "0.1", "--log"], ".mcap"),
    "record": (["record", "tcp:127.0.0.1:1", "--duration", "0.1", "-o"], ".mcap"),
    "tap": (["tap", "tcp:127.0.0.1:1,baud=38400", "--link", "none/link", "--duration", "0.1", "-o"], ".mcap"),
}


def _read_only(monkeypatch, folder):
    """Have a folder refuse files, as one of a read-only disk does: also to root, whom no permission stops."""
    make, may, make_folder, open_file = os.open, os.access, tempfile.mkdtemp, io.open

    def refused(path, flags, *mode, **how):
        if flags & os.O_CREAT and Path(os.fsdecode(path)).is_relative_to(folder):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
        return make(path, flags, *mode, **how)

    def no_folder(*_, dir=None, **how):
        if dir == folder:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(dir))
        return make_folder(*_, dir=dir, **how)

    def opened(file, mode="r", *rest, **how):
        if set("wax") & set(mode) and not isinstance(file, int) and Path(file).is_relative_to(folder):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(file))
        return open_file(file, mode, *rest, **how)

    monkeypatch.setattr(os, "open", refused)
    monkeypatch.setattr(io, "open", opened)
    monkeypatch.setattr("builtins.open", opened)
    monkeypatch.setattr(os, "access", lambda path, mode, **how: Path(path) != folder and may(path, mode, **how))
    monkeypatch.setattr(tempfile, "mkdtemp", no_folder)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("place", ["read-only", "missing", "a file"])
def test_a_place_that_cannot_be_written_is_told_in_a_line(name, place, tmp_path, monkeypatch, cli):
    words, ending = WRITERS[name]
    folder = tmp_path / "there"
    if place == "a file":
        folder.write_text("x")
    elif place == "read-only":
        folder.mkdir()
        _read_only(monkeypatch, folder)
    said = cli(*words, str(folder / f"out{ending}"), status=2)
    monkeypatch.undo()
    assert said.err.count("\n") == 1
    assert str(folder) in said.err
    assert "fault" not in said.err
    assert not folder.is_dir() or list(folder.iterdir()) == []


@pytest.mark.parametrize(("fault", "status"), [("", 2), (",fault=checksum-wrong", 1)])
def test_no_verdict_is_lost_on_a_full_disk(fault, status, tmp_path, monkeypatch, cli):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(Output, "keep", lambda self: (_ for _ in ()).throw(full))
    outputs = {"--report": "r.html", "--junitxml": "j.xml", "--write-baseline": "b.json", "--log": "l.mcap"}
    words = [word for option, file in outputs.items() for word in (option, str(tmp_path / file))]
    said = cli("test", f"mks-rs485@1{fault}", "--claim", "*/shape/read_speed/checksum", *words, "--jobs", "1", status=status)
    assert "1 of 1 claims ran" in said.out
    for file in outputs.values():
        assert said.err.count(f"cannot write {tmp_path / file}: No space left on device") == 1
    assert len(said.err.splitlines()) == len(outputs)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(fcntl is None, reason="a system without locks on files")
@pytest.mark.parametrize("kind", [Output, OutputFolder])
def test_what_a_killed_process_left_goes_when_the_same_file_is_written_again(kind, tmp_path):
    target, other = tmp_path / "a.mcap", tmp_path / ".b.mcap.abcdefgh.part"
    living = kind(target, replace=True)
    left = tmp_path / ".a.mcap.abcd_012.part"
    left.mkdir() if kind is OutputFolder else left.write_bytes(b"half of a log")
    for mine in (other, tmp_path / ".a.mcap.part", tmp_path / ".a.mcap.thesis.part"):
        mine.write_bytes(b"of the user")
    os.mkfifo(tmp_path / ".a.mcap.fifofifo.part")
    output._parts_in.cache_clear()
    again = kind(target, replace=True)
    assert not left.exists()
    assert living.part.exists(), "its process lives"
    assert len(list(tmp_path.glob(".*.part"))) == 6
    living.drop()
    again.keep()
    assert target.exists()


@pytest.mark.parametrize("kind", [Output, OutputFolder])
def test_what_another_program_created_meanwhile_stays(kind, tmp_path):
    target = tmp_path / "a"
    mine, other = kind(target, replace=False), kind(target, replace=False)
    for each in (mine, other):
        (each.part / "x.parquet" if kind is OutputFolder else each.part).write_bytes(str(each is mine).encode())
    other.keep()
    with pytest.raises(UsageError, match="was created by another program meanwhile; --force replaces it"):
        mine.keep()
    mine.drop()
    assert (target / "x.parquet" if kind is OutputFolder else target).read_bytes() == b"False"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("kind", [Output, OutputFolder])
@pytest.mark.parametrize("call", ["chmod", "unlink"])
def test_a_medium_without_permissions_or_that_keeps_what_is_removed_takes_what_is_written(kind, call, tmp_path, monkeypatch):
    target = tmp_path / "table"
    output = kind(target, replace=False)

    def refused(self, *words, **how):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM), str(self))

    monkeypatch.setattr(Path, call, refused)
    output.keep()
    assert target.exists()
