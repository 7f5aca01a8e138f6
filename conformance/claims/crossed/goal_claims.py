"""What motions without a law of ramps do in all conditions, and what is read meanwhile: the rows of `claims.crossed.goals`.

    motions     taken, told truly by their own reply, end where asked, at their speed, ended or left alone by 80, 81 and 88
    9C 94 90    where the position has the shaft, at the speed at which that changes
    9A 9D       on, with the flags of before; phase currents that are those of the torque

Rules kept here:
- The position is what the other reads are held against; that it does not jump is a claim of its own.
- A torque current is judged where it is steady: how it rises no manual says.
- The speed that a way is long enough for is reckoned by the least ramp that the suite asks of a drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claim import Aspect, Inconclusive
from conformance.claims.crossed.goals import (
    FORCES,
    OFF,
    ON,
    STOP,
    Edge,
    Tried,
    apart,
    cases,
    crossed,
    first_of,
    first_rows,
    met_after_s,
    motions_of,
    moves,
    reads_of,
    samples,
    speeds,
)
from conformance.claims.crossed.looks import Look
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import of_motion, of_rows, risks_by
from conformance.motion import declared, motion
from conformance.motion.declared import FORCE
from conformance.motion.motion import Sample
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe

#: The least ramp that the suite asks of a drive (deg/s2), and by how much a speed may be off beside its share, in rpm.
_LEAST_RAMP, _RPM = 1800, 1.0
#: So many degrees before its end a move that a stop ended is not over: one that slows down already ends where it would have.
_WELL_BEFORE = 20
#: A speed that replies leave more uncertain than this share is not judged.
_BLIND = 0.1
#: How long a speed must last to be seen.
_SEEN_S = 0.1
#: From when on, of the begin of a run or torque, its speed and current are steady.
_STEADY_NS = 550 * MS
#: What a drive turns at on its own at most, and how far a position may jump beside that, in rpm and degrees.
_FASTEST, _JUMP = 400, 5.0
#: How long a speed that is read may stay behind, and by how much two speeds that are steady differ.
_FILTER_NS, _CHANGES = 150 * MS, 0.1
#: How far a place within the turn may differ from the shaft's way (degrees), and how old it may be.
_OFF, _OLD_S = 2.0, 0.02
#: What is read of the place within the turn, and how many units a turn may have.
_WITHIN_TURN: Mapping[Verb, tuple[str, tuple[int, ...]]] = {
    Verb.READ_ENCODER: ("encoder", (1 << 14, 1 << 15, 1 << 16)),
    Verb.READ_STATE_2: ("encoder", (1 << 14, 1 << 15, 1 << 16)),
    Verb.READ_SINGLE_TURN: ("angle", (36_000,)),
}
#: A turn of the encoder that has the fewest bits, and the counts of the finest one in one of its counts.
_TURN, _FINEST = 1 << 14, 4
#: How far a shaft may turn between two looks at that (degrees): farther on the finest encoder tells no way.
_TOLD_APART = 40
#: Fields of a state that tremble.
_TREMBLES = {"temperature", "voltage", "current"}
_all_motions = risks_by(Verb.RUN_SPEED, Verb.MOTOR_OFF, Verb.MOTOR_ON, Verb.STOP)
_STRENGTHS = ("torque_current", "power")


def _position(case: Case) -> tuple[str, ...]:
    assert case.command is not None
    return ("position",) if declared.of(case.command).kind is MotionKind.MOVE_TO else ()


def _rows(probe: Probe, command: Command, *, few: bool = False) -> tuple[Tried, ...]:
    """Return what the rows of a motion showed, or its first `few`."""
    found = first_of(probe, command) if few else probe.recorded(crossed, command)
    sound = tuple(tried for tried in found if not tried.damaged)
    if 2 * len(sound) < len(found):
        raise Inconclusive("the line damaged something of most motions")
    return sound


_of_goals = partial(of_rows, _rows, each=cases, at_best=Certainty.LIKELY, risks=_all_motions, settings=_position)


# --- the motions ------------------------------------------------------------------------------------------------------


@_of_goals(name="{command}/crossed-taken", refuted_by="no answer")
def _taken(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} is answered in all conditions, and so is what comes on its way."""
    for tried in rows:
        for edge in tried.edges:
            assert edge.exchange.command is not None  # it was asked for
            text = f"{edge.exchange.command.name} is not answered in one condition"
            holds, expected = edge.exchange.is_read, f"an answer: {tried.row}"
            probe.expect("no answer", holds=holds, expected=expected, refutes=text, exchange=edge.exchange)


