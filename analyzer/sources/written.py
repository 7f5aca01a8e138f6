"""Bytes as people and tools write them: one table of ways, and what tells hexadecimal from decimal.

    FA 01 F6   fa01f6   FA:01:F6   FA-01-F6   0xFA, 0x1, 0xF6   {0xFA, 0x01}   FAh 01h   $FA $01   16#FA &HFA   FA 1 F6
    <FA><01><F6>   [fa][01][f6]   {FA}{01}{F6}   'fa', '01', 'f6'   <Buffer fa 01 f6>   bytes([0xFA, 1, 0xF6])
    b'\\xfa\\x01'   "\\xfa\\x01%"   "\\372\\1"   250 1 246   [250, 1, 246]   -6 1 -10   (-6 is FA)   250-1-246

Rules: two digits a byte are hexadecimal. Numbers are decimal only where one of them cannot be a byte in hexadecimal: it has
three digits or a sign. Single digits without a letter among them (`1 4 0 30`) can be either; the whole text decides. In a list
where some numbers have 0x, the others are decimal, as in a program: `[0xFA, 1, 246]`. So are those of a list in brackets, with
commas, and without a zero before a digit: `[58,48,49,13,10]`.
"""

from __future__ import annotations

import ast
import html
import re
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

from analyzer.link import modbus_crc


class Radix(StrEnum):
    """What numbers certainly are, or `either`."""

    HEX = "hexadecimal"
    DECIMAL = "decimal"
    EITHER = "either"


class Written(NamedTuple):
    """Bytes, and how certain it is that they are written in hexadecimal."""

    data: bytes
    radix: Radix = Radix.HEX


#: The longest string that is evaluated.
_LITERAL_LIMIT = 1 << 16
#: Calls and declarations that stand around bytes in programs and their output.
_CALL = re.compile(
    r"(?:<Buffer\s|(?:bytes|bytearray|list|Buffer\.from|bytes\.fromhex|bytearray\.fromhex)\(|new\s+byte\[\d*\]\s*|(?:\[\]byte|Uint8Array\(\d*\)\s*)(?=[\[{]))"
)
_WRAPPERS = {"`": "`", "[": "]", "{": "}", "(": ")", '"': '"', "'": "'", "<": ">"}
_TOKEN = re.compile(r"[0-9A-Fa-f]{1,2}")
_TWO_DIGITS = re.compile(r"[0-9A-Fa-f]{2}")
_HEX_LETTER = re.compile(r"[A-Fa-f]")
_DAYTIME = re.compile(r"[0-2]?\d:[0-5]\d:[0-5]\d")
_NUMBER = re.compile(r"-?\d{1,3}")
_ESCAPE = re.compile(r"\\(?:x[0-9A-Fa-f]{2}|[0-7])")
_LATIN = re.compile("[\x80-\xff]")
_ZERO = re.compile(r"(\\\\)|\\0")
#: `10-15-0-204`, as modbus_tk prints it: no signs.
_DASHED = re.compile(r"\d{1,3}(?:-\d{1,3})+")
_QUOTES = str.maketrans("", "", "'\"")
#: Digits alone, as they stand in a decimal text.
_DIGITS = re.compile(r"-?\d{1,3}(?:[\s,;]+-?\d{1,3})*[\s,;]*|\d{1,3}(?:-\d{1,3})+")


#: Bytes that a person has typed, with a letter O for a zero; a small one may be that of a word.
_TYPED = re.compile(
    r"(?<![^\s:=>|\[(])(?=[A-FO\s]*\d)(?=[\dA-F\s]*O)(?:[\dA-FO]{2}\s){2,}[\dA-FO]{2}(?![^\s.,;|\])])"
    r"|(?<=: )(?=[\dA-F ]*O)(?:[\dA-FO]{2} )*[\dA-FO]{2}$"
)


