"""Diagnosis of junk without end: a bounded sample is kept and looked at, and what stands behind it is still found."""

from __future__ import annotations

import random

import pytest

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import Awaited, chains, placed
from analyzer.records import Chunk
from tests.diagnosis.test_diagnosis import told, watched

NATIVE = registry.get("mks-rs485")
ASKED, ANSWERED = bytes.fromhex("FA 01 32 2D"), bytes.fromhex("FB 01 32 00 00 2E")


def junk(size, port="bus", start_ns=0):
    """Return random bytes in chunks, none of which begins a frame of the dialect."""
    data = bytes(set(range(256)) - {0xFA, 0xFB, 0xFC})
    source = random.Random(size)
    return [
        Chunk(start_ns + at, port, bytes(source.choices(data, k=min(4096, size - at))), Role.REPLY)
        for at in range(0, size, 4096)
    ]


def kept_junk(items):
    """Return the junk that the scenes have, by bus and place."""
    scenes = watched(items, [NATIVE]).scenes([NATIVE])
    return {scene.bus: [(p.offset, len(p.data)) for p in scene.pieces if p.message is None] for scene in scenes}


def test_all_of_some_junk_is_looked_at():
    assert sum(size for _, size in kept_junk(junk(60_000))["bus"]) == 60_000


def test_of_a_flood_there_is_a_sample_of_its_beginning_and_of_each_time_it_doubles():
    half, whole = (kept_junk(junk(size))["bus"] for size in (1 << 19, 1 << 20))
    sizes = [sum(size for _, size in kept) for kept in (half, whole)]
    assert sizes[0] < sizes[1] < sizes[0] + (1 << 16)
    assert whole[0][0] == 0
    assert any(at >= 1 << 19 for at, _ in whole)


def test_a_flood_on_one_bus_leaves_the_evidence_of_another():
    other = junk(3000, "other", 1 << 30)
    assert sum(size for _, size in kept_junk([*junk(1 << 18), *other])["other"]) == 3000


def test_what_comes_behind_a_flood_is_kept_with_who_sent_it():
    noise = junk(1 << 18)
    late_ns = 1 << 40
    asked, short = ASKED, Chunk(late_ns + 10**9, "bus", b"\x55\x33", Role.REPLY)
    [scene] = watched([*noise, Chunk(late_ns, "bus", asked, Role.REQUEST), short], [NATIVE]).scenes([NATIVE])
    request = next(p for p in scene.pieces if p.is_request)
    assert request.data == asked
    assert scene.direction(request.offset) is Role.REQUEST
    assert scene.stretches[-1].data == short.data


@pytest.mark.parametrize("reads", [1, 100])
def test_a_reply_is_looked_for_where_its_head_stands_alone(monkeypatch, reads):
    looked = []
    stands = Awaited.stands

    def counted(self, data, at):
        looked.append(at)
        return stands(self, data, at)

    monkeypatch.setattr(Awaited, "stands", counted)
    noise = b"".join(chunk.data for chunk in junk(20_000))
    step = len(noise) // reads
    parts = [noise[at : at + step] for at in range(0, len(noise), step)]
    came = [*parts[:-1], parts[-1] + ANSWERED]
    items = [Chunk(0, "bus", ASKED, Role.REQUEST)]
    items += [Chunk(10**9 + 20_000_000 * n, "bus", data, Role.REPLY) for n, data in enumerate(came)]
    [scene] = watched(items, [NATIVE]).scenes([NATIVE])
    [exchange] = chains(scene)[0]
    assert len(exchange.data) == len(noise) + len(ANSWERED)
    [found] = placed(scene)
    assert found.read.offset + found.shift == len(ASKED) + len(noise)
    assert len(looked) == 1


def test_the_frames_of_an_adapter_are_known_in_a_stream_without_end():
    frames = b"".join(b"t%03X20131\r" % (1 + number % 4) for number in range(4000))
    found = told((">", frames))
    assert [each.cause for each in found] == ["adapter_framing"]
