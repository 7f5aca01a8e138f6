"""The interface of all links: the head and the checks of a frame, and the search for frames in a stream of bytes.

A `Link` delimits and checks the frames of a dialect, and reads their heads. It knows bytes and lengths, but no commands. A
`Slicer` is a link together with the data lengths of one dialect's codes.

`Slicer.look` returns the length of a complete frame whose check fits, 0 for none, `MORE` while that is open, and `TIE`
where two lengths check. It never raises, for any bytes.

Rules of every slicer:
- Later bytes never change an answer other than `MORE`, so the cuts between reads do not matter.
- The shortest length that checks is the answer. The following bytes can still favour another length
  (`Slicer.lengths`). Only lengths one byte apart are a `TIE`.

Bytes that check may still not be a frame: `analyzer.framer` decides.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol

from analyzer.layout import Layout

if TYPE_CHECKING:
    from analyzer.link.arrays import Bytes, Found

#: `Slicer.look`: a frame that may begin here is still arriving.
MORE = -1
#: `Slicer.look`: frames of two lengths begin here, one byte apart, and both check.
TIE = -2


def sum8(data: bytes) -> int:
    """Return the low byte of the sum of `data`."""
    return sum(data) & 0xFF


class Role(StrEnum):
    """Who sent a frame, and what for.

    `message`: a node that is no drive, told unasked, as a file describes it. `foreign`: such a node, and nothing describes it.
    """

    REQUEST = "request"
    REPLY = "reply"
    MESSAGE = "message"
    UNKNOWN = "unknown"
    FOREIGN = "foreign"


class FormShape(Protocol):
    """What a link has to know of a form of a command. `code` None: the command's own."""

    @property
    def code(self) -> int | None: ...
    @property
    def layout(self) -> Layout: ...


class Slots(Protocol):
    """How many slots a package has, and of how many bytes each."""

    @property
    def count(self) -> int: ...
    @property
    def size(self) -> int: ...


class CommandShape(Protocol):
    """What a link has to know of a command. The catalogue's commands have it."""

    @property
    def code(self) -> int: ...
    @property
    def function(self) -> int | None: ...
    @property
    def quantity(self) -> int: ...
    @property
    def slots(self) -> Slots | None: ...
    @property
    def request_forms(self) -> Sequence[FormShape]: ...
    @property
    def reply_forms(self) -> Sequence[FormShape]: ...


class Head(NamedTuple):
    """What a frame says of itself, before any command is known.

    `code` None: the frame does not carry it (a Modbus read reply, an exception). `start`, `stop`: the own data.
    """

    address: int
    role: Role
    code: int | None
    function: int | None
    start: int
    stop: int
    quantity: int | None = None
    exception: int | None = None


class Check(NamedTuple):
    """One check of a frame: where it stands, what it says and what it should say."""

    name: str
    start: int
    got: bytes
    expected: bytes

    @property
    def ok(self) -> bool:
        """Whether the check fits."""
        return self.got == self.expected


class Part(NamedTuple):
    """A stretch of a frame's head and what it is, for people."""

    start: int
    stop: int
    name: str
    text: str


class Candidate(NamedTuple):
    """A frame that could be read from `start` to `stop`, as far as its bytes are there.

    `judged_to`: behind the last byte that says what it is; later bytes change nothing. `address` None: it has not come, or no
    one drive is meant. `known`: its code is in the catalogue. `complete`: all its bytes are there; `fits`: and its checks are
    right. `code_at`: the last byte that tells the code. `data`: its own data, as far as they are there; `sizes`: how many
    bytes they can have, empty where that cannot be told yet. `misfit`: its length is none of its code.

    How much an incomplete or damaged one is worth: `first_only`: nothing but at the beginning of a sending; `weak`: nothing.
    `slot`: number of the slot of a package, from 1; 0: none.
    """

    start: int
    stop: int
    judged_to: int
    address: int | None
    function: int | None
    code: int
    code_at: int
    known: bool
    fits: bool
    complete: bool
    data: bytes = b""
    sizes: tuple[int, ...] = ()
    misfit: bool = False
    first_only: bool = False
    weak: bool = False
    slot: int = 0
    note: str = ""


class Candidates(NamedTuple):
    """All frames that could begin at one place. `open`: bytes to come can add one or change one."""

    found: tuple[Candidate, ...] = ()
    open: bool = False


#: Made once: most bytes begin nothing.
NO_CANDIDATES = Candidates()


