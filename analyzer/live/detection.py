"""Which dialects a bus is in, found out from its traffic while it comes.

At first everything is held back until the sample leaves no doubt, for half a second or 16 KiB at most; where it says nothing
by then, all dialects of the kind of bus are tried at once. Afterwards the newest traffic is looked at again while
nothing frames, or when junk shows that another dialect has joined; ever more seldom where that helps nothing.

Each decision goes into the log as an event before its traffic, so that decoding the log again needs no new decision.
No clock: times are those of the traffic.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from analyzer.catalogue import Dialect
from analyzer.detect import Choice, choose
from analyzer.records import CanFrame, Chunk

#: The longest that traffic is held back, and the most of it.
HOLD_NS = 500_000_000
HOLD_BYTES = 16 << 10
#: A sample is looked at when it has this many bytes, then at each doubling.
FIRST_LOOK = 24
#: A dialect that explains this share of the bytes, in so many frames, is the one; while a rival explains less than this.
SURE_SHARE = 0.9
SURE_FRAMES = 4
RIVAL_SHARE = 0.2
#: Later looks: what of the traffic is kept for them, how often, and what share of junk gives cause.
RECENT_BYTES = 16 << 10
FIRST_PAUSE_NS = 2_000_000_000
LAST_PAUSE_NS = 60_000_000_000
JUNK_SHARE = 0.02
JUNK_LEAST = 32
#: What a dialect must explain to be believed after all were tried.
BELIEVED_SHARE = 0.5


class Detection:
    """The dialects of one bus.

    `kind`: `serial` or `can`. `candidates`: all dialects there are. `given`: those of other devices, which are on the bus.
    """

    def __init__(self, kind: str, candidates: Sequence[Dialect], given: Sequence[Dialect] = ()) -> None:
        self._candidates = [d for d in candidates if d.bus == kind and d not in given]
        self._given = [d for d in given if d.bus == kind]
        #: Those of drives: if nothing tells, all of them are tried.
        self._drives = [d for d in self._candidates if d.of_drives]
        #: What it is; empty until it was decided.
        self.dialects: tuple[Dialect, ...] = ()
        #: All are being tried, for none was believed.
        self.guessing = False
        self._sample: deque[Chunk | CanFrame] = deque()
        self._size = 0
        self._look_at = FIRST_LOOK
        self._first_ns = 0
        self._pause_ns = FIRST_PAUSE_NS
        self._looked_ns = 0
        self._bytes = self._junk = 0
        self._bytes_seen = self._junk_seen = 0

    def add(self, item: Chunk | CanFrame) -> None:
        size = len(item.data)
        if not self._sample and not self.dialects:
            self._first_ns = item.t_ns or 0
        self._sample.append(item)
        self._size += size
        self._bytes += size
        if self.dialects:
            while self._size > RECENT_BYTES and len(self._sample) > 1:
                self._size -= len(self._sample.popleft().data)

    def junk(self, size: int) -> None:
        self._junk += size

    def first(self, t_ns: int, *, final: bool = False) -> Choice | None:
        """Return what the bus is if that is certain, or if no more can be waited at `t_ns`; `final`: nothing more comes."""
        waited = final or t_ns - self._first_ns >= HOLD_NS or self._size >= HOLD_BYTES
        if not waited and self._size < self._look_at and len(self._drives) > 1:
            return None
        self._look_at = max(2 * self._look_at, self._size + 1)
        choice = choose(self._candidates, list(self._sample), self._given)
        if not waited and len(self._drives) > 1 and not _is_sure(choice):
            return None
        self._decide(choice, t_ns)
        # What was held back comes once more, now to be decoded.
        self._sample.clear()
        self._size = self._bytes = 0
        return choice

    def recheck(self, t_ns: int) -> Choice | None:
        """Return what the bus is if that has changed; called about once a second."""
        if t_ns - self._looked_ns < self._pause_ns or len(self._drives) < 2:
            return None
        traffic, junk = self._bytes - self._bytes_seen, self._junk - self._junk_seen
        if traffic < JUNK_LEAST:
            return None
        self._looked_ns = t_ns
        self._bytes_seen, self._junk_seen = self._bytes, self._junk
        if not self.guessing and (junk < JUNK_LEAST or junk < JUNK_SHARE * traffic):
            self._pause_ns = FIRST_PAUSE_NS
            return None
        self._pause_ns = min(2 * self._pause_ns, LAST_PAUSE_NS)
        choice = choose(self._candidates, list(self._sample), self._given)
        if self.guessing:
            if not choice.evidence or choice.evidence[0].share < BELIEVED_SHARE:
                return None
        else:
            # What was seen once can come again: dialects join, none leaves.
            joined = [d for d in choice.dialects if d not in self.dialects and _explains(choice, d)]
            if not joined:
                return None
            choice = Choice((*self.dialects, *joined), choice.evidence, choice.reason)
        self._decide(choice, t_ns)
        self._pause_ns = FIRST_PAUSE_NS
        return choice

    def _decide(self, choice: Choice, t_ns: int) -> None:
        self.dialects = choice.dialects
        believed = not choice.evidence or choice.evidence[0].share >= BELIEVED_SHARE
        self.guessing = not believed and len(choice.dialects) - len(self._given) == len(self._drives) > 1
        self._looked_ns = t_ns

    def resume(self, dialects: Sequence[Dialect], guessing: bool) -> None:
        """Go on with what another process had decided."""
        self.dialects, self.guessing = tuple(dialects), guessing


def _explains(choice: Choice, dialect: Dialect) -> bool:
    return any(e.dialect is dialect and e.frames >= SURE_FRAMES for e in choice.evidence)


def _is_sure(choice: Choice) -> bool:
    best = choice.evidence[0] if choice.evidence else None
    rival = choice.evidence[1].share if len(choice.evidence) > 1 else 0.0
    return best is not None and best.share >= SURE_SHARE and best.frames >= SURE_FRAMES and rival < RIVAL_SHARE
