"""Hex dumps of raw bytes, as `hexdump -C`, `xxd` and `od -A x -t x1` print them.

    00000000  fa 01 f6 01 40 02 34 fb  01 f6 01 f3              |....@.4.....|
    00000000: fa01 f601 4002 34fb 01f6 01f3                     ....@.4.....
    *                                                           the row before, again, up to the next offset

    0000  fa 01 30 2b                                       ..0+         tshark -x: an offset of 0 begins a packet

    fa0131...                                                   `xxd -p`: rows of 30 bytes, without offsets

No times, no directions: rows are cut anywhere, but a packet of several is a burst. The offsets show bytes that are missing.
Lines of words above the rows and behind them (a prompt) are comments, unless they say who sent this one frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

from analyzer.catalogue import Role
from analyzer.records import Chunk, Comment
from analyzer.sources.lines import Lines, fitting, head_lines
from analyzer.sources.prose import role_in_text
from analyzer.sources.source import Source, quote
from analyzer.values import counted

_ROW = re.compile(r"\s*([0-9A-Fa-f]{4,16})(:?)(?:\s+|$)(.*)$")
_GROUPS = re.compile(r"(?:[0-9A-Fa-f]{2})+(?: {1,2}(?:[0-9A-Fa-f]{2})+)*")
#: `xxd` separates the characters by two spaces, and never has two between bytes; hexdump frames them.
_FRAMED = re.compile(r"[|>].*$")
#: A row with its characters behind it.
_WITH_TEXT = re.compile(r"\s*[0-9A-Fa-f]{4,16}:?\s+(?:[0-9A-Fa-f]{2,4} ?){1,16} {2,}\S")
#: Characters behind a wider gap than hexdump has between its halves.
_COLUMN = re.compile(r"\s{3,}\S.*$")
_LONGEST_ROW = 64
_LONGEST_PACKET = 1 << 16
#: Share of rows that must follow from the one before; some may be missing.
_FOLLOWING = 0.8
#: Rows of a dump of which one may have a damaged offset.
_DAMAGED_ROWS = 4
_USUAL_ROWS = (8, 16, 32)
#: Lines of words around the rows, and the fewest rows that have such.
_MOST_WORDS, _LEAST_ROWS = 8, 3
#: No reply of a drive has more bytes.
_LONGEST_REPLY = 64
#: What a shell prints before a command.
_PROMPT = re.compile(
    r"\s*(?:\(\w+\) ?)?(?:\[?\S{1,40}@\S{1,80}(?: \S{1,40}?\]?)?)? ?[$#%](?:\s|$)|\s*(?:PS )?[A-Z]:\\[^>]{0,200}>"
)
#: Rows without offsets are so wide, and the last may be shorter.
_PLAIN_BYTES = 30
#: Digits at the beginning of a frame that those of one sender share.
_HEAD = 6
_PLAIN = re.compile(rf"\s*(?:[0-9A-Fa-f]{{2}}){{1,{_PLAIN_BYTES}}}\s*")


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are a hex dump, 0..1: each offset must follow from the row before, or be 0 again."""
    lines = _without_words(head_lines(head))
    if _is_plain(lines):
        return 0.95
    # The last line of a dump is an offset alone.
    if len(lines) >= _DAMAGED_ROWS and " " not in lines[-1].strip():
        lines = lines[:-1]
    found = [_row(line) for line in lines]
    rows = [row for row in found if row is not None]
    starred = [line.strip() == "*" for line in lines]
    stars = sum(starred)
    if (
        not rows
        or not rows[0][1]
        or fitting(lines, [r is not None or star for r, star in zip(found, starred, strict=True)]) < 1
    ):
        return 0.0
    damaged = len(lines) - len(rows) - stars
    if len(rows) == 1:
        framed = len(rows[0][1]) in _USUAL_ROWS or _WITH_TEXT.match(lines[0]) is not None
        return 0.95 if rows[0][0] == 0 and framed else 0.0
    if all(offset == 0 for offset, _ in rows) and not all(_WITH_TEXT.match(line) for line in lines):
        return 0.0
    follows = sum(1 for (offset, data), (then, _) in pairwise(rows) if then == offset + len(data) or then == 0)
    # A damaged offset follows from no row, and no row from it.
    falling = sum(1 for (offset, data), (then, _) in pairwise(rows) if then < offset + len(data) and then != 0)
    if falling and (len(rows) < _DAMAGED_ROWS or falling > max(1, len(rows) // 10)):
        return 0.0
    return 0.95 if follows + stars + damaged + 2 * falling >= _FOLLOWING * (len(rows) - 1) else 0.0


def read(source: Source) -> Iterator[Chunk | Comment]:
    """Read the bytes."""
    return _records(source)


def _without_words(lines: Sequence[str]) -> Sequence[str]:
    """Return the rows of a dump that stand between a few lines of words; all lines where they are no such dump."""
    rows = {number: data for number, line in enumerate(lines) if (data := _bytes(line)) is not None}
    words = [line for number, line in enumerate(lines) if number not in rows]
    first, last = min(rows, default=0), max(rows, default=0)
    if len(rows) < _LEAST_ROWS or not 0 < len(words) <= _MOST_WORDS or len(rows) <= last - first:
        return lines
    roles = {role_in_text(line) for line in words if _PROMPT.match(line) is None}
    one = Role.REPLY in roles and sum(map(len, rows.values())) <= _LONGEST_REPLY
    return lines if one or Role.REQUEST in roles or any(map(_ROW.match, words)) else lines[first : last + 1]


def _bytes(line: str) -> bytes | None:
    """Return the bytes of a row, with its offset or without; None if the line is none."""
    row = _row(line)
    return row[1] if row is not None else bytes.fromhex(line.strip()) if _PLAIN.fullmatch(line) else None


def _is_plain(lines: Sequence[str]) -> bool:
    """Say whether lines are rows of `xxd -p`: most frames of a text would begin as others do."""
    rows = [line.strip() for line in lines[:-1]]
    if (
        len(rows) < _LEAST_ROWS - 1
        or any(len(row) != 2 * _PLAIN_BYTES for row in rows)
        or not all(map(_PLAIN.fullmatch, lines))
    ):
        return False
    return 2 * len({row[:_HEAD] for row in rows}) > len(rows)


def _row(line: str) -> tuple[int, bytes] | None:
    """Return a row's offset and bytes, None if the line is no row."""
    found = _ROW.match(line)
    if found is None:
        return None
    offset, colon, text = found.groups()
    text = text.partition("  ")[0] if colon else _COLUMN.sub("", _FRAMED.sub("", text).rstrip())
    text = text.strip()
    if text and _GROUPS.fullmatch(text) is None:
        return None
    data = bytes.fromhex(text)
    return (int(offset, 16), data) if len(data) <= _LONGEST_ROW else None


def _records(source: Source) -> Iterator[Chunk | Comment]:
    head = head_lines(source.head)
    rows = _without_words(head)
    plain, words = _is_plain(rows), set(head).difference(rows)
    packets = not plain and sum(1 for line in rows if (row := _row(line)) is not None and row[0] == 0) > 1
    lines, budget = Lines(source), source.stream.budget
    port = source.port()
    before, end = b"", 0
    first = True
    starred = torn = False
    packet = bytearray()
    for line in lines:
        text = line.strip()
        if text == "*":
            starred = True
            continue
        if line in words:
            yield source.comment(None, text)
            continue
        row = _row(line) if not plain else (end, bytes.fromhex(text)) if _PLAIN.fullmatch(line) else None
        if row is None:
            if text:
                source.problem(f"expected an offset and hex bytes, got {quote(text)!r}", line=lines.number)
            continue
        offset, data = row
        if packets and (offset == 0 or len(packet) >= _LONGEST_PACKET):
            if packet:
                yield Chunk(None, port, bytes(packet), burst=True, torn=torn)
            torn = False
            packet.clear()
        elif not first and offset > end:
            missing = offset - end
            if starred and before and missing % len(before) == 0 and budget.repeat(missing):
                # Within a packet the repeated rows stand behind those before them.
                if packets:
                    packet += before * (missing // len(before))
                else:
                    yield Chunk(None, port, before * (missing // len(before)))
            else:
                torn = True
                source.problem(f"{counted(missing, 'byte')} missing before offset {offset:X}", line=lines.number)
        elif not first and 0 < offset < end:
            source.problem(f"expected offset {end:X}, got {offset:X}; the bytes are kept", line=lines.number)
        first = starred = False
        before, end = data or before, offset + len(data)
        if packets:
            packet += data
        elif data:
            yield Chunk(None, port, data, torn=torn)
            torn = False
    if packet:
        yield Chunk(None, port, bytes(packet), burst=True, torn=torn)
