"""UART annotations of sigrok: the text of sigrok-cli, and what PulseView exports.

    uart-1: FA                            sigrok-cli -A uart=rx-data
    1234-5678 uart-1: FA                  the same with --protocol-decoder-samplenum
    uart-1: rx-data: FA                   with --protocol-decoder-ann-class
    1234-5678 UART: RX data: FA           PulseView, with the row or class in the middle
    uart-1: FA 01 30 2B                   a burst, as scripts put it together

Rules: each byte is a chunk, and so is what one line has. Start, stop and parity bits are passed over. Sample numbers become
times only with the line speed (`--baud`), which tells how long the 8 bits of a byte are; else the capture has no times. `RX`
and `TX` say who sent once something was sent.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from analyzer.catalogue import Role
from analyzer.records import Chunk
from analyzer.sources.lines import Lines, fitting, head_lines
from analyzer.sources.marks import ReceivedMarks, role_of_name
from analyzer.sources.source import Source, quote
from analyzer.values import SECOND_NS

_LINE = re.compile(
    r"\"?(?:(\d{1,18})-(\d{1,18})\"?\s+)?\"?([A-Za-z][\w .\[\]-]{0,40}?)\"?:\s(?:\"?([A-Za-z][\w -]{0,30})\"?:\s)?(.+)$"
)
_DATA_CLASS = re.compile(r"(?:(rx|tx)[ -]?(?:data|dump)?|data)$", re.IGNORECASE)
_OTHER_CLASS = re.compile(r"(rx|tx)[ -]?\w+|.*(bits?|warnings?|packets?|break|start|stop|parity).*", re.IGNORECASE)
_QUOTED = re.compile(r'"([^"]*)"')
_HEX = re.compile(r"(?:0x|@|\[)?([0-9A-Fa-f]{2})\]?$")
_BURST = re.compile(r"(?:[0-9A-Fa-f]{2} ){1,299}[0-9A-Fa-f]{2}$")
_BITS = re.compile(r"[01]{8}$")
_BIT_WORDS = re.compile(r"(start|stop|parity|break|frame|idle|rx|tx)\b", re.IGNORECASE)
_DATA_BITS, _FRAME_BITS = 8, 10


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are UART annotations, 0..1."""
    lines = head_lines(head)
    return 0.95 * fitting(lines, [_tells(line) for line in lines])


def _tells(line: str) -> bool:
    """Say whether a line is an annotation of a UART."""
    found = _LINE.match(line.strip())
    return found is not None and (
        "uart" in found[3].lower() or (found[1] is not None and _DATA_CLASS.match(found[4] or "") is not None)
    )


def read(source: Source) -> Iterator[Chunk]:
    """Read the bytes."""
    numbered = any(m[1] for line in head_lines(source.head) if (m := _LINE.match(line.strip())) is not None)
    if numbered and source.baud:
        source.time_source = f"capture: sample numbers, at {source.baud} baud by the length of the bytes"
    elif numbered:
        source.note("the sample numbers have no rate: give --baud to turn them into times")
    return _records(source)


def _records(source: Source) -> Iterator[Chunk]:
    lines = Lines(source)
    heard = ReceivedMarks()
    #: Samples of the first byte, which last 8 bits.
    samples = 0
    for line in lines:
        text = line.strip()
        if not text:
            continue
        found = _LINE.match(text)
        if found is None:
            source.problem(f"expected 'samples decoder: byte', got {quote(text)!r}", line=lines.number)
            continue
        start, stop, decoder, kind, value = found.groups()
        if kind is not None and not _DATA_CLASS.match(kind) and _OTHER_CLASS.match(kind):
            continue
        data = _bytes(value, kind is not None)
        if data is None:
            # A bit lasts an eighth of a byte; a byte that lost a digit lasts as long as the others.
            bit = value in ("0", "1") and not (samples and start is not None and 2 * (int(stop) - int(start)) > samples)
            if not _BIT_WORDS.match(value.strip('"')) and not bit:
                source.problem(f"expected a byte of two hex digits, got {quote(value)!r}", line=lines.number)
            continue
        t_ns = None
        if start is not None:
            # A burst has the bits between its bytes, too.
            samples = samples or (int(stop) - int(start)) * _DATA_BITS // (_FRAME_BITS * len(data) - 2)
            if source.baud and samples > 0:
                t_ns = int(stop) * (_DATA_BITS * SECOND_NS // source.baud) // samples
        role = role_of_name(kind or decoder)
        named = kind is None and role is not Role.UNKNOWN
        port = (
            None if named or (decoder.lower().rstrip("-1").startswith("uart") and decoder[-1:] not in "23456789") else decoder
        )
        yield Chunk(t_ns, source.port(port), data, heard(role), len(data) > 1)


def _bytes(value: str, classed: bool) -> bytes | None:
    """Return an annotation's bytes, mostly one, None if it is none."""
    quoted = _QUOTED.match(value)
    text = quoted[1] if quoted is not None else value
    found = _HEX.match(text)
    if found is not None:
        return bytes.fromhex(found[1])
    if _BURST.match(text):
        return bytes.fromhex(text)
    if _BITS.match(text):
        return bytes((int(text, 2),))
    # The decoder's format "ascii" prints one character; a lone 0 or 1 is a bit unless the line says it is data.
    if len(text) == 1 and text.isascii() and (classed or text not in "01"):
        return text.encode()
    return None
