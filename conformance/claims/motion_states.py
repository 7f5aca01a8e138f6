"""States: what the motor status says on the way, and that motion is refused where it has to be.

    F1    1 stopped   2 speeding up   3 slowing down   4 full speed   5 homing   6 calibrating

Rules kept here:
- Each state of the ramp lasts longer than a second in these claims, so that a late reply still tells of it.
- A motion is refused (status 0; Modbus: a refused write) while the motor is disabled, protected, or in a pulse mode; and
  what is refused turns nothing, now or later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.motion.motion import MS, QUICK, SAME, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: 120 rpm at 12 ms for each rpm: 1.44 s up and as long down.
_RPM, _RAMP, _RAMP_NS = 120, 16, 1440 * MS
_STOPPED, _UP, _DOWN, _FULL = 1, 2, 3, 4
#: How long F1 was seen to stay behind the shaft.
_STAYS_NS = 2 * SECOND_NS
#: Commands that need a bus mode and that the manual takes back nothing of; of the others it is less sure.
_SURE = (Verb.RUN_SPEED, *journey.MOVES, Verb.ENABLE)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about states."""
    yield from _about_status(dialect)
    for command in (dialect.by_verb[Verb.RUN_SPEED], *journey.moves(dialect)):
        yield motion_claim(
            dialect,
            command,
            "disabled",
            f"{command.name} is refused while the motor is disabled, and nothing turns when it is enabled again.",
            "a motion, or an answer that says success",
            _disabled,
        )
    for command in dialect.commands:
        if command.modes and not (command.models and dialect.model and dialect.model not in command.models):
            yield motion_claim(
                dialect,
                command,
                "pulse-mode",
                f"{command.name} is refused in the work modes in which pulses move the motor.",
                "a motion, or an answer that says success",
                _in_pulse_modes,
                at_best=_certainty(command),
                own=_sent_risks(command),
                models=command.models,
            )


def _certainty(command: Command) -> Certainty:
    if command.verb in _SURE:
        return Certainty.CERTAIN
    return Certainty.OPEN if command.verb is Verb.EMERGENCY_STOP else Certainty.LIKELY


def _sent_risks(command: Command) -> frozenset[Risk]:
    return command.risks(_plain(command))


# --- F1 ---------------------------------------------------------------------------------------------------------------


def _about_status(dialect: Dialect) -> Iterator[Claim]:
    status = dialect.by_verb[Verb.READ_STATUS]
    run = dialect.by_verb[Verb.RUN_SPEED]
    made = partial(motion_claim, dialect, status, risks=run.all_risks)
    moved = partial(motion_claim, dialect, status)
    yield moved("at-rest", "The status of a motor that stands is 1.", "another status", _at_rest)
    yield made("speeding-up", "The status on the ramp up is 2.", "another status", _speeding_up)
    yield made("full-speed", "The status at the speed that was asked for is 4.", "another status", _full_speed)
    yield made(
        "slowing-down",
        "The status on the ramp down is 3.",
        "another status",
        _slowing_down,
        quirks=known(dialect, "status-stops-early"),
    )
    yield moved(
        "after-a-move",
        "The status of a motor that has come to its target is 1.",
        "another status",
        _after_a_move,
        quirks=known(dialect, "status-stays-slowing"),
    )
    yield made(
        "follows",
        "The status follows the motor at once: 1 before a run, 2 on the ramp, 4 at full speed, 1 long after the stop.",
        "a status of the time before, or one that never changes",
        _follows,
    )
    yield moved(
        "in-a-move",
        "The status during a move is that of its ramp: 2, then 4, then 1 when it is over.",
        "another status",
        _in_a_move,
    )


def _status(probe: Probe) -> tuple[int, Exchange]:
    command = probe.command(Verb.READ_STATUS)
    exchange = probe.ask(command, quiet_ns=0)
    return int(probe.reply(exchange).values["status"]), exchange


def _expect(probe: Probe, wanted: int, what: str) -> None:
    seen, exchange = _status(probe)
    if seen != wanted:
        raise _wrong(exchange, wanted, seen, what)


def _wrong(exchange: Exchange, wanted: int, seen: int, what: str) -> Exception:
    return refute(exchange, f"the motor {what}, and its status is {seen}", expected=str(wanted), got=str(seen))


