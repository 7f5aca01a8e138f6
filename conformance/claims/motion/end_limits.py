"""End limits: with the limit on, a shaft does not run beyond a closed end stop, and motion away from it goes on.

Tried on emulated drives, where end stops are where a claim mounts them: the left one is found by homing and is then zero,
the right one stands two turns from it. A pin without a switch that is at its level all the time shows a limit without hands.

Rules kept here:
- A changed limit holds only after homing, so every claim homes first.
- A move that a limit ends says 3. What a run says when it is to go on towards a closed limit is not printed.
- Drives were seen to ignore the command that follows a limit stop (quirk deaf-after-limit-stop): it is sent again.
- A right limit is there on a 57, and on the smaller drives once the ports are remapped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Trait, Verb
from conformance.claim import Inconclusive, NotRun
from conformance.claims import bench
from conformance.claims.declare import Case, Cases, commands
from conformance.claims.known_quirks import known, may_meet
from conformance.claims.motion import homing
from conformance.claims.motion.motion_claim import expect_stays, of_motion, risks_by, that_tell_their_end
from conformance.model import covering
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import QUICK, RUNS_AND_MOVES, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe, Until

#: Where the left end stop is found (counts), and where homing leaves the shaft afterwards.
_LEFT, _HALF = -3000, 8000
#: How many turns the right end stop is from the left one, and how long the moves are that are to meet one.
_RIGHT_TURNS, _LONG_TURNS = 2, 4
#: How fast motions meet one: the slow one is as slow as one goes by hand, the fast one beyond half of any drive's speed.
_RPM, _SLOW, _FAST = 120, 15, 1600
#: How motions that meet one come to their speed: by a steep ramp, and at once.
_RAMPS = (QUICK, 0)
#: Without a switch: how fast motions are asked for, how long they have to begin, and how long homing has to end.
_PIN_RPM, _STARTS_NS, _SOON_NS = 30, 200 * MS, 1500 * MS
#: How far homing goes back from a pin that is at its level (counts).
_BACK = 0x800
#: What turns the shaft.
_TURNING = (
    Verb.RUN_SPEED,
    Verb.MOVE_RELATIVE_PULSES,
    Verb.MOVE_ABSOLUTE_PULSES,
    Verb.MOVE_RELATIVE_AXIS,
    Verb.MOVE_ABSOLUTE_AXIS,
)
_DEAF = "deaf-after-limit-stop"


def _fields(case: Case) -> tuple[str, ...]:
    return (*homing.fields(case.dialect), "limit_remap", "respond", "active")


_settings = commands(Verb.SET_HOME)


def _motions(*kinds: MotionKind) -> Cases:
    def cases(dialect: Dialect) -> Iterator[Case]:
        for case in _settings(dialect):
            yield from (Case(dialect, case.command, {"run": run}) for run in dialect.motions(*kinds))

    return cases


_moves = _motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO)
_runs_and_moves = _motions(*RUNS_AND_MOVES)


def _of_limits(refuted_by: str, *, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    risks = risks_by(Verb.RUN_SPEED, Verb.HOME, *homing.SETS_HOME, Verb.SET_RESPOND)
    return of_motion(each=each, refuted_by=refuted_by, emulated=True, risks=risks, settings=_fields, **facts)


def _deaf_after_moves(case: Case) -> tuple[str, ...]:
    # A run tells no stop, and no drive was seen to be deaf after one.
    return () if case["run"].motion.kind is MotionKind.RUN else known(case.dialect, _DEAF)


# --- between the end stops --------------------------------------------------------------------------------------------


def _homed(probe: Probe, end_limit: int = 1, side: int = -1, mode: str = "", trigger: int = 0) -> None:
    """Find the left end stop and go back half a turn from it; the right one stands beyond.

    `side`: the way in which left lies, 1 where counts rise. `trigger`: the level of a pin at its end stop.
    """
    motion.ready_to_move(probe, mode, subdivision=SUBDIVISION)
    ways = {"home_direction": 1} if side > 0 else {}
    homing.set_home(probe, end_limit=end_limit, home_speed=60, home_trigger=trigger, **ways)
    bench.left_switch(probe, -side * _LEFT, trigger)
    bench.right_switch(probe, -side * (_LEFT + _RIGHT_TURNS * probe.dialect.counts_per_turn), trigger)
    homing.find_home(probe)
    probe.wait(500 * MS)
    # Homing may have let the shaft go.
    probe.do(Verb.ENABLE, {"enabled": 1})
    move = arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), -side * _degrees(probe, _HALF))
    if end_limit:
        text = "a move away from the end limit that homing found is not carried out"
        probe.expect(abs(move.degrees), at_least=1, unit="degrees", refutes=text, exchange=move.exchange)
    if abs(move.degrees + side * _degrees(probe, _HALF)) > motion.same(probe):
        raise Inconclusive(f"a move by {_HALF} counts between the end stops went {move.degrees:+.2f} degrees")


def _degrees(probe: Probe, counts: int) -> float:
    return counts * 360 / probe.dialect.counts_per_turn


def _sense_of(probe: Probe, command: Command) -> int:
    # The sense of counts is known; that of a direction bit and of pulses is not.
    return _sense(probe, command) if declared.of(command).direction or declared.takes_pulses(command) else 1


def _values(
    probe: Probe, command: Command, way: int, sense: int = 0, rpm: int = _RPM, acceleration: int = QUICK
) -> dict[str, int]:
    """Return the values of a long motion down (-1) or up (1). `sense`: the drive's sense of direction, if known."""
    sense = sense or _sense_of(probe, command)
    start, turned = motion.place(probe, command), way * sense
    how = {"rpm": rpm * turned if declared.of(command).kind is MotionKind.RUN else rpm, "acceleration": acceleration}
    return declared.values_of(probe.dialect, command, _LONG_TURNS * 360 * turned, start=start, **how)