class Finder(ABC):
    """Finds every request that could begin at an offset: of known or unknown code, complete or cut off, with any check.

    A slicer looks for real frames; a finder must not miss any bytes that a careless drive could take for a frame. A frame with
    the head of a reply counts as a request of its code.

    `longest`: bytes of the longest frame. `headless`: any byte can begin a frame, so that those of an unknown function only
    show by their check (`checked`).
    """

    longest = 64
    headless = False

    @abstractmethod
    def at(self, buffer: bytes, start: int, can_id: int | None = None) -> Candidates:
        """Return all candidates that begin at `start`."""

    def checked(self, buffer: bytes, start: int, stop: int) -> Iterator[Candidate]:
        """Yield the candidates of an unknown function that begin at `start`, end at `stop` or later, and check."""
        return iter(())


class Slicer(ABC):
    """Finds the frames of one dialect in a stream of bytes. One instance per port.

    `heads`: values of the first byte of a frame. `starts`: a regular expression for places where a frame may begin.
    `strong_head`: a frame begins with a byte that is rare elsewhere. `strong_check`: bytes that are no frame check so
    seldom (one in 65536) that a fitting check is believed against what follows. `longest`: bytes of the longest frame.
    """

    heads: bytes = bytes(range(256))
    starts: bytes = b"."
    strong_head = True
    strong_check = False
    longest = 64

    @abstractmethod
    def look(self, buffer: bytes, at: int, end: int, closed: bool) -> int:
        """Return the length of the frame at `at` whose check fits, 0 for none, `MORE` if bytes are wanting, or `TIE`.

        `end`: where the bytes end; `closed`: no more will follow.
        """

    @abstractmethod
    def lengths(self, buffer: bytes, at: int, end: int) -> list[int]:
        """Return all lengths at which a frame at `at` checks, in ascending order, then `MORE` if bytes are wanting."""

    def preferred(self, buffer: bytes, at: int, lengths: Sequence[int]) -> int:
        """Return which of several lengths that check an open request awaits, 0 if none does."""
        return 0

    def damaged(self, buffer: bytes, at: int, end: int) -> list[int]:
        """Return the lengths of known frames at `at` whose check alone is wrong, then `MORE` if bytes are wanting."""
        return []

    def foreign(self, buffer: bytes, at: int) -> bool:
        """Say whether what begins at `at` has the head of this dialect and a code that is not in the catalogue."""
        return False

    def whole(self, data: bytes) -> bool:
        """Say whether a burst is one frame, of any code and length: its head and its check fit."""
        return False

    def shortened(self, buffer: bytes, at: int, end: int) -> list[int]:
        """Return the lengths at which a package that lost zeros would check, in ascending order."""
        return []

    def scan(self, codes: Bytes) -> Found | None:
        """Return, by operations over arrays, where `look` finds a frame and of which length, in ascending order.

        A place that is unsure costs time and nothing else; a `TIE` must be. What bytes to come can change, less than `longest`
        before the end, is left out. None: frames can only be found one by one.
        """
        return None


def places_in(starts: re.Pattern[bytes], buffer: bytes, at: int, stop: int) -> Iterator[int]:
    """Yield the places from one to another where a frame may begin. `starts`: made of those of the slicers that count."""
    found = starts.search(buffer, at, stop)
    while found:
        place = found.start()
        yield place
        found = starts.search(buffer, place + 1, stop)


class Link(ABC):
    """How frames of a dialect are delimited and checked. Subclasses are immutable."""

    kind = "serial"
    #: Bytes at the beginning that, with the length, tell address and code; 0 where the bytes alone never do.
    deciding_bytes = 0
    #: The fewest data bytes of a CAN frame.
    shortest = 0
    #: Whether a frame has a check. Bytes without one are no evidence of a drive that speaks so.
    checked = True
    #: Whether the identifier alone says what a CAN frame is: these are messages that a file describes, of no drive.
    by_identifier = False
    #: Whether a frame tells its length, or the bus does.
    tells_length = False
    #: Why it finds no frame any more: it is of another package, and failed.
    left_out = ""

    @abstractmethod
    def slicer(self, commands: Sequence[CommandShape], expects: Callable[[int, int], int]) -> Slicer:
        """Return a slicer for `commands`.

        `expects(address, function)`: data bytes of the reply that an open request awaits, 0 for none.
        """

    def deciding(self, frame: bytes) -> int:
        """Return how many bytes at the beginning tell, with the length, what is asked, or what a reply can answer; 0: none do.

        Frames of one length and the same first three bytes have the same number.
        """
        return self.deciding_bytes

    def silence_ns(self, byte_ns: int) -> int:
        """Return the silence that ends a frame, for bytes of `byte_ns` on the line; 0 where only its bytes tell its end."""
        return 0

    @property
    def first_bytes(self) -> frozenset[int]:
        """The bytes that begin a frame; empty where any byte can."""
        return frozenset()

    def finder(self, commands: Sequence[CommandShape]) -> Finder:
        """Return what finds the candidates of `commands`."""
        return FrameFinder(self, commands) if self.kind == "can" else SlicerFinder(self, commands)

    def identifier(self, command: CommandShape, address: int) -> int | None:
        """Return the CAN identifier of a frame; None where the bus has none."""
        return None

    @abstractmethod
    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        """Return the head of a complete frame."""

    @abstractmethod
    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        """Return the checks of a complete frame, in the order in which they stand."""

    def claims(self, can_id: int) -> bool:
        """Say whether frames of an identifier are of this dialect, whatever their data."""
        return False

    def fits(self, frame: bytes, can_id: int | None = None) -> bool:
        """Say whether every check of a complete frame fits."""
        return all(check.ok for check in self.checks(frame, can_id))

    @abstractmethod
    def build(self, command: CommandShape, form: FormShape, address: int, data: bytes, role: Role) -> bytes:
        """Return the bytes of a frame; on CAN its data bytes."""

    @abstractmethod
    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        """Return what the bytes of the head are."""

    @abstractmethod
    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        """Return a frame that lacks its last check with that check added."""


