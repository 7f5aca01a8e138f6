"""Addressing: a drive hears its own address, all drives' and its group's, and answers its own alone.

Rules kept here:
- Everything here but a read of the drive itself goes to other addresses: the claims want the bus to themselves.
- That something is executed, or is not, is seen by an observable effect (`motion.effects`), which is sent to the drive
  itself in the end where nothing was to happen, so that a drive that does nothing at all proves nothing.
- Addresses of several drives stand in `addressing.many`, packages for several drives in `addressing.package`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Form, MotionKind, Risk, Role, Subject, Verb
from analyzer.codec import codec
from analyzer.link import HeadLink, LkLink
from conformance.claim import Inconclusive, Theme
from conformance.claims.addressing.ways import read_of, send_to
from conformance.claims.control_reads import ask_first, expect_silence, judge_next, plain_read, received_text
from conformance.claims.declare import Case, claim, commands, described_in, needing
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import by_bus, expect_not_turned, expect_stays, of_motion, risks_by
from conformance.claims.settings.link_changes import NEW_ADDRESS_ANSWERS
from conformance.motion import arriving, declared, effects, motion
from conformance.motion.declared import QUICK, SUBDIVISION
from conformance.motion.effects import Observable
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe, Until

_BYTE = 0xFF
#: Changes that are sent to other addresses: each takes the time of a move.
_FEW, _MANY = 5, 14
#: A motion of a tenth of a second; how long another drive's is listened to, and how long the shaft is watched behind all.
_DEGREES, _BETWEEN_NS, _LISTEN_NS = 36, 30_000_000, 150_000_000


def _addressing(refuted_by: str, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a check that sends to other addresses, whose section is that about addresses."""
    facts = {"section": described_in(Subject.ADDRESSING), "parameters": {}, **facts}
    return claim(Theme.ADDRESSING, refuted_by=refuted_by, alone=True, **facts)


# --- other addresses --------------------------------------------------------------------------------------------------


def _neighbours(dialect: Dialect, own: int) -> Iterable[int]:
    return (own - 1, own + 1, own - 2, own + 2, own - 16, own + 16)


def _one_bit(dialect: Dialect, own: int) -> Iterable[int]:
    return (own ^ 1 << bit for bit in range(max(dialect.addresses[1], _BYTE).bit_length()))


