"""How an MKS drive can misbehave with frames: which it takes and answers, and the bytes of its Modbus replies.

    hearing(whom), answering(whom)      which frames it takes and answers besides those of the manual
    slots(choose)                       which slots of a package it carries out
    of_functions(READS, change)         the bytes of Modbus replies

What it does with a frame that it takes stands in `mks_behaviour`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from msgspec.structs import replace

from analyzer.catalogue import Command, Role, Verb
from analyzer.decoder import Decoder, Slot
from analyzer.link import READS, WRITE_MANY
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Hooks, Outgoing
from conformance.drives.faults.mks_behaviour import mks
from conformance.drives.faults.places import (
    MODBUS,
    NATIVE,
    Change,
    answered,
    body_of,
    byte,
    frames,
    having,
    rebuilt,
    taken,
    together,
)
from conformance.drives.mks.core import MOTIONS, STOPS, MksCore
from conformance.drives.mks.settings import SETTINGS

# --- what it hears and answers ---------------------------------------------------------------------------------------

Whom = Callable[[MksCore, Message], bool]


def own(drive: MksCore, message: Message) -> bool:
    """Say whether a frame has the drive's own address."""
    return message.address == drive.address


def for_all(drive: MksCore, message: Message) -> bool:
    """Say whether a frame has the address of all drives, as packages have."""
    return message.address == drive.dialect.broadcast


def to_all(drive: MksCore, message: Message) -> bool:
    """Say whether a frame is a broadcast."""
    return for_all(drive, message) and not package(drive, message)


def stop_of_all(drive: MksCore, message: Message) -> bool:
    """Say whether a frame is a stop by broadcast."""
    stops = STOPS | {Verb.EMERGENCY_STOP}
    return to_all(drive, message) and message.command is not None and message.command.verb in stops


def read_of_all(drive: MksCore, message: Message) -> bool:
    """Say whether a frame is a read by broadcast."""
    return to_all(drive, message) and message.command is not None and message.command.all_risks == {"read"}


def to_group(drive: MksCore, message: Message) -> bool:
    """Say whether a frame has the address of the drive's group."""
    group = drive.settings.get("group_address")
    return message.address == group != drive.dialect.broadcast and not own(drive, message)


def low_byte_of_group(drive: MksCore, message: Message) -> bool:
    """Say whether the address of a frame is the low byte of the group's, and not the drive's own."""
    group = drive.settings.get("group_address", 0)
    return message.address == group & 0xFF and group > 0xFF and not own(drive, message)


def setting_of_group(drive: MksCore, message: Message) -> bool:
    """Say whether a frame is a setting of the group."""
    return to_group(drive, message) and message.command is not None and message.command.verb in SETTINGS


def grouped(drive: MksCore, message: Message) -> bool:
    """Say whether a frame has the drive's own address while it is in a group."""
    return own(drive, message) and bool(drive.settings["group_address"])


def stops(message: Message) -> bool:
    """Say whether a frame is one that stops the shaft."""
    return message.command is not None and message.command.verb in STOPS | {Verb.EMERGENCY_STOP}


def package(drive: MksCore, message: Message) -> bool:
    """Say whether a frame is a package."""
    return message.command is not None and message.command.slots is not None


def to_one(drive: MksCore, message: Message) -> bool:
    """Say whether a frame is for one drive, this or another."""
    return not (to_all(drive, message) or to_group(drive, message) or package(drive, message))


def is_setting(message: Message) -> bool:
    """Say whether a frame is one that sets something."""
    return message.command is not None and message.command.verb.value.startswith("set_")


def motion_of_another(drive: MksCore, message: Message) -> bool:
    """Say whether a frame is a motion of another drive."""
    return to_one(drive, message) and message.command is not None and message.command.verb in MOTIONS


def to_next(drive: MksCore, message: Message) -> bool:
    """Say whether a frame has the next higher address."""
    return message.address == drive.address + 1


def same_low_byte(drive: MksCore, message: Message) -> bool:
    """Say whether the address of a frame has the low byte of the drive's own."""
    return (message.address ^ drive.address) & 0xFF == 0


def of(whom: Whom, *verbs: Verb) -> Whom:
    """Return what says whether a frame so addressed is of one of these commands."""
    return lambda drive, message: whom(drive, message) and message.command is not None and message.command.verb in verbs


