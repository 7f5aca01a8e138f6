"""DBC files: what cantools decodes stands in the log, beside the drives; what is wrong with a file is told in one line."""

from __future__ import annotations

import json
import random
import re
from collections import OrderedDict

import cantools
import pytest
from cantools.database import Database, can, conversion

from analyzer.cli import main
from analyzer.decoder import physical
from analyzer.devices import load
from analyzer.devices.text import MOST_BYTES
from analyzer.dialects import get
from analyzer.errors import ServotapError
from analyzer.link import sum8
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Role
from tests.collect import Collect
from tests.columns.both_ways import blocks, messages, outcome, short_runs

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'
BATTERY = (
    HEAD
    + """BO_ 291 Status: 8 A
 SG_ Voltage : 0|16@1+ (0.1,0) [0|60] "V" A
 SG_ Mode : 16|8@1+ (1,0) [0|0] "" A
 SG_ Page M : 24|8@1+ (1,0) [0|0] "" A
 SG_ Cell m4 : 32|8@1- (1,-40) [0|0] "degC" A
 SG_ Pack m5 : 32|8@1- (1,-40) [0|0] "degC" A
 SG_ address : 56|8@1+ (1,0) [0|0] "" A
BO_ 2566846206 Engine: 8 A
 SG_ Load : 0|32@1- (1,0) [0|0] "" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566846206 3;
SIG_VALTYPE_ 2566846206 Load : 1;
VAL_ 291 Mode 3 "Not Ready" 4 "Go";
"""
)


