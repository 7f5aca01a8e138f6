"""Claims that need nothing but traffic: the analyzer's findings, each read as something that the manual says.

    finding bad_checksum on /bus/1/read_speed/reply      refutes   "Replies check."                about the drive
    finding bad_checksum on /bus/1/read_speed/request    refutes   "Requests check."               about the host
    finding junk_noise                                   refutes   "Every byte belongs to a frame."  about the wire

Nothing is judged anew here: a rule of `analyzer.findings` is a row of `ROWS`, with what it says and of whom. So any
recording can be judged, and what the suite sends itself is judged by the same words.

Rules kept here:
- A claim is confirmed where traffic that could have refuted it was seen; where there was none it was not run.
- What the manual leaves to the drive (that it refuses) or says nothing of is open: observed, never refuted.
- Who is to blame is told by who sent the frame; bytes that are no frame, and trouble of the recording, are the wire's.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from analyzer.catalogue import Certainty, Dialect, Role
from analyzer.entries import Entry
from analyzer.findings import RULES
from analyzer.records import Comment, Finding, Junk, Message

#: Findings of each claim that are kept to be shown.
FIRST_FEW = 3
_CERTAIN, _LIKELY, _OPEN = Certainty.CERTAIN, Certainty.LIKELY, Certainty.OPEN


class Party(StrEnum):
    """Whom a claim is about."""

    DRIVE = "drive"
    HOST = "host"
    WIRE = "wire"


class Seen(StrEnum):
    """Traffic that a claim needs, so that something could have refuted it."""

    FRAMES = "frames"
    REQUESTS = "requests"
    REPLIES = "replies"
    BROADCASTS = "broadcasts"
    PACKAGES = "packages"
    MODBUS = "Modbus frames"
    CAN = "CAN frames"
    NOTHING = "nothing"


@dataclass(frozen=True)
class Row:
    """A rule as a claim. `side`: the sender of its frames, None: either; `needs`: what must have been seen."""

    name: str
    rule: str
    about: Party
    statement: str
    certainty: Certainty = _CERTAIN
    needs: Seen = Seen.FRAMES
    side: Role | None = None


_BY_SIDE = (
    # name, rule, statement of requests, statement of replies
    ("checks", "bad_checksum", "Requests check.", "Replies check."),
    ("lengths", "wrong_length", "Requests have the length of their command.", "Replies have the length of their command."),
    ("ranges", "out_of_range", "Requests hold values within their ranges.", "Replies hold values within their ranges."),
    ("choices", "unknown_choice", "Requests hold values that are listed.", "Replies hold values that are listed."),
    ("reserved", "reserved_bits", "Reserved bits of requests are 0.", "Reserved bits of replies are 0."),
)


def _sided() -> tuple[Row, ...]:
    rows = []
    for name, rule, asked, told in _BY_SIDE:
        rows.append(Row(f"reply_{name}", rule, Party.DRIVE, told, needs=Seen.REPLIES, side=Role.REPLY))
        rows.append(Row(f"request_{name}", rule, Party.HOST, asked, needs=Seen.REQUESTS, side=Role.REQUEST))
    return tuple(rows)


_D, _H, _W = Party.DRIVE, Party.HOST, Party.WIRE
ROWS: tuple[Row, ...] = (
    *_sided(),
    # What a drive answers
    Row("answered", "unanswered", _D, "Every request to one drive is answered.", needs=Seen.REQUESTS),
    Row("in_time", "late_reply", _D, "Replies come within the limit.", _LIKELY, Seen.REPLIES),
    Row("asked_for", "unsolicited_reply", _D, "Nothing is answered that was not asked.", _LIKELY, Seen.REPLIES),
    Row("once", "duplicate_reply", _D, "A request is answered once.", _LIKELY, Seen.REPLIES),
    Row("broadcast", "answered_broadcast", _D, "What is meant for several drives is not answered.", needs=Seen.BROADCASTS),
    Row("done", "failed_status", _D, "What is asked is done.", _OPEN, Seen.REPLIES),
    Row("exceptions", "modbus_exception", _D, "No request calls for an exception.", _OPEN, Seen.MODBUS),
    Row("writes", "refused_write", _D, "Writes are not refused.", _OPEN, Seen.MODBUS),
    Row("silent", "silent_address", _D, "Motion commands are answered: respond is on, and the address no group's.", _OPEN,
        Seen.REQUESTS),
    # What a host asks
    Row("codes", "unknown_command", _H, "Frames have codes that the manual lists.", _LIKELY),
    Row("packages", "short_package", _H, "Packages have 52 bytes.", needs=Seen.PACKAGES),
    Row("dialect", "other_dialect", _H, "A drive is asked in the dialect that it speaks."),
    # The wire, and the recording of it
    Row("noise", "junk_noise", _W, "Every byte belongs to a frame.", _LIKELY, Seen.NOTHING),
    Row("truncated", "junk_truncated", _W, "Frames do not break off.", _LIKELY, Seen.NOTHING),
    Row("collisions", "junk_collision", _W, "No two senders send at once.", _LIKELY, Seen.NOTHING),
    Row("echo", "host_echo", _W, "The host does not hear itself.", _OPEN, Seen.REQUESTS),
    Row("error_frames", "can_error_frame", _W, "There are no error frames.", _LIKELY, Seen.CAN),
    Row("foreign_frames", "foreign_can_frame", _W, "All frames are of CAN 2.0A and of the dialect.", _LIKELY, Seen.CAN),
    Row("bus_errors", "bus_error", _W, "The CAN controller stays on the bus.", _LIKELY, Seen.CAN),
    Row("port_lost", "port_lost", _W, "The port stays.", _OPEN, Seen.NOTHING),
    Row("port_back", "port_back", _W, "The port is not taken up again.", _OPEN, Seen.NOTHING),
    Row("overruns", "overrun", _W, "The serial driver loses nothing.", _OPEN, Seen.NOTHING),
    Row("dropped", "dropped", _W, "All that came is in the log.", _OPEN, Seen.NOTHING),
    Row("clock", "clock_step", _W, "The wall clock is not set.", _OPEN, Seen.NOTHING),
    Row("restarted", "restarted", _W, "The recording goes on by itself.", _OPEN, Seen.NOTHING),
    Row("stalled", "log_stalled", _W, "The log can be written.", _OPEN, Seen.NOTHING),
    Row("spool", "spool_damaged", _W, "What was stored can be read.", _OPEN, Seen.NOTHING),
    Row("decoder", "decoder_fault", _W, "The decoder does not fail.", _OPEN, Seen.NOTHING),
)  # fmt: skip

#: Rules of what a frame holds.
_OF_CONTENT = frozenset(rule for _, rule, *_ in _BY_SIDE if rule != "bad_checksum")

_BY_RULE: Mapping[str, tuple[Row, ...]] = {
    rule: tuple(row for row in ROWS if row.rule == rule) for rule in dict.fromkeys(row.rule for row in ROWS)
}


def row_of(found: Finding) -> Row:
    """Return the row of a finding: by its rule and, where that tells, by who sent the frame.

    A rule that is not in the table is open and about the wire.
    """
    rows = _BY_RULE.get(found.rule, ())
    side = found.topic.rpartition("/")[2]
    for row in rows:
        if row.side is None or row.side == side:
            return row
    if rows:
        # Who sent it is not known: a host asks first, so it is taken for a request.
        return rows[-1]
    meaning = RULES[found.rule].meaning if found.rule in RULES else found.rule
    return Row(found.rule, found.rule, Party.WIRE, f"There is none of: {meaning}.", _OPEN, Seen.NOTHING)


# --- judging ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Example:
    """One finding to be shown. `data`: the frame's bytes, empty where it is about none or was not at hand."""

    finding: Finding
    data: bytes = b""


