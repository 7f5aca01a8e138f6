"""Motion that a drive must not carry out: while the motor is off, or in a mode in which pulses move it.

Rules kept here:
- An MKS drive refuses (status 0; Modbus: a refused write) while the motor is disabled, protected, or in a pulse mode.
- An LK motor that is off answers as always.
- What is not carried out turns nothing, now or later.
- One way is asked for slowly and the other one fast, where the user's bounds allow it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims.control_reads import judge_next
from conformance.claims.declare import Case, motions
from conformance.claims.motion.motion_claim import command_of, expect_not_turned, expect_stays, of_motion, risks_by
from conformance.gate.gate import Refused
from conformance.motion import arriving, declared, motion
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM, MOVES, QUICK, SUBDIVISION
from conformance.talk.acceptance import need_reliable_replies
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe
from conformance.talk.samples import sample

#: Kinds of motion that the manual lets no pulse mode do; of the others it is less sure.
_SURE = (MotionKind.RUN, *MOVES)
#: How long is looked whether the shaft turns: at 60 rpm it would go by 17 degrees.
_LOOKED_AT_NS = 60 * MS
#: The speed of what is asked for downwards (rpm); how long a quarter turn at the slower speed takes at most.
_FAST, _MOVES_NS = 900, 500 * MS


def _can_refuse(command: Command) -> bool:
    return bool(command.replies.failed or command.replies.failed_forms)


def _turning(command: Command, way: int, rpm: int = CALM) -> dict[str, Any]:
    """Return the way of a quarter turn, up or down, as motions are asked for."""
    signed = declared.of(command).kind in (MotionKind.RUN, MotionKind.TORQUE)
    return {"degrees": 90.0 * way, "rpm": float(rpm * way if signed else rpm)}


def _request(dialect: Dialect, command: Command, start: int = 0, way: int = 1, rpm: int = CALM) -> dict[str, int]:
    """Return values of a request that would move the shaft a way, or do what the command does."""
    if command.motion is not None and command.motion.kind in _SURE:
        return declared.values_of(dialect, command, **_turning(command, way, rpm), acceleration=QUICK, start=start)
    return sample(dialect, command)


def _ask(probe: Probe, command: Command, start: int, way: int) -> tuple[Exchange, dict[str, int]]:
    """Ask for a motion; return it with its values."""
    calm = _request(probe.dialect, command, start, way)
    fast = _request(probe.dialect, command, start, way, _FAST)
    if way < 0:
        with contextlib.suppress(Refused):
            return probe.ask(command, fast), fast
    return probe.ask(command, calm), calm


def expect_refused(
    probe: Probe, command: Command, why: str, again: Callable[[], object] | None = None, ways: Iterable[int] = (1,)
) -> None:
    """Ask for a motion and refute unless it is refused and turns nothing, also after `again` (enabling, for instance)."""
    before = motion.position(probe)
    for way in ways:
        start = motion.place(probe, command) if command.motion is not None else 0
        exchange, values = _ask(probe, command, start, way)
        if exchange.silent and command.replies.failed:
            # A reply can be lost; a drive that never refuses is another matter.
            need_reliable_replies(probe)
            again_asked = probe.ask(command, values)
            text = f"{command.name} {why} is not answered at all"
            probe.expect("silence", holds=not again_asked.silent, expected="a refusal", refutes=text, exchange=exchange)
        answer = probe.reply(exchange)
        probe.wait(_LOOKED_AT_NS)
        expect_not_turned(probe, before, exchange, f"{command.name} {why} turns the shaft")
        probe.expect(
            answer.data.hex(" ").upper(),
            holds=probe.refused(exchange),
            expected="a refusal",
            refutes=f"{command.name} {why} is not refused",
            exchange=exchange,
        )
    if again is not None:
        again()
        probe.wait(_LOOKED_AT_NS)
        expect_not_turned(probe, before, exchange, f"{command.name} {why} turns the shaft")


@of_motion(each=motions(*_SURE, where=_can_refuse), refuted_by="a motion, or an answer that says success")
def _disabled(probe: Probe, command: Command) -> None:
    """{command} is refused either way while the motor is disabled, behind a release of the protection too.

    Nothing turns when the motor is enabled again.
    """
    motion.ready_to_move(probe)
    motion.switch(probe, False)
    expect_refused(probe, command, "while disabled", ways=(1, -1))
    release = probe.dialect.by_verb.get(Verb.RELEASE_PROTECTION)
    if release is not None:
        probe.ask(release)
    expect_refused(probe, command, "while disabled, behind a release", lambda: motion.switch(probe, True))


@of_motion(
    each=lambda dialect: list(motions(MotionKind.MOVE_BY, where=_can_refuse)(dialect))[:1],
    name="{command}/behind-refusals",
    refuted_by="silence, or a command that is not carried out",
)
def _behind_refusals(probe: Probe, command: Command) -> None:
    """What comes behind a refused motion is answered and carried out: a read, enabling, and a move."""
    # Without a look whether it has a bus mode: that may be refused, and what is behind it would not be looked at.
    motion.set_mode(probe, declared.bus_modes(probe.dialect)[-1])
    probe.ask(Verb.SET_SUBDIVISION, {"subdivision": SUBDIVISION})
    motion.switch(probe, False)
    values = _request(probe.dialect, command)
    judge_next(probe, "a refused motion", lambda: probe.ask(command, values, quiet_ns=0))
    before = motion.position(probe)
    for _ in range(_TRIES):
        refusal, enabling = undamaged(probe, _enabled_behind, command, values)
        if not enabling.silent:
            break
    is_on, exchange = motion.is_on(probe), probe.traffic[-1]
    text = "a motor is not enabled at once behind a refused motion"
    probe.expect(is_on, equal=True, refutes=text, exchange=exchange)
    probe.expect("a motion", holds=probe.refused(refusal), expected="a refusal", refutes=f"{command.name} is not refused")
    exchange = probe.ask(command, values, quiet_ns=0)
    moved = abs(arriving.come_to_rest(probe, exchange, 0, _MOVES_NS).value - before.value)
    text = f"{command.name} behind a refused one is not carried out"
    probe.expect(moved, near=90, within=motion.miss(probe), unit="degrees", refutes=text, exchange=exchange)


def _enabled_behind(probe: Probe, command: Command, values: dict[str, int]) -> tuple[Exchange, Exchange]:
    """Ask a motor that is off for a motion, and switch it on at once."""
    motion.switch(probe, False)
    refusal = probe.ask(command, values, quiet_ns=0)
    return refusal, probe.ask(*declared.switching(probe.dialect, True), quiet_ns=0)


#: How often enabling is asked for behind a refusal: a reply may be lost.
_TRIES = 2


def _needing_modes(dialect: Dialect) -> Iterator[Case]:
    for command in dialect.commands:
        if command.modes and not (command.models and dialect.model and dialect.model not in command.models):
            yield Case(dialect, command)


def _certainty(case: Case) -> Certainty:
    command = command_of(case)
    if command.verb is Verb.ENABLE or (command.motion is not None and command.motion.kind in _SURE):
        return Certainty.CERTAIN
    return Certainty.OPEN if command.verb is Verb.EMERGENCY_STOP else Certainty.LIKELY


def _risks_of_request(case: Case) -> frozenset[Risk]:
    command = command_of(case)
    return command.risks(_request(case.dialect, command))


@of_motion(
    each=_needing_modes,
    name="{command}/pulse-mode",
    refuted_by="a motion, or an answer that says success",
    at_best=_certainty,
    own=_risks_of_request,
)
def _in_pulse_modes(probe: Probe, command: Command) -> None:
    """{command} is refused in the work modes in which pulses move the motor."""
    for number, mode in enumerate(declared.pulse_modes(probe.dialect)):
        motion.set_mode(probe, mode)
        expect_refused(probe, command, f"in mode {mode}", ways=((-1) ** number,))


@of_motion(
    each=motions(*_SURE, MotionKind.TORQUE, where=lambda command: not _can_refuse(command)),
    refuted_by="silence, or motion",
    risks=risks_by(Verb.MOTOR_OFF),
)
def _while_off(probe: Probe, command: Command) -> None:
    """{command} is answered while the motor is off, and turns nothing either way, then or later."""
    motion.ready_to_move(probe)
    motion.switch(probe, False)
    before = motion.position(probe)
    for way in (1, -1):
        how = _turning(command, way)
        exchange = motion.ask(probe, command, **how)
        # A reply can be lost; a motor that is off never answers.
        if exchange.silent and not motion.ask(probe, command, **how).silent:
            raise Inconclusive(f"{command.name} was answered only when it was sent again")
        text = f"{command.name} is not answered while the motor is off"
        probe.expect("silence", holds=not exchange.silent, expected="a reply", refutes=text, exchange=exchange)
        probe.wait(_LOOKED_AT_NS)
        expect_stays(before, motion.position(probe), exchange, f"{command.name} turns a motor that is off")
    motion.switch(probe, True)
    probe.wait(_LOOKED_AT_NS)
    after = motion.position(probe)
    motion.stop(probe)
    expect_stays(before, after, exchange, f"{command.name}, given while off, turns the motor when it is on again")
