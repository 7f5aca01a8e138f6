"""What passes between a suite and its guard: one request, one answer, over pipes, as MessagePack."""

from __future__ import annotations

from typing import IO

import msgspec

from analyzer.records import CanFrame, Chunk
from analyzer.system import sized
from conformance.gate.permissions import Allowance

_LIMIT = 64 << 20
#: A time that does not end.
NO_END_NS = 1 << 62
#: Exit status of a guard that has seen alone to it that all stands. A library of a driver can end it with 0 at any moment.
STANDS = 21


class Wire(msgspec.Struct, frozen=True, array_like=True):
    """An item as it passes the pipe: bytes, and on CAN the identifier and flags; `t_ns` of what was received."""

    data: bytes
    can_id: int | None = None
    extended: bool = False
    remote: bool = False
    error: bool = False
    fd: bool = False
    t_ns: int | None = None


class Drive(msgspec.Struct, frozen=True):
    """A drive that the guard looks after: what it has to know to stop it."""

    dialect: str
    model: str
    address: int


class Begin(msgspec.Struct, frozen=True, tag="begin"):
    """The first request: open the port.

    `allowance`: what may be sent, with a budget of which nothing is spent; `longest_run_ns` of motion without an end;
    `longest_silence_ns` of the suite while a drive may be moving: one that waits for a drive asks five times a second;
    `moving`: the drives may be moving already. Until `DriveFound` reads alone pass, and those to any address.
    """

    endpoint: str
    drives: tuple[Drive, ...]
    allowance: Allowance
    longest_run_ns: int = 30_000_000_000
    longest_silence_ns: int = 5_000_000_000
    moving: bool = False
    journal: str = ""
    cut_power: str = ""


class Send(msgspec.Struct, frozen=True, tag="send"):
    """Judge and write an item."""

    item: Wire


class Receive(msgspec.Struct, frozen=True, tag="receive"):
    """Wait for what comes next."""

    timeout_ns: int


class Speed(msgspec.Struct, frozen=True, tag="speed"):
    """Change the host's speed."""

    bits_per_second: int


class DriveFound(msgspec.Struct, frozen=True, tag="drive_found"):
    """The drive was found: from now on what was allowed passes, and nothing to others."""


class ReadState(msgspec.Struct, frozen=True, tag="read_state"):
    """Read where the drives stand, for the bounds that are counted from there."""


class Standing(msgspec.Struct, frozen=True, tag="standing"):
    """The suite has stopped a drive and has seen it stand."""


class AllPutBack(msgspec.Struct, frozen=True, tag="all_put_back"):
    """The suite has put all settings back."""


class End(msgspec.Struct, frozen=True, tag="end"):
    """The suite is done and has put back everything itself: stop what is not seen standing, close the port and end.

    `given_up`: all was tried already.
    """

    given_up: bool = False


class Done(msgspec.Struct, frozen=True, tag="done"):
    """It was done; `t_ns` on the line's clock. `moving`: a drive may be moving since, of which nothing was said."""

    t_ns: int = 0
    moving: bool = False


class Busy(msgspec.Struct, frozen=True, tag="busy"):
    """The answer comes later, within `seconds`: a motor is being stopped first."""

    seconds: float


class Got(msgspec.Struct, frozen=True, tag="got"):
    """What came, or nothing. `passed`: bytes that came until now and were not read."""

    item: Wire | None = None
    passed: int = 0


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """It was not done. `kind`: refused, lost, usage, not stopped, or stopped (the guard has stopped the motor by itself)."""

    kind: str
    text: str


Request = Begin | Send | Receive | Speed | DriveFound | ReadState | Standing | AllPutBack | End
Answer = Done | Got | Failed | Busy


def put(stream: IO[bytes], message: Request | Answer) -> None:
    """Write a message. Raises OSError where the other end has gone."""
    sized.put(stream, msgspec.msgpack.encode(message))


def take(stream: IO[bytes]) -> bytes:
    """Return the next message as bytes. Raises EOFError when the other end has gone."""
    data = sized.take(stream, _LIMIT)
    if not data:
        raise EOFError("the other end has gone")
    return bytes(data)


def wire(item: bytes | CanFrame | Chunk) -> Wire:
    """Return an item as it passes the pipe."""
    if isinstance(item, CanFrame):
        return Wire(item.data, item.id, item.extended, item.remote, item.error, item.fd, item.t_ns)
    if isinstance(item, Chunk):
        return Wire(item.data, t_ns=item.t_ns)
    return Wire(item)


def sendable(item: Wire, bus: str) -> bytes | CanFrame:
    """Return an item that is to be sent."""
    if item.can_id is None:
        return item.data
    return CanFrame(None, bus, item.can_id, item.data, extended=item.extended, remote=item.remote, error=item.error, fd=item.fd)


def received(item: Wire, bus: str) -> Chunk | CanFrame:
    """Return an item that has come."""
    if item.can_id is None:
        return Chunk(item.t_ns, bus, item.data)
    return CanFrame(
        item.t_ns, bus, item.can_id, item.data, extended=item.extended, remote=item.remote, error=item.error, fd=item.fd
    )
