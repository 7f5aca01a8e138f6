"""`servotap explain`: every printed frame comes back, damaged ones are shown with the right one, hostile text is refused."""

from __future__ import annotations

import io
import json
import re
import sys
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Risk, Role, Vector, Verb, always
from analyzer.cli import explain as module
from analyzer.cli import main
from analyzer.decoder import slots_of
from analyzer.errors import UnreadableError
from analyzer.layout import Layout, u8, u16
from analyzer.link import HeadLink
from analyzer.reference.explanation import Explainer
from analyzer.reference.explanation_text import explanation_lines
from analyzer.reference.hex_frame import read_frame
from tests.cli.vectors import VECTORS

ALL = dialects.every()


@pytest.fixture
def explain(capsys):
    def call(*words, status=0):
        assert main(["explain", *words]) == status
        return capsys.readouterr()

    return call


@pytest.fixture
def as_json(explain):
    def call(*words):
        return json.loads(explain(*words, "--json").out)

    return call


# --- every printed frame ----------------------------------------------------------------------------------------------


def options(dialect, command, vector):
    """Return the options that say what the bytes alone do not."""
    words = ["--dialect", dialect.name, "--role", vector.role.value]
    if not vector.checksum:
        words.append("--no-checksum")
    if vector.models:
        words += ["--model", vector.models[0]]
    if vector.role is Role.REPLY and needs_request(dialect, command, vector):
        asked = next(v for v in command.vectors if v.role is Role.REQUEST) if command.vectors else None
        words += ["--request", asked.corrected or asked.printed]
    return words


def needs_request(dialect, command, vector):
    """Say whether a reply is told only by its request, and the manual prints such a request."""
    requests = any(v.role is Role.REQUEST for v in command.vectors)
    return requests and all(f.needs_request for f in command.reply_forms)


@pytest.mark.parametrize(("dialect", "command", "vector"), VECTORS)
def test_every_vector_comes_back(as_json, dialect: Dialect, command: Command, vector: Vector):
    if vector.erratum and (len(vector.corrected) != len(vector.printed) or not vector.checksum):
        pytest.skip("printed with other bytes than its checksum's wrong")
    shown = as_json(*options(dialect, command, vector), vector.printed)
    assert shown["dialect"] == dialect.name
    assert shown["role"] == vector.role
    printed = vector.data
    assert shown["address"] == (printed[0] if dialect.bus == "can" else dialect.link.parse(printed).address)
    stray = all(f.needs_request for f in command.reply_forms) and not needs_request(dialect, command, vector)
    if not (stray and vector.role is Role.REPLY):
        assert shown["command"] == command.name
        assert shown["section"] == command.section
    if command.slots is None:
        assert shown["wire"] == dict(vector.values)
    assert shown["checksum"]["ok"] is (vector.checksum and not vector.erratum)
    assert ("got" in shown["checksum"]) is vector.checksum
    right = bytes.fromhex(shown["frame"])
    assert right[: len(printed)] == printed or right == bytes.fromhex(vector.corrected)
    rules = {f["rule"] for f in shown["findings"]}
    assert rules == ({"bad_checksum"} if vector.erratum else set())


@pytest.mark.parametrize(("dialect", "command", "vector"), VECTORS)
def test_every_vector_is_explained_byte_by_byte(explain, dialect: Dialect, command: Command, vector: Vector):
    if vector.erratum:
        return
    out = explain(*options(dialect, command, vector), vector.printed).out
    table = out.split("offset ", 1)[1].split("\n\n", 1)[0]
    hexes = [word for line in table.splitlines()[1:] for word in line[8:].split("  ")[0].split() if len(word) == 2]
    shown = bytes.fromhex("".join(w for w in hexes if all(c in "0123456789ABCDEF" for c in w)))
    whole = vector.data[1:] if dialect.bus == "can" else vector.data
    assert shown == whole


