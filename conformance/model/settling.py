"""Waits of a walk (`model.walk`) until the drive and its twin (`model.pair`) stand, or have their speed.

    let_end(pair)                              a move that was left to itself ends first, if it is near its end
    steady(pair, looks, given)                 a run gets its speed; it is looked at while it speeds up or slows down
    rest(pair, watched=True, lawful=True)      both come to rest, and what was said unasked meanwhile is compared

Rules kept here:
- A wait is as long as the law of ramps says and a little more. Where there is no law the speed of the shaft is read.
- A shaft that does not come to rest, where that of its twin does, refutes the drive.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from conformance.claim import Inconclusive
from conformance.model import adopting
from conformance.model.looks import WORTH_NS, Looks
from conformance.model.pair import Pair
from conformance.model.steps import ASIDE, LEAVE
from conformance.motion import motion, ramp
from conformance.motion.declared import QUICK
from conformance.talk.probe import MS, Until

#: Until a shaft has settled, one that does not tremble and one that does.
_SETTLES_NS, _TREMBLES_NS = 20 * MS, 120 * MS
#: What a move takes longer than the law at most.
_SLOW, _LATE_NS = 1.07, 150 * MS
#: How late what is told unasked was seen to come.
_BEHIND_NS = 800 * MS
#: By then a run has its speed.
_LONG_NS = 100_000 * MS
#: How long a shaft may take to come to rest that its twin's has, and the speed of one that surely turns.
_REST_NS, _TURNS_RPM = 15_000 * MS, 1.5
#: Where there is no law: how often and how far apart the speed of a run is read, and by how much a steady one changes.
_READS, _APART_NS, _STEADY_RPM = 40, 60 * MS, 0.5


def let_end(pair: Pair) -> None:
    """Let a motion that was left to itself come to its end if that is near: what is sent while it is told may be lost."""
    pair.catch_up()
    drive: Any = pair.twin.drive
    if pair.course.left_going and (not pair.twin.turning or drive.motor.settled - pair.twin.now_ns < WORTH_NS):
        pair.course.left_going = False
        rest(pair, watched=True, lawful=False)
        adopting.place(pair, anywhere=True)


def steady(pair: Pair, looks: Looks, given: Mapping[str, int]) -> None:
    """Wait until a run has its speed, or leave it while it rises. `given`: the values of its step."""
    if pair.dialect.ramp is None:
        _steady_by_speed(pair)
        return
    probe, course = pair.probe, pair.course
    # A mode or fine subdivisions may let the shaft turn slower than was asked.
    motor: Any = getattr(pair.twin.drive, "motor", None)
    before, course.rpm = course.rpm, motor.speed(pair.twin.now_ns + _LONG_NS) if "rpm" in given else 0
    most = max(abs(course.rpm - before), abs(course.rpm) * course.rising)
    lasts_ns = most * ramp.step_ns(given.get("acceleration", QUICK)) * _SLOW
    if lasts_ns > WORTH_NS:
        course.rising = True
        probe.wait(int(lasts_ns) // 3)
        looks.changing()
        if given.get(ASIDE):
            pair.send_aside(given[ASIDE])
        lasts_ns *= 2 / 3
    course.rising = bool(given.get(LEAVE))
    if not course.rising:
        probe.wait(int(lasts_ns) + (_TREMBLES_NS if probe.noise.live else 2 * _SETTLES_NS))


def _steady_by_speed(pair: Pair) -> None:
    last = motion.speed(pair.probe).value
    for _ in range(_READS):
        pair.probe.wait(_APART_NS)
        now = motion.speed(pair.probe).value
        if abs(now - last) < _STEADY_RPM + pair.probe.noise.of("rpm", now):
            break
        last = now
    pair.catch_up()


def rest(pair: Pair, *, watched: bool, lawful: bool) -> None:
    """Wait until both shafts stand, and compare what was said unasked meanwhile. Raises Refuted.

    `watched`: its end is not known. `lawful`: the manual says when it comes.
    """
    probe, twin, unasked = pair.probe, pair.twin, pair.unasked
    pair.catch_up()
    left_ns = 0.0
    if twin.turning or twin.drive.next_ns() is not None:
        begun_ns = twin.now_ns
        unasked.expect(twin.settle())
        left_ns = twin.now_ns - begun_ns
    missing = unasked.missing()
    until_ns = probe.gate.now_ns() + int(left_ns * _SLOW) + (_LATE_NS + 5 * probe.noise.latency_ns if missing > 0 else 0)
    while (now_ns := probe.gate.now_ns()) < until_ns and (missing > 0 or left_ns):
        heard = probe.listen(until_ns - now_ns, Until.REPLY if missing > 0 else Until.TIMEOUT)
        missing = unasked.missing()
        if missing <= 0 and heard.answers:
            break
    if pair.dialect.ramp is None or watched:
        limit_ns = int(left_ns * (_SLOW - 1)) + 2 * _LATE_NS + 5 * probe.noise.latency_ns
        _watch(pair, limit_ns if lawful and pair.dialect.ramp is not None and not twin.turning else _REST_NS)
    probe.wait(_TREMBLES_NS if probe.noise.live or probe.noise.lag else _SETTLES_NS)
    pair.anchor()
    if unasked.missing() > 0:
        probe.listen(_BEHIND_NS)
    # What was left to itself has ended by now.
    left, pair.course.left = pair.course.left, -1
    if (different := unasked.taken(left)) is not None:
        pair.refute("what is said at the end of a motion", *different)


def _watch(pair: Pair, limit_ns: int) -> None:
    """Read the speed until the shaft stands. Raises Refuted where it turns on."""
    try:
        motion.wait_standing(pair.probe, limit_ns=limit_ns)
    except Inconclusive:
        rpm = motion.speed(pair.probe).value
        if abs(rpm) > _TURNS_RPM + pair.probe.noise.rpm:
            pair.refute("the shaft does not come to rest", "0 rpm", f"{rpm:.3g} rpm")
        raise
