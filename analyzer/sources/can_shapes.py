"""The shapes of lines that are CAN frames: one table, a pattern a row, as `can_text.py` reads them."""

from __future__ import annotations

import re
from typing import NamedTuple


class Shape(NamedTuple):
    """A shape of lines. Groups of the pattern: id, data, and time, mark, extended, length, remote, error, port.

    `near`: the beginning of a line that was meant to be one. `sure`: one line of it is a CAN frame; of the others a text must
    be full, with lengths or letters that fit.
    """

    name: str
    pattern: re.Pattern[str]
    near: re.Pattern[str] | None = None
    sure: bool = True


_ID = r"(?:0[xX]|16#)?(?P<id>[0-9A-Fa-f]{1,8})[hH]?"
_DATA = r"(?P<data>(?:(?:0[xX]|16#)?(?:[0-9A-Fa-f]{1,2}|\d{3})\b[\s,.:]*+){0,64}|(?:[0-9A-Fa-f]{2}){2,64})"
_NUMBER = r"0x[0-9A-F]{1,8}|\d{1,9}"
#: A list of numbers in a program: in hexadecimal with 0x alone.
_LISTED = (
    r"(?:bytes|bytearray)?\(?\s*\[(?P<listed>\s*(?:(?:0x[0-9A-F]{1,2}|\d{1,3})\s*,?\s*){0,64})\](?:\s*\*\s*(?P<times>\d{1,2}))?"
)
_MARK = r"(?P<mark>[TR]x|[TR])"
_LENGTH = r"(?:0[xX])?(?P<length>\d{1,2})"


def _shape(name: str, pattern: str, near: str = "", sure: bool = True) -> Shape:
    return Shape(name, re.compile(pattern, re.IGNORECASE), re.compile(near, re.IGNORECASE) if near else None, sure)


