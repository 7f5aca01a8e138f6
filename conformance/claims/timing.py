"""Replies in time: at rest and in motion, in one piece, each time, behind a setting; LK's delay; the restart.

Rules kept here:
- The MKS manuals print no time for a reply: a second is what a host can wait. What was measured stands in the verdict
  (p50, p99, longest; ms), with the uncertainty of the line beside it.
- LK's 0.25 ms may be a fixed, a typical or the longest time: what is seen is reported and never refutes.
- No manual says how long a restart takes: that it ends is judged, how long it takes is observed.
- Modbus has rules of silence in its standard, which the manual does not repeat: they are observed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import ceil, inf
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk, Verb
from analyzer.link import ModbusLink
from conformance.claim import Aspect, Inconclusive, Observed, Theme
from conformance.claims.declare import Case, Cases, claim, commands, once
from conformance.claims.known_quirks import HASTY, LATE, may_meet
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.claims.settings import setting_effects
from conformance.motion import declared, motion
from conformance.motion.declared import QUICK, RUNS_AND_MOVES, SUBDIVISION
from conformance.talk.acceptance import plain_read
from conformance.talk.exchange import Answer, Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe, Until

#: A reply later than this is late, and so long is waited for one that is.
_LATE_NS, _LATEST_NS = SECOND_NS, 6 * SECOND_NS
#: While the motor turns a reply takes no longer than this, but for drives that were seen to need up to 700 ms.
_BUSY_NS, _SEEN_NS = 100 * MS, 750 * MS
#: How often a read is timed; reads in a row: more than two hundred, for what comes at every so many-th.
_TIMES, _IN_A_ROW = 20, 220
#: A second reply to a setting has come by then.
_AGAIN_NS = 30 * MS
#: LK's printed delay, and how far a reply may be from it in addition to the line's uncertainty.
_LK_DELAY_NS, _LK_SLACK_NS = 250_000, 20_000
#: What a host's clock and adapter leave uncertain on a real line.
_HOST_NS = 2 * MS
_SLOW_START = "slow-restart"


def _of_reads(
    refuted_by: str, *, each: Cases = once, name: str, **facts: Any
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a check of a plain read, whose section it has."""
    return claim(
        Theme.TIMING, each=each, name=name, refuted_by=refuted_by, section=lambda c: plain_read(c.dialect).section, **facts
    )


# --- measuring replies ------------------------------------------------------------------------------------------------


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


def _expect_soon(probe: Probe, command: Command, exchange: Exchange, answer: Answer) -> None:
    at_most, text = _LATE_NS / 1e6, f"{command.name} is answered late"
    probe.expect(answer.latency_ns / 1e6, at_most=at_most, unit="ms", refutes=text, exchange=exchange)


def _expect_answers(probe: Probe, exchanges: Sequence[Exchange], refutes: str) -> None:
    """Expect an answer to each of several requests."""
    silent = [e for e in exchanges if e.silent]
    probe.expect(
        f"{len(exchanges) - len(silent)} replies",
        holds=not silent,
        expected=f"{len(exchanges)} replies to {len(exchanges)} requests",
        refutes=refutes,
        exchange=next(iter(silent), None),
    )


# --- at rest ----------------------------------------------------------------------------------------------------------


@_of_reads("a reply that comes later", name="replies/at-rest", at_best=Certainty.LIKELY)
def _at_rest(probe: Probe) -> None:
    """A read is answered within a second."""
    latencies = []
    for command in _reads(probe.dialect):
        for _ in range(2):
            exchange, answer = _timed(probe, command)
            latencies.append(answer.latency_ns)
            _expect_soon(probe, command, exchange, answer)
    _summary(probe, "reply", latencies)


@_of_reads(
    "a read without a reply",
    name="replies/every-time",
    statement=f"Of {_IN_A_ROW} reads in a row each is answered.",
    of_line=True,
)
def _every_time(probe: Probe) -> None:
    command = plain_read(probe.dialect)
    exchanges = [probe.ask(command, timeout_ns=probe.rig.late_ns, quiet_ns=0) for _ in range(_IN_A_ROW)]
    if all(e.silent for e in exchanges):
        raise Inconclusive(f"{command.name} is never answered")
    _expect_answers(probe, exchanges, f"{command.name} is not answered each time")


def _lk_motors(dialect: Dialect) -> Iterable[Case]:
    return once(dialect) if dialect.family == "lk" else ()


@_of_reads("another time", each=_lk_motors, name="replies/delay", rests_on=(Doubt.DELAY,), quirks=may_meet("lk-reply-within"))
def _delay(probe: Probe) -> None:
    """A reply begins 0.25 ms after the request."""
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


#: How much later a reply may come while the shaft turns than the latest one at rest, beside as much again.
_LATER_NS = 8 * MS


