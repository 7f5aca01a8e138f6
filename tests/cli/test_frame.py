"""`servotap frame`: every printed frame is built from its values, and what the manual forbids is refused by name."""

from __future__ import annotations

import json

import pytest

from analyzer.catalogue import Command, Dialect, Role, Vector
from analyzer.cli import main
from tests.cli.vectors import VECTORS


@pytest.fixture
def frame(cli):
    def call(*words):
        return cli("frame", *words).out.strip()

    return call


@pytest.fixture
def refused(cli):
    def call(*words):
        captured = cli("frame", *words, status=2)
        assert captured.out == ""
        assert captured.err.isascii()
        return captured.err.removeprefix("servotap frame: ").strip()

    return call


# --- every printed frame ----------------------------------------------------------------------------------------------


def right(dialect, vector):
    """Return the text of the frame that a vector stands for, with its checksum."""
    if vector.corrected or vector.checksum:
        return vector.corrected or vector.printed
    can_id = vector.data[0] if dialect.bus == "can" else None
    data = vector.data[1:] if dialect.bus == "can" else vector.data
    whole = dialect.link.completed(data, can_id)
    return (vector.data[:1] + whole if dialect.bus == "can" else whole).hex(" ").upper()


@pytest.mark.parametrize(("dialect", "command", "vector"), VECTORS)
def test_every_vector_is_built_from_its_values(frame, dialect: Dialect, command: Command, vector: Vector):
    expected = right(dialect, vector)
    data = bytes.fromhex(expected)
    if command.slots is not None:
        pytest.skip("a package is built from its slots")
    address = data[0] if dialect.bus == "can" else dialect.link.parse(data).address
    words = [f"{dialect.name}@{address}", command.name, "--wire"]
    words += [f"{n}={v}" for n, v in vector.values.items()]
    words += ["--reply"] if vector.role is Role.REPLY else []
    words += ["--model", vector.models[0]] if vector.models else []
    assert frame(*words) == expected


@pytest.mark.parametrize(("dialect", "command", "vector"), VECTORS)
def test_every_vector_is_built_from_what_explain_says(cli, dialect: Dialect, command: Command, vector: Vector):
    if vector.erratum:
        pytest.skip("does not hold")
    model = ["--model", vector.models[0]] if vector.models else []
    role = ["--role", vector.role.value] + ([] if vector.checksum else ["--no-checksum"])
    told = json.loads(cli("explain", "--json", "--dialect", dialect.name, *role, *model, vector.printed).out)
    fields = {n: v for n, v in told["fields"].items() if not n.endswith("_name")}
    words = [f"{n}={told['fields'].get(n + '_name', v)}" for n, v in fields.items() if not n.endswith("_text")]
    if "slots" in fields:
        words = [f"slot={slot_text(s)}" for s in fields["slots"]]
    if any(n.endswith("_text") for n in fields):
        words = [f"{n[:-5]}={v}" for n, v in fields.items() if n.endswith("_text")]
    words += ["--reply"] if vector.role is Role.REPLY else []
    assert cli("frame", f"{dialect.name}@{told['address']}", told["command"], *words, *model).out.strip() == told["frame"]


def slot_text(slot):
    words = {n: v for n, v in slot.items() if n not in ("address", "code", "command") and not n.endswith("_name")}
    return f"{slot['address']} {slot['command']} " + " ".join(f"{n}={v}" for n, v in words.items())


