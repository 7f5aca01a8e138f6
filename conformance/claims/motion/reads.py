"""Reads of a moving shaft: position, speed, pulses and error follow the shaft, and agree with each other.

Two reads of one quantity are compared (30 and 31, 31 and 32, 31 and 33; LK 92 and 94). So a wrong one shows after any motion.

Rules kept here:
- A turn is 16384 counts of an MKS encoder and 3200 pulses at 16 subdivisions.
- Both sides of zero are looked at: a sign or a width that is wrong often shows only there.
- An angle error needs a shaft that is held: an emulated drive's can be.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from itertools import pairwise
from typing import NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Verb
from conformance.claim import Aspect, Inconclusive, NotRun, Theme
from conformance.claims import bench
from conformance.claims.declare import Case, claim, commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import QUICK, SUBDIVISION
from conformance.talk import settings
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe
from conformance.talk.restarts import restart

_RPM = 120
#: The speed of moves whose end is what counts, in rpm.
_QUICK_RPM = 360
#: More counts than 24 signed bits hold, in turns.
_WIDE_TURNS = 530
#: The speed of the way back from there (rpm), and how late its end may be.
_BACK_RPM, _LATE_NS = 1500, 200 * MS
#: The angle error of a loop that holds its place, at most, in degrees.
_LAG = 1.0
#: What the version tells of the bare encoder.
_CW_RAISES, _CW_LOWERS = 1, 2
#: Angles by which the shaft is turned before something is read, in degrees: no two alike within a turn.
PLACES = (37.3, 101.7, 203.1, -171.9, 59.4)
_by_pulses = risks_by(Verb.MOVE_RELATIVE_PULSES)


# --- the position -----------------------------------------------------------------------------------------------------


def _counts(probe: Probe) -> int:
    return probe.read(Verb.READ_POSITION, "position")


def _move_by_pulses(probe: Probe, turns: float) -> None:
    arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_PULSES), turns * 360, rpm=_QUICK_RPM, acceleration=QUICK)


def _counted_positions(dialect: Dialect) -> Iterable[Case]:
    """Return the read of the position where the dialect tells how many counts a turn has."""
    return commands(Verb.READ_POSITION)(dialect) if dialect.counts_per_turn else ()


@of_motion(each=_counted_positions, refuted_by="another change", risks=_by_pulses)
def _turn(probe: Probe) -> None:
    """A turn of the shaft (3200 pulses at 16 subdivisions) changes the position by 16384."""
    motion.prepare(probe, probe.command(Verb.MOVE_RELATIVE_PULSES))
    for turns in (1, -1):
        before = _counts(probe)
        _move_by_pulses(probe, turns)
        change, wanted = abs(_counts(probe) - before), probe.dialect.counts_per_turn
        text = "a turn of the shaft is another number of counts"
        probe.expect(change, near=wanted, unit="counts", refutes=text)


def _with_places(dialect: Dialect) -> Iterable[Case]:
    """Return the read of carry and value where a move to a place counts as the encoder does."""
    return commands(Verb.READ_ENCODER_CARRY)(dialect) if Verb.MOVE_ABSOLUTE_AXIS in dialect.by_verb else ()


@of_motion(
    each=_with_places,
    refuted_by="a value beyond 3FFFh, or a carry that comes early or late",
    risks=risks_by(Verb.MOVE_ABSOLUTE_AXIS),
)
def _at_the_carry(probe: Probe, command: Command) -> None:
    """On either side of a whole turn, count by count, carry x 16384 + value is the place, and the value is within a turn."""
    move, turn = probe.command(Verb.MOVE_ABSOLUTE_AXIS), probe.dialect.counts_per_turn
    motion.prepare(probe, move)
    # About zero, wherever the shaft is: a carry without its sign is one elsewhere too.
    probe.do(Verb.SET_ZERO)
    for place in (carry * turn + beside for carry in (1, -1, 0) for beside in (-2, -1, 0, 1, 2)):
        exchange = motion.begin(
            probe, move, (place - motion.place(probe, move)) * 360 / turn, rpm=_QUICK_RPM, acceleration=QUICK
        )
        motion.wait_standing(probe)
        exchange = probe.ask(command)
        values = probe.reply(exchange).values
        probe.expect(values["encoder"], at_most=turn - 1, refutes="the value is more than a turn", exchange=exchange)
        together = values["carry"] * turn + values["encoder"]
        text = "carry and value are not the place beside a whole turn"
        probe.expect(together, near=_counts(probe), unit="counts", refutes=text, exchange=exchange)


@of_motion(each=_counted_positions, refuted_by="a position that stays", emulated=True, risks=risks_by(Verb.ENABLE))
def _while_disabled(probe: Probe) -> None:
    """The position follows the shaft while the motor is disabled."""
    motion.ready_to_move(probe)
    _counts(probe)
    motion.switch(probe, False)
    for turned in (3000, -20_000):
        before = _counts(probe)
        bench.drive_of(probe).turn_shaft(turned)
        text = "the position does not follow the shaft of a disabled motor"
        probe.expect(_counts(probe) - before, near=turned, unit="counts", refutes=text)
    motion.switch(probe, True)


def _switch_inputs(dialect: Dialect) -> Iterable[Case]:
    """Return the read of the ports where the home switch is at IN_1 on every model."""
    return commands(Verb.READ_IO)(dialect) if dialect.bus == "serial" else ()


@of_motion(each=_switch_inputs, name="{command}/in_1", refuted_by="a bit that stays", emulated=True, still=True)
def _shows_switch(probe: Probe, command: Command) -> None:
    """Bit 0 changes when the switch at IN_1 opens or closes."""
    for _ in range(2):
        levels = []
        for pressed in (True, False):
            bench.press(probe, pressed)
            levels.append(probe.read(command, "in_1"))
        text = "IN_1 does not tell whether its switch is closed"
        probe.expect(levels, holds=levels[0] != levels[1], expected="two levels", refutes=text)


@of_motion(
    each=_counted_positions,
    statement=f"The position counts on over {_WIDE_TURNS} turns, more than 24 bits hold; a move to a place begins there.",
    refuted_by="a position that begins anew, or a shaft that goes elsewhere",
    risks=risks_by(Verb.RUN_SPEED, Verb.SET_ZERO, Verb.MOVE_ABSOLUTE_AXIS),
)
def _wide(probe: Probe) -> None:
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    before = motion.position(probe)
    # Downwards: a shaft that begins near zero passes it, and the end of 24 bits with a sign.
    exchange = motion.run_at(probe, -3000, 255)
    probe.wait(int(_WIDE_TURNS / 3000 * 60 * SECOND_NS))
    motion.stop(probe, 255)
    turns = (before.value - motion.wait_standing(probe).value) / 360
    least, most = _WIDE_TURNS * 0.97, _WIDE_TURNS * 1.2
    missed, back = undamaged(probe, _to_a_place_from_afar) if least <= abs(turns) <= most else (0.0, exchange)
    # So far from its zero a move to a place could not go on.
    probe.do(Verb.SET_ZERO)
    text = "the position does not count on"
    probe.expect(abs(turns), at_least=least, at_most=most, unit="turns", refutes=text, exchange=exchange)
    text, within = (
        "a move to a place goes elsewhere from more counts than 24 bits hold",
        motion.miss(probe) + motion.same(probe),
    )
    probe.expect(missed, near=0, within=within, unit="degrees from there", refutes=text, exchange=back)


def _to_a_place_from_afar(probe: Probe) -> tuple[float, Exchange]:
    """Move up to a place that a command can name; return by how many degrees the shaft misses it, and the exchange.

    A shaft that goes elsewhere is stopped when it should be there.
    """
    move, here, turn = probe.command(Verb.MOVE_ABSOLUTE_AXIS), _counts(probe), probe.dialect.counts_per_turn
    target = max(declared.distance_of(move).low, here + 2 * turn)
    degrees = (target - here) * 360 / turn
    exchange = motion.ask(probe, move, degrees, rpm=_BACK_RPM, acceleration=QUICK, start=here)
    law_ns = int(ramp.move_ns(degrees / 360, _BACK_RPM, QUICK))
    arriving.come_to_rest(probe, exchange, law_ns, law_ns + _LATE_NS)
    return (_counts(probe) - target) * 360 / turn, exchange


@of_motion(each=commands(Verb.READ_PULSES), refuted_by="another number, or the same way for both", risks=_by_pulses)
def _counts_moves(probe: Probe, command: Command) -> None:
    """The count of pulses changes by the pulses of a move, up for one direction and down for the other."""
    motion.prepare(probe, probe.command(Verb.MOVE_RELATIVE_PULSES))
    changes = []
    for turns in (0.3, -0.7, 1.5):
        before = probe.read(command, "pulses")
        _move_by_pulses(probe, turns)
        changes.append(probe.read(command, "pulses") - before)
        text = "the count of pulses does not change by those of the move"
        probe.expect(abs(changes[-1]), near=round(abs(turns) * 3200), within=1, refutes=text)
    probe.expect(
        f"{changes[0]:+d} and {changes[1]:+d}",
        holds=changes[0] * changes[1] <= 0,
        expected="two ways",
        refutes="the count of pulses changes the same way for both directions",
    )


@of_motion(each=commands(Verb.READ_PULSES), name="{command}/wide", refuted_by="a count that begins anew", risks=_by_pulses)
def _wide_pulses(probe: Probe, command: Command) -> None:
    """The count of pulses goes on beyond 16 bits, above and below zero."""
    move, finest = probe.command(Verb.MOVE_RELATIVE_PULSES), 256
    motion.ready_to_move(probe, subdivision=declared.finest(probe.dialect))
    for turns in (2, -4):
        before = probe.read(command, "pulses")
        arriving.follow(probe, move, turns * 360, rpm=180, acceleration=QUICK, subdivision=finest)
        change = abs(probe.read(command, "pulses") - before)
        wanted = abs(turns) * declared.units_per_turn(probe.dialect, move, finest)
        probe.expect(change, near=wanted, within=1, refutes="the count of pulses does not change by those of a long move")


# --- the angle within the turn ----------------------------------------------------------------------------------------


def turn_by(probe: Probe, degrees: float) -> None:
    """Turn the shaft by an angle and wait until it stands."""
    arriving.follow(probe, probe.command("move_increment_limited"), degrees, rpm=180)


def angle(probe: Probe) -> float:
    """Return the angle within the turn, in degrees."""
    return probe.read(Verb.READ_SINGLE_TURN, "angle") / 100


def around(degrees: float) -> float:
    """Return an angle as the shortest way, -180..180."""
    return (degrees + 180) % 360 - 180


_READS = 6
_single_turn = commands(Verb.READ_SINGLE_TURN)


@of_motion(each=_single_turn, name="{command}/is-position", refuted_by="another change")
def _angle_is_position(probe: Probe) -> None:
    """The angle within the turn changes as the position does, around the turn."""
    motion.ready_to_move(probe)
    for degrees in PLACES:
        angle_before, place_before = angle(probe), motion.position(probe).value
        turn_by(probe, degrees)
        turned, moved = angle(probe) - angle_before, motion.position(probe).value - place_before
        probe.expect(
            f"{around(turned):+.2f} degrees",
            holds=abs(around(turned - moved)) <= motion.miss(probe),
            expected=f"{around(moved):+.2f} degrees",
            refutes="the angle within the turn does not change as the position does",
        )


@of_motion(each=_single_turn, refuted_by="another angle")
def _within_turn(probe: Probe, command: Command) -> None:
    """The angle within the turn stays within 0 and 359.99 degrees, at whole turns and beside them too."""
    motion.ready_to_move(probe)
    for degrees in (360 - angle(probe), 0.01, -0.02, -719.99):
        turn_by(probe, degrees)
        # A shaft that shivers is exactly there at times.
        for _ in range(_READS):
            seen = probe.read(command, "angle")
            probe.expect(seen, at_least=0, at_most=35_999, refutes="the angle within the turn is outside of it")


# --- the speed --------------------------------------------------------------------------------------------------------


@of_motion(each=commands(Verb.READ_SPEED), name="{command}/at-rest", refuted_by="another speed", risks=risks_by(Verb.RUN_SPEED))
def _speed_at_rest(probe: Probe) -> None:
    """The speed of a shaft that stands is 0."""
    motion.ready_to_move(probe)
    motion.run_at(probe, _RPM, QUICK)
    probe.wait(300 * MS)
    motion.stop(probe, QUICK)
    probe.wait(300 * MS)
    before = motion.position(probe)
    seen = motion.speed(probe)
    exchange = probe.traffic[-1]
    if abs(motion.position(probe).value - before.value) > motion.same(probe):
        raise Inconclusive("the shaft does not stand")
    text = "the shaft stands and its speed is not 0"
    probe.expect(seen, near=0, within=0.9, unit="rpm", refutes=text, exchange=exchange)


# --- the angle error --------------------------------------------------------------------------------------------------

_angle_error = commands(Verb.READ_ANGLE_ERROR)


def _error(probe: Probe, command: Command) -> float:
    field = command.reply_forms[0].layout.named["angle_error"]
    return float(field.physical(probe.read(command, "angle_error")))


def _held_errors(dialect: Dialect) -> Iterator[Case]:
    for case in _angle_error(dialect):
        for turns in (0.25, -0.25, 1.5, -1.5):
            given = {"turns": turns, "degrees": round(turns * 360)}
            yield Case(dialect, case.command, given, {"name": f"read_angle_error/held-{turns:+g}".replace(".", "_")})


@of_motion(
    each=_held_errors,
    statement="With the shaft held and a move by {turns:+g} turns, the angle error is {degrees:+d} degrees: "
    "51200 units are a turn, and what is wanted beyond the shaft is positive.",
    refuted_by="another number",
    emulated=True,
    settings=("protection",),
    risks=risks_by(Verb.SET_PROTECTION),
    parameters=lambda case: {"turns": case["turns"]},
)
def _error_held(probe: Probe, command: Command, degrees: int) -> None:
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    motion.prepare(probe, move)
    probe.do(Verb.SET_PROTECTION, {"protection": 0})
    bench.hold(probe)
    motion.begin(probe, move, degrees, acceleration=QUICK)
    probe.wait(3 * SECOND_NS)
    text = "the angle error of a shaft that is held is not what is missing"
    probe.expect(_error(probe, command), near=degrees, within=_LAG, unit="degrees", refutes=text)


# --- what else is read ------------------------------------------------------------------------------------------------


@claim(
    Theme.MOTION,
    each=commands(Verb.READ_VERSION),
    refuted_by="the other sense",
    aspect=Aspect.STATE,
    rests_on=(Doubt.SIGN,),
    at_best=Certainty.OPEN,
    quirks=may_meet("version-cal-1"),
)
def _calibration(probe: Probe) -> None:
    """The version tells that turning clockwise lowers the bare encoder, as it lowers what 31 reads."""
    seen = probe.read(Verb.READ_VERSION, "calibration")
    if seen == _CW_RAISES and "version-cal-1" in probe.claim.quirks:
        probe.meets("version-cal-1")
    else:
        probe.expect(seen, equal=_CW_LOWERS, refutes="the version tells another sense of the encoder")


#: What the version tells of a drive of each model: E series, and the hardware.
_VERSIONS: Mapping[str, tuple[int, int]] = {"42E": (1, 2), "57E": (1, 4)}


@claim(
    Theme.MOTION, each=commands(Verb.READ_VERSION), refuted_by="another drive", aspect=Aspect.STATE, at_best=Certainty.LIKELY
)
def _names_the_drive(probe: Probe, command: Command) -> None:
    """The version tells the series and the hardware of this drive."""
    model = probe.dialect.model
    if model not in _VERSIONS:
        raise NotRun("the model of the drive is not known: add model=42E or model=57E to the drive")
    exchange = probe.ask(command)
    values = probe.reply(exchange).values
    seen = values["series"], values["hardware"]
    probe.expect(seen, equal=_VERSIONS[model], refutes=f"the version is not that of a {model} with CAN", exchange=exchange)


# --- the ports --------------------------------------------------------------------------------------------------------


def _ports(dialect: Dialect) -> Iterator[Case]:
    """Yield the read of the ports where one tells whether the shaft is in place."""
    for case in commands(Verb.READ_IO)(dialect):
        if "pend" in case.command.reply_forms[0].layout.named:  # type: ignore[union-attr]  # cases of commands
            yield case


_of_ports = partial(
    of_motion,
    each=_ports,
    refuted_by="the other level",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.SET_PULSE_DIVISION, Verb.WRITE_IO),
    settings=("division_level", "division_period"),
)


def _give_ports_back(probe: Probe) -> None:
    """Let the ports tell what they tell by default."""
    motion.ready_to_move(probe)
    probe.do(Verb.SET_PULSE_DIVISION, {"division_level": 0, "division_period": 0})
    probe.do(Verb.WRITE_IO, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})


@_of_ports()
def _in_position_at_rest(probe: Probe, command: Command) -> None:
    """PEND is 1 when the shaft has come to its target, and ALM is 1 without an alarm."""
    _give_ports_back(probe)
    arriving.follow(probe, declared.any_move(probe.dialect), 90)
    for port, text in (("pend", "the shaft is in place, and PEND says that it is not"), ("alm", "ALM tells an alarm at rest")):
        probe.expect(probe.read(command, port), equal=1, refutes=text, exchange=probe.traffic[-1])


@_of_ports()
def _not_in_position_while_moving(probe: Probe, command: Command) -> None:
    """PEND is 0 while the shaft is on its way."""
    _give_ports_back(probe)
    motion.begin(probe, declared.any_move(probe.dialect), 720)
    probe.wait(500 * MS)
    seen, exchange = probe.read(command, "pend"), probe.traffic[-1]
    turning = motion.turning(probe)
    motion.stand_still(probe)
    if abs(turning.value) < 1:
        raise Inconclusive("the shaft does not turn")
    probe.expect(seen, equal=0, refutes="the shaft is on its way, and PEND says that it is in place", exchange=exchange)


@of_motion(each=_ports, refuted_by="a port that stays, or one of another switch", at_best=Certainty.LIKELY, emulated=True)
def _shows_left_switch(probe: Probe, command: Command) -> None:
    """The port of the left switch changes when it is pressed, and again when it is let go: in_1, or in_2 on a 57."""
    port = "in_2" if probe.dialect.model.startswith("57") else "in_1"
    seen = []
    for pressed in (False, True, False):
        bench.press(probe, pressed)
        seen.append(probe.read(command, port))
    text = f"{port} does not follow the left switch"
    probe.expect(seen, holds=seen[0] != seen[1] and seen[0] == seen[2], expected="two levels", refutes=text)


def _enable_ports(dialect: Dialect) -> Iterator[Case]:
    """Yield the read of the ports of a 42E, whose in_2 is the En pin."""
    if dialect.model == "42E":
        yield from commands(Verb.READ_IO)(dialect)


_of_enable_port = partial(of_motion, each=_enable_ports, refuted_by="the other level, or always the same")


def _not_remapped(probe: Probe) -> None:
    """Take the limit switches off the ports of the pulse interface; they are remapped in a bus mode alone."""
    motion.set_mode(probe, declared.bus_modes(probe.dialect)[-1])
    settings.to_defaults(probe, "limit_remap")


@_of_enable_port(emulated=True, settings=("limit_remap",))
def _shows_enable_pin(probe: Probe, command: Command) -> None:
    """in_2 of a 42E is the level of the En pin."""
    _not_remapped(probe)
    for level in (1, 0, 1):
        bench.enable_pin(probe, level)
        probe.expect(probe.read(command, "in_2"), equal=level, refutes="in_2 is not the level of the En pin")


@_of_enable_port(settings=("enable_level", "limit_remap"), risks=risks_by(Verb.SET_ENABLE_LEVEL), at_best=Certainty.LIKELY)
def _is_enable_pin(probe: Probe, command: Command) -> None:
    """In a pulse mode in_2 of a 42E is the level at which the motor is enabled."""
    _not_remapped(probe)
    motion.set_mode(probe, declared.pulse_modes(probe.dialect)[0])
    for level in (0, 1):
        exchange = probe.do(Verb.SET_ENABLE_LEVEL, {"enable_level": level})
        enabled = probe.read(Verb.READ_ENABLED)
        wanted = level if enabled else 1 - level
        text = "in_2 is not the level of the En pin that enables or disables the motor"
        probe.expect(probe.read(command, "in_2"), equal=wanted, refutes=text, exchange=exchange)


# --- the divided pulses -----------------------------------------------------------------------------------------------


class _Look(NamedTuple):
    """The level of PEND and the count of pulses after a move. `anew`: the drive was restarted before it."""

    level: int
    period: int
    anew: bool
    pulses: int
    pend: int

    @property
    def flips(self) -> int:
        """How often PEND has flipped from the zero on."""
        return self.pulses // self.period if self.period >= _LEAST_PERIOD else 0


def _divided(probe: Probe) -> tuple[tuple[_Look, ...], ...]:
    """Return three looks at PEND for each period that is tried."""
    _give_ports_back(probe)
    move, command = probe.command(Verb.MOVE_RELATIVE_PULSES), probe.command(Verb.SET_PULSE_DIVISION)
    found = []
    for level, period, way, subdivision in _DIVIDED:
        motion.ready_to_move(probe, subdivision=subdivision % _FINEST)
        probe.do(Verb.SET_ZERO)
        probe.do(command, {"division_level": level, "division_period": period})
        looks = []
        for number in range(3):
            anew = bool(number == 1 and level and way > 0)
            if anew:
                restart(probe)
                motion.ready_to_move(probe, subdivision=subdivision % _FINEST)
                probe.do(Verb.SET_ZERO)
            degrees = way * _PART * period * 360 / declared.units_per_turn(probe.dialect, move, subdivision)
            rpm = min(_QUICK_RPM, _FINE_RPM)
            arriving.follow(probe, move, degrees, rpm=rpm, acceleration=QUICK, subdivision=subdivision)
            pulses = abs(probe.read(Verb.READ_PULSES, "pulses"))
            looks.append(_Look(level, period, anew, pulses, probe.read(Verb.READ_IO, "pend")))
        found.append(tuple(looks))
    return tuple(found)


_of_division = partial(
    of_motion,
    each=commands(Verb.SET_PULSE_DIVISION),
    refuted_by="a port that does not follow the pulses",
    risks=risks_by(Verb.SET_PULSE_DIVISION, Verb.MOVE_RELATIVE_PULSES, Verb.WRITE_IO, Verb.SET_ZERO, Verb.RESTART),
    settings=("division_level", "division_period"),
)


@_of_division(at_best=Certainty.OPEN)
def _divides(probe: Probe) -> None:
    """PEND flips where so many pulses have come since the zero, from its starting level, also after a restart."""
    for look in (look for looks in probe.recorded(_divided) for look in looks):
        wanted = look.level ^ (look.flips & 1) if look.period >= _LEAST_PERIOD else 1
        text = f"PEND with a period of {look.period} is not {wanted} after {look.pulses} pulses"
        probe.expect(look.pend, equal=wanted, refutes=text)


@_of_division(at_best=Certainty.LIKELY)
def _flips(probe: Probe) -> None:
    """PEND flips once for every so many pulses either way, wherever it begins, and never with a period below 100."""
    if len({look.pend for looks in probe.recorded(_divided) for look in looks}) == 1:
        # Whether 34 shows the port or the signal of the drive is not said.
        raise Inconclusive("no pulses change PEND as 34 tells it")
    for before, after in (pair for looks in probe.recorded(_divided) for pair in pairwise(looks) if not pair[1].anew):
        text = f"PEND with a period of {after.period} flips otherwise between {before.pulses} and {after.pulses} pulses"
        probe.expect(before.pend ^ after.pend, equal=(before.flips ^ after.flips) & 1, refutes=text, key="division")


#: Starting levels and periods, the way, and the subdivision at which the pulses are counted; the part of a period of each move.
_DIVIDED = (
    (0, 99, 1, 16),
    (0, 50, -1, 16),
    (0, 100, 1, 16),
    (1, 150, -1, 16),
    (0, 400, -1, 16),
    (1, 1600, 1, 16),
    (0, 1600, -1, 16),
    (1, 3200, -1, 16),
    (0, 12_000, 1, 256),
    (1, 40_000, -1, 256),
    (0, 100_000, 1, 256),
)
_PART, _LEAST_PERIOD, _FINEST = 0.55, 100, 256
#: A speed that can be sent at the finest subdivision too.
_FINE_RPM = 240
