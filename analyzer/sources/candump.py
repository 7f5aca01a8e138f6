"""candump of can-utils, as it logs (`-l`, `-L`) and as it shows on the screen.

    (1436509052.249713) can0 001#F60140023A          log; R or T may follow
    (1436509052.249713) can0 12345678##1AABB         extended identifier, CAN FD with flags
    (1436509052.249713) can0 123#R4                  remote request of 4 bytes
     (000.000512)  can0  001   [4]  F6 01 40 02      screen, with -t a, A, z or d, or without a time
      can0  RX - -  001   [4]  F6 01 40 02           screen with -x
      can0  001  [04]  F6 01 40 02                   CAN FD: two digits of length

Rules: times are exact to the printed digits, up to 9. `T` and `TX` say that the host sent a frame; `R` and `RX` say
nothing of who did, for a listener receives everything. python-can's reader knows the log form only, drops the class of
error frames and rounds times, so lines are read here; a test holds the two together.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache

from analyzer.catalogue import Role
from analyzer.columns.block import CanBlock
from analyzer.records import CanFrame, Comment
from analyzer.sources.lines import Lines, cut_note, head_lines, share
from analyzer.sources.source import Source, quote
from analyzer.sources.times import Clock, Deltas, clock_ns, day_ns, falls, number_ns
from analyzer.values import CAN_ID_MASK, SECOND_NS

LOG = re.compile(
    r"\s*\((\d{1,18})\.(\d{1,9})\) +(\S+) +([0-9A-Fa-f]{1,8})#([0-9A-Fa-f]*)([#RrXx_][0-9A-Fa-f]*|)(?: +([RTrt]))?\s*$"
)
#: Signs of a quotation may stand before a line of the screen.
_SCREEN = (
    r"[\s>|]*(?:\(([^)]{1,40})\)\s+)?(\S+)\s+(?:(RX|TX) [B-] [E-]\s+)?([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(\d{1,2})\]"
    r"(?:\s+(remote request)|((?:\s+[0-9A-Fa-f]{2})*))(?:\s+ERRORFRAME|\s+'.*')?\s*$"
)
_EITHER = f"(?:{LOG.pattern})|(?:{_SCREEN})"
_ERROR_TEXT = r"(?:[>|] ?)*(?:(?:\t| {2,})[a-z][a-z-]*|[a-z]+(?:-[a-z]+)+)(?:\{.*)?\s*$"
_KNOWN = f"(?:{_EITHER})|(?:{_ERROR_TEXT})"
#: A pattern made when it is first needed: to make those that no line of the log form needs takes as long as 50000 such lines.
_pattern = cache(re.compile)
_DATED = re.compile(r"(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)\.(\d{1,9})$")

_EXTENDED_DIGITS = 3
_ERROR_FLAG = 0x2000_0000
_POWERS = tuple(10**n for n in range(10))
_ROLES = {None: Role.UNKNOWN, "R": Role.UNKNOWN, "r": Role.UNKNOWN, "T": Role.REQUEST, "t": Role.REQUEST}
_ROLES |= {"RX": Role.UNKNOWN, "TX": Role.REQUEST}
_EXPECTED = "expected '(seconds) interface ID#data' or 'interface ID [length] data'"


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are candump's, 0..1."""
    # The words below an error frame are candump's too, and the command that was typed comes before.
    lines = head_lines(head)
    if lines and all(LOG.match(line) for line in lines):
        # Nothing else prints so: to ask the formats behind this one would take longer than to read a short capture.
        return 1.0
    return 0.95 * share(head, _pattern(_KNOWN)) if any(map(_pattern(_EITHER).match, lines)) else 0.0


def read(source: Source) -> Iterator[CanFrame | CanBlock | Comment]:
    """Read the lines one by one."""
    source.time_source = "capture: seconds as candump printed them, exact to their digits"
    screens = [m for line in head_lines(source.head) if not LOG.match(line) and (m := _pattern(_SCREEN).match(line))]
    if screens and not any(m[1] for m in screens):
        source.time_source = "none"
    return _records(source, _screen_time(source, [m[1] for m in screens if m[1]]))


def _screen_time(source: Source, printed: list[str]) -> Callable[[str], int]:
    """Return how to read a time of the screen form: since 1970 or the start, of a calendar, or from line to line."""
    if any(_DATED.match(text) for text in printed):
        source.clock = Clock.PRINTED
    numbers = [number_ns(text) for text in printed if re.fullmatch(r"\d{1,18}\.\d{1,9}", text)]
    if falls(numbers) and max(numbers) < 100_000_000 * SECOND_NS:
        source.time_source = "capture: sums of the seconds between frames, as candump -t d printed them"
        sum_up = Deltas()
        return lambda text: sum_up(number_ns(text))
    return _screen_ns


