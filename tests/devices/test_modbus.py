"""Modbus slaves: by functions alone, and by a list of their registers; pymodbus' own traffic and its own decoding."""

from __future__ import annotations

import json
import random

import pytest

from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.decoder import physical
from analyzer.detect import choose
from analyzer.devices import load
from analyzer.dialects import every, get, of_no_drive
from analyzer.errors import ServotapError
from analyzer.link import read_bytes
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import Chunk
from analyzer.sources import open_source
from tests.bytestreams import SERIAL
from tests.collect import Collect, rtu
from tests.columns.both_ways import messages, same_line, short_runs
from tests.columns.serial_traffic import chunks_of

METER = """\
# a meter
unit;address;name;type;scale;unit_of_measure;table;word_order
5;0x0000;voltage;u16;0.1;V;input;
5;6;energy;u32;;kWh;input;little
5;3;pump;coil;;;;
5;0x0030;limit;f32;;;;
5;0x0040;label;string 5;;;;
"""


def meter(folder, text=METER, name="meter.csv"):
    path = folder / name
    path.write_text(text)
    return str(path)


def slaves(folder, text=METER):
    return load([], [meter(folder, text)], print)[0].dialects


def read(dialects, *frames):
    sink = Collect()
    chunks = [Chunk(n * 50_000_000, "bus", rtu(text)) for n, text in enumerate(frames)]
    Pipeline(dialects, [sink]).run(chunks)
    return sink


def shown(dialects, *frames):
    sink = read(dialects, *frames)
    assert not sink.pieces
    return [physical(e.message) for e in sink.entries]


#: Request and reply of each function, and what the reply says without a list.
EXCHANGES = {
    "05 01 00 03 00 0A | 05 01 02 05 02": {"register": 3, "quantity": 10, "values": [1, 0, 1, 0, 0, 0, 0, 0, 0, 1]},
    "05 02 00 00 00 03 | 05 02 01 06": {"register": 0, "quantity": 3, "values": [0, 1, 1]},
    "05 03 00 10 00 02 | 05 03 04 00 07 FF FF": {"register": 16, "quantity": 2, "values": [7, 65535]},
    "05 04 00 00 00 01 | 05 04 02 08 FC": {"register": 0, "quantity": 1, "values": [2300]},
    "05 05 00 03 FF 00 | 05 05 00 03 FF 00": {"register": 3, "values": [1]},
    "05 06 00 20 00 05 | 05 06 00 20 00 05": {"register": 32, "values": [5]},
    "05 0F 00 03 00 03 01 05 | 05 0F 00 03 00 03": {"register": 3, "quantity": 3},
    "05 10 00 30 00 01 02 00 09 | 05 10 00 30 00 01": {"register": 48, "quantity": 1},
    # A reply of eight bytes that could be a request.
    "05 01 03 00 00 18 | 05 01 03 01 02 03": {
        "register": 768, "quantity": 24, "values": [1] + [0] * 8 + [1] + [0] * 6 + [1, 1] + [0] * 6,
    },
    "05 03 00 10 00 01 | 05 83 02": {"exception": 2, "exception_name": "illegal_data_address"},
}  # fmt: skip


@pytest.mark.parametrize("exchange", EXCHANGES)
def test_an_exchange_of_each_function(exchange):
    sink = read([get("modbus")], *exchange.split(" | "))
    request, reply = sink.entries
    assert physical(reply.message) == EXCHANGES[exchange]
    assert reply.request_sequence == request.sequence
    assert reply.topic == request.topic.replace("/request", "/reply")
    assert {f.rule for f in sink.findings} <= {"modbus_exception"}


def test_a_reply_without_its_request_keeps_its_registers():
    sink = read([get("modbus")], "05 03 04 00 07 FF FF")
    assert physical(sink.entries[0].message) == {"byte_count": 4, "registers": "00 07 FF FF"}
    assert {f.rule for f in sink.findings} == {"unknown_command", "unsolicited_reply"}