def _edges(dialect: Dialect, own: int) -> Iterable[int]:
    first, last = dialect.addresses
    return (first, last, last - 1, (first + last) // 2, own * 2, own >> 1, (own << 8 | own >> 8) & last)


def _same_low_byte(dialect: Dialect, own: int) -> Iterable[int]:
    return (own & _BYTE | high << 8 for high in range(8))


def _every(dialect: Dialect, own: int) -> Iterable[int]:
    last = dialect.addresses[1]
    return (*range(min(last, _BYTE) + 1), *range(_BYTE, last + 1, 31))


Addresses = Callable[[Dialect, int], Iterable[int]]


def _classes(dialect: Dialect) -> Iterator[Case]:
    """Yield classes of addresses that are not the drive's."""
    rows: list[tuple[str, str, Addresses, bool]] = [
        ("neighbours", "an address near the drive's", _neighbours, False),
        ("one_bit", "an address that differs from the drive's in one bit", _one_bit, False),
        ("edges", "the lowest, the highest and other addresses", _edges, False),
        ("every", "any other address", _every, True),
    ]
    if dialect.addresses[1] > _BYTE:
        rows.append(("low_byte", "an address with the drive's low byte", _same_low_byte, False))
    if dialect.broadcast is None:
        rows.append(("zero", "the address 0", lambda dialect, own: (0,), False))
    for kind, what, addresses, emulated in rows:
        yield Case(dialect, given={"kind": kind, "what": what, "addresses": addresses}, facts={"emulated": emulated})


def _chosen(probe: Probe, addresses: Iterable[int]) -> list[int]:
    """Return those addresses that can be sent to and are neither the drive's, nor its group's, nor all drives'."""
    dialect, own = probe.dialect, probe.address
    # A head has a byte for the address, an identifier no more bits than addresses need.
    wide = dialect.bus == "serial"
    last = max(dialect.addresses[1], _BYTE if wide else 0)
    fit = [a for a in dict.fromkeys(addresses) if 0 <= a <= last and a not in (own, probe.rig.group)]
    return [a for a in fit if a != dialect.broadcast]


@_addressing("any answer", each=_classes, name="other/{kind}")
def _not_answered(probe: Probe, addresses: Addresses) -> None:
    """A request to {what} is not answered."""
    ask_first(probe)
    for address in _chosen(probe, addresses(probe.dialect, probe.address)):
        sent = read_of(probe, address)
        text = f"a request to {address} is answered, and the drive is {probe.address}"
        expect_silence(probe, sent, text, key="another address is answered")


@_addressing("silence, or another answer", name="other/next")
def _behind_others(probe: Probe) -> None:
    """The next request to the drive behind one to another address is answered."""
    ask_first(probe)
    for address in _chosen(probe, _neighbours(probe.dialect, probe.address)):
        judge_next(probe, f"one to {address}", partial(read_of, probe, address))


def _observable(dialect: Dialect) -> Iterator[Case]:
    shown = effects.observable(dialect)
    if shown is not None:
        yield Case(dialect, given={"shown": shown}, facts={"risks": shown.risks, "settings": shown.settings})


@_addressing("an effect of it", each=_observable, name="other/not_executed")
def _not_executed(probe: Probe, shown: Observable) -> None:
    """A request to another address is not executed."""
    dialect, own = probe.dialect, probe.address
    shown.prepare(probe)
    near = _chosen(probe, _neighbours(dialect, own))[:2]
    far = _chosen(probe, (*_one_bit(dialect, own), *_edges(dialect, own)))
    if dialect.broadcast is None:
        near.append(0)
    change = shown.change(probe)
    for address in [*near, *far[-3:], *far[:3]][: _FEW + 2]:
        sent = send_to(probe, address, change, shown.settle_ns)
        probe.expect(
            f"{change.after} is read",
            holds=not shown.done(probe, change),
            expected=f"{change.before} still to be read after {hex_of(sent.sent or b'')}",
            refutes=f"{change.command.name} to {address} is executed, and the drive is {own}",
            exchange=sent,
            key="another address is executed",
        )
    shown.control(probe)


@of_motion(theme=Theme.ADDRESSING, each=by_bus, name="{command}/other_address", refuted_by="a shaft that turns", alone=True)
def _motion_of_another(probe: Probe, command: Command) -> None:
    """{command} to another address turns nothing."""
    dialect, own = probe.dialect, probe.address
    motion.prepare(probe, command)
    before = motion.wait_standing(probe)
    values = declared.values_of(dialect, command, _DEGREES, start=motion.place(probe, command))
    others = (own + 1, own - 1, own ^ 0x80, own + 16, _BYTE, own ^ 0x100, *_edges(dialect, own), *_one_bit(dialect, own))
    for address in _chosen(probe, others)[:_MANY]:
        sent = probe.ask(command, values, address=address, until=Until.TIMEOUT, timeout_ns=_BETWEEN_NS)
        expect_not_turned(probe, before, sent, f"{command.name} to {address} turns the shaft of {own}")
    probe.wait(_LISTEN_NS)
    expect_stays(before, motion.position(probe), sent, f"{command.name} to another address turns the shaft of {own}")
    motion.begin(probe, command, _DEGREES)
    probe.wait(_LISTEN_NS)
    went = abs(motion.position(probe).value - before.value)
    motion.stand_still(probe)
    if went < _DEGREES / 4:
        raise Inconclusive(f"{command.name} to the drive itself turns nothing either")


@of_motion(
    theme=Theme.ADDRESSING,
    each=needing(Verb.MOVE_RELATIVE_PULSES, commands(Verb.SET_SUBDIVISION)),
    name="other/{command}",
    refuted_by="pulses of another size",
    risks=risks_by(Verb.MOVE_RELATIVE_PULSES, Verb.ENABLE),
    alone=True,
)
def _setting_of_another(probe: Probe, command: Command) -> None:
    """{command} and disabling to another address leave the drive as it is; to the drive itself it changes the pulses."""
    own, move = probe.address, probe.command(Verb.MOVE_RELATIVE_PULSES)
    motion.prepare(probe, move)
    for address in _chosen(probe, (own + 1, own - 1, own ^ 0x80, own + 16, *_edges(probe.dialect, own)))[:_FEW]:
        probe.ask(command, {"subdivision": _FINER}, address=address, until=Until.TIMEOUT, timeout_ns=_BETWEEN_NS)
        sent = probe.ask(Verb.ENABLE, {"enabled": 0}, address=address, until=Until.TIMEOUT, timeout_ns=_BETWEEN_NS)
        text = f"disabling {address} switches the motor of {own} off"
        probe.expect("off", holds=motion.is_on(probe) is not False, expected="on", refutes=text, exchange=sent)
    went = arriving.follow(probe, move, _DEGREES, acceleration=QUICK)
    text = f"{command.name} to other addresses changes the pulses of {own}"
    # Which way is not judged: it may be set.
    probe.expect(abs(went.degrees), near=went.asked, unit="degrees", refutes=text, exchange=went.exchange)
    probe.do(command, {"subdivision": _FINER})
    if abs(arriving.follow(probe, move, _DEGREES, acceleration=QUICK).degrees) > went.asked * 3 / 4:
        raise Inconclusive(f"{command.name} to the drive itself changes nothing either")


#: Twice the subdivision at which the suite counts pulses.
_FINER = 2 * SUBDIVISION


def _with_room(dialect: Dialect) -> Iterator[Case]:
    """Yield the motions of serial drives whose data has room for a whole request."""
    size = len(_own_read(dialect, dialect.addresses[0]))
    moves = dialect.motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO) if dialect.bus == "serial" else ()
    fit = [(each, form) for each in moves for form in each.request_forms[:1] if form.layout.byte_length >= size]
    if fit:
        risks = frozenset[Risk]().union(*(each.all_risks for each, _ in fit)) - {Risk.UNKNOWN}
        yield Case(dialect, given={"moves": fit}, facts={"risks": risks})


