"""What libraries report in words instead of a reply: a refusal, silence, a wrong check; each with its cause."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

from analyzer.framer import GLITCHES


class Report(NamedTuple):
    """A library's words, as a pattern. `cause`: what they stand for; `what`: what they mean; `next`: what to do."""

    pattern: str
    cause: str
    what: str
    next: str


_TRY = (
    "Try in this order: A and B swapped, speed and parity, the unit's address, its power, a longer timeout; then show the raw "
    "bytes (a debug log of the library), for they tell more"
)
_LINE = (
    "Try in this order: speed and parity, one read for the whole reply, ground and termination; then show the raw bytes (a "
    "debug log of the library), for they tell more"
)
#: A number of an exception, as libraries write it: behind the word, in brackets, in hexadecimal.
_CODE = (
    r"(?:\b(?:modbus )?exception(?: (?:code|response|status)\b)?\s*[:=#]?\s*\(?(?:0x0?)?{0}\b(?!\.\d)"
    r"|ExceptionResponse\(\d+, ?\d+, ?{0}\b|\bexception_code\s*[:=]\s*{0}\b|request result: 0x0?{0}\b)"
)


@cache
def _compiled(pattern: str) -> re.Pattern[str]:
    """Return a pattern that is asked: few captures have words, and all of these take long to compile."""
    return re.compile(pattern, re.IGNORECASE)


