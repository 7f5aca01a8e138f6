"""How far, how fast, how hard: what a reading would make a drive do, from the fields that the catalogue declares.

    speed          fields in rpm: the real rpm of the shaft, which depends on the subdivision; deg/s: a sixth of it
    turns          relative moves by their length; absolute ones from where the drive is; within one turn: one
    acceleration   as sent, 1..255, where 0 means at once and is above every bound
    current        fields in mA, or in A once the model is known

What is not in the frame has to be known: `Knowledge` has what was told (`note_...`) and what was sent since, and of
several possibilities the worst counts. What cannot be told is no bounded command: it is refused, and said why. An unknown
subdivision counts as 1 (the real rpm is then 16 times what is sent).

A stop is never bounded. A run without an end has no length: that it may be sent is what the risk `unbounded` says.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from analyzer.catalogue import Dialect, Risk, Verb
from analyzer.layout import Field
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.gate.interpretations import Reading

DEGREES = 360.0
#: Full steps of a turn of the shaft; finer motors turn less for the same pulses.
STEPS_PER_TURN = 200
#: Subdivisions at which a speed as sent is that of the shaft, and the factor for all others.
PLAIN_SUBDIVISIONS = frozenset({16, 32, 64})
SPEED_SUBDIVISION = 16
_LARGEST_SUBDIVISION = 256

STOPS = frozenset(
    {
        Verb.STOP,
        Verb.EMERGENCY_STOP,
        Verb.STOP_SPEED,
        Verb.STOP_RELATIVE_PULSES,
        Verb.STOP_ABSOLUTE_PULSES,
        Verb.STOP_RELATIVE_AXIS,
        Verb.STOP_ABSOLUTE_AXIS,
    }
)
RUNS = frozenset({Verb.RUN_SPEED, Verb.RUN_TORQUE, Verb.RUN_OPEN_LOOP})
MOVES = frozenset(
    {
        Verb.MOVE_RELATIVE_PULSES,
        Verb.MOVE_ABSOLUTE_PULSES,
        Verb.MOVE_RELATIVE_AXIS,
        Verb.MOVE_ABSOLUTE_AXIS,
        Verb.MOVE_SINGLE_TURN,
    }
)
#: What turns the shaft by rules of its own.
OWN_WAYS = frozenset({Verb.HOME, Verb.CALIBRATE})
#: After these the position that was known is another one, or counted from elsewhere.
_FORGET = OWN_WAYS | {Verb.SET_ZERO, Verb.CLEAR_TURNS, Verb.RESTART, Verb.RESTORE, Verb.ENABLE, Verb.MOTOR_OFF, Verb.OTHER}
_MOVING_RISKS = frozenset({Risk.MOTION, Risk.UNBOUNDED})


@dataclass(frozen=True)
class Bounds:
    """What one command may do at most. None: no bound. `speed` rpm, `acceleration` as sent (1..255), `current` mA."""

    speed: float | None = None
    turns: float | None = None
    acceleration: float | None = None
    current: float | None = None

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return any(b is not None for b in (self.speed, self.turns, self.acceleration, self.current))


@dataclass
class _Drive:
    """What is known of one drive: the values that a setting may have, and where the shaft may be, low and high."""

    subdivisions: set[int] = field(default_factory=lambda: {1})
    home_speeds: set[int] = field(default_factory=set)
    degrees: tuple[float, float] | None = None
    pulses: tuple[int, int] | None = None
    running_rpm: float = 0.0
    since_ns: int = 0


class Knowledge:
    """What is known of the drives on a line. `subdivision`: what all of them are set to, None: unknown."""

    def __init__(self, subdivision: int | None = None) -> None:
        self._subdivision = subdivision or 1
        self._drives: dict[int | None, _Drive] = {}

    def _of(self, address: int | None) -> _Drive:
        found = self._drives.get(address)
        if found is None:
            found = self._drives[address] = _Drive({self._subdivision})
        return found

    # --- what is told ---------------------------------------------------------------------------------------------

    def note_subdivision(self, value: int, address: int | None = None) -> None:
        """Take it that a drive (None: every drive) is set to a subdivision; 0 stands for 256."""
        value = value or _LARGEST_SUBDIVISION
        if address is None:
            self._subdivision = value
            for drive in self._drives.values():
                drive.subdivisions = {value}
        self._of(address).subdivisions = {value}

    def note_position(self, degrees: float, address: int, pulses: int | None = None) -> None:
        """Take it that the shaft of a drive stands at `degrees` over all turns, and at a count of pulses where known."""
        drive = self._of(address)
        drive.degrees = (degrees, degrees)
        drive.pulses = None if pulses is None else (pulses, pulses)

    # --- what a reading would do ----------------------------------------------------------------------------------

    def problems(self, reading: Reading, bounds: Bounds) -> list[str]:
        """Return how a reading is beyond the bounds, or that nobody can tell; empty where it is within them."""
        if not bounds.given or reading.command is None or reading.reads_only or reading.command.verb in STOPS:
            return []
        told = [self._speed(reading, bounds.speed), self._turns(reading, bounds.turns)]
        told += [self._acceleration(reading, bounds.acceleration), self._current(reading, bounds.current)]
        return [text for text in told if text]

    def rpm(self, reading: Reading) -> float | None:
        """Return the highest rpm that a reading may make the shaft turn at; None where nobody can tell."""
        command, form = reading.command, reading.form
        if command is None or form is None:
            return None
        speeds = []
        for name, declared in form.layout.named.items():
            if declared.unit not in ("rpm", "deg/s") or declared.fixed is not None:
                continue
            value = reading.values.get(name)
            if value is None or (name == "max_speed" and value == 0):
                return None
            physical = abs(float(declared.physical(value)))
            speeds.append(self._real(reading, physical) if declared.unit == "rpm" else physical / 6)
        if speeds:
            return max(speeds)
        if command.verb is Verb.HOME:
            known = self._of(reading.address).home_speeds
            return max(self._real(reading, float(s)) for s in known) if known else None
        return None if moves(reading) else 0.0

    def _real(self, reading: Reading, rpm: float) -> float:
        """Return the rpm of the shaft for a speed as sent, at the worst subdivision the drive may be set to."""
        if not has_subdivision(reading.dialect):
            return rpm
        return max(
            rpm if s in PLAIN_SUBDIVISIONS else rpm * SPEED_SUBDIVISION / s for s in self._of(reading.address).subdivisions
        )

    def turns(self, reading: Reading) -> float | None:
        """Return how many turns a reading makes the shaft turn at most; None where nobody can tell."""
        command, form = reading.command, reading.form
        if command is None or form is None:
            return None
        verb = command.verb
        if verb not in MOVES:
            return None if moves(reading) else 0.0
        if verb is Verb.MOVE_SINGLE_TURN:
            return 1.0
        name = next((n for n in ("pulses", "position") if n in form.layout.named), "")
        value = reading.values.get(name)
        if value is None:
            return None
        drive = self._of(reading.address)
        if verb in (Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_ABSOLUTE_PULSES):
            pulses = abs(value) if verb is Verb.MOVE_RELATIVE_PULSES else _farthest(drive.pulses, value)
            return None if pulses is None else pulses / (STEPS_PER_TURN * min(drive.subdivisions))
        degrees = _degrees(form.layout.named[name], value)
        if verb is Verb.MOVE_RELATIVE_AXIS:
            return abs(degrees) / DEGREES
        farthest = _farthest(drive.degrees, degrees)
        return None if farthest is None else farthest / DEGREES

    # --- bound by bound -------------------------------------------------------------------------------------------

    def _speed(self, reading: Reading, bound: float | None) -> str:
        if bound is None:
            return ""
        rpm = self.rpm(reading)
        if rpm is None:
            return f"its speed cannot be told from the frame{_hint(reading)}, and --max-speed is {bound:g} rpm"
        if rpm <= bound:
            return ""
        if has_subdivision(reading.dialect) and 1 in self._of(reading.address).subdivisions:
            unknown = "while the subdivision is not known (tell it: --subdivision N)"
            return f"up to {rpm:g} rpm {unknown}, above --max-speed {bound:g}"
        return f"{rpm:g} rpm, above --max-speed {bound:g}"

    def _turns(self, reading: Reading, bound: float | None) -> str:
        if bound is None or not moves(reading) or Risk.UNBOUNDED in reading.risks:
            return ""
        turns = self.turns(reading)
        if turns is None:
            return f"how far it turns cannot be told without the drive's position, and --max-turns is {bound:g}"
        return f"{turns:.4g} turns, above --max-turns {bound:g}" if turns > bound else ""

    @staticmethod
    def _acceleration(reading: Reading, bound: float | None) -> str:
        if bound is None or reading.form is None:
            return "" if bound is None or not moves(reading) else "its acceleration has not come yet"
        declared = reading.form.layout.named.get("acceleration")
        if declared is None:
            return ""
        value = reading.values.get("acceleration")
        if value is None:
            return "its acceleration has not come yet"
        if value == 0:
            return f"acceleration 0 is at once, above --max-acceleration {bound:g}"
        return f"acceleration {value}, above --max-acceleration {bound:g}" if value > bound else ""

    @staticmethod
    def _current(reading: Reading, bound: float | None) -> str:
        if bound is None or reading.form is None:
            return ""
        for name, declared in reading.form.layout.named.items():
            if not _is_current(name, declared):
                continue
            value = reading.values.get(name)
            if declared.unit not in ("mA", "A") or value is None:
                return f"{name} in mA is not known without the drive's model, and --max-current is {bound:g} mA"
            milliamperes = abs(float(declared.physical(value))) * (1000 if declared.unit == "A" else 1)
            if milliamperes > bound:
                return f"{name} {milliamperes:g} mA, above --max-current {bound:g}"
        return ""

    # --- what was sent --------------------------------------------------------------------------------------------

    def learn(self, reading: Reading, now_ns: int) -> None:
        """Take it that a reading has left and that a drive may have obeyed."""
        command = reading.command
        if command is None or reading.reads_only:
            return
        for drive in self._concerned(reading):
            if command.verb in STOPS or moves(reading):
                drive.running_rpm, drive.since_ns = 0.0, now_ns
            if command.verb is Verb.RUN_SPEED:
                drive.running_rpm = self.rpm(reading) or 0.0
            if command.verb in RUNS | _FORGET:
                drive.degrees = drive.pulses = None
            elif command.verb in MOVES:
                self._shift(drive, reading)
            self._settings(drive, reading)

    def run_turns(self, reading: Reading, now_ns: int) -> float:
        """Return the turns that a drive has made in the run that this reading ends, as far as any."""
        minutes = [d.running_rpm * (now_ns - d.since_ns) / 60e9 for d in self._concerned(reading)]
        return max(minutes, default=0.0)

    def _concerned(self, reading: Reading) -> list[_Drive]:
        if reading.slot or not reading.to_many:
            return [self._of(reading.address)]
        return list(self._drives.values())

    @staticmethod
    def _shift(drive: _Drive, reading: Reading) -> None:
        command, form = reading.command, reading.form
        assert command is not None
        value = reading.values.get("position")
        known = drive.degrees
        drive.degrees = drive.pulses = None
        if known is None or value is None or form is None or form.layout.named["position"].unit == "pulses":
            return
        # It may have been refused, or be under way.
        low, high = known
        degrees = _degrees(form.layout.named["position"], value)
        ends = (degrees,) if command.verb is Verb.MOVE_ABSOLUTE_AXIS else (low + degrees, high + degrees)
        drive.degrees = (min(low, *ends), max(high, *ends))

    @staticmethod
    def _settings(drive: _Drive, reading: Reading) -> None:
        command, values = reading.command, reading.values
        assert command is not None
        if command.verb is Verb.SET_SUBDIVISION:
            drive.subdivisions.add(values.get("subdivision", 1) or _LARGEST_SUBDIVISION)
        elif command.verb is Verb.SET_HOME and "home_speed" in values:
            drive.home_speeds.add(values["home_speed"])
        elif command.verb is Verb.RESTORE:
            drive.subdivisions.add(SPEED_SUBDIVISION)
            drive.home_speeds.clear()


def moves(reading: Reading) -> bool:
    """Say whether a reading makes the shaft go somewhere, stops aside."""
    command = reading.command
    if command is None:
        return False
    if command.verb in MOVES | RUNS | OWN_WAYS:
        return True
    return command.verb is Verb.OTHER and bool(reading.risks & _MOVING_RISKS)


def has_subdivision(dialect: Dialect) -> bool:
    """Say whether the drives of a dialect turn at another speed than is sent, by their subdivision."""
    return Verb.SET_SUBDIVISION in dialect.by_verb


def _degrees(declared: Field, value: int) -> float:
    if declared.unit == "counts":
        return value * DEGREES / COUNTS_PER_TURN
    return float(declared.physical(value))


def _farthest(known: tuple[float, float] | None, target: float) -> float | None:
    return None if known is None else max(abs(target - known[0]), abs(target - known[1]))


def _is_current(name: str, declared: Field) -> bool:
    return declared.unit == "mA" or name.endswith("current") or name in ("torque_limit", "power")


def _hint(reading: Reading) -> str:
    assert reading.command is not None
    if reading.command.verb is Verb.HOME:
        return " (set_home says it, if it is sent first)"
    return ""
