"""The choice of dialects by what they explain of a sample."""

from __future__ import annotations

import random

import pytest

from analyzer import dialects
from analyzer.detect import choose, weigh
from analyzer.encoder import build
from analyzer.records import CanFrame, Chunk, Comment

SERIAL = [d for d in dialects.every() if d.bus == "serial"]


def polls(name, count, address=1):
    dialect = dialects.get(name)
    read = next(c for c in dialect.commands if c.name == "read_speed")
    return [Chunk(n * 10_000_000, "bus", build(dialect, read, address), burst=True) for n in range(count)]


@pytest.mark.parametrize("name", [d.name for d in SERIAL if any(c.name == "read_speed" for c in d.commands)])
def test_requests_of_one_dialect_are_told_by_their_bytes(name):
    choice = choose(SERIAL, polls(name, 20))
    assert [d.name for d in choice.dialects] == [name]
    assert choice.evidence[0].share == 1.0
    assert choice.evidence[0].frames == 20
    assert name in choice.reason


def test_another_dialect_on_the_same_line_joins():
    mixed = [c for pair in zip(polls("mks-rs485", 20), polls("mks-modbus", 20, 2), strict=True) for c in pair]
    assert {d.name for d in choose(SERIAL, mixed).dialects} >= {"mks-rs485", "mks-modbus"}


def test_noise_is_explained_by_none_and_all_are_tried():
    noise = random.Random(5).randbytes(400)
    choice = choose(SERIAL, [Chunk(0, "bus", noise)])
    assert list(choice.dialects) == SERIAL
    assert "all are tried" in choice.reason
    assert all(weigh(d, [Chunk(0, "bus", noise)]).share < 0.1 for d in SERIAL)


def test_an_empty_sample_and_comments_say_nothing():
    assert list(choose(SERIAL, [Comment(None, "", "started")]).dialects) == SERIAL
    assert weigh(SERIAL[0], []).share == 0.0


def test_the_kind_of_bus_bounds_the_choice():
    frame = CanFrame(0, "can0", 1, bytes.fromhex("F60140023A"))
    assert {d.bus for d in choose(dialects.every(), [frame]).dialects} == {"can"}