#: The more exact words stand first: one text often has several, of several layers of a program.
REPORTS = (
    Report(
        rf"\billegal[ _]?data[ _]?address|\billegaldataaddress|{_CODE.format(2)}", "wrong_register",
        "the unit has no such register, or the quantity reaches over the last one",
        "Look the register up: many manuals count from 1, from 40001, or in hexadecimal; try one less",
    ),
    Report(
        rf"\billegal[ _]?data[ _]?value|\billegaldatavalue|{_CODE.format(3)}", "value_out_of_range",
        "the unit does not take the value or the quantity", "Look up the range of the register, and how many are read at once",
    ),
    Report(
        rf"\billegal[ _]?function|{_CODE.format(1)}", "wrong_function", "the unit does not know the function",
        "Look up which function the register has (03, 04, 06 or 10)",
    ),
    Report(
        rf"\b(?:slave|server)[ _](?:device )?(?:is )?busy|{_CODE.format(6)}", "too_fast",
        "the unit is busy with what it was asked before",
        "Wait for the end of what runs, then ask again",
    ),
    Report(
        rf"\bgateway[ _](?:target|path)|{_CODE.format('(?:0?b|11|10|0?a)')}", "no_reply",
        "the unit behind the gateway does not answer",
        "Check the unit's address behind the gateway, its speed, wires and power",
    ),
    Report(
        r"expected at least \d+ bytes? \((?!0 )\d+ received\)|\b(?:data )?length error, expected \d+,? got (?!0\b)\d+"
        r"|\blooking for \d+ bytes?, received (?!0\b)\d+"
        r"|\b(?:response|reply|message|packet|frame) (?:is |was )?(?:too short|incomplete)\b|\btoo short (?:response|reply)",
        "reply_cut", "a part of the reply came", "Read until the length of the reply is there or a timeout has passed",
    ),
    Report(
        r"\bdata length errors?\b(?!, expected)", "split_frame", "a read has another length than the reply",
        "Join what is read until the length of the reply is there: a library with a buffer does it (connectRTUBuffered)",
    ),
    Report(
        r"\blength not corresponding to the computed length", "wrong_length",
        "a reply has another length than its function and its count make",
        "Compare the reply with the manual byte by byte, and empty the input behind each reply that does not fit",
    ),
    Report(
        r"transaction[_ ]?id\s*=?\s*\d+,? but (?:got|received)"
        r"|transaction[_ ]?id\W{1,4}\d+\W{1,3}(?:does not|doesn't) match"
        r"|\b(?:unexpected|wrong|invalid) transaction[_ ]?id", "late_reply",
        "a reply came that belongs to a request before", "Wait longer for each reply, and clear the input before each request",
    ),
    Report(
        r"no response received|\blooking for \d+ bytes?, received 0\b"
        r"|\(0 received\)|no communication with the instrument|\bNoResponseError|TransactionTimedOut"
        r"|no response (?:received )?from the (?:remote )?(?:unit|slave|device)|request result: 0x(?:0?b|e4)\b"
        r"|modbus[^\n]{0,60}\btimed?[ -]?out\b(?! ?[=:(])|modbus\w*(?:timeout|timedout)(?:error|exception)"
        r"|\bconnection timed out: select|(?<!set )\b(?:response|reply) time[ -]?out\b(?! ?(?:[=:(]|is|of|to|for|set))"
        r"|\btime[ -]?out\W{1,3}no (?:response|reply|answer)\b|\bE0 - timeout\b|\berror: ?0xe0\b"
        r"|\b(?:read|write)\w*\b[^\n]{0,40}\bfailed: ?(?:connection|operation) timed out",
        "no_reply", "no reply came in time", _TRY,
    ),
    Report(
        r"\bask for id=\d+ but got id=\d+"
        r"|\brequest for slave \d+ ignored \(not 0\)"
        r"|\bresponse address \d+ is different from request address \d+|\bE[14] - (?:invalid server|server id mismatch)",
        "wrong_address", "the reply comes from another address than the one that was asked",
        "Ask at the address from which the reply comes; 0 is for all units, and none should answer from it; then look for "
        "stray bytes before the reply in a log of the raw bytes",
    ),
    Report(
        r"\bE5 - packet length error", "reply_cut", "a reply has another length than it should",
        "Look at the raw bytes (a debug log of the library): a part of the reply is missing, or stray bytes stand around it",
    ),
    Report(
        r"\b(?:get|got|gets|getting|switch\w*|go(?:es)?|stuck|stays?|changes?|falls?)\b[^\n\"]{0,50}\berror[- ]passive\b",
        "can_no_ack", "the CAN controller is error-passive: what it sends is not acknowledged, or fails on the line",
        "Look at the other node's power, CAN_H and CAN_L, 120 Ohm at both ends, then the bit rate of both; `candump -e "
        "any,0:0,#FFFFFFFF` shows what kind of errors they are",
    ),
    Report(
        r"(?<![\w.])-?\d(?:\.\d+)?e-(?:3[89]|4[0-5])\b", "wrong_byte_order",
        "a float comes out next to nothing: the words or bytes that make it stand in the wrong order, or it is no float",
        "Swap the two words (CDAB), then the bytes of each (BADC), until a known value comes out; a value that counts in whole "
        "numbers is an integer of 32 bits",
    ),
)  # fmt: skip
#: Words of a program that waits for a reply in vain, in sentences and in the lines of a log.
NOTHING_CAME = re.compile(
    r"time[ds]?[ -]?out(?:error|exception|expired|occurred)?\b(?!\s*(?:[:=(]|of|is|ms|in\b))|\bretr(?:y|ies)\b"
    r"|\bno (?:response|answer|reply)\b(?! (?:is )?(?:expected|needed|wanted|due))"
    r"|\b(?:never|n't|not) (?:answer|repl|respond|confirm)\w*"
    # What a console of Python has read.
    r"|^(?:b(?:''|\"\")|\[\])$"
    # `rx nothing`, `recv: b''`, `<- []`, `recv(timeout=1.0) -> None`, `=> None`.
    # A word between dashes is a heading.
    r"|(?:(?:(?<!- )|(?!\w+ -+$))\b(?:rxd?|rd|re?c(?:v|ei?ved?)|read|got|reply|response|answer|returned)\b(?:\([^()]{0,40}\))?"
    r"|<[-=]*|[-=]>)[\s:=>-]*"
    r"(?:[(<]?(?:nothing|none|empty)\b(?! (?:else|special|wrong|needed|expected))|b?(?:''|\"\")|\[\]|<Buffer ?>|-{1,3}$)",
    re.IGNORECASE,
)
#: A check that was expected and one that was got, in any of the usual words.
_CHECKS = (
    (
        r"\bcrc[^\n]{0,60}?\bexpected:?\s*(?:0x)?(?P<meant>[0-9a-f]{1,4})\b[^\n]{0,30}?\b(?:got|received|but|actual)\b:?[^\n]{0,12}?"
        r"\s(?:0x)?(?P<got>[0-9a-f]{1,4})\b"
    ),
    (r"\bcrc received:?\s*(?:0x)?(?P<got>[0-9a-f]{1,4})\b[^\n]{0,12}?\bcrc calculated:?\s*(?:0x)?(?P<meant>[0-9a-f]{1,4})\b"),
    (
        r"\bcrc check failed!?\s*(?P<meant>[0-9a-f]{1,4})\s*!=\s*(?P<got>[0-9a-f]{1,4})\b"
        r"(?:\s+(?P<bytes>[0-9a-f]{2}(?:[. :][0-9a-f]{2})+)\b)?"
    ),
    (
        r"\bcrc[^\n]{0,30}?\b(?:received|got)\b:?\s*(?:0x)?(?P<got>[0-9a-f]{1,4})\b[^\n]{0,20}?\b(?:calculated|expected|computed)\b"
        r"[^\n]{0,8}?\s(?:0x)?(?P<meant>[0-9a-f]{1,4})\b"
    ),
)
_FAILED_CHECK = (
    r"\bcrc(?:16)? ?(?:check )?(?:error|fail\w*|mismatch)|\b(?:invalid|wrong|bad|incorrect) crc|\bchecksum error in rtu"
)


