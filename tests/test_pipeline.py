"""The pipeline: what comes out depends on the bytes alone, every byte is accounted for, and its state can be moved."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.errors import UsageError
from analyzer.events import DIALECT, PORT
from analyzer.pipeline import Pipeline
from analyzer.port import Options, Port, PortSetup, Setups, topic_name
from analyzer.records import CanFrame, Chunk, Event, Silence
from tests.collect import Collect, can, run, serial, sum8

ASK, ANSWER = sum8("FA 01 32"), sum8("FB 01 32 00 64")
TALK = bytes.fromhex(f"{ASK} {ANSWER} 13 37 {sum8('FA 01 F6 01 40 02')} {sum8('FB 01 F6 01')} FA 01 F6 01") * 3


def of_bytes(pieces):
    return run((Chunk(None, "bus", piece) for piece in pieces), "mks-rs485")


def outcome(sink):
    return sink.shown, sink.rules, [(p.offset, p.data, p.reason) for p in sink.pieces]


@given(st.lists(st.integers(0, len(TALK)), max_size=20))
def test_chunking_does_not_change_the_result(cuts):
    edges = [0, *sorted(cuts), len(TALK)]
    pieces = [TALK[a:b] for a, b in pairwise(edges) if a < b]
    assert outcome(of_bytes(pieces)) == outcome(of_bytes([TALK]))


@given(st.binary(max_size=300), st.sampled_from(["mks-rs485", "mks-modbus", "lk-rs485", "mks-rs485 mks-modbus lk-rs485"]))
def test_every_byte_ends_in_one_frame_or_one_piece_of_junk(data, names):
    sink = run([Chunk(None, "bus", data)], names)
    places = sorted(
        [(e.message.frame.offset, e.message.frame.data) for e in sink.entries] + [(p.offset, p.data) for p in sink.pieces]
    )
    assert b"".join(data for _, data in places) == data
    assert [offset for offset, _ in places] == [sum(len(d) for _, d in places[:n]) for n in range(len(places))]


def test_one_count_numbers_frames_junk_and_events_of_all_buses():
    sink = Collect()
    pipeline = Pipeline([dialects.get("mks-rs485")], (sink,))
    for bus in ("a", "b", "a"):
        pipeline.feed(Chunk(0, bus, bytes.fromhex(ASK)))
        pipeline.feed(Silence(1, bus))
    pipeline.close()
    assert [e.sequence for e in sink.entries] == [1, 2, 3]
    assert [e.topic for e in sink.entries] == [f"/{bus}/1/read_speed/request" for bus in "aba"]


def test_state_moves_into_another_pipeline_in_the_midst_of_a_frame():
    for cut in range(1, len(TALK), 5):
        whole, sink = of_bytes([TALK]), Collect()
        first = Pipeline([dialects.get("mks-rs485")], (sink,))
        first.feed(Chunk(None, "bus", TALK[:cut]))
        second = Pipeline([dialects.get("mks-rs485")], (sink,))
        second.restore(first.state(), {})
        second.feed(Chunk(None, "bus", TALK[cut:]))
        second.close()
        assert outcome(sink) == outcome(whole)


def test_an_event_that_names_dialects_sets_a_bus_up():
    sink = Collect()
    known = dialects.by_name()
    pipeline = Pipeline(dialects.every(), (sink,), on_setup=Setups(known))
    pipeline.feed(Event(0, "a", PORT, {"dialects": ["mks-modbus"], "offset": 100}))
    pipeline.feed(Event(0, "a", DIALECT, {"dialects": ["mks-rs485"], "offset": 100}))
    pipeline.feed(Chunk(0, "a", bytes.fromhex(ASK)))
    pipeline.close()
    assert [(e.message.frame.dialect.name, e.message.frame.offset) for e in sink.entries] == [("mks-rs485", 100)]
    assert Setups(known)(Event(0, "a", PORT, {})) is None


@pytest.mark.parametrize(
    ("frame", "rule"),
    [
        (CanFrame(0, "c", 1, b"", remote=True), "foreign_can_frame"),
        (CanFrame(0, "c", 1, b"\x32"), "foreign_can_frame"),
        (CanFrame(0, "c", 1, b"\x32\x33", fd=True), "foreign_can_frame"),
        (CanFrame(0, "c", 4, bytes(8), error=True), "can_error_frame"),
    ],
)
def test_can_frames_that_no_dialect_can_have_sent(frame, rule):
    assert rule in run([frame], "mks-can", listed=frozenset({1})).rules


def test_a_bus_of_the_other_kind_is_a_mistake_of_the_caller():
    with pytest.raises(UsageError, match="is a serial line"):
        run([Chunk(0, "a", b"\xfa")], "mks-can")
    with pytest.raises(UsageError, match="is a CAN bus"):
        run([CanFrame(0, "a", 1, b"\x32\x33")], "mks-rs485")


@given(st.text(max_size=30))
def test_any_name_of_a_bus_makes_one_part_of_a_topic(text):
    name = topic_name(text)
    assert name
    assert name.isascii()
    assert "/" not in name
    assert topic_name(name) == name


def test_a_port_begins_anew_behind_a_fault():
    port = Port("a", PortSetup((dialects.get("mks-rs485"),)), Options(groups=frozenset({7})))
    port.context.silenced.add(1)
    port.renew()
    assert port.context.groups == {7}
    assert not port.context.silenced


def test_an_unlucky_stream_ends_in_the_same_result_twice():
    data = random.Random(3).randbytes(2000)
    assert outcome(of_bytes([data])) == outcome(of_bytes([data[:999], data[999:]]))


def test_latency_is_told_only_where_a_capture_has_times():
    assert serial("mks-rs485", (0, ASK), (3, ANSWER)).entries[1].latency_ns == 3_000_000
    assert serial("mks-rs485", ASK, ANSWER, timed=False).entries[1].latency_ns is None
    assert can((0, "001#3233"), (2, "001#32006497")).entries[1].latency_ns == 2_000_000
