"""`servotap stop`: emulated drives that turn, on a port whose every byte is logged."""

from __future__ import annotations

import io
import signal

import pytest

from analyzer import cli as analyzer_cli
from analyzer import dialects
from analyzer.encoder import build
from conformance.cli import stop
from conformance.drives.serial_bus import SerialBus
from conformance.safety import stopping
from tests.conformance.drives.served import LoggedPty, drives, on_port

MKS, LK = dialects.get("mks-rs485"), dialects.get("lk-rs485")
RUNNING = (
    build(MKS, "run_speed", 2, {"speed": 300, "acceleration": 200}),
    build(LK, "motor_on", 3),
    build(LK, "run_speed", 3, {"speed": 18000}),
)


def run(*words: str) -> int:
    return analyzer_cli._run("stop", stop, words)


@pytest.fixture
def port():
    """Two drives that turn, at 38400 baud."""
    bus = SerialBus(drives("mks-rs485@2,work_mode=sr_vfoc", "lk-rs485@3,baud=38400"))
    pty = LoggedPty(bus)
    with on_port(bus, pty) as path:
        import os

        line = os.open(path, os.O_RDWR | os.O_NOCTTY)
        for frame in RUNNING:
            os.write(line, frame)
            os.read(line, 64)
        os.close(line)
        pty.heard = b""
        yield f"serial:{path},baud=38400", pty


def test_all_that_turn_are_found_and_stand_afterwards(port, capsys):
    place, pty = port
    assert run(place, "--addresses", "1-4") == 0
    out = capsys.readouterr().out
    assert "mks-rs485@2: stands at" in out
    assert "lk-rs485@3: stands at" in out
    # No motor is disabled, and nothing else moves it.
    assert build(MKS, "enable", 2, {"enabled": 0}) not in pty.heard
    assert build(LK, "motor_off", 3) not in pty.heard
    assert build(MKS, "stop_speed", 2, {"acceleration": 200}) in pty.heard


def test_those_that_are_named_are_asked_to_stop_before_anything_else(port, capsys):
    place, pty = port
    assert run(place, "mks-rs485@2") == 0
    assert "mks-rs485@2: stands at" in capsys.readouterr().out
    assert pty.heard.startswith(build(MKS, "stop_speed", 2, {"acceleration": 200}))
    assert build(LK, "stop", 3) not in pty.heard


def test_a_drive_that_does_not_answer_is_not_stopped(port, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(stopping, "_RAMP_NS", 400_000_000)
    monkeypatch.setattr(stopping, "_AT_ONCE_NS", 400_000_000)
    place, _ = port
    assert run(place, "mks-rs485@9", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
    assert "NOT STOPPED: mks-rs485@9" in capsys.readouterr().err
    assert (tmp_path / "cut").exists()
    assert run(place, "--addresses", "20") == 20
    assert "no drive answered" in capsys.readouterr().err
    assert run(place, "mks-can@1") == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_that_is_interrupted_says_that_the_drive_may_turn(number, port, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(stop, "_prove", lambda gate, drive: signal.raise_signal(number))
    assert run(port[0], "mks-rs485@2", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
    assert "NOT STOPPED: mks-rs485@2: interrupted" in capsys.readouterr().err
    assert (tmp_path / "cut").exists()


class GoneReader(io.StringIO):
    """The output of a program whose reader has gone."""

    def write(self, text: str) -> int:
        raise BrokenPipeError


def test_a_drive_that_is_not_stopped_is_told_also_where_nothing_can_be_printed(port, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(stopping, "_RAMP_NS", 400_000_000)
    monkeypatch.setattr(stopping, "_AT_ONCE_NS", 400_000_000)
    monkeypatch.setattr("sys.stdout", GoneReader())
    assert run(port[0], "mks-rs485@2", "mks-rs485@9", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
    assert "NOT STOPPED: mks-rs485@9" in capsys.readouterr().err
    assert (tmp_path / "cut").exists()
