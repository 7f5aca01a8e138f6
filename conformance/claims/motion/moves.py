"""Moves: how far each goes, which way, how fast, and what it answers.

    MKS  FD, F4 by a distance, FE, F5 to a place; FD and FE in pulses, F4 and F5 in counts
    LK   A7, A8 by an angle, A3, A4 to a position over all turns, A5, A6 to an angle within the turn; the even ones with a speed

Rules kept here:
- A turn of an MKS drive is 16384 counts, and 200 pulses at each subdivision: 3200 at 16, to which the suite sets it.
- Counts have a sign that the manual's examples fix, angles one that the manual prints. What the direction bit and the sign
  of pulses turn is not judged; that both values of one command turn opposite ways is.
- Positions are read when the shaft has come to rest; only `told-when-there` reads at once.
- The limits of an LK setup program are not known here: speeds and ways are small (60 rpm, a turn).
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind
from conformance.claims.declare import Case, motions, with_values
from conformance.claims.known_quirks import SETTLING, may_meet
from conformance.claims.motion.motion_claim import (
    command_of,
    expect_at_rest,
    expect_row_taken,
    expect_speed,
    expect_stays,
    expect_taken,
    has_sign,
    of_motion,
    that_tell_their_end,
)
from conformance.claims.motion.stops import endless
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.arriving import Move
from conformance.motion.declared import GENTLE, MOVES, QUICK, takes_pulses
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE, TOLD_LATE_NS
from conformance.talk.probe import MS, Probe, Until

#: A way that no power of two divides, one back that is shorter, and a short one, in degrees.
_THERE, _BACK, _SHORT = 97.2, -39.6, 41.4
#: Many quick moves each way: how many, their speed and acceleration. Their degrees: 104 pulses, which are no whole counts, and
#: an angle of whole counts at each width of an encoder.
_MANY, _MANY_RPM, _STEEP = 24, 240, 255
_EACH, _EACH_ANGLE = 11.7, 22.5
#: How far a shaft may go beyond its target on the way, in degrees.
_OVERSHOOT = 2.0
#: Short moves, in units, and their way; how often each is asked for, and how long one takes.
_STEPS = ((1, 1), (1, -1), (2, -1), (3, 1), (5, -1), (7, 1), (7, -1), (14, 1))
_SO_MANY, _STEP_NS = 4, 25 * MS
#: Ways round within a turn, each from where the one before ended: short, long and nearly a turn, beside its zero and across it.
_ROUND_FROM, _ROUND_RPM = 3, 2 * declared.CALM
_ROUND = (4, -4, 350, 12, -12, -350, -8, 354, -354, -25, 30, -175, 185, -200, 270, -90)


def takes_angle(command: Command) -> bool:
    """Say whether the distance of a move is an angle, and not a number of counts or pulses."""
    return declared.field_of(command, declared.of(command).distance).unit == "deg"


def takes_counts(command: Command) -> bool:
    """Say whether the distance of a move is in counts or pulses, of which the manual says how many are a turn."""
    return not takes_angle(command)


def takes_place(command: Command) -> bool:
    """Say whether a move goes to a place, and not by a distance."""
    return declared.of(command).kind is MotionKind.MOVE_TO


_counted = motions(*MOVES, where=takes_counts)
_angled = motions(*MOVES, where=takes_angle)
_counted_places = motions(MotionKind.MOVE_TO, where=takes_counts)
_in_turn = motions(MotionKind.MOVE_IN_TURN)
with_max_speed = motions(*MOVES, where=lambda c: takes_angle(c) and bool(declared.of(c).speed))


def without_max_speed(dialect: Dialect) -> Iterator[Case]:
    """Yield the moves without a max_speed, each with the one of its kind that has one."""
    limited = {declared.of(command_of(case)).kind: command_of(case) for case in with_max_speed(dialect)}
    for command in dialect.motions(*limited):
        if not declared.of(command).speed:
            yield Case(dialect, command, {"limited": limited[declared.of(command).kind]})


def keeps_position(case: Case) -> tuple[str, ...]:
    """Return the settings that hold where the turns are counted from, for moves that go by them."""
    command = command_of(case)
    return ("position",) if takes_place(command) and takes_angle(command) else ()


# --- where a move ends ------------------------------------------------------------------------------------------------


def _distances(dialect: Dialect) -> Iterator[Case]:
    for command in filter(takes_counts, dialect.motions(*MOVES)):
        unit = declared.field_of(command, declared.of(command).distance).unit
        where = "to a place" if takes_place(command) else "by a distance"
        yield Case(dialect, command, {"signed": False, "unit": unit, "where": where}, {"parameters": {}})


def _angles(dialect: Dialect) -> Iterator[Case]:
    for command in filter(takes_angle, dialect.motions(*MOVES)):
        signed = declared.of(command).kind is not MotionKind.MOVE_IN_TURN
        yield Case(dialect, command, {"signed": signed}, {"parameters": {}})


def _expect_way(probe: Probe, move: Move, signed: bool, refutes: str, *, times: int = 1) -> None:
    """Refute unless a move, or several, went as far as was asked, the way that was asked where it is `signed`."""
    seen, asked = (move.degrees, move.asked) if signed else (abs(move.degrees), abs(move.asked))
    within = times * declared.near(probe.dialect)
    if takes_place(move.command) and takes_pulses(move.command):
        # The shaft may have stood between two pulses, of which the drive read one.
        within += 180 / declared.units_per_turn(probe.dialect, move.command)
    if takes_place(move.command):
        # Each of several goes from where the shaft was read to be: what that is off by adds up.
        within += (times - 1) * probe.noise.place
    probe.expect(seen, near=asked, within=within, unit="degrees", refutes=refutes, exchange=move.exchange)


def there_and_back(probe: Probe, command: Command) -> tuple[Move, Move, tuple[int, ...]]:
    """Move there, listen for what comes late, and move back; return both moves and all statuses of the first."""
    motion.prepare(probe, command)
    since = len(probe.traffic)
    there = arriving.follow(probe, command, _THERE)
    if declared.of(command).tells_end:
        probe.wait(700 * MS)
    statuses = arriving.statuses(probe.traffic[since:], command)
    return there, arriving.follow(probe, command, _BACK), tuple(statuses)


@of_motion(
    each=_distances,
    statement="{command} moves the shaft {where} in {unit}: 16384 counts, or 3200 pulses at 16 subdivisions, are a turn.",
    refuted_by="a shaft that went farther or less far",
)
@of_motion(
    each=with_values(motions(*MOVES, where=lambda c: takes_counts(c) and not takes_pulses(c)), signed=True),
    name="{command}/sign",
    statement="{command}: a greater position raises what read_position reads, by so many counts.",
    refuted_by="an encoder value that falls, or does not come to what was asked",
    parameters={},
)
@of_motion(
    each=_angles,
    name="{command}/reaches",
    statement="{command} brings the shaft to where it was asked to go.",
    refuted_by="a shaft that stops elsewhere",
    settings=keeps_position,
)
def _distance(probe: Probe, command: Command, signed: bool) -> None:
    for move in probe.recorded(there_and_back, command)[:2]:
        _expect_way(probe, move, signed, f"{command.name} does not go as far as it was asked to")


def _opposites(dialect: Dialect) -> Iterator[Case]:
    for command in filter(takes_counts, dialect.motions(*MOVES)):
        both = "a greater and a smaller position" if has_sign(command) else "direction 0 and direction 1"
        yield Case(dialect, command, {"both": both}, {"parameters": {}})


@of_motion(each=_opposites, refuted_by="the same way twice")
def _opposite(probe: Probe, command: Command) -> None:
    """{command} turns the shaft opposite ways for {both}."""
    there, back, _ = probe.recorded(there_and_back, command)
    probe.expect(
        f"{there.degrees:+.2f} and {back.degrees:+.2f} degrees",
        holds=there.degrees * back.degrees < 0 and min(abs(there.degrees), abs(back.degrees)) > motion.same(probe),
        expected="two ways",
        refutes=f"{command.name} does not turn two ways",
        exchange=back.exchange,
    )


@of_motion(
    each=with_values(_counted, signed=False),
    statement="{command} can be asked for again and again: the ways add up and nothing is lost.",
    refuted_by="several short moves that are not one long one",
    parameters={},
)
@of_motion(
    each=with_values(motions(MotionKind.MOVE_BY, where=takes_angle), signed=True),
    name="{command}/adds-up",
    statement="{command} five times by an angle moves by five times the angle.",
    refuted_by="another angle",
    parameters={},
)
def _again(probe: Probe, command: Command, signed: bool) -> None:
    motion.prepare(probe, command)
    moves = [arriving.follow(probe, command, 11.18, acceleration=QUICK) for _ in range(5)]
    whole = Move(command, moves[-1].exchange, sum(m.asked for m in moves), moves[0].start, moves[-1].end)
    _expect_way(probe, whole, signed, f"{command.name}: {len(moves)} moves do not add up", times=len(moves))


@of_motion(each=motions(MotionKind.MOVE_BY), refuted_by="moves that each miss by a little, one way or the other")
def _many(probe: Probe, command: Command) -> None:
    """{command} many times one way, and as often back, goes as far as all of them together, each way by itself."""
    motion.prepare(probe, command)
    motion.wait_standing(probe)
    each = _EACH_ANGLE if takes_angle(command) else _EACH
    for way in (1, -1):
        before = motion.position(probe)
        every = [_one_of_many(probe, command, way * each) for _ in range(_MANY)]
        went = abs(motion.wait_standing(probe).value - before.value)
        one = abs(every[-1].values[declared.of(command).distance]) * 360 / declared.units_per_turn(probe.dialect, command)
        # Whether a move was made whose reply was lost only the way tells.
        least = sum(exchange.is_read for exchange in every)
        made = min(max(round(went / one), least), _MANY)
        text = f"{command.name}: {_MANY} moves do not add up"
        probe.expect(went, near=made * one, unit="degrees", refutes=text, exchange=every[-1])


def _one_of_many(probe: Probe, command: Command, degrees: float) -> Exchange:
    """Make one of many moves, and wait until it is over."""
    if probe.dialect.ramp is None:
        return arriving.follow(probe, command, degrees).exchange
    tells = declared.of(command).tells_end
    until = Until.DONE if tells else Until.REPLY
    exchange = motion.ask(probe, command, degrees, rpm=_MANY_RPM, acceleration=_STEEP, until=until, quiet_ns=0)
    expect_row_taken(probe, exchange, f"by {degrees:g} degrees", f"{command.name} is refused")
    if not tells:
        probe.wait(int(ramp.move_ns(degrees / 360, _MANY_RPM, _STEEP) * (1 + CLOCK_SHARE)) + TOLD_LATE_NS)
    return exchange


@of_motion(each=_counted, refuted_by="a shaft that stays, or goes elsewhere", at_best=Certainty.LIKELY)
def _steps(probe: Probe, command: Command) -> None:
    """{command} by few units at a time, either way, goes as far as it was asked to: no step is too short."""
    motion.prepare(probe, command)
    turn = declared.units_per_turn(probe.dialect, command)
    stands = motion.wait_standing(probe)
    for units, way in _STEPS:
        step = way * units * 360 / turn
        if units * 360 / turn <= declared.near(probe.dialect):
            # A shaft may miss its target by as much.
            continue
        begin = motion.place(probe, command)
        for number in range(_SO_MANY):
            # To a place it is one step more each time.
            start = begin + number * way * units if takes_place(command) else begin
            done = Until.DONE if declared.of(command).tells_end else Until.REPLY
            exchange = motion.ask(probe, command, step, acceleration=QUICK, start=start, until=done, quiet_ns=0)
            expect_taken(probe, exchange, f"{command.name} by {units} units is refused")
            probe.wait(0 if declared.of(command).tells_end else _STEP_NS)
        before, stands = stands, motion.wait_standing(probe)
        within = (1 if takes_place(command) else _SO_MANY) * declared.near(probe.dialect) + motion.miss(probe)
        text = f"{command.name} by few units at a time goes elsewhere"
        probe.expect(
            abs(stands.value - before.value),
            near=_SO_MANY * abs(step),
            within=within,
            unit="degrees",
            expected=f"{_SO_MANY * abs(step):.3g} degrees: {_SO_MANY} times {way * units:+d}",
            refutes=text,
            exchange=exchange,
        )


@of_motion(
    each=_counted_places,
    statement="{command} to where the shaft stands turns nothing.",
    refuted_by="a shaft that turned, or a refusal",
)
@of_motion(
    each=motions(MotionKind.MOVE_TO, where=takes_angle),
    name="{command}/absolute",
    statement="{command} twice to one position moves once.",
    refuted_by="a second motion",
)
def _same_place(probe: Probe, command: Command) -> None:
    motion.prepare(probe, command)
    there = arriving.follow(probe, command, _THERE)
    exchange = motion.ask(probe, command, until=Until.DONE if declared.of(command).tells_end else Until.REPLY)
    expect_taken(probe, exchange, f"{command.name} to the same place is refused")
    probe.wait(300 * MS)
    within = declared.near(probe.dialect)
    expect_stays(there.end, motion.wait_standing(probe), exchange, f"{command.name} to the same place turns the shaft", within)


@of_motion(
    each=lambda dialect: (case for case in _distances(dialect) if takes_place(command_of(case))),
    statement="After {command} the drive reads the {unit} that were asked for, above and below zero.",
    refuted_by="another number",
)
def _reads_as_asked(probe: Probe, command: Command) -> None:
    motion.prepare(probe, command)
    turn = declared.units_per_turn(probe.dialect, command)
    for degrees in (108, -216):
        target = motion.place(probe, command) + round(degrees * turn / 360)
        move = arriving.follow(probe, command, degrees)
        text = f"{command.name}: the drive reads another place than was asked for"
        unit = "counts" if probe.dialect.counts_per_turn else "0.01 degrees"
        seen = motion.place(probe, command)
        probe.expect(seen, near=target, within=2, unit=unit, refutes=text, exchange=move.exchange)


# --- after what ended another motion, or moved the zero of the position -------------------------------------------------


@of_motion(
    # Where motions are crossed, they come behind stops too.
    each=motions(*MOVES, where=takes_angle),
    refuted_by="a shaft that ends elsewhere",
    risks=lambda case: {r for c in case.dialect.motions(MotionKind.RUN, *MOVES) for r in c.all_risks},
    settings=keeps_position,
    at_best=Certainty.LIKELY,
)
def _after_stop(probe: Probe, command: Command) -> None:
    """{command} right after a stop that ended another motion goes by what it says itself, from where the shaft stands."""
    every = probe.dialect.motions(MotionKind.RUN, *MOVES)
    own = every.index(command)
    # Its own kind, the one before and the one behind it.
    for number, ended in enumerate((command, every[own - 1], every[(own + 1) % len(every)])):
        motion.prepare(probe, command)
        endless(probe, ended)
        stops = probe.dialect.stops_of(ended)
        stop = stops[number % len(stops)]
        ramped = "acceleration" in stop.request_forms[0].layout.named
        probe.ask(stop, {"acceleration": QUICK} if ramped else {}, quiet_ns=0)
        motion.wait_standing(probe)
        move = arriving.follow(probe, command, (-1) ** number * _SHORT)
        _expect_way(probe, move, False, f"{command.name} after a stop of {ended.name} does not go as far as it was asked to")


@of_motion(
    each=lambda dialect: motions(*MOVES, where=takes_angle)(dialect) if "set_position" in dialect.by_name else (),
    refuted_by="a shaft that ends elsewhere",
    risks=lambda case: {r for name in ("set_position", "clear_turns") for r in case.dialect.by_name[name].all_risks},
    settings=("position",),
    at_best=Certainty.LIKELY,
)
def _after_new_position(probe: Probe, command: Command) -> None:
    """{command} after 95 or 93 goes as far as before: to a position as 92 tells it, to an angle as 94 does, or by an angle."""
    motion.prepare(probe, command)
    for number, position in enumerate((12_345, -234_567, None)):
        exchange = probe.do("clear_turns") if position is None else probe.do("set_position", {"position": position})
        move = arriving.follow(probe, command, (-1) ** number * _SHORT)
        assert exchange.command is not None  # it was asked for
        text = f"{command.name} after {exchange.command.name} does not go where it was asked to"
        _expect_way(probe, move, False, text)


@of_motion(each=_in_turn, refuted_by="one way for both directions")
def _two_ways(probe: Probe, command: Command) -> None:
    """{command} goes to one angle by both ways: together they are a turn."""
    cw, ccw, exchange = probe.recorded(both_ways, command)
    probe.expect(
        f"{cw:+.1f} and {ccw:+.1f} degrees",
        holds=cw * ccw < 0 and abs(abs(cw) + abs(ccw) - 360) <= 2 * motion.miss(probe),
        expected="two ways that are a turn together",
        refutes=f"{command.name} does not go to one angle by both ways",
        exchange=exchange,
    )


@of_motion(each=_in_turn, refuted_by="the other way", at_best=Certainty.LIKELY)
def _clockwise(probe: Probe, command: Command) -> None:
    """{command} with direction 0 turns clockwise, which raises the position."""
    cw, ccw, exchange = probe.recorded(both_ways, command)
    probe.expect(
        f"{cw:+.1f} and {ccw:+.1f} degrees",
        holds=max(abs(cw - 120), abs(ccw + 240)) <= motion.miss(probe),
        expected="+120 and -240 degrees",
        refutes=f"{command.name} does not turn the way that it was told",
        exchange=exchange,
    )


@of_motion(each=_in_turn, refuted_by="another way", at_best=Certainty.LIKELY)
def _across_zero(probe: Probe, command: Command) -> None:
    """{command} goes on across the zero of the turn, both ways, and no turn more."""
    motion.ready_to_move(probe)
    here = motion.place(probe, command)
    turn = declared.units_per_turn(probe.dialect, command)
    # To 300 degrees, then to 60 and back; to 357, then to 2 and back.
    arriving.follow(probe, command, (300 - here * 360 / turn) % 360, start=here)
    for way in (120, -120, 57, 5, -5):
        move = arriving.follow(probe, command, way)
        _expect_way(probe, move, True, f"{command.name} goes another way across zero")


@of_motion(each=_in_turn, refuted_by="the other way round, or another way", at_best=Certainty.LIKELY)
def _way_round(probe: Probe, command: Command) -> None:
    """{command} goes the way round that it is told, by few degrees and by nearly a turn, beside zero and across it."""
    motion.ready_to_move(probe)
    here = motion.place(probe, command)
    turn = declared.units_per_turn(probe.dialect, command)
    arriving.follow(probe, command, (_ROUND_FROM - here * 360 / turn) % 360, start=here)
    for way in _ROUND:
        move = arriving.follow(probe, command, way, rpm=_ROUND_RPM)
        text = f"{command.name} goes another way round than it was told"
        _expect_way(probe, move, True, text)


def both_ways(probe: Probe, command: Command) -> tuple[float, float, Exchange]:
    """Go to one angle clockwise, back to where that began, and to it again the other way; return both ways (degrees)."""
    motion.ready_to_move(probe)
    start = motion.place(probe, command)
    cw = arriving.follow(probe, command, 120, start=start)
    arriving.follow(probe, command, -360, start=start)
    ccw = arriving.follow(probe, command, -240, start=start)
    arriving.follow(probe, command, 360, start=start)
    return cw.degrees, ccw.degrees, ccw.exchange


# --- on the way -------------------------------------------------------------------------------------------------------


@of_motion(
    each=with_max_speed,
    name="{command}/max-speed",
    statement="{command} keeps to max_speed, and comes to it where the way is long enough.",
    refuted_by="a speed above it, or far below",
    settings=keeps_position,
)
def _speed(probe: Probe, command: Command) -> None:
    motion.prepare(probe, command)
    for rpm, degrees, after_ns in ((15, 300, 500 * MS), (45, -300, 500 * MS)):
        exchange = motion.begin(probe, command, degrees, rpm=rpm, acceleration=QUICK, quiet_ns=0)
        probe.wait(exchange.sent_ns + after_ns - probe.gate.now_ns())
        seen = motion.turning(probe)
        # Where it ends is judged elsewhere.
        motion.stand_still(probe)
        expect_speed(seen, rpm, exchange, f"{command.name} does not turn at the speed that was asked for")


@of_motion(
    each=with_values(_counted, degrees=360, rpm=300, for_ns=700 * MS),
    statement="{command} slows the shaft down by its ramp, so that it does not go beyond the target.",
    refuted_by=f"a shaft more than {_OVERSHOOT:g} degrees beyond the target on the way",
    at_best=Certainty.LIKELY,
    parameters={},
)
@of_motion(
    each=with_values(_angled, degrees=200, rpm=45, for_ns=1300 * MS),
    statement="{command} does not go beyond its target.",
    refuted_by="a shaft that was beyond the target on the way",
    at_best=Certainty.OPEN,
    settings=keeps_position,
    parameters={},
)
def _within(probe: Probe, command: Command, degrees: int, rpm: int, for_ns: int) -> None:
    motion.prepare(probe, command)
    start = motion.position(probe)
    exchange = motion.begin(probe, command, degrees, rpm=rpm, acceleration=236, quiet_ns=0)
    seen = motion.sampled(probe, for_ns, 40 * MS)
    end = motion.wait_standing(probe)
    way = 1 if end.value > start.value else -1
    beyond = max((s.value - end.value) * way for s in seen)
    text = f"{command.name} goes beyond its target and comes back"
    probe.expect(beyond, at_most=_OVERSHOOT, unit="degrees beyond", refutes=text, exchange=exchange)


# --- replies ----------------------------------------------------------------------------------------------------------


@of_motion(each=that_tell_their_end(_counted), refuted_by="other statuses, another order, more or fewer replies")
def _replies(probe: Probe, command: Command) -> None:
    """{command} is answered twice: status 1 when it begins, status 2 when it is done."""
    there, _, told = probe.recorded(there_and_back, command)
    text, seen = f"{command.name}: other replies than 1 and then 2", list(told)
    probe.expect(seen, equal=[1, 2], refutes=text, exchange=there.exchange, key=f"{command.name} {seen}")


@of_motion(
    each=that_tell_their_end(_counted), refuted_by="a shaft that is elsewhere when status 2 comes", quirks=may_meet(SETTLING)
)
def _told_when_there(probe: Probe, command: Command) -> None:
    """When {command} says that it is complete, the shaft is at its target."""
    motion.prepare(probe, command)
    for degrees, rpm, acceleration in ((_THERE, 120, GENTLE), (-1080, 900, QUICK)):
        exchange = motion.ask(probe, command, degrees, rpm=rpm, acceleration=acceleration, until=Until.DONE, quiet_ns=0)
        expect_at_rest(probe, command, exchange, f"{command.name} is told as complete before the shaft is there")
