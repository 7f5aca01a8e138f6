"""Timing: how soon a drive answers, how it takes requests that follow closely, how long a restart takes, and its ramps.

Rules kept here:
- The MKS manuals print no time for a reply: a second is what a host can wait. What was measured stands in the verdict
  (p50, p99, longest; ms), with the uncertainty of the line beside it.
- LK's 0.25 ms may be a fixed, a typical or the longest time: what is seen is reported and never refutes.
- Modbus has rules of silence in its standard, which the manual does not repeat: they are observed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import ceil

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance import journey, moving
from conformance.claim import Aspect, Claim, Inconclusive, Observed, Theme
from conformance.claims import motion_lk_limits, timing_ramps
from conformance.claims.answers import plain_read
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import motion_claim, refute
from conformance.exchange import Answer, Exchange
from conformance.moving import MS, SECOND_NS
from conformance.probe import Probe, Until

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
    """Make the claims of this theme for a dialect."""
    yield from _about_replies(dialect)
    if Verb.RESTART in dialect.by_verb:
        yield from _about_restart(dialect)
    if _pair_of_settings(dialect) is not None:
        yield _about_settings(dialect)
    if dialect.link.__class__.__name__ == "ModbusLink":
        yield from _about_silence(dialect)
    if journey.is_mks(dialect):
        yield from timing_ramps.claims(dialect)
    if Verb.MOVE_SINGLE_TURN in dialect.by_verb:
        yield from (claim for claim in motion_lk_limits.claims(dialect) if claim.theme is Theme.TIMING)


# --- replies ----------------------------------------------------------------------------------------------------------


def _about_replies(dialect: Dialect) -> Iterator[Claim]:
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
    if journey.is_mks(dialect):
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
        for verb in (*journey.STOP_OF, *journey.STOP_OF.values()):
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
            errata=("lk-rs485-05",),
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
    moving.ready_to_move(probe)
    moving.run_at(probe, 120, 250)
    probe.wait(300 * MS)
    timed = [_timed(probe, command) for _ in range(_TIMES)]
    moving.stand_still(probe)
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
    journey.prepare(probe, command)
    if command.verb is Verb.RUN_SPEED:
        values = moving.run_values(command, 60, 56)
    elif command.verb in journey.MOVES:
        values = journey.values_of(command, journey.units_per_turn(command) // 2, 30, 56, journey.place(probe, command))
    else:
        values = {"acceleration": 56}
    exchange = probe.ask(command, values, timeout_ns=_LATEST_NS, quiet_ns=0)
    moving.stop(probe, 250)
    moving.wait_standing(probe)
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


# --- the restart ------------------------------------------------------------------------------------------------------


def _about_restart(dialect: Dialect) -> Iterator[Claim]:
    restart = dialect.by_verb[Verb.RESTART]
    yield declare(
        dialect, Theme.TIMING, "restart/answers-again", "A restarted drive answers again within ten seconds.",
        "silence for ten seconds", _answers_again, command=restart, aspect=Aspect.STATE, risks=restart.all_risks,
        at_best=Certainty.LIKELY,
    )  # fmt: skip
    yield declare(
        dialect, Theme.TIMING, "restart/time", "A restarted drive answers again within a second and a half.",
        "a drive that takes longer", _restarts_soon, command=restart, risks=restart.all_risks,
        at_best=Certainty.OPEN, quirks=known(dialect, "slow-restart"),
    )  # fmt: skip


def _time_to_answer(probe: Probe) -> int | None:
    """Restart and ask until the drive answers; return how long that took, None where it does not within ten seconds."""
    exchange = probe.ask(Verb.RESTART)
    if exchange.silent:
        raise Inconclusive("the restart is not answered")
    read = plain_read(probe.dialect)
    until_ns = exchange.sent_ns + 10 * SECOND_NS
    while probe.gate.now_ns() < until_ns:
        again = probe.ask(read, timeout_ns=50 * MS, quiet_ns=0)
        if not again.silent:
            return again.sent_ns - exchange.sent_ns
    return None


def _answers_again(probe: Probe) -> None:
    took_ns = _time_to_answer(probe)
    if took_ns is None:
        text = "a restarted drive does not answer again"
        raise refute(probe.traffic[0], text, expected="a reply within 10 s", got="silence")
    probe.measured["restart_ms"] = took_ns / 1e6


def _restarts_soon(probe: Probe) -> None:
    took_ns = _time_to_answer(probe)
    if took_ns is None:
        raise Inconclusive("a restarted drive does not answer again")
    probe.measured["restart_ms"] = took_ns / 1e6
    if took_ns <= 1500 * MS:
        return
    if took_ns <= 3 * SECOND_NS and "slow-restart" in probe.claim.quirks:
        probe.meets("slow-restart")
        return
    text = "a restart takes long"
    raise refute(probe.traffic[0], text, expected="at most 1.5 s", got=f"{took_ns / 1e9:.2f} s")


# --- settings in a row ------------------------------------------------------------------------------------------------


def _pair_of_settings(dialect: Dialect) -> Command | None:
    """Return a setting without risk but that of a setting, for writing twice; None where a dialect has none."""
    return dialect.by_verb.get(Verb.SET_HOME)


def _about_settings(dialect: Dialect) -> Claim:
    command = dialect.by_verb[Verb.SET_SUBDIVISION]
    return declare(
        dialect, Theme.TIMING, "settings/in-a-row", "A setting that follows another at once is done as well.",
        "no reply to the second one", _in_a_row, command=command, risks=command.all_risks, settings=("subdivision",),
        quirks=known(dialect, "hasty-writes-dropped"),
    )  # fmt: skip


def _in_a_row(probe: Probe) -> None:
    command = probe.command(Verb.SET_SUBDIVISION)
    for _ in range(3):
        probe.do(command, {"subdivision": journey.SUBDIVISION})
    probe.wait(probe.rig.write_gap_ns)
    exchanges = []
    for subdivision in (32, 16, 32, 16):
        built = probe.build(command, {"subdivision": subdivision})
        # `ask` would keep the distance that real drives need.
        exchanges.append(probe.send(probe.item(built.frame), until=Until.REPLY, timeout_ns=probe.rig.late_ns))
    if exchanges[0].silent:
        raise Inconclusive("a setting is not answered")
    dropped = [e for e in exchanges if e.silent]
    if dropped and "hasty-writes-dropped" in probe.claim.quirks:
        probe.wait(probe.rig.write_gap_ns + 100 * MS)
        probe.do(command, {"subdivision": 16})
        probe.meets("hasty-writes-dropped")
    elif dropped:
        text = "a setting that follows another at once is not answered"
        raise refute(dropped[0], text, expected="a reply to each", got=f"{4 - len(dropped)} replies to 4")


# --- Modbus: rules of silence -----------------------------------------------------------------------------------------


def _about_silence(dialect: Dialect) -> Iterator[Claim]:
    read = plain_read(dialect)
    for what, statement, refuted_by, check in (
        ("none-between", "A request that follows the reply before it at once is answered.", "silence", _none_between),
        ("pause-inside", "A request with a silence of 40 ms inside is none: it is not answered.", "a reply", _pause_inside),
    ):
        yield declare(
            dialect, Theme.TIMING, f"silence/{what}", statement, refuted_by, check, section=read.section,
            at_best=Certainty.OPEN,
        )  # fmt: skip


def _none_between(probe: Probe) -> None:
    command = plain_read(probe.dialect)
    exchanges = [probe.ask(command, quiet_ns=0) for _ in range(5)]
    if exchanges[0].silent:
        raise Inconclusive(f"{command.name} is not answered")
    if any(e.silent for e in exchanges):
        text = "a request right behind a reply is not answered"
        raise refute(next(e for e in exchanges if e.silent), text, expected="a reply", got="silence")


def _pause_inside(probe: Probe) -> None:
    built = probe.build(plain_read(probe.dialect))
    half = len(built.frame) // 2
    probe.send(built.frame[:half], until=Until.TIMEOUT, timeout_ns=40 * MS)
    exchange = probe.send(built.frame[half:])
    if not exchange.silent:
        text = "a request with a silence inside is answered"
        raise refute(exchange, text, expected="silence", got=f"{len(exchange.answers)} replies")
