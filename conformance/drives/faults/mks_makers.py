"""Makers of faults and quirks: each turns a small change into what `Fault.install` and `Quirk.install` are.

    changed(Verb.READ_SPEED, "speed", lambda v: -v)      a value of a reply
    given({Verb.RUN_SPEED}, "direction", lambda v: 1-v)  a value of a request, before the drive acts on it
    said(change)                                         the bytes of a reply
    wrapped(verbs, wrap)                                 what the drive does with a command
    ended(script)                                        how a move ends
    tuned(change)                                        an attribute of the drive

Rules kept here:
- State that a change keeps belongs to one drive: it is made when the change is installed.
- Bytes are taken apart by the dialect's link; a change that is to be seen through a good checksum gets a new one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.protocols import mks_shared
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Hooks, Outgoing, Values
from conformance.drives.mks.core import MOTIONS, Behaviour, Kind, MksCore, Script
from conformance.drives.mks.speaker import Order

Install = Callable[[Hooks], None]
#: (drive, command, reply) -> what is sent instead.
Said = Callable[[Drive, Command, Outgoing], Iterable[Outgoing]]

#: The moves to a position.
MOVES = MOTIONS - {Verb.RUN_SPEED}
NATIVE, MODBUS, CAN = "mks-rs485", "mks-modbus", "mks-can"
#: Those that tell the end of a motion.
TELLING = (NATIVE, CAN)
EVERY = (NATIVE, MODBUS, CAN)
SERIAL = (NATIVE, MODBUS)
#: What is on the wire of any drive.
WIRES = (NATIVE, MODBUS, CAN, "lk-rs485")
LINES = (NATIVE, MODBUS, "lk-rs485")
#: The longest data of a CAN frame.
CAN_LONGEST = 8


def mks(drive: Drive) -> MksCore:
    """Return a drive as the MKS drive that it is."""
    assert isinstance(drive, MksCore)
    return drive


def several(*installs: Install) -> Install:
    """Do all of these."""

    def install(hooks: Hooks) -> None:
        for each in installs:
            each(hooks)

    return install


# --- bytes ----------------------------------------------------------------------------------------------------------


def said(change: Said) -> Install:
    """Change the bytes of every reply."""
    return lambda hooks: hooks.reply.append(change)


def said_anew(make: Callable[[], Said]) -> Install:
    """Change the bytes of every reply by a function that keeps state, made for each drive."""
    return lambda hooks: hooks.reply.append(make())


def body_of(drive: Drive, outgoing: Outgoing) -> bytes:
    """Return a frame without its last check."""
    checks = drive.dialect.link.checks(outgoing.data, outgoing.can_id)
    return outgoing.data[: checks[-1].start]


def rebuilt(drive: Drive, outgoing: Outgoing, body: bytes) -> Outgoing:
    """Return a reply of another body, with the check that fits it."""
    return replace(outgoing, data=drive.dialect.link.completed(body, outgoing.can_id))


def bodies(change: Callable[[bytes], bytes], verbs: Collection[Verb] | None = None) -> Install:
    """Change the bodies of replies to these commands (None: of all), and make the checks fit again."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        body = body_of(drive, outgoing)
        after = body if verbs is not None and command.verb not in verbs else change(body)
        fits = outgoing.can_id is None or len(after) < CAN_LONGEST
        yield rebuilt(drive, outgoing, after) if after != body and fits else outgoing

    return said(say)


def byte(place: int, change: Callable[[int], int]) -> Callable[[bytes], bytes]:
    """Return a change of one byte of a body."""

    def apply(body: bytes) -> bytes:
        return body[:place] + bytes((change(body[place]) & 0xFF,)) + body[place + 1 :] if len(body) > place else body

    return apply


# --- values of replies and requests ---------------------------------------------------------------------------------


