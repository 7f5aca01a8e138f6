"""The gate under attack: random histories before a stop, and streams that try to get a forbidden frame out.

    python -m benchmarks.gate [--histories 1000000] [--attacks 100000] [--seed 1] [--jobs 2]

A history sends what is allowed of random requests, pieces and packages; then stops of a dialect have to leave. An attack draws
an allowance (any risks, addresses, bounds, a budget) and sends frames that are forbidden: whole, split, damaged, hidden in the
data of others, in packages and in Modbus writes. After each, all that was written is read once more by a reader that shares
only the catalogue with the gate. No stop may be refused, and no sound frame may have left that the allowance forbids. The exit
status says so. A case that fails is named by its number and seed: `attack(number, seed)` runs it alone.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from itertools import pairwise
from multiprocessing import get_context
from typing import NamedTuple

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Form, MotionKind, Risk, Role
from analyzer.codec import codec
from analyzer.encoder import build
from analyzer.link import modbus_crc
from analyzer.live import endpoint as endpoints
from analyzer.records import CanFrame, Chunk
from conformance.bus.line import Line
from conformance.gate.gate import Allowance, Budget, Gate, Item, Refused

SERIAL = [d for d in dialects.every() if d.bus == "serial"]
CAN = [d for d in dialects.every() if d.bus == "can"]
READS = frozenset({Risk.READ})
#: Bytes that begin frames, and codes and addresses that are heads as well.
HEADS = bytes.fromhex("FA FB FC 3E F6 FD 01 02 06 10")
ADDRESSES = (1, 1, 2, 6, 16, 62, 250, 252)
ACCELERATIONS = (0, 1, 62, 200, 246, 250, 252)
#: What is known of all drives here, so that a speed as sent is that of the shaft.
SUBDIVISION = 16


class Wire(Line):
    """Keeps what was written; nothing ever comes."""

    def __init__(self, place: str = "serial:/dev/none,baud=38400") -> None:
        self.endpoint = endpoints.parse(place)
        self.written: list[Item] = []
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def write(self, item: bytes | CanFrame) -> int:
        self.written.append(item)
        return self._now_ns

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        self._now_ns += timeout_ns
        return None

    def set_speed(self, bits_per_second: int) -> None:
        raise AssertionError

    def close(self) -> None:
        pass


# --- the reader: sound frames in all that was written, wherever they begin ----------------------------------------------


class Seen(NamedTuple):
    """A sound request. `address` None: all drives, or those of a package."""

    dialect: Dialect
    address: int | None
    command: Command
    values: dict[str, int]
    risks: frozenset[Risk]
    data: bytes

    def __str__(self) -> str:
        return f"{self.dialect.name}@{self.address} {self.command.name} {self.values} ({self.data.hex(' ')})"


@cache
def _forms(name: str) -> dict[tuple[int | None, int], list[tuple[Command, Form]]]:
    found: dict[tuple[int | None, int], list[tuple[Command, Form]]] = {}
    for command in dialects.get(name).commands:
        for form in command.request_forms if command.slots is None else ():
            found.setdefault((command.function, command.code), []).append((command, form))
    return found


def _meant(
    dialect: Dialect, address: int, key: tuple[int | None, int], data: bytes, whole: bytes, *, many: bool = False
) -> Iterator[Seen]:
    """Yield what data of a code tell a drive: the commands whose layout they have; those of their length where none has."""
    long = [(c, f) for c, f in _forms(dialect.name).get(key, ()) if f.layout.byte_length == len(data)]
    alike = [(c, f) for c, f in long if codec(f.layout).matches(data)]
    for command, form in alike[:1] or long:
        values = codec(form.layout).wire(data) if alike else {}
        to_all = many or address == dialect.broadcast
        yield Seen(dialect, None if to_all else address, command, values, command.risks(values), whole)


def _sizes(dialect: Dialect, key: tuple[int | None, int]) -> set[int]:
    return {form.layout.byte_length for _, form in _forms(dialect.name).get(key, ())}


def _native(dialect: Dialect, stream: bytes, at: int) -> Iterator[Seen]:
    if stream[at] == 0xFA and at + 3 < len(stream):
        key = (None, stream[at + 2])
        for last in [at + 3 + size for size in _sizes(dialect, key)]:
            if last < len(stream) and sum(stream[at:last]) & 0xFF == stream[last]:
                yield from _meant(dialect, stream[at + 1], key, stream[at + 3 : last], stream[at : last + 1])
    if stream[at] == 0xFC and at + 52 <= len(stream) and sum(stream[at : at + 51]) & 0xFF == stream[at + 51]:
        for first in range(at + 1, at + 51, 10):
            slot, key = stream[first : first + 10], (None, stream[first + 1])
            for size in _sizes(dialect, key):
                yield from _meant(dialect, slot[0], key, slot[2 : 2 + size], stream[at : at + 52], many=True)


def _lk(dialect: Dialect, stream: bytes, at: int) -> Iterator[Seen]:
    if stream[at] != 0x3E or at + 5 > len(stream) or sum(stream[at : at + 4]) & 0xFF != stream[at + 4]:
        return
    size = stream[at + 3]
    stop = at + 5 + (size + 1 if size else 0)
    if stop <= len(stream) and (not size or sum(stream[at + 5 : stop - 1]) & 0xFF == stream[stop - 1]):
        yield from _meant(dialect, stream[at + 2], (None, stream[at + 1]), stream[at + 5 : at + 5 + size], stream[at:stop])


def _modbus(dialect: Dialect, stream: bytes, at: int) -> Iterator[Seen]:
    if at + 8 > len(stream) or stream[at] > 247 or stream[at + 1] not in (6, 16):
        return
    many = stream[at + 1] == 16
    stop = at + 9 + stream[at + 6] if many else at + 8
    if stop <= len(stream) and not modbus_crc(stream[at:stop]):
        data = stream[at + 7 : stop - 2] if many else stream[at + 4 : stop - 2]
        key = (stream[at + 1], stream[at + 2] << 8 | stream[at + 3])
        yield from _meant(dialect, stream[at], key, data, stream[at:stop])


_READERS: dict[str, Callable[[Dialect, bytes, int], Iterator[Seen]]] = {
    "mks-rs485": _native, "lk-rs485": _lk, "mks-modbus": _modbus,
}  # fmt: skip


def sound(written: Sequence[Item]) -> Iterator[Seen]:
    """Yield the sound requests in all that was written; reads of Modbus aside."""
    stream = b"".join(item for item in written if isinstance(item, bytes))
    for at in range(len(stream)):
        for dialect in SERIAL:
            yield from _READERS[dialect.name](dialect, stream, at)
    for item in written:
        if isinstance(item, CanFrame) and len(item.data) >= 2 and (item.id + sum(item.data[:-1])) & 0xFF == item.data[-1]:
            for dialect in CAN:
                yield from _meant(dialect, item.id, (None, item.data[0]), item.data[1:-1], item.data)


def forbidden(seen: Seen, allowed: Allowance) -> bool:
    """Say whether an allowance forbids a sound request; reads of any drive are harmless."""
    if seen.risks <= READS:
        return False
    if not seen.risks <= allowed.risks:
        return True
    if not allowed.alone and (seen.address is None or Risk.LINK in seen.risks):
        return True
    if not allowed.alone and allowed.addresses is not None and seen.address not in allowed.addresses:
        return True
    known = Risk.SETTING not in allowed.risks
    stops = seen.command.motion is not None and seen.command.motion.kind is MotionKind.STOP
    return known and not stops and allowed.speed is not None and _rpm(seen) > allowed.speed


def _rpm(seen: Seen) -> float:
    units = {"rpm": 1.0, "deg/s": 1 / 6}
    fields = {n: f for form in seen.command.request_forms for n, f in form.layout.named.items() if f.unit in units}
    return max([float(seen.values[n] * f.scale) * units[f.unit] for n, f in fields.items() if n in seen.values], default=0.0)


# --- what is sent -----------------------------------------------------------------------------------------------------


@cache
def stops(name: str, address: int, acceleration: int) -> list[bytes]:
    """Return each stop of a dialect."""
    dialect, found = dialects.get(name), []
    for command in dialect.motions(MotionKind.STOP):
        named = command.request_forms[0].layout.named
        found.append(build(dialect, command, address, {"acceleration": acceleration} if "acceleration" in named else {}))
    return found


@cache
def _commands(name: str) -> list[Command]:
    return [c for c in dialects.get(name).commands if c.slots is None]


def request(chance: random.Random, dialect: Dialect, address: int) -> bytes:
    """Return a sound request of a dialect, with values or with bytes that are heads."""
    command = chance.choice(_commands(dialect.name))
    form = chance.choice(command.request_forms)
    if chance.random() < 0.7:
        named = form.layout.named.items()
        data = codec(form.layout).encode({n: _value(chance, f.low, f.high) if f.fixed is None else f.fixed for n, f in named})
    else:
        data = heads(chance, form.layout.byte_length)
    return dialect.link.build(command, form, address, data, Role.REQUEST)


def _value(chance: random.Random, low: int, high: int) -> int:
    return chance.choice((low, high, chance.randint(low, high), min(high, max(low, chance.choice(HEADS)))))


def heads(chance: random.Random, size: int) -> bytes:
    """Return bytes of which many begin a frame."""
    return bytes(chance.choice(HEADS) if chance.random() < 0.6 else chance.randrange(256) for _ in range(size))


def package(chance: random.Random, address: int) -> bytes:
    """Return a package of motions whose sum fits."""
    body = bytearray(b"\xfc")
    for _ in range(5):
        slot = request(chance, dialects.get("mks-rs485"), address)[1:-1][:10] if chance.random() < 0.5 else b""
        body += slot.ljust(10, b"\0")
    return bytes(body + bytes((sum(body) & 0xFF,)))


def hidden(chance: random.Random, inner: bytes, address: int) -> bytes:
    """Return a Modbus request that holds the beginning of another frame, or all of it, and checks."""
    if chance.random() < 0.5:
        registers = inner + b"\0" * (len(inner) % 2)
        where = chance.choice((0x0087, 0x00F3, 0x00F6, 0x00FA, 0xFA01))
        body = bytes((address & 0x7F, 16, where >> 8, where & 0xFF, 0, len(registers) // 2, len(registers))) + registers
    else:
        body = bytes((address & 0x7F, chance.choice((3, 4, 6)))) + inner[:4].ljust(4, b"\0")
    crc = modbus_crc(body)
    return body + bytes((crc & 0xFF, crc >> 8))


def random_item(chance: random.Random, address: int) -> bytes:
    """Return a request, a piece of one, two of them glued, a package, or bytes with many heads."""
    kind = chance.random()
    if kind < 0.15:
        return heads(chance, chance.randint(1, 12))
    if kind < 0.2:
        return package(chance, address)
    frame = request(chance, chance.choice(SERIAL), address)
    if kind < 0.3:
        return hidden(chance, frame, address)
    if kind < 0.42:
        return frame[: chance.randint(1, len(frame))]
    return frame if kind < 0.92 else frame + random_item(chance, address)


def pieces(chance: random.Random, data: bytes) -> list[bytes]:
    """Return data in up to four pieces."""
    cuts = sorted({0, len(data), *(chance.randint(0, len(data)) for _ in range(chance.randint(0, 3)))})
    return [data[a:b] for a, b in pairwise(cuts)]


@cache
def read(name: str, command: str, address: int) -> bytes:
    """Return a read."""
    return build(dialects.get(name), command, address)


@cache
def _run(address: int, speed: int, acceleration: int) -> bytes:
    return build(dialects.get("mks-rs485"), "run_speed", address, {"speed": speed, "acceleration": acceleration})


def bait(chance: random.Random, address: int, stop: bytes) -> list[bytes]:
    """Return sound frames of a drive in which a package has begun that the stop would end, with a sum that fits."""
    reads = [read("mks-rs485", name, address) for name in ("read_speed", "read_position", "read_protection")]
    reads += [read("lk-rs485", name, address) for name in ("read_state_1", "read_state_2") if address <= 32]
    for _ in range(30):
        body = [_run(address, chance.randint(1, 60), 0xFC)]
        # The package begins with the acceleration.
        room = 52 - 2 - len(stop)
        while room:
            own = stops("mks-rs485", address, chance.choice(ACCELERATIONS))
            run = _run(address, chance.randint(1, 60), chance.choice(ACCELERATIONS))
            fitting = [f for f in (*reads, *own, run) if len(f) <= room and room - len(f) not in (1, 2, 3)]
            if not fitting:
                break
            body.append(chance.choice(fitting))
            room -= len(body[-1])
        whole = b"".join([*body, stop])[5:]
        if not room and sum(whole[:-1]) & 0xFF == whole[-1]:
            break
    return body


# --- histories and attacks --------------------------------------------------------------------------------------------


def allowance(chance: random.Random, address: int, *moving: Risk) -> Allowance:
    """Return any permission; `moving` is always in it."""
    risks = frozenset({r for r in Risk if chance.random() < 0.4} | READS | set(moving))
    named = chance.choice((frozenset({address}), frozenset({address}), frozenset({address, 7}), None))
    budget = Budget(commands=chance.choice((None, None, 0, 3)))
    speed = chance.choice((None, 60.0, 300.0))
    return Allowance(risks, speed, addresses=named, alone=chance.random() < 0.15, budget=budget, subdivision=SUBDIVISION)


def history(number: int, seed: int, longest: int = 8) -> str:
    """Send what is allowed of a random history, then stops; return what went wrong, or nothing."""
    chance = random.Random(f"{seed} history {number}")
    address, wire = chance.choice(ADDRESSES), Wire()
    allowed = allowance(chance, address, Risk.MOTION)
    gate = Gate(wire, allowed, dialects=SERIAL)
    for _ in range(chance.randint(0, longest)):
        with contextlib.suppress(Refused):
            gate.send(random_item(chance, address))
    dialect = chance.choice([d for d in SERIAL if d.addresses[0] <= address <= d.addresses[1]])
    ways = stops(dialect.name, address, chance.choice(ACCELERATIONS))
    tried = chance.sample(ways, min(2, len(ways)))
    if chance.random() < 0.1:
        for item in bait(chance, address, tried[0]):
            with contextlib.suppress(Refused):
                gate.send(item)
    for stop in tried:
        try:
            gate.send(stop)
        except Refused as error:
            return _told(wire, f"a stop was refused: {error}")
        for name in ("read_speed", "read_position", "read_state_2", "read_state_1"):
            if name in dialect.by_name and chance.random() < 0.2:
                with contextlib.suppress(Refused):
                    gate.send(read(dialect.name, name, address))
    return _got_out(wire, allowed)


def attack(number: int, seed: int) -> str:
    """Send what may be forbidden in every disguise; return what got out, or nothing."""
    chance = random.Random(f"{seed} attack {number}")
    address = chance.choice(ADDRESSES)
    allowed = allowance(chance, address)
    if chance.random() < 0.15:
        return _attack_on_can(chance, address, allowed)
    wire = Wire()
    gate = Gate(wire, allowed, dialects=SERIAL)
    for _ in range(chance.randint(1, 5)):
        aim = chance.choice((address, address, chance.choice(ADDRESSES), 0))
        frame = package(chance, aim) if chance.random() < 0.15 else request(chance, chance.choice(SERIAL), aim)
        way = chance.random()
        if way < 0.25:
            frame = hidden(chance, frame, aim)
        elif way < 0.4:
            frame = request(chance, chance.choice(SERIAL), address)[: chance.randint(1, 6)] + frame
        elif way < 0.5:
            frame = heads(chance, chance.randint(1, 4)) + frame
        for piece in pieces(chance, frame):
            # A piece that is refused does not leave, the next may.
            with contextlib.suppress(Refused):
                gate.send(piece)
            if chance.random() < 0.2:
                with contextlib.suppress(Refused):
                    gate.send(random_item(chance, address))
        if chance.random() < 0.2:
            with contextlib.suppress(Refused):
                gate.send(chance.choice(stops(chance.choice(SERIAL).name, min(address, 32), chance.choice(ACCELERATIONS))))
    return _got_out(wire, allowed)


def _attack_on_can(chance: random.Random, address: int, allowed: Allowance) -> str:
    wire = Wire("can:virtual:none")
    gate = Gate(wire, allowed, dialects=CAN)
    for _ in range(chance.randint(1, 8)):
        dialect, aim = chance.choice(CAN), chance.choice((address, address, 0, 2, 0x7FF))
        data = request(chance, dialect, aim)
        if chance.random() < 0.3:
            data = heads(chance, chance.randint(0, 8))
        can_id = chance.choice((aim, aim, aim + 0x800))
        strange = {chance.choice(("extended", "remote", "error", "fd")): True} if chance.random() < 0.1 else {}
        with contextlib.suppress(Refused):
            gate.send(CanFrame(None, "can", can_id, data[:8], **strange))
    return _got_out(wire, allowed)


def _got_out(wire: Wire, allowed: Allowance) -> str:
    found = [seen for seen in sound(wire.written) if forbidden(seen, allowed)]
    return _told(wire, f"got out: {found[0]} under {sorted(allowed.risks)}, {allowed.addresses}") if found else ""


def _told(wire: Wire, what: str) -> str:
    sent = " | ".join(f"{i.id:03X}#{i.data.hex()}" if isinstance(i, CanFrame) else i.hex(" ") for i in wire.written)
    return f"{what}; sent {sent}"


def _slice(kind: str, seed: int, numbers: range) -> list[str]:
    act = history if kind == "history" else attack
    return [f"{kind} {n} of seed {seed}: {told}" for n in numbers if (told := act(n, seed))]


_SLICE = 500


def run(kind: str, count: int, seed: int, jobs: int, first: int = 0) -> Iterator[str]:
    """Yield what goes wrong in so many histories or attacks."""
    started = time.perf_counter()
    slices = [range(n, min(n + _SLICE, first + count)) for n in range(first, first + count, _SLICE)]
    with get_context("fork").Pool(jobs) as pool:
        for number, found in enumerate(pool.imap_unordered(partial(_slice, kind, seed), slices), 1):
            yield from found
            if not number % 20 or number == len(slices):
                done = min(number * _SLICE, count)
                print(f"{kind}: {done} of {count} in {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histories", type=int, default=1_000_000)
    parser.add_argument("--attacks", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="number of the first one, to go on where a run ended")
    arguments = parser.parse_args()
    wrong = 0
    for kind, count in (("history", arguments.histories), ("attack", arguments.attacks)):
        for told in run(kind, count, arguments.seed, arguments.jobs, arguments.first) if count else ():
            wrong += 1
            print(told, flush=True)
    print(f"{wrong} went wrong in {arguments.histories} histories and {arguments.attacks} attacks (seed {arguments.seed})")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
