"""The decoding process: what the spools hold becomes a log that is complete, and the same as `decode` makes of its bytes."""

from __future__ import annotations

import io
import json
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from analyzer.cli import main
from analyzer.devices import read as read_files
from analyzer.live.config import CONTROL, WHOLE
from analyzer.live.spool import CanFlag
from tests import CAPTURES
from tests.collect import crc, sum8
from tests.live.spooled import START, UTC, Spools, content, decoded_of, port, raw_of, read, traffic
from tests.logs import metadata

DEVICES = CAPTURES / "devices"

LEFT = port("1-left", "left", byte_ns=260_416, speed=38400)


def decoded_again(log, *words):
    out = log.with_name("again.mcap")
    assert main(["decode", str(log), "-o", str(out), "--force", *words]) == 0
    return out


def test_a_recording_is_a_log_like_any_other(tmp_path):
    spools = Spools(tmp_path, LEFT, port("2-arm", "arm", "can", ("mks-can",), speed=500_000))
    spools.event(CONTROL, 0, "begin", host="bench", version="1", system="linux")
    spools.event("1-left", 0, "open", precision="within 0.1 ms", notes=["RTS could not be held"])
    spools.data("1-left", 10, sum8("FA 01 32"))
    spools.can("2-arm", 12, "001#3031")
    spools.data("1-left", 13, sum8("FB 01 32 FE D4"))
    spools.can("2-arm", 14, "001#3000000000123477")
    spools.event(CONTROL, 15, "mark", text="lifted the arm")
    spools.idle("1-left", 70)
    spools.end(100)
    assert spools.record() == []
    assert not spools.folder.exists()
    rows = read(spools.log)
    topics = [topic for topic, _, _ in rows]
    assert {"/left/1/read_speed/request", "/left/1/read_speed/reply", "/left/1/state"} <= set(topics)
    assert "/arm/1/read_encoder_carry/reply" in topics
    reply = next(value for topic, _, value in rows if topic == "/left/1/read_speed/reply")
    assert (reply["speed"], reply["_offset"]) == (-300, 4)
    assert reply["_latency"] == pytest.approx(3e-3 - 5 * 260_416e-9)
    assert next(v["message"] for t, _, v in rows if t == "/comments") == "lifted the arm"
    assert [m.log_time for t, m, _ in rows if t == "/left/raw"] == [UTC + ms * 1_000_000 for ms in (10, 13, 70)]
    times = [message.log_time for _, message, _ in rows]
    assert times == sorted(times)
    about = metadata(spools.log)
    assert about["bus.left.endpoint"] == "serial:/dev/ttyUSB0"
    assert about["bus.left.notes"] == "RTS could not be held"
    assert about["bus.arm.bit_rate"] == "500000"
    assert about["ended"] == "Ctrl-C"
    assert int(about["bytes_total"]) == int(about["bytes_in_frames"]) + int(about["bytes_junk"])
    assert raw_of([spools.log], "left") == spools.sent["left"]
    assert not [t for t in topics if t == "/arm/raw"]  # its frames stand in the decoded topics
    assert content(decoded_again(spools.log)) == content(spools.log)


def test_what_happened_to_a_port_stands_in_the_log(tmp_path):
    spools = Spools(tmp_path, LEFT)
    spools.data("1-left", 10, sum8("FA 01 32")[:6])
    spools.event("1-left", 20, "lost", reason="unplugged")
    spools.event("1-left", 3020, "back", gap_ns=3_000_000_000, from_ns=START + 20_000_000, reason="unplugged", notes=[])
    spools.data("1-left", 3030, sum8("FA 01 32"))
    spools.event("1-left", 3040, "overrun", from_ns=START, overrun=2)
    spools.event("1-left", 3050, "dropped", lost=70, bytes=70, from_ns=START, to_ns=START, reason="disk full")
    spools.event(CONTROL, 3060, "clock_step", step_ns=-5_000_000_000, cause="the wall clock was set")
    spools.data("1-left", 3070, sum8("FA 01 32"))
    spools.end(4000)
    spools.record()
    found = {v["name"]: v for t, _, v in read(spools.log) if t == "/findings"}
    assert {"port_lost", "port_back", "overrun", "dropped", "clock_step", "junk_truncated"} <= set(found)
    assert "gone for 3.000 s" in found["port_back"]["message"]
    begun, ended = found["port_back"]["timestamp"], UTC + 20_000_000
    assert begun["sec"] * 10**9 + begun["nsec"] == ended
    events = {(v["event"], m.sequence) for t, m, v in read(spools.log) if t == "/recording"}
    assert ("back", found["port_back"]["line"]) in events
    assert metadata(spools.log)["bus.left.lost"] == "70 bytes"
    assert content(decoded_again(spools.log)) == content(spools.log)


