"""Shape: a reply has the head, address, code, length and checksum that the manual gives it, and a status of its list.

One claim for each command and each thing about its reply. What came is laid over what should have come (`conformance.
anatomy`), so a defect is named by the claim that is about it, and the others go on.

Rules kept here:
- All claims about one command judge one exchange where they run on one rig: a setting is written once, a motor moved
  once. A claim that runs again asks again.
- What a claim rests on and another one judges (an answer at all, the right length) makes it inconclusive.
- Values are judged here by what the manual allows a reply to hold, whatever they are about.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from analyzer.catalogue import Certainty, Command, Dialect, Form, Verb
from analyzer.codec import codec
from analyzer.layout import Field, Kind
from conformance.anatomy import COUNTS, Reading, Replies, heard, replies, templates
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.claims.requests import demands, plain_exchange
from conformance.claims.shape_parameters import parameters
from conformance.exchange import Exchange, hex_of

if TYPE_CHECKING:
    from conformance.probe import Probe
    from conformance.rig import Rig

Judge = Callable[["Probe", Exchange, Replies], None]

#: How long nothing may come unasked.
_LISTEN_NS = 5_000_000_000
#: Two replies of the quirk "second-reply" are so far apart at least; a doubled reply follows at once.
_APART_NS = 5_000_000
SECOND_REPLY, NO_CHECKSUM, OTHER_FIRMWARE = "second-reply", "no-checksum", "lk-firmware-235"
#: Commands of drives whose replies were seen to have a wrong sum now and then (quirk lk-off-sum).
_ERRING = frozenset({("lk-rs485", "move_multi_turn_limited")})
#: Settings as the drives know them: what a second reply was seen after.
_SETTING = ("set_", "write_user_id")
#: Errata that make a claim about a command less sure: what the claim is about -> command -> erratum.
_ERRATA: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "once": {"save_speed": ("mks-rs485-44",)},
    "echo": {"write_parameter": ("lk-rs485-36",), "set_position": ("lk-rs485-46",)},
    "values": {
        "brake": ("lk-rs485-25",),
        "read_state_1": ("lk-rs485-15",),
        "clear_errors": ("lk-rs485-15",),
        "read_version": ("mks-can-54",),
    },
    "reserved": {
        "read_parameter": ("lk-rs485-49",),
        "write_parameter": ("lk-rs485-49",),
        "read_version": ("mks-can-54",),
    },
}


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    for command in dialect.commands:
        if command.reply_forms:
            yield from _about(dialect, command)
    yield from parameters(dialect)
    yield _unasked(dialect)


def _about(dialect: Dialect, command: Command) -> Iterator[Claim]:
    make = _Maker(dialect, command)
    yield make("answered", "is answered", "silence, or bytes that are no reply to it", _answered)
    yield make("once", "is answered once", "a second reply that is no completion", _once, SECOND_REPLY)
    yield make("clean", "is answered by one frame, with nothing before, in or behind it", "stray bytes, or a pause", _clean)
    for name in make.parts:
        if name not in COUNTS:
            yield make(name, f"is answered with its {name}", f"another {name}", _part(name))
    size = "has a reply of the length that the manual prints"
    yield make("length", size, "a longer or shorter reply", _length, NO_CHECKSUM)
    for name in make.checks:
        yield make(_slug(name), f"has a reply whose {name} fits", f"a {name} that does not fit", _check(name), NO_CHECKSUM)
    fields = make.fields
    if any(f.kind is Kind.RESERVED for f in fields):
        yield make("reserved", "has a reply whose reserved bits are 0", "a reserved bit that is 1", _reserved, NO_CHECKSUM)
    status = command.replies.status
    if any(f.name == status and f.choices is not None for f in fields):
        listed = "is answered with a status of the manual's list"
        yield make("status", listed, "a status that is not listed", _status, NO_CHECKSUM)
    if any(_limited(f) and f.name != status for f in fields):
        ranged = "has a reply whose values are within their ranges"
        yield make("values", ranged, "a value beyond its range", _values, NO_CHECKSUM)
    for name in make.fixed:
        yield make(name, f"has a reply whose {name} is one that the manual prints", f"another {name}", _fixed(name))
    if make.echoed:
        same = "has a reply that repeats what was sent"
        yield make("echo", same, "other values than those sent", _echo(make.echoed), NO_CHECKSUM)


class _Maker:
    """Makes the claims about one command."""

    def __init__(self, dialect: Dialect, command: Command) -> None:
        self.dialect, self.command = dialect, command
        self._demands = demands(dialect, command)
        good = [f for f in command.reply_forms if f.name not in command.replies.failed_forms]
        self.fields = [field for form in good for _, field in form.layout]
        asked = {n: f for form in command.request_forms for n, f in form.layout.named.items()}
        told = [(n, f) for form in good for n, f in form.layout.named.items() if n in asked]
        self.echoed = tuple(dict.fromkeys(n for n, f in told if f == asked[n] or f.fixed is not None))
        #: Fields that make a reply one of a form, where there is no form without.
        every = [{n for n, f in form.layout.named.items() if f.fixed is not None} for form in command.reply_forms]
        self.fixed = sorted(set.intersection(*every))
        shaped = templates(dialect, command, 1, {})
        self.parts = list(dict.fromkeys(name for t in shaped for name, _, _ in t.parts))
        if dialect.link.kind == "can":
            self.parts.insert(0, "address")
        self.checks = list(dict.fromkeys(name for t in shaped for name in t.checks))

    def __call__(self, name: str, statement: str, refuted_by: str, judge: Judge, *quirks: str) -> Claim:
        command = self.command
        met = tuple(q for q in (*quirks, OTHER_FIRMWARE) if _concerns(q, self.dialect, command))

        def check(probe: Probe) -> None:
            exchange = _shared(probe, command)
            if exchange.silent and OTHER_FIRMWARE in met:
                probe.meets(OTHER_FIRMWARE)
                return
            with contextlib.suppress(_Met):
                judge(probe, exchange, replies(exchange, probe.dialect))

        # That a reply is one piece stands in no manual; that it is the reply's bytes and no others, in all.
        at_best = Certainty.LIKELY if name == "clean" else Certainty.CERTAIN
        return declare(
            self.dialect,
            Theme.SHAPE,
            f"{command.name}/{name}",
            f"{command.name} {statement}.",
            refuted_by,
            check,
            command=command,
            aspect=Aspect.SHAPE,
            errata=_ERRATA.get(name, {}).get(command.name, ()),
            at_best=at_best,
            quirks=met,
            **self._demands,
        )


def _concerns(quirk: str, dialect: Dialect, command: Command) -> bool:
    """Say whether a quirk is one of a dialect's and of a command."""
    if not known(dialect, quirk):
        return False
    if quirk == SECOND_REPLY:
        return command.name.startswith(_SETTING) and command.verb is not Verb.SET_ZERO
    return quirk != OTHER_FIRMWARE or command.verb in (Verb.READ_PARAMETER, Verb.WRITE_PARAMETER)


