"""An emulated Lingkong (LK) drive on RS485: what it does with each command of manual V2.36, and what it answers.

    request 3E A2 01 04 E5 A0 8C 00 00 2C  ->  values by name  ->  ACTS["run_speed"]  ->  the motor
    reply   3E A2 01 07 E8 ...             <-  reply's fields by name  <-  SENT, PHYSICAL  <-  the motor and the drive

What a command does and where a reply's fields come from stand in the tables of `lk_commands`. Layouts, ranges, models,
codes and frames come from the catalogue.

Rules kept here:
- One request, one reply, `reply_delay_ns` (0.25 ms) after the last byte of the request. Nothing is sent unasked.
- Silence: a wrong sum, another address (there is no broadcast), a code or length that the model does not have, and a
  parameter that appendix 1 does not list, for which there is nothing to answer.
- A value outside its range or choices is answered, since LK has no reply that refuses, and changes nothing. Reserved
  bytes are not looked at.
- Off, or with an error flag set: answered, but nothing moves, neither then nor later. An error takes the torque away.
- 0x80 drops the motion under way and keeps the turns; 0x88 takes nothing up again. 0x81 brakes by the ramp and holds,
  and the motor stays on.
- `max_speed` of 0xA4, 0xA6 and 0xA8 stands in for the speed limit, as the remarks of sections 13, 15 and 17 leave Max
  Speed out. 0 is a limit of 0 and nothing moves: no word makes an exception of it (that real drives do is a quirk).
- 0xA7 and 0xA8 count from where the shaft is. A multi-turn position counts from the encoder's zero at power-up, until
  0x93 (the whole turns are dropped, the angle within the turn stays) or 0x95. Neither disturbs motion under way.
- 0xA5 and 0xA6 turn in the direction given and no other; at the angle already, the shaft stays.
- 0xC1 holds at once, also for motion under way. Parameter numbers are taken as: torques LSB of torque current (MS:
  power), speeds 0.01 deg/s, angles 0.01 deg, torque ramp LSB/s, speed ramp 0.01 deg/s2; signs are ignored. The manual
  gives no units; these are those of its commands. On MS 30 and 36 act on the power.
- 0x19 stores the raw encoder value; the zero moves at the next power-up.
- 0x9C and its like report the encoder counted from the zero, as a real MS4015 does.
- Error flags stay until 0x9B, which clears those whose cause is gone; its reply shows what is left.
- 0x8C answers with the state after switching. At power-up the brake is released, since the motor obeys at once then.

Decided, since nothing is printed: the voltages and temperatures that raise flags, the values at power-up, the supply
current, the phases' angle.

Not emulated: loop gains (kept and read back, without effect), heating under load, the light, the setup program's
link, what a failed encoder does to the position, the multi-motor commands that the manual only mentions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import msgspec

from analyzer.catalogue import Command, Dialect, Role
from analyzer.codec import codec
from analyzer.decoder import Decoder
from analyzer.errors import UsageError
from analyzer.layout import Field
from analyzer.protocols.lk_rs485 import DIALECT, ERROR_BITS, HUNDREDTH, PARAMETER_FORMS
from analyzer.records import Frame
from conformance.drives.drive import Drive, Fault, Outgoing, Quirk, Values
from conformance.drives.lk.commands import ACTS, ANSWERS, PHYSICAL, SENT, Act, Answer, Request
from conformance.drives.lk.motor import BUILDS, Build, Limits, LkMotor

DEFAULT_MODEL = "MF"
REPLY_DELAY_NS = 250_000

#: Fields of the control parameters by name.
PARAMETERS: Mapping[str, Field] = {
    name: field
    for form in PARAMETER_FORMS
    for name, field in form.layout.named.items()
    if form.layout.named["parameter"].fixed is not None and name != "parameter"
}
#: Control parameters at power-up, as sent; those left out begin as 0, `torque_limit` as the most that may be asked.
FACTORY: Mapping[str, int] = {
    "angle_kp": 100,
    "angle_ki": 20,
    "speed_kp": 50,
    "speed_ki": 20,
    "current_kp": 100,
    "current_ki": 50,
    "speed_limit": 72_000,
    "angle_limit": PARAMETERS["angle_limit"].high,
    "current_ramp": 100_000,
    "speed_ramp": 360_000,
}
ENCODER_WIDTHS = (14, 15, 16, 18)

#: Volts below which the drive is dead, and volts and degC at which a flag is raised.
OFF_VOLTS, LOW_VOLTAGE, HIGH_VOLTAGE = 5.0, 10.0, 52.0
MOTOR_HOT, DRIVE_HOT = 90.0, 110.0


#: Dialects as one model speaks them, so that their codecs are made once: (name, model) -> (of which one, as spoken).
_spoken: dict[tuple[str, str], tuple[Dialect, Dialect]] = {}


def _as_spoken(dialect: Dialect, model: str) -> Dialect:
    """Return a dialect as one model speaks it; the same object each time."""
    known = _spoken.get((dialect.name, model))
    if known is None or known[0] is not dialect:
        known = _spoken[dialect.name, model] = (dialect, dialect.for_model(model))
    return known[1]


class LkDrive(Drive):
    """One LK drive with its motor.

    `model`: MF (if none is given), MG, MH or MS. `settings`: what it holds at power-up, integers as sent: the control
    parameters by their field names, `encoder_zero` (counts), `encoder_bits` (14, 15, 16 or 18) and `baud_rate`.
    `angle`: where the shaft stands at first (deg).

    Raises UsageError for a setting that it does not have or cannot hold, ValueError for an unknown model.
    """

    motor: LkMotor  # type: ignore[assignment, unused-ignore]  # the base names the motor of the others

    def __init__(
        self,
        dialect: Dialect = DIALECT,
        address: int = 1,
        *,
        model: str = "",
        settings: Mapping[str, int] | None = None,
        quirks: Iterable[Quirk] = (),
        faults: Iterable[Fault] = (),
        seed: int = 0,
        angle: float = 0.0,
    ) -> None:
        spoken = _as_spoken(dialect, (model or dialect.model or DEFAULT_MODEL).upper())
        super().__init__(spoken, address, settings=settings, quirks=quirks, faults=faults, seed=seed)
        self.model = spoken.model
        self.settings = self._checked(self.settings)
        self.reply_delay_ns = REPLY_DELAY_NS
        self.acts: dict[str, Act] = dict(ACTS)
        self.answers: dict[str, Answer] = dict(ANSWERS)
        self.errors: set[str] = set()
        self.volts: float = 24.0
        self.temperature: float = 30.0
        self._tripped: set[str] = set()
        self.parameters = self._stored_parameters()
        self.motor = LkMotor(self._build, self.limits, angle=angle)
        self.motor.encoder_zero = self.settings["encoder_zero"]
        self.motor.power_up()
        for setup in self.hooks.setup:
            setup(self)
        self._decoder = Decoder(self.dialect)

    def _checked(self, given: Mapping[str, int]) -> dict[str, int]:
        asked = next(c for n in ("run_torque", "run_open_loop") if (c := self.dialect.by_name.get(n)) is not None)
        torque = next(iter(asked.request_forms[0].layout.named.values()))
        width = BUILDS[self.dialect.model].encoder_bits
        held = {name: FACTORY.get(name, 0) for name in PARAMETERS}
        rates = self.dialect.baud_rates
        held |= {"torque_limit": torque.high, "encoder_zero": 0, "encoder_bits": width, "baud_rate": rates[0]}
        for name, value in given.items():
            if name not in held:
                raise UsageError(f"{self.dialect.name} has no setting {name!r}; it has {', '.join(sorted(held))}")
            held[name] = value
        for name, field in PARAMETERS.items():
            if not field.allows(held[name]):
                raise UsageError(f"{name}: got {held[name]}, expected {field.low}..{field.high}")
        for name, choices in (("encoder_bits", ENCODER_WIDTHS), ("baud_rate", rates)):
            if held[name] not in choices:
                raise UsageError(f"{name}: got {held[name]}, expected one of {', '.join(map(str, choices))}")
        counts = 1 << min(held["encoder_bits"], 16)
        if not 0 <= held["encoder_zero"] < counts:
            raise UsageError(f"encoder_zero: got {held['encoder_zero']}, expected 0..{counts - 1}")
        return held

    # --- requests and replies -------------------------------------------------------------------------------------

    def receive(self, frame: Frame, t_ns: int) -> list[Outgoing]:
        """Take a frame that is complete at `t_ns`, also one that is damaged or not for this drive; return replies."""
        self.advance(t_ns)
        if not self.powered or frame.dialect.name != self.dialect.name:
            return []
        message, _ = self._decoder.decode(msgspec.structs.replace(frame, role=Role.REQUEST))
        wanted = frame.checksum_ok and message.address == self.address and message.form is not None
        for accept in self.hooks.accept:
            wanted = accept(self, frame, message, wanted)
        if not wanted:
            return []
        command, form = message.command, message.form
        if command is None or form is None:
            # Only a fault takes a frame that no command is for.
            return [Outgoing(t_ns + self.reply_delay_ns, frame.data)]
        values = message.values
        for change in self.hooks.request:
            values = change(self, command, values)
        fields = form.layout.named
        request = Request(command, form, values, {n: f.physical(values[n]) for n, f in fields.items()})
        allowed = all(f.allows(values[n]) for n, f in fields.items())
        for allow in self.hooks.allow:
            allowed = allow(self, command, values, allowed)
        if allowed and command.name in self.acts:
            self.acts[command.name](self, request)
        answers = True
        for decide in self.hooks.answer:
            answers = decide(self, message, answers)
        if not answers:
            return []
        answer = self.answers[command.name](self, request) if command.name in self.answers else self.readings(command)
        for adjust in self.hooks.result:
            answer = adjust(self, command, values, answer)
        if answer is None:
            return []
        outgoing = [Outgoing(t_ns + self.reply_delay_ns, self.encode(command, answer))]
        for rewrite in self.hooks.reply:
            outgoing = [changed for one in outgoing for changed in rewrite(self, command, one)]
        return outgoing

    def readings(self, command: Command) -> Values | None:
        """Return the values of a command's reply, each field as the drive measures it; None where there is no reply."""
        if not command.reply_forms:
            return None
        return {name: self.reading(field) for name, field in command.reply_forms[0].layout.named.items()}

    def reading(self, field: Field) -> int:
        """Return what a field reports now, as sent, cut off at what it may hold."""
        if field.name in PHYSICAL:
            # Not `field.wire`: that is exact for any fraction, and takes longer than all the rest of a reply.
            value = round(PHYSICAL[field.name](self) / field.scale)
        elif field.name in self.parameters:
            value = self.parameters[field.name]
        else:
            value = SENT[field.name](self)
        return max(field.low, min(field.high, value))

    def encode(self, command: Command, values: Values) -> bytes:
        """Return the frame of a reply; its form is the one that has these fields."""
        form = next(
            f
            for f in command.reply_forms
            if f.layout.named.keys() == values.keys()
            and all(d.fixed is None or d.fixed == values[n] for n, d in f.layout.named.items())
        )
        return self.dialect.link.build(command, form, self.address, codec(form.layout).encode(values), Role.REPLY)

    def learn(self, command: Command, act: Act | None = None, answer: Answer | None = None) -> None:
        """Take on a command that the dialect or the model does not have, as a quirk or a fault does."""
        others = tuple(c for c in self.dialect.commands if c.name != command.name)
        self.dialect = replace(self.dialect, commands=(*others, command))
        if act is not None:
            self.acts[command.name] = act
        if answer is not None:
            self.answers[command.name] = answer

    def forget(self, *names: str) -> None:
        """Drop commands, as a quirk does."""
        kept = tuple(c for c in self.dialect.commands if c.name not in names)
        self.dialect = replace(self.dialect, commands=kept)

    # --- time -----------------------------------------------------------------------------------------------------

    def advance(self, t_ns: int) -> list[Outgoing]:
        """Let time pass until `t_ns`; an LK drive sends nothing by itself."""
        self.now_ns = max(self.now_ns, t_ns)
        stalls_ns = self.motor.stalls_ns
        if stalls_ns is not None and self.now_ns >= stalls_ns:
            self.motor.to(stalls_ns)
            self._raise({"stalled"})
        self.motor.to(self.now_ns)
        return []

    def next_ns(self) -> int | None:
        """Return when the ramps under way end or the motor stalls, or None while nothing is under way."""
        times = [t for t in (self.motor.settles_ns, self.motor.stalls_ns) if t is not None and t > self.now_ns]
        return min(times, default=None)

    def power_cycle(self, t_ns: int) -> None:
        """Switch the drive off and on: parameters, turns and errors are gone, the stored zero takes effect."""
        self.advance(t_ns)
        self.errors.clear()
        self.parameters = self._stored_parameters()
        self.motor.encoder_zero = self.settings["encoder_zero"]
        self.motor.limit(self.limits)
        self.motor.power_up()
        self._raise(self.causes)
        for change in self.hooks.powered:
            change(self)

    # --- what it holds --------------------------------------------------------------------------------------------

    def store(self, name: str, value: int) -> None:
        """Keep a value: a control parameter until the power goes, a setting beyond that."""
        for change in self.hooks.stored:
            changed = change(self, name, value)
            if changed is None:
                return
            name, value = changed
        if name in self.parameters:
            self.parameters[name] = value
            self.motor.limit(self.limits)
        else:
            self.settings[name] = value

    def _stored_parameters(self) -> dict[str, int]:
        return {name: self.settings[name] for name in PARAMETERS}

    @property
    def _build(self) -> Build:
        return replace(BUILDS[self.dialect.model], encoder_bits=self.settings["encoder_bits"])

    @property
    def limits(self) -> Limits:
        """What the control parameters allow the motor."""
        held = {name: abs(value) for name, value in self.parameters.items()}
        return Limits(
            torque=held["torque_limit"],
            speed=float(held["speed_limit"] * HUNDREDTH),
            angle=float(held["angle_limit"] * HUNDREDTH),
            torque_ramp=held["current_ramp"],
            acceleration=float(held["speed_ramp"] * HUNDREDTH),
        )

    # --- errors ---------------------------------------------------------------------------------------------------

    @property
    def powered(self) -> bool:
        """Whether the supply is enough to answer."""
        return self.volts >= OFF_VOLTS

    @property
    def obeys(self) -> bool:
        """Whether a motion command moves the motor: it is on, and no error flag is set."""
        return self.motor.on and not self.errors

    @property
    def causes(self) -> set[str]:
        """What is wrong now, by the names of the error flags."""
        conditions = {
            "low_voltage": self.volts < LOW_VOLTAGE,
            "high_voltage": self.volts > HIGH_VOLTAGE,
            "motor_hot": self.temperature >= MOTOR_HOT,
            "drive_hot": self.temperature >= DRIVE_HOT,
            "stalled": "stalled" in self.errors and self.motor.held,
        }
        return self._tripped | {name for name, wrong in conditions.items() if wrong}

    def clear_errors(self) -> None:
        """Clear the flags whose cause is gone."""
        self.errors &= self.causes

    def _raise(self, names: set[str]) -> None:
        self.errors |= names
        if self.errors:
            self.motor.release()

    # --- what happens to it ---------------------------------------------------------------------------------------

    def block(self, blocked: bool = True) -> None:
        """Hold the shaft by hand, or let go."""
        self.motor.hold(blocked=blocked)

    def turn_shaft(self, degrees: float) -> None:
        """Turn the shaft by hand (clockwise positive)."""
        self.motor.twist(degrees)

    def supply(self, volts: float) -> None:
        """Set the supply: below `OFF_VOLTS` the drive is dead, and powers up when there is more again."""
        was_powered = self.powered
        self.volts = volts
        if self.powered and not was_powered:
            self.power_cycle(self.now_ns)
        self._raise(self.causes)

    def hot(self, temperature: float) -> None:
        """Set the temperature of motor and drive (degC)."""
        self.temperature = temperature
        self._raise(self.causes)

    def encoder_error(self, fails: bool = True) -> None:
        """Let the encoder's signal be lost, or come back; of LK's flags only `input_lost` is about a signal."""
        self.trip("input_lost", fails)

    def trip(self, name: str, present: bool = True) -> None:
        """Let the cause of an error flag (its field's name) be there, or gone. Raises UsageError for no flag."""
        flags = [f.name for f in ERROR_BITS]
        if name not in flags:
            raise UsageError(f"no error flag {name!r}; there are {', '.join(flags)}")
        (self._tripped.add if present else self._tripped.discard)(name)
        self._raise(self.causes)
