"""Replies in time: at rest and in motion, in one piece, each time; and LK's quarter of a millisecond.

Rules kept here:
- The MKS manuals print no time for a reply: a second is what a host can wait. What was measured stands in the verdict
  (p50, p99, longest; ms), with the uncertainty of the line beside it.
- LK's 0.25 ms may be a fixed, a typical or the longest time: what is seen is reported and never refutes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import ceil

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from conformance.claim import Claim, Inconclusive, Observed, Theme
from conformance.claims.answers import plain_read
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import motion_claim, refute
from conformance.motion import motion, moves
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.exchange import Answer, Exchange
from conformance.talk.probe import Probe

#: A reply later than this is late, and so long is waited for one that is.
_LATE_NS, _LATEST_NS = SECOND_NS, 6 * SECOND_NS
#: While the motor turns a reply takes no longer than this, but for drives that were seen to need up to 700 ms.
_BUSY_NS, _SEEN_NS = 100 * MS, 750 * MS
_TIMES = 20
#: A silence within a reply that no adapter makes.
_GAP_NS = 30 * MS
#: LK's printed delay, and how far a reply may be from it beside the line's own uncertainty.
_LK_DELAY_NS, _LK_SLACK_NS = 250_000, 20_000
#: What a host's clock and adapter leave uncertain on a real line.
_HOST_NS = 2 * MS


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about replies."""
    read = plain_read(dialect)

    def made(what: str, statement: str, refuted_by: str, check: object, **more: object) -> Claim:
        return declare(
            dialect, Theme.TIMING, f"replies/{what}", statement, refuted_by, check,  # type: ignore[arg-type]
            section=read.section, **more,  # type: ignore[arg-type]  # the rest of what a claim declares
        )  # fmt: skip

    yield made("at-rest", "A read is answered within a second.", "a reply that comes later", _at_rest, at_best=Certainty.LIKELY)
    yield made("every-time", f"Of {_TIMES} reads in a row each is answered.", "a read without a reply", _every_time)
    if dialect.bus == "serial":
        yield made(
            "in-one-piece",
            "A reply comes without a silence between its bytes.",
            "a silence of 30 ms within a reply",
            _in_one_piece,
            at_best=Certainty.LIKELY,
        )
    if moves.is_mks(dialect):
        yield motion_claim(
            dialect,
            dialect.by_verb[Verb.READ_SPEED],
            "while-moving",
            "While the motor turns a read is answered as soon as at rest: within 100 ms.",
            "a reply that comes later",
            _while_moving,
            theme=Theme.TIMING,
            at_best=Certainty.OPEN,
            quirks=known(dialect, "slow-replies-in-motion"),
            risks=dialect.by_verb[Verb.RUN_SPEED].all_risks,
        )
        for verb in (*moves.STOP_OF, *moves.STOP_OF.values()):
            command = dialect.by_verb[verb]
            yield motion_claim(
                dialect,
                command,
                "answered-soon",
                f"{command.name} is answered within a second, however long what it asks for takes.",
                "a reply that comes later",
                _motion_answered,
                theme=Theme.TIMING,
                at_best=Certainty.LIKELY,
            )
    if Verb.MOVE_SINGLE_TURN in dialect.by_verb:
        yield made(
            "delay",
            "A reply begins 0.25 ms after the request.",
            "another time",
            _lk_delay,
            rests_on=(Doubt.DELAY,),
            quirks=known(dialect, "lk-reply-within"),
        )


def _reads(dialect: Dialect) -> list[Command]:
    return [c for c in dialect.commands if c.all_risks == {Risk.READ} and not c.request_forms[0].layout.fields]