def data_lengths(commands: Sequence[CommandShape], role: Role) -> dict[int, set[int]]:
    """Return the data lengths of each code for one role; an open-ended layout has none."""
    result: dict[int, set[int]] = {}
    for command in commands:
        for form in command.request_forms if role is Role.REQUEST else command.reply_forms:
            if not form.layout.open_ended:
                code = command.code if form.code is None else form.code
                result.setdefault(code, set()).add(form.layout.byte_length)
    return result


def request_sizes(commands: Sequence[CommandShape]) -> dict[int, tuple[int, ...]]:
    """Return the data lengths of the requests of each code, ascending; packages left out."""
    sizes = data_lengths(commands, Role.REQUEST)
    codes = {command.code for command in commands if command.slots is None}
    return {code: tuple(sorted(sizes.get(code, ()))) for code in codes}


class FrameFinder(Finder):
    """For links whose bus delimits the frames: the buffer is one frame."""

    def __init__(self, link: Link, commands: Sequence[CommandShape]) -> None:
        self._link = link
        self._codes = {(command.function, command.code) for command in commands}

    def at(self, buffer: bytes, start: int, can_id: int | None = None) -> Candidates:
        head = self._link.parse(buffer, can_id)
        checks = self._link.checks(buffer, can_id)
        # A check that stands where the head should end shows that the frame is cut off.
        complete = all(check.start >= head.start for check in checks)
        data = buffer[head.start : head.stop]
        known = (head.function, head.code) in self._codes
        candidate = Candidate(
            0, len(buffer), len(buffer), head.address, head.function, head.code or 0, max(0, head.start - 1), known,
            complete and all(check.ok for check in checks), complete, data, (len(data),), misfit=not complete,
        )  # fmt: skip
        return Candidates((candidate,))


class SlicerFinder(Finder):
    """For links that have no finder of their own: frames that check, and known ones whose check alone is wrong."""

    def __init__(self, link: Link, commands: Sequence[CommandShape]) -> None:
        self._link = link
        self._slicer = link.slicer(commands, lambda address, function: 0)
        self._codes = {(command.function, command.code) for command in commands}
        self.longest = self._slicer.longest

    def at(self, buffer: bytes, start: int, can_id: int | None = None) -> Candidates:
        slicer, end = self._slicer, len(buffer)
        if buffer[start] not in slicer.heads:
            return NO_CANDIDATES
        fitting = {n for n in slicer.lengths(buffer, start, end) if n > 0}
        lengths = fitting | {n for n in slicer.damaged(buffer, start, end) if n > 0}
        found = [self._candidate(buffer[start : start + n], start, n in fitting) for n in sorted(lengths)]
        if slicer.foreign(buffer, start):
            found.append(Candidate(start, end, end, None, None, -1, start, False, False, False))
        return Candidates(tuple(found), end - start < slicer.longest)

    def _candidate(self, frame: bytes, start: int, fits: bool) -> Candidate:
        head = self._link.parse(frame)
        code = -1 if head.code is None else head.code
        data = frame[head.start : head.stop]
        stop = start + len(frame)
        return Candidate(
            start, stop, stop, head.address, head.function, code, start + max(0, head.start - 1),
            (head.function, code) in self._codes, fits, True, data, (len(data),),
        )  # fmt: skip
