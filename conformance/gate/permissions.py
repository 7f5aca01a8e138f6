"""Permissions: the risks, bounds, addresses and budget that a user allows, and the options that say so.

    --allow setting,motion --max-speed 300 --max-turns 2 --max-acceleration 200 --max-current 1500 --budget commands=500

Reads are always allowed; everything else has to be allowed by name, each risk of a frame. `motion` includes neither `torque`
nor `unbounded`: a run needs both `motion` and `unbounded`.

Neighbours: where addresses are named, all others need `alone`, and so do a broadcast, a package and a change of the link
anywhere. An interpretation that only reads and whose checks do not fit has no address: no drive would answer it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, field

from analyzer import dialects as registry
from analyzer.catalogue import Risk
from analyzer.cli.option_types import number
from analyzer.errors import UsageError
from analyzer.live.profile import BOUNDS, NamedDrive
from analyzer.values import near, quote
from conformance.gate.bounds import Bounds, Knowledge
from conformance.gate.budget import Budget, parse_budget
from conformance.gate.interpretations import Interpretation

#: The order in which risks are listed.
WORDS = tuple(risk.value for risk in Risk if risk is not Risk.READ)
READS = frozenset({Risk.READ})


@dataclass(frozen=True)
class Objection:
    """Why an interpretation may not leave. `hint`: what would allow it."""

    interpretation: Interpretation
    reasons: tuple[str, ...]
    hint: str = ""

    def __str__(self) -> str:
        return f"{self.interpretation}: {'; '.join(self.reasons)}" + (f" ({self.hint})" if self.hint else "")


#: Bounds are below this.
_LARGEST = 1e12
_SUBDIVISIONS = range(1, 257)
_ABOVE_ZERO = number("a number above 0", float, lambda value: 0 < value < _LARGEST)
_SUBDIVISION = number("a subdivision 1..256", int, lambda value: value in _SUBDIVISIONS)


@dataclass(frozen=True)
class Allowance:
    """What may be sent.

    `risks`: reads are always among them. `addresses`: the drives that are meant, None: all. `alone`: no other drive is
    on the bus; `spoken`: the dialects in which one is looked for, None: all of the bus. `subdivision`: what the drives
    are set to, where the user says so. `budget` None: no limits but the default
    wear. A bound that is no number above 0, and a subdivision that cannot be, raise UsageError: they would bound nothing.
    """

    risks: frozenset[Risk] = READS
    speed: float | None = None
    turns: float | None = None
    acceleration: float | None = None
    current: float | None = None
    addresses: frozenset[int] | None = None
    alone: bool = False
    budget: Budget = field(default_factory=Budget)
    subdivision: int | None = None
    spoken: frozenset[str] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "risks", frozenset(self.risks) | READS)
        for name in BOUNDS:
            value = getattr(self, name.removeprefix("max_"))
            if value is not None and not (isinstance(value, (int, float)) and 0 < value < _LARGEST):
                raise UsageError(f"{name}: expected a number above 0, got {value!r}")
        if self.subdivision is not None and self.subdivision not in _SUBDIVISIONS:
            raise UsageError(f"subdivision: expected 1..256, got {self.subdivision!r}")

    @property
    def bounds(self) -> Bounds:
        """The bounds of one command."""
        return Bounds(self.speed, self.turns, self.acceleration, self.current)

    def described(self) -> dict[str, str]:
        """Return the bounds as the options have them, for reports."""
        numbers = {"max-speed": self.speed, "max-turns": self.turns, "max-acceleration": self.acceleration}
        numbers |= {"max-current": self.current, "subdivision": self.subdivision}
        shown = {name: f"{value:g}" for name, value in numbers.items() if value is not None}
        budget = ",".join(f"{n}={v}" for n, v in self.budget.described().items())
        spoken = {} if self.spoken is None else {"spoken": ",".join(sorted(self.spoken))}
        return shown | ({"budget": budget} if budget else {}) | ({"alone": "yes"} if self.alone else {}) | spoken

    def objection(self, asked: Interpretation, known: Knowledge) -> Objection | None:
        """Return why an interpretation may not leave, None where it may; the budget aside."""
        if asked.reads_only and (self.addresses is None or self.alone) and not asked.to_many:
            return None
        lacking = asked.risks - self.risks
        missing = [risk.value for risk in Risk if risk in lacking] if lacking else []
        reasons = [f"needs {', '.join(missing)}"] * bool(missing)
        hint = [f"--allow {','.join(missing)}"] * bool(missing)
        neighbour = "" if self.alone else self._neighbour(asked)
        if neighbour:
            reasons.append(neighbour)
            hint.append("--alone if no other drive is on the bus")
        reasons += known.problems(asked, self.bounds)
        return Objection(asked, tuple(reasons), " ".join(hint)) if reasons else None

    def _neighbour(self, asked: Interpretation) -> str:
        if asked.reads_only and not asked.fits:
            return ""
        if asked.slot or (asked.to_many and asked.address is None):
            return "a package, which several drives obey"
        if asked.to_many:
            return "meant for all drives"
        if Risk.LINK in asked.risks:
            return "it changes the link, and may put a drive where another one is"
        if self.addresses is not None and asked.address is not None and asked.address not in self.addresses:
            return f"meant for {asked.address}, and the drive is {_listed(self.addresses)}"
        return ""


def _listed(addresses: Iterable[int]) -> str:
    return " or ".join(str(a) for a in sorted(addresses)) or "none"


# --- options ------------------------------------------------------------------------------------------------------


def parse_allow(text: str) -> frozenset[Risk]:
    """Return the risks of `setting,motion`; reads are always among them.

    Raises UsageError for a word that is none, with all that there are.
    """
    found = {Risk.READ}
    for word in (w.strip().lower().replace("_", "-") for w in text.split(",")):
        if word and word not in (*WORDS, Risk.READ.value):
            raise UsageError(f"--allow: got {quote(word)}{near(word, WORDS)}, expected some of {', '.join(WORDS)}")
        if word:
            found.add(Risk(word))
    return frozenset(found)


def parse_spoken(text: str | None) -> frozenset[str] | None:
    """Return the dialects of `mks-can,lk-rs485`. Raises UsageError for a name that is none."""
    return None if text is None else frozenset(registry.get(name.strip()).name for name in text.split(","))


def add_gate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options by which a user says what may be sent."""
    group = parser.add_argument_group("permissions (without them, only reads are sent)")
    group.add_argument("--allow", action="append", default=[], metavar="RISKS", help=f"some of {','.join(WORDS)}")
    group.add_argument("--max-speed", type=_ABOVE_ZERO, metavar="RPM", help="highest speed of the shaft, by its subdivision")
    group.add_argument("--max-turns", type=_ABOVE_ZERO, metavar="N", help="longest move; runs without an end are `unbounded`")
    group.add_argument("--max-acceleration", type=_ABOVE_ZERO, metavar="N", help="as sent, 1..255; 0, at once, is above all")
    group.add_argument("--max-current", type=_ABOVE_ZERO, metavar="MA", help="highest current that is set or held")
    group.add_argument("--alone", action="store_true", help="no other drive is on the bus: broadcasts, packages, link changes")
    group.add_argument("--spoken", metavar="DIALECTS", help="what drives on this bus speak: --alone looks for these")
    group.add_argument(
        "--budget", action="append", default=[], metavar="WORD=N,...", help="of the whole run: commands, seconds, turns, wear"
    )
    group.add_argument("--subdivision", type=_SUBDIVISION, metavar="N", help="what MKS drives are set to (else taken as 1)")


