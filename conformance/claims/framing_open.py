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
from typing import TYPE_CHECKING

from analyzer.catalogue import Certainty, Dialect
from analyzer.link import CanLink, ModbusLink
from conformance.claim import Claim, Inconclusive, Observed, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.hearing import (
    LISTEN_NS,
    PAUSE_NS,
    answered_by,
    ask_cleanly,
    ask_first,
    came,
    garblers,
    judge_next,
    plain_read,
    section,
)
from conformance.talk import garbling
from conformance.talk.exchange import Exchange, hex_of

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

MS = 1_000_000
#: Pauses within a frame, ns: what an operating system, an adapter and a slow host put there.
_GAPS_NS = (1 * MS, 5 * MS, 16 * MS, 50 * MS, 200 * MS, 1000 * MS)
#: The pause that ends a Modbus frame at any baud rate of these drives, and one that does not: 3.5 and 1.5 characters.
_MODBUS_LONG_NS = 20 * MS
_CHARACTERS = 1.0


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about frames without a pause between or with one inside."""
    yield from _two(dialect)
    if isinstance(dialect.link, CanLink):
        return
    yield from _glued(dialect)
    yield from _pieces(dialect)
    if isinstance(dialect.link, ModbusLink):
        yield from _modbus_gaps(dialect)


Check = Callable[["Probe"], None]
Variants = Callable[["Probe"], Iterable[tuple[str, bytes]]]


def _declare(
    dialect: Dialect, name: str, statement: str, refuted_by: str, check: Check, sure: Certainty, *, emulated: bool = False
) -> Claim:
    where = section(dialect)
    return declare(dialect, Theme.FRAMING, name, statement, refuted_by, check, section=where, at_best=sure, emulated=emulated)


# --- at once ----------------------------------------------------------------------------------------------------------


def _glued(dialect: Dialect) -> Iterator[Claim]:
    read = plain_read(dialect)

    def with_noise(probe: Probe) -> Iterator[tuple[str, bytes]]:
        frame = probe.build(read).frame
        for data in garbling.NOISE:
            yield f"noise {data[:4].hex(' ').upper()}", data + frame

    def with_broken(probe: Probe) -> Iterator[tuple[str, bytes]]:
        frame = probe.build(read).frame
        for size in range(1, len(frame)):
            yield f"{size} of {len(frame)} bytes", frame[:size] + frame

    def with_trailing(probe: Probe) -> Iterator[tuple[str, bytes]]:
        for what, item in garblers(probe)[0].trailing():
            if isinstance(item, bytes):
                yield what, item

    yield from _glued_pair(dialect, "noise_before", "noise at once before it", with_noise)
    yield from _glued_pair(dialect, "broken_before", "the beginning of another one at once before it", with_broken)
    yield from _glued_pair(dialect, "trailing", "stray bytes at once behind it", with_trailing)


def _glued_pair(dialect: Dialect, name: str, what: str, variants: Variants) -> Iterator[Claim]:
    read = plain_read(dialect)

    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        deaf = []
        for shown, data in variants(probe):
            sent = probe.send(data, timeout_ns=LISTEN_NS)
            if not answered_by(probe, sent, read):
                deaf.append((shown, sent))
        if deaf:
            listed = ", ".join(shown for shown, _ in deaf)
            raise Refuted(
                f"a good request is not answered with {listed}",
                expected=f"a reply to the good one in {hex_of(deaf[0][1].sent or b'')}",
                got=came(deaf[0][1]),
                exchange=deaf[0][1],
                key="not answered without a pause",
            )

    def following(probe: Probe) -> None:
        ask_first(probe)
        for shown, data in variants(probe):
            judge_next(probe, f"one with {shown}", partial(probe.send, data, timeout_ns=LISTEN_NS))

    statement = f"A good request with {what} is answered."
    yield _declare(dialect, f"{name}/answered", statement, "silence, or another answer", check, Certainty.OPEN)
    statement = f"The next good request behind one with {what} is answered."
    yield _declare(dialect, f"{name}/next", statement, "silence, or another answer", following, Certainty.LIKELY)


def _two(dialect: Dialect) -> Iterator[Claim]:
    first = plain_read(dialect)
    others = (c for c in dialect.commands if c is not first and c.all_risks == first.all_risks)
    second = next((c for c in others if c.request_forms[0].layout.byte_length == 0), None)
    if second is None:
        return
    can = isinstance(dialect.link, CanLink)

    def send(probe: Probe) -> Exchange:
        built = [probe.build(c) for c in (first, second)]
        if not can:
            return probe.send(b"".join(each.frame for each in built), timeout_ns=LISTEN_NS)
        one, other = (probe.send(each.item(), timeout_ns=0 if n == 0 else LISTEN_NS) for n, each in enumerate(built))
        other.answers[:0] = one.answers
        return other

    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        tries = [send(probe) for _ in range(2)]
        sent = tries[-1]
        if not any(answered_by(probe, each, first, second) for each in tries):
            raise Refuted(
                "of two requests at once, not both are answered in their order",
                expected=f"a reply to {first.name} and one to {second.name}",
                got=came(sent),
                exchange=sent,
            )

    def following(probe: Probe) -> None:
        ask_first(probe)
        judge_next(probe, "two at once", partial(send, probe))

    sure = Certainty.LIKELY if can else Certainty.OPEN
    statement = "Two good requests at once are both answered, in their order."
    yield _declare(dialect, "two_at_once/answered", statement, "one answer, or none", check, sure)
    statement = "The next good request behind two at once is answered."
    yield _declare(dialect, "two_at_once/next", statement, "silence", following, Certainty.LIKELY)


# --- in pieces --------------------------------------------------------------------------------------------------------


def _cut(probe: Probe, at: int, gap_ns: int) -> Exchange:
    """Send a good read in two pieces with a pause between; return what came behind the second."""
    frame = probe.build(plain_read(probe.dialect)).frame
    early = probe.send(frame[:at], timeout_ns=gap_ns)
    if not early.silent:
        raise Inconclusive(f"{at} of {len(frame)} bytes were answered, which another claim judges")
    return probe.send(frame[at:], timeout_ns=LISTEN_NS)


def _pieces(dialect: Dialect) -> Iterator[Claim]:
    read = plain_read(dialect)

    def check(probe: Probe) -> None:
        ask_cleanly(probe)
        size = len(probe.build(read).frame)
        taken: list[int] = []
        for gap_ns in _GAPS_NS:
            answered = [answered_by(probe, _cut(probe, at, gap_ns), read) for at in range(1, size)]
            if all(answered):
                taken.append(gap_ns)
        longest = max(taken, default=0)
        probe.measured["longest_pause_in_a_frame_ms"] = longest / MS
        if len(taken) == len(_GAPS_NS):
            raise Observed(f"a request in two pieces is answered however long the pause, up to {longest // MS} ms")
        if not taken:
            raise Observed(f"a request in two pieces is not answered, from {_GAPS_NS[0] // MS} ms of pause on")
        raise Observed(f"a request in two pieces is answered up to {longest // MS} ms of pause, and not beyond")

    def following(probe: Probe) -> None:
        ask_first(probe)
        for at in range(1, len(probe.build(read).frame)):
            what = f"one in two pieces ({at} bytes before the pause)"
            judge_next(probe, what, partial(_cut, probe, at, _GAPS_NS[-2]))

    statement = "A request in two pieces with a pause between is answered."
    yield _declare(dialect, "pieces/answered", statement, "nothing: the manual is silent on pauses", check, Certainty.OPEN)
    statement = "The next good request behind one in two pieces is answered."
    yield _declare(dialect, "pieces/next", statement, "silence, or another answer", following, Certainty.LIKELY)


def _modbus_gaps(dialect: Dialect) -> Iterator[Claim]:
    read = plain_read(dialect)

    def long(probe: Probe) -> None:
        ask_first(probe)
        for at in range(1, len(probe.build(read).frame)):
            sent = _cut(probe, at, _MODBUS_LONG_NS)
            if not sent.silent:
                raise Refuted(
                    "a frame with a silence inside is answered",
                    expected=f"silence: more than 3.5 characters behind byte {at} end a frame",
                    got=came(sent),
                    exchange=sent,
                )
            probe.wait(PAUSE_NS)

    def short(probe: Probe) -> None:
        ask_cleanly(probe)
        gap_ns = int(_CHARACTERS * probe.rig.byte_ns)
        for at in range(1, len(probe.build(read).frame)):
            # The first piece takes its time on the line; the pause begins behind it.
            tries = [_cut(probe, at, gap_ns) for _ in range(2)]
            sent = tries[-1]
            if not any(answered_by(probe, each, read) for each in tries):
                raise Refuted(
                    "a frame with a pause of one character inside is not answered",
                    expected=f"a reply: up to 1.5 characters behind byte {at} belong to the frame",
                    got=came(sent),
                    exchange=sent,
                )

    statement = "A frame with more than 3.5 characters of silence inside is not answered."
    yield _declare(dialect, "silence/long", statement, "an answer", long, Certainty.LIKELY)
    statement = "A frame with a pause of one character inside is answered."
    yield _declare(dialect, "silence/short", statement, "silence", short, Certainty.LIKELY, emulated=True)
