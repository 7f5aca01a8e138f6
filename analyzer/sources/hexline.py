"""One line of a hex text: its time, its mark, its bytes.

    000-Tx:01 03 00 00 00 0A C5 CD                   counter, mark, bytes
    [12:34:56.789] < FB 01 F6 01 F3                  time, mark, bytes
    [12:34:56][D][uart_debug:114]: >>> FA:01:30:2B   time, tags, mark, bytes
    [bus:0] Sending :  3e a4 01 0c ef                name of the line, mark, bytes
    receive:   5: FB 01 F6 01 F3                     mark, count, bytes
    Will write to instrument (expecting 7): 01 04    a phrase with a mark in it, bytes
    uint8_t run[] = {0xFA, 0x01, 0xF6};              declaration or call, bytes
    [2023-04-30 22:40:55.899]# SEND HEX>             time and mark of the lines that follow
    12 | 14:22:01.100 | TX | 4 | FA 01 32 2D         number of the line, time, mark, count, bytes
    0.012345 0xFA, 0x01, 0xF6  # run                 seconds, bytes, comment

Rules: what stands before the bytes is peeled off item by item, by one table; what is left must be bytes in one of the ways
people write them (`written.py`). A line that is not traffic is a comment if it looks like words, and broken if it looks like
bytes gone wrong.
"""

from __future__ import annotations

import re
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.link import modbus_crc
from analyzer.sources import written
from analyzer.sources.hexitems import (
    CONTENT,
    DECORATION,
    DISTANT,
    DISTANT_LIMIT,
    DISTANT_TIME,
    ITEMS,
    LETTER,
    PAIR,
    PHRASE,
    SIGNS_PATTERN,
    WORDS_PATTERN,
    When,
)
from analyzer.sources.lines import remembered
from analyzer.sources.marks import ACTIONS, LETTERS, MATTERS, SIGNS, SPEAKERS, TO, WORDS, role_of, speaker_of
from analyzer.sources.stamps import ANY, STAMPS, Stamp
from analyzer.sources.written import Radix, Written


class Shape(StrEnum):
    """What a line is."""

    BLANK = "blank"
    TRAFFIC = "traffic"
    HEADER = "header"
    COMMENT = "comment"
    BROKEN = "broken"


class HexLine(NamedTuple):
    """A line taken apart.

    `stamp`: its time as printed. `role`: who sent, by words and signs. `sign`: the sign before the bytes, the brackets around
    each of them, or `binary` for a byte that is printed bit by bit. `worded`: a word says who sent. `name`: of the bus line.
    `number`: it stands before the bytes. `led`: no colon parts it from them.
    `declared`: what a program calls the bytes. `note`: a comment behind the bytes. `passed`: words before the mark.
    `text`: what could not be understood, if anything.
    `radix`: how sure the bytes are.
    """

    shape: Shape
    data: bytes = b""
    stamp: Stamp = Stamp()
    role: Role = Role.UNKNOWN
    name: str = ""
    note: str = ""
    text: str = ""
    sign: str = ""
    worded: bool = False
    ascii: bool = False
    number: int | None = None
    led: bool = False
    radix: Radix = Radix.HEX
    passed: str = ""
    declared: str = ""

    @property
    def marked(self) -> bool:
        """Whether a word or sign says who sent."""
        return self.worded or self.sign in SIGNS or self.sign in LETTERS or TO in self.sign