def test_bytes_that_a_reader_counted_and_nobody_told_of(tmp_path):
    spools = Spools(tmp_path, LEFT)
    spools.data("1-left", 10, sum8("FA 01 32"))
    spools._counts["1-left"] += 9
    spools.data("1-left", 20, sum8("FB 01 32 FE D4"))
    spools.end(100)
    spools.record()
    assert [v["message"] for t, _, v in read(spools.log) if t == "/findings" and v["name"] == "dropped"] == [
        "9 bytes missing in the stored data"
    ]


def test_two_directions_are_one_bus(tmp_path):
    spools = Spools(tmp_path, port("1-left-a", "left", direction="request"), port("2-left-b", "left", direction="reply"))
    for n in range(20):
        spools.data("1-left-a", 10 * n, sum8("FA 01 32"))
        spools.data("2-left-b", 10 * n + 3, sum8("FB 01 32 FE D4"))
    spools.end(1000)
    spools.record()
    rows = read(spools.log)
    assert [v["_direction"] for t, _, v in rows if t == "/left/raw"] == ["request", "reply"] * 20
    assert sum(t == "/left/1/read_speed/reply" and "_latency" in v for t, _, v in rows) == 20
    assert not [t for t, _, _ in rows if t == "/findings"]
    assert content(decoded_again(spools.log)) == content(spools.log)


def test_can_directions_and_flags_survive(tmp_path):
    spools = Spools(tmp_path, port("1-arm", "arm", "can", ("mks-can",)))
    spools.can("1-arm", 1, "001#3031", CanFlag.TX)
    spools.can("1-arm", 2, "001#3000000000123477")
    spools.can("1-arm", 3, "18DAF110#0102", CanFlag.EXTENDED)
    spools.can("1-arm", 4, "20000004#0000000000000000", CanFlag.ERROR)
    spools.end(100)
    spools.record()
    frames = [v for t, _, v in read(spools.log) if "_can_id" in v]
    assert [v.get("_direction") for v in frames] == ["request", "reply", "reply", "reply"]
    assert content(decoded_again(spools.log)) == content(spools.log)


@pytest.mark.parametrize(("kind", "text"), [("serial", sum8("FA 01 32")), ("can", "001#3031")])
def test_raw_only_is_decoded_later(tmp_path, kind, text):
    folders = []
    for raw_only in (False, True):
        folder = tmp_path / str(raw_only)
        folder.mkdir()
        dialects = ("mks-can",) if kind == "can" else ("mks-rs485",)
        spools = Spools(folder, port("1-x", "x", kind, dialects), raw_only=raw_only)
        for n in range(5):
            (spools.can if kind == "can" else spools.data)("1-x", 100 * n, text)
            spools.idle("1-x", 100 * n + 50)
        spools.end(1000)
        spools.record()
        folders.append(spools.log)
    full, raw = folders
    assert {t for t, _, _ in read(raw)} == {"/recording", "/x/raw"}
    assert content(decoded_again(raw))[2:] == content(full)[2:]


