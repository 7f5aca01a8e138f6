"""Explanations: one frame, read by every dialect that it fits.

    text -> Given -> a reading for each dialect, with and without its check -> the best of them

Four facts rank a reading: the check fits, the command is in the manual, the data fit its layout, and the manual lists the
values. A frame counts as one without its check only if no dialect reads it with a fitting check. A frame is readable for
any of three reasons: its check fits, its command is in the manual and the layout fits, or only one dialect has its head.

Earlier traffic is not known here. A frame that may be a request or a reply stays `unknown` and has both readings, unless
`request` gives the request that it answers.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from analyzer.catalogue import Dialect, Role
from analyzer.context import Context, Request
from analyzer.decoder import Decoder
from analyzer.entries import Entry
from analyzer.errors import UnreadableError
from analyzer.findings import Issue, of_message
from analyzer.link import Check, Head, Link
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, Comment, Finding, Frame, Junk, Message
from analyzer.reference.hex_frame import CAN_DATA_LIMIT, LONGEST_TEXT, Given, read_frame, write_frame
from analyzer.values import CAN_ID_LIMIT

#: A frame told by its head alone has this many bytes at least.
_LEAST_BY_HEAD = 4


class _Extended(UnreadableError):
    """A frame that no drive here can have sent, which is sure."""


@dataclass(frozen=True)
class Explanation:
    """One frame as one dialect reads it.

    `sent`: the bytes as given (on CAN the data bytes); `message.frame.data`: the same with the checks that were missing.
    `checks`: as they stand in `message.frame.data`; `absent`: those that were not given. `right`: the frame with every
    check and length as they should be, None where a part of it is unknown. `readings`: both, where the role stays unknown.
    `sound_head`: the lengths and counts in the head are those of the command. `also`: dialects that read it equally well.
    `maybe_unchecked`: the check fits, but the data would fit a command if the frame had none (the last byte being data).
    """

    dialect: Dialect
    head: Head
    message: Message
    sent: bytes
    can_id: int | None
    checks: tuple[Check, ...]
    absent: tuple[Check, ...]
    issues: tuple[Issue, ...]
    right: bytes | None
    readings: tuple[Message, ...]
    sound_head: bool
    score: tuple[int, ...]
    also: tuple[str, ...] = ()
    maybe_unchecked: bool = False

    @property
    def checks_ok(self) -> bool:
        """Whether every check was given and fits."""
        return not self.absent and all(c.ok for c in self.checks)

    @property
    def data_start(self) -> int:
        """Where the command's own data begin."""
        form = self.message.form
        # What is read behind the data of its request begins before the frame.
        behind = form is not None and form.after_request
        return self.head.start if behind else self.head.stop - len(self.message.data)


class _Bytes(NamedTuple):
    """Bytes as one dialect may have them: whole, as given, and the checks that were added to make them whole."""

    dialect: Dialect
    data: bytes
    sent: bytes
    can_id: int | None
    absent: tuple[Check, ...]


class _Frames:
    """A sink that keeps the messages."""

    def __init__(self) -> None:
        self.messages: list[Message] = []

    def entry(self, entry: Entry) -> None:
        self.messages.append(entry.message)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        pass

    def finding(self, found: Finding) -> None:
        pass

    def comment(self, comment: Comment) -> None:
        pass


