"""What each motion does in all conditions: it is answered, goes as far as asked, and keeps to the course of the law.

All of it is judged on the rows of `claims.crossed.course`.

Rules kept here:
- Which way the direction bit and the sign of pulses turn the shaft is not judged; that it is one way in all conditions is.
- A run is followed to its stop, which has the acceleration of the run.
- The course is held against positions alone, so that no other read can hide or make a failure.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, MotionKind
from conformance.claims.crossed.course import Tried, cases, crossed, first_of, moved, sense, sound
from conformance.claims.crossed.looks import place
from conformance.claims.known_quirks import LATE, may_meet
from conformance.claims.motion.motion_claim import expect_between, of_motion, of_rows, that_tell_their_end
from conformance.claims.motion.ramps import TOO_LATE_NS
from conformance.motion import arriving, declared, motion
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE, COUNT
from conformance.talk.probe import Probe

#: A speed that replies leave more uncertain than this share is not judged.
_BLIND = 0.1
#: No loop corrects the error of an encoder that is off the shaft's centre: seven counts of 16384 either way were seen.
_OPEN_DEGREES = 14 * COUNT


_of_all = partial(of_rows, lambda probe, command: probe.recorded(crossed, command))


@_of_all(each=cases, name="{command}/crossed-taken", refuted_by="a refusal, or no answer")
def _taken(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} is taken in all conditions: fast and slow, either way, by any ramp, in each mode and subdivision."""
    for tried in rows:
        text = f"{command.name} is refused or not answered in one condition"
        # What the line damaged is no answer of the drive's.
        holds = not tried.refused or tried.damaged
        probe.expect(str(tried.row), holds=holds, expected="an answer", refutes=text, exchange=tried.begun)


@_of_all(
    each=that_tell_their_end(cases),
    name="{command}/crossed-replies",
    refuted_by="other statuses, or another order",
    quirks=may_meet(LATE),
)
def _replies(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} and its stop are answered in all conditions as the manual says, begin and end."""
    for tried in sound(rows):
        if LATE in probe.claim.quirks and tried.latest_ns / 2 > TOO_LATE_NS:
            # What is told at the end may then come before what was told at the begin.
            probe.meets(LATE)
            continue
        for exchange, told, wanted in _told(tried):
            assert exchange.command is not None  # it was asked for
            text = f"{exchange.command.name} has other replies in one condition"
            expected = f"{wanted}: {tried.row}"
            probe.expect(told, equal=wanted, refutes=text, exchange=exchange, expected=expected)


def _told(tried: Tried) -> Iterator[tuple[Exchange, list[int], list[int]]]:
    """Yield the commands of a row with what they were answered, and with what the manual says."""
    begins, ends = [1], [1, 2]
    yield tried.begun, list(tried.told), ends if tried.stopped is None else begins
    if tried.stopped is not None:
        yield tried.stopped, list(tried.told_of_stop), ends


@_of_all(each=cases, name="{command}/crossed-ends", refuted_by="another way, or another direction in one condition")
def _ends(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} goes the same way for a direction, and as far as it was asked to, in all conditions."""
    way = sense(command, rows)
    for tried in sound(rows):
        if tried.row.start:
            continue
        # A command that counts places by pulses goes from the whole pulse at which it stands.
        within = declared.near(probe.dialect) + (
            180 / declared.units_per_turn(probe.dialect, command, tried.row.subdivision)
            if declared.takes_pulses(command) and declared.of(command).kind is MotionKind.MOVE_TO
            else 0.0
        )
        within += _OPEN_DEGREES if "open" in tried.row.mode else 0.0
        low, high = sorted(way * 360 * turns for turns in _end(tried))
        text = f"{command.name} goes elsewhere in one condition"
        expect_between(probe, tried.went * COUNT, (low, high), within, tried.row, text, tried.begun)


def _end(tried: Tried) -> tuple[float, float]:
    """Return between which places a row ends, in turns from its begin, if the drive keeps to the law."""
    return tried.turns(tried.after[-1])


@_of_all(
    each=cases,
    name="{command}/crossed-course",
    refuted_by="a place that no such ramp or speed leads to",
    at_best=Certainty.LIKELY,
)
def _course(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} is on the course of the law in all conditions: on its ramps and at its speed."""
    for tried in sound(rows):
        if tried.row.start or not moved(tried):
            continue
        begin = place(tried.places(tried.before)[-1])
        way = 1 if tried.went * tried.row.way > 0 else -1
        text = f"{command.name} leaves the course of its ramps and speed in one condition"
        for look in tried.places(tried.during):
            low, high = sorted(way * 360 * turns for turns in tried.turns(look))
            after_ms = (look.span[0] - tried.begun.sent_ns) / 1e6
            probe.expect(
                (place(look) - begin) * COUNT,
                at_least=low - probe.noise.swing,
                at_most=high + probe.noise.swing,
                unit="degrees",
                expected=f"{low:.6g} to {high:.6g} degrees, {after_ms:.0f} ms on: {tried.row}",
                refutes=text,
                exchange=look.exchange,
            )


@_of_all(each=cases, name="{command}/crossed-speed", refuted_by="another speed in one condition", at_best=Certainty.LIKELY)
def _speed(probe: Probe, command: Command, rows: tuple[Tried, ...]) -> None:
    """{command} turns the shaft at the speed that was asked for in all conditions, as its positions tell."""
    for tried in sound(rows):
        steady = _steady(tried, probe.noise.place)
        if len(steady) < 2:
            continue
        seen, spread = motion.speed_between(steady[0], steady[-1])
        wanted = tried.course.top
        if spread > wanted * _BLIND:
            continue
        text = f"{command.name} turns at another speed in one condition"
        within = wanted * CLOCK_SHARE + spread
        expected = f"{wanted:g} rpm +-{within:.3g}: {tried.row}"
        probe.expect(abs(seen), near=wanted, within=within, unit="rpm", refutes=text, expected=expected, exchange=tried.begun)


@of_motion(
    each=cases,
    name="{command}/crossed-first",
    refuted_by="a refusal, other replies, or another way, place or speed in one condition",
    at_best=Certainty.LIKELY,
)
def _first(probe: Probe, command: Command) -> None:
    """{command} is taken, ends where asked and keeps its course and speed in a few motions, each condition once."""
    rows = first_of(probe, command)
    told = (_replies,) if arriving.tells_end(probe.dialect) else ()
    for judge in (_taken, *told, _ends, _course, _speed):
        judge(probe, command, rows)


def _steady(tried: Tried, noise: float) -> list[Sample]:
    """Return the positions at which a shaft surely had its full speed; they may be off by `noise` degrees."""
    found = []
    for look in tried.places(tried.during):
        on, span = tried.spans(look)
        low, high = on.rpm(*span)
        if on is tried.course and min(abs(low), abs(high)) == on.top and low * high > 0:
            half_ns = (look.span[1] - look.span[0]) / 2
            found.append(Sample(look.span[0] + half_ns, half_ns, place(look) * COUNT, COUNT, noise))
    return found