# --- how values are written -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("mks-rs485@1 run_speed direction=ccw speed=320 acceleration=2", "FA 01 F6 01 40 02 34"),
        ("mks-rs485@0x01 run_speed direction=0 speed=0x140 acceleration=0x2", "FA 01 F6 01 40 02 34"),
        ("mks-rs485@1 run_speed speed=320rpm acceleration=2 direction=cw", "FA 01 F6 81 40 02 B4"),
        ("mks-rs485@1 run-speed direction=CW speed=320 acceleration=2", "FA 01 F6 81 40 02 B4"),
        ("mks-rs485@all stop_speed", "FA 00 F6 00 00 00 F0"),
        ("mks-rs485@1 enable enabled=on", "FA 01 F3 01 EF"),
        ("mks-rs485@1 enable enabled=false", "FA 01 F3 00 EE"),
        ("mks-rs485@1 0xF7", "FA 01 F7 F2"),
        ("mks-rs485@1 set_current --force", "FA 01 83 00 00 7E"),
        ("mks-rs485@1 set_current --model 42D", "FA 01 83 06 40 C4"),
        ("mks-rs485@1 --reply read_speed speed=-1", "FB 01 32 FF FF 2C"),
        ("mks-rs485@1 read_speed --reply speed=-1", "FB 01 32 FF FF 2C"),
        ("mks-modbus@1 read_speed", "01 04 00 32 00 01 90 05"),
        ("mks-modbus@1 set_work_mode work_mode=sr_vfoc", "01 06 00 82 00 05 E9 E1"),
        ("mks-modbus@1 set_home home_speed=0", "01 10 00 90 00 03 05 00 00 00 00 00 52 52"),
        ("mks-modbus@1 run_speed --reply", "01 10 00 F6 00 02 A1 FA"),
        ("mks-modbus@1 run_speed --reply quantity=0", "01 10 00 F6 00 00 20 3B"),
        ("mks-modbus@1 run_speed --reply --form refused", "01 10 00 F6 00 00 20 3B"),
        ("mks-can@1 run_speed direction=ccw speed=320 acceleration=2", "01 F6 01 40 02 3A"),
        ("mks-can@1 run_speed direction=ccw speed=320 acceleration=2 --candump", "001#F60140023A"),
        ("mks-can@0x123 run_speed direction=ccw speed=320 acceleration=2", "123 F6 01 40 02 5C"),
        ("mks-can@1 read_parameter parameter=work_mode", "01 00 82 83"),
        ("mks-can@1 read_parameter --reply work_mode=bus_closed", "01 82 05 88"),
        ("mks-can@1 read_parameter --reply parameter=current", "01 83 00 00 84"),
        ("mks-can@1 read_parameter --reply --form unreadable parameter=0x82", "01 82 FF FF 81"),
        ("lk-rs485@1 move_multi_turn position=360.5", "3E A3 01 08 EA D2 8C 00 00 00 00 00 00 5E"),
        ("lk-rs485@1 move_multi_turn position=-.5", "3E A3 01 08 EA CE FF FF FF FF FF FF FF C7"),
        ("lk-rs485@3 run_torque torque_current=1.5 --model MF", "3E A1 03 02 E4 BA 00 BA"),
        ("lk-rs485@3 write_parameter torque_limit=5", "3E C1 03 07 09 1E 00 00 05 00 00 00 23"),
        ("lk-rs485@3 write_parameter parameter=speed_pid speed_kp=7 --force", "3E C1 03 07 09 0B 07 00 00 00 00 00 12"),
        ("lk-rs485@3 read_state_2 --reply power=5", "3E 9C 03 07 E4 00 05 00 00 00 00 00 05"),
    ],
)
def test_a_frame_from_words(frame, words, expected):
    assert frame(*words.split()) == expected


def test_a_package(frame):
    built = frame(
        "mks-rs485@all", "long_package", "slot=1 run_speed direction=ccw speed=50 acceleration=10", "slot=2 read_speed"
    )
    data = bytes.fromhex(built)
    assert len(data) == 52
    assert data[:12] == bytes.fromhex("FC 01 F6 00 32 0A 00 00 00 00 00 02")


def test_a_frame_as_json(frame):
    shown = json.loads(frame("mks-rs485@1", "run_speed", "direction=ccw", "speed=320", "acceleration=2", "--json"))
    assert shown == {
        "dialect": "mks-rs485",
        "address": 1,
        "command": "run_speed",
        "code": "0xF6",
        "role": "request",
        "frame": "FA 01 F6 01 40 02 34",
        "risk": ["motion", "unbounded"],
        "section": "6.5.1",
        "filled": {},
    }
    assert json.loads(frame("mks-rs485@1", "run_speed", "--force", "--json"))["risk"] == ["motion"]
    assert json.loads(frame("mks-rs485@1", "run_speed", "--reply", "--json"))["risk"] == []
    package = json.loads(frame("mks-rs485@all", "long_package", "slot=1 enable enabled=off", "--json"))
    assert package["risk"] == ["torque"]


def test_what_was_left_out_is_told_beside_the_frame(capsys, cli):
    out, err = cli("frame", "mks-rs485@1", "set_current", "--model", "42D")
    assert out.strip() == "FA 01 83 06 40 C4"
    assert err.strip() == "left out and taken so: current=1600 mA"
    assert main(["frame", "mks-rs485@1", "set_current"]) == 2
    assert "set_current needs current (0..5200 mA): the manual states no default" in capsys.readouterr().err


