"""`servotap send`: one frame through the gate, the reply decoded, on ports that are real."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator

import pytest

from analyzer import cli as analyzer_cli
from conformance.cli import HELP, send
from conformance.drives.serial_bus import SerialBus
from conformance.serve.tcp import TcpPort
from tests.conformance.drives.served import Emulated, drives, on_port, on_pty


def run(*words: str) -> int:
    return analyzer_cli._run("send", send, words)


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    bus = SerialBus(drives("mks-rs485@1,work_mode=sr_vfoc", "lk-rs485@3,baud=38400", "mks-modbus@4"))
    with on_port(bus, TcpPort("127.0.0.1", 0)) as found:
        yield f"tcp:{found}"


@pytest.fixture
def said(place: str, capsys: pytest.CaptureFixture[str]):
    """Return what `send` prints on the drives' port, its status checked."""

    def call(*words: str, status: int = 0, on: str = place) -> str:
        assert run(*words, "--on", on) == status, capsys.readouterr()
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return out if status < 2 else err

    return call


def test_a_read_needs_no_permission(said):
    text = said("mks-rs485@1", "read_position")
    assert "> FA 01 31 2C   read_position" in text
    assert "< FB 01 31 00 00 00 00 00 00 2D   read_position position=0 counts   after" in text


def test_reads_in_every_dialect(said):
    assert "temperature=30" in said("lk-rs485@3", "read_state_1")
    assert "speed=0" in said("mks-modbus@4", "read_speed")


def test_a_motion_needs_its_risks(said):
    err = said("mks-rs485@1", "run_speed", "direction=cw", "speed=60", "acceleration=200", status=2)
    assert "not sent: FA 01 F6 80 3C C8 75" in err
    assert "--allow motion,unbounded" in err
    err = said("mks-rs485@1", "run_speed", "direction=ccw", "speed=60", "acceleration=200", "--allow", "motion", status=2)
    assert "needs unbounded" in err
    assert "needs motion" not in err


def test_a_move_and_its_completion(said):
    words = ("mks-rs485@1", "move_relative_axis", "speed=600", "acceleration=250", "position=4096", "--allow", "motion")
    text = said(*words)
    assert "status=starting" in text
    assert "has not come" in text
    text = said(*words, "--wait")
    assert "status=starting" in text
    assert "status=complete" in text


def test_bounds_ask_the_drive_where_it_is(said):
    words = ("mks-rs485@1", "move_absolute_axis", "speed=600", "acceleration=250", "--allow", "motion", "--max-turns", "3")
    assert "turns, above --max-turns 3" in said(*words, "position=1638400", status=2)
    assert "status=complete" in said(*words, "position=16384", "--wait")
    assert "while the subdivision is not known" in said(*words, "position=16384", "--max-speed", "600", status=2)
    assert "status=complete" in said(*words, "position=0", "--max-speed", "600", "--subdivision", "16", "--wait")


def test_a_refusal_by_the_drive_is_1(said):
    text = said("mks-rs485@1", "set_subdivision", "subdivision=16", "--allow", "setting")
    assert "status=success" in text
    text = said("mks-rs485@1", "set_work_mode", "work_mode=9", "--wire", "--force", "--allow", "setting,torque", status=1)
    assert "status=failed" in text


def test_no_answer_is_1(said):
    text = said("mks-rs485@9", "read_speed", "--timeout", "60", status=1)
    assert re.search(r"nothing came within \d+ ms at (38400 bit/s|its own rate) ", text)
    assert "servotap scan" in text


def test_who_is_not_meant_to_answer_does_not(said):
    err = said("mks-rs485@all", "read_speed", status=2)
    assert "meant for all drives (--alone" in err
    assert "nothing answers it, and nothing came" in said("mks-rs485@all", "read_speed", "--alone")


def test_bytes_as_they_are(said):
    assert "read_position position=" in said("--hex", "FA 01 31 2C")
    assert "nothing came" in said("--hex", "FA 01 31 2D", "--timeout", "50", status=1)
    assert "emergency_stop" in said("--hex", "55 FA 01 F7 F2", status=2)
    assert "expected the bytes alone" in said("mks-rs485@1", "--hex", "FA 01 31 2C", status=2)


def test_an_adapter_that_echoes(capsys: pytest.CaptureFixture[str]):
    with on_port(SerialBus(drives("mks-rs485@1"), echo=True), TcpPort("127.0.0.1", 0)) as echoing:
        assert run("mks-rs485@1", "read_speed", "--on", f"tcp:{echoing}") == 0
    out = capsys.readouterr().out
    assert out.count("FA 01 32 2D") == 1
    assert "hands back what it sends" in out


def test_json(said):
    found = json.loads(said("lk-rs485@3", "motor_on", "--allow", "motion", "--json"))
    assert found["sent"] == "3E 88 03 00 C9"
    assert found["outcome"] == "done"
    assert found["replies"][0]["raw"] == "3E 88 03 00 C9"
    assert found["replies"][0]["meaning"] == "final"
    assert 0 < found["replies"][0]["latency"] < 1


def test_what_has_no_default_must_be_given_and_what_has_one_is_told(said, capsys: pytest.CaptureFixture[str]):
    err = said("mks-rs485@1", "run_speed", "speed=60", "--allow", "motion,unbounded", status=2)
    assert "run_speed needs direction (0 ccw, 1 cw), acceleration (0..255): the manual states no default" in err
    assert run("mks-modbus@4", "set_home", "home_speed=60", "--dry-run") == 2
    assert "left out and taken so: home_trigger=0 low" in capsys.readouterr().err


