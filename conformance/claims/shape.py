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
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Subject, Verb
from analyzer.layout import Field, Kind
from conformance.claim import Aspect, Claim, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.claims.requests import demands, plain_exchange
from conformance.claims.shape_judges import (
    NO_CHECKSUM,
    OTHER_FIRMWARE,
    SECOND_REPLY,
    Judge,
    Met,
    check_judge,
    echo_judge,
    fixed_judge,
    judge_answered,
    judge_clean,
    judge_length,
    judge_once,
    judge_reserved,
    judge_status,
    judge_values,
    part_judge,
    shown,
)
from conformance.claims.shape_parameters import parameters
from conformance.talk.exchange import Exchange
from conformance.talk.reply_match import COUNTS, replies, templates

if TYPE_CHECKING:
    from conformance.talk.probe import Probe, Rig

#: How long nothing may come unasked.
_LISTEN_NS = 5_000_000_000
#: Settings as the drives know them: what a second reply was seen after.
_SETTING = ("set_", "write_user_id")
#: What a claim rests on that names more than one thing of a reply, by the end of its id.
_RESTS_ON: Mapping[str, tuple[Doubt, ...]] = {
    "once": (Doubt.REPLY_COUNT,),
    "echo": (Doubt.ECHO,),
    "values": (Doubt.REPLY_VALUES,),
    "reserved": (Doubt.RESERVED,),
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
    yield make("answered", "is answered", "silence, or bytes that are no reply to it", judge_answered)
    yield make("once", "is answered once", "a second reply that is no completion", judge_once, SECOND_REPLY)
    one = "is answered by one frame, with nothing before, in or behind it"
    yield make("clean", one, "stray bytes, or a pause", judge_clean)
    for name in make.parts:
        if name not in COUNTS:
            yield make(name, f"is answered with its {name}", f"another {name}", part_judge(name))
    size = "has a reply of the length that the manual prints"
    yield make("length", size, "a longer or shorter reply", judge_length, NO_CHECKSUM)
    for name in make.checks:
        yield make(_slug(name), f"has a reply whose {name} fits", f"a {name} that does not fit", check_judge(name), NO_CHECKSUM)
    fields = make.fields
    if any(f.kind is Kind.RESERVED for f in fields):
        yield make("reserved", "has a reply whose reserved bits are 0", "a reserved bit that is 1", judge_reserved, NO_CHECKSUM)
    status = command.replies.status
    if any(f.name == status and f.choices is not None for f in fields):
        listed = "is answered with a status of the manual's list"
        yield make("status", listed, "a status that is not listed", judge_status, NO_CHECKSUM)
    if any(_limited(f) and f.name != status for f in fields):
        ranged = "has a reply whose values are within their ranges"
        yield make("values", ranged, "a value beyond its range", judge_values, NO_CHECKSUM)
    for name in make.fixed:
        yield make(name, f"has a reply whose {name} is one that the manual prints", f"another {name}", fixed_judge(name))
    if make.echoed:
        same = "has a reply that repeats what was sent"
        yield make("echo", same, "other values than those sent", echo_judge(make.echoed), NO_CHECKSUM)


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
            with contextlib.suppress(Met):
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
            rests_on=_RESTS_ON.get(name, ()),
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


# --- nothing comes unasked --------------------------------------------------------------------------------------------


def _unasked(dialect: Dialect) -> Claim:
    def check(probe: Probe) -> None:
        exchange = probe.listen(_LISTEN_NS)
        if not exchange.silent:
            raise Refuted("the drive sends unasked", expected="silence", got=shown(exchange.received), exchange=exchange)

    return declare(
        dialect,
        Theme.SHAPE,
        "unasked",
        "A drive that stands sends nothing that was not asked for.",
        "anything at all",
        check,
        section=dialect.sections.get(Subject.SILENCE, dialect.commands[0].section),
    )
