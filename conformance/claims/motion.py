"""Motion: what a drive does when it is told to move, and what it says about it. The parts stand in files of their own."""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Dialect
from conformance.claim import Claim, Theme
from conformance.claims import (
    calibrating,
    control_parameters,
    enabling,
    encoder_zero,
    end_limits,
    health,
    homing,
    motion_reads,
    motor_states,
    moves,
    newer_motion,
    power_on,
    protection,
    refusals,
    responding,
    runs,
    set_zero,
    speed_limits,
    stops,
    subdivisions,
    torque,
)
from conformance.claims.declare import declared_in

_PARTS = (
    moves,
    runs,
    newer_motion,
    speed_limits,
    subdivisions,
    stops,
    enabling,
    motor_states,
    refusals,
    motion_reads,
    torque,
    health,
    encoder_zero,
    control_parameters,
)
#: Parts about what the drives of one family alone have.
_OF_FAMILY = {"mks": (responding, set_zero, homing, end_limits, protection, power_on, calibrating)}


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    for part in (*_PARTS, *_OF_FAMILY.get(dialect.family, ())):
        yield from (claim for claim in declared_in(part.__name__, dialect) if claim.theme is Theme.MOTION)
