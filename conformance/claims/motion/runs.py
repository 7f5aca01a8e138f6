"""Runs at a speed: how fast the shaft turns for what is sent, which way, and for how long.

Rules kept here:
- How fast the shaft turns is measured from positions, by the clock of the line.
- Which way a direction bit turns the shaft is observed; that run and relative move take it alike is judged.
- A drive without a direction bit takes the speed with its sign: positive is clockwise and raises what 92 reads.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk, Trait, Verb
from conformance.claim import Inconclusive
from conformance.claims.declare import Case, commands, motions
from conformance.claims.known_quirks import LATE, may_meet
from conformance.claims.motion.motion_claim import expect_speed, has_direction, has_sign, of_motion, risks_by
from conformance.claims.motion.ramps import TOO_LATE_NS
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.declared import CALM, QUICK, SUBDIVISION
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, SECOND_NS, Probe
from conformance.talk.restarts import restart

#: A speed is measured over so many times the way by which places may be off.
_CLEAR = 20
#: The speed of runs that last, and that of runs whose direction alone matters: 16 bits hold them in every unit.
_RPM, _SLOW = 54, 30
#: How far a move goes whose way is looked at (degrees), and when it has its speed: it takes 185 ms.
_MOVED, _ON_ITS_WAY_NS = 45, 80 * MS
#: The slowest, in whole rpm and in 0.01 deg/s: what they are measured in, after how long, and by how much they may be off.
_SLOWEST, _SLOWEST_BY_ANGLES = (1, 2), (0.1, 0.5)
_SLOW_NS, _SETTLED_NS, _SLOW_SHARE = 500 * MS, 100 * MS, 0.25
_runs = motions(MotionKind.RUN)
_directed = motions(MotionKind.RUN, where=has_direction)
_signed = motions(MotionKind.RUN, where=has_sign)


def _at_speeds(dialect: Dialect) -> Iterator[Case]:
    for case in _directed(dialect):
        for rpm in (1, 60):
            yield Case(dialect, case.command, {"rpm": rpm, "asked": f"{rpm} rpm"}, {"name": f"run_speed/speed-{rpm}"})
    for case in _signed(dialect):
        # In 0.01 deg/s 360 and -500 need more than 16 bits.
        for speed in (10, -180, 360, -500):
            given = {"rpm": speed / 6, "asked": f"{speed} deg/s"}
            yield Case(dialect, case.command, given, {"name": f"run_speed/speed-{speed}"})


@of_motion(each=_at_speeds, refuted_by="positions that change by another speed", quirks=may_meet(LATE))
def _turns_at(probe: Probe, rpm: float) -> None:
    """Asked for {asked}, the shaft turns at {asked}."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    exchange = motion.run_at(probe, rpm, QUICK)
    probe.wait(200 * MS)
    # At a low speed the shaft needs a while to go far enough to measure, the more so where it trembles.
    clear_ns = int(_CLEAR * probe.noise.place / 6 / abs(rpm) * SECOND_NS)
    speed, spread = motion.mean_speed(probe, max(clear_ns, 1500 * MS if abs(rpm) < 10 else 600 * MS))
    looked = probe.latencies[-2:]
    motion.stand_still(probe)
    wanted, text = declared.rpm_as_asked(exchange), "the shaft does not turn at the speed that was asked for"
    probe.expect(abs(speed), near=wanted, within=wanted * CLOCK_SHARE + spread, unit="rpm", refutes=text, exchange=exchange)
    if spread > wanted / 10:
        if LATE not in probe.claim.quirks or max(ns for _, ns in looked) <= 2 * TOO_LATE_NS:
            raise Inconclusive(f"a speed cannot be measured: {spread:.1f} rpm are uncertain")
        probe.meets(LATE)
    else:
        probe.measured["rpm"] = abs(speed)