@_of_goals(name="{command}/crossed-tells", refuted_by="another temperature, torque current, speed or encoder")
def _tells(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} is answered with what 9C tells: at rest, and while the shaft turns either way, slow and fast."""
    for tried in rows:
        for edge in (tried.begun, tried.again):
            answer = edge.exchange.reply if edge is not None else None
            if edge is not None and answer is not None and edge.exchange.is_read:
                first, last = (one.values for one in edge.states)
                if first is not None and last is not None:
                    what = f"{command.name} is answered with"
                    _expect_between(probe, what, edge, first, answer.values, last)
                    # What comes once more changes nothing, and a move by nothing does nothing.
                    if edge is tried.again or (declared.of(command).kind is MotionKind.MOVE_BY and not tried.target):
                        _expect_strength(probe, what, edge, first, answer.values, last)


def _expect_between(
    probe: Probe, what: str, edge: Edge, first: Mapping[str, int], told: Mapping[str, int], last: Mapping[str, int]
) -> None:
    """Refute unless a reply tells what 9C told before and after it, or something between."""
    shown: dict[str, Any] = {"exchange": edge.exchange}
    text = f"{what} another temperature than 9C tells"
    probe.expect(told["temperature"], near=first["temperature"], unit="degC", refutes=text, **shown)
    low, high = sorted((first["speed"], last["speed"]))
    # Each of the three is one read of a speed that trembles.
    top = max(abs(low), abs(high))
    slack = probe.within("deg/s", top) + probe.noise.of("deg/s", top)
    text = f"{what} another speed than 9C tells"
    probe.expect(told["speed"], at_least=low - slack, at_most=high + slack, unit="deg/s", refutes=text, **shown)
    before, behind = edge.states
    elapsed = (behind.span[1] - before.span[0]) / 1e9
    if max(abs(values["speed"]) for values in (first, told, last)) * elapsed > _TOLD_APART:
        return
    gone, way = (((values["encoder"] - first["encoder"] + _TURN // 2) % _TURN) - _TURN // 2 for values in (told, last))
    slack = _FINEST * probe.within("counts")
    probe.expect(
        str(told["encoder"]),
        holds=min(0, way) - slack <= gone <= max(0, way) + slack,
        expected=f"{first['encoder']} to {last['encoder']}, as 9C tells",
        refutes=f"{what} another encoder value than 9C tells",
        **shown,
    )


def _expect_strength(
    probe: Probe, what: str, edge: Edge, first: Mapping[str, int], told: Mapping[str, int], last: Mapping[str, int]
) -> None:
    # Where it changes at the command, it may have been anything between.
    for name in (name for name in _STRENGTHS if name in told and abs(first[name] - last[name]) <= FORCE / 4):
        low, high = sorted((first[name], last[name]))
        text, within = f"{what} another {name} than 9C tells", FORCE / 4
        shown: dict[str, Any] = {"exchange": edge.exchange, "refutes": text, "unit": "LSB"}
        probe.expect(told[name], at_least=low - within, at_most=high + within, **shown)


@_of_goals(name="{command}/crossed-ends", refuted_by="another way")
def _ends(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} goes as requested, slow and fast, from rest and out of a run, also if the motor is switched on meanwhile."""
    for tried in rows:
        if tried.row.meets in (STOP, OFF):
            continue
        text = f"{command.name} goes elsewhere in one condition"
        stands, expected = tried.stood or not moves(command), f"standing: {tried.row}"
        probe.expect("a shaft that turns on", holds=stands, expected=expected, refutes=text)
        if not moves(command):
            went = tried.went(probe) * tried.row.way
            # A weak torque may not turn a real shaft.
            if not tried.row.start and abs(went) >= 1:
                expected = f"{tried.row.way:+d}: {tried.row}"
                probe.expect(f"{went:+.1f} degrees", holds=went > 0, expected=expected, refutes=text)
            continue
        low, high = _wanted(probe, tried)
        within = motion.miss(probe) + (probe.noise.swing if tried.row.start else 0.0)
        probe.expect(
            _gone(probe, tried),
            at_least=low - within,
            at_most=high + within,
            unit="degrees",
            expected=f"{low:.6g} to {high:.6g} degrees: {tried.row}",
            refutes=text,
            exchange=tried.begun.exchange,
        )


