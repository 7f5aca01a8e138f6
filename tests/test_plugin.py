"""A dialect of another package: found by its entry point, decoded, explained and logged without touching the core."""

from __future__ import annotations

import json
import signal

import pytest

from analyzer.plugins import attempt
from tests.logs import messages
from tests.plugin_site import make_site, servotap

MODULE = '''
"""An invented drive: AA/55 heads, address, code, data, XOR check."""
from enum import IntEnum
from functools import reduce

from analyzer.catalogue import Command, Dialect, Replies, Risk, Role, Vector, Verb, always
from analyzer.layout import Layout, StatePart, i16, u8, u16
from analyzer.link import HeadLink


class Gate(IntEnum):
    SHUT = 0
    OPEN = 1


def xor(data):
    return reduce(lambda a, b: a ^ b, data, 0)


DIALECT = Dialect(
    name="toy-rs485",
    title="A toy",
    manual="The toy's manual V1",
    bus="serial",
    link=HeadLink(heads={0xAA: Role.REQUEST, 0x55: Role.REPLY}, check=xor),
    commands=(
        Command(
            name="read_speed", verb=Verb.READ_SPEED, code=0x21, section="2.1", summary="Read the speed.",
            risk=(always(Risk.READ),), request=Layout(),
            reply=Layout(i16("speed", unit="rpm", state=StatePart("speed", 1.0)), u8("gate", choices=Gate)),
            vectors=(Vector("AA 01 21 8A"),),
        ),
        Command(
            name="set_speed", verb=Verb.RUN_SPEED, code=0x22, section="2.2", summary="Run.",
            risk=(always(Risk.UNBOUNDED),), request=Layout(u16("speed", maximum=500, unit="rpm")),
            reply=Layout(u8("status")), replies=Replies(final={1}, failed={0}),
        ),
    ),
    addresses=(1, 15),
    baud_rates=(9600,),
)
'''


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return make_site(tmp_path_factory.mktemp("site"), "toy_drive", MODULE, "toy-rs485")


def xored(text):
    data = bytes.fromhex(text)
    check = 0
    for byte in data:
        check ^= byte
    return (data + bytes((check,))).hex(" ").upper()


def test_it_is_explained(site):
    line = json.loads(servotap(site, "explain", "--json", xored("55 01 21 FE D4 01")).stdout)
    assert (line["dialect"], line["command"], line["role"]) == ("toy-rs485", "read_speed", "reply")
    assert line["fields"] == {"speed": -300, "gate": 1, "gate_name": "open"}


def test_it_is_built_and_stands_in_the_catalogue(site):
    assert servotap(site, "frame", "toy-rs485@1", "set_speed", "speed=300").stdout.strip() == xored("AA 01 22 01 2C")
    assert "expected 0..500 rpm" in servotap(site, "frame", "toy-rs485@1", "set_speed", "speed=501").stderr
    assert "set_speed" in servotap(site, "catalogue", "--dialect", "toy-rs485").stdout


def test_it_is_found_decoded_and_logged(site):
    rows = []
    for n in range(20):
        rows += [f"0.{n:03d} > {xored('AA 01 21')}", f"0.{n:03d}5 < {xored(f'55 01 21 00 {n:02X} 00')}"]
    rows += [f"1.0 > {xored('AA 01 22 03 E8')}", f"1.1 < {xored('55 01 22 00')}"]
    (site / "toy.log").write_text("\n".join(rows) + "\n")
    done = servotap(site, "decode", "toy.log", "--force", "--json")
    summary = json.loads(done.stdout)
    assert summary["dialects"] == ["toy-rs485"]
    assert summary["frames"] == 42
    assert {f["rule"] for f in summary["findings"]} == {"out_of_range", "failed_status"}

    found = messages(site / "toy.log.mcap")
    assert ("/serial/1/state", {"speed": 7.0}) in found
    assert any(topic == "/serial/1/read_speed/reply" and value["gate_name"] == "shut" for topic, value in found)


def test_a_package_whose_files_are_damaged_is_named_and_left_out(tmp_path, monkeypatch):
    monkeypatch.setenv("SERVOTAP_FAULTS", str(tmp_path))
    info = tmp_path / "broken-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_bytes(b"Metadata-Version: 2.1\nName: \xff\n")
    (info / "entry_points.txt").write_bytes(b"[servotap.dialects]\nx = \xff:y\n")
    done = servotap(
        make_site(tmp_path, "toy_drive", "print('hello')\n" + MODULE, "toy-rs485"), "explain", xored("55 01 21 FE D4 01")
    )
    assert done.returncode == 0
    assert done.stdout.startswith("toy-rs485  reply")
    assert "broken-1.0.dist-info failed and is left out" in done.stderr
    (tmp_path / "toy_command.py").write_text("def add_arguments(parser): pass\ndef run(arguments): return 1 / 0\n")
    (tmp_path / "toy_drive-1.0.dist-info" / "entry_points.txt").write_text("[servotap.commands]\ntoy = toy_command\n")
    done = servotap(tmp_path, "toy")
    assert done.returncode == 70
    told = "servotap: a fault of the package toy-drive 1.0 (toy_command): ZeroDivisionError: division by zero; please "
    assert done.stderr.splitlines()[-1].startswith(f"{told}report it to its makers with the file written to ")
    assert done.stderr.count("ZeroDivisionError") == 1


