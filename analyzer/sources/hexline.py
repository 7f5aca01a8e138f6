"""One line of a hex text: its time, its mark, its bytes.

    000-Tx:01 03 00 00 00 0A C5 CD                   counter, mark, bytes
    [12:34:56.789] < FB 01 F6 01 F3                  time, mark, bytes
    [bus:0] Sending :  3e a4 01 0c ef                name of the line, mark, bytes
    [2023-04-30 22:40:55.899]# SEND HEX>             time and mark of the lines that follow
    0.012345 0xFA, 0x01, 0xF6  # run                 seconds, bytes, comment

Rules: what stands before the bytes is peeled off item by item; what is left must be bytes in one of the ways people
write them. A line that is not traffic is a comment if it looks like words, and broken if it looks like bytes gone
wrong.
"""

from __future__ import annotations

import ast
import re
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.sources.marks import LETTERS, SIGNS, WORDS, role_of


class Shape(StrEnum):
    """What a line is."""

    BLANK = "blank"
    TRAFFIC = "traffic"
    HEADER = "header"
    COMMENT = "comment"
    BROKEN = "broken"


class HexLine(NamedTuple):
    """A line taken apart.

    `stamp_kind`: which pattern of `STAMPS` the time `stamp` fits, "" without one. `name`: of the bus line. `marked`: a
    word or sign says who sent. `note`: a comment behind the bytes. `text`: what could not be understood, if anything.
    """

    shape: Shape
    data: bytes = b""
    stamp_kind: str = ""
    stamp: str = ""
    role: Role = Role.UNKNOWN
    name: str = ""
    note: str = ""
    text: str = ""
    marked: bool = False
    ascii: bool = False


_DAYTIME = r"\d{1,2}:\d\d:\d\d(?:[.,:]\d{1,9})?"
_UNIT = r"(?:\s?(?:ms|us|µs|ns|sec|s)(?![0-9A-Za-z]))"
#: Times by kind, each a pattern; the first that fits wins.
STAMPS: dict[str, str] = {
    "date": rf"\d{{4}}[-/.]\d{{1,2}}[-/.]\d{{1,2}}(?:[T_,]|\s){{1,2}}{_DAYTIME}(?:\s?Z\b|\s?[+-]\d\d:?\d\d\b)?",
    "dmy": rf"\d{{1,2}}\.\d{{1,2}}\.\d{{4}}(?:[T_,]|\s){{1,2}}{_DAYTIME}",
    "clock": _DAYTIME,
    "step": rf"\+\d{{1,19}}(?:\.\d{{1,12}}{_UNIT}?|{_UNIT})",
    "seconds": rf"\d{{1,19}}\.\d{{1,12}}{_UNIT}?",
    "units": rf"\d{{1,19}}{_UNIT}",
    "epoch_ms": r"\d{13}",
}
_stamps = "|".join(f"(?P<{kind}>{pattern})" for kind, pattern in STAMPS.items())
_words = "|".join(sorted(WORDS, key=len, reverse=True))
_letters = "|".join(LETTERS)
_signs = "|".join(re.escape(sign) for sign in sorted(SIGNS, key=len, reverse=True))
_END = r"(?![0-9A-Za-z_])"
_DECORATION = r"[\s:=<>|\])→←◇◆：,]*(?:-+[>\s]\s*)?"

_STAMP = re.compile(rf"\s*[\[(]?\s*(?:{_stamps})(?![0-9A-Za-z_.]|:[0-9A-Fa-f])\s*[\])]?(?:[\s,;:|]|-(?!>))*")
_WORD = re.compile(rf"[\s#*<>=\[(-]*(?P<word>{_words}){_END}{_DECORATION}", re.IGNORECASE)
_LETTER = re.compile(rf"\s*\[?(?P<letter>{_letters})\]?\s*[:>|]+\s*", re.IGNORECASE)
_SIGN = re.compile(rf"\s*(?P<sign>{_signs})(?![<>=-])[\s:]*")
_NAME = re.compile(
    r"\s*(?:\[(?P<name>[A-Za-z][\w :./\\#-]{0,40})\]|\[\d{1,9}\]"
    r"|(?P<port>(?:/dev/)?(?:tty|com|uart|bus|port)\w{1,20})(?=[\s:]))"
    r"[\s:,|-]*(?:>\s*(?=[A-Za-z]))?",
    re.IGNORECASE,
)
_COUNT = re.compile(rf"\s*#?\d{{1,9}}\s*[-.):]\s*(?=[<>\[(]*(?:{_words}){_END})", re.IGNORECASE)
_ASSIST = re.compile(r"\s*#\s*(?P<assist>SEND|RECV)\s+(?P<form>HEX|ASCII|BIN)[^>]{0,80}>\s*", re.IGNORECASE)
#: Behind a mark: what the bytes are called, how many they are, a counter as Modbus Poll prints it.
_BEHIND = re.compile(
    rf"(?:(?:hex|data|bytes?|frame|adu|pdu|buffer|buf|msg|message|raw){_END}[\s:=>]*"
    r"|len(?:gth)?\s*[=:]?\s*\d{1,5}\s*(?:bytes?)?[\s:=>,-]+"
    r"|[\[(]\s*(?:len\s*[=:]?\s*)?\d{1,5}\s*(?:bytes?|B)?\s*[\])][\s:=>-]*"
    r"|\d{3,9}-(?=\s*[0-9A-Fa-f]{2}(?:\s|$)))",
    re.IGNORECASE,
)
#: The shapes that most lines have, in one step: a time, a mark, plain hex bytes.
_USUAL = re.compile(
    rf"(?:[\[(]?(?:({STAMPS['date']})|({STAMPS['clock']})|(\d{{1,19}}\.\d{{1,12}}))[\])]?[\s,;|]+)?"
    rf"(?:({_words}|{_signs}){_DECORATION})?((?:[0-9A-Fa-f]{{2}} ?)+)",
    re.IGNORECASE,
)
_DISTANT_WORD = re.compile(rf"(?<![\w.])(?:{_words})\s*[:>\]=|]", re.IGNORECASE)
_DISTANT_LIMIT = 80

