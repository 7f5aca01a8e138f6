"""At which rate a serial line runs, and what is spoken on it, found out by listening alone.

    for each rate that a manual lists:  listen -> bytes -> frames of the dialects that list it -> share of good bytes

At a wrong rate a UART makes other bytes of the same line, and next to none of them fit a check. So the rate at which most
bytes end in good frames is the one, if no other comes near.

Rules: the most usual rate comes first; a rate without doubt ends the search. A quiet line is listened to for the whole time
at every rate, and then said to be quiet. Nothing is opened here: see `autobaud_ports`.

What it cannot know: parity and stop bits, which are those of the endpoint, and rates that no manual lists.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from analyzer.catalogue import Dialect
from analyzer.detect import Evidence, choose, weigh
from analyzer.errors import UsageError
from analyzer.live.endpoint import Endpoint
from analyzer.records import Chunk
from analyzer.values import counted, quote

#: Below this share, or with fewer frames, a rate is not believed.
LEAST_SHARE = 0.5
LEAST_FRAMES = 3
#: Another rate must explain less than this part of what the best one does.
RIVAL = 0.3
#: A rate that explains so much in so many frames ends the search.
SURE_SHARE = 0.9
SURE_FRAMES = 8
#: So many bytes are enough to judge a rate.
ENOUGH_BYTES = 4096
#: A rate at which fewer bytes than this were heard is listened to once more before it is judged.
TOO_FEW_BYTES = 32
_FIRST_LOOK = 48


@dataclass(frozen=True)
class ListenResult:
    """What listening at one rate gave. `best`: of the dialect that explains most; None where nothing was heard."""

    rate: int
    bytes: int
    best: Evidence | None

    @property
    def share(self) -> float:
        """Share of the bytes in good frames."""
        return self.best.share if self.best is not None else 0.0

    @property
    def frames(self) -> int:
        return self.best.frames if self.best is not None else 0

    @property
    def believed(self) -> bool:
        """Whether the line may run at this rate."""
        return self.share >= LEAST_SHARE and self.frames >= LEAST_FRAMES

    @property
    def sure(self) -> bool:
        """Whether there is no need to listen at another rate."""
        return self.share >= SURE_SHARE and self.frames >= SURE_FRAMES


@dataclass(frozen=True)
class Found:
    """What was found. `dialects`: on the line; `reason`: why those; `evidence`: of every rate that was tried."""

    endpoint: Endpoint
    dialects: tuple[Dialect, ...]
    reason: str
    evidence: tuple[ListenResult, ...]


class Listener(Protocol):
    """Listens to a port."""

    def listen(self, rate: int, seconds: float, enough: Callable[[Sequence[Chunk]], bool]) -> Sequence[Chunk]:
        """Return what came at a rate within a time, or until it is enough."""

    def close(self) -> None:
        """Give the port back."""


def rates(candidates: Sequence[Dialect]) -> list[int]:
    """Return the rates that dialects list, most usual first: defaults, then those that most of them have."""
    listed = list(dict.fromkeys(rate for d in candidates for rate in d.baud_rates))

    def rank(rate: int) -> tuple[int, int]:
        defaults = sum(d.baud_rates[0] == rate for d in candidates)
        return -defaults, -sum(rate in d.baud_rates for d in candidates)

    return sorted(listed, key=rank)


def judge(rate: int, chunks: Sequence[Chunk], candidates: Sequence[Dialect]) -> ListenResult:
    """Return what the dialects that list a rate make of what was heard at it."""
    size = sum(len(chunk.data) for chunk in chunks)
    weighed = [weigh(d, chunks) for d in candidates if rate in d.baud_rates] if size else []
    return ListenResult(rate, size, max(weighed, key=lambda e: e.good_bytes, default=None))


def score(chunks_by_rate: Mapping[int, Sequence[Chunk]], candidates: Sequence[Dialect]) -> list[ListenResult]:
    """Return what was heard at each rate, the best explained first."""
    heard = [judge(rate, chunks, candidates) for rate, chunks in chunks_by_rate.items()]
    # A stable sort: of rates that explain the same, the more usual one stands first.
    return sorted(heard, key=lambda h: (-h.believed, -h.share))


def decide(heard: Sequence[ListenResult]) -> ListenResult:
    """Return the rate of the line. `heard`: as `score` orders it.

    Raises UsageError that says what was heard, where no rate is clear.
    """
    if not any(h.bytes for h in heard):
        raise UsageError(
            "baud=auto: no traffic at any rate. Detection only listens: let the host talk to the drive meanwhile. Check A and "
            "B, ground, and that the adapter is on the right pair; servotap scan sends requests itself"
        )
    best = heard[0]
    if not best.believed:
        raise UsageError(
            "baud=auto: bytes arrive, but at no rate do they form frames of a known dialect. Check parity and stop bits "
            "(parity=even, stop=2), that A and B are not swapped, and the rate in the drive's menu"
        )
    rivals = [h for h in heard[1:] if h.believed and h.share > RIVAL * best.share]
    if rivals:
        also = ", ".join(f"{h.rate} ({_percent(h.share)})" for h in rivals)
        raise UsageError(
            f"baud=auto: not clear: {best.rate} baud explains {_percent(best.share)} of the bytes, and so do {also}. The line "
            "seems to change its rate; give one with baud=N"
        )
    return best


def table(heard: Sequence[ListenResult]) -> list[str]:
    """Return the evidence as lines of text, in the order of the rates."""
    lines = [f"{'baud':>8} {'bytes':>7} {'good frames':>12} {'share':>7}  dialect"]
    for each in sorted(heard, key=lambda h: h.rate):
        name = each.best.dialect.name if each.best is not None and each.frames else "-"
        share = _percent(each.share) if each.bytes else "-"
        lines.append(f"{each.rate:>8} {each.bytes:>7} {each.frames:>12} {share:>7}  {name}")
    return lines


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def search(
    endpoint: Endpoint,
    listener: Listener,
    candidates: Sequence[Dialect],
    *,
    seconds: float = 3.0,
    say: Callable[[str], None] = lambda text: None,
) -> Found:
    """Listen at one rate after the other and return what is clear then; the evidence is said as a table.

    `seconds`: the longest at each rate. Raises UsageError where nothing is clear.
    """
    chunks: dict[int, list[Chunk]] = {}
    order = rates(candidates)
    for turn in range(2):
        for rate in order:
            if turn and sum(len(c.data) for c in chunks[rate]) >= TOO_FEW_BYTES:
                continue
            got = chunks.setdefault(rate, [])
            # Two turns at a rate are two stretches of time; the framer is told of no pause, so each is judged with the other.
            got += listener.listen(rate, seconds, _Enough(rate, got, candidates))
            heard = judge(rate, got, candidates)
            say(_said(heard))
            if heard.sure:
                return _found(endpoint, chunks, candidates, say)
        found = score(chunks, candidates)
        if found[0].believed or not any(h.bytes for h in found):
            break
    return _found(endpoint, chunks, candidates, say)


class _Enough:
    """Says when what was heard leaves no doubt; looks at it at each doubling of its size, for looking costs time."""

    def __init__(self, rate: int, before: Sequence[Chunk], candidates: Sequence[Dialect]) -> None:
        self._rate = rate
        self._before = list(before)
        self._candidates = candidates
        self._look_at = _FIRST_LOOK

    def __call__(self, chunks: Sequence[Chunk]) -> bool:
        size = sum(len(chunk.data) for chunk in chunks)
        if size < self._look_at:
            return False
        self._look_at = 2 * size
        return size >= ENOUGH_BYTES or judge(self._rate, [*self._before, *chunks], self._candidates).sure


def _said(heard: ListenResult) -> str:
    if not heard.bytes:
        return f"{heard.rate} baud: nothing heard"
    best = heard.best
    what = f", {best.frames} good frames of {best.dialect.name}" if best is not None and best.frames else ", no good frame"
    return f"{heard.rate} baud: {counted(heard.bytes, 'byte')}{what} ({_percent(heard.share)} of the bytes)"


def _found(
    endpoint: Endpoint, chunks: Mapping[int, Sequence[Chunk]], candidates: Sequence[Dialect], say: Callable[[str], None]
) -> Found:
    heard = score(chunks, candidates)
    for line in table(heard):
        say(line)
    best = decide(heard)
    choice = choose([d for d in candidates if best.rate in d.baud_rates], chunks[best.rate])
    say(f"{quote(endpoint.name)}: {best.rate} baud, {', '.join(d.name for d in choice.dialects)} ({choice.reason})")
    return Found(endpoint.at(best.rate), choice.dialects, choice.reason, tuple(heard))
