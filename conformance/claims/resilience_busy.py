"""Resilience of a busy drive: what arrives while it moves, homes or calibrates is heard and answered.

Rules kept here:
- The shaft turns slowly, and is stopped by a ramp in the end. Homing and calibrating are begun as they are: they risk what
  the catalogue says.
- What is asked meanwhile are reads, a setting without an effect on motion, and damaged reads; whether a move goes on under
  another command is for claims about motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance.claim import Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.hearing import PAUSE_NS, came, garblers, is_answered
from conformance.claims.known_quirks import known
from conformance.claims.known_reads import plain_reads
from conformance.motion import motion
from conformance.talk import samples
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_SECOND_NS = 1_000_000_000
_RPM = 60.0
#: How far the speed may differ from the asked one while something else is said to the drive, in rpm.
_NEAR = 6.0
_ROUNDS = 3
OFF_SUM = "lk-off-sum"
_OFF_SUM_MOST, _OFF_SUM_BY = 5, 4
#: Settings without an effect on a shaft that turns, with what they risk no more than a setting does.
_HARMLESS = (Verb.SET_SCREEN_OFF, Verb.SET_KEY_LOCK, Verb.SET_PULSE_DELAY, Verb.WRITE_USER_ID)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about busy drives."""
    if not motion.can_move(dialect):
        return
    yield _reads_while(dialect, "moving", "while the shaft turns", _run, _stop, motion.risks(dialect, Risk.UNBOUNDED), {})
    yield _settings_while_moving(dialect)
    yield _noise_while_moving(dialect)
    for verb, name, by_name in ((Verb.HOME, "homing", False), (Verb.CALIBRATE, "calibrating", True)):
        command = dialect.by_verb.get(verb)
        if command is not None:
            risks = command.all_risks | motion.risks(dialect)
            begin, end = partial(_begin, command=command), partial(_end, command=command)
            yield _reads_while(dialect, name, f"while the drive is {name}", begin, end, risks, {"by_name": by_name})
    limited = dialect.by_name.get("move_multi_turn_limited")
    if limited is not None:
        yield _sums_of_moves(dialect, limited)


# --- what is under way ------------------------------------------------------------------------------------------------


def _run(probe: Probe) -> None:
    motion.ready_to_move(probe)
    motion.run_at(probe, _RPM)
    probe.wait(_SECOND_NS)


def _running(probe: Probe) -> float:
    """Begin a run and return its speed. Raises Inconclusive where it is not the one that was asked for."""
    _run(probe)
    speed = motion.speed(probe).value
    if abs(abs(speed) - _RPM) > _NEAR:
        _stop(probe)
        raise Inconclusive(f"the shaft does not turn at {_RPM:.0f} rpm, but at {speed:.0f}")
    return speed


def _stop(probe: Probe) -> None:
    motion.stop(probe)
    probe.wait(_SECOND_NS)
    motion.wait_standing(probe)


