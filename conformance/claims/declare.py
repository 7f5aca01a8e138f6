"""Declaring claims: a check becomes claims, one for each case of a dialect.

    @claim(Theme.MOTION, each=stops_of_motions, refuted_by="a shaft that moves again", risks=of_run)
    def stays_stopped(probe: Probe, run: Command, stop: Command) -> None:
        '''After {stop} the shaft stays where it stopped.'''

The docstring is the claim's statement, the function's name the last part of its id. A `Case` says what one claim is about: its
command, the other arguments of the check, and facts that differ from case to case. What `claim` is given may be a value or a
function of the case.

Rules kept here:
- The section and the coverage of a claim about one command are that command's.
- A claim about a command that only some models have runs where the model is known.
- A claim says what it rests on (`Doubt`) and is as sure as the least sure of the errata that leave that in doubt about its
  command or its fields.
- A claim that cannot be made for a dialect costs that claim alone: another stands for it, does not run, and says why.
- A command among the arguments of a check is the one of the drive's model.
"""

from __future__ import annotations

import inspect
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, MotionKind, Risk, Subject, Verb
from conformance.claim import Aspect, Claim, NotRun, Theme
from conformance.talk.probe import Probe

_ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.OPEN)
#: The checks of each module, in the order of their declaration.
_declared: dict[str, list[_Declaration]] = defaultdict(list)

Check = Callable[..., None]


@dataclass(frozen=True)
class Case:
    """What one claim of a check is about.

    `command`: the claim covers it, and the check gets it as `command`. `given`: other arguments of the check by name;
    they stand in its statement too (`{run}`, a command by its name). `facts`: what `claim` takes, for this case alone; `name`
    is the id behind the theme, `statement` what holds.
    """

    dialect: Dialect
    command: Command | None = None
    given: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def words(self) -> dict[str, Any]:
        """What the texts of a claim can name."""
        every = {"command": self.command, "dialect": self.dialect, **self.given}
        return {name: getattr(value, "name", value) for name, value in every.items()}

    def __getitem__(self, name: str) -> Any:
        return self.given[name]


Cases = Callable[[Dialect], Iterable[Case]]


def once(dialect: Dialect) -> Iterator[Case]:
    """Yield one case for a dialect, about no single command."""
    yield Case(dialect)


def commands(*verbs: Verb) -> Cases:
    """Return cases of the commands that a dialect has for these verbs."""
    return lambda dialect: (Case(dialect, dialect.by_verb[verb]) for verb in verbs if verb in dialect.by_verb)


def needing(verb: Verb, each: Cases) -> Cases:
    """Return those of some cases whose dialect has a command for a verb."""
    return lambda dialect: each(dialect) if verb in dialect.by_verb else ()


def described_in(subject: Subject) -> Callable[[Case], str]:
    """Return what tells the section in which a case's manual describes a subject."""
    return lambda case: case.dialect.sections.get(subject, case.dialect.commands[0].section)


def motions(*kinds: MotionKind, where: Callable[[Command], bool] = lambda command: True) -> Cases:
    """Return cases of the commands whose motion is of these kinds, in the manual's order; those for which `where` is true."""
    return lambda dialect: (Case(dialect, command) for command in dialect.motions(*kinds) if where(command))


def with_values(each: Cases, **given: object) -> Cases:
    """Return cases with more arguments of the check."""
    return lambda dialect: (Case(c.dialect, c.command, {**c.given, **given}, c.facts) for c in each(dialect))


@dataclass(frozen=True)
class _Declaration:
    theme: Theme
    each: Cases
    check: Check
    first: Callable[[Probe], None] | None
    facts: Mapping[str, Any]

    def claims(self, dialect: Dialect) -> Iterator[Claim]:
        return made(dialect, self.theme, self.own_name, self._each)

    def _each(self, dialect: Dialect) -> Iterator[Claim]:
        for number, case in enumerate(self.each(dialect)):
            yield from made(dialect, self.theme, f"{self.own_name}-{number}", partial(self._claims, case))

    @property
    def own_name(self) -> str:
        return self.check.__name__.strip("_").replace("_", "-")

    def _claims(self, case: Case, dialect: Dialect) -> Iterator[Claim]:
        yield self._claim(case)

    def _claim(self, case: Case) -> Claim:
        facts = dict(self.facts) | dict(case.facts)
        facts = {name: value(case) if callable(value) else value for name, value in facts.items()}
        words = case.words
        default = f"{words['command']}/{self.own_name}" if case.command is not None else self.own_name
        name = facts.pop("name", default).format_map(words)
        statement = facts.pop("statement", None) or _first_paragraph(self.check)
        facts.setdefault("parameters", {n: words[n] for n, v in case.given.items() if not isinstance(v, Command)})
        return declare(
            case.dialect,
            self.theme,
            name,
            statement.format_map(words),
            facts.pop("refuted_by").format_map(words),
            _Bound(self.check, case, self.first),
            command=case.command,
            **facts,
        )


