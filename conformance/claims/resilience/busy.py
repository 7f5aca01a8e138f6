"""Resilience of a busy drive: damaged requests and many moves do not disturb it.

Rules kept here:
- The shaft turns slowly, and is stopped by a ramp in the end.
- Whether a move goes on under another command is for claims about motion. Reads and settings stand in modules of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from analyzer.catalogue import Certainty, Dialect, Risk, Verb
from conformance.claim import Inconclusive, Theme
from conformance.claims.control_reads import PAUSE_NS, garblers
from conformance.claims.declare import Case, Cases, claim
from conformance.motion import declared, motion
from conformance.motion.declared import QUICK
from conformance.talk.probe import Probe

_SECOND_NS = 1_000_000_000
_RPM = 60.0
#: How far the speed may differ from the asked one while something else is said to the drive, in rpm.
_NEAR = 6.0


def _moving(dialect: Dialect) -> Iterator[Case]:
    if declared.can_move(dialect):
        yield Case(dialect)


def _of_busy(refuted_by: str, *, each: Cases = _moving, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    every: dict[str, Any] = {
        "section": lambda case: case.dialect.by_verb[Verb.RUN_SPEED].section,
        "risks": lambda case: declared.risks(case.dialect, Risk.UNBOUNDED),
        "settings": lambda case: declared.settings(case.dialect),
        "parameters": {},
    }
    return claim(Theme.RESILIENCE, each=each, refuted_by=refuted_by, **every | facts)


# --- what is under way ------------------------------------------------------------------------------------------------


def _run(probe: Probe) -> None:
    motion.ready_to_move(probe)
    motion.run_at(probe, _RPM)
    probe.wait(_SECOND_NS)


def _running(probe: Probe) -> float:
    """Begin a run and return its speed. Raises Inconclusive at another speed than the requested one."""
    _run(probe)
    speed = motion.speed(probe).value
    if abs(abs(speed) - _RPM) > _NEAR:
        _stop(probe)
        raise Inconclusive(f"the shaft does not turn at {_RPM:.0f} rpm, but at {speed:.0f}")
    return speed


def _stop(probe: Probe) -> None:
    motion.stop(probe)
    probe.wait(_SECOND_NS)
    motion.wait_standing(probe)


# --- damaged requests ---------------------------------------------------------------------------------------------------


@_of_busy("another speed", name="moving/noise")
def _damaged_requests(probe: Probe) -> None:
    """Damaged requests do not disturb a shaft that turns."""
    before = _running(probe)
    try:
        garbler = garblers(probe)[0]
        for what, item in [*garbler.wrong_checks(), *garbler.truncated()]:
            sent = probe.send(item, timeout_ns=PAUSE_NS)
            now = motion.speed(probe).value
            text, key = f"a damaged read ({what}) changes the speed", "a damaged read changes the speed"
            probe.expect(now, near=before, within=_NEAR, unit="rpm", refutes=text, exchange=sent, key=key)
    finally:
        _stop(probe)


# --- many moves in a row ----------------------------------------------------------------------------------------------

#: Short moves one after the other, and how long each of them is given.
_SHORT_MOVES, _SHORT_DEGREES, _SHORT_NS = 16, 9, 80_000_000


def _moves_that_add(dialect: Dialect) -> Iterator[Case]:
    """Yield the dialect where a move goes on from where the one before ends, and not from where the shaft is."""
    if dialect.family == "mks":
        yield from _moving(dialect)


@_of_busy("a move that is refused or not carried out", each=_moves_that_add, name="moves/in-a-row", at_best=Certainty.LIKELY)
def _in_a_row(probe: Probe) -> None:
    """The last of many short moves is taken as the first one was, and all of them are carried out."""
    move = declared.any_move(probe.dialect)
    motion.prepare(probe, move)
    before = motion.wait_standing(probe)
    for number in range(_SHORT_MOVES):
        exchange = motion.ask(probe, move, _SHORT_DEGREES, rpm=180, acceleration=QUICK, quiet_ns=0)
        if not exchange.silent:
            text = f"the last of {number + 1} moves in a row is refused"
            taken = not motion.refused(probe, exchange)
            probe.expect("a refusal", holds=taken, expected="no refusal", refutes=text, exchange=exchange, key="moves in a row")
        probe.wait(_SHORT_NS)
    moved = motion.wait_standing(probe).value - before.value
    text = f"{_SHORT_MOVES} moves in a row are not all carried out"
    wanted, within = _SHORT_MOVES * _SHORT_DEGREES, motion.miss(probe) * 2
    probe.expect(abs(moved), near=wanted, within=within, unit="degrees", refutes=text, exchange=exchange)
