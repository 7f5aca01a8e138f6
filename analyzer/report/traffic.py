"""What a log holds, for a page: values over time as columns, latencies as histograms, counts of all the rest.

Messages of one topic are parsed together, some thousands at once. Memory does not grow with the log: see `kept`.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Annotated, Generic, TypeVar

import msgspec
import numpy as np

from analyzer import dialects, events
from analyzer.catalogue import Verb
from analyzer.errors import UsageError
from analyzer.layout import STATE_UNITS
from analyzer.records import Severity
from analyzer.report.kept import Breaches, Bus, Drive, Example, Marks, Talk, Told, Track, number_of, own_fields, properties_of
from analyzer.sources.mcap_scan import LogMessage, fields_of
from analyzer.sources.source import Source, describe
from analyzer.system.decoding import UNDECODABLE
from analyzer.values import SECOND_NS, fields_text, identifier

if TYPE_CHECKING:
    from mcap.records import Channel

#: Messages that are parsed together, and how many such batches are looked through for the frame of a finding.
_BATCH, _RECENT = 16_384, 6
#: Points of all series together, in memory; beyond it each keeps its share of half of them.
_POINTS = 2_000_000
#: Marks that are kept of all drives, and of one command of a drive.
_MARKS_KEPT, _LEAST_MARKS, _MOST_MARKS = 60_000, 64, 4096
#: Of each rule the findings that are shown, and what is kept of comments, events and nodes that are no drives.
FIRST_FEW, _COMMENTS, _EVENTS, _OTHERS = 4, 200, 500, 2000
#: Drives, commands and rules of a log; one with more is damaged or hostile.
_DRIVES, _COMMANDS, _RULES = 5000, 5000, 200
#: Values of another device that are drawn, and numbers of its frames that are none.
_VALUES, _NO_VALUES = 24, frozenset(("register", "quantity", "exception"))
#: Characters of a finding that are kept beside its mark.
_LONGEST = 200
_LEVELS = {4: Severity.ERROR, 3: Severity.WARNING, 2: Severity.INFO}
#: Events of a recording that a page leaves out.
_UNTOLD = frozenset(("part", "port", "dialect", "resumed", "clock_drift"))
_KINDS = {
    **dict.fromkeys((Verb.ENABLE, Verb.MOTOR_ON, Verb.MOTOR_OFF), "enable"),
    **dict.fromkeys((v for v in Verb if v.startswith("stop") or v in (Verb.BRAKE, Verb.EMERGENCY_STOP)), "stop"),
}

T = TypeVar("T", bound=msgspec.Struct)
#: A whole number that a column holds.
_Whole = Annotated[int, msgspec.Meta(ge=-1, le=1 << 53)]
#: Times beyond it (the year 2116) are damage.
LATEST_NS = 1 << 62


class _State(msgspec.Struct, gc=False):
    position: float = math.nan
    speed: float = math.nan
    current: float = math.nan
    voltage: float = math.nan
    temperature: float = math.nan


class _Frame(msgspec.Struct, gc=False):
    raw: str = msgspec.field(name="_raw", default="")
    latency: float = msgspec.field(name="_latency", default=math.nan)
    request: _Whole = msgspec.field(name="_request_sequence", default=-1)
    sound: bool = msgspec.field(name="_checksum_ok", default=True)
    address: _Whole = -1
    who: str = ""
    length: _Whole = 0
    reason: str = ""


class _Second(msgspec.Struct, gc=False):
    frames: _Whole = 0
    bytes: _Whole = 0
    junk_bytes: _Whole = 0
    errors: _Whole = 0
    warnings: _Whole = 0
    load: float = math.nan


class _Found(msgspec.Struct, gc=False):
    level: int = 2
    message: str = ""
    name: str = ""
    file: str = ""
    line: _Whole = 0
    section: str = ""
    bus: str = ""
    offset: int = 0
    address: _Whole | None = None
    event: str = ""
    text: str = ""


class _Topic:
    """A topic and the messages of it that were not parsed yet."""

    def __init__(self, channel: Channel, take: Callable[[_Topic], None], units: Mapping[str, str]) -> None:
        _, bus, *rest = [*channel.topic.split("/"), "", ""]
        self.name = channel.topic
        self.bus, self.address = bus, rest[0]
        self.is_request = channel.topic.endswith("/request")
        self.is_message = channel.topic.endswith("/message")
        self.can = channel.metadata.get("bus_kind") == "can"
        self.dialect = channel.metadata.get("dialect", "")
        self.command = channel.metadata.get("command", rest[1])
        self.take = take
        self.units = units
        self.mark = _mark_of(self.dialect, self.command) if self.is_request else ""
        self.is_of_device = self.is_message or not (self.is_request or _of_drives(self.dialect))
        self.highest = -1
        self.empty()

    def empty(self) -> None:
        """Begin a new batch; the last one stays with those who hold it."""
        self.times: list[int] = []
        self.sequences: list[int] = []
        self.data: list[bytes] = []


@cache
def _of_drives(dialect: str) -> frozenset[str]:
    """Return the commands in the manual of a dialect of drives, none of any other: those of device files are not registered."""
    return frozenset(name for each in dialects.every() if each.name == dialect for name in each.by_name)


def _mark_of(dialect: str, name: str) -> str:
    """Return what kind of mark a request is worth: motion, stop, enable, or none."""
    try:
        command = next((c for c in dialects.get(dialect).commands if c.name == name), None)
    except UsageError:
        return ""
    if command is None:
        return ""
    return _KINDS.get(command.verb) or ("motion" if command.moves else "")


class _Parser(Generic[T]):
    """Parses messages of one form together; one that is damaged becomes an empty one."""

    def __init__(self, form: type[T], problem: Callable[[str], None]) -> None:
        self._empty = form
        self._one = msgspec.json.Decoder(form).decode
        self._many = msgspec.json.Decoder(list[form]).decode  # type: ignore[valid-type]
        self._problem = problem

    def __call__(self, topic: _Topic) -> list[T]:
        try:
            rows: list[T] = self._many(b"[" + b",".join(topic.data) + b"]")
            if len(rows) == len(topic.data):
                return rows
        except UNDECODABLE:
            pass
        return [self._alone(topic, each) for each in topic.data]

    def _alone(self, topic: _Topic, data: bytes) -> T:
        try:
            return self._one(data)
        except UNDECODABLE as error:
            self._problem(f"a message of {topic.name}: {describe(error)}")
            return self._empty()


class Traffic:
    """All of a log. Read it by `read`.

    `first_ns`, `last_ns`, `last_sequence`: of its messages, 0 without any; `frames`: that were decoded; `raw`: pieces that were
    only recorded. `about`: what its metadata say.
    """

    def __init__(self, source: Source, since_ns: int, until_ns: int) -> None:
        self.source = source
        self.first_ns = self.last_ns = self.last_sequence = 0
        self.frames = self.raw = 0
        self.about: dict[str, str] = {}
        self.drives: dict[tuple[str, str], Drive] = {}
        self.talks: dict[tuple[str, str], Talk] = {}
        self.buses: dict[str, Bus] = {}
        self.breaches: dict[str, Breaches] = {}
        #: Nodes that are no drives: frames and bytes by bus and who.
        self.others: dict[tuple[str, str], list[int]] = {}
        self.comments: list[Told] = []
        self.happened: list[Told] = []
        self.first_finding_ns: int | None = None
        self._since_ns, self._until_ns = since_ns, until_ns
        self._topics: dict[int, _Topic] = {}
        self._by_name: dict[str, _Topic] = {}
        self._schemas: dict[int, bytes] = {}
        self._units: dict[int, dict[str, str]] = {}
        self._recent: deque[dict[str, tuple[list[int], list[bytes]]]] = deque(maxlen=_RECENT)
        self._kinds_of_marks = 0
        self._states = _Parser(_State, source.problem)
        self._frames = _Parser(_Frame, source.problem)
        self._seconds = _Parser(_Second, source.problem)
        self._logged = _Parser(_Found, source.problem)

    # --- reading ------------------------------------------------------------------------------------------------------

    def read(self) -> None:
        """Read the whole log. Raises UnreadableError for one that grows beyond bounds."""
        from mcap.records import Channel, Metadata, Schema

        from analyzer.sources.mcap_records import records

        waiting = 0
        topics, since_ns, until_ns = self._topics, self._since_ns, self._until_ns
        for record in records(self.source):
            if isinstance(record, LogMessage):
                number, sequence, log_ns, _, data = record
                topic = topics.get(number)
                if topic is None or not since_ns <= log_ns <= until_ns:
                    continue
                if log_ns > LATEST_NS:
                    self.source.problem(f"a message of {topic.name}: its time is {log_ns} ns, expected one before 2116")
                    continue
                topic.times.append(log_ns)
                topic.sequences.append(sequence)
                topic.data.append(data)
                waiting += 1
                if waiting >= _BATCH:
                    self._take()
                    waiting = 0
            elif isinstance(record, Channel):
                self._declare(record)
            elif isinstance(record, Schema):
                self._schemas[record.id] = record.data
            elif isinstance(record, Metadata) and record.name.startswith("servotap"):
                self.about |= record.metadata
        self._take()

    def _declare(self, channel: Channel) -> None:
        """Learn what a topic is. A part of a recording has numbers of its own for topics that were there before."""
        known = self._by_name.get(channel.topic)
        if known is None:
            take = self._taking(channel)
            if take is None:
                self._topics.pop(channel.id, None)
                return
            known = self._by_name[channel.topic] = _Topic(channel, take, self._units_of(channel))
        self._topics[channel.id] = known

    def _taking(self, channel: Channel) -> Callable[[_Topic], None] | None:
        """Return what takes the messages of a topic, None for one that is not needed."""
        match channel.topic.split("/"):
            case ["", "findings"]:
                return self._take_findings
            case ["", "comments"]:
                return self._take_comments
            case ["", name] if f"/{name}" == events.TOPIC:
                return self._take_events
            case ["", _, "stats"]:
                return self._take_seconds
            case ["", _, "unknown" | "foreign" | "junk" as what]:
                return {"unknown": self._take_unknown, "foreign": self._take_foreign, "junk": self._take_junk}[what]
            case ["", _, "raw"]:
                return self._take_raw
            case ["", _, _, "state"]:
                return self._take_states
            case ["", _, _, _, "request" | "reply" | "message"]:
                return self._take_frames
        return None

    def _units_of(self, channel: Channel) -> Mapping[str, str]:
        """Return the units of a topic's fields, as its schema has them."""
        known = self._units.get(channel.schema_id)
        if known is None:
            properties = properties_of(self._schemas.get(channel.schema_id, b""))
            known = {name: str(about["unit"]) for name, about in properties.items() if "unit" in about}
            self._units[channel.schema_id] = known
        return known

    def _take(self) -> None:
        """Take the messages that wait, topic by topic; findings last, for they look for their frames."""
        full = [topic for topic in self._by_name.values() if topic.data]
        if not full:
            return
        self._recent.append({topic.name: (topic.sequences, topic.data) for topic in full})
        # A comment at the head of a capture may have no time.
        if traffic := [topic for topic in full if topic.take != self._take_comments]:
            first_ns = min(topic.times[0] for topic in traffic)
            self.first_ns = min(self.first_ns, first_ns) if self.first_ns else first_ns
            self.last_ns = max(self.last_ns, *(topic.times[-1] for topic in traffic))
        self.last_sequence = max(self.last_sequence, *(topic.sequences[-1] for topic in full))
        for topic in sorted(full, key=lambda each: each.take == self._take_findings):
            topic.take(topic)
            topic.empty()
        tracks = [track for drive in self.drives.values() for track in drive.states.values()]
        tracks += [track for bus in self.buses.values() for track in (bus.load, bus.frames, bus.errors, bus.warnings)]
        if sum(track.count for track in tracks) > _POINTS:
            most = max(200, _POINTS // 2 // len(tracks))
            for track in tracks:
                track.thin(most)

    # --- topics -------------------------------------------------------------------------------------------------------

    def _drive(self, bus: str, address: str, *, can: bool = False) -> Drive:
        key = bus, address
        if key not in self.drives and len(self.drives) >= _DRIVES:
            key = bus, "further"
        drive = self.drives.setdefault(key, Drive(*key))
        if can and number_of(key[1]) >= 0:
            drive.who = identifier(number_of(key[1]))
        drive.who = drive.who or key[1]
        return drive

    def _bus(self, name: str) -> Bus:
        return self.buses.setdefault(name, Bus())

    def _take_states(self, topic: _Topic) -> None:
        rows = self._states(topic)
        t_ns, sequence = np.array(topic.times, np.int64), np.array(topic.sequences, np.int64)
        drive = self._drive(topic.bus, topic.address)
        drive.units |= STATE_UNITS
        states = drive.states
        for name in STATE_UNITS:
            values = np.array([getattr(row, name) for row in rows], np.float64)
            if np.isfinite(values).any():
                states.setdefault(name, Track()).add(t_ns, sequence, values)

    def _take_values(self, topic: _Topic, drive: Drive) -> None:
        """Take the numbers of another device's frames that have no names of their own (a mode is no curve)."""
        found: dict[str, list[tuple[int, int, float]]] = {}
        for t_ns, sequence, data in zip(topic.times, topic.sequences, topic.data, strict=True):
            fields = fields_of(data)
            if fields.get("_checksum_ok") is False:
                continue
            for name, value in own_fields(fields).items():
                if isinstance(value, (int, float)) and name not in _NO_VALUES and f"{name}_name" not in fields:
                    found.setdefault(name, []).append((t_ns, sequence, value))
        for name, points in found.items():
            if name in drive.states or len(drive.states) < _VALUES:
                times, sequences, values = zip(*points, strict=True)
                drive.units[name] = topic.units.get(name, "")
                track = drive.states.setdefault(name, Track())
                track.add(np.array(times, np.int64), np.array(sequences, np.int64), np.array(values, np.float64))

    def _take_frames(self, topic: _Topic) -> None:
        rows = self._frames(topic)
        count = len(rows)
        self.frames += count
        self._bus(topic.bus)
        drive = self._drive(topic.bus, topic.address, can=topic.can)
        drive.bytes += sum((len(row.raw) + 1) // 3 for row in rows)
        drive.dialects.setdefault(topic.dialect)
        if topic.is_of_device:
            self._take_values(topic, drive)
        if topic.is_message:
            drive.messages += count
            return
        key = (topic.bus, topic.command)
        if key not in self.talks and len(self.talks) >= _COMMANDS:
            key = topic.bus, "further"
        talk = self.talks.setdefault(key, Talk(*key))
        if topic.is_request:
            drive.requests += count
            talk.requests += count
            if topic.mark:
                marks = self._marks(drive, topic.command, topic.mark, topic.command, topic.units)
                marks.add(topic.times, topic.sequences, topic.data, self._most_marks)
            return
        drive.replies += count
        talk.replies += count
        if topic.command in _of_drives(topic.dialect):
            drive.answers += sum(row.sound for row in rows)
        # Of several replies to a request the first one counts: the others tell how long a motion took.
        asked = np.array([row.request for row in rows], np.int64)
        before = np.maximum.accumulate(np.concatenate(([topic.highest], asked[:-1])))
        topic.highest = max(topic.highest, int(asked.max()))
        seconds = np.array([row.latency for row in rows], np.float64)
        there = np.isfinite(seconds) & (seconds >= 0) & (seconds < 1e9) & (asked > before)
        talk.latencies.add_all(np.rint(seconds[there] * 1e9).astype(np.int64))

    def _marks(self, drive: Drive, key: str, kind: str, label: str, units: Mapping[str, str]) -> Marks:
        known = drive.marks.get(key)
        if known is None:
            known = drive.marks[key] = Marks(kind, label, units)
            self._kinds_of_marks += 1
        return known

    @property
    def _most_marks(self) -> int:
        return min(_MOST_MARKS, max(_LEAST_MARKS, _MARKS_KEPT // self._kinds_of_marks))

    def _take_unknown(self, topic: _Topic) -> None:
        for row in self._frames(topic):
            self.frames += 1
            drive = self._drive(topic.bus, str(row.address), can=topic.can)
            drive.unknown += 1
            drive.bytes += (len(row.raw) + 1) // 3

    def _take_foreign(self, topic: _Topic) -> None:
        for row in self._frames(topic):
            self.frames += 1
            node = topic.bus, row.who
            if node not in self.others and len(self.others) >= _OTHERS:
                node = topic.bus, "further"
            counts = self.others.setdefault(node, [0, 0])
            counts[0] += 1
            counts[1] += row.length

    def _take_junk(self, topic: _Topic) -> None:
        junk_bytes = self._bus(topic.bus).junk_bytes
        for row in self._frames(topic):
            junk_bytes[row.reason] += row.length

    def _take_raw(self, topic: _Topic) -> None:
        self.raw += len(topic.data)

    def _take_seconds(self, topic: _Topic) -> None:
        rows, bus = self._seconds(topic), self._bus(topic.bus)
        # The counts of a second are written with the first frame behind it, so they are of the second of the ones before.
        begins = [bus.second_ns if bus.second_ns is not None else self.first_ns, *topic.times[:-1]]
        bus.second_ns = topic.times[-1]
        t_ns, none = np.array(begins, np.int64) // SECOND_NS * SECOND_NS, np.zeros(len(rows), np.int64)
        for name in ("load", "frames", "errors", "warnings"):
            values = np.array([getattr(row, name) for row in rows], np.float64)
            getattr(bus, name).add(t_ns, none, values)

    def _take_findings(self, topic: _Topic) -> None:
        for t_ns, row in zip(topic.times, self._logged(topic), strict=True):
            severity = _LEVELS.get(row.level, Severity.INFO)
            if self.first_finding_ns is None:
                self.first_finding_ns = t_ns
            rule = row.name if row.name in self.breaches or len(self.breaches) < _RULES else "further"
            known = self.breaches.setdefault(rule, Breaches(rule, severity))
            known.count += 1
            # The members stand in the order of their names; errors come first here.
            known.severity = severity if severity is Severity.ERROR else known.severity
            if row.address is not None:
                drive = self._drive(row.bus, str(row.address))
                drive.severities[severity] += 1
                if severity is not Severity.INFO:
                    marks = self._marks(drive, f"! {rule}", severity.value, rule, {})
                    marks.add([t_ns], [row.line], [row.message[:_LONGEST]], self._most_marks)
            if len(known.first) < FIRST_FEW:
                raw, fields = self._frame_of(row.file, row.line)
                known.first.append(Example(t_ns, row.line, row.file, row.offset, row.message, row.section, raw, fields))

    def _frame_of(self, topic: str, sequence: int) -> tuple[str, str]:
        """Return a frame that came not long ago as hex and as its fields in words; nothing where it is not found."""
        for batch in reversed(self._recent):
            sequences, data = batch.get(topic, ((), ()))
            at = bisect_left(sequences, sequence)
            if at < len(sequences) and sequences[at] == sequence:
                fields = fields_of(data[at])
                raw, can_id = str(fields.get("_raw", "")), fields.get("_can_id")
                head = f"{identifier(can_id)[2:]} " if isinstance(can_id, int) else ""
                units = self._by_name[topic].units if topic in self._by_name else {}
                return f"{head}{raw}", fields_text(own_fields(fields), units)
        return "", ""

    def _take_comments(self, topic: _Topic) -> None:
        for t_ns, row in zip(topic.times, self._logged(topic), strict=True):
            if len(self.comments) < _COMMENTS:
                self.comments.append(Told(t_ns, row.bus, row.message))

    def _take_events(self, topic: _Topic) -> None:
        for t_ns, row in zip(topic.times, self._logged(topic), strict=True):
            if row.event not in _UNTOLD and len(self.happened) < _EVENTS:
                self.happened.append(Told(t_ns, row.bus, f"{row.event}: {row.text}"))