def _at_rest(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    _expect(probe, _STOPPED, "stands")


def _speed_up(probe: Probe) -> Exchange:
    motion.ready_to_move(probe, subdivision=journey.SUBDIVISION)
    exchange = motion.run_at(probe, _RPM, _RAMP)
    probe.wait(exchange.sent_ns + 400 * MS - probe.gate.now_ns())
    return exchange


def _speeding_up(probe: Probe, command: Command) -> None:
    _speed_up(probe)
    _expect(probe, _UP, "speeds up")
    motion.stand_still(probe)


def _full_speed(probe: Probe, command: Command) -> None:
    exchange = _speed_up(probe)
    probe.wait(exchange.sent_ns + _RAMP_NS + 500 * MS - probe.gate.now_ns())
    _expect(probe, _FULL, "turns at full speed")
    motion.stand_still(probe)


def _slowing_down(probe: Probe, command: Command) -> None:
    exchange = _speed_up(probe)
    probe.wait(exchange.sent_ns + _RAMP_NS + 500 * MS - probe.gate.now_ns())
    motion.stop(probe, _RAMP)
    turning = motion.speed(probe)
    seen, asked = _status(probe)
    motion.wait_standing(probe)
    if abs(turning.value) < 2:
        raise Inconclusive("the shaft stood too soon to see it slow down")
    if seen == _STOPPED and "status-stops-early" in probe.claim.quirks:
        probe.meets("status-stops-early")
    elif seen != _DOWN:
        raise _wrong(asked, _DOWN, seen, "slows down")


def _after_a_move(probe: Probe, command: Command) -> None:
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    journey.prepare(probe, move)
    journey.begin(probe, move, 0.25, acceleration=QUICK)
    motion.wait_standing(probe)
    seen, exchange = _status(probe)
    if seen == _DOWN and "status-stays-slowing" in probe.claim.quirks:
        probe.wait(_STAYS_NS)
        seen, exchange = _status(probe)
        probe.meets("status-stays-slowing")
    if seen != _STOPPED:
        raise _wrong(exchange, _STOPPED, seen, "has come to its target")


def _follows(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, subdivision=journey.SUBDIVISION)
    _expect(probe, _STOPPED, "stands")
    exchange = _speed_up(probe)
    _expect(probe, _UP, "speeds up")
    probe.wait(exchange.sent_ns + _RAMP_NS + SECOND_NS - probe.gate.now_ns())
    _expect(probe, _FULL, "turns at full speed")
    motion.stand_still(probe)
    probe.wait(_STAYS_NS)
    _expect(probe, _STOPPED, "has stopped")


def _in_a_move(probe: Probe, command: Command) -> None:
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    journey.prepare(probe, move)
    # The ramps take 1.44 s each, and half of six turns is left for full speed: 1.5 s.
    exchange = journey.begin(probe, move, 6.0, speed=_RPM, acceleration=_RAMP, quiet_ns=0)
    probe.wait(exchange.sent_ns + 400 * MS - probe.gate.now_ns())
    _expect(probe, _UP, "speeds up on a move")
    probe.wait(exchange.sent_ns + _RAMP_NS + 200 * MS - probe.gate.now_ns())
    _expect(probe, _FULL, "turns at full speed on a move")
    motion.wait_standing(probe)
    probe.wait(_STAYS_NS)
    _expect(probe, _STOPPED, "has ended a move")


# --- refused ----------------------------------------------------------------------------------------------------------


def _plain(command: Command) -> dict[str, int]:
    """Return values of a request that would move the shaft, or do what the command does."""
    named = command.request_forms[0].layout.named
    plain = {"speed": 60, "acceleration": QUICK, "pulses": 800, "position": 4000, "enabled": 1, "limit_remap": 0}
    values = {n: plain.get(n, f.low) for n, f in named.items() if f.fixed is None}
    if "save_state" in named:
        values["save_state"] = motion.choice(command, "save_state", "clean")
    return values


def _ask_plainly(probe: Probe, command: Command) -> Exchange:
    values = _plain(command)
    if journey.is_absolute(command):
        values["position"] += journey.place(probe, command)
    return probe.ask(command, values)


def expect_refused(probe: Probe, command: Command, why: str, again: Callable[[], None] | None = None) -> None:
    """Ask for a motion and refute unless it is refused and turns nothing, also after `again` (enabling, for instance)."""
    before = motion.position(probe)
    exchange = _ask_plainly(probe, command)
    answer = probe.reply(exchange)
    probe.wait(SECOND_NS)
    if again is not None:
        again()
        probe.wait(SECOND_NS)
    after = motion.position(probe)
    if abs(after.value - before.value) > SAME and Verb.RUN_SPEED in probe.dialect.by_verb:
        motion.stop(probe)
    expect_stays(before, after, exchange, f"{command.name} {why} turns the shaft")
    if not probe.refused(exchange):
        text = f"{command.name} {why} is not refused"
        raise refute(exchange, text, expected="a refusal", got=answer.data.hex(" ").upper())


def _disabled(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    probe.do(Verb.ENABLE, {"enabled": 0})
    expect_refused(probe, command, "while disabled", lambda: _enable(probe))


def _enable(probe: Probe) -> None:
    probe.do(Verb.ENABLE, {"enabled": 1})


def _pulse_modes(probe: Probe) -> list[str]:
    field = probe.command(Verb.SET_WORK_MODE).request_forms[0].layout.named["work_mode"]
    return [name for name in field.choice_names.values() if name not in motion.bus_modes(probe.dialect)]


def _in_pulse_modes(probe: Probe, command: Command) -> None:
    for mode in _pulse_modes(probe):
        motion.set_mode(probe, mode)
        expect_refused(probe, command, f"in mode {mode}")