def _wanted(probe: Probe, tried: Tried) -> tuple[float, float]:
    """Return between which places a move ends, in degrees from where its row began."""
    if not tried.row.start or declared.of(tried.command).kind is not MotionKind.MOVE_BY:
        return tried.target, tried.target
    # It goes on from where the shaft was when it came.
    rest = samples(probe, tried.before)[-1].value
    sides = [one.value - rest for one in samples(probe, tried.begun.places)]
    if len(sides) < 2:
        raise Inconclusive("the position cannot be read")
    return min(sides) + tried.target, max(sides) + tried.target


def _gone(probe: Probe, tried: Tried) -> float:
    """Return how far a move went; one to an angle of a turning shaft but for whole turns."""
    went = tried.went(probe)
    if tried.row.start and declared.of(tried.command).kind is MotionKind.MOVE_IN_TURN:
        return tried.target + (went - tried.target + 180) % 360 - 180
    return went


@_of_goals(name="{command}/crossed-stopped", refuted_by="a shaft that goes on, or another state")
def _stopped(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} is ended by 80 and 81: the shaft stands, and 80 leaves the motor off. 88 takes nothing up and ends nothing."""
    for tried in rows:
        edge = tried.met
        if edge is None:
            continue
        assert edge.exchange.command is not None  # it was asked for
        ending = edge.exchange.command.name
        text = f"{ending} does not end {command.name} in one condition"
        shown: dict[str, Any] = {"exchange": edge.exchange}
        probe.expect("a shaft that turns", holds=tried.stood, expected=f"standing: {tried.row}", refutes=text, **shown)
        if tried.row.meets is not ON and moves(command) and not tried.row.start:
            at, went = samples(probe, edge.places), tried.went(probe)
            left = abs(tried.target) - abs(at[-1].value - samples(probe, tried.before)[-1].value) if len(at) > 1 else 0.0
            if left > 0 and left > _slows_down(at[0], at[-1]) + _WELL_BEFORE:
                short = abs(went - tried.target) > motion.miss(probe)
                probe.expect(f"{went:.1f} degrees", holds=short, expected=f"less: {tried.row}", refutes=text, **shown)
        states = {"off": tried.off, "on": (*tried.after, *(tried.ending if tried.row.meets is ON else ()))}
        for wanted, looks in states.items():
            for one in looks:
                if one.read.verb is Verb.READ_STATE_1 and one.values is not None:
                    text = f"the motor is not {wanted} after {ending}"
                    holds = (one.values["state"] != 0) == (wanted == "off")
                    expected = f"{wanted}: {tried.row}"
                    probe.expect(one.values["state"], holds=holds, expected=expected, refutes=text, exchange=one.exchange)
        if tried.off:
            moved = samples(probe, tried.after)[-1].value - samples(probe, tried.off)[-1].value
            text = f"switching the motor on takes {command.name} up again"
            most = motion.same(probe)
            probe.expect(abs(moved), at_most=most, unit="degrees", expected=str(tried.row), refutes=text)


def _slows_down(first: Sample, last: Sample) -> float:
    """Return how far a shaft may still go that slows down from the speed between two places, in degrees."""
    rpm, uncertain = motion.speed_between(first, last)
    return (6 * (abs(rpm) + uncertain)) ** 2 / 2 / _LEAST_RAMP


@_of_goals(name="{command}/crossed-speed", refuted_by="another speed, or another way")
def _speed(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} turns the shaft no faster than it is told, and as fast where the way is long, as its positions tell."""
    if declared.of(command).kind is MotionKind.TORQUE or not declared.of(command).speed:
        return
    for tried in rows:
        row, text = tried.row, f"{command.name} turns at another speed in one condition"
        runs = not moves(command)
        begun_ns = tried.begun.exchange.sent_ns
        # What a run turned at before is not its own.
        since_ns = begun_ns + (_STEADY_NS if runs or row.start else 0)
        looks = (*tried.during, *tried.ending) if row.meets is ON and not runs else tried.during
        seen = [
            (rpm * row.way if runs else abs(rpm), spread)
            for first, _, rpm, spread in speeds(samples(probe, looks))
            if first.t_ns >= since_ns and spread <= abs(rpm) * _BLIND
        ]
        if not seen:
            continue
        share = row.rpm * CLOCK_SHARE + _RPM
        shown: dict[str, Any] = {"refutes": text, "exchange": tried.begun.exchange, "unit": "rpm"}
        fastest = max(rpm - spread for rpm, spread in seen)
        probe.expect(fastest, at_most=row.rpm + share, expected=f"at most {row.rpm + share:.4g} rpm: {row}", **shown)
        if runs or _has_its_speed(tried):
            reached = min(rpm + spread for rpm, spread in seen) if runs else max(rpm + spread for rpm, spread in seen)
            probe.expect(reached, at_least=row.rpm - share, expected=f"at least {row.rpm - share:.4g} rpm: {row}", **shown)


