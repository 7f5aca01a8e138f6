"""By what ramp the speed of an LK motor changes all the way: from rest, while a motion is changed, and to its end.

    speed |     /--\\            30 rpm, then 60, then 20, then 30 the other way, and to rest: each change in two halves,
          |  /--    \\--         each half with a slope of its own
          |_/          \\    ___ time
          |             \\__/

Rules kept here:
- The manual gives no accelerations. So slopes are compared with each other: those of a shaft that gets faster, and those of
  one that gets slower, for friction helps there.
- The speed ramp (C1) makes them slow enough to look at; a drive that does not keep to it is observed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import inf, sqrt

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive, Observed, Theme
from conformance.claims.declare import Case, motions
from conformance.claims.known_quirks import may_meet
from conformance.claims.lk.limits import tried
from conformance.claims.lk.speed_ramp import SHORTER
from conformance.claims.motion.motion_claim import command_of, of_motion
from conformance.model.lk_parameters import OTHER_FIRMWARE, parameter, set_parameter
from conformance.motion import declared, motion
from conformance.motion.declared import MOVES
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe

#: The ramp as sent and in deg/s2; the speed limit of moves that say none, as sent.
_RAMP, _SLOPE, _LIMIT = 54_000, 540.0, 18_000
#: The speeds of a run, and those of a move with a speed of its own, the last one back to its end (rpm).
_RUNS, _CHANGES = (30, 60, 20, -30, 0), (30, 60, 20, -30)
#: Lengths of moves in degrees: one is changed on its way, one is the last, one stays within a turn.
_FAR, _BACK, _IN_TURN = 3000, 300, 340
#: How long a speed is kept before it changes, how often it is read, and how long the last move takes to its end.
_KEEPS_NS, _EVERY_NS, _REST_NS = 100 * MS, 12 * MS, 4 * SECOND_NS
#: Parts of a change of speed between which it is looked at, its middle, and how many reads tell a slope.
_BEGINS, _ENDS, _LEAST = 0.1, 0.9, 4
#: By how much two slopes of one kind may differ.
_ALIKE = 0.25


@dataclass(frozen=True)
class _Change:
    """What was read while the speed changed from one to another (deg/s, signed). `exchange`: what was to change it."""

    first: float
    last: float
    samples: tuple[Sample, ...]
    exchange: Exchange


@dataclass(frozen=True)
class _Slope:
    """A slope in deg/s2 of a part of a change, from and to a speed in rpm; `off`: by how much it may be off."""

    value: float
    off: float
    first: float
    last: float
    exchange: Exchange

    @property
    def faster(self) -> bool:
        """Whether the shaft got faster."""
        return abs(self.last) > abs(self.first)

    def __str__(self) -> str:
        """Return it for people."""
        return f"{self.value:.4g} +-{self.off:.2g} deg/s2 from {self.first:+.0f} to {self.last:+.0f} rpm"


# --- what is seen -----------------------------------------------------------------------------------------------------


def changes(probe: Probe, command: Command) -> tuple[_Change, ...]:
    """Change the speed of a motion again and again, and return what was read; nothing where the drive has no such parameter."""
    kept = {name: parameter(probe, name) for name in ("speed_ramp", "speed_limit")}
    if kept["speed_ramp"] is None:
        return ()
    motion.ready_to_move(probe)
    set_parameter(probe, "speed_ramp", _RAMP)
    if not declared.of(command).speed:
        set_parameter(probe, "speed_limit", _LIMIT)
    found = list(_changed(probe, command))
    motion.stand_still(probe)
    for name, value in kept.items():
        set_parameter(probe, name, value or 0)
    return tuple(found)


def _changed(probe: Probe, command: Command) -> Iterator[_Change]:
    before, runs = 0.0, declared.of(command).kind is MotionKind.RUN
    for rpm, degrees in _steps(command):
        exchange = motion.ask(probe, command, degrees, rpm=rpm if runs else abs(rpm), quiet_ns=0)
        after = rpm * 6.0
        yield _Change(before, after, _until(probe, before, after), exchange)
        before = after
    if not runs:
        # What is left of the move ends by itself.
        yield _Change(before, 0.0, _until(probe, before, 0.0, _REST_NS), exchange)


def _until(probe: Probe, before: float, after: float, more_ns: int = 0) -> tuple[Sample, ...]:
    """Read the speed until it is another one (deg/s), or until three times as long as that takes are over."""
    lasts_ns = round(3 * abs(after - before) / _SLOPE * SECOND_NS) + more_ns
    until_ns, found = probe.gate.now_ns() + lasts_ns, [motion.speed(probe)]
    while probe.gate.now_ns() < until_ns and abs(found[-1].value * 6 - after) > (1 - _ENDS) * abs(after - before) / 2:
        probe.wait(_EVERY_NS - round(probe.gate.now_ns() - found[-1].t_ns))
        found.append(motion.speed(probe))
    probe.wait(_KEEPS_NS)
    return tuple(found)


def _steps(command: Command) -> tuple[tuple[int, int], ...]:
    """Return the speeds (rpm) and the ways (degrees) that are asked for in turn."""
    what = declared.of(command)
    if what.kind is MotionKind.RUN:
        return tuple((rpm, 0) for rpm in _RUNS)
    if what.kind is MotionKind.MOVE_IN_TURN:
        return ((30, _IN_TURN),)
    speeds = _CHANGES if what.speed else (_CHANGES[0], _CHANGES[-1])
    return (*((rpm, _FAR) for rpm in speeds[:-1]), (speeds[-1], -_BACK))


def _slopes(change: _Change) -> Iterator[_Slope]:
    """Yield the slope of each half of a change of speed. Raises Inconclusive where too little was read of one."""
    parts = [(s.t_ns / SECOND_NS, (s.value * 6 - change.first) / (change.last - change.first), s) for s in change.samples]
    # A move that is to end keeps its speed until then.
    late = [n for n, (_, part, _) in enumerate(parts) if part < _BEGINS]
    parts = parts[late[-1] :] if late else parts
    for low, high in pairwise((_BEGINS, 0.5, _ENDS)):
        points = [(t, part, s) for t, part, s in parts if low <= part <= high]
        speeds = [(change.first + (change.last - change.first) * part) / 6 for part in (low, high)]
        if len(points) < _LEAST:
            raise Inconclusive(
                f"only {len(points)} reads tell how the speed changes from {speeds[0]:.0f} to {speeds[1]:.0f} rpm"
            )
        value, off = _fitted(points)
        scale = abs(change.last - change.first)
        yield _Slope(value * scale, off * scale, speeds[0], speeds[1], change.exchange)


def _fitted(points: list[tuple[float, float, Sample]]) -> tuple[float, float]:
    """Return the slope of parts over seconds by least squares, and twice its uncertainty."""
    count = len(points)
    mean_t, mean_y = sum(t for t, _, _ in points) / count, sum(y for _, y, _ in points) / count
    spread = sum((t - mean_t) ** 2 for t, _, _ in points)
    if not spread:
        return 0.0, inf
    slope = sum((t - mean_t) * (y - mean_y) for t, y, _ in points) / spread
    rest = sum((y - mean_y - slope * (t - mean_t)) ** 2 for t, y, _ in points) / max(1, count - 2)
    # When a read was taken is known to its spread.
    times = max(s.spread_ns for _, _, s in points) / SECOND_NS * abs(slope) / sqrt(spread)
    return slope, 2 * sqrt(rest / spread) + times


# --- judging ----------------------------------------------------------------------------------------------------------


def _motions(dialect: Dialect) -> Iterator[Case]:
    if Verb.WRITE_PARAMETER in dialect.by_verb:
        for case in motions(MotionKind.RUN, *MOVES)(dialect):
            command = command_of(case)
            risks = {*command.all_risks, Risk.SETTING} - {Risk.UNKNOWN}
            facts = {"risks": declared.risks(dialect, *risks), "models": command.models}
            yield Case(dialect, dialect.by_verb[Verb.WRITE_PARAMETER], {"run": command}, facts)


_of_ramp = partial(
    of_motion,
    theme=Theme.TIMING,
    each=_motions,
    at_best=Certainty.LIKELY,
    settings=("speed_ramp", "speed_limit"),
    own=lambda case: {Risk.SETTING},
    quirks=may_meet(OTHER_FIRMWARE),
)


@_of_ramp(name="{command}/one-slope-{run}", refuted_by="a steeper or a slower ramp on the way")
def _one_slope(probe: Probe, run: Command) -> None:
    """{run} changes its speed by one ramp all the way: from rest, to a faster and a slower one, round, and to its end."""
    if not (seen := tried(probe, changes, run)):
        return
    slopes = [slope for change in seen for slope in _slopes(change)]
    begins = slopes[0]
    if abs(begins.value - _SLOPE) > _SLOPE * (1 / SHORTER - 1) + begins.off:
        raise Observed(f"the speed of {run.name} rises by another ramp than was set: {begins}")
    for faster in (True, False):
        alike = [slope for slope in slopes if slope.faster is faster]
        first = begins if faster else sorted(alike, key=lambda slope: slope.value)[len(alike) // 2]
        share = _ALIKE if faster else 1 / SHORTER - 1
        for slope, reference, part in (*((slope, first, _ALIKE) for slope in alike), (first, begins, share)):
            within = reference.value * part + slope.off + reference.off
            text = f"the speed of {run.name} changes by another ramp on the way"
            holds, expected = abs(slope.value - reference.value) <= within, f"{reference.value:.4g} +-{within:.3g} deg/s2"
            probe.expect(str(slope), holds=holds, expected=expected, refutes=text, exchange=slope.exchange)


# --- a ramp that is written on the way --------------------------------------------------------------------------------

#: Ramps and the speed limit as sent, the speed in rpm; when the steep ramp has it, and how long the slow one is looked at.
_SLOW_RAMP, _STEEP_RAMP, _RISING_LIMIT, _RISING_RPM = 3_000, 90_000, 12_000, 20
_RISES_NS, _BEGINS_NS = 250 * MS, 60 * MS
#: Parts of the speed: what a shaft has that kept to the steep ramp, and at most to the slow one.
_RISEN, _CREPT = 0.9, 0.6


@dataclass(frozen=True)
class _Rising:
    """How fast a shaft was (rpm) after a motion began by a ramp. `slow`: how fast by the slow one, before the steep one."""

    slow: float
    speed: Sample
    exchange: Exchange


def rising(probe: Probe, command: Command) -> tuple[_Rising, ...]:
    """Begin a motion by a steep ramp, then by a slow one that a steep one takes over; nothing where there is no such ramp."""
    kept = {name: parameter(probe, name) for name in ("speed_ramp", "speed_limit")}
    if kept["speed_ramp"] is None:
        return ()
    motion.ready_to_move(probe)
    set_parameter(probe, "speed_limit", _RISING_LIMIT)
    found = []
    for ramp in (_STEEP_RAMP, _SLOW_RAMP):
        set_parameter(probe, "speed_ramp", ramp)
        exchange = motion.ask(probe, command, _IN_TURN, rpm=_RISING_RPM, quiet_ns=0)
        slow = 0.0
        if ramp == _SLOW_RAMP:
            probe.wait(_BEGINS_NS)
            slow = abs(motion.speed(probe).value)
            exchange = set_parameter(probe, "speed_ramp", _STEEP_RAMP)
        probe.wait(_RISES_NS)
        found.append(_Rising(slow, motion.speed(probe), exchange))
        motion.stand_still(probe)
    for name, value in kept.items():
        set_parameter(probe, name, value or 0)
    return tuple(found)


@_of_ramp(name="{command}/speed-ramp-under-way-{run}", refuted_by="a shaft that is as slow as by the ramp of before")
def _ramp_under_way(probe: Probe, run: Command) -> None:
    """A steep speed ramp that holds for {run} from its begin holds as soon as it is written while the speed still rises."""
    if not (seen := tried(probe, rising, run)):
        return
    steep, late = seen
    if abs(steep.speed.value) < _RISEN * _RISING_RPM:
        raise Observed(f"the speed of {run.name} rises by another ramp than was set: {steep.speed.value:.3g} rpm")
    if late.slow > _CREPT * _RISING_RPM:
        raise Observed(f"the speed of {run.name} does not rise by a slow ramp that was set: {late.slow:.3g} rpm")
    text, speed = f"a steep ramp that is written while {run.name} speeds up does not hold", late.speed
    least = _RISEN * _RISING_RPM - speed.noise
    probe.expect(abs(speed.value), at_least=least, unit="rpm", refutes=text, exchange=late.exchange)
