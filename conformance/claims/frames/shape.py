"""Shape: a reply has the head, address, code, length and checksum that the manual gives it, and a status of its list.

There is one claim for each command and each property of its reply. `talk.reply_match` lays the reply over the expected one.
So the claim about the defect refutes it, and the others go on.

Rules kept here:
- All claims about one command judge one exchange where they run on one rig: a setting is written once, a motor moved
  once. A claim that runs again asks again.
- What a claim rests on and another one judges (an answer at all, the right length) makes it inconclusive.
- Values are judged here by what the manual allows a reply to hold, whatever they are about.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Form, Subject, Verb
from analyzer.codec import codec
from analyzer.layout import Field, FieldKind
from conformance.claim import Aspect, Inconclusive, Theme
from conformance.claims.control_reads import PAUSES_NS, around_silence, plain_read
from conformance.claims.declare import Case, Cases, claim, described_in
from conformance.claims.known_quirks import NO_CHECKSUM, known
from conformance.claims.known_reads import plain_reads
from conformance.claims.requests import demands, plain_exchange
from conformance.model.lk_parameters import OTHER_FIRMWARE
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.probe import Probe
from conformance.talk.reply_match import COUNTS, MatchedReply, Replies, replies, templates

SECOND_REPLY = "second-reply"
#: Settings as the drives know them: what a second reply was seen after.
_SETTING = ("set_", "write_user_id")
#: Two replies of the quirk "second-reply" are so far apart at least; a doubled reply follows at once.
_APART_NS = 5_000_000
#: How often a command is asked again whose reply is damaged.
_AGAIN = 2


# --- one exchange for all claims about a command ----------------------------------------------------------------------


class _Kept:
    """An exchange, and the claims that have judged it."""

    def __init__(self, exchange: Exchange) -> None:
        self.exchange = exchange
        self.judged: set[str] = set()


_kept: WeakKeyDictionary[Any, dict[str, _Kept]] = WeakKeyDictionary()


def _shared(probe: Probe, command: Command) -> Exchange:
    """Return the exchange that the claims about a command share on a rig; one that judges it again gets a new one."""
    exchanges = _kept.setdefault(probe.rig, {})
    kept = exchanges.get(command.name)
    if kept is None or probe.claim.id in kept.judged:
        exchange = plain_exchange(probe, command)
        # A line loses a request now and then.
        kept = exchanges[command.name] = _Kept(plain_exchange(probe, command) if exchange.unanswered else exchange)
    else:
        probe.traffic.append(kept.exchange)
    kept.judged.add(probe.claim.id)
    return kept.exchange


# --- what is judged ---------------------------------------------------------------------------------------------------


def _hex(data: bytes) -> str:
    return data.hex(" ").upper() or "nothing"


@dataclass(frozen=True)
class _Answer:
    """What came back to a plain request of a command, laid over what should have come."""

    probe: Probe
    command: Command
    exchange: Exchange
    found: Replies

    def expect(self, holds: bool, what: str, expected: str, got: str) -> None:
        """Refute the claim unless something holds; `what` is wrong with the reply otherwise."""
        self.probe.expect(
            got, holds=holds, expected=expected, refutes=f"{self.command.name}: {what}", exchange=self.exchange, key=what
        )

    @property
    def reply(self) -> MatchedReply:
        """The reply. Raises Inconclusive where there is none, which another claim judges."""
        if self.found.first is None:
            raise Inconclusive(f"{self.command.name} was not answered by anything like a reply")
        return self.found.first

    @property
    def whole(self) -> bool:
        """Whether each part of the reply fits, and nothing else came."""
        first = self.found.first
        return first is not None and first.fitting == first.template.count and not self.leftover

    @property
    def leftover(self) -> list[bytes]:
        """Bytes outside the replies, without the line's own noise around each reply."""
        noise = self.probe.noise
        of_line = (noise.stray, noise.trailing, noise.trailing + noise.stray)
        return [piece for piece in self.found.leftover if piece not in of_line]

    @property
    def meets_no_checksum(self) -> bool:
        """Whether the reply has no checksum, as real drives were seen to answer; then there is no more to judge."""
        met = self.reply.lacks_check and NO_CHECKSUM in self.probe.claim.quirks
        if met:
            self.probe.meets(NO_CHECKSUM)
        return met

    @property
    def sized(self) -> MatchedReply:
        """The reply where it has the right length. Raises Inconclusive where it has not."""
        if not self.reply.length_fits:
            raise Inconclusive(f"the reply to {self.command.name} has a wrong length, so nothing more of it can be told")
        return self.reply