def _summary(probe: Probe, name: str, latencies_ns: Sequence[float]) -> None:
    """Keep the median, the 99th per cent and the longest of latencies (ms) in the verdict."""
    ordered = sorted(latencies_ns)
    probe.measured |= {
        f"{name}_p50_ms": ordered[len(ordered) // 2] / 1e6,
        f"{name}_p99_ms": ordered[min(len(ordered) - 1, ceil(len(ordered) * 0.99))] / 1e6,
        f"{name}_longest_ms": ordered[-1] / 1e6,
        "uncertain_ms": _uncertain_ns(probe) / 1e6,
    }


def _uncertain_ns(probe: Probe) -> int:
    """Return how uncertain a latency is: an emulated line has exact times, a host's clock and adapter have not."""
    return 0 if probe.rig.emulated else _HOST_NS


def _timed(probe: Probe, command: Command) -> tuple[Exchange, Answer]:
    """Ask and wait long enough for a reply that is late. Raises Inconclusive where none comes at all."""
    exchange = probe.ask(command, timeout_ns=_LATEST_NS, quiet_ns=0)
    answer = exchange.reply
    if answer is None:
        raise Inconclusive(f"{command.name} was not answered within {_LATEST_NS / 1e9:.0f} s")
    return exchange, answer


def _at_rest(probe: Probe) -> None:
    latencies = []
    for command in _reads(probe.dialect):
        for _ in range(2):
            exchange, answer = _timed(probe, command)
            latencies.append(answer.latency_ns)
            if answer.latency_ns > _LATE_NS:
                got = f"{answer.latency_ns / 1e6:.0f} ms"
                raise refute(exchange, f"{command.name} is answered late", expected="within 1000 ms", got=got)
    _summary(probe, "reply", latencies)


def _every_time(probe: Probe) -> None:
    command = plain_read(probe.dialect)
    exchanges = [probe.ask(command, timeout_ns=_LATEST_NS, quiet_ns=0) for _ in range(_TIMES)]
    silent = [e for e in exchanges if e.silent]
    if len(silent) == _TIMES:
        raise Inconclusive(f"{command.name} is never answered")
    if silent:
        text = f"{command.name} is not answered each time"
        got = f"{_TIMES - len(silent)} replies"
        raise refute(silent[0], text, expected=f"{_TIMES} replies to {_TIMES} requests", got=got)


def _in_one_piece(probe: Probe) -> None:
    longest = 0
    for command in _reads(probe.dialect):
        exchange = probe.ask(command)
        gap_ns = _gap(probe, exchange)
        longest = max(longest, gap_ns)
        if gap_ns > _GAP_NS:
            got = f"a silence of {gap_ns / 1e6:.0f} ms"
            raise refute(exchange, f"the reply to {command.name} comes in pieces", expected="no silence", got=got)
    probe.measured["longest_silence_ms"] = longest / 1e6


def _gap(probe: Probe, exchange: Exchange) -> int:
    """Return the silence within a reply (ns). Raises Inconclusive where no reply can be read, whole or put together."""
    if exchange.answers:
        return max(a.last_ns - a.first_ns - (len(a.data) - 1) * probe.rig.byte_ns for a in exchange.answers)
    pieces = sorted(exchange.junk, key=lambda j: j.first_ns)
    if not _is_frame(probe.dialect, b"".join(j.data for j in pieces)):
        raise Inconclusive("the reply cannot be read")
    return max((later.first_ns - piece.last_ns for piece, later in pairwise(pieces)), default=0)


def _is_frame(dialect: Dialect, data: bytes) -> bool:
    """Say whether bytes end in the check that fits them."""
    checks = dialect.link.checks(data, None)
    return bool(checks) and dialect.link.completed(data[: checks[-1].start], None) == data


def _while_moving(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    motion.run_at(probe, 120, QUICK)
    probe.wait(300 * MS)
    timed = [_timed(probe, command) for _ in range(_TIMES)]
    motion.stand_still(probe)
    latencies = [answer.latency_ns for _, answer in timed]
    _summary(probe, "reply", latencies)
    if max(latencies) <= _BUSY_NS:
        return
    if max(latencies) <= _SEEN_NS and "slow-replies-in-motion" in probe.claim.quirks:
        probe.meets("slow-replies-in-motion")
        return
    text = f"{command.name} is answered late while the motor turns"
    raise refute(timed[0][0], text, expected="within 100 ms", got=f"up to {max(latencies) / 1e6:.0f} ms")


def _motion_answered(probe: Probe, command: Command) -> None:
    moves.prepare(probe, command)
    if command.verb is Verb.RUN_SPEED:
        values = motion.run_values(command, 60, 56)
    elif command.verb in moves.MOVES:
        values = moves.values_of(command, moves.units_per_turn(command) // 2, 30, 56, moves.place(probe, command))
    else:
        values = {"acceleration": 56}
    exchange = probe.ask(command, values, timeout_ns=_LATEST_NS, quiet_ns=0)
    motion.stop(probe, QUICK)
    motion.wait_standing(probe)
    answer = exchange.reply
    if answer is None:
        raise Inconclusive(f"{command.name} was not answered")
    if answer.latency_ns > _LATE_NS:
        got = f"{answer.latency_ns / 1e6:.0f} ms"
        raise refute(exchange, f"{command.name} is answered late", expected="within 1000 ms", got=got)


def _lk_delay(probe: Probe) -> None:
    latencies = []
    for command in _reads(probe.dialect):
        for _ in range(3):
            _, answer = _timed(probe, command)
            # The first byte is known by its end.
            latencies.append(answer.latency_ns - probe.rig.byte_ns)
    _summary(probe, "delay", latencies)
    slack_ns = _LK_SLACK_NS + _uncertain_ns(probe)
    if all(abs(latency - _LK_DELAY_NS) <= slack_ns for latency in latencies):
        return
    if all(latency <= _LK_DELAY_NS + slack_ns for latency in latencies):
        probe.meets("lk-reply-within")
        return
    raise Observed(f"replies begin {min(latencies) / 1e6:.2f} to {max(latencies) / 1e6:.2f} ms after the request")
