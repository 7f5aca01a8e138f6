"""Requests that fail by their check alone: the frame that they should be, and the rules that give the check that they have."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.check_rules import RULES, RULES_OF_TWO, Rule
from analyzer.diagnosis.reader import Reader, Reading
from analyzer.diagnosis.scene import Scene, Stretch, Trouble
from analyzer.link import LAST_EXCEPTION, LAST_UNIT, MOST_REGISTERS, REGISTER_READS, LkLink, modbus_crc

_LONGEST_CHECK = 2
#: The link whose head counts the fields and has a sum of its own.
_COUNTING = LkLink()
#: Bytes before a frame that are looked for.
_STRAY = 3


class Failing(NamedTuple):
    """A request that fails by its check alone. `rules`: those that give what it has; `right`: the frame as it should be.

    `size`: how many bytes of a check it has; 0 where there is none, or only the first byte of the right one.
    """

    trouble: Trouble
    right: bytes
    name: str
    size: int
    rules: tuple[Rule, ...]

    @property
    def data(self) -> bytes:
        """The request as it is."""
        return self.trouble.stretch.data if self.trouble.stretch is not None else b""

    @property
    def is_counted(self) -> bool:
        """Whether its head counts its fields and all are there, so that only their sum is missing."""
        data = self.data
        return data[0] in _COUNTING.first_bytes and len(self.right) == len(data) + 1 and self.right.startswith(data)


def failing_by_check(scene: Scene, trouble: Trouble, stretch: Stretch) -> Failing | None:
    """Return a stretch as a request whose check alone is wrong or missing."""
    if stretch.direction is Role.REPLY:
        return None
    sent = stretch.direction is Role.REQUEST
    data, can_id = stretch.data, stretch.can_id
    # Bytes too many before a sound frame are no matter of its check.
    if can_id is None and any(scene.reader.best(data[size:]) is not None for size in range(1, _STRAY + 1)):
        return None
    alone = stretch.opens and stretch.ends
    if alone and (body := _read_and_write(data)):
        right, got = body + modbus_crc(body).to_bytes(2, "little"), data[len(body) :]
        rules = tuple(rule for rule in RULES if got and rule.of(body, 0) == got)
        return None if right == data else Failing(trouble, right, "read_and_write_registers", len(got), rules)
    bare = _with_check(scene.reader, trouble, data, b"", can_id, alone, sent) if alone else None
    if bare is not None and bare.is_counted:
        return bare
    for size in range(1, _LONGEST_CHECK + 1):
        found = _with_check(scene.reader, trouble, data[: len(data) - size], data[len(data) - size :], can_id, alone)
        if found is not None and (found.rules or stretch.ends):
            return found
    return bare


def _read_and_write(data: bytes) -> bytes:
    """Return a request of function 17h without its check, as far as its own counts tell its length; else nothing.

    The framer takes functions that no dialect has by their CRC alone, so that a wrong one is told here.
    """
    if len(data) <= _COUNT_OF_17 or data[1] != _FUNCTION_17 or not 0 < data[0] <= LAST_UNIT:
        return b""
    size = _COUNT_OF_17 + 1 + data[_COUNT_OF_17]
    fits = data[8] == 0 and data[_COUNT_OF_17] == 2 * data[9] > 0 and len(data) in (size, size + 2)
    return data[:size] if fits else b""


#: The function that reads and writes registers at once, and where its request has its count of bytes.
_FUNCTION_17, _COUNT_OF_17 = 0x17, 10


def _with_check(
    reader: Reader, trouble: Trouble, body: bytes, got: bytes, can_id: int | None, alone: bool, sent: bool = False
) -> Failing | None:
    """Return the request that a body is with the right check behind it, if it is one. `alone`: it is all that was sent.

    `sent`: the capture says that its writer has sent it; a device without checks sends replies.
    """
    if len(body) < (1 if can_id is not None else 3):
        return None
    for right in _completions(reader, body, can_id):
        if right == body + got:
            continue
        rules = tuple(rule for rule in RULES if got and rule.of(body, can_id or 0) == got)
        # Of a CRC its first byte is there.
        half = len(got) == 1 and len(right) == len(body) + _LONGEST_CHECK and right.startswith(body + got)
        for reading in reader.readings(right, can_id):
            # Without its own check a frame of a code or register that is not listed could be anything, but for a read.
            strong = (
                reading.listed
                or (rules and len(got) > 1)
                or (
                    alone
                    and (len(got) != 1 or half)
                    and (is_plain(right) or (len(got) > 1 and (is_write(right) or _is_whole_write(right))))
                )
            )
            lost = len(right) - len(body)
            own = () if can_id is not None else tuple(_of_two(reading, body + got, right))
            known = bool(rules or own or half)
            if (reading.message.role is Role.REPLY and not sent) or not strong or (not known and got and len(got) != lost):
                continue
            return Failing(trouble, right, reading.name, 0 if half else len(got), own or rules)
    return None


def _of_two(reading: Reading, data: bytes, right: bytes) -> Iterator[Rule]:
    """Yield the rules that make bytes of a frame whose head has a check of its own."""
    first, *others = reading.dialect.link.checks(right)
    if others:
        head, body = right[: first.start], right[first.start + 1 : others[0].start]
        yield from (rule for rule, whole in RULES_OF_TWO if whole(head, body) == data)


def is_plain(frame: bytes) -> bool:
    """Say whether a frame is a Modbus read of registers, as programs ask for them or as they are answered, or an exception.

    Or it switches a coil, which is done by two values alone.
    """
    if len(frame) == READ_SIZE and frame[1] in REGISTER_READS and 0 < int.from_bytes(frame[4:6], "big") <= MOST_REGISTERS:
        return True
    if len(frame) == READ_SIZE and frame[1] == _SWITCHES and frame[4:6] in _SWITCHED and 0 < frame[0] <= LAST_UNIT:
        return True
    return len(frame) > _EXCEPTION - 1 and (
        (frame[1] in REGISTER_READS and frame[2] == len(frame) - 5 and frame[2] % 2 == 0)
        or (len(frame) == _EXCEPTION and frame[1] & 0x7F in REGISTER_READS and 0 < frame[2] <= LAST_EXCEPTION)
    )


def is_write(frame: bytes) -> bool:
    """Say whether a frame is a Modbus write of one register."""
    return len(frame) == READ_SIZE and frame[1] == _WRITE_ONE and 0 < frame[0] <= LAST_UNIT


_WRITE_ONE = 0x06


def _is_whole_write(frame: bytes) -> bool:
    """Say whether a frame is a Modbus write of as many registers as it has bytes for."""
    return (
        len(frame) > _COUNTED and frame[1] == _WRITE_MANY and not frame[4] and len(frame) - _COUNTED == frame[6] == 2 * frame[5]
    )


#: The function that writes registers, and the bytes around these.
_WRITE_MANY, _COUNTED = 0x10, 9
#: The function that switches a coil, and its values.
_SWITCHES, _SWITCHED = 0x05, (b"\xff\0", b"\0\0")
#: The size of an exception.
_EXCEPTION = 5
READ_SIZE = 8


def _completions(reader: Reader, body: bytes, can_id: int | None) -> Iterator[bytes]:
    """Yield a body with the checks of each dialect: behind it, and those within it."""
    for dialect in reader.dialects:
        link = dialect.link
        whole = link.completed(body, can_id)
        yield whole
        first, *others = link.checks(whole, can_id)
        if others:
            # The head has a check of its own: wrong, or forgotten.
            at = first.start
            yield link.completed(link.completed(body[:at]) + body[at + 1 :], can_id)
            yield link.completed(link.completed(body[:at]) + body[at:], can_id)
