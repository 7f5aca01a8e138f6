"""`servotap catalogue`: pages, errata and JSON of every command, complete, stable and narrow."""

from __future__ import annotations

import json
import re

import pytest

from analyzer import dialects
from analyzer.cli import main
from analyzer.codec import codec
from analyzer.dialects import code_text, find_commands
from analyzer.layout import FieldKind
from analyzer.reference.bit_diagram import bit_diagram

ALL = dialects.every()
LAYOUTS = [
    pytest.param(form.layout, id=f"{d.name}-{c.name}-{number}")
    for d in ALL
    for c in d.commands
    for number, form in enumerate((*c.request_forms, *c.reply_forms))
]


@pytest.fixture
def catalogue(capsys):
    def call(*words, status=0):
        assert main(["catalogue", *words]) == status
        captured = capsys.readouterr()
        return captured.err if status else captured.out

    return call


# --- text -------------------------------------------------------------------------------------------------------------


def test_the_overview_names_every_command(catalogue):
    out = catalogue()
    for dialect in ALL:
        assert f"{dialect.name}: {dialect.title}" in out
        for command in dialect.commands:
            assert any(command.name in line and command.section in line for line in out.splitlines())
    assert out == catalogue()


def test_the_overview_of_one_dialect(catalogue):
    out = catalogue("--dialect", "lk-rs485")
    assert out.startswith("lk-rs485: ")
    assert "mks-can" not in out


def test_a_page(catalogue):
    out = catalogue("--dialect", "mks-rs485", "run_speed")
    expected = """\
       +-+-----+-----------------------+---------------+
     0 |1| rsv |         speed         |  acceleration |
       +-+-----+-----------------------+---------------+

     field         byte:bit  type    unit  range     printed
  1  direction     0:7       uint1         2 values  dir
  2  speed         0:3-1:0   uint12  rpm   0..3000   speed
  3  acceleration  2         uint8         0..255    acc

    direction  0 ccw, 1 cw
"""
    assert expected in out
    assert "motion; unbounded where speed is 1..4095" in out
    assert "FA 01 F6 | 00 00 00 | F1" in out
    assert "sr_open, sr_close, sr_vfoc" in out
    assert "direction 1 cw, speed 320 rpm, acceleration 2" in out


def test_a_risk_shows_only_values_that_its_field_can_hold(catalogue):
    assert "unbounded where speed is 1..65535" in catalogue("--dialect", "mks-modbus", "run_speed")
    assert "unbounded where speed is 1..4095" in catalogue("--dialect", "mks-can", "run_speed")
    assert "torque where parameter is 10..12, 30 torque_limit" in catalogue("--dialect", "lk-rs485", "write_parameter")
    rules = json.loads(catalogue("--json", "--dialect", "mks-rs485", "run_speed"))["dialects"][0]["commands"][0]["risk_rules"]
    assert rules[1] == {"risks": ["unbounded"], "field": "speed", "low": 1, "high": 4095}


def test_a_page_tells_an_echo_from_a_reply_of_like_layout(catalogue):
    assert "\n  the same as the request\n" in catalogue("--dialect", "lk-rs485", "set_position")
    written = catalogue("--dialect", "lk-rs485", "write_parameter")
    assert "\n  the layouts of the request\n" in written
    assert "the same as the request" not in written


