"""What is read while motions are under way, in all conditions: each read tells what the shaft does, and reads agree.

    32 speed        that of the course                    30, 33 places    between two looks at the position
    F1 status       rests, rises, full speed, falls       39 error         small
    3A 3B 3E 34     what they told at rest, but for a port that tells whether a move has arrived

All of it is judged on the rows of `claims.crossed.course`, of every motion: on its ramps, at its speed, and at rest again.

Rules kept here:
- A value may be that of any moment between a request and its reply; a speed may be that of a moment before.
- The sense of pulses is not told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Aspect
from conformance.claims.crossed.course import Tried, crossed, first_of, motions_of, reads_of, sense, sound
from conformance.claims.crossed.looks import Look, place
from conformance.claims.declare import Case
from conformance.claims.known_quirks import known
from conformance.claims.motion.motion_claim import of_motion
from conformance.motion import declared
from conformance.motion.course import Trend
from conformance.motion.declared import MOVES, SAME
from conformance.talk import settings
from conformance.talk.noise import CLOCK_SHARE, COUNT, TOLD_LATE_NS
from conformance.talk.probe import MS, Probe

#: How long a read speed may lag, and the angle error of a free shaft in motion and at rest (degrees).
_FILTER_NS, _LAG, _REST = 100 * MS, 45.0, 1.0
#: What F1 of real drives was seen to do.
_STATUS_QUIRKS = _EARLY, _STAYS = "status-stops-early", "status-stays-slowing"
#: The motor status of each trend.
_STATUSES = {Trend.RESTS: 1, Trend.RISES: 2, Trend.FALLS: 3, Trend.STEADY: 4}

#: The port that tells whether a move has arrived.
_IN_PLACE = "pend"


class _Seen(NamedTuple):
    """A look at a read, the motion it belongs to, and the looks at the position beside it. `rests`: the shaft stood.

    `sense`: 1 where a positive way of the motion raises the position, else -1.
    """

    tried: Tried
    look: Look
    before: Look
    after: Look
    rests: bool
    sense: int

    @property
    def values(self) -> Mapping[str, int]:
        assert self.look.values is not None  # it was answered
        return self.look.values


def _cases(dialect: Dialect) -> Iterator[Case]:
    risks = frozenset().union(*(c.all_risks for c in motions_of(dialect)))
    for read in reads_of(dialect) if risks else ():
        quirks = known(dialect, *_STATUS_QUIRKS) if read.verb is Verb.READ_STATUS else ()
        yield Case(dialect, read, facts={"risks": declared.risks(dialect, *risks), "aspect": Aspect.STATE, "quirks": quirks})


def _looks(probe: Probe, read: Command, *, few: bool) -> Iterator[_Seen]:
    """Yield what a read told on the way and at the end of every motion, or of the first `few`."""
    for command in motions_of(probe.dialect):
        rows = first_of(probe, command) if few else probe.recorded(crossed, command)
        usual = sense(command, rows)
        for tried in sound(rows):
            # What a motion does the wrong way is judged there.
            way = usual if tried.row.start or not tried.went else 1 if tried.went * tried.row.way > 0 else -1
            yield from _of(tried, read, tried.during, rests=False, way=way)
            yield from _of(tried, read, tried.after, rests=True, way=way)


def _of(tried: Tried, read: Command, looks: tuple[Look, ...], *, rests: bool, way: int) -> Iterator[_Seen]:
    for number, look in enumerate(looks):
        if look.read.name == read.name:
            before, after = tried.places(looks[:number]), tried.places(looks[number:])
            if before and after:
                yield _Seen(tried, look, before[-1], after[0], rests, way)


@of_motion(
    each=_cases, name="{command}/crossed", refuted_by="no answer, or another value in one condition", at_best=Certainty.LIKELY
)
def _crossed(probe: Probe, command: Command) -> None:
    """{command} is answered and tells what the shaft does in all motions, at each moment of them."""
    _judge(probe, command, few=False)


def _of_few(dialect: Dialect) -> Iterator[Case]:
    # The port that tells whether a shaft is in place is known by all motions alone.
    return (case for case in _cases(dialect) if case.command is not None and case.command.verb is not Verb.READ_IO)


@of_motion(
    each=_of_few,
    name="{command}/crossed-first",
    refuted_by="no answer, or another value in one condition",
    at_best=Certainty.LIKELY,
)
def _crossed_first(probe: Probe, command: Command) -> None:
    """{command} is answered and tells what the shaft does in a few motions, in which each condition comes once."""
    _judge(probe, command, few=True)


def _judge(probe: Probe, command: Command, *, few: bool) -> None:
    judge = _JUDGES[command.verb]
    if judge is _ports and _divides(probe):
        judge = _ports_but_pend
    for seen in _looks(probe, command, few=few):
        when = "at rest after" if seen.rests else "on the way of"
        text = f"{command.name} is not answered {'at rest' if seen.rests else 'while the shaft turns'}, twice"
        answered = seen.look.values is not None
        probe.expect("no answer", holds=answered, expected="an answer", refutes=text, exchange=seen.look.exchange)
        judge(probe, seen, f"{when} {seen.tried.row}")


def _fail(seen: _Seen, what: str) -> str:
    return f"{seen.look.read.name} {what} {'at rest' if seen.rests else 'while the shaft turns'} in one condition"


def _speed(probe: Probe, seen: _Seen, when: str) -> None:
    on, (first_ns, last_ns) = seen.tried.spans(seen.look)
    low, high = sorted(seen.sense * rpm for rpm in on.rpm(first_ns - _FILTER_NS, last_ns))
    beside = 1 + CLOCK_SHARE * on.top
    probe.expect(
        seen.values["speed"],
        at_least=low - beside,
        at_most=high + beside,
        unit="rpm",
        expected=f"{low:.5g} to {high:.5g} rpm, {when}",
        refutes=_fail(seen, "tells another speed"),
        exchange=seen.look.exchange,
    )


def _status(probe: Probe, seen: _Seen, when: str) -> None:
    on, (first_ns, last_ns) = seen.tried.spans(seen.look)
    trends = on.trends(first_ns - TOLD_LATE_NS, last_ns)
    if first_ns < TOLD_LATE_NS:
        # It may still tell of the time before, or of a first step.
        trends |= {Trend.RESTS, Trend.RISES, Trend.STEADY} if on is seen.tried.course else {Trend.STEADY, Trend.FALLS}
    status, wanted = seen.values["status"], sorted(_STATUSES[trend] for trend in trends)
    if status in wanted:
        return
    if status == 1 and Trend.FALLS in trends and _EARLY in probe.claim.quirks:
        probe.meets(_EARLY)
    elif status == 3 and Trend.RESTS in trends and _STAYS in probe.claim.quirks:
        probe.meets(_STAYS)
    else:
        expected = f"{' or '.join(map(str, wanted))}, {when}"
        text = _fail(seen, "tells another state")
        probe.expect(status, among=wanted, expected=expected, refutes=text, exchange=seen.look.exchange)


def _place(probe: Probe, seen: _Seen, when: str) -> None:
    turn = probe.dialect.counts_per_turn
    text, exchange = _fail(seen, "tells another place than read_position"), seen.look.exchange
    told = seen.values["carry"] * turn + seen.values["encoder"]
    low, high = sorted((place(seen.before), place(seen.after)))
    within = probe.within("counts") + (0.0 if seen.rests else probe.noise.swing / COUNT)
    expected = f"{low} to {high} counts, {when}"
    inside = low - within <= told <= high + within and 0 <= seen.values["encoder"] < turn
    # A shaft that turns round between two looks was beyond both.
    if inside or seen.tried.row.start >= 0:
        probe.expect(f"{told} counts", holds=inside, expected=expected, refutes=text, exchange=exchange)


def _pulses(probe: Probe, seen: _Seen, when: str) -> None:
    turn = 200 * seen.tried.row.subdivision
    rest = next((look for look in seen.tried.before if look.read.name == seen.look.read.name), None)
    if rest is None or rest.values is None or seen.tried.row.start:
        return
    begin = place(seen.tried.places(seen.tried.before)[-1])
    low, high = sorted(360 / probe.dialect.counts_per_turn * (place(look) - begin) for look in (seen.before, seen.after))
    went = (seen.values["pulses"] - rest.values["pulses"]) * 360 / turn
    went *= -1 if went * (low + high) < 0 else 1
    beside = (_REST if seen.rests else _LAG) + SAME
    probe.expect(
        went,
        at_least=low - beside,
        at_most=high + beside,
        unit="degrees",
        expected=f"{low:.5g} to {high:.5g} degrees as positions have it, {when}",
        refutes=_fail(seen, "does not go on as read_position does"),
        exchange=seen.look.exchange,
    )


def _error(probe: Probe, seen: _Seen, when: str) -> None:
    field = seen.look.read.reply_forms[0].layout.named["angle_error"]
    error = abs(float(field.physical(seen.values["angle_error"])))
    most = _REST if seen.rests else _LAG
    text, expected = _fail(seen, "is that of a shaft that is held"), f"at most {most:g} degrees, {when}"
    probe.expect(error, at_most=most, unit="degrees", expected=expected, refutes=text, exchange=seen.look.exchange)


def _as_at_rest(probe: Probe, seen: _Seen, when: str) -> None:
    rest = next(look for look in seen.tried.before if look.read.name == seen.look.read.name)
    text, expected = _fail(seen, "tells another state than before"), f"{rest.values}, {when}"
    probe.expect(
        str(seen.values), holds=seen.values == rest.values, expected=expected, refutes=text, exchange=seen.look.exchange
    )


def _divides(probe: Probe) -> bool:
    """Say whether a user has set the drive to show its pulses on the port that tells whether the shaft is in place."""
    command = probe.dialect.by_verb.get(Verb.SET_PULSE_DIVISION)
    return command is not None and bool((settings.read_back(probe, command)[0] or {}).get("division_period"))


def _ports_but_pend(probe: Probe, seen: _Seen, when: str) -> None:
    _ports(probe, seen, when, but=_IN_PLACE)


def _ports(probe: Probe, seen: _Seen, when: str, but: str = "") -> None:
    rest = next(look for look in seen.tried.before if look.read.name == seen.look.read.name)
    wanted = {name: value for name, value in (rest.values or {}).items() if name != but}
    if _IN_PLACE in wanted and not seen.rests:
        on, (first_ns, last_ns) = seen.tried.spans(seen.look)
        slow, fast = on.rpm(first_ns - TOLD_LATE_NS, last_ns)
        moves = declared.of(seen.tried.command).kind in MOVES
        del wanted[_IN_PLACE]
        # Whether a run is in place no manual says; a port that was written tells nothing of the shaft.
        if moves and slow * fast > 0 and _tells_moves(probe):
            wanted[_IN_PLACE] = 0
    got = {name: seen.values[name] for name in wanted}
    text = _fail(seen, "tells other levels")
    probe.expect(got, equal=wanted, expected=f"{wanted}, {when}", refutes=text, exchange=seen.look.exchange)


def _tells_moves(probe: Probe) -> bool:
    """Say whether the port of a shaft in place was seen at 0, on the way of any move."""
    for command in motions_of(probe.dialect):
        for tried in probe.recorded(crossed, command) if declared.of(command).kind in MOVES else ():
            if any(look.values is not None and look.values.get(_IN_PLACE) == 0 for look in tried.during):
                return True
    return False


_JUDGES: Mapping[Verb, Callable[[Probe, _Seen, str], None]] = {
    Verb.READ_SPEED: _speed,
    Verb.READ_STATUS: _status,
    Verb.READ_ENCODER_CARRY: _place,
    Verb.READ_PULSES: _pulses,
    Verb.READ_ANGLE_ERROR: _error,
    Verb.READ_ENABLED: _as_at_rest,
    Verb.READ_PROTECTION: _as_at_rest,
    Verb.READ_ZERO_STATUS: _as_at_rest,
    Verb.READ_IO: _ports,
}
