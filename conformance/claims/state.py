"""State: after any sequence of allowed requests a drive is what the manual says it is then.

    settings    settings, allowed and not, restarts          motion    runs, moves, stops, zero
    mixed       all of it, with the settings that motion depends on, enabling and disabling

One claim for each variant. Sequences are drawn by Hypothesis (`model.machine`) and compared with a model of the drive
(`conformance.model.session`) after each step; what refutes it is a list of steps, shortened.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from conformance.claim import Aspect, Claim, Theme
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.talk.acceptance import need_plain_replies
from conformance.talk.probe import Probe

_WORDS = {
    "settings": "After any sequence of settings the drive has what was set, and nothing else has changed.",
    "motion": "After any sequence of motion commands the drive is where and as fast as they say.",
    "mixed": "Settings, enabling and motion in any order leave the drive as each of them says.",
}
#: Risks of a variant's steps beside those that every session has.
_RISKS = {
    "settings": (Risk.SETTING, Risk.TORQUE),
    "motion": (Risk.SETTING, Risk.MOTION, Risk.UNBOUNDED),
    "mixed": (Risk.SETTING, Risk.MOTION, Risk.UNBOUNDED, Risk.TORQUE),
}
#: What real drives were seen to do that a variant's steps bring out: those that switch an LK motor off.
_QUIRKS = {"settings": ("lk-off-clears-turns",), "mixed": ("lk-off-clears-turns",)}
_ENABLING = (Verb.ENABLE, Verb.MOTOR_ON, Verb.MOTOR_OFF)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    if not journey.is_mks(dialect) and "move_increment_limited" not in dialect.by_name:
        return
    for variant, statement in _WORDS.items():
        yield declare(
            dialect, Theme.STATE, variant, statement, "another answer, position, speed or setting than the model's",
            _check(variant), section="all", rests_on=(Doubt.SEQUENCE,), at_best=Certainty.LIKELY,
            parameters={"variant": variant}, quirks=known(dialect, *_QUIRKS.get(variant, ())), **_needs(dialect, variant),
        )  # fmt: skip


def _check(variant: str) -> Callable[[Probe], None]:
    def check(probe: Probe) -> None:
        # Hypothesis is imported where it is used, and nowhere else.
        from conformance.model import machine

        need_plain_replies(probe)
        machine.check(probe, variant)

    return check


def _needs(dialect: Dialect, variant: str) -> dict[str, Any]:
    about = [c for c in dialect.commands if _covers(c, variant)]
    settings = [n for c in about if Risk.SETTING in c.all_risks for f in c.request_forms for n in f.layout.named]
    return {
        "risks": motion.risks(dialect, *_RISKS[variant]),
        "settings": tuple(dict.fromkeys((*motion.settings(dialect), *settings))),
        "commands": tuple(c.name for c in about),
        "covers": tuple((c.name, Aspect.STATE) for c in about),
    }


def _covers(command: Command, variant: str) -> bool:
    """Say whether a variant draws a command."""
    sets = Risk.SETTING in command.all_risks and not command.all_risks & {Risk.LINK, Risk.POWER_ON, Risk.WEAR, Risk.MOTION}
    moves = command.moves and command.verb not in (Verb.HOME, Verb.CALIBRATE, Verb.RELEASE_PROTECTION, Verb.CLEAR_ERRORS)
    strong = command.verb in (Verb.RUN_TORQUE, Verb.RUN_OPEN_LOOP)
    if variant == "settings":
        return sets
    return (moves and not strong) or (variant == "mixed" and (sets or command.verb in _ENABLING))
