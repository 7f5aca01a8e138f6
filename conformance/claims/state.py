"""State: after any sequence of allowed requests a drive is what the manual says it is then.

    settings    settings, allowed and not, restarts          motion    runs, moves, stops, zero
    mixed       all of it, with the settings that motion depends on, enabling and disabling

One claim for each variant. Sequences are drawn by Hypothesis (`conformance.model.machine`) and compared with a model of the
drive (`conformance.model.session`) after each step; a refutation shows a shortened list of steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk, Verb
from conformance.claim import Aspect, Theme
from conformance.claims.declare import Case, claim
from conformance.claims.known_quirks import known
from conformance.motion import motion
from conformance.talk.acceptance import need_plain_replies
from conformance.talk.probe import Probe


class Variant(NamedTuple):
    """What a variant shows, what its steps risk, and the quirks of real drives that they bring out."""

    statement: str
    risks: tuple[Risk, ...]
    quirks: tuple[str, ...] = ()


_MOTION = (Risk.SETTING, Risk.MOTION, Risk.UNBOUNDED)
VARIANTS = {
    "settings": Variant(
        "After any sequence of settings the drive has what was set, and nothing else has changed.",
        (Risk.SETTING, Risk.TORQUE),
        ("lk-off-clears-turns",),
    ),
    "motion": Variant("After any sequence of motion commands the drive is where and as fast as they say.", _MOTION),
    "mixed": Variant(
        "Settings, enabling and motion in any order leave the drive as each of them says.",
        (*_MOTION, Risk.TORQUE),
        ("lk-off-clears-turns",),
    ),
}
#: Families of drives that have a model (`conformance.model.machine`).
_MODELLED = ("mks", "lk")
_ENABLING = (Verb.ENABLE, Verb.MOTOR_ON, Verb.MOTOR_OFF)
_NOT_DRAWN = frozenset({Risk.LINK, Risk.POWER_ON, Risk.WEAR, Risk.MOTION})


def _draws(variant: str, command: Command) -> bool:
    """Say whether a variant draws a command."""
    sets = Risk.SETTING in command.all_risks and not command.all_risks & _NOT_DRAWN
    if variant == "settings":
        return sets
    kind = command.motion.kind if command.motion is not None else None
    moves_shaft = command.moves and kind not in (MotionKind.HOME, MotionKind.CALIBRATE, MotionKind.TORQUE)
    frees = command.verb in (Verb.RELEASE_PROTECTION, Verb.CLEAR_ERRORS)
    return (moves_shaft and not frees) or (variant == "mixed" and (sets or command.verb in _ENABLING))


def _variants(dialect: Dialect) -> Iterator[Case]:
    for name, variant in VARIANTS.items() if dialect.family in _MODELLED else ():
        about = [c for c in dialect.commands if _draws(name, c)]
        settings = [n for c in about if Risk.SETTING in c.all_risks for f in c.request_forms for n in f.layout.named]
        facts = {
            "name": name,
            "statement": variant.statement,
            "quirks": known(dialect, *variant.quirks),
            "risks": motion.risks(dialect, *variant.risks),
            "settings": tuple(dict.fromkeys((*motion.settings(dialect), *settings))),
            "commands": tuple(c.name for c in about),
            "covers": tuple((c.name, Aspect.STATE) for c in about),
        }
        yield Case(dialect, None, {"variant": name}, facts)


@claim(
    Theme.STATE,
    each=_variants,
    first=need_plain_replies,
    refuted_by="another answer, position, speed or setting than the model's",
    section="all",
    rests_on=(Doubt.SEQUENCE,),
    at_best=Certainty.LIKELY,
)
def _sequences(probe: Probe, variant: str) -> None:
    # Hypothesis is imported where it is used, and nowhere else.
    from conformance.model import machine

    machine.check(probe, variant)