def test_every_page_is_complete_and_narrow(catalogue):
    out = catalogue("--pages")
    for dialect in ALL:
        for command in dialect.commands:
            assert f"{command.name}  " in out
            for form in (*command.request_forms, *command.reply_forms) if command.slots is None else ():
                assert all(name in out for name in form.layout.named)
            for note in command.notes:
                assert note.split()[0] in out
    wide = [line for line in out.splitlines() if len(line) > 120]
    assert not wide
    assert "None" not in out.split()
    assert out.isascii() or out.isprintable() or all(c.isprintable() or c == "\n" for c in out)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_pictures_are_straight_and_name_every_field(layout):
    lines = bit_diagram(layout)
    assert bool(lines) == bool(layout.fields)
    assert all(len(line) <= 80 for line in lines)
    boxes = [line for line in lines if "|" in line]
    # A bit takes two columns, so the boxes of a row end where its bits end.
    bits = sum((len(line[5:]) - 1) // 2 for line in boxes)
    assert bits == 8 * layout.byte_length or layout.open_ended
    for line, above in zip(lines[1:], lines, strict=False):
        if "|" in line and "+" in above:
            assert all(above[i] == "+" for i, c in enumerate(line) if c == "|")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["run_speed"], {("mks-rs485", "run_speed"), ("mks-modbus", "run_speed"), ("mks-can", "run_speed")}),
        (["RUN-SPEED", "--dialect", "lk-rs485"], {("lk-rs485", "run_speed")}),
        (["0xF7"], {("mks-rs485", "emergency_stop"), ("mks-can", "emergency_stop")}),
        (["F7"], {("mks-rs485", "emergency_stop"), ("mks-can", "emergency_stop")}),
        (["f7h"], {("mks-rs485", "emergency_stop")}),
        (["0x00F7"], {("mks-modbus", "emergency_stop")}),
        (["0xF7", "--dialect", "mks-modbus"], {("mks-modbus", "emergency_stop")}),
        (["04:0030"], {("mks-modbus", "read_encoder_carry")}),
        (["0x04:0x0030"], {("mks-modbus", "read_encoder_carry")}),
    ],
)
def test_commands_are_found_by_name_and_code(catalogue, words, expected):
    titles = [line.split("  ") for line in catalogue(*words).splitlines() if re.match(r"\w+  .*  section ", line)]
    named = {(title[2], title[0]) for title in titles}
    assert expected <= named
    if "--dialect" in words or ":" in words[0]:
        assert named == expected


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["runspeed"], "no dialect has a command 'runspeed'; did you mean run_speed"),
        (["0x77"], "no dialect has a command '0x77'"),
        (["06:0030"], "'06:0030'"),
        (["emergency_stop", "--dialect", "lk-rs485"], "lk-rs485 has no command 'emergency_stop'"),
        (["--dialect", "mks_can"], "did you mean mks-can?"),
        (["--model", "99"], "no model '99'"),
        (["[red]x[/red]"], "'[red]x[/red]'"),
        (["\x1b[31m"], "'\\x1b[31m'"),
        (["a" * 10_000], "(10000 characters)"),
        ([""], "''"),
    ],
)
def test_unknown_names(catalogue, words, expected):
    said = catalogue(*words, status=2)
    assert expected in said
    assert len(said) < 300


def test_limits_of_a_model(catalogue):
    assert "0..3000" in catalogue("--dialect", "mks-can", "set_current", "--model", "42E")
    assert "1/4096" not in catalogue("--dialect", "lk-rs485", "run_torque", "--model", "MH")
    assert "33/4096" in catalogue("--dialect", "lk-rs485", "run_torque", "--model", "mf")


# --- errata -----------------------------------------------------------------------------------------------------------


def test_every_erratum_is_printed(catalogue):
    out = catalogue("--errata")
    for dialect in ALL:
        assert all(f"\n{e.id}  " in out for e in dialect.errata)
    assert len([line for line in out.splitlines() if len(line) > 100]) == 0
    only = catalogue("--errata", "--dialect", "mks-can")
    assert "mks-rs485-01" not in only


def test_the_errata_of_a_command(catalogue):
    out = catalogue("--errata", "--dialect", "mks-rs485", "move_relative_axis")
    assert "mks-rs485-48" in out
    assert "mks-rs485-01" not in out