def _asked_turning(dialect: Dialect) -> list[tuple[Command, dict[str, int]]]:
    """Return what is asked of a shaft that turns and leaves it turning."""
    found: list[tuple[Command, dict[str, int]]] = [(command, {}) for command in _reads(dialect)]
    found += [(dialect.by_verb[verb], {}) for verb in (Verb.MOTOR_ON, Verb.CLEAR_ERRORS) if verb in dialect.by_verb]
    if Verb.READ_PARAMETER in dialect.by_verb:
        found.append((dialect.by_verb[Verb.READ_PARAMETER], {"parameter": 30}))
    return found


#: How often what is answered late is asked at most: a line delays a reply now and then.
_DELAYS = 5


def _latencies(probe: Probe, soon_ns: float = inf) -> list[tuple[int, Exchange]]:
    """Return how long the reply to each took, the shortest of two times, and of more where that is not soon."""
    found = []
    for command, values in _asked_turning(probe.dialect):
        taken: list[tuple[int, Exchange]] = []
        for time in range(_DELAYS):
            if time < 2 or not taken or taken[0][0] > soon_ns:
                exchange = probe.ask(command, values, quiet_ns=0)
                taken += [(exchange.reply.latency_ns, exchange)] if exchange.reply is not None else []
                taken.sort(key=lambda each: each[0])
        found += taken[:1]
    return found


@of_motion(
    each=lambda dialect: commands(Verb.RUN_SPEED)(dialect) if dialect.family == "lk" else (),
    name="replies/turning",
    refuted_by="replies that come later",
    theme=Theme.TIMING,
    rests_on=(Doubt.DELAY,),
    risks=risks_by(Verb.MOTOR_ON, Verb.CLEAR_ERRORS),
)
def _turning(probe: Probe, command: Command) -> None:
    """While the shaft turns, either way, and while it moves, each reply comes as soon as at rest."""
    motion.ready_to_move(probe)
    soon_ns = 2 * max(latency for latency, _ in _latencies(probe)) + _LATER_NS
    move = declared.any_move(probe.dialect, at_speed=True)
    for how, rpm in ((command, 60), (command, -60), (move, 60)):
        motion.begin(probe, how, 4 * 360, rpm=rpm)
        probe.wait(150 * MS)
        later = [(ns, e) for ns, e in _latencies(probe, soon_ns) if ns > soon_ns]
        motion.stand_still(probe)
        for latency_ns, exchange in later:
            assert exchange.command is not None
            text = f"{exchange.command.name} is answered later while the shaft turns"
            probe.expect(latency_ns / 1e6, at_most=soon_ns / 1e6, unit="ms", refutes=text, exchange=exchange, key="later")


# --- in motion --------------------------------------------------------------------------------------------------------


def _with_ramps(each: Cases) -> Cases:
    return lambda dialect: each(dialect) if dialect.ramp is not None else ()


@of_motion(
    each=_with_ramps(commands(Verb.READ_SPEED)),
    refuted_by="a reply that comes later",
    theme=Theme.TIMING,
    at_best=Certainty.OPEN,
    quirks=may_meet(LATE),
    risks=risks_by(Verb.RUN_SPEED),
)
def _while_moving(probe: Probe, command: Command) -> None:
    """While the motor turns a read is answered as soon as at rest: within 100 ms."""
    motion.ready_to_move(probe)
    motion.run_at(probe, 120, QUICK)
    probe.wait(300 * MS)
    timed = [_timed(probe, command) for _ in range(_TIMES)]
    motion.stand_still(probe)
    latencies = [answer.latency_ns for _, answer in timed]
    _summary(probe, "reply", latencies)
    if _BUSY_NS < max(latencies) <= _SEEN_NS and LATE in probe.claim.quirks:
        probe.meets(LATE)
    else:
        text = f"{command.name} is answered late while the motor turns"
        at_most = _BUSY_NS / 1e6
        probe.expect(max(latencies) / 1e6, at_most=at_most, unit="ms", refutes=text, exchange=timed[0][0])


def _motions_and_stops(dialect: Dialect) -> Iterator[Case]:
    motions = dialect.motions(*RUNS_AND_MOVES)
    for command in (*motions, *(dialect.stops_of(m)[0] for m in motions)):
        yield Case(dialect, command)


