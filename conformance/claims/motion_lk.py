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

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Verb
from conformance.claim import Claim
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
    for name in _LIMITED:
        made = partial(motion_claim, dialect, named[name], settings=("position",) if name in _MULTI else ())
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