@pytest.mark.parametrize(
    ("dialect", "command", "ids"),
    [
        ("mks-rs485", "move_absolute_pulses", ("mks-rs485-46",)),
        ("mks-modbus", "move_absolute_pulses", ("mks-modbus-21", "mks-modbus-25", "mks-modbus-26")),
        ("mks-can", "stop_absolute_pulses", ("mks-can-68", "mks-can-69")),
        ("mks-can", "run_speed", ("mks-can-73",)),
        ("lk-rs485", "write_parameter", ("lk-rs485-48", "lk-rs485-49", "lk-rs485-50")),
    ],
)
def test_errata_of_wider_places_are_on_the_page_too(catalogue, dialect, command, ids):
    page = catalogue("--dialect", dialect, command)
    listed = catalogue("--errata", "--dialect", dialect, command)
    told = json.loads(catalogue("--json", "--dialect", dialect, command))["dialects"][0]["errata"]
    for one in ids:
        assert f"\n  {one}  " in page
        assert f"\n{one}  " in listed
        assert one in {e["id"] for e in told}


def test_an_erratum_names_the_commands_that_its_sections_do_not(catalogue):
    listed = catalogue("--errata", "--dialect", "mks-can").split("\n\n")
    assert next(e for e in listed if e.startswith("mks-can-73  ")).endswith("\n  commands  run_speed")
    told = json.loads(catalogue("--json", "--errata", "--dialect", "mks-can"))["dialects"][0]["errata"]
    named = {e["id"]: e.get("commands") for e in told}
    assert named["mks-can-73"] == ["run_speed"]
    assert named["mks-can-72"] is None


# --- JSON -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole():
    import contextlib
    import io

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert main(["catalogue", "--json"]) == 0
    return json.loads(out.getvalue())


def nulls(value):
    if isinstance(value, dict):
        return any(nulls(v) for v in value.values())
    if isinstance(value, list):
        return any(nulls(v) for v in value)
    return value is None


def test_the_object_holds_everything(whole):
    assert not nulls(whole)
    assert [d["name"] for d in whole["dialects"]] == dialects.names()
    for dialect, shown in zip(ALL, whole["dialects"], strict=True):
        assert [c["name"] for c in shown["commands"]] == [c.name for c in dialect.commands]
        assert [e["id"] for e in shown["errata"]] == [e.id for e in dialect.errata]
        for command, told in zip(dialect.commands, shown["commands"], strict=True):
            assert told["code"] == code_text(command.code, command.function)
            assert told["risk"] == sorted(command.all_risks)
            assert [r["name"] for r in told["replies"]] == [f.name for f in command.reply_forms]
            assert [v["frame"] for v in told["vectors"]] == [v.printed for v in command.vectors]
            assert {f["name"] for f in told["request"]} == {n for f in command.request_forms for n in f.layout.named}


def test_a_field_as_an_object(whole):
    rs485 = whole["dialects"][0]
    command = next(c for c in rs485["commands"] if c["name"] == "run_speed")
    direction, speed, acceleration = command["request"]
    assert direction == {
        "name": "direction", "printed": "dir", "bit_offset": 0, "bit_width": 1, "type": "uint", "order": "big",
        "choices": {"0": "ccw", "1": "cw"}, "scale": 1,
    }  # fmt: skip
    assert speed == {
        "name": "speed", "printed": "speed", "bit_offset": 4, "bit_width": 12, "type": "uint", "order": "big",
        "minimum": 0, "maximum": 3000, "unit": "rpm", "scale": 1,
    }  # fmt: skip
    assert acceleration["bit_offset"] == 16


def test_fields_can_be_decoded_from_the_object(whole):
    """Decode every worked example with nothing but the object, and compare with its values."""
    read = 0
    for dialect, shown in zip(ALL, whole["dialects"], strict=True):
        for command in shown["commands"]:
            for vector in command["vectors"]:
                forms = command["replies"] if vector["role"] == "reply" else command.get("requests")
                forms = forms or [{"fields": command["request"]}]
                if "slots" in command or "erratum" in vector:
                    continue
                frame = bytes.fromhex(vector["frame"])
                frame = frame if vector["checksum"] else frame + bytes(2 if shown["name"] == "mks-modbus" else 1)
                head = dialect.link.parse(frame[1:], frame[0]) if dialect.bus == "can" else dialect.link.parse(frame)
                data = (frame[1:] if dialect.bus == "can" else frame)[head.start : head.stop]
                decoded = [d for form in forms if (d := decode(form["fields"], data)) is not None]
                assert vector["values"] in decoded
                read += 1
    assert read > 200