def test_a_dialect_that_fails_while_it_is_read_is_named_once(tmp_path):
    module = MODULE.replace("reduce(lambda a, b: a ^ b, data, 0)", "{}[len(data)]")
    site = make_site(tmp_path, "toy_drive", module, "toy-rs485")
    told = "servotap: toy-rs485 of servotap.dialects failed and is left out: KeyError: 3\n"
    (site / "toy.log").write_text("0.1 > FA 01 32 2D\n0.2 < FB 01 32 00 64 92\n0.3 > AA 01 21 8A\n")
    shown = servotap(site, "show", "toy.log", "--dialect", "toy-rs485,mks-rs485")
    assert (shown.returncode, shown.stderr.count(told)) == (0, 1)
    assert "speed=100 rpm" in shown.stdout
    assert "left_out" in shown.stdout
    decoded = servotap(site, "decode", "toy.log", "--force")
    assert decoded.stderr.count("failed and is left out") == 1
    assert "14 bytes: 10 in 2 frames, 4 junk" in decoded.stdout


def test_a_package_that_fails_as_python_exits_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("SERVOTAP_FAULTS", str(tmp_path))
    late = "import atexit\n\n\ndef late():\n    raise RuntimeError('\\x1b[31mgone')\n\n\natexit.register(late)\n"
    site = make_site(tmp_path, "toy_drive", late + MODULE, "toy-rs485")
    said = servotap(site, "explain", "AA 01 21 8A").stderr
    assert said.startswith("servotap: a fault of the package toy-drive 1.0 (toy_drive): RuntimeError: \\x1b[31mgone; please")


def test_a_package_that_ends_the_program_as_it_is_imported_is_named_and_left_out(tmp_path):
    site = make_site(
        tmp_path,
        "toy_drive",
        "import os\nif hasattr(os, 'fork') and not os.fork():\n    os._exit(0)\nos._exit(0)\n",
        "toy-rs485",
    )
    done = servotap(site, "explain", "FA 01 32 2D")
    assert (done.returncode, "toy-rs485 (toy_drive:DIALECT)" in done.stderr) == (0, True)
    assert done.stderr.count("failed and is left out: Ended: os._exit(0) was called") == 1
    assert done.stdout.startswith("mks-rs485  request")


def test_a_dialect_that_ends_the_program_while_it_is_read_is_named_and_left_out(tmp_path):
    module = MODULE.replace("reduce(lambda a, b: a ^ b, data, 0)", "__import__('os')._exit(0)")
    site = make_site(tmp_path, "toy_drive", module, "toy-rs485")
    (site / "toy.log").write_text("0.1 > FA 01 32 2D\n0.2 < FB 01 32 00 64 92\n0.3 > AA 01 21 8A\n")
    shown = servotap(site, "show", "toy.log", "--dialect", "toy-rs485,mks-rs485")
    assert "toy-rs485 of servotap.dialects failed and is left out: Ended: os._exit(0) was called" in shown.stderr
    assert "speed=100 rpm" in shown.stdout


class Panic(BaseException):
    """What a package in Rust raises, and pytest where it skips."""

    def __str__(self):
        raise ValueError


@pytest.mark.parametrize("error", [Panic(), GeneratorExit(), SystemExit(3), RecursionError("deep"), ValueError("\x1b[2J")])
def test_whatever_a_package_raises_is_named_and_left_out(error, capsys):
    def call():
        raise error

    assert attempt("a toy", call) is None
    said = capsys.readouterr().err
    assert said.startswith(f"servotap: a toy failed and is left out: {type(error).__name__}")
    assert "\x1b" not in said


def test_an_interrupt_is_none_of_a_package_and_names_what_was_waited_for(capsys):
    def call():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        attempt("a toy", call)
    assert capsys.readouterr().err == "servotap: interrupted in a toy\n"
    # A process that ignores Ctrl-C gets none.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert attempt("a toy", call) is None
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "servotap: a toy failed and is left out: KeyboardInterrupt: \n"
