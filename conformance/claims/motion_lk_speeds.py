"""Speeds of LK motors: how fast the shaft turns for what A2 asks, which way, and for how long.

Rules kept here:
- The speed is measured from positions, by the clock of the line.
- Positive is clockwise and raises what 92 reads.
"""

from __future__ import annotations

from conformance.motion import motion
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe


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