def _limited(field: Field) -> bool:
    """Say whether a reply's field can hold what the manual does not allow."""
    if field.kind is Kind.RESERVED or field.fixed is not None or not field.bit_width:
        return False
    narrow = field.low > field.wire_minimum or field.high < field.wire_maximum
    values = field.values if field.choices is None else frozenset(field.choice_names)
    return narrow or (values is not None and len(values) < 1 << field.bit_width)


def _slug(name: str) -> str:
    return name.lower().replace(" ", "_")


# --- one exchange for all claims about a command ----------------------------------------------------------------------


class _Kept:
    """An exchange, and the claims that have judged it."""

    def __init__(self, exchange: Exchange) -> None:
        self.exchange = exchange
        self.judged: set[str] = set()


_kept: WeakKeyDictionary[Rig, dict[str, _Kept]] = WeakKeyDictionary()


def _shared(probe: Probe, command: Command) -> Exchange:
    """Return the exchange that the claims about a command share on a rig; one that judges it again gets a new one."""
    exchanges = _kept.setdefault(probe.rig, {})
    kept = exchanges.get(command.name)
    if kept is None or probe.claim.id in kept.judged:
        kept = exchanges[command.name] = _Kept(plain_exchange(probe, command))
    else:
        probe.traffic.append(kept.exchange)
    kept.judged.add(probe.claim.id)
    return kept.exchange


# --- judging ----------------------------------------------------------------------------------------------------------


