"""States of LK motors: on and off, and the stop.

Rules kept here:
- Off: commands are answered and nothing turns, neither then nor when the motor is on again.
- The stop leaves the motor on. How it brakes is not printed: that it does is observed.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.claims.motion_lk import values_of
from conformance.claims.motion_lk_forces import FORCES, TORQUE
from conformance.claims.motion_lk_speeds import measured, run
from conformance.motion import motion
from conformance.motion.motion import MS, SECOND_NS
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
    spins, lets_go = named["run_speed"].all_risks, named["motor_off"].all_risks
    for name in MOTIONS:
        if name in named:
            yield motion_claim(
                dialect, named[name], "while-off",
                f"{name} is answered while the motor is off, and turns nothing, then or later.", "silence, or motion",
                _while_off, risks=lets_go, models=named[name].models,
            )  # fmt: skip
    off, on, stop = named["motor_off"], named["motor_on"], named["stop"]
    made = partial(motion_claim, dialect, risks=lets_go)
    yield made(off, "is-read", "A motor that is off reads state 10h, one that is on 00h.", "the other", _state_is_read)
    yield made(
        off, "ends-motion", "Switching the motor off ends a motion.", "a shaft that is still driven", _off_ends,
        at_best=Certainty.LIKELY, risks=spins,
    )  # fmt: skip
    yield made(
        on, "does-not-resume", "Switching the motor on does not take up what was ended.", "motion", _does_not_resume,
        at_best=Certainty.LIKELY, risks=spins | lets_go,
    )  # fmt: skip
    yield made(on, "obeys", "A motor that was switched off and on obeys the next command.", "no motion", _obeys_again)
    yield made(
        off, "keeps-turns", "Switching the motor off and on leaves the counted turns.", "another position", _keeps_turns,
        at_best=Certainty.LIKELY, quirks=known(dialect, "lk-off-clears-turns"),
    )  # fmt: skip
    yield made(stop, "stops", "The stop brings a running shaft to rest.", "a shaft that goes on", _stops, risks=spins)
    yield made(stop, "ends-a-move", "The stop ends a move before its target.", "a shaft at its target", _stops_move, risks=())
    yield made(
        stop, "stays-on", "After the stop the motor is on, and the next command moves it.", "state 10h, or no motion",
        _stays_on, at_best=Certainty.LIKELY, risks=spins,
    )  # fmt: skip
    yield made(
        stop, "keeps-turns", "The stop leaves the counted turns.", "another position", _stop_keeps_turns,
        at_best=Certainty.LIKELY, risks=(),
    )  # fmt: skip
    yield made(
        stop, "brakes", "The stop brakes the shaft as speed 0 does: it goes no farther.", "a shaft that runs out",
        _stop_brakes, at_best=Certainty.OPEN, risks=spins,
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


def _state(probe: Probe) -> int:
    return probe.read(Verb.READ_STATE_1, "state")


def _state_is_read(probe: Probe, command: Command) -> None:
    for verb, wanted in ((Verb.MOTOR_ON, _ON), (Verb.MOTOR_OFF, _OFF), (Verb.MOTOR_ON, _ON), (Verb.MOTOR_OFF, _OFF)):
        exchange = probe.do(verb)
        seen = _state(probe)
        if seen != wanted:
            text = f"the state after {verb.value} is another one"
            raise refute(exchange, text, expected=f"{wanted:02X}h", got=f"{seen:02X}h")
    probe.do(Verb.MOTOR_ON)


def _expect_slow(probe: Probe, exchange: Exchange, text: str) -> None:
    speed, _ = measured(probe, 500 * MS)
    if abs(speed) > 2:
        motion.stop(probe)
        raise refute(exchange, text, expected="a shaft that stands", got=f"{speed:.0f} deg/s")


def _off_ends(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    exchange = probe.do(command)
    probe.wait(5 * SECOND_NS)
    _expect_slow(probe, exchange, "the shaft still turns after the motor was switched off")


def _does_not_resume(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    probe.do(Verb.MOTOR_OFF)
    probe.wait(5 * SECOND_NS)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    _expect_slow(probe, exchange, "switching the motor on takes up the motion again")


def _expect_moves(probe: Probe, text: str) -> None:
    before = motion.position(probe)
    exchange = probe.do("move_increment", {"position": 4_500})
    probe.wait(500 * MS)
    after = motion.wait_standing(probe)
    if abs(abs(after.value - before.value) - 45) > 1:
        raise refute(exchange, text, expected="45 degrees", got=f"{after.value - before.value:+.1f} degrees")


def _obeys_again(probe: Probe, command: Command) -> None:
    for _ in range(2):
        probe.do(Verb.MOTOR_OFF)
        probe.do(command)
        _expect_moves(probe, "the motor does not obey after it was switched on")


def _turn_away(probe: Probe) -> None:
    motion.ready_to_move(probe)
    for _ in range(2):
        probe.do("move_increment", {"position": 42_000})
        probe.wait(SECOND_NS)
        motion.wait_standing(probe)


def _keeps_turns(probe: Probe, command: Command) -> None:
    _turn_away(probe)
    before = motion.position(probe)
    exchange = probe.do(command)
    probe.do(Verb.MOTOR_ON)
    after = motion.position(probe)
    change = after.value - before.value
    if abs(change) <= 1:
        return
    if "lk-off-clears-turns" in probe.claim.quirks and abs(change - 360 * round(change / 360)) <= 1:
        probe.meets("lk-off-clears-turns")
        return
    text = "switching the motor off changes the position"
    raise refute(exchange, text, expected=f"{before.value:.1f} degrees", got=f"{after.value:.1f} degrees")


# --- the stop ---------------------------------------------------------------------------------------------------------


def _stops(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    exchange = probe.do(command)
    probe.wait(3 * SECOND_NS)
    _expect_slow(probe, exchange, "the stop does not bring the shaft to rest")


def _stops_move(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    before = motion.position(probe)
    probe.do("move_increment_limited", {"position": 36_000, "max_speed": 9_000})
    probe.wait(SECOND_NS)
    exchange = probe.do(command)
    probe.wait(5 * SECOND_NS)
    went = motion.wait_standing(probe).value - before.value
    if not 20 < abs(went) < 300:
        text = "the stop does not end a move on its way"
        raise refute(exchange, text, expected="about 90 degrees of 360", got=f"{went:+.1f} degrees")


def _stays_on(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    exchange = probe.do(command)
    motion.wait_standing(probe)
    state = _state(probe)
    if state != _ON:
        raise refute(exchange, "the motor is not on after the stop", expected="00h", got=f"{state:02X}h")
    _expect_moves(probe, "the motor does not obey after the stop")


def _stop_keeps_turns(probe: Probe, command: Command) -> None:
    _turn_away(probe)
    before = motion.position(probe)
    exchange = probe.do(command)
    probe.wait(500 * MS)
    after = motion.position(probe)
    if abs(after.value - before.value) > 1:
        text = "the stop changes the position of a shaft that stands"
        raise refute(exchange, text, expected=f"{before.value:.1f} degrees", got=f"{after.value:.1f} degrees")


def _stop_way(probe: Probe, name: str, values: dict[str, int]) -> tuple[float, Exchange]:
    """Run, stop by a command and return how far the shaft went after it (degrees)."""
    run(probe, 36_000)
    exchange = probe.ask(name, values, quiet_ns=0)
    begun = motion.position(probe)
    probe.wait(SECOND_NS)
    return abs(motion.wait_standing(probe).value - begun.value), exchange


def _stop_brakes(probe: Probe, command: Command) -> None:
    braked, _ = _stop_way(probe, "run_speed", {"speed": 0})
    stopped, exchange = _stop_way(probe, command.name, {})
    if stopped > braked + 5:
        text = "the shaft goes farther after the stop than after speed 0"
        raise refute(exchange, text, expected=f"about {braked:.0f} degrees", got=f"{stopped:.0f} degrees")
