"""The places at which a quirk or a fault takes hold of an LK drive, and the small tools that they share.

Each function here makes an `install` for a `Quirk` or a `Fault` out of one function that changes one thing:

    on_reply(change)    the bytes of a reply        change(drive, command, frame) -> frame
    on_result(change)   the values of a reply       change(drive, command, asked, values) -> values or None
    on_field(name, change)   one field of replies   change(drive, value) -> value
    on_request(change)  the values of a request     change(drive, command, values) -> values
    on_asked(name, change)   one field of requests  change(value) -> value
    on_allow(change)    whether values are obeyed   change(command, values, wanted) -> bool
    on_store(change)    what is kept of a value     change(drive, name, value) -> (name, value) or None
    on_setup(change)    the drive itself: its acts, its motor, its commands
    on_act(name, make)  what one command does       make(act) -> act

`only` names the commands that are meant; none: all.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import TYPE_CHECKING, cast

import msgspec

from analyzer.catalogue import Command
from analyzer.protocols.lk_rs485 import DIALECT
from conformance.drives.drive import Drive, Hooks, Outgoing, Values
from conformance.drives.lk.commands import MOVES, Act, Request

if TYPE_CHECKING:
    from conformance.drives.lk.drive import LkDrive

Install = Callable[[Hooks], None]

#: Commands whose reply is what the host sent.
ECHOED = ("motor_off", "motor_on", "stop", "clear_turns", "set_position")
#: Commands that end at a position counted over all turns, at an angle within one, or at a distance.
MULTI_TURN = ("move_multi_turn", "move_multi_turn_limited")
SINGLE_TURN = ("move_single_turn", "move_single_turn_limited")
INCREMENTS = ("move_increment", "move_increment_limited")
LIMITED = ("move_multi_turn_limited", "move_single_turn_limited", "move_increment_limited")
PARAMETER_COMMANDS = ("read_parameter", "write_parameter")
STATE_2 = ("read_state_2", *MOVES)
STATE_1 = ("read_state_1", "clear_errors")


def lk(drive: Drive) -> LkDrive:
    """Return a drive as the LK drive that it is."""
    return cast("LkDrive", drive)


def _meant(command: Command, only: Collection[str]) -> bool:
    return not only or command.name in only


def on_reply(change: Callable[[LkDrive, Command, bytes], bytes], only: Collection[str] = ()) -> Install:
    """Change the bytes of replies."""

    def hook(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        if _meant(command, only):
            outgoing = msgspec.structs.replace(outgoing, data=change(lk(drive), command, outgoing.data))
        return (outgoing,)

    return lambda hooks: hooks.reply.append(hook)


def on_result(change: Callable[[LkDrive, Command, Values, Values], Values | None], only: Collection[str] = ()) -> Install:
    """Change the values of replies; silence stays silence."""

    def hook(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        if values is None or not _meant(command, only):
            return values
        return change(lk(drive), command, asked, dict(values))

    return lambda hooks: hooks.result.append(hook)


def on_field(name: str, change: Callable[[LkDrive, int], int], only: Collection[str] = ()) -> Install:
    """Change one field wherever a reply has it."""

    def result(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values:
        return values | {name: change(drive, values[name])} if name in values else values

    return on_result(result, only)


def on_request(change: Callable[[LkDrive, Command, Values], Values], only: Collection[str] = ()) -> Install:
    """Change the values of requests before the drive acts on them."""

    def hook(drive: Drive, command: Command, values: Values) -> Values:
        return change(lk(drive), command, dict(values)) if _meant(command, only) else values

    return lambda hooks: hooks.request.append(hook)


def on_asked(name: str, change: Callable[[int], int], only: Collection[str] = ()) -> Install:
    """Change one field wherever a request has it."""

    def request(drive: LkDrive, command: Command, values: Values) -> Values:
        return values | {name: change(values[name])} if name in values else values

    return on_request(request, only)


def on_allow(change: Callable[[Command, Values, bool], bool], only: Collection[str] = ()) -> Install:
    """Change which values are obeyed."""

    def hook(drive: Drive, command: Command, values: Values, wanted: bool) -> bool:
        return change(command, values, wanted) if _meant(command, only) else wanted

    return lambda hooks: hooks.allow.append(hook)


def on_store(change: Callable[[LkDrive, str, int], tuple[str, int] | None]) -> Install:
    """Change what is kept of a value."""
    return lambda hooks: hooks.stored.append(lambda drive, name, value: change(lk(drive), name, value))


def on_setup(change: Callable[[LkDrive], None]) -> Install:
    """Change the drive when it is made."""
    return lambda hooks: hooks.setup.append(lambda drive: change(lk(drive)))


def on_act(name: str, make: Callable[[Act], Act]) -> Install:
    """Change what a command does; `make` gets what it does by the manual."""

    def setup(drive: LkDrive) -> None:
        drive.acts[name] = make(drive.acts[name])

    return on_setup(setup)


def instead(act: Act) -> Callable[[Act], Act]:
    """Return a maker of an act that replaces the manual's."""
    return lambda old: act


def followed_by(act: Act) -> Callable[[Act], Act]:
    """Return a maker of an act that does the manual's, then another."""

    def make(old: Act) -> Act:
        def both(drive: LkDrive, request: Request) -> None:
            old(drive, request)
            act(drive, request)

        return both

    return make


def nothing(drive: LkDrive, request: Request) -> None:
    """Do nothing."""


def together(*installs: Install) -> Install:
    """Return an install that does several."""

    def install(hooks: Hooks) -> None:
        for each in installs:
            each(hooks)

    return install


# --- bytes and numbers --------------------------------------------------------------------------------------------


def reframed(frame: bytes, *, code: int | None = None, address: int | None = None, data: bytes | None = None) -> bytes:
    """Return a frame with another code, address or data and sums that fit."""
    link = DIALECT.link
    head = link.parse(frame)
    body = frame[head.start : head.stop] if data is None else data
    old = head.code or 0
    start = bytes((frame[0], old if code is None else code, head.address if address is None else address, len(body)))
    framed = link.completed(start)
    return link.completed(framed + body) if body else framed


def wrapped(value: int, bits: int) -> int:
    """Return what is left of a signed number in fewer bits."""
    half = 1 << (bits - 1)
    return (value + half) % (1 << bits) - half


def swapped(value: int, bits: int) -> int:
    """Return a signed number with its bytes in the other order."""
    raw = (value % (1 << bits)).to_bytes(bits // 8, "little")
    return int.from_bytes(raw, "big", signed=True)
