"""Attempts on a line that damages replies: a motion of which something was damaged says little, and is made anew.

    tried = undamaged(probe, _try, row, rest=rest)          _try(probe, row, rest), and anew from where the shaft rests then

    @anew
    def spun(probe, ...)                                    what always is made so

While a reply is waited for that the line damaged, a shaft goes on, a move comes to its end, or a ramp is over.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from analyzer.catalogue import Verb
from conformance.claim import Inconclusive
from conformance.motion import motion

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: How often a motion is made at most.
_ATTEMPTS = 3

Seen = TypeVar("Seen")
Given = ParamSpec("Given")


def undamaged(probe: Probe, attempt: Callable[..., Seen], *given: Any, rest: motion.Sample | None = None) -> Seen:
    """Return what `attempt(probe, *given)` shows; one in which the line damaged something is made anew, at most twice.

    `rest`: where the shaft rests, which the attempt is given last. Raises what it raises at last.
    """
    for left in reversed(range(_ATTEMPTS)):
        since = len(probe.traffic)
        try:
            seen = attempt(probe, *given) if rest is None else attempt(probe, *given, rest)
        except Inconclusive:
            if not left or not damaged(probe, since):
                raise
        else:
            if not left or not damaged(probe, since):
                return seen
        stands = motion.stand_still(probe)
        rest = rest and stands
    raise AssertionError("the last attempt returns or raises")


def anew(attempt: Callable[Concatenate[Probe, Given], Seen]) -> Callable[Concatenate[Probe, Given], Seen]:
    """Return a function that makes an attempt as `undamaged` does."""

    @wraps(attempt)
    def made(probe: Probe, /, *given: Given.args, **named: Given.kwargs) -> Seen:
        return undamaged(probe, partial(attempt, **named), *given)

    return made


def damaged(probe: Probe, since: int) -> bool:
    """Say whether the line damaged or lost something from an exchange on, by its number in the claim's traffic.

    Where the claim itself has set what is answered, silence is no loss.
    """
    silenced = any(e.command is not None and e.command.verb is Verb.SET_RESPOND for e in probe.traffic)
    return any(exchange.damaged or (exchange.unanswered and not silenced) for exchange in probe.traffic[since:])
