"""What is drawn for the sessions of MKS drives: kinds of steps, their values, and which kinds each variant has.

Rules kept here:
- Values are drawn within the bounds of the session's room, and those of settings from the catalogue.
- On hardware nothing is set that the motor cannot move without, or that a switch decides (`_STRONG`).
- Speeds are as sent: at a finer subdivision than 16 the shaft turns slower.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from analyzer.catalogue import Command, Risk, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.gate.drawing import Room
from conformance.model import limits, strategies
from conformance.model.mks import MksSession, settable
from conformance.model.session import Kind
from conformance.motion import moves
from conformance.talk import samples

#: The longest move, in turns, and speeds and accelerations of motion where no bound is lower.
LONGEST, SLOWEST, FASTEST, GENTLEST, STEEPEST = 0.5, 30, 300, 200, 249
#: Settings that a motor cannot move without, or that a switch decides: left alone where the motor is to move for real.
_STRONG = frozenset({"current", "home_current", "holding_current", "stall_tolerance", "end_limit", "limit_remap", "protection"})
#: Settings that motion depends on.
TELLING = (Verb.SET_WORK_MODE, Verb.SET_SUBDIVISION, Verb.SET_RESPOND, Verb.SET_DIRECTION, Verb.SET_AXIS_LOCK)


def _values(session: MksSession, command: Command, *, telling: bool) -> SearchStrategy[dict[str, int]]:
    form = command.request_forms[0]
    drawn: dict[str, Any] = {"command": st.just(command.code)}
    plain = samples.sample(session.dialect, command, form)
    for name, field in form.layout.named.items():
        if name in _STRONG and (session.probe.drive is None or telling):
            drawn[name] = st.just(plain[name])
        elif telling and name == "subdivision":
            drawn[name] = st.sampled_from([n for n in (128, 0, 16, 64, 32) if field.allows(n)])
        else:
            drawn[name] = strategies.inside(field, session.room)
    return st.fixed_dictionaries(drawn)


@dataclass(frozen=True)
class _Drawn:
    """What strategies of settings depend on; they are made once for each."""

    dialect: str
    model: str
    allowed: frozenset[Risk]
    real: bool
    room: Room
    what: str


_made: dict[_Drawn, SearchStrategy[dict[str, int]]] = {}


def _kept(what: str, make: Callable[[MksSession], SearchStrategy[dict[str, int]]]) -> Any:
    def draw(session: MksSession) -> SearchStrategy[dict[str, int]]:
        rig = session.probe.rig
        real = session.probe.drive is None
        key = _Drawn(session.dialect.name, session.dialect.model, rig.allowed, real, session.room, what)
        if key not in _made:
            _made[key] = make(session)
        return _made[key]

    return draw


def _settings(session: MksSession) -> SearchStrategy[dict[str, int]]:
    return st.one_of([_values(session, c, telling=False) for c in settable(session)])


def _telling(session: MksSession) -> SearchStrategy[dict[str, int]]:
    # The subdivision changes what most of the others do, so it is drawn more often.
    chosen = [c for v in (Verb.SET_SUBDIVISION, *TELLING) for c in settable(session) if c.verb is v]
    return st.one_of([_values(session, c, telling=True) for c in chosen])


def _strays(session: MksSession) -> SearchStrategy[dict[str, int]]:
    drawn = []
    for command in settable(session):
        layout = command.request_forms[0].layout
        if any(limits.beyond(f) for f in layout.named.values()):
            drawn.append(st.tuples(st.just(command.code), strategies.strays(layout, session.room)))
    return st.one_of(drawn).map(lambda pair: {"command": pair[0], **pair[1].values})


def _paces(session: MksSession) -> dict[str, Any]:
    """Return strategies of speed and acceleration within the bounds."""
    bounds = session.room.bounds
    fastest = min(FASTEST, int(bounds.speed or FASTEST))
    steepest = min(STEEPEST, int(bounds.acceleration or STEEPEST))
    slowest, gentlest = min(SLOWEST, fastest), min(GENTLEST, steepest)
    return {"speed": st.integers(slowest, fastest), "acceleration": st.integers(gentlest, steepest)}


def _draw_run(session: MksSession) -> SearchStrategy[dict[str, int]]:
    return st.fixed_dictionaries({"direction": st.integers(0, 1), **_paces(session)})


def _draw_move(unit: str) -> Any:
    def draw(session: MksSession) -> SearchStrategy[dict[str, int]]:
        longest = min(LONGEST, session.room.bounds.turns or LONGEST)
        # Half a turn at 16 subdivisions, less at finer ones.
        units = int(longest * (COUNTS_PER_TURN if unit == "counts" else 3200))
        amounts = st.one_of(st.integers(units // 8, units), st.integers(-units, -units // 8))
        return st.fixed_dictionaries({unit: amounts, **_paces(session)})

    return draw


def _nothing(session: MksSession) -> SearchStrategy[dict[str, int]]:
    return st.just({})


def _draw_enable(session: MksSession) -> SearchStrategy[dict[str, int]]:
    lets_go = Risk.TORQUE in session.probe.rig.allowed
    # To a motor that may be enabled already, letting go is what changes something.
    return st.fixed_dictionaries({"enabled": st.sampled_from(([0, 1] if session.enabled else [1, 0]) if lets_go else [1])})


def _draw_stop(session: MksSession) -> SearchStrategy[dict[str, int]]:
    motions = st.integers(0, len(moves.STOP_OF) - 1)
    return st.fixed_dictionaries({"motion": motions, "acceleration": _paces(session)["acceleration"]})


def _draw_user_id(session: MksSession) -> SearchStrategy[dict[str, int]]:
    return st.fixed_dictionaries({"user_id": st.integers(0, 0xFFFFFFFF)})


def _stands(session: MksSession) -> bool:
    return not session.running


def _by_bus(session: MksSession) -> bool:
    return session.by_bus


def _can_stop(session: MksSession) -> bool:
    return not session.by_bus or session.enabled is True


_MOVING = frozenset({Risk.MOTION})
_SETTING = frozenset({Risk.SETTING})
_RESTARTING = frozenset({Risk.TORQUE, Risk.POWER_ON})

_EVERY = (
    Kind("setting", _kept("setting", _settings), risks=_SETTING),
    Kind("telling", _kept("telling", _telling), _stands, _SETTING),
    Kind("stray", _kept("stray", _strays), risks=_SETTING),
    Kind("user_id", _draw_user_id, lambda s: Verb.WRITE_USER_ID in s.dialect.by_verb, _SETTING),
    Kind("restart", _nothing, risks=_RESTARTING),
    Kind("enable", _draw_enable, risks=_MOVING),
    Kind("emergency_stop", _nothing, _by_bus, _MOVING),
    Kind("stop", _draw_stop, _can_stop, _MOVING),
    Kind("run_speed", _draw_run, risks=_MOVING | {Risk.UNBOUNDED}),
    Kind("move_relative_pulses", _draw_move("pulses"), _stands, _MOVING),
    Kind("move_absolute_pulses", _draw_move("pulses"), _stands, _MOVING),
    Kind("move_relative_axis", _draw_move("counts"), _stands, _MOVING),
    Kind("move_absolute_axis", _draw_move("counts"), _stands, _MOVING),
    Kind("set_zero", _nothing, _stands, _SETTING),
    Kind("look", _nothing),
)
KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _EVERY}

#: Which kinds of steps each variant draws; a name that stands twice is drawn twice as often.
VARIANTS: Mapping[str, tuple[str, ...]] = {
    "settings": ("setting", "setting", "stray", "user_id", "restart", "look"),
    "motion": (
        "run_speed", "stop", "move_relative_pulses", "move_absolute_pulses", "move_relative_axis", "move_absolute_axis",
        "emergency_stop", "set_zero", "look",
    ),
    "mixed": (
        "telling", "telling", "stray", "enable", "enable", "restart", "run_speed", "stop", "move_relative_pulses",
        "move_absolute_axis", "move_relative_axis", "move_absolute_pulses", "emergency_stop", "set_zero", "look",
    ),
}  # fmt: skip
