"""Conditions of a drive: at rest, moving in each way, off, stopped, restarted, protected; how a claim brings it there and out.

A bug often shows in one condition alone. So claims about reads and about settings are made for each of them.

Rules kept here:
- The shaft turns slowly, but for one fast run. Homing and calibrating are begun as they are: they risk what the catalogue
  says.
- Entering and leaving judges nothing.
- The work modes take turns, so that what is wrong in one of them shows in some conditions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from analyzer.protocols.lk_rs485 import ERROR_BITS
from conformance.claims import bench
from conformance.claims.addressing.ways import join
from conformance.claims.motion import homing
from conformance.claims.motion.protection import protect
from conformance.claims.motion.stops import endless
from conformance.model import limits
from conformance.motion import declared, motion
from conformance.motion.declared import MOVES, QUICK
from conformance.talk import restarts, samples
from conformance.talk.probe import MS, Probe

#: The speed of the fast run, in rpm.
_FAST = 1200
#: Runs by a ramp of 2.8 s, in which all reads are asked for; a place that is turns below zero; a while in which a shaft
#: that was stopped comes to rest.
_RAMPED, _LONG_RAMP, _BELOW, _SOON_NS = 240, 24, 2.4, 400 * MS
#: The same for a slow one.
_STOPS_NS = 150 * MS
#: Where homing finds an end stop, in counts below the shaft.
_HOME_COUNTS = 3000
_Step = Callable[[Probe], object]


@dataclass(frozen=True)
class Condition:
    """A condition of a drive. `enter` brings the drive into it, `leave` out of it; `risks` of both, beside those of motion.

    `mode`: the work mode in which it is tried, "" for any. `rpm`: how fast the shaft turns, where that is fast. `settings`:
    what it sets itself. `stands`: the shaft stands, and nothing is under way. `steady`: it turns at one speed.
    `stays`: what is stored stays as it is. `without`: reads whose reply the manual does not promise in it. `changes`: flags
    that read otherwise in it.
    """

    name: str
    when: str
    enter: _Step
    leave: _Step
    risks: frozenset[Risk] = frozenset()
    mode: str = ""
    rpm: int = 0
    settings: tuple[str, ...] = ()
    emulated: bool = False
    by_name: bool = False
    stands: bool = False
    steady: bool = False
    stays: bool = True
    models: tuple[str, ...] = ()
    without: tuple[Verb, ...] = ()
    changes: tuple[Verb, ...] = ()

    def facts(self, dialect: Dialect, *risks: Risk, settings: tuple[str, ...] = ()) -> dict[str, Any]:
        """Return what a claim must declare that is made in this condition, with more risks and settings."""
        return {
            "risks": declared.risks(dialect, *(self.risks | set(risks)) - {Risk.UNKNOWN}, Risk.UNBOUNDED),
            "settings": tuple(dict.fromkeys(declared.settings(dialect, *self.settings, *settings))),
            "emulated": self.emulated,
            "by_name": self.by_name,
            # What changes an address may put a drive where another one is.
            "alone": Risk.LINK in self.risks,
            "models": self.models,
        }


# --- how conditions are entered and left ----------------------------------------------------------------------------------


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
    probe.wait(_STOPS_NS)


def _turn_and_stop_at_once(probe: Probe) -> None:
    endless(probe, probe.command(Verb.RUN_SPEED))
    _emergency_stop(probe)
    probe.wait(_STOPS_NS)


def _speed_up(probe: Probe) -> None:
    motion.run_at(probe, _RAMPED, _LONG_RAMP)


def _slow_down(probe: Probe) -> None:
    motion.run_at(probe, -_RAMPED, QUICK)
    probe.wait(_SOON_NS)
    motion.stop(probe, _LONG_RAMP)


def _go_below_zero(probe: Probe) -> None:
    probe.do(Verb.SET_ZERO)
    motion.begin(probe, declared.any_move(probe.dialect), -_BELOW * 360, rpm=180, acceleration=QUICK)
    probe.wait(round(_BELOW / 3 * 1000) * MS + _SOON_NS)


def _emergency_stop(probe: Probe) -> None:
    probe.ask(Verb.EMERGENCY_STOP)


def _wait_for_the_end(probe: Probe) -> None:
    probe.wait(probe.rig.done_ns)


def _nothing(probe: Probe) -> None:
    """Leave a condition that lasts no longer than the claim."""


def _set(verb: Verb, **values: int) -> _Step:
    return lambda probe: probe.do(verb, values)


def _sample(command: Command) -> _Step:
    return lambda probe: probe.do(command, samples.sample(probe.dialect, command))


def _release(probe: Probe) -> None:
    probe.do(Verb.RELEASE_PROTECTION)


def _trip(probe: Probe, present: bool) -> None:
    for field in ERROR_BITS:
        bench.lk_drive(probe).trip(field.name, present)
    if not present:
        probe.do(Verb.CLEAR_ERRORS)


def _pulse_mode(probe: Probe) -> None:
    motion.set_mode(probe, [mode for mode in declared.pulse_modes(probe.dialect) if "no_encoder" not in mode][-1])


def _refused_setting(probe: Probe) -> None:
    field = declared.field_of(probe.command(Verb.SET_WORK_MODE), "work_mode")
    probe.ask(Verb.SET_WORK_MODE, {"work_mode": limits.beyond(field)[0]})


def _find_home(probe: Probe) -> None:
    homing.set_home(probe, home_speed=120)
    bench.left_switch(probe, -_HOME_COUNTS)
    homing.find_home(probe)
    probe.do(Verb.ENABLE, {"enabled": 1})


def _bus_mode(probe: Probe) -> None:
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1])


# --- the conditions of a dialect ----------------------------------------------------------------------------------------

_AT_REST = Condition("at-rest", "at rest", _nothing, _nothing, stands=True)


def _motions(dialect: Dialect) -> Iterator[Condition]:
    """Yield one motion of each kind, if possible one with a speed in its request."""
    for kind in (MotionKind.RUN, *MOVES, MotionKind.TORQUE):
        commands = sorted(dialect.motions(kind), key=lambda c: (bool(c.models), not declared.of(c).speed))
        for command in commands[:1]:
            enter, when = partial(endless, run=command), f"while {command.name} turns the shaft"
            facts: dict[str, Any] = {"models": command.models, "steady": kind is MotionKind.RUN}
            yield Condition(command.name, when, enter, _stop, command.all_risks, **facts)
    if dialect.ramp is not None:
        yield Condition("fast", f"while the shaft turns at {_FAST} rpm", _turn_fast, _stop, rpm=_FAST, steady=True)
        yield Condition("speeding-up", "while the shaft speeds up", _speed_up, _stop)
        yield Condition("slowing-down", "while the shaft slows down", _slow_down, _nothing)
    yield Condition("stopped", "after a stop", _turn_and_stop, _nothing, stands=True)


def _tasks(dialect: Dialect) -> Iterator[Condition]:
    for task in dialect.motions(MotionKind.HOME):
        yield Condition("homing", "while the drive is homing", _sample(task), _emergency_stop, task.all_risks)
    for task in dialect.motions(MotionKind.CALIBRATE):
        # It may change what the version tells of the encoder.
        when = "while the drive is calibrating"
        yield Condition("calibrating", when, _sample(task), _wait_for_the_end, task.all_risks, by_name=True, stays=False)


def _others(dialect: Dialect) -> Iterator[Condition]:
    verbs = dialect.by_verb

    def risks(*of: Verb) -> frozenset[Risk]:
        return frozenset[Risk]().union(*(verbs[v].all_risks for v in of))

    yield Condition(
        "off",
        "while the motor is off",
        partial(motion.switch, on=False),
        partial(motion.switch, on=True),
        frozenset({Risk.TORQUE}),
        stands=True,
        changes=(Verb.READ_ENABLED,),
    )
    if Verb.EMERGENCY_STOP in verbs:
        yield Condition("emergency-stopped", "after an emergency stop", _turn_and_stop_at_once, _nothing, stands=True)
    if Verb.SET_ZERO in verbs and dialect.counts_per_turn:
        when = f"{_BELOW} turns below zero, after a move"
        yield Condition("below-zero", when, _go_below_zero, _nothing, risks(Verb.SET_ZERO), stands=True)
    if Verb.SET_RESPOND in verbs:
        silent, loud = (_set(Verb.SET_RESPOND, respond=on, active=on) for on in (0, 1))
        facts: dict[str, Any] = {"settings": ("respond", "active"), "stands": True, "stays": False}
        yield Condition("respond-off", "with respond 0", silent, loud, risks(Verb.SET_RESPOND), **facts)
    if Verb.SET_WORK_MODE in verbs:
        yield Condition(
            "refused", "after a refused setting", _refused_setting, _nothing, risks(Verb.SET_WORK_MODE), stands=True
        )
        # The status is of bus modes alone.
        facts = {"settings": ("work_mode",), "without": (Verb.READ_STATUS,), "changes": (Verb.READ_ENABLED,)}
        facts |= {"stands": True, "stays": False}
        yield Condition("pulse-mode", "in a pulse mode", _pulse_mode, _bus_mode, risks(Verb.SET_WORK_MODE), **facts)
    if Verb.RESTART in verbs:
        facts = {"stands": True, "changes": (Verb.READ_ENABLED, Verb.READ_ZERO_STATUS)}
        yield Condition("restarted", "after a restart", restarts.restart, _nothing, risks(Verb.RESTART), **facts)
    else:
        facts = {"emulated": True, "stands": True, "stays": False}
        yield Condition("restarted", "after its power was cut", restarts.power_cycle, _nothing, **facts)
    if Verb.SET_GROUP_ADDRESS in verbs:
        facts = {"settings": ("group_address",), "stands": True, "stays": False}
        yield Condition("grouped", "in a group", join, _nothing, risks(Verb.SET_GROUP_ADDRESS), **facts)
    if Verb.SET_PROTECTION in verbs:
        facts = {"settings": ("protection",), "emulated": True, "stands": True, "stays": False}
        facts |= {"changes": (Verb.READ_PROTECTION, Verb.READ_ENABLED)}
        needs = risks(Verb.SET_PROTECTION, Verb.RELEASE_PROTECTION)
        yield Condition("protected", "while the rotor protection holds", protect, _release, needs, **facts)
    if Verb.SET_HOME in verbs:
        facts = {"settings": homing.fields(dialect), "emulated": True, "stands": True, "stays": False}
        needs = risks(*(verb for verb in homing.SETS_HOME if verb in verbs), Verb.HOME)
        yield Condition("homed", "after homing", _find_home, _nothing, needs, **facts)
    if Verb.CLEAR_ERRORS in verbs:
        there, gone = partial(_trip, present=True), partial(_trip, present=False)
        needs = risks(Verb.CLEAR_ERRORS)
        yield Condition("error", "while error flags are set", there, gone, needs, emulated=True, stands=True)


def every(dialect: Dialect) -> Iterator[Condition]:
    """Yield the conditions in which a drive of a dialect can be, beside at rest: each in one of the work modes, in turn."""
    if not declared.can_move(dialect):
        return
    modes = [mode for mode in declared.bus_modes(dialect) if "no_encoder" not in mode]
    for number, each in enumerate(chain(_motions(dialect), _tasks(dialect), _others(dialect))):
        fit = [mode for mode in modes if each.rpm <= dialect.mode_speeds.get(mode, each.rpm)]
        # What hands do to the shaft, and what wears, is not promised of an open loop.
        own = each.emulated or each.by_name or "work_mode" in each.settings
        yield each if own or not fit else replace(each, mode=fit[number % len(fit)])


def passing(dialect: Dialect) -> list[Condition]:
    """Return the conditions that a drive of a dialect can be in, but for those that change it for good."""
    return [_AT_REST, *(each for each in every(dialect) if not each.by_name)] if declared.can_move(dialect) else []
