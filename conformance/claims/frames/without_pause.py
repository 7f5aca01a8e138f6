"""Framing without the pause between frames, which no manual speaks of: observed, except where Modbus has its own rule.

    FF FF FF FA 01 31 2C             noise at once before a good request
    FA 01 FA 01 31 2C                a broken one at once before a good one
    FA 01 31 2C FA 01 32 2D          two at once
    FA 01 .... 31 2C                 one in pieces

What is always judged is that the next good request, behind a pause, is answered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Subject
from analyzer.link import CanLink, ModbusLink
from conformance.claim import Inconclusive, Observed, Theme
from conformance.claims.control_reads import (
    PAUSE_NS,
    answered_by,
    ask_alone,
    ask_first,
    garblers,
    judge_next,
    plain_read,
    received_text,
)
from conformance.claims.declare import Case, claim, described_in, once
from conformance.talk import garbling
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe

MS = 1_000_000
#: Pauses within a frame, ns: what an operating system, an adapter and a slow host put there.
_GAPS_NS, _LONG_NS = (1 * MS, 5 * MS, 16 * MS, 50 * MS, 200 * MS, 1000 * MS), 200 * MS
#: The pause that ends a Modbus frame at any baud rate of these drives, and one that does not: 3.5 and 1.5 characters.
_MODBUS_LONG_NS = 20 * MS
_CHARACTERS = 1.0


def _framing(refuted_by: str, at_best: Any, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a check of frames, whose section is that about frames."""
    facts = {"section": described_in(Subject.FRAMING), "parameters": {}, **facts}
    return claim(Theme.FRAMING, refuted_by=refuted_by, at_best=at_best, **facts)


def _on_serial_lines(dialect: Dialect) -> Iterable[Case]:
    return () if isinstance(dialect.link, CanLink) else once(dialect)


# --- at once ----------------------------------------------------------------------------------------------------------

Variants = Callable[[Probe], Iterable[tuple[str, bytes]]]


def _with_noise(probe: Probe) -> Iterator[tuple[str, bytes]]:
    frame = probe.build(plain_read(probe.dialect)).frame
    for data in garbling.NOISE:
        yield f"noise {data[:4].hex(' ').upper()}", data + frame


def _with_broken(probe: Probe) -> Iterator[tuple[str, bytes]]:
    frame = probe.build(plain_read(probe.dialect)).frame
    for size in range(1, len(frame)):
        yield f"{size} of {len(frame)} bytes", frame[:size] + frame


def _with_trailing(probe: Probe) -> Iterator[tuple[str, bytes]]:
    for what, item in garblers(probe)[0].trailing():
        if isinstance(item, bytes):
            yield what, item


_GLUED: tuple[tuple[str, str, Variants], ...] = (
    ("noise_before", "noise at once before it", _with_noise),
    ("broken_before", "the beginning of another one at once before it", _with_broken),
    ("trailing", "stray bytes at once behind it", _with_trailing),
)


def _glued(dialect: Dialect) -> Iterator[Case]:
    for case in _on_serial_lines(dialect):
        for kind, what, variants in _GLUED:
            yield Case(case.dialect, given={"kind": kind, "what": what, "variants": variants})


@_framing("silence, or another answer", Certainty.OPEN, each=_glued, name="{kind}/answered")
def _glued_answered(probe: Probe, variants: Variants) -> None:
    """A good request with {what} is answered."""
    read = plain_read(probe.dialect)
    ask_alone(probe)
    sent = [(what, probe.send(data)) for what, data in variants(probe)]
    missed = [(what, exchange) for what, exchange in sent if not answered_by(probe, exchange, read)]
    if missed:
        exchange = missed[0][1]
        probe.expect(
            received_text(exchange),
            holds=False,
            expected=f"a reply to the good one in {hex_of(exchange.sent or b'')}",
            refutes=f"a good request is not answered with {', '.join(what for what, _ in missed)}",
            exchange=exchange,
            key="not answered without a pause",
        )


@_framing("silence, or another answer", Certainty.LIKELY, each=_glued, name="{kind}/next")
def _behind_glued(probe: Probe, variants: Variants) -> None:
    """The next good request behind one with {what} is answered."""
    ask_first(probe)
    for what, data in variants(probe):
        judge_next(probe, f"one with {what}", partial(probe.send, data))


def _pair(dialect: Dialect) -> tuple[Command, Command]:
    """Return two reads without data and of the same risks."""
    first = plain_read(dialect)
    others = (c for c in dialect.commands if c.request_forms[0].layout.byte_length == 0 and c is not first)
    return first, next(c for c in others if c.all_risks == first.all_risks)


def _send_two(probe: Probe) -> Exchange:
    both = [probe.build(c) for c in _pair(probe.dialect)]
    if not isinstance(probe.dialect.link, CanLink):
        return probe.send(b"".join(built.frame for built in both))
    one, other = (probe.send(built.item(), timeout_ns=0 if n == 0 else None) for n, built in enumerate(both))
    other.answers[:0] = one.answers
    return other


