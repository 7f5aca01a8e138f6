"""The lines of a text capture, one by one, in bounded memory.

A line ends with LF, CR LF or CR. Bytes that are no valid text become replacement characters. Colours of a terminal are taken
out. A line longer than `LINE_LIMIT` is cut, with a problem. Python's other white space (separators, form feeds, no-break
spaces) becomes a blank, so that all parsers see blanks and tabs only.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Sequence
from difflib import SequenceMatcher
from functools import lru_cache, partial, wraps
from typing import Concatenate, NamedTuple, ParamSpec, TypeVar

from analyzer.columns.block import CanBlock
from analyzer.sources.source import TOGETHER, Source

#: The stretches of some lines: from which to which, on which bus, and their frames; None: they are to be read singly.
Pieces = Callable[[bytes], Iterator[tuple[int, int, str, CanBlock | None]]]

#: Bytes of one line.
LINE_LIMIT = 1 << 20
_COLOR = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")
#: Characters that Chinese serial assistants put before traffic (send, receive, arrows), as they write them.
_CHINESE_MARKS = ("发", "收", "→", "←")
#: What patterns and `split` take for white space, and `bytes.fromhex`, `csv` and `int` do not.
_BLANKS = re.compile("[\x0b\x0c\x1c-\x1f\x85\xa0\u1680\u2000-\u200a\u2028\u2029\u202f\u205f\u3000]")
_BLANK_BYTES = b"\x0b\x0c\x1c\x1d\x1e\x1f"
#: A beginning of so many bytes may be cut within a line.
_CUT = 4096
#: How long a line may be that is remembered, and how many of such.
_REMEMBERED = ((256, 1024), (1 << 16, 64))
P = ParamSpec("P")
T = TypeVar("T")
#: Damaged lines among which a format is looked for, at most, and how much of one is compared with those around it.
_MOST_DAMAGED = 8
_COMPARED = 160
_NEIGHBOURS = 6
_LIKE = 0.8
_HEX_DIGIT = re.compile(r"[0-9A-Fa-f]")
#: What is taken out of a text or put in the place of others before its lines are read.
_UNPLAIN = [bytes((code,)) for code in b"\r\x1b" + _BLANK_BYTES]
_CONTROLS = bytes(c for c in range(32) if c not in b"\t\n\r\f\v\b\x1b") + b"\x7f"


def remembered(function: Callable[Concatenate[str, P], T]) -> Callable[Concatenate[str, P], T]:
    """Return a function of a line that keeps what it gave for those of late.

    Lines that came again and again are what a small compressed file unpacks to most of; they cost no more than being read.
    """
    kept = tuple((longest, lru_cache(maxsize=count)(function)) for longest, count in _REMEMBERED)

    @wraps(function)
    def of(line: str, /, *more: P.args, **named: P.kwargs) -> T:
        size = len(line)
        for longest, cached in kept:
            if size <= longest:
                return cached(line, *more, **named)  # type: ignore[arg-type]
        return function(line, *more, **named)

    return of


class _Text(NamedTuple):
    """Some lines. `dropped`: bytes left out of the first one, which was cut; None: it was not. `whole`: the last has an end."""

    data: bytes
    dropped: int | None = None
    whole: bool = True


class Lines:
    """Iterates the lines of a source's text without their ends. `number`: of the line given last, from 1.

    `ended`: whether the last line had its end; a line without one may have been cut off.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._encoding = encoding_of(source.head)
        self._end = b"\r" if b"\n" not in source.head and b"\r" in source.head else b"\n"
        self.number = 0
        self.ended = True

    def __iter__(self) -> Iterator[str]:
        pay = self._source.stream.budget.record
        for text in self._texts():
            for line in self._lines(text):
                self.number += 1
                pay()
                yield line

    def with_blocks(self, parse: Pieces) -> Iterator[str | CanBlock]:
        """Yield the lines, and where blocks are wanted what `parse` makes of many lines of plain ASCII together.

        It yields stretches of them: from which to which, on which bus, and their frames; None: read them singly.
        """
        pay, port = self._source.stream.budget.record, self._source.port
        for text, parts in self._source.parsed(partial(_pieces, parse), self._texts()):
            lines = [] if parts is not None and all(block is not None for *_, block in parts) else self._lines(text)
            for start, stop, name, block in parts or ((0, len(lines), "", None),):
                if block is not None:
                    self.number += len(block)
                    pay(len(block))
                    yield dataclasses.replace(block, port=port(name))
                    continue
                for line in lines[start:stop]:
                    self.number += 1
                    pay()
                    yield line

    def _lines(self, text: _Text) -> list[str]:
        lines = _text(text.data, self._encoding).split("\n")
        if text.dropped is not None:
            lines[0] = self._cut(lines[0], text.dropped)
        return lines

    def _texts(self) -> Iterator[_Text]:
        """Yield whole lines, many at once without the last end."""
        source, end = self._source, self._end
        read = source.stream.block
        held: list[bytes] = []
        held_size = dropped = 0
        first = True
        while block := source.stream.exactly(TOGETHER) if source.in_blocks else read():
            if first:
                block = block.removeprefix(b"\xef\xbb\xbf")
                first = False
            cut = block.rfind(end)
            if cut < 0:
                if held_size < LINE_LIMIT:
                    held.append(block)
                    held_size += len(block)
                else:
                    dropped += len(block)
                continue
            text = b"".join((*held, memoryview(block)[:cut])).removesuffix(b"\r")
            rest = block[cut + len(end) :]
            held = [rest] if rest else []
            cut_off = dropped if held_size >= LINE_LIMIT else None
            held_size = len(rest)
            if cut_off is not None:
                dropped = 0
            yield _Text(text, cut_off)
        if held:
            self.ended = False
            yield _Text(b"".join(held), dropped if held_size >= LINE_LIMIT else None, whole=False)

    def _cut(self, line: str, dropped: int) -> str:
        if dropped or len(line) > LINE_LIMIT:
            self._source.problem(
                f"a line of {len(line.encode()) + dropped} bytes, expected at most {LINE_LIMIT}: only its beginning is used",
                line=self.number + 1,
            )
        return line[:LINE_LIMIT]


