"""DBC files: the log has what cantools decodes and the drives; what is wrong with a file is told in one line."""

from __future__ import annotations

import json
import random
import re
import subprocess
import sys
from collections import OrderedDict
from typing import ClassVar

import cantools
import pytest
from cantools.database import Database, can, conversion

from analyzer.cli import main
from analyzer.decoder import physical
from analyzer.devices import dbc, load
from analyzer.devices.text import MOST_BYTES
from analyzer.dialects import get
from analyzer.errors import ServotapError
from analyzer.link import sum8
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Role
from analyzer.system import bounded, sized
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
        {n: str(each.get(f"{n}_name", each.get(f"{n}_text", each.get(n)))) for n in names}
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


def test_the_log_has_schemas_and_says_what_decoded_it(tmp_path, capsys, cli):
    log, out = write(tmp_path, LOG, "bus.log"), tmp_path / "out.mcap"
    cli("decode", log, "--dbc", write(tmp_path, BATTERY), "-o", out)
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


#: Whole numbers that no integer of 64 bits holds: by the factor, by the offset, by the length of CAN FD; beyond a double.
LONG = """VERSION ""
BU_: A
BO_ 291 Long: 64 A
 SG_ Factor : 0|64@1+ (1000,0) [0|0] "" A
 SG_ Offset : 64|8@1+ (1,1e30) [0|0] "" A
 SG_ Length : 72|100@1- (1,0) [0|0] "" A
 SG_ Beyond : 184|64@1+ (1e308,0) [0|0] "" A
"""


