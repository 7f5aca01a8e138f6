"""The summary of a capture: frames and latencies by command and address, bytes by kind, findings by rule.

Memory does not grow with the capture. Latencies go into histograms with buckets of at most 3 %, and only the first few
findings of each rule are kept.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from analyzer import __version__
from analyzer.catalogue import Dialect, Role
from analyzer.entries import Entry, plain_entry
from analyzer.records import Comment, Finding, Frame, Junk, Lane, Severity

if TYPE_CHECKING:
    from analyzer.columns.codec import Integers
    from analyzer.columns.plain import Plain

#: Findings of each rule that are kept to be shown.
FIRST_FEW = 3
#: How far a double is shifted right to keep its exponent and the first five bits of its mantissa.
_BEHIND_SIX = 52 - 5
#: Nodes that are counted apart of those that are no drives: there are as many identifiers as one likes.
MOST_OTHERS = 2000
#: Frames of a node without one fitting check that are no chance.
_SEVERAL = 3


class Latencies:
    """A histogram of times in ns; quantiles are at most 3 % too great, the greatest is exact."""

    def __init__(self) -> None:
        self.count = 0
        self.greatest = 0
        self._buckets: dict[int, int] = {}

    def add(self, latency_ns: int) -> None:
        self.count += 1
        if latency_ns > self.greatest:
            self.greatest = latency_ns
        # The six leading bits and the number of the others: buckets are 1.6 % to 3.1 % wide.
        more = latency_ns.bit_length() - 6
        bucket = latency_ns if more <= 0 else (more << 6) + (latency_ns >> more)
        self._buckets[bucket] = self._buckets.get(bucket, 0) + 1

    def add_counted(self, bucket: int, count: int, greatest: int) -> None:
        """Count times of one bucket. `greatest`: of times that are counted; of the last bucket it is the greatest."""
        self.count += count
        self.greatest = max(self.greatest, greatest)
        self._buckets[bucket] = self._buckets.get(bucket, 0) + count

    def add_all(self, latencies_ns: Integers) -> None:
        import numpy as np

        if len(latencies_ns):
            greatest = int(latencies_ns.max())
            for bucket, count in zip(*np.unique(_buckets_of(latencies_ns), return_counts=True), strict=True):
                self.add_counted(int(bucket), int(count), greatest)

    def counts(self) -> list[tuple[int, int]]:
        """Return the greatest time of each bucket in ns, and how many fell into it, the shortest first."""
        return [(min(_upper(bucket), self.greatest), self._buckets[bucket]) for bucket in sorted(self._buckets)]

    def quantile(self, share: float) -> int:
        """Return the time that this share (0..1) of all does not exceed, in ns; 0 without any."""
        wanted = share * self.count
        seen = 0
        for time_ns, count in self.counts():
            seen += count
            if seen >= wanted:
                return time_ns
        return 0


def _buckets_of(latencies_ns: Integers) -> Integers:
    """Return the bucket of each time, as for one time."""
    import numpy as np

    # The highest bits of a double are its exponent, then its mantissa, of which the leading 1 is not stored.
    high = latencies_ns.astype(np.float64).view(np.int64) >> _BEHIND_SIX
    more = (high >> 5) - (1023 + 5)
    buckets: Integers = np.where(more > 0, (more << 6) + 32 + (high & 31), latencies_ns)
    return buckets


def _upper(bucket: int) -> int:
    """Return the greatest time of a bucket in ns."""
    if bucket < 64:
        return bucket
    # The leading bits are 32..63, so they never carry into the number of the others.
    more, leading = bucket >> 6, bucket & 63
    return ((leading + 1) << more) - 1


@dataclass
class Row:
    """One command of one address."""

    requests: int = 0
    replies: int = 0
    unknown: int = 0
    messages: int = 0
    latencies: Latencies = field(default_factory=Latencies)


class Summary:
    """A sink that counts."""

    def __init__(self) -> None:
        self.rows: dict[tuple[str, str, str, str], Row] = {}
        self.frames = 0
        self.frame_bytes = 0
        self.junk_bytes: Counter[str] = Counter()
        self.findings: Counter[str] = Counter()
        self.severities: Counter[Severity] = Counter()
        #: The worst severity that a rule's findings had: it can be milder than the rule's own.
        self.worst: dict[str, Severity] = {}
        self.first: dict[str, list[Finding]] = {}
        #: CAN nodes that sent a fitting check, and how many frames without one each sent.
        self._sound: set[tuple[str, str]] = set()
        self._unsound: Counter[tuple[str, str]] = Counter()
        #: CAN buses.
        self.can: set[str] = set()
        #: Who else spoke: frames and bytes by bus and identifier or address.
        self.others: dict[tuple[str, str], list[int]] = {}
        self.comments = 0
        self.first_ns: int | None = None
        self.last_ns = 0
        self._known: dict[str, Row] = {}
        self._plain: Plain | None = None
        self._taken: list[slice] = []

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        row = self._known.get(lane.topic)
        if row is None:
            self.entry(plain_entry(lane, frame, sequence, latency_ns, request_sequence))
            return
        self.frames += 1
        self.frame_bytes += len(frame.data)
        if frame.last_ns > self.last_ns:
            self.last_ns = frame.last_ns
        if lane.is_request:
            row.requests += 1
        else:
            row.replies += 1
            if latency_ns is not None:
                row.latencies.add(latency_ns)

    def begin(self, plain: Plain) -> None:
        self.settle()
        self._plain = plain
        self._taken = []

    def run(self, start: int, stop: int, sequence: int) -> None:
        """Count plain exchanges; by commands they are counted when the block has ended."""
        assert self._plain is not None  # a run is of a block
        block = self._plain.block
        if self.first_ns is None:
            self.first_ns = int(block.first_ns[start])
        self.frames += stop - start
        self.frame_bytes += int(block.sizes[start:stop].sum())
        self.last_ns = max(self.last_ns, int(block.t_ns[stop - 1]))
        if self._taken and self._taken[-1].stop == start:
            start = self._taken.pop().start
        self._taken.append(slice(start, stop))

    def about(self, dialects: Sequence[Dialect], bytes_in: int) -> dict[str, str]:
        """Return what the metadata of every log says of its traffic. `bytes_in`: what came in."""
        return {
            "dialect": ",".join(d.name for d in dialects),
            "manual": "; ".join(d.manual for d in dialects),
            "version": __version__,
            "bytes_total": str(bytes_in),
            "bytes_in_frames": str(self.frame_bytes),
            "bytes_junk": str(sum(self.junk_bytes.values())),
            "frames": str(self.frames),
            "findings": str(sum(self.findings.values())),
        }

    def settle(self) -> Summary:
        """Count by commands what was taken of the last block. Return this."""
        plain = self._plain
        if plain is None or not self._taken:
            return self
        import numpy as np

        from analyzer.columns.groups import ranks

        numbers, latencies = (np.concatenate([each[rows] for rows in self._taken]) for each in (plain.lane, plain.latencies))
        counts = np.bincount(numbers, minlength=len(plain.lanes)).tolist()
        known: dict[int, Row] = {}
        for number, (lane, many) in enumerate(zip(plain.lanes, counts, strict=True)):
            if not many:
                continue
            row = self._known.get(lane.topic)
            if row is None:
                message = lane.message(plain.frame(int((plain.lane == number).argmax())))
                if message.frame.can is not None:
                    self._sound.add((plain.block.port, message.who))
                row = self._row(Entry(message, 0, lane.topic))
            row.requests += many * lane.is_request
            row.replies += many * (not lane.is_request)
            known[number] = row
        timed = np.flatnonzero(latencies > 0)
        if len(timed):
            times = latencies.take(timed)
            buckets, places = ranks(_buckets_of(times))
            keys, places = ranks(numbers.take(timed) * len(buckets) + places)
            # The greatest time of a lane is among those in its last bucket.
            lasts = np.append(np.diff(keys // len(buckets)) > 0, True)
            rows = np.flatnonzero(lasts.take(places))
            greatest = np.zeros(len(keys), dtype=np.int64)
            np.maximum.at(greatest, places[rows], times[rows])
            for key, count, most in zip(keys.tolist(), np.bincount(places).tolist(), greatest.tolist(), strict=True):
                number, place = divmod(key, len(buckets))
                known[number].latencies.add_counted(int(buckets[place]), count, most)
        self._plain = None
        return self

    def entry(self, entry: Entry) -> None:
        message = entry.message
        frame = message.frame
        self.frames += 1
        self.frame_bytes += len(frame.data)
        if self.first_ns is None:
            self.first_ns = frame.first_ns
        if frame.last_ns > self.last_ns:
            self.last_ns = frame.last_ns
        role = message.role
        if role is Role.FOREIGN:
            node = frame.port, message.who
            if node not in self.others and len(self.others) >= MOST_OTHERS:
                node = frame.port, "further"
            counts = self.others.setdefault(node, [0, 0])
            counts[0] += 1
            counts[1] += len(frame.data)
            return
        if frame.can is not None and role is not Role.MESSAGE:
            node = frame.port, message.who
            if frame.checksum_ok:
                self._sound.add(node)
            else:
                self._unsound[node] += 1
        # The topic names bus, address and command already; unknown ones share a topic and are told apart here.
        row = self._known.get(entry.topic) if message.command is not None and role is not Role.UNKNOWN else None
        if row is None:
            row = self._row(entry)
        if role is Role.REQUEST:
            row.requests += 1
        elif role is Role.REPLY:
            row.replies += 1
            if entry.first_reply and entry.latency_ns is not None:
                row.latencies.add(entry.latency_ns)
        elif role is Role.MESSAGE:
            row.messages += 1
        else:
            row.unknown += 1

    def _row(self, entry: Entry) -> Row:
        message = entry.message
        command = message.command
        who = "all" if command is not None and command.slots is not None else str(message.address)
        if message.frame.can is not None:
            self.can.add(message.frame.port)
        key = (message.frame.port, who, message.frame.dialect.name, message.what)
        row = self.rows.setdefault(key, Row())
        if command is not None and message.role is not Role.UNKNOWN:
            self._known[entry.topic] = row
        return row

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        self.junk_bytes[junk.reason.value] += len(junk.data)
        if self.first_ns is None:
            self.first_ns = junk.first_ns
        self.last_ns = max(self.last_ns, junk.last_ns)

    def finding(self, found: Finding) -> None:
        self.findings[found.rule] += 1
        self.severities[found.severity] += 1
        worst = self.worst.get(found.rule)
        if worst is None or found.severity.rank > worst.rank:
            self.worst[found.rule] = found.severity
        kept = self.first.setdefault(found.rule, [])
        if len(kept) < FIRST_FEW:
            kept.append(found)

    def comment(self, comment: Comment) -> None:
        self.comments += 1

    def doubtful(self) -> list[tuple[str, str, int]]:
        """Return the CAN nodes that no frame with a fitting check speaks for, where others have such: bus, who, frames."""
        sound = {bus for bus, _ in self._sound}
        return [
            (*node, n) for node, n in self._unsound.items() if node not in self._sound and n >= _SEVERAL and node[0] in sound
        ]

    def by_frames(self) -> list[tuple[tuple[str, str], list[int]]]:
        """Return who else spoke with frames and bytes, those with the most frames first."""
        return sorted(self.others.items(), key=lambda item: (-item[1][0], item[0]))

    def as_object(self) -> dict[str, Any]:
        """Return the summary as an object for JSON; times in seconds."""
        commands = []
        for (bus, address, dialect, name), row in sorted(self.rows.items(), key=_order):
            shown: dict[str, Any] = {"bus": bus, "address": address, "dialect": dialect, "command": name}
            shown |= {"requests": row.requests, "replies": row.replies}
            if row.unknown:
                shown["unknown"] = row.unknown
            if row.messages:
                shown["messages"] = row.messages
            if row.latencies.count:
                shown["latency"] = {
                    "median": row.latencies.quantile(0.5) / 1e9,
                    "p99": row.latencies.quantile(0.99) / 1e9,
                    "max": row.latencies.greatest / 1e9,
                }
            commands.append(shown)
        return {
            "frames": self.frames,
            "bytes": {
                "frames": self.frame_bytes,
                "junk": dict(sorted(self.junk_bytes.items())),
                "total": self.frame_bytes + sum(self.junk_bytes.values()),
            },
            "commands": commands,
            "others": [
                {"bus": bus, "who": who, "frames": frames, "bytes": size} for (bus, who), (frames, size) in self.by_frames()
            ],
            "findings": [
                {
                    "rule": rule,
                    "severity": self.worst[rule].value,
                    "count": count,
                    "first": [
                        {"time": f.first_ns / 1e9, "topic": f.topic, "sequence": f.sequence, "offset": f.offset}
                        | {"text": f.text}
                        for f in self.first[rule]
                    ],
                }
                for rule, count in self.findings.most_common()
            ],
        }


def _order(item: tuple[tuple[str, str, str, str], Row]) -> tuple[str, int, str, str]:
    bus, address, dialect, name = item[0]
    return bus, int(address) if address.isdigit() else -1, dialect, name