#: A digit before bytes that all have two digits is no byte, where some byte keeps its zero or has a letter.
_LEAD = re.compile(
    r"(\d)(?:\s*[|;,]\s*|\s+)(?=.*(?:[A-Fa-f]|\b0\d))(?=[0-9A-Fa-f]{2}(?:[\s:-]?[0-9A-Fa-f]{2}){2,}(?:\s+-{1,3})?\s*$)"
)
#: Such a number in a text whose lines all have one.
LEADS = re.compile(r"(\d{1,6})(?:\s*[|;,]\s*|\s+)(?=[0-9A-Fa-f]{2}(?:[\s:-]?[0-9A-Fa-f]{2}){2,}(?:\s+-{1,3})?\s*$)")
#: A time of day in whole seconds, which could be three bytes, before bytes that no colon parts.
_SECONDS = re.compile(r"[0-2]?\d:[0-5]\d:[0-5]\d[\s,;|]++[^:]*+")
#: The shapes that most lines have, in one step: a time, a mark, plain hex bytes.
_USUAL = re.compile(
    rf"(?:[\[(]?(?:({STAMPS['date']})|({STAMPS['clock']})|(\d{{1,19}}\.\d{{1,12}}))[\])]?[\s,;|]+)?"
    rf"(?:({WORDS_PATTERN}|{SIGNS_PATTERN}){DECORATION})?((?:[0-9A-Fa-f]{{2}} ?)+)",
    re.IGNORECASE,
)

_COMMENT_SIGNS = ("#", "//", ";", "%", "*", "--", "/*", "'", "```")
_ARROW = re.compile(r"-+>")
_TRAILING = re.compile(r"(?:(?<!\b16)#|//|;|\(|\||!|--(?=\s)|(?<![-=])[-=]++>|<[-=]+|[→←]|>\s*\d+ bytes?\b).*", re.DOTALL)
#: Words behind bytes: `old_data:`, `, 4) = 4`, `OK`.
_WORDY = re.compile(
    r"(?<=[\s\"'\])},])"
    r"(?:[A-Za-z_]{2}\w*+(?: data)?\s*[:=]|,\s*\d+\s*(?:,\s*\w+\s*)?\)|[A-Za-z]{3}(?:\s|$)|[G-Zg-z_][A-Za-z_]{2,}+(?:\s|$)).*",
    re.DOTALL,
)
_STRING = re.compile(r"`[^`]*`|b?('(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\")")
_EACH = re.compile(r"([\[<])\s*(?:0x)?[0-9A-Fa-f]{1,2}\s*[\]>]\s*[\[<]")
_SPLIT = re.compile(r"[\s,;:|]+")
_HEXLIKE = re.compile(r"(?:0[xX]|\\[xX]|\$)?[0-9A-Fa-f]{1,2}[hH]?")
_RUN = re.compile(r"(?=.{0,20}\d)[0-9A-Fa-f]{5,}")
_DIGITS = re.compile(r"[0-9A-Fa-f]{1,8}")
_LONG_RUN = re.compile(r"(?=.{0,20}\d)[0-9A-Fa-f]{8,}$")
#: One byte of a log, printed twice, perhaps with a remark: `Modbus received Byte  27 (0X1b)  == the unit`,
#: `Read 0b00011011 (0x1B)`.
_TWICE = re.compile(
    r"(?P<before>.*[\s:=])(?:0b(?P<binary>[01]{8})|(?P<decimal>\d{1,3}))\s*[(\[](?:0[xX])?(?P<hex>[0-9A-Fa-f]{1,2})[)\]]"
    r"(?:\s*(?:==|=|//|#|;|<-+|-+>?)\s.*)?"
)
#: One byte of a log behind its index: `byte 3: 0x02`, `Received byte[3] = 0x02`.
_INDEXED = re.compile(
    r"(?P<before>.*?)\bbyte\s*[\[#(]?\s*\d{1,3}\s*[\])]?\s*[:=]\s*0[xX](?P<hex>[0-9A-Fa-f]{1,2})", re.IGNORECASE
)
#: One byte of a log before the name of who sent it: `0.000260 TAB 0x01 TAB HOST`.
_SIDED = re.compile(r"(?P<before>[^\t]*)\t(?:0[xX])?(?P<hex>[0-9A-Fa-f]{2})\t(?P<side>[A-Za-z]+)")
_NUMBER = re.compile(r"\d+\s*")
#: Two unknown names are a mark only if nothing but bytes follows them.
_FRAME = re.compile(rf"(?:{PAIR}[\s,:-]*){{3,}}")
_AROUND_NOTE = " \t,;|"
#: The place of the first byte, as rows of dumps have it.
_PLACE = re.compile(
    r"(?:0x[0-9A-F]{8}(?=\s\s)|0{4}|[0-9A-F]{8}|[0-9A-F]{3}0)(?::\s*|\s{2,})(?=[0-9A-F]{2}(?:\s|$))", re.IGNORECASE
)
#: How many bytes there are, in a cell before theirs.
_COUNT_CELL = re.compile(
    r"(\d{1,5})\s*[;,|\t]\s*(?=(?:(?:0x|16#)?[0-9A-F]{2}(?: |-|:|\s*$)){2}|(?:[0-9A-F]{2}){3,}\s*(?:$|[;,|\t]))", re.IGNORECASE
)
#: What a logger puts before its words; that of Android has a letter before its tag, as `D/Servo:`.
_LEVEL = re.compile(r"\b(?:DEBUG|INFO|WARN(?:ING)?|ERROR|TRACE)\b|(?<![\w.])[VDIWEF](?:/|[ \t]+)$")
_NAME_PARTS = re.compile(r"[._]")
#: The parts of a name: `tx_buf`, `txBuf`, `abTx`, `tx0`.
_PARTS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")
#: A sentence before a mark: no header of bytes.
_TWO_WORDS = re.compile(r"[^\W\d_]+ [^\W\d_]+ $")
#: Words of a sentence, and how many of them are one.
_PLAIN_WORD = re.compile(r"[^\W\d_]{3,}[.!?]?")
_SENTENCE_WORDS = 3
#: Groups of items that are times, with the kind of each; those that are words of who sent.
_KINDS_OF_TIME = {kind: kind for kind in STAMPS} | dict.fromkeys(("millis", "counted", "leading"), "millis")
_SAID = {"host": "host", "drive": "drive", "shell": "sent"}
_BRACKETS = {"[": "]", "{": "}", "(": ")"}
_CLOSERS = " ]})>\"'□`"
_ITEM_LIMIT = 10
_LONGEST_HEADER = 120
_COLONS_OF_TIME = 2