def _first(exchange: Exchange, found: Replies) -> Reading:
    """Return the reply. Raises Inconclusive where there is none, which another claim judges."""
    if found.first is None:
        raise Inconclusive(f"{_name(exchange)} was not answered by anything like a reply")
    return found.first


class _Met(Exception):
    """A quirk was met, and there is nothing more to judge."""


def _sized(probe: Probe, exchange: Exchange, found: Replies) -> Reading:
    """Return the reply where it has the right length.

    Raises Inconclusive where another claim judges, _Met where a known quirk of real drives is the reason.
    """
    reading = _first(exchange, found)
    if reading.lacks_check and NO_CHECKSUM in probe.claim.quirks:
        probe.meets(NO_CHECKSUM)
        raise _Met
    if not reading.length_fits:
        raise Inconclusive(f"the reply to {_name(exchange)} has a wrong length, so nothing more of it can be told")
    return reading


def _name(exchange: Exchange) -> str:
    assert exchange.command is not None  # `plain_exchange` asks for one
    return exchange.command.name


def _refuted(exchange: Exchange, what: str, expected: str, got: str) -> Refuted:
    return Refuted(f"{_name(exchange)}: {what}", expected=expected, got=got, exchange=exchange, key=what)


def _hex(data: bytes) -> str:
    return data.hex(" ").upper() or "nothing"


def _answered(probe: Probe, exchange: Exchange, found: Replies) -> None:
    if found.first is not None:
        return
    came = heard(exchange)
    what = "bytes that are no reply" if came else "no answer"
    shape = templates(probe.dialect, exchange.command, exchange.address, exchange.values)[-1]  # type: ignore[arg-type]  # asked
    raise _refuted(exchange, what, f"a reply such as {_hex(shape.frame)}", _hex(came))


def _status_of(reading: Reading) -> int | None:
    layout = reading.template.form.layout
    if not layout.fits(len(reading.own)):
        return None
    status: int | None = codec(layout).wire(reading.own).get("status")
    return status


def _once(probe: Probe, exchange: Exchange, found: Replies) -> None:
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
        raise _refuted(exchange, what, "one reply", f"reply {number}: {_hex(other.data)}")


def _is_second(exchange: Exchange, first: Reading, second: Reading) -> bool:
    """Say whether a setting was answered once more after a pause, as real drives were seen to do."""
    if first.data != second.data or len(exchange.answers) != 2:
        return False
    return exchange.answers[1].first_ns - exchange.answers[0].last_ns >= _APART_NS


def _clean(probe: Probe, exchange: Exchange, found: Replies) -> None:
    reading = _first(exchange, found)
    if found.strange:
        what = "bytes beside the reply"
        raise _refuted(exchange, what, f"{_hex(reading.data)} alone", _hex(heard(exchange)))
    sound = reading.fitting == reading.template.count
    if sound and not any(reading.data == answer.data for answer in exchange.answers):
        raise _refuted(exchange, "a pause within the reply", "a reply in one piece", " | ".join(exchange.lines()[1:]))


def _part(name: str) -> Judge:
    def judge(probe: Probe, exchange: Exchange, found: Replies) -> None:
        part = _first(exchange, found).part(name)
        if part is None:
            raise Inconclusive(f"the reply to {_name(exchange)} is of a form that has no {name}")
        if not part.ok:
            raise _refuted(exchange, f"another {name} in the reply", f"{name} {_hex(part.expected)}", _hex(part.got))

    return judge


def _length(probe: Probe, exchange: Exchange, found: Replies) -> None:
    reading = _first(exchange, found)
    if reading.lacks_check and NO_CHECKSUM in probe.claim.quirks:
        probe.meets(NO_CHECKSUM)
        return
    if reading.lacks_check:
        raise Inconclusive("the reply has no check at its end, which another claim judges")
    expected, got = len(reading.template.frame), len(reading.data)
    if expected != got:
        raise _refuted(exchange, "a reply of another length", f"{expected} bytes", f"{got} bytes: {_hex(reading.data)}")
    for part in reading.parts:
        if part.name in COUNTS and not part.ok:
            what = f"another {part.name} in the reply"
            raise _refuted(exchange, what, f"{part.name} {_hex(part.expected)}", _hex(part.got))


