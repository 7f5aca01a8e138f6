"""What is read of a shaft that stands: on either side of zero, near it and turns away, on and off, in each work mode it has.

One walk over the places of a covering array is recorded; each read is judged by a claim of its own.

Rules kept here:
- The walk begins at a zero that is set there, so that small and wide values of either sign are read.
- A shaft that is let go may settle: where it then is, is what 31 says; the other reads are held against that.
- What tells a place within the turn is held against where the walk began; a turn has what fits one of the known widths.
- In a pulse mode the manual promises no status, and the En pin enables the motor. Without an encoder there is no place.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from analyzer.protocols.lk_rs485 import ERROR_BITS
from conformance.claims.declare import Case, commands
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.model import covering
from conformance.motion import declared, motion
from conformance.motion.declared import QUICK, SUBDIVISION
from conformance.talk.probe import Probe

#: Places in turns, the last ones beyond 16 bits of counts; the speed between them, which an open mode has too.
_PLACES = (4.6, 1.7, 0.3, -0.3, -1.7, -4.6)
_RPM = 360
#: The angle error of a loop that holds its place at most, and by how much a shaft that is let go may settle (degrees).
_LAG = 1.0
#: Pulses by which the count may differ from the place, in addition to the noise.
_PULSES = 2
_STOPPED = 1
#: The speed of a drive that tells no carry; what its places are called after them, in turns: as far as 32 bits hold.
_GOAL_RPM, _FAR = 240, (59_000.0, -59_000.0)
#: What is read.
_READS = (
    Verb.READ_POSITION,
    Verb.READ_ENCODER_CARRY,
    Verb.READ_PULSES,
    Verb.READ_SPEED,
    Verb.READ_STATUS,
    Verb.READ_ANGLE_ERROR,
    Verb.READ_ENABLED,
    Verb.READ_ZERO_STATUS,
    Verb.READ_PROTECTION,
    Verb.READ_STATE_1,
    Verb.READ_STATE_2,
    Verb.READ_SINGLE_TURN,
    Verb.READ_ENCODER,
)
_Values = Mapping[str, int]


class _Stand(NamedTuple):
    """A place in turns, a work mode, whether the motor is on, and what each read tells there.

    `turned`: how far the shaft is from where the walk began, in turns; the place may have been called otherwise since.
    """

    place: float
    mode: str
    on: bool
    told: Mapping[Verb, _Values]
    turned: float

    def __str__(self) -> str:
        """Return it for people."""
        return f"at {self.place:+g} turns{f' in {self.mode}' if self.mode else ''}, {'on' if self.on else 'off'}"


def _modes(dialect: Dialect) -> tuple[str, ...]:
    """Return the bus modes that have an encoder, and one pulse mode."""
    field = declared.field_of(dialect.by_verb[Verb.SET_WORK_MODE], "work_mode")
    modes = [mode for mode in field.choice_names.values() if "no_encoder" not in mode]
    by_bus = declared.bus_modes(dialect)
    return (*(m for m in modes if m in by_bus), next(m for m in modes if m not in by_bus))


def _walk(probe: Probe) -> list[_Stand]:
    """Stand at each place in each mode, on and off, and read everything."""
    dialect = probe.dialect
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    best = declared.bus_modes(dialect)[-1]
    motion.ready_to_move(probe, best, subdivision=SUBDIVISION)
    probe.do(Verb.SET_ZERO)
    found, at = [], 0.0
    factors = {"place": _PLACES, "mode": _modes(dialect), "on": (True, False)}
    for row in sorted(covering.rows(factors), key=lambda row: _PLACES.index(row["place"])):
        place, mode, on = row["place"], row["mode"], row["on"]
        if place != at:
            motion.ready_to_move(probe, best)
            motion.begin(probe, move, place * 360 - motion.position(probe).value, rpm=_RPM, acceleration=QUICK)
            motion.wait_standing(probe)
            at = place
        motion.set_mode(probe, mode)
        if mode in declared.bus_modes(dialect):
            motion.switch(probe, on)
        found.append(_Stand(place, mode, on, _told(probe), place))
    motion.ready_to_move(probe, best)
    return found


def _told(probe: Probe) -> dict[Verb, _Values]:
    reads = (verb for verb in _READS if verb in probe.dialect.by_verb)
    return {verb: dict(probe.reply(probe.ask(verb, quiet_ns=0)).values) for verb in reads}


def _walk_by_angles(probe: Probe) -> list[_Stand]:
    """Stand at each place, on and off, and read everything; at the last one call it places that are far away."""
    move, call = probe.command("move_increment_limited"), probe.command("set_position")
    motion.ready_to_move(probe)
    probe.do(call, {"position": 0})
    found: list[_Stand] = []
    rows = covering.rows({"place": _PLACES, "on": (True, False)})
    for row in sorted(rows, key=lambda row: _PLACES.index(row["place"])):
        motion.switch(probe, True)
        if not found or row["place"] != found[-1].place:
            here, at = motion.position(probe).value, found[-1].place * 360 if found else 0.0
            # A position that is far off is judged, and no way begins there.
            here = here if abs(here - at) <= 360 else at
            motion.begin(probe, move, row["place"] * 360 - here, rpm=_GOAL_RPM)
            motion.wait_standing(probe)
        motion.switch(probe, row["on"])
        found.append(_Stand(row["place"], "", row["on"], _told(probe), row["place"]))
    for place in _FAR:
        probe.do(call, {"position": declared.field_of(call, "position").wire(round(place * 360))})
        for on in (True, False):
            motion.switch(probe, on)
            found.append(_Stand(place, "", on, _told(probe), _PLACES[-1]))
    motion.switch(probe, True)
    return found


# --- what each read must tell -------------------------------------------------------------------------------------------


def _cases(dialect: Dialect) -> Iterator[Case]:
    if (
        declared.can_move(dialect)
        and Verb.MOVE_RELATIVE_AXIS in dialect.by_verb
        and (_tells_carry(dialect) or _by_angles(dialect))
    ):
        yield from commands(*_READS)(dialect)


def _tells_carry(dialect: Dialect) -> bool:
    return Verb.READ_ENCODER_CARRY in dialect.by_verb


def _by_angles(dialect: Dialect) -> bool:
    """Say whether a place is counted in angles, and can be called another one."""
    return Verb.READ_SINGLE_TURN in dialect.by_verb and "set_position" in dialect.by_name


def _counts(stand: _Stand) -> int:
    return stand.told[Verb.READ_POSITION]["position"]


def _expected(probe: Probe, verb: Verb, stand: _Stand, first: _Stand) -> tuple[Any, Any, float]:
    """Return what a read tells, what it must tell, and by how much it may differ; the same twice where nothing is promised."""
    turn, told = probe.dialect.counts_per_turn, stand.told[verb]
    in_bus_mode = stand.mode in declared.bus_modes(probe.dialect)
    value = next(iter(told.values()), 0)
    if verb is Verb.READ_POSITION:
        return value * 360 / turn, stand.place * 360, motion.miss(probe) + _LAG
    if verb is Verb.READ_ENCODER_CARRY:
        return told["carry"] * turn + told["encoder"], _counts(stand), probe.within("counts")
    if verb is Verb.READ_PULSES:
        # The sense of pulses is not told.
        per_turn = declared.units_per_turn(probe.dialect, probe.command(Verb.MOVE_RELATIVE_PULSES), SUBDIVISION)
        sense = 1 if first.told[verb]["pulses"] * first.place > 0 else -1
        within = _PULSES + (motion.miss(probe) + _LAG) * per_turn / 360
        return value, stand.place * per_turn * sense, within
    if verb is Verb.READ_SPEED:
        return value, 0, 0.9 + probe.noise.rpm
    if verb is Verb.READ_STATUS:
        return (value, _STOPPED, 0) if in_bus_mode else (0, 0, 0)
    if verb is Verb.READ_ANGLE_ERROR:
        field = probe.command(verb).reply_forms[0].layout.named["angle_error"]
        return float(field.physical(value)), 0, _LAG + probe.noise.place
    if verb is Verb.READ_ENABLED:
        return (value, int(stand.on), 0) if in_bus_mode else (0, 0, 0)
    return value, next(iter(first.told[verb].values())), 0


#: How many units a turn may have in the fields that tell a place within it; flags, which stay.
_TURNS = {"encoder": (1 << 14, 1 << 15, 1 << 16), "angle": (36_000,)}
_FLAGS = frozenset(field.name for field in ERROR_BITS)


def _risks(case: Case) -> frozenset[Risk]:
    if _tells_carry(case.dialect):
        return risks_by(Verb.SET_ZERO, Verb.ENABLE, Verb.SET_WORK_MODE, Verb.MOVE_RELATIVE_AXIS)(case)
    moved = risks_by(Verb.MOTOR_OFF, Verb.MOTOR_ON, Verb.MOVE_RELATIVE_AXIS)(case)
    return moved | case.dialect.by_name["set_position"].all_risks


def _expected_by_angles(probe: Probe, verb: Verb, stand: _Stand, first: _Stand) -> Iterator[tuple[Any, Any, float]]:
    """Yield what each field of a read tells, what it must tell, and by how much it may differ."""
    told, before = stand.told[verb], first.told[verb]
    near = motion.miss(probe) + _LAG
    for name in told:
        if name == "position":
            yield told[name] / 100, stand.place * 360, near
        elif name == "speed":
            yield told[name], 0, probe.within("deg/s")
        elif name == "state":
            yield told[name] == 0, stand.on, 0
        elif name in _TURNS:
            turned = (stand.turned - first.turned) * 360
            off = [((told[name] - before[name]) * 360 / turn - turned + 180) % 360 - 180 for turn in _TURNS[name]]
            yield min(off, key=abs), 0, near
        elif name in _FLAGS:
            yield told[name], before[name], 0


@of_motion(
    each=_cases,
    name="{command}/standing",
    refuted_by="another value at one place, in one mode, on or off",
    at_best=Certainty.LIKELY,
    risks=_risks,
    settings=lambda case: ("position",) if _by_angles(case.dialect) else (),
)
def _standing(probe: Probe, command: Command) -> None:
    """{command} tells what holds where the shaft stands: either side of zero, near and far, on and off, in each mode."""
    first, *_ = stands = probe.recorded(_walk if _tells_carry(probe.dialect) else _walk_by_angles)
    for stand in stands:
        every = (
            [_expected(probe, command.verb, stand, first)]
            if _tells_carry(probe.dialect)
            else _expected_by_angles(probe, command.verb, stand, first)
        )
        for got, wanted, within in every:
            text, expected = f"{command.name} tells {got:g} {stand}", f"{wanted:g} +-{within:.3g}"
            probe.expect(f"{got:g}", holds=abs(got - wanted) <= within, expected=expected, refutes=text, key=command.name)
