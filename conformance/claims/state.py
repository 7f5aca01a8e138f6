"""State: after any sequence of allowed requests a drive is what the manual says it is then.

A walk (`conformance.model.route`) in which any two conditions meet: work mode, on and off, settings, motion, the command that
comes then. Each reply is compared with that of the ideal drive, which was sent the same (`conformance.model.walk`).
A refutation shows a shortened list of steps. The walk has some legs, one claim each.

Some short walks (`conformance.model.corners`) go where a route that is drawn seldom comes: to the ends of numbers and speeds,
to motion in place of motion, to damaged requests.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial

from analyzer.catalogue import Certainty, Dialect, Doubt, Risk
from conformance.claim import Aspect, Theme
from conformance.claims.declare import Case, claim
from conformance.drives.make import KINDS
from conformance.gate.bounds import Leeway
from conformance.model import conditions, corners, route, story
from conformance.model.lk_parameters import need_room
from conformance.model.steps import beginning
from conformance.motion import declared
from conformance.talk.acceptance import need_plain_replies
from conformance.talk.probe import Probe

#: In how many claims the walk is done.
LEGS = 3


def _legs(dialect: Dialect) -> Iterator[Case]:
    if dialect.name in KINDS:
        for leg in range(LEGS):
            yield _case(dialect, (deed.name for deed in conditions.deeds(dialect)), {"leg": leg + 1})


def _corners(dialect: Dialect) -> Iterator[Case]:
    for part, (statement, _) in corners.PARTS.items() if dialect.name in KINDS and dialect.ramp is not None else ():
        steps = (*beginning(dialect), *corners.steps(dialect, part))
        yield _case(dialect, (step.name for step in steps), {"part": part}, statement=f"{statement}.")


def _case(dialect: Dialect, names: Iterable[str], given: Mapping[str, object], **more: object) -> Case:
    about = [c for c in map(dialect.by_name.__getitem__, dict.fromkeys(names)) if c.all_risks != {Risk.READ}]
    risks = frozenset[Risk]().union(*(command.all_risks for command in about)) - {Risk.UNKNOWN, Risk.READ}
    facts = {
        "risks": declared.risks(dialect, *risks),
        # What cannot be put back besides is left out, step by step.
        "settings": declared.settings(dialect),
        "commands": tuple(command.name for command in about),
        "covers": tuple((command.name, Aspect.STATE) for command in about),
    }
    return Case(dialect, None, given, facts | more)


def _first(probe: Probe) -> None:
    need_plain_replies(probe)
    need_room(probe)


_of_state = partial(
    claim,
    Theme.STATE,
    first=_first,
    refuted_by="another answer, position, speed or setting than that of the ideal drive",
    section="all",
    rests_on=(Doubt.SEQUENCE,),
    at_best=Certainty.LIKELY,
)


@_of_state(each=_legs, name="walk/{leg}")
def _walk(probe: Probe, leg: int) -> None:
    """In any state and after any requests, a drive answers and moves as the manual says (leg {leg})."""
    allowance = probe.gate.allowance
    leeway = Leeway(allowance.bounds, allowance.subdivision, dialect=probe.dialect)
    waits = probe.rig.write_gap_ns > 0
    story.check(probe, route.steps(probe.dialect, seed=probe.rig.seed, leeway=leeway, leg=leg, legs=LEGS, waits=waits))


@_of_state(each=_corners, name="corners/{part}")
def _at_corners(probe: Probe, part: str) -> None:
    """In a part of the corners, a drive answers and moves as the manual says."""
    story.check(probe, corners.steps(probe.dialect, part))