def _first_cases(dialect: Dialect) -> Iterator[Case]:
    first = {row.command for row in first_rows(dialect)}
    return (case for case in cases(dialect) if case.command is not None and case.command.name in first)


@of_motion(
    each=_first_cases,
    name="{command}/crossed-first",
    refuted_by="no answer, or another reply, way, speed or end in one condition",
    at_best=Certainty.LIKELY,
    risks=_all_motions,
)
def _first(probe: Probe, command: Command) -> None:
    """{command} is answered, goes and ends as asked in a few motions, in which each condition comes once."""
    rows = _rows(probe, command, few=True)
    for judge in (_taken, _tells, _ends, _stopped, _speed):
        judge(probe, command, rows)


def _has_its_speed(tried: Tried) -> bool:
    """Say whether a move from rest is so long, or long enough under way when something comes, that it has its speed."""
    row, speed = tried.row, tried.row.rpm * 6
    if row.start:
        return False
    if row.meets is None:
        # Up and down again, by the least ramp.
        return row.turns * 360 >= speed**2 / _LEAST_RAMP
    return met_after_s(row) >= speed / _LEAST_RAMP + _SEEN_S


# --- what is read meanwhile ---------------------------------------------------------------------------------------------


class _Seen(NamedTuple):
    """A look at a read with those at the position beside it, all looks of its phase, and when it was."""

    tried: Tried
    before: Look
    look: Look
    after: Look
    phase: tuple[Look, ...]
    when: str

    @property
    def values(self) -> Mapping[str, int]:
        assert self.look.values is not None  # it was answered
        return self.look.values


def _reads(dialect: Dialect) -> Iterator[Case]:
    risks = frozenset().union(*(c.all_risks for c in motions_of(dialect)))
    for read in (dialect.by_verb[Verb.READ_POSITION], *reads_of(dialect)) if risks else ():
        facts = {"aspect": Aspect.STATE, "settings": ("position",), "name": "{command}/crossed"}
        yield Case(dialect, read, facts=facts | {"risks": declared.risks(dialect, *risks, *dialect.by_verb[OFF].all_risks)})


def _first_reads(dialect: Dialect) -> Iterator[Case]:
    few = {"settings": (), "name": "{command}/crossed-first"}
    return (Case(dialect, case.command, facts={**case.facts, **few}) for case in _reads(dialect) if first_rows(dialect))


def _recorded(probe: Probe, *, few: bool) -> Iterator[Tried]:
    for command in motions_of(probe.dialect):
        if probe.dialect.model or not command.models:
            yield from _rows(probe, command, few=few)


def _looks(probe: Probe, read: Command, *, few: bool) -> Iterator[_Seen]:
    """Yield what a read told before, on the way and at the end of every motion, or of the first `few`."""
    for tried in _recorded(probe, few=few):
        phases = {"at rest before": tried.before, "on the way of": tried.during, "after what came on the way of": tried.ending}
        phases |= {"while off after": tried.off, "at rest after": tried.after}
        for when, looks in phases.items():
            for before, one, after in apart(looks):
                if one.read.name == read.name:
                    yield _Seen(tried, before, one, after, looks, f"{when} {tried.row}")


@of_motion(each=_reads, refuted_by="no answer, or another value in one condition", at_best=Certainty.LIKELY)
def _read(probe: Probe, command: Command) -> None:
    """{command} is answered and tells what the shaft does in all motions, before, on the way of and after each of them."""
    _judge(probe, command, few=False)


@of_motion(each=_first_reads, refuted_by="no answer, or another value in one condition", at_best=Certainty.LIKELY)
def _first_read(probe: Probe, command: Command) -> None:
    """{command} is answered and tells what the shaft does in a few motions, in which each condition comes once."""
    _judge(probe, command, few=True)


