"""The log, read back by the `mcap` reader and by an independent one: complete, in order, by Foxglove's rules."""

from __future__ import annotations

import io
import json

import jsonschema
import pytest
from mcap.reader import make_reader

from analyzer import dialects
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sinks.mcap_log import McapLog
from tests.collect import Collect, crc, sum8

MS = 1_000_000
START = 1_700_000_000_000_000_000


def serial_items():
    rows = [
        (0, sum8("FA 01 31")),
        (3, sum8("FB 01 31 00 00 00 00 40 00")),
        (10, sum8("FA 01 32")),
        (13, sum8("FB 01 32 FE D4")),
        (20, "00 55 AA"),
        (30, sum8("FA 01 F6 0F A0 02")),
        (33, sum8("FB 01 F6 01")),
        (40, sum8("FA 01 32")[:-2] + "00"),
        (50, sum8("FC" + "01 F6 00 32 0A 00 00 00 00 00" + "02 F3 01 00 00 00 00 00 00 00" + "00" * 30)),
        (1500, sum8("FA 01 30")),
        (1503, sum8("FB 01 30 FF FF FF FF 22 69")),
        (1510, crc("05 03 00 10 00 02")),
        (1600, sum8("FA 01 32")),
        (1590, sum8("FB 01 32 00 00")),
    ]
    for at, text in rows:
        yield Chunk(START + at * MS, "left", bytes.fromhex(text), burst=True)
    yield Comment(None, "left", "a \x1b[31mcomment <b>")


def write(items, names):
    stream = io.BytesIO()
    log, collect = McapLog(stream, byte_ns=260_416), Collect()
    pipeline = Pipeline([dialects.get(n) for n in names.split()], (log, collect), Options(byte_ns=260_416))
    pipeline.run(items)
    log.finish({"source": "test", "bytes_total": str(sum(p.bytes_in for p in pipeline.ports.values()))})
    return stream.getvalue(), collect


@pytest.fixture(scope="module")
def written():
    return write(serial_items(), "mks-rs485 mks-modbus")


def read(data):
    return [(s, c, m, json.loads(m.data)) for s, c, m in make_reader(io.BytesIO(data)).iter_messages(log_time_order=False)]


def test_every_frame_is_there_once_and_in_order(written):
    data, collect = written
    rows = [(m.sequence, c.topic) for _, c, m, _ in read(data) if not c.topic.endswith(("state", "stats", "findings"))]
    wanted = [(e.sequence, e.topic) for e in collect.entries]
    assert [r for r in rows if not r[1].endswith(("junk", "comments"))] == wanted
    raw = "".join(v["_raw"] for _, c, _, v in read(data) if "_raw" in v).replace(" ", "")
    assert bytes.fromhex(raw) == b"".join(i.data for i in serial_items() if isinstance(i, Chunk))


def test_an_independent_reader_sees_the_same(written):
    small = pytest.importorskip("small_mcap")
    data, _ = written
    ours = [(c.topic, m.sequence, m.log_time, m.publish_time, m.data) for _, c, m, _ in read(data)]
    theirs = [
        (c.topic, m.sequence, m.log_time, m.publish_time, bytes(m.data)) for _, c, m in small.read_message(io.BytesIO(data))
    ]
    assert sorted(theirs) == sorted(ours)


def test_times_never_decrease_and_the_wire_time_is_before(written):
    data, _ = written
    times = [m.log_time for _, _, m, _ in read(data)]
    assert times == sorted(times)
    assert all(m.publish_time <= m.log_time for _, _, m, _ in read(data))
    first = read(data)[0][2]
    assert (first.log_time, first.log_time - first.publish_time) == (START, 3 * 260_416)


def check_schema(schema):
    assert schema["type"] == "object"
    text = json.dumps(schema)
    assert "anyOf" not in text
    assert "null" not in text

    def walk(node):
        if isinstance(node, dict):
            assert not isinstance(node.get("type"), list)
            for value in node.values():
                walk(value)

    walk(schema)


def test_schemas_obey_foxglove_and_every_message_its_schema(written):
    data, _ = written
    for schema, channel, _, value in read(data):
        assert schema is not None, channel.topic
        assert schema.encoding == "jsonschema"
        declared = json.loads(schema.data)
        check_schema(declared)
        jsonschema.validate(value, declared)
        assert set(value) <= set(declared["properties"]), channel.topic
        assert None not in value.values()


def test_every_command_has_a_schema_that_obeys():
    from analyzer.catalogue import Role
    from analyzer.sinks.schemas import command_schema

    for dialect in dialects.every():
        for command in dialect.commands:
            for role in (Role.REQUEST, Role.REPLY):
                check_schema(json.loads(command_schema(dialect, command, role)))


def test_units_and_sections_stand_in_schema_and_channel(written):
    data, _ = written
    by_topic = {c.topic: (s, c) for s, c, _, _ in read(data)}
    schema, channel = by_topic["/left/1/read_speed/reply"]
    assert channel.metadata["section"] == "5.1.3"
    assert channel.metadata["dialect"] == "mks-rs485"
    assert "V1.0.5" in channel.metadata["manual"]
    assert json.loads(schema.data)["properties"]["speed"]["unit"] == "rpm"
    assert "5.1.3" in json.loads(schema.data)["properties"]["speed"]["description"]


