"""What can stand before the bytes of a line: times, marks, names, counts. `hexline` peels a line by this table."""

from __future__ import annotations

import re
from enum import StrEnum

from analyzer.sources.marks import ACTIONS, LETTERS, SIGNS, WORDS
from analyzer.sources.stamps import ANY, DAYS


class When(StrEnum):
    """Where an item of a line may stand: anywhere, before the first mark, or behind it."""

    ANY = "any"
    UNMARKED = "unmarked"
    MARKED = "marked"


#: Words and signs that say who sent, and what may stand behind them.
WORDS_PATTERN = "|".join(sorted(WORDS, key=len, reverse=True))
_RECEIVED = "|".join(sorted((word for word, way in ACTIONS.items() if way < 0), key=len, reverse=True))
_letters = "|".join(LETTERS)
SIGNS_PATTERN = "|".join(re.escape(sign) for sign in sorted(SIGNS, key=len, reverse=True))
_END = r"(?![0-9A-Za-z_]|::|\.[A-Za-z])"
#: What some programs put before a time.
TIMED = r"(?:@|T\+|(?:time|ts|t)\s*[=:]\s*\"?)?"
DECORATION = r"[\s:=<>|\])→←◇◆：,;]*(?:-+[>\s]\s*)?"
#: A byte of two digits.
PAIR = r"(?:0[xX])?[0-9A-Fa-f]{1,2}(?![0-9A-Za-z_.])"
#: What is written or read by its number, by name: what stands behind are a number and values, no bytes.
_VALUES = r"(?:reg|coil|bits?(?![a-z])|float|holding|input)"
#: Words for bytes, behind the word that says who sent: `ReadFrame`, `rx_buffer`, `TX data`.
CONTENT = r"(?:data|bytes?|frame|adu|pdu|buffer|buf|packet|msg|message|raw|数据|报文|帧)"
#: What bytes can begin with.
_BYTES = (
    rf"(?={PAIR}|0x(?:[0-9A-Fa-f]{{2}}){{3,}}\b|[\[{{(<\"'b]|"
    r"[0-9A-Fa-f]{4,}\s*(?:$|->|<-|[→←|#])|(?:[0-9A-Fa-f]{2}\.){5}|(?:[0-9A-Fa-f]{2}\.)+[0-9A-Fa-f]{2}\s\(\d+\)|-?\d{1,3}[\s,])"
)
#: What stands between the name of a call and the bytes that it returned.
_RETURNED = rf"\(\d{{0,5}}\)(?:\s*(?:[-=]>|[→=:])\s*{_BYTES}|\s+(?={PAIR}|(?:[0-9A-Fa-f]{{2}}){{3,}}(?:\s|$)|b['\"]|\[))"


def _end(group: str) -> str:
    """Return the pattern of a name of an end of a line, which is no byte and no word for bytes."""
    return rf"(?!(?:[0-9A-F]{{2}}|hex|{CONTENT})\b)(?P<{group}>[A-Za-z][A-Za-z0-9]{{0,11}})(?![0-9A-Za-z_])"


#: One end of a line and the other, with an arrow between them.
_ENDS = rf"{_end('one')}\s*(?P<way>[-=]{{0,2}}>|<[-=]{{1,2}}|[→←])\s*{_end('other')}{DECORATION}{_BYTES}"

#: A letter alone before three bytes or more of two digits each: who sent, even if it is a hexadecimal digit.
LETTER = re.compile(
    r"\s*(?P<letter>[a-z])(?:\s*[|;,]\s*|\s+)(?=(?:[0-9a-f]{2}[\s:-]{0,2}){3,}+(?:$|[^0-9a-z]|[g-z]))", re.IGNORECASE
)