def allowance_from(arguments: argparse.Namespace, *, addresses: Iterable[int] | None = None) -> Allowance:
    """Return what the options of `add_gate_arguments` allow. `addresses`: the drives that are meant.

    Raises UsageError for words that are none.
    """
    return Allowance(
        parse_allow(",".join(arguments.allow or ())),
        arguments.max_speed,
        arguments.max_turns,
        arguments.max_acceleration,
        arguments.max_current,
        None if addresses is None else frozenset(addresses),
        bool(arguments.alone),
        parse_budget(list(arguments.budget or ())),
        getattr(arguments, "subdivision", None),
        parse_spoken(getattr(arguments, "spoken", None)),
    )


def narrow(arguments: argparse.Namespace, drives: Iterable[NamedDrive]) -> None:
    """Take from the profile of drives what the options of `add_gate_arguments` leave open; of several bounds the narrowest."""
    entries = [drive.entry for drive in drives]
    for bound in BOUNDS:
        values = [value for entry in entries if (value := getattr(entry, bound)) is not None]
        if values and getattr(arguments, bound) is None:
            setattr(arguments, bound, min(values))
    subdivisions = {entry.subdivision for entry in entries}
    if len(subdivisions) == 1 and getattr(arguments, "subdivision", None) is None:
        arguments.subdivision = subdivisions.pop()