def test_raw_only_without_a_dialect(tmp_path):
    """Each bus is judged by its own traffic when it is decoded later."""
    ports = (port("1-a", "a", dialects=()), port("2-b", "b", dialects=()), port("3-arm", "arm", "can", ()))
    spools = Spools(tmp_path, *ports, raw_only=True)
    for n in range(30):
        for stem, pieces in (("1-a", modbus(n)), ("2-b", (sum8("FA 01 32"), sum8("FB 01 32 FE D4")))):
            for at, piece in enumerate(pieces):
                spools.data(stem, 100 * n + 3 * at, piece)
        spools.can("3-arm", 100 * n, "001#3031")
    spools.end(4000)
    spools.record()
    out = decoded_again(spools.log)
    assert metadata(out)["dialect"] == "mks-modbus,mks-rs485,mks-can"
    topics = {t for t, _, _ in read(out)}
    assert {"/b/1/read_speed/reply", "/arm/1/read_encoder_carry/request"} <= topics
    assert not [t for t in topics if t.endswith("/junk")]


# --- the dialect ----------------------------------------------------------------------------------------------------


def modbus(n):
    return crc(f"01 04 00 32 00 {1 + n % 2:02X}"), crc("01 04 02 00 10" if n % 2 == 0 else "01 04 04 00 10 00 20")


def test_the_dialect_is_found_before_anything_is_decoded(tmp_path):
    spools = Spools(tmp_path, port("1-left", "left", dialects=()), port("2-right", "right", dialects=()))
    for n in range(30):
        request, reply = modbus(n)
        spools.data("1-left", 10 * n, request)
        spools.data("1-left", 10 * n + 3, reply)
        spools.data("2-right", 10 * n + 5, sum8("FA 01 32"))
        spools.data("2-right", 10 * n + 7, sum8("FB 01 32 FE D4"))
    spools.end(1000)
    spools.record()
    assert {t.split("/")[1] for t, _, v in read(spools.log) if "junk" in t} == set()
    about = metadata(spools.log)
    assert (about["bus.left.dialect"], about["bus.right.dialect"]) == ("mks-modbus", "mks-rs485")
    assert "30 good frames" in about["bus.left.dialect_reason"]
    assert raw_of([spools.log], "left") == decoded_of([spools.log], "left") == spools.sent["left"]
    assert content(decoded_again(spools.log)) == content(spools.log)


def test_noise_is_no_dialect_and_it_is_tried_again(tmp_path):
    spools = Spools(tmp_path, port("1-left", "left", dialects=()))
    chance = random.Random(1)
    for n in range(20):
        spools.data("1-left", 100 * n, bytes(chance.choice(b"\x00\x55\xaa\x10\x77") for _ in range(20)))
        spools.idle("1-left", 100 * n + 60)
    for n in range(200):
        spools.data("1-left", 3000 + 50 * n, sum8("FA 01 32"))
        spools.data("1-left", 3003 + 50 * n, sum8("FB 01 32 FE D4"))
    spools.end(20_000)
    # In steps: while it comes, as it would be live.
    spools.record()
    said = [v for t, _, v in read(spools.log) if t == "/recording" and v["event"] == "dialect"]
    assert said[0]["dialects"] == ["mks-rs485", "mks-modbus", "lk-rs485"]
    assert raw_of([spools.log], "left") == decoded_of([spools.log], "left") == spools.sent["left"]
    assert content(decoded_again(spools.log)) == content(spools.log)


# --- however it comes -----------------------------------------------------------------------------------------------


@settings(max_examples=15)
@given(st.data())
def test_the_log_is_what_decode_makes_of_its_bytes(tmp_path_factory, data):
    """Random chunks, pauses and idle marks, with any times."""
    folder = tmp_path_factory.mktemp("equal")
    auto = data.draw(st.booleans())
    byte_ns = data.draw(st.sampled_from([0, 260_416, 2_500]))
    names = () if auto else ("mks-rs485", "mks-modbus")
    spools = Spools(folder, port("1-left", "left", dialects=names, byte_ns=byte_ns))
    stream = b"".join(piece for _, piece in traffic(data.draw(st.integers(0, 1000)), data.draw(st.integers(1, 12))))
    ms, at = 1.0, 0
    while at < len(stream):
        size = data.draw(st.integers(1, 12))
        ms += data.draw(st.sampled_from([0, 0.1, 1, 3, 24, 26, 60, 200, 6000]))
        if data.draw(st.booleans()):
            spools.idle("1-left", ms)
        ms += data.draw(st.sampled_from([0, 0.5, 5]))
        spools.data("1-left", ms, stream[at : at + size])
        at += size
    spools.end(ms + 1)
    spools.record()
    assert raw_of([spools.log], "left") == decoded_of([spools.log], "left") == stream
    assert content(decoded_again(spools.log)) == content(spools.log)