@_framing(
    "one answer, or none",
    lambda case: Certainty.LIKELY if isinstance(case.dialect.link, CanLink) else Certainty.OPEN,
    name="two_at_once/answered",
)
def _two_answered(probe: Probe) -> None:
    """Two good requests at once are both answered, in their order."""
    first, second = _pair(probe.dialect)
    ask_alone(probe)
    tries = [_send_two(probe) for _ in range(2)]
    probe.expect(
        received_text(tries[-1]),
        holds=any(answered_by(probe, each, first, second) for each in tries),
        expected=f"a reply to {first.name} and one to {second.name}",
        refutes="of two requests at once, not both are answered in their order",
        exchange=tries[-1],
    )


@_framing("silence", Certainty.LIKELY, name="two_at_once/next")
def _behind_two(probe: Probe) -> None:
    """The next good request behind two at once is answered."""
    ask_first(probe)
    judge_next(probe, "two at once", partial(_send_two, probe))


# --- in pieces --------------------------------------------------------------------------------------------------------


def _cut(probe: Probe, at: int, gap_ns: int) -> Exchange:
    """Send a good read in two pieces with a pause between; return what came behind the second."""
    frame = probe.build(plain_read(probe.dialect)).frame
    early = probe.send(frame[:at], timeout_ns=gap_ns)
    if not early.silent:
        raise Inconclusive(f"{at} of {len(frame)} bytes were answered, which another claim judges")
    return probe.send(frame[at:])


def _places(probe: Probe, gap_ns: int = 0) -> range:
    """Return the places at which a good read can be cut; for a pause as long as this the middle alone."""
    whole = len(probe.build(plain_read(probe.dialect)).frame)
    return range(1, whole) if gap_ns < _LONG_NS else range(whole // 2, whole // 2 + 1)


@_framing("nothing: the manual is silent on pauses", Certainty.OPEN, each=_on_serial_lines, name="pieces/answered")
def _pieces_answered(probe: Probe) -> None:
    """A request in two pieces with a pause between is answered."""
    read = plain_read(probe.dialect)
    ask_alone(probe)
    passed: list[int] = []
    for gap_ns in _GAPS_NS:
        if not all(answered_by(probe, _cut(probe, at, gap_ns), read) for at in _places(probe, gap_ns)):
            # What does not outlast this pause outlasts none that is longer.
            break
        passed.append(gap_ns)
    longest = max(passed, default=0)
    probe.measured["longest_pause_in_a_frame_ms"] = longest / MS
    if len(passed) == len(_GAPS_NS):
        raise Observed(f"a request in two pieces is answered however long the pause, up to {longest // MS} ms")
    if not passed:
        raise Observed(f"a request in two pieces is not answered, from {_GAPS_NS[0] // MS} ms of pause on")
    raise Observed(f"a request in two pieces is answered up to {longest // MS} ms of pause, and not beyond")


@_framing("silence, or another answer", Certainty.LIKELY, each=_on_serial_lines, name="pieces/next")
def _behind_pieces(probe: Probe) -> None:
    """The next good request behind one in two pieces is answered."""
    ask_first(probe)
    for at in _places(probe):
        judge_next(probe, f"one in two pieces ({at} bytes before the pause)", partial(_cut, probe, at, _GAPS_NS[-2]))


def _on_modbus(dialect: Dialect) -> Iterable[Case]:
    return once(dialect) if isinstance(dialect.link, ModbusLink) else ()


@_framing("an answer", Certainty.LIKELY, each=_on_modbus, name="silence/long")
def _long_silence(probe: Probe) -> None:
    """A frame with more than 3.5 characters of silence inside is not answered."""
    ask_first(probe)
    for at in _places(probe):
        sent = _cut(probe, at, _MODBUS_LONG_NS)
        probe.expect(
            received_text(sent),
            holds=sent.silent,
            expected=f"silence: more than 3.5 characters behind byte {at} end a frame",
            refutes="a frame with a silence inside is answered",
            exchange=sent,
        )
        probe.wait(PAUSE_NS)


@_framing("silence", Certainty.LIKELY, each=_on_modbus, name="silence/short", emulated=True)
def _short_silence(probe: Probe) -> None:
    """A frame with a pause of one character inside is answered."""
    ask_alone(probe)
    gap_ns = int(_CHARACTERS * probe.rig.byte_ns)
    for at in _places(probe):
        # The first piece takes its time on the line; the pause begins behind it.
        tries = [_cut(probe, at, gap_ns) for _ in range(2)]
        probe.expect(
            received_text(tries[-1]),
            holds=any(answered_by(probe, each, plain_read(probe.dialect)) for each in tries),
            expected=f"a reply: up to 1.5 characters behind byte {at} belong to the frame",
            refutes="a frame with a pause of one character inside is not answered",
            exchange=tries[-1],
        )