def decode(fields, data):
    """Return the values of data as sent, or None if they are not of these fields."""
    values = {}
    for field in fields:
        start, width = field["bit_offset"], field["bit_width"]
        raw = data[start // 8 : (start + width + 7) // 8]
        if start + width > 8 * len(data):
            return None
        value = int.from_bytes(raw, field["order"])
        if field["order"] == "big":
            value = value >> (-(start + width) % 8) & ((1 << width) - 1)
        if field["type"] == "int" and value >> (width - 1):
            value -= 1 << width
        if field.get("fixed", value) != value:
            return None
        values[field["name"]] = value
    return values


def test_types_and_bounds(whole):
    for shown in whole["dialects"]:
        for command in shown["commands"]:
            for field in (f for fields in [command["request"], *(r["fields"] for r in command["replies"])] for f in fields):
                assert field["type"] in ("uint", "int", "bytes")
                if field["type"] == "bytes":
                    continue
                assert field["order"] in ("big", "little")
                assert field["scale"] > 0
                low = -(1 << (field["bit_width"] - 1)) if field["type"] == "int" else 0
                assert low <= field.get("minimum", low) <= field.get("maximum", field.get("minimum", low))
                assert all(key.lstrip("-").isdigit() for key in field.get("choices", {}))


def test_the_object_can_be_filtered(catalogue):
    one = json.loads(catalogue("--json", "--dialect", "mks-can", "run_speed"))
    assert [c["name"] for c in one["dialects"][0]["commands"]] == ["run_speed"]
    errata = json.loads(catalogue("--json", "--errata", "--dialect", "mks-can"))["dialects"][0]
    assert "commands" not in errata
    assert errata["errata"][0].keys() >= {"id", "section", "printed", "wrong", "taken_as", "why", "certainty"}
    model = json.loads(catalogue("--json", "--dialect", "mks-can", "set_current", "--model", "57E"))["dialects"][0]
    assert model["commands"][0]["request"][0]["maximum"] == 5200
    assert model["model"] == "57E"


def test_parameter_replies_say_what_they_answer(whole):
    can = next(d for d in whole["dialects"] if d["name"] == "mks-can")
    replies = next(c for c in can["commands"] if c["name"] == "read_parameter")["replies"]
    mode = next(r for r in replies if r["fields"][0]["name"] == "work_mode")
    assert (mode["code"], mode["needs_request"], mode["request_values"]) == ("0x82", True, {"parameter": 0x82})


def test_every_layout_has_its_codec():
    for dialect, command in ((d, c) for d in ALL for c in d.commands):
        assert find_commands([dialect], command.name) == [(dialect, command)]
        for form in (*command.request_forms, *command.reply_forms):
            named = [f for f in form.layout.fields if f.kind is not FieldKind.RESERVED]
            assert len(codec(form.layout).wire(bytes(form.layout.byte_length))) == len(named)


# --- searching --------------------------------------------------------------------------------------------------------


def test_a_word_or_a_section_finds_commands(catalogue):
    shown = catalogue("speed", "--dialect", "mks-rs485").splitlines()
    assert shown[0] == "mks-rs485"
    assert any("run_speed" in row for row in shown)
    assert not any("set_current" in row for row in shown)
    assert [row.split()[1] for row in catalogue("6.5.1", "--dialect", "mks-rs485").splitlines()[2:]] == ["run_speed"]
    assert {row.split()[1] for row in catalogue("6.5", "--dialect", "mks-rs485").splitlines()[2:]} >= {
        "stop_speed",
        "run_speed",
    }


def test_a_name_shows_its_page_and_catalog_is_catalogue(catalogue, cli):
    page = catalogue("run_speed", "--dialect", "mks-rs485")
    assert cli("catalog", "run_speed", "--dialect", "mks-rs485").out == page