_COMMENT_SIGNS = ("#", "//", ";", "%", "*", "--", "/*", "'")
_BARE = re.compile(r"[0-9A-Fa-f]{1,2}(?:[\s,;:|_-]+[0-9A-Fa-f]{1,2})*[\s,;:|_-]*")
_PREFIXED = re.compile(r"(?:(?:0[xX]|\\[xX]|\$)[0-9A-Fa-f]{1,2}[\s,;:|-]*)+")
_SUFFIXED = re.compile(r"(?:[0-9A-Fa-f]{2}[hH][\s,;]*)+")
_LITERAL = re.compile(r"(?:bytearray\()?(b'.*'|b\".*\")\)?", re.DOTALL)
_TOKEN = re.compile(r"[0-9A-Fa-f]{1,2}")
_TWO_DIGITS = re.compile(r"[0-9A-Fa-f]{2}")
_DAYTIME_ONLY = re.compile(r"[0-2]?\d:[0-5]\d:[0-5]\d")
_TRAILING = re.compile(r"(?:#|//|;|\(|\||!|--(?=\s)).*", re.DOTALL)
_PREFIX_DIGITS = re.compile(r"0[xX]|\\[xX]|\$")
_SPLIT = re.compile(r"[\s,;:|]+")
_HEXLIKE = re.compile(r"(?:0[xX]|\\[xX]|\$)?[0-9A-Fa-f]{1,2}[hH]?")
_RUN = re.compile(r"(?=.{0,20}\d)[0-9A-Fa-f]{5,}")
_DIGITS = re.compile(r"[0-9A-Fa-f]{1,8}")
_LONG_RUN = re.compile(r"(?=.{0,20}\d)[0-9A-Fa-f]{8,}$")
#: What people put around bytes. The opening one may have been taken for a part of the mark.
_WRAPPERS = {"[": "]", "{": "}", "(": ")", '"': '"', "'": "'", "<": ">"}
_CLOSERS = " ]})>\"'"
#: The longest bytes literal that is evaluated.
_LITERAL_LIMIT = 1 << 16
_ITEMS = 8


def bytes_of(text: str) -> bytes | None:
    """Return the bytes that a text stands for in any of the usual ways, None if it is none of them."""
    try:
        return bytes.fromhex(text)
    except ValueError:
        pass
    literal = _LITERAL.fullmatch(text.strip())
    if literal is not None and len(text) <= _LITERAL_LIMIT:
        return _literal(literal[1])
    text = text.strip()
    if _WRAPPERS.get(text[:1]) == text[-1:] and len(text) > 2:
        text = text[1:-1].strip()
    if _BARE.fullmatch(text):
        # Bytes printed without leading zeros are short here and there; letters and single numbers are something else.
        plain = _TWO_DIGITS.search(text) is not None and not _DAYTIME_ONLY.fullmatch(text)
        return bytes(int(token, 16) for token in _TOKEN.findall(text)) if plain else None
    if _PREFIXED.fullmatch(text):
        return bytes(int(t.strip(" \t,;:|-"), 16) for t in _PREFIX_DIGITS.split(text) if t)
    if _SUFFIXED.fullmatch(text):
        return bytes.fromhex(re.sub(r"[hH,;]", " ", text))
    try:
        return bytes.fromhex(text[2:]) if text[:2] in ("0x", "0X") else bytes.fromhex(text)
    except ValueError:
        return None


def _literal(text: str) -> bytes | None:
    try:
        value = ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None
    return value if isinstance(value, bytes) else None


