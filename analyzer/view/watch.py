"""The state of a watched source: counts, rows and findings from all snapshots. It knows no terminal."""

from __future__ import annotations

from dataclasses import dataclass, field

from analyzer.live.snapshot import BusCounts, FindingLine, RowCounts, Snapshot
from analyzer.view.kept import Kept

#: Findings that are listed; all are counted.
FINDINGS = 20_000


@dataclass
class CommandRow:
    """One command of one address: its requests, replies and frames of unknown role."""

    bus: str
    who: str
    command: str
    roles: dict[str, RowCounts] = field(default_factory=dict)

    def count(self, role: str) -> int:
        row = self.roles.get(role)
        return row.count if row is not None else 0

    @property
    def rate(self) -> float:
        return sum(row.rate for row in self.roles.values())

    @property
    def total(self) -> int:
        return sum(row.count for row in self.roles.values())

    @property
    def latencies(self) -> tuple[int, int, int] | None:
        """Latency of the last reply, on average and at most, in ns; None without any."""
        row = self.roles.get("reply")
        if row is None or not row.latencies:
            return None
        return row.latency_last_ns, row.latency_sum_ns // row.latencies, row.latency_max_ns


def number_of(who: str) -> int:
    """Return the address that a text of `who` means, -1 where it is none."""
    try:
        return int(who, 0)
    except ValueError:
        return -1


class Watch:
    """Takes snapshots; what was lost between two of them is in the counts all the same."""

    def __init__(self, log: str = "") -> None:
        self.log = log
        self.log_bytes = 0
        self.behind_ns = 0
        self.first_ns = 0
        self.t_ns = 0
        self.ended = False
        self.buses: dict[str, BusCounts] = {}
        self.rows: dict[tuple[str, str, str, str], CommandRow] = {}
        self.rules: dict[str, int] = {}
        #: The lines of each cause of trouble.
        self.causes: dict[str, list[str]] = {}
        self.findings: Kept[FindingLine] = Kept(FINDINGS)
        #: Snapshots that found no room in the pipe.
        self.missed = 0
        self._number = 0

    @property
    def frames(self) -> int:
        return sum(bus.frames for bus in self.buses.values())

    @property
    def things(self) -> int:
        """Frames and pieces of junk so far."""
        return sum(bus.frames + bus.junk for bus in self.buses.values())

    @property
    def severities(self) -> tuple[int, int, int]:
        """Findings so far: errors, warnings, infos."""
        buses = self.buses.values()
        return sum(b.errors for b in buses), sum(b.warnings for b in buses), sum(b.infos for b in buses)

    @property
    def span_ns(self) -> int:
        """How long it has been watched, on the clock of the log."""
        return max(0, self.t_ns - self.first_ns) if self.first_ns else 0

    def take(self, snapshot: Snapshot) -> None:
        """Take a snapshot, without its frames."""
        if snapshot.number > self._number + 1:
            self.missed += snapshot.number - self._number - 1
        self._number = snapshot.number
        self.t_ns = snapshot.t_ns
        self.log = snapshot.log or self.log
        self.log_bytes = snapshot.log_bytes
        self.behind_ns = snapshot.behind_ns
        self.first_ns = self.first_ns or snapshot.first_ns
        self.ended = self.ended or snapshot.ended
        for bus in snapshot.buses:
            self.buses[bus.bus] = bus
        for row in snapshot.rows:
            key = (row.bus, row.who, row.dialect, row.command)
            known = self.rows.get(key)
            if known is None:
                known = self.rows[key] = CommandRow(row.bus, row.who, row.command)
            known.roles[row.role] = row
        if snapshot.rules:
            self.rules = snapshot.rules
            self.causes = snapshot.causes
        for found in snapshot.findings:
            self.findings.append(found)

    def findings_of(self, sequence: int) -> list[FindingLine]:
        """Return the findings that are listed of a frame."""
        kept = self.findings
        return [f for n in range(kept.first, kept.stop) if (f := kept.item(n)).sequence == sequence and sequence]
