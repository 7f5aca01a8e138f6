"""A stop is never refused: whatever was sent before, and without a sound frame getting out that was not allowed."""

from __future__ import annotations

import contextlib
import random
from functools import cache

import pytest

from analyzer import dialects
from analyzer.catalogue import Dialect, MotionKind, Risk, Role
from analyzer.codec import codec
from analyzer.encoder import build
from analyzer.live import endpoint as endpoints
from analyzer.records import CanFrame, Chunk
from conformance.bus.line import Line
from conformance.gate.gate import Allowance, Gate, Judge, Refused
from conformance.gate.interpretations import Interpretation, Pending, SerialInterpreter
from tests.conformance.vectors import on_can

SERIAL = [d for d in dialects.every() if d.bus == "serial"]
ALLOWED = (
    frozenset({Risk.READ, Risk.MOTION}),
    frozenset({Risk.READ, Risk.MOTION, Risk.UNBOUNDED}),
    frozenset({Risk.READ, Risk.MOTION, Risk.SETTING}),
)
HEADS = bytes.fromhex("FA FB FC 3E F6 FD 01 02 06 10")


class Wire(Line):
    """Keeps what was written; nothing ever comes."""

    def __init__(self) -> None:
        self.endpoint = endpoints.parse("serial:/dev/none,baud=38400")
        self.written: list[bytes] = []
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def write(self, item: bytes | CanFrame) -> int:
        assert isinstance(item, bytes)
        self.written.append(item)
        return self._now_ns

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        self._now_ns += timeout_ns
        return None

    def set_speed(self, bits_per_second: int) -> None:
        raise AssertionError

    def close(self) -> None:
        pass


@cache
def _stops(name: str, address: int, acceleration: int) -> list[bytes]:
    dialect, found = dialects.get(name), []
    for command in dialect.motions(MotionKind.STOP):
        named = command.request_forms[0].layout.named
        found.append(build(dialect, command, address, {"acceleration": acceleration} if "acceleration" in named else {}))
    return found


def stops(dialect: Dialect, address: int, acceleration: int) -> list[bytes]:
    """Return each stop of a dialect."""
    return _stops(dialect.name, address, acceleration)


def random_item(rng: random.Random, address: int) -> bytes:
    """Return a request, a piece of one, two of them glued, or bytes with many heads."""
    kind = rng.random()
    if kind < 0.15:
        return bytes(rng.choice(HEADS) if rng.random() < 0.6 else rng.randrange(256) for _ in range(rng.randint(1, 12)))
    dialect = rng.choice(SERIAL)
    command = rng.choice([c for c in dialect.commands if c.slots is None])
    form = rng.choice(command.request_forms)
    size = form.layout.byte_length
    data = bytes(rng.choice(HEADS) if rng.random() < 0.3 else rng.randrange(256) for _ in range(size))
    if rng.random() < 0.7:
        values = {n: rng.randint(f.low, f.high) if f.fixed is None else f.fixed for n, f in form.layout.named.items()}
        data = codec(form.layout).encode(values)
    frame = dialect.link.build(command, form, address, data, Role.REQUEST)
    if kind < 0.3:
        return frame[: rng.randint(1, len(frame))]
    return frame if kind < 0.9 else frame + random_item(rng, address)


def sound_and_forbidden(written: list[bytes], judge: Judge, reader: SerialInterpreter) -> list[Interpretation]:
    """Return sound frames of known codes in all that was written, wherever they begin, that the allowance forbids."""
    found, _ = reader.interpret(Pending(), b"".join(written))
    return [i for i in found if i.fits and i.command is not None and judge.allowance.objection(i, judge.known) is not None]


def history(rng: random.Random, length: int = 14) -> None:
    """Send what is allowed of a random history; then each stop leaves, and no forbidden sound frame has left."""
    address, wire = rng.choice((1, 1, 2, 6, 16)), Wire()
    gate = Gate(wire, Allowance(rng.choice(ALLOWED), addresses=frozenset({address})))
    for _ in range(rng.randint(0, length)):
        with contextlib.suppress(Refused):
            gate.send(random_item(rng, address))
    dialect = rng.choice(SERIAL)
    for stop in stops(dialect, address, rng.choice((0, 1, 200, 250, 252, 62, 246))):
        gate.send(stop)
        assert wire.written[-1] == stop
        for read in ("read_speed", "read_position", "read_state_2", "read_state_1"):
            if read in dialect.by_name and rng.random() < 0.3:
                gate.send(build(dialect, read, address))
    told = b"".join(wire.written).hex(" ")
    assert sound_and_forbidden(wire.written, Judge(gate.allowance), READER) == [], told


READER = SerialInterpreter(SERIAL)


def test_a_stop_is_never_refused_whatever_was_sent_before():
    rng = random.Random(20)
    for _ in range(500):
        history(rng)


def test_a_stop_passes_what_was_read_as_a_package():
    """The case of a shaft that turned on at 180 rpm: the acceleration FC is the head of a package."""
    judge = Judge(Allowance(ALLOWED[1], addresses=frozenset({1})))
    for text in ("FA 01 F6 00 B4 FC A1", *["FA 01 32 2D"] * 10, "FA 01 F6 00 00 C8 B9", "FA 01 32 2D", "FA 01 F7 F2"):
        for item in (bytes.fromhex(text),):
            assert judge.objections(item) == [], text
            judge.admit(item)


def test_what_a_stop_would_complete_is_closed_by_reads_before():
    """The stop is the last piece of a package that checks: a read goes first, and it no longer is."""
    mks, lk = dialects.get("mks-rs485"), dialects.get("lk-rs485")
    stop = bytes.fromhex("FA 01 F7 F2")
    short = [build(mks, c, 1) for c in mks.commands if c.name.startswith("read_") and not c.request_forms[0].layout.named]
    long = [build(lk, name, 1) for name in ("read_state_1", "read_state_2")]
    closed = 0
    for seed in range(3000):
        rng = random.Random(seed)
        # From FC on there are 52 bytes: the end of the run, the reads, the stop.
        body = [rng.choice(short) for _ in range(8)] + [rng.choice(long) for _ in range(2)] + [stop]
        rng.shuffle(body)
        body.insert(0, build(mks, "run_speed", 1, {"speed": rng.randint(1, 300), "acceleration": 0xFC}))
        package = b"".join([*body, stop])[-52:]
        # A slot that holds the earlier stop: it is not for one drive alone.
        slotted = any(package[at] == 0xF7 for at in range(2, 52, 10))
        if package[0] != 0xFC or sum(package[:-1]) & 0xFF != package[-1] or not slotted:
            continue
        wire = Wire()
        gate = Gate(wire, Allowance(ALLOWED[1], addresses=frozenset({1})))
        for item in body:
            gate.send(item)
        gate.send(stop)
        assert wire.written[-1] == stop
        assert len(wire.written) == len(body) + 2
        assert all(i.reads_only for i in READER.interpret(Pending(), wire.written[-2])[0])
        closed += 1
    assert closed, "no such history was drawn"


@pytest.mark.parametrize("dialect", dialects.every(), ids=lambda d: d.name)
def test_a_stop_of_another_drive_is_no_stop_of_the_drive_that_is_meant(dialect: Dialect):
    judge = Judge(Allowance(ALLOWED[1], addresses=frozenset({1})))
    for stop in stops(dialect, 2, 200):
        assert judge.objections(stop if dialect.bus == "serial" else on_can(2, stop)) != []
    for stop in stops(dialect, 1, 200):
        assert judge.objections(stop if dialect.bus == "serial" else on_can(1, stop)) == []