@pytest.mark.parametrize(("dialect", "command", "vector"), VECTORS)
def test_the_dialect_of_every_whole_vector_is_found(as_json, dialect: Dialect, command: Command, vector: Vector):
    if vector.erratum or not vector.checksum or vector.models:
        return
    shown = as_json(vector.printed)
    assert dialect.name in (shown["dialect"], *shown.get("also", ()))
    assert shown["checksum"]["ok"]


# --- one frame, in words ----------------------------------------------------------------------------------------------


def test_a_frame_in_words(explain):
    assert explain("FA 01 F6 01 40 02 34").out == (
        "mks-rs485  request  address 1  run_speed  0xF6  section 6.5.1\n"
        "Run at a speed until told otherwise.\n"
        "\n"
        "offset  hex    bits                 meaning\n"
        "0       FA                          head: a request\n"
        "1       01                          address 1\n"
        "2       F6                          code 0xF6 run_speed\n"
        "3-4     01 40  0... .... .... ....  direction 0 ccw (0 ccw, 1 cw)\n"
        "               .000 .... .... ....  reserved 0\n"
        "               .... 0001 0100 0000  speed 320 rpm (0..3000 rpm)\n"
        "5       02                          acceleration 2 (0..255)\n"
        "6       34                          checksum: as computed\n"
        "\n"
        "risk: motion, unbounded\n"
        "\n"
        "no findings\n"
    )


def test_a_frame_as_json(as_json):
    assert as_json("FA 01 F6 01 40 02 34") == {
        "dialect": "mks-rs485",
        "role": "request",
        "address": 1,
        "code": "0xF6",
        "command": "run_speed",
        "fields": {"direction": 0, "direction_name": "ccw", "speed": 320, "acceleration": 2},
        "wire": {"direction": 0, "speed": 320, "acceleration": 2},
        "checksum": {"ok": True, "got": "34", "expected": "34"},
        "findings": [],
        "section": "6.5.1",
        "frame": "FA 01 F6 01 40 02 34",
    }


@pytest.mark.parametrize(
    "words",
    [
        ["FA01F601400234"],
        ["fa 01 f6 01 40 02 34"],
        ["FA,01,F6,01,40,02,34"],
        ["FA:01:F6:01:40:02:34"],
        ["FA-01-F6-01-40-02-34"],
        ["0xFA, 0x01, 0xF6, 0x01, 0x40, 0x02, 0x34"],
        ["{0xFA, 0x1, 0xF6, 0x1, 0x40, 0x2, 0x34}"],
        ["\\xfa\\x01\\xf6\\x01\\x40\\x02\\x34"],
        ["b'\\xfa\\x01\\xf6\\x01\\x40\\x02\\x34'"],
        ["FAh 01h F6h 01h 40h 02h 34h"],
        ["FA 1 F6 1 40 2 34"],
        ["FA", "01", "F6", "01", "40", "02", "34"],
    ],
)
def test_hex_in_any_common_form(as_json, words):
    assert as_json(*words)["frame"] == "FA 01 F6 01 40 02 34"


@pytest.mark.parametrize(
    "text",
    [
        "01 F6 01 40 02 3A",
        "001#F60140023A",
        "001#F6.01.40.02.3A",
        "can0 001#F60140023A",
        "(1436509052.249713) can0 001#F60140023A R",
        "can0  001   [5]  F6 01 40 02 3A",
        "001 F6 01 40 02 3A",
    ],
)
def test_can_frames(as_json, text):
    shown = as_json(text)
    assert (shown["dialect"], shown["address"], shown["command"]) == ("mks-can", 1, "run_speed")
    assert shown["frame"] == "01 F6 01 40 02 3A"


def test_can_identifier_of_three_digits(as_json):
    shown = as_json("123#F6014002 5D".replace(" ", ""))
    assert shown["address"] == 0x123
    assert shown["checksum"] == {"ok": False, "got": "5D", "expected": "5C"}
    assert shown["frame"] == "123 F6 01 40 02 5C"
    assert as_json(shown["frame"])["checksum"]["ok"]


