"""How a request of a walk reaches the drive, and frames that are not for it, or ask for nothing that there is.

    addressed(probe, command, values, way, group)   the request, sent in one of the ways to it
    aside(probe, number, group)                     a frame that changes nothing: no motion, no setting, no reply that is due
    spoiled(dialect, built, how)                    a request with a wrong check, or on CAN with another number of data bytes

A drive does the same in each of these ways. A frame that is not for it changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import TYPE_CHECKING

from analyzer.catalogue import Command, Dialect, MotionKind, Verb
from analyzer.encoder import Built
from conformance.claim import NotRun
from conformance.gate.gate import Item
from conformance.motion import declared

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: A code that no manual has; a speed that would be seen if a drive took the run of another one; the bit above a byte.
_UNKNOWN, _RPM, _ABOVE_BYTE = 0x99, 60, 0x100
#: Bytes of data that a CAN frame has beside its code and its check.
_CAN_DATA = 6


class Way(IntEnum):
    """How a request reaches the drive. In a package: in its first slot; numbers above it are those of later slots."""

    OWN = 0
    BROADCAST = 1
    GROUP = 2
    PACKAGE = 3


class Aside(IntEnum):
    """A frame that is not for the drive, or asks for nothing that there is."""

    OTHER_READ = 1
    OTHER_RUN = 2
    BROADCAST_READ = 3
    GROUP_READ = 4
    WRONG_CHECK = 5
    UNKNOWN_CODE = 6
    NEAR_GROUP_RUN = 7


def _package(dialect: Dialect) -> Command | None:
    return next((command for command in dialect.commands if command.slots is not None), None)


def ways(dialect: Dialect) -> tuple[Way, ...]:
    """Return the ways to a drive of a dialect."""
    found = [Way.OWN]
    found += [Way.BROADCAST] * (dialect.broadcast is not None)
    found += [Way.GROUP] * (Verb.SET_GROUP_ADDRESS in dialect.by_verb)
    return (*found, *[Way.PACKAGE] * (_package(dialect) is not None))


def slots(dialect: Dialect) -> int:
    """Return how many slots a package has, 0 where there is none."""
    package = _package(dialect)
    return 0 if package is None or package.slots is None else package.slots.count


def asides(dialect: Dialect) -> tuple[Aside, ...]:
    """Return the frames that a drive of a dialect has nothing to do with."""
    to_many = {Aside.BROADCAST_READ: Way.BROADCAST, Aside.GROUP_READ: Way.GROUP, Aside.NEAR_GROUP_RUN: Way.GROUP}
    known = ways(dialect)
    found = [each for each in Aside if each not in to_many or to_many[each] in known]
    return tuple(each for each in found if each is not Aside.UNKNOWN_CODE or _unknown(dialect))


def _unknown(dialect: Dialect) -> bool:
    return dialect.broadcast is not None and dialect.bus == "serial"


def _other(probe: Probe, group: int | None) -> int:
    """Return an address that is neither the drive's nor its group's."""
    last = probe.dialect.addresses[1] - 1
    return next(n for n in (probe.address % last + 1, (probe.address + 1) % last + 1) if n != group)


def _near(probe: Probe, group: int | None) -> int:
    """Return an address that differs from the group's in one bit: the one above a byte, where there is such."""
    if not group:
        raise NotRun("the drive is in no group")
    near = group ^ (_ABOVE_BYTE if probe.dialect.addresses[1] >= _ABOVE_BYTE else 1)
    if near == probe.address or not near:
        raise NotRun("there is no address beside the group's")
    return near


def _read(dialect: Dialect) -> Command:
    return dialect.by_verb[Verb.READ_POSITION]


def addressed(probe: Probe, command: Command, values: Mapping[str, int], way: int, group: int | None) -> Built:
    """Return a request in one of the ways to the drive. Raises NotRun where there is none."""
    dialect = probe.dialect
    if way >= Way.PACKAGE:
        package = _package(dialect)
        assert package is not None
        assert package.slots is not None
        if max(form.layout.byte_length for form in command.request_forms) > package.slots.size - 2:
            raise NotRun("it is longer than a slot")
        others = [{"address": _other(probe, group), "command": _read(dialect).name}] * (way - Way.PACKAGE)
        return probe.build(package, {"slots": [*others, {"address": probe.address, "command": command.name, **values}]})
    return probe.build(command, values, address=_to(probe, way, group))


def _to(probe: Probe, way: int, group: int | None) -> int:
    if way == Way.BROADCAST:
        assert probe.dialect.broadcast is not None  # `ways` has it
        return probe.dialect.broadcast
    if way == Way.GROUP:
        if not group:
            raise NotRun("the drive is in no group")
        return group
    return probe.address


def aside(probe: Probe, number: int, group: int | None) -> Item:
    """Return a frame that changes nothing. Raises NotRun where there is none."""
    dialect = probe.dialect
    read = _read(dialect)
    if number == Aside.OTHER_READ:
        return probe.build(read, address=_other(probe, group)).item()
    if number in (Aside.OTHER_RUN, Aside.NEAR_GROUP_RUN):
        run = dialect.motions(MotionKind.RUN)[0]
        to = _other(probe, group) if number == Aside.OTHER_RUN else _near(probe, group)
        return probe.build(run, declared.values_of(dialect, run, rpm=_RPM), address=to).item()
    if number in (Aside.BROADCAST_READ, Aside.GROUP_READ):
        way = Way.BROADCAST if number == Aside.BROADCAST_READ else Way.GROUP
        return probe.build(read, address=_to(probe, way, group)).item()
    built = probe.build(read)
    if number == Aside.WRONG_CHECK:
        return spoiled(dialect, built, WRONG_CHECK)
    # One code behind the head and the address, or a register behind the function.
    code = bytes((0x00, _UNKNOWN, 0x00, 0x01)) if read.function else bytes((_UNKNOWN,))
    return dialect.link.completed(built.frame[:2] + code)


#: How a request is spoiled: by a wrong check, or none; numbers from the last on stand for the number of its data bytes.
WRONG_CHECK, _NO_CHECK, _OF_LENGTH = 1, 2, 3


def lengths(dialect: Dialect, command: Command) -> tuple[int, ...]:
    """Return what gives a request another length, as `spoiled` takes it. On a line the next frame would end it."""
    own = command.request_forms[0].layout.byte_length
    others = (_OF_LENGTH + n for n in range(_CAN_DATA + 1) if n != own)
    return (_NO_CHECK, *others) if dialect.bus == "can" else ()


def spoiled(dialect: Dialect, built: Built, how: int) -> Item:
    """Return a request of which nothing comes."""
    link = dialect.link
    if how == WRONG_CHECK:
        frame = bytearray(built.frame)
        frame[link.checks(built.frame, built.can_id)[-1].start] ^= 1
        return built.item(bytes(frame))
    body = built.frame[:-1]
    if how == _NO_CHECK:
        return built.item(body)
    return built.item(link.completed(body.ljust(1 + _CAN_DATA, b"\0")[: 1 + how - _OF_LENGTH], built.can_id))