def test_the_library_reads_it(tmp_path):
    spools = Spools(tmp_path, LEFT)
    for n in range(300):
        spools.data("1-left", 10 * n, sum8("FA 01 32"))
    spools.end(5000)
    spools.record()
    reader = make_reader(io.BytesIO(spools.log.read_bytes()), validate_crcs=True)
    summary = reader.get_summary()
    assert summary.statistics.message_count == sum(1 for _ in reader.iter_messages())
    assert len(list(reader.iter_messages(topics=["/left/1/read_speed/request"]))) == 300


def test_every_message_obeys_its_schema(tmp_path):
    """By Foxglove's rules, with any note of a reader."""
    import jsonschema

    from tests.test_mcap_log import check_schema

    spools = Spools(tmp_path, LEFT, port("2-arm", "arm", "can", ("mks-can",)), groups=(3,), model="57D")
    spools.event("1-left", 0, "open", precision="p", notes=["n"], odd={"a": [1]}, count="many", speed=None)
    spools.data("1-left", 10, sum8("FA 01 F6 0F A0 02"))
    spools.can("2-arm", 12, "18DAF110#01", CanFlag.EXTENDED | CanFlag.TX)
    spools.event("2-arm", 15, "bus_error", reason="bus off", count=3, from_ns=START)
    spools.event("1-left", 20, "news", text="of another version", more=True)
    spools.idle("1-left", 90)
    spools.end(100)
    spools.record()
    with spools.log.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            declared, value = json.loads(schema.data), json.loads(message.data)
            check_schema(declared)
            jsonschema.validate(value, declared)
            assert set(value) <= set(declared["properties"]), channel.topic
            assert None not in value.values()
    events = {v["event"]: v for t, _, v in read(spools.log) if t == "/recording"}
    assert json.loads(events["open"]["details"]) == {"odd": "{'a': [1]}", "count": "many"}
    assert events["news"]["text"] == "of another version"
    found = {v["name"]: v for t, _, v in read(spools.log) if t == "/findings"}
    assert (found["bus_error"]["level"], found["bus_error"]["message"]) == (4, "bus off, 3 times")
    assert content(decoded_again(spools.log)) == content(spools.log)


def test_a_line_that_changes_its_speed(tmp_path):
    """Both directions of a tap tell it; the times of bytes follow, also when the log is decoded again."""
    ports = (port("1-left-a", "left", direction="request"), port("2-left-b", "left", direction="reply"))
    spools = Spools(tmp_path, *ports)
    spools.data("1-left-a", 1, sum8("FA 01 32"))
    for stem in ("1-left-a", "2-left-b"):
        spools.event(stem, 5, "speed", speed=9600, byte_ns=1_041_667, text="9600 Bd")
    spools.data("1-left-a", 50, sum8("FA 01 32"))
    spools.data("2-left-b", 80, sum8("FB 01 32 FE D4"))
    spools.end(200)
    spools.record()
    last = [m for t, m, _ in read(spools.log) if t == "/left/1/read_speed/request"][-1]
    assert last.log_time - last.publish_time == 3 * 1_041_667
    assert content(decoded_again(spools.log)) == content(spools.log)


def test_what_the_decoder_cannot_do_costs_no_byte(tmp_path, monkeypatch):
    """A fault of this program in the midst of decoding: told, and gone on behind it."""
    from analyzer.decoder import Decoder

    real, calls = Decoder.decode, []

    def faulty(self, frame, context=None):
        calls.append(frame)
        if len(calls) == 3:
            raise KeyError("a fault for the test")
        return real(self, frame, context)

    spools = Spools(tmp_path, LEFT)
    for n in range(10):
        spools.data("1-left", 100 * n, sum8("FA 01 F6 0F A0 02"))
        spools.data("1-left", 100 * n + 3, sum8("FB 01 F6 01"))
        spools.idle("1-left", 100 * n + 60)
    spools.end(2000)
    monkeypatch.setattr(Decoder, "decode", faulty)
    spools.record()
    monkeypatch.setattr(Decoder, "decode", real)
    assert raw_of([spools.log], "left") == spools.sent["left"]
    assert [v["name"] for t, _, v in read(spools.log) if t == "/findings" and v["name"] == "decoder_fault"]
    assert sum(t == "/left/1/run_speed/reply" for t, _, _ in read(spools.log)) >= 8
    again = decoded_again(spools.log)
    assert sum(t == "/left/1/run_speed/reply" for t, _, _ in read(again)) == 10