class Explainer:
    """Explains frames in the dialects given; keeps a decoder for each."""

    def __init__(self, dialects: Sequence[Dialect]) -> None:
        self._dialects = tuple(dialects)
        self._decoders = {d.name: Decoder(d) for d in dialects}
        self._slicers = {d.name: d.link.slicer(d.commands, lambda a, f: 0) for d in dialects if d.link.kind != "can"}

    def explain(
        self, given: Given, *, role: Role = Role.UNKNOWN, no_checksum: bool = False, request: Given | None = None
    ) -> Explanation:
        """Return the best reading of a frame.

        `role`: who sent it, where known; `no_checksum`: it has none; `request`: the request that it answers.
        Raises UnreadableError if no dialect reads it, with what each expected.
        """
        contexts = self._contexts(request)
        found: list[Explanation] = []
        if not no_checksum:
            found = [e for d in self._dialects for e in self._read(d, given, role, False, False, contexts)]
        unchecked: list[Explanation] = []
        if not any(e.score[0] and e.score[2] for e in found):
            unchecked = [e for d in self._dialects for e in self._read(d, given, role, True, no_checksum, contexts)]
        found += unchecked
        if not found:
            raise UnreadableError(self._why(given, role, no_checksum))
        # Between equals a head of its own says more than a first byte that may also be an identifier.
        best = max(found, key=lambda e: (e.score, self._begins(e.dialect, e.message.frame.data), not e.absent))
        also = dict.fromkeys(e.dialect.name for e in found if e.score == best.score and e.dialect is not best.dialect)
        doubt = bool(best.score[0] and any(e.score[2] for e in unchecked))
        return replace(best, also=tuple(also), maybe_unchecked=doubt)

    def apart(self, given: Given) -> list[Given]:
        """Return the sound frames that stand behind each other in some bytes; the bytes as they are if that is not all."""
        dialects = [d for d in self._dialects if d.name in self._slicers]
        if given.can_id is not None or not dialects:
            return [given]
        seen = _Frames()
        Pipeline(dialects, [seen], Options()).run([Chunk(None, "", given.data)])
        sound = [m.frame.data for m in seen.messages if m.frame.checksum_ok and m.form is not None]
        return [Given(data, None) for data in sound] if len(sound) > 1 and b"".join(sound) == given.data else [given]

    def each(
        self, given: Given, *, role: Role = Role.UNKNOWN, no_checksum: bool = False, request: Given | None = None
    ) -> Iterator[Explanation]:
        """Yield the best reading of each frame in some bytes. Raises UnreadableError."""
        asked = request
        for part in self.apart(given):
            found = self.explain(part, role=role, no_checksum=no_checksum, request=asked)
            # Of two frames the second may answer the first.
            asked = part if found.message.role is Role.REQUEST else asked
            yield found

    def text(
        self, text: str, *, role: Role = Role.UNKNOWN, no_checksum: bool = False, request: Given | None = None
    ) -> tuple[list[Explanation], list[str]]:
        """Return the best readings of the frames in a text, and notes on how it is written.

        A text that is no frame by itself is read as captures are: with times and marks, as decimal numbers, in a sentence.
        Raises UnreadableError.
        """
        try:
            return list(self.each(read_frame(text), role=role, no_checksum=no_checksum, request=request)), []
        except UnreadableError as error:
            if len(text) > LONGEST_TEXT:
                raise
            try:
                return self._pasted(text, role, no_checksum, request)
            except UnreadableError as other:
                raise (other if isinstance(other, _Extended) else error) from None

    def _pasted(self, text: str, role: Role, no_checksum: bool, request: Given | None) -> tuple[list[Explanation], list[str]]:
        # Only now: it brings all formats with it.
        from analyzer.sources import read_text

        pasted = read_text(text)
        found: list[Explanation] = []
        for record in pasted.traffic:
            if isinstance(record, CanFrame) and record.extended:
                raise _Extended(f"expected an identifier of 11 bits, got {record.id:08X}: no drive of these dialects")
            given = Given(record.data, record.id if isinstance(record, CanFrame) else None)
            who = record.direction if role is Role.UNKNOWN else role
            try:
                several = list(self.each(given, role=who, no_checksum=no_checksum, request=request))
            except UnreadableError:
                # A listener's mark, or an arrow that only points to the bytes: they tell it themselves.
                several = list(self.each(given, role=role, no_checksum=no_checksum, request=request))
            request = given if several[-1].message.role is Role.REQUEST else request
            found += several
        if not found:
            raise UnreadableError("no frame")
        return found, pasted.notes

    # --- readings -------------------------------------------------------------------------------------------------

    def _read(
        self, dialect: Dialect, given: Given, role: Role, absent: bool, stated: bool, contexts: dict[str, Context]
    ) -> Iterator[Explanation]:
        """Yield the readings of a dialect; `absent`: as a frame without its check; `stated`: the user says that."""
        for sent, can_id in _split(dialect.link, given):
            lacks = absent and dialect.link.checked
            candidates = _restored(dialect.link, sent, can_id) if lacks else ((sent, ()),)
            for data, lacking in candidates:
                if len(data) < _shortest(dialect.link, can_id):
                    continue
                frame = _Bytes(dialect, data, sent, can_id, lacking)
                found = self._explanation(frame, role, stated, contexts.get(dialect.name))
                if found is not None and self._believed(found, stated):
                    yield found

    def _explanation(self, frame: _Bytes, role: Role, stated: bool, context: Context | None) -> Explanation | None:
        dialect, data, sent, can_id, absent = frame
        link = dialect.link
        head = link.parse(data, can_id)
        if role is not Role.UNKNOWN and head.role not in (role, Role.UNKNOWN):
            return None
        checks = link.checks(data, can_id)
        if any(len(c.got) < len(c.expected) for c in checks):
            return None
        good = all(c.ok for c in checks)
        message = self._decode(dialect, data, can_id, role, good, context)
        right, odd = _right(dialect, message, head, can_id)
        # Where there is no check, code and length have to speak for a frame.
        fits = good and not absent and self._whole(dialect, data) and (link.checked or message.form is not None)
        issues = [*of_message(message, Context()), *odd]
        if absent and not stated:
            issues = [Issue("bad_checksum", f"{c.name}: expected {_hex(c.expected)}, got none") for c in absent] + issues
        readings: tuple[Message, ...] = (message,)
        if message.role is Role.UNKNOWN and message.command is not None:
            both = [self._decode(dialect, data, can_id, r, True, context) for r in (Role.REQUEST, Role.REPLY)]
            readings = tuple(m for m in both if m.form is not None) or readings
        own = message.command is not None and dialect.by_name.get(message.command.name) is message.command
        known = 2 if own else int(message.command is not None)
        score = (
            int(fits),
            known,
            int(message.form is not None),
            int(message.form is not None and not message.violations and not odd),
        )
        return Explanation(dialect, head, message, sent, can_id, checks, absent, tuple(issues), right, readings, not odd, score)

    def _decode(
        self, dialect: Dialect, data: bytes, can_id: int | None, role: Role, good: bool, context: Context | None
    ) -> Message:
        can = None if can_id is None else CanFrame(None, "", can_id, data)
        frame = Frame("", 0, 0, 0, data, dialect, role, good, can)
        return self._decoders[dialect.name].decode(frame, context)[0]

    def _whole(self, dialect: Dialect, data: bytes) -> bool:
        slicer = self._slicers.get(dialect.name)
        return slicer is None or slicer.whole(data)

    def _begins(self, dialect: Dialect, data: bytes) -> bool:
        """Say whether the first byte can begin a frame of this dialect and of few others."""
        slicer = self._slicers.get(dialect.name)
        if slicer is None or not slicer.strong_head:
            return False
        return re.match(slicer.starts, data, re.DOTALL) is not None

    def _believed(self, found: Explanation, stated: bool) -> bool:
        fits, known, form, valid = found.score
        present, strong = not found.absent, self._begins(found.dialect, found.message.frame.data)
        if not present and not stated and not (form and found.sound_head and (valid or strong)):
            return False
        if fits or (known == 2 and form):
            return True
        sure = len(self._dialects) == 1
        if sure and form and (present or stated):
            return True
        return (present or stated) and len(found.sent) >= _LEAST_BY_HEAD and strong

    # --- what was said before -------------------------------------------------------------------------------------

    def _contexts(self, request: Given | None) -> dict[str, Context]:
        """Return by dialect a context in which the request is open."""
        if request is None:
            return {}
        result: dict[str, Context] = {}
        for dialect in self._dialects:
            found = list(self._read(dialect, request, Role.REQUEST, False, False, {}))
            found = found or list(self._read(dialect, request, Role.REQUEST, True, False, {}))
            asked = [e.message for e in found if e.message.form is not None]
            if asked:
                context = Context()
                context.open[asked[0].address] = [Request.of(asked[0], 0, "")]
                result[dialect.name] = context
        if not result:
            raise UnreadableError(f"expected a request, got {write_frame(*request)}")
        return result

    # --- no reading -----------------------------------------------------------------------------------------------

    def _why(self, given: Given, role: Role, stated: bool) -> str:
        shown = write_frame(given.data[:16], given.can_id) + (" ..." if len(given.data) > 16 else "")
        reasons = [f"{d.name}: {self._reason(d, given, role, stated)}" for d in self._dialects]
        return "no frame: " + shown + "".join(f"\n  {r}" for r in reasons)

    def _reason(self, dialect: Dialect, given: Given, role: Role, stated: bool) -> str:
        link = dialect.link
        if link.kind == "can":
            whole = self._with_identifier(dialect, given)
            if whole:
                return f"these are the data of a frame without its identifier: {whole} would fit"
            if given.can_id is None and len(given.data) > CAN_DATA_LIMIT + 1:
                return f"expected an identifier and at most {CAN_DATA_LIMIT} bytes, got {len(given.data)} bytes"
            return self._reason_of_bytes(dialect, *next(_split(link, given), (b"", 0)), stated)
        if given.can_id is not None:
            return "a dialect of a serial bus, got a CAN frame"
        head = link.parse(given.data, None) if given.data else None
        if head is not None and role is not Role.UNKNOWN and head.role not in (role, Role.UNKNOWN):
            return f"expected a {role}, got a {head.role} by its head"
        slicer = self._slicers[dialect.name]
        if slicer.strong_head and re.match(slicer.starts, given.data, re.DOTALL) is None:
            return f"no frame begins with {_hex(given.data[:1])}"
        return self._reason_of_bytes(dialect, given.data, None, stated)

    def _with_identifier(self, dialect: Dialect, given: Given) -> str:
        """Return bytes with the identifier that makes their checksum fit, if they are a known frame then; else nothing."""
        if given.can_id is not None or not 2 <= len(given.data) <= CAN_DATA_LIMIT:
            return ""
        can_id = (given.data[-1] - sum(given.data[:-1])) & 0xFF
        found = self._explanation(_Bytes(dialect, given.data, given.data, can_id, ()), Role.UNKNOWN, False, None)
        good = found is not None and found.score[0] and found.score[2] and found.score[3]
        return write_frame(given.data, can_id, candump=True) if good else ""

    def _reason_of_bytes(self, dialect: Dialect, data: bytes, can_id: int | None, stated: bool) -> str:
        if len(data) < _shortest(dialect.link, can_id):
            return f"got {len(data)} bytes, which is too short"
        bad = [c for c in dialect.link.checks(data, can_id) if not c.ok]
        if stated or not bad:
            return "no command of this code and length"
        return f"{bad[0].name}: expected {_hex(bad[0].expected)}, got {_hex(bad[0].got)}, and no command fits"


