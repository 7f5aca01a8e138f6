"""Lanes, the fast path of usual frames, give the same results as the slow path, for any frames in any order."""

from __future__ import annotations

import random

import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.decoder import Decoder, physical
from analyzer.encoder import assemble
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk
from tests.collect import Collect, sum8

MS = 1_000_000
#: Requests of MKS drives whose code has several commands, and some others.
REQUESTS = (
    "F6 00 00 02", "F6 01 40 02", "F6 00 00 00", "F6 8F FF 01", "FD 01 40 02 00 00 FA 00", "FD 00 00 02 00 00 00 00",
    "F4 01 40 02 00 00 FA 00", "32", "33", "80 00", "84 00", "8C 00 01", "8C 01 01",
)  # fmt: skip


def native(chance):
    """An exchange of an MKS drive, good or not."""
    address = chance.choice(("01", "02"))
    request = chance.choice(REQUESTS)
    yield f"FA {address} {request}"
    if chance.random() < 0.9:
        status = chance.choice(("00", "01", "01", "01", "02", "03"))
        code = request[:2]
        yield f"FB {address} {code} " + {"32": f"00 {status}", "33": f"00 00 00 {status}"}.get(code, status)


def asked(dialect, command, chance):
    """A request of a Modbus register and mostly its reply; some of another function, address or register, some not listed."""
    address = chance.choice((1, 1, 2, chance.randint(3, 200)))
    if chance.random() < 0.2:
        yield dialect.link.completed(bytes((address, chance.choice((3, 4)), 0x12, 0x34, 0, 2)))
    yield assemble(dialect, command, address, {}, Role.REQUEST).item()
    if chance.random() < 0.2:
        other = chance.choice(dialect.commands)
        yield assemble(dialect, other, address, {}, Role.REQUEST).item()
    if chance.random() < 0.2:
        command = chance.choice([c for c in dialect.commands if c.reply_forms])
        address = chance.choice((1, 2))
    if command.reply_forms and chance.random() < 0.9:
        yield assemble(dialect, command, address, {}, Role.REPLY).item()


def items(dialect, chance):
    ms = 0
    for _ in range(60):
        ms += chance.choice((1, 2, 3, 30, 1200))
        if dialect.name == "mks-rs485":
            for text in native(chance):
                ms += 2
                yield Chunk(ms * MS, "b", bytes.fromhex(sum8(text)))
            continue
        command = chance.choice(dialect.commands)
        if dialect.name == "mks-modbus" and chance.random() < 0.7:
            for request in asked(dialect, command, chance):
                ms += 2
                yield Chunk(ms * MS, "b", request)
            continue
        vector = chance.choice(command.vectors) if command.vectors else None
        if vector is not None and dialect.bus == "can":
            yield CanFrame(ms * MS, "b", 1, bytes.fromhex(vector.printed)[-8:])
        elif vector is not None:
            yield Chunk(ms * MS, "b", bytes.fromhex(vector.printed))


def outcome(traffic, dialect):
    sink = Collect()
    Pipeline([dialect], [sink], Options(byte_ns=100)).run(traffic)
    entries = [
        (e.topic, e.sequence, e.message.role, e.message.command, physical(e.message), e.latency_ns, e.request_sequence,
         e.first_reply, e.findings)
        for e in sink.entries
    ]  # fmt: skip
    return entries, [(f.rule, f.text, f.sequence) for f in sink.findings]


@pytest.mark.parametrize("dialect", dialects.every(), ids=lambda d: d.name)
def test_the_same_as_the_long_way(dialect, monkeypatch):
    used = [0, 0]
    real = Decoder.lane

    def counted(self, frame, context):
        lane = real(self, frame, context)
        used[lane is not None] += 1
        return lane

    for seed in range(12):
        traffic = list(items(dialect, random.Random(seed)))
        monkeypatch.setattr(Decoder, "lane", counted)
        short = outcome(traffic, dialect)
        monkeypatch.setattr(Decoder, "lane", lambda self, frame, context: None)
        assert outcome(traffic, dialect) == short
    assert used[1]
