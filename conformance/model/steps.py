"""The steps of a walk (`model.walk`): requests as they are sent, motions by their amounts, and looks.

    Step("set_subdivision", {"subdivision": 8})
    Step("look", {"first": 3, "count": 4})          some of the reads
    Step("aside", {"aside": 2})                     a frame that changes nothing

A step is data, which can be repeated, shortened and stored.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from analyzer.catalogue import Dialect, Verb
from conformance.model.values import ROOMY
from conformance.motion import declared
from conformance.motion.declared import SUBDIVISION


@dataclass(frozen=True)
class Step:
    """One thing that is done. `values`: integers as sent, or the amounts of a motion."""

    name: str
    values: Mapping[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return it as `parse_steps` reads it."""
        return " ".join([self.name, *(f"{n}={v}" for n, v in self.values.items())])


def steps_text(steps: Iterable[Step]) -> str:
    """Return steps as text."""
    return "; ".join(map(str, steps))


def parse_steps(text: str) -> list[Step]:
    """Return the steps of a text that `steps_text` wrote. Raises ValueError for another."""
    steps = []
    for part in filter(None, (p.strip() for p in text.split(";"))):
        name, *pairs = part.split()
        steps.append(Step(name, {n: int(v) for n, _, v in (p.partition("=") for p in pairs)}))
    return steps


#: A motion by its amounts: it is left to itself, so that the next step comes meanwhile.
LEAVE = "leave"
#: How the request reaches the drive (`asides.Way`), and what is sent while its motion is under way (`asides.Aside`).
WAY, ASIDE = "way", "aside"
#: What makes a request one of which nothing comes (`asides.spoiled`).
SPOILED = "spoiled"
LOOK = "look"


def selectors(dialect: Dialect) -> list[int]:
    """Return the numbers of all parameters that can be read."""
    if Verb.READ_PARAMETER not in dialect.by_verb:
        return []
    write = dialect.by_verb.get(Verb.WRITE_PARAMETER)
    if write is not None:
        return sorted({f.layout.named["parameter"].fixed for f in write.request_forms if f.layout.named["parameter"].fixed})
    return [c.code for c in dialect.commands if c.readable]


def beginning(dialect: Dialect) -> list[Step]:
    """Return the steps that bring a drive into a known state."""
    verbs = dialect.by_verb
    wanted: list[tuple[Verb, dict[str, int]]] = []
    if Verb.SET_WORK_MODE in verbs:
        mode = declared.choice(verbs[Verb.SET_WORK_MODE], "work_mode", declared.bus_modes(dialect)[-1])
        wanted.append((Verb.SET_WORK_MODE, {"work_mode": mode}))
    wanted += [
        (Verb.ENABLE, {"enabled": 1}),
        (Verb.SET_SUBDIVISION, {"subdivision": SUBDIVISION}),
        (Verb.SET_DIRECTION, {"motor_direction": 0}),
        (Verb.SET_RESPOND, {"respond": 1, "active": 1}),
        (Verb.SET_ZERO, {}),
        (Verb.MOTOR_ON, {}),
    ]
    steps = [Step(verbs[verb].name, values) for verb, values in wanted if verb in verbs]
    forms = verbs[Verb.WRITE_PARAMETER].request_forms if Verb.WRITE_PARAMETER in verbs else ()
    for named in (form.layout.named for form in forms if "speed_limit" in form.layout.named):
        roomy = {"parameter": named["parameter"].fixed or 0, "speed_limit": ROOMY["speed_limit"][0]}
        steps.append(Step("write_parameter", roomy))
    if "set_position" in dialect.by_name:
        steps = [s for s in steps if s.name != "set_zero"] + [Step("set_position", {"position": 0})]
    return steps
