"""Several spools as one sequence of records in order of time, as far as that order is certain.

A record is given when every spool has gone beyond its time. A later record or an IDLE shows that, or an empty spool
`PATIENCE_NS` later. So a silent port delays the others for that long at most. Records stored even later are given late, and
the recording counts them.

Memory is bounded: a spool that is ahead is not read on until the others have caught up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from analyzer.live.spool import NEVER_NS, Record, SpoolReader

#: The longest that a silent spool is waited for.
PATIENCE_NS = 200_000_000
#: Records of a spool that wait at most before it is not read on, and bytes read at a time.
WAITING_LIMIT = 20_000
READ_SIZE = 1 << 16


class Spool:
    """One spool that is followed. `position`: behind the last record that was processed; its owner sets it."""

    def __init__(self, folder: Path, stem: str, start: tuple[int, int] | None) -> None:
        self.stem = stem
        self.reader = SpoolReader(folder, stem, start)
        self.position = start or (-1, 0)
        self.waiting: deque[Record] = deque()
        #: Nothing that comes later is earlier than this.
        self.watermark_ns = 0
        #: Bytes that were no record, as far as told.
        self.damaged = 0

    def read(self, now_ns: int | None) -> None:
        """Take what is there; `now_ns`: a moment before this call, None when no process writes any more."""
        if len(self.waiting) >= WAITING_LIMIT:
            return
        before = len(self.waiting)
        self.waiting.extend(self.reader.read(READ_SIZE, final=now_ns is None))
        if len(self.waiting) > before:
            self.watermark_ns = max(self.watermark_ns, self.waiting[-1].t_ns)
        else:
            self.watermark_ns = max(self.watermark_ns, NEVER_NS if now_ns is None else now_ns - PATIENCE_NS)


class Merger:
    """Follows the spools of a folder. `starts`: where to go on in each, by stem."""

    def __init__(self, folder: Path, stems: Sequence[str], starts: Mapping[str, tuple[int, int]] | None = None) -> None:
        self.spools = [Spool(folder, stem, (starts or {}).get(stem)) for stem in stems]
        #: Everything before this time has been given.
        self.horizon_ns = 0

    def take(self, now_ns: int | None) -> Iterator[tuple[Spool, Record]]:
        """Yield what is certain by now, in order; `now_ns` as in `Spool.read`, None gives everything in the end."""
        for spool in self.spools:
            spool.read(now_ns)
        self.horizon_ns = max(self.horizon_ns, min(spool.watermark_ns for spool in self.spools))
        yield from self._certain(self.horizon_ns)

    @property
    def drained(self) -> bool:
        """All records were given, and no process writes any more."""
        return self.horizon_ns >= NEVER_NS and not any(spool.waiting for spool in self.spools)

    def behind_ns(self, now_ns: int) -> int:
        """Return by how much what was given lags behind the readers, beyond the wait for silent ports."""
        return max(0, now_ns - self.horizon_ns - PATIENCE_NS) if 0 < self.horizon_ns < NEVER_NS else 0

    def _certain(self, horizon_ns: int) -> Iterator[tuple[Spool, Record]]:
        while True:
            first: Spool | None = None
            first_ns = limit_ns = NEVER_NS + 1
            for spool in self.spools:
                if spool.waiting:
                    t_ns = spool.waiting[0].t_ns
                    if t_ns < first_ns:
                        first, first_ns, limit_ns = spool, t_ns, first_ns
                    elif t_ns < limit_ns:
                        limit_ns = t_ns
            if first is None or first_ns > horizon_ns:
                return
            limit_ns = min(limit_ns, horizon_ns)
            waiting = first.waiting
            while waiting and waiting[0].t_ns <= limit_ns:
                yield first, waiting.popleft()

    def close(self) -> None:
        for spool in self.spools:
            spool.reader.close()
