"""What a diagnosis looks at: one bus with what the pipeline made of its bytes, and the troubles on it."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from itertools import pairwise

import msgspec
from msgspec.structs import replace

from analyzer.catalogue import Dialect, Risk, Role
from analyzer.diagnosis.reader import Reader
from analyzer.link import READS, WRITE_MANY, read_bytes
from analyzer.records import CanFrame, Finding, Message


class Confidence(StrEnum):
    """How sure a cause is."""

    CERTAIN = "certain"
    LIKELY = "likely"
    POSSIBLE = "possible"


class Piece(msgspec.Struct, frozen=True, eq=False):
    """Bytes and what they were taken for. `message` None: junk. `asked_by`: the number of the request that it answers."""

    offset: int
    data: bytes
    t_ns: int
    sequence: int
    message: Message | None
    asked_by: int | None = None
    rules: frozenset[str] = frozenset()

    @property
    def stop(self) -> int:
        """Where the bytes end on the bus."""
        return self.offset + len(self.data)

    @property
    def can(self) -> CanFrame | None:
        """The CAN frame, if it is one."""
        return None if self.message is None else self.message.frame.can

    @property
    def is_request(self) -> bool:
        """Whether it is a known request."""
        return self.message is not None and self.message.role is Role.REQUEST

    @property
    def is_reply(self) -> bool:
        """Whether it is a known reply."""
        return self.message is not None and self.message.role is Role.REPLY

    @property
    def sound(self) -> bool:
        """Whether it is a frame with nothing wrong in its bytes; of a standard function, the register may be unknown."""
        message = self.message
        if message is None:
            return False
        damaged = self.rules & DAMAGED
        if not damaged or damaged != {"unknown_command"} or not message.frame.checksum_ok:
            return not damaged
        return any(command is message.command for command in message.frame.dialect.fallbacks.values())

    @property
    def answered(self) -> bool:
        """Whether it is a request without a finding that no reply came."""
        return self.is_request and "unanswered" not in self.rules


class Read(msgspec.Struct, frozen=True):
    """Bytes that came at once: a line of a log, a read of a port. `firm`: the capture itself says where it ends."""

    offset: int
    stop: int
    t_ns: int | None
    direction: Role
    firm: bool


class Stretch(msgspec.Struct, frozen=True, eq=False):
    """Bytes in a row within the limits of a read; those of a trouble are damaged, and end at sound frames too.

    `opens`, `ends`: it begins or ends where a read does; so what stands there is all that was sent.
    """

    offset: int
    data: bytes
    t_ns: int
    direction: Role
    opens: bool
    ends: bool
    pieces: tuple[Piece, ...]

    @property
    def stop(self) -> int:
        """Where it ends on the bus."""
        return self.offset + len(self.data)

    @property
    def checked(self) -> bool:
        """Whether it is frames whose checks fit: then no line and no second sender has changed their bytes."""
        return all(piece.message is not None and piece.message.frame.checksum_ok for piece in self.pieces)

    @property
    def can_id(self) -> int | None:
        """The identifier of the CAN frame that it is."""
        can = self.pieces[0].can
        return None if can is None else can.id


class Trouble(msgspec.Struct, frozen=True, eq=False):
    """One thing that is wrong: `rule` of the findings, or `damaged` for a stretch."""

    rule: str
    offset: int
    stretch: Stretch | None = None
    piece: Piece | None = None


class Shown(msgspec.Struct, frozen=True):
    """A frame that a cause is about. `right`: what it should be, as hex text; empty where it is not known."""

    offset: int
    data: str
    right: str = ""


class Suspicion(msgspec.Struct, frozen=True):
    """A cause, with what it explains. `by_words`: words say it, where the bytes show causes, which come first."""

    cause: str
    confidence: Confidence
    troubles: Sequence[Trouble]
    say: str
    evidence: str
    next: str
    frames: tuple[Shown, ...] = ()
    by_words: bool = False


#: Rules of findings that say that the bytes of a frame are not as the manual has them.
DAMAGED = frozenset(("bad_checksum", "unknown_command", "wrong_length", "short_package", "foreign_can_frame"))
#: Rules of findings that no reply came.
SILENT = frozenset(("unanswered", "silent_address"))
#: Rules of findings of a read that a drive refuses.
_OF_REFUSAL = frozenset(("failed_status", "out_of_range", "unknown_choice"))
#: Rules of findings that are a trouble by themselves, apart from damaged bytes.
_TROUBLE = frozenset(
    ("unanswered", "silent_address", "unsolicited_reply", "duplicate_reply", "late_reply", "failed_status", "modbus_exception",
     "refused_write", "host_echo", "other_dialect", "can_error_frame", "out_of_range", "unknown_choice")
)  # fmt: skip


@dataclass(eq=False)
class Scene:
    """One bus: its pieces near trouble in their order, the limits of its reads, and what is found wrong.

    `frames`: all that came by, kept or not. `timed`: the capture has times. `noted`: the bytes stand among words, and these
    neither ask nor say that anything is wrong. `words`: the first of them. `lost`: findings that are left out, since the reader
    of the capture has lost bytes there. `uarts`: how bytes stand on the line, as `8E1` or `8N1 read as 8E1`, where
    levels tell. `explained`: the troubles that are suspected so far; `certain`: how many of them a certain cause explains.
    """

    bus: str
    dialects: tuple[Dialect, ...]
    pieces: Sequence[Piece]
    reads: Sequence[Read]
    findings: Sequence[Finding]
    frames: int
    timed: bool
    noted: bool = False
    words: tuple[str, ...] = ()
    lost: int = 0
    uarts: frozenset[str] = frozenset()
    explained: set[Trouble] = field(default_factory=set)
    certain: int = 0

    @cached_property
    def reader(self) -> Reader:
        """What reads bytes in all dialects of this kind of bus."""
        return Reader.of_bus("can" if any(p.can is not None for p in self.pieces) else "serial")

    @cached_property
    def directed(self) -> bool:
        """Whether the capture says who sent what."""
        return any(read.direction is not Role.UNKNOWN for read in self.reads)

    @cached_property
    def shows_sent(self) -> bool:
        """Whether the capture says of any bytes that they were sent."""
        return any(read.direction is Role.REQUEST for read in self.reads)

    @cached_property
    def limits(self) -> frozenset[int]:
        """Where the capture says that a sending begins or ends."""
        found: set[int] = set()
        before: Read | None = None
        for read in self.reads:
            pause = before is None or before.stop != read.offset or before.direction is not read.direction
            if before is not None and before.t_ns is not None and read.t_ns is not None:
                pause |= read.t_ns - before.t_ns > PAUSE_NS + SLOW_BYTE_NS * (read.stop - read.offset)
            if pause or read.firm or (before is not None and before.firm):
                found.add(read.offset)
            before = read
        if before is not None:
            found.add(before.stop)
        return frozenset(found)

    @cached_property
    def _limits(self) -> list[int]:
        return sorted(self.limits)

    @cached_property
    def replies(self) -> dict[int, list[Piece]]:
        """The replies to each request, by its number."""
        found: dict[int, list[Piece]] = {}
        for piece in self.pieces:
            if piece.asked_by is not None:
                found.setdefault(piece.asked_by, []).append(piece)
        return found

    @cached_property
    def behind(self) -> dict[int, Piece]:
        """The piece that comes next after each, by the number of that."""
        return {one.sequence: other for one, other in pairwise(self.pieces)}

    def direction(self, offset: int) -> Role:
        """Return who sent the byte at an offset, as the capture says."""
        at = bisect_right(self._starts, offset) - 1
        read = self.reads[at] if at >= 0 else None
        return read.direction if read is not None and offset < read.stop else Role.UNKNOWN

    @cached_property
    def _starts(self) -> list[int]:
        return [read.offset for read in self.reads]

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """All damaged bytes."""
        return tuple(self._stretches())

    @cached_property
    def requests(self) -> list[Piece]:
        """All sound requests."""
        return [piece for piece in self.pieces if piece.is_request and piece.sound]

    def asked_before(self, offset: int) -> Piece | None:
        """Return the last sound request before a place on the bus."""
        at = bisect_left(self.requests, offset, key=lambda piece: piece.offset)
        return self.requests[at - 1] if at else None

    @cached_property
    def bursts(self) -> tuple[Stretch, ...]:
        """All bytes, damaged or not, between the limits of what was sent at once."""
        return tuple(self._runs(lambda piece: False))

    @cached_property
    def ending(self) -> dict[int, Stretch]:
        """What was sent at once, by where it ends."""
        return {burst.stop: burst for burst in self.bursts}

    def _stretches(self) -> Iterator[Stretch]:
        # A recording that knows no pause, and has no sound frame: the frames of the catalogue tell where others end.
        unbroken = len(self.reads) == 1 and not self.reads[0].firm and not any(piece.sound for piece in self.pieces)
        for stretch in self._runs(lambda piece: piece.sound):
            stops = self.reader.laid(stretch.data) if unbroken and len(stretch.data) <= _LONG else []
            if len(stops) < _LAID:
                yield stretch
                continue
            for at, stop in pairwise((0, *stops)):
                inside = tuple(p for p in stretch.pieces if p.offset < stretch.offset + stop and p.stop > stretch.offset + at)
                yield replace(
                    stretch, offset=stretch.offset + at, data=stretch.data[at:stop], opens=True, ends=True, pieces=inside
                )

    def _runs(self, left_out: Callable[[Piece], bool]) -> Iterator[Stretch]:
        """Yield pieces in a row, between those that are left out and the limits of reads."""
        run: list[Piece] = []
        for piece in self.pieces:
            out = left_out(piece)
            if run and (piece.offset != run[-1].stop or piece.offset in self.limits or piece.can is not None or out):
                yield from self._cut(run)
                run = []
            if not out:
                run.append(piece)
        if run:
            yield from self._cut(run)

    def _cut(self, run: list[Piece]) -> Iterator[Stretch]:
        """Yield the stretches of pieces in a row: a piece of junk can reach over the limits of reads."""
        first, last = run[0].offset, run[-1].stop
        data = b"".join(piece.data for piece in run)
        if run[0].can is not None:
            yield Stretch(first, data, run[0].t_ns, run[0].can.direction, True, True, tuple(run))
            return
        at = first
        for stop in (*self._limits[bisect_right(self._limits, first) : bisect_left(self._limits, last)], last):
            inside = tuple(p for p in run if p.offset < stop and p.stop > at)
            part = data[at - first : stop - first]
            yield Stretch(at, part, inside[0].t_ns, self.direction(at), at in self.limits, stop in self.limits, inside)
            at = stop

    @cached_property
    def troubles(self) -> tuple[Trouble, ...]:
        """All that is wrong, each once: what only follows from another is left out."""
        stretches = [stretch for stretch in self.stretches if not self._is_body(stretch)]
        # A log leaves out the CRC of each request; one that stays unanswered among them says nothing of it.
        sent = [stretch for stretch in stretches if stretch.direction is Role.REQUEST]
        if sent and all(map(self._was_answered, sent)):
            stretches = [stretch for stretch in stretches if stretch not in sent]
        damaged = [Trouble("damaged", s.offset, s) for s in stretches]
        by_sequence = {piece.sequence: piece for piece in self.pieces}
        following = self._followed()
        # A capture of one side alone shows what it shows.
        asked = any(piece.is_request for piece in self.pieces)
        others = []
        for found in self.findings:
            piece = by_sequence.get(found.sequence)
            if found.rule not in _TROUBLE or (piece is not None and not piece.sound):
                continue
            if not asked and found.rule in ("unsolicited_reply", "duplicate_reply"):
                continue
            if piece is not None and (piece.asked_by or piece.sequence) in self._refused_reads and found.rule in _OF_REFUSAL:
                continue
            # A request is unanswered where its reply came damaged.
            if found.rule in ("unanswered", "silent_address") and found.sequence in following:
                continue
            others.append(Trouble(found.rule, found.offset, None, piece))
        return (*damaged, *others)

    @cached_property
    def _refused_reads(self) -> frozenset[int]:
        """The reads that a drive has answered with a refusal, and that were not sent again: so a host asks what there is."""
        refused = {p.asked_by for p in self.pieces if p.sound and "failed_status" in p.rules}
        often = Counter(piece.data for piece in self.requests)
        return frozenset(
            piece.sequence
            for piece in self.requests
            if piece.sequence in refused and often[piece.data] == 1 and piece.message is not None
            and piece.message.command is not None and piece.message.command.all_risks == {Risk.READ}
        )  # fmt: skip

    def _is_body(self, stretch: Stretch) -> bool:
        """Say whether bytes are those of the frame right behind them without its check, or what a request carries.

        Programs print both.
        """
        if stretch.opens and stretch.ends and stretch.data in self._carried:
            return True
        at = bisect_left(self.pieces, stretch.stop, key=lambda piece: piece.offset)
        whole = self.pieces[at] if stretch.opens and stretch.ends and at < len(self.pieces) else None
        return whole is not None and _body(whole) == stretch.data

    def _was_answered(self, stretch: Stretch) -> bool:
        """Say whether a request of Modbus stands without its CRC, and its reply behind it: the unit has seen a CRC.

        A glitch may stand before the reply.
        """
        at = bisect_left(self.pieces, stretch.stop, key=lambda piece: piece.offset)
        near = [piece for piece in self.pieces[at : at + 2] if piece.is_reply]
        return stretch.opens and stretch.ends and any(_answers(_body(piece), stretch.data) for piece in near)

    @cached_property
    def _carried(self) -> frozenset[bytes]:
        """What requests of Modbus have between address and CRC, where words stand beside them."""
        requests = (p.data for p in self.requests if p.can is None and len(p.data) >= _CARRIES) if self.words else ()
        return frozenset(data[1:-2] for data in requests)

    def _followed(self) -> frozenset[int]:
        """Return the numbers of the requests behind which damaged bytes come before anything else."""
        starts = {s.offset: s for s in self.stretches}
        return frozenset(
            piece.sequence
            for piece in self.pieces
            if piece.is_request and piece.stop in starts and starts[piece.stop].direction is not Role.REQUEST
        )

    @cached_property
    def repeated(self) -> list[Trouble]:
        """The requests that were taken for an echo, and come too late for one: they were sent again."""
        return [
            trouble
            for trouble in self.of("host_echo")
            # What the capture shows as received came back, however late a library has read it.
            if trouble.piece is not None and self.timed
            and not (self.shows_sent and self.direction(trouble.offset) is Role.REPLY)
            and (asked := self._before(trouble.piece)) is not None
            and trouble.piece.t_ns - asked.t_ns > _ECHO_NS
        ]  # fmt: skip

    def _before(self, piece: Piece) -> Piece | None:
        return next((p for p in reversed(self.pieces) if p.sequence < piece.sequence and p.data == piece.data), None)

    @cached_property
    def listed(self) -> bool:
        """Whether the requests are a list, of a program or in notes: nothing says that they were sent and waited for."""
        sent = [piece.data for piece in self.pieces if piece.is_request]
        heard = any(read.direction is Role.REPLY for read in self.reads)
        return self.noted and not self.timed and not heard and len(set(sent)) == len(sent)

    @cached_property
    def program(self) -> bool:
        """Whether the bytes stand in the text of a program: nothing shows that they were sent, or that they are whole."""
        if not self.noted or self.timed or any(p.can is not None or (p.is_reply and p.sound) for p in self.pieces):
            return False
        # The name of an array may say "read". Bytes that are no request came back.
        if any(b.direction is Role.REPLY and not (b.pieces[0].is_request or self.reader.bare(b.data)) for b in self.bursts):
            return False
        if max(Counter(burst.data for burst in self.bursts).values(), default=0) >= _SENT_AGAIN:
            return False
        lines = [line for text in self.words for line in text.splitlines() if not _REMARK.search(line)]
        return 2 * sum(_CODE.search(line) is not None for line in lines) >= len(lines) > 0

    def often(self, count: int, role: Role) -> bool:
        """Say whether what happened to so many frames of a sender is no chance: often, or to the only one."""
        roles = (role,) if role in (Role.REQUEST, Role.REPLY) else tuple(Role)
        others = sum(piece.sound and piece.message is not None and piece.message.role in roles for piece in self.pieces)
        return (count > 1 and count >= _OFTEN * others) or (count == 1 and others <= 1)

    def of(self, *rules: str) -> list[Trouble]:
        """Return the troubles of some rules."""
        return [trouble for trouble in self.troubles if trouble.rule in rules]

    @cached_property
    def damaged(self) -> list[Trouble]:
        """The troubles that are damaged bytes, as far as they can be one frame; of very many the first."""
        found = [trouble for trouble in self.of("damaged") if len(trouble.stretch.data if trouble.stretch else b"") <= _LONG]
        return found[:_MOST_DAMAGED]

    @cached_property
    def spoiled(self) -> list[Trouble]:
        """The damaged bytes of a serial line that are no frames whose checks fit: what a line or a sender can have changed."""
        return [t for t in self.damaged if t.stretch is not None and t.stretch.can_id is None and not t.stretch.checked]


def _body(piece: Piece) -> bytes:
    """Return a sound frame of a serial bus without its check; of all else nothing."""
    if not piece.sound or piece.can is not None or piece.message is None:
        return b""
    return piece.data[: -len(piece.message.frame.dialect.link.checks(piece.data)[-1].expected)]


def _answers(reply: bytes, request: bytes) -> bool:
    """Say whether a reply of Modbus is that to a request, both without their CRC."""
    asked = request[:_ASKED]
    if len(asked) < _ASKED or reply[:2] != asked[:2]:
        return False
    if asked[1] in READS:
        return request == asked and reply[2] == len(reply) - 3 == read_bytes(asked[1], int.from_bytes(asked[4:], "big"))
    return reply == asked and (asked == request or asked[1] in WRITE_MANY)


#: Lines of programs, in C, Python, JavaScript and their like: how they begin, what they call, and how they end; and remarks.
_CODE = re.compile(
    r"^\s*(?:line \d+, column \d+: *)?(?:#include\b|#define\b|def \w+\(|class \w+|import \w+$|from \w+ import\b|assert\b"
    r"|return\b|print\(|(?:const|let|var|static|void|u?int\d*(?:_t)?|byte|char)\s+\w+[\s\[(=]|\w+\s*=\s*\(*[A-Za-z_][\w.]*[.(])"
    r"|\w\([^()]*\)\s*[;{]|[;{}]\s*$"
)
_REMARK = re.compile(
    r"^\s*(?:line \d+, column \d+: *)?(?://|/\*|#(?!include|define)|\"\"\"|$"
    # A log puts its bytes in braces behind a word.
    r"|[^\W\d_]\w*:\s*\{[^{};]*\}\s*$)"
)
#: A program has no array three times.
_SENT_AGAIN = 3
#: The shortest request of Modbus that carries something; what all of them have before a CRC or values.
_CARRIES, _ASKED = 8, 6
#: Frames in a row that are no chance.
_LAID = 3
#: No frame of any dialect is longer, and more stretches show nothing new.
_LONG = 300
_MOST_DAMAGED = 1000
#: The share of a sender's frames from which on something is no chance.
_OFTEN = 0.2
#: A longer pause in a capture with times ends what was sent; slow lines and adapters hold bytes back.
PAUSE_NS = 8_000_000
SLOW_BYTE_NS = 1_041_667
#: An echo comes while the request is still on the line, and adapters hold it back for less than this.
_ECHO_NS = 150_000_000


def shown(data: bytes, can_id: int | None = None) -> str:
    """Return bytes as people write them."""
    text = data.hex(" ").upper()
    return text if can_id is None else f"{can_id:03X} {text}"


def whole(piece: Piece | None) -> str:
    """Return a piece as it is shown, with the identifier of its CAN frame."""
    return "" if piece is None else shown(piece.data, None if piece.can is None else piece.can.id)