def _split(link: Link, given: Given) -> Iterator[tuple[bytes, int | None]]:
    """Yield the bytes of a frame and its identifier as a link has them, if it can have them at all."""
    if link.kind != "can":
        if given.can_id is None and given.data:
            yield given.data, None
    elif given.can_id is not None:
        yield given.data, given.can_id
    elif min(2, 1 + link.shortest) <= len(given.data) <= CAN_DATA_LIMIT + 1:
        yield given.data[1:], given.data[0] & CAN_ID_LIMIT


def _shortest(link: Link, can_id: int | None) -> int:
    """Return the fewest bytes of a frame, on CAN of its data."""
    return 3 if can_id is None else link.shortest


def _restored(link: Link, body: bytes, can_id: int | None) -> Iterator[tuple[bytes, tuple[Check, ...]]]:
    """Yield the frames that bytes without a check can be, with the checks they lack: the last one, or every one."""
    if can_id is not None and len(body) >= CAN_DATA_LIMIT:
        return
    frame = link.completed(body, can_id)
    checks = link.checks(frame, can_id)
    yield frame, checks[-1:]
    inner = checks[:-1]
    if not inner:
        return
    for check in inner:
        body = link.completed(body[: check.start], can_id) + body[check.start :]
    if len(body) > inner[-1].start + len(inner[-1].got):
        body = link.completed(body, can_id)
    yield body, link.checks(body, can_id)