def _own_read(dialect: Dialect, address: int) -> bytes:
    read = plain_read(dialect)
    form = read.request_forms[0]
    return dialect.link.build(read, form, address, codec(form.layout).encode({}), Role.REQUEST)


@_addressing("an answer to what its data read like", each=_with_room, name="other/inside", at_best=Certainty.LIKELY)
def _inside_request(probe: Probe, moves: list[tuple[Command, Form]]) -> None:
    """A move of another drive whose data read like a request to this drive is not answered."""
    ask_first(probe)
    dialect, own = probe.dialect, probe.address
    inner = _own_read(dialect, own)
    for command, form in moves:
        size = form.layout.byte_length
        for address in _chosen(probe, _neighbours(dialect, own))[:2]:
            frame = dialect.link.build(command, form, address, inner.rjust(size, b"\0"), Role.REQUEST)
            text = f"what the data of a {command.name} to another drive read like is answered"
            expect_silence(probe, probe.send(frame), text)


# --- another address for the drive ------------------------------------------------------------------------------------


@claim(
    Theme.ADDRESSING,
    each=commands(Verb.SET_ADDRESS),
    refuted_by="an answer at the old address, or none at the new one",
    alone=True,
    risks=lambda case: case.dialect.by_verb[Verb.SET_ADDRESS].all_risks,
    settings=("new_address",),
    fields=("new_address",),
    quirks=may_meet(NEW_ADDRESS_ANSWERS),
)
def _moves(probe: Probe, command: Command) -> None:
    """A drive that is given another address is heard there, and no longer at the old one; and back."""
    ask_first(probe)
    old = probe.address
    new = old + 1 if old < probe.dialect.addresses[1] else old - 1
    exchange = probe.ask(command, {"new_address": new})
    if exchange.silent or probe.refused(exchange):
        raise Inconclusive(f"{command.name} was answered {received_text(exchange)}")
    if probe.claim.quirks and any(a.message.address == new for a in exchange.answers):
        probe.meets(NEW_ADDRESS_ANSWERS)
    try:
        _judge_place(probe, new, old, exchange)
    finally:
        # Whether or not it moved: what hears at the new address gets the old one back.
        back = probe.ask(command, {"new_address": old}, address=new)
    _judge_place(probe, old, new, back)


