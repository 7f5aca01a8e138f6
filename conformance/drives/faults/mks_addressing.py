"""Faults of hearing: whom an MKS drive takes a frame from, whom it answers, and what it makes of a package."""

from __future__ import annotations

from collections.abc import Callable

from analyzer.catalogue import Role
from analyzer.decoder import Slot
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Fault, Hooks, Outgoing
from conformance.drives.faults.mks_makers import CAN, EVERY, MODBUS, NATIVE, TELLING, Install, accepted, replied, several
from conformance.drives.mks.core import MksCore


def _named(drive: MksCore, frame: Frame, message: Message) -> bool:
    """Say whether a frame is one that the drive would take from its host."""
    return frame.checksum_ok and drive.speaker.understands(message)


def _own(drive: MksCore, message: Message) -> bool:
    return message.address == drive.address


def _to_all(drive: MksCore, message: Message) -> bool:
    return message.address == drive.dialect.broadcast and not _package(message)


def _to_group(drive: MksCore, message: Message) -> bool:
    group = drive.settings.get("group_address")
    return message.address == group != drive.dialect.broadcast and not _own(drive, message)


def _package(message: Message) -> bool:
    return message.command is not None and message.command.slots is not None


def _strange(drive: MksCore, frame: Frame, message: Message) -> bool:
    """Say whether a frame names the drive and no command."""
    return frame.checksum_ok and _own(drive, message) and message.role is not Role.REPLY and message.form is None


def _utter(drive: MksCore, message: Message, body: bytes) -> None:
    """Send something that no command of the catalogue answers."""
    frame = message.frame
    can_id = frame.can.id if frame.can is not None else None
    command = message.command or drive.dialect.commands[0]
    data = drive.dialect.link.completed(body, can_id)
    drive.send(command, Outgoing(drive.now_ns + drive.reply_delay_ns, data, can_id))


def _answering_strangers(drive: MksCore, frame: Frame, message: Message, wanted: bool) -> bool:
    if _strange(drive, frame, message):
        code = frame.data[:1] if frame.can is not None else bytes((0xFB, drive.address, frame.data[2]))
        _utter(drive, message, code + b"\0")
    return wanted


def _slots(choose: Callable[[MksCore, list[Slot], list[Slot]], list[Slot]]) -> Install:
    """Choose otherwise which slots of a package are executed."""

    def install(hooks: Hooks) -> None:
        def chosen(drive: Drive, every: list[Slot], wanted: list[Slot]) -> list[Slot]:
            assert isinstance(drive, MksCore)
            return choose(drive, every, wanted)

        hooks.slots.append(chosen)

    return install


def _mine(drive: MksCore, slots: list[Slot]) -> list[Slot]:
    return [slot for slot in slots if slot.address == drive.address]


def _behind(drive: MksCore, slots: list[Slot], wanted: list[Slot]) -> list[Slot]:
    """Return the slot behind the drive's own one."""
    places = [n for n, slot in enumerate(slots) if slot.address == drive.address]
    return slots[places[0] + 1 : places[0] + 2] if places else []


def _any_length(drive: MksCore, frame: Frame, message: Message, wanted: bool) -> bool:
    return wanted or (_package(message) and frame.checksum_ok)


