"""The state of an MKS drive: its settings, its memory, its motor, its switches, and what follows from them.

Rules kept here:
- A setting has the name of its field in the catalogue and the default printed there; where the manual prints none, the
  one of `UNPRINTED`, else 0. Besides the settings, `KEPT` names what other commands leave in the flash.
- `Memory` is what a restart clears: all that stands in it is lost, and nothing else is.
- In bus modes a command enables the motor, in pulse modes the En pin.
- Left is the side to which homing goes, right is the other one. A closed switch pulls its pin low, so that with
  `home_trigger` high an open switch is the effective one.
- A drive has a port for the right switch if it is a 57 or its ports are remapped.
- The real speed is the speed as sent at 16, 32 and 64 subdivisions, else speed x 16 / subdivision; the limit of the work
  mode is one of the speed as sent.
- Without any current (0 mA) the shaft stays where it is, and the position error grows.

Not emulated: which port a switch is wired to; the drive finds it at the port where it looks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import NamedTuple, Unpack

from analyzer.catalogue import Command, Dialect, Verb
from analyzer.errors import UsageError
from analyzer.layout import Effect, Field
from analyzer.protocols import mks_shared
from conformance.drives.drive import Drive, Options
from conformance.drives.mks.motor import Motor, Switch
from conformance.drives.mks.paths import Number, divided, ramp_step_ns
from conformance.drives.mks.responders import MksResponder

COUNTS_PER_TURN, SUBDIVISION = mks_shared.COUNTS_PER_TURN, mks_shared.SUBDIVISION
#: The position error at which a locked rotor counts as one where no setting says: that of the CAN drives.
STALL_COUNTS = COUNTS_PER_TURN // 2
DEGREES = 360


@cache
def _counts(tolerance: int, scale: Fraction) -> Number:
    return divided(tolerance * scale * COUNTS_PER_TURN, DEGREES)


def way_of(direction: int) -> int:
    """Return the way of a direction in a setting: 1 raises the encoder."""
    return 1 if direction == mks_shared.ConfigDirection.CCW else -1


# --- what a drive keeps and what it forgets -------------------------------------------------------------------------------

#: Defaults that the manual of the RS485 drives does not print: the home speed is that of the CAN drives.
UNPRINTED: Mapping[str, int] = {"home_speed": 60}

#: What is stored by other commands than settings, and the highest value of each. All begin at 0.
KEPT: Mapping[str, int] = {
    "saved_run": 1,  # whether a run at a speed is kept for power-on (FF)
    "saved_direction": 1,
    "saved_speed": 0xFFFF,
    "saved_acceleration": 0xFF,
    "zero_kept": 1,  # whether a zero point is kept (9A), and where it is within the turn
    "zero_point": COUNTS_PER_TURN - 1,
    "limits_homed": 1,  # whether homing was done since the end limits were changed
}

#: Where each setting stands that the catalogue has under no "set" command.
_ALSO = frozenset({Verb.WRITE_USER_ID})


def is_setting(command: Command) -> bool:
    """Say whether the fields of a command's request are stored."""
    return command.verb in _ALSO or (command.verb.value.startswith("set_") and command.verb is not Verb.SET_ZERO)


class Catalogued(NamedTuple):
    """What a dialect says of settings: their fields by name, and the default of everything that a drive keeps."""

    fields: Mapping[str, Field]
    defaults: Mapping[str, int]


def catalogued(dialect: Dialect) -> Catalogued:
    """Return what a dialect says of settings; worked out once, and kept with it.

    A dialect without a model has the defaults of its first one.
    """
    kept: Catalogued | None = dialect.__dict__.get("_catalogued")
    if kept is None:
        resolved = dialect if dialect.model else dialect.for_model(dialect.models[0])
        defaults = dict.fromkeys(KEPT, 0)
        for name, field in _fields(resolved).items():
            defaults[name] = UNPRINTED.get(name, 0) if field.default is None else int(field.default)
        kept = dialect.__dict__["_catalogued"] = Catalogued(_fields(dialect), defaults)
    return kept


def _fields(dialect: Dialect) -> dict[str, Field]:
    fields: dict[str, Field] = {}
    for command in dialect.commands:
        if is_setting(command):
            for form in command.request_forms:
                for name, field in form.layout.named.items():
                    fields.setdefault(name, field)
    return fields