def _pieces(parse: Pieces, text: _Text) -> list[tuple[int, int, str, CanBlock | None]] | None:
    """Return the stretches of some lines; None where they are to be read singly."""
    data = text.data
    if not text.whole or text.dropped is not None or not data.isascii() or any(code in data for code in _UNPLAIN):
        return None
    return list(parse(data))


def _text(data: bytes, encoding: str) -> str:
    """Return a piece of a capture as text with one kind of line ends and one of white space."""
    text = data.decode(encoding, "replace")
    if b"\x1b" in data:
        text = _COLOR.sub("", text)
    if b"\r" in data:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not text.isascii() or len(data.translate(None, _BLANK_BYTES)) < len(data):
        text = _BLANKS.sub(" ", text)
    return text


def cut_note(source: Source, lines: Lines) -> None:
    """Note that the last line of a capture that a program wrote has no end."""
    if not lines.ended:
        source.note(f"line {lines.number}, the last one, has no line end: the capture may be cut off in it")


def encoding_of(head: bytes) -> str:
    """Return the encoding of a text that begins with these bytes: UTF-8, or GB 18030 of Chinese serial assistants."""
    try:
        # The head may end inside a character.
        head.rsplit(b"\n", 1)[0].decode("utf-8")
    except UnicodeDecodeError:
        chinese = head.decode("gb18030", "ignore")
        return "gb18030" if any(mark in chinese for mark in _CHINESE_MARKS) else "utf-8"
    return "utf-8"


@lru_cache(maxsize=4)
def is_text(head: bytes) -> bool:
    """Say whether bytes look like text: no control characters to speak of, and not mostly foreign bytes."""
    # A file system that lost its power leaves zeros at the end of what was being written.
    head = head.rstrip(b"\0")
    if not head:
        return False
    if head.count(0) > len(head) // 1000 or len(head.translate(None, _CONTROLS)) < 0.95 * len(head):
        return False
    high = sum(1 for b in head if b >= 0x80)
    if high <= len(head) // 5:
        return True
    try:
        head.rsplit(b"\n", 1)[0].decode(encoding_of(head))
    except UnicodeDecodeError:
        return False
    return b"\n" in head


@lru_cache(maxsize=4)
def head_lines(head: bytes) -> tuple[str, ...]:
    """Return the whole lines of a capture's beginning that are not blank; all of a short one, whose last may have no end."""
    if not is_text(head):
        return ()
    text = _text(head.removeprefix(b"\xef\xbb\xbf"), encoding_of(head))
    lines = text.split("\n")
    if len(lines) > 1 and len(head) >= _CUT:
        lines.pop()
    return tuple(line[:4096] for line in lines if line.strip())


def share(head: bytes, pattern: re.Pattern[str]) -> float:
    """Return which share of a head's lines match a pattern, 0..1."""
    return fitting(head_lines(head), [pattern.match(line) is not None for line in head_lines(head)])


def fitting(lines: Sequence[str], fits: Sequence[bool]) -> float:
    """Return which share of the lines of a text fit a format, 0..1; a few that are like those around them were damaged."""
    good = sum(fits)
    damaged = [n for n, fit in enumerate(fits) if not fit]
    few = len(damaged) <= min(_MOST_DAMAGED, max(1, len(lines) // 10)) < good
    if damaged and few and all(_is_damaged(n, lines, fits) for n in damaged):
        return 1.0
    return good / len(lines) if lines else 0.0


def _is_damaged(at: int, lines: Sequence[str], fits: Sequence[bool]) -> bool:
    around = range(max(0, at - _NEIGHBOURS), min(len(lines), at + _NEIGHBOURS + 1))
    return any(is_like(lines[at], lines[n]) for n in around if fits[n])


def is_like(line: str, other: str) -> bool:
    """Say whether two lines differ little but in their hexadecimal digits."""
    first, second = (_HEX_DIGIT.sub("0", each[:_COMPARED].strip()) for each in (line, other))
    return SequenceMatcher(None, first, second, autojunk=False).quick_ratio() >= _LIKE