def bytes_of(text: str) -> bytes | None:
    """Return the bytes that a text stands for in any of the usual ways, None if it is none of them."""
    found = written.read(text)
    return None if found is None else found.data


def take_apart(line: str, decimal: bool = False, led: bool = False) -> HexLine:
    """Take a line apart. `decimal`: numbers without a letter among them are decimal ones. `led`: a number leads the bytes."""
    text = written.plain(line).strip()
    if not text:
        return HexLine(Shape.BLANK)
    if ";" in text and _FIELDS.fullmatch(text) is not None:
        text = _of_record(text)
        if not text:
            return HexLine(Shape.COMMENT, text=line.strip())
    if (
        (text[-1] in ")]" or "(0" in text)
        and (twice := _TWICE.fullmatch(text)) is not None
        # Bytes before it, glued to one line, are not to be lost.
        and "(0x" not in twice["before"].lower()
        and (int(twice["binary"], 2) if twice["binary"] else int(twice["decimal"])) == int(twice["hex"], 16)
    ):
        return _of_one(twice)
    if "0x" in text[-4:].lower() and (indexed := _INDEXED.fullmatch(text)) is not None:
        return _of_one(indexed)
    if "\t" in text and (sided := _SIDED.fullmatch(text)) is not None and sided["side"].lower() in (*SPEAKERS, *WORDS):
        return _of_one(sided)
    if decimal:
        numbers = _numbers(text)
        return (
            HexLine(Shape.TRAFFIC, numbers.data, radix=numbers.radix)
            if numbers is not None and numbers.data
            else _as_it_stood(_peeled(text, decimal), line)
        )
    if led:
        return _as_it_stood(_peeled(text, led=True), line)
    # Plain bytes need no pattern.
    numbered = text[2:3] in " \t" and written.behind_number(text) > 0
    plain = written.read(text) if (text[2:3] == " " or text.isalnum()) and not numbered else None
    if plain is not None and plain.data:
        return HexLine(Shape.TRAFFIC, plain.data, radix=plain.radix)
    usual = _USUAL.fullmatch(text) if not numbered else None
    if usual is not None:
        date, clock, seconds, mark, digits = usual.groups()
        kind = "date" if date is not None else "clock" if clock is not None else "seconds" if seconds is not None else ""
        stamp = Stamp(kind, date or clock or seconds) if kind else Stamp()
        worded = mark is not None and mark.lower() in WORDS
        return HexLine(
            Shape.TRAFFIC, bytes.fromhex(digits), stamp, _role(mark or ""), sign="" if worded else mark or "", worded=worded
        )
    headed = _LEAD.match(text) or LETTER.match(text) or _SECONDS.fullmatch(text)
    plain = written.read(text) if headed is None and not numbered else None
    if plain is not None and plain.data:
        each = _EACH.match(text)
        return HexLine(Shape.TRAFFIC, plain.data, sign=f"each{each[1]}" if each is not None else "", radix=plain.radix)
    return _as_it_stood(_peeled(text), line)