#: The first shape that fits most lines is that of a text.
SHAPES: tuple[Shape, ...] = (
    _shape(
        "python-can",
        rf"Timestamp:\s+(?P<time>\d+\.\d+)\s+ID:\s+(?P<id>[0-9a-f]{{3,8}})\s+(?:(?P<extended>X)|S)?\s*{_MARK}?(?P<error>\s+E)?"
        rf"(?P<remote>\s+R)?(?:\s+F)?(?:\s+BS)?(?:\s+EI)?\s+DLC?:\s*(?P<length>\d+)\s*{_DATA}(?:'.*')?\s*(?:Channel:\s*(?P<port>\S+))?",
        near=r"\s*Timestamp:",
    ),
    _shape(
        "python-can-repr",
        rf"(?:can\.)?Message\(timestamp=(?P<time>\d+\.\d+),.*?arbitration_id=0x(?P<id>[0-9a-f]+),.*?is_extended_id=(?:False|(?P<extended>True))"
        rf".*?(?:is_rx=(?P<mark>\w+).*?)?(?:channel=[\"']?(?P<port>\w+)[\"']?.*?)?dlc=(?P<length>\d+),.*?data=\[{_DATA}\].*\)",
    ),
    # In a program; python-can takes 29 bits where nothing else is said.
    _shape(
        "call",
        rf".*?(?:(?P<extended>can\.Message\((?!.*extended_id\s*=\s*False))|Message\()(?=.*?(?P<standard>extended_id\s*=\s*False))?(?=.*?\barbitration_id\s*=\s*(?P<id>{_NUMBER}))"
        rf".*?\bdata\s*=\s*{_LISTED}.*",
    ),
    _shape("call-id-data", rf".*?\b(?:write|send)\(\s*(?P<id>{_NUMBER}),\s*{_LISTED}.*"),
    # In JavaScript.
    _shape(
        "call-object",
        rf".*?(?:\bsend\(|=)\s*\{{(?=.*?\bid\s*:\s*(?P<id>{_NUMBER}))(?=.*\bext\s*:\s*(?P<extended>true))?.*?\bdata\s*:"
        r"\s*(?:(?:new )?(?:Buffer(?:\.from)?|Uint8Array)\()?\s*\["
        r"(?P<listed>\s*(?:(?:0x[0-9A-F]{1,2}|\d{1,3})\s*,?\s*){0,64})\].*",
    ),
    _shape("slcan", r"(?P<slcan>[tTrR])(?P<rest>[0-9A-F]{4,})[zZ]?(?:\\[rn])*", near=r"\s*[tr][0-9A-F]{4}"),
    _shape(
        "busmaster",
        rf"(?P<time>\d+:\d\d:\d\d:\d{{1,4}})\s+{_MARK}\s+(?P<port>\d+)\s+0x(?P<id>[0-9a-f]+)\s+(?:s|(?P<extended>x))(?P<remote>r)?"
        rf"\s+(?P<length>\d+)\s+{_DATA}",
    ),
    _shape(
        "canking",
        rf"(?P<port>\d{{1,2}})\s+(?P<id>[0-9A-F]{{8}})(?P<extended>\s+X)?(?P<remote>\s+R)?\s+(?P<length>\d)\s+(?P<data>(?:[0-9A-F]{{2}}\s+){{0,8}})(?P<time>\d+\.\d+)\s+"
        rf"{_MARK}",
    ),
    # In a sentence or a script too, with words behind it.
    _shape(
        "cansend",
        r".*?\b(?P<mark>cansend)\s+(?P<port>\S+)\s+(?P<id>[0-9A-F]{1,8})#(?P<data>[0-9A-F.]*)(?![0-9A-Z#]).*",
        near=r".*\bcansend\s",
    ),
    # What a program takes: `SEND:01#F6...`.
    # A controller's bytes are each `16#01`.
    _shape(
        "sent",
        r".*?\b(?P<mark>send|tx)[:= ]{1,2}(?!16#..\W+16#)(?P<id>[0-9A-F]{1,8})#(?P<data>(?:[0-9A-F]{2}){1,8})"
        r"(?![0-9A-Z#]|\s[0-9A-F]{2}\b).*",
    ),
    # The records of gs_usb adapters (candleLight): echo number, identifier, length, channel, flags, data.
    _shape(
        "gs_usb",
        r"\s*(?P<own>[0-9A-F]{8})(?P<record>[0-9A-F]{8})(?P<length>0[0-8])0[0-3]0[0-9A-F]00(?P<data>[0-9A-F]{16})(?:[0-9A-F]{8})?",
    ),
    _shape("hash", r"(?:(?P<port>[A-Za-z]\w{1,15})\s+)?(?P<id>[0-9A-F]{3}|[0-9A-F]{8})#(?P<data>(?:[0-9A-F]{2}[. ]?)*)"),
    # In a sentence, or as a program prints it.
    _shape(
        "quoted",
        r"(?:.*?(?P<error>error[ _]?frame\b))?(?P<before>.*?)(?<![\w#/.-])(?P<id>[0-9A-F]{3}|[0-9A-F]{8})#"
        r"(?P<data>(?:[0-9A-F]{2}){1,8})"
        r"(?![0-9A-Z#]|\s[0-9A-F]{2}\b).*",
    ),
    _shape(
        "candump",
        rf"(?:(?P<port>[A-Za-z]\w{{1,15}})\s+)?(?:{_MARK}\s+[-BE]\s+[-BE]\s+)?(?:0x)?(?P<id>[0-9A-F]{{3}}|[0-9A-F]{{8}})\s+"
        rf"\[(?P<length>\d{{1,2}})\]\s*{_DATA}(?P<remote>remote request)?(?:'.*')?",
    ),
    _shape(
        "candump-table",
        rf"(?P<port>\w{{0,2}}can\d{{1,2}})[\s|]+(?:0x)?(?P<id>[0-9A-F]{{1,8}})[\s|]+\[(?P<length>\d{{1,2}})\][\s|]*{_DATA}\|?",
    ),
    # Rows of a monitor's window.
    _shape(
        "monitor",
        rf"(?:\d{{1,9}}\)?\s+)?(?P<time>\d+\.\d+)\s+(?:(?P<port>[A-Za-z]\w{{1,15}})\s+)?{_MARK}\s+(?:0x)?(?P<id>[0-9A-F]{{3,8}})\s+"
        rf"(?P<length>[0-8])\s+{_DATA}",
    ),
    _shape(
        "pcan",
        rf"(?:\d{{1,9}}\)?\s+\d+\.\d+\s+{_MARK}\s+)?(?P<id>[0-9A-F]{{3,8}})h\s+(?:(?:data|std|ext)\w*\s+)?(?P<length>[0-8])\s+{_DATA}",
    ),
    _shape("cansniffer", r"\d{1,6}(?:\.\d+)?\s*\|\s*(?P<id>[0-9A-F]{3,8})\s*\|\s(?P<data>(?:[0-9A-F]{2} )+)\s*.*"),
    _shape(
        "id-data",
        rf"(?:(?P<before>.*?)(?<![A-Za-z]))?(?:(?:can|cob|std|ext)[\s_-]?)?id\s*[:=]?\s*{_ID}\b[\s,;|]*(?:and\s+)?(?:(?:(?P<extended>ext\w*)|std|standard)[\s,;|]*)?"
        rf"(?:(?:(?:and|with)\s+)?(?:dlc|dl|len|length|size)\s*[:=]?\s*{_LENGTH}\b[\s,;|]*)?(?:(?:data|daten|payload|bytes?|msg|message)(?:\[0\.\.\d\])?\s*[:=]?[\s\[{{]*|\[\s*|(?(length):\s*|(?!)))"
        rf"{_DATA}[\]}}\s]*(?:\((?P<port>[a-z]+\d+)\)\s*)?",
        near=r"\s*(?:\S+\s+)?id\s*[:=]",
    ),
    # In a sentence, in Wireshark's list, and before what Python prints of bytes.
    _shape(
        "id-said",
        r"(?:(?P<before>.*?)(?<![A-Za-z]))?(?:(?:can|cob|std|ext)[\s_-]?)?(?:id|std|xtd)\b\s*[:=]?\s*0x(?P<id>[0-9A-F]{1,8})"
        r"(?:\s*(?::|->|=>)\s*|\s+(?:with\s+)?)(?P<data>[0-9A-F]{2}(?:\s[0-9A-F]{2}){0,7})[.,]?\s*",
    ),
    _shape(
        "id-literal",
        r"(?:id\s*[:=]?\s*)?0x(?P<id>[0-9A-F]{1,8})[\s,:]+(?:data\s*[:=]?\s*)?(?P<literal>(?:bytearray\()?b(?:'[^']*'|\"[^\"]*\")\)?)",
    ),
    # SavvyCAN's adapters and others that name the kind of frame by a letter.
    _shape(
        "gvret",
        rf"(?:(?P<micros>\d{{1,12}})\s+-\s+)?(?P<id>[0-9A-F]{{1,8}})\s+(?:S|(?P<extended>X))\s+(?:(?P<port>\d)\s+)?(?P<length>[0-8])\s+{_DATA}",
    ),
    # With what the frame is, in words behind it: no row of a dump has that.
    _shape(
        "id-words", r"0x(?P<id>[1-7][0-9A-F]{2}):?\s+(?P<data>[0-9A-F]{2}(?:\s[0-9A-F]{2}){0,7})\s{2,}[A-Z]{2,}\s[A-Z]{2,}.*"
    ),
    _shape("id-bytes", r"0x(?P<id>[0-7]?[0-9A-F]{1,2})\s*[:,]?\s+(?P<data>[0-9A-F]{2}(?:\s[0-9A-F]{2}){1,7})\s*", sure=False),
    _shape("id-length", r"(?P<id>[0-9A-F]{1,8})\s+(?P<length>[0-8])(?P<data>(?:\s+[0-9A-F]{1,2}){0,8})\s*", sure=False),
    _shape(
        "id",
        r"(?:0x)?(?P<id>[0-7][0-9A-F]{2}|(?!0{8})[01][0-9A-F]{7})\s*:?\s+(?P<data>[0-9A-F]{2}(?:\s[0-9A-F]{2}){0,7})(?:\s*|(?:\s{2,}|\s*[#(;]).*)",
        sure=False,
    ),
)
