"""The conditions of a walk (`model.route`), as rows in which any two of them meet.

    work mode x on or off x subdivision x direction x replies       the state of the drive
    standing, rising, running or moving, either way                 what the shaft does meanwhile
    to the drive, to all, to its group, in a slot of a package      how the deed reaches it
    each command that is no read, inside and outside its limits     the deed

Rules kept here:
- Settings that motion depends on are sent only while the shaft stands: how they affect a motion no manual says.
- Nothing of the link but the group, of the flash or of power-on, and nothing that searches or calibrates.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from conformance.model import covering, limits
from conformance.model.asides import Way, ways
from conformance.model.values import SUBDIVISIONS
from conformance.motion import declared
from conformance.motion.declared import MOVES

#: What cannot be put back by a setting, or that other hands are needed for.
_NOT_DONE = frozenset({Risk.LINK, Risk.DESTRUCTIVE, Risk.WEAR})
_NOT_MOVED = frozenset({MotionKind.CALIBRATE, MotionKind.TORQUE})
#: Settings that motion depends on, and what gives a place another name.
_OF_STANDING = frozenset(
    {
        Verb.SET_SUBDIVISION,
        Verb.SET_DIRECTION,
        Verb.SET_RESPOND,
        Verb.SET_WORK_MODE,
        Verb.SET_ZERO,
        Verb.RESTART,
        Verb.WRITE_PARAMETER,
        Verb.BRAKE,
        Verb.CLEAR_TURNS,
        Verb.SET_CURRENT,
    }
)


class Deed(NamedTuple):
    """A command, and whether it is sent as it may be (`way`: of a motion), or outside its limits."""

    name: str
    way: int = 0
    stray: bool = False


def is_done(command: Command) -> bool:
    """Say whether a walk sends a command that is no read."""
    risks = command.all_risks
    if command.verb is Verb.SET_GROUP_ADDRESS:
        return True
    if command.slots is not None or risks == {Risk.READ} or risks & _NOT_DONE:
        return False
    if command.motion is not None and command.motion.kind in _NOT_MOVED:
        return False
    return Risk.POWER_ON not in risks or command.verb is Verb.RESTART or command.verb is Verb.SET_NO_LIMIT_HOME


def deeds(dialect: Dialect) -> tuple[Deed, ...]:
    """Return all that is done."""
    found = []
    for command in (c for c in dialect.commands if is_done(c)):
        kind = command.motion.kind if command.motion is not None else None
        if kind in (MotionKind.RUN, *MOVES):
            found += [Deed(command.name, 1), Deed(command.name, -1)]
            continue
        found.append(Deed(command.name))
        if kind is None and any(limits.beyond(f) for form in command.request_forms for f in form.layout.named.values()):
            found.append(Deed(command.name, 0, True))
    return tuple(found)


def _factors(dialect: Dialect) -> dict[str, Sequence[Any]]:
    verbs = dialect.by_verb
    found: dict[str, Sequence[Any]] = {}
    if Verb.SET_WORK_MODE in verbs:
        modes = declared.field_of(verbs[Verb.SET_WORK_MODE], "work_mode").choice_names.values()
        bus = declared.bus_modes(dialect)
        found["mode"] = (*(m for m in bus if "no_encoder" not in m), next(m for m in modes if m not in bus))
    found["on"] = (1, 0)
    if Verb.SET_SUBDIVISION in verbs:
        found["subdivision"] = SUBDIVISIONS
    if Verb.SET_DIRECTION in verbs:
        found["direction"] = (0, 1)
    if Verb.SET_RESPOND in verbs:
        found["replies"] = ((1, 1), (1, 0), (0, 1), (0, 0))
    kinds = ("run", "move") if dialect.ramp is None else ("run", "move", "rise")
    found["going"] = (0, *((kind, way) for kind in kinds for way in (1, -1)))
    found["way"] = ways(dialect)
    found["deed"] = deeds(dialect)
    return found


@cache
def rows_of(dialect_name: str, model: str) -> tuple[dict[str, Any], ...]:
    """Return the rows for a model of a dialect: a level of each factor, by name."""
    dialect = registry.get(dialect_name)
    dialect = dialect.for_model(model) if model else dialect
    factors = _factors(dialect)
    verbs = {command.name: command for command in dialect.commands}
    bus = declared.bus_modes(dialect) if "mode" in factors else ()
    # Motions over motions one by one, all else over a run one way and a move the other way.
    rules: list[covering.Rule] = [
        lambda going, deed: not going or not (verbs[deed.name].verb in _OF_STANDING or deed.name == "set_position"),
        lambda going, deed: verbs[deed.name].motion is not None or going in (0, ("run", 1), ("move", -1)),
        lambda way, deed: way == Way.OWN or not (deed.stray or verbs[deed.name].verb is Verb.SET_GROUP_ADDRESS),
        # A stop has something to stop, a homing begins at rest.
        lambda going, deed: going or not verbs[deed.name].motion or declared.of(verbs[deed.name]).kind is not MotionKind.STOP,
        lambda going, deed: not going or verbs[deed.name].verb is not Verb.HOME,
    ]
    if "replies" in factors:
        # Only motion commands can be silenced.
        rules.append(lambda deed, replies: verbs[deed.name].motion is not None or replies in ((1, 1), (0, 0)))
    if "subdivision" in factors:
        rules.append(lambda deed, subdivision: verbs[deed.name].motion is not None or subdivision == SUBDIVISIONS[2])
    able = factors | {"on": (1,)} | ({"mode": tuple(m for m in factors["mode"] if m in bus)} if bus else {})
    found = covering.rows(able, *rules)
    # Where nothing moves each deed is refused, or done without a motion.
    unable = {name: levels for name, levels in factors.items() if name in ("mode", "on", "deed")} | {"going": (0,)}
    unable["deed"] = tuple(d for d in unable["deed"] if verbs[d.name].verb is not Verb.HOME and not d.stray)
    still = [lambda on, mode: (on and mode not in bus) or (not on and mode in bus)] if bus else [lambda on: not on]
    return found + covering.rows(unable, *still)
