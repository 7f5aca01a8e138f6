"""How a hex text is written, as far as one line alone cannot tell: whom the marks name, which numbers are decimal."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.link import REGISTER_READS, modbus_crc
from analyzer.sources.hexfields import begins_dump, has_cells, has_fields
from analyzer.sources.hexline import LEADS, HexLine, Shape, bytes_of, take_apart
from analyzer.sources.marks import OTHER_SIDE, TO, WORDS, role_of
from analyzer.sources.prose import quotations
from analyzer.sources.written import Radix, decimal

#: So many lines marked as received, and none as sent, are a listener's.
_LISTENER_LINES = 8
#: So many lines of one byte are a log of bytes.
_SINGLE_LINES = 4
#: Bytes of a line of decimal numbers without a mark; rows of a table begin with more values than these.
_DECIMAL_BYTES, _DECIMAL_HEADS = 4, 4
#: A request to read registers, and what a reply has beside its registers.
_READ_BYTES, _AROUND = 8, 5
#: Bytes of the shortest native frame.
_SUMMED = 4
#: The head of a frame of LK, and commands that read and ask without data.
_LK, _LK_HEAD, _LK_READS = 0x3E, 5, range(0x90, 0xA0)
#: An odd number of digits without a gap, and the number of such lines that is no slip.
_ODD_DIGITS, _UNPADDED_LINES = re.compile(r"\s*[0-9A-F](?:[0-9A-F]{2}){2,}\s*"), 2
#: Bytes with gaps between them, and one of one digit beside one of two.
_SHORT = re.compile(r"\s*(?:[0-9A-Fa-f]{1,2}\s+){2,}[0-9A-Fa-f]{1,2}\s*")
_BOTH = re.compile(r"(?=.*\b[0-9A-Fa-f]\b).*\b[0-9A-Fa-f]{2}\b")
#: Marks that are bytes where bytes stand without their zeros.
_HEX_LETTERS = frozenset("abcdef")
#: The least byte of two digits.
_TWO_DIGITS = 0x10
SINGLE = re.compile(r"\s*(?:0[xX])?([0-9A-Fa-f]{1,2}|\d{3})\s*")
_DIGIT = re.compile(r"(?:(?P<call>.*\w)\(\):)?\s*(?P<digit>[0-9A-Fa-f])\s*")
_QUOTED = re.compile(r"\s*>\s?")
_ARROW = "->"
#: What libmodbus prints behind each request.
_AWAITS = "Waiting for a confirmation"


def _is_count(part: HexLine) -> bool:
    """Say whether a number stands alone behind a mark, as one byte does."""
    return part.marked and (len(part.data) == 1 or (part.shape is Shape.BROKEN and part.text.strip(" :").isdecimal()))


def _as_header(part: HexLine) -> HexLine:
    """Return the mark above a dump without the number of its bytes."""
    return part._replace(shape=Shape.HEADER, data=b"") if _is_count(part) else part


def _asks(data: bytes) -> bool:
    """Say whether bytes are a request, to read registers or of a native dialect: who receives one is a server, or listens."""
    if data[:1] == b"\xfa" and _sums(data):
        return True
    if len(data) == _LK_HEAD and data[0] == _LK and data[1] in _LK_READS and _sums(data):
        return True
    return len(data) == _READ_BYTES and data[1] in REGISTER_READS and modbus_crc(data) == 0


def _replies(data: bytes) -> bool:
    """Say whether bytes are a reply, of registers or of a native dialect, and no request."""
    if data[:1] == b"\xfb" and _sums(data):
        return True
    if len(data) > _LK_HEAD and data[0] == _LK and data[1] in _LK_READS and _sums(data[:_LK_HEAD]):
        return data[3] == len(data) - _LK_HEAD - 1
    long = len(data) >= _AROUND and len(data) != _READ_BYTES
    return long and data[1] in REGISTER_READS and data[2] == len(data) - _AROUND and modbus_crc(data) == 0


def _sums(data: bytes) -> bool:
    """Say whether bytes end in their sum."""
    return len(data) >= _SUMMED and sum(data[:-1]) & 0xFF == data[-1]


def _is_deaf(traffic: Sequence[HexLine], roles: Sequence[Role]) -> bool:
    """Say whether the marks tell nothing, because all lines have the same: those of a listener, or the name of a host."""
    if Role.REQUEST not in roles:
        return roles.count(Role.REPLY) >= _LISTENER_LINES or any(p.role is Role.REPLY and _asks(p.data) for p in traffic)
    marked = [p.data for p in traffic if p.role is Role.REQUEST]
    return Role.REPLY not in roles and any(map(_replies, marked)) and any(map(_asks, marked))


def _is_turned(traffic: Sequence[HexLine]) -> bool:
    """Say whether a server writes: all requests that can be told are marked as received, and all replies as sent."""
    asked = [p.role for p in traffic if _asks(p.data)]
    replied = {p.role for p in traffic if _replies(p.data)}
    # An echo comes after what was sent, alone or with the reply.
    first = next((p.data for p in traffic if _asks(p.data)), b"")
    echoed = not replied and any(p.role is Role.REQUEST and p.data.startswith(first) for p in traffic)
    return asked[:1] == [Role.REPLY] and (echoed or (replied == {Role.REQUEST}))


def _below(parts: Sequence[HexLine]) -> Iterator[HexLine]:
    """Yield the lines of traffic, with the role of the header that stands above them."""
    header = Role.UNKNOWN
    for part in parts:
        if part.shape is Shape.HEADER:
            header = part.role
        elif part.shape is Shape.TRAFFIC:
            header = Role.UNKNOWN if part.marked or part.stamp.kind else header
            yield part if header is Role.UNKNOWN else part._replace(role=header)


def _asker(traffic: Sequence[HexLine]) -> str:
    """Return the name of who sends requests to read registers, of names that speak to each other; empty where none does."""
    votes: Counter[str] = Counter()
    for part in traffic:
        if TO in part.sign:
            sender, receiver = part.sign.split(TO)
            votes[sender] += _asks(part.data)
            votes[receiver] += _replies(part.data)
    return max(votes, key=lambda name: votes[name]) if votes.total() else ""


def says(parts: Sequence[HexLine]) -> bool:
    """Say whether a line of words speaks of frames."""
    return any(quotations(p.text) for p in parts if p.shape in (Shape.COMMENT, Shape.BROKEN))


def is_single(lines: Sequence[str]) -> bool:
    """Say whether each line is one byte."""
    return len(lines) >= _SINGLE_LINES and all(SINGLE.fullmatch(line) for line in lines)


def is_decimal_column(lines: Sequence[str]) -> bool:
    """Say whether lines of one byte each are decimal."""
    return any(len(line.strip()) == 3 for line in lines) and decimal(" ".join(lines)) is not None


def is_table(parts: list[HexLine]) -> bool:
    """Say whether rows of decimal numbers are those of a table, rather than bytes that begin with a few heads."""
    if not parts:
        return False
    heads = Counter(p.data[0] for p in parts)
    return len(heads) > _DECIMAL_HEADS or any(len(p.data) < _DECIMAL_BYTES for p in parts)


def _counts_up(lines: Sequence[str], traffic: Sequence[HexLine]) -> bool:
    """Say whether a number that counts up stands before the frame of each line, and is no byte of it."""
    found = [(row, line.strip()[row.end() :]) for line in lines if (row := LEADS.match(line.strip())) is not None]
    if len(found) < max(_COUNTED_ROWS, len(traffic)) or any(int(b[0][1]) - int(a[0][1]) != 1 for a, b in pairwise(found)):
        return False
    behind = [bytes_of(text) or b"" for _, text in found]
    return all(data[:1] in _HEADS or modbus_crc(data) == 0 for data in behind) and all(modbus_crc(p.data) for p in traffic)


#: Rows whose numbers count up by no chance, and the heads of native dialects.
_COUNTED_ROWS, _HEADS = 3, (b"\xfa", b"\xfb", b"\x3e")


def _counts_bytes(traffic: Sequence[HexLine]) -> bool:
    """Say whether the first number of each line says how many bytes follow, in lines of different lengths."""
    counts = [(p.number, len(p.data)) if p.led else (int(f"{p.data[0]:x}"), len(p.data) - 1)
              for p in traffic if p.led or f"{p.data[0]:x}".isdecimal()]  # fmt: skip
    fits = len(counts) == len(traffic) > 1 and all(number == size for number, size in counts)
    return fits and len(set(counts)) > 1 and any(p.led for p in traffic)


def _spelled(data: bytes) -> bytes:
    """Return the bytes that a string of hex digits stands for, none for any other."""
    return bytes.fromhex(data.decode()) if len(data) >= _SPELLED and _HEX_DIGITS.fullmatch(data) is not None else b""


def _is_spelled(traffic: Sequence[HexLine]) -> bool:
    """Say whether what was received are hex digits, and no echo: a program prints bytes so, for no drive sends letters."""
    sent = {p.data for p in traffic if p.role is Role.REQUEST}
    return any(p.role is Role.REPLY and p.data not in sent and _spelled(p.data) for p in traffic)


#: A list of hexadecimal numbers without zeros before them, and what shows that they are hexadecimal.
_SHORT_LIST = re.compile(r"\[\s*[0-9A-Fa-f]{1,2}(?:,\s*[0-9A-Fa-f]{1,2}){3,}\s*\]")
_HEX_LIST = re.compile(r"[\[,]\s*(?:[A-Fa-f][0-9A-Fa-f]|[0-9][A-Fa-f])\s*[,\]]")
_DIGIT_ALONE = re.compile(r"\b[0-9A-Fa-f]\b")
#: Letters of the shortest frame.
_SPELLED, _HEX_DIGITS = 8, re.compile(rb"(?:[0-9A-Fa-f]{2})+")


def _leaves_replies(traffic: Sequence[HexLine]) -> bool:
    """Say whether a sign stands before what was sent and none before what was received: some is a reply, and none a request."""
    bare = [p for p in traffic if not p.marked]
    marked = all(p.role is Role.REQUEST and not p.worded for p in traffic if p.marked)
    return (
        marked and 0 < len(bare) < len(traffic) and any(_replies(p.data) for p in bare) and not any(_asks(p.data) for p in bare)
    )


def _is_digit(line: HexLine) -> bool:
    """Say whether a line has one digit alone: a byte without its leading zero, where each line is a byte.

    A function may print it: `receive(): 1`.
    """
    found = _DIGIT.fullmatch(line.text) if line.shape in (Shape.BROKEN, Shape.COMMENT) else None
    return found is not None and (found["call"] is None or bool(_words(found["call"])))


def _words(call: str) -> list[str]:
    """Return the words of a line that say who sent."""
    return [word for word in re.findall(r"[^\W\d_]+", call.lower()) if word in WORDS]


def _is_short(line: str, part: HexLine) -> bool:
    """Say whether bytes of a line stand without their zeros, beside bytes of two digits."""
    if part.sign in _HEX_LETTERS:
        return False
    shown = [f"{byte:x}" for byte in part.data]
    behind = len({len(digits) for digits in shown}) > 1 and line.lower().split()[-len(shown) :] == shown
    return behind or (_SHORT.fullmatch(line) is not None and _BOTH.search(line) is not None)


def _is_quoted(lines: Sequence[str]) -> bool:
    """Say whether `>` is a quotation: it stands before words too, or another mark or time, and what is not quoted is words."""
    begun = [line for line in lines if _QUOTED.match(line)]
    others = (line for line in lines if not _QUOTED.match(line))
    if len(begun) < 2 or any(line.lstrip().startswith("<") or take_apart(line).shape is Shape.TRAFFIC for line in others):
        return False
    inner = [take_apart(_QUOTED.sub("", line, 1)) for line in begun]
    return any(p.shape is Shape.COMMENT or p.marked or p.stamp.kind for p in inner)


def _wrapped(lines: Sequence[str], traffic: Sequence[HexLine]) -> int:
    """Return how many bytes each line of a dump has but the last; 0 where lines can be frames: those begin alike.

    Frames that have their characters behind them all begin alike.
    """
    sizes = {len(p.data) for p in traffic[:-1]}
    bare = not any(p.marked or p.stamp.kind or p.number is not None for p in traffic)
    size = sizes.pop() if len(sizes) == 1 and len(traffic) > _DUMP_LINES else 0
    heads = Counter(p.data[0] for p in traffic)
    full = bare and size >= _DUMP_WIDTH and size >= len(traffic[-1].data)
    alike = len(heads) == 1 if all(map(_WITH_CHARACTERS.match, lines)) else 2 * max(heads.values(), default=0) > len(traffic)
    return size if full and not alike else 0


def _answer(lines: Sequence[str], parts: Sequence[HexLine]) -> str:
    """Return the word for bytes that stands before what came back, where only what was sent has a mark."""
    sent = [p for p in parts if p.shape is Shape.TRAFFIC]
    if len(sent) < _ANSWERS or {p.role for p in sent} != {Role.REQUEST}:
        return ""
    said = b" ".join(p.data for p in sent)
    words = Counter(
        came["name"].lower()
        for line, part in zip(lines, parts, strict=True)
        if part.shape is not Shape.TRAFFIC and (came := _NAMED.search(line)) is not None
        and (data := bytes_of(came["bytes"])) and data not in said
    )  # fmt: skip
    return next((word for word, count in words.most_common(1) if count >= _ANSWERS), "")


#: A row of a dump, with its bytes as characters behind them.
_WITH_CHARACTERS = re.compile(r"\s*(?:[0-9A-Fa-f]{2} ){1,32} +\S")
#: Lines of a dump and bytes of each, at least; and lines of what came back.
_DUMP_LINES, _DUMP_WIDTH, _ANSWERS = 3, 16, 2
#: A word that says what follows is bytes, and not who sent them.
_NAMED = re.compile(
    r"\b(?P<name>processing|data|bytes|buffer|buf|raw|chunk|packet|hex)\b\s*[:=]?\s+"
    r"(?P<bytes>(?:0x[0-9a-f]{1,2}[ ,]*){3,}$|(?:[0-9a-f]{2} ?){3,}$)",
    re.IGNORECASE,
)


class Manner(NamedTuple):
    """How a text is written, as far as one line alone cannot tell."""

    #: Every line begins with `>`, lines of words too: a quotation.
    quoted: bool = False
    #: Numbers without a letter are decimal, because others can be nothing else.
    decimal: bool = False
    #: What stands alone behind a mark is how many bytes the dump below it has.
    counted: bool = False
    #: Each line is one byte.
    single: bool = False
    #: Each line is one byte behind its time or its mark.
    lone: bool = False
    #: A sign that stands on every line behind its time, as Arduino's serial monitor prints it.
    arrow: bool = False
    #: Bytes in `[]` were sent, those in `<>` received, as libmodbus prints them.
    brackets: bool = False
    #: Every line has the same mark, as in a listener's log: it does not tell who sent.
    deaf: bool = False
    #: A server writes: what it sends are replies.
    turned: bool = False
    #: The name of who sends requests, of two names that tell nothing by themselves.
    asker: str = ""
    #: A number stands before the bytes of each line.
    led: bool = False
    #: Strings of hex digits are bytes, as Python's hexlify returns them: the replies are frames.
    spelled: bool = False
    #: A list without 0x has numbers that are certainly hexadecimal: so are those of all others.
    padded: bool = False
    #: Only what was sent has a mark: what stands without one was received.
    replies_bare: bool = False
    #: There is no line of a log: sentences are read.
    prose: bool = False
    #: Frames stand field by field, a line each.
    fields: bool = False
    #: Their names stand elsewhere.
    cells: bool = False
    #: All bytes stand in comments of a program.
    commented: bool = False
    #: Bytes stand without their zeros: where a line has nothing but single digits, these are bytes, too.
    short: bool = False
    #: So is a letter alone before bytes, because no line with one has a byte with its zero.
    lettered: bool = False
    #: Bytes stand without gaps and without their zeros: where one ends cannot be told.
    unpadded: bool = False
    #: So many bytes stand on each line of a dump: a line ends where it is full, and not where a read does.
    wrapped: int = 0
    #: The word before what came back, where no word says so and only what was sent has a mark.
    answer: str = ""

    @classmethod
    def of(cls, lines: Sequence[str]) -> Manner:
        """Find out how the lines of a head are written."""
        if is_single(lines):
            return cls(single=True, decimal=is_decimal_column(lines))
        quoted = _is_quoted(lines)
        parts = [take_apart(_QUOTED.sub("", line, 1) if quoted else line) for line in lines]
        counted = any(_is_count(part) and begins_dump(below) for part, below in zip(parts, lines[1:], strict=False))
        if counted:
            parts = [_as_header(part) for part in parts]
        traffic = list(_below(parts))
        roles = [p.role for p in parts if p.shape in (Shape.TRAFFIC, Shape.HEADER)]
        stamped = [p for p in parts if p.stamp.kind]
        prose = not any(p.stamp.kind or p.marked for p in traffic)
        bytes_alone = [p for p in parts if (p.shape is Shape.TRAFFIC and len(p.data) == 1 and p.number is None) or _is_digit(p)]
        short = any(_is_short(line, part) for line, part in zip(lines, parts, strict=True))
        return cls(
            quoted=quoted,
            counted=counted,
            lone=bool(traffic) and len(bytes_alone) >= _SINGLE_LINES and not any(len(p.data) > 1 for p in traffic),
            decimal=any(p.radix is Radix.DECIMAL for p in traffic),
            arrow=bool(stamped) and all(p.stamp.kind == "clock" and p.sign == _ARROW for p in stamped),
            brackets=any("][" in line for line in lines) and any("><" in line or _AWAITS in line for line in lines),
            led=(len(traffic) > 1 and all(p.led for p in traffic[:2])) or _counts_up(lines, traffic) or _counts_bytes(traffic),
            spelled=_is_spelled(traffic),
            padded=any(_SHORT_LIST.search(line) and _HEX_LIST.search(line) for line in lines),
            replies_bare=_leaves_replies(traffic),
            deaf=_is_deaf(traffic, roles),
            turned=_is_turned(traffic),
            asker=_asker(traffic),
            wrapped=_wrapped(lines, traffic),
            answer=_answer(lines, parts),
            prose=prose,
            fields=prose and has_fields(lines),
            cells=prose and has_cells(lines),
            short=short,
            lettered=short and not any(p.sign in _HEX_LETTERS and min(p.data) < _TWO_DIGITS for p in traffic),
            unpadded=sum(1 for line in lines if _ODD_DIGITS.fullmatch(line)) >= _UNPADDED_LINES,
            commented=prose and not traffic and not says([p for p in parts if not p.text.startswith("#")]),
        )

    def take(self, text: str) -> HexLine:
        """Take a line apart as this text is written."""
        if self.padded and (listed := _SHORT_LIST.search(text)) is not None:
            text = text[: listed.start()] + _DIGIT_ALONE.sub(r"0\g<0>", listed[0]) + text[listed.end() :]
        if self.answer and (came := _NAMED.search(text)) is not None and came["name"].lower() == self.answer:
            text = f"{text[: came.start()]}received: {came['bytes']}"
        line = take_apart(_QUOTED.sub("", text, 1) if self.quoted else text, self.decimal, self.led)
        if self.counted:
            line = _as_header(line)
        if self.lone and _is_digit(line):
            found = _DIGIT.fullmatch(line.text)
            assert found is not None  # asked just before
            role = role_of(_words(found["call"])) if found["call"] is not None else line.role
            data = bytes((int(found["digit"], 16),))
            line = line._replace(shape=Shape.TRAFFIC, data=data, role=role, radix=Radix.HEX)
        if self.short and line.shape is Shape.BROKEN and _SHORT.fullmatch(line.text) is not None:
            data = bytes(int(digit, 16) for digit in line.text.split())
            line = line._replace(shape=Shape.TRAFFIC, data=data, radix=Radix.EITHER)
        if self.spelled and line.data and (data := _spelled(line.data)):
            line = line._replace(data=data)
        if self.lettered and line.data and line.sign in _HEX_LETTERS:
            line = line._replace(data=bytes((int(line.sign, 16),)) + line.data, sign="")
        role = line.role
        if self.deaf or (self.arrow and not line.worded):
            role = Role.UNKNOWN
        elif self.replies_bare and line.shape is Shape.TRAFFIC and not line.marked:
            role = Role.REPLY
        elif self.brackets and line.sign.startswith("each"):
            role = Role.REQUEST if line.sign == "each[" else Role.REPLY
        elif self.asker and TO in line.sign:
            role = Role.REQUEST if line.sign.startswith(f"{self.asker}{TO}") else Role.REPLY
        elif self.turned:
            role = OTHER_SIDE[role]
        return line if role is line.role else line._replace(role=role)

    def notes(self, parts: list[HexLine]) -> Iterator[str]:
        """Say what was concluded, and what could not be."""
        radixes = {p.radix for p in parts if p.shape is Shape.TRAFFIC}
        if self.deaf:
            yield "every line has the same mark, as a listener's log does: the marks do not tell the sender"
        if self.turned:
            yield "a server writes this log: it receives requests, and what it sends are replies"
        if self.quoted:
            yield "lines of words begin with '>', too: it is read as a quotation, not as sent by the host"
        if self.arrow:
            yield "the '->' on every line is read as the sign between time and text: it does not tell the sender"
        if self.unpadded:
            yield "bytes are printed without gaps and without leading zeros: where one ends cannot be told, and none is read"
        if self.single or self.lone:
            yield "one byte a line: where a frame ends is not told"
        if self.decimal and (self.single or radixes <= {Radix.DECIMAL}):
            yield "the bytes are decimal numbers: some have three digits or a sign"
        elif self.decimal:
            yield "some lines are decimal, others hexadecimal: digits without a letter are read as decimal"
        elif radixes == {Radix.EITHER}:
            yield "nothing tells whether the bytes are hexadecimal or decimal: they are read as hexadecimal"
