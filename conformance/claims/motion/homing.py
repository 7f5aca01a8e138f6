"""Homing: how a drive finds its end stop, or an obstacle, and what it then calls zero.

An end stop or an obstacle must be where the claim expects it, so homing is tried on emulated drives alone.

Rules kept here:
- `home_direction` 0 is clockwise, and clockwise lowers the counts.
- Where the drive tells the end (native, CAN) that is listened to; where it does not (Modbus), F1 is asked until it is no
  longer 5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Trait, Verb
from conformance.claim import Inconclusive
from conformance.claims import bench
from conformance.claims.declare import Case, Cases, commands
from conformance.claims.motion.motion_claim import of_motion, risks_by, that_tell_their_end
from conformance.claims.motion.refusals import expect_refused
from conformance.model import covering
from conformance.motion import arriving, declared, motion
from conformance.motion.attempts import undamaged
from conformance.motion.declared import QUICK, SUBDIVISION
from conformance.talk import samples
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe, Until

_CW, _CCW = 0, 1
_SWITCH = 3000
HOMING, HOMED = 5, 2
_LIMIT_NS = 20 * SECOND_NS
#: How long homing from where `mounted` leaves the shaft takes at most, at 300 rpm.
FOUND_NS = 4 * SECOND_NS
#: How far a move goes from where homing ended, in degrees.
_BESIDE = 45
#: How near the place is known where the shaft turns round (counts): at 60 rpm it goes so far between two looks at it.
_BACK = 200
_WAYS = {_CW: -1, _CCW: 1}
#: Return angles, in counts: none, parts of a turn, and more than 16 bits hold.
_ANGLES = (0, 0x1000, 0x3000, 0x12000, 0x25000)
_DIRECTIONS = {"cw": _CW, "ccw": _CCW}
_homings = commands(Verb.HOME)
#: What sets how a drive homes.
SETS_HOME = (Verb.SET_HOME, Verb.SET_NO_LIMIT_HOME)


def fields(dialect: Dialect) -> tuple[str, ...]:
    """Return the settings of homing."""
    found = [c for v in SETS_HOME if (c := dialect.by_verb.get(v)) is not None]
    return tuple(dict.fromkeys(n for c in found for f in c.request_forms for n in f.layout.named))


def modes(dialect: Dialect) -> tuple[int, ...]:
    """Return the modes of homing: by a switch, and by an obstacle where the dialect has that."""
    return (0, 1) if "home_mode" in fields(dialect) else (0,)


def _of_homing(
    refuted_by: str, *, each: Cases = _homings, **facts: Any
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    facts = {"emulated": True, "risks": risks_by(*SETS_HOME), "settings": lambda case: fields(case.dialect), **facts}
    return of_motion(each=each, refuted_by=refuted_by, **facts)


# --- homing -----------------------------------------------------------------------------------------------------------


def set_home(probe: Probe, **values: int) -> Exchange:
    """Set how the drive homes; what is not given: clockwise, at 60 rpm, a low pin, no end limit, by a switch.

    What a user has set of it is not told by all drives, so that all of it is set. Returns the exchange of the first setting.
    """
    wanted = {"home_trigger": 0, "home_direction": _CW, "home_speed": 60, "end_limit": 0, "home_mode": 0, **values}
    done = []
    for command in (probe.dialect.by_verb[verb] for verb in SETS_HOME if verb in probe.dialect.by_verb):
        named = command.request_forms[0].layout.named
        given: dict[str, Any] = {n: v for n, v in wanted.items() if n in named}
        if "home_current" in named:
            given["home_current"] = 400
        if "return_angle" in named:
            given.setdefault("return_angle", named["return_angle"].default)
        done.append(probe.do(command, given))
    return done[0]


def find_home(probe: Probe) -> Exchange:
    """Ask for homing and follow it to its end. Raises Inconclusive where it is refused."""
    home = probe.command(Verb.HOME)
    telling = arriving.tells_end(probe.dialect)
    exchange = probe.ask(home, until=Until.DONE if telling else Until.REPLY, timeout_ns=_LIMIT_NS if telling else None)
    probe.reply(exchange)
    if probe.refused(exchange):
        raise Inconclusive("homing was refused")
    if not telling:
        motion.wait_until(probe, lambda: _status_now(probe) != HOMING, every_ns=200 * MS, limit_ns=_LIMIT_NS)
    return exchange


def ends_within(probe: Probe, limit_ns: int) -> bool:
    """Say whether homing that was begun ends by itself so soon; stop it where it does not."""
    motion.wait_until(probe, lambda: _status_now(probe) != HOMING, every_ns=50 * MS, limit_ns=limit_ns)
    if _status_now(probe) != HOMING:
        return True
    _halt(probe)
    motion.wait_standing(probe)
    return False


def _status_now(probe: Probe) -> int:
    return probe.read(Verb.READ_STATUS, "status")


def _prepared(probe: Probe, mode: str = "", **values: int) -> float:
    """Make a drive ready for homing; return where the shaft stands (counts of its own)."""
    motion.ready_to_move(probe, mode, subdivision=SUBDIVISION)
    # Away from where it was made, so that its zero is not by chance where homing ends.
    arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 216)
    set_home(probe, **values)
    return bench.shaft(probe)


def _founds(dialect: Dialect) -> tuple[str, ...]:
    """Return what a drive can find home by: a switch that is open or closed at first, a wall where it needs no switch."""
    return ("open", "closed", "wall") if _can_meet_a_wall(dialect) else ("open", "closed")


def places(dialect: Dialect) -> tuple[dict[str, Any], ...]:
    """Return rows of `mounted` in which each way is tried with all that home is found by."""
    return covering.rows({"direction": (_CW, _CCW), "found": _founds(dialect)})


def mounted(probe: Probe, direction: int, found: str, **values: int) -> str:
    """Mount what home is to be found by, and make the drive ready; return it for people."""
    way = _WAYS[direction]
    bench.wall(probe, None)
    bench.left_switch(probe, way * 100 * probe.dialect.counts_per_turn)
    _prepared(probe, "", home_direction=direction, home_mode=int(found == "wall"), **values)
    if found == "wall":
        bench.wall(probe, way * _SWITCH)
    elif found == "closed":
        bench.switch_here(probe, way, 1000)
    else:
        bench.left_switch(probe, way * 2 * probe.dialect.counts_per_turn)
    return ", ".join(f"{name} {value}" for name, value in {"home_direction": direction, "found": found, **values}.items())


def _expect_shaft(probe: Probe, exchange: Exchange, refutes: str, *, near: float, **how: Any) -> None:
    """Expect the shaft at a place (counts of its own); where it is elsewhere, stop it."""
    at = bench.shaft(probe)
    if abs(at - near) > probe.within("counts"):
        _halt(probe)
    probe.expect(at, near=near, unit="counts", refutes=refutes, exchange=exchange, **how)


def _expect_flags(probe: Probe, exchange: Exchange) -> None:
    """Refute unless the status is that of a motor that stands, neither protected nor on its way to a kept zero."""
    for verb, wanted in ((Verb.READ_STATUS, 1), (Verb.READ_ZERO_STATUS, 1), (Verb.READ_PROTECTION, 0)):
        if verb in probe.dialect.by_verb:
            seen = probe.read(verb, "status")
            text = f"{probe.command(verb).name} tells {seen} after homing"
            probe.expect(seen, equal=wanted, refutes=text, exchange=exchange)


def _expect_still(probe: Probe, exchange: Exchange, wait_ns: int, refutes: str) -> None:
    at = bench.shaft(probe)
    probe.wait(wait_ns)
    _expect_shaft(probe, exchange, refutes, near=at, expected="a shaft that stands")


def _halt(probe: Probe) -> None:
    probe.ask(Verb.EMERGENCY_STOP)


# --- where it ends ----------------------------------------------------------------------------------------------------


def _both_ways(dialect: Dialect) -> Iterator[Case]:
    for way in _DIRECTIONS:
        yield from (Case(dialect, case.command, {"way": way}) for case in _homings(dialect))


@_of_homing("a shaft that goes the other way or stops elsewhere", each=_both_ways, name="{command}/finds-switch-{way}")
def _finds_switch(probe: Probe, way: str) -> None:
    """Homing with direction {way} turns the shaft {way} until its end stop, at either level and in each mode."""
    direction = _DIRECTIONS[way]
    for row in covering.rows({"mode": declared.bus_modes(probe.dialect), "rpm": (60, 300), "trigger": (0, 1)}):
        trigger = row["trigger"]
        bench.left_switch(probe, _WAYS[direction] * 10 * probe.dialect.counts_per_turn, trigger)
        start = _prepared(probe, row["mode"], home_direction=direction, home_speed=row["rpm"], home_trigger=trigger)
        bench.left_switch(probe, _WAYS[direction] * _SWITCH, trigger)
        exchange = find_home(probe)
        probe.wait(500 * MS)
        text = f"homing at {row['rpm']} rpm in {row['mode']} does not end at the end stop"
        _expect_shaft(probe, exchange, text, near=start + _WAYS[direction] * _SWITCH)
        _expect_flags(probe, exchange)


@_of_homing("a shaft that does not leave the end stop, or stops elsewhere", each=_both_ways, name="{command}/from-closed-{way}")
def _from_closed(probe: Probe, command: Command, way: str) -> None:
    """From a closed end stop the shaft first turns the other way, then comes back to it, at either level."""
    direction = _DIRECTIONS[way]
    for trigger in (0, 1):
        start = _prepared(probe, home_direction=direction, return_angle=0x2000, home_trigger=trigger)
        bench.switch_here(probe, _WAYS[direction], 1000, trigger)
        exchange = probe.ask(command, quiet_ns=0)
        probe.reply(exchange)
        probe.wait(50 * MS)
        first = (bench.shaft(probe) - start) * _WAYS[direction]
        probe.wait(5 * SECOND_NS)
        if first >= 0:
            _halt(probe)
        text = "homing from a closed end stop does not leave it first"
        got = f"{first:.0f} counts towards it"
        probe.expect(got, holds=first < 0, expected="motion away from it", refutes=text, exchange=exchange)
        text = "homing from a closed end stop does not end at it"
        _expect_shaft(probe, exchange, text, near=start - _WAYS[direction] * 1000)


def _backing_off(dialect: Dialect) -> Iterator[Case]:
    return _both_ways(dialect) if Trait.BACKS_OFF_BY_ANGLE in dialect.traits else iter(())


@_of_homing("another distance", each=_backing_off, name="{command}/backs-off-{way}", at_best=Certainty.LIKELY)
def _backs_off(probe: Probe, command: Command, way: str) -> None:
    """From a closed end stop the shaft first goes back by the return angle, less than a turn or several turns."""
    direction = _DIRECTIONS[way]
    for angle in _ANGLES[1:]:
        start = _prepared(probe, home_direction=direction, return_angle=angle)
        bench.switch_here(probe, _WAYS[direction], 1000)
        exchange = probe.do(command)
        went = [0.0]

        def turns_round(start: float = start, went: list[float] = went) -> bool:
            went.append((start - bench.shaft(probe)) * _WAYS[direction])
            return went[-1] < max(went) - 4 * _BACK

        motion.wait_until(probe, turns_round, every_ns=10 * MS, limit_ns=_LIMIT_NS)
        _halt(probe)
        text = f"homing from a closed end stop does not go back by the return angle of {angle:#x}"
        probe.expect(max(went), near=angle, within=_BACK, unit="counts", refutes=text, exchange=exchange)


@_of_homing("another number")
def _zero(probe: Probe) -> None:
    """Where homing ends is zero: of the encoder, of the pulses, and for moves to a place; both ways, by a switch or a wall."""
    for row in places(probe.dialect):
        shown, way = mounted(probe, **row), _WAYS[row["direction"]]
        exchange = find_home(probe)
        probe.wait(500 * MS)
        for verb, name in ((Verb.READ_POSITION, "position"), (Verb.READ_PULSES, "pulses")):
            text = f"the {name} is not zero where homing ended"
            expected = f"0: {shown}"
            probe.expect(probe.read(verb, name), near=0, unit="counts", expected=expected, refutes=text, exchange=exchange)
        for move in probe.dialect.motions(MotionKind.MOVE_TO):
            # A drive may still stand at the wall.
            exchange = motion.begin(probe, move, -way * _BESIDE, rpm=120, acceleration=QUICK, start=0)
            probe.wait(SECOND_NS)
            went, within = abs(motion.stand_still(probe).value), motion.miss(probe) + motion.same(probe)
            text = f"{move.name} does not count from where homing ended"
            probe.expect(went, near=_BESIDE, within=within, unit="degrees from there", refutes=text, exchange=exchange)


def _without_switch(dialect: Dialect) -> Iterator[Case]:
    for way in _DIRECTIONS if _can_meet_a_wall(dialect) else ():
        for angle in _ANGLES:
            yield from (Case(dialect, case.command, {"way": way, "angle": angle}) for case in _homings(dialect))


def _can_meet_a_wall(dialect: Dialect) -> bool:
    """Say whether a drive can home without a switch."""
    return len(modes(dialect)) > 1


@_of_homing("another place", each=_without_switch, name="{command}/without-switch-{way}-{angle:x}")
def _is_held_then_zero(probe: Probe, way: str, angle: int) -> None:
    """Without an end stop the shaft turns {way} until it is held, goes back by {angle:#x} counts, and that point is zero."""
    direction = _DIRECTIONS[way]
    start = _prepared(probe, home_direction=direction, home_mode=1, return_angle=angle)
    bench.wall(probe, _WAYS[direction] * _SWITCH)
    exchange = find_home(probe)
    probe.wait(500 * MS)
    end = start + _WAYS[direction] * (_SWITCH - angle)
    _expect_shaft(probe, exchange, "homing without an end stop ends elsewhere", near=end)
    seen = probe.read(Verb.READ_POSITION, "position")
    text = "the position is not zero where homing ended"
    probe.expect(seen, near=0, unit="counts", refutes=text, exchange=exchange)


# --- on the way -------------------------------------------------------------------------------------------------------


def _expect_going_on(probe: Probe, since: int, command: Command) -> None:
    """Raise Inconclusive where homing was told as over: a closed end stop ends it before there is anything to see."""
    if set(_statuses(probe, since, command)) - {1}:
        raise Inconclusive("homing ends before there is anything to see: the end stop is closed already")


def _at_speeds(dialect: Dialect) -> Iterator[Case]:
    # 515 rpm are another speed with either byte first.
    for rpm in (60, 120, 515, *((600,) if dialect.mode_speeds else ()), 2000):
        yield from (Case(dialect, case.command, {"rpm": rpm}) for case in _homings(dialect))


@_of_homing("another speed", each=_at_speeds, name="{command}/speed-{rpm}")
def _speed(probe: Probe, command: Command, rpm: int) -> None:
    """With home_speed {rpm} homing turns the shaft at {rpm} rpm, at most at what the mode allows, either way."""
    highest = probe.dialect.mode_speeds
    for row in covering.rows({"mode": declared.bus_modes(probe.dialect), "direction": (_CW, _CCW)}):
        mode = row["mode"]
        _prepared(probe, mode, home_speed=rpm, home_direction=row["direction"])
        since = len(probe.traffic)
        exchange = probe.do(command)
        probe.wait(SECOND_NS)
        seen = abs(motion.speed(probe).value)
        _expect_going_on(probe, since, command)
        _halt(probe)
        motion.wait_standing(probe)
        wanted = min(rpm, highest.get(mode, rpm))
        text = f"homing in {mode} does not turn at the speed that was set"
        probe.expect(seen, near=wanted, within=1 + wanted / 100, unit="rpm", refutes=text, exchange=exchange)


@_of_homing("another status")
def _status(probe: Probe, command: Command) -> None:
    """While homing F1 reads 5, and afterwards 1, either way and in each mode."""
    for row in covering.rows({"mode": declared.bus_modes(probe.dialect), "direction": (_CW, _CCW)}):
        mode, direction = row["mode"], row["direction"]
        _prepared(probe, mode, home_direction=direction)
        # Four seconds at 60 rpm.
        bench.left_switch(probe, _WAYS[direction] * 4 * probe.dialect.counts_per_turn)
        exchange = probe.do(command)
        probe.wait(300 * MS)
        during = _status_now(probe)
        probe.wait(6 * SECOND_NS)
        seen = (during, _status_now(probe))
        _halt(probe)
        text = f"the status does not tell of homing and of its end in {mode} with home_direction {direction}"
        probe.expect(seen, equal=(HOMING, 1), refutes=text, exchange=exchange)


def _with_way_back(dialect: Dialect) -> Iterator[Case]:
    """Yield homing that turns both ways: from a closed end stop, and by an obstacle where the drive can do that."""
    for case in _homings(dialect):
        yield Case(dialect, case.command, {"how": "from-closed"}, {"statement": _ALL_THE_WAY.format("from a closed end stop")})
    for case in _without_switch(dialect):
        if not case["angle"]:
            statement = _ALL_THE_WAY.format(f"{case['way']} without an end stop")
            yield Case(dialect, case.command, {"how": f"without-switch-{case['way']}"}, {"statement": statement})


_ALL_THE_WAY = "Homing {} reads 5 until the shaft stands, on its way there and back."


@_of_homing("another status while the shaft turns", each=_with_way_back, name="{command}/status-{how}")
def _status_all_the_way(probe: Probe, command: Command, how: str) -> None:
    closed = how == "from-closed"
    way = _WAYS[_CCW if how.endswith("-ccw") else _CW]
    _prepared(probe, home_direction=_CCW if way > 0 else _CW, return_angle=0x3000, home_mode=int(not closed))
    if closed:
        bench.switch_here(probe, way, 8000)
    else:
        bench.wall(probe, way * _SWITCH)
    exchange = probe.do(command)
    motion.wait_until(probe, lambda: _status_now(probe) != HOMING, every_ns=20 * MS, limit_ns=_LIMIT_NS)
    seen = _status_now(probe)
    _expect_still(probe, exchange, 500 * MS, f"homing is told as over ({seen}) while the shaft turns")


@_of_homing("a shaft that stops at the low level, or runs on")
def _trigger(probe: Probe, command: Command) -> None:
    """With home_trigger 1 the end stop counts as reached when its pin is high: when it opens."""
    _prepared(probe, home_trigger=1)
    bench.press(probe)
    start = bench.shaft(probe)
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    turn, went = probe.dialect.counts_per_turn, bench.shaft(probe) - start
    if went > -turn / 4:
        _halt(probe)
    text = "with home_trigger 1 a low pin stops homing, or turns it round"
    probe.expect(went, at_most=-turn / 4, unit="counts in a second", refutes=text, exchange=exchange)
    bench.press(probe, False)
    probe.wait(300 * MS)
    _expect_still(probe, exchange, SECOND_NS, "with home_trigger 1 a high pin does not end homing")


@_of_homing("a motion, or an answer that says success", at_best=Certainty.LIKELY)
def _disabled(probe: Probe, command: Command) -> None:
    """Homing is refused while the motor is disabled."""
    start = _prepared(probe)
    probe.do(Verb.ENABLE, {"enabled": 0})
    exchange = probe.ask(command)
    answer = probe.reply(exchange)
    probe.wait(SECOND_NS)
    _expect_shaft(probe, exchange, "homing turns a disabled motor", near=start, expected="no motion")
    text = "homing is not refused while the motor is disabled"
    got = answer.data.hex(" ").upper()
    probe.expect(got, holds=probe.refused(exchange), expected="a refusal", refutes=text, exchange=exchange)


@_of_homing(
    "a motion, or an answer that says success",
    each=lambda dialect: _homings(dialect) if Verb.ENABLE in dialect.by_verb else (),
    name="{command}/off",
    emulated=False,
    risks=risks_by(Verb.ENABLE),
    settings=(),
    at_best=Certainty.OPEN,
)
def _off(probe: Probe, command: Command) -> None:
    """Homing as the drive is set turns nothing while the motor is disabled, and is refused."""
    motion.ready_to_move(probe)
    motion.switch(probe, False)
    expect_refused(probe, command, "while disabled", lambda: motion.switch(probe, True))


def _statuses(probe: Probe, since: int, command: Command) -> list[int]:
    return arriving.statuses(probe.traffic[since:], command)


@_of_homing("others", each=that_tell_their_end(_homings))
def _replies(probe: Probe, command: Command) -> None:
    """Homing is answered by 1 when it begins and by 2 when home is found: both ways, by an open or closed switch or a wall."""
    for row in covering.rows({"direction": (_CW, _CCW), "found": _founds(probe.dialect), "home_speed": (60, 300)}):
        shown, exchange, told = undamaged(probe, _homed, command, row)
        text = "homing is not answered by 1 and then 2"
        probe.expect(told, equal=[1, 2], expected=f"1, 2: {shown}", refutes=text, exchange=exchange)


def _homed(probe: Probe, command: Command, row: Mapping[str, Any]) -> tuple[str, Exchange, list[int]]:
    """Find home as a row says; return the row for people, the exchange, and all that homing was answered."""
    shown, since = mounted(probe, **row), len(probe.traffic)
    exchange = find_home(probe)
    probe.wait(2 * SECOND_NS)
    return shown, exchange, _statuses(probe, since, command)


@_of_homing("others", each=that_tell_their_end(_homings), at_best=Certainty.LIKELY)
def _told_though(probe: Probe, command: Command) -> None:
    """Homing goes on, and its end is told, though 92, a read or a setting comes on the way."""
    for verb in (Verb.SET_ZERO, Verb.READ_STATUS, Verb.SET_CURRENT):
        between = probe.command(verb)
        exchange, told = undamaged(probe, _homed_though, command, between)
        text = f"the end of homing is not told when {between.name} comes on the way"
        probe.expect(told, equal=[1, 2], refutes=text, exchange=exchange)


def _homed_though(probe: Probe, command: Command, between: Command) -> tuple[Exchange, list[int]]:
    """Find home and ask for something on the way; return what came of that, and all that homing was answered."""
    _prepared(probe)
    bench.left_switch(probe, -2 * probe.dialect.counts_per_turn)
    since = len(probe.traffic)
    probe.do(command)
    probe.wait(500 * MS)
    exchange = probe.ask(between, samples.sample(probe.dialect, between), quiet_ns=0)
    probe.wait(4 * SECOND_NS)
    return exchange, _statuses(probe, since, command)


# --- held at the end stop ---------------------------------------------------------------------------------------------


def _with_end_limit(dialect: Dialect) -> Iterator[Case]:
    lets_go = Trait.LETS_GO_AT_END_LIMIT in dialect.traits
    facts = {
        "name": "home/end-limit",
        "statement": f"With the end limit on, and off before, the shaft is {'let go' if lets_go else 'held'} at the end stop.",
        "refuted_by": "a motor that is enabled" if lets_go else "a motor that is disabled",
        "at_best": Certainty.CERTAIN if lets_go else Certainty.LIKELY,
    }
    for case in _homings(dialect):
        yield Case(dialect, case.command, {"end_limit": 1, "held": not lets_go}, facts)
        yield Case(dialect, case.command, {"end_limit": 0, "held": True})


@_of_homing("a motor that is disabled", each=_with_end_limit, name="{command}/holds", at_best=Certainty.LIKELY)
def _held_after(probe: Probe, end_limit: int, held: bool) -> None:
    """With the end limit off the shaft is held at the end stop, also where it was on before."""
    names = ("let go", "held")
    for direction, way in _WAYS.items():
        set_home(probe, end_limit=1 - end_limit, home_direction=direction)
        _prepared(probe, end_limit=end_limit, home_direction=direction)
        bench.left_switch(probe, way * _SWITCH)
        exchange = find_home(probe)
        probe.wait(500 * MS)
        is_held = bool(probe.read(Verb.READ_ENABLED, "enabled"))
        text = f"with end_limit {end_limit} and home_direction {direction} the shaft is {names[not held]} after homing"
        probe.expect(names[is_held], equal=names[held], refutes=text, exchange=exchange)
        bench.expect_hold(probe, held, f"with end_limit {end_limit} and home_direction {direction} after homing")
