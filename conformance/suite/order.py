"""The order in which claims run on a real line: what teaches most in a second comes first.

`benchmarks/order.py` measured a table for each dialect (`telling/DIALECT.json`). It lists the claims that refute the most
known faults per second and look at something new. It also has the time of each kind of claim. Claims without an entry (new
ones, those of another package) come last, by an estimate.

Rules kept here:
- The order depends on the claims alone, so every run has the same one.
- A kind is a claim's id without the names of commands. Of the claims that are not named one by one, first one of each kind
  runs, then a second, the quick ones first.
- What proves that settings need no distance runs before the first claim that changes one.
- Claims that make the drive ready to move stand together, unless that delays another claim by more than some seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import msgspec

from analyzer import dialects
from analyzer.catalogue import Risk
from conformance.claim import Claim

#: How long a short run may take, and of that to put back what its last claims left, in seconds.
SHORT_SECONDS, ENDING_SECONDS = 90.0, 1.5
#: The share of a short run that one claim may take.
LONGEST = 0.25
#: How much of a run says how much slower its port is than what was measured.
_TELLING_SECONDS = 5.0
#: By how much a claim may come later so that it stands with others that need the drive ready to move, in seconds.
_TOGETHER_SECONDS = 10.0


class Cost(NamedTuple):
    """What something costs on a line: seconds that pass at any rate, and bits."""

    waits: float
    bits: float

    def seconds(self, rate: int) -> float:
        """Return how long it takes at so many bits per second."""
        return self.waits + self.bits / rate


#: What is said of a claim of which nothing is known.
_UNKNOWN = Cost(1.0, 1000)


class Table(msgspec.Struct, frozen=True):
    """What was measured in a dialect. `start`: until the first claim; `alone`: more of it, with --alone.

    `first`: claims that teach most in a second, in order, by id without the dialect; `behind`: those of them that judge what
    others recorded, with these others. `kinds`: all others.
    """

    start: Cost = Cost(1.0, 0)
    alone: Cost = Cost(0, 0)
    first: dict[str, Cost] = {}
    behind: dict[str, tuple[str, ...]] = {}
    kinds: dict[str, Cost] = {}


@cache
def table(dialect: str) -> Table:
    """Return what was measured in a dialect; an empty table where nothing was."""
    file = files("conformance.suite") / "telling" / f"{dialect}.json"
    return msgspec.json.decode(file.read_bytes(), type=Table) if file.is_file() else Table()


def kind(claim: Claim) -> str:
    """Return a claim's id without its dialect and the names of commands."""
    return "/".join(_without_names(claim.dialect, part) for part in claim.id.split("/")[1:])


@cache
def _without_names(dialect: str, part: str) -> str:
    for name in _names(dialect):
        part = part.replace(name, "*")
    return part


@cache
def _names(dialect: str) -> Sequence[str]:
    known = [c.name for d in dialects.every() if d.name == dialect for c in d.commands]
    return sorted(known, key=lambda name: (-len(name), name))


def cost(claim: Claim) -> Cost:
    """Return what a claim costs, with what comes behind it (stopping, putting back); an estimate where it was not measured."""
    known = table(claim.dialect)
    return known.first.get(claim.id.split("/", 1)[1]) or known.kinds.get(kind(claim)) or _UNKNOWN


def seconds(claim: Claim, rate: int) -> float:
    """Return how long a claim takes on a line."""
    return cost(claim).seconds(rate)


def start_seconds(dialect: str, rate: int, *, alone: bool) -> float:
    """Return how long a run takes until its first claim."""
    known = table(dialect)
    return known.start.seconds(rate) + known.alone.seconds(rate) * alone


def ordered(claims: Iterable[Claim], rate: int) -> list[Claim]:
    """Return claims in the order in which they run on a real line."""
    every = list(claims)
    told = [c for c in every if c.id.split("/", 1)[1] in table(c.dialect).first]
    place = {f"{dialect}/{name}": n for dialect in {c.dialect for c in every} for n, name in enumerate(table(dialect).first)}
    told.sort(key=lambda c: place[c.id])
    return _together(_distance_first([*told, *_by_rounds([c for c in every if c.id not in place], rate)]), rate)


def _by_rounds(claims: Sequence[Claim], rate: int) -> list[Claim]:
    """Return one claim of each kind, then a second: a slow one waits for more rounds of quick ones than of its own."""
    met: dict[str, int] = {}
    keys: dict[str, tuple[float, str]] = {}
    for claim in claims:
        own = kind(claim)
        met[own] = met.get(own, 0) + 1
        keys[claim.id] = (met[own] ** 2 * seconds(claim, rate), claim.id)
    return sorted(claims, key=lambda c: keys[c.id])


def _distance_first(claims: list[Claim]) -> list[Claim]:
    at = next((number for number, claim in enumerate(claims) if Risk.SETTING in claim.risks), len(claims))
    early, late = claims[:at], claims[at:]
    return [*early, *(c for c in late if c.hasty), *(c for c in late if not c.hasty)]


def _together(claims: Sequence[Claim], rate: int) -> list[Claim]:
    """Return claims with those of the same settings side by side, within some seconds."""
    found: list[Claim] = []
    some: list[Claim] = []
    passed = 0.0
    for number, claim in enumerate(claims):
        some.append(claim)
        passed += seconds(claim, rate)
        if passed >= _TOGETHER_SECONDS or claim.hasty or number == len(claims) - 1:
            found += sorted(some, key=lambda c: (c.hasty, c.settings))
            some, passed = [], 0.0
    return found


class Recorded:
    """What the claims of a run have recorded, by name: what others recorded is judged without being done again."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def seconds(self, claim: Claim, rate: int) -> float:
        """Return how long a claim takes now, with what others were to record for it and have not."""
        name = claim.id.split("/", 1)[1]
        own = seconds(claim, rate) if name not in self._names else 0.0
        return own + sum(table(claim.dialect).first[other].seconds(rate) for other in self._missing(claim))

    def add(self, claim: Claim) -> None:
        """Take note that a claim runs, and records what it needs."""
        self._names |= {claim.id.split("/", 1)[1], *self._missing(claim)}

    def _missing(self, claim: Claim) -> set[str]:
        return {*table(claim.dialect).behind.get(claim.id.split("/", 1)[1], ())} - self._names


def fitting(claims: Iterable[Claim], rate: int, within: float, passed: Callable[[], float] | None = None) -> Iterator[Claim]:
    """Yield the claims that fit into so many seconds, the first ones first. One that would take much of them is left out.

    Once one does not fit, later ones that were measured fill what is left: an estimate is too rough for that.
    `passed`: the seconds that a run has taken, which decide what still fits; None: those that were planned. Where a port or a
    drive is slower than what was measured, what follows counts as so much slower; where it is faster, more claims follow.
    """
    longest, full, planned = within * LONGEST, False, 0.0
    recorded = Recorded()
    for claim in claims:
        own = recorded.seconds(claim, rate)
        if own > longest:
            continue
        gone = planned if passed is None else passed()
        slower = max(1.0, gone / planned) if planned > _TELLING_SECONDS else 1.0
        fits = gone + own * slower <= within
        full = full or not fits
        if fits and (not full or claim.id.split("/", 1)[1] in table(claim.dialect).first):
            planned += own
            recorded.add(claim)
            yield claim