def test_a_reply_of_another_length_is_told():
    sink = read([get("modbus")], "05 03 00 10 00 02", "05 03 02 00 07")
    assert sink.findings[0].text == "2 registers from 0x0010: expected 4 bytes, got 2"


def test_values_stand_under_their_names_and_the_others_under_their_addresses(tmp_path):
    dialects = slaves(tmp_path)
    assert shown(dialects, "05 04 00 00 00 02", "05 04 04 08 FC 00 09")[1] == {
        "register": 0, "quantity": 2, "voltage": 230.0, "unmapped": "0x0001: 0009",
    }  # fmt: skip
    assert shown(dialects, "05 04 00 06 00 02", "05 04 04 00 01 00 02")[1]["energy"] == 0x20001
    assert shown(dialects, "05 01 00 03 00 02", "05 01 01 03")[1]["pump"] == 1
    written = shown(dialects, "05 10 00 30 00 02 04 3F 80 00 00", "05 10 00 30 00 02")
    assert written[0] == {"register": 48, "quantity": 2, "limit": 1.0}
    assert shown(dialects, "05 03 00 40 00 03", "05 03 06 41 42 43 44 45 00")[1]["label"] == "ABCDE"


def test_half_a_value_stays_raw(tmp_path):
    """A value that is read in two halves is not put together: nothing says that they are of one moment."""
    halves = shown(slaves(tmp_path), "05 04 00 06 00 01", "05 04 02 00 01", "05 04 00 07 00 01", "05 04 02 00 02")
    assert [h.get("unmapped") for h in halves] == [None, "0x0006: 0001", None, "0x0007: 0002"]
    assert not any("energy" in h for h in halves)


def test_other_units_stay_with_the_drives(tmp_path):
    meter_own, drive = ("05 04 00 00 00 01", "05 04 02 08 FC"), ("01 04 00 32 00 01", "01 04 02 01 40")
    sink = read([*slaves(tmp_path), get("mks-modbus")], *meter_own, *drive)
    assert [e.topic for e in sink.entries] == [
        "/bus/5/read_input_registers/request", "/bus/5/read_input_registers/reply",
        "/bus/1/read_speed/request", "/bus/1/read_speed/reply",
    ]  # fmt: skip
    assert not sink.findings


# --- as pymodbus does -------------------------------------------------------------------------------------------------------

TYPES = {"u16": "UINT16", "i16": "INT16", "u32": "UINT32", "i32": "INT32", "u64": "UINT64", "i64": "INT64",
         "f32": "FLOAT32", "f64": "FLOAT64", "string 6": "STRING"}  # fmt: skip


@pytest.mark.parametrize("seed", range(8))
def test_the_values_are_those_of_pymodbus(seed, tmp_path):
    client = pytest.importorskip("pymodbus.client").ModbusTcpClient
    chance = random.Random(seed)
    rows, at = [], 0
    while at < 60:
        kind = chance.choice(list(TYPES))
        count = 3 if kind.startswith("string") else int(kind[1:]) // 16
        rows.append((at, f"v{at}", kind, count, chance.choice(("big", "little"))))
        at += count + chance.choice((0, 0, 1))
    text = "unit,address,name,type,word_order\n" + "".join(f"9,{a},{n},{k},{o}\n" for a, n, k, _, o in rows)
    words = [int.from_bytes(bytes(chance.randint(65, 90) for _ in range(2)), "big") for _ in range(at)]
    reply = f"09 03 {2 * at:02X} " + " ".join(f"{w:04X}" for w in words)
    got = shown(slaves(tmp_path, text), f"09 03 0000 {at:04X}", reply)[1]
    for address, name, kind, count, order in rows:
        own = words[address : address + count]
        own = own[::-1] if order == "little" and kind.startswith("string") else own
        wanted = client.convert_from_registers(own, getattr(client.DATATYPE, TYPES[kind]), word_order=order)
        if kind.startswith("string") and order == "little":
            wanted = client.convert_from_registers(own, client.DATATYPE.STRING)
        assert got[name] == wanted, (kind, order)