# --- checksums --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "got", "right"),
    [
        ("FA 01 F6 01 40 02 35", "35", "FA 01 F6 01 40 02 34"),
        ("01 04 00 32 00 01 90 06", "90 06", "01 04 00 32 00 01 90 05"),
        ("01 F6 01 40 02 3B", "3B", "01 F6 01 40 02 3A"),
        ("3E A2 01 04 E5 A0 8C 00 00 2D", "2D", "3E A2 01 04 E5 A0 8C 00 00 2C"),
        ("3E A2 01 04 E4 A0 8C 00 00 2C", "E4", "3E A2 01 04 E5 A0 8C 00 00 2C"),
    ],
)
def test_a_wrong_checksum_is_shown_with_the_right_frame(explain, as_json, text, got, right):
    shown = as_json(text)
    assert shown["checksum"]["ok"] is False
    assert shown["checksum"]["got"] == got
    assert shown["frame"] == right
    assert {f["rule"] for f in shown["findings"]} == {"bad_checksum"}
    assert f"the right frame: {right}\n" in explain(text).out


@pytest.mark.parametrize("right", ["FA 01 F6 01 40 02 34", "01 04 00 32 00 01 90 05", "01 F6 01 40 02 3A", "3E 80 01 00 BF"])
@pytest.mark.parametrize("stated", [False, True])
def test_a_missing_checksum(as_json, right, stated):
    size = 2 if right.endswith("90 05") else 1
    body = right[: -3 * size]
    shown = as_json(body, *(["--no-checksum"] if stated else []))
    assert shown["checksum"] == {"ok": False, "expected": right[-3 * size + 1 :]}
    assert shown["frame"] == right
    assert [f["rule"] for f in shown["findings"]] == ([] if stated else ["bad_checksum"])


def test_two_missing_sums(as_json, explain):
    shown = as_json("3E A2 01 04 A0 8C 00 00")
    assert shown["frame"] == "3E A2 01 04 E5 A0 8C 00 00 2C"
    assert len(shown["findings"]) == 2
    assert "none given" in explain("3E A2 01 04 A0 8C 00 00").out


def test_a_fitting_checksum_wins_over_a_missing_one(as_json, explain):
    # One byte of data is missing and the sum is right; without its sum it would be a whole command.
    text = "FA 01 F6 01 40 32"
    shown = as_json(text)
    assert shown["checksum"]["ok"]
    assert [f["rule"] for f in shown["findings"]] == ["wrong_length"]
    assert "frame" not in shown
    assert shown["maybe_unchecked"] is True
    assert "--no-checksum" in explain(text).out
    assert as_json("--no-checksum", text)["wire"] == {"direction": 0, "speed": 320, "acceleration": 50}


# --- what is unusual --------------------------------------------------------------------------------------------------


def test_an_unknown_command(as_json):
    shown = as_json("FA 01 99 00 94")
    assert "command" not in shown
    assert "section" not in shown
    assert (shown["code"], shown["role"], shown["fields"]) == ("0x99", "request", {})
    assert [f["rule"] for f in shown["findings"]] == ["unknown_command"]


def test_bad_values(as_json, explain):
    shown = as_json("FA 01 F6 7F A1 02 13")
    assert [f["rule"] for f in shown["findings"]] == ["reserved_bits", "out_of_range"]
    assert [f["severity"] for f in shown["findings"]] == ["warning", "error"]
    out = explain("FA 01 F6 7F A1 02 13").out
    assert "! speed 4001 rpm (0..3000 rpm)" in out
    assert "! reserved 7 (expected 0)" in out


def test_a_length_byte_that_does_not_fit(as_json):
    shown = as_json("3E A2 01 05 E6 A0 8C 00 00 2C")
    assert [f["text"] for f in shown["findings"]] == ["length: expected 04, got 05"]
    assert shown["frame"] == "3E A2 01 04 E5 A0 8C 00 00 2C"


def test_both_readings_where_nothing_tells_who_sent_it(as_json, explain):
    shown = as_json("01 80 00 81")
    assert shown["role"] == "unknown"
    assert [(r["role"], r["wire"]) for r in shown["readings"]] == [("request", {}), ("reply", {"status": 0})]
    out = explain("01 80 00 81").out
    assert "as a request:  calibrate, without data" in out
    assert "as a reply:    calibrate: status 0 calibrating" in out
    assert as_json("01 80 00 81", "--role", "reply")["wire"] == {"status": 0}