def _sense(probe: Probe, command: Command) -> int:
    """Return which way direction 0, or a greater position, turns the shaft: 1 where counts rise."""
    before = motion.position(probe)
    if command.motion is not None and command.motion.kind is MotionKind.RUN:
        motion.run_at(probe, 30, QUICK)
        probe.wait(200 * MS)
        after = motion.stand_still(probe)
    else:
        after = arriving.follow(probe, command, 7.2, acceleration=QUICK).end
    return 1 if after.value > before.value else -1


def _send_left(probe: Probe, command: Command, rpm: int = _RPM, acceleration: int = QUICK) -> Exchange:
    values = _values(probe, command, -1, rpm=rpm, acceleration=acceleration)
    exchange = probe.ask(command, values, timeout_ns=10 * SECOND_NS)
    probe.reply(exchange)
    probe.wait(_time_to_meet(probe, _HALF, rpm))
    return exchange


def _time_to_meet(probe: Probe, counts: int, rpm: int) -> int:
    """Return how long to wait until a shaft has gone so far, and well beyond if nothing stops it (ns)."""
    return 3 * SECOND_NS * max(1, counts * _RPM // (rpm * probe.dialect.counts_per_turn))


# --- towards the limit ------------------------------------------------------------------------------------------------


@_of_limits(
    "a shaft that runs beyond it", each=_runs_and_moves, name="{command}/end-limit-stops-{run}", quirks=_deaf_after_moves
)
def _stops_at(probe: Probe, run: Command) -> None:
    """With the end limit on, {run} towards the left stops at its end stop, in each mode, at any speed, at both levels."""
    factors = {"mode": run.modes or ("",), "rpm": (_RPM, _SLOW, _FAST), "trigger": (0, 1), "ramp": _RAMPS}
    for row in covering.rows(factors):
        mode = row["mode"]
        _homed(probe, mode=mode, trigger=row["trigger"])
        exchange = _send_left(probe, run, row["rpm"], row["ramp"])
        seen = probe.read(Verb.READ_POSITION, "position")
        if abs(seen) > probe.within("counts"):
            motion.stop(probe)
        text = f"{run.name} does not stop at an end limit of level {row['trigger']} {mode and 'in ' + mode}".rstrip()
        expected = "0, where the end stop is"
        probe.expect(seen, near=0, unit="counts", expected=expected, refutes=text, exchange=exchange)
        _hear_again(probe)


@_of_limits(
    "a shaft that runs beyond it", each=_runs_and_moves, name="{command}/end-limit-stops-{run}-ccw", quirks=_deaf_after_moves
)
def _stops_at_the_other_side(probe: Probe, run: Command) -> None:
    """With the end limit on and homing counter-clockwise, {run} that way stops at the left end stop, and goes back from it."""
    for rpm in (_RPM, _SLOW, _FAST):
        _homed(probe, side=1, mode=run.modes[0] if run.modes else "")
        # The sense is found before the shaft stands at a limit, where it could not be.
        sense = _sense_of(probe, run)
        for way in (1, -1):
            exchange = _ask_again(probe, run, _values(probe, run, way, sense, rpm if way > 0 else _RPM))
            probe.wait(_time_to_meet(probe, _HALF, rpm) if way > 0 else SECOND_NS)
            seen = probe.read(Verb.READ_POSITION, "position")
            if way > 0:
                text = f"{run.name} does not stop at an end limit that lies counter-clockwise"
                expected = "0, where the end stop is"
                probe.expect(seen, near=0, unit="counts", expected=expected, refutes=text, exchange=exchange)
        motion.stop(probe)
        text = f"{run.name} does not go back from an end limit"
        probe.expect(-seen, at_least=_HALF / 4, unit="counts", refutes=text, exchange=exchange)


def _with_right_limit(dialect: Dialect) -> Iterator[Case]:
    if Verb.SET_LIMIT_REMAP in dialect.by_verb or dialect.model.startswith("57"):
        yield from _runs_and_moves(dialect)


@_of_limits(
    "a shaft that runs beyond it",
    each=_with_right_limit,
    name="{command}/end-limit-stops-{run}-right",
    quirks=_deaf_after_moves,
)
def _stops_at_the_right(probe: Probe, run: Command) -> None:
    """With the end limit on, {run} towards the right stops at its end stop, in each mode, at any speed, at both levels."""
    motion.ready_to_move(probe)
    if Verb.SET_LIMIT_REMAP in probe.dialect.by_verb:
        probe.do(Verb.SET_LIMIT_REMAP, {"limit_remap": 1})
    right = _RIGHT_TURNS * probe.dialect.counts_per_turn
    for row in covering.rows({"mode": run.modes or ("",), "trigger": (0, 1), "rpm": (_RPM, _SLOW, _FAST)}):
        _homed(probe, mode=row["mode"], trigger=row["trigger"])
        exchange = _ask_again(probe, run, _values(probe, run, 1, rpm=row["rpm"]))
        probe.wait(_time_to_meet(probe, right, row["rpm"]))
        seen = probe.read(Verb.READ_POSITION, "position")
        motion.stop(probe)
        text, expected = f"{run.name} does not stop at the right end limit", f"{right}, where the right end stop is"
        probe.expect(seen, near=right, unit="counts", expected=expected, refutes=text, exchange=exchange)
        _hear_again(probe)


def _ask_again(probe: Probe, command: Command, values: dict[str, int]) -> Exchange:
    """Ask for a motion after a limit stop. Where the drive is deaf then, as was seen of real drives, ask again."""
    exchange = probe.ask(command, values, timeout_ns=10 * SECOND_NS)
    if exchange.silent and _DEAF in probe.claim.quirks:
        exchange = probe.ask(command, values, timeout_ns=10 * SECOND_NS)
        if not exchange.silent:
            probe.meets(_DEAF)
    probe.reply(exchange)
    return exchange


def _hear_again(probe: Probe) -> None:
    """Ask a drive that stood at a limit for a move by nothing: where it is deaf, it hears what comes behind."""
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    _ask_again(probe, move, declared.values_of(probe.dialect, move, 0, rpm=_RPM, acceleration=QUICK))


@_of_limits("a shaft that runs beyond it", each=_runs_and_moves, name="{command}/end-limit-holds-{run}", quirks=may_meet(_DEAF))
def _holds_at(probe: Probe, run: Command) -> None:
    """With the end limit on, {run} towards an end stop that is closed turns nothing, at both levels."""
    for trigger in (0, 1):
        _homed(probe, trigger=trigger)
        values = _values(probe, run, -1)
        _send_left(probe, probe.command(Verb.MOVE_RELATIVE_AXIS))
        before = motion.position(probe)
        exchange = _ask_again(probe, run, values)
        probe.wait(2 * SECOND_NS)
        after = motion.position(probe)
        motion.stop(probe)
        expect_stays(before, after, exchange, f"{run.name} towards a closed end limit of level {trigger} turns the shaft")
        _hear_again(probe)


def _met(probe: Probe, run: Command, respond: int, active: int) -> Iterator[tuple[str, Exchange, list[int]]]:
    """Run into the left end stop, which lies clockwise and then counter-clockwise, and into the right one: what each told."""
    motion.ready_to_move(probe)
    if Verb.SET_LIMIT_REMAP in probe.dialect.by_verb:
        probe.do(Verb.SET_LIMIT_REMAP, {"limit_remap": 1})
    for side, way, where in ((-1, -1, "left, clockwise"), (1, 1, "left, counter-clockwise"), (-1, 1, "right")):
        _homed(probe, side=side)
        values = _values(probe, run, way)
        probe.do(Verb.SET_RESPOND, {"respond": respond, "active": active})
        since = len(probe.traffic)
        until = (Until.DONE if active else Until.REPLY) if respond else Until.TIMEOUT
        exchange = probe.ask(run, values, until=until, timeout_ns=(10 if respond else 2) * SECOND_NS)
        probe.wait(2 * SECOND_NS)
        told = arriving.statuses(probe.traffic[since:], run)
        probe.do(Verb.SET_RESPOND, {"respond": 1, "active": 1})
        yield where, exchange, told
        _hear_again(probe)


def _answering_moves(dialect: Dialect) -> Iterator[Case]:
    if Verb.SET_RESPOND in dialect.by_verb:
        yield from that_tell_their_end(_moves)(dialect)


@_of_limits("another status", each=_answering_moves, name="{command}/end-limit-told-{run}", quirks=_deaf_after_moves)
def _told(probe: Probe, run: Command) -> None:
    """{run} that an end limit stops is answered by 1 and then by 3, at each side."""
    for where, exchange, told in _met(probe, run, respond=1, active=1):
        text = f"{run.name} that an end limit stops is not answered 1 and 3"
        probe.expect(told, equal=[1, 3], expected=f"1, 3: {where}", refutes=text, exchange=exchange)


@_of_limits("another answer", each=_answering_moves, name="{command}/end-limit-inactive-{run}", at_best=Certainty.LIKELY)
def _not_told(probe: Probe, run: Command) -> None:
    """{run} that an end limit stops is answered with active 0 when it begins alone, and not at all with respond 0."""
    for respond, active, wanted in ((1, 0, [1]), (0, 1, [])):
        text = f"{run.name} that an end limit stops is told although {'active' if respond else 'respond'} is 0"
        for where, exchange, told in _met(probe, run, respond, active):
            probe.expect(told, equal=wanted, expected=f"{wanted or 'silence'}: {where}", refutes=text, exchange=exchange)


# --- without a switch -------------------------------------------------------------------------------------------------


def _backing_off(dialect: Dialect) -> Iterator[Case]:
    """Yield the setting where homing from a closed end stop goes back by an angle: it ends at a pin that never changes."""
    if Trait.BACKS_OFF_BY_ANGLE in dialect.traits:
        yield from _settings(dialect)


@of_motion(
    each=_backing_off,
    name="{command}/end-limit-by-level",
    refuted_by="a shaft that turns on",
    risks=risks_by(Verb.HOME, *homing.SETS_HOME, *_TURNING),
    settings=_fields,
    at_best=Certainty.LIKELY,
    quirks=may_meet(_DEAF),
)
def _by_level(probe: Probe, command: Command) -> None:
    """Where home_trigger is the level of a pin without a switch, homing ends at once, and nothing turns to the left then."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    homing.set_home(probe)
    runs = [(run, _sense_of(probe, run)) for run in probe.dialect.motions(*RUNS_AND_MOVES)]
    if not any(_homes_at_once(probe, trigger) for trigger in (1, 0)):
        raise Inconclusive("homing ends at once with neither level of home_trigger")
    probe.do(Verb.ENABLE, {"enabled": 1})
    for run, sense in runs:
        before = motion.position(probe)
        exchange = _ask_again(probe, run, _values(probe, run, -1, sense, _PIN_RPM))
        probe.wait(_STARTS_NS)
        after = motion.position(probe)
        motion.stand_still(probe)
        text = f"{run.name} goes on to the left although the pin of the end limit is at home_trigger"
        expect_stays(before, after, exchange, text, motion.same(probe))


def _homes_at_once(probe: Probe, trigger: int) -> bool:
    """Say whether homing ends soon with a level; stop it where it does not."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    homing.set_home(probe, end_limit=1, home_trigger=trigger, return_angle=_BACK)
    exchange = probe.ask(Verb.HOME)
    probe.reply(exchange)
    if probe.refused(exchange):
        raise Inconclusive("homing was refused")
    return homing.ends_within(probe, _SOON_NS)


# --- away from the limit, and without one -----------------------------------------------------------------------------


@_of_limits("a refusal, or no motion", each=_settings, name="{command}/end-limit-lets-back", quirks=may_meet(_DEAF))
def _lets_back(probe: Probe) -> None:
    """With the end limit on, each motion away from a closed end stop is carried out, as far as it was asked to."""
    for run in probe.dialect.motions(*RUNS_AND_MOVES):
        _homed(probe)
        sense = _sense_of(probe, run)
        _send_left(probe, probe.command(Verb.MOVE_RELATIVE_AXIS))
        before = motion.position(probe)
        runs, asked = declared.of(run).kind is MotionKind.RUN, _degrees(probe, _AWAY)
        how = {"rpm": sense * _RPM if runs else _RPM, "acceleration": QUICK, "start": motion.place(probe, run)}
        exchange = _ask_again(probe, run, declared.values_of(probe.dialect, run, sense * asked, **how))
        probe.wait(200 * MS if runs else 2 * SECOND_NS)
        end = motion.stand_still(probe) if runs else motion.wait_standing(probe)
        went = end.value - before.value
        # A run goes on until it is stopped.
        far = went >= 10 if runs else abs(went - asked) <= 1
        probe.expect(
            f"{went:+.1f} degrees",
            holds=not probe.refused(exchange) and far,
            expected="+10 degrees and more" if runs else f"{asked:+.1f} degrees",
            refutes=f"{run.name} away from an end limit is not carried out",
            exchange=exchange,
        )


#: How far a move goes away from an end stop, in counts.
_AWAY = 4000


@_of_limits("a shaft that stops at it", each=_settings, name="{command}/end-limit-off")
def _off_passes(probe: Probe) -> None:
    """With the end limit off, the end stop does not stop the shaft."""
    _homed(probe, end_limit=0)
    amount = -_HALF - 4000
    move = arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), _degrees(probe, amount))
    text = "an end stop stops the shaft although the end limit is off"
    near = _degrees(probe, amount)
    probe.expect(move.degrees, near=near, unit="degrees", refutes=text, exchange=move.exchange)


