"""Frames anywhere in text: bytes in a forum post, a console or a program, their place and their sender.

    If I send FA 01 30 2B it answers with FB 01 30 00 00 00 01 20 00 4D, but `FA01F601400234` does nothing.
    Response from instrument: '\\x01\\x84\\x02\\xc2\\xc1' (01 84 02 C2 C1) (5 bytes), roundtrip time: 30.1 ms
    halcmd: [FA][01][30][2B]        serial.write([250, 1, 48, 43])        instead of 02 03 02 00 07 BD 86

Rules: at least three bytes, written alike, with a letter or a sign of hexadecimal among them, or five without; two where a
sign or a verb stands directly before them. Digits without a gap only in capitals, in quotes, or behind a word for bytes.
Times, dates, addresses of network cards and of memory, and hashes are no frames. Bytes that, by their sentence, did not come
or should have come are left out.
The last word before the bytes in the same sentence tells the sender (`marks.py` and the verbs below), else a sign does.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.link import modbus_crc
from analyzer.sources import written
from analyzer.sources.lines import remembered
from analyzer.sources.marks import ACTIONS, MATTERS, OTHER_SIDE, SIGNS, SPEAKERS, role_of

#: Verbs that people use, in addition to the words of logs.
_VERBS = {
    **dict.fromkeys(("ask", "asked", "asks", "write", "writes", "writing", "type", "typed", "transmits"), "send"),
    **dict.fromkeys(
        ("get", "gets", "getting", "see", "sees", "shows", "gives", "output", "return", "returning", "responding",
         "answering", "back", "comes", "respond"),
        "reply",
    ),
}  # fmt: skip
_MARKED = r"(?:(?:0[xX]|16#)[0-9A-Fa-f]{1,2})"
_PAIR = r"[0-9A-Fa-f]{2}"
_PAIRS = rf"(?:{_PAIR}){{1,4}}"
#: A number that is compared is a check. A label may touch its bytes: `frame:01 03`.
_NOTHING_BEFORE = r"(?:(?<![\w.:/+@#-])|(?<=[G-Zg-z]\w:)|(?<=\w[G-Zg-z]:))(?<!!=)"
_ITEM = r"(?:0[xX])?(?:[0-9A-Fa-f]{1,2}|\d{3})"
#: Ways to write bytes inside a text; the names of groups tell apart what is checked further.
_RUN = re.compile(
    # A string of a program with escapes in it. A quote behind a backslash begins none: each would be followed to the end.
    r"""(?P<string>b?(?<!\\)'(?:[^'\\]|\\.)*?\\x[0-9A-Fa-f]{2}(?:[^'\\]|\\.)*'|b?(?<!\\)"(?:[^"\\]|\\.)*?\\x[0-9A-Fa-f]{2}(?:[^"\\]|\\.)*")"""
    r"|(?P<buffer><Buffer(?: [0-9A-Fa-f]{2})+>)"
    r"|(?P<escapes>(?:\\x[0-9A-Fa-f]{2})+)"
    # `\\FA\\01`, as terminals take bytes.
    r"|(?P<slashed>(?<![\w:\\.])(?:\\[0-9A-Fa-f]{2}(?!\w|\.\w)){3,})"
    # Each byte in brackets.
    rf"|(?P<each>(?:\[{_ITEM}\]\s*){{2,}}|(?:<\s?{_ITEM}\s?>\s*){{2,}}|(?:\{{{_ITEM}\}}\s*){{2,}})"
    # Behind a label to the end of the line, without their zeros, as Arduino prints them.
    r"|(?P<short>(?<=[:=>] )(?=[0-9A-Fa-f ]*\b[0-9A-Fa-f]\b)[0-9A-Fa-f]{1,2}(?: [0-9A-Fa-f]{1,2}){3,}(?=\s*$))"
    # `10-15-0-204`, as modbus_tk prints it.
    rf"|(?P<dashed>(?:{_NOTHING_BEFORE}(?=[\d-]*\d{{3}})|(?:(?<=[<-]-)|(?<=(?:<-|->)[ \t]))(?=(?:\d{{1,3}}-)*\d\b))"
    r"\d{1,3}(?:-\d{1,3}){2,}(?![\w.-]))"
    rf"|(?P<list>[\[({{]\s*-?{_ITEM}(?:\s*,\s*-?{_ITEM})+\s*,?\s*[\])}}])"
    rf"|(?P<pairs>{_NOTHING_BEFORE}(?:{_MARKED}(?:(?:, ?|[ :-]){_MARKED})+"
    rf"|(?:0[xX])?{_PAIRS}(?: {{1,2}}{_PAIRS})+"
    # A number of the cell before belongs to no bytes.
    rf"|{_PAIR}(?:(?:(?:[,;] ?{_PAIR})++|(?:\t{_PAIR})++|(?:\|{_PAIR})++)(?! {_PAIR}\b)|(?::{_PAIR})+|(?:-{_PAIR})+"
    rf"|(?:\.{_PAIR}){{5,}}))"
    r"(?![\w:]))"
    r"|(?P<quoted>(?<=[`'\"])(?:[0-9A-Fa-f]{2}){3,}(?=[`'\"]))"
    rf"|(?P<digits>{_NOTHING_BEFORE}(?=[0-9A-Fa-f]*\d)(?=\d*[A-Fa-f])(?:[0-9A-Fa-f]{{2}}){{4,}}(?![\w/-]))"
)
_LETTER = re.compile(r"[A-Fa-f]|0[xX]|16#|\\x")
_LABEL = re.compile(r"[^\W\d_]\s*[:=]\s*$")
_TWO_WITH_LETTER = re.compile(r"\b(?=\w?[A-Fa-f])\w\w\b")
_NETWORK_CARD = re.compile(r"(?:[0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}")
_TIME = re.compile(r"[0-2]\d:[0-5]\d:[0-5]\d(?::\d+)*")
_UNLETTERED, _LEAST, _LEAST_DIRECT = 5, 3, 2
_THREE_DIGITS = 100
#: Digits that stand for themselves: MD5, SHA-1, SHA-256.
_HASHES = (32, 40, 64)
#: A word for bytes before long digits in small letters.
_BYTES_WORD = re.compile(
    r"(?:hex|data|bytes?|frame|msg|message|packet|buffer|payload|raw|dump|tx|rx|sent|recv|received)\W*$", re.I
)
_WORD = re.compile(r"(?:[^\W\d_]|(?<=\w)['\u2019](?=\w))+")
_OBJECT = re.compile(r"\b[a-z_]\w*\.(?=[a-z_])")
_NAMES = re.compile(r"\b[A-Za-z]+(?:_[A-Za-z]+)+\b")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z][a-z])")
#: The name of what is asked for tells no sender.
_FUNCTION = re.compile(r"\bread (?:\d+ |holding |input |discrete )*(?:registers?|coils?|inputs?)\b")
_SENTENCE = re.compile(r"[.!?;]\s")
_SIGN = re.compile(rf"(?:^|(?<=[\s\])|:]))({'|'.join(map(re.escape, sorted(SIGNS, key=len, reverse=True)))})[\s:<\[({{'\"]*$")
_NOT = frozenset(("not", "never", "no", "cannot", "without"))
_WISHED = re.compile(
    r"\b(?:instead of|rather than|expect\w*(?! \d+ bytes)|should|shall|supposed to|must be|correct\w*|ought)\b", re.IGNORECASE
)
#: Who answers gives nothing away of what was sent: these take the request as their object.
_TOWARDS = frozenset(("answer", "answers", "respond", "responds", "reply", "replies", "react", "reacts"))
#: "To read": what is sent in order to read.
_PURPOSE = frozenset(("read", "get", "see", "return"))


class Quotation(NamedTuple):
    """Bytes in a text. `column` counts from 1. `left`: why they are no traffic; empty where they are. `end`: behind them."""

    column: int
    data: bytes
    role: Role
    end: int
    left: str = ""


def quotations(line: str) -> list[Quotation]:
    """Return the frames that a line of words speaks of."""
    return [each for each in mentions(line) if not each.left]


@remembered
def mentions(line: str, libmodbus: bool = False) -> list[Quotation]:
    """Return the runs of bytes of a line in their order, with those that are left out.

    `libmodbus`: bytes in `[]` were sent, those in `<>` received.
    """
    line = written.plain(line)
    found: list[Quotation] = []
    begin = 0
    brackets = {"[": Role.REQUEST, "<": Role.REPLY} if libmodbus else {}
    for run in _RUN.finditer(_SMALL_WORD.sub(lambda word: " " * len(word[0]), line)):
        data = _data(run)
        if data is None:
            continue
        # `addr 01  FA 01 3A 35`.
        number = written.behind_number(run[0])
        data, start = (data[1:], run.start() + number) if number else (data, run.start())
        before = line[max(begin, start - _LONGEST_SENTENCE) : start]
        sentence = _SENTENCE.split(before)[-1]
        sign = _SIGN.search(before, max(0, len(before) - _LONGEST_SIGN))
        left = _no_frame(run, data, before, sentence, sign is not None)
        if left is None:
            continue
        begin = run.end()
        if found and found[-1].data == data and len(before) <= _AGAIN and not found[-1].left:
            # The same bytes in another way of writing.
            continue
        role = role_in_text(sentence)
        if role is Role.UNKNOWN and sign is not None:
            role = role_of((), sign[1])
        role = brackets.get(run[0][0], role) if run.lastgroup == "each" else role
        found.append(Quotation(start + 1, data, role, run.end(), left or _not_sent(sentence, role)))
    return found


#: A word of two letters that could be a byte: `be FB 01`. Bytes of one frame are all small, or all in capitals.
_SMALL_WORD = re.compile(r"(?<![\w.:/-])[a-f]{2}(?= +(?:\d\d +)*(?:[A-F][0-9A-F]|\d[A-F])(?![0-9A-Za-z]))")
#: Characters between bytes and the same bytes again.
_AGAIN = 25
#: Characters before bytes that are looked at for who sent them: with all of a long line, its cost would grow with its square.
_LONGEST_SENTENCE = 300
_LONGEST_SIGN = 60


def _data(run: re.Match[str]) -> bytes | None:
    """Return the bytes of a run."""
    text = run[0]
    kind = run.lastgroup
    if kind == "string":
        return _string(text)
    if kind == "slashed":
        return bytes.fromhex(text.replace("\\", ""))
    if kind in ("quoted", "digits"):
        return bytes.fromhex(text)
    if kind == "pairs" and "x" not in text.lower()[2:] and "#" not in text:
        return bytes.fromhex(re.sub(r"0[xX]|[^0-9A-Fa-f]", "", text))
    if kind == "dashed":
        return written.decimal(text)
    found = written.read(text)
    return None if found is None else found.data


def spells_frame(data: bytes) -> bool:
    """Say whether bytes are the letters of hex digits, and these begin as a frame does."""
    if len(data) < _SPELLED or _DIGITS.fullmatch(data) is None:
        return False
    head = bytes.fromhex(data[:4].decode())
    return head[0] in _HEADS or head[1] in _STANDARD


_DIGITS = re.compile(rb"(?:[0-9A-Fa-f]{2})+[\r\n]*")
#: Letters of the shortest frame, the heads of native dialects, and the usual functions of Modbus.
_SPELLED, _HEADS, _STANDARD = 8, b"\xfa\xfb\x3e", (3, 4, 6, 16)


def _string(text: str) -> bytes | None:
    """Return the bytes of a string as programs print it, its other characters as they stand."""
    inner = text[text.index(text[-1]) + 1 : -1]
    try:
        return _ESCAPE.sub(
            lambda found: chr(int(found[1], 16)) if found[1] else _ESCAPES.get(found[2], found[2]), inner
        ).encode("latin-1")
    except UnicodeEncodeError:
        return None


_ESCAPE = re.compile(r"\\(?:x([0-9A-Fa-f]{2})|(.))")
_ESCAPES = {"n": "\n", "r": "\r", "t": "\t", "0": "\0", "a": "\a", "b": "\b", "f": "\f", "v": "\v"}


def _no_frame(run: re.Match[str], data: bytes, before: str, sentence: str, signed: bool) -> str | None:
    """Return why a run is no frame; empty where it is one, None where it is no bytes at all."""
    text, kind = run[0], run.lastgroup
    lettered = _LETTER.search(text) is not None
    if kind == "buffer":
        return ""
    if kind in ("string", "escapes", "slashed", "each", "dashed"):
        return "" if len(data) >= _LEAST else None
    if kind == "list":
        sure = lettered or any(value >= _THREE_DIGITS for value in data) or _BYTES_WORD.search(before) is not None
        # Numbers of a sentence stand in brackets, too. Behind a label they are a frame, though it is short.
        least = _LEAST if _LABEL.search(before) is not None and text.lower().count("0x") == len(data) else _LEAST + 1
        return "" if len(data) >= least and sure else None
    if kind == "short":
        # Words of two letters, and numbers in a list, are not both in one text.
        sure = _TWO_WITH_LETTER.search(text) is not None and any(c.isdigit() for c in text)
        return "" if sure and text in (text.upper(), text.lower()) else None
    # Words of two letters are none in capitals.
    if text != text.upper() and not any(c.isdigit() for c in text):
        return None
    if kind == "quoted":
        return "a hash" if len(text) in _HASHES else ""
    if kind == "digits":
        small = text != text.upper()
        if len(text) in _HASHES and not signed:
            return "a hash"
        return "" if not small or signed or _BYTES_WORD.search(before) is not None or _has_check(data) else None
    words = _WORD.findall(sentence.lower())
    direct = signed or (bool(words) and sentence.rstrip(" :='\"`(").lower().endswith(words[-1]) and words[-1] in _SAID)
    if _NETWORK_CARD.fullmatch(text) and not direct and not _has_check(data):
        return "the address of a network card"
    if _TIME.fullmatch(text):
        return None
    # Bytes are printed with their zeros, numbers of people without.
    if not lettered and not direct and re.search(r"\b0", text) is None and not spells_frame(data):
        return None
    least = _LEAST_DIRECT if direct and lettered else _LEAST if lettered or direct else _UNLETTERED
    return "" if len(data) >= least else None


def _has_check(data: bytes) -> bool:
    """Say whether bytes end as a frame of a dialect does, or begin as one of LK."""
    if data[:1] == b"\x3e":
        return sum(data[:4]) & 0xFF == data[4]
    return (data[0] in _HEADS and sum(data[:-1]) & 0xFF == data[-1]) or modbus_crc(data) == 0


#: Who "wrote" above a quotation wrote a post, and "3rd" is a number.
_SAID = frozenset((*ACTIONS, *MATTERS, *_VERBS)) - {"wrote", "wr", "rd"}


def role_in_text(text: str) -> Role:
    """Return the sender by the last word of a text that tells it, and the speaker before that word."""
    # In a program `motor.send` sends to the motor, and `FB_Servo` is the name of a block.
    text = _NAMES.sub(_named, text)
    text = _CAMEL.sub(" ", text).lower().replace("\u2019", "'")
    words = _WORD.findall(_FUNCTION.sub("", _OBJECT.sub("", text)))
    at = next((n for n in range(len(words) - 1, -1, -1) if words[n] in _SAID), None)
    if at is None:
        speakers = [n for n, word in enumerate(words) if word in SPEAKERS]
        if not speakers:
            return Role.UNKNOWN
        role = role_of((words[speakers[-1]],))
        return OTHER_SIDE[role] if "to" in words[speakers[-1] - 2 : speakers[-1]] else role
    word = words[at]
    if at and words[at - 1] == "to" and word in _PURPOSE:
        return Role.REQUEST
    if word in _TOWARDS and _denied(words[:at]):
        return Role.REQUEST
    if word in _VERBS:
        return Role.REQUEST if _VERBS[word] == "send" else Role.REPLY
    speakers_before = [w for w in words[max(0, at - 3) : at] if w in SPEAKERS]
    return role_of([*speakers_before[-1:], word])


def _named(found: re.Match[str]) -> str:
    """Return a name of a program where a part of it says what is done; any other tells no sender."""
    return found[0] if any(part in ACTIONS or part in MATTERS for part in found[0].lower().split("_")) else " "


def _denied(words: list[str]) -> bool:
    return any(word in _NOT or word.endswith("n't") for word in words[-4:])


def unsent(text: str) -> str:
    """Return why the bytes below a line of words are no traffic, by its last sentence; empty where they are."""
    sentence = _SENTENCE.split(text)[-1]
    return _not_sent(sentence, role_in_text(sentence))


def _not_sent(sentence: str, role: Role) -> str:
    """Return why the bytes that a sentence speaks of did not come; empty where they did."""
    if role is not Role.REQUEST and _WISHED.search(sentence) is not None:
        return "what should have come"
    words = _WORD.findall(sentence.lower().replace("\u2019", "'"))
    at = next((n for n in range(len(words) - 1, -1, -1) if words[n] in _SAID), None)
    if at is not None and role is Role.REPLY and _denied(words[:at]):
        return "what did not come"
    return ""