class _Bound:
    """A check with the arguments of a case; its commands are those of the drive's model."""

    def __init__(self, check: Check, case: Case, first: Callable[[Probe], None] | None) -> None:
        self.check = check
        self.first = first
        given = dict(case.given) | ({} if case.command is None else {"command": case.command})
        self._arguments = {name: given[name] for name in list(inspect.signature(check).parameters)[1:]}

    def __call__(self, probe: Probe) -> None:
        if self.first is not None:
            self.first(probe)
        known = probe.dialect.by_name
        self.check(probe, **{n: known[v.name] if isinstance(v, Command) else v for n, v in self._arguments.items()})


def _first_paragraph(check: Check) -> str:
    text = inspect.getdoc(check)
    if not text:
        raise ValueError(f"{check.__module__}.{check.__name__}: the docstring of a check says what holds")
    return " ".join(text.split("\n\n")[0].split())


def claim(
    theme: Theme, *, refuted_by: Any, each: Cases = once, first: Callable[[Probe], None] | None = None, **facts: Any
) -> Callable[[Check], Check]:
    """Declare the decorated check as claims of a theme, one for each case.

    `first`: called before each check; it raises Inconclusive where the check could say nothing.
    `facts`: `name` of the id behind the theme, `at_best`, `rests_on`, `risks`, `settings`, `quirks`, `section`, `aspect`, and
    the other attributes of a `Claim`. Each is a value, or a function of the case.
    """

    def declared(check: Check) -> Check:
        _declared[check.__module__].append(_Declaration(theme, each, check, first, {"refuted_by": refuted_by, **facts}))
        return check

    return declared


def declared_in(module: str, dialect: Dialect) -> Iterator[Claim]:
    """Make the claims that the checks of a module declare for a dialect, in order."""
    for declaration in _declared[module]:
        yield from declaration.claims(dialect)


def made(dialect: Dialect, theme: Theme, what: str, make: Callable[[Dialect], Iterable[Claim]]) -> Iterator[Claim]:
    """Make claims for a dialect; where one cannot be made, a claim that does not run stands for it and says why.

    `what`: a name for these claims among those of the theme.
    """
    try:
        yield from make(dialect)
    except Exception as error:
        yield _unmade(dialect, theme, what, error)


def _unmade(dialect: Dialect, theme: Theme, what: str, error: Exception) -> Claim:
    reason = f"this claim cannot be made for {dialect.name}: {type(error).__name__}: {error}"

    def check(probe: Probe) -> None:
        raise NotRun(reason)

    return Claim(
        id=f"{dialect.name}/{theme.value}/unmade/{what}",
        theme=theme,
        dialect=dialect.name,
        statement=f"What {what} says holds for {dialect.name}.",
        section="all",
        refuted_by="nothing, since it does not run",
        check=check,
        certainty=Certainty.OPEN,
    )


def surety(
    dialect: Dialect,
    rests_on: Iterable[Doubt],
    names: Collection[str],
    *,
    errata: Collection[str] = (),
    at_best: Certainty = Certainty.CERTAIN,
) -> Certainty:
    """Return how sure a claim is that rests on these points about commands and fields of these names, and on these errata."""
    doubts = tuple(rests_on)
    found = (e for e in dialect.errata if e.id in errata or any(e.doubts(doubt, names) for doubt in doubts))
    return max([at_best, *(erratum.certainty for erratum in found)], key=_ORDER.index)


def declare(
    dialect: Dialect,
    theme: Theme,
    name: str,
    statement: str,
    refuted_by: str,
    check: Callable[[Probe], None],
    *,
    command: Command | None = None,
    section: str = "",
    rests_on: Iterable[Doubt] = (),
    about: Iterable[str] = (),
    errata: Collection[str] = (),
    at_best: Certainty = Certainty.CERTAIN,
    risks: Iterable[Risk] = (),
    aspect: Aspect | None = None,
    **rest: Any,
) -> Claim:
    """Return a claim with the id `<dialect>/<theme>/<name>`.

    `command`: its subject, which it covers in `aspect`, and whose section it has by default.
    `rests_on`: what must be as the manual is read, about the command, the claim's fields and what else `about` names.
    `errata`: ids of those that its printed frames name. `at_best`: how sure it is without any erratum. `risks`: what it sends
    beside reads.
    """
    if command is not None:
        rest.setdefault("models", command.models)
        rest.setdefault("commands", (command.name,))
        if aspect is not None:
            rest.setdefault("covers", ((command.name, aspect),))
        section = section or command.section
    names = {*about, *rest.get("fields", ()), *(() if command is None else (command.name,))}
    return Claim(
        id=f"{dialect.name}/{theme.value}/{name}",
        theme=theme,
        dialect=dialect.name,
        statement=statement,
        section=section,
        refuted_by=refuted_by,
        check=check,
        certainty=surety(dialect, rests_on, names, errata=errata, at_best=at_best),
        risks=frozenset(risks) - {Risk.READ},
        **rest,
    )
