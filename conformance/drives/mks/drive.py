"""An emulated MKS drive of any dialect: its dialects, its behaviour, and actions from outside.

    responders      requests and replies in native frames, Modbus-RTU, CAN
    state, core     settings, memory, motor and switches; scripts, limits and the locked rotor
    reading, settings, motion     the behaviour of each command: `BEHAVIOURS`, one function for each verb
    motor, paths    the shaft

    native 8E 01, or `modbus=1` at the start  ->  Modbus     Modbus 008Eh = 0, or a restore  ->  native

Rules kept here:
- Settings and motion belong to the drive, and stay when its dialect changes. `dialect` is the current dialect.
- The reply to a change of dialect is still in the old dialect.
- Differences of the CAN drives from the RS485 drives stand in `CanResponder`.
- Actions from outside happen at the drive's current time.

Not emulated:
- the display and the keys (a key lock is stored), interpolation, heat (no command shows it);
- the effect of motor and holding current beyond none at all (they are stored; no manual gives a torque);
- the calibration that a restored drive needs;
- on CAN: pulses at the STP and DIR pins beyond their count, the 100 ms after 85, the LED, homing by a 200 ms pulse at En;
- the reading of an X4 mode without a magnet (the encoder stays readable).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Unpack

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Verb
from analyzer.layout import Effect
from analyzer.link import CanLink, HeadLink, Link, ModbusLink
from analyzer.protocols import mks_rs485
from conformance.drives.drive import Options, Rest
from conformance.drives.mks.core import Behaviour, MksCore
from conformance.drives.mks.motion import MOTION, power_on
from conformance.drives.mks.motor import Switch
from conformance.drives.mks.paths import Number, size
from conformance.drives.mks.reading import READING
from conformance.drives.mks.responders import CanResponder, MksResponder, ModbusResponder, NativeResponder
from conformance.drives.mks.settings import POWER, SETTINGS, restart

BEHAVIOURS: Mapping[Verb, Behaviour] = {**READING, **SETTINGS, **MOTION, **POWER}

#: Below so many volts nothing works.
OFF_VOLTS = 5.0


_RESPONDERS: Mapping[type[Link], type[MksResponder]] = {
    HeadLink: NativeResponder,
    ModbusLink: ModbusResponder,
    CanLink: CanResponder,
}


def _responders(dialect: Dialect, model: str) -> list[MksResponder]:
    """Return the dialects of the drive that speaks one, as a model has them, by the value that chooses each."""
    every = sorted((dialect.whole, *map(registry.get, dialect.siblings)), key=lambda each: each.chosen_by)
    return [_RESPONDERS[type(each.link)](each.for_model(model) if model else each) for each in every]


class MksDrive(MksCore):
    """One MKS drive with its motor. `dialect`: its first dialect.

    Raises UsageError for a name that is no setting and for a value that a setting cannot have.
    """

    def __init__(
        self, dialect: Dialect = mks_rs485.DIALECT, address: int = 1, *, model: str = "", **options: Unpack[Options]
    ) -> None:
        chosen = dialect.effect(Effect.DIALECT)
        if chosen is not None:
            options["settings"] = {chosen[1].name: int(dialect.chosen_by)} | dict(options.get("settings") or {})
        super().__init__(_responders(dialect, model or dialect.model), address, BEHAVIOURS, power_on, **options)

    @property
    def counts_per_turn(self) -> int:
        """What the encoder counts in a turn."""
        return self.motor.counts_per_turn

    @property
    def rest(self) -> Rest:
        now, path = self.now_ns, self.motor.path
        speed = path.speed(now)
        if speed:
            return Rest(now, -1, 1 if speed > 0 else -1, float(speed))
        at_ns = float(path.settled)
        return Rest(at_ns, now - at_ns, next((s.way for s in reversed(path.segments) if s.way), 0))

    def hold(self, settings: Mapping[str, int]) -> None:
        self.settings.update({name: value for name, value in settings.items() if name in self.fields})
        self.tune()
        self.grip()

    def stand(self, told: Mapping[str, int]) -> None:
        if "enabled" in told and self.by_bus:
            self.memory.enabled = bool(told["enabled"])
            self.grip()
        if "position" in told:
            self.motor.jump(self.now_ns, told["position"] - self.axis)
        if "pulses" in told:
            self.memory.pulse_zero = self.motor.wanted(self.now_ns) - told["pulses"] * self.pulse_counts

    def power_cycle(self, t_ns: int) -> None:
        """Switch the drive off and on: what is in RAM is gone, what happens at power-on happens."""
        self.advance(t_ns)
        self.discard_replies()
        restart(self)
        self.changed()

    # --- what can be done to it from outside ----------------------------------------------------------------------

    def block(self, blocked: bool = True) -> None:
        """Hold the shaft from outside, or let it go."""
        self.motor.block(self.now_ns, blocked or self.without_current)
        self.changed()

    def obstruct(self, side: str, counts: Number | None) -> None:
        """Put something the shaft cannot pass where 31 would show `counts`, on the `left` or `right`; None: take it away."""
        place = None if counts is None else counts + self.memory.zero
        self.motor.obstruct(self.now_ns, self.side_way(side), place)
        self.changed()

    def limit_switch(self, side: str, pressed: bool = True) -> None:
        """Press the `left` or `right` end stop by hand, or let it go; left is where homing goes."""
        self.switches[side].pressed = pressed
        self.changed()

    def place_switch(self, side: str, counts: Number | None) -> None:
        """Mount the `left` or `right` end stop where 31 would show `counts`: closed there and beyond. None: nowhere."""
        place = None if counts is None else counts + self.memory.zero
        self.switches[side] = Switch(self.side_way(side), place, self.switches[side].pressed)
        self.changed()

    def turn_shaft(self, counts: Number) -> None:
        """Turn the shaft by hand; a motor that holds gives way only if its protection lets go."""
        if self.guarded and size(counts) > self.stall_counts:
            self.protect()
        if not self.motor.holding:
            self.memory.pulse_zero += counts
        self.motor.turn(self.now_ns, counts)
        self.changed()

    def step(self, pulses: int) -> None:
        """Give pulses at the STP pin, all at once; positive ones as the setting of the motor's direction says."""
        if self.by_bus or not self.motor.holding:
            return
        counts = pulses * size(self.pulse_counts) * (1 if self.settings["motor_direction"] else -1)
        self.motor.jump(self.now_ns, counts)
        self.memory.pulse_zero += counts - pulses * self.pulse_counts
        self.changed()

    def supply(self, volts: float) -> None:
        """Set the supply: out of its range the motor lets go; below `OFF_VOLTS` the drive is off."""
        was_on, self.powered = self.powered, volts >= OFF_VOLTS
        self.motor.volts = volts
        if self.powered and not was_on:
            restart(self)
        elif not self.powered:
            self.drop()
            self.let_go()
            self.discard_replies()
        elif not self.supplied:
            self.fail()
        else:
            self.grip()
        self.changed()

    def hot(self, temperature: float) -> None:
        """Set the motor's temperature (degC), which no MKS command shows."""
        self.motor.temperature = temperature

    def encoder_error(self, fails: bool = True) -> None:
        """Make the encoder fail, or work again: without it a closed loop lets go."""
        self.motor.encoder_fails = fails
        if fails and self.motor.closed_loop:
            self.fail()
        else:
            self.grip()
        self.changed()

    def set_enable_pin(self, level: int) -> None:
        """Set the level of the En pin, which counts in pulse modes; where it disables, it ends the protection (CAN)."""
        self.enable_pin = level
        if not self.by_bus:
            if not self.enabled and "stall_tolerance" in self.settings:
                self.memory.protected = False
            self.grip()
        self.changed()
