"""A sink that makes snapshots of decoding for a viewer, without slowing it down.

    plain(), entry(), junk(), ...         count, and keep the newest by reference (a third of a microsecond a frame)
    snapshot(t_ns)                        makes texts of a bounded part of it, about ten times a second

Where there are more frames than fit, a snapshot shows those with findings first. Then come the newest of each command and
role, so that a rare one is seen among thousands of polls, and the newest of all. The others are counted.

Memory does not grow with the traffic: rings of fixed size, and at most `ROW_LIMIT` rows; what belongs to further ones is
counted in one row a bus. Not known here: the wall clock, and the viewers.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.entries import Entry, plain_entry
from analyzer.live.snapshot import EVENT, BusCounts, FrameLine, RowCounts, Snapshot
from analyzer.live.snapshot_lines import event_line, finding_line, frame_line, junk_line
from analyzer.pipeline import CAN_OVERHEAD_BITS
from analyzer.records import Comment, Event, Finding, Frame, Junk, Lane, Message, Severity
from analyzer.values import SECOND_NS

#: Of the newest frames, of those with findings, and of rows that had something new: shown in one snapshot at most.
NEWEST = 100
MARKED = 50
FROM_ROWS = 50
FINDINGS = 50
EVENTS = 50
#: Rows of one snapshot, those of them that have not changed, and rows kept.
ROWS_SENT = 200
ROWS_AGAIN = 20
ROW_LIMIT = 2000
#: Events that come again and again, and say nothing that one would act on.
_QUIET = frozenset(("clock_drift", "port"))

_Plain = tuple[Lane, Frame, int, int | None, int | None]


class _Piece(NamedTuple):
    """Junk with its place in the log."""

    junk: Junk
    sequence: int
    topic: str


class _Row:
    """Counts of one command of one address in one role, and the newest frame of it."""

    __slots__ = (
        "bytes", "command", "count", "counted", "dialect", "last", "latencies", "latency_last", "latency_max", "latency_sum",
        "port", "rate", "role", "sent", "who",
    )  # fmt: skip

    def __init__(self, port: str, who: str, command: str, role: str, dialect: str) -> None:
        self.port, self.who, self.command, self.role, self.dialect = port, who, command, role, dialect
        self.count = self.bytes = self.latencies = self.latency_last = self.latency_sum = self.latency_max = 0
        #: Counts when the rate was last told, and when the row was last sent.
        self.counted = self.sent = 0
        self.rate = 0.0
        self.last: _Plain | Entry | None = None


class _Bus:
    """Counts of a bus beside those of its rows, and what they were when the rates were last told."""

    __slots__ = ("bytes", "foreign", "frames", "is_can", "junk", "junk_bytes", "rates", "severities", "wire_ns")

    def __init__(self, is_can: bool) -> None:
        self.is_can = is_can
        self.junk = self.junk_bytes = 0
        self.severities = {Severity.INFO: 0, Severity.WARNING: 0, Severity.ERROR: 0}
        self.frames = self.bytes = self.foreign = self.wire_ns = 0
        self.rates: tuple[float, float, float | None] = (0.0, 0.0, None)


class SnapshotSink:
    """A sink to be watched. Used from one thread.

    `byte_ns`: bus -> time of one byte on a serial line, `bit_ns`: bus -> time of one bit of a CAN bus, for the load, where
    they are known; the empty name stands for every other bus. `log`, `log_bytes`, `behind_ns`, `lost` (by bus) and `causes`
    are for its owner to set; they go into each snapshot.
    """

    def __init__(self, *, byte_ns: Mapping[str, int] | None = None, bit_ns: Mapping[str, int] | None = None) -> None:
        self.log = ""
        self.log_bytes = 0
        self.behind_ns = 0
        self.lost: dict[str, int] = {}
        self.causes: dict[str, list[str]] = {}
        self._byte_ns = dict(byte_ns or {})
        self._bit_ns = dict(bit_ns or {})
        self._rows: dict[object, _Row] = {}
        self._others: dict[str, _Row] = {}
        self._buses: dict[str, _Bus] = {}
        self._recent: deque[_Plain | Entry | _Piece] = deque(maxlen=NEWEST)
        self._marked: deque[Entry] = deque(maxlen=MARKED)
        self._findings: deque[Finding] = deque(maxlen=FINDINGS)
        self._events: deque[FrameLine] = deque(maxlen=EVENTS)
        self._rules: Counter[str] = Counter()
        self._number = 0
        self._things_taken = 0
        self._newest_taken = 0
        #: When the rates were last told, and what the buses had counted then: frames, bytes, time busy.
        self._rated_ns: int | None = None
        self._before: dict[str, tuple[int, int, int]] = {}
        self._first_ns = 0
        self._turn = 0

    # --- sink -----------------------------------------------------------------------------------------------------

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        row = self._rows.get(lane.topic)
        if row is None:
            row = self._row(lane.topic, lane.message(frame))
        row.count += 1
        row.bytes += len(frame.data)
        if latency_ns is not None:
            row.latencies += 1
            row.latency_last = latency_ns
            row.latency_sum += latency_ns
            if latency_ns > row.latency_max:
                row.latency_max = latency_ns
        row.last = kept = (lane, frame, sequence, latency_ns, request_sequence)
        self._recent.append(kept)

    def entry(self, entry: Entry) -> None:
        message = entry.message
        row = self._row(entry.topic, message)
        row.count += 1
        row.bytes += len(message.frame.data)
        latency_ns = entry.latency_ns
        if latency_ns is not None and entry.first_reply:
            row.latencies += 1
            row.latency_last = latency_ns
            row.latency_sum += latency_ns
            row.latency_max = max(row.latency_max, latency_ns)
        row.last = entry
        self._recent.append(entry)
        if entry.findings:
            self._marked.append(entry)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        bus = self._bus(junk.port, junk.first_ns)
        bus.junk += 1
        bus.junk_bytes += len(junk.data)
        self._recent.append(_Piece(junk, sequence, topic))

    def finding(self, found: Finding) -> None:
        self._bus(found.port, found.first_ns).severities[found.severity] += 1
        self._rules[found.rule] += 1
        self._findings.append(found)

    def comment(self, comment: Comment) -> None:
        """Take a comment, such as a mark: it is shown as an event."""
        self._events.append(FrameLine(0, comment.t_ns or 0, comment.port, EVENT, "comment", text=comment.text))

    def happened(self, event: Event, sequence: int) -> None:
        if event.name not in _QUIET:
            self._events.append(event_line(event, sequence))

    def event(self, t_ns: int, bus: str, kind: str, text: str) -> None:
        """Take what happens to the recording and cannot stand in its log yet, such as a disk that is full."""
        self._events.append(FrameLine(0, t_ns, bus, EVENT, kind, severity=Severity.WARNING.value, text=text))

    # --- rows and buses -------------------------------------------------------------------------------------------

    def _bus(self, port: str, t_ns: int, is_can: bool = False) -> _Bus:
        bus = self._buses.get(port)
        if bus is None:
            bus = self._buses[port] = _Bus(is_can)
            if not self._first_ns:
                self._first_ns = t_ns
        return bus

    def _row(self, topic: str, message: Message) -> _Row:
        """Return the row of a message. Messages without a command share a topic and are told apart here."""
        command, frame, role = message.command, message.frame, message.role
        known = command is not None and role is not Role.UNKNOWN
        name = message.what
        key: object = topic if known else (topic, message.who, name)
        row = self._rows.get(key)
        if row is not None:
            return row
        self._bus(frame.port, frame.first_ns, frame.can is not None)
        if len(self._rows) >= ROW_LIMIT:
            other = self._others.get(frame.port)
            if other is None:
                other = self._others[frame.port] = _Row(frame.port, "", "others", "", "")
            return other
        row = self._rows[key] = _Row(frame.port, message.who, name, role.value, frame.dialect.name)
        return row

    # --- snapshots ------------------------------------------------------------------------------------------------

    def snapshot(self, t_ns: int, *, ended: bool = False, whole: bool = False) -> Snapshot:
        """Return what is new since the snapshot before, at `t_ns` on the log's clock; its size is bounded.

        `whole`: rates are those of the whole time so far, not of the last second; all rows are there, as in the last one.
        """
        self._number += 1
        rows = [*self._rows.values(), *self._others.values()]
        self._total(rows)
        if whole:
            self._rated_ns = self._first_ns or t_ns
            self._before.clear()
            for row in rows:
                row.counted = 0
        if self._rated_ns is None or t_ns - self._rated_ns >= (1 if whole else SECOND_NS):
            self._rate(rows, t_ns)
        shown = self._shown(rows)
        things = sum(bus.frames + bus.junk for bus in self._buses.values())
        left_out = things - self._things_taken - len(shown)
        self._things_taken = things
        findings = [finding_line(f) for f in self._findings]
        self._findings.clear()
        lines = [_line(kept) for kept in shown.values()]
        lines += [event for event in self._events if event.sequence]
        lines.sort(key=lambda line: line.sequence)
        lines += [event for event in self._events if not event.sequence]
        self._events.clear()
        return Snapshot(
            t_ns=t_ns,
            number=self._number,
            frames=lines,
            left_out=left_out,
            findings=findings,
            buses=[self._bus_counts(name, bus) for name, bus in self._buses.items()],
            rows=self._row_counts(rows, every=ended or whole),
            rules=dict(self._rules),
            log=self.log,
            log_bytes=self.log_bytes,
            behind_ns=self.behind_ns,
            first_ns=self._first_ns,
            ended=ended,
            causes=dict(self.causes),
        )

    def _shown(self, rows: list[_Row]) -> dict[int, _Plain | Entry | _Piece]:
        """Return what is shown, by sequence: none of it twice, and none of it again in the next snapshot."""
        taken: dict[int, _Plain | Entry | _Piece] = {_sequence(kept): kept for kept in self._recent}
        for entry in self._marked:
            taken[entry.sequence] = entry
        newest = self._newest_taken
        fresh = [row.last for row in rows if row.last is not None and _sequence(row.last) > newest]
        fresh = [last for last in fresh if _sequence(last) not in taken]
        # The oldest first: the others will have been in the ring, or are there next time.
        for last in sorted(fresh, key=_sequence)[:FROM_ROWS]:
            taken[_sequence(last)] = last
        if taken:
            self._newest_taken = max(newest, max(taken))
        self._recent.clear()
        self._marked.clear()
        return taken

    def _total(self, rows: list[_Row]) -> None:
        for bus in self._buses.values():
            bus.frames = bus.bytes = bus.foreign = 0
        for row in rows:
            bus = self._buses[row.port]
            bus.foreign += row.count if row.role == Role.FOREIGN else 0
            bus.frames += row.count
            bus.bytes += row.bytes
        for name, bus in self._buses.items():
            unit_ns = self._unit_ns(name, bus)
            bits = CAN_OVERHEAD_BITS * bus.frames + 8 * bus.bytes
            bus.wire_ns = unit_ns * (bits if bus.is_can else bus.bytes + bus.junk_bytes)

    def _unit_ns(self, name: str, bus: _Bus) -> int:
        """Return the time of a byte, on CAN of a bit; 0 where it is not known."""
        units = self._bit_ns if bus.is_can else self._byte_ns
        return units.get(name, units.get("", 0))

    def _rate(self, rows: list[_Row], t_ns: int) -> None:
        """Tell the rates of the time since they were last told."""
        before = self._rated_ns
        self._rated_ns = t_ns
        if before is not None:
            span = t_ns - before
            for row in rows:
                row.rate = (row.count - row.counted) * SECOND_NS / span
            for name, bus in self._buses.items():
                frames, size, wire_ns = self._before.get(name, (0, 0, 0))
                load = min(1.0, (bus.wire_ns - wire_ns) / span) if self._unit_ns(name, bus) else None
                wire_bytes = bus.bytes + bus.junk_bytes
                bus.rates = ((bus.frames - frames) * SECOND_NS / span, (wire_bytes - size) * SECOND_NS / span, load)
        for row in rows:
            row.counted = row.count
        self._before = {n: (b.frames, b.bytes + b.junk_bytes, b.wire_ns) for n, b in self._buses.items()}

    def _row_counts(self, rows: list[_Row], *, every: bool) -> list[RowCounts]:
        """Return the rows that have changed, and some of the others in turn: what a lost snapshot held comes again."""
        changed = rows if every else [row for row in rows if row.count != row.sent][:ROWS_SENT]
        room = 0 if every else min(ROWS_SENT - len(changed), ROWS_AGAIN, len(rows))
        again = [rows[(self._turn + n) % len(rows)] for n in range(room)]
        self._turn += room
        result = []
        for row in dict.fromkeys([*changed, *again]):
            row.sent = row.count
            result.append(
                RowCounts(
                    row.port, row.who, row.command, row.role, row.dialect, row.count, round(row.rate, 2), row.latencies,
                    row.latency_last, row.latency_sum, row.latency_max,
                )
            )  # fmt: skip
        return result

    def _bus_counts(self, name: str, bus: _Bus) -> BusCounts:
        frame_rate, byte_rate, load = bus.rates
        severities = bus.severities
        return BusCounts(
            bus=name,
            frames=bus.frames,
            bytes=bus.bytes,
            junk=bus.junk,
            junk_bytes=bus.junk_bytes,
            errors=severities[Severity.ERROR],
            warnings=severities[Severity.WARNING],
            infos=severities[Severity.INFO],
            foreign=bus.foreign,
            lost=self.lost.get(name, 0),
            frame_rate=round(frame_rate, 2),
            byte_rate=round(byte_rate, 2),
            load=None if load is None else round(load, 4),
        )


def _line(kept: _Plain | Entry | _Piece) -> FrameLine:
    if isinstance(kept, Entry):
        return frame_line(kept)
    if isinstance(kept, _Piece):
        return junk_line(*kept)
    return frame_line(plain_entry(*kept))


def _sequence(kept: _Plain | Entry | _Piece) -> int:
    if isinstance(kept, (Entry, _Piece)):
        return kept.sequence
    return kept[2]
