"""How the reply of a drive is compared with that of its twin (`model.twin`): what may differ, and by how much.

    comparing = Comparing(probe, course)
    comparing.different(command, answer, told, twin)     the names of the fields that differ by more than they may

Rules kept here:
- What is discrete must be the same: status, settings, flags, reserved bits.
- Places, speeds and errors are compared through the resolution and the measured noise, of a shaft that stands or has its speed.
- On its way a shaft may be off by the share that clocks differ by. Without a law of ramps nothing is said of it there.
- No manual promises currents, voltages or temperatures.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Verb
from analyzer.layout import Field
from conformance.model.twin import Told, Twin
from conformance.talk.exchange import Answer
from conformance.talk.noise import CLOCK_SHARE

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: Units and fields of what no manual promises.
_UNPROMISED = frozenset({"V", "A", "degC"})
_UNPROMISED_FIELDS = frozenset(
    {"power", "torque_current", "phase_a_current", "phase_b_current", "phase_c_current", "temperature", "current"}
)
_PLACES = frozenset({"counts", "turns", "deg", "pulses"})
_SPEEDS = frozenset({"rpm", "deg/s"})
_PASSING = _PLACES | _SPEEDS
#: Angles within the turn, and what is told of a shaft that turns.
_IN_TURN = frozenset({"encoder", "encoder_raw", "angle"})
_OF_MOTION = frozenset({"status", "pend"})
#: The rule of bits that are always 0.
_RESERVED = "reserved_bits"
#: At which level of its pin a motor is enabled in pulse modes.
_EN_LEVEL = "enable_level"


@dataclass
class Course:
    """What the shafts of a drive and its twin do.

    `running`: they have a speed without an end; `rising`: one that they have yet to reach. `left_going`: a move goes on that
    was left to itself. `from_rest`: the motion is a move that began at rest, of which the law tells each place. `loose`: the
    manual does not say where the shaft comes to rest. `begun_ns`: when the motion began, on the twin's clock; `pace`: its
    highest speed, in degrees per second. `rpm`: the speed of the last run. `left`: the code of the last motion that was left
    to itself.
    """

    running: bool = False
    rising: bool = False
    left_going: bool = False
    from_rest: bool = False
    loose: bool = False
    begun_ns: int = 0
    pace: float = 0.0
    rpm: float = 0
    left: int = -1


class Comparing:
    """What of the replies of a drive differs from those of its twin."""

    def __init__(self, probe: Probe, course: Course) -> None:
        self._probe, self._dialect, self._course = probe, probe.dialect, course
        #: Commands and fields whose values are the drive's own, and are not compared.
        self.own: set[tuple[str, str]] = set()
        #: Settings, by field, that the drive does not tell and that were not set.
        self.untold = set() if Verb.READ_PARAMETER in self._dialect.by_verb else {_EN_LEVEL}
        #: By how many degrees the count of pulses of the twin may be off.
        self.pulse_degrees = 0.0

    def different(self, command: Command, answer: Answer, told: Told, twin: Twin, spare: float = 0.0) -> list[str]:
        """Return the fields in which a reply differs from that of the twin. `spare`: degrees that a place may be off beside."""
        if answer.data == told.data:
            return []
        form = answer.message.form
        assert form is not None  # it can be read
        if not answer.values or not answer.values.keys() <= told.values.keys():
            return [] if answer.bare else ["the reply"]
        reserved = [_RESERVED] * any(v.rule == _RESERVED for v in answer.message.violations)
        return reserved + [
            name
            for name, field in form.layout.named.items()
            if (command.name, name) not in self.own
            and field.unit not in _UNPROMISED
            and name not in _UNPROMISED_FIELDS
            and not (name == "enabled" and self._by_pin(twin))
            and not self._same(command, field, answer.values, told.values, spare, twin)
        ]

    def only_passing(self, command: Command, different: Iterable[str]) -> bool:
        """Say whether what differs passes while the shaft turns, at a speed that changes or to a place."""
        fields = command.reply_forms[0].layout.named
        units = _PASSING if self._course.from_rest else _SPEEDS
        return all(name in fields and (fields[name].unit in units or name in _OF_MOTION) for name in different)

    def _by_pin(self, twin: Twin) -> bool:
        """Say whether a pin of unknown level enables the motor, as one does in pulse modes."""
        drive: Any = twin.drive
        return _EN_LEVEL in self.untold and Verb.SET_ENABLE_LEVEL in self._dialect.by_verb and not drive.by_bus

    def _same(
        self, command: Command, field: Field, got: Mapping[str, int], told: Mapping[str, int], spare: float, twin: Twin
    ) -> bool:
        """Say whether a field is what the twin tells, or as near to it as it has to be."""
        name, known = field.name, self._dialect.ramp is not None
        if got[name] == told[name] and name != "carry":
            return True
        if field.unit in _SPEEDS:
            steady = self._course.running and not self._course.rising and command.motion is None
            if twin.turning and not steady and (not known or self._probe.noise.live):
                return True
            return self._same_speed(field, got[name], told[name])
        if field.unit in _PLACES:
            if twin.turning and (not known or name == "angle_error"):
                return True
            return self._same_place(field, got, told, spare, twin)
        return name in _OF_MOTION and twin.turning and not known and not self._course.running

    def _same_speed(self, field: Field, got: int, told: int) -> bool:
        rpm = _rpm(field, told)
        return abs(_rpm(field, got) - rpm) <= self._probe.within("rpm", rpm) + abs(rpm) * 2 * CLOCK_SHARE

    def _same_place(self, field: Field, got: Mapping[str, int], told: Mapping[str, int], spare: float, twin: Twin) -> bool:
        name, drive = field.name, twin.drive
        if name == "encoder" and "carry" in got:
            # The carry is compared with it.
            return True
        degrees, turn = degrees_of(drive, field), drive.counts_per_turn
        away = (got[name] - told[name]) * degrees
        if name == "carry":
            away += (got["encoder"] - told["encoder"]) * 360 / turn
            degrees = 360 / turn
        elif name in _IN_TURN:
            away = (away + 180) % 360 - 180
            # The twin's shaft is where the position says, which each drive counts from where it was when it was named.
            spare += self._probe.noise.place
        gone_ns = twin.now_ns - self._course.begun_ns if twin.turning else 0
        # When a drive hears a request, and looks, the line does not tell to less than a reply takes.
        unsure_ns = self._probe.noise.latency_ns if twin.turning else 0
        spare += self._course.pace * (gone_ns * CLOCK_SHARE + unsure_ns) / 1e9
        return abs(away) <= self._probe.within("degrees") + degrees + spare + self.pulse_degrees


def _rpm(field: Field, value: int) -> float:
    return float(field.physical(value)) / (6 if field.unit == "deg/s" else 1)


def degrees_of(drive: Any, field: Field) -> float:
    """Return the degrees of one of a field as sent."""
    if field.unit == "deg":
        return float(field.scale)
    if field.unit == "pulses":
        return 360 / (200 * int(drive.subdivision))
    return 360.0 if field.unit == "turns" else 360 / int(drive.counts_per_turn)