# --- the right end stop -----------------------------------------------------------------------------------------------


def _remaps(dialect: Dialect) -> Iterator[Case]:
    remap = dialect.by_verb.get(Verb.SET_LIMIT_REMAP)
    if remap is not None:
        statement = "Without remapped ports the right end stop holds on a 57 and not on a smaller drive."
        yield Case(dialect, remap, {"remap": 0, "word": "off"}, {"statement": statement})
        yield Case(dialect, remap, {"remap": 1, "word": "on"})


@_of_limits("a right limit that is there, or is not, against this", each=_remaps, name="{command}/right-{word}")
def _right(probe: Probe, command: Command, remap: int) -> None:
    """With the ports remapped the right end stop holds."""
    motion.ready_to_move(probe)
    probe.do(command, {"limit_remap": remap})
    _homed(probe)
    wanted = bool(remap) or bench.drive_of(probe).model.startswith("57")
    move, turn = probe.command(Verb.MOVE_RELATIVE_AXIS), probe.dialect.counts_per_turn
    exchange = motion.ask(probe, move, _LONG_TURNS * 360, rpm=120, acceleration=QUICK)
    if motion.refused(probe, exchange):
        raise NotRun("the move was refused")
    probe.wait(5 * SECOND_NS)
    seen, right = probe.read(Verb.READ_POSITION, "position"), _RIGHT_TURNS * turn
    probe.expect(
        seen,
        holds=(abs(seen - right) <= probe.within("counts")) is wanted,
        expected=f"{right}, where the right end stop is" if wanted else f"{_HALF + _LONG_TURNS * turn}",
        refutes=f"with limit_remap {remap} the right end stop {'does not hold' if wanted else 'holds'}",
        exchange=exchange,
    )
