"""Logs of pyserial's `spy://` ports: a hex dump of what was sent and received, and calls that set control lines.

    000003.001 TX   0000  FA 01 F6 01 40 02 34                              ....@.4
    000003.102 RX   0000  FB 01 F6 01 F3                                    .....
    000003.200 RTS  inactive

Rules: rows of one call (offset 0010 and on) are one chunk with the time of the first. A write is a burst; a read may cut
a burst anywhere. Times are seconds since the port was opened, exact to their 3 digits. Other calls are comments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from analyzer.catalogue import Role
from analyzer.records import Chunk, Comment
from analyzer.sources.lines import Lines, cut_note, share
from analyzer.sources.source import Source, quote
from analyzer.sources.times import number_ns
from analyzer.values import counted

_ROW_BYTES = 16
#: Where the characters of a row stand, behind its first byte.
_CHARACTERS = 50
#: Sixteen columns of three characters, a gap after the eighth (some logs have none), a gap, and the bytes as characters.
_ROW = re.compile(r"(\d{6,}\.\d{3}) (TX|RX)   ([0-9A-F]{4,})  ((?:[0-9A-F]{2} ){1,8}(?: ?(?:[0-9A-F]{2} ){1,8})?)")
_EMPTY = re.compile(r"(\d{6,}\.\d{3}) RX   <empty>\s*$")
_CONTROL = re.compile(r"(\d{6,}\.\d{3}) (?![TR]X )([A-Z][A-Z-]{1,5}) +(\S.*)$")
_EITHER = re.compile(f"(?:{_ROW.pattern})|(?:{_EMPTY.pattern})|(?:{_CONTROL.pattern})")
_ROLES = {"TX": Role.REQUEST, "RX": Role.REPLY}
#: Rows of one call that are put together at most.
_JOINED = 1 << 16


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are a spy log, 0..1."""
    # Its rows are lines of hex text, too: where most fit, they are a spy's.
    return 0.95 * min(1.0, 2 * share(head, _EITHER))


def read(source: Source) -> Iterator[Chunk | Comment]:
    """Read the rows and calls."""
    source.time_source = "capture: seconds since the port was opened, exact to 1 ms"
    return _records(source)


def _records(source: Source) -> Iterator[Chunk | Comment]:
    lines = Lines(source)
    port = source.port()
    held = b""
    held_ns, held_mark, torn = 0, "", False
    for line in lines:
        found = _ROW.match(line)
        if found is None:
            if held:
                yield _chunk(held_ns, port, held, held_mark, torn)
                held = b""
            other = None if _EMPTY.match(line) else _CONTROL.match(line)
            if other is not None:
                yield source.comment(number_ns(other[1]), f"{other[2]} {other[3]}")
            elif line.strip() and not _EMPTY.match(line):
                source.problem(
                    f"expected 'seconds TX|RX offset bytes' or 'seconds name value', got {quote(line)!r}", line=lines.number
                )
            continue
        stamp, mark, offset, text = found.groups()
        data = bytes.fromhex(text)
        place = int(offset[:8], 16)
        # A blank may be a byte or fill the row up, so fewer characters than bytes are no damage.
        shown = len(line[found.start(4) + _CHARACTERS :].rstrip())
        lacks = shown > len(data)
        if lacks:
            source.problem(
                f"expected {counted(shown, 'byte')}, as many as the characters show, got {len(data)}", line=lines.number
            )
        continues = bool(held) and mark == held_mark and place == len(held) < _JOINED
        if not continues and place and place < _JOINED:
            lacks = True
            source.problem(f"the rows before offset {offset} are missing", line=lines.number)
        if held and not continues:
            yield _chunk(held_ns, port, held, held_mark, torn)
            held = b""
        if not continues:
            held_ns, held_mark, torn = number_ns(stamp), mark, False
        held += data
        torn |= lacks
        # A row that is not full is the last of its call; waiting for the next line would hold up a live log.
        if len(data) < _ROW_BYTES:
            yield _chunk(held_ns, port, held, held_mark, torn)
            held = b""
    if held:
        yield _chunk(held_ns, port, held, held_mark, torn)
    cut_note(source, lines)


def _chunk(t_ns: int, port: str, data: bytes, mark: str, torn: bool) -> Chunk:
    return Chunk(t_ns, port, data, _ROLES[mark], mark == "TX", torn)