def test_fields_are_flat_and_replies_carry_latency(written):
    data, _ = written
    reply = next(v for _, c, _, v in read(data) if c.topic == "/left/1/read_speed/reply")
    assert reply["speed"] == -300
    assert reply["_raw"] == "FB 01 32 FE D4 00"
    assert reply["_checksum_ok"] is True
    assert reply["_request_sequence"] == 3
    assert reply["_latency"] == pytest.approx(3e-3 - 5 * 260_416e-9)
    run = next(v for _, c, _, v in read(data) if c.topic == "/left/1/run_speed/request")
    assert (run["speed"], run["direction"], run["direction_name"]) == (4000, 0, "ccw")
    assert run["_findings"] == ["out_of_range"]


def test_the_state_has_the_same_units_for_every_dialect(written):
    data, _ = written
    states = [v for _, c, _, v in read(data) if c.topic == "/left/1/state"]
    assert states[0] == {"position": 360.0}
    assert states[1] == {"speed": -300.0}
    assert states[2]["position"] == pytest.approx((-1 * 16384 + 0x2269) * 360 / 16384)


def test_findings_are_foxglove_logs_that_lead_to_their_message(written):
    data, collect = written
    logs = [(s, v) for s, c, _, v in read(data) if c.topic == "/findings"]
    assert {s.name for s, _ in logs} == {"foxglove.Log"}
    assert [v["name"] for _, v in logs] == collect.rules
    messages = {(c.topic, m.sequence): v for _, c, m, v in read(data) if c.topic != "/findings"}
    for _, value in logs:
        assert messages[value["file"], value["line"]]["_offset"] == value["offset"]
        assert value["level"] in (2, 3, 4)
        assert set(value["timestamp"]) == {"sec", "nsec"}


def test_a_package_is_a_list_of_slots(written):
    data, _ = written
    value = next(v for _, c, _, v in read(data) if c.topic == "/left/all/long_package/request")
    assert [(s["address"], s["command"]) for s in value["slots"]] == [(1, "run_speed"), (2, "enable")]
    assert value["slots"][0]["speed"] == 50


def test_stats_count_each_second_and_metadata_is_complete(written):
    data, collect = written
    stats = [v for _, c, _, v in read(data) if c.topic == "/left/stats"]
    assert len(stats) == 2
    assert sum(s["frames"] for s in stats) == len(collect.entries)
    assert sum(s["bytes"] for s in stats) == sum(len(i.data) for i in serial_items() if isinstance(i, Chunk))
    assert all(0 < s["load"] < 1 for s in stats)
    reader = make_reader(io.BytesIO(data))
    assert reader.get_header().profile == "servotap"
    assert [m.metadata["source"] for m in reader.iter_metadata()] == ["test"]
    summary = reader.get_summary()
    assert summary.statistics.message_count == len(read(data))
    assert summary.statistics.channel_message_counts == {
        i: sum(1 for _, c, _, _ in read(data) if c.id == i) for i in summary.channels
    }


def test_a_comment_is_text(written):
    data, _ = written
    assert [v["message"] for _, c, _, v in read(data) if c.topic == "/comments"] == ["a \x1b[31mcomment <b>"]


def test_can_frames_keep_id_and_flags():
    items = [
        CanFrame(START, "can0", 1, bytes.fromhex("F60140023A")),
        CanFrame(START + MS, "can0", 1, bytes.fromhex("F601F8")),
        CanFrame(START + 2 * MS, "can0", 0x18DAF110, b"\x01\x02", extended=True),
        CanFrame(START + 3 * MS, "can0", 0x20000004, bytes(8), error=True),
    ]
    data, collect = write(items, "mks-can")
    values = [(c.topic, v) for _, c, _, v in read(data)]
    assert ("/can0/1/run_speed/request", 1) in [(t, v.get("_can_id")) for t, v in values]
    assert [v["_can_flags"] for t, v in values if t == "/can0/unknown"] == [["error"]]
    foreign = next(v for t, v in values if t == "/can0/foreign")
    assert foreign == {
        "address": 0x18DAF110, "who": "0x18DAF110", "length": 2, "_raw": "01 02", "_offset": 8, "_can_id": 0x18DAF110,
        "_can_flags": ["extended"],
    }  # fmt: skip
    assert collect.rules == ["can_error_frame"]


def test_large_logs_have_chunks_with_indexes():
    items = [Chunk(START + i * MS, "left", bytes.fromhex(sum8("FA 01 32"))) for i in range(9000)]
    data, _ = write(items, "mks-rs485")
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert len(summary.chunk_indexes) > 1
    reader = make_reader(io.BytesIO(data))
    seen = list(reader.iter_messages(topics=["/left/1/read_speed/request"], starting_at=START + 8990 * MS))
    assert len(seen) == 10
