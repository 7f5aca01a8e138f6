"""Frames in sentences: what a forum post says of bytes, with where it stands and who is said to have sent it.

    If I send FA 01 30 2B it answers with FB 01 30 00 00 00 01 20 00 4D, but `FA01F601400234` does nothing.

Rules: at least three bytes of two digits, separated alike, with a letter or `0x` among them, or five without; digits without a
gap only in capitals, in quotes or in backticks, so that no word, time, address of a network card or hash is taken for a frame.
The last word before the bytes in the same sentence says who sent, by `marks.py` or one of the verbs below.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.sources import written
from analyzer.sources.marks import WORDS, role_of

#: Verbs of people, beside the words of logs.
_VERBS = {
    **dict.fromkeys(("ask", "asked", "write", "writing", "type", "typed"), "send"),
    **dict.fromkeys(("get", "gets", "got", "getting", "see", "returning", "responding", "answering", "back"), "reply"),
}
_BYTE = r"(?:0[xX][0-9A-Fa-f]{1,2}|[0-9A-Fa-f]{2})"
_RUN = re.compile(
    rf"(?<![\w.:/+-]){_BYTE}(?:(?P<gap>, ?|[ :-]){_BYTE})(?:(?P=gap){_BYTE})+(?![\w])"
    r"|(?<=[`'\"])(?:[0-9A-Fa-f]{2}){3,40}(?=[`'\"])"
    r"|(?<![\w.:/#-])(?=[0-9A-F]*\d)(?=\d*[A-F])(?:[0-9A-F]{2}){4,40}(?![\w-])"
)
_LETTER = re.compile(r"[A-Fa-f]|0[xX]")
_NETWORK_CARD = re.compile(r"(?:[0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}")
_UNLETTERED = 5
_WORD = re.compile(r"[^\W\d_]+")
_SENTENCE = re.compile(r"[.!?;]\s")


class Quotation(NamedTuple):
    """Bytes in a sentence. `column` counts from 1."""

    column: int
    data: bytes
    role: Role


def quotations(line: str) -> list[Quotation]:
    """Return the frames that a line of words speaks of."""
    found = []
    begin = 0
    for run in _RUN.finditer(line):
        text = run[0]
        data = written.read(text)
        if data is None or not any(c.isdigit() for c in text) or _NETWORK_CARD.fullmatch(text):
            continue
        if _LETTER.search(text) is None and len(data.data) < _UNLETTERED:
            continue
        sentence = _SENTENCE.split(line[begin : run.start()])[-1]
        begin = run.end()
        found.append(Quotation(run.start() + 1, data.data, _who(sentence)))
    return found


def _who(before: str) -> Role:
    words = [_VERBS.get(word, word) for word in _WORD.findall(before.lower())]
    said = [word for word in words if word in WORDS]
    return role_of(said[-1:])
