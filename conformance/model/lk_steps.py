"""What is drawn for the sessions of LK drives: kinds of steps, their values, and which kinds each variant has.

Rules kept here:
- Values are drawn within the bounds of the session's room; positions from where the shaft is.
- A move within the turn goes to an angle that is not where the shaft is: nobody can say whether that is no way or a turn.
- On hardware the gains of the loops are left alone.
"""

from __future__ import annotations

from collections.abc import Mapping

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from analyzer.catalogue import Risk, Verb
from conformance.claims import read_back_lk
from conformance.claims.ranges_lk_looks import MODERATE
from conformance.claims.read_back_lk import TURN
from conformance.model.lk import LkSession
from conformance.model.session import Kind

#: Speeds in rpm, and the longest move in turns, where no bound is lower.
FASTEST, SLOWEST, LONGEST = 300, 20, 0.75


def _nothing(session: LkSession) -> SearchStrategy[dict[str, int]]:
    return st.just({})


def _fastest(session: LkSession) -> int:
    return min(FASTEST, int(session.room.bounds.speed or FASTEST))


def _limits(session: LkSession) -> SearchStrategy[int]:
    return st.integers(min(SLOWEST * 600, _fastest(session) * 600), min(MODERATE, _fastest(session) * 600))


def _distances(session: LkSession) -> SearchStrategy[int]:
    units = int(min(LONGEST, session.room.bounds.turns or LONGEST) * TURN)
    return st.one_of(st.integers(units // 8, units), st.integers(-units, -units // 8))


def _draw_run(session: LkSession) -> SearchStrategy[dict[str, int]]:
    top = min(100, _fastest(session)) * 600
    return st.fixed_dictionaries({"speed": st.one_of(st.integers(SLOWEST * 300, top), st.integers(-top, -SLOWEST * 300))})


def _draw_increment(session: LkSession) -> SearchStrategy[dict[str, int]]:
    return st.fixed_dictionaries({"position": _distances(session), "max_speed": _limits(session)})


def _draw_free_increment(session: LkSession) -> SearchStrategy[dict[str, int]]:
    return st.fixed_dictionaries({"position": _distances(session)})


def _draw_multi(session: LkSession) -> SearchStrategy[dict[str, int]]:
    return st.fixed_dictionaries({"distance": _distances(session), "max_speed": _limits(session)})


def _draw_single(session: LkSession) -> SearchStrategy[dict[str, int]]:
    now = (session.turned + (session.at or 0)) % TURN
    angles = st.integers(TURN // 16, TURN - TURN // 16).map(lambda away: (now + away) % TURN)
    return st.fixed_dictionaries({"direction": st.integers(0, 1), "angle": angles, "max_speed": _limits(session)})


def _draw_position(session: LkSession) -> SearchStrategy[dict[str, int]]:
    return st.fixed_dictionaries({"position": st.integers(-10 * TURN, 10 * TURN)})


def _draw_parameter(session: LkSession) -> SearchStrategy[dict[str, int]]:
    allowed = session.probe.rig.allowed
    command = session.dialect.by_verb[Verb.WRITE_PARAMETER]
    which = [
        n
        for n, form in enumerate(session.forms)
        if command.risks({"parameter": read_back_lk.number_of(form)}) <= allowed
        and (session.probe.drive is not None or form.name.endswith(("_limit", "_ramp")))
    ]
    return st.fixed_dictionaries({"which": st.sampled_from(which), "values": st.integers(0, 1)})


def _stands(session: LkSession) -> bool:
    return not session.running and session.at is not None


def _writes(session: LkSession) -> bool:
    return bool(session.held)


def _unbounded_speed(session: LkSession) -> bool:
    return _stands(session) and session.room.bounds.speed is None


_MOVING = frozenset({Risk.MOTION})
_SETTING = frozenset({Risk.SETTING})
_TORQUE = frozenset({Risk.TORQUE})

_EVERY = (
    Kind("parameter_step", _draw_parameter, _writes, _SETTING),
    Kind("motor_on", _nothing, risks=_MOVING),
    Kind("motor_off", _nothing, risks=_TORQUE),
    Kind("stop", _nothing, lambda s: s.on, _MOVING),
    Kind("run_speed", _draw_run, risks=_MOVING | {Risk.UNBOUNDED}),
    Kind("move_increment", _draw_free_increment, _unbounded_speed, _MOVING),
    Kind("move_increment_limited", _draw_increment, _stands, _MOVING),
    Kind("move_multi_turn_limited", _draw_multi, _stands, _MOVING),
    Kind("move_single_turn_limited", _draw_single, _stands, _MOVING),
    Kind("set_position", _draw_position, _stands, _SETTING),
    Kind("clear_turns", _nothing, _stands, _SETTING),
    Kind("brake", _nothing, lambda s: _stands(s) and s.on, _TORQUE),
    Kind("look", _nothing),
)
KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _EVERY}

#: Which kinds of steps each variant draws; a name that stands twice is drawn twice as often.
VARIANTS: Mapping[str, tuple[str, ...]] = {
    "settings": ("parameter_step", "parameter_step", "set_position", "clear_turns", "brake", "motor_on", "motor_off", "look"),
    "motion": (
        "run_speed", "stop", "move_increment", "move_increment_limited", "move_multi_turn_limited", "move_single_turn_limited",
        "set_position", "look",
    ),
    "mixed": (
        "motor_on", "motor_on", "motor_off", "stop", "run_speed", "move_increment_limited", "move_multi_turn_limited",
        "move_single_turn_limited", "set_position", "clear_turns", "parameter_step", "brake", "look",
    ),
}  # fmt: skip