@pytest.mark.parametrize("byte", ["00", "7F", "80", "FF"])
def test_numbers_beyond_64_bits_are_doubles_with_their_exact_text(byte, tmp_path, capsys):
    pyarrow = pytest.importorskip("pyarrow.parquet")
    log, dbc = write(tmp_path, f"(1700000000.000000) can0 123##1{byte * 64}\n", "bus.log"), write(tmp_path, LONG)
    assert main(["decode", log, "--dbc", dbc, "--to", "parquet", "-o", str(tmp_path / "t")]) == 0
    assert main(["export", log, "--dbc", dbc, "-o", str(tmp_path / "rows.parquet")]) == 0
    assert main(["export", log, "--dbc", dbc, "--wide", "-o", str(tmp_path / "wide.csv")]) == 0
    wanted = cantools.database.load_string(LONG, "dbc").decode_message(291, bytes.fromhex(byte * 64))
    for table in ("t/battery.Long.message.parquet", "rows.parquet"):
        (row,) = pyarrow.read_table(tmp_path / table).to_pylist()
        for name, value in wanted.items():
            if isinstance(value, int) and abs(value) > 1 << 53:
                assert row[f"{name}_text"] == str(value)
            assert row[name] == (float(value) if value <= sys.float_info.max else None)


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
    "length": (BATTERY.replace("Status: 8", "Status: 1786"), ":5: Status: expected 1785 bytes at most, got 1786"),
    "bits": (BATTERY.replace("0|16@", "0|1600@"), ":5: The signal Voltage does not fit in message Status."),
    "scale": (BATTERY.replace("0.1,0", "1e400,0"), ":6: Status.Voltage: expected a scale that a float can hold, got inf"),
    "maximum": (BATTERY.replace("|60]", f"|{10**400}]"), "expected a maximum that a float can hold, got 1000"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_told_in_one_line_and_nothing_is_written(name, tmp_path, cli):
    text, said = BAD[name]
    log, out = write(tmp_path, LOG, "bus.log"), tmp_path / "out.mcap"
    err = cli("decode", log, "--dbc", write(tmp_path, text), "-o", out, status=2).err
    assert err.count("\n") == 1
    assert said in err
    assert not out.exists()


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


def _kcd(inside, before=""):
    return f"""<?xml version="1.0"?>{before}<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/>
<Bus name="b">{inside}</Bus></NetworkDefinition>"""


ENTITIES = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10 if n else "b" * 10}">' for n in range(9))
PAGE = HEAD + 'BO_ 1 M: 8 A\n SG_ Page M : 0|8@1+ (1,0) [0|0] "" A\n'
#: Small files for which cantools takes gigabytes or minutes.
HOSTILE = {
    "length.dbc": HEAD + "BO_\t5 X\n:\n400000000 A\n",
    "name.dbc": HEAD + f"BO_ 5 {'X' * 400}: 400000000 A\n",
    "bits.dbc": HEAD + 'BO_ 5 X: 8 A\n SG_ a : 0 | 4000000000 @ 1+ (1,0) [0|1] "" A\n',
    "digits.dbc": HEAD + 'BO_ 5 X: 8 A\n SG_ a :\n400000000000 |8@1+ (1,0) [0|1] "" A\n',
    "length.kcd": _kcd('<Message id="0x1" name="M" length="&#52;00000000"><Signal name="s" offset="0"/></Message>'),
    "entity.kcd": _kcd(
        '<Message id="0x1" name="M" length="&l;"><Signal name="s" offset="0"/></Message>',
        '<!DOCTYPE a [<!ENTITY l "400000000">]>',
    ),
    "entities.kcd": _kcd("<Message id='1' name='&e8;'/>", f"<!DOCTYPE a [{ENTITIES}]>"),
    "length.sym": 'FormatVersion=6.0 // c\nTitle="t"\n{SENDRECEIVE}\n[M]\nID=001h\nLen\n=\n400000000\n',
    "range.dbc": PAGE + ' SG_ s m0 : 8|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 1 s Page 0\n-400000000;\n',
    "ranges.dbc": PAGE
    + "".join(f' SG_ s{n} m0 : 8|8@1+ (1,0) [0|0] "" A\n' for n in range(40))
    + "".join(f"SG_MUL_VAL_ 1 s{n} Page 0-65000;\n" for n in range(40)),
    "one.dbc": PAGE + ' SG_ s m0 : 8|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 1 s Page ' + ", ".join(["0-65535"] * 2000) + ";\n",
    "offset.kcd": _kcd(
        "<Message id='1' name='M' length='8'><Signal name='s' offset=' 4000000000 ' length='40000000000'/></Message>"
    ),
    "nested.dbc": HEAD
    + "BO_ 1 M: 8 A\n"
    + "".join(f' SG_ s{n} {"m0M" if n else "M"} : {8 * n}|8@1+ (1,0) [0|0] "" A\n' for n in range(4))
    + "".join(f"SG_MUL_VAL_ 1 s{n} s{n - 1} 0-255;\n" for n in range(1, 4)),
    "signals.dbc": HEAD + "BO_ 1 M: 1785 A\n" + "".join(f' SG_ s{n} : {n}|1@1+ (1,0) [0|0] "" A\n' for n in range(6000)),
}


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not bound the memory of a process")
@pytest.mark.parametrize("name", HOSTILE)
def test_a_small_file_that_takes_all_memory_or_minutes_is_refused_in_a_line(name, tmp_path, cli, monkeypatch):
    import resource

    monkeypatch.setattr(dbc, "_SECONDS", 1)
    spent = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    log, out = write(tmp_path, LOG, "bus.log"), tmp_path / "out.mcap"
    err = cli("decode", log, "--dbc", write(tmp_path, HOSTILE[name], name), "-o", out, status=2).err
    assert err.count("\n") == 1
    assert re.search(rf"{name}: (reading it takes more memory or time than a device file may|.* amplification)", err)
    assert not out.exists()
    own, other = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    # One second for the start of the process.
    assert other.ru_utime - spent[1].ru_utime < dbc._SECONDS + dbc._SECONDS_PER_MIB + 1
    assert own.ru_utime - spent[0].ru_utime < 3
    assert own.ru_maxrss - spent[0].ru_maxrss < 64 << 10


def test_numbers_of_a_comment_are_none_of_a_message(tmp_path):
    assert devices(tmp_path, BATTERY + 'CM_ "at 12:00:4000 from 0-400000000: 99999 |";\n')[0].commands


