"""A stop passes after any bytes, and never lets out a sound frame that is not allowed."""

from __future__ import annotations

import random

import pytest

from analyzer import dialects
from analyzer.catalogue import Dialect, Risk
from analyzer.encoder import build
from benchmarks import gate as attack
from conformance.gate.gate import Allowance, Gate, Judge
from tests.conformance.vectors import on_can

RUNNING = frozenset({Risk.READ, Risk.MOTION, Risk.UNBOUNDED})


def test_a_stop_is_never_refused_whatever_was_sent_before():
    """A sample of `python -m benchmarks.gate`, which runs a million."""
    assert [told for n in range(400) if (told := attack.history(n, 20))] == []


def test_nothing_forbidden_gets_out_in_any_disguise():
    assert [told for n in range(600) if (told := attack.attack(n, 20))] == []


def test_what_gets_out_is_seen(monkeypatch: pytest.MonkeyPatch):
    """The attacks can fail: they do where all is let through, and where a gate forgets what was sent before."""
    monkeypatch.setattr(Judge, "_objections", lambda *_: [])
    assert sum(bool(attack.attack(n, 20)) for n in range(60)) > 40


def test_a_stop_passes_what_was_read_as_a_package():
    """The case of a shaft that turned on at 180 rpm: the acceleration FC is the head of a package."""
    judge = Judge(Allowance(RUNNING, addresses=frozenset({1})))
    for text in ("FA 01 F6 00 B4 FC A1", *["FA 01 32 2D"] * 10, "FA 01 F6 00 00 C8 B9", "FA 01 32 2D", "FA 01 F7 F2"):
        item = bytes.fromhex(text)
        assert judge.objections(item) == [], text
        judge.admit(item)


def test_what_a_stop_would_complete_is_closed_by_reads_before():
    """The stop is the last piece of a package that checks: a read goes first, and it no longer is."""
    stop, chance, closed = bytes.fromhex("FA 01 F7 F2"), random.Random(3), 0
    while closed < 5:
        body = attack.bait(chance, 1, stop)
        if not any(seen.address is None for seen in attack.sound([b"".join([*body, stop])])):
            continue
        wire = attack.Wire()
        gate = Gate(wire, Allowance(RUNNING, addresses=frozenset({1})))
        for item in [*body, stop]:
            gate.send(item)
        assert wire.written[: len(body)] == body
        assert wire.written[-1] == stop
        closing = wire.written[len(body) : -1]
        assert closing
        assert [s for s in attack.sound(closing) if not s.risks <= attack.READS] == []
        closed += 1


@pytest.mark.parametrize(
    ("address", "sent"),
    [
        # Each ends in a frame for another drive that lacks a byte, and each frame of these drives begins with that byte.
        (0xFA, "FA FA 87 FF 7A"),
        (0xFA, "FA FA 83 F6 10 7D"),
    ],
)
def test_a_drive_whose_address_is_a_head_is_stopped_too(address: int, sent: str):
    wire = attack.Wire()
    allowed = Allowance(RUNNING | {Risk.SETTING, Risk.TORQUE}, addresses=frozenset({address}))
    gate = Gate(wire, allowed)
    stop = build(dialects.get("mks-rs485"), "emergency_stop", address)
    gate.send(bytes.fromhex(sent))
    gate.send(stop)
    assert wire.written[-1] == stop
    assert len(wire.written) == 3, "a filler goes between"
    assert [str(s) for s in attack.sound(wire.written) if attack.forbidden(s, allowed)] == []


@pytest.mark.parametrize("address", [1, 62, 250, 252])
def test_what_was_sent_is_ended_for_a_drive_of_any_address(address: int):
    """Another program may speak next: what it sends must not complete a frame of this one."""
    mks, wire = dialects.get("mks-rs485"), attack.Wire()
    gate = Gate(wire, Allowance())
    gate.send(build(mks, "read_speed", address))
    gate.end_stream((mks, address))
    assert gate.rehearsal().left_open(b"") == ()
    assert [s for s in attack.sound(wire.written) if not s.risks <= attack.READS] == []


@pytest.mark.parametrize("dialect", dialects.every(), ids=lambda d: d.name)
def test_a_stop_of_another_drive_is_no_stop_of_the_drive_that_is_meant(dialect: Dialect):
    judge = Judge(Allowance(RUNNING, addresses=frozenset({1})))
    for stop in attack.stops(dialect.name, 2, 200):
        assert judge.objections(stop if dialect.bus == "serial" else on_can(2, stop)) != []
    for stop in attack.stops(dialect.name, 1, 200):
        assert judge.objections(stop if dialect.bus == "serial" else on_can(1, stop)) == []