def _screen_ns(text: str) -> int:
    dated = _DATED.match(text)
    if dated is None:
        return number_ns(text)
    year, month, day, hour, minute, second, fraction = dated.groups()
    return day_ns(int(year), int(month), int(day)) + clock_ns(hour, minute, second, fraction)


def _records(source: Source, screen_time: Callable[[str], int]) -> Iterator[CanFrame | CanBlock | Comment]:
    lines = Lines(source)
    match, port, fromhex = LOG.match, source.port, bytes.fromhex
    unknown = Role.UNKNOWN
    for line in lines.with_blocks(_pieces):
        if not isinstance(line, str):
            yield line
            continue
        found = match(line)
        if found is None:
            record = _screen(source, line, lines.number, screen_time)
            if record is not None:
                yield record
            continue
        seconds, fraction, name, ident, data, tail, mark = found.groups()
        t_ns = int(seconds) * SECOND_NS + int(fraction) * _POWERS[9 - len(fraction)]
        number = int(ident, 16)
        if tail or number > CAN_ID_MASK or len(data) & 1:
            record = _special(source, lines.number, t_ns, found)
            if record is not None:
                yield record
            continue
        direction = unknown if mark is None else _ROLES[mark]
        yield CanFrame(t_ns, port(name), number, fromhex(data), direction, len(ident) > _EXTENDED_DIGITS)
    cut_note(source, lines)


def frame_of(line: str) -> CanFrame | None:
    """Return the frame of a line that stands in a text; without its time."""
    found = _pattern(_SCREEN).match(line)
    if found is None or (not found[6] and len(bytes.fromhex(found[7] or "")) != int(found[5])):
        return None
    return _framed(found, None, found[2])


def _framed(found: re.Match[str], t_ns: int | None, port: str) -> CanFrame:
    _, _, mark, ident, length, remote, text = found.groups()
    bits = int(ident, 16)
    error = len(ident) > _EXTENDED_DIGITS and bool(bits & _ERROR_FLAG)
    extended = len(ident) > _EXTENDED_DIGITS and not error
    data = bytes.fromhex(text or "")
    return CanFrame(t_ns, port, bits & CAN_ID_MASK, data, _ROLES[mark], extended, bool(remote), error, len(length) > 1)


def _pieces(text: bytes) -> Iterator[tuple[int, int, str, CanBlock | None]]:
    # NumPy comes with the first block.
    from analyzer.sources.candump_blocks import pieces

    return pieces(text)


def _special(source: Source, line: int, t_ns: int, found: re.Match[str]) -> CanFrame | None:
    """Return a frame of the log form that is no plain data frame: FD, remote, error."""
    _, _, name, ident, data, tail, mark = found.groups()
    number, direction, kind = int(ident, 16), _ROLES[mark], tail[:1]
    if (kind == "#" and data) or number > CAN_ID_MASK | _ERROR_FLAG:
        source.problem(f"{_EXPECTED}, got {quote(found[0].strip())!r}", line=line)
        return None
    if kind == "#" and len(tail) >= 2:
        data = tail[2:]
    if len(data) & 1:
        source.problem(f"expected two hex digits a byte, got {quote(data[-5:])!r} at the end", line=line)
        return None
    if kind in ("X", "x"):
        source.problem(f"CAN XL is not supported: {quote(found[0].strip())!r}", line=line)
        return None
    if kind in ("R", "r") and data:
        source.problem(f"a remote frame carries no data: {quote(found[0].strip())!r}", line=line)
        return None
    return CanFrame(
        t_ns,
        source.port(name),
        number & CAN_ID_MASK,
        bytes.fromhex(data),
        direction,
        len(ident) > _EXTENDED_DIGITS and not number & _ERROR_FLAG,
        kind in ("R", "r"),
        bool(number & _ERROR_FLAG),
        kind == "#",
    )


def _screen(source: Source, line: str, number: int, time_of: Callable[[str], int]) -> CanFrame | Comment | None:
    """Return what a line of the screen form holds; None with a problem noted if it fits neither form."""
    # A post may show bytes in bold, or the line as code.
    match = _pattern(_SCREEN).match
    found = match(line) or match(line.replace("**", "").strip(" `"))
    if found is None:
        if _pattern(_ERROR_TEXT).match(line):
            # `candump -e` explains an error frame on the lines below it.
            return source.comment(None, line)
        if line.strip():
            source.problem(f"{_EXPECTED}, got {quote(line.strip())!r}", line=number)
        return None
    printed, name, length, text = found.group(1, 2, 5, 7)
    size = len(bytes.fromhex(text or ""))
    if not found[6] and size != int(length):
        source.problem(f"expected {length} data bytes, got {size}: {quote(line.strip())!r}", line=number)
        return None
    try:
        t_ns = time_of(printed) if printed else None
    except ValueError:
        t_ns = None
        source.problem(f"expected a time, got {quote(printed)!r}; the frame is kept", line=number)
    return _framed(found, t_ns, source.port(name))
