"""Reads in every state: what a drive answers at rest it answers while it moves, is off, is protected, or has been set.

What is not answered again and again in one state is refuted there, so that no drive hides behind claims that cannot judge.
What is stored reads the same in every state.

Rules kept here:
- Only reads that are answered at rest are asked for. One reply may be lost: a read is asked for twice.
- The shaft turns slowly, but for one fast run. Homing and calibrating are begun as they are: they risk what the catalogue
  says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive, Theme
from conformance.claims import bench
from conformance.claims.control_reads import is_answered, received_text
from conformance.claims.declare import Case, claim
from conformance.claims.known_reads import every_read, is_stored
from conformance.claims.protection import protect
from conformance.claims.stops import endless
from conformance.motion import motion
from conformance.motion.motion import MOVES, MS, QUICK
from conformance.talk import samples
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

_ROUNDS = 2
#: The speed of the fast run, in rpm.
_FAST = 1200
#: Runs by a ramp of 2.8 s, in which all reads are asked for; a place that is turns below zero; a while in which a shaft
#: that was stopped comes to rest.
_RAMPED, _LONG_RAMP, _BELOW, _SOON_NS = 240, 24, 2.4, 400 * MS
_Step = Callable[[Probe], object]


@dataclass(frozen=True)
class _State:
    """A state of a drive. `enter` brings the drive into it, `leave` out of it; `risks` of both, beside those of motion.

    `stays`: what is stored stays as it is in this state. `without`: reads whose reply the manual does not promise in it.
    """

    name: str
    when: str
    enter: _Step
    leave: _Step
    risks: frozenset[Risk] = frozenset()
    settings: tuple[str, ...] = ()
    emulated: bool = False
    by_name: bool = False
    stays: bool = True
    models: tuple[str, ...] = ()
    without: tuple[Verb, ...] = ()


# --- how states are entered and left ----------------------------------------------------------------------------------


def _stop(probe: Probe) -> None:
    motion.stop(probe, QUICK)
    motion.wait_standing(probe)


def _turn_fast(probe: Probe) -> None:
    motion.run_at(probe, -_FAST, QUICK)
    probe.wait(600 * MS)


def _turn_and_stop(probe: Probe) -> None:
    # Nothing is asked before the reads: a drive that is deaf then is what is looked for.
    endless(probe, probe.command(Verb.RUN_SPEED))
    motion.stop(probe, QUICK)
    probe.wait(_SOON_NS)


def _speed_up(probe: Probe) -> None:
    motion.run_at(probe, _RAMPED, _LONG_RAMP)


def _slow_down(probe: Probe) -> None:
    motion.run_at(probe, -_RAMPED, QUICK)
    probe.wait(_SOON_NS)
    motion.stop(probe, _LONG_RAMP)


def _go_below_zero(probe: Probe) -> None:
    probe.do(Verb.SET_ZERO)
    motion.begin(probe, motion.any_move(probe.dialect), -_BELOW * 360, rpm=180, acceleration=QUICK)
    probe.wait(round(_BELOW / 3 * 1000) * MS + _SOON_NS)


def _emergency_stop(probe: Probe) -> None:
    probe.ask(Verb.EMERGENCY_STOP)


def _wait_for_the_end(probe: Probe) -> None:
    probe.wait(probe.rig.done_ns)


def _nothing(probe: Probe) -> None:
    """Leave a state that lasts no longer than the claim."""


def _set(verb: Verb, **values: int) -> _Step:
    return lambda probe: probe.do(verb, values)


def _sample(command: Command) -> _Step:
    return lambda probe: probe.do(command, samples.sample(probe.dialect, command))


def _release(probe: Probe) -> None:
    probe.do(Verb.RELEASE_PROTECTION)


def _trip(probe: Probe, present: bool) -> None:
    bench.lk_drive(probe).trip("motor_hot", present)
    if not present:
        probe.do(Verb.CLEAR_ERRORS)


def _pulse_mode(probe: Probe) -> None:
    modes = motion.field_of(probe.command(Verb.SET_WORK_MODE), "work_mode").choice_names.values()
    by_pulses = [mode for mode in modes if mode not in motion.bus_modes(probe.dialect) and "no_encoder" not in mode]
    motion.set_mode(probe, by_pulses[-1])


# --- the states of a dialect --------------------------------------------------------------------------------------------


def _motions(dialect: Dialect) -> Iterator[_State]:
    """Yield one motion of each kind; where the manual has several, the one that is told its speed."""
    for kind in (MotionKind.RUN, *MOVES, MotionKind.TORQUE):
        commands = sorted(dialect.motions(kind), key=lambda c: (bool(c.models), not motion.of(c).speed))
        for command in commands[:1]:
            enter, when = partial(endless, run=command), f"while {command.name} turns the shaft"
            yield _State(command.name, when, enter, _stop, command.all_risks, models=command.models)
    if dialect.ramp is not None:
        yield _State("fast", f"while the shaft turns at {_FAST} rpm", _turn_fast, _stop)
        yield _State("speeding-up", "while the shaft speeds up", _speed_up, _stop)
        yield _State("slowing-down", "while the shaft slows down", _slow_down, _nothing)
    yield _State("stopped", "after a stop", _turn_and_stop, _nothing)


def _tasks(dialect: Dialect) -> Iterator[_State]:
    for task in dialect.motions(MotionKind.HOME):
        yield _State("homing", "while the drive is homing", _sample(task), _emergency_stop, task.all_risks)
    for task in dialect.motions(MotionKind.CALIBRATE):
        # It may change what the version tells of the encoder.
        when = "while the drive is calibrating"
        yield _State("calibrating", when, _sample(task), _wait_for_the_end, task.all_risks, by_name=True, stays=False)


def _others(dialect: Dialect) -> Iterator[_State]:
    verbs = dialect.by_verb
    off = frozenset({Risk.TORQUE})
    yield _State("off", "while the motor is off", partial(motion.switch, on=False), partial(motion.switch, on=True), off)
    if Verb.SET_ZERO in verbs and dialect.counts_per_turn:
        yield _State(
            "below-zero", f"{_BELOW} turns below zero, after a move", _go_below_zero, _nothing, verbs[Verb.SET_ZERO].all_risks
        )
    if Verb.SET_RESPOND in verbs:
        silent, loud = (_set(Verb.SET_RESPOND, respond=on, active=on) for on in (0, 1))
        risks = verbs[Verb.SET_RESPOND].all_risks
        yield _State("respond-off", "with respond 0", silent, loud, risks, ("respond", "active"), stays=False)
    if Verb.SET_WORK_MODE in verbs:
        risks = verbs[Verb.SET_WORK_MODE].all_risks
        # The status is of bus modes alone.
        yield _State("pulse-mode", "in a pulse mode", _pulse_mode, _nothing, risks, stays=False, without=(Verb.READ_STATUS,))
    if Verb.SET_PROTECTION in verbs:
        risks = verbs[Verb.SET_PROTECTION].all_risks | verbs[Verb.RELEASE_PROTECTION].all_risks
        facts: dict[str, Any] = {"settings": ("protection",), "emulated": True, "stays": False}
        yield _State("protected", "while the rotor protection holds", protect, _release, risks, **facts)
    if Verb.CLEAR_ERRORS in verbs:
        there, gone = partial(_trip, present=True), partial(_trip, present=False)
        yield _State("error", "while an error flag is set", there, gone, verbs[Verb.CLEAR_ERRORS].all_risks, emulated=True)


def _states(dialect: Dialect) -> Iterator[Case]:
    if not motion.can_move(dialect):
        return
    reads = tuple(dict.fromkeys(c.name for c, _ in every_read(dialect)))
    for state in (*_motions(dialect), *_tasks(dialect), *_others(dialect)):
        facts = {
            "risks": motion.risks(dialect, *state.risks - {Risk.UNKNOWN}, Risk.UNBOUNDED),
            "settings": motion.settings(dialect, *state.settings),
            "emulated": state.emulated,
            "by_name": state.by_name,
            "models": state.models,
            "commands": reads,
        }
        yield Case(dialect, given={"state": state, "when": state.when}, facts=facts)


# --- what is read -------------------------------------------------------------------------------------------------------


@claim(
    Theme.RESILIENCE,
    each=_states,
    name="reads/{state}",
    refuted_by="silence, another reply, or another stored value",
    section=lambda case: case.dialect.by_verb[Verb.RUN_SPEED].section,
    at_best=Certainty.LIKELY,
    parameters={},
)
def _reads(probe: Probe, state: _State) -> None:
    """Every read is answered by its own reply {when}, and what is stored reads as before."""
    motion.ready_to_move(probe)
    at_rest = [(c, values, probe.ask(c, values, quiet_ns=0)) for c, values in every_read(probe.dialect)]
    readable = [(c, values, e) for c, values, e in at_rest if _tells(probe, e) and c.verb not in state.without]
    if not readable:
        raise Inconclusive("no read is answered while the shaft stands")
    state.enter(probe)
    for number in range(_ROUNDS):
        for command, values, before in readable:
            # What is stored is asked for once: that is most of a dialect's reads.
            if not number or not is_stored(command):
                _expect_answer(probe, command, values, state, before)
    state.leave(probe)


def _tells(probe: Probe, exchange: Exchange) -> bool:
    """Say whether a read was answered by what it reads: no other layout, and no refusal."""
    return is_answered(exchange) and motion.readable(exchange) and not probe.refused(exchange)


def _expect_answer(probe: Probe, command: Command, values: Mapping[str, Any], state: _State, before: Exchange) -> None:
    exchange = probe.ask(command, values, quiet_ns=0)
    if not _tells(probe, exchange):
        exchange = probe.ask(command, values, quiet_ns=0)
    answered = _tells(probe, exchange)
    if not answered:
        # What cannot be read cannot be left in order either.
        motion.stop(probe, QUICK)
    probe.expect(
        received_text(exchange),
        holds=answered,
        expected=f"a reply to {command.name}",
        refutes=f"{command.name} is not answered {state.when}",
        exchange=exchange,
        key=f"reads are not answered {state.when}",
    )
    told = [v.rule for v in probe.reply(exchange).message.violations]
    if told and not probe.reply(before).message.violations:
        text = f"{command.name} is answered {state.when} by what its reply cannot be"
        probe.expect(received_text(exchange), holds=False, expected=f"no {told[0]}", refutes=text, exchange=exchange)
    if state.stays and is_stored(command):
        stored = probe.reply(before).values
        text = f"{command.name} reads something else {state.when} than at rest"
        probe.expect(probe.reply(exchange).values, equal=stored, refutes=text, exchange=exchange)
