"""`mcap` reads the index of a chunk that was made from columns."""

from __future__ import annotations

import io
import random
from array import array

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import MessageIndex

from analyzer.columns.index import index_records
from analyzer.columns.rows import Messages
from analyzer.sinks.mcap_chunk import Chunk


def read(data: bytes, begin: int) -> MessageIndex:
    assert data[begin] == Opcode.MESSAGE_INDEX
    size = int.from_bytes(data[begin + 1 : begin + 9], "little")
    return MessageIndex.read(ReadDataStream(io.BytesIO(data[begin + 9 : begin + 9 + size])))


def test_records_are_read_by_the_library():
    chance = random.Random(1)
    entries = [(chance.choice((1, 3, 70, 40_000)), 10**18 + n, 40 * n) for n in range(200)]
    data, channels, begins, counts = index_records(
        np.array([channel for channel, _, _ in entries], dtype=np.uint16), np.array([entry[1:] for entry in entries])
    )
    assert channels == sorted({channel for channel, _, _ in entries})
    for channel, begin, count in zip(channels, begins, counts, strict=True):
        found = read(data, begin)
        assert (found.channel_id, found.records) == (channel, [entry[1:] for entry in entries if entry[0] == channel])
        assert count == len(found.records)


def alone(channel: int, *times: int) -> Chunk:
    """Return a chunk of messages of 33 bytes that come one by one."""
    chunk = Chunk()
    for t_ns in times:
        chunk.index.setdefault(channel, array("Q")).extend((t_ns, chunk.size))
        chunk.parts.append(bytes(33))
        chunk.size += 33
        chunk.messages += 1
        chunk.first_ns, chunk.last_ns = chunk.first_ns or t_ns, t_ns
    return chunk


def test_messages_alone_and_together_are_indexed_in_their_order():
    one, other = 3, 9

    def together() -> Messages:
        channels, entries = np.array([one, other], dtype=np.uint16), np.array([(6, 0), (7, 35)])
        return Messages(np.arange(2 * 35, dtype=np.uint8), np.array([35, 70]), channels, entries)

    chunk = alone(one, 5)
    assert chunk.fill(together(), 0, 1 << 20) == 2
    chunk.join(alone(one, 8, 9))
    data, channels, begins, counts = chunk.indexed()
    assert (channels.tolist(), counts.tolist()) == ([one, other], [4, 1])
    assert read(data, begins[0]).records == [(5, 0), (6, 33), (8, 103), (9, 136)]
    assert read(data, begins[1]).records == [(7, 68)]
    assert (chunk.first_ns, chunk.last_ns, chunk.messages, chunk.size) == (5, 9, 5, 169)
    # The message that fills a chunk is its last.
    assert [Chunk().fill(together(), at, 35) for at in (0, 1)] == [1, 2]


def test_a_message_in_a_gap_between_others_makes_one_part_with_them():
    codes, chunk, channel = np.arange(35 + 33 + 35, dtype=np.uint8), Chunk(), np.array([3], dtype=np.uint16)
    chunk.fill(Messages(codes, np.array([35]), channel, np.array([(5, 0)])), 0, 1 << 20)
    chunk.join(alone(9, 6), (codes, 35))
    chunk.fill(Messages(codes, np.array([35 + 33 + 35]), channel, np.array([(7, 35 + 33)])), 0, 1 << 20)
    assert chunk.parts == [codes.tobytes()]
    data, channels, begins, _ = chunk.indexed()
    assert [(each, read(data, begin).records) for each, begin in zip(channels, begins, strict=True)] == [
        (3, [(5, 0), (7, 68)]), (9, [(6, 35)]),
    ]  # fmt: skip