def take_apart(line: str) -> HexLine:
    """Take a line apart."""
    text = line.strip()
    if not text:
        return HexLine(Shape.BLANK)
    # Plain bytes need no pattern.
    plain = bytes_of(text) if text[2:3] == " " or text.isalnum() else None
    if plain:
        return HexLine(Shape.TRAFFIC, plain)
    usual = _USUAL.fullmatch(text)
    if usual is not None:
        date, clock, seconds, mark, digits = usual.groups()
        role = _role(mark) if mark is not None else Role.UNKNOWN
        kind = "date" if date is not None else "clock" if clock is not None else "seconds" if seconds is not None else ""
        stamp = date or clock or seconds or ""
        return HexLine(Shape.TRAFFIC, bytes.fromhex(digits), kind, stamp, role, "", "", "", mark is not None)
    plain = bytes_of(text)
    if plain:
        return HexLine(Shape.TRAFFIC, plain)
    return _Peeler(text).line()


@lru_cache(maxsize=256)
def _role(mark: str) -> Role:
    """Return who sent under one word or sign."""
    return role_of((mark.lower(),), mark)


class _Peeler:
    """Peels one line."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.kind = self.stamp = self.name = self.sign = ""
        self.words: list[str] = []
        self.ascii = False

    def line(self) -> HexLine:
        """Return the line taken apart."""
        text = self.text
        data, note = None, ""
        for _ in range(_ITEMS):
            if (self.words or self.sign or self.kind) and (data := bytes_of(text[self.at :])) is not None:
                break
            if not self._item():
                break
        rest = text[self.at :]
        if data is None:
            data, note = _with_note(rest)
        role = role_of(self.words, self.sign)
        marked = bool(self.words or self.sign)
        taken = (self.kind, self.stamp, role, self.name)
        commented = text.startswith(_COMMENT_SIGNS) and not (self.words and not rest)
        if data and not commented:
            return HexLine(Shape.TRAFFIC, data, *taken, note, "", marked)
        if not rest and (self.kind or marked):
            return HexLine(Shape.HEADER, b"", *taken, "", text, marked, self.ascii)
        broken = not commented and _is_broken(rest, marked)
        return HexLine(Shape.BROKEN if broken else Shape.COMMENT, b"", *taken, "", rest if broken else text, marked)

    def _item(self) -> bool:
        """Peel the next item off; say whether there was one."""
        text, at = self.text, self.at
        marked = bool(self.words or self.sign)
        if not self.kind and (found := _STAMP.match(text, at)):
            self.kind = found.lastgroup or ""
            self.stamp = found[self.kind]
        elif found := _ASSIST.match(text, at):
            self.words.append(found["assist"].lower())
            self.ascii = found["form"].upper() == "ASCII"
        elif found := _WORD.match(text, at):
            self.words.append(found["word"].lower())
        elif marked and (found := _BEHIND.match(text, at)):
            pass
        elif not marked and (found := _LETTER.match(text, at)):
            self.sign = found["letter"].lower()
        elif not marked and (found := _SIGN.match(text, at)):
            self.sign = found["sign"]
        elif not self.name and (found := _NAME.match(text, at)):
            self.name = found["name"] or found["port"] or ""
        elif not marked and (found := _COUNT.match(text, at)):
            pass
        elif not marked and (distant := _DISTANT_WORD.search(text, at, at + _DISTANT_LIMIT)):
            # A logger's own words ("DEBUG:pymodbus.logging:send: 0x1 0x3") stand before the mark.
            self.at = distant.start()
            return True
        if found is None or found.end() == at:
            return False
        self.at = found.end()
        return True


def _with_note(rest: str) -> tuple[bytes | None, str]:
    """Return the bytes at the beginning of a text and what stands behind them as a comment."""
    data = bytes_of(rest.rstrip(_CLOSERS))
    if data is not None:
        return data, ""
    found = _TRAILING.search(rest)
    if found is not None and found.start() > 0:
        data = bytes_of(rest[: found.start()])
        if data:
            return data, found[0].strip()
    # A column of the same bytes as characters, as dumps have.
    head, gap, column = rest.partition("  ")
    if gap:
        data = bytes_of(head)
        if data is not None and len(data) == len(column.strip()):
            return data, ""
    return None, ""


def _is_broken(rest: str, marked: bool) -> bool:
    """Say whether a text that is no bytes looks as if it was meant to be."""
    tokens = [t for t in _SPLIT.split(rest[:4096]) if t]
    alike = sum(1 for t in tokens if _HEXLIKE.fullmatch(t))
    runs = sum(1 for t in tokens if _RUN.match(t))
    if len(tokens) == 1:
        return bool(_LONG_RUN.match(tokens[0]) or (marked and _DIGITS.fullmatch(tokens[0])))
    return alike + runs >= 2 and 2 * (alike + runs) >= len(tokens)
