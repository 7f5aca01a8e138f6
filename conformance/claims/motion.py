"""Motion: what a drive does when it is told to move, and what it says about it. The parts stand in files of their own."""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Dialect
from conformance.claim import Claim, Theme
from conformance.claims import (
    calibrating,
    enabling,
    end_limits,
    homing,
    motion_lk,
    motion_lk_encoder,
    motion_lk_errors,
    motion_lk_forces,
    motion_lk_limits,
    motion_lk_reads,
    motion_reads,
    motion_speeds,
    motor_states,
    moves,
    newer_motion,
    power_on,
    protection,
    refusals,
    responding,
    runs,
    set_zero,
    stops,
)
from conformance.claims.declare import declared_in
from conformance.motion import moves as old_moves

_DECLARED = (moves, runs, newer_motion, stops, enabling, motor_states, refusals)
_MKS = (motion_speeds, motion_reads, responding, set_zero, homing, end_limits, protection, power_on, calibrating)
_LK = (motion_lk, motion_lk_forces, motion_lk_errors, motion_lk_reads, motion_lk_encoder, motion_lk_limits)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    for module in _DECLARED:
        yield from declared_in(module.__name__, dialect)
    for part in _MKS if old_moves.is_mks(dialect) else _LK if is_lk(dialect) else ():
        for claim in part.claims(dialect):
            if claim.theme is Theme.MOTION:
                yield claim


def is_lk(dialect: Dialect) -> bool:
    """Say whether a dialect has the moves of the LK motors."""
    return dialect.family == "lk"