def _right(dialect: Dialect, message: Message, head: Head, can_id: int | None) -> tuple[bytes | None, list[Issue]]:
    """Return the frame as it should be, and what in its head is not so (lengths and counts)."""
    link, data, command = dialect.link, message.frame.data, message.command
    fixed = _with_checks(link, data, can_id)
    broken = {v.rule for v in message.violations}
    if "short_package" in broken or ("wrong_length" in broken and message.form is None):
        return None, []
    # What does not stand in the dialect's own table cannot be built by it.
    if message.form is None or command is None or dialect.by_name.get(command.name) is not command or command.slots is not None:
        return fixed, []
    if message.form not in (*command.request_forms, *command.reply_forms):
        return fixed, []
    role = Role.REQUEST if message.role is Role.UNKNOWN else message.role
    built = link.build(command, message.form, message.address, message.data, role)
    told = {v.field for v in message.violations}
    odd = []
    if len(built) != len(fixed):
        odd.append(Issue("wrong_length", f"expected {len(built)} bytes, got {len(fixed)}"))
    else:
        for part in link.parts(data, can_id):
            expected, got = built[part.start : part.stop], data[part.start : part.stop]
            if part.stop <= head.start and expected != got and part.name not in told:
                odd.append(Issue("wrong_length", f"{part.name}: expected {_hex(expected)}, got {_hex(got)}"))
    return built, odd


def _with_checks(link: Link, data: bytes, can_id: int | None) -> bytes:
    """Return a frame with each of its checks as it should be, the first ones first."""
    for index in range(len(link.checks(data, can_id))):
        check = link.checks(data, can_id)[index]
        data = data[: check.start] + check.expected + data[check.start + len(check.expected) :]
    return data


def _hex(data: bytes) -> str:
    return data.hex(" ").upper() or "none"
