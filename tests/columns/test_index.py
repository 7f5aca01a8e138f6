"""The index of a chunk from columns is the one that `mcap` reads."""

from __future__ import annotations

import io
import random

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import MessageIndex

from analyzer.columns.index import index_records
from analyzer.columns.rows import Messages
from analyzer.sinks.mcap_file import McapFile


def read(data: bytes, begin: int) -> MessageIndex:
    assert data[begin] == Opcode.MESSAGE_INDEX
    size = int.from_bytes(data[begin + 1 : begin + 9], "little")
    return MessageIndex.read(ReadDataStream(io.BytesIO(data[begin + 9 : begin + 9 + size])))


def test_records_are_read_by_the_library():
    chance = random.Random(1)
    entries = [(chance.choice((1, 3, 70, 40_000)), 10**18 + n, 40 * n) for n in range(200)]
    data, begins, counts = index_records(*np.array(entries, dtype=np.int64).T)
    assert list(begins) == sorted({channel for channel, _, _ in entries})
    for channel, begin in begins.items():
        found = read(data, begin)
        assert (found.channel_id, found.records) == (channel, [entry[1:] for entry in entries if entry[0] == channel])
        assert counts[channel] == len(found.records)


def test_messages_alone_and_together_are_indexed_in_their_order():
    stream = io.BytesIO()
    file = McapFile(stream, profile="", library="")
    schema = file.add_schema("any", b"{}")
    one, other = (file.add_channel(topic, schema, {}) for topic in ("/one", "/other"))
    begin = file._building.size
    together = (
        np.arange(2 * 35, dtype=np.uint8),
        np.array([0, 35]),
        np.array([35, 70]),
        np.array([one, other]),
        np.array([6, 7]),
    )
    file.add_message(one, 1, 5, 5, b"{ }")
    file.add_messages(Messages(*together))
    file.add_message(one, 2, 8, 8, b"{}")
    data, begins, counts = file._building.indexed()
    assert read(data, begins[one]).records == [(5, begin), (6, begin + 34), (8, begin + 34 + 70)]
    assert read(data, begins[other]).records == [(7, begin + 34 + 35)]
    assert counts == {one: 3, other: 1}
    file.abandon()
