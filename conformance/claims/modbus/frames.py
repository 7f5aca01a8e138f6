"""Modbus frames as claims send them, and what must come back to the byte."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from analyzer.catalogue import Dialect
from analyzer.link import ModbusLink, modbus_crc
from conformance.claim import Observed
from conformance.claims.control_reads import received_text
from conformance.claims.declare import Case, once
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe, Until

#: Address, function and CRC.
_SHORTEST = 4
#: What a transceiver that turns round may put before a reply, now and then: no reply begins so.
_IDLE, _MOST_IDLE = b"\0\xff", 2


def request(probe: Probe, function: int, *words: int, data: bytes = b"", address: int | None = None) -> bytes:
    """Return a request of any function with 16-bit words and bytes behind it, and its CRC."""
    to = probe.address if address is None else address
    body = bytes((to, function)) + b"".join(w.to_bytes(2, "big") for w in words) + data
    return probe.dialect.link.completed(body)


def unambiguous(make: Callable[[int], bytes]) -> bytes | None:
    """Return a frame of some value of which no shorter part has a CRC that fits: a drive could take that for the frame.

    None where each has such a part.
    """
    frames = map(make, range(0, 0xFFFF, 0x0101))
    return next((f for f in frames if all(modbus_crc(f[:size]) for size in range(_SHORTEST, len(f)))), None)


def exception(probe: Probe, function: int, code: int) -> bytes:
    """Return the exception by which a request is refused."""
    return probe.dialect.link.completed(bytes((probe.address, function | 0x80, code)))


def ask(probe: Probe, frame: bytes) -> Exchange:
    """Send a request as bytes and return what came back."""
    return probe.send(frame, until=Until.REPLY, timeout_ns=probe.rig.late_ns)


def expect_answer(probe: Probe, sent: Exchange, expected: bytes, what: str) -> None:
    """Refute a drive that does not answer what was sent with these bytes and nothing else."""
    if _told(sent) != expected:
        # Once more: a line that loses or garbles a reply now and then is another matter.
        again = ask(probe, sent.data)
        probe.expect(
            received_text(again),
            holds=_told(again) == expected,
            expected=f"{hex_of(expected)} to {hex_of(sent.sent or b'')}",
            refutes=f"{what} is answered otherwise",
            exchange=again,
            key=what,
        )


def _told(sent: Exchange) -> bytes:
    """Return what came back, without what a line may put before it."""
    told = sent.received.lstrip(_IDLE)
    return told if len(sent.received) - len(told) <= _MOST_IDLE else sent.received


#: A request that calls for an exception: what it is in words, its function, its bytes, the exception.
Denied = tuple[str, int, bytes, int]


def expect_exceptions(probe: Probe, denied: Iterable[Denied]) -> None:
    """Refute a drive that answers one of several requests by anything but its exception.

    Raises Observed where no more is wrong than that some are not answered: exceptions are the standard's, and not the manual's.
    """
    silent = []
    for what, function, frame, code in denied:
        sent = ask(probe, frame)
        if sent.silent:
            # A drive may drop what comes at once behind a write.
            probe.wait(probe.rig.write_gap_ns)
            sent = ask(probe, frame)
        if sent.silent:
            silent.append(what)
        else:
            expect_answer(probe, sent, exception(probe, function, code), what)
    if silent:
        raise Observed(f"silence, and no exception, to {silent[0]}" + f" and {len(silent) - 1} more" * (len(silent) > 1))


def on_modbus(dialect: Dialect) -> Iterable[Case]:
    """Yield one case for a dialect on Modbus, none for another."""
    return once(dialect) if isinstance(dialect.link, ModbusLink) else ()
