"""VCD, the value change dump of IEEE 1364: what sigrok, PulseView, Saleae Logic 2 and simulators export.

    $timescale 1 ns $end
    $var wire 1 ! RX $end             a channel: one bit, its code, its name; of more bits each is one: bus[0], bus[1] ...
    $enddefinitions $end
    #0 1! 0"                          at a time: channel ! is 1, channel " is 0
    #8680 0! b0101 # r1.5 $           vectors; reals are passed over

Rules: x and z leave a channel as it was, with a note; so do u, w and - of VHDL, whose l and h are 0 and 1. What a channel is
only within one step of time was never on the wire. Bits bear the numbers of their declaration. Times only rise. A word that is
none of these is damage, and the capture is refused with its line; only its last word may break off. What it does not know: how
often the line was sampled.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from analyzer.columns.codec import Integers
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk, Event
from analyzer.sources.logic.traffic import records
from analyzer.sources.logic.waveform import CHANNEL_LIMIT, Stretch, Waveform
from analyzer.sources.source import LATEST_NS, Source, quote

_RANGE = re.compile(r"(.*?)(?:\s*\[(\d{1,9}):(\d{1,9})\])?", re.DOTALL)
_SCALE = re.compile(r"(1|10|100)\s*(s|ms|us|ns|ps|fs)")
#: Femtoseconds of each unit, and of one nanosecond.
_UNITS = {"s": 10**15, "ms": 10**12, "us": 10**9, "ns": 10**6, "ps": 10**3, "fs": 1}
_NS = 10**6
#: Bytes of the header, and of one word in the body.
_HEADER_LIMIT, _WORD_LIMIT = 1 << 22, 1 << 16
_IGNORED = (b"$dumpvars", b"$dumpall", b"$dumpon", b"$dumpoff", b"$end")
_UNKNOWN = b"xXzZuUwW-"
#: Levels of all letters; those of `_UNKNOWN` have none.
_LEVELS = {"0": 0, "1": 1, "l": 0, "h": 1}


def read(source: Source) -> Iterator[Chunk | CanFrame | Event]:
    """Read the traffic. Raises UnreadableError for a header that is damaged."""
    header = _header(source)
    source.time_source = f"capture: times of changes, in steps of {header.scale}"
    wave = Waveform([name for name, _ in header.names], iter(()))
    wave.stretches = _stretches(source, wave, header)
    return records(source, wave)


@dataclass
class _Header:
    """`unit`: femtoseconds of a step of time. `codes`: the first channel of a code and its bits. `rest`: of the body."""

    names: list[tuple[str, int]] = field(default_factory=list)
    codes: dict[bytes, tuple[int, int]] = field(default_factory=dict)
    unit: int = 0
    scale: str = ""
    lines: int = 0
    rest: bytes = b""


def _header(source: Source) -> _Header:
    text = b""
    while b"$enddefinitions" not in text:
        block = source.stream.block()
        text += block
        if not block or len(text) > _HEADER_LIMIT:
            raise UnreadableError(f"{source.name}: the VCD header has no end: expected $enddefinitions within 4 MiB")
    end = text.find(b"$end", text.index(b"$enddefinitions") + len(b"$enddefinitions"))
    while end < 0:
        block = source.stream.block()
        text += block
        end = text.find(b"$end", text.index(b"$enddefinitions") + len(b"$enddefinitions"))
        if not block or len(text) > _HEADER_LIMIT:
            raise UnreadableError(f"{source.name}: the VCD header breaks off in $enddefinitions, expected $end")
    header = _Header(rest=text[end + 4 :], lines=text.count(b"\n", 0, end))
    scopes: list[str] = []
    line, counted = 1, 0
    for match in re.finditer(rb"\$(\w+)\s(.*?)\$end", text[: end + 4], re.DOTALL):
        line, counted = line + text.count(b"\n", counted, match.start()), match.start()
        words = match[2].decode("utf-8", "replace").split()
        if match[1] == b"timescale":
            _set_scale(source, header, " ".join(words), line)
        elif match[1] == b"scope":
            scopes.append(words[-1] if words else "")
        elif match[1] == b"var":
            _add(source, header, words, line)
    if not header.unit:
        header.unit, header.scale = _NS, "1 ns"
        source.note("the VCD header has no timescale: 1 ns is taken")
    if not header.names:
        raise UnreadableError(f"{source.name}: the VCD header declares no channel of bits: expected $var wire 1 CODE NAME $end")
    return header


def _set_scale(source: Source, header: _Header, words: str, line: int) -> None:
    found = _SCALE.fullmatch(words)
    if found is None:
        raise UnreadableError(f"{source.name}: line {line}: expected a timescale as in 1 ns, got {quote(words) or 'nothing'}")
    header.unit, header.scale = int(found[1]) * _UNITS[found[2]], f"{found[1]} {found[2]}"


def _add(source: Source, header: _Header, words: list[str], line: int) -> None:
    if len(words) < 4 or not words[1].isdecimal() or len(words[1]) > 5:
        raise UnreadableError(f"{source.name}: line {line}: expected $var TYPE BITS CODE NAME, got {quote(' '.join(words))}")
    kind, bits, code, name = words[0], int(words[1]), words[2].encode(), " ".join(words[3:])
    if kind in ("real", "realtime", "string", "event", "parameter") or not bits:
        source.note(f"channels of the type {quote(kind)} are passed over")
        header.codes.setdefault(code, (-1, 0))
    elif code not in header.codes:
        if len(header.names) + bits > CHANNEL_LIMIT:
            raise UnreadableError(f"{source.name}: line {line}: expected at most {CHANNEL_LIMIT} channels of one bit, got more")
        header.codes[code] = (len(header.names), bits)
        stem, first, last = _RANGE.fullmatch(name).groups()  # type: ignore[union-attr]
        lowest, step = (int(last), 1 if int(first) >= int(last) else -1) if last else (0, 1)
        header.names += [(name, 0)] if bits == 1 else [(f"{stem}[{lowest + step * bit}]", bit) for bit in range(bits)]


class _Body:
    """Takes the words of the body: keeps levels and edges."""

    def __init__(self, source: Source, header: _Header) -> None:
        self._source = source
        self._codes = header.codes
        self._unit = header.unit
        self.levels = [-1] * len(header.names)
        self.first = [-1] * len(header.names)
        self.edges: list[list[int]] = [[] for _ in header.names]
        #: What each word of one bit means, channel and level; made once.
        self._bits = {
            b"%d%s" % (level, code): (at, level) for code, (at, n) in header.codes.items() if n == 1 for level in (0, 1)
        }
        self.t_ns = self.start = -1
        self._pending: bytes = b""
        self._comment = False

    def take(self, words: list[bytes]) -> int:
        """Take words; return the place of the first that is none, -1 where all are taken."""
        bits, levels, edges, t_ns = self._bits, self.levels, self.edges, self.t_ns
        for place, word in enumerate(words):
            hit = None if self._pending or self._comment else bits.get(word)
            if hit is not None:
                channel, level = hit
                if levels[channel] != level:
                    if levels[channel] >= 0:
                        edges[channel].append(t_ns)
                    else:
                        self.first[channel] = level
                    levels[channel] = level
            elif word[0] == 35 and not self._pending and not self._comment:
                if not word[1:].isdigit() or len(word) > 24:
                    return place
                t_ns = int(word[1:]) * self._unit // _NS
                if t_ns < self.t_ns or t_ns > LATEST_NS:
                    return place
                self.t_ns = t_ns
            elif not self._other(word):
                return place
        return -1

    def _other(self, word: bytes) -> bool:
        """Take a word that is rare; say whether it is one."""
        if self._comment:
            self._comment = word != b"$end"
        elif self._pending:
            value, self._pending = self._pending, b""
            return self._vector(value, word)
        elif word == b"$comment":
            self._comment = True
        elif word[:1] in (b"b", b"B", b"r", b"R", b"s", b"S") and len(word) > 1:
            self._pending = word
        elif word[0] in _UNKNOWN and word[1:] in self._codes:
            self._source.note("x and z leave a channel as it was")
        elif word[:1].lower() in (b"0", b"1", b"l", b"h") and word[1:] in self._codes:
            return self._vector(b"b" + word[:1], word[1:])
        else:
            return word in _IGNORED
        return True

    def _vector(self, value: bytes, code: bytes) -> bool:
        if code not in self._codes:
            return False
        first, bits = self._codes[code]
        if value[:1] not in (b"b", b"B") or first < 0:
            return True
        digits = value[1:].decode("ascii", "replace").lower()
        if set(digits) - set("01xzuwlh-") or len(digits) > bits:
            return False
        digits = digits.rjust(bits, "0" if digits[0] in _LEVELS else digits[0])
        for channel, digit in enumerate(reversed(digits), first):
            level = _LEVELS.get(digit, -1)
            if level < 0:
                self._source.note("x and z leave a channel as it was")
            elif self.levels[channel] != level:
                if self.levels[channel] >= 0:
                    self.edges[channel].append(self.t_ns)
                else:
                    self.first[channel] = level
                self.levels[channel] = level
        return True


def _stretches(source: Source, wave: Waveform, header: _Header) -> Iterator[Stretch]:
    body = _Body(source, header)
    line = header.lines + 1
    text = header.rest
    while True:
        block = source.stream.block()
        data = text + block
        words = data.split()
        # The last word may go on in the next block.
        whole = bool(block) and not data[-1:].isspace()
        text = words.pop() if whole and words else b""
        if len(text) > _WORD_LIMIT:
            raise UnreadableError(f"{source.name}: line {line}: expected a change of a value, got a word without end")
        wrong = body.take(words)
        if wrong >= 0 and not (not block and wrong == len(words) - 1):
            raise _wrong(source, data, words, wrong, line)
        if wrong >= 0:
            source.problem(f"the last word breaks off: {quote(words[wrong].decode('utf-8', 'replace'))}", line=line)
        line += data.count(b"\n")
        edges = [_settled(np.array(found, dtype=np.int64)) for found in body.edges]
        for found in body.edges:
            found.clear()
        # A channel that says nothing before its first change is taken as what it was not.
        wave.first[:] = [max(level, 0) for level in body.first]
        yield Stretch(edges, max(body.t_ns, 0))
        if not block:
            return


def _settled(edges: Integers) -> Integers:
    """Return edges without those that take each other back at one time."""
    if not len(edges) or bool((edges[1:] > edges[:-1]).all()):
        return edges
    times, counts = np.unique(edges, return_counts=True)
    single: Integers = times[counts % 2 == 1]
    return single


def _wrong(source: Source, data: bytes, words: list[bytes], place: int, line: int) -> UnreadableError:
    """Return what is wrong with a word of a piece of the body that begins in a line."""
    at = [match.start() for match in re.finditer(rb"\S+", data)][place]
    shown = quote(words[place].decode("utf-8", "replace"))
    line += data.count(b"\n", 0, at)
    return UnreadableError(
        f"{source.name}: line {line}: expected a time as #123 that is not before the last, or a value "
        f"as 1! of a declared channel, got {shown!r}"
    )