def plain(line: str) -> str:
    """Return a line of a post without the marks of its layout, and without the casts that Java and C need."""
    if "`" in line and (quoted := _INLINE.fullmatch(line)) is not None:
        line = quoted[1]
    if "-0x" in line:
        line = _BULLET.sub("", line)
    if "**" in line:
        line = _EMPHASIS.sub("", line)
    if "O" in line:
        line = _TYPED.sub(lambda found: found[0].replace("O", "0"), line)
    if "</" in line or "[/" in line:
        line = _TAG.sub("", line)
    if '"Buffer"' in line:
        line = _JSON_BUFFER.sub(_as_buffer, line)
    line = unescaped(line)
    return _CAST.sub("", line) if ")0x" in line or ") 0x" in line else line


def unescaped(line: str) -> str:
    """Return a line without what a page has for characters."""
    if "&" not in line or _ENTITY.search(line) is None:
        return line
    return html.unescape(_BREAK.sub("", line)).replace("\xa0", " ")


#: What stands for characters in the text of a page, and its ends of lines.
_ENTITY, _BREAK = re.compile(r"&(?:[gl]t|amp|nbsp|quot|#\d{2,4});"), re.compile(r"<br ?/?>")
#: A Buffer of Node as it stands in JSON, or in an object of JSON with nothing else.
_JSON_BUFFER = re.compile(
    r'(\{\s*"\w+"\s*:\s*)?\{\s*"type"\s*:\s*"Buffer"\s*,\s*"data"\s*:\s*\[(?P<numbers>(?:\s*\d{1,3}\s*,)*\s*\d{1,3}\s*)\]\s*\}(?(1)\s*\})'
)


def _as_buffer(found: re.Match[str]) -> str:
    """Return a Buffer of Node as its console prints it; with a number that is no byte it stays as it is."""
    values = [int(number) for number in _NUMBER.findall(found["numbers"])]
    if max(values) > _LARGEST:
        return found[0]
    return f"<Buffer {bytes(values).hex(' ')}>"


def _bare(text: str) -> Written | None:
    # Bytes printed without leading zeros are short here and there; letters and single numbers are something else.
    if _TWO_DIGITS.search(text) is None or _DAYTIME.fullmatch(text):
        return None
    tokens = _TOKEN.findall(text)
    sure = _HEX_LETTER.search(text) is not None or all(len(token) == 2 for token in tokens)
    return Written(bytes(int(token, 16) for token in tokens), Radix.HEX if sure else Radix.EITHER)


def _marked(text: str) -> Written:
    return Written(bytes(int(token, 16) for token in _TOKEN.findall(re.sub(r"0[xX]|\\[xX]|(?:B#)?16#|&[hH]|[$hH]", " ", text))))


def _each(text: str) -> Written | None:
    return read(re.sub(r"[\[\]<>{}()]+", " ", text).strip())


def _mixed(text: str) -> Written | None:
    """Return the bytes of a list of a program, in which some numbers have 0x: the others are decimal."""
    values = [int(token, 16 if token[:2].lower() == "0x" else 10) for token in _EITHER.findall(text)]
    return Written(bytes(values)) if max(values) <= _LARGEST else None


def _listed(text: str) -> Written:
    return Written(bytes(int(token) for token in _NUMBER.findall(text)))


#: A list of numbers as languages print it. One of three digits tells more, of the whole text.
_LISTED = re.compile(r"[\[{(]\s*(?:0|[1-9]\d?)(?:\s*,\s*(?:0|[1-9]\d?)){3,}\s*,?\s*[\]})]")
_EITHER, _LARGEST = re.compile(r"0[xX][0-9A-Fa-f]{1,2}|\d{1,3}"), 0xFF


