"""Values of the settings in a walk (`model.walk`), drawn by chance from the limits of the catalogue.

    setting_values(dialect, command, chance, leeway, stray=False)     allowed ones, or one of them outside its limits
    parameter(form, chance)                                           those of a parameter of an LK drive

Rules kept here:
- Values that a motor cannot move without stay strong; none depends on a switch.
"""

from __future__ import annotations

import random

from analyzer.catalogue import Command, Dialect, Form, Verb
from analyzer.layout import Effect, Field
from conformance.gate.bounds import Leeway
from conformance.model import limits, lk_parameters
from conformance.motion.declared import SUBDIVISION
from conformance.talk import samples

#: The subdivisions of a walk.
SUBDIVISIONS = (SUBDIVISION, 64, 7, 128, 0)
#: A motor needs these as they are, or a switch decides what they do.
_STRONG = frozenset({"current", "home_current", "holding_current", "stall_tolerance", "end_limit"})
#: Of these a little less is as good, so that what was not stored shows.
_EITHER = _STRONG - {"end_limit"}
#: More of this does not hurt, and needs its high byte.
_MORE = {"stall_tolerance": 0x0123}
#: A homing search that no switch ends is this fast at most.
_HOME_RPM = 600
#: Groups are behind the addresses that drives often have.
_GROUP_LEAST = 0x11
#: The farthest name of a place, in hundredths of a degree.
_FAR = 100_000_000
#: Limits with which a motor moves as it would without, whatever their unit is, which no manual prints.
ROOMY = {"torque_limit": (1500, 1900), "speed_limit": (0x1F_2345, 0x1E_0F23), "angle_limit": (0x2134_5678, 0x1134_5678)}


def setting_values(dialect: Dialect, command: Command, chance: random.Random, leeway: Leeway, *, stray: bool) -> dict[str, int]:
    """Return values of a request, allowed ones or one of them outside its limits."""
    form: Form = chance.choice(forms_of(command))
    plain = samples.sample(dialect, command, form)
    wrong = [name for name, field in form.layout.named.items() if limits.beyond(field)]
    beyond = chance.choice(wrong) if stray and wrong else ""
    values = {}
    for name, field in form.layout.named.items():
        if name == beyond:
            values[name] = chance.choice(limits.beyond(field))
        elif field.fixed is not None:
            values[name] = field.fixed
        elif name in _STRONG:
            values[name] = chance.choice(
                [v for v in (plain[name] - 1, plain[name] + _MORE.get(name, 0)) if name in _EITHER and field.allows(v)]
                or [plain[name]]
            )
        else:
            values[name] = _value(field, chance, leeway)
    return values


def parameter(form: Form, chance: random.Random) -> dict[str, int]:
    """Return values of a parameter with which a motor moves as it would without."""
    which = chance.randrange(2)
    moderate = lk_parameters.moderate(form, which)
    return {name: ROOMY[name][which] if name in ROOMY else value for name, value in moderate.items()}


def forms_of(command: Command) -> list[Form]:
    """Return the forms of a request that have values; of a parameter write those that are about one parameter."""
    if command.verb is not Verb.WRITE_PARAMETER:
        return [form for form in command.request_forms if form.layout.named] or list(command.request_forms)
    return [f for f in command.request_forms if f.layout.named["parameter"].fixed]


def _value(field: Field, chance: random.Random, leeway: Leeway) -> int:
    if field.effect is Effect.SUBDIVISION:
        return chance.choice([s for s in (*SUBDIVISIONS, 1, 32, 255, 11) if field.allows(s)])
    spans = limits.allowed(field, leeway)
    low, high = chance.choice(spans)
    if field.unit == "deg" and field.effect is None:
        # Within what the drive's own limit of the angle leaves.
        low, high = max(low, -_FAR), min(high, _FAR)
    if field.effect is Effect.HOME_SPEED:
        high = min(high, _HOME_RPM)
    if field.effect is Effect.GROUP:
        low = max(low, _GROUP_LEAST)
    return chance.choice((low, high, chance.randint(low, high), chance.randint(low, high)))