def _check(name: str) -> Judge:
    def judge(probe: Probe, exchange: Exchange, found: Replies) -> None:
        reading = _first(exchange, found)
        check = reading.check(name)
        if check is not None and check.ok:
            return
        if reading.lacks_check and name == reading.template.checks[-1]:
            if NO_CHECKSUM in probe.claim.quirks:
                probe.meets(NO_CHECKSUM)
                return
            raise _refuted(exchange, f"a reply without its {name}", f"a {name} at its end", _hex(reading.data))
        if check is None or not reading.length_fits:
            raise Inconclusive(f"the reply to {_name(exchange)} has a wrong length, so its {name} cannot be told")
        if _now_and_then(probe, exchange, name):
            raise Inconclusive(f"the {name} of {_name(exchange)} does not fit now and then, which another claim judges")
        expected, got = _hex(check.expected), f"{_hex(check.got)} in {_hex(reading.data)}"
        raise _refuted(exchange, f"a {name} that does not fit", f"{name} {expected}", got)

    return judge


def _now_and_then(probe: Probe, exchange: Exchange, name: str) -> bool:
    """Say whether a check fits when a command is asked again, that of drives which were seen to err now and then."""
    assert exchange.command is not None  # asked
    if (probe.dialect.name, exchange.command.name) not in _ERRING:
        return False
    again = [replies(plain_exchange(probe, exchange.command), probe.dialect).first for _ in range(2)]
    checks = [reading.check(name) for reading in again if reading is not None]
    return any(check is not None and check.ok for check in checks)


def _broken(exchange: Exchange, reading: Reading, wanted: Callable[[Form, str, str], bool]) -> None:
    """Raise Refuted for a value of a reply that breaks the manual and is wanted by (form, field, rule)."""
    form = reading.template.form
    if not codec(form.layout).matches(reading.own):
        return
    for violation in codec(form.layout).broken(reading.own):
        if wanted(form, violation.field, violation.rule):
            text = violation.text
            raise _refuted(exchange, f"a value that the manual does not allow ({violation.field})", text, _hex(reading.data))


def _reserved(probe: Probe, exchange: Exchange, found: Replies) -> None:
    _broken(exchange, _sized(probe, exchange, found), lambda form, field, rule: rule == "reserved_bits")


def _status(probe: Probe, exchange: Exchange, found: Replies) -> None:
    assert exchange.command is not None  # asked
    name = exchange.command.replies.status
    _broken(exchange, _sized(probe, exchange, found), lambda form, field, rule: field == name)


def _values(probe: Probe, exchange: Exchange, found: Replies) -> None:
    assert exchange.command is not None  # asked
    name = exchange.command.replies.status
    reading = _sized(probe, exchange, found)
    _broken(exchange, reading, lambda form, field, rule: field != name and rule != "reserved_bits")


def _fixed(name: str) -> Judge:
    def judge(probe: Probe, exchange: Exchange, found: Replies) -> None:
        reading = _sized(probe, exchange, found)
        assert exchange.command is not None  # asked
        forms = [f for f in exchange.command.reply_forms if f.layout.fits(len(reading.own))]
        if any(codec(f.layout).matches(reading.own) for f in forms):
            return
        listed = " or ".join(str(f.layout.named[name].fixed) for f in forms)
        got = codec(reading.template.form.layout).wire(reading.own)[name]
        raise _refuted(exchange, f"another {name} than is printed", f"{name} {listed}", f"{got} in {_hex(reading.data)}")

    return judge


def _echo(names: tuple[str, ...]) -> Judge:
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
                raise _refuted(exchange, "another value than was sent", sent, f"{got[name]} in {_hex(reading.data)}")

    return judge


# --- nothing comes unasked --------------------------------------------------------------------------------------------


def _unasked(dialect: Dialect) -> Claim:
    def check(probe: Probe) -> None:
        exchange = probe.listen(_LISTEN_NS)
        if not exchange.silent:
            raise Refuted(
                "the drive sends unasked", expected="silence", got=_hex(heard(exchange)), exchange=exchange
            )

    return declare(
        dialect,
        Theme.SHAPE,
        "unasked",
        "A drive that stands sends nothing that was not asked for.",
        "anything at all",
        check,
        section=_QUIET_SECTIONS.get(dialect.name, "4"),
    )


#: Where the manuals say that the drive answers the host.
_QUIET_SECTIONS: Mapping[str, str] = {"mks-modbus": "8", "mks-can": "3", "lk-rs485": "Single motor command"}