def test_the_default_rate_of_a_dialect_is_taken_and_told(capsys: pytest.CaptureFixture[str]):
    with on_pty("lk-rs485@3") as path:
        assert run("lk-rs485@3", "read_state_1", "--on", f"serial:{path}") == 0
    assert f"serial:{path},baud=115200: the default rate of lk-rs485" in capsys.readouterr().err


def test_a_dry_run_opens_nothing(capsys: pytest.CaptureFixture[str]):
    assert run("mks-rs485@1", "run_speed", "direction=ccw", "speed=60", "acceleration=200", "--dry-run") == 2
    out = capsys.readouterr().out
    assert "FA 01 F6 00 3C C8 F5" in out
    assert "motion, unbounded" in out
    assert "not allowed" in out
    assert run("mks-can@1", "read_speed", "--dry-run", "--on", "can:nothing:0") == 0
    assert "it may be sent" in capsys.readouterr().out
    assert run("mks-rs485@1", "run_speed", "direction=ccw", "speed=60", "acceleration=200", "--dry-run", "--json") == 2
    assert json.loads(capsys.readouterr().out)["refused"][0]["hint"] == "--allow motion,unbounded"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "what? expected DIALECT@ADDRESS COMMAND"),
        (("mks-rs485@1",), "what?"),
        (("mks-rs485@1", "read_speed"), "where? expected --on"),
        (("mks-rs485@1", "read_sped", "--on", "tcp:127.0.0.1:1"), "did you mean read_speed"),
        (("mks-rs485@1", "run_speed", "speed=4000", "--on", "tcp:127.0.0.1:1"), "speed: got 4000 rpm, expected 0..3000"),
        (("mks-rs485@1", "run_speed", "sped=9", "--on", "tcp:127.0.0.1:1"), "did you mean speed"),
        (("mks-can@1", "read_speed", "--on", "tcp:127.0.0.1:1"), "another kind of bus"),
        (("mks-rs485@1", "read_speed", "--on", "tcp:127.0.0.1:1"), "cannot connect"),
        (("mks-rs485@1", "read_speed", "--on", "telnet:x"), "expected serial:PORT"),
        (("mks-rs485@1", "read_speed", "--on", "serial:/dev/none", "--allow", "all"), "expected some of setting"),
        (("--hex", "zz", "--on", "tcp:127.0.0.1:1"), "hex bytes"),
        (("--hex", "", "--on", "can:virtual:x"), "expected the hex bytes"),
    ],
)
def test_wrong_use(words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]):
    assert run(*words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert told in err


def test_a_can_drive_of_another_process(capsys: pytest.CaptureFixture[str]):
    # A group and a port of its own: other tests have theirs at the same time.
    place = f"udp_multicast:239.74.163.71,port={44200 + os.getpid() % 1000}"
    with Emulated("mks-can@1,work_mode=bus_closed", "--can", place):
        on = f"can:{place}"
        assert run("mks-can@1", "read_version", "--on", on) == 0
        assert "firmware_major=1" in capsys.readouterr().out
        words = ("mks-can@1", "move_relative_axis", "speed=600", "acceleration=250", "position=4096", "--on", on, "--wait")
        # CAN drives can be asked for their subdivision.
        assert run(*words, "--allow", "motion", "--max-speed", "600", "--max-turns", "1") == 0
        assert "status=complete" in capsys.readouterr().out
        assert run("--hex", "01 31 32", "--on", on) == 0
        assert "read_position position=" in capsys.readouterr().out


def test_it_is_listed():
    assert "reply" in HELP["send"]


# --- two sendings in turn ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("FA 01", "F6 01 40 02 34"),
        ("FA", "01 F6 01 40 02 34"),
        ("04 04 FA 01 F6 01 17 27", "30 01 00 00 00 01 F8 2B"),
        ("FA D0 30 FA", "01 F6 01 40 02 34"),
        ("3E", "A2 01 04 E5 10 27 00 00 37"),
        ("01 06", "00 F6 00 3C 68 29"),
    ],
)
def test_two_sendings_in_turn_move_nothing(first, second, capsys):
    bus = SerialBus(drives("mks-rs485@1,work_mode=sr_vfoc", "lk-rs485@1,baud=38400"))
    with on_port(bus, TcpPort("127.0.0.1", 0)) as found:
        assert run("mks-rs485@1", "enable", "enabled=1", "--allow", "torque,motion", "--on", f"tcp:{found}") == 0
        for text in (first, second):
            run("--hex", text, "--on", f"tcp:{found}", "--timeout", "100")
        assert run("mks-rs485@1", "read_speed", "--on", f"tcp:{found}", "--json") == 0
    assert '"speed": 0' in capsys.readouterr().out


def test_bytes_that_begin_a_frame_are_refused_and_say_what_they_begin(said):
    assert "the beginning of a frame of mks-rs485" in said("--hex", "FA 01", status=2)
    assert "the beginning of a frame of mks-rs485" in said("--hex", "04 04 FA 01 F6 01 17 27", status=2)
    # A damaged frame, and a read that is cut off, begin nothing that acts.
    said("--hex", "FA 01 31 00", "--timeout", "100", status=1)
    said("--hex", "FA 01 31", "--timeout", "100", status=1)