def _judge(probe: Probe, command: Command, *, few: bool) -> None:
    if command.verb is Verb.READ_POSITION:
        _expect_no_jumps(probe, few=few)
        return
    widths = set(_WITHIN_TURN[command.verb][1]) if command.verb in _WITHIN_TURN else set()
    for seen in _looks(probe, command, few=few):
        text = f"{command.name} is not answered in one condition, twice"
        shown: dict[str, Any] = {"expected": f"an answer, {seen.when}", "exchange": seen.look.exchange}
        probe.expect("no answer", holds=seen.look.values is not None, refutes=text, **shown)
        if widths:
            _expect_within_turn(probe, seen, widths)
        for judge in _JUDGES.get(command.verb, ()):
            judge(probe, seen)


def _expect_no_jumps(probe: Probe, *, few: bool) -> None:
    """Refute where the position changes by more than a shaft can turn between two looks."""
    for tried in _recorded(probe, few=few):
        every = (*tried.before, *tried.begun.places, *tried.during, *(tried.met.places if tried.met else ()))
        looks = tuple(sorted({one.span: one for one in (*every, *tried.ending, *tried.off, *tried.after)}.items()))
        places = samples(probe, tuple(one for _, one in looks))
        for first, last in pairwise(places):
            most = _FASTEST * 6 * (last.t_ns - first.t_ns + first.spread_ns + last.spread_ns) / 1e9 + _JUMP + probe.noise.swing
            text = "the position jumps in one condition"
            jump, expected = abs(last.value - first.value), f"at most {most:.4g} degrees: {tried.row}"
            probe.expect(jump, at_most=most, unit="degrees", expected=expected, refutes=text)


def _expect_within_turn(probe: Probe, seen: _Seen, widths: set[int]) -> None:
    """Refute where a place within the turn goes on otherwise than the position; `widths`: those that fit all of before."""
    name, _ = _WITHIN_TURN[seen.look.read.verb]
    rest = next((s for s in apart(seen.tried.before) if s[1].read.name == seen.look.read.name), None)
    if rest is None or rest[1].values is None:
        return
    origin, low, high = (sample.value for sample in samples(probe, (rest[0], seen.before, seen.after)))
    low, high = sorted((low - origin, high - origin))
    elapsed = (seen.after.span[1] - seen.before.span[0]) / 1e9
    beside = _OFF + probe.noise.place + (high - low) / max(elapsed, 1e-3) * _OLD_S
    told, since = seen.values[name], rest[1].values[name]
    fits = {turn for turn in widths if ((told - since) * 360 / turn - (low - beside)) % 360 <= high - low + 2 * beside}
    widths &= fits
    text = f"{seen.look.read.name} tells another place than the position in one condition"
    expected = f"{low:.4g} to {high:.4g} degrees from {since}, {seen.when}"
    probe.expect(str(told), holds=bool(widths), expected=expected, refutes=text, exchange=seen.look.exchange)


def _expect_speed(probe: Probe, seen: _Seen) -> None:
    """Refute where the speed that is read is not that of the positions of a while in which that is steady."""
    first_ns, last_ns = seen.look.span
    places = [s for s in samples(probe, seen.phase) if first_ns - _FILTER_NS <= s.t_ns <= last_ns + _FILTER_NS / 2]
    around = list(speeds(places))
    if not around or places[0].t_ns > first_ns - _FILTER_NS / 2 or places[-1].t_ns < last_ns:
        return
    if around[-1][0].t_ns < around[0][1].t_ns:
        # All of them are over one pause between two looks, in which the speed may have changed.
        return
    low, high = min(rpm for *_, rpm, _ in around), max(rpm for *_, rpm, _ in around)
    unsure = max(spread for *_, spread in around)
    if high - low > _RPM + _CHANGES * max(abs(low), abs(high)) or unsure > _RPM + _BLIND * abs(high):
        return
    # By as much as mean speeds differ, the speed of a moment may be beyond them: where it rises to a peak and falls again.
    beside = _RPM + max(unsure, high - low) + CLOCK_SHARE * max(abs(low), abs(high))
    probe.expect(
        seen.values["speed"] / 6,
        at_least=low - beside,
        at_most=high + beside,
        unit="rpm",
        expected=f"{low:.5g} to {high:.5g} rpm, {seen.when}",
        refutes=f"{seen.look.read.name} tells another speed in one condition",
        exchange=seen.look.exchange,
    )


def _torque(seen: _Seen) -> int | None:
    """Return the torque that was asked for where it is steady, as sent, else None."""
    if declared.of(seen.tried.command).kind is not MotionKind.TORQUE or seen.phase is not seen.tried.during:
        return None
    long = seen.look.span[0] - seen.tried.begun.exchange.sent_ns >= _STEADY_NS / 2
    met = seen.tried.met is not None and seen.look.span[1] > seen.tried.met.exchange.sent_ns
    return FORCES[seen.tried.row.rpm] * seen.tried.row.way if long and not met else None


