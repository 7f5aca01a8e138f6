"""How an LK drive can misbehave: makers of changes to the drive itself and to what its commands do.

    acting("stop", nothing)                  what a command does instead
    acting("stop", clear_turns, after=True)  what it does besides
    moving(INCREMENTS, as_absolute)          the same for motion commands

Rules kept here:
- A command is named as in the catalogue. A motion command does something else only while the drive obeys.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

from analyzer.protocols.lk_rs485 import DIALECT
from conformance.drives.drive import Drive, Request
from conformance.drives.faults.places import LK, Change
from conformance.drives.lk.drive import ACTS, Act, LkDrive
from conformance.drives.lk.motor import Goal, LkMotor, Torque

#: Commands that end at a position counted over all turns, at an angle within one, or at a distance.
MULTI_TURN = ("move_multi_turn", "move_multi_turn_limited")
SINGLE_TURN = ("move_single_turn", "move_single_turn_limited")
INCREMENTS = ("move_increment", "move_increment_limited")


def lk(drive: Drive) -> LkDrive:
    """Return a drive as the LK drive that it is."""
    return cast(LkDrive, drive)


def turns(drive: LkDrive) -> bool:
    """Say whether the shaft turns, by a degree a second at least."""
    return abs(drive.motor.motion.speed) >= 1


def backwards(drive: LkDrive) -> bool:
    """Say whether the shaft turns counter-clockwise."""
    return drive.motor.motion.speed <= -1


def tuned(change: Callable[[LkDrive], None]) -> Change:
    """Change the drive itself, once."""
    return Change(lambda hooks: hooks.setup.append(lambda drive: change(lk(drive))), LK)


def at_power_up(change: Callable[[LkDrive], None]) -> Change:
    """Do something after each power-up but the first."""
    return Change(lambda hooks: hooks.powered.append(lambda drive: change(lk(drive))), LK)


def replaced(names: str | tuple[str, ...], act: Callable[[Act, LkDrive, Request], None]) -> Change:
    """Change what commands do. `act` gets what the command does by the manual, the drive and the request."""
    commands = (names,) if isinstance(names, str) else names
    return tuned(lambda drive: drive.acts.update({name: partial(act, drive.acts[name]) for name in commands}))


def undone(names: str | tuple[str, ...], when: Callable[[LkDrive, Request], bool]) -> Change:
    """Answer commands in a condition, and do nothing."""

    def act(old: Act, drive: LkDrive, request: Request) -> None:
        if not when(drive, request):
            old(drive, request)

    return replaced(names, act)


def acting(names: str | tuple[str, ...], act: Act, *, after: bool = False) -> Change:
    """Let commands do something else, or something more after what the manual says."""

    def both(old: Act, drive: LkDrive, request: Request) -> None:
        if after:
            old(drive, request)
        act(drive, request)

    return replaced(names, both)


def moving(names: tuple[str, ...], act: Act, *, after: bool = False) -> Change:
    """Let motion commands do something else, or something more; they do it only while the drive obeys."""

    def obedient(drive: LkDrive, request: Request) -> None:
        if after or drive.obeys:
            act(drive, request)

    return acting(names, obedient, after=after)


def nothing(drive: LkDrive, request: Request) -> None:
    """Do nothing."""


def rebuilt(**changes: float) -> Change:
    """Give the drive a motor that is built otherwise."""
    return tuned(lambda drive: drive.motor.rebuilt(**changes))


def learning(name: str, models: tuple[str, ...]) -> Change:
    """Let the models that lack a command have it."""

    def learn(drive: LkDrive) -> None:
        if drive.dialect.model not in models:
            drive.learn(DIALECT.by_name[name], ACTS[name])

    return tuned(learn)


@dataclass(frozen=True)
class _Unlimited(Torque):
    """A torque for which no limit holds, and which is told as if it did."""

    def push(self, motor: LkMotor) -> float:
        return self.torque


def told_as_limited(drive: LkDrive) -> None:
    """Let no limit hold for a torque below 0, and tell it as limited."""
    go = drive.motor.go
    drive.motor.go = lambda goal: go(  # type: ignore[method-assign]
        _Unlimited(goal.torque) if isinstance(goal, Torque) and goal.torque < 0 else goal
    )


def limited_one_way(drive: LkDrive) -> None:
    """Let no limit hold for a torque below 0."""
    go = drive.motor.go

    def begin(goal: Goal) -> None:
        below = isinstance(goal, Torque) and goal.torque < 0
        drive.motor.limits = replace(drive.limits, torque=1e9) if below else drive.limits
        go(goal)

    drive.motor.go = begin  # type: ignore[method-assign]
