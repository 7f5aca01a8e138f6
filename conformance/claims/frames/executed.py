"""Framing and what a drive does: start bytes in data are data, and what does not check is not executed.

That a damaged request has no effect can be seen only with a request that has one. Those are sent to emulated drives alone:
on a real line what is garbled is a read (`conformance.talk.garbling`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Subject, Verb
from analyzer.link import HeadLink
from conformance.claim import Inconclusive, Theme
from conformance.claims.control_reads import received_text
from conformance.claims.declare import Case, claim, commands, described_in
from conformance.claims.motion.motion_claim import by_bus, expect_not_turned, expect_stays, of_motion
from conformance.motion import declared, effects, motion
from conformance.motion.declared import CALM, QUICK, SUBDIVISION
from conformance.motion.effects import Observable
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe

# --- start bytes in data ----------------------------------------------------------------------------------------------


def _lk_positions(own: int) -> tuple[int, ...]:
    """Return positions with heads in them; the last one and its sum read like a good request to the drive."""
    head = bytes((0x3E, 0x92, own, 0x00))
    return (*_LK_POSITIONS, int.from_bytes(head, "little"))


#: A value without a start byte in it, for comparison.
_PLAIN = 16
#: Any byte is a subdivision: the heads of requests, replies and packages.
_SUBDIVISIONS = (0xFA, 0xFB, 0xFC, 0x3E)
#: How far beside its target a quiet loop rests, in 0.01 degrees: less than the smallest of these positions.
_BESIDE = 20
#: Positions whose bytes, low byte first, are heads and the beginning of a good read.
_LK_POSITIONS = (0x3E, 0x3E3E, 0x3E3E_3E3E, 0x3E00)


def _good_answers(probe: Probe, command: Command, exchange: Exchange) -> int:
    """Return how many good replies there are, 0 where there is anything else, or a refusal."""
    named = [a for a in exchange.answers if a.command is not None and a.command.name == command.name]
    good = [a for a in named if a.message.frame.checksum_ok]
    return 0 if exchange.junk or probe.refused(exchange) or len(good) != len(exchange.answers) else len(good)


@dataclass(frozen=True)
class _AnyBytes:
    """A field of a setting that may hold any byte. `values(address)`: what is sent; `read`: what reads it back, or None."""

    field: str
    values: Callable[[int], tuple[int, ...]]
    read: Verb | None


_ANY_BYTES: Mapping[str, _AnyBytes] = {
    "set_position": _AnyBytes("position", _lk_positions, Verb.READ_POSITION),
    "set_subdivision": _AnyBytes("subdivision", lambda own: _SUBDIVISIONS, None),
}


def _settings_of_any_bytes(dialect: Dialect) -> Iterator[Case]:
    for name, setting in _ANY_BYTES.items():
        if name in dialect.by_name and (setting.read is not None or isinstance(dialect.link, HeadLink)):
            command = dialect.by_name[name]
            facts = {"name": "start_bytes", "fields": (setting.field,), "settings": (setting.field,), "parameters": {}}
            yield Case(dialect, command, {"setting": setting}, facts | {"risks": command.all_risks})


@claim(
    Theme.FRAMING,
    each=_settings_of_any_bytes,
    refuted_by="silence, a second answer, or another value",
    section=described_in(Subject.FRAMING),
)
def _start_bytes(probe: Probe, command: Command, setting: _AnyBytes) -> None:
    """A byte in the data of a request that could begin a frame is data."""
    field = setting.field
    usual = _good_answers(probe, command, probe.ask(command, {field: _PLAIN}))
    if not usual:
        raise Inconclusive(f"{command.name} is not answered by a good reply that it is done")
    for value in setting.values(probe.address):
        # Twice: a line that loses a reply now and then is another matter.
        exchanges = [probe.ask(command, {field: value}) for _ in range(2)]
        exchange = exchanges[-1]
        probe.expect(
            received_text(exchange),
            holds=any(_good_answers(probe, command, e) == usual for e in exchanges),
            expected=f"a reply that it is done, to {hex_of(exchange.sent or b'')}",
            refutes=f"{command.name} with {value:X}h in its data is not answered as any other",
            exchange=exchange,
            key="start bytes in data",
        )
        if setting.read is not None:
            text = f"{command.name} with {value:X}h in its data is not taken as it was sent"
            seen = probe.read(setting.read, field)
            # What is set may be a place, where a shaft trembles.
            unit, within = ("0.01 degrees", _BESIDE) if setting.read is Verb.READ_POSITION else ("", 0)
            key = "start bytes in data"
            probe.expect(seen, near=value, within=within, unit=unit, refutes=text, exchange=exchange, key=key)


# --- what does not check is not executed ------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Damage:
    """One way to damage a request. `make(dialect, frame, address)` yields what it is and the bytes; `head`: by its head."""

    name: str
    what: str
    make: Callable[[Dialect, bytes, int], Iterator[tuple[str, bytes]]]
    head: bool = False


def _wrong_checks(dialect: Dialect, frame: bytes, address: int) -> Iterator[tuple[str, bytes]]:
    for check in dialect.link.checks(frame, address):
        for bit in (0, 7):
            changed = bytearray(frame)
            changed[check.start + len(check.expected) - 1] ^= 1 << bit
            yield f"bit {bit} of the {check.name} flipped", bytes(changed)


def _flipped_data(dialect: Dialect, frame: bytes, address: int) -> Iterator[tuple[str, bytes]]:
    head = dialect.link.parse(frame, address)
    for at in range(head.start, head.stop):
        changed = bytearray(frame)
        changed[at] ^= 1
        yield f"bit 0 of byte {at + 1} flipped", bytes(changed)


def _reply_heads(dialect: Dialect, frame: bytes, address: int) -> Iterator[tuple[str, bytes]]:
    for head in (0xFB, 0xF9):
        yield f"{head:02X} for its head", dialect.link.completed(bytes((head,)) + frame[1:-1], address)


def _cut(dialect: Dialect, frame: bytes, address: int) -> Iterator[tuple[str, bytes]]:
    for size in (len(frame) - 1, len(frame) - 2):
        yield f"{size} of {len(frame)} bytes", frame[:size]


_DAMAGES = (
    _Damage("checksum_bit", "whose checksum does not fit", _wrong_checks),
    _Damage("flipped_bit", "with a flipped bit in its data", _flipped_data),
    _Damage("truncated", "that breaks off", _cut),
    _Damage("head", "with another head than a request's", _reply_heads, head=True),
)


def _damages(dialect: Dialect) -> Iterable[Case]:
    observable = effects.observable(dialect)
    for damage in _DAMAGES if observable is not None else ():
        if not damage.head or isinstance(dialect.link, HeadLink):
            yield Case(dialect, given={"damage": damage, "what": damage.what, "observable": observable})


@claim(
    Theme.FRAMING,
    each=_damages,
    name="{damage}/not_executed",
    refuted_by="an effect of it",
    section=described_in(Subject.FRAMING),
    risks=lambda case: case["observable"].risks | _READ_AS.get(type(case.dialect.link), frozenset()),
    settings=lambda case: case["observable"].settings,
    emulated=True,
    parameters={},
)
def _not_executed(probe: Probe, damage: _Damage, observable: Observable) -> None:
    """A request {what} is not executed."""
    observable.prepare(probe)
    change = observable.change(probe)
    built = probe.build(change.command, change.values)
    for what, frame in damage.make(probe.dialect, built.frame, probe.address):
        sent = probe.send(built.item(frame), timeout_ns=_LISTEN_NS)
        observable.settle(probe)
        got = observable.read(probe)
        probe.expect(
            f"{got} is read",
            holds=observable.is_done(got, change.undone),
            expected=f"nothing: {change.before} still to be read after {hex_of(sent.sent or b'')}",
            refutes=f"{change.command.name} is executed with {what}",
            exchange=sent,
            key=f"{damage.name}: executed",
        )
    observable.control(probe)


#: How long is listened to a damaged request before its effect is looked for.
_LISTEN_NS = 150_000_000


#: What damaged requests could be read as, beside what they were built from.
_READ_AS: Mapping[type, frozenset[Risk]] = {HeadLink: frozenset({Risk.UNKNOWN})}


# --- a motion that does not check ---------------------------------------------------------------------------------------


def _wrong_in_all_ways(dialect: Dialect, frame: bytes, address: int) -> Iterator[tuple[str, bytes]]:
    """Yield a frame with every kind of check that lazy firmware takes for a good one, and with the head of a reply."""
    for check in dialect.link.checks(frame, address):
        right, size = check.expected, len(check.expected)
        number, most = int.from_bytes(right, "big"), (1 << 8 * size) - 1
        wrong = {
            "zeros for": bytes(size),
            "FF for": b"\xff" * size,
            "one more than": (number + 1 & most).to_bytes(size, "big"),
            "another first byte of": bytes((right[0] ^ 0x5A, *right[1:])),
            "another last byte of": bytes((*right[:-1], right[-1] ^ 0x5A)),
            "the reverse of": right[::-1],
            "the complement of": bytes(b ^ 0xFF for b in right),
            "the top bit flipped in": bytes((*right[:-1], right[-1] ^ 0x80)),
        }
        if size == 1:
            wrong["without the head"] = bytes((number - frame[0] & most,))
            wrong["without the address"] = bytes((number - address & most,))
        for what, data in wrong.items():
            if data != right:
                yield f"{what} the {check.name}", frame[: check.start] + data + frame[check.start + size :]
    if isinstance(dialect.link, HeadLink):
        yield from _reply_heads(dialect, frame, address)


def _expect_none_turns(probe: Probe, command: Command, values: Mapping[str, int], to: int, before: motion.Sample) -> None:
    """Send a motion in all the ways in which it must not be executed; the shaft stays."""
    built = probe.build(command, values, address=to)
    for what, frame in _wrong_in_all_ways(probe.dialect, built.frame, to):
        sent = probe.send(built.item(frame), timeout_ns=_BETWEEN_NS)
        expect_not_turned(probe, before, sent, f"{command.name} is executed with {what}")


def _expect_stays(probe: Probe, command: Command, before: motion.Sample) -> None:
    """The shaft also stays for a while behind the last of them."""
    probe.wait(_LISTEN_NS)
    expect_stays(before, motion.position(probe), probe.traffic[-1], f"{command.name} is executed with a wrong checksum")


def _read_as(case: Case) -> frozenset[Risk]:
    return _READ_AS.get(type(case.dialect.link), frozenset())


@of_motion(theme=Theme.FRAMING, each=by_bus, name="{command}/wrong_check", refuted_by="a shaft that turns", risks=_read_as)
def _wrong_check(probe: Probe, command: Command) -> None:
    """{command} whose checksum does not fit turns nothing, however it is wrong."""
    motion.prepare(probe, command)
    before = motion.wait_standing(probe)
    values = declared.values_of(probe.dialect, command, _DEGREES, acceleration=QUICK, start=motion.place(probe, command))
    _expect_none_turns(probe, command, values, probe.address, before)
    _expect_stays(probe, command, before)
    motion.begin(probe, command, _DEGREES)
    probe.wait(_LISTEN_NS)
    went = abs(motion.position(probe).value - before.value)
    motion.stand_still(probe)
    if went < _DEGREES / 4:
        raise Inconclusive(f"{command.name} turns nothing when its checksum fits either")


def _stopping(dialect: Dialect) -> Iterable[Case]:
    """Yield the stop of a run, which stands for all that can stop it."""
    for run in dialect.motions(MotionKind.RUN) if dialect.family == "mks" else ():
        yield Case(dialect, dialect.stops_of(run)[0], {"run": run})


@of_motion(
    theme=Theme.FRAMING,
    each=_stopping,
    name="stops/wrong_check",
    refuted_by="a shaft that stands",
    risks=lambda case: _read_as(case) | case["run"].all_risks,
    parameters={},
)
def _wrong_stop(probe: Probe, run: Command) -> None:
    """A stop, an emergency stop or a disabling whose checksum does not fit stops nothing, however it is wrong."""
    motion.ready_to_move(probe)
    motion.run_at(probe, CALM, QUICK)
    before = motion.position(probe)
    for stop in (*probe.dialect.stops_of(run), probe.command(Verb.ENABLE)):
        named = stop.request_forms[0].layout.named
        built = probe.build(stop, {"acceleration": 0} if "acceleration" in named else {n: 0 for n in named if n == "enabled"})
        for what, frame in _wrong_in_all_ways(probe.dialect, built.frame, probe.address):
            sent = probe.send(built.item(frame), timeout_ns=_BETWEEN_NS)
            after, before = before, motion.position(probe)
            text = f"{stop.name} is executed with {what}"
            went = abs(before.value - after.value)
            probe.expect(went, at_least=_WAY_BETWEEN, unit="degrees", refutes=text, exchange=sent)
    motion.stand_still(probe)


def _homes(dialect: Dialect) -> Iterable[Case]:
    return commands(Verb.HOME)(dialect) if dialect.family == "mks" else ()


@of_motion(theme=Theme.FRAMING, each=_homes, name="{command}/wrong_check", refuted_by="a shaft that turns", risks=_read_as)
def _wrong_home(probe: Probe, command: Command) -> None:
    """{command} whose checksum does not fit turns nothing, however it is wrong.

    It is not sent whole: without an end stop homing has no end.
    """
    motion.ready_to_move(probe)
    before = motion.wait_standing(probe)
    _expect_none_turns(probe, command, {}, probe.address, before)
    _expect_stays(probe, command, before)


@of_motion(
    theme=Theme.FRAMING,
    each=lambda dialect: commands(Verb.RUN_SPEED)(dialect) if dialect.family == "mks" and dialect.broadcast is not None else (),
    name="broadcast/wrong_check",
    refuted_by="a shaft that turns",
    risks=lambda case: _read_as(case).union(*(c.command.all_risks for c in by_bus(case.dialect) if c.command)),
    alone=True,
)
def _wrong_to_all(probe: Probe) -> None:
    """No motion to all drives turns a shaft if its checksum does not fit."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    before = motion.wait_standing(probe)
    for case in by_bus(probe.dialect):
        assert case.command is not None
        command = probe.command(case.command.name)
        values = declared.values_of(probe.dialect, command, _DEGREES, acceleration=QUICK, start=motion.place(probe, command))
        _expect_none_turns(probe, command, values, probe.dialect.broadcast or 0, before)
    _expect_stays(probe, command, before)


#: A move that takes a tenth of a second; how long is listened between requests that are to do nothing: it goes 3 degrees in it.
_DEGREES = 36
_BETWEEN_NS = 20_000_000
#: What a shaft at 60 rpm goes meanwhile at least, in degrees: half of it.
_WAY_BETWEEN = 3.5
