"""Judging one reply for one thing: what each claim about the shape of a reply looks at.

A judge gets the probe, the exchange and what came laid over what should have come; it raises Refuted where its one thing is
wrong, Inconclusive where what it rests on is (another claim judges that), `Met` where a quirk of real drives explains it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from analyzer.catalogue import Form
from analyzer.codec import codec
from conformance.claim import Inconclusive, Refuted
from conformance.claims.known_quirks import known
from conformance.claims.requests import plain_exchange
from conformance.talk.exchange import Exchange, hex_of
from conformance.talk.reply_match import COUNTS, MatchedReply, Replies, replies, templates

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

Judge = Callable[["Probe", Exchange, Replies], None]

SECOND_REPLY, NO_CHECKSUM, OTHER_FIRMWARE = "second-reply", "no-checksum", "lk-firmware-235"
#: Two replies of the quirk "second-reply" are so far apart at least; a doubled reply follows at once.
_APART_NS = 5_000_000
#: The quirk of replies that have a wrong sum now and then, and the command whose replies were seen so.
_OFF_SUM, _ERRING = "lk-off-sum", "move_multi_turn_limited"


def _first(exchange: Exchange, found: Replies) -> MatchedReply:
    """Return the reply. Raises Inconclusive where there is none, which another claim judges."""
    if found.first is None:
        raise Inconclusive(f"{_name(exchange)} was not answered by anything like a reply")
    return found.first


class Met(Exception):
    """A quirk was met, and there is nothing more to judge."""


def _sized(probe: Probe, exchange: Exchange, found: Replies) -> MatchedReply:
    """Return the reply where it has the right length.

    Raises Inconclusive where another claim judges, Met where a known quirk of real drives is the reason.
    """
    reading = _first(exchange, found)
    if reading.lacks_check and NO_CHECKSUM in probe.claim.quirks:
        probe.meets(NO_CHECKSUM)
        raise Met
    if not reading.length_fits:
        raise Inconclusive(f"the reply to {_name(exchange)} has a wrong length, so nothing more of it can be told")
    return reading


def _name(exchange: Exchange) -> str:
    assert exchange.command is not None  # `plain_exchange` asks for one
    return exchange.command.name


def refuted(exchange: Exchange, what: str, expected: str, got: str) -> Refuted:
    """Return what says that a reply is wrong in one thing."""
    return Refuted(f"{_name(exchange)}: {what}", expected=expected, got=got, exchange=exchange, key=what)


def shown(data: bytes) -> str:
    """Return bytes for people."""
    return data.hex(" ").upper() or "nothing"


def judge_answered(probe: Probe, exchange: Exchange, found: Replies) -> None:
    """Refute a drive that answers nothing, or nothing like a reply."""
    if found.first is not None:
        return
    came = exchange.received
    what = "bytes that are no reply" if came else "no answer"
    shape = templates(probe.dialect, exchange.command, exchange.address, exchange.values)[-1]  # type: ignore[arg-type]  # asked
    raise refuted(exchange, what, f"a reply such as {shown(shape.frame)}", shown(came))


def _status_of(reading: MatchedReply) -> int | None:
    layout = reading.template.form.layout
    if not layout.fits(len(reading.own)):
        return None
    status: int | None = codec(layout).wire(reading.own).get("status")
    return status


def judge_once(probe: Probe, exchange: Exchange, found: Replies) -> None:
    """Refute a second reply that is no completion."""
    reading = _first(exchange, found)
    assert exchange.command is not None  # asked
    interim = exchange.command.replies.interim
    before = _status_of(reading)
    for number, other in enumerate(found.readings[1:], 2):
        status = _status_of(other)
        if before in interim and status not in interim:
            before = status
            continue
        if SECOND_REPLY in probe.claim.quirks and _is_second(exchange, reading, other):
            probe.meets(SECOND_REPLY)
            return
        what = "the same reply once more" if other.data == reading.data else "another reply"
        raise refuted(exchange, what, "one reply", f"reply {number}: {shown(other.data)}")


def _is_second(exchange: Exchange, first: MatchedReply, second: MatchedReply) -> bool:
    """Say whether a setting was answered once more after a pause, as real drives were seen to do."""
    if first.data != second.data or len(exchange.answers) != 2:
        return False
    return exchange.answers[1].first_ns - exchange.answers[0].last_ns >= _APART_NS


def judge_clean(probe: Probe, exchange: Exchange, found: Replies) -> None:
    """Refute bytes beside the reply, and a pause within it."""
    reading = _first(exchange, found)
    if found.leftover:
        what = "bytes beside the reply"
        raise refuted(exchange, what, f"{shown(reading.data)} alone", shown(exchange.received))
    sound = reading.fitting == reading.template.count
    if sound and not any(reading.data == answer.data for answer in exchange.answers):
        raise refuted(exchange, "a pause within the reply", "a reply in one piece", " | ".join(exchange.lines()[1:]))


def part_judge(name: str) -> Judge:
    """Return what refutes another part of the head than the expected one."""

    def judge(probe: Probe, exchange: Exchange, found: Replies) -> None:
        part = _first(exchange, found).part(name)
        if part is None:
            raise Inconclusive(f"the reply to {_name(exchange)} is of a form that has no {name}")
        if not part.ok:
            raise refuted(exchange, f"another {name} in the reply", f"{name} {shown(part.expected)}", shown(part.got))

    return judge


def judge_length(probe: Probe, exchange: Exchange, found: Replies) -> None:
    """Refute a reply of another length, and a head that counts wrongly."""
    reading = _first(exchange, found)
    if reading.lacks_check and NO_CHECKSUM in probe.claim.quirks:
        probe.meets(NO_CHECKSUM)
        return
    if reading.lacks_check:
        raise Inconclusive("the reply has no check at its end, which another claim judges")
    expected, got = len(reading.template.frame), len(reading.data)
    if expected != got:
        raise refuted(exchange, "a reply of another length", f"{expected} bytes", f"{got} bytes: {shown(reading.data)}")
    for part in reading.parts:
        if part.name in COUNTS and not part.ok:
            what = f"another {part.name} in the reply"
            raise refuted(exchange, what, f"{part.name} {shown(part.expected)}", shown(part.got))


def check_judge(name: str) -> Judge:
    """Return what refutes a check that does not fit, or is not there."""

    def judge(probe: Probe, exchange: Exchange, found: Replies) -> None:
        reading = _first(exchange, found)
        check = reading.check(name)
        if check is not None and check.ok:
            return
        if reading.lacks_check and name == reading.template.checks[-1]:
            if NO_CHECKSUM in probe.claim.quirks:
                probe.meets(NO_CHECKSUM)
                return
            raise refuted(exchange, f"a reply without its {name}", f"a {name} at its end", shown(reading.data))
        if check is None or not reading.length_fits:
            raise Inconclusive(f"the reply to {_name(exchange)} has a wrong length, so its {name} cannot be told")
        if _now_and_then(probe, exchange, name):
            raise Inconclusive(f"the {name} of {_name(exchange)} does not fit now and then, which another claim judges")
        expected, got = shown(check.expected), f"{shown(check.got)} in {shown(reading.data)}"
        raise refuted(exchange, f"a {name} that does not fit", f"{name} {expected}", got)

    return judge


def _now_and_then(probe: Probe, exchange: Exchange, name: str) -> bool:
    """Say whether a check fits when a command is asked again, that of drives which were seen to err now and then."""
    assert exchange.command is not None  # asked
    if exchange.command.name != _ERRING or not known(probe.dialect, _OFF_SUM):
        return False
    again = [replies(plain_exchange(probe, exchange.command), probe.dialect).first for _ in range(2)]
    checks = [reading.check(name) for reading in again if reading is not None]
    return any(check is not None and check.ok for check in checks)


def _broken(exchange: Exchange, reading: MatchedReply, wanted: Callable[[Form, str, str], bool]) -> None:
    """Raise Refuted for a value of a reply that breaks the manual and is wanted by (form, field, rule)."""
    form = reading.template.form
    if not codec(form.layout).matches(reading.own):
        return
    for violation in codec(form.layout).broken(reading.own):
        if wanted(form, violation.field, violation.rule):
            text = violation.text
            raise refuted(exchange, f"a value that the manual does not allow ({violation.field})", text, shown(reading.data))


def judge_reserved(probe: Probe, exchange: Exchange, found: Replies) -> None:
    """Refute a reserved bit that is 1."""
    _broken(exchange, _sized(probe, exchange, found), lambda form, field, rule: rule == "reserved_bits")


def judge_status(probe: Probe, exchange: Exchange, found: Replies) -> None:
    """Refute a status that is not listed."""
    assert exchange.command is not None  # asked
    name = exchange.command.replies.status
    _broken(exchange, _sized(probe, exchange, found), lambda form, field, rule: field == name)


def judge_values(probe: Probe, exchange: Exchange, found: Replies) -> None:
    """Refute a value that the manual does not allow."""
    assert exchange.command is not None  # asked
    name = exchange.command.replies.status
    reading = _sized(probe, exchange, found)
    _broken(exchange, reading, lambda form, field, rule: field != name and rule != "reserved_bits")


def fixed_judge(name: str) -> Judge:
    """Return what refutes a value that makes the reply none of the printed forms."""

    def judge(probe: Probe, exchange: Exchange, found: Replies) -> None:
        reading = _sized(probe, exchange, found)
        assert exchange.command is not None  # asked
        forms = [f for f in exchange.command.reply_forms if f.layout.fits(len(reading.own))]
        if any(codec(f.layout).matches(reading.own) for f in forms):
            return
        listed = " or ".join(str(f.layout.named[name].fixed) for f in forms)
        got = codec(reading.template.form.layout).wire(reading.own)[name]
        raise refuted(exchange, f"another {name} than is printed", f"{name} {listed}", f"{got} in {shown(reading.data)}")

    return judge


def echo_judge(names: tuple[str, ...]) -> Judge:
    """Return what refutes other values than those that were sent."""

    def judge(probe: Probe, exchange: Exchange, found: Replies) -> None:
        reading = _sized(probe, exchange, found)
        form = reading.template.form
        assert exchange.command is not None  # asked
        if form.name in exchange.command.replies.failed_forms and codec(form.layout).matches(reading.own):
            raise Inconclusive(f"{_name(exchange)} was refused, so there is no echo")
        got = codec(form.layout).wire(reading.own)
        for name in names:
            if name in got and name in exchange.values and got[name] != exchange.values[name]:
                sent = f"{name} {exchange.values[name]}, as in {hex_of(exchange.sent or b'')}"
                raise refuted(exchange, "another value than was sent", sent, f"{got[name]} in {shown(reading.data)}")

    return judge