def test_modbus_registers_and_functions(as_json):
    shown = as_json("01 06 00 82 00 05 E9 E1", "--role", "request")
    assert (shown["code"], shown["function"], shown["command"]) == ("0x0082", "0x06", "set_work_mode")
    assert shown["fields"] == {"work_mode": 5, "work_mode_name": "sr_vfoc"}


def test_a_request_tells_what_its_reply_means(as_json):
    reply = "01 04 02 01 40 B9 50"
    assert as_json(reply)["command"] == "unknown_read"
    shown = as_json(reply, "--request", "01 04 00 32 00 01 90 05")
    assert (shown["command"], shown["wire"], shown["findings"]) == ("read_speed", {"speed": 320}, [])
    shown = as_json("01 82 05 88", "--request", "01 00 82 83")
    assert (shown["command"], shown["role"], shown["wire"]) == ("read_parameter", "reply", {"work_mode": 5})


def test_a_package_slot_by_slot(explain, as_json):
    frame = next(v for v in dialects.get("mks-rs485").by_name["long_package"].vectors if not v.erratum).printed
    out = explain(frame).out
    assert out.count("slot ") == 5
    assert "address 0 (all)" in out
    assert re.search(r"^31 +04 +slot 4: address 4$", out, re.MULTILINE)
    assert re.search(r"^6-10 +00 00 00 00 00 +filled up with zeros$", out, re.MULTILINE)
    slots = as_json(frame)["fields"]["slots"]
    assert [(s["address"], s["command"]) for s in slots][:2] == [(1, "run_speed"), (2, "run_speed")]


def test_a_package_that_lost_zeros(explain, as_json):
    frame = next(v for v in dialects.get("mks-rs485").by_name["long_package"].vectors if v.erratum).printed
    shown = as_json(frame)
    assert shown["findings"][-1]["rule"] == "short_package"
    assert "frame" not in shown
    assert "the right frame" not in explain(frame).out


def test_units_of_a_model(as_json):
    frame = "3E A1 01 02 E2 C8 00 C8"
    assert as_json(frame, "--role", "request")["fields"] == {"torque_current": 200}
    assert as_json(frame, "--role", "request", "--model", "mf")["fields"]["torque_current"] == pytest.approx(1.6113, abs=1e-4)


def test_dialects_that_fit_equally_well_are_named(explain, as_json):
    # A head of 3E with a sum over all of it is also an identifier with a sum over all of it.
    shown = as_json("3E 93 01 00 D2")
    assert (shown["dialect"], shown["also"]) == ("lk-rs485", ["mks-can"])
    assert "fits equally well: mks-can" in explain("3E 93 01 00 D2").out


def test_values_beyond_the_exact_range_of_json_numbers(as_json):
    shown = as_json("3E 92 02 08 DA EF CD AB 89 67 45 23 01 C0")
    assert shown["wire"] == {"position": 81985529216486895}
    assert shown["fields"]["position_text"] == "819855292164868.95"


# --- refusals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "got nothing"),
        ("   ", "got nothing"),
        ("hello", "'hello'"),
        ("FA 01 GG", "'GG'"),
        ("FA0", "3 digits"),
        ("F", "1 digits"),
        ("[red]FA[/red]", "expected hex bytes"),
        ("\x1b[31mFA", "\\x1b"),
        ("é", "\\xe9"),
        ("00" * 600, "at most 512 bytes"),
        ("A" * 10_000, "10000 characters"),
        (" ".join(["FA"] * 5000), "at most 512 bytes"),
        ("#", "001#"),
        ("001#F601400", "digits"),
        ("001#" + "00" * 9, "at most 8 data bytes"),
        ("12345678#F6", "11 bits"),
        ("800#F6F6", "11 bits"),
        ("001##1F6", "CAN FD"),
        ("001#R", "remote"),
        ("can0  001   [4]  F6 01 40 02 3A", "[4]"),
        ("FF FF FF", "no frame"),
        ("77 " * 40, "no frame"),
        ("001#", "no frame"),
        ("001#F6", "no frame"),
    ],
)
def test_what_is_no_frame(explain, text, expected):
    captured = explain(text, status=2)
    assert captured.out == ""
    assert expected in captured.err
    assert captured.err.isprintable() or all(c.isprintable() or c == "\n" for c in captured.err)
    assert len(captured.err) < 1000


