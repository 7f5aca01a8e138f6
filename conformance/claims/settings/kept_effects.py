"""What shows a setting of its own that no drive reads back: one field at a time, some with hands on an emulated drive.

For claims about what a restart keeps and what a restore puts back; what a whole command shows stands in `setting_effects`.

Rules kept here:
- Each row sets one field to another value than its default, and leaves the others as they are by default.
- What is seen is compared with what was seen before, so that nothing depends on what the manual says of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from analyzer.catalogue import Command, Dialect, Verb
from conformance.claim import Inconclusive, NotRun
from conformance.claims import bench
from conformance.claims.motion import homing
from conformance.claims.settings.setting_effects import BY_VERB, GROUP, SettingEffect, by_action
from conformance.motion import declared, motion
from conformance.motion.declared import QUICK, SUBDIVISION
from conformance.talk.probe import MS, SECOND_NS, Probe

#: Where end stops and walls are put (counts, turns), and how far a motion goes that is to meet one.
_NEAR, _FAR_TURNS, _LONG_TURNS = 3000, 2, 4
#: Counts in which two places are one.
_ROUGH = 700
_HOMING = 5


@dataclass(frozen=True)
class Kept:
    """A stored field: what sets it, to what, and how it shows.

    `hands`: on an emulated drive alone. `not_on`: models that begin so do not show it.
    """

    name: str
    verb: Verb
    values: Mapping[str, int]
    effect: SettingEffect
    hands: bool = False
    not_on: str = ""


# --- with hands -------------------------------------------------------------------------------------------------------


def _protected(probe: Probe) -> int:
    """Hold the shaft, ask for a move, and return whether the drive protects itself."""
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    motion.prepare(probe, move)
    bench.hold(probe)
    motion.begin(probe, move, _FAR_TURNS * 360, rpm=120, acceleration=QUICK)
    probe.wait(4 * SECOND_NS)
    seen = probe.read(Verb.READ_PROTECTION, "status")
    motion.switch(probe, False)
    bench.hold(probe, False)
    probe.do(Verb.RELEASE_PROTECTION)
    return seen


def _went(probe: Probe, turns: float) -> int:
    """Return how far a move goes, in counts; what ends or refuses it is not asked."""
    before = bench.shaft(probe)
    for _ in range(2):
        # Drives were seen to ignore the command that follows a limit stop: it is sent again.
        move = probe.command(Verb.MOVE_RELATIVE_AXIS)
        if not motion.ask(probe, move, turns * 360, rpm=120, acceleration=QUICK).silent:
            break
    probe.wait(round(abs(turns) * SECOND_NS))
    motion.wait_standing(probe)
    motion.stop(probe)
    return round(bench.shaft(probe) - before)


def _home(probe: Probe) -> None:
    """Find an end stop clockwise of the shaft; another one stands counter-clockwise."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    bench.left_switch(probe, -_NEAR)
    bench.right_switch(probe, _FAR_TURNS * probe.dialect.counts_per_turn - _NEAR)
    homing.find_home(probe)
    probe.wait(500 * MS)
    probe.do(Verb.ENABLE, {"enabled": 1})


def _beyond_left(probe: Probe) -> int:
    """Return how far the shaft goes beyond the left end stop."""
    _home(probe)
    return _went(probe, -1)


def _beyond_right(probe: Probe) -> int:
    """Return how far the shaft goes towards the right end stop and beyond, with the end limit on."""
    homing.set_home(probe, end_limit=1)
    _home(probe)
    return _went(probe, _LONG_TURNS)