#: A record of named fields, and the field that has a frame.
_FIELDS = re.compile(r"(?:[A-Za-z_]\w*=[^;=]*;){2,}(?:[A-Za-z_]\w*=[^;=]*)?")
_FRAME_FIELD = re.compile(rf"(?:(?P<who>{WORDS_PATTERN})|hex|{CONTENT})=(?P<bytes>(?:{PAIR}[ -]?){{2,}})", re.IGNORECASE)


def _of_record(text: str) -> str:
    """Return the time, the mark and the bytes of a record of named fields; empty where none has a frame."""
    fields = [field.strip() for field in text.split(";")]
    frames = [found for field in fields if (found := _FRAME_FIELD.fullmatch(field)) is not None]
    values = [field.partition("=")[2].strip() for field in fields]
    kept = [value for value in values if re.fullmatch(ANY, value, re.IGNORECASE) or value.lower() in WORDS]
    return " ".join((*kept, frames[0]["who"] or "", frames[0]["bytes"])) if len(frames) == 1 else ""


def _as_it_stood(found: HexLine, line: str) -> HexLine:
    """Return words with the marks of their layout, which only bytes have to lose."""
    return found._replace(text=line.strip()) if found.shape is Shape.COMMENT else found


#: A string of hex digits that a program writes: what goes out are its letters, unless something makes bytes of it. With 0x it
#: may be printed for a person.
_AS_TEXT = re.compile(
    r"""(?:[^"']*[\s=(;])?[A-Za-z_]\w*\.(?:write(?:Line)?|print(?:ln)?(?!\(.0x)|send|puts)\(\s*[bu]?(["'])"""
    r"""(?P<digits>(?:(?:0x)?[0-9A-F]{2}[ ,:]{0,2}){3,})\1"""
    r"""(?:\.encode\([^()]*\))?\s*(?:,(?!\s*['"]hex)[^"']*)?\)(?P<rest>.*)""",
    re.IGNORECASE,
)


@remembered
def _peeled(text: str, decimal: bool = False, led: bool = False) -> HexLine:
    if "(" in text and (spelled := _AS_TEXT.fullmatch(text)) is not None:
        data = spelled["digits"].encode()
        return HexLine(Shape.TRAFFIC, data, role=Role.REQUEST, worded=True, note=spelled["rest"].strip(" ;"))
    return _Peeler(text, decimal, led).line()


