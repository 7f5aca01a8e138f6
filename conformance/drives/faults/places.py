"""Where a fault or a quirk takes hold of a drive. Each maker turns a small change into something that can be installed.

    reply("speed", negated, Verb.READ_SPEED)   a value of a reply
    asked("direction", exchanged(0, 1), F6)    a value of a request, before the drive acts on it
    limit("current", one_more)                 which values of a request are allowed
    stored("current", swap_bytes)              what a setting becomes when it is stored
    frames(change), bodies(change)             the bytes of a reply; `bodies` makes the last check fit again
    check(-1, added(1))                        one check of a reply
    taken(judge), answered(judge)              which frames the drive takes, and which of them it answers

Rules kept here:
- A change knows from the catalogue which dialects have what it touches. `faults` asks it.
- `of` names the commands that are meant; without it, all are.
- State that a change keeps belongs to one drive: it is made when the change is installed.
- Bytes are taken apart by the dialect's link. Nothing on CAN grows beyond eight bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

from msgspec.structs import replace

from analyzer.catalogue import Command, Dialect, Form, Verb
from analyzer.layout import Field, FieldKind
from analyzer.protocols import lk_rs485, mks_can, mks_modbus, mks_rs485
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Fault, Hooks, Outgoing, Values
from conformance.drives.faults.numbers import Judge, Number

DIALECTS = (mks_rs485.DIALECT, mks_modbus.DIALECT, mks_can.DIALECT, lk_rs485.DIALECT)
EVERY = tuple(dialect.name for dialect in DIALECTS)
NATIVE, MODBUS, CAN, LK = ((name,) for name in EVERY)
MKS = NATIVE + MODBUS + CAN
SERIAL = NATIVE + MODBUS
#: The dialects that have a reply for the end of a motion, and status bytes.
TELLING = NATIVE + CAN
#: The longest data of a CAN frame.
CAN_LONGEST = 8

Of = Verb | Collection[Verb]
Say = Callable[[Drive, Command, Outgoing], Iterable[Outgoing]]


@dataclass(frozen=True)
class Change:
    """Something wrong with a drive. `dialects`: those that have what it touches. To call it is to install it."""

    install: Callable[[Hooks], None]
    dialects: tuple[str, ...] = EVERY

    def __call__(self, hooks: Hooks) -> None:
        self.install(hooks)


class Row(NamedTuple):
    """One fault of a table. `dialects`: those it is for; none: LK where its name says so, else MKS."""

    name: str
    text: str
    change: Change
    dialects: tuple[str, ...] = ()


#: Tables of faults, by what they break.
Rows = Mapping[str, Iterable[Row]]


def faults(*tables: Rows) -> tuple[Fault, ...]:
    """Return the faults of tables, each in those of its dialects that have what it touches."""
    found = []
    for breaks, rows in (entry for table in tables for entry in table.items()):
        for name, text, change, dialects in rows:
            family = dialects or (LK if name.startswith("lk-") else MKS)
            found.append(Fault(name, tuple(d for d in family if d in change.dialects), text, breaks, change))
    return tuple(found)


def together(*changes: Change) -> Change:
    """Return a change that makes several."""

    def install(hooks: Hooks) -> None:
        for change in changes:
            change(hooks)

    return Change(install, tuple(d for d in EVERY if all(d in change.dialects for change in changes)))


# --- what the catalogue says -----------------------------------------------------------------------------------------


def _meant(of: Of) -> frozenset[Verb]:
    return frozenset({of}) if isinstance(of, Verb) else frozenset(of)


def having(of: Of) -> tuple[str, ...]:
    """Return the dialects that have one of these commands; without any, all."""
    verbs = _meant(of)
    return tuple(d.name for d in DIALECTS if not verbs or not verbs.isdisjoint(d.by_verb))


def keeping(*names: str) -> tuple[str, ...]:
    """Return the dialects whose requests have one of these fields. What no request has is the drive's own: all."""
    return tuple(d.name for d in DIALECTS if any(_requested(d, n) for n in names)) or EVERY


def _requested(dialect: Dialect, name: str) -> list[Field]:
    return [f for command in dialect.commands if (f := _field(command.request_forms, name)) is not None]