# --- which dialect a capture is in ------------------------------------------------------------------------------------------


def traffic(*frames):
    return [Chunk(n * 50_000_000, "bus", rtu(text)) for n, text in enumerate(frames)]


def chosen(items, given=()):
    return [d.name for d in choose([*every(), *of_no_drive()], items, given).dialects]


def test_a_slave_that_works_is_found():
    assert chosen(traffic(*["05 04 00 00 00 02", "05 04 04 08 FC 00 01"] * 4)) == ["modbus"]


def test_a_slave_that_refuses_may_be_a_drive():
    assert "modbus" not in chosen(traffic(*["05 04 00 00 00 02", "05 84 02"] * 4))


@pytest.mark.parametrize("name", SERIAL)
def test_drives_are_still_found(name):
    with open_source(f"captures/{name.replace('-', '_')}.log") as source:
        assert chosen([item for item in source if isinstance(item, Chunk)]) == [name]


def test_beside_a_slave_with_a_list_the_drives_are_found(tmp_path):
    own = traffic(*["05 04 00 00 00 02", "05 04 04 08 FC 00 01"] * 4, *["01 04 00 32 00 01", "01 04 02 01 40"] * 3)
    assert chosen(own, slaves(tmp_path)) == ["meter", "mks-modbus"]
    assert chosen(own[:8], slaves(tmp_path)) == ["meter"]


# --- the commands -----------------------------------------------------------------------------------------------------------


def capture(folder):
    lines = ["05 04 00 00 00 02", "05 04 04 08 FC 00 01"] * 4
    path = folder / "bus.log"
    path.write_text("".join(f"[{n / 20 + 1:.3f}] {'><'[n % 2]} {rtu(t).hex(' ')}\n" for n, t in enumerate(lines)))
    return str(path)


def test_a_slave_that_works_is_no_trouble(tmp_path, cli):
    assert "nothing wrong was found" in cli("diagnose", capture(tmp_path)).out


def test_the_log_and_the_filter_know_the_names(tmp_path, capsys, cli):
    log, out, listed = capture(tmp_path), tmp_path / "out.mcap", meter(tmp_path)
    assert json.loads(cli("decode", log, "--modbus-map", listed, "-o", out, "--json").out)["dialects"] == ["meter"]
    values = [value for topic, *_, value in messages(out.read_bytes()) if topic == "/serial/5/read_input_registers/reply"]
    assert [v["voltage"] for v in values] == [230.0] * 4
    assert b"device_file_meter.csv" in out.read_bytes()
    main(["show", log, "--modbus-map", listed, "--filter", "voltage > 200 V", "--json"])
    assert len(capsys.readouterr().out.splitlines()) == 4
    main(["explain", rtu("05 04 00 00 00 02").hex(), "--dialect", "modbus"])
    assert "read_input_registers" in capsys.readouterr().out


def test_other_devices_are_not_judged_and_not_replayed(cli):
    given = ("captures/devices/meter.log", "--modbus-map", "captures/devices/meter.csv")
    out = cli("check", *given).out
    assert "3 requests, 6 Modbus frames, 3 replies, 10 not of this dialect" in out
    assert "exception" not in out
    out = cli("replay", *given, "--on", "serial:none", "--dry-run").out
    assert "3 x mks-modbus@1 read_speed" in out
    assert "10 frames that are not of this dialect: left out" in out


def test_a_capture_without_times_has_those_of_the_drives_line(tmp_path, capsys):
    path = tmp_path / "wire.bin"
    path.write_bytes(b"".join(rtu(t) for t in ["01 04 00 32 00 01", "01 04 02 01 40", "05 04 00 00 00 01"] * 2))
    main(["show", str(path), "--json", "--dialect", "mks-modbus"])
    alone = [json.loads(line)["time"] for line in capsys.readouterr().out.splitlines()]
    main(["show", str(path), "--json", "--dialect", "mks-modbus", "--modbus-map", meter(tmp_path)])
    assert [json.loads(line)["time"] for line in capsys.readouterr().out.splitlines()] == alone


