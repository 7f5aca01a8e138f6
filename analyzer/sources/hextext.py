"""Hex text: logs of serial traffic as people have them, a line of hex bytes after the other (see `hexline.py`).

Rules:

- Each line of traffic is a burst of its own. Lines of bytes below a header (a line with only a time or a mark) are one burst.
- `Tx`, `Send` and `>` mean that the host sent; `Rx`, `Recv` and `<` mean that the drive did. A listener marks every line as
  received: in its log the marks mean nothing.
- Lines of words are comments, and broken lines are problems.
- Prose is read too: the frames in its sentences (see `prose.py`), frames written one field a line, and rows of dumps.
  If such bytes have no mark, the words above them say who sent them.
- `Manner` (`hexmanner.py`) decides from all lines together: whether `>` is a quotation, whether numbers are decimal, whether
  each line is one byte, and whether `->` only separates time and text. Each such guess is a note.

Times: see `stamps.py`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

import msgspec

from analyzer.catalogue import Role
from analyzer.diagnosis.reports import speaks
from analyzer.link import modbus_crc
from analyzer.records import Chunk, Comment
from analyzer.sources.hexfields import ROWS, Parts, has_fields, is_frame
from analyzer.sources.hexknown import Known, stands_before
from analyzer.sources.hexline import HexLine, Shape, bytes_of, take_apart
from analyzer.sources.hexmanner import SINGLE, Manner, is_decimal_column, is_single, is_table, says
from analyzer.sources.lines import Lines, head_lines
from analyzer.sources.marks import ReceivedMarks
from analyzer.sources.prose import Quotation, mentions, quotations, role_in_text, spells_frame, unsent
from analyzer.sources.source import Source, quote
from analyzer.sources.stamps import StampClock
from analyzer.sources.written import Radix
from analyzer.values import counted

#: What a program notes beside bytes whose check failed.
_JUDGED = re.compile(r"\berr(?:or)?\s*[=:]\s*\w*(?:crc|checksum)\w*", re.IGNORECASE)
#: A call with a number, which tells what the bytes behind it are to say.
_CALLED = re.compile(r"\b[A-Za-z_]\w*\(\d{2,}\)\s*$")
#: Lines of a head that are looked at to find the format.
_SAMPLE_LINES = 400
#: Traffic lines, as a share of all, below which a text is no log.
_LEAST_SHARE = 0.2
_LEAST_MARKED_SHARE = 0.05
_MARKED_LINES = 3
#: How sure a text is whose sentences speak of frames.
_PROSE_SCORE = 0.35
#: Bytes from which on a line of a text that is no log counts.
_SAID_BYTES, _PADDED_BYTES = 3, 5
#: The least byte of two digits.
_TWO_DIGITS = 0x10
_REMARKS = ("#", "//", ";")
_OPEN = ("{", "[", "(", ",")
_LIST_ITEMS = r"(?:(?:0[xX])?[0-9A-Fa-f]{1,3}(?![0-9A-Fa-f])\s*+,?\s*+)*+"
_LIST = re.compile(
    rf"(?:[=(:]|\w\(\d+\))\s*+(?:new\s+\w+\[\d*\]\s*+|bytes\(|bytearray\(|Buffer\.from\()?[\[{{]\s*+{_LIST_ITEMS}$"
)
_GOES_ON = re.compile(rf"\s*+{_LIST_ITEMS}(?:[\]}})][\]}});,\s]*)?(?:(?://|#|/\*).*)?")
#: What libmodbus prints of a long reply, and where a console has wrapped it.
_LONG_LINE = re.compile(r"(?:<[0-9A-F]{2}>){24,}\s*", re.IGNORECASE)
_WRAPPED = re.compile(r"(?:<[0-9A-F]{2}>)+\s*", re.IGNORECASE)
#: What separates a label from its bytes. In a sentence nothing does.
_LABELLED = re.compile(r"[:=>|]\s*[\[({<'\"`]?\s*$")
#: Frames of a line whose columns a note names.
_COLUMNS_SHOWN = 10
_SPOILT = re.compile(r"[\s,:-]{0,2}(?:0x\w{1,2}|\d\w?|\w\d)\b")
_WORDS = re.compile(r"(?<!\d)[^\W\d_]{3,}")
_LABEL = re.compile(r"data|bytes?|hex|frame|buffer|message|msg|payload|raw", re.IGNORECASE)
#: Characters of a line in which a library reports.
_LONGEST_REPORT = 400
#: Frames of one line; each is looked for in all that stands behind the one before.
_PIECES = 50
#: A header's lines are collected up to this many bytes.
_COLLECTED = 1 << 16
_AT_ONCE_NS = 1_000_000_000
#: Digits without a gap.
_RUN_OF_DIGITS = re.compile(r"\s*[0-9A-F]{5,}\s*")
#: How many bytes a line has: nothing to tell anyone.
_COUNTED = re.compile(r"\(?\s*(?:len\w*\s*[=:]?\s*)?\d+\s*(?:bytes?|B)?\s*\)?(?:\s*=\s*\d+)?", re.IGNORECASE)
_DUMPED = re.compile(r"\s*\|?\s*[0-9A-Fa-f]{4,8}:?\s\s?[0-9A-Fa-f]{2}")
_HEX_LETTER = re.compile(r"[A-Fa-f]|0x|\\x")
_BUS_NAME = re.compile(r"(?:bus|com|port|can|tty|uart|usart|rs-?485|rs-?232|usb|serial|line|ch|channel|axis)\W?\w*", re.I)
#: A name as this program exports it: a bus, and not a number of one.
_EXPORTED_NAME = re.compile(r"bus:(?!\d+$)([\w.-]+)")


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are hex text, 0..1."""
    lines = list(_whole_lists(head_lines(head)[:_SAMPLE_LINES]))
    if is_single(lines):
        return 0.4 if any(_HEX_LETTER.search(line) for line in lines) or is_decimal_column(lines) else 0.1
    parts = [take_apart(line) for line in lines]
    traffic = [p for p in parts if p.shape is Shape.TRAFFIC]
    counted = sum(1 for p in parts if p.shape is not Shape.COMMENT or not p.text.startswith(("#", "//", ";")))
    plain = any(
        (len(p.data) >= _SAID_BYTES and (p.marked or _HEX_LETTER.search(p.data.hex())))
        or (p.data[:1] < b"\n" and _is_padded(p))
        or spells_frame(p.data)
        for p in traffic
    )
    said = _PROSE_SCORE if plain or says(parts) or has_fields(lines) else _reported(lines)
    if not traffic or not counted:
        return said
    ratio = len(traffic) / counted
    marked = sum(1 for p in traffic if p.marked and len(p.data) > 1)
    # Rows of decimal numbers pass for hex; real traffic is not free of letters for long.
    letters = any(_HEX_LETTER.search(p.data.hex()) for p in traffic) or "0x" in "".join(lines)
    letters = letters or any(p.sign.startswith("each") or spells_frame(p.data) or _is_padded(p) for p in traffic)
    letters = letters or any(len(p.data) > _SAID_BYTES and (modbus_crc(p.data) == 0 or _is_tcp(p.data)) for p in traffic)
    if not letters and not marked and sum(len(p.data) for p in traffic) > 4:
        return max(0.1, _reported(lines))
    if not marked and is_table([p for p in traffic if p.radix is Radix.DECIMAL]):
        return max(0.1, _reported(lines))
    if ratio >= _LEAST_SHARE or (marked >= _MARKED_LINES and ratio >= _LEAST_MARKED_SHARE):
        return 0.4 + 0.5 * min(1.0, ratio)
    return max(said, 0.25 * ratio / _LEAST_SHARE)