def _numbers(text: str) -> Written | None:
    """Return the bytes of decimal numbers. Where their CRC fits only if they are hexadecimal, they are that."""
    data = written.decimal(text)
    if data is None:
        return None
    pairs = written.read(text) if _PAIRS.fullmatch(text) is not None else None
    if pairs is not None and modbus_crc(pairs.data) == 0 and modbus_crc(data):
        return pairs
    return Written(data, Radix.DECIMAL)


#: Two digits a byte, of as many bytes as the shortest frame with a CRC has.
_PAIRS = re.compile(r"\s*[0-9A-Fa-f]{2}(?:[\s,]+[0-9A-Fa-f]{2}){4,}\s*")


def _of_one(byte: re.Match[str]) -> HexLine:
    """Return a line that prints one byte, twice or behind its index: where a frame ends it does not tell."""
    before = _Peeler(byte["before"])
    while before._item():
        pass
    side = byte.groupdict().get("side")
    words = [side.lower()] if side else [word for word in re.findall(r"[^\W\d_]+", byte["before"].lower()) if word in WORDS]
    data = bytes((int(byte["hex"], 16),))
    sign = "binary" if (byte.groupdict().get("binary")) else ""
    return HexLine(Shape.TRAFFIC, data, before.stamp, role_of(words), sign=sign, worded=bool(words), number=len(data))


@lru_cache(maxsize=256)
def _role(mark: str) -> Role:
    """Return who sent under one word or sign."""
    return role_of((mark.lower(),), mark)


