"""The one place where causes are weighed against each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from analyzer.diagnosis.scene import Confidence, Suspicion, Trouble

#: Causes that are told.
MOST = 3
_WEIGHT = {Confidence.CERTAIN: 1.0, Confidence.LIKELY: 0.7, Confidence.POSSIBLE: 0.4}
#: What follows from any cause stands behind them.
_SYMPTOMS = frozenset(("no_reply",))
#: Where two weigh alike, what spoils all bytes on their way comes first, then what spoils the edges of frames, and then what
#: is in them.
_SPOILS = {"inverted_lines": 2, "wrong_baud": 2, "lost_start": 1, "leading_glitch": 1, "trailing_glitch": 1}
#: A cause that explains less than this of what no likelier one does is not told.
_LEAST_NEW = 0.05


class Ranked(msgspec.Struct, frozen=True):
    """A cause and the share of the trouble that it explains."""

    suspicion: Suspicion
    share: float


def ranked(suspicions: Iterable[Suspicion], troubles: Sequence[Trouble]) -> list[Ranked]:
    """Return the causes that are told, the likeliest first.

    What a certain cause explains needs no other. What is likely or possible is told beside others that explain the same, for
    these are what else it can be; but a symptom is not told beside a likely cause of it. What explains nothing of the trouble
    comes last, however sure it is.
    """
    total = len(troubles)
    weighed = sorted(
        (Ranked(each, min(1.0, len(set(each.troubles)) / total) if total else 1.0) for each in suspicions),
        key=lambda r: (
            not r.share,
            r.suspicion.cause in _SYMPTOMS,
            r.suspicion.by_words,
            -_WEIGHT[r.suspicion.confidence] * r.share,
            -_WEIGHT[r.suspicion.confidence],
            -_SPOILS.get(r.suspicion.cause, 0),
        ),
    )
    told: list[Ranked] = []
    explained: set[Trouble] = set()
    likely: set[Trouble] = set()
    for each in weighed:
        own = set(each.suspicion.troubles)
        new = own - (likely if each.suspicion.cause in _SYMPTOMS or each.suspicion.by_words else explained)
        if any(t.suspicion.cause == each.suspicion.cause for t in told):
            continue
        if told and total and len(new) < max(1, _LEAST_NEW * total):
            continue
        told.append(each)
        if each.suspicion.confidence is Confidence.CERTAIN:
            explained |= own
        if each.suspicion.confidence is not Confidence.POSSIBLE:
            likely |= own
    return told[:MOST]
