"""Effects of the limits of LK motors (C1): of speed, angle and torque. They are observed: the manual does not call them so.

The manual names these control parameters without units. Elsewhere it speaks of limits that a setup program sets. Here they are
taken to act on motion at once, until the power goes, in the units of the commands. A drive that does otherwise is not refuted.

Rules kept here:
- What a limit does one way it does the other way, and what it does from the begin of a motion it does at once: that is judged.
- Real drives without C0 and C1 were seen (firmware 2.35).
- A claim puts back what it changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk, Verb
from conformance.claim import Inconclusive, Observed
from conformance.claims.declare import Case, commands, motions
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import command_of, of_motion, risks_by
from conformance.claims.motion.moves import without_max_speed
from conformance.model.lk_parameters import OTHER_FIRMWARE, parameter, set_parameter
from conformance.motion import declared, motion
from conformance.motion.attempts import damaged
from conformance.motion.declared import CALM, FORCE, MOVES
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, SECOND_NS, Probe

_of_parameter = partial(
    of_motion,
    each=commands(Verb.WRITE_PARAMETER),
    settings=("speed_limit", "angle_limit", "torque_limit", "speed_ramp"),
    rests_on=(Doubt.EFFECT,),
    own=lambda case: {Risk.SETTING},
    quirks=may_meet(OTHER_FIRMWARE),
)
of_run = partial(_of_parameter, risks=risks_by(Verb.RUN_SPEED))


#: Speed limits as they are sent, and in rpm the tolerance of each.
_HIGHER, _WIDER, _LIMIT, _LIMIT_NEAR = 24_000, 18_000, 9_000, 0.5
#: Which way, under which limit, and whether that is written when the motion is under way; a run asks for more than each.
_SPEED_LIMITS = ((-1, _LIMIT, False), (1, _LIMIT, False), (-1, _LIMIT, True), (1, _HIGHER, False))
#: Which way and under which angle limit, in degrees; a move asks for twice as much.
_ANGLE_LIMITS = ((1, 60), (-1, 60), (-1, 400))
#: How far a move goes under a speed limit: less than a turn, for some stay within one.
_WAY = 345
#: A speed of more than 16 bits, as it is sent; how far a move by it goes (degrees), and how long until it turns so fast.
_FAST, _FAST_WAY, _FAST_NS = 120_000, 3600, 1000 * MS
#: How much faster than 65535 a shaft has to turn for that to show.
_FASTER = 1.2
#: How often a motion is tried of which the line damages something.
_TRIES = 3
#: A speed reaches its limit within the first time, and is measured for the second.
_HOLDS_NS, _SEEN_NS = 300 * MS, 300 * MS


@dataclass(frozen=True)
class _Limited:
    """A motion under a limit: `seen` is what the limit holds at `limit`, `within` so much (rpm or degrees).

    `under_way`: the limit was written when the motion was under way.
    """

    way: int
    seen: float
    limit: float
    within: float
    exchange: Exchange
    under_way: bool = False

    @property
    def holds(self) -> bool:
        """Whether the limit held."""
        return abs(self.seen - self.limit) <= self.within


#: Moves or runs under limits, once for all claims about them; and what any such record has seen.
_Record = Callable[[Probe, Command], tuple[_Limited, ...]]
_Seen = TypeVar("_Seen")


def limited_speeds(probe: Probe, command: Command) -> tuple[_Limited, ...]:
    """Move or run either way under a speed limit, then with one written under way; nothing where there is no such limit."""
    kept = parameter(probe, "speed_limit")
    found = []
    for one in _SPEED_LIMITS if kept is not None else ():
        for _ in range(_TRIES):
            since = len(probe.traffic)
            seen = _limited_speed(probe, command, *one)
            anew = damaged(probe, since)
            motion.stand_still(probe)
            set_parameter(probe, "speed_limit", kept or 0)
            if not anew:
                break
            # While a reply is waited for that the line damaged, a move comes to its end.
        else:
            raise Inconclusive("the line damages replies while a speed limit is tried")
        found.append(seen)
    return tuple(found)


def _limited_speed(probe: Probe, command: Command, way: int, limit: int, under_way: bool) -> _Limited:
    """Begin a motion under a speed limit, or write that under way, and measure its speed."""
    motion.ready_to_move(probe)
    exchange = set_parameter(probe, "speed_limit", _WIDER if under_way else limit)
    motion.begin(probe, command, way * _WAY, rpm=way * CALM)
    probe.wait(_HOLDS_NS)
    if under_way:
        exchange = set_parameter(probe, "speed_limit", limit)
        probe.wait(_HOLDS_NS)
    rpm, uncertain = motion.mean_speed(probe, _SEEN_NS)
    within = _LIMIT_NEAR + limit / 600 * CLOCK_SHARE + uncertain
    return _Limited(way, abs(rpm), limit / 600, within, exchange, under_way)


def limited_places(probe: Probe, move: Command) -> tuple[_Limited, ...]:
    """Move beyond angle limits on either side of zero, within a turn and beyond; nothing where the drive has no such limit."""
    kept = parameter(probe, "angle_limit")
    found = []
    for way, limit in _ANGLE_LIMITS if kept is not None else ():
        motion.ready_to_move(probe)
        probe.do("set_position", {"position": 0})
        exchange = set_parameter(probe, "angle_limit", limit * 100)
        motion.begin(probe, move, way * 2 * limit, start=0)
        probe.wait(2 * SECOND_NS)
        end = motion.stand_still(probe)
        set_parameter(probe, "angle_limit", kept or 0)
        found.append(_Limited(way, end.value, way * limit, 1 + motion.same(probe), exchange))
    return tuple(found)


def tried(probe: Probe, record: Callable[[Probe, Command], tuple[_Seen, ...]], command: Command) -> tuple[_Seen, ...]:
    """Return what a motion showed, once for all claims; nothing, which is a known quirk, where the parameter is not there."""
    found = probe.recorded(record, command)
    if not found:
        probe.meets(OTHER_FIRMWARE)
    return found


def _from_begin(found: tuple[_Limited, ...]) -> tuple[_Limited, ...]:
    return tuple(one for one in found if not one.under_way)


def _expect_each_way(probe: Probe, record: _Record, move: Command, limit: str) -> None:
    """Refute a limit that holds one way alone."""
    found = _from_begin(tried(probe, record, move))
    beyond = [one for one in found if not one.holds]
    if found and len(beyond) == len(found):
        raise Observed(f"the {limit} does not hold for {move.name}")
    for one in beyond:
        text = f"a {limit} that holds for {move.name} does not hold the other way, or for another value"
        probe.expect(one.seen, near=one.limit, within=one.within, refutes=text, exchange=one.exchange)


def _unlimited_motions(dialect: Dialect) -> Iterator[Case]:
    """Yield the run and the moves that have no highest speed of their own."""
    unlimited = (*motions(MotionKind.RUN)(dialect), *without_max_speed(dialect))
    for case in commands(Verb.WRITE_PARAMETER)(dialect):
        for each in unlimited:
            risks = {*command_of(each).all_risks, Risk.SETTING}
            yield Case(dialect, case.command, {"move": each.command}, {"risks": declared.risks(dialect, *risks)})


_of_speed_limit = partial(_of_parameter, each=_unlimited_motions, at_best=Certainty.LIKELY, rests_on=())


@_of_speed_limit(name="{command}/speed-limit-{move}-at-once", refuted_by="the speed of before")
def _speed_limit_at_once(probe: Probe, move: Command) -> None:
    """A speed limit that holds for {move} from its begin holds as soon as it is written for one that is under way."""
    found = tried(probe, limited_speeds, move)
    if not all(one.holds for one in _from_begin(found)):
        raise Observed(f"the speed limit does not hold for {move.name}")
    for one in found:
        text = f"a speed limit that is written while {move.name} is under way does not hold for it"
        probe.expect(one.seen, near=one.limit, within=one.within, unit="rpm", refutes=text, exchange=one.exchange)


@_of_speed_limit(name="{command}/speed-limit-{move}-each-way", refuted_by="a faster shaft one way")
def _speed_limit_each_way(probe: Probe, move: Command) -> None:
    """The speed limit that holds for {move} one way holds the other way too."""
    _expect_each_way(probe, limited_speeds, move, "speed limit")


def _fast_run(probe: Probe, run: Command) -> float:
    """Return how fast the shaft turns (rpm) in a run whose speed has more than 16 bits."""
    return _fast(probe, run)[0]


def _fast(probe: Probe, command: Command) -> tuple[float, Exchange]:
    """Return how fast the shaft turns (rpm) where more than 16 bits say the speed, with the parameter above it."""
    motion.ready_to_move(probe)
    kept = parameter(probe, "speed_limit")
    if kept is not None:
        set_parameter(probe, "speed_limit", _FAST * 2)
    exchange = motion.begin(probe, command, _FAST_WAY, rpm=_FAST / 600)
    probe.wait(_FAST_NS)
    seen = motion.turning(probe)
    motion.stand_still(probe)
    if kept is not None:
        set_parameter(probe, "speed_limit", kept)
    return abs(seen.value), exchange


def _takes_32_bits(command: Command) -> bool:
    """Say whether a move has a highest speed of more than 16 bits."""
    speed = declared.of(command).speed
    return bool(speed) and declared.field_of(command, speed).high > 0xFFFF


@of_motion(
    # A move within a turn is too short to come to such a speed.
    each=motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO, where=_takes_32_bits),
    refuted_by="the speed of 65535",
    settings=("position", "speed_limit"),
    own=lambda case: {Risk.SETTING},
    risks=risks_by(Verb.RUN_SPEED),
)
def _beyond_16_bits(probe: Probe, command: Command) -> None:
    """{command} by a max_speed of more than 16 bits is as fast as a run by that speed."""
    can = probe.recorded(_fast_run, probe.dialect.by_verb[Verb.RUN_SPEED])
    low = 0xFFFF / 600
    if can < _FASTER * low:
        raise Inconclusive(f"a run of {_FAST / 600:.0f} rpm comes to {can:.1f} rpm, and 16 bits say {low:.1f} rpm")
    rpm, exchange = _fast(probe, command)
    text = f"{command.name} by a max_speed of more than 16 bits is slower than a run by that speed"
    probe.expect(rpm, at_least=(can + low) / 2, unit="rpm", refutes=text, exchange=exchange)


def _moves_to_positions(dialect: Dialect) -> Iterator[Case]:
    for case in commands(Verb.WRITE_PARAMETER)(dialect):
        for move in dialect.motions(MotionKind.MOVE_TO):
            yield Case(dialect, case.command, {"move": move})


@_of_parameter(
    each=_moves_to_positions,
    name="{command}/angle-limit-{move}-each-way",
    refuted_by="a shaft beyond it on one side",
    at_best=Certainty.LIKELY,
    rests_on=(),
)
def _angle_limit_each_way(probe: Probe, move: Command) -> None:
    """The angle limit that holds for {move} on one side of zero holds on the other side too."""
    _expect_each_way(probe, limited_places, move, "angle limit")


_every_motion = motions(MotionKind.RUN, *MOVES, MotionKind.TORQUE)


def _limited_motions(dialect: Dialect) -> Iterator[Case]:
    """Yield every motion but the run, with the run by which the limit is tried first."""
    for case in _every_motion(dialect) if Verb.WRITE_PARAMETER in dialect.by_verb else ():
        command = command_of(case)
        if command.verb is not Verb.RUN_SPEED:
            risks = {*command.all_risks, *dialect.by_verb[Verb.RUN_SPEED].all_risks, Risk.TORQUE, Risk.SETTING}
            facts = {"risks": declared.risks(dialect, *risks - {Risk.UNKNOWN}), "models": command.models}
            yield Case(dialect, dialect.by_verb[Verb.WRITE_PARAMETER], {"how": command}, facts)


_of_torque_limit = partial(
    of_motion,
    at_best=Certainty.LIKELY,
    settings=("torque_limit",),
    own=lambda case: {Risk.SETTING},
    quirks=may_meet(OTHER_FIRMWARE),
)


@_of_torque_limit(each=_limited_motions, name="{command}/torque-limit-{how}", refuted_by="motion")
def _torque_limit_of(probe: Probe, how: Command) -> None:
    """With a torque limit of 0, with which no run turns the shaft, {how} turns it neither."""
    kept = parameter(probe, "torque_limit")
    if kept is None:
        return
    motion.ready_to_move(probe)
    exchange = set_parameter(probe, "torque_limit", 0)
    assert how.motion is not None  # it is one of the motions
    both = ((how, -30),) if how.motion.kind is MotionKind.TORQUE else ()
    went = []
    for command, rpm in ((probe.command(Verb.RUN_SPEED), 30), (how, 30), *both):
        before = motion.position(probe)
        motion.ask(probe, command, 90, rpm=rpm)
        probe.wait(300 * MS)
        went.append(abs(motion.position(probe).value - before.value))
        probe.do(Verb.STOP)
    set_parameter(probe, "torque_limit", kept)
    motion.stand_still(probe)
    most = 1 + motion.same(probe)
    if went[0] > most:
        raise Observed("a run turns the shaft with a torque limit of 0")
    text = f"{how.name} turns the shaft with a torque limit of 0"
    probe.expect(max(went[1:]), at_most=most, unit="degrees", refutes=text, exchange=exchange)


def _forces(dialect: Dialect) -> Iterator[Case]:
    for case in _limited_motions(dialect):
        if case["how"].motion.kind is MotionKind.TORQUE:
            yield case


#: A torque limit below what is asked for, how long a torque has until it is there, and how near it is then.
_LOW, _THERE_NS, _NEAR = FORCE // 2, 250 * MS, FORCE / 4


@_of_torque_limit(each=_forces, name="{command}/torque-limit-at-once-{how}", refuted_by="the torque of before")
def _torque_limit_at_once(probe: Probe, how: Command) -> None:
    """A torque limit that holds for {how} one way holds the other way, and as soon as it is written for one under way."""
    kept = parameter(probe, "torque_limit")
    if kept is None:
        return
    (name,) = declared.values_of(probe.dialect, how)

    def strength() -> float:
        probe.wait(_THERE_NS)
        return probe.read(Verb.READ_STATE_2, name)

    motion.ready_to_move(probe)
    set_parameter(probe, "torque_limit", _LOW)
    seen, speeds = [], []
    for way in (1, -1):
        exchange = probe.do(how, {name: way * FORCE})
        seen.append(strength())
        speeds.append(abs(motion.speed(probe).value))
        motion.stand_still(probe)
    begun, other = seen
    set_parameter(probe, "torque_limit", kept)
    for way in (-1, 1):
        motion.stand_still(probe)
        probe.do(how, {name: way * FORCE})
        free = strength()
        speeds.append(abs(motion.speed(probe).value))
    written = set_parameter(probe, "torque_limit", _LOW)
    changed = strength()
    motion.stand_still(probe)
    set_parameter(probe, "torque_limit", kept)
    if abs(begun - _LOW) > _NEAR or abs(free - FORCE) > _NEAR:
        raise Observed(f"with a torque limit of {_LOW} the torque is {begun:.0f}, and {free:.0f} without")
    text = f"a torque limit that holds for {how.name} one way does not hold the other way"
    probe.expect(other, near=-_LOW, within=_NEAR, unit="LSB", refutes=text, exchange=exchange)
    text = f"{how.name} is told as limited each way, and its limit slows the shaft down one way alone"
    _expect_slower(probe, speeds, text, exchange)
    text = f"a torque limit does not hold for {how.name} that is under way"
    probe.expect(changed, near=_LOW, within=_NEAR, unit="LSB", refutes=text, exchange=written)


#: What a limit must leave of a speed at most to be seen in it.
_SLOWED = 0.75


def _expect_slower(probe: Probe, speeds: list[float], refutes: str, exchange: Exchange) -> None:
    """Expect that a limit that slows a shaft down one way slows it down the other way, each against the speed without it.

    `speeds` (rpm): under the limit one way and the other way, without it the other way and the one way. The load of a shaft
    may differ each way, so its speeds are not compared across: only no effect at all is refuted.
    """
    one, other, other_free, one_free = speeds
    noise = probe.noise.rpm
    if one + noise > one_free * _SLOWED or other_free <= noise:
        return
    most = other_free * (1 + _SLOWED) / 2
    probe.expect(other, at_most=most, unit="rpm", refutes=refutes, exchange=exchange)
