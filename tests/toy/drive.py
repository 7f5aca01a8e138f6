"""A toy drive with a turning shaft: it follows its manual, or has one fault.

Only the tests have this drive: the claims must run for a dialect without an emulated drive in the project.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from analyzer.records import CanFrame

_SECOND_NS = 1_000_000_000
_REPLY_NS = 300_000
_DEGREES_PER_SECOND_PER_RPM = 6.0
#: How fast the shaft gains or loses speed, in rpm per second.
_RAMP = 3000.0
_STEP_NS = 1_000_000
_CODE_BITS = 5


@dataclass
class ToyDrive:
    """One toy drive. `speed_factor`: rpm of the shaft for 1 rpm as asked. `highest_current`: the last that it accepts."""

    node: int = 2
    speed_factor: float = 1.0
    highest_current: int = 4000
    on: bool = False
    current: int = 1000
    degrees: float = 0.0
    rpm: float = 0.0
    _target_rpm: float = 0.0
    _place: float | None = None
    _now_ns: int = 0
    _replies: list[tuple[int, CanFrame]] = field(default_factory=list)

    # --- the bus --------------------------------------------------------------------------------------------------------

    def put(self, frame: CanFrame, now_ns: int) -> None:
        """Take a frame of the bus at a time."""
        self.turn(now_ns)
        if frame.extended or frame.remote or frame.error or frame.fd or frame.id >> _CODE_BITS != self.node:
            return
        data = self._answer(frame.id & ((1 << _CODE_BITS) - 1), frame.data)
        if data is not None:
            self._replies.append((now_ns + _REPLY_NS, CanFrame(None, "toy", frame.id, data)))

    @property
    def next_ns(self) -> int | None:
        """When the next reply is on the wire; None where there is none."""
        return self._replies[0][0] if self._replies else None

    def take(self) -> CanFrame:
        """Return the next reply."""
        return self._replies.pop(0)[1]

    def _answer(self, code: int, data: bytes) -> bytes | None:
        shape, act = _COMMANDS.get(code, ("", None))
        if act is None or len(data) != struct.calcsize("<" + shape):
            return None
        return act(self, *struct.unpack("<" + shape, data))

    # --- commands -------------------------------------------------------------------------------------------------------

    def _motor(self, power: int) -> bytes:
        if power not in (0, 1):
            return _REFUSED
        self.on = power == 1
        if not self.on:
            self._halt()
            self.rpm = 0.0
        return _DONE

    def _run(self, speed: int) -> bytes:
        if not self.on or abs(speed) > 5000:
            return _REFUSED
        self._place, self._target_rpm = None, speed / 10 * self.speed_factor
        return _DONE

    def _move_to(self, position: int, speed: int) -> bytes:
        if not self.on or speed > 5000:
            return _REFUSED
        self._place, self._target_rpm = position / 100, speed / 10 * self.speed_factor
        return _DONE

    def _stop(self, why: int) -> bytes:
        if why > 3:
            return _REFUSED
        self._halt()
        return _DONE

    def _halt(self) -> None:
        self._place, self._target_rpm = None, 0.0

    def _set_current(self, current: int) -> bytes:
        if current > self.highest_current:
            return _REFUSED
        self.current = current
        return _DONE

    def _read_position(self) -> bytes:
        return struct.pack("<i", round(self.degrees * 100))

    def _read_speed(self) -> bytes:
        return struct.pack("<i", round(self.rpm * 10))

    # --- the shaft ------------------------------------------------------------------------------------------------------

    def turn(self, now_ns: int) -> None:
        """Let the shaft turn until a time."""
        if self.rpm == self._target_rpm == 0:
            self._now_ns = now_ns
        while self._now_ns < now_ns:
            step_ns = min(_STEP_NS, now_ns - self._now_ns)
            self._step(step_ns / _SECOND_NS)
            self._now_ns += step_ns

    def _step(self, seconds: float) -> None:
        wanted = self._wanted()
        change = _RAMP * seconds
        self.rpm = min(max(wanted, self.rpm - change), self.rpm + change)
        before = self.degrees
        self.degrees += self.rpm * _DEGREES_PER_SECOND_PER_RPM * seconds
        place = self._place
        if place is not None and min(before, self.degrees) <= place <= max(before, self.degrees):
            self.degrees, self.rpm = place, 0.0
            self._halt()

    def _wanted(self) -> float:
        """Return the speed to go for: on the way to a place one from which the ramp can end there."""
        if self._place is None:
            return self._target_rpm
        left = self._place - self.degrees
        braking = (2 * _RAMP * abs(left) / _DEGREES_PER_SECOND_PER_RPM) ** 0.5
        wanted = min(self._target_rpm, max(braking, 1.0))
        return wanted if left > 0 else -wanted


_REFUSED, _DONE = bytes((0,)), bytes((1,))
_COMMANDS = {
    0x07: ("B", ToyDrive._motor),
    0x0D: ("i", ToyDrive._run),
    0x0C: ("iH", ToyDrive._move_to),
    0x18: ("B", ToyDrive._stop),
    0x0B: ("H", ToyDrive._set_current),
    0x09: ("", ToyDrive._read_position),
    0x14: ("", ToyDrive._read_speed),
}
