"""States of LK motors: on and off, and the stop.

Rules kept here:
- Off: commands are answered and nothing turns, neither then nor when the motor is on again.
- The stop leaves the motor on. How it brakes is not printed: that it does is observed.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.claims.motion_lk import values_of
from conformance.claims.motion_lk_forces import FORCES, TORQUE
from conformance.motion import motion
from conformance.motion.motion import SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

_ON, _OFF = 0x00, 0x10
#: Commands of motion, as far as a model has them.
MOTIONS = (
    "run_torque", "run_open_loop", "run_speed", "move_multi_turn", "move_multi_turn_limited", "move_single_turn",
    "move_single_turn_limited", "move_increment", "move_increment_limited",
)  # fmt: skip


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about the states of an LK motor."""
    named = dialect.by_name
    lets_go = named["motor_off"].all_risks
    for name in MOTIONS:
        if name in named:
            yield motion_claim(
                dialect, named[name], "while-off",
                f"{name} is answered while the motor is off, and turns nothing, then or later.", "silence, or motion",
                _while_off, risks=lets_go, models=named[name].models,
            )  # fmt: skip


# --- on and off -------------------------------------------------------------------------------------------------------


def _ask_motion(probe: Probe, command: Command) -> Exchange:
    field = FORCES.get(command.name)
    if field is not None:
        return probe.ask(command, {field: TORQUE})
    if command.verb is Verb.RUN_SPEED:
        return probe.ask(command, {"speed": 18_000})
    return probe.ask(command, values_of(probe, command, 90.0, motion.position(probe)))


def _while_off(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    probe.do(Verb.MOTOR_OFF)
    before = motion.position(probe)
    exchange = _ask_motion(probe, command)
    if exchange.silent:
        # A reply can be lost; a motor that is off never answers.
        if not _ask_motion(probe, command).silent:
            raise Inconclusive(f"{command.name} was answered only when it was sent again")
        text = f"{command.name} is not answered while the motor is off"
        raise refute(exchange, text, expected="a reply", got="silence")
    probe.wait(SECOND_NS)
    expect_stays(before, motion.position(probe), exchange, f"{command.name} turns a motor that is off")
    probe.do(Verb.MOTOR_ON)
    probe.wait(SECOND_NS)
    after = motion.position(probe)
    motion.stop(probe)
    expect_stays(before, after, exchange, f"{command.name}, given while off, turns the motor when it is on again")