def _literal(text: str) -> Written | None:
    if len(text) > _LITERAL_LIMIT:
        return None
    # Python 2 prints the characters of bytes as they are.
    text = _LATIN.sub(lambda found: f"\\x{ord(found[0]):02x}", text)
    if "\\x" in text:
        # Beside hexadecimal escapes `\0` is a zero, as Rust prints it, and no octal number begins with it.
        text = _ZERO.sub(lambda found: found[1] or "\\x00", text)
    try:
        value = ast.literal_eval(text if text[0] == "b" else f"b{text}")
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None
    return Written(value) if isinstance(value, bytes) else None


def _escaped(text: str) -> Written | None:
    """Return the bytes of a string with escapes; one without may be any words."""
    return _literal(text) if _ESCAPE.search(text) is not None else None


def _parted(text: str) -> Written | None:
    """Return the bytes of a string as Qt prints it: a digit that goes with no escape stands behind two quotes."""
    parts = [
        _escaped(f'"{_SHORT_ESCAPE.sub(_PADDED, part)}"') or Written(part.encode("latin-1", "replace"))
        for part in text[1:-1].split('""')
    ]
    return Written(b"".join(part.data for part in parts)) if _ESCAPE.search(text) is not None else None


_SHORT_ESCAPE, _PADDED = re.compile(r"\\x(?=[0-9A-Fa-f](?![0-9A-Fa-f]))"), r"\\x0"


def decimal(text: str) -> bytes | None:
    """Return the bytes of a text of decimal numbers, None if it is none, or has numbers that are no bytes."""
    text = _unwrapped(text.strip())
    if _DIGITS.fullmatch(text) is None:
        return None
    values = [int(token) for token in (text.split("-") if _DASHED.fullmatch(text) else _NUMBER.findall(text))]
    return bytes(value & 0xFF for value in values) if all(-128 <= value <= 255 for value in values) else None


def _decimal(text: str) -> Written | None:
    data = decimal(text)
    return None if data is None or len(data) < 2 else Written(data, Radix.DECIMAL)


def behind_number(text: str) -> int:
    """Return where bytes begin behind a number of two digits that stands apart from them; 0 where none does.

    It is one of a table, unless a CRC says otherwise. A hexadecimal one is told by a head of a frame behind it.
    """
    found = _NUMBERED.match(text)
    return found.end() if found is not None and modbus_crc(bytes.fromhex(found[1] + (found[2] or found[3]))) else 0