@dataclass
class Count:
    """What was found against a row in one dialect: how often, by address, and the first few."""

    row: Row
    dialect: str
    found: int = 0
    addresses: Counter[int] = field(default_factory=Counter)
    examples: list[Example] = field(default_factory=list)

    def add(self, example: Example, most: int) -> None:
        """Count a finding, and keep it while there are fewer than `most`."""
        self.found += 1
        if example.finding.address is not None:
            self.addresses[example.finding.address] += 1
        if len(self.examples) < most:
            self.examples.append(example)


class Judge:
    """A sink of the analyzer's pipeline that counts findings by claim, and the traffic that could have broken one.

    `dialects`: those of the traffic; the first stands for what cannot be told. `groups`: addresses of several drives.
    `first_few`: findings of each claim that are kept.
    """

    def __init__(self, dialects: Iterable[Dialect], groups: Iterable[int] = (), *, first_few: int = FIRST_FEW) -> None:
        self.first_few = first_few
        #: When the traffic begins.
        self.first_ns = 0
        self._begun = False
        self.dialects = {d.name: d for d in dialects}
        self._groups = frozenset(groups)
        self.seen: dict[str, Counter[Seen]] = {name: Counter() for name in self.dialects}
        #: Frames of nodes that are no drives, and those of such nodes that something describes: bus and address.
        self.foreign = 0
        self._described: set[tuple[str, int | None]] = set()
        self._counts: dict[tuple[str, str], Count] = {}
        self._spoken: dict[tuple[str, int | None], str] = {}
        self._last: Entry | None = None
        self._last_junk: Junk | None = None

    # --- the sink -------------------------------------------------------------------------------------------------

    def entry(self, entry: Entry) -> None:
        """Count a frame."""
        message = entry.message
        frame = message.frame
        if message.role is Role.FOREIGN or not frame.dialect.of_drives:
            self.foreign += 1
            if not frame.dialect.of_drives:
                self._described.add((frame.port, message.address))
            return
        name = frame.dialect.name
        self._spoken[frame.port, message.address] = self._spoken[frame.port, None] = name
        self._last = entry
        self._begin(frame.first_ns)
        seen = self.seen.setdefault(name, Counter())
        seen[Seen.FRAMES] += 1
        if message.role is not Role.UNKNOWN:
            seen[Seen.REQUESTS if message.role is Role.REQUEST else Seen.REPLIES] += 1
        if message.role is Role.REQUEST and self._to_many(message, frame.dialect):
            seen[Seen.BROADCASTS] += 1
        if message.command is not None and message.command.slots is not None:
            seen[Seen.PACKAGES] += 1
        if frame.dialect.fallbacks:
            seen[Seen.MODBUS] += 1
        if frame.can is not None:
            seen[Seen.CAN] += 1

    def _to_many(self, message: Message, dialect: Dialect) -> bool:
        command = message.command
        if command is not None and command.name == "set_group_address":
            self._groups |= {v for v in message.values.values() if isinstance(v, int)}
        return (
            message.address == dialect.broadcast
            or message.address in self._groups
            or (command is not None and command.slots is not None)
        )

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        """Keep the bytes for the finding that follows."""
        self._last_junk = junk
        self._begin(junk.first_ns)

    def _begin(self, t_ns: int) -> None:
        if not self._begun:
            self._begun, self.first_ns = True, t_ns

    def finding(self, found: Finding) -> None:
        """Count a finding about drives."""
        node = found.port, found.address
        if node in self._described and node not in self._spoken:
            return
        if self._is_damaged(found):
            return
        row = row_of(found)
        name = self._dialect_of(found)
        count = self._counts.setdefault((name, row.name), Count(row, name))
        count.add(Example(found, self._bytes_of(found)), self.first_few)

    def _is_damaged(self, found: Finding) -> bool:
        """Say whether a finding is about what a damaged frame holds: its sender may have said something else."""
        last = self._last
        if last is None or last.sequence != found.sequence or found.rule not in _OF_CONTENT:
            return False
        return not last.message.frame.checksum_ok

    def comment(self, comment: Comment) -> None:
        """Do nothing: a comment is no traffic."""

    def _dialect_of(self, found: Finding) -> str:
        spoken = self._spoken
        known = spoken.get((found.port, found.address)) or spoken.get((found.port, None))
        return known or next(iter(self.dialects), "")

    def _bytes_of(self, found: Finding) -> bytes:
        last, junk = self._last, self._last_junk
        if last is not None and last.sequence == found.sequence:
            return last.message.frame.data
        if junk is not None and junk.offset == found.offset and found.topic.endswith("/junk"):
            return junk.data
        return b""

    # --- what came of it ------------------------------------------------------------------------------------------

    def counts(self) -> list[Count]:
        """Return what was found against each row in each dialect, rows in their order; those without a finding too."""
        result = []
        for name in self.dialects:
            for row in ROWS:
                result.append(self._counts.get((name, row.name)) or Count(row, name))
            result += [c for (d, _), c in self._counts.items() if d == name and c.row not in ROWS]
        return result

    def ran(self, count: Count) -> bool:
        """Say whether traffic was seen that could have broken a row."""
        needs = count.row.needs
        return bool(count.found) or needs is Seen.NOTHING or self.seen[count.dialect][needs] > 0