class _Peeler:
    """Peels one line."""

    def __init__(self, text: str, decimal: bool = False, led: bool = False) -> None:
        self.text = text
        self.lead = LEADS if led else _LEAD
        self.led = False
        self.decimal = decimal
        self.at = 0
        self.stamp = Stamp()
        self.name = self.sign = ""
        self.words: list[str] = []
        #: Words in brackets of their own, which may be the name of who logs.
        self.tags: list[str] = []
        self.declared = self.ascii = self.spoken = False
        self.passed = self.declaration = ""
        self.number: int | None = None

    @property
    def marked(self) -> bool:
        """Whether a word or sign says who sent."""
        return bool(self.words or self.sign)

    def line(self) -> HexLine:
        """Return the line taken apart."""
        text = self.text
        found: Written | None = None
        note = ""
        for _ in range(_ITEM_LIMIT):
            # A number before a colon is a count, or of the line; it is never a byte.
            known = self.marked or self.stamp.kind or self.declared or self.number is not None
            if known and (found := self._bytes(text[self.at :])) is not None:
                break
            if not self._item():
                break
        rest = text[self.at :]
        if found is None:
            found, note = self._with_note(rest)
        words = self.words
        if any(word in ACTIONS for word in words):
            words = [word for word in words if word not in self.tags]
        role = role_of(words, self.sign)
        commented = (
            text.startswith(_COMMENT_SIGNS)
            and not (self.words and text.startswith("* "))
            and not (self.words and not rest)
            and not _ARROW.match(text)
        )
        taken = {"stamp": self.stamp, "role": role, "name": self.name, "sign": self.sign, "worded": bool(self.words)}
        if found is not None and found.data and not commented:
            return HexLine(
                Shape.TRAFFIC,
                found.data,
                note=note,
                number=self.number,
                led=self.led,
                radix=found.radix,
                passed=self.passed,
                declared=self.declaration,
                **taken,  # type: ignore[arg-type]
            )
        if not rest and (self.stamp.kind or self.marked) and not self.spoken:
            return HexLine(Shape.HEADER, text=text, ascii=self.ascii, **taken)  # type: ignore[arg-type]
        if (
            self.words
            and self.stamp.kind in ("", "millis")
            and len(text) < _LONGEST_HEADER
            and (time := DISTANT_TIME.search(rest)) is not None
        ):
            # `Write request, 1, 20.11.2026 14:01:05`: a monitor names what Windows was asked for; it asks to read, too.
            self.stamp = Stamp()
            self._take(time)
            role = role_of([word for word in words if word in ACTIONS] or words, self.sign)
            taken |= {"stamp": self.stamp, "role": role}
            return HexLine(Shape.HEADER, text=text, **taken)  # type: ignore[arg-type]
        broken = not commented and _is_broken(rest, self.marked)
        shape = Shape.BROKEN if broken else Shape.COMMENT
        return HexLine(shape, text=rest if broken else text, **taken)  # type: ignore[arg-type]

    def _bytes(self, text: str) -> Written | None:
        if self.decimal and (numbers := _numbers(text)) is not None:
            return numbers
        if not self.marked and LETTER.match(text) is not None:
            return None
        if self.marked and (placed := _PLACE.match(text)) is not None:
            text = text[placed.end() :]
        if self.marked and self.number is None and (celled := _COUNT_CELL.match(text)) is not None:
            self.number = int(celled[1])
            text = text[celled.end() :]
        elif not self.decimal and self.number is None:
            if (lead := self.lead.match(text)) is not None:
                self.number, self.led = int(lead[1]), True
                text = text[lead.end() :]
            elif (end := written.behind_number(text)) and (found := written.read(text[end:])) is not None:
                digits = text[:end].strip()
                self.number, self.led = int(digits, 10 if digits.isdecimal() else 16), True
                return found
        found = written.read(text)
        if found is None and self.marked and self.stamp.kind and text.count(":") == _COLONS_OF_TIME:
            # Behind a time and a mark three bytes are no time of day.
            found = written.read(text.replace(":", " "))
        return found

    def _item(self) -> bool:
        """Peel the next item off; say whether there was one."""
        text, at = self.text, self.at
        marked = self.marked
        for when, has, pattern in ITEMS:
            if has not in text or (when is not When.ANY and (when is When.MARKED) != marked):
                continue
            found = pattern.match(text, at)
            if found is not None and found.end() > at and self._take(found):
                self.at = found.end()
                return True
        named = bool(self.words) and not self.sign and all(word in SPEAKERS for word in self.words)
        if self.marked and not named:
            return False
        if named and (time := DISTANT_TIME.search(text, at, at + DISTANT_LIMIT)) is not None:
            # What stands before the time of a logger is the name of a program.
            self.words.clear()
            self.at = time.start()
            return True
        distant = DISTANT.search(text, at, at + DISTANT_LIMIT)
        if named and (distant is None or _LEVEL.search(text, at, distant.start()) is None):
            return False
        if distant is not None and distant.start() > at:
            self.words.clear()
            self.spoken = _TWO_WORDS.search(text[at : distant.start()]) is not None
            self._pass(distant.start())
            self.at = distant.start()
            return True
        phrase = PHRASE.search(text, at, at + 2 * DISTANT_LIMIT)
        if phrase is None or self._with_note(text[phrase.end() :])[0] is None:
            return False
        said = [phrase["word"].lower()]
        if said[0] in SPEAKERS:
            said += [word for word in re.findall(r"[^\W\d_]+", phrase[0].lower()) if word in ACTIONS]
        self.words += said
        self._pass(phrase.start())
        self.at = phrase.end()
        return True

    def _pass(self, end: int) -> None:
        """Keep the words that stand before a distant mark, and the time among them."""
        self.passed = self.text[self.at : end]
        if not self.stamp.kind and (time := DISTANT_TIME.search(self.text, self.at, end)) is not None:
            self._take(time)

    def _take(self, found: re.Match[str]) -> bool:
        """Keep what an item says; say whether it can stand here."""
        if "way" in found.re.groupindex:
            return self._speaks(found)
        for group, value in found.groupdict().items():
            if value is None:
                continue
            if kind := _KINDS_OF_TIME.get(group):
                if self.stamp.kind:
                    return False
                self.stamp = Stamp(kind, value)
            elif group in ("word", "assist", "call"):
                self.words.append(value.lower())
                if value.lower() in SPEAKERS and (found[0].lstrip().startswith("[") or _LEVEL.search(self.passed)):
                    self.tags.append(value.lower())
            elif group in _SAID:
                self.words.append(_SAID[group])
            elif group == "form":
                self.ascii = value.upper() == "ASCII"
            elif group in ("sign", "letter"):
                self.sign = value.lower()
            elif group == "count":
                if self.number is not None:
                    return False
                self.number = int(value)
            elif group in ("label", "bullet"):
                self.declared = True
            elif group == "variable":
                self.declared = True
                self.declaration = found[0].strip(" =")
                # What a program calls "read" is the command that reads.
                parts = [part.lower() for part in _PARTS.findall(value)]
                self.words += [word for word in parts if word in WORDS and word != "read"]
            else:
                # `[client.write]`, `UART_TX`: what a program calls; the line is named before it, if at all.
                if (word := _NAME_PARTS.split(value)[-1].lower()) in ACTIONS and word != value.lower():
                    self.words.append(word)
                    value = value[: -len(word) - 1]
                self.name = self.name or value
        return True

    def _speaks(self, found: re.Match[str]) -> bool:
        """Keep who speaks to whom; say whether the names are those of the ends of a line."""
        ends = (found["one"].lower(), found["other"].lower())
        sender, receiver = ends[::-1] if found["way"][0] in "<←" else ends
        if not {sender, receiver}.isdisjoint((*ACTIONS, *MATTERS)):
            return False
        if speaker := speaker_of(sender, receiver):
            self.words.append(speaker)
        elif " " not in found[0].strip() and _FRAME.fullmatch(self.text, found.end()):
            self.sign = f"{sender}{TO}{receiver}"
        return self.marked

    def _with_note(self, rest: str) -> tuple[Written | None, str]:
        """Return the bytes at the beginning of a text and what stands behind them as a comment."""
        if self.marked and (placed := _PLACE.match(rest)) is not None:
            rest = rest[placed.end() :]
        # A list that goes on in the next line.
        if _BRACKETS.get(rest[:1], rest) not in rest:
            rest = rest[1:].strip()
        for end in ("; )", _CLOSERS, f"{_CLOSERS};"):
            if (found := self._bytes(rest.rstrip(end))) is not None:
                return found, ""
        for pattern in (_TRAILING, _WORDY):
            trailing = pattern.search(rest)
            if trailing is not None and trailing.start() > 0:
                head = rest[: trailing.start()].rstrip(" ,;)")
                # A number of a logger, and one before words, are no bytes.
                if not self.marked and pattern is _TRAILING and _NUMBER.fullmatch(head) and trailing[0][0] == "|":
                    continue
                found = self._bytes(head)
                if found is not None and len(found.data) > (pattern is _WORDY):
                    return found, trailing[0].strip(_AROUND_NOTE)
        string = _STRING.match(rest)
        if string is not None and (found := self._bytes(string[0])) is not None and found.data:
            return found, rest[string.end() :].strip(_AROUND_NOTE)
        # A column of the same bytes as characters, as dumps have.
        head, gap, column = rest.partition("  ")
        if gap:
            found = self._bytes(head)
            if found is not None and len(found.data) == len(column.strip()):
                return found, ""
        return None, ""


def _is_broken(rest: str, marked: bool) -> bool:
    """Say whether a text that is no bytes looks as if it was meant to be."""
    tokens = [t for t in _SPLIT.split(rest[:4096]) if t]
    alike = sum(1 for t in tokens if _HEXLIKE.fullmatch(t))
    runs = sum(1 for t in tokens if _RUN.match(t))
    if len(tokens) == 1:
        return bool(_LONG_RUN.match(tokens[0]) or (marked and _DIGITS.fullmatch(tokens[0])))
    if sum(1 for t in tokens if _PLAIN_WORD.fullmatch(t)) >= _SENTENCE_WORDS:
        return False
    return alike + runs >= 2 and 2 * (alike + runs) >= len(tokens)
