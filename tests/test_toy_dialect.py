"""A fifth dialect: all that works of a drive that stands in one file, and whose CAN identifiers are not addresses."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Role
from analyzer.encoder import assemble
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame
from tests.collect import Collect
from tests.toy.dialect import DIALECT


def _decoded(*frames: tuple[int, str]) -> Collect:
    kept = Collect()
    pipeline = Pipeline((DIALECT,), (kept,), Options())
    for n, (can_id, data) in enumerate(frames):
        pipeline.feed(CanFrame(n * 1_000_000, "can0", can_id, bytes.fromhex(data)))
    pipeline.close()
    return kept


def test_requests_without_data_and_their_replies_are_paired():
    kept = _decoded((2 << 5 | 0x09, ""), (2 << 5 | 0x09, "10 27 00 00"))
    request, reply = kept.entries
    assert (request.topic, reply.topic) == ("/can0/2/read_position/request", "/can0/2/read_position/reply")
    assert (reply.message.values, reply.latency_ns) == ({"position": 10000}, 1_000_000)


def test_nodes_are_told_apart_by_the_upper_bits_of_the_identifier():
    kept = _decoded(
        (1 << 5 | 0x0D, "2C 01 00 00"), (2 << 5 | 0x0D, "D4 FE FF FF"), (1 << 5 | 0x0D, "01"), (2 << 5 | 0x0D, "00")
    )
    assert [(e.message.address, dict(e.message.values)) for e in kept.entries] == [
        (1, {"speed": 300}),
        (2, {"speed": -300}),
        (1, {"status": 1}),
        (2, {"status": 0}),
    ]
    assert kept.rules == ["failed_status"]


def test_a_value_out_of_range_is_a_finding():
    assert _decoded((2 << 5 | 0x0B, "A1 0F")).rules == ["out_of_range", "unanswered"]


@pytest.mark.parametrize("command", DIALECT.commands, ids=lambda c: c.name)
def test_every_vector_is_built_as_it_is_printed(command):
    for vector in command.vectors:
        can_id, data = int(vector.printed.split()[0], 16), bytes.fromhex(vector.printed.partition(" ")[2])
        built = assemble(DIALECT, command, 2, vector.values)
        assert (built.can_id, built.frame, built.role) == (can_id, data, Role.REQUEST)