def _is_padded(line: HexLine) -> bool:
    """Say whether bytes keep their zeros; numbers of people have none before them."""
    return len(line.data) >= _PADDED_BYTES and min(line.data) < _TWO_DIGITS and line.radix is Radix.HEX


def _is_tcp(data: bytes) -> bool:
    """Say whether bytes have the header of Modbus TCP, and as many bytes behind it as it promises."""
    return len(data) > _TCP_HEADER and data[2:5] == b"\0\0\0" and data[5] == len(data) - _TCP_HEADER


_TCP_HEADER = 6


def _reported(lines: Sequence[str]) -> float:
    """Say how sure a text is in which a library reports what went wrong, and no bytes stand."""
    return _PROSE_SCORE if any(speaks(line[:_LONGEST_REPORT]) for line in lines) else 0.0


def read(source: Source) -> Iterator[Chunk | Comment]:
    """Read the lines one by one."""
    lines = list(_whole_lists(head_lines(source.head)))
    manner = Manner.of(lines)
    parts = [manner.take(line) for line in lines]
    clock = StampClock((p.stamp for p in parts if p.shape in (Shape.TRAFFIC, Shape.HEADER)), source)
    for note in manner.notes(parts):
        source.note(note)
    return _Reader(source, clock, manner).records()


def _whole_lists(lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines; one in which a list of bytes begins comes with those that go on with it."""
    held: list[str] = []
    for line in lines:
        if held:
            wrapped = held[0].startswith("<")
            if len(held) < _PIECES and (_WRAPPED if wrapped else _GOES_ON).fullmatch(line):
                held.append(line)
                continue
            yield " ".join(held)
            held.clear()
        if (line.endswith(_OPEN) and _LIST.search(line)) or (line.startswith("<") and _LONG_LINE.fullmatch(line)):
            held.append(line)
        else:
            yield line
    if held:
        yield " ".join(held)


class _Reader:
    """Turns lines into records; holds the header that waits for its bytes."""

    def __init__(self, source: Source, clock: StampClock, manner: Manner) -> None:
        self._source = source
        self._lines = Lines(source)
        self._clock = clock
        self._manner = manner
        self._header: HexLine | None = None
        self._header_ns: int | None = None
        self._collected = bytearray()
        self._said = 0
        self._running: int | None = None
        self._passed = 0
        self._declared = False
        self._known = Known()
        self._parts = Parts(manner.fields, manner.cells)
        #: Who sent the bytes below words, and whether any came.
        self._above = Role.UNKNOWN
        self._above_words: frozenset[str] = frozenset()
        self._below = False
        #: Why the bytes below a sentence are not traffic.
        self._unsent = ""
        self._marks = ReceivedMarks()
        self._printed: tuple[bytes, Role, tuple[str, bool, str], int | None] | None = None

    def records(self) -> Iterator[Chunk | Comment]:
        """Yield the records of all lines."""
        if self._manner.single:
            yield from self._single_bytes()
            return
        source = self._source
        prose = self._manner.prose
        for text in _whole_lists(self._lines):
            if self._manner.unpadded and _RUN_OF_DIGITS.fullmatch(text) is not None:
                yield source.comment(None, text)
                continue
            if prose:
                if self._parts.take(text):
                    continue
                yield from self._end_parts()
                # It may begin the next one.
                if self._parts.take(text):
                    continue
            line = self._manner.take(text)
            if self._header is not None:
                plain = line.shape is Shape.TRAFFIC and not line.marked and not line.stamp.kind
                if plain and not self._header.ascii and len(self._collected) < _COLLECTED:
                    self._collected += line.data
                    continue
                if line.shape is Shape.BLANK and not self._collected:
                    continue
                if self._header.ascii and line.shape is not Shape.BLANK and not line.stamp.kind:
                    yield source.comment(self._header_ns, text)
                    continue
                yield from self._end_header()
            if line.shape is Shape.BLANK:
                if self._below:
                    self._above, self._unsent = Role.UNKNOWN, ""
                continue
            t_ns = self._time(line)
            if line.shape is Shape.TRAFFIC and line.passed and (said := self._better(text, line)):
                yield from self._quoted(t_ns, text, said)
            elif line.shape is Shape.TRAFFIC and self._is_reprint(t_ns, line, text):
                yield source.comment(t_ns, text)
            elif line.shape is Shape.TRAFFIC and self._unsent and not line.marked:
                self._below = True
                source.note(f"line {self._lines.number}: {line.data.hex(' ').upper()} is left out: {self._unsent}")
                yield source.comment(t_ns, text)
            elif line.shape is Shape.TRAFFIC:
                self._check_count(line)
                if line.passed and self._lines.number <= _SAMPLE_LINES and (_CALLED.search(line.passed) or speaks(line.passed)):
                    yield source.comment(t_ns, line.passed)
                elif self._lines.number <= _SAMPLE_LINES and (judged := _JUDGED.search(text)) is not None:
                    yield source.comment(t_ns, judged[0])
                if line.declared and not self._declared:
                    # Once shows that these are bytes of a program.
                    self._declared = True
                    yield source.comment(t_ns, line.declared)
                yield from self._traffic(t_ns, self._told_above(line) if prose else line)
            elif line.shape is Shape.HEADER:
                self._header, self._header_ns = line, t_ns
            elif line.shape is Shape.COMMENT:
                yield from self._words(t_ns, line)
            elif (said := mentions(text, self._manner.brackets) or self._known.labelled(text)) and _SPOILT.match(
                text, said[-1].end
            ) is None:
                yield from self._quoted(t_ns, text, said)
            else:
                source.problem(f"expected hex bytes, got {quote(line.text.strip())!r}", line=self._lines.number)
        yield from self._end_parts()
        yield from self._end_header()
        if self._passed:
            source.note(f"{counted(self._passed, 'line')} of words with bytes in them: not read, only the lines of traffic are")

    def _single_bytes(self) -> Iterator[Chunk]:
        port = self._source.port()
        for text in self._lines:
            found = SINGLE.fullmatch(text)
            value = int(found[1], 10 if self._manner.decimal else 16) if found is not None else 256
            if value < 256:
                yield Chunk(None, port, bytes((value,)))
            elif text.strip():
                self._source.problem(f"expected one byte, got {quote(text.strip())!r}", line=self._lines.number)

    def _words(self, t_ns: int | None, line: HexLine) -> Iterator[Chunk | Comment]:
        """Yield a line of words; in prose also the frames that it quotes."""
        said = mentions(line.text, self._manner.brackets) if not line.text.startswith("#") or self._manner.commented else []
        said = said or self._known.labelled(line.text)
        if self._manner.prose and not said and _WORDS.search(line.text):
            self._above, self._below, self._unsent = role_in_text(line.text), False, unsent(line.text)
            self._above_words = frozenset(_WORDS.findall(line.text))
        if not self._manner.prose:
            # Programs repeat in words what they sent and received. Bytes behind a label with a sender are new.
            new = [each for each in said if not each.left and not self._known.has_part(each.data)]
            labels = "" if line.text.startswith(_REMARKS) else line.text
            said = [e for e in new if e.role is not Role.UNKNOWN and stands_before(_LABELLED, labels, e)]
            self._passed += len(new) > len(said)
        if not said:
            yield self._source.comment(t_ns, line.text)
            return
        yield from self._quoted(t_ns, line.text, said)

    def _better(self, text: str, line: HexLine) -> list[Quotation]:
        """Return what a line of words speaks of, where that is more than the bytes behind its last mark."""
        said = mentions(text, self._manner.brackets)
        more = quotations(line.passed) or any(len(each.data) > len(line.data) for each in said if not each.left)
        return said if more else []

    def _quoted(self, t_ns: int | None, text: str, said: Sequence[Quotation]) -> Iterator[Chunk | Comment]:
        """Yield a line of words with the frames that it quotes."""
        number = self._lines.number
        for each in said:
            if each.left:
                self._source.note(f"line {number}, column {each.column}: {each.data.hex(' ').upper()} is left out: {each.left}")
        frames = self._known.new_of(text, [each for each in said if not each.left])
        if self._printed is not None and _DUMPED.match(text):
            # The rows of a dump below a call show its bytes again.
            frames = [each for each in frames if each.data not in self._printed[0]]
        if not frames:
            yield self._source.comment(t_ns, text)
            return
        columns = ", ".join(str(each.column) for each in frames[:_COLUMNS_SHOWN])
        more = f" and {len(frames) - _COLUMNS_SHOWN} more" if len(frames) > _COLUMNS_SHOWN else ""
        where = f"line {number}, column{'s' * (len(frames) > 1)} {columns}{more}"
        if not self._said:
            self._source.note(f"frames stand in sentences, the first in {where}: who sent is told by the word before")
        self._said += len(frames)
        yield self._source.comment(t_ns, f"{where}: {text}")
        alone = all(_LABEL.fullmatch(word) or word in self._above_words for word in _WORDS.findall(text))
        for each in frames:
            self._known.add_label(text, each)
            role = self._marks(self._above) if each.role is Role.UNKNOWN and alone else each.role
            self._known.add(each.data, role)
            self._marks(role)
            yield Chunk(t_ns, self._source.port(), each.data, Role.UNKNOWN if self._manner.deaf else role, True)

    def _told_above(self, line: HexLine) -> HexLine:
        """Return a line with the sender that words behind it or above it name."""
        self._below = True
        if line.marked or line.role is not Role.UNKNOWN:
            self._marks(line.role)
            return line
        # What stands behind a declaration says what the bytes are for, not that they were sent.
        behind = Role.UNKNOWN if line.declared else role_in_text(line.note)
        return line._replace(role=self._marks(self._above if behind is Role.UNKNOWN else behind))

    def _end_parts(self) -> Iterator[Chunk | Comment]:
        """Yield the frame of the fields or rows so far."""
        dumped, rows = self._parts.end()
        if dumped:
            role, t_ns = self._above, None
            if self._header is not None and not self._collected:
                # A mark and perhaps a time, alone on the line above the dump.
                role, t_ns, self._header = self._header.role, self._header_ns, None
            yield Chunk(t_ns, self._source.port(), dumped, self._marks(role), True)
        if is_frame(rows):
            data = bytes.fromhex(re.sub("0[xX]|[ ,]", "", "".join(row["bytes"] for row in rows)))
            # A table often explains a frame that stands above it.
            if not (data in self._known and rows[0].re in ROWS):
                role = Role.REQUEST if rows[0]["call"] else self._marks(self._above)
                yield Chunk(None, self._source.port(), data, role, True)
        elif rows and not any(row["name"] or row["call"] for row in rows):
            for row in rows:
                yield Chunk(None, self._source.port(), bytes.fromhex(row["bytes"]), self._marks(self._above), True)
            return
        for row in rows:
            yield self._source.comment(None, row[0])

    def _traffic(self, t_ns: int | None, line: HexLine) -> Iterator[Chunk | Comment]:
        """Yield the bytes of a line, and what stands behind them: often the reply."""
        for _ in range(_PIECES):
            behind = self._manner.take(line.note) if line.note else None
            if behind is None or behind.shape is not Shape.TRAFFIC or not behind.marked:
                yield self._chunk(t_ns, line, line.data)
                if behind is None or self._is_idle(line):
                    return
                said = [] if line.note.startswith(_REMARKS) else mentions(line.note)
                said = [each for each in said if each.data not in self._known]
                yield from self._quoted(t_ns, line.note, said) if said else (self._source.comment(t_ns, line.note),)
                return
            if not line.marked and not behind.worded:
                # `FA 01 30 2B -> FB 01 F6 01 F3`
                line, behind = line._replace(role=Role.REQUEST), behind._replace(role=Role.REPLY)
            yield self._chunk(t_ns, line, line.data)
            line = behind
        self._source.problem(
            f"expected at most {_PIECES} frames on a line, got more: {quote(line.note)!r} is not read", line=self._lines.number
        )
        yield msgspec.structs.replace(self._chunk(t_ns, line, line.data), torn=True)

    def _is_reprint(self, t_ns: int | None, line: HexLine, text: str) -> bool:
        """Say whether a program prints at once what the line before has, or a console how many bytes it has sent."""
        before = self._printed
        if before is not None and before[1] is Role.REQUEST and not line.marked and text.strip() == str(len(before[0])):
            return True
        self._printed = (line.data, line.role, (line.sign, line.worded, line.passed), t_ns)
        # Of single bytes the layers take turns: one prints each bit by bit.
        layers = before is not None and "binary" in (before[2][0], line.sign)
        if before is None or not (layers or (line.role is not Role.UNKNOWN and len(line.data) >= _SAID_BYTES)):
            return False
        data, role, style, then_ns = before
        same = (data, role) == (line.data, line.role) and style != self._printed[2]
        return same and (t_ns is None or then_ns is None or abs(t_ns - then_ns) < _AT_ONCE_NS)

    @staticmethod
    def _is_idle(line: HexLine) -> bool:
        """Say whether what stands behind the bytes tells nothing more: how many they are, or the same bytes again."""
        return _COUNTED.fullmatch(line.note) is not None or bytes_of(line.note) == line.data

    def _check_count(self, line: HexLine) -> None:
        """Say once what a number before the bytes was taken for, where it is not how many they are."""
        running = self._running
        self._running = None if line.number is None else line.number + 1
        # An index that begins at 0 or goes on needs no word.
        if line.number is not None and line.number not in (len(line.data), 0, running):
            shown = f"{line.number}" if line.led else f"{line.number}:"
            self._source.note(
                f"line {self._lines.number}: the '{shown}' before {counted(len(line.data), 'byte')} is read as the "
                "number of the line or an expected length, never as a byte"
            )

    def _time(self, line: HexLine) -> int | None:
        try:
            return self._clock(line.stamp)
        except ValueError as error:
            self._source.problem(str(error), line=self._lines.number)
            return None

    def _chunk(self, t_ns: int | None, line: HexLine, data: bytes) -> Chunk:
        name = line.name if line.name and _BUS_NAME.fullmatch(line.name) else None
        exported = _EXPORTED_NAME.fullmatch(line.name)
        if exported is not None:
            name = exported[1]
        self._known.add(data, line.role)
        firm = not (self._manner.lone or self._manner.wrapped) and (len(data) > 1 or line.number is None)
        return Chunk(t_ns, self._source.port(name), data, line.role, firm)

    def _end_header(self) -> Iterator[Chunk | Comment]:
        header, data = self._header, bytes(self._collected)
        self._header = None
        self._collected.clear()
        if header is None:
            return
        if data:
            yield self._chunk(self._header_ns, header, data)
        elif not header.ascii:
            yield self._source.comment(self._header_ns, header.text)