#: Addresses whose bits are once 0 and once 1, and those at the ends of them.
_BITS = (0x55, 0xAA, 0x80, 0xFE, 0x100, 0x2AA, 0x555, 0x400, 0x7FF)


@claim(
    Theme.ADDRESSING,
    each=commands(Verb.SET_ADDRESS),
    name="{command}/bits",
    refuted_by="an answer from another address, or none",
    alone=True,
    risks=lambda case: case.dialect.by_verb[Verb.SET_ADDRESS].all_risks,
    settings=("new_address",),
    fields=("new_address",),
    quirks=may_meet(NEW_ADDRESS_ANSWERS),
)
def _each_bit(probe: Probe, command: Command) -> None:
    """At an address with any of its bits set, a drive obeys, and answers from that address."""
    ask_first(probe)
    old, last = probe.address, command.request_forms[0].layout.named["new_address"].high
    for new in (a for a in _BITS if a <= min(last, probe.dialect.addresses[1]) and a != old):
        told = probe.ask(command, {"new_address": new})
        if told.silent or probe.refused(told):
            raise Inconclusive(f"{command.name} was answered {received_text(told)}")
        if probe.claim.quirks and any(a.message.address == new for a in told.answers):
            probe.meets(NEW_ADDRESS_ANSWERS)
        try:
            _expect_heard(probe, new, told)
        finally:
            back = probe.ask(command, {"new_address": old}, address=new)
        _expect_heard(probe, old, back)


#: Addresses that need both of their bytes.
_WIDE = (0x155, 0x6AA)


def _readable_address(dialect: Dialect) -> Iterator[Case]:
    """Yield the command that sets an address wider than a byte, where the address can be read."""
    wide = Verb.READ_PARAMETER in dialect.by_verb and dialect.addresses[1] > _BYTE
    return (case for case in commands(Verb.SET_ADDRESS)(dialect) if wide and case.command and case.command.readable)


@claim(
    Theme.ADDRESSING,
    each=_readable_address,
    name="{command}/told",
    refuted_by="another address",
    alone=True,
    risks=lambda case: case.dialect.by_verb[Verb.SET_ADDRESS].all_risks,
    settings=("new_address",),
    fields=("new_address",),
    parameters={},
)
def _told(probe: Probe, command: Command) -> None:
    """The address reads as it was set, with both of its bytes."""
    ask_first(probe)
    old = probe.address
    for new in (a for a in _WIDE if a != old):
        told = probe.ask(command, {"new_address": new})
        if told.silent or probe.refused(told):
            raise Inconclusive(f"{command.name} was answered {received_text(told)}")
        try:
            exchange = probe.ask(Verb.READ_PARAMETER, {"parameter": command.code}, address=new)
        finally:
            probe.ask(command, {"new_address": old}, address=new)
        seen = [a.message.values.get("new_address") for a in exchange.answers if a.message.frame.checksum_ok]
        if not seen:
            raise Inconclusive(f"the read of an address was answered {received_text(exchange)}")
        text = f"a drive with the address {new:X}h tells another one"
        probe.expect(seen[-1], equal=new, refutes=text, exchange=exchange, key="another address is told")


