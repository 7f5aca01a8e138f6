"""Bad input: each kind ends in a message or a finding, never in a traceback, and nothing readable is lost."""

from __future__ import annotations

import os
import random
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from analyzer.cli import main
from tests.collect import sum8

#: A user without rights, on every system that has root.
NOBODY = 65534
GOOD = bytes.fromhex(sum8("FA 01 32") + sum8("FB 01 32 00 64"))


def decode(tmp_path, capsys, data, *words, name="in.log"):
    path = tmp_path / name
    path.write_bytes(data)
    status = main(["decode", str(path), "-o", str(tmp_path / "out.mcap"), "--force", *words])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return status, captured.out, captured.err


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("empty.log", "empty.log is empty"),
        ("folder", "folder is a folder without files, expected captures"),
        ("nothing.log", "nothing.log: No such file or directory"),
        ("main.c", "main.c is not a recognised capture format"),
    ],
)
def test_what_cannot_be_read_is_told_in_one_line(name, said, tmp_path, cli):
    """How each kind of file is refused is proved in `tests/sources`."""
    (tmp_path / "empty.log").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "main.c").write_text('int main(void) {\n    printf("hello");\n    return 0;\n}\n')
    err = cli("decode", tmp_path / name, "-o", tmp_path / "o.mcap", status=2).err
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "o.mcap").exists()


@contextmanager
def not_as_root():
    """Root may read everything, so its rights are given up meanwhile."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(user)


def test_no_permission(capsys):
    # Not in `tmp_path`: run as root, its parent folder is closed to other users, and they could not reach the file.
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        path = Path(folder) / "secret.log"
        path.write_bytes(GOOD)
        # What is imported at the first run may be root's alone, too.
        assert main(["show", str(path)]) == 0
        path.chmod(0)
        with not_as_root():
            assert main(["show", str(path)]) == 2
    assert "permission" in capsys.readouterr().err.lower()


@pytest.mark.parametrize("dialect", ["auto", "mks-rs485", "mks-modbus", "lk-rs485", "mks-rs485,mks-modbus,lk-rs485"])
def test_random_bytes(tmp_path, capsys, dialect):
    data = random.Random(1).randbytes(200_000)
    status, out, _ = decode(tmp_path, capsys, data, "--dialect", dialect, "--format", "raw")
    assert status == 0
    assert "200000 bytes" in out


@pytest.mark.parametrize("byte", [0x00, 0x01, 0x3E, 0xFA, 0xFB, 0xFC, 0xFF])
def test_one_byte_over_and_over(tmp_path, capsys, byte):
    words = ("--dialect", "mks-rs485,mks-modbus,lk-rs485", "--format", "raw")
    status, out, _ = decode(tmp_path, capsys, bytes((byte,)) * 50_000, *words)
    assert status == 0
    assert "50000 bytes" in out


@pytest.mark.parametrize(
    "stamps",
    [
        ("2026-03-02T09:00:01.000", "2026-03-02T09:00:00.000"),
        ("1970-01-01T00:00:00.000", "1970-01-01T00:00:00.001"),
        ("2200-01-01T00:00:00.000", "2200-01-01T00:00:01.000"),
    ],
)
def test_impossible_times(tmp_path, capsys, stamps):
    data = f"{stamps[0]} > FA 01 32 2D\n{stamps[1]} < FB 01 32 00 64 92\n".encode()
    status, out, _ = decode(tmp_path, capsys, data)
    assert status == 0
    assert "read_speed" in out


def test_escapes_markup_and_html_are_text(tmp_path, cli):
    data = b"# \x1b[31mred\x1b[0m [bold]x[/bold] <script>\n(1.0) [/red] 001#F60140023A\n> FA 01 32 2D\n< FB 01 32 00 64 92\n"
    path = tmp_path / "\x1b[31m[bold]evil<b>.log"
    path.write_bytes(data)
    assert main(["decode", str(path), "-o", str(tmp_path / "o.mcap")]) == 0
    captured = cli("show", path)
    assert "\x1b[31m" not in captured.out + captured.err
    assert "[bold]" in captured.out


def test_bytes_before_a_fault_are_in_the_log(tmp_path, capsys):
    status, out, _ = decode(tmp_path, capsys, GOOD * 50 + b"\xfa\x01", "--dialect", "mks-rs485", "--format", "raw")
    assert status == 0
    assert "in 100 frames, 2 junk (2 truncated)" in out


def test_a_wrong_option_is_told_in_one_line_with_the_near_one(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["show", "--lmit", "3", "x"])
    assert ended.value.code == 2
    err = capsys.readouterr().err
    assert "unrecognized arguments: --lmit" in err
    assert "did you mean --limit? (see servotap show --help)" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("option", "text", "said"),
    [
        ("--dbc", "nothing\n", "wrong.txt:1:"),
        ("--modbus-map", "unit,address,name,type\n5,0,a,u99\n", "wrong.txt:2: type: expected u16"),
        ("--modbus-map", None, "wrong.txt: No such file"),
    ],
)
def test_a_recording_does_not_begin_with_a_wrong_file_of_devices(option, text, said, tmp_path, cli):
    if text is not None:
        (tmp_path / "wrong.txt").write_text(text)
    err = cli("record", "can:virtual:x", option, tmp_path / "wrong.txt", "-o", tmp_path / "x.mcap", status=2).err
    assert err.count("\n") == 1
    assert said in err
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["decode", "loop"], "loop is a symbolic link that leads back to itself, expected a capture file"),
        (["show", "dangling"], "dangling is a symbolic link to a file that does not exist, expected a capture file"),
        (["cut", "loop", "-o", "x.mcap"], "loop is a symbolic link that leads back to itself"),
        (["decode", "x.log", "-o", "loop"], "loop is a symbolic link that leads back to itself: remove it"),
        (["export", "x.log", "-o", "loop", "--to", "csv"], "loop is a symbolic link that leads back to itself: remove it"),
        (["cut", "x.mcap", "-o", "loop"], "loop is a symbolic link that leads back to itself: remove it"),
    ],
)
def test_links_that_lead_nowhere(words, said, tmp_path, cli, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop2")
    Path("loop2").symlink_to("loop")
    Path("dangling").symlink_to("nothing")
    Path("x.log").write_text("TX: FA 01 32 2D\n")
    cli("decode", "x.log", "-o", "x.mcap")
    assert said in cli(*words, status=2).err
