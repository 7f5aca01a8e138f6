"""How fast the shaft turns at most: by the work mode, and by the max_speed of a move.

Rules kept here:
- An MKS work mode has a highest speed (400, 1500, 3000 rpm); a greater one, in whatever width, runs at it and is no error.
- The max_speed of an LK move holds for that move alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claim import Inconclusive
from conformance.claims.declare import Case
from conformance.claims.known_quirks import LATE, may_meet
from conformance.claims.motion.motion_claim import command_of, expect_speed, expect_taken, of_motion, risks_by
from conformance.claims.motion.moves import with_max_speed
from conformance.motion import declared, motion
from conformance.motion.attempts import anew
from conformance.motion.declared import CALM, MOVES, SUBDIVISION
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe

#: The highest speed of any MKS drive, and that of a drive whose manual has no table of modes.
_HIGHEST = 3000
#: The max_speed of a move that others are not to keep, in rpm.
_SLOW = 5


#: How long a shaft turns before a motion that comes then.
_GOING_NS = 60 * MS
#: How long a move keeps its speed at least.
_KEEPS_NS = 350 * MS
#: How far a move goes. At exactly 20 turns back one of its frames ends in a sound native frame to all drives.
_TURNS = 19.9


class Spun(NamedTuple):
    """A motion at a speed as sent, in a mode. `rpm`: as the drive reads it."""

    exchange: Exchange
    rpm: Sample


def _way(probe: Probe, speed: int, mode: str) -> int:
    """Return which way a speed is tried in a mode: the highest of it one way, those beyond the other way."""
    beyond = speed > probe.dialect.mode_speeds.get(mode, _HIGHEST)
    return 1 if (declared.bus_modes(probe.dialect).index(mode) + beyond) % 2 == 0 else -1


@anew
def spun(probe: Probe, command: Command, speed: int, mode: str, turns: bool = False) -> Spun:
    """Turn the shaft at a speed as sent, by a run or a long move, and look when the ramp is over. `turns`: it does before."""
    way = _way(probe, speed, mode)
    motion.ready_to_move(probe, mode, subdivision=SUBDIVISION)
    if turns:
        motion.run_at(probe, way * CALM)
        probe.wait(_GOING_NS)
    exchange = motion.ask(
        probe, command, way * _TURNS * 360, rpm=way, acceleration=255, quiet_ns=0, more={declared.of(command).speed: speed}
    )
    # At 50 us for one rpm the shaft has 3000 rpm after 150 ms. A move of so many turns keeps that speed for 250 ms.
    probe.wait(exchange.sent_ns + 180 * MS - probe.gate.now_ns())
    seen = motion.speed(probe)
    motion.stop(probe, 255)
    motion.wait_standing(probe)
    return Spun(exchange, seen)


def expect_spun(probe: Probe, command: Command, speed: int, mode: str, rpm: int, *, turns: bool = False) -> None:
    """Refute unless a motion at a speed as sent, in a mode, turns the shaft at `rpm`. `turns`: it turns before."""
    seen = probe.recorded(spun, command, speed, mode, turns)
    expect_taken(probe, seen.exchange, f"{command.name} at speed {speed} is refused in mode {mode}")
    if seen.rpm.t_ns > seen.exchange.sent_ns + _KEEPS_NS:
        # The move may be at its end by then.
        if LATE not in probe.claim.quirks:
            raise Inconclusive("the reply to the read of the speed came too late")
        probe.meets(LATE)
        return
    text = f"{command.name} at speed {speed} in mode {mode} turns at another speed"
    expect_speed(seen.rpm, rpm, seen.exchange, text)


def _modes(dialect: Dialect) -> Iterator[Case]:
    for run in dialect.motions(MotionKind.RUN):
        for mode in run.modes:
            yield Case(dialect, run, {"mode": mode, "rpm": dialect.mode_speeds.get(mode, _HIGHEST)})


@of_motion(
    each=_modes, name="{command}/highest-{mode}", refuted_by="another speed", at_best=Certainty.LIKELY, quirks=may_meet(LATE)
)
def _highest_of_mode(probe: Probe, command: Command, mode: str, rpm: int) -> None:
    """In mode {mode} the shaft turns at up to {rpm} rpm, and at {rpm} rpm when more is asked for."""
    for speed in (rpm, _HIGHEST):
        expect_spun(probe, command, speed, mode, rpm)


def _moves_by_mode(dialect: Dialect) -> Iterator[Case]:
    """Yield the moves of a dialect whose modes have highest speeds, each with those below the highest of all."""
    for command in dialect.motions(*MOVES):
        modes = {mode: dialect.mode_speeds.get(mode, _HIGHEST) for mode in command.modes}
        lower = {mode: rpm for mode, rpm in modes.items() if rpm < _HIGHEST}
        if lower:
            yield Case(dialect, command, {"limits": lower})


@of_motion(
    each=_moves_by_mode,
    refuted_by="another speed",
    risks=risks_by(Verb.RUN_SPEED),
    at_best=Certainty.LIKELY,
    parameters={},
    quirks=may_meet(LATE),
)
def _mode_limit(probe: Probe, command: Command, limits: dict[str, int]) -> None:
    """{command} at a greater speed than that of the work mode turns the shaft at the mode's, where it turns already, too."""
    for mode, rpm in limits.items():
        expect_spun(probe, command, _HIGHEST, mode, rpm, turns=True)


# --- the max_speed of a move ------------------------------------------------------------------------------------------


def _after_limited(dialect: Dialect) -> Iterator[Case]:
    """Yield every move, with the moves with a max_speed that come before it."""
    limited = tuple(command_of(case) for case in with_max_speed(dialect))
    for command in dialect.motions(*MOVES) if limited else ():
        yield Case(dialect, command, {"limited": tuple(c.name for c in limited)}, {"parameters": {}})


@of_motion(each=_after_limited, refuted_by="the speed of the move before", at_best=Certainty.LIKELY, settings=("position",))
def _own_speed(probe: Probe, command: Command, limited: tuple[str, ...]) -> None:
    """{command} does not keep to the max_speed of any move before it."""
    motion.prepare(probe, command)
    for before in limited:
        motion.begin(probe, probe.command(before), 5, rpm=_SLOW)
        probe.wait(200 * MS)
        exchange = motion.begin(probe, command, 300)
        probe.wait(100 * MS)
        rpm, spread = motion.mean_speed(probe, 100 * MS)
        motion.stand_still(probe)
        text, key = f"{command.name} keeps to the max_speed of {before} before it", f"{command.name} keeps a max_speed"
        probe.expect(
            abs(rpm) + spread,
            at_least=2 * _SLOW,
            expected=f"more than {_SLOW} rpm",
            unit="rpm",
            refutes=text,
            exchange=exchange,
            key=key,
        )