@of_motion(each=_runs, refuted_by="another speed, or a shaft that stands")
def _slow(probe: Probe, command: Command) -> None:
    """The slowest speeds that can be sent turn the shaft too, either way, and are read."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    for rpm in _SLOWEST if has_direction(command) else _SLOWEST_BY_ANGLES:
        for way in (1, -1):
            exchange = motion.run_at(probe, way * rpm, QUICK)
            probe.wait(_SETTLED_NS)
            speed, spread = motion.mean_speed(probe, _SLOW_NS)
            seen = motion.speed(probe)
            motion.stand_still(probe)
            wanted = declared.rpm_as_asked(exchange)
            within = wanted * _SLOW_SHARE + spread
            text = f"a run at {wanted:.3g} rpm turns the shaft at another speed"
            probe.expect(abs(speed), near=wanted, within=within, unit="rpm", refutes=text, exchange=exchange)
            text, within = f"a run at {wanted:.3g} rpm is read as another speed", within + seen.step / 2 + seen.noise
            probe.expect(abs(seen.value), near=wanted, within=within, unit="rpm", refutes=text, exchange=exchange)


# --- which way --------------------------------------------------------------------------------------------------------


def _way(probe: Probe, rpm: float) -> float:
    """Return how far a short run turns the shaft, in degrees, from rest to rest. Refutes a speed that is told the other way."""
    before = motion.position(probe)
    exchange = motion.run_at(probe, rpm, QUICK)
    probe.wait(100 * MS)
    seen = motion.speed(probe)
    went = motion.stand_still(probe).value - before.value
    _expect_told_way(probe, seen, went, exchange)
    return went


def _way_of_move(probe: Probe, move: Command) -> float:
    """Return how far a move of 45 degrees turns the shaft. Refutes a speed that is told the other way."""
    before = motion.position(probe)
    exchange = motion.begin(probe, move, _MOVED, quiet_ns=0)
    probe.wait(exchange.sent_ns + _ON_ITS_WAY_NS - probe.gate.now_ns())
    seen = motion.speed(probe)
    law_ns = int(ramp.move_ns(_MOVED / 360, CALM, QUICK))
    went = arriving.come_to_rest(probe, exchange, law_ns, law_ns).value - before.value
    _expect_told_way(probe, seen, went, exchange)
    return went


def _expect_told_way(probe: Probe, seen: Sample, went: float, exchange: Exchange) -> None:
    if min(abs(seen.value), abs(went)) > 1 + seen.noise:
        assert exchange.command is not None  # it was asked for
        text = f"the speed of {exchange.command.name} is told the other way than the shaft turned, by {went:+.1f} degrees"
        key = "the speed is told the other way"
        probe.expect(
            seen, holds=seen.value * went > 0, unit="rpm", expected="that way", refutes=text, exchange=exchange, key=key
        )


def _relative_way(probe: Probe) -> float:
    """Return how far a relative move of direction 0 turns the shaft, in degrees."""
    return arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_PULSES), 36).degrees


def _expect_ways(probe: Probe, ways: tuple[float, float], opposite: bool, refutes: str) -> None:
    probe.expect(
        f"{ways[0]:+.1f} and {ways[1]:+.1f} degrees",
        holds=ways[0] * ways[1] < 0 if opposite else ways[0] * ways[1] > 0,
        expected="opposite ways" if opposite else "one way",
        refutes=refutes,
    )


@of_motion(each=_directed, refuted_by="one way for both", statement="Direction 0 and direction 1 turn the shaft opposite ways.")
@of_motion(each=_signed, refuted_by="one way for both", statement="Speeds of opposite signs turn opposite ways.")
def _opposite(probe: Probe) -> None:
    motion.ready_to_move(probe)
    ways = (_way(probe, _SLOW), _way(probe, -_SLOW))
    _expect_ways(probe, ways, True, "speeds of opposite signs do not turn the shaft opposite ways")


@of_motion(
    each=_directed,
    statement="Direction 0 is counter-clockwise and raises the encoder value.",
    refuted_by="an encoder value that falls",
    at_best=Certainty.OPEN,
    quirks=may_meet("reversed-direction"),
)
@of_motion(
    each=_signed,
    name="{command}/sign",
    statement="A positive speed raises the position, a negative one lowers it.",
    refuted_by="the other way",
    rests_on=(Doubt.SIGN,),
)
def _raises(probe: Probe) -> None:
    motion.ready_to_move(probe)
    up, down = _way(probe, _SLOW), _way(probe, -_SLOW)
    if up < 0 and "reversed-direction" in probe.claim.quirks and _relative_way(probe) < 0:
        probe.meets("reversed-direction")
    else:
        text = "a positive speed does not raise the position, or a negative one does not lower it"
        probe.expect(f"{up:+.1f} and {down:+.1f} degrees", holds=up > 0 > down, expected="a rise and a fall", refutes=text)


@of_motion(
    each=_directed,
    refuted_by="a run and a move of one direction that go opposite ways",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.MOVE_RELATIVE_PULSES),
)
def _same_sense(probe: Probe) -> None:
    """The direction bit turns the shaft the same way in a run as in a relative move by pulses."""
    motion.ready_to_move(probe)
    ways = (_way(probe, _SLOW), _relative_way(probe))
    _expect_ways(probe, ways, False, "direction 0 turns the shaft one way in a run and the other way in a move")


def _direction_settings(dialect: Dialect) -> Iterator[Case]:
    turns = Trait.DIRECTION_TURNS_BUS_MOTION in dialect.traits
    facts = {
        "statement": f"The setting of the motor's direction {'turns' if turns else 'does not turn'} motion by the bus.",
        "refuted_by": "a run that turns the same way with both settings" if turns else "a run that turns another way",
    }
    for case in commands(Verb.SET_DIRECTION)(dialect):
        yield Case(dialect, case.command, {"turns": turns}, facts)


def _direction_risks(case: Case) -> frozenset[Risk]:
    more = case.dialect.by_verb[Verb.RESTART].all_risks if case["turns"] and Verb.RESTART in case.dialect.by_verb else set()
    return frozenset(more) | case.dialect.by_verb[Verb.RUN_SPEED].all_risks


@of_motion(each=_direction_settings, refuted_by="", risks=_direction_risks, settings=("motor_direction",))
def _and_the_bus(probe: Probe, command: Command, turns: bool) -> None:
    """What the direction setting does to motion by the bus it does in each mode, and after a restart."""
    modes = [m for m in reversed(declared.bus_modes(probe.dialect)) if "no_encoder" not in m]
    motion.ready_to_move(probe, modes[0])
    text = "the setting of the motor's direction and motion by the bus"
    probe.do(command, {"motor_direction": 0})
    plain = _way(probe, _SLOW)

    def expect(when: str) -> None:
        way = _way(probe, _SLOW)
        probe.expect(
            f"{plain:+.1f} and {way:+.1f} degrees",
            holds=(plain * way < 0) is turns,
            expected=f"{'opposite ways' if turns else 'one way'} {when}",
            refutes=text,
        )

    if not turns:
        # Where it does not concern the bus it ends nothing that the bus began.
        motion.run_at(probe, CALM, QUICK)
        probe.wait(100 * MS)
        exchange = probe.do(command, {"motor_direction": 1})
        seen = motion.turning(probe)
        motion.stand_still(probe)
        expect_speed(seen, CALM, exchange, "the setting of the motor's direction changes a run that is under way")
    for mode in modes:
        motion.ready_to_move(probe, mode)
        probe.do(command, {"motor_direction": 1})
        expect(f"in {mode}")
    if turns and Verb.RESTART in probe.dialect.by_verb:
        restart(probe)
        motion.ready_to_move(probe)
        expect("after a restart")


def _directions_of_moves(dialect: Dialect) -> Iterator[Case]:
    """Yield the setting with each move that it may turn: at once, and after a restart."""
    turns = Trait.DIRECTION_TURNS_BUS_MOTION in dialect.traits
    turned = "turns" if turns else "does not turn"
    for case in commands(Verb.SET_DIRECTION)(dialect):
        for move in dialect.motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO):
            if declared.takes_pulses(move) or not turns:
                for where, when in (("", ""), ("-restart", " after a restart")):
                    begins = dialect.by_verb[Verb.RESTART].all_risks if where else set()
                    facts = {
                        "statement": f"The setting of the motor's direction {turned} {{move}}{{when}}.",
                        "refuted_by": f"a move that turns {'the same' if turns else 'another'} way with the other setting",
                        "parameters": {},
                        "risks": declared.risks(dialect, *move.all_risks, *begins),
                    }
                    yield Case(dialect, case.command, {"move": move, "turns": turns, "where": where, "when": when}, facts)


@of_motion(each=_directions_of_moves, name="{command}/and-{move}{where}", refuted_by="", settings=("motor_direction",))
def _and_moves(probe: Probe, command: Command, move: Command, turns: bool, when: str) -> None:
    motion.prepare(probe, move)
    probe.do(command, {"motor_direction": 0})
    plain = _way_of_move(probe, move)
    exchange = probe.do(command, {"motor_direction": 1})
    if when:
        restart(probe)
        motion.prepare(probe, move)
    way = _way_of_move(probe, move)
    text = f"the setting of the motor's direction {'does not turn' if turns else 'turns'} {move.name}{when}"
    shown, expected = f"{plain:+.1f} and {way:+.1f} degrees", "opposite ways" if turns else "one way"
    probe.expect(shown, holds=(plain * way < 0) is turns, expected=expected, refutes=text, exchange=exchange)


# --- as time goes on --------------------------------------------------------------------------------------------------


@of_motion(each=_runs, refuted_by="a shaft that slows down or stops by itself")
def _lasts(probe: Probe) -> None:
    """A run goes on until it is told otherwise."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    exchange = motion.run_at(probe, _RPM, QUICK)
    probe.wait(3 * SECOND_NS)
    seen = motion.turning(probe)
    motion.stand_still(probe)
    expect_speed(seen, _RPM, exchange, "a run does not go on")


@of_motion(each=_signed, refuted_by="another speed")
def _changes(probe: Probe) -> None:
    """A newer speed takes over from the one under way, either way: slower, faster, and the other way."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    for rpm, acceleration in ((50, QUICK), (25, 56), (54, QUICK), (-50, QUICK), (-25, 56), (-54, QUICK)):
        exchange = motion.run_at(probe, rpm, acceleration)
        if abs(rpm) == 25:
            seen = motion.turning(probe)  # the ramp from 50 to 25 rpm takes 250 ms at 10 ms for each rpm
            text = "a newer run stops the shaft first"
            probe.expect(abs(seen.value), at_least=abs(rpm) - 1, unit="rpm", refutes=text, exchange=exchange)
        probe.wait(400 * MS)
        expect_speed(motion.turning(probe), rpm, exchange, "a newer run does not take over")
    motion.stand_still(probe)