def _replied(dialect: Dialect, names: Collection[str]) -> bool:
    return any(_field(command.reply_forms, name) is not None for command in dialect.commands for name in names)


def _field(forms: Iterable[Form], name: str) -> Field | None:
    return next((form.layout.named[name] for form in forms if name in form.layout.named), None)


def signed(dialect: Dialect, name: str, of: Of) -> bool:
    """Say whether a field of replies has a sign."""
    verbs = _meant(of)
    forms = (form for command in dialect.commands if not verbs or command.verb in verbs for form in command.reply_forms)
    field = _field(forms, name)
    return field is not None and field.kind is FieldKind.INT


@cache
def _answered(verb: Verb, name: str) -> Field:
    """Return the field of a reply as the first dialect declares it that has it; Modbus has no statuses."""
    commands = (command for dialect in DIALECTS for command in dialect.commands if command.verb is verb)
    field = _field((form for command in commands for form in command.reply_forms), name)
    assert field is not None  # a drive answers with what some catalogue has
    return field


# --- values of replies and requests ----------------------------------------------------------------------------------


def result(change: Callable[[Drive, Command, Values, Values], Values | None], of: Of = ()) -> Change:
    """Change the values of replies by `change(drive, command, asked, values)`, or silence them."""
    verbs = _meant(of)

    def hook(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        if values is None or (verbs and command.verb not in verbs):
            return values
        return change(drive, command, asked, dict(values))

    return Change(lambda hooks: hooks.result.append(hook), having(of))


def reply(names: str | tuple[str, ...], change: Number, of: Of = ()) -> Change:
    """Change a number of replies, under any of its names."""
    fields = (names,) if isinstance(names, str) else names

    def apply(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
        for name in fields:
            if name in values:
                field = _field(command.reply_forms, name) or _answered(command.verb, name)
                values[name] = change(values[name], field)
        return values

    dialects = having(of) if of else tuple(d.name for d in DIALECTS if _replied(d, fields))
    return Change(result(apply, of).install, dialects)


def request(change: Callable[[Drive, Command, Values], Values], of: Of = ()) -> Change:
    """Change the values of requests before the drive acts on them."""
    verbs = _meant(of)

    def hook(drive: Drive, command: Command, values: Values) -> Values:
        return change(drive, command, dict(values)) if not verbs or command.verb in verbs else values

    return Change(lambda hooks: hooks.request.append(hook), having(of))


def asked(names: str | tuple[str, ...], change: Number, of: Of = ()) -> Change:
    """Change a number of requests before the drive acts on it."""
    fields = (names,) if isinstance(names, str) else names

    def apply(drive: Drive, command: Command, values: Values) -> Values:
        for name in fields:
            field = _field(command.request_forms, name)
            if name in values and field is not None:
                values[name] = change(values[name], field)
        return values

    return Change(request(apply, of).install, having(of) if of else keeping(*fields))


def limit(name: str, judge: Judge, beside: Mapping[str, int] | None = None) -> Change:
    """Judge the values of a field otherwise than the manual; what is accepted must be right in its other fields.

    `beside`: what other fields must be for that.
    """
    needed = dict(beside or {})

    def hook(drive: Drive, command: Command, values: Values, wanted: bool) -> bool:
        form = next((f for f in command.request_forms if f.layout.named.keys() == values.keys()), None)
        if form is None or name not in values or not judge.concerns(form.layout.named[name], values[name]):
            return wanted
        if not needed.items() <= values.items():
            return wanted
        others = all(field.allows(values[n]) for n, field in form.layout.named.items() if n != name)
        return judge.verdict and others

    def differs(dialect: Dialect) -> bool:
        has_others = all(_requested(dialect, other) for other in needed)
        return has_others and any(judge.differs(field) for field in _requested(dialect, name))

    return Change(lambda hooks: hooks.allow.append(hook), tuple(d.name for d in DIALECTS if differs(d)))


# --- storing ---------------------------------------------------------------------------------------------------------


def storing(change: Callable[[Drive, str, int], tuple[str, int] | None], *names: str) -> Change:
    """Store something else by `change(drive, name, value)`; None stores nothing. `names`: the settings it touches."""
    return Change(lambda hooks: hooks.stored.append(change), keeping(*names))


def stored(name: str, change: Number) -> Change:
    """Store another value of a setting."""

    def store(drive: Drive, setting: str, value: int) -> tuple[str, int]:
        return setting, change(value, _requested(drive.dialect, name)[0]) if setting == name else value

    return storing(store, name)


def unstored(*names: str) -> Change:
    """Do not store these settings."""
    return storing(lambda drive, name, value: None if name in names else (name, value), *names)


def stored_as(name: str, other: str) -> Change:
    """Store a setting under the name of another one."""
    return storing(lambda drive, setting, value: (other if setting == name else setting, value), name)


# --- bytes -----------------------------------------------------------------------------------------------------------


def frames(change: Say, of: Of = ()) -> Change:
    """Change, drop or add frames of replies."""
    return counted(lambda: change, of)


def counted(make: Callable[[], Say], of: Of = ()) -> Change:
    """Change frames by a function that keeps state, made for each drive."""
    verbs = _meant(of)

    def install(hooks: Hooks) -> None:
        change = make()
        hooks.reply.append(lambda d, command, o: change(d, command, o) if not verbs or command.verb in verbs else (o,))

    return Change(install, having(of))


def every(period: int, change: Say) -> Change:
    """Change every so many replies of a drive."""

    def make() -> Say:
        count = 0

        def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
            nonlocal count
            count += 1
            return (outgoing,) if count % period else change(drive, command, outgoing)

        return say

    return counted(make)


def _grown(outgoing: Outgoing, data: bytes) -> Outgoing:
    """Return a reply of other bytes, or the same one where CAN has no room for them."""
    return outgoing if outgoing.can_id is not None and len(data) > CAN_LONGEST else replace(outgoing, data=data)


def whole(change: Callable[[bytes], bytes], of: Of = ()) -> Change:
    """Change the bytes of replies, checks and all."""
    return frames(lambda drive, command, outgoing: (_grown(outgoing, change(outgoing.data)),), of)


def check(number: int, change: Callable[[bytes], bytes]) -> Change:
    """Change one check of every reply that has it: 0 is the first, -1 the last."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        data, checks = outgoing.data, drive.dialect.link.checks(outgoing.data, outgoing.can_id)
        if number < len(checks):
            start, stop = checks[number].start, checks[number].start + len(checks[number].expected)
            data = data[:start] + change(data[start:stop]) + data[stop:]
        yield _grown(outgoing, data)

    return frames(say)


def body_of(drive: Drive, outgoing: Outgoing) -> bytes:
    """Return a frame without its last check."""
    checks = drive.dialect.link.checks(outgoing.data, outgoing.can_id)
    return outgoing.data[: checks[-1].start]


def rebuilt(drive: Drive, outgoing: Outgoing, body: bytes) -> Outgoing:
    """Return a reply of another body, with the check that fits it."""
    return replace(outgoing, data=drive.dialect.link.completed(body, outgoing.can_id))


def bodies(change: Callable[[bytes], bytes], of: Of = ()) -> Change:
    """Change the bodies of replies and make the last check fit again."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        body = body_of(drive, outgoing)
        after = change(body)
        fits = outgoing.can_id is None or len(after) < CAN_LONGEST
        yield rebuilt(drive, outgoing, after) if after != body and fits else outgoing

    return frames(say, of)


def byte(place: int, change: Callable[[int], int]) -> Callable[[bytes], bytes]:
    """Return a change of one byte; a place below 0 counts from the end."""

    def apply(data: bytes) -> bytes:
        at = place if place >= 0 else len(data) + place
        return data[:at] + bytes((change(data[at]) & 0xFF,)) + data[at + 1 :] if 0 <= at < len(data) else data

    return apply


# --- which frames a drive takes and answers --------------------------------------------------------------------------


def taken(judge: Callable[[Drive, Frame, Message, bool], bool]) -> Change:
    """Judge otherwise which frames are for the drive; the last argument is what the manual says."""
    return Change(lambda hooks: hooks.accept.append(judge))


def answered(judge: Callable[[Drive, Message, bool], bool]) -> Change:
    """Judge otherwise which of the frames it takes the drive answers."""
    return Change(lambda hooks: hooks.answer.append(judge))