def _undamaged(answer: _Answer) -> _Answer:
    """Return an answer, and where it is damaged one that is not: a line damages replies now and then.

    That is a fault of all replies, which a claim about the line judges once.
    """
    for _ in range(_AGAIN):
        if answer.whole or answer.found.first is None or answer.reply.lacks_check:
            break
        exchange = plain_exchange(answer.probe, answer.command)
        again = replace(answer, exchange=exchange, found=replies(exchange, answer.probe.dialect))
        if again.whole:
            return again
    return answer


def _good_fields(command: Command) -> list[Field]:
    good = [f for f in command.reply_forms if f.name not in command.replies.failed_forms]
    return [field for form in good for _, field in form.layout]


def _answered_commands(dialect: Dialect) -> Iterator[Case]:
    """Yield the commands that are answered."""
    for command in dialect.commands:
        if command.reply_forms:
            yield Case(dialect, command)


def _with_fields(wanted: Callable[[Command, Field], bool]) -> Cases:
    """Return the commands whose reply has a field that is wanted."""
    return lambda dialect: (
        case
        for case in _answered_commands(dialect)
        if case.command is not None and any(wanted(case.command, f) for f in _good_fields(case.command))
    )


def _concerns(quirk: str, dialect: Dialect, command: Command) -> bool:
    """Say whether a quirk is one of a dialect's and of a command."""
    if not known(dialect, quirk):
        return False
    if quirk == SECOND_REPLY:
        return command.name.startswith(_SETTING) and command.verb is not Verb.SET_ZERO
    return quirk != OTHER_FIRMWARE or command.verb in (Verb.READ_PARAMETER, Verb.WRITE_PARAMETER)