def row(text):
    return f"unit,address,name,type,scale,offset,table,word_order\n5,0,a,u32,,,,\n# c\n{text}\n"


BAD = {
    "0,5,b,u16": ":4: unit: expected an address from 1 to 247, got '0'",
    "5,70000,b,u16": ":4: address: expected 0 to 65535, as 16 or 0x10, got '70000'",
    "5,0x,b,u16": ":4: address: expected 0 to 65535",
    "5,65535,b,u32": ":4: address: expected 2 registers up to 0xFFFF, got 0xFFFF",
    "5,5,b c,u16": ":4: name: expected letters, digits and _, as b_c, got 'b c'",
    "5,5,role,u16": ":4: name: expected letters",
    "5,5,a,u16": ":4: name: a of unit 5 stands in row 2 already",
    "5,1,b,u16": ":4: address: holding 0x0001 of unit 5 is a (row 2) already",
    "5,5,b,u12": ":4: type: expected u16 i16 u32 i32 u64 i64 f32 f64 bool coil, or string N, got 'u12'",
    "5,5,b,string 999": ":4: type: expected u16",
    "5,5,b,u16,0": ":4: scale: expected a number from 1e-12 to 1e12, as 0.1 or 1/10, got '0'",
    "5,5,b,u16,1e99999999": ":4: scale: expected",
    "5,5,b,u16,1/0": ":4: scale: expected",
    "5,5,b,u16,,,coil": ":4: type: bool expected for coil, got u16",
    "5,5,b,u16,,,spool": ":4: table: expected coil, discrete, holding or input, got 'spool'",
    "5,5,b,u32,,,,middle": ":4: word_order: expected big or little, got 'middle'",
    "5,5,b,u16,,,,,,9": ":4: expected 8 values as in the heading, got 10",
    '5,5,"b': ":4: expected values with ',' between them",
}


@pytest.mark.parametrize("wrong", BAD)
def test_a_wrong_row_is_told_in_one_line_and_nothing_is_written(wrong, tmp_path, cli):
    log, out = capture(tmp_path), tmp_path / "out.mcap"
    err = cli("decode", log, "--modbus-map", meter(tmp_path, row(wrong)), "-o", out, status=2).err
    assert err.count("\n") == 1
    assert f"meter.csv{BAD[wrong]}" in err
    assert not out.exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [("", "expected rows"), ("a,b\n1,2\n", ":1: expected a heading with unit, address"), ("a\0b", "a zero byte at 1")],
)
def test_a_file_that_is_no_list(text, said, tmp_path):
    with pytest.raises(ServotapError, match=said):
        slaves(tmp_path, text)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_a_list_as_excel_writes_it(encoding, tmp_path):
    """With a line for the separator, decimal commas, empty rows and the words of other tools."""
    path = tmp_path / "excel.csv"
    rows = [
        "unit;address;name;type;scale;table",
        "5;0;Länge;UINT16;0,1;Input Register",
        ";;;;;",
        "5;1;b;float32;;",
        "5;3;c;int16;;",
    ]
    path.write_bytes("\r\n".join(["sep=;", *rows, ""]).encode(encoding))
    (dialect,) = load([], [str(path)], print)[0].dialects
    assert shown((dialect,), "05 04 00 00 00 01", "05 04 02 08 FC")[1]["Länge"] == 230
    assert shown((dialect,), "05 03 00 01 00 03", "05 03 06 3F 80 00 00 FF FF")[1] == {
        "register": 1, "quantity": 3, "b": 1, "c": -1
    }  # fmt: skip


def test_numbers_of_a_manual_are_told(tmp_path):
    notes = []
    load(
        [], [meter(tmp_path, "unit,address,name,type\n5,40001,a,u16\n5,40003,b,u16\n6,40001,a,u16\n6,7,b,u16\n")], notes.append
    )
    assert notes == [
        "meter.csv: unit 5: addresses count from 0, as frames have them; if 40001 is meant as manuals number registers, write 0"
    ]


