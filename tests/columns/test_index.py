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
    data, indexes = index_records(*np.array(entries, dtype=np.int64).T)
    assert [channel for channel, _, _ in indexes] == sorted({channel for channel, _, _ in entries})
    for channel, begin, count in indexes:
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
    columns = [[0, 35], [35, 70], [one, other], [6, 7]]
    together = Messages(np.arange(2 * 35, dtype=np.uint8), *(np.array(column) for column in columns))
    chunk = alone(one, 5)
    assert chunk.fill(together, 0, 1 << 20) == 2
    chunk.join(alone(one, 8, 9))
    data, indexes = chunk.indexed()
    assert [(channel, count) for channel, _, count in indexes] == [(one, 4), (other, 1)]
    assert read(data, indexes[0][1]).records == [(5, 0), (6, 33), (8, 103), (9, 136)]
    assert read(data, indexes[1][1]).records == [(7, 68)]
    assert (chunk.first_ns, chunk.last_ns, chunk.messages, chunk.size) == (5, 9, 5, 169)
    # The message that fills a chunk is its last.
    assert [Chunk().fill(together, at, 35) for at in (0, 1)] == [1, 2]
