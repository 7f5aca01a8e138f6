"""Moves of LK motors: over several turns, within one turn and by an angle, each way and at which speed.

    A3, A4  to a position over all turns     A5, A6  to an angle within the turn
    A7, A8  by an angle                      (the even codes with a highest speed)

Rules kept here:
- LK tells no end: the shaft is watched until it stands.
- Positive is clockwise and raises what 92 reads; spinDirection 0 is clockwise.
- The limits of the setup program are not known here: speeds and ways are small (90 rpm, a turn), and what a limit of C1
  does to motion is observed (`motion_lk_limits`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.claims.motion_lk_speeds import measured
from conformance.motion import motion
from conformance.motion.motion import MS, SECOND_NS, Sample
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: How far from its target a move may end, in degrees.
NEAR = 0.25
_CW, _CCW = 0, 1
#: The speed limit that the suite gives its own moves, 0.01 deg/s: 45 rpm.
_CALM = 27_000
#: Positions that 32 bits hold and do not hold, as sent.
_EDGE = 2_147_480_000
_MULTI = ("move_multi_turn", "move_multi_turn_limited")
_SINGLE = ("move_single_turn", "move_single_turn_limited")
_STEPS = ("move_increment", "move_increment_limited")
_LIMITED = ("move_multi_turn_limited", "move_single_turn_limited", "move_increment_limited")
#: Moves to A4 whose replies are looked at for their sums.
_MANY = 300


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about the moves of an LK motor."""
    named = dialect.by_name
    for name in (*_MULTI, *_SINGLE, *_STEPS):
        command = named[name]
        made = partial(motion_claim, dialect, command, settings=("position",) if name in _MULTI else ())
        yield made("reaches", f"{name} brings the shaft to where it was asked to go.", "a shaft that stops elsewhere", _reaches)
        yield made(
            "within", f"{name} does not go beyond its target.", "a shaft that was beyond the target on the way", _within,
            at_best=Certainty.OPEN,
        )  # fmt: skip
        if name in _LIMITED:
            yield made(
                "max-speed", f"{name} keeps to max_speed, and comes to it where the way is long enough.",
                "a speed above it, or far below", _keeps_max_speed,
            )  # fmt: skip
            plain = named[name.removesuffix("_limited")]
            yield motion_claim(
                dialect, plain, "own-speed", f"{plain.name} does not keep to the max_speed of a move before it.",
                "the speed of the move before", partial(_own_speed, name), at_best=Certainty.LIKELY,
                settings=("position",) if name in _MULTI else (),
            )  # fmt: skip
            yield made(
                "max-speed-0", f"{name} with max_speed 0 turns nothing: 0 is a limit like any other.", "motion",
                _max_speed_0, rests_on=(Doubt.MEANING,), quirks=known(dialect, "lk-zero-speed-moves"),
            )  # fmt: skip
    for name in _MULTI:
        made = partial(motion_claim, dialect, named[name])
        yield made("absolute", f"{name} twice to one position moves once.", "a second motion", _absolute)
        yield made(
            "wide", f"{name} takes positions of more than 32 bits.", "a shaft that turns the wrong way", _wide_target,
            risks={Risk.SETTING},
        )  # fmt: skip
    for name in _STEPS:
        made = partial(motion_claim, dialect, named[name])
        yield made("adds-up", f"{name} five times by an angle moves by five times the angle.", "another angle", _adds_up)
    for name in _SINGLE:
        made = partial(motion_claim, dialect, named[name])
        yield made(
            "two-ways", f"{name} goes to one angle by both ways: together they are a turn.",
            "one way for both directions", _two_ways,
        )  # fmt: skip
        yield made(
            "clockwise", f"{name} with direction 0 turns clockwise, which raises the position.", "the other way",
            _clockwise, at_best=Certainty.LIKELY,
        )  # fmt: skip
    yield motion_claim(
        dialect, named["move_multi_turn_limited"], "sums", f"Each of {_MANY} replies has the sums that fit it.",
        "a sum that is off", _sums, quirks=known(dialect, "lk-off-sum"),
    )  # fmt: skip
    yield motion_claim(
        dialect, named["move_multi_turn"], "newer", "A newer move takes the place of the one under way.",
        "a shaft that ends elsewhere", _newer, at_best=Certainty.LIKELY,
    )  # fmt: skip