def test_a_head_that_contradicts_the_role(explain):
    assert "got a request by its head" in explain("FA 01 30 2B", "--dialect", "mks-rs485", "--role", "reply", status=2).err


def test_unknown_dialects_and_models(explain):
    assert "did you mean mks-rs485?" in explain("FA", "--dialect", "mks-rs458", status=2).err
    assert "no model '99Z'" in explain("FA", "--model", "99Z", status=2).err
    assert "no model '42E' in mks-rs485" in explain("FA", "--model", "42E", "--dialect", "mks-rs485", status=2).err


# --- standard input ---------------------------------------------------------------------------------------------------


def feed(monkeypatch, data: bytes):
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(data)))


def test_a_frame_a_line(monkeypatch, explain):
    feed(monkeypatch, b"# a comment\n\nFA 01 F6 01 40 02 34  # run\r\n001#F60140023A\n")
    lines = [json.loads(line) for line in explain("-", "--json").out.splitlines()]
    assert [line["dialect"] for line in lines] == ["mks-rs485", "mks-can"]


def test_an_unreadable_line_is_named_and_the_others_come_out(monkeypatch, explain):
    feed(monkeypatch, b"FA 01 30 2B\nnonsense\xff\nFA 01 31 2C\n" + b"A" * 200_000 + b"\nFA 01 32 2D")
    captured = explain("-", "--json", status=2)
    assert [json.loads(line)["command"] for line in captured.out.splitlines()] == [
        "read_encoder_carry",
        "read_position",
        "read_speed",
    ]
    assert [line[:24] for line in captured.err.splitlines()] == ["servotap explain: line 2", "servotap explain: line 4"]


def test_lines_in_words(monkeypatch, explain):
    feed(monkeypatch, b"\xef\xbb\xbfFA 01 30 2B\n")
    assert explain("-").out.startswith("line 1: FA 01 30 2B\nmks-rs485  request")


# --- properties -------------------------------------------------------------------------------------------------------

EXPLAINER = Explainer(ALL)


@settings(max_examples=300)
@given(st.binary(max_size=60), st.sampled_from([Role.UNKNOWN, Role.REQUEST, Role.REPLY]), st.booleans())
def test_any_bytes_are_explained_or_refused(data, role, no_checksum):
    if not data:
        return
    try:
        found = EXPLAINER.explain(read_frame(data.hex()), role=role, no_checksum=no_checksum)
    except UnreadableError:
        return
    assert explanation_lines(found)
    assert json.loads(json.dumps(module.explained(found)))["dialect"] == found.dialect.name


@settings(max_examples=300)
@given(st.data())
def test_flipped_vectors_are_explained_or_refused(data):
    _, _, vector = data.draw(st.sampled_from(VECTORS)).values
    raw = bytearray(vector.data)
    raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        found = EXPLAINER.explain(read_frame(raw.hex()))
    except UnreadableError:
        return
    assert explanation_lines(found)
    module.explained(found)


@settings(max_examples=300)
@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text):
    said = ""
    try:
        read_frame(text)
    except UnreadableError as error:
        said = str(error)
    assert said.isascii()


# --- a dialect from elsewhere -----------------------------------------------------------------------------------------


