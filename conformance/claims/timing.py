"""Timing: replies, ramps and moves stand in files of their own; here, requests that follow closely, and the restart.

Rules kept here:
- No manual says how long a restart takes: that it ends is judged, how long it takes is observed.
- Modbus has rules of silence in its standard, which the manual does not repeat: they are observed.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Aspect, Claim, Inconclusive, Theme
from conformance.claims import motion_lk_limits, timing_moves, timing_ramps, timing_replies
from conformance.claims.answers import plain_read
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import refute
from conformance.motion import moves
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.probe import Probe, Until


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    yield from timing_replies.claims(dialect)
    if Verb.RESTART in dialect.by_verb:
        yield from _about_restart(dialect)
    if _pair_of_settings(dialect) is not None:
        yield _about_settings(dialect)
    if dialect.link.__class__.__name__ == "ModbusLink":
        yield from _about_silence(dialect)
    if moves.is_mks(dialect):
        yield from timing_ramps.claims(dialect)
        yield from timing_moves.claims(dialect)
    if Verb.MOVE_SINGLE_TURN in dialect.by_verb:
        yield from (claim for claim in motion_lk_limits.claims(dialect) if claim.theme is Theme.TIMING)


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
        probe.do(command, {"subdivision": moves.SUBDIVISION})
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