def test_two_lists_of_one_slave(tmp_path):
    with pytest.raises(ServotapError, match=r"unit 5 stands in meter.csv and in other.csv"):
        load([], [meter(tmp_path), meter(tmp_path, name="other.csv")], print)


def test_bytes_of_bits_and_registers():
    assert [read_bytes(function, 9) for function in (1, 2, 3, 4)] == [2, 2, 18, 18]


@pytest.mark.parametrize("seed", range(6))
def test_however_a_line_is_cut_and_damaged_the_same_comes_out(seed):
    """By rows and chunk by chunk, with frames of all functions, junk and lost bytes."""
    chance = random.Random(seed)
    line = bytearray(b"".join(rtu(chance.choice(text.split(" | "))) for text in chance.choices(list(EXCHANGES), k=150)))
    for _ in range(seed * 4):
        line[chance.randrange(len(line))] = chance.randrange(256)
    with short_runs():
        same_line(list(chunks_of(bytes(line), chance, longest=chance.choice((3, 40, 5000)))), get("modbus"), 50)


# --- slaves without a list beside a drive -------------------------------------------------------------------------------

DRIVE = ("01 04 00 32 00 01", "01 04 02 01 40")
UNLISTED, ANSWER = "05 04 00 00 00 02", "05 04 04 00 2A 00 07"


def beside(*frames, listed=None):
    sink = Collect()
    chunks = [Chunk(n * 50_000_000, "bus", rtu(text)) for n, text in enumerate(frames)]
    Pipeline([get("mks-modbus")], [sink], Options(listed=listed)).run(chunks)
    assert not sink.pieces
    return sink


def test_a_slave_of_another_maker_beside_a_drive_is_no_error():
    sink = beside(*(*DRIVE, UNLISTED, ANSWER) * 3, "05 06 00 09 00 01", "05 06 00 09 00 01")
    assert sink.rules == []
    assert [entry.topic for entry in sink.entries][2:4] == ["/bus/5/unknown_read/request", "/bus/5/unknown_read/reply"]
    assert all(entry.request_sequence for entry in sink.entries if entry.message.role is Role.REPLY)
    # What goes wrong with it is told as of any other.
    assert beside(UNLISTED, ANSWER, "05 04 00 08 00 01", "05 84 02").rules == ["modbus_exception"]
    assert beside(UNLISTED, ANSWER, "05 04 00 08 00 01", *DRIVE).rules == ["unanswered"]


@pytest.mark.parametrize(
    ("frames", "rules"),
    [
        # A drive refuses what it does not have, or is silent.
        ((UNLISTED, "05 84 02"), ["unknown_command", "modbus_exception"]),
        ((UNLISTED,), ["unanswered", "unknown_command"]),
        ((UNLISTED, UNLISTED, "05 04 00 01 00 02"), ["unanswered"] * 3 + ["unknown_command"] * 2),
        # A write is answered by itself, which tells nothing.
        (("05 06 00 09 00 01", "05 06 00 09 00 01", *DRIVE), ["unknown_command"] * 2),
        # A drive that was heard is judged in all that it is asked.
        ((*DRIVE, "01 04 00 00 00 02", "01 04 04 00 2A 00 07"), ["unknown_command"]),
    ],
)
def test_a_request_that_no_manual_lists_is_told_where_no_slave_answers(frames, rules):
    assert sorted(beside(*frames).rules) == sorted(rules)


def test_a_register_that_a_drive_has_as_well_is_read_as_the_drives():
    sink = beside(UNLISTED, ANSWER, "05 04 00 32 00 01", "05 04 02 01 40", UNLISTED, ANSWER)
    assert sink.rules == []
    assert sink.entries[3].topic == "/bus/5/read_speed/reply"


def test_who_is_listed_as_a_drive_is_no_other_slave():
    assert "unknown_command" in beside(UNLISTED, ANSWER, listed=frozenset((1, 5))).rules