@dataclass
class Memory:
    """What a drive forgets when it restarts.

    `zero`: the encoder's zero, and `pulse_zero` where the count of pulses is 0, both in counts of the shaft. `run`: the
    last run at a speed (direction, speed, acceleration as sent). The ports (CAN): masks and levels as written.
    """

    enabled: bool = True
    protected: bool = False
    zero: Number = 0
    pulse_zero: Number = 0
    run: tuple[int, int, int] | None = None
    zero_status: int = 1
    alm_mask: int = 0
    pend_mask: int = 0
    alm: int = 0
    pend: int = 0


# --- the state ----------------------------------------------------------------------------------------------------------


class MksState(Drive):
    """The state of one drive. `responders`: its dialects, by the value of the setting that chooses one.

    Raises UsageError for a name that is no setting and for a value that a setting cannot have.

    A quirk or a fault may change these attributes:

    - `reply_delay_ns`, `start_ns`, `calibration_ns`: times. `ramp`: the time of one rpm, by acceleration as sent.
    - `home_settings`: the settings of homing. `heedless`: names of settings without an effect.
    - `forgetful`: settings that a restart resets. `clinging`: settings that a restore keeps.
    """

    def __init__(self, responders: Sequence[MksResponder], address: int, **options: Unpack[Options]) -> None:
        super().__init__(responders, address, **options)
        self.dialect_setting = self._named(Effect.DIALECT)
        self.fields, self.factory = catalogued(self.dialect)
        self.settings = self._checked({"new_address": address} | self.settings)
        self.ramp: Callable[[int], int] = ramp_step_ns
        self.home_settings: Callable[[], Mapping[str, int]] = lambda: self.settings
        self.start_ns = 200_000_000
        self.calibration_ns = 5_000_000_000
        self.heedless: set[str] = set()
        self.forgetful: set[str] = set()
        self.clinging: set[str] = set()
        self.motor = Motor(COUNTS_PER_TURN)
        self.memory = Memory()
        self.starting = False
        self.powered = True
        self.without_current = False
        self.enable_pin = int(mks_shared.Level.LOW)
        self.switches: dict[str, Switch] = {"left": Switch(-1), "right": Switch(1)}
        self.tune()

    def _checked(self, given: Mapping[str, int]) -> dict[str, int]:
        for name, value in given.items():
            if name not in self.factory:
                known = ", ".join(sorted(self.fields))
                raise UsageError(f"{self.dialect.name} has no setting {name!r}, expected one of {known}")
            field = self.fields.get(name)
            if field is None and not 0 <= value <= KEPT[name]:
                raise UsageError(f"{name}: got {value}, expected 0..{KEPT[name]}")
            spoken = (catalogued(responder.dialect).fields.get(name) for responder in self.responders)
            allowed = any(each is not None and each.allows(value) for each in spoken)
            if field is not None and not allowed and value != self.factory[name]:
                raise UsageError(f"{name}: got {value}, expected {field.low}..{field.high} or what the manual lists")
        return {**self.factory, **given}

    def tune(self) -> None:
        """Take what the settings say of the link, of the loop and of the current."""
        self.dialect = self.responder.dialect
        self.address = self.settings["new_address"]
        self.motor.closed_loop = "open" not in self.mode
        without = not self.settings["current"]
        if without != self.without_current:
            self.without_current = without
            self.motor.block(self.now_ns, without)

    # --- link and mode --------------------------------------------------------------------------------------------

    @property
    def responder(self) -> MksResponder:
        """The responder of the dialect that the drive speaks now."""
        responder = self.responders[min(self.settings.get(self.dialect_setting, 0), len(self.responders) - 1)]
        assert isinstance(responder, MksResponder)
        return responder

    @property
    def listening(self) -> bool:
        """Whether the drive hears what is on the bus."""
        return self.powered and not self.starting

    @property
    def mode(self) -> str:
        """The name of the work mode."""
        return self.fields["work_mode"].choice_names.get(self.settings["work_mode"], "")

    @property
    def by_bus(self) -> bool:
        """Whether the work mode takes motion from the bus."""
        return self.mode in self.responders[0].dialect.by_verb[Verb.RUN_SPEED].modes

    @property
    def enabled(self) -> bool:
        """Whether the motor is to hold: by command in bus modes, by the En pin in pulse modes."""
        if self.by_bus:
            return self.memory.enabled
        return self.settings["enable_level"] in (mks_shared.EnableLevel.ALWAYS, self.enable_pin)

    @property
    def supplied(self) -> bool:
        """Whether the supply is within what the manual asks for."""
        low, high = self.responder.supply
        return low <= self.motor.volts <= high

    @property
    def healthy(self) -> bool:
        """Whether nothing is wrong with supply, encoder and rotor."""
        blind = self.motor.encoder_fails and self.motor.closed_loop
        return self.supplied and not blind and not self.memory.protected

    # --- units ----------------------------------------------------------------------------------------------------

    @property
    def subdivision(self) -> int:
        """The pulses of a full step."""
        return self.settings["subdivision"] or SUBDIVISION.largest

    @property
    def bus_sense(self) -> int:
        """-1 where the setting of the motor's direction turns motion by the bus, else 1."""
        turned = self.responder.turns_bus_motion and self.settings["motor_direction"] == mks_shared.ConfigDirection.CCW
        return -1 if turned else 1

    @property
    def pulse_counts(self) -> Number:
        """The encoder counts of one pulse, below 0 where pulses lower the encoder."""
        return Fraction(self.bus_sense * COUNTS_PER_TURN, SUBDIVISION.full_steps * self.subdivision)

    @property
    def pulses(self) -> int:
        """The count of pulses."""
        return round((self.motor.wanted(self.now_ns) - self.memory.pulse_zero) / self.pulse_counts)

    @property
    def axis(self) -> int:
        """The encoder's running count."""
        return round(self.motor.position(self.now_ns) - self.memory.zero)

    def highest_speed(self, declared: int) -> int:
        """Return the speed as sent that the work mode allows at most; `declared` is that of the command."""
        return self.dialect.mode_speeds.get(self.mode, declared)

    def real_speed(self, speed: int) -> Number:
        """Return the rpm of the shaft for a speed as sent."""
        plain = self.subdivision in SUBDIVISION.plain
        return speed if plain else divided(speed * SUBDIVISION.counted_at, self.subdivision)

    @property
    def stall_counts(self) -> Number:
        """The position error at which a locked rotor counts as one, in counts."""
        declared = self.fields.get("stall_tolerance")
        if declared is None:
            return STALL_COUNTS
        return _counts(self.settings["stall_tolerance"], declared.scale)

    # --- switches -------------------------------------------------------------------------------------------------

    def side_way(self, side: str) -> int:
        """Return the way in which a side lies: left is where homing goes."""
        home = way_of(self.settings["home_direction"])
        return home if side == "left" else -home

    def side_wired(self, side: str) -> bool:
        """Say whether the drive has a port for the switch of a side."""
        return side == "left" or self.model.startswith("57") or bool(self.settings["limit_remap"])

    def level(self, side: str) -> int:
        """Return the level at the pin of a switch."""
        return int(not self.switches[side].closed(self.motor.position(self.now_ns)))

    def effective(self, side: str) -> bool:
        """Say whether the switch of a side stands at its effective level."""
        return self.side_wired(side) and self.level(side) == self.settings["home_trigger"]

    def until_effective(self, side: str, wanted: bool) -> Number | None:
        """Return when the switch of a side will (or will no longer) stand at its effective level, or None."""
        if self.effective(side) == wanted:
            return self.now_ns
        return self.motor.changes(self.switches[side], self.now_ns) if self.side_wired(side) else None

    # --- the shaft ------------------------------------------------------------------------------------------------

    def let_go(self) -> None:
        """Let the shaft go; the count of pulses stays as it is."""
        self.memory.pulse_zero -= self.motor.error(self.now_ns)
        self.motor.release(self.now_ns)

    def grip(self) -> None:
        """Hold the shaft, or let it go, as the state says."""
        if self.enabled and self.healthy:
            self.motor.hold(self.now_ns)
        elif self.motor.holding:
            self.let_go()