def _expect_torque(probe: Probe, seen: _Seen) -> None:
    name = next(n for n in _STRENGTHS if n in seen.values)
    shown: dict[str, Any]
    wanted = _torque(seen)
    rest = next((one.values for one in seen.tried.before if one.read.name == seen.look.read.name), None)
    if seen.phase is seen.tried.off:
        text = f"{seen.look.read.name} tells a {name} of a motor that is off"
        shown = {"expected": f"none, {seen.when}", "exchange": seen.look.exchange}
        probe.expect(abs(seen.values[name]), at_most=FORCE / 3, unit="LSB", refutes=text, **shown)
    elif seen.phase is seen.tried.after and rest is not None:
        text = f"{seen.look.read.name} tells another {name} at rest than before a motion"
        shown = {"expected": f"about {rest[name]} LSB, {seen.when}", "exchange": seen.look.exchange}
        probe.expect(seen.values[name], near=rest[name], within=FORCE, unit="LSB", refutes=text, **shown)
    if wanted is not None:
        text = f"{seen.look.read.name} tells another {name} than was asked for in one condition"
        shown = {"expected": f"about {wanted} LSB, {seen.when}", "exchange": seen.look.exchange}
        probe.expect(seen.values[name], near=wanted, within=FORCE / 4, unit="LSB", refutes=text, **shown)


def _expect_phases(probe: Probe, seen: _Seen) -> None:
    """Refute where phase currents do not add up to nothing, or are not those of a steady torque; off, where there are any."""
    wanted = _torque(seen)
    currents = [seen.values[f"phase_{phase}_current"] for phase in "abc"]
    if seen.phase is seen.tried.off:
        text = "phase currents are told of a motor that is off"
        most, expected = max(map(abs, currents)), f"none, {seen.when}"
        probe.expect(most, at_most=FORCE / 3, unit="LSB", expected=expected, refutes=text, exchange=seen.look.exchange)
    if wanted is None:
        return
    shown: dict[str, Any] = {"exchange": seen.look.exchange, "expected": f"those of {wanted} LSB, {seen.when}"}
    flowing = math.sqrt(sum(current * current for current in currents) / 1.5)
    text = "the phase currents are not those of the torque current in one condition"
    probe.expect(flowing, near=abs(wanted), within=FORCE / 3, unit="LSB", refutes=text, **shown)
    text = "the phase currents do not add up to nothing in one condition"
    holds = abs(sum(currents)) <= max(4, max(map(abs, currents)) / 4)
    probe.expect(" + ".join(map(str, currents)), holds=holds, refutes=text, **shown)


def _expect_state(probe: Probe, seen: _Seen) -> None:
    """Refute where another state or another flag is told than at rest; off alone differs, after 80."""
    rest = next((one.values for _, one, _ in apart(seen.tried.before) if one.read.name == seen.look.read.name), None)
    if rest is None:
        return
    switched = {"state"} if seen.tried.row.meets is OFF else set()
    for name in sorted(seen.values.keys() - _TREMBLES - switched):
        text = f"{seen.look.read.name} tells another {name} than at rest in one condition"
        shown: dict[str, Any] = {"expected": f"{rest[name]}, {seen.when}", "exchange": seen.look.exchange}
        probe.expect(seen.values[name], holds=seen.values[name] == rest[name], refutes=text, **shown)


def _expect_temperature(probe: Probe, seen: _Seen) -> None:
    first = next((one.values for one in seen.tried.before if one.values is not None and "temperature" in one.values), None)
    if first is not None:
        text = f"{seen.look.read.name} tells another temperature in one condition"
        shown: dict[str, Any] = {"expected": f"{first['temperature']} degC, {seen.when}", "exchange": seen.look.exchange}
        probe.expect(seen.values["temperature"], near=first["temperature"], unit="degC", refutes=text, **shown)


_JUDGES: Mapping[Verb, tuple[Callable[[Probe, _Seen], None], ...]] = {
    Verb.READ_STATE_2: (_expect_speed, _expect_torque, _expect_temperature),
    Verb.READ_STATE_1: (_expect_state, _expect_temperature),
    Verb.READ_STATE_3: (_expect_phases, _expect_temperature),
}
