"""Addressing: a drive hears its own address, all drives' and its group's, and answers its own alone.

Rules kept here:
- Everything here but a read of the drive itself goes to other addresses: the claims want the bus to themselves.
- That something is executed, or is not, is seen by a witness (`motion.effects`), and the witness is sent to the drive
  itself in the end where nothing was to happen, so that a drive that does nothing at all proves nothing.
- Addresses of several drives stand in `addressing_many`, packages for several drives in `addressing_package`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING

from analyzer.catalogue import Certainty, Dialect, Role, Verb
from analyzer.link import HeadLink, LkLink
from conformance.claim import Claim, Inconclusive, Refuted, Theme
from conformance.claims import addressing_many, addressing_package
from conformance.claims.addressing_many import read_of, send_to
from conformance.claims.declare import declare
from conformance.claims.hearing import ask_first, came, judge_next, plain_read, section
from conformance.claims.known_quirks import known
from conformance.motion import effects
from conformance.motion.effects import Witness
from conformance.talk.exchange import Exchange, hex_of

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

NEW_ADDRESS_ANSWERS = "new-address-answers"
_BYTE = 0xFF
#: Orders of the witness that are sent to other addresses: each takes the time of a move.
_FEW = 5


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    yield from _others(dialect)
    yield from addressing_many.claims(dialect)
    if Verb.SET_ADDRESS in dialect.by_verb:
        yield _moves(dialect)
    if not isinstance(dialect.link, HeadLink | LkLink):
        return
    yield from _foreign_replies(dialect)
    if any(c.slots is not None for c in dialect.commands):
        yield from addressing_package.claims(dialect)


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


_CLASSES: tuple[tuple[str, str, Callable[[Dialect, int], Iterable[int]], bool], ...] = (
    ("neighbours", "an address near the drive's", _neighbours, False),
    ("one_bit", "an address that differs from the drive's in one bit", _one_bit, False),
    ("edges", "the lowest, the highest and other addresses", _edges, False),
    ("every", "any other address", _every, True),
)


def _others(dialect: Dialect) -> Iterator[Claim]:
    classes = [*_CLASSES]
    if dialect.addresses[1] > _BYTE:
        classes.insert(2, ("low_byte", "an address with the drive's low byte", _same_low_byte, False))
    for name, what, addresses, emulated in classes:
        yield _silent_to(dialect, name, what, addresses, emulated)
    if dialect.broadcast is None:
        yield _silent_to(dialect, "zero", "the address 0", lambda dialect, own: (0,), False)
    yield _other_next(dialect)
    shown = effects.chosen(dialect)
    if shown is not None:
        yield _not_executed(dialect, shown)


def _chosen(dialect: Dialect, own: int, addresses: Iterable[int]) -> list[int]:
    """Return those addresses that can be sent to and are neither the drive's nor all drives'."""
    last = max(dialect.addresses[1], _BYTE if dialect.broadcast is None else 0)
    fit = [a for a in dict.fromkeys(addresses) if 0 <= a <= last and a != own]
    return [a for a in fit if a != dialect.broadcast]


def _silent_to(
    dialect: Dialect, name: str, what: str, addresses: Callable[[Dialect, int], Iterable[int]], emulated: bool
) -> Claim:
    def check(probe: Probe) -> None:
        ask_first(probe)
        for address in _chosen(dialect, probe.address, addresses(dialect, probe.address)):
            sent = read_of(probe, address)
            if not sent.silent:
                raise Refuted(
                    f"a request to {address} is answered, and the drive is {probe.address}",
                    expected=f"silence after {hex_of(sent.sent or b'')}",
                    got=came(sent),
                    exchange=sent,
                    key="another address is answered",
                )

    return declare(
        dialect,
        Theme.ADDRESSING,
        f"other/{name}",
        f"A request to {what} is not answered.",
        "any answer",
        check,
        section=section(dialect),
        alone=True,
        emulated=emulated,
    )


def _other_next(dialect: Dialect) -> Claim:
    def check(probe: Probe) -> None:
        ask_first(probe)
        for address in _chosen(dialect, probe.address, _neighbours(dialect, probe.address)):
            judge_next(probe, f"one to {address}", partial(read_of, probe, address))

    return declare(
        dialect,
        Theme.ADDRESSING,
        "other/next",
        "The next request to the drive behind one to another address is answered.",
        "silence, or another answer",
        check,
        section=section(dialect),
        alone=True,
    )


def _not_executed(dialect: Dialect, shown: Witness) -> Claim:
    def check(probe: Probe) -> None:
        shown.prepare(probe)
        near = _chosen(dialect, probe.address, _neighbours(dialect, probe.address))[:2]
        far = _chosen(dialect, probe.address, (*_one_bit(dialect, probe.address), *_edges(dialect, probe.address)))
        if dialect.broadcast is None:
            near.append(0)
        order = shown.order(probe)
        for address in [*near, *far[-3:], *far[:3]][: _FEW + 2]:
            sent = send_to(probe, address, order, shown.settle_ns)
            if shown.done(probe, order):
                raise Refuted(
                    f"{order.command.name} to {address} is executed, and the drive is {probe.address}",
                    expected=f"{order.before} still to be read after {hex_of(sent.sent or b'')}",
                    got=f"{order.after} is read",
                    exchange=sent,
                    key="another address is executed",
                )
        shown.control(probe)

    return declare(
        dialect,
        Theme.ADDRESSING,
        "other/not_executed",
        "A request to another address is not executed.",
        "an effect of it",
        check,
        section=section(dialect),
        alone=True,
        risks=shown.risks,
        settings=shown.settings,
    )


# --- another address for the drive ------------------------------------------------------------------------------------


def _moves(dialect: Dialect) -> Claim:
    command = dialect.by_verb[Verb.SET_ADDRESS]
    quirks = known(dialect, NEW_ADDRESS_ANSWERS)

    def check(probe: Probe) -> None:
        ask_first(probe)
        old = probe.address
        new = old + 1 if old < dialect.addresses[1] else old - 1
        exchange = probe.ask(command, {"new_address": new})
        if exchange.silent or probe.refused(exchange):
            raise Inconclusive(f"{command.name} was answered {came(exchange)}")
        if quirks and any(a.message.address == new for a in exchange.answers):
            probe.meets(NEW_ADDRESS_ANSWERS)
        try:
            _judge_place(probe, new, old, exchange)
        finally:
            # Whether or not it moved: what hears at the new address gets the old one back.
            back = probe.ask(command, {"new_address": old}, address=new)
        _judge_place(probe, old, new, back)

    return declare(
        dialect,
        Theme.ADDRESSING,
        "set_address/moves",
        "A drive that is given another address is heard there, and no longer at the old one; and back.",
        "an answer at the old address, or none at the new one",
        check,
        command=command,
        alone=True,
        risks=command.all_risks,
        settings=("new_address",),
        fields=("new_address",),
        quirks=quirks,
    )


def _judge_place(probe: Probe, here: int, gone: int, told: Exchange) -> None:
    """Refute a drive that is not heard here, or is heard where it should be gone."""
    for address, wanted in ((here, True), (gone, False)):
        tries = [probe.ask(plain_read(probe.dialect), address=address, timeout_ns=probe.rig.late_ns) for _ in range(2)]
        exchange = tries[-1]
        heard = [any(a.message.address == address and a.message.frame.checksum_ok for a in t.answers) for t in tries]
        if any(heard) != wanted:
            what = "is not heard there" if wanted else "is still heard at the old one"
            raise Refuted(
                f"a drive that was given the address {here} {what}",
                expected=f"{'a reply' if wanted else 'silence'} at {address}, behind {hex_of(told.sent or b'')}",
                got=came(exchange),
                exchange=exchange,
                key=f"set_address: {what}",
            )


# --- what other drives answer -----------------------------------------------------------------------------------------


def _foreign_replies(dialect: Dialect) -> Iterator[Claim]:
    read = plain_read(dialect)

    def reply_of(probe: Probe, data: bytes) -> bytes:
        other = probe.address + 1 if probe.address < dialect.addresses[1] else probe.address - 1
        return dialect.link.build(read, read.reply_forms[0], other, data, Role.REPLY)

    def frames(probe: Probe) -> list[bytes]:
        size = read.reply_forms[0].layout.byte_length
        inner = probe.build(read).frame
        return [reply_of(probe, bytes(size)), reply_of(probe, inner.ljust(size, b"\0")[:size])]

    def plain(probe: Probe) -> None:
        ask_first(probe)
        _silent_behind(probe, frames(probe)[0])

    def inner(probe: Probe) -> None:
        ask_first(probe)
        _silent_behind(probe, frames(probe)[1])

    def following(probe: Probe) -> None:
        ask_first(probe)
        for frame in frames(probe):
            judge_next(probe, "another drive's reply", partial(probe.send, frame))

    kinds = (
        ("ignored", "Another drive's reply is not answered.", "any answer", plain, Certainty.CERTAIN),
        (
            "inside", "Another drive's reply whose data read like a request is not answered.", "an answer to what its data"
            " read like", inner, Certainty.OPEN,
        ),
        (
            "next", "The next request to the drive behind another drive's reply is answered.", "silence, or another answer",
            following, Certainty.LIKELY,
        ),
    )  # fmt: skip
    for name, statement, refuted_by, check, sure in kinds:
        yield declare(
            dialect, Theme.ADDRESSING, f"foreign_reply/{name}", statement, refuted_by, check, section=section(dialect),
            alone=True, at_best=sure,
        )  # fmt: skip


def _silent_behind(probe: Probe, frame: bytes) -> None:
    sent = probe.send(probe.build(plain_read(probe.dialect)).item(frame))
    if not sent.silent:
        raise Refuted(
            "another drive's reply is answered", expected=f"silence after {hex_of(frame)}", got=came(sent), exchange=sent
        )