_NUMBERED = re.compile(
    r"\s*(\d\d|[01][A-Fa-f](?=\s+(?:FA|FB|3E|fa|fb|3e)))"
    r"(?:\s{2,}(?=([0-9A-Fa-f]{2}(?: [0-9A-Fa-f]{2}){2,})(?:\s\s|\s*$))|\s+(?=((?:[0-9A-Fa-f]{2}){4,})(?:\s|$)))"
)
#: What bytes begin with, however they are written: most words do not.
_BEGIN = re.compile(
    r"[\[{(<\"'`\\$&-]|(?:B#)?16#|[0-9A-Fa-f]{1,2}(?![0-9A-Za-z_.])|0[xX]|\d{3}|[0-9A-Fa-f]{4}|(?:[0-9A-Fa-f]{2}\.){3}|[0-9A-Fa-f]{2}[hH]|b['\"]|byte|list|new|Buffer|Uint8Array"
)
#: A line of a log that a post shows as a piece of code of its own.
_INLINE = re.compile(r"\s*`([^`]+)`\s*")
#: The dash of a list in a post, which no byte has.
_BULLET = re.compile(r"^\s*-(?=0x[0-9A-Fa-f]{1,2}\b)")
#: What makes letters bold in a post.
_EMPHASIS = re.compile(r"(?<=[\s\dA-Fa-f_])\*\*_?|_?\*\*(?=[\s\dA-Fa-f_])")
_TAG = re.compile(
    r"</?(?:b|i|u|em|p|br|li|td|tr|pre|code|span|strong)(?: [^<>]*)?/?>|\[/?(?:b|i|u|code|color|size)(?:=[^\]]*)?\]",
    re.IGNORECASE,
)
_CAST = re.compile(r"\((?:byte|char|u?int8_t|unsigned char)\)\s?(?=0[xX])")
_GAP = r"(?:\s*[,;|_-]\s*|\s+|:)"
#: Ways to write bytes, the first that fits wins. Plain pairs of digits are read before these.
_WAYS: tuple[tuple[re.Pattern[str], Callable[[str], Written | None]], ...] = tuple(
    (re.compile(pattern, re.DOTALL), reader)
    for pattern, reader in (
        (r"b'.*'|b\".*\"", _literal),
        (r"'(?:[^'\\]|\\.)*+'", _escaped),
        (r'"(?:[^"\\]|\\.)*+"', _escaped),
        (r'"(?:[^"\\]|\\.|"")*+"', _parted),
        (r"(?:(['\"])(?:0[xX])?[0-9A-Fa-f]{1,2}\1[\s,;]*){2,}", lambda text: read(text.translate(_QUOTES))),
        (r"(?:[\[<{(]\s*(?:(?:0[xX])?[0-9A-Fa-f]{1,2}|\d{3})\s*[\]>})]\s*){2,}", _each),
        (rf"[0-9A-Fa-f]{{1,2}}(?:{_GAP}[0-9A-Fa-f]{{1,2}})*[\s,;:|_-]*", _bare),
        (r"(?:(?:0[xX]|\\[xX]|\$|(?:B#)?16#|&[hH])[0-9A-Fa-f]{1,2}[\s,;:|-]*)+", _marked),
        (r"(?=.*0[xX])(?:0[xX][0-9A-Fa-f]{1,2}|\d{1,3})(?:\s*,\s*(?:0[xX][0-9A-Fa-f]{1,2}|\d{1,3}))+\s*,?\s*", _mixed),
        (r"(?:[0-9A-Fa-f]{2}[hH][\s,;]*)+", _marked),
        (r"(?:\\[0-9A-Fa-f]{2}){3,}", lambda text: Written(bytes.fromhex(text.replace("\\", "")))),
        (
            r"(?:[0-9A-Fa-f]{2}\.){5}(?:\.?[0-9A-Fa-f]{2})+|(?=.*[A-Fa-f])[0-9A-Fa-f]{2}(?:\.[0-9A-Fa-f]{2}){3,}",
            lambda text: Written(bytes.fromhex(text.replace(".", ""))),
        ),
        (r"0[xX](?:[0-9A-Fa-f]{2})+", lambda text: Written(bytes.fromhex(text[2:]))),
        (r"(?=.*(?:\d{3}|-\d))-?\d{1,3}(?:[\s,;]+-?\d{1,3})+[\s,;]*", _decimal),
        (r"(?=.*\d{3})\d{1,3}(?:-\d{1,3})+", _decimal),
    )
)


def read(text: str) -> Written | None:
    """Return the bytes that a text stands for in any of the usual ways, None if it is none of them."""
    try:
        return Written(bytes.fromhex(text))
    except ValueError:
        pass
    text = text.strip()
    if _BEGIN.match(text) is None:
        return None
    found = _way(text) if _LISTED.fullmatch(text) is None else _listed(text)
    if found is None and (inner := _unwrapped(text)) != text:
        found = _way(inner)
    return found


def _way(text: str) -> Written | None:
    for pattern, reader in _WAYS:
        if pattern.fullmatch(text) is not None and (found := reader(text)) is not None:
            return found
    try:
        return Written(bytes.fromhex(text))
    except ValueError:
        return None


def _unwrapped(text: str) -> str:
    """Return what stands inside brackets, quotes, a call or a declaration."""
    text = text.rstrip("; ")
    if (call := _CALL.match(text)) is not None:
        text = text[call.end() :].rstrip(" )>")
        # A call leaves the brackets of its argument.
    if _WRAPPERS.get(text[:1]) == text[-1:] and len(text) > 2:
        text = text[1:-1].strip()
    return text