class Checks(NamedTuple):
    """Checks of replies as a library prints them: `meant` computed from the bytes, `got` in them; and these, if shown."""

    text: str
    meant: int
    got: int
    data: bytes = b""

    @property
    def swapped(self) -> bool:
        """Whether one is the other with its bytes swapped."""
        return self.meant != self.got and self.meant == (self.got >> 8 | self.got << 8 & 0xFF00)

    @property
    def half(self) -> bool:
        """Whether a byte of what was got is missing, or a 00 stands for it."""
        return not self.got & 0xFF or not self.got >> 8

    @property
    def edges(self) -> bool:
        """Whether what was got is bytes that a line makes by itself."""
        return self.got != 0 and {self.got & 0xFF, self.got >> 8} <= GLITCHES


def checks(words: str) -> list[Checks]:
    """Return the checks that words compare."""
    found = next((rows for rows in (list(_compiled(each).finditer(words)) for each in _CHECKS) if rows), [])
    return [Checks(row[0], int(row["meant"], 16), int(row["got"], 16), _bytes(row.groupdict().get("bytes"))) for row in found]


def _bytes(text: str | None) -> bytes:
    return bytes.fromhex(re.sub(r"[. :]", "", text or ""))


def reports(words: str) -> Iterator[tuple[Report, str, int]]:
    """Yield what libraries report, with their words, and how often."""
    silent = 0
    for report in REPORTS:
        found = [row[0] for row in _compiled(report.pattern).finditer(words)]
        if found:
            silent = len(found) if report.cause == "no_reply" else silent
            yield report, found[0], len(found)
    compared = checks(words)
    # A check that fails as often as nothing comes is one of nothing.
    if compared or len(_compiled(_FAILED_CHECK).findall(words)) > silent:
        yield _of_checks(words, compared)


#: Pieces that are no chance, and the bytes of the shortest reply.
_PARTS, _SMALLEST = 3, 5
#: All but one in so many.
_MOST_OF = 3


def _are_pieces(compared: list[Checks]) -> bool:
    """Say whether most have the size of the shortest reply, and begin otherwise each, as the parts of one reply do."""
    smallest = sum(len(each.data) == _SMALLEST for each in compared)
    return (
        _MOST_OF * smallest >= len(compared) * (_MOST_OF - 1) and len({each.data[:2] for each in compared}) > len(compared) // 2
    )


def _of_checks(words: str, compared: list[Checks]) -> tuple[Report, str, int]:
    """Return what failing checks stand for: their numbers tell more than that they fail."""
    if compared and all(each.swapped for each in compared):
        cause, what = "crc_swapped", "the two bytes of each CRC are swapped"
        todo = "Send the low byte of the CRC first, and compare it so"
    elif len(compared) >= _PARTS and all(each.edges for each in compared):
        cause, what = "leading_glitch", "bytes of an edge or of an idle line (00, FE, FF) stand where a reply should"
        todo = "Bias and terminate the line, and see that the driver of each node is off while it does not send"
    elif compared and all(each.half for each in compared):
        cause, what = "reply_cut", "a byte of each CRC is missing: the reply was not read to its end"
        todo = "Read until the length of the reply is there or a timeout has passed"
    elif len(compared) >= _PARTS and _are_pieces(compared):
        cause, what = "split_frame", f"each {_SMALLEST} bytes that come are taken for a reply: it is cut into pieces"
        todo = (
            "Let the host read on until a pause shows the end: a larger buffer, a later interrupt (rx_full_threshold, "
            "rx_timeout), and no other work between its reads"
        )
    else:
        cause, what, todo = "noise", "replies come damaged", _LINE
    shown = compared[0].text if compared else next(iter(_compiled(_FAILED_CHECK).findall(words)), "")
    times = len(compared) or len(_compiled(_FAILED_CHECK).findall(words))
    return Report(_FAILED_CHECK, cause, what, todo), shown, times


#: A library's words for a reply that does not fit the request.
MISFIT = re.compile(r"wrong (?:function ?code|(?:return )?slave ?address): \d+ instead of \d+", re.I)


def speaks(line: str) -> bool:
    """Say whether a line has a library's report of an exchange."""
    return (
        MISFIT.search(line) is not None
        or any(_compiled(report.pattern).search(line) for report in REPORTS)
        or _compiled(_FAILED_CHECK).search(line) is not None
    )


def last_bytes(words: str) -> bytes:
    """Return the last bytes in a line of words; none where no letter shows that their numbers are hexadecimal."""
    text = next((found[0] for found in reversed(list(_SAID.finditer(words)))), "")
    if _LETTER.search(text) is None:
        return b""
    numbers = _NUMBER.findall(text)
    return bytes(int(each, 16) for each in numbers) if len(numbers) > 1 else bytes.fromhex(text)


#: Bytes in words, with gaps and without.
_SAID = re.compile(
    r"(?<![\w.:-])(?:(?:(?:0x)?[0-9a-f]{1,2}[ ,:-]{1,2}){3,}(?:0x)?[0-9a-f]{1,2}|(?:[0-9a-f]{2}){4,})(?![\w.:-])", re.IGNORECASE
)
_LETTER, _NUMBER = re.compile(r"[a-fx]", re.IGNORECASE), re.compile(r"\b(?:0x)?([0-9a-f]{1,2})\b", re.IGNORECASE)
