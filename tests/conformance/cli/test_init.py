"""`servotap init` and names in place of endpoints: emulated drives on a port whose every byte is logged."""

from __future__ import annotations

import signal
import tomllib

import pytest

from analyzer import cli as analyzer_cli
from analyzer import dialects
from analyzer.encoder import build
from analyzer.live import profile
from conformance.cli import init, scan, send, stop
from conformance.drives.serial_bus import SerialBus
from tests.conformance.drives.served import LoggedPty, drives, on_port

MKS = dialects.get("mks-rs485")


@pytest.fixture
def port(tmp_path, monkeypatch):
    """Two drives, one of which turns, and an empty folder."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    bus = SerialBus(drives("mks-rs485@1,work_mode=sr_vfoc", "mks-rs485@2,work_mode=sr_vfoc"))
    pty = LoggedPty(bus)
    with on_port(bus, pty) as path:
        yield path, pty


def run(module, *words):
    return analyzer_cli._run(module.__name__.rpartition(".")[2], module, words)


def test_a_profile_is_written_of_what_answers(port, tmp_path, capsys):
    path, _ = port
    assert run(init, f"left=serial:{path},baud=38400", "--addresses", "1-3") == 0
    written = tomllib.loads((tmp_path / "servotap.toml").read_text())
    assert written == {
        "bus": {"left": {"port": f"serial:{path}", "baud": 38400}},
        "drive": {f"left_{n}": {"bus": "left", "dialect": "mks-rs485", "address": n} for n in (1, 2)},
    }
    said = capsys.readouterr().out
    assert "wrote servotap.toml: left, left_1, left_2" in said
    assert "servotap record left --view" in said
    assert "servotap test left_1 --short" in said
    assert [each.target for each in profile.look_up("left").drives] == ["mks-rs485@1", "mks-rs485@2"]
    # It is not replaced unasked, and nothing is sent before that is known.
    assert run(init, f"left=serial:{path},baud=38400") == 2
    assert "servotap.toml exists; --force replaces it" in capsys.readouterr().err
    assert run(init, f"arm=serial:{path},baud=38400", "--addresses", "2", "--force") == 0
    assert profile.look_up("arm").drives[0].target == "mks-rs485@2"


def test_a_profile_that_another_program_writes_during_the_search_is_kept(port, tmp_path, capsys, monkeypatch):
    path, _ = port
    look = init.look

    def and_write(*arguments):
        (tmp_path / "servotap.toml").write_text("# mine")
        return look(*arguments)

    monkeypatch.setattr(init, "look", and_write)
    assert run(init, f"left=serial:{path},baud=38400", "--addresses", "1", "--dialects", "mks-rs485") == 2
    assert "servotap.toml was created by another program meanwhile; --force replaces it" in capsys.readouterr().err
    assert (tmp_path / "servotap.toml").read_text() == "# mine"


def test_a_signal_ends_the_search_on_all_buses_and_what_was_found_is_written(port, tmp_path, capsys, monkeypatch):
    path, _ = port
    look = scan.scan

    def until_second(*arguments, **options):
        def stop(done, total, where):
            if done == 2:
                signal.raise_signal(signal.SIGTERM)

        return look(*arguments, **options | {"progress": stop})

    monkeypatch.setattr(scan, "scan", until_second)
    words = [f"left=serial:{path},baud=38400", "right=serial:/dev/absent", "--dialects", "mks-rs485", "--addresses", "1-9"]
    assert run(init, *words) == 128 + signal.SIGTERM
    assert profile.look_up("left").drives[0].target == "mks-rs485@1"
    assert "stopped by SIGTERM" in capsys.readouterr().out


def test_nothing_is_written_where_nothing_answers(port, tmp_path, capsys):
    path, pty = port
    assert run(init, f"serial:{path},baud=38400", "--addresses", "9", "--dialects", "mks-rs485") == 1
    assert not (tmp_path / "servotap.toml").exists()
    assert "nothing written: no drive answered" in capsys.readouterr().err
    assert pty.heard.count(0xFA) == 1
    assert run(init, f"mks-can=serial:{path}") == 2
    assert run(init) == 2


def test_names_stand_for_endpoints_and_drives(port, tmp_path, capsys):
    path, pty = port
    (tmp_path / "servotap.toml").write_text(
        f'[bus.left]\nport = "{path}"\nbaud = 38400\n'
        '[drive.arm]\nbus = "left"\ndialect = "mks-rs485"\naddress = 2\nmax-speed = 100\n'
        '[drive.lift]\nbus = "left"\ndialect = "mks-rs485"\n'
    )
    assert run(send, "arm", "read_speed") == 0
    assert build(MKS, "read_speed", 2) in pty.heard
    fast = ("arm", "run_speed", "direction=cw", "speed=200", "acceleration=200", "--allow", "motion,unbounded")
    assert run(send, *fast) == 2
    assert "above --max-speed 100" in capsys.readouterr().err
    assert run(send, *fast, "--max-speed", "200", "--subdivision", "16") == 0
    pty.heard = b""
    assert run(stop, "arm") == 0
    out = capsys.readouterr().out
    assert "mks-rs485@2: stands" in out
    assert "mks-rs485@1" not in out
    assert pty.heard.startswith(build(MKS, "stop_speed", 2, {"acceleration": 200}))
    assert run(stop, "left", "--addresses", "1-2") == 0
    out = capsys.readouterr().out
    assert out.count("mks-rs485@1: stands") == out.count("mks-rs485@2: stands") == 1
    assert run(scan, "lift", "--addresses", "1", "--dialects", "mks-rs485") == 0
    assert run(stop, "amr") == 2
    assert "did you mean arm" in capsys.readouterr().err
