"""An emulated Lingkong (LK) drive on RS485: its actions and replies for each command of manual V2.36.

    request 3E A2 01 04 E5 A0 8C 00 00 2C  ->  values by name  ->  ACTS["run_speed"]  ->  the motor
    reply   3E A2 01 07 E8 ...             <-  reply's fields by name  <-  SENT, PHYSICAL  <-  the motor and the drive

    ACTS      command name -> its action; a command that is not listed only reads
    ANSWERS   command name -> the values of its reply, where they are not measured
    PHYSICAL  field name -> its measured value in the field's unit
    SENT      field name -> its measured value as sent

Layouts, ranges, models, codes and frames come from the catalogue.

Rules kept here:
- One request, one reply, `reply_delay_ns` (0.25 ms) after the last byte of the request. Nothing is sent unasked.
- There is no broadcast. A request for a parameter that appendix 1 does not list gets no reply.
- A value outside its range or choices changes nothing, but it is answered: LK has no reply that refuses.
  Reserved bytes are ignored.
- Off, or with an error flag set: commands are answered, but never executed. An error removes the torque.
- 0x80 drops the current motion and keeps the turns; 0x88 resumes nothing. 0x81 brakes by the ramp and holds, and the
  motor stays on.
- `max_speed` of 0xA4, 0xA6 and 0xA8 replaces the speed limit, as the remarks of sections 13, 15 and 17 leave Max Speed
  out. 0 is a limit of 0 and nothing moves: the manual prints no exception (real drives differ, which is a quirk).
- 0xA7 and 0xA8 count from where the shaft is. A multi-turn position counts from the encoder's zero at power-up, until
  0x93 (the whole turns are dropped, the angle within the turn stays) or 0x95. Neither disturbs a current motion.
- 0xA5 and 0xA6 turn only in the given direction; a shaft that is at the angle already stays.
- 0xC1 takes effect at once, also on a current motion. Parameter numbers are taken as: torques LSB of torque current (MS:
  power), speeds 0.01 deg/s, angles 0.01 deg, torque ramp LSB/s, speed ramp 0.01 deg/s2; signs are ignored. The manual
  gives no units; these are those of its commands. On MS 30 and 36 act on the power.
- 0x19 stores the raw encoder value; the zero moves at the next power-up.
- 0x9C and its like report the encoder counted from the zero, as a real MS4015 does.
- Error flags stay until 0x9B, which clears those whose cause is gone; its reply shows what is left.
- 0x8C answers with the state after switching. At power-up the brake is released, since the motor obeys at once then.

The manual does not print the voltages and temperatures that raise flags, the values at power-up, the supply current and the
phases' angle. They are chosen here.

Not emulated: loop gains (stored without effect), heating under load, the light, and the link of the setup program. Nor the
effect of a failed encoder on the position, and the multi-motor commands that the manual only mentions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Unpack

from analyzer.catalogue import Command, Dialect, MotionKind
from analyzer.codec import Violation
from analyzer.errors import UsageError
from analyzer.layout import Field
from analyzer.protocols.lk_rs485 import (
    DIALECT,
    ERROR_BITS,
    HUNDREDTH,
    PARAMETER_FORMS,
    BrakeControl,
    BrakeState,
    MotorState,
    SpinDirection,
)
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Options, Request, Responder, Rest, Values
from conformance.drives.lk.motor import BUILDS, Build, Limits, LkMotor, Speed, Torque

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

# --- what it does with each command --------------------------------------------------------------------------------------

#: Supply current of a drive that does nothing (A), and of each LSB of torque at full speed.
IDLE_CURRENT, CURRENT_SHARE = 0.04, 0.006


Act = Callable[["LkDrive", Request], None]
Answer = Callable[["LkDrive", Request], "Values | None"]
Move = Callable[[LkMotor, Request], None]

# --- motion -------------------------------------------------------------------------------------------------------


def _torque(motor: LkMotor, request: Request) -> None:
    (torque,) = request.values.values()
    motor.go(Torque(torque))


def _to_in_turn(motor: LkMotor, request: Request) -> None:
    clockwise = request.values["direction"] == SpinDirection.CW
    motor.turn_to(request.physical["angle"], clockwise=clockwise, top=request.physical.get("max_speed"))


_KINDS: Mapping[MotionKind, Move] = {
    MotionKind.TORQUE: _torque,
    MotionKind.RUN: lambda motor, request: motor.go(Speed(request.physical["speed"])),
    MotionKind.MOVE_TO: lambda motor, request: motor.move_to(request.physical["position"], request.physical.get("max_speed")),
    MotionKind.MOVE_IN_TURN: _to_in_turn,
    MotionKind.MOVE_BY: lambda motor, request: motor.move_by(request.physical["position"], request.physical.get("max_speed")),
}
#: Commands of motion: command name -> what it asks of the motor.
MOVES: Mapping[str, Move] = {c.name: _KINDS[c.motion.kind] for c in DIALECT.motions(*_KINDS) if c.motion is not None}


def obeying(move: Move) -> Act:
    """Return the act of a motion command: the move, if the drive obeys."""

    def act(drive: LkDrive, request: Request) -> None:
        if drive.obeys:
            move(drive.motor, request)

    return act


# --- all else -----------------------------------------------------------------------------------------------------


def _stop(drive: LkDrive, request: Request) -> None:
    if drive.obeys:
        drive.motor.stop()


def _brake(drive: LkDrive, request: Request) -> None:
    control = request.values["brake_control"]
    if control != BrakeControl.READ:
        drive.motor.hold(braked=control == BrakeControl.POWER_OFF)


def write_parameter(drive: LkDrive, request: Request) -> None:
    """Store the parameter that a request writes."""
    for name, value in request.values.items():
        if name in drive.parameters:
            drive.store(name, value)


ACTS: Mapping[str, Act] = {
    "clear_errors": lambda drive, request: drive.clear_errors(),
    "motor_off": lambda drive, request: drive.motor.turn_off(),
    "motor_on": lambda drive, request: drive.motor.turn_on(),
    "stop": _stop,
    "brake": _brake,
    **{name: obeying(move) for name, move in MOVES.items()},
    "write_parameter": write_parameter,
    "set_zero": lambda drive, request: drive.store("encoder_zero", drive.motor.encoder_raw),
    "clear_turns": lambda drive, request: drive.motor.clear_turns(),
    "set_position": lambda drive, request: drive.motor.set_position(request.physical["position"]),
}

# --- replies ------------------------------------------------------------------------------------------------------


def told_parameter(drive: LkDrive, request: Request) -> Values | None:
    """Answer with what the drive holds, after writing too; with nothing for a number that is not listed."""
    for form in request.command.reply_forms:
        fields = form.layout.named
        if fields["parameter"].fixed == request.values["parameter"]:
            return {n: drive.reading(f) if f.fixed is None else f.fixed for n, f in fields.items()}
    return None


ANSWERS: Mapping[str, Answer] = {
    "read_parameter": told_parameter,
    "write_parameter": told_parameter,
    "set_position": lambda drive, request: dict(request.values),
}


def _supply_current(drive: LkDrive) -> float:
    motor = drive.motor
    return IDLE_CURRENT + CURRENT_SHARE * abs(motor.torque * motor.motion.speed) / motor.build.top_speed


PHYSICAL: Mapping[str, Callable[[LkDrive], float]] = {
    "temperature": lambda drive: drive.temperature,
    "voltage": lambda drive: drive.volts,
    "current": _supply_current,
    "speed": lambda drive: drive.motor.motion.speed,
    "position": lambda drive: drive.motor.position,
    "angle": lambda drive: drive.motor.within_turn,
}


def _phase(number: int) -> Callable[[LkDrive], int]:
    """Return the reading of a phase current: the torque current, turned by the electrical angle."""

    def reading(drive: LkDrive) -> int:
        motor = drive.motor
        electrical = math.radians(motor.motion.angle * motor.build.pole_pairs - 120.0 * number)
        return round(motor.torque * math.cos(electrical))

    return reading


def _flag(name: str) -> Callable[[LkDrive], int]:
    return lambda drive: int(name in drive.errors)


SENT: Mapping[str, Callable[[LkDrive], int]] = {
    "state": lambda drive: MotorState.ON if drive.motor.on else MotorState.OFF,
    **{field.name: _flag(field.name) for field in ERROR_BITS},
    "torque_current": lambda drive: round(drive.motor.torque),
    "power": lambda drive: round(drive.motor.torque),
    "phase_a_current": _phase(0),
    "phase_b_current": _phase(1),
    "phase_c_current": _phase(2),
    "encoder": lambda drive: drive.motor.encoder,
    "encoder_raw": lambda drive: drive.motor.encoder_raw,
    "encoder_offset": lambda drive: drive.motor.encoder_zero,
    "encoder_zero": lambda drive: drive.motor.encoder_raw,
    "brake_state": lambda drive: BrakeState.POWER_OFF if drive.motor.braked else BrakeState.RELEASED,
}


# --- the drive ----------------------------------------------------------------------------------------------------------


def _nothing() -> None:
    """Do nothing at the end of a ramp."""


class LkDrive(Drive):
    """One LK drive with its motor.

    `model`: MF (if none is given), MG, MH or MS. `settings`: what it holds at power-up, integers as sent: the control
    parameters by their field names, `encoder_zero` (counts), `encoder_bits` (14, 15, 16 or 18) and `baud_rate`.
    `angle`: where the shaft stands at first (deg).

    Raises UsageError for a setting that it does not have or cannot hold, ValueError for an unknown model.
    """

    motor: LkMotor

    def __init__(
        self, dialect: Dialect = DIALECT, address: int = 1, *, model: str = "", angle: float = 0.0, **options: Unpack[Options]
    ) -> None:
        spoken = dialect.for_model((model or dialect.model or DEFAULT_MODEL).upper())
        super().__init__((Responder(spoken),), address, **options)
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

    def _checked(self, given: Mapping[str, int]) -> dict[str, int]:
        (asked,) = self.dialect.motions(MotionKind.TORQUE)
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

    @property
    def listening(self) -> bool:
        """Whether the supply is enough to answer."""
        return self.volts >= OFF_VOLTS

    def answers_to(self, message: Message, own: bool) -> bool:
        """Say whether the drive answers a frame that it has taken: there is no broadcast, so that it always does."""
        return True

    def tolerates(self, command: Command, violation: Violation) -> bool:
        """Say whether the drive overlooks what a request breaks: reserved bits."""
        return violation.rule == "reserved_bits"

    def unfit(self, frame: Frame) -> None:
        """Echo a frame that no command is for; only a fault takes one."""
        self._outbox.append(self._ready(frame.data))

    def behave(self, request: Request) -> Values | None:
        act, fields = self.acts.get(request.command.name), request.form.layout.named
        # Only a fault asks for what the bits of a field do not hold.
        if act is not None and all(fields[n].wire_minimum <= v <= fields[n].wire_maximum for n, v in request.values.items()):
            act(self, request)
        return self.refused(request)

    def refused(self, request: Request) -> Values | None:
        """Return the values of the reply, which is the same whether the request is obeyed or not."""
        answer = self.answers.get(request.command.name)
        return self.readings(request.command) if answer is None else answer(self, request)

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

    def learn(self, command: Command, act: Act | None = None, answer: Answer | None = None) -> None:
        """Take on a command that the dialect or the model does not have, as a quirk or a fault does."""
        others = tuple(c for c in self.dialect.commands if c.name != command.name)
        self._speak((*others, command))
        if act is not None:
            self.acts[command.name] = act
        if answer is not None:
            self.answers[command.name] = answer

    def forget(self, *names: str) -> None:
        """Drop commands, as a quirk does."""
        self._speak(tuple(c for c in self.dialect.commands if c.name not in names))

    def _speak(self, commands: tuple[Command, ...]) -> None:
        """Have these commands and no others."""
        self.dialect = replace(self.dialect, commands=commands)
        self.responders = (Responder(self.dialect),)

    # --- time -----------------------------------------------------------------------------------------------------

    def reach(self, t_ns: int) -> None:
        super().reach(t_ns)
        self.motor.to(t_ns)

    def foresee(self) -> tuple[int, Callable[[], None]] | None:
        """Return when the ramps under way end or the motor stalls, and what the drive does then."""
        settles_ns, stalls_ns = self.motor.settles_ns, self.motor.stalls_ns
        if stalls_ns is not None and stalls_ns > self.now_ns and (settles_ns is None or stalls_ns <= settles_ns):
            return stalls_ns, self._stall
        return None if settles_ns is None else (settles_ns, _nothing)

    def _stall(self) -> None:
        self._raise({"stalled"})

    @property
    def counts_per_turn(self) -> int:
        """What the encoder counts in a turn, as it is sent."""
        return self.motor.encoder_scale

    @property
    def rest(self) -> Rest:
        at_ns, way = self.motor.rests
        return Rest(at_ns, self.now_ns - at_ns, way, self.motor.motion.speed / 6)

    def hold(self, settings: Mapping[str, int]) -> None:
        for name, value in settings.items():
            if name in self.parameters:
                self.keep(name, value)

    def stand(self, told: Mapping[str, int]) -> None:
        if "encoder_raw" in told:
            motor, raw = self.motor, told["encoder_raw"]
            angle = told.get("angle", 0) / 36_000
            widths = {w: told["encoder"] / (1 << min(w, 16)) for w in (self._build.encoder_bits, *ENCODER_WIDTHS)}
            width = min(widths, key=lambda w: round(abs((widths[w] - angle + 0.5) % 1 - 0.5), 3))
            motor.rebuilt(encoder_bits=width)
            motor.shift(raw * 360 / motor.encoder_scale - motor.motion.angle % 360)
            motor.encoder_zero = self.settings["encoder_zero"] = told["encoder_offset"]
            motor.set_position(told["position"] / 100)
        elif "position" in told:
            self.motor.shift(told["position"] / 100 - self.motor.position)

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

    def keep(self, name: str, value: int) -> None:
        """Keep a value: a control parameter until the power goes, a setting beyond that."""
        if name in self.parameters:
            self.parameters[name] = value
            self.motor.limit(self.limits)
        else:
            super().keep(name, value)

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
        self.changed()

    # --- what happens to it ---------------------------------------------------------------------------------------

    def block(self, blocked: bool = True) -> None:
        """Hold the shaft by hand, or let go."""
        self.motor.hold(blocked=blocked)
        self.changed()

    def turn_shaft(self, degrees: float) -> None:
        """Turn the shaft by hand (clockwise positive)."""
        self.motor.twist(degrees)
        self.changed()

    def supply(self, volts: float) -> None:
        """Set the supply: below `OFF_VOLTS` the drive is dead, and powers up when there is more again."""
        was_listening = self.listening
        self.volts = volts
        if self.listening and not was_listening:
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