@of_motion(
    each=_with_ramps(_motions_and_stops), refuted_by="a reply that comes later", theme=Theme.TIMING, at_best=Certainty.LIKELY
)
def _answered_soon(probe: Probe, command: Command) -> None:
    """{command} is answered within a second, however long what it asks for takes."""
    assert command.motion is not None
    motion.prepare(probe, command)
    rpm = 60 if command.motion.kind is MotionKind.RUN else 30
    exchange = motion.ask(probe, command, 180, rpm=rpm, acceleration=56, timeout_ns=_LATEST_NS, quiet_ns=0)
    motion.stop(probe, QUICK)
    motion.wait_standing(probe)
    answer = exchange.reply
    if answer is None:
        raise Inconclusive(f"{command.name} was not answered")
    _expect_soon(probe, command, exchange, answer)


# --- the restart ------------------------------------------------------------------------------------------------------


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
            took_ns = again.sent_ns - exchange.sent_ns
            probe.measured["restart_ms"] = took_ns / 1e6
            return took_ns
    return None


@claim(
    Theme.TIMING,
    each=commands(Verb.RESTART),
    refuted_by="silence for ten seconds",
    aspect=Aspect.STATE,
    risks=risks_by(Verb.RESTART),
    at_best=Certainty.LIKELY,
)
def _answers_again(probe: Probe) -> None:
    """A restarted drive answers again within ten seconds."""
    took_ns = _time_to_answer(probe)
    text = "a restarted drive does not answer again"
    shown = probe.traffic[0]
    probe.expect("silence", holds=took_ns is not None, expected="a reply within 10 s", refutes=text, exchange=shown)


@claim(
    Theme.TIMING,
    each=commands(Verb.RESTART),
    name="{command}/time",
    refuted_by="a drive that takes longer",
    risks=risks_by(Verb.RESTART),
    at_best=Certainty.OPEN,
    quirks=may_meet(_SLOW_START),
)
def _restarts_soon(probe: Probe) -> None:
    """A restarted drive answers again within a second and a half."""
    took_ns = _time_to_answer(probe)
    if took_ns is None:
        raise Inconclusive("a restarted drive does not answer again")
    if 1500 * MS < took_ns <= 3 * SECOND_NS and _SLOW_START in probe.claim.quirks:
        probe.meets(_SLOW_START)
    else:
        text, shown = "a restart takes long", probe.traffic[0]
        probe.expect(took_ns / 1e9, at_most=1.5, unit="s", refutes=text, exchange=shown)


# --- settings in a row ------------------------------------------------------------------------------------------------


@claim(
    Theme.TIMING,
    each=commands(Verb.SET_SUBDIVISION),
    name="settings/in-a-row",
    refuted_by="no reply to the second one, or one that is not stored",
    risks=lambda case: risks_by(Verb.SET_SUBDIVISION, Verb.MOVE_RELATIVE_PULSES)(case) | declared.risks(case.dialect),
    settings=lambda case: declared.settings(case.dialect),
    quirks=may_meet(HASTY),
)
def _in_a_row(probe: Probe, command: Command) -> None:
    """A setting that follows another at once is done as well."""
    effect = setting_effects.of(probe.dialect, command)
    if effect is not None:
        effect.ready(probe)
    for _ in range(3):
        probe.do(command, {"subdivision": SUBDIVISION})
    probe.wait(probe.rig.write_gap_ns)
    exchanges = []
    for subdivision in (32, 16, 32, 8):
        built = probe.build(command, {"subdivision": subdivision})
        late_ns = probe.rig.late_ns
        exchanges.append(probe.send(built.item(), until=Until.REPLY, timeout_ns=late_ns, quiet_ns=0, at_once=True))
    if exchanges[0].silent:
        raise Inconclusive("a setting is not answered")
    if any(e.silent for e in exchanges) and HASTY in probe.claim.quirks:
        probe.wait(probe.rig.write_gap_ns + 100 * MS)
        probe.do(command, {"subdivision": 16})
        probe.meets(HASTY)
    else:
        # One may be answered once more.
        probe.wait(_AGAIN_NS)
        _expect_answers(probe, exchanges, "a setting that follows another at once is not answered")
        if effect is not None and effect.expected is not None:
            seen, should = effect.see(probe), effect.expected(probe.dialect, {"subdivision": 8})
            effect.expect(probe, seen, should, "of settings at once the last is not stored", exchanges[-1])


# --- Modbus: rules of silence -----------------------------------------------------------------------------------------


def _on_modbus(dialect: Dialect) -> Iterable[Case]:
    return once(dialect) if isinstance(dialect.link, ModbusLink) else ()


@_of_reads("silence", each=_on_modbus, name="silence/none-between", at_best=Certainty.OPEN)
def _none_between(probe: Probe) -> None:
    """A request that follows the reply before it at once is answered."""
    command = plain_read(probe.dialect)
    exchanges = [probe.ask(command, quiet_ns=0) for _ in range(5)]
    if exchanges[0].silent:
        raise Inconclusive(f"{command.name} is not answered")
    _expect_answers(probe, exchanges, "a request right behind a reply is not answered")