def test_an_invented_dialect(capsys):
    def xor(data: bytes) -> int:
        result = 0
        for byte in data:
            result ^= byte
        return result

    spin = Command(
        name="spin", verb=Verb.OTHER, code=0x10, section="1", summary="Spin.", risk=(always(Risk.MOTION),),
        request=Layout(u16("speed", maximum=100, unit="rpm")), reply=Layout(u8("status")),
    )  # fmt: skip
    invented = Dialect(
        name="invented", title="Invented", manual="none", bus="serial", commands=(spin,),
        link=HeadLink(heads={0xA5: Role.REQUEST, 0x5A: Role.REPLY}, check=xor),
    )  # fmt: skip
    found = Explainer([*ALL, invented]).explain(read_frame("A5 07 10 00 64 D6"))
    assert found.dialect is invented
    shown = module.explained(found)
    assert (shown["command"], shown["fields"], shown["checksum"]["ok"]) == ("spin", {"speed": 100}, True)


def test_slots_of_a_package_are_all_shown():
    dialect = dialects.get("mks-rs485")
    command = dialect.by_name["long_package"]
    assert len(slots_of(dialect, command, bytes(50))) == 0
    found = Explainer([dialect]).explain(read_frame("FC" + "00" * 50 + "FC"))
    assert "\n".join(explanation_lines(found)).count("unused") == 5


# --- what people paste ------------------------------------------------------------------------------------------------


def test_two_frames_that_stand_together_are_explained_one_behind_the_other(capsys, cli):
    out = cli("explain", "FA 01 32 2D FB 01 32 00 64 92").out
    assert out.index("mks-rs485  request  address 1  read_speed") < out.index("mks-rs485  reply  address 1  read_speed")
    assert "speed 100 rpm" in out
    assert main(["explain", "01 04 00 32 00 01 90 05 01 04 02 01 40 B9 50", "--json"]) == 0
    assert [json.loads(row)["command"] for row in capsys.readouterr().out.splitlines()] == ["read_speed", "read_speed"]


def test_the_data_of_a_can_frame_without_the_identifier_are_told(cli):
    assert "without its identifier: 001#F60140023A would fit" in cli("explain", "F6 01 40 02 3A", status=2).err


# --- as it is pasted --------------------------------------------------------------------------------------------------

PASTED = [
    ("[12:00:00][D][uart_debug:114]: >>> FA:01:30:2B", ["read_encoder_carry request"]),
    ("12:00:00.124 -> FB 1 30 0 0 0 1 20 0 4D", ["read_encoder_carry reply"]),
    ("receive:   5: FB 01 F6 01 F3", ["run_speed reply"]),
    ("250 1 48 43", ["read_encoder_carry request"]),
    (">>> ser.write(bytes([0xFA, 0x01, 0x30, 0x2B]))", ["read_encoder_carry request"]),
    ('{"type":"Buffer","data":[250,1,48,43]}', ["read_encoder_carry request"]),
    ("Timestamp: 1.5    ID: 0001    S Rx    DL:  3    f6 01 f8    Channel: can0", ["run_speed reply"]),
    ("t0015F60140023A", ["run_speed request"]),
    ("I send FA 01 30 2B and get FB 01 30 00 00 00 01 20 00 4D", ["read_encoder_carry request", "read_encoder_carry reply"]),
    ("Tx: 01 04 00 32 00 01 90 05\nRx: 01 04 02 01 40 B9 50", ["read_speed request", "read_speed reply"]),
]


@pytest.mark.parametrize(("text", "found"), PASTED, ids=[text[:24] for text, _ in PASTED])
def test_a_line_of_a_log_or_a_program_is_explained(text, found, explain):
    lines = explain("--json", "--", text).out.splitlines()
    assert [f"{one['command']} {one['role']}" for one in map(json.loads, lines)] == found


def test_what_a_pasted_line_leaves_open_is_said(explain):
    assert "decimal" in explain("250 1 48 43").err
    assert "an identifier of 11 bits, got 12345678" in explain("T123456781FF", status=2).err


@pytest.mark.parametrize("text", ["motor ready", "RX:", "12:00:00 TX", "ser.read(10)"])
def test_a_line_without_bytes_is_refused_with_what_was_expected(text, explain):
    assert "expected hex bytes, got" in explain(text, status=2).err