def test_values_of_a_long_range_are_decoded(tmp_path):
    text = PAGE + ' SG_ s m0 : 8|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 1 s Page 0-5000;\n'
    assert physical(read(devices(tmp_path, text), [can_frame(0, 1, [7, 9, 0, 0, 0, 0, 0, 0])]).entries[0].message) == {
        "Page": 7, "s": 9,
    }  # fmt: skip


def test_multiplexers_in_each_other_without_end(tmp_path):
    for depth in (100, 400, 900):
        signals = "".join(f' SG_ s{n} {"m0M" if n else "M"} : {n}|1@1+ (1,0) [0|0] "" A\n' for n in range(depth))
        values = "".join(f"SG_MUL_VAL_ 1 s{n} s{n - 1} 0-0;\n" for n in range(1, depth))
        text = f"{HEAD}BO_ 1 M: 200 A\n{signals}{values}"
        if depth == 100:
            assert len(devices(tmp_path, text)[0].commands[0].request.fields) == depth
        else:
            with pytest.raises(ServotapError, match=r"RecursionError|fewer multiplexers in each other"):
                devices(tmp_path, text)


# --- the process that parses ----------------------------------------------------------------------------------------------


class Watched(subprocess.Popen):
    """A process that is known afterwards. `interrupted`: Ctrl-C comes while it is waited for."""

    seen: ClassVar[list[Watched]] = []
    interrupted = False

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.seen.append(self)

    def wait(self, timeout=None):
        if type(self).interrupted:
            type(self).interrupted = False
            raise KeyboardInterrupt
        return super().wait(timeout)


@pytest.fixture
def watched(monkeypatch):
    monkeypatch.setattr(dbc.subprocess, "Popen", Watched)
    monkeypatch.setattr(Watched, "seen", [])
    return Watched


def test_a_process_that_does_not_end_is_ended_at_its_deadline(tmp_path, monkeypatch, watched):
    monkeypatch.setattr(dbc, "_CLOCK", 0)
    with pytest.raises(ServotapError, match="reading it takes more memory or time"):
        devices(tmp_path, HOSTILE["nested.dbc"])
    assert [child.poll() in (None, 0) for child in watched.seen] == [False]


def test_a_file_is_parsed_once_for_many_captures(tmp_path, watched):
    first, second = devices(tmp_path, BATTERY), devices(tmp_path, BATTERY)
    assert first[0].link.codes == second[0].link.codes
    assert len(watched.seen) == 1
    devices(tmp_path, BATTERY.replace("Voltage", "Tension"))
    assert len(watched.seen) == 2


def test_no_process_is_left_after_ctrl_c(tmp_path, monkeypatch, watched):
    monkeypatch.setattr(watched, "interrupted", True)
    with pytest.raises(KeyboardInterrupt):
        devices(tmp_path, BATTERY)
    assert len(watched.seen) == 1
    assert watched.seen[0].poll() is not None


def test_the_process_ends_with_its_parent():
    command = bounded.command("analyzer.devices.dbc_child", "nested.dbc", "dbc", 1 << 40, 10_000)
    data = HOSTILE["nested.dbc"].encode()
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        sized.put(child.stdin, data)
        child.stdin.close()
        assert child.wait(60) == 1
        assert child.stdout.read() == b""


def test_a_fault_of_ours_is_not_taken_for_the_files(tmp_path, monkeypatch):
    monkeypatch.setattr(
        bounded,
        "CHILD",
        bounded.CHILD.replace(
            "import_module(", "from analyzer.devices import dbc_child; dbc_child._facts = None; import_module(", 1
        ),
    )
    with pytest.raises(RuntimeError, match="NoneType"):
        devices(tmp_path, BATTERY)


def test_cantools_is_loaded_for_the_first_message_only(tmp_path):
    battery = write(tmp_path, BATTERY)
    code = "import sys; from analyzer.cli import main; main(sys.argv[1:]); print('cantools' in sys.modules)"
    for text, loaded in ((LOG.splitlines()[0], "False"), (LOG, "True")):
        command = [
            sys.executable,
            "-c",
            code,
            "decode",
            write(tmp_path, text, "bus.log"),
            "--dbc",
            battery,
            "-o",
            str(tmp_path / "out.mcap"),
            "--force",
        ]
        assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-1] == loaded