def answered(verbs: Collection[Verb] | None, change: Callable[[MksCore, Command, Values, Values], Values | None]) -> Install:
    """Change the values of replies to these commands (None: all), or silence them."""

    def result(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        if values is None or (verbs is not None and command.verb not in verbs):
            return values
        return change(mks(drive), command, asked, dict(values))

    return lambda hooks: hooks.result.append(result)


def changed(verbs: Verb | Collection[Verb], field: str, change: Callable[[int], int]) -> Install:
    """Change one value of the replies to these commands."""
    chosen = frozenset({verbs}) if isinstance(verbs, Verb) else frozenset(verbs)

    def apply(drive: MksCore, command: Command, asked: Values, values: Values) -> Values:
        return values | {field: change(values[field])} if field in values else values

    return answered(chosen, apply)


def frozen(verb: Verb, field: str, value: int) -> Install:
    """Answer a read with the same value always."""
    return changed(verb, field, lambda _: value)


def given(verbs: Collection[Verb], field: str, change: Callable[[int], int]) -> Install:
    """Change one value of requests of these commands, before the drive acts on them."""

    def request(drive: Drive, command: Command, values: Values) -> Values:
        return values | {field: change(values[field])} if command.verb in verbs and field in values else values

    return lambda hooks: hooks.request.append(request)


def allowed(field: str, judge: Callable[[int], bool | None], verbs: Collection[Verb] | None = None) -> Install:
    """Judge the values of a field otherwise; None: as the manual does."""

    def allow(drive: Drive, command: Command, values: Values, wanted: bool) -> bool:
        if field not in values or (verbs is not None and command.verb not in verbs):
            return wanted
        judged = judge(values[field])
        return wanted if judged is None else judged

    return lambda hooks: hooks.allow.append(allow)


def at_high(field: str, offset: int, verdict: bool) -> Install:
    """Judge the value at (or `offset` beyond) the upper limit that a setting has for the drive's model."""

    def allow(drive: Drive, command: Command, values: Values, wanted: bool) -> bool:
        return verdict if values.get(field) == mks(drive).fields[field].high + offset else wanted

    return lambda hooks: hooks.allow.append(allow)


def refusing(field: str, *values: int) -> Install:
    """Refuse values that the manual allows."""
    return allowed(field, lambda v: False if v in values else None)


def accepting(field: str, *values: int) -> Install:
    """Accept values that the manual does not allow."""
    return allowed(field, lambda v: True if v in values else None)


# --- storing --------------------------------------------------------------------------------------------------------


def stored(change: Callable[[str, int], tuple[str, int] | None]) -> Install:
    """Store something else; None: nothing."""
    return lambda hooks: hooks.stored.append(lambda drive, name, value: change(name, value))


def unstored(*names: str) -> Install:
    """Do not store these settings."""
    return stored(lambda name, value: None if name in names else (name, value))


def stored_as(field: str, other: str) -> Install:
    """Store a setting under the name of another one."""
    return stored(lambda name, value: (other, value) if name == field else (name, value))


# --- what the drive does --------------------------------------------------------------------------------------------


def tuned(change: Callable[[MksCore], None]) -> Install:
    """Change the drive itself, once."""
    return lambda hooks: hooks.setup.append(lambda drive: change(mks(drive)))


def heedless(name: str) -> Install:
    """Store a setting, and do as if it were not there."""
    return tuned(lambda drive: drive.heedless.add(name))


def forgetful(*names: str) -> Install:
    """Lose settings when the drive restarts."""
    return tuned(lambda drive: drive.forgetful.update(names))


def clinging(*names: str) -> Install:
    """Keep settings when the drive is restored."""
    return tuned(lambda drive: drive.clinging.update(names))


def wrapped(verbs: Collection[Verb], wrap: Callable[[Behaviour], Behaviour]) -> Install:
    """Put another behaviour round that of these commands."""

    def change(drive: MksCore) -> None:
        for verb in verbs:
            if verb in drive.behaviours:
                drive.behaviours[verb] = wrap(drive.behaviours[verb])

    return tuned(change)


def instead(verbs: Collection[Verb], behaviour: Behaviour) -> Install:
    """Do something else for these commands."""
    return wrapped(verbs, lambda _: behaviour)


def lying(verbs: Collection[Verb]) -> Install:
    """Say that it is done, and do nothing."""
    return instead(verbs, lambda drive, order: {"status": int(mks_shared.Success.SUCCESS)})


def ended(script: Callable[[MksCore, Order], Script], verbs: Collection[Verb] = MOVES) -> Install:
    """Let moves (or stops) that have begun go on by another script."""

    def wrap(behaviour: Behaviour) -> Behaviour:
        def act(drive: MksCore, order: Order) -> Values | None:
            answer = behaviour(drive, order)
            if drive.task is not None and drive.task.order is order:
                drive.begin(Kind.MOVE if order.command.verb in MOVES else Kind.STOP, script(drive, order), order)
            return answer

        return act

    return wrapped(verbs, wrap)


# --- whom it hears and answers --------------------------------------------------------------------------------------


def accepted(judge: Callable[[MksCore, Frame, Message, bool], bool]) -> Install:
    """Judge otherwise which frames are for the drive."""
    return lambda hooks: hooks.accept.append(lambda drive, frame, message, wanted: judge(mks(drive), frame, message, wanted))


def replied(judge: Callable[[MksCore, Message, bool], bool]) -> Install:
    """Judge otherwise which of the frames it takes the drive answers."""
    return lambda hooks: hooks.answer.append(lambda drive, message, wanted: judge(mks(drive), message, wanted))