# --- refusals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("mks-rs485@1 run_speed speed=4000", "speed: got 4000 rpm, expected 0..3000 rpm"),
        ("mks-rs485@1 stop_speed speed=5", "speed: got 5 rpm, expected 0 rpm"),
        ("mks-rs485@1 set_current current=3500 --model 42D", "current: got 3500 mA, expected 0..3000 mA"),
        ("mks-rs485@1 set_zero_mode zero_mode=7", "zero_mode: got 7, expected 0 disabled, 1 direction, 2 near"),
        ("mks-can@1 set_subdivision subdivision=3", "subdivision: got 3, expected 0, 2, 4, 5, 8, 10"),
        ("mks-can@1 move_relative_axis position=-8388608", "position: got -8388608 counts, expected -8388607..8388607"),
        ("mks-can@0 set_address new_address=0", "new_address: got 0, expected 1..2047"),
        ("mks-rs485@1 run_speed speed=3.5", "speed: got 3.5, expected a whole number"),
        ("mks-rs485@1 run_speed speed=fast", "speed: got 'fast', expected 0..3000 rpm"),
        ("mks-rs485@1 run_speed speed=1e999999999", "speed: got '1e999999999', expected"),
        ("mks-rs485@1 run_speed speed=nan", "speed: got 'nan', expected"),
        ("mks-rs485@1 run_speed direction=on", "direction: got 'on', expected 0 ccw, 1 cw"),
        ("mks-rs485@1 set_work_mode work_mode=sr_vfok", "did you mean sr_vfoc"),
        ("mks-rs485@1 run_speed spede=5", "the request of run_speed has no field 'spede'; did you mean speed?"),
        ("mks-rs485@1 read_speed speed=5", "has no field 'speed'; it takes none"),
        ("mks-rs485@1 runspeed", "mks-rs485 has no command 'runspeed'; did you mean run_speed"),
        ("mks-rs485@1 F6", "'F6' is the code of several commands, expected stop_speed or run_speed"),
        ("mks-rs485@1 long_package --reply", "long_package has no reply"),
        ("mks-rs485@1 run_speed --form other", "run_speed has no form 'other', expected request"),
        ("mks-rs485@1 run_speed speed", "expected FIELD=VALUE, got 'speed'"),
        ("mks-rs485@1 run_speed =5", "expected FIELD=VALUE, got '=5'"),
        ("mks-rs485@1 run_speed speed=1 speed=2", "'speed' is given twice"),
        ("mks-rs485 run_speed", "expected DIALECT@ADDRESS as mks-rs485@1, got 'mks-rs485'"),
        ("mks-rs485@ run_speed", "expected DIALECT@ADDRESS"),
        ("mks-rs485@one run_speed", "address: got 'one', expected a number"),
        ("mks-rs485@256 run_speed", "address 256 does not fit the frame, expected 0..255"),
        ("mks-can@0x800 read_speed", "address 2048 does not fit the frame, expected 0..2047"),
        ("mks-modbus@248 read_speed", "address: got 248, expected 1..247, or 0 for all"),
        ("lk-rs485@33 stop", "address: got 33, expected 1..32"),
        ("lk-rs485@0 stop", "address: got 0, expected 1..32"),
        ("lk-rs485@all stop", "lk-rs485 has no broadcast address"),
        ("mks-rs458@1 run_speed", "did you mean mks-rs485?"),
        ("mks-rs485@1 run_speed --candump", "--candump is for CAN, got mks-rs485"),
        ("mks-rs485@1 run_speed --model 42E", "no model '42E' in mks-rs485"),
        ("mks-rs485@all long_package", "long_package: got 0 bytes, expected 50"),
        ("mks-rs485@1 run_speed slot=1", "slot 1: expected"),
    ],
)
def test_refusals_say_what_was_expected(refused, words, expected):
    assert expected in refused(*words.split())


@pytest.mark.parametrize(
    ("slots", "expected"),
    [
        (["1 run_speed speed=4000"], "slot 1: speed: got 4000 rpm, expected 0..3000 rpm"),
        (["1 run_speed", "1 run_speed"], "slot 2: address 1 again"),
        (["1 run_speed"] * 6, "got 6 slots, expected at most 5"),
        (["1 long_package"], "slot 1: long_package cannot stand in a slot"),
        (["1 run_speed spede=4"], "slot 1: the request of run_speed has no field 'spede'"),
        (['1 run_speed "'], "slot 1:"),
        (["300 run_speed"], "slot 1: address 300 does not fit"),
        (["1 run_speed slot=1"], "slot 1: "),
    ],
)
def test_packages_are_checked_slot_by_slot(refused, slots, expected):
    assert expected in refused("mks-rs485@all", "long_package", *(f"slot={s}" for s in slots))


def test_force_builds_what_the_bits_can_hold(frame, refused):
    assert frame("mks-rs485@1", "run_speed", "speed=4000", "--force") == "FA 01 F6 0F A0 00 A0"
    assert frame("lk-rs485@33", "stop", "--force") == "3E 81 21 00 E0"
    assert "does not fit 12 bits" in refused("mks-rs485@1", "run_speed", "speed=4096", "--force")


@pytest.mark.parametrize("text", ["[red]x[/red]", "\x1b[31m", "é" * 5000, "a" * 10_000, "{0}", "%s", "\udc80"])
def test_hostile_text_is_only_quoted(refused, text):
    for words in (
        [f"mks-rs485@{text}", "run_speed"],
        ["mks-rs485@1", text],
        ["mks-rs485@1", "run_speed", f"speed={text}"],
        ["mks-rs485@1", "run_speed", text],
        ["mks-rs485@1", "run_speed", f"{text}=1"],
        ["mks-rs485@1", "long_package", f"slot={text}"],
        ["mks-rs485@1", "run_speed", f"--form={text}"],
    ):
        said = refused(*words)
        assert "\x1b" not in said
        assert len(said) < 400
