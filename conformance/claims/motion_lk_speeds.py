"""Speeds of LK motors: how fast the shaft turns for what A2 asks, which way, and for how long.

Rules kept here:
- The speed is measured from positions, by the clock of the line.
- Positive is clockwise and raises what 92 reads.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Command, Dialect, Doubt
from conformance.claim import Claim
from conformance.claims.motion_claim import motion_claim, refute
from conformance.motion import motion
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: How sure it is which way a positive number turns.
_ON_SIGN = (Doubt.SIGN,)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about the speeds of an LK motor."""
    made = partial(motion_claim, dialect, dialect.by_name["run_speed"])
    # 0.01 deg/s; 36000 and -50000 need more than 16 bits.
    for sent in (1_000, -18_000, 36_000, -50_000):
        yield made(
            f"speed-{sent / 100:g}".replace(".", "_"),
            f"Asked for {sent / 100:g} deg/s, the shaft turns at {sent / 100:g} deg/s.",
            "positions that change by another speed",
            partial(_turns_at, sent),
            parameters={"speed": sent},
        )
    yield made(
        "sign", "A positive speed raises the position, a negative one lowers it.", "the other way", _sign, rests_on=_ON_SIGN
    )
    yield made("opposite", "Speeds of opposite signs turn opposite ways.", "one way for both", _opposite)
    yield made("lasts", "A run goes on until it is told otherwise.", "a shaft that stops by itself", _lasts)
    yield made("zero", "Speed 0 stops the shaft.", "a shaft that turns", _zero)
    yield made("changes", "A newer speed takes over from the one under way.", "another speed", _changes)


def run(probe: Probe, sent: int, wait_ns: int = 500 * MS) -> Exchange:
    """Begin a run (0.01 deg/s) and let the shaft come to its speed."""
    motion.ready_to_move(probe)
    exchange = probe.do("run_speed", {"speed": sent})
    probe.wait(wait_ns)
    return exchange


def measured(probe: Probe, over_ns: int = SECOND_NS) -> tuple[float, float]:
    """Return the speed of the shaft from two positions, deg/s, and its uncertainty."""
    first = motion.position(probe)
    probe.wait(over_ns)
    rpm, spread = motion.speed_between(first, motion.position(probe))
    return rpm * 6, spread * 6


def _turns_at(sent: int, probe: Probe, command: Command) -> None:
    exchange = run(probe, sent)
    speed, spread = measured(probe)
    motion.stand_still(probe)
    wanted = abs(sent) / 100
    if abs(abs(speed) - wanted) > wanted / 100 + spread + 0.5:
        text = "the shaft does not turn at the speed that was asked for"
        raise refute(exchange, text, expected=f"{wanted:g} deg/s", got=f"{abs(speed):.2f} deg/s +-{spread:.2f}")
    probe.measured["deg_s"] = speed


def _ways(probe: Probe) -> tuple[float, float]:
    run(probe, 18_000)
    up, _ = measured(probe, 300 * MS)
    motion.stand_still(probe)
    run(probe, -18_000)
    down, _ = measured(probe, 300 * MS)
    motion.stand_still(probe)
    return up, down


def _sign(probe: Probe, command: Command) -> None:
    up, down = _ways(probe)
    if up <= 0 or down >= 0:
        text = "the sign of a speed turns the shaft the other way"
        raise refute(probe.traffic[0], text, expected="+180 and -180 deg/s", got=f"{up:+.0f} and {down:+.0f} deg/s")


def _opposite(probe: Probe, command: Command) -> None:
    up, down = _ways(probe)
    if up * down >= 0:
        text = "speeds of opposite signs turn the shaft one way"
        raise refute(probe.traffic[0], text, expected="two ways", got=f"{up:+.0f} and {down:+.0f} deg/s")


def _lasts(probe: Probe, command: Command) -> None:
    exchange = run(probe, 18_000, 5 * SECOND_NS)
    speed, _ = measured(probe, 300 * MS)
    motion.stand_still(probe)
    if abs(abs(speed) - 180) > 5:
        raise refute(exchange, "a run does not go on", expected="180 deg/s", got=f"{speed:.0f} deg/s")


def _zero(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    exchange = probe.do(command, {"speed": 0})
    probe.wait(3 * SECOND_NS)
    speed, _ = measured(probe, 500 * MS)
    if abs(speed) > 1:
        motion.stop(probe)
        raise refute(exchange, "speed 0 does not stop the shaft", expected="0 deg/s", got=f"{speed:.1f} deg/s")


def _changes(probe: Probe, command: Command) -> None:
    run(probe, 18_000)
    exchange = run(probe, 9_000, SECOND_NS)
    speed, _ = measured(probe, 500 * MS)
    motion.stand_still(probe)
    if abs(abs(speed) - 90) > 3:
        raise refute(exchange, "a newer speed does not take over", expected="90 deg/s", got=f"{speed:.0f} deg/s")
