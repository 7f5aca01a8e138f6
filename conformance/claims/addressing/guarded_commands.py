"""Commands that must not be executed by mistake, and how one sees that they were: in the shaft and in what is read.

A row says how a drive is made ready to show it, what is sent, and what that would change; so most need no hands on the drive.

Rules kept here:
- A damaged motion is one that the same permission allows whole: small, slow, and the sums alone are wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from analyzer.protocols.lk_rs485 import ERROR_BITS
from conformance.claims import bench
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import command_of
from conformance.claims.motion.protection import protect
from conformance.claims.settings import setting_effects
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import MOVES, QUICK, SAME, SUBDIVISION
from conformance.talk import restarts
from conformance.talk.probe import MS, Probe

#: A motion that shows: degrees, and rpm where it can be told.
_DEGREES, RPM = 20, 30
#: How far a shaft is brought away from zero (deg), and how often until its angle is that far from zero.
_OFF_ZERO, _AWAY_MOST = 36, 3
#: How long a motion that is executed has until it is looked for; a shaft that went less than `_STILL` (deg) stays.
WATCH_NS, _STILL = 150 * MS, 4 * SAME
_POWER_OFF, _RELEASED, _READ_BRAKE = 0x00, 0x01, 0x10
_POSITION_STEP = 4_321
#: A position beyond three turns, the status of a calibration, and what lets a port be written.
_TURNS_AWAY, _CALIBRATING, _WRITE = 123_400, 6, 1
#: The shorter way back to a kept zero, at the highest speed.
_NEAR, _FASTEST = 2, 4


def _switch_on(probe: Probe) -> object:
    return motion.switch(probe, True)


@dataclass(frozen=True)
class Guarded:
    """A command that must not be executed. `ready`: makes it tell; `values`: what is sent; `see`: what it would change.

    `within`: by how much that differs by itself. `after`: puts back what it changed. `again`: sent whole, it shows; what ends a
    connection or takes long is sent whole by other claims alone. `sends`: what `see` sends beside motion.
    """

    ready: Callable[[Probe], object]
    values: Callable[[Probe, Command], Mapping[str, int]]
    see: Callable[[Probe], float]
    within: float = 0.0
    after: Callable[[Probe], object] = _switch_on
    again: bool = True
    sends: tuple[Verb, ...] = ()

    def shows(self, probe: Probe, before: float, after: float) -> bool:
        """Say whether what is seen has changed by more than it does by itself: a place trembles, and nothing else does."""
        return abs(after - before) > self.within + (probe.noise.place if self.within else 0.0)


def _shaft(probe: Probe) -> float:
    return motion.position(probe).value


def _is_on(probe: Probe) -> float:
    return float(motion.is_on(probe) is True)


def _brake(probe: Probe) -> float:
    return probe.read(Verb.BRAKE, "brake_state", {"brake_control": _READ_BRAKE})


def _release(probe: Probe) -> object:
    return probe.do(Verb.BRAKE, {"brake_control": _RELEASED})


def _nothing(probe: Probe, command: Command) -> Mapping[str, int]:
    return {}


def _motion_values(probe: Probe, command: Command) -> Mapping[str, int]:
    start = motion.place(probe, command)
    return declared.values_of(probe.dialect, command, _DEGREES, rpm=RPM, start=start)


def _another_position(probe: Probe, command: Command) -> Mapping[str, int]:
    now = probe.read(Verb.READ_POSITION, "position")
    # Far from the old position and from the ends of 32 bits.
    return {"position": _POSITION_STEP if abs(now - _POSITION_STEP) > _POSITION_STEP // 2 else -_POSITION_STEP}


def _away(probe: Probe) -> None:
    """Bring the shaft away from zero: what makes its place zero then shows."""
    motion.ready_to_move(probe)
    at = motion.position(probe).value
    arriving.follow(probe, declared.any_move(probe.dialect), _OFF_ZERO if at > -_OFF_ZERO / 2 else -_OFF_ZERO)


def _turn(probe: Probe) -> None:
    motion.ready_to_move(probe)
    motion.run_at(probe, -RPM)
    probe.wait(WATCH_NS)


def _turns(probe: Probe) -> float:
    return float(abs(motion.speed(probe).value) > RPM / 2)


def _turns_still(probe: Probe) -> float:
    """Say whether the shaft turns, of a drive that may just have begun anew."""
    restarts.wait_for_answer(probe)
    return _turns(probe)


def _count_turns(probe: Probe) -> None:
    motion.ready_to_move(probe)
    probe.do("set_position", {"position": _TURNS_AWAY})


def _calibrates(probe: Probe) -> float:
    return float(probe.read(Verb.READ_STATUS, "status") == _CALIBRATING)


def _has_flag(probe: Probe) -> float:
    return float(any(probe.read(Verb.READ_STATE_1, field.name) for field in ERROR_BITS))


def _set_flag(probe: Probe) -> None:
    for present in (True, False):
        bench.lk_drive(probe).trip("overcurrent", present)


def _clear_flag(probe: Probe) -> object:
    return probe.do(Verb.CLEAR_ERRORS)


def _protected(probe: Probe) -> float:
    return probe.read(Verb.READ_PROTECTION, "status")


def _ports(probe: Probe) -> float:
    return 2 * probe.read(Verb.READ_IO, "alm") + probe.read(Verb.READ_IO, "pend")


def _other_ports(probe: Probe, command: Command) -> Mapping[str, int]:
    now = int(_ports(probe))
    return {"alm_mask": _WRITE, "pend_mask": _WRITE, "alm": 1 - now // 2, "pend": 1 - now % 2}


def _own_ports(probe: Probe) -> object:
    return probe.do(Verb.WRITE_IO, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})


def _pulse_mode(probe: Probe, command: Command) -> Mapping[str, int]:
    return {"work_mode": declared.choice(command, "work_mode", declared.pulse_modes(probe.dialect)[0])}


def _moves_by_bus(probe: Probe) -> float:
    """Say whether the motor can be enabled, as in a bus mode alone."""
    return float(not motion.refused(probe, probe.ask(Verb.ENABLE, {"enabled": 1})))


def _another_group(probe: Probe) -> int:
    return next(group for group in setting_effects.GROUPS[2:] if group not in (probe.address, probe.rig.group))


def _forget_zero(probe: Probe) -> object:
    return probe.do(Verb.SET_ZERO_MODE, {"zero_mode": 0, "set_zero": 0, "zero_speed": 0, "zero_direction": 0})


def _without_zero(probe: Probe) -> None:
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    _forget_zero(probe)


def _goes_back(probe: Probe) -> float:
    """Bring the shaft away, restart, and return how far it is then from where it was left, in degrees within the turn.

    One that went back reads zero then, so it is left where the angle is none near zero.
    """
    motion.ready_to_move(probe)
    for _ in range(_AWAY_MOST):
        arriving.follow(probe, declared.any_move(probe.dialect), _OFF_ZERO)
        left = probe.read(Verb.READ_ENCODER_CARRY, "encoder")
        if _within_turn(probe, left) >= _OFF_ZERO:
            break
    restarts.restart(probe)
    motion.wait_standing(probe)
    return _within_turn(probe, probe.read(Verb.READ_ENCODER_CARRY, "encoder") - left)


def _within_turn(probe: Probe, counts: int) -> float:
    """Return the least angle between two places that are so many counts apart, in degrees."""
    turn = probe.dialect.counts_per_turn
    return min(counts % turn, -counts % turn) * 360 / turn


def _halt(probe: Probe) -> object:
    return probe.ask(Verb.EMERGENCY_STOP)


MOTION = Guarded(motion.ready_to_move, _motion_values, _shaft, _STILL)
#: What switches, renames or homes, by the name of the command.
_SWITCHES: Mapping[str, Guarded] = {
    "enable": Guarded(motion.ready_to_move, lambda probe, command: {"enabled": 0}, _is_on),
    # With what a user has set it may end at once: then it makes zero where the shaft stands.
    "home": Guarded(_away, _nothing, _shaft, _STILL, after=_halt),
    "motor_off": Guarded(_switch_on, _nothing, _is_on),
    "motor_on": Guarded(partial(motion.switch, on=False), _nothing, _is_on),
    "brake": Guarded(_release, lambda probe, command: {"brake_control": _POWER_OFF}, _brake, after=_release),
    "set_position": Guarded(motion.ready_to_move, _another_position, _shaft, _STILL),
}
_STOP = Guarded(_turn, lambda probe, command: {"acceleration": QUICK} if declared.of(command).acceleration else {}, _turns)
_NEW_BEGINNING = Guarded(_turn, _nothing, _turns_still, after=motion.ready_to_move, again=False)
#: What stops a shaft, and what shows beside: on buses alone whose frames tell their length. `facts` of their claims.
_MORE: Mapping[str, tuple[Guarded, Mapping[str, Any]]] = {
    "emergency_stop": (_STOP, {}),
    "stop_speed": (_STOP, {}),
    "stop": (_STOP, {}),
    "restart": (_NEW_BEGINNING, {}),
    "restore": (_NEW_BEGINNING, {"alone": True}),
    "calibrate": (Guarded(motion.ready_to_move, _nothing, _calibrates, after=_halt, again=False), {"by_name": True}),
    "write_io": (Guarded(motion.ready_to_move, _other_ports, _ports, after=_own_ports), {}),
    "release_protection": (Guarded(protect, _nothing, _protected), {"emulated": True, "settings": ("protection",)}),
    "clear_errors": (Guarded(_set_flag, _nothing, _has_flag, after=_clear_flag), {"emulated": True}),
    "clear_turns": (Guarded(_count_turns, _nothing, _shaft, _STILL), {}),
}
#: What else several drives are told at once.
_TO_MANY: Mapping[str, tuple[Guarded, Mapping[str, Any]]] = {
    **{name: _MORE[name] for name in ("calibrate", "write_io", "release_protection")},
    "set_work_mode": (Guarded(motion.ready_to_move, _pulse_mode, _moves_by_bus, after=motion.ready_to_move), {}),
    "set_group_address": (
        Guarded(
            motion.ready_to_move,
            lambda probe, command: {"group_address": _another_group(probe)},
            lambda probe: float(setting_effects.hears(probe, _another_group(probe))),
            sends=(Verb.ENABLE,),
        ),
        {"settings": ("group_address",)},
    ),
    "set_zero_mode": (
        Guarded(
            _without_zero,
            lambda probe, command: {"zero_mode": _NEAR, "set_zero": 1, "zero_speed": _FASTEST, "zero_direction": 0},
            _goes_back,
            _OFF_ZERO / 2,
            after=_forget_zero,
            sends=(Verb.RESTART,),
        ),
        {"settings": ("zero_mode", "set_zero", "zero_speed", "zero_direction")},
    ),
}
MOTIONS = (*MOVES, MotionKind.RUN, MotionKind.TORQUE)


def _all_guarded(dialect: Dialect) -> Iterator[Case]:
    """Yield what switches, renames or homes, and the motions of the LK drives: those of MKS stand with their frames."""
    if not declared.can_move(dialect):
        return
    for command in dialect.motions(*MOTIONS) if dialect.family == "lk" else ():
        yield Case(dialect, command, {"guarded": MOTION})
    for name, guarded in _SWITCHES.items():
        if name in dialect.by_name:
            yield Case(dialect, dialect.by_name[name], {"guarded": guarded})
    # Of LK 19h is kept in the flash, which wears.
    if dialect.family == "mks" and Verb.SET_ZERO in dialect.by_verb:
        zero = Guarded(_away, _nothing, _shaft, _STILL, after=motion.ready_to_move)
        yield Case(dialect, dialect.by_verb[Verb.SET_ZERO], {"guarded": zero})


def risks(case: Case) -> frozenset[Risk]:
    """Return what a claim about a guarded command may do."""
    command = command_of(case)
    switching = {Risk.TORQUE} if command.verb is Verb.MOTOR_ON else set[Risk]()
    run = case.dialect.by_verb.get(Verb.RUN_SPEED)
    if run is not None and case["guarded"].ready is _turn:
        switching |= run.all_risks - {Risk.UNKNOWN}
    switching |= {risk for verb in case["guarded"].sends for risk in case.dialect.by_verb[verb].all_risks - {Risk.UNKNOWN}}
    # A damaged frame with a head may be read as another one, where nothing tells its length.
    if case.dialect.link.first_bytes and not case.dialect.link.tells_length:
        switching.add(Risk.UNKNOWN)
    return declared.risks(case.dialect, *(command.all_risks - {Risk.UNKNOWN}), *switching)


def switches(dialect: Dialect) -> Iterator[Case]:
    """Yield what switches, homes, sets the zero or writes a port of the drives that hear several addresses."""
    if dialect.broadcast is not None:
        yield from (case for case in _all_guarded(dialect) if case["guarded"] is not MOTION)
        yield from _of_table(dialect, _TO_MANY)


def _of_table(dialect: Dialect, table: Mapping[str, tuple[Guarded, Mapping[str, Any]]]) -> Iterator[Case]:
    for name, (guarded, facts) in table.items():
        if name in dialect.by_name and declared.can_move(dialect):
            settings = declared.settings(dialect, *facts.get("settings", ()))
            yield Case(dialect, dialect.by_name[name], {"guarded": guarded}, {**facts, "settings": settings})


def every_guarded(dialect: Dialect) -> Iterator[Case]:
    """Yield them with what stops, clears or begins anew, on buses whose frames tell their length."""
    yield from _all_guarded(dialect)
    yield from _of_table(dialect, _MORE if dialect.link.tells_length else {})


def repeatable(dialect: Dialect) -> Iterator[Case]:
    """Yield those of them that show when they are sent whole."""
    return (case for case in every_guarded(dialect) if case["guarded"].again)


def leave(probe: Probe, guarded: Guarded) -> None:
    """Leave the motor on and the shaft at rest."""
    guarded.after(probe)
    motion.stand_still(probe)