def hearing(whom: Whom) -> Change:
    """Take frames of these addresses too."""

    def judge(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        core = mks(drive)
        return wanted or (frame.checksum_ok and core.responder.understands(message) and whom(core, message))

    return taken(judge)


def deaf_to(whom: Whom) -> Change:
    """Do not take these frames."""
    return taken(lambda drive, frame, message, wanted: wanted and not whom(mks(drive), message))


def answering(whom: Whom) -> Change:
    """Answer these frames too."""
    return answered(lambda drive, message, wanted: wanted or whom(mks(drive), message))


def silent_to(whom: Whom) -> Change:
    """Do not answer these frames."""
    return answered(lambda drive, message, wanted: wanted and not whom(mks(drive), message))


def take_bad_checksum(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    """Take own frames with a wrong checksum."""
    core = mks(drive)
    return wanted or (not frame.checksum_ok and own(core, message) and core.responder.understands(message))


def take_bad_motion(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    """Take own motions with a wrong checksum."""
    moves = message.command is not None and message.command.verb in MOTIONS
    return wanted or (moves and take_bad_checksum(drive, frame, message, wanted))


def take_bad(*verbs: Verb) -> Change:
    """Take own frames of some commands with a wrong checksum, without an answer."""

    def judge(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        meant = message.command is not None and message.command.verb in verbs
        return wanted or (meant and take_bad_checksum(drive, frame, message, wanted))

    change = together(taken(judge), silent_to(lambda d, m: not m.frame.checksum_ok))
    return Change(change.install, tuple(d for d in change.dialects if d in having(verbs)))


def take_reply_head(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    """Take own frames with the head of a reply."""
    return wanted or (frame.checksum_ok and own(mks(drive), message) and frame.data[:1] == b"\xfb")


def take_bad_package(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    """Take packages with any checksum."""
    return wanted or package(mks(drive), message)


def take_short_package(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    """Take packages of any length."""
    return wanted or (package(mks(drive), message) and frame.checksum_ok)


def answer_unknown(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    """Answer a code that no command has with status 0."""
    asked = own(mks(drive), message) and message.role is not Role.REPLY and message.form is None
    if frame.checksum_ok and asked:
        can_id = frame.can.id if frame.can is not None else None
        code = frame.data[:1] if frame.can is not None else bytes((0xFB, drive.address, frame.data[2]))
        data = drive.dialect.link.completed(code + b"\0", can_id)
        command = message.command or drive.dialect.commands[0]
        mks(drive).send(command, Outgoing(drive.now_ns + mks(drive).reply_delay_ns, data, can_id))
    return wanted


def startle(hooks: Hooks) -> None:
    """Miss the frame after one with a wrong checksum."""
    deaf = False

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        nonlocal deaf
        was, deaf = deaf, not frame.checksum_ok
        return wanted and not was

    hooks.accept.append(accept)


def slots(choose: Callable[[int, list[Slot], list[Slot]], list[Slot]]) -> Change:
    """Choose which slots of a package are executed: `choose(address, slots, those of the manual)`."""
    return Change(lambda hooks: hooks.slots.append(lambda drive, every, wanted: choose(drive.address, every, wanted)), NATIVE)


def without(verb: Verb) -> Change:
    """Leave out the slots of a command."""
    return slots(lambda own, every, wanted: [s for s in wanted if s.command is None or s.command.verb is not verb])


def mine(address: int, every: list[Slot]) -> list[Slot]:
    """Return the slots of an address."""
    return [slot for slot in every if slot.address == address]


def behind_others(address: int, every: list[Slot], wanted: list[Slot]) -> list[Slot]:
    """Return the drive's own slots but for those that stand behind another own one."""
    before = (0, *(slot.address for slot in every))
    return [slot for last, slot in zip(before, every, strict=False) if slot.address == address != last]


def behind_mine(address: int, every: list[Slot], wanted: list[Slot]) -> list[Slot]:
    """Return the slot behind the drive's own one."""
    places = [n for n, slot in enumerate(every) if slot.address == address]
    return every[places[0] + 1 : places[0] + 2] if places else []


# --- Modbus ----------------------------------------------------------------------------------------------------------

WORD = 2
#: Where things stand in a body: function, then a register and a value or a quantity, or a byte count.
FUNCTION, REGISTER, VALUE, COUNT = 1, 2, 4, 2


def of_functions(functions: Iterable[int], change: Callable[[bytes], bytes], *, exceptions: bool = False) -> Change:
    """Change the bodies of replies to these functions; with `exceptions`, only those that are exceptions."""
    chosen = frozenset(functions)

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        body = body_of(drive, outgoing)
        fits = body[FUNCTION] & 0x7F in chosen and bool(body[FUNCTION] & 0x80) == exceptions
        yield rebuilt(drive, outgoing, change(body)) if fits else outgoing

    return Change(frames(say).install, MODBUS)


def refused(body: bytes) -> bool:
    """Say whether an echo refuses a write."""
    return body[VALUE:] == (b"\0\0" if body[FUNCTION] in WRITE_MANY else b"\xff\xff")


def done(change: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """Return a change of the echoes of writes that were done."""
    return lambda body: body if refused(body) else change(body)


def not_done(change: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """Return a change of the echoes of writes that were refused."""
    return lambda body: change(body) if refused(body) else body


def low_word_first(body: bytes) -> bytes:
    """Send numbers of several registers with the low register first."""
    data = body[COUNT + 1 :]
    words = [data[n : n + WORD] for n in range(0, len(data), WORD)]
    return body[: COUNT + 1] + b"".join(reversed(words))


def echo_write(hooks: Hooks) -> None:
    """Echo the whole request of a write of several registers."""
    heard: list[bytes] = []

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        heard[:] = [frame.data]
        return wanted

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        many = outgoing.data[FUNCTION] in WRITE_MANY
        yield replace(outgoing, data=heard[0]) if many and heard else outgoing

    hooks.accept.append(accept)
    hooks.reply.append(say)


def translated(change: Callable[[MksCore, bytes], bytes | None]) -> Change:
    """Take a request for another one: that of the body which `change` returns. None: for what it is."""

    def judge(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        core, link, body = mks(drive), drive.dialect.link, frame.data[:-2]
        other = change(core, body) if frame.checksum_ok and own(core, message) and len(body) > VALUE else None
        if other is None:
            return wanted
        asked = replace(frame, data=link.completed(other))
        request = core.responder.request(Decoder(drive.dialect).decode(asked)[0], True)
        if request is None:
            return wanted
        core.obey(request)
        return False

    return Change(taken(judge).install, MODBUS)


def as_04(drive: MksCore, body: bytes) -> bytes | None:
    """Take 03h for 04h."""
    return byte(FUNCTION, lambda _: 0x04)(body) if body[FUNCTION] == 0x03 else None


def own_quantity(drive: MksCore, body: bytes) -> bytes | None:
    """Take a read of any quantity for one of the register's own."""
    named = [c for c in drive.dialect.by_code.get(body[REGISTER] << 8 | body[REGISTER + 1], ()) if c.function == 0x04]
    if body[FUNCTION] != 0x04 or not named:
        return None
    return body[:VALUE] + named[0].quantity.to_bytes(WORD, "big")


def six_bytes(drive: MksCore, body: bytes) -> bytes | None:
    """Take six bytes for the home settings, as the standard would have it."""
    is_home = body[FUNCTION] == 0x10 and body[REGISTER:VALUE] == b"\x00\x90" and body[6:7] == b"\x06"
    return body[:6] + b"\x05" + body[7:11] + body[12:13] if is_home else None


def low_byte_register(drive: MksCore, body: bytes) -> bytes | None:
    """Look only at the low byte of a register."""
    return body[:REGISTER] + b"\0" + body[REGISTER + 1 :] if body[REGISTER] else None


def busy_while_turning(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    """Answer reads with exception 04 while the shaft turns."""
    body = body_of(drive, outgoing)
    busy = body[FUNCTION] in READS and mks(drive).motor.speed(drive.now_ns)
    yield rebuilt(drive, outgoing, bytes((body[0], body[FUNCTION] | 0x80, 4))) if busy else outgoing


def echo_at_end(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    """Tell the end of a move by a second echo."""
    yield outgoing
    if mks(drive).task is not None:
        yield replace(outgoing, at_ns=max(outgoing.at_ns, int(mks(drive).motor.settled)))