def test_the_supervisor_died(tmp_path):
    """Without an end record the leash is gone: the rest is read, and the log is finished."""
    import subprocess
    import sys

    spools = Spools(tmp_path, LEFT)
    for n in range(20):
        spools.data("1-left", n, sum8("FA 01 32"))
    spools.event("1-left", 30, "closed", reason="the supervisor has gone")
    process = subprocess.Popen([sys.executable, "-m", "analyzer.live.recorder", str(spools.folder)], stdin=subprocess.PIPE)
    process.stdin.close()
    assert process.wait(30) == WHOLE
    assert not spools.folder.exists()
    assert "died" in metadata(spools.log)["ended"]
    assert raw_of([spools.log], "left") == spools.sent["left"]


# --- other devices --------------------------------------------------------------------------------------------------


def meter_traffic(spools, stem, count):
    for n in range(count):
        spools.data(stem, 100 * n, crc("05 04 00 00 00 02"))
        spools.data(stem, 100 * n + 9, crc("05 04 04 08 FC 00 00"))
        spools.data(stem, 100 * n + 50, crc("01 04 00 32 00 01"))
        spools.data(stem, 100 * n + 59, crc("01 04 02 01 40"))


@pytest.mark.parametrize("dialects", [(), ("mks-modbus",)])
def test_files_of_other_devices_decode_what_is_recorded(dialects, tmp_path):
    files = tuple(read_files([str(DEVICES / "battery.dbc")], [str(DEVICES / "meter.csv")]))
    ports = port("1-left", "left", dialects=dialects), port("2-arm", "arm", "can", ("mks-can",))
    spools = Spools(tmp_path, *ports, devices=files)
    meter_traffic(spools, "1-left", 20)
    spools.can("2-arm", 5, "123#E001F4FF01004100")
    spools.can("2-arm", 6, "001#3233")
    spools.end(5000)
    # Recovering needs the folder alone.
    spools.record_and_be_killed(30, 7)
    spools.record()
    rows = read(spools.log)
    (battery,) = [value for topic, _, value in rows if topic == "/arm/291/battery_status/message"]
    assert battery["voltage"] == 48
    meter = [value for topic, _, value in rows if topic == "/left/5/read_input_registers/reply"]
    assert [value["voltage"] for value in meter] == [230] * 20
    assert sum(topic == "/left/1/read_speed/reply" for topic, _, _ in rows) == 20
    assert not [value for topic, _, value in rows if topic == "/findings" and value["name"] == "unknown_command"]
    about = metadata(spools.log)
    assert "SHA-256" in about["device_file_meter.csv"]
    assert about["bus.left.dialect"] == "meter,mks-modbus"


@pytest.mark.parametrize("dialects", [(), ("modbus",)])
def test_a_slave_of_any_make_is_recorded(dialects, tmp_path):
    spools = Spools(tmp_path, port("1-left", "left", dialects=dialects))
    for n in range(20):
        spools.data("1-left", 100 * n, crc("05 04 00 00 00 02"))
        spools.data("1-left", 100 * n + 9, crc("05 04 04 08 FC 00 00"))
    spools.end(5000)
    spools.record()
    found = [value for topic, _, value in read(spools.log) if topic == "/left/5/read_input_registers/reply"]
    assert [value["values"] for value in found] == [[0x08FC, 0]] * 20
    assert metadata(spools.log)["bus.left.dialect"] == "modbus"
    assert content(decoded_again(spools.log)) == content(spools.log)