def write(folder, text, name="battery.dbc"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


def devices(folder, *texts):
    files = load([write(folder, text, f"d{n}.dbc") for n, text in enumerate(texts)], [], lambda note: None)
    return [d for file in files for d in file.dialects]


def read(dialects, frames, options=None):
    sink = Collect()
    Pipeline([*dialects, get("mks-can")], [sink], options).run(frames)
    return sink


def can_frame(number, can_id, data, **facts):
    return CanFrame(number * 1_000_000, "can0", can_id, bytes(data), **facts)


def status(number, page=4, **facts):
    return can_frame(number, 291, [2, 1, 3, page, 5, 6, 7, 8], **facts)


def test_a_message_stands_beside_the_drives(tmp_path):
    ask = bytes((0x32, sum8(b"\x01\x32")))
    other = can_frame(3, 0x701, [5])
    sink = read(devices(tmp_path, BATTERY), [can_frame(0, 1, ask), status(1), status(2, page=5), other])
    assert [e.topic for e in sink.entries] == [
        "/can0/1/read_speed/request", "/can0/291/Status/message", "/can0/291/Status/message", "/can0/foreign",
    ]  # fmt: skip
    first, second = (physical(e.message) for e in sink.entries[1:3])
    assert first == {
        "Voltage": 25.8, "Mode": 3, "Mode_name": "Not Ready", "Page": 4, "Cell": -35, "signal_address": 8,
    }  # fmt: skip
    assert second["Pack"] == -35
    assert "Cell" not in second
    assert all(f.rule == "unanswered" for f in sink.findings)


@pytest.mark.parametrize(("can_id", "fits"), [(0x18FEF600, True), (0x0CFEF6A7, True), (0x18FEF700, False)])
def test_a_j1939_message_goes_by_its_group_number(tmp_path, can_id, fits):
    sink = read(devices(tmp_path, BATTERY), [can_frame(0, can_id, bytes(8), extended=True)])
    assert (sink.entries[0].message.role is Role.MESSAGE) is fits


def test_an_identifier_of_11_bits_is_none_of_29(tmp_path):
    sink = read(devices(tmp_path, BATTERY), [status(0, extended=True), status(1, remote=True), status(2)])
    assert [e.message.role for e in sink.entries] == [Role.FOREIGN, Role.FOREIGN, Role.MESSAGE]


def test_numbers_that_are_none_are_left_out(tmp_path):
    nan = can_frame(0, 2566846206 & 0x1FFFFFFF, b"\0\0\xc0\x7f\0\0\0\0", extended=True)
    assert physical(read(devices(tmp_path, BATTERY), [nan]).entries[0].message) == {"Load_text": "nan"}


def test_frames_that_do_not_fit_keep_their_bytes(tmp_path):
    sink = read(devices(tmp_path, BATTERY), [can_frame(0, 291, [1, 2]), status(1, page=9)])
    assert [(f.rule, f.text) for f in sink.findings] == [
        ("wrong_length", "Status message: expected 8 bytes of data, got 2"),
        ("unknown_choice", "Status: expected multiplexer id 4 or 5, but got 9"),
    ]
    assert [physical(e.message) for e in sink.entries] == [{}, {}]


def test_an_identifier_of_both_is_the_files_and_that_is_said_once(tmp_path):
    text = HEAD + 'BO_ 1 Both: 2 A\n SG_ X : 0|8@1+ (1,0) [0|0] "" A\n'
    ask = bytes((0x32, sum8(b"\x01\x32")))
    frames = [can_frame(n, 1, ask) for n in range(5)]
    sink = read(devices(tmp_path, text), frames)
    assert {e.message.role for e in sink.entries} == {Role.MESSAGE}
    assert [(f.rule, f.severity) for f in sink.findings] == [("foreign_can_frame", "info")]
    assert "--ids 0x1 reads it as a drive" in sink.findings[0].text
    assert read(devices(tmp_path, text), frames, Options(listed=frozenset({1}))).entries[0].message.role is Role.REQUEST


# --- as cantools does -----------------------------------------------------------------------------------------------------


def any_database(chance):
    """Return a database with signals of any kind that do not overlap."""
    found = []
    for number in range(chance.randint(1, 4)):
        at, signals = 0, []
        while at < 60 and chance.random() < 0.9:
            size = chance.randint(1, min(20, 64 - at))
            is_float = at % 8 == 0 and at <= 32 and chance.random() < 0.2
            size = 32 if is_float else size
            choices = OrderedDict({n: f"c {n}" for n in range(3)}) if chance.random() < 0.3 and not is_float else None
            signals.append(
                can.Signal(
                    f"s{at}", at, size, "little_endian", chance.random() < 0.5 and not is_float,
                    conversion=conversion.BaseConversion.factory(
                        scale=chance.choice((1, 0.5, 3)), offset=chance.choice((0, -40)), choices=choices, is_float=is_float
                    ),
                    unit=chance.choice(("V", None)),
                )
            )  # fmt: skip
            at += size
        extended = chance.random() < 0.3
        found.append(can.Message(0x200 + number, f"M{number}", 8, signals, is_extended_frame=extended, sort_signals=None))
    return Database(found, [], sort_signals=None)


@pytest.mark.parametrize("seed", range(12))
def test_the_values_are_those_of_cantools(seed, tmp_path):
    chance = random.Random(seed)
    text = any_database(chance).as_dbc_string(sort_signals=None)
    loaded = cantools.database.load_string(text, "dbc", sort_signals=None)
    frames, wanted = [], []
    for number in range(40):
        message = chance.choice(loaded.messages)
        frame = can_frame(number, message.frame_id, chance.randbytes(8), extended=message.is_extended_frame)
        frames.append(frame)
        wanted.append({n: str(v) for n, v in message.decode(frame.data).items()})
    shown = [physical(e.message) for e in read(devices(tmp_path, text), frames).entries]
    got = [
        {n: str(each.get(f"{n}_name", each.get(n, each.get(f"{n}_text")))) for n in names}
        for each, names in zip(shown, wanted, strict=True)
    ]
    assert got == wanted


@pytest.mark.parametrize("seed", range(4))
def test_by_blocks_comes_what_comes_one_by_one(seed, tmp_path):
    """Traffic of a drive and of a node, in one block after the other: the fast path leaves out what the file describes."""
    chance = random.Random(seed)
    dialect = devices(tmp_path, BATTERY + 'BO_ 2 Two: 2 A\n SG_ X : 0|8@1+ (1,0) [0|0] "" A\n')[0]
    ask = {n: bytes((0x32, sum8(bytes((n, 0x32))))) for n in (1, 2)}
    tell = {n: bytes((0x32, 0, 9, sum8(bytes((n, 0x32, 0, 9))))) for n in (1, 2)}
    frames = []
    while len(frames) < 300:
        drive = chance.choice((1, 1, 1, 2))
        frames += [can_frame(len(frames), drive, ask[drive]), can_frame(len(frames) + 1, drive, tell[drive])]
        if chance.random() < 0.1:
            frames.append(status(len(frames), page=chance.choice((4, 5, 9))))
    with short_runs():
        single, _ = outcome(frames, [dialect, get("mks-can")])
        together, pipeline = outcome(list(blocks(frames, 50)), [dialect, get("mks-can")])
    assert single == together
    assert pipeline.in_runs


# --- the commands ---------------------------------------------------------------------------------------------------------

LOG = """(1700000000.000000) can0 012#3244
(1700000000.001000) can0 012#32004084
(1700000000.002000) can0 123#0201030405060708
"""


def test_the_log_has_schemas_and_says_what_decoded_it(tmp_path, capsys):
    log, out = write(tmp_path, LOG, "bus.log"), tmp_path / "out.mcap"
    assert main(["decode", log, "--dbc", write(tmp_path, BATTERY), "-o", str(out)]) == 0
    capsys.readouterr()
    found = {topic: (schema, value) for topic, schema, _, _, _, value in messages(out.read_bytes())}
    schema, value = found["/can0/291/Status/message"]
    assert (schema, value["Voltage"], value["Mode_name"]) == ("servotap.battery.Status.message", 25.8, "Not Ready")
    main(["show", str(out), "--dbc", write(tmp_path, BATTERY), "--json", "--filter", "Voltage > 25 V and Mode == 'Not Ready'"])
    assert json.loads(capsys.readouterr().out)["Voltage"] == 25.8
    assert b"device_file_battery.dbc" in out.read_bytes()


def test_tables_have_the_signals(tmp_path, capsys):
    pyarrow = pytest.importorskip("pyarrow.parquet")
    log, dbc = write(tmp_path, LOG, "bus.log"), write(tmp_path, BATTERY)
    assert main(["decode", log, "--dbc", dbc, "--to", "parquet", "-o", str(tmp_path / "t")]) == 0
    table = pyarrow.read_table(tmp_path / "t" / "battery.Status.message.parquet")
    assert table["Voltage"].to_pylist() == [25.8]
    assert table["Mode_name"].to_pylist() == ["Not Ready"]
    assert table.schema.field("Voltage").metadata[b"unit"] == b"V"
    assert main(["export", log, "--dbc", dbc, "--wide", "-o", str(tmp_path / "w.csv")]) == 0
    assert "/can0/291/Status/message.Voltage [V]" in (tmp_path / "w.csv").read_text()
    assert main(["diagnose", log, "--dbc", dbc]) == 0


TWICE = BATTERY + "BO_ 291 Again: 8 A\n"
BAD = {
    "overlap": (BATTERY.replace("16|8@1+", "8|8@1+"), ":5: The signals Mode and Voltage are overlapping in message Status."),
    "identifier": (TWICE, ":19: Again has the identifier 0x123 of Status"),
    "name": (BATTERY + "BO_ 292 Status: 8 A\n", ": two messages have the name Status"),
    "syntax": (BATTERY.replace("0.1,0", "0.1;0"), ":6: Invalid syntax"),
    "empty": (HEAD, "expected messages, got none"),
    "binary": (b"\x7fELF\0\0\0", "expected text, got a zero byte at 4"),
    "noise": (bytes(range(1, 256)) * 9, ":1: Invalid syntax"),
    "huge": (b" " * (MOST_BYTES + 1), "expected at most 4 MiB"),
    "length": (BATTERY.replace("Status: 8", "Status: 99999999999"), ":5: bytes of a message: expected 1785 at most"),
    "bits": (BATTERY.replace("0|16@", "0|16000000000@"), ":6: bits of a signal: expected 14280 at most"),
    "scale": (BATTERY.replace("0.1,0", "1e400,0"), ":6: Status.Voltage: expected a scale that a float can hold, got inf"),
    "maximum": (BATTERY.replace("|60]", f"|{10**400}]"), "expected a maximum that a float can hold, got 1000"),
    "multiplexer": (BATTERY + "SG_MUL_VAL_ 291 Cell Page 4-4000000000;\n", ":19: multiplexer values: expected 65536 at most"),
}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (" BO_ 5 X: 400000000 A\n", "bytes of a message"),
        ("BO_\t5 X\n:\n400000000 A\n", "bytes of a message"),
        ('BO_ 5 X: 8 A\n SG_ a : 0 | 400000000 @ 1+ (1,0) [0|1] "" A\n', "bits of a signal"),
        ('BO_ 5 X: 8 A\n SG_ a :\n400000000 |8@1+ (1,0) [0|1] "" A\n', "first bit of a signal"),
        (" SG_MUL_VAL_\t5 a m 0 - 400000000;\n", "multiplexer values"),
    ],
)
def test_numbers_that_would_take_all_memory_are_refused_however_they_are_spaced(text, said, tmp_path):
    with pytest.raises(ServotapError, match=f"{said}: expected"):
        load([write(tmp_path, HEAD + text)], [], print)


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_told_in_one_line_and_nothing_is_written(name, tmp_path, capsys):
    text, said = BAD[name]
    log, out = write(tmp_path, LOG, "bus.log"), tmp_path / "out.mcap"
    assert main(["decode", log, "--dbc", write(tmp_path, text), "-o", str(out)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert said in err
    assert not out.exists()


def test_a_file_of_entities_is_refused(tmp_path):
    bomb = '<?xml version="1.0"?>\n<!DOCTYPE a [<!ENTITY b "c">]>\n<NetworkDefinition/>'
    with pytest.raises(ServotapError, match=r"bus.kcd:2: expected no DOCTYPE"):
        load([write(tmp_path, bomb, "bus.kcd")], [], print)


def test_another_format_of_cantools(tmp_path):
    text = any_database(random.Random(1)).as_kcd_string()
    assert load([write(tmp_path, text, "bus.kcd")], [], print)[0].dialects[0].commands


@pytest.mark.parametrize("element", ["Message", "Signal"])
def test_a_name_that_is_missing(element, tmp_path):
    text = any_database(random.Random(1)).as_kcd_string()
    nameless = re.sub(rf'(<{element}\b[^>]*?) name="[^"]*"', r"\1", text, count=1)
    assert nameless != text
    with pytest.raises(ServotapError, match=r"bus.kcd.*: expected a name of"):
        load([write(tmp_path, nameless, "bus.kcd")], [], print)


def test_two_files_of_one_identifier(tmp_path):
    with pytest.raises(ServotapError, match=r"message 0x123 stands in d0.dbc and in d1.dbc"):
        devices(tmp_path, BATTERY, BATTERY)
    with pytest.raises(ServotapError, match=r"none.dbc: No such file"):
        load([str(tmp_path / "none.dbc")], [], print)


#: Texts of a megabyte of which each begin looks like one of what is searched. To look through all behind each would take hours.
REPEATED = {
    "lines": ("", "\n", "", "expected messages, got none"),
    "messages without an end": ("", "BO_ 1 \n", "", "Invalid syntax"),
    "multiplexer values without an end": ("", "SG_MUL_VAL_ \n", "", "Invalid syntax"),
    "a multiplexer value without an end": ("SG_MUL_VAL_ ", "1", ";", "Invalid syntax"),
}


@pytest.mark.parametrize("name", REPEATED)
def test_a_text_that_repeats_is_looked_through_once(name, tmp_path):
    begin, piece, end, told = REPEATED[name]
    with pytest.raises(ServotapError, match=told):
        devices(tmp_path, f'VERSION ""\n{begin}{piece * ((1 << 20) // len(piece))}{end}')


def _signals_in(format, count):
    """Return a file of one message of 1785 bytes with so many signals of one bit."""
    signals = [can.Signal(f"s{n}", n, 1) for n in range(count)]
    database = Database([can.Message(1, "M", 1785, signals, strict=False)], strict=False)
    return getattr(database, f"as_{format}_string")()


@pytest.mark.parametrize("format", ["dbc", "kcd", "sym"])
def test_signals_at_whose_bits_cantools_would_look_for_minutes_are_refused(format, tmp_path):
    few = load([write(tmp_path, _signals_in(format, 20), f"few.{format}")], [], print)[0]
    assert len(few.dialects[0].commands[0].request.fields) == 20
    with pytest.raises(
        ServotapError, match=r"many\..*: expected fewer signals in messages so long, got too many with message M"
    ):
        load([write(tmp_path, _signals_in(format, 1200), f"many.{format}")], [], print)
    # What bounds it ends with the file.
    assert len(load([write(tmp_path, _signals_in(format, 20), f"few.{format}")], [], print)) == 1


#: Multiplexers whose values are few lines of text, and more than anyone can look at.
NESTED = {
    "multiplexers in each other": (
        "".join(f' SG_ s{n} {"m0M" if n else "M"} : {8 * n}|8@1+ (1,0) [0|0] "" A\n' for n in range(4)),
        "".join(f"SG_MUL_VAL_ 1 s{n} s{n - 1} 0-255;\n" for n in range(1, 4)),
        "expected fewer signals in messages so long",
    ),
    "long ranges many times": (
        ' SG_ M M : 0|8@1+ (1,0) [0|0] "" A\n' + "".join(f' SG_ s{n} m0 : 8|8@1+ (1,0) [0|0] "" A\n' for n in range(40)),
        "".join(f"SG_MUL_VAL_ 1 s{n} M 0-65000;\n" for n in range(40)),
        "multiplexer values: expected 1048576 in a file at most",
    ),
}


@pytest.mark.parametrize("name", NESTED)
def test_multiplexers_of_more_values_than_anyone_can_look_at_are_refused(name, tmp_path):
    signals, values, told = NESTED[name]
    with pytest.raises(ServotapError, match=told):
        devices(tmp_path, f'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n{signals}\n{values}')