#: Items that may stand before the bytes, in the order of trying, each with a character that its lines have. The names of the
#: groups say what an item is.
ITEMS: tuple[tuple[When, str, re.Pattern[str]], ...] = tuple(
    (when, has, re.compile(pattern, re.IGNORECASE))
    for when, has, pattern in (
        # A time; `month` has letters that no other has.
        (When.ANY, "", rf"\s*{TIMED}[\[(]?\s*(?:{ANY})(?![0-9A-Za-z_.]|:[0-9A-Fa-f])\s*[\])\"]?(?:[\s,;:|]|-(?!>))*"),
        # `# SEND HEX>`: the bytes follow on the next lines.
        (When.ANY, "#", r"\s*#\s*(?P<assist>SEND|RECV)\s+(?P<form>HEX|ASCII|BIN)[^>]{0,80}>\s*"),
        # Milliseconds since the start, as a counter of a controller gives them: `[65250] TX`, `65250 TX`, `I (65250) bus:`.
        (
            When.UNMARKED,
            "",
            rf"\s*(?:\[\s*(?P<millis>\d{{4,10}})\]|[VDIWE] \((?P<counted>\d{{1,10}})\)"
            rf"|(?P<leading>[1-9]\d{{3,9}})(?=[\s:]+(?:{WORDS_PATTERN}){_END}))[\s:]*",
        ),
        # `ser.write(`, `write(3, "..."`, `HAL_UART_Transmit(&huart1, {`.
        (
            When.ANY,
            "(",
            rf"\s*(?:[$>\s]*)(?:(?:[A-Za-z_]\w*\.)*|HAL_\w{{1,8}}_)(?P<call>{WORDS_PATTERN})(?!\w*{_VALUES})\w{{0,12}}\((?=[^)]*[,\"'])(?:\d{{1,4}},\s*(?=[\"'])|&?\w+,\s*(?=[{{\[]))?",
        ),
        # `>>> list(ser.read(64))`, `>>> ser.read(64).hex(" ")`: a console prints below it what it returns.
        (
            When.UNMARKED,
            ">>>",
            rf"\s*>>>\s*(?:[A-Za-z_][\w.]{{0,40}}\()?(?:[A-Za-z_]\w{{0,40}}\.)+(?P<call>{_RECEIVED})\w{{0,12}}"
            r"\([\w.=, ]{0,40}\)(?:\.hex\([^()]{0,20}\))?[)\s]*$",
        ),
        # `Serial1.write: FA 1 30 2B`, `socket.send  FA01302B -> nothing`.
        (
            When.ANY,
            ".",
            rf"\s*(?:[A-Za-z_]\w*\.)+(?P<call>{WORDS_PATTERN})(?:all|_?{CONTENT})?(?:\(\))?(?:\s*[:=]\s*|\s+){_BYTES}",
        ),
        # `on('data') <Buffer fb>`: an event of Node.js, whatever number of bytes it brings.
        (When.UNMARKED, "on(", rf"\s*(?:[A-Za-z_]\w*\.)*on\(['\"](?P<drive>data)['\"]\){DECORATION}"),
        # `read(8) -> b'\\xfb'`: a call with what it returned.
        (When.ANY, "(", rf"\s*(?:[A-Za-z_]\w*\.)*(?P<call>{WORDS_PATTERN}){_RETURNED}"),
        # Who sends to whom, as analyzers of USB name the ends.
        (
            When.UNMARKED,
            "host",
            r"\s*(?:(?P<host>host\s+\d+\.\d+\.\d+)|(?P<drive>\d+\.\d+\.\d+\s+host))\s+(?:USB\s+)?(?:\d{1,5}\s+)?",
        ),
        # Who sends to whom: `PC=>MOT`, `COM>TCP`, `[host <- drive]`.
        (When.UNMARKED, "", rf"\s*[\[(]?{_ENDS}"),
        (When.ANY, "", rf"[\s#*<>=\[(-]*(?:VISA\s)?(?P<word>{WORDS_PATTERN})(?:_?{CONTENT}|HEX)?(?:\(\):)?{_END}{DECORATION}"),
        # `('TX', b'\\xfa')`, as Python prints pairs.
        (When.ANY, "'", rf"\s*[\[({{]?\s*'(?P<word>{WORDS_PATTERN})'\s*[,:]\s*"),
        (When.UNMARKED, "\t", r"\d{1,9}\t(?=\d+\.\d+\t)"),
        # What the bytes are called, how many they are, a counter as Modbus Poll prints it.
        (When.MARKED, "", rf"(?:hex|{CONTENT}){_END}[\s:=>]*"),
        (When.MARKED, "", r"len(?:gth)?\s*[=:]?\s*\d{1,5}\s*(?:bytes?)?(?:[\s:=>,-]+(?:(?:from|to)=\d+\s*)*|$)"),
        (When.MARKED, "", r"[\[(]\s*(?:len\s*[=:]?\s*)?\d{1,5}\s*(?:bytes?|B)?\s*[\])](?!\s*[\[(])[\s:=>-]*"),
        (When.MARKED, "", rf"\d{{1,5}}\s+bytes?\s*[:=]?\s*{_BYTES}"),
        (When.MARKED, ":", rf"(?:to|from|by|on|for|over|via|at)\s[^:]{{1,40}}:\s+{_BYTES}"),
        (When.MARKED, "", r"\d{3,9}-(?=\s*[0-9A-Fa-f]{2}(?:\s|$))"),
        (When.ANY, ":", rf"\s*(?P<count>\d{{1,5}})\s*:\s+{_BYTES}"),
        # What the bytes are called, where nothing says who sent; a bullet or a number of a list.
        (
            When.UNMARKED,
            "",
            rf"\s*(?P<label>hex|data|bytes|frame|packet|buffer|payload|msg|message|raw)\s*\d*\s*(?:[:=]\s*{_BYTES}|(?=<Buffer\b|Uint8Array\())",
        ),
        # What Windows was asked for, and how it went; the place of a line that searches of files and loggers print.
        (When.MARKED, "", r"(?:(?:UP|DOWN|SUCCESS|STATUS_\w+)\s+)+"),
        (When.ANY, ":", r"\s*[\w./-]{1,60}\.[A-Za-z]\w{0,4}:\d{1,7}[:\s]\s*"),
        # One byte behind a bullet is what a list explains.
        (When.UNMARKED, "", rf"(?P<bullet>[-•]|\d{{1,3}}[.)])\s+(?:{_BYTES}(?!{PAIR}\s*$)|(?=(?:{SIGNS_PATTERN})\s))"),
        # `echo -ne '\\xFA' > /dev/ttyUSB0`.
        (When.UNMARKED, "", r"(?:\$\s+)?(?P<shell>echo|printf)\s+(?:-\w+\s+)*(?=['\"])"),
        (When.UNMARKED, "", rf"\s*(?P<letter>out|in)\s+{_BYTES}"),
        (When.UNMARKED, "", rf"\s*\[?(?P<letter>{_letters})\]?(?:\s*[:>|]+|\t)\s*"),
        # `W 1 3 0 0`: a letter before numbers alone.
        (When.UNMARKED, "", r"\s*(?P<letter>[wrt])\s+(?=(?:(?:0x)?[0-9a-f]{1,3}[\s,]+){2,}(?:0x)?[0-9a-f]{1,3}[\s,]*$)"),
        (When.UNMARKED, "", LETTER.pattern),
        (When.UNMARKED, "", rf"\s*+(?::\s*+)?[\[(]?(?P<sign>{SIGNS_PATTERN})(?![<>=-])[\])]?[\s:]*"),
        (
            When.ANY,
            "",
            r"\s*(?:\[(?P<name>[A-Za-z][\w :./\\#-]{0,40})\]|\[\d{1,9}\](?!\[)|\((?P<port>COM\d{1,3})\)"
            r"|(?P<device>(?:/dev/)?(?:tty|com|uart|bus|port)\w{1,20})(?=[\s:]|$))[\s:,|-]*(?:>\s*(?=[A-Za-z]))?",
        ),
        # A counter before a mark.
        (When.UNMARKED, "", rf"\s*#?\d{{1,9}}\s*[-.):]\s*(?=[<>\[(]*(?:{WORDS_PATTERN}){_END})"),
        (When.ANY, ".", rf"\s*\d{{1,9}}\s*\|\s*(?=\d{{1,4}}[-:/.]\d|[|\s]*(?:{WORDS_PATTERN}){_END})"),
        # A declaration: `uint8_t run[] = {`.
        (
            When.UNMARKED,
            "",
            r"[\w\s*:<>]{0,60}?(?P<variable>\$\d{1,4}|[A-Za-z_]\w*+)\s*+(?:\[\w*\]\s*+)?(?:=|:(?=\s\[(?:16#|0x)))\s*(?=[\[{(\"'<]|b['\"]|byte|new|0x|Buffer)",
        ),
    )
)
#: A logger's own words ("DEBUG:pymodbus.logging:send: 0x1 0x3") stand before the mark; so does a phrase that ends in a colon.
DISTANT = re.compile(
    # What a name ends with, as `FB_Servo`, speaks for no drive.
    rf"(?<![^\W_])(?<!\.)(?<!before )(?!(?<=[a-z]_)(?:servo|motor|drive|device)\b)(?:{_ENDS}|(?:{WORDS_PATTERN}){_RETURNED}"
    rf"|(?<=:)(?:{SIGNS_PATTERN})\s+(?={PAIR}[\s,:-]+{PAIR})|(?<=\s)(?:->|<-)\s+(?=\d{{1,3}}-\d{{1,3}}-)"
    # `bus.py:41 write(b'...')`, `msg=tx data="FA 01"`, `modbus_tx_adu: FA 01`; a number behind a name is that of a line.
    rf"|(?:{WORDS_PATTERN})\w{{0,12}}\((?=b['\"]|[\[{{'\"])|(?:{WORDS_PATTERN})\s+(?:hex|{CONTENT})=[\"']?(?={PAIR})"
    rf"|(?:{WORDS_PATTERN})(?:_{CONTENT}(?!>))?\s*(?:[>\]=|]|:(?!:|\d{{1,5}}\s-\s))|(?<![\w,]\s)(?:{WORDS_PATTERN})\s+"
    rf"(?={PAIR}[\s,:-]+{PAIR}|(?:[0-9a-f]{{2}}){{3,}}(?:\s|$)|<Buffer|Uint8Array\(|b['\"]|[\[{{(]\s*['\"]?(?:0x)?-?[0-9a-f]{{1,3}}\b))",
    re.IGNORECASE,
)
PHRASE = re.compile(rf"(?<![\w.])(?P<word>{WORDS_PATTERN}){_END}[^:]{{1,60}}:\s+{_BYTES}", re.IGNORECASE)
DISTANT_LIMIT = 80
#: A time among the words of a logger.
DISTANT_TIME = re.compile(rf"(?<![\w.:]){DAYS}(?![\w.:])")