def _begin(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    probe.do(command, samples.sample(probe.dialect, command))


def _end(probe: Probe, command: Command) -> None:
    if command.verb is Verb.HOME:
        probe.ask(Verb.EMERGENCY_STOP)
    else:
        probe.wait(probe.rig.done_ns)


# --- reads ------------------------------------------------------------------------------------------------------------


def _reads_while(
    dialect: Dialect,
    name: str,
    when: str,
    begin: Callable[[Probe], None],
    end: Callable[[Probe], None],
    risks: frozenset[Risk],
    demands: Mapping[str, Any],
) -> Claim:
    reads = plain_reads(dialect)

    def check(probe: Probe) -> None:
        known = [c for c in reads if is_answered(probe.ask(c, quiet_ns=0))]
        if not known:
            raise Inconclusive("no read is answered while the shaft stands")
        begin(probe)
        try:
            for _ in range(_ROUNDS):
                for command in known:
                    _answered_now(probe, command, when)
        finally:
            end(probe)

    return declare(
        dialect,
        Theme.RESILIENCE,
        f"{name}/reads",
        f"Every read is answered by its own reply {when}.",
        "silence, or another reply",
        check,
        section=dialect.by_verb[Verb.RUN_SPEED].section,
        at_best=Certainty.LIKELY,
        risks=risks,
        settings=motion.settings(dialect),
        commands=tuple(c.name for c in reads),
        **demands,
    )


def _answered_now(probe: Probe, command: Command, when: str) -> None:
    exchange = probe.ask(command, quiet_ns=0)
    if is_answered(exchange):
        return
    again = probe.ask(command, quiet_ns=0)
    if not is_answered(again):
        raise Refuted(
            f"{command.name} is not answered {when}",
            expected=f"a reply to {command.name}",
            got=came(again),
            exchange=again,
            key=f"reads are not answered {when}",
        )


# --- what else --------------------------------------------------------------------------------------------------------


def _settings_while_moving(dialect: Dialect) -> Claim:
    found = [dialect.by_verb[v] for v in _HARMLESS if v in dialect.by_verb]
    speed_limit = dialect.by_verb.get(Verb.WRITE_PARAMETER)
    commands = found or ([speed_limit] if speed_limit is not None else [])
    risks = {r for c in commands for r in c.risks(samples.sample(dialect, c))}
    fields = tuple(dict.fromkeys(n for c in commands for n in samples.sample(dialect, c)))
    quirks = known(dialect, "lk-firmware-235") if speed_limit in commands else ()

    def check(probe: Probe) -> None:
        before = _running(probe)
        try:
            for command in commands:
                exchange = probe.ask(command, samples.sample(dialect, command))
                if exchange.silent and quirks:
                    probe.meets(quirks[0])
                    continue
                _still_runs(probe, before, f"{command.name} is not answered, or stops the shaft", exchange)
        finally:
            _stop(probe)

    return declare(
        dialect,
        Theme.RESILIENCE,
        "moving/settings",
        "A setting that has nothing to do with motion is answered while the shaft turns, and the shaft turns on.",
        "silence, or another speed",
        check,
        section=dialect.by_verb[Verb.RUN_SPEED].section,
        at_best=Certainty.LIKELY,
        risks={*risks, *motion.risks(dialect, Risk.UNBOUNDED)},
        settings=motion.settings(dialect, *fields),
        commands=tuple(c.name for c in commands),
        quirks=quirks,
    )


def _still_runs(probe: Probe, before: float, what: str, exchange: Exchange) -> None:
    now = motion.speed(probe).value
    if exchange.silent or abs(now - before) > _NEAR:
        raise Refuted(
            what, expected=f"an answer, and {before:.0f} rpm", got=f"{came(exchange)}, and {now:.0f} rpm", exchange=exchange
        )


def _noise_while_moving(dialect: Dialect) -> Claim:
    def check(probe: Probe) -> None:
        before = _running(probe)
        try:
            made = garblers(probe)[0]
            for what, item in [*made.wrong_checks(), *made.truncated()]:
                sent = probe.send(item, timeout_ns=PAUSE_NS)
                now = motion.speed(probe).value
                if abs(now - before) > _NEAR:
                    raise Refuted(
                        f"a damaged read ({what}) changes the speed",
                        expected=f"{before:.0f} rpm",
                        got=f"{now:.0f} rpm",
                        exchange=sent,
                        key="a damaged read changes the speed",
                    )
        finally:
            _stop(probe)

    return declare(
        dialect,
        Theme.RESILIENCE,
        "moving/noise",
        "Damaged requests do not disturb a shaft that turns.",
        "another speed",
        check,
        section=dialect.by_verb[Verb.RUN_SPEED].section,
        risks=motion.risks(dialect, Risk.UNBOUNDED),
        settings=motion.settings(dialect),
    )


def _sums_of_moves(dialect: Dialect, command: Command) -> Claim:
    """Return the claim that the replies to many moves all check: real drives were seen to miss it now and then."""
    count = 100

    def check(probe: Probe) -> None:
        motion.ready_to_move(probe)
        here = probe.read(Verb.READ_POSITION, "position")
        exchanges = [probe.ask(command, {"position": here, "max_speed": 6_000}, quiet_ns=0) for _ in range(count)]
        bad = [e for e in exchanges if not e.silent and not is_answered(e)]
        if not bad:
            return
        if len(bad) <= _OFF_SUM_MOST and all(_is_off(dialect, e) for e in bad):
            probe.meets(OFF_SUM)
            return
        if len(bad) == count:
            raise Inconclusive(f"no reply to {command.name} can be read, which another claim judges")
        raise Refuted(
            f"{len(bad)} of the replies to {count} moves are garbled",
            expected="replies whose checks fit",
            got=came(bad[0]),
            exchange=bad[0],
            key="replies to moves are garbled",
        )

    return declare(
        dialect,
        Theme.RESILIENCE,
        "moves/good",
        f"The replies to {count} moves to where the shaft is all check.",
        "a reply that is garbled",
        check,
        command=command,
        risks=motion.risks(dialect),
        quirks=known(dialect, OFF_SUM),
    )


def _is_off(dialect: Dialect, exchange: Exchange) -> bool:
    """Say whether a reply has a last check that is off by as little as was seen on real drives."""
    if len(exchange.answers) != 1:
        return False
    check = dialect.link.checks(exchange.answers[0].data)[-1]
    off = (check.got[0] - check.expected[0] + 128) % 256 - 128
    return 0 < abs(off) <= _OFF_SUM_BY
