"""Changing where and how a drive answers, following it there and leading it back. For claims about settings of the link.

Rules kept here:
- The reply to such a setting uses the old setting; one that already uses the new is accepted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from analyzer import encoder
from analyzer.catalogue import Command, Dialect
from analyzer.errors import UsageError
from analyzer.layout import Effect
from conformance.claim import Inconclusive, NotRun
from conformance.talk.acceptance import Acceptance, acceptance, answers, is_there
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe, Until

#: How a setting is sent to a drive.
Ask = Callable[[Probe, Command, dict[str, int]], Exchange]
#: A drive that changes its link gets so long for it.
SETTLE_NS = 200 * MS
NEW_ADDRESS_ANSWERS = "new-address-answers"
#: The address that a claim gives a drive for a while. The second number is added where addresses have more than a byte.
_OTHER_ADDRESS, _SECOND_BYTE = 0x5A, 0x100
#: Head, address and check are no reply yet.
_SHORTEST = 4


def other_address(dialect: Dialect) -> int:
    """Return an address that a claim can give a drive for a while: one of more than a byte where there are such."""
    return _OTHER_ADDRESS | (_SECOND_BYTE if dialect.addresses[1] >= _SECOND_BYTE else 0)


def change_address(probe: Probe, command: Command, address: int, *, at: int | None = None) -> Exchange:
    """Give the drive (that answers `at` an address) another one; the claim is refuted where it refuses.

    Raises Inconclusive where it does not answer.
    """
    built = probe.build(command, {command.sets(Effect.ADDRESS): address}, address=at)
    exchange = probe.ask_built(built)
    if exchange.silent:
        # The line may have lost it.
        exchange = probe.ask_built(built)
    if exchange.silent:
        raise Inconclusive(f"{command.name} {address} was not answered")
    from_new = exchange.answers and exchange.answers[0].message.address == address != built.address
    if from_new and NEW_ADDRESS_ANSWERS in probe.claim.quirks:
        probe.meets(NEW_ADDRESS_ANSWERS)
    expect_not_refused(probe, command, address, exchange)
    settle(probe, address)
    return exchange


def settle(probe: Probe, address: int | None = None) -> None:
    """Wait until a drive that changes its link answers, at its address or this one: not longer than it gets for that."""
    until_ns = probe.gate.now_ns() + SETTLE_NS
    while (left_ns := until_ns - probe.gate.now_ns()) > 0:
        if is_there(probe, address, most_ns=left_ns):
            return


def expect_not_refused(probe: Probe, command: Command, value: int, exchange: Exchange) -> None:
    """Refute the claim where a drive refused a value that the manual lists."""
    probe.expect(
        exchange.answers[0].data.hex(" ").upper() if exchange.answers else "silence",
        holds=acceptance(probe, exchange) is not Acceptance.REFUSED,
        expected="success: the manual lists it",
        refutes=f"{command.name}: {value} is refused",
        exchange=exchange,
        key=f"{command.name} refused",
    )


def follow(probe: Probe, rate: int) -> None:
    """Bring this end to a speed. Raises NotRun where that cannot be."""
    try:
        probe.gate.set_speed(rate)
    except UsageError as error:
        raise NotRun(f"this end cannot follow the drive to {rate} bits per second: {error}") from None


def set_rate(probe: Probe, rate: int, ask: Ask = Probe.ask) -> Exchange:
    """Set the drive to a speed, without following it. Raises Inconclusive where it has no such setting."""
    command, name, code = _setting_of(probe, rate)
    return ask(probe, command, {name: code})


def _setting_of(probe: Probe, rate: int) -> tuple[Command, str, int]:
    code = next((v for v, r in probe.dialect.rates.items() if r == rate), None)
    found = probe.dialect.effect(Effect.BAUD_RATE)
    if found is None or code is None:
        raise Inconclusive(f"{probe.dialect.name} has no setting for {rate} bits per second")
    return found[0], found[1].name, code


def another_rate(probe: Probe) -> int:
    """Return a speed of the line that the drive can have, and has not."""
    return next(rate for rate in probe.dialect.rates.values() if rate != probe.gate.line.endpoint.bits_per_second)


@contextmanager
def at_rate(probe: Probe, rate: int, ask: Ask = Probe.ask) -> Iterator[Exchange]:
    """Bring the drive and this end to a speed, yield the exchange that asked for it, and bring both back. `ask`: how it does.

    Raises NotRun where this end cannot be there, and Inconclusive where the drive could not be set back.
    """
    before = probe.gate.line.endpoint.bits_per_second
    # A drive that has changed is not found again by an end that cannot follow, nor set back where it has no such setting.
    for each in (rate, before):
        _setting_of(probe, each)
        follow(probe, each)
    exchange = set_rate(probe, rate, ask)
    follow(probe, rate)
    try:
        settle(probe)
        yield exchange
        if rate != before and answers(probe, probe.address):
            set_rate(probe, before)
    finally:
        follow(probe, before)
    settle(probe)


def ask_in(
    probe: Probe, other: Dialect, what: str, values: dict[str, int] | None = None, *, address: int | None = None
) -> bytes:
    """Send a request in another dialect, and return what came back."""
    item = encoder.build(other, what, probe.address if address is None else address, values)
    exchange = probe.send(item, until=Until.TIMEOUT, timeout_ns=min(SETTLE_NS, probe.rig.silence_ns))
    pieces = [(a.first_ns, a.data) for a in exchange.answers] + [(j.first_ns or 0, j.data) for j in exchange.junk]
    return b"".join(data for _, data in sorted(pieces))


def is_reply(dialect: Dialect, address: int, data: bytes) -> bool:
    """Say whether data is a whole reply of a drive in a dialect."""
    return len(data) > _SHORTEST and dialect.link.fits(data) and dialect.link.parse(data).address == address


def need_reply_or_silence(dialect: Dialect, address: int, data: bytes) -> None:
    """Raise Inconclusive for bytes that are neither a reply nor nothing, which other claims judge."""
    if data and not is_reply(dialect, address, data):
        raise Inconclusive(f"what came in {dialect.name} is no reply: {data.hex(' ').upper()}")
