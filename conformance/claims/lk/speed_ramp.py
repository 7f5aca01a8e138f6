"""Effect of the speed ramp of LK motors (C1): how fast the speed rises, and how it changes. It is observed, as limits are.

The manual names a speed ramp without a unit. Here it is taken to be 0.01 deg/s2, for all motions, until the power goes.

Rules kept here:
- A ramp that holds one way holds the other way, and for a shaft that turns when it is written: that is judged.
- A claim puts back what it changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from math import inf

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claim import Inconclusive, Observed, Theme
from conformance.claims.declare import Case, commands
from conformance.claims.lk.limits import of_run, tried
from conformance.model.lk_parameters import parameter, set_parameter
from conformance.motion import declared, motion
from conformance.motion.declared import RUNS_AND_MOVES
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, SECOND_NS, Probe

_of_ramp = partial(of_run, theme=Theme.TIMING)
_of_change = partial(_of_ramp, settings=("speed_ramp",))


@dataclass(frozen=True)
class _Ramp:
    """A mean acceleration in deg/s2, and between which two it surely lies. `exchange`: what began it."""

    value: float
    low: float
    high: float
    exchange: Exchange

    @staticmethod
    def of(change: tuple[float, float], took: tuple[float, float], exchange: Exchange) -> _Ramp:
        """Return the ramp of a change of speed (deg/s) in a time (s), each with its uncertainty."""
        (speed, speed_off), (time, time_off) = change, took
        time_off += 2 * CLOCK_SHARE * abs(time)
        speed = abs(speed)

        def rate(speed: float, time: float) -> float:
            return max(0.0, speed) / time if time > _LEAST_S else inf

        low, high = rate(speed - speed_off, max(0.0, time) + time_off), rate(speed + speed_off, time - time_off)
        return _Ramp(rate(speed, time), low, high, exchange)

    def near(self, wanted: float, within: float) -> bool:
        """Say whether it may be near another one."""
        return self.low <= wanted + within and self.high >= wanted - within

    def __str__(self) -> str:
        """Return it for people."""
        return f"{self.value:.4g} deg/s2 ({self.low:.4g} to {self.high:.4g})"

    def need_sure(self) -> None:
        """Raise Inconclusive where it may be another one by half or twice."""
        if self.low < self.value / 2 or self.high > self.value * 2:
            raise Inconclusive(f"the acceleration is {self}, too uncertain to say")


def _expect_ramp(probe: Probe, seen: _Ramp, wanted: float, within: float, refutes: str) -> None:
    expected, exchange = f"{wanted:g} +-{within:.3g} deg/s2", seen.exchange
    probe.expect(str(seen), holds=seen.near(wanted, within), expected=expected, refutes=refutes, exchange=exchange)
    seen.need_sure()


#: A change of speed in less than that is one at once.
_LEAST_S = 1e-4


def _speed_of(probe: Probe, least_ns: int) -> tuple[float, float]:
    """Return the mean speed (deg/s) and its uncertainty, over the longer a time the slower the drive answers."""
    rpm, uncertain = motion.mean_speed(probe, max(least_ns, _SLOWER * probe.noise.latency_ns))
    return rpm * 6, uncertain * 6


#: How many times longer than the latency of a drive it takes to know a speed well.
_SLOWER = 24


def _begun(exchange: Exchange) -> tuple[float, float]:
    """Return when a command that was answered began, and by how much that may be off (ns)."""
    half_ns = (exchange.answers[0].first_ns - exchange.sent_ns) / 2 if exchange.answers else 0.0
    return exchange.sent_ns + half_ns, half_ns


def _acceleration(probe: Probe, ramp: int, how: Command, way: int = 1) -> _Ramp:
    """Turn the shaft by a ramp and return the mean acceleration to full speed.

    Two positions, both at full speed, tell how long it takes to it: the way that is missing.
    """
    ramp_ns = 18_000 * SECOND_NS // ramp
    motion.ready_to_move(probe)
    set_parameter(probe, "speed_ramp", ramp)
    here = motion.position(probe)
    kept = parameter(probe, "speed_limit") or 0
    # A move has no speed of its own: the limit is its speed, which it keeps for more turns than it is looked at.
    set_parameter(probe, "speed_limit", 18_000)
    runs = declared.of(how).kind is MotionKind.RUN
    exchange = motion.ask(probe, how, way * 20 * 360, rpm=way * 30 if runs else 30, quiet_ns=0)
    probe.wait(ramp_ns * 3 // 2)
    first = motion.position(probe)
    speed, uncertain = _speed_of(probe, ramp_ns // 2)
    motion.stand_still(probe)
    set_parameter(probe, "speed_limit", kept)
    speed *= way
    if speed <= uncertain:
        raise Inconclusive(f"{how.name} does not turn the shaft")
    begun_ns, off_ns = _begun(exchange)
    went = (first.value - here.value) * way
    missing_s = (first.t_ns - begun_ns) / SECOND_NS - went / speed
    off_s = (first.spread_ns + off_ns) / SECOND_NS + (first.step + first.noise) / speed + went / speed * uncertain / speed
    return _Ramp.of((speed, uncertain), (2 * missing_s, 2 * off_s), exchange)


def _ramped(dialect: Dialect) -> Iterator[Case]:
    for case in commands(Verb.WRITE_PARAMETER)(dialect):
        for run in dialect.motions(*RUNS_AND_MOVES):
            yield Case(dialect, case.command, {"run": run})


def ramped_each_way(probe: Probe, run: Command) -> tuple[_Ramp, ...]:
    """Return the accelerations by two ramps, the steeper one the other way; nothing where the drive has no such parameter."""
    kept = parameter(probe, "speed_ramp")
    if kept is None:
        return ()
    found = tuple(_acceleration(probe, ramp, run, way) for ramp, way in ((18_000, 1), (_BACK_RAMP, -1)))
    set_parameter(probe, "speed_ramp", kept)
    return found


#: The ramp that is tried the other way.
_BACK_RAMP = 36_000


@_of_ramp(
    each=_ramped,
    name="{command}/speed-ramp-{run}-each-way",
    refuted_by="a steeper or a slower ramp one way",
    at_best=Certainty.LIKELY,
    rests_on=(),
)
def _speed_ramp_each_way(probe: Probe, run: Command) -> None:
    """The speed ramp that holds for {run} one way holds the other way too."""
    if not (found := tried(probe, ramped_each_way, run)):
        return
    forward, back = found
    probe.measured["deg_s2"] = forward.value
    if not forward.near(180, 180 * (1 - SHORTER)):
        raise Observed(f"the speed of {run.name} rises by another ramp than was set")
    text, wanted = f"the speed of {run.name} rises by another ramp the other way", _BACK_RAMP / 100
    _expect_ramp(probe, back, wanted, wanted * (1 - SHORTER), text)


@_of_change(
    name="{command}/speed-ramp-at-once",
    refuted_by="a change of speed by the ramp of before",
    at_best=Certainty.LIKELY,
    rests_on=(),
)
def _ramp_at_once(probe: Probe) -> None:
    """A speed ramp that holds for a change of speed when it is written at rest holds too when the shaft turns then."""
    kept = parameter(probe, "speed_ramp")
    if kept is None:
        return
    motion.ready_to_move(probe)
    for under_way in (False, True):
        set_parameter(probe, "speed_ramp", kept if under_way else _LATE_RAMP)
        motion.run_at(probe, 10)
        probe.wait(_BEGUN_NS if under_way else _BEGUN_NS + 60 * SECOND_NS * 100 // _LATE_RAMP)
        if under_way:
            set_parameter(probe, "speed_ramp", _LATE_RAMP)
        first = _speed_of(probe, 200 * MS)
        before = motion.position(probe)
        exchange = motion.run_at(probe, 40)
        probe.wait(1_000 * MS)
        after = motion.position(probe)
        last = _speed_of(probe, 200 * MS)
        motion.stand_still(probe)
        set_parameter(probe, "speed_ramp", kept)
        if abs(last[0] - first[0]) < 60:
            raise Inconclusive("the speed does not change to 40 rpm")
        seen, wanted = _changed(before, first, exchange, after, last), _LATE_RAMP / 100
        if not under_way and not seen.near(wanted, wanted / 5):
            raise Observed("the speed of a run rises by another ramp than was set")
        text = "the speed of a shaft that turned when its ramp was written changes by another ramp"
        _expect_ramp(probe, seen, wanted, wanted / 5, text)


#: A speed is reached within this time, but for a ramp.
_BEGUN_NS = 300 * MS
#: The ramp that is written before a run and while one is under way, as sent.
_LATE_RAMP = 24_000
#: The ramp by which speeds change, as sent and in deg/s2, and the speeds in rpm: faster, slower and back, on both sides of 0.
_CHANGE_RAMP, _CHANGES = 36_000, (60, 30, -30, -60, -30, 30, 0)
#: By how much a ramp may be shorter than that from rest, for friction helps a motor that slows down.
SHORTER = 0.67


def _changed(before: Sample, first: tuple[float, float], exchange: Exchange, after: Sample, last: tuple[float, float]) -> _Ramp:
    """Return the ramp by which the speed changed, by a position before and one after.

    `first`, `last`: the speeds in deg/s, each with its uncertainty.
    """
    begun_ns, off_ns = _begun(exchange)
    lead, rest = (begun_ns - before.t_ns) / SECOND_NS, (after.t_ns - begun_ns) / SECOND_NS
    change, change_off = last[0] - first[0], first[1] + last[1]
    took = 2 * (first[0] * lead + last[0] * rest - (after.value - before.value)) / change
    spread = abs(first[0]) * before.spread_ns + abs(last[0]) * after.spread_ns + abs(change) * off_ns
    off = first[1] * lead + last[1] * rest + spread / SECOND_NS + after.step + after.noise
    return _Ramp.of((change, change_off), (took, (2 * off + abs(took) * change_off) / abs(change)), exchange)


@_of_change(name="{command}/one-ramp", refuted_by="a change of speed by a steeper ramp", at_best=Certainty.LIKELY, rests_on=())
def _one_ramp(probe: Probe) -> None:
    """A run speeds up, slows down and turns round by no steeper ramp than it begins by, both ways."""
    kept = parameter(probe, "speed_ramp")
    if kept is None:
        return
    motion.ready_to_move(probe)
    set_parameter(probe, "speed_ramp", _CHANGE_RAMP)
    before, speed = motion.position(probe), (0.0, 0.0)
    found = []
    for rpm in _CHANGES:
        exchange = motion.run_at(probe, rpm)
        # A change of a speed by 360 deg/s takes a second.
        probe.wait(round(1.3 * abs(rpm * 6 - speed[0]) / _CHANGE_RAMP * 100 * SECOND_NS) + 50 * MS)
        after = motion.position(probe)
        last = _speed_of(probe, 200 * MS) if rpm else (0.0, 0.0)
        if abs(last[0] - speed[0]) < 60:
            raise Inconclusive(f"the speed does not change to {rpm} rpm by the ramp that was set")
        seen = _changed(before, speed, exchange, after, last)
        found.append((seen, f"{speed[0] / 6:+.0f} to {last[0] / 6:+.0f} rpm"))
        before, speed = motion.position(probe), last
    set_parameter(probe, "speed_ramp", kept)
    motion.stand_still(probe)
    begins = found[0][0]
    if begins.low > 2 * _CHANGE_RAMP / 100:
        raise Observed("the speed ramp that was set does not hold")
    begins.need_sure()
    for seen, what in found[1:]:
        most, text = begins.high / SHORTER, f"from {what} the speed changes by a steeper ramp than from rest"
        holds, expected, key = seen.low <= most, f"at most {most:.4g} deg/s2", "a steeper ramp"
        probe.expect(str(seen), holds=holds, expected=expected, refutes=text, exchange=seen.exchange, key=key)
        seen.need_sure()