def _of_replies(
    refuted_by: str, *quirks: str, each: Cases = _answered_commands, **facts: Any
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a check of what came back to a plain request: `check(answer, ...)`."""

    def may_meet(case: Case) -> tuple[str, ...]:
        assert case.command is not None
        return tuple(q for q in (*quirks, OTHER_FIRMWARE) if _concerns(q, case.dialect, case.command))

    def needed(name: str) -> Callable[[Case], Any]:
        return lambda case: demands(case.dialect, case.command)[name] if case.command is not None else None

    def declared(check: Callable[..., None]) -> Callable[..., None]:
        def of_probe(probe: Probe, command: Command, part: str) -> None:
            exchange = _shared(probe, command)
            if exchange.silent and OTHER_FIRMWARE in probe.claim.quirks:
                probe.meets(OTHER_FIRMWARE)
                return
            answer = _undamaged(_Answer(probe, command, exchange, replies(exchange, probe.dialect)))
            check(answer, part) if part else check(answer)

        def cases(dialect: Dialect) -> Iterator[Case]:
            for case in each(dialect):
                yield Case(dialect, case.command, {"part": "", **case.given}, case.facts)

        of_probe.__name__, of_probe.__doc__, of_probe.__module__ = check.__name__, check.__doc__, check.__module__
        named = {name: needed(name) for name in ("risks", "settings", "alone", "by_name")}
        every = {"aspect": Aspect.SHAPE, "quirks": may_meet, "parameters": {}, **named, **facts}
        claim(Theme.SHAPE, each=cases, refuted_by=refuted_by, **every)(of_probe)
        return check

    return declared


# --- that there is a reply, and one -----------------------------------------------------------------------------------


@_of_replies("silence, or bytes that are no reply to it")
def _answered(answer: _Answer) -> None:
    """{command} is answered."""
    exchange, received = answer.exchange, answer.exchange.received
    assert exchange.address is not None  # asked by address
    shape = templates(answer.probe.dialect, answer.command, exchange.address, exchange.values)[-1]
    what = "bytes that are no reply" if received else "no answer"
    answer.expect(answer.found.first is not None, what, f"a reply such as {_hex(shape.frame)}", _hex(received))


def _status_of(reading: MatchedReply) -> int | None:
    layout = reading.template.form.layout
    if not layout.fits(len(reading.own)):
        return None
    status: int | None = codec(layout).wire(reading.own).get("status")
    return status


def _is_second(exchange: Exchange, first: MatchedReply, second: MatchedReply) -> bool:
    """Say whether a setting was answered once more after a pause, as real drives were seen to do."""
    if first.data != second.data or len(exchange.answers) != 2:
        return False
    return exchange.answers[1].first_ns - exchange.answers[0].last_ns >= _APART_NS


@_of_replies("a second reply that is no completion", SECOND_REPLY, rests_on=(Doubt.REPLY_COUNT,))
def _once(answer: _Answer) -> None:
    """{command} is answered once."""
    reply, interim = answer.reply, answer.command.replies.interim
    before = _status_of(reply)
    for number, other in enumerate(answer.found.readings[1:], 2):
        status = _status_of(other)
        if before in interim and status not in interim:
            before = status
            continue
        if SECOND_REPLY in answer.probe.claim.quirks and _is_second(answer.exchange, reply, other):
            answer.probe.meets(SECOND_REPLY)
            return
        what = "the same reply once more" if other.data == reply.data else "another reply"
        answer.expect(False, what, "one reply", f"reply {number}: {_hex(other.data)}")


@_of_replies("stray bytes", at_best=Certainty.LIKELY)
def _clean(answer: _Answer) -> None:
    """{command} is answered by one frame, with nothing before or behind it."""
    reply, exchange = answer.reply, answer.exchange
    expected = f"{_hex(reply.data)} alone"
    repeats = answer.probe.noise.repeats
    if repeats and answer.command is plain_read(answer.probe.dialect):
        # It is one fault, of the line or of the drive, and said once.
        answer.expect(False, "the end of each reply comes twice", expected, _hex(reply.data + reply.data[-repeats:]))
    answer.expect(not answer.leftover, "bytes beside the reply", expected, _hex(exchange.received))


# --- its head, length and checks --------------------------------------------------------------------------------------


def _parts(dialect: Dialect) -> Iterator[Case]:
    """Yield each command with each part of the head of its reply."""
    for case in _answered_commands(dialect):
        assert case.command is not None
        shaped = templates(dialect, case.command, 1, {})
        names = dict.fromkeys(name for t in shaped for name, _, _ in t.parts)
        for name in (*(("address",) if dialect.link.kind == "can" else ()), *names):
            if name not in COUNTS:
                yield Case(dialect, case.command, {"part": name})


@_of_replies("another {part}", each=_parts, name="{command}/{part}")
def _part(answer: _Answer, name: str) -> None:
    """{command} is answered with its {part}."""
    part = answer.reply.part(name)
    if part is None:
        raise Inconclusive(f"the reply to {answer.command.name} is of a form that has no {name}")
    answer.expect(part.ok, f"another {name} in the reply", f"{name} {_hex(part.expected)}", _hex(part.got))


@_of_replies("a longer or shorter reply", NO_CHECKSUM)
def _length(answer: _Answer) -> None:
    """{command} has a reply of the length that the manual prints."""
    if answer.meets_no_checksum:
        return
    reply = answer.reply
    if reply.lacks_check:
        raise Inconclusive("the reply has no check at its end, which another claim judges")
    expected, got = len(reply.template.frame), len(reply.data)
    answer.expect(expected == got, "a reply of another length", f"{expected} bytes", f"{got} bytes: {_hex(reply.data)}")
    for part in reply.parts:
        if part.name in COUNTS:
            what = f"another {part.name} in the reply"
            answer.expect(part.ok, what, f"{part.name} {_hex(part.expected)}", _hex(part.got))


def _checks(dialect: Dialect) -> Iterator[Case]:
    """Yield each command with each check of its reply."""
    for case in _answered_commands(dialect):
        assert case.command is not None
        for name in dict.fromkeys(name for t in templates(dialect, case.command, 1, {}) for name in t.checks):
            slug = name.lower().replace(" ", "_")
            yield Case(dialect, case.command, {"part": name}, {"name": f"{case.command.name}/{slug}"})


@_of_replies("a {part} that does not fit", NO_CHECKSUM, each=_checks)
def _check(answer: _Answer, name: str) -> None:
    """{command} has a reply whose {part} fits."""
    reply = answer.reply
    check = reply.check(name)
    if check is not None and check.ok:
        return
    if reply.lacks_check and name == reply.template.checks[-1]:
        if not answer.meets_no_checksum:
            answer.expect(False, f"a reply without its {name}", f"a {name} at its end", _hex(reply.data))
        return
    if check is None or not reply.length_fits:
        raise Inconclusive(f"the reply to {answer.command.name} has a wrong length, so its {name} cannot be told")
    expected, got = _hex(check.expected), f"{_hex(check.got)} in {_hex(reply.data)}"
    answer.expect(False, f"a {name} that does not fit", f"{name} {expected}", got)


# --- its values -------------------------------------------------------------------------------------------------------


def _expect_values(answer: _Answer, wanted: Callable[[str, str], bool]) -> None:
    """Refute a value of a reply that breaks the manual and is wanted by (field, rule)."""
    if answer.meets_no_checksum:
        return
    reply = answer.sized
    layout = codec(reply.template.form.layout)
    for violation in layout.broken(reply.own) if layout.matches(reply.own) else ():
        if wanted(violation.field, violation.rule):
            what = f"a value that the manual does not allow ({violation.field})"
            answer.expect(False, what, violation.text, _hex(reply.data))


def _limited(field: Field) -> bool:
    """Say whether a reply's field can hold what the manual does not allow."""
    if field.kind is FieldKind.RESERVED or field.fixed is not None or not field.bit_width:
        return False
    narrow = field.low > field.wire_minimum or field.high < field.wire_maximum
    values = field.values if field.choices is None else frozenset(field.choice_names)
    return narrow or (values is not None and len(values) < 1 << field.bit_width)


@_of_replies(
    "a reserved bit that is 1",
    NO_CHECKSUM,
    each=_with_fields(lambda command, field: field.kind is FieldKind.RESERVED),
    rests_on=(Doubt.RESERVED,),
)
def _reserved(answer: _Answer) -> None:
    """{command} has a reply whose reserved bits are 0."""
    _expect_values(answer, lambda field, rule: rule == "reserved_bits")


@_of_replies(
    "a status that is not listed",
    NO_CHECKSUM,
    each=_with_fields(lambda command, field: field.name == command.replies.status and field.choices is not None),
)
def _status(answer: _Answer) -> None:
    """{command} is answered with a status of the manual's list."""
    _expect_values(answer, lambda field, rule: field == answer.command.replies.status)


@_of_replies(
    "a value beyond its range",
    NO_CHECKSUM,
    each=_with_fields(lambda command, field: _limited(field) and field.name != command.replies.status),
    rests_on=(Doubt.VALUES,),
)
def _values(answer: _Answer) -> None:
    """{command} has a reply whose values are within their ranges."""
    status = answer.command.replies.status
    _expect_values(answer, lambda field, rule: field != status and rule != "reserved_bits")


def _fixed_fields(dialect: Dialect) -> Iterator[Case]:
    """Yield each command with each field that makes a reply one of a form, where there is no form without."""
    for case in _answered_commands(dialect):
        assert case.command is not None
        every = [{n for n, f in form.layout.named.items() if f.fixed is not None} for form in case.command.reply_forms]
        for name in sorted(set.intersection(*every)):
            yield Case(dialect, case.command, {"part": name})


@_of_replies("another {part}", each=_fixed_fields, name="{command}/{part}")
def _fixed(answer: _Answer, name: str) -> None:
    """{command} has a reply whose {part} is one that the manual prints."""
    if answer.meets_no_checksum:
        return
    reply = answer.sized
    forms = [f for f in answer.command.reply_forms if f.layout.fits(len(reply.own))]
    listed = " or ".join(str(f.layout.named[name].fixed) for f in forms)
    got = codec(reply.template.form.layout).wire(reply.own)[name]
    printed = any(codec(f.layout).matches(reply.own) for f in forms)
    answer.expect(printed, f"another {name} than is printed", f"{name} {listed}", f"{got} in {_hex(reply.data)}")


def _echoed(command: Command) -> set[str]:
    """Return the fields that a reply repeats as they were sent."""
    asked = {n: f for form in command.request_forms for n, f in form.layout.named.items()}
    good: list[Form] = [f for f in command.reply_forms if f.name not in command.replies.failed_forms]
    told = ((n, f) for form in good for n, f in form.layout.named.items() if n in asked)
    return {n for n, f in told if f == asked[n] or f.fixed is not None}


@_of_replies(
    "other values than those sent",
    NO_CHECKSUM,
    each=_with_fields(lambda command, field: field.name in _echoed(command)),
    rests_on=(Doubt.ECHO,),
)
def _echo(answer: _Answer) -> None:
    """{command} has a reply that repeats what was sent."""
    if answer.meets_no_checksum:
        return
    reply, exchange = answer.sized, answer.exchange
    form = reply.template.form
    if form.name in answer.command.replies.failed_forms and codec(form.layout).matches(reply.own):
        raise Inconclusive(f"{answer.command.name} was refused, so there is no echo")
    got = codec(form.layout).wire(reply.own)
    echoed = _echoed(answer.command)
    for name in (n for n in got if n in echoed and n in exchange.values):
        sent = f"{name} {exchange.values[name]}, as in {hex_of(exchange.sent or b'')}"
        same = got[name] == exchange.values[name]
        answer.expect(same, "another value than was sent", sent, f"{got[name]} in {_hex(reply.data)}")


# --- the line ---------------------------------------------------------------------------------------------------------


def _serial(dialect: Dialect) -> Iterator[Case]:
    if dialect.bus != "can":
        yield Case(dialect)


# That a reply is one piece stands in no manual.
@claim(Theme.SHAPE, each=_serial, refuted_by="a pause in a reply", at_best=Certainty.LIKELY, name="one-piece")
def _one_piece(probe: Probe) -> None:
    """Each reply to a read comes in one piece, without a pause that ends a frame."""
    broken = []
    for command in plain_reads(probe.dialect):
        exchange = probe.ask(command)
        found = replies(exchange, probe.dialect).first
        if (
            found is not None
            and found.fitting == found.template.count
            and not any(found.data == a.data for a in exchange.answers)
        ):
            broken.append((command.name, exchange))
    names = ", ".join(name for name, _ in broken)
    shown = broken[0][1] if broken else None
    lines = " | ".join(shown.lines()[1:]) if shown is not None else ""
    text = f"there is a pause in the replies to {len(broken)} reads ({names})"
    probe.expect(lines, holds=not broken, expected="replies in one piece", refutes=text, exchange=shown, key="pause in a reply")


# --- nothing comes unasked --------------------------------------------------------------------------------------------


@claim(Theme.SHAPE, refuted_by="anything at all", section=described_in(Subject.SILENCE))
def _unasked(probe: Probe) -> None:
    """A drive that stands sends nothing that was not asked for."""
    exchange, _ = probe.recorded(around_silence, PAUSES_NS[-1])
    got = _hex(exchange.received)
    probe.expect(got, holds=exchange.silent, expected="silence", refutes="the drive sends unasked", exchange=exchange)