def _at_a_wall(probe: Probe) -> int:
    """Return where homing leaves the shaft that meets a wall before the end stop; where it does not end, 0."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    start = bench.shaft(probe)
    bench.left_switch(probe, -2 * _NEAR)
    bench.wall(probe, -_NEAR)
    probe.do(Verb.HOME)
    probe.wait(3 * SECOND_NS)
    ended, at = probe.read(Verb.READ_STATUS, "status") != _HOMING, bench.shaft(probe)
    probe.ask(Verb.EMERGENCY_STOP)
    bench.wall(probe, None)
    motion.wait_standing(probe)
    return round(at - start) if ended else 0


def _held_by_setting(probe: Probe) -> int:
    """Return whether the motor is enabled in a pulse mode with the En pin at its upper level."""
    motion.set_mode(probe, declared.pulse_modes(probe.dialect)[0])
    bench.enable_pin(probe, 1)
    seen = probe.read(Verb.READ_ENABLED)
    bench.enable_pin(probe, 0)
    return seen


def _roughly(probe: Probe, one: int, other: int) -> bool:
    return abs(one - other) <= _ROUGH


_DISTANCE = SettingEffect(see=_beyond_left, same=_roughly, moves=True, sends=((Verb.HOME, {}),))
_BEYOND_RIGHT, _WALL = replace(_DISTANCE, see=_beyond_right), replace(_DISTANCE, see=_at_a_wall)
_PIN = SettingEffect(see=_held_by_setting, moves=True, sends=((Verb.ENABLE, {"enabled": 1}),))
_PROTECTION = SettingEffect(see=_protected, moves=True, sends=((Verb.RELEASE_PROTECTION, {}),))

# --- the rows ---------------------------------------------------------------------------------------------------------

_HOME = {"home_trigger": 0, "home_direction": 0, "home_speed": 60, "end_limit": 0}
_HOMING_SHOWN = BY_VERB[Verb.SET_HOME]
_ROWS = (
    Kept("respond", Verb.SET_RESPOND, {"respond": 0, "active": 1}, BY_VERB[Verb.SET_RESPOND]),
    Kept("active", Verb.SET_RESPOND, {"respond": 1, "active": 0}, BY_VERB[Verb.SET_RESPOND]),
    Kept("subdivision", Verb.SET_SUBDIVISION, {"subdivision": 32}, BY_VERB[Verb.SET_SUBDIVISION]),
    Kept("group", Verb.SET_GROUP_ADDRESS, {"group_address": GROUP}, BY_VERB[Verb.SET_GROUP_ADDRESS]),
    Kept("home-direction", Verb.SET_HOME, _HOME | {"home_direction": 1}, _HOMING_SHOWN),
    Kept("home-speed", Verb.SET_HOME, _HOME | {"home_speed": 180}, _HOMING_SHOWN),
    # With an open switch for a closed one homing begins the other way.
    Kept("home-trigger", Verb.SET_HOME, _HOME | {"home_trigger": 1}, _HOMING_SHOWN),
    Kept("end-limit", Verb.SET_HOME, _HOME | {"end_limit": 1}, _DISTANCE, hands=True),
    # A 57 has a port for each switch.
    Kept("limit-remap", Verb.SET_LIMIT_REMAP, {"limit_remap": 1}, _BEYOND_RIGHT, hands=True, not_on="57"),
    Kept("home-mode", Verb.SET_NO_LIMIT_HOME, {"home_mode": 1, "return_angle": 0x1000}, _WALL, hands=True),
    Kept("protection", Verb.SET_PROTECTION, {"protection": 1}, _PROTECTION, hands=True),
    Kept("enable-level", Verb.SET_ENABLE_LEVEL, {"enable_level": 2}, _PIN, hands=True),
)


def rows(dialect: Dialect) -> Iterator[tuple[Command, Kept]]:
    """Yield the stored fields of a dialect that no read shows, each with its command."""
    for row in _ROWS:
        command = dialect.by_verb.get(row.verb)
        if command is None or command.readable or not row.values.keys() <= command.request_forms[0].layout.named.keys():
            continue
        if not row.hands and by_action(dialect, command) is None:
            continue
        yield command, row


def need_difference(probe: Probe, row: Kept, one: object, other: object) -> None:
    """Raise Inconclusive where what is seen of a field is what is seen of its default; NotRun where the model shows neither."""
    if row.not_on and probe.dialect.model.startswith(row.not_on):
        raise NotRun(f"a {probe.dialect.model} does not show {row.name}")
    if row.effect.same(probe, one, other):
        raise Inconclusive(f"{row.name} shows no difference: {row.effect.words(one)}")