def _expect_heard(probe: Probe, here: int, told: Exchange) -> None:
    """Refute a drive that is not heard at an address, or answers from another one."""
    tries = [probe.ask(plain_read(probe.dialect), address=here, timeout_ns=probe.rig.late_ns) for _ in range(2)]
    probe.expect(
        received_text(tries[-1]),
        holds=any(a.message.address == here and a.message.frame.checksum_ok for t in tries for a in t.answers),
        expected=f"a reply of {here:X}h, behind {hex_of(told.sent or b'')}",
        refutes=f"a drive that was given the address {here} is not heard there",
        exchange=tries[-1],
        key="set_address: an address is not heard",
    )


def _judge_place(probe: Probe, here: int, gone: int, told: Exchange) -> None:
    """Refute a drive that is not heard here, or is heard where it should be gone."""
    for address, wanted, late_ns in ((here, True, probe.rig.late_ns), (gone, False, probe.rig.silence_ns)):
        tries = [probe.ask(plain_read(probe.dialect), address=address, timeout_ns=late_ns) for _ in range(2)]
        exchange = tries[-1]
        heard = [any(a.message.address == address and a.message.frame.checksum_ok for a in t.answers) for t in tries]
        what = "is not heard there" if wanted else "is still heard at the old one"
        probe.expect(
            received_text(exchange),
            holds=any(heard) == wanted,
            expected=f"{'a reply' if wanted else 'silence'} at {address}, behind {hex_of(told.sent or b'')}",
            refutes=f"a drive that was given the address {here} {what}",
            exchange=exchange,
            key=f"set_address: {what}",
        )


# --- what other drives answer -----------------------------------------------------------------------------------------


def _with_heads(dialect: Dialect) -> Iterator[Case]:
    """Yield a case for links whose frames begin with a head, so that a reply can be taken for a request."""
    if isinstance(dialect.link, HeadLink | LkLink):
        yield Case(dialect)


def _foreign_replies(probe: Probe) -> tuple[bytes, bytes]:
    """Return two replies of another drive: of zeros, and with a request to this drive in its data."""
    dialect, read = probe.dialect, plain_read(probe.dialect)
    size = read.reply_forms[0].layout.byte_length
    request = probe.build(read).frame.ljust(size, b"\0")[:size]
    other = probe.address + 1 if probe.address < dialect.addresses[1] else probe.address - 1
    zeros, inner = (dialect.link.build(read, read.reply_forms[0], other, data, Role.REPLY) for data in (bytes(size), request))
    return zeros, inner


def _expect_ignored(probe: Probe, frame: bytes) -> None:
    ask_first(probe)
    expect_silence(probe, probe.send(frame), "another drive's reply is answered")


@_addressing("any answer", each=_with_heads, name="foreign_reply/ignored")
def _reply_ignored(probe: Probe) -> None:
    """Another drive's reply is not answered."""
    _expect_ignored(probe, _foreign_replies(probe)[0])


@_addressing("an answer to what its data read like", each=_with_heads, name="foreign_reply/inside", at_best=Certainty.OPEN)
def _inside_reply(probe: Probe) -> None:
    """Another drive's reply whose data read like a request is not answered."""
    _expect_ignored(probe, _foreign_replies(probe)[1])


@_addressing("silence, or another answer", each=_with_heads, name="foreign_reply/next", at_best=Certainty.LIKELY)
def _behind_reply(probe: Probe) -> None:
    """The next request to the drive behind another drive's reply is answered."""
    ask_first(probe)
    for frame in _foreign_replies(probe):
        judge_next(probe, "another drive's reply", partial(probe.send, frame))