# --- moves ------------------------------------------------------------------------------------------------------------


def values_of(probe: Probe, command: Command, degrees: float, here: Sample) -> dict[str, int]:
    """Return the values of a move by so many degrees from where the shaft is (at most a turn)."""
    name, hundredths = command.name, round(degrees * 100)
    limit = {"max_speed": _CALM} if name in _LIMITED else {}
    if name in _MULTI:
        return {"position": round(here.value * 100) + hundredths, **limit}
    if name in _STEPS:
        return {"position": hundredths, **limit}
    angle = probe.read(Verb.READ_SINGLE_TURN, "angle")
    return {"direction": _CW if degrees >= 0 else _CCW, "angle": (angle + hundredths) % 36_000, **limit}


def _go(probe: Probe, command: Command, values: Mapping[str, int]) -> tuple[Exchange, Sample]:
    exchange = probe.do(command, values)
    # At 45 rpm a turn lasts 1.3 s.
    probe.wait(500 * MS)
    return exchange, motion.wait_standing(probe)


def _reaches(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for degrees in (123.45, -67.89):
        here = motion.position(probe)
        exchange, end = _go(probe, command, values_of(probe, command, degrees, here))
        went = end.value - here.value
        if abs(abs(went) - abs(degrees)) > NEAR or (command.name not in _SINGLE and abs(went - degrees) > NEAR):
            raise refute(
                exchange,
                f"{command.name} does not end where it was asked to go",
                expected=f"{degrees:+.2f} degrees",
                got=f"{went:+.2f} degrees",
            )


def _within(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    here = motion.position(probe)
    exchange = probe.do(command, values_of(probe, command, 200.0, here))
    seen = motion.sampled(probe, 2 * SECOND_NS, 20 * MS)
    end = motion.wait_standing(probe)
    way = 1 if end.value > here.value else -1
    beyond = max((s.value - end.value) * way for s in seen)
    if beyond > 1:
        text = f"{command.name} goes beyond its target and comes back"
        raise refute(exchange, text, expected="at most a degree beyond", got=f"{beyond:.1f} degrees beyond")


def _keeps_max_speed(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    for limit in (9_000, _CALM):
        here = motion.position(probe)
        values = {**values_of(probe, command, 300.0, here), "max_speed": limit}
        exchange = probe.do(command, values)
        probe.wait(500 * MS)
        speed, spread = measured(probe, 300 * MS)
        motion.wait_standing(probe)
        wanted = limit / 100
        if abs(speed) > wanted * 1.02 + spread + 1 or abs(speed) < wanted * 0.9 - spread:
            text = f"{command.name} does not keep to max_speed"
            raise refute(exchange, text, expected=f"{wanted:g} deg/s", got=f"{abs(speed):.1f} deg/s")


def _own_speed(limited: str, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    slow, plain = probe.command(limited), command
    _go(probe, slow, {**values_of(probe, slow, 30.0, motion.position(probe)), "max_speed": 3_000})
    exchange = probe.do(plain, values_of(probe, plain, 300.0, motion.position(probe)))
    probe.wait(200 * MS)
    speed, spread = measured(probe, 100 * MS)
    motion.wait_standing(probe)
    if abs(speed) < 60 - spread:
        text = f"{command.name} keeps to the max_speed of the move before it"
        raise refute(exchange, text, expected="more than 30 deg/s", got=f"{abs(speed):.0f} deg/s")


def _max_speed_0(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    here = motion.position(probe)
    exchange = probe.do(command, {**values_of(probe, command, 90.0, here), "max_speed": 0})
    probe.wait(2 * SECOND_NS)
    end = motion.stand_still(probe)
    if abs(end.value - here.value) <= NEAR:
        return
    if "lk-zero-speed-moves" in probe.claim.quirks and abs(abs(end.value - here.value) - 90) <= NEAR:
        probe.meets("lk-zero-speed-moves")
        return
    expect_stays(here, end, exchange, f"{command.name} with max_speed 0 turns the shaft")


def _absolute(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    here = motion.position(probe)
    values = values_of(probe, command, 50.0, here)
    _, there = _go(probe, command, values)
    exchange, again = _go(probe, command, values)
    if abs(again.value - there.value) > NEAR:
        text = f"{command.name} to where the shaft stands turns it"
        raise refute(exchange, text, expected="no motion", got=f"{again.value - there.value:+.2f} degrees")


def _wide_target(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    limit = {"max_speed": _CALM} if command.name in _LIMITED else {}
    for side in (1, -1):
        probe.do("set_position", {"position": side * _EDGE})
        here = motion.position(probe)
        exchange = probe.do(command, {"position": side * (_EDGE + 9_000), **limit})
        probe.wait(SECOND_NS)
        end = motion.stand_still(probe)
        went = (end.value - here.value) * side
        # An angle limit of 32 bits would end the way after 36 degrees.
        if went < 30:
            text = f"{command.name} to a position of more than 32 bits does not go there"
            raise refute(exchange, text, expected=f"{side * 90:+d} degrees", got=f"{end.value - here.value:+.1f} degrees")


def _adds_up(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    here = motion.position(probe)
    for _ in range(5):
        exchange, end = _go(probe, command, values_of(probe, command, 13.37, here))
    went = end.value - here.value
    if abs(went - 5 * 13.37) > NEAR:
        text = f"{command.name}: five moves do not add up"
        raise refute(exchange, text, expected=f"{5 * 13.37:.2f} degrees", got=f"{went:+.2f} degrees")


def _both_ways(probe: Probe, command: Command) -> tuple[float, float, Exchange]:
    """Go to one angle clockwise, back to where that began, and to it again the other way; return both ways (degrees)."""
    motion.ready_to_move(probe)
    limit = {"max_speed": _CALM} if command.name in _LIMITED else {}
    start = probe.read(Verb.READ_SINGLE_TURN, "angle")
    ways = []
    for direction in (_CW, _CCW):
        here = motion.position(probe)
        exchange, end = _go(probe, command, {"direction": direction, "angle": (start + 12_000) % 36_000, **limit})
        ways.append(end.value - here.value)
        _go(probe, command, {"direction": 1 - direction, "angle": start, **limit})
    return ways[0], ways[1], exchange


def _two_ways(probe: Probe, command: Command) -> None:
    cw, ccw, exchange = _both_ways(probe, command)
    if cw * ccw >= 0 or abs(abs(cw) + abs(ccw) - 360) > 2 * NEAR:
        text = f"{command.name} does not go to one angle by both ways"
        raise refute(exchange, text, expected="two ways that are a turn together", got=f"{cw:+.1f} and {ccw:+.1f} degrees")


def _clockwise(probe: Probe, command: Command) -> None:
    cw, ccw, exchange = _both_ways(probe, command)
    if abs(cw - 120) > NEAR or abs(ccw + 240) > NEAR:
        text = f"{command.name} does not turn the way that it was told"
        raise refute(exchange, text, expected="+120 and -240 degrees", got=f"{cw:+.1f} and {ccw:+.1f} degrees")


def _newer(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    here = motion.position(probe)
    probe.do("move_multi_turn_limited", {"position": round(here.value * 100) + 36_000, "max_speed": 9_000})
    probe.wait(SECOND_NS)
    exchange, end = _go(probe, command, {"position": round(here.value * 100) - 3_000})
    went = end.value - here.value
    if abs(went + 30) > NEAR:
        raise refute(exchange, "a newer move does not take over", expected="-30 degrees", got=f"{went:+.1f} degrees")


def _sums(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    here = motion.position(probe)
    values = values_of(probe, command, 0.0, here)
    good, off = 0, []
    for _ in range(_MANY):
        exchange = probe.ask(command, values, quiet_ns=0)
        if exchange.reply is not None and exchange.reply.message.frame.checksum_ok:
            good += 1
        else:
            off.append(exchange)
    if not good:
        raise Inconclusive(f"no reply to {command.name} can be read")
    if off and len(off) <= _MANY // 20 and "lk-off-sum" in probe.claim.quirks and all(e.answers or e.junk for e in off):
        probe.meets("lk-off-sum")
    elif off:
        text = f"replies to {command.name} have sums that do not fit"
        raise refute(off[0], text, expected=f"{_MANY} good replies", got=f"{good} good ones")
