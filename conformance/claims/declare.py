"""Declaring claims: what every theme of claims does alike.

    declare(dialect, Theme.SHAPE, "read_speed/code", "The reply to ...", "another code", check, command=command)

Rules kept here:
- The section and the coverage of a claim about one command are that command's.
- A claim about a command that only some models have runs where the model is known.
- How sure a claim is comes from the errata that it names: it is as sure as the least sure of them; those of another
  dialect are passed over, so that a theme names what it rests on once for all dialects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Certainty, Command, Dialect, Risk
from conformance.claim import Aspect, Claim, NotRun, Theme

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

_ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.OPEN)


def surety(dialect: Dialect, *errata: str, at_best: Certainty = Certainty.CERTAIN) -> Certainty:
    """Return how sure a claim is that rests on these errata (by id)."""
    known = {erratum.id: erratum.certainty for erratum in dialect.errata}
    return max([at_best, *(known[name] for name in errata if name in known)], key=_ORDER.index)


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
    errata: Iterable[str] = (),
    at_best: Certainty = Certainty.CERTAIN,
    risks: Iterable[Risk] = (),
    aspect: Aspect | None = None,
    **rest: Any,
) -> Claim:
    """Return a claim with the id `<dialect>/<theme>/<name>`.

    `command`: the one that it is about, whose section it has where none is given, and which it covers in `aspect`.
    `errata`: ids of those that it rests on; `at_best`: how sure it is without them. `risks`: what it sends beside reads.
    """
    if command is not None:
        check = _of_models(command, check)
        rest.setdefault("models", command.models)
        rest.setdefault("commands", (command.name,))
        if aspect is not None:
            rest.setdefault("covers", ((command.name, aspect),))
        section = section or command.section
    return Claim(
        id=f"{dialect.name}/{theme.value}/{name}",
        theme=theme,
        dialect=dialect.name,
        statement=statement,
        section=section,
        refuted_by=refuted_by,
        check=check,
        certainty=surety(dialect, *errata, at_best=at_best),
        risks=frozenset(risks) - {Risk.READ},
        **rest,
    )


def _of_models(command: Command, check: Callable[[Probe], None]) -> Callable[[Probe], None]:
    if not command.models:
        return check

    def known(probe: Probe) -> None:
        if not probe.dialect.model:
            raise NotRun(f"only {' and '.join(command.models)} have {command.name}, and the model of the drive was not given")
        check(probe)

    return known
