"""An emulated MKS drive, whatever its dialect: the table of what it does, and what one can do to it from outside.

    mks_speaker    frames to orders, reply values to bytes     mks_rs485, mks_modbus, mks_can
    mks_core       orders to behaviours, scripts, time
    mks_state      settings, motor, switches and what follows  mks_store: what is kept, what is lost with the power
    behaviours     mks_reading, mks_settings, mks_motion, mks_homing, mks_power

Rules kept here:
- `BEHAVIOURS` has one function for each verb of the three dialects; a dialect has the verbs of its catalogue.
- What is done from outside happens at the time to which the drive was last told that time has passed.

Not emulated: the display and the keys (a key lock is stored), motor and holding current (stored, without effect: no
manual gives a torque), interpolation, heat (no command shows it), and that a restored drive is to be calibrated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from analyzer.catalogue import Verb
from conformance.drives.drive import Fault, Quirk
from conformance.drives.mks.core import Behaviour, MksCore
from conformance.drives.mks.homing import HOMING, power_on
from conformance.drives.mks.motion import MOTION
from conformance.drives.mks.paths import Number, size
from conformance.drives.mks.power import POWER, restart
from conformance.drives.mks.reading import READING
from conformance.drives.mks.settings import SETTINGS
from conformance.drives.mks.speaker import Speaker
from conformance.drives.motor import Switch

BEHAVIOURS: Mapping[Verb, Behaviour] = {**READING, **SETTINGS, **MOTION, **HOMING, **POWER}

#: Below so many volts nothing works.
OFF_VOLTS = 5.0


class MksDrive(MksCore):
    """One MKS drive with its motor. `speakers`: its dialects, by the value of the setting `modbus`.

    `settings`: start values by field name, in place of the defaults. Raises UsageError for a name that is no setting and
    for a value that it cannot have.
    """

    def __init__(
        self,
        speakers: Sequence[Speaker],
        address: int,
        *,
        settings: Mapping[str, int] | None = None,
        quirks: Iterable[Quirk] = (),
        faults: Iterable[Fault] = (),
        seed: int = 0,
    ) -> None:
        super().__init__(speakers, address, BEHAVIOURS, power_on, settings=settings, quirks=quirks, faults=faults, seed=seed)

    def power_cycle(self, t_ns: int) -> None:
        """Switch the drive off and on: what is in RAM is gone, what happens at power-on happens."""
        self.advance(t_ns)
        self.forget()
        restart(self)
        self.changed()

    # --- what can be done to it from outside ----------------------------------------------------------------------

    def block(self, blocked: bool = True) -> None:
        """Hold the shaft from outside, or let it go."""
        self.motor.block(self.now_ns, blocked)
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
            self.forget()
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
