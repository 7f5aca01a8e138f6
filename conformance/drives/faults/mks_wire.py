"""Faults of the wire side, the same in any dialect: checksums, times, lost and superfluous bytes.

Rules kept here:
- Nothing here knows a command or an MKS drive, so that all of it serves the Lingkong drives too: what a check is and where
  it stands is told by the dialect's link.
- On CAN a superfluous piece is a frame of its own, and nothing grows beyond eight bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Fault, Hooks, Outgoing
from conformance.drives.faults.mks_makers import (
    CAN,
    CAN_LONGEST,
    LINES,
    MODBUS,
    NATIVE,
    WIRES,
    Install,
    Said,
    body_of,
    said,
    said_anew,
)

_LATE_NS = 2_000_000_000
_PAUSE_NS = 40_000_000
_NOISE = bytes((0xFF, 0x00, 0x55))


def _last_check(drive: Drive, outgoing: Outgoing) -> bytes:
    return outgoing.data[len(body_of(drive, outgoing)) :]


def _checks(change: Callable[[bytes], bytes]) -> Install:
    """Change the last check of every reply."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        body = body_of(drive, outgoing)
        data = body + change(_last_check(drive, outgoing))
        fits = outgoing.can_id is None or len(data) <= CAN_LONGEST
        yield replace(outgoing, data=data) if fits else outgoing

    return said(say)


def _added(check: bytes, by: int) -> bytes:
    return bytes(((check[0] + by) & 0xFF,)) + check[1:]


def _whole(change: Callable[[bytes], bytes]) -> Install:
    """Change the bytes of every reply, checks and all."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        data = change(outgoing.data)
        fits = outgoing.can_id is None or len(data) <= CAN_LONGEST
        yield replace(outgoing, data=data) if fits else outgoing

    return said(say)


def _late(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    yield replace(outgoing, at_ns=outgoing.at_ns + _LATE_NS)


def _twice(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    yield outgoing
    yield outgoing


def _noisy(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    yield replace(outgoing, data=_NOISE)
    yield outgoing


def _halting(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    half = len(outgoing.data) // 2
    yield replace(outgoing, data=outgoing.data[:half])
    yield replace(outgoing, data=outgoing.data[half:], at_ns=outgoing.at_ns + _PAUSE_NS)


def _every(period: int, change: Said) -> Callable[[], Said]:
    """Return a maker of a change of every so many replies of a drive."""

    def make() -> Said:
        count = 0

        def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
            nonlocal count
            count += 1
            return (outgoing,) if count % period else change(drive, command, outgoing)

        return say

    return make


def _silent(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    return ()


def _flipped(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    middle = len(outgoing.data) // 2
    data = bytearray(outgoing.data)
    data[middle] ^= 0x08
    yield replace(outgoing, data=bytes(data))


def _echo(hooks: Hooks) -> None:
    """Repeat a request before its reply."""
    heard: list[Frame] = []

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        heard[:] = [frame]
        return wanted

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        if heard:
            yield replace(outgoing, data=heard.pop().data)
        yield outgoing

    hooks.accept.append(accept)
    hooks.reply.append(say)


def _only(verb: Verb, change: Said) -> Said:
    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        return change(drive, command, outgoing) if command.verb is verb else (outgoing,)

    return say


FAULTS: tuple[Fault, ...] = (
    Fault("checksum-wrong", WIRES, "every reply has a wrong checksum", "checksum", _checks(lambda c: _added(c, 0x5A))),
    Fault("checksum-off-by-one", WIRES, "the checksum is one too high", "checksum", _checks(lambda c: _added(c, 1))),
    Fault("checksum-missing", WIRES, "replies end without a checksum", "checksum", _checks(lambda c: b"")),
    Fault("checksum-doubled", WIRES, "the checksum stands twice", "checksum", _checks(lambda c: c + c)),
    Fault("checksum-zero", WIRES, "the checksum is always 0", "checksum", _checks(lambda c: bytes(len(c)))),
    Fault("checksum-inverted", WIRES, "the checksum is sent as its complement", "checksum",
          _checks(lambda c: bytes(b ^ 0xFF for b in c))),
    Fault("checksum-without-head", (NATIVE,), "the checksum leaves the head out", "checksum",
          _checks(lambda c: _added(c, -0xFB))),
    Fault("checksum-without-id", (CAN,), "the checksum leaves the ID out", "checksum",
          said(lambda drive, command, out: (replace(out, data=drive.dialect.link.completed(out.data[:-1], 0)),))),
    Fault("crc-high-byte-first", (MODBUS,), "the CRC is sent high byte first", "checksum", _checks(lambda c: c[::-1])),
    Fault("flaky-checksum", WIRES, "every fifth reply has a flipped bit", "checksum", said_anew(_every(5, _flipped))),
    Fault("late-reply", WIRES, "every reply comes two seconds late", "time", said(_late)),
    Fault("lost-reply", WIRES, "every third reply is not sent", "lost", said_anew(_every(3, _silent))),
    Fault("first-reply-only", WIRES, "every second reply is not sent", "lost", said_anew(_every(2, _silent))),
    Fault("doubled-reply", WIRES, "every reply is sent twice", "shape", said(_twice)),
    Fault("half-frame", WIRES, "of every reply only the first half is sent", "shape", _whole(lambda d: d[: len(d) // 2])),
    Fault("spurious-bytes", WIRES, "three bytes of noise come before every reply", "shape", said(_noisy)),
    Fault("trailing-byte", WIRES, "a zero byte comes behind every reply", "shape", _whole(lambda d: d + b"\0")),
    Fault("pause-in-frame", LINES, "every reply stops for 40 ms in its middle", "shape", said(_halting)),
    Fault("echo", WIRES, "the request is repeated before every reply", "shape", _echo),
)  # fmt: skip