FAULTS: tuple[Fault, ...] = (
    # Checks and heads
    Fault("hears-bad-checksum", EVERY, "frames with a wrong checksum are executed and answered", "checksum",
          accepted(lambda d, f, m, w: w or (not f.checksum_ok and _own(d, m) and d.speaker.understands(m)))),
    Fault("executes-bad-checksum", EVERY, "frames with a wrong checksum are executed and not answered", "checksum",
          several(accepted(lambda d, f, m, w: w or (not f.checksum_ok and _own(d, m) and d.speaker.understands(m))),
                  replied(lambda d, m, w: w and m.frame.checksum_ok))),
    Fault("hears-reply-head", (NATIVE,), "frames with the head of a reply are taken for requests", "head",
          accepted(lambda d, f, m, w: w or (f.checksum_ok and _own(d, m) and f.data[:1] == b"\xfb"))),
    Fault("answers-unknown-code", TELLING, "unknown codes are answered with status 0", "unknown",
          accepted(_answering_strangers)),
    Fault("deaf-after-bad-frame", EVERY, "after a frame with a wrong checksum the next good one is not heard", "checksum",
          lambda hooks: hooks.accept.append(_startled())),
    # Addresses
    Fault("answers-another-address", EVERY, "requests to any address are executed and answered", "address",
          several(accepted(lambda d, f, m, w: w or _named(d, f, m)),
                  replied(lambda d, m, w: w or not (_to_all(d, m) or _to_group(d, m) or _package(m))))),
    Fault("executes-another-address", EVERY, "requests to any address are executed, without an answer", "address",
          accepted(lambda d, f, m, w: w or _named(d, f, m))),
    Fault("answers-next-address", EVERY, "requests to the next higher address are answered too", "address",
          several(accepted(lambda d, f, m, w: w or (_named(d, f, m) and m.address == d.address + 1)),
                  replied(lambda d, m, w: w or m.address == d.address + 1))),
    Fault("address-low-byte-only", (CAN,), "only the low byte of an ID is looked at", "address",
          several(accepted(lambda d, f, m, w: w or (_named(d, f, m) and (m.address ^ d.address) & 0xFF == 0)),
                  replied(lambda d, m, w: w or (m.address ^ d.address) & 0xFF == 0))),
    # Broadcast and groups
    Fault("answers-broadcast", EVERY, "broadcasts are answered", "broadcast",
          replied(lambda d, m, w: w or _to_all(d, m))),
    Fault("answers-broadcast-reads", EVERY, "reads by broadcast are answered", "broadcast",
          replied(lambda d, m, w: w or (_to_all(d, m) and m.command is not None and m.command.all_risks == {"read"}))),
    Fault("ignores-broadcast", EVERY, "broadcasts are not executed", "broadcast",
          accepted(lambda d, f, m, w: w and not _to_all(d, m))),
    Fault("answers-group", TELLING, "requests to the group address are answered", "group",
          replied(lambda d, m, w: w or _to_group(d, m))),
    Fault("ignores-group", TELLING, "requests to the group address are not executed", "group",
          accepted(lambda d, f, m, w: w and not _to_group(d, m))),
    Fault("group-replaces-address", TELLING, "a drive in a group no longer hears its own address", "group",
          accepted(lambda d, f, m, w: w and not (_own(d, m) and d.settings["group_address"]))),
    # Packages
    Fault("package-answered", (NATIVE,), "packages are answered", "package",
          replied(lambda d, m, w: w or _package(m))),
    Fault("package-ignored", (NATIVE,), "packages are not executed", "package",
          accepted(lambda d, f, m, w: w and not _package(m))),
    Fault("package-any-length", (NATIVE,), "packages shorter than 52 bytes are executed", "package",
          accepted(_any_length)),
    Fault("package-both-slots", (NATIVE,), "all slots for an address are executed", "package",
          _slots(lambda d, every, w: _mine(d, every))),
    Fault("package-last-slot", (NATIVE,), "of two slots for an address the last is executed", "package",
          _slots(lambda d, every, w: _mine(d, every)[-1:])),
    Fault("package-next-slot", (NATIVE,), "the slot behind the own one is executed", "package", _slots(_behind)),
    Fault("package-first-slot-only", (NATIVE,), "only the first slot is looked at", "package",
          _slots(lambda d, every, w: _mine(d, every[:1]))),
    Fault("package-every-slot", (NATIVE,), "the slots of all addresses are executed", "package",
          _slots(lambda d, every, w: every)),
    Fault("package-broadcast-slot", (NATIVE,), "a slot for address 0 is executed", "package",
          _slots(lambda d, every, w: w or [s for s in every if s.address == 0][:1])),
    # Modbus
    Fault("modbus-no-exceptions", (MODBUS,), "what calls for an exception is not answered", "exception",
          replied(lambda d, m, w: w and d.speaker.exception(m) is None)),
)  # fmt: skip


def _startled() -> Callable[[Drive, Frame, Message, bool], bool]:
    deaf = False

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        nonlocal deaf
        was, deaf = deaf, not frame.checksum_ok
        return wanted and not was

    return accept
