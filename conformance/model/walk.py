"""A walk: steps that are done to a drive under test and to its twin (`model.twin`), whose replies are compared.

    walk = Walk(probe)                                  brings the drive into a known state, and makes the twin like it
    walk.do(Step("set_subdivision", {"subdivision": 8}))     raises Refuted where the two differ
    walk.do(Step("look", {"first": 3, "count": 4}))          some of the reads, compared
    walk.do(Step("aside", {"aside": 2}))                     a frame that changes nothing

A step that is no read goes this way:

    let_end           a move that was left to itself ends, if it is near its end              `model.settling`
    _values           amounts of a motion as what is sent, within the bounds
    addressed         to the drive, to all, to its group or in a package                      `model.asides`
    meanwhile         looks at other reads, while a setting has to wait                       `model.looks`
    ask_built, hear   the same bytes to the drive and to its twin
    compare_reply     Refuted where the replies differ                                        `model.pair`, `model.comparing`
    _follow           both come to rest or have their speed, looked at on the way             `model.settling`, `model.looks`
                      the twin takes over what the manual leaves open                         `model.adopting`
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analyzer.catalogue import Command, MotionKind, Risk, Verb
from conformance.claim import NotRun
from conformance.gate.gate import Refused as GateRefused
from conformance.model import adopting, settling
from conformance.model.asides import Way, addressed, spoiled
from conformance.model.looks import Looks
from conformance.model.pair import Pair
from conformance.model.steps import ASIDE, LEAVE, LOOK, SPOILED, WAY, Step, beginning
from conformance.motion import declared, motion
from conformance.motion.declared import MOVES, QUICK, SUBDIVISION
from conformance.talk.probe import MS, Probe, Until
from conformance.talk.restarts import wait_for_answer

#: How often a command that is no read is sent at most, where it is not answered.
_TOLD = 2
#: What sets the shaft going.
_TURNING = frozenset({MotionKind.RUN, MotionKind.HOME, *MOVES})
#: What may leave the shaft a little elsewhere, or anywhere if it turned.
_LOOSENS = frozenset(
    {
        Verb.ENABLE,
        Verb.MOTOR_ON,
        Verb.MOTOR_OFF,
        Verb.BRAKE,
        Verb.SET_WORK_MODE,
        Verb.RESTART,
        Verb.RELEASE_PROTECTION,
        Verb.CLEAR_TURNS,
    }
)
#: What gives the place of an LK shaft another name.
_RENAMES = frozenset({"set_position", "clear_turns"})


class Walk:
    """One drive and its twin. `steps`: what was done."""

    def __init__(self, probe: Probe) -> None:
        self.pair = Pair(probe)
        self.steps = self.pair.steps
        self._probe, self._dialect, self._course = probe, probe.dialect, self.pair.course
        self._looks = Looks(self.pair)
        self._begin()

    def _begin(self) -> None:
        motion.ready_to_move(
            self._probe, declared.bus_modes(self._dialect)[-1] if Verb.SET_WORK_MODE in self._dialect.by_verb else ""
        )
        motion.stand_still(self._probe)
        adopting.settings(self.pair)
        adopting.place(self.pair, anywhere=True)
        for step in beginning(self._dialect):
            self.do(step)
        adopting.place(self.pair, anywhere=True)
        adopting.own(self.pair, *self._looks.reads)
        self.steps.clear()
        self.pair.unasked.forget()

    def do(self, step: Step) -> None:
        """Do a step. Raises Refuted where the drive is not what its twin is."""
        self.steps.append(step)
        if step.name == LOOK:
            self._looks.some(step.values["first"], step.values["count"])
            return
        if step.name == ASIDE:
            self.pair.send_aside(step.values[ASIDE])
            return
        command = self._dialect.by_name[step.name]
        if command.verb in self.pair.missing:
            self.steps.pop()
            return
        if command.all_risks == {Risk.READ}:
            self.pair.look(command, step.values)
            return
        try:
            self._do(command, step.values)
        except (GateRefused, NotRun):
            # This is no step: its bytes could be read as a frame that is not allowed, its values are beyond the bounds, or
            # the old value is not known.
            self.steps.pop()

    def _do(self, command: Command, given: Mapping[str, int]) -> None:
        pair, probe = self.pair, self._probe
        settling.let_end(pair)
        values = self._values(command, given)
        if values.get(pair.twin.drive.group_setting) == probe.address:
            raise NotRun("no manual says what a drive is that is in a group of its own address")
        way = self._way(given)
        built = addressed(probe, command, values, way, pair.group)
        if not built.risks <= probe.rig.allowed | {Risk.READ}:
            raise NotRun("not allowed")
        if given.get(SPOILED):
            pair.send_beside(spoiled(self._dialect, built, given[SPOILED]))
            return
        if Risk.SETTING in built.risks:
            self._looks.meanwhile()
            settling.let_end(pair)
        was_turning = pair.twin.turning
        self._set_going(command, given)
        silent = bool(way) or pair.twin.drive.silenced(command)
        until, timeout_ns = (Until.TIMEOUT, probe.noise.silence_ns) if silent else (Until.REPLY, None)
        before, scale = dict(pair.twin.drive.settings), 360 / (200 * getattr(pair.twin.drive, "subdivision", 1))
        for _ in range(_TOLD):
            exchange = probe.ask_built(built, until=until, timeout_ns=timeout_ns, quiet_ns=0)
            # A request that the line loses does nothing. The second one is the drive's word.
            if silent or not exchange.unanswered:
                break
            pair.lossy = True
        told = pair.twin.hear(built.item(), pair.twin_ns(exchange.sent_ns))
        pair.compare_reply(command, exchange, told)
        if not silent and not probe.refused(exchange):
            pair.comparing.untold -= values.keys()
        self._follow(command, given, was_turning, before)
        if command.verb in (Verb.SET_SUBDIVISION, Verb.SET_DIRECTION):
            adopting.pulses(pair, scale)
        if command.name in _RENAMES and not pair.twin.turning:
            # Where the drive was beside its twin when the place was named it is from then on.
            for verb in adopting.ENCODER:
                pair.look(self._dialect.by_verb[verb])
            adopting.encoder(pair)

    def _way(self, given: Mapping[str, int]) -> int:
        """Return how a step is sent: to the drive alone if no other way is open, or if the line loses frames."""
        way = given.get(WAY, Way.OWN)
        other = self._probe.gate.allowance.alone and not self.pair.lossy and (way != Way.GROUP or self.pair.group)
        return way if other else Way.OWN

    def _values(self, command: Command, given: Mapping[str, int]) -> dict[str, int]:
        """Return the values of a step as they are sent; those of a motion are its amounts, within the bounds."""
        told = command.motion
        if told is None or told.kind is MotionKind.STOP or not (told.speed or told.distance):
            return {name: value for name, value in given.items() if name not in (LEAVE, WAY, ASIDE, SPOILED)}
        bounds = self._probe.gate.allowance.bounds
        rpm, acceleration = given.get("rpm", 0), given.get("acceleration", QUICK)
        if bounds.speed is not None:
            rpm = max(-int(bounds.speed), min(int(bounds.speed), rpm))
        if bounds.acceleration is not None:
            acceleration = min(acceleration, int(bounds.acceleration))
        values = declared.values_of(
            self._dialect,
            command,
            given.get("degrees", 0),
            rpm=rpm,
            acceleration=acceleration,
            subdivision=getattr(self.pair.twin.drive, "subdivision", SUBDIVISION),
            start=motion.place(self._probe, command),
        )
        # Numbers as they are sent are in place of degrees and rpm.
        sent = {name: given[name] for name in (told.distance, told.speed) if name in given}
        if not told.speed or told.speed in sent:
            return values | sent
        return values | sent | {told.speed: min(values[told.speed], declared.field_of(command, told.speed).high)}

    def _set_going(self, command: Command, given: Mapping[str, int]) -> None:
        """Take note of when a motion begins, and how fast it goes."""
        if command.motion is None:
            return
        course, turning, kind = self._course, self.pair.twin.turning, command.motion.kind
        course.from_rest = self._dialect.ramp is not None and not turning and kind in MOVES
        if kind in _TURNING:
            if not turning:
                course.begun_ns, course.pace = self.pair.twin_ns(self._probe.gate.now_ns()), 0.0
            # A speed as sent may be beyond the fastest.
            sent = declared.field_of(command, command.motion.speed).high if command.motion.speed in given else 0
            course.pace = max(course.pace, 6.0 * abs(given.get("rpm") or sent or self._home_rpm))

    @property
    def _home_rpm(self) -> float:
        drive: Any = self.pair.twin.drive
        return float(drive.real_speed(drive.settings["home_speed"]))

    # --- what comes of it ---------------------------------------------------------------------------------------------

    def _follow(self, command: Command, given: Mapping[str, int], was_turning: bool, before: Mapping[str, int]) -> None:
        """Wait until both drives have done what they were told to; the twin takes over what the manual leaves open."""
        pair, course, verb, twin = self.pair, self._course, command.verb, self.pair.twin
        kind = command.motion.kind if command.motion is not None else None
        if verb is Verb.RESTART:
            self._restart()
        if verb in _LOOSENS or (was_turning and kind is not None and kind is not MotionKind.MOVE_TO):
            course.loose = True
        if verb is Verb.SET_ZERO:
            pair.comparing.pulse_degrees = 0.0
        if kind in (MotionKind.RUN, MotionKind.HOME) and twin.turning:
            course.running, course.loose, course.left_going = True, True, False
            settling.steady(pair, self._looks, given)
            return
        if verb is Verb.MOTOR_OFF:
            # It runs out.
            course.running = False
        elif kind is not None or not twin.turning:
            # A stop that was refused stops nothing.
            course.running = course.running and twin.turning and twin.drive.next_ns() is None
        if course.running or (given.get(LEAVE) and twin.turning):
            course.left = command.code if kind in _TURNING else course.left
            course.left_going = self._dialect.ramp is not None and not course.running
            return
        course.left_going, course.rising, course.rpm = False, False, 0
        if self._dialect.ramp is not None and twin.turning:
            self._looks.on_the_way(given.get(ASIDE, 0))
        if twin.turning or was_turning or kind in (MotionKind.STOP, *MOVES):
            settling.rest(pair, watched=was_turning, lawful=kind in (MotionKind.STOP, *MOVES))
        if course.loose:
            adopting.place(pair, anywhere=was_turning or verb in (Verb.RESTART, Verb.CLEAR_TURNS))
            if verb is Verb.RESTART or (verb is Verb.SET_WORK_MODE and self._open_enabling(before)):
                adopting.enabled(pair)
            if verb is Verb.RESTART and Verb.READ_ZERO_STATUS in self._dialect.by_verb:
                # Whether a zero is kept for power-on no read tells, and a motor that is off does not go back to it.
                adopting.own(pair, self._dialect.by_verb[Verb.READ_ZERO_STATUS])

    def _restart(self) -> None:
        """Wait until both drives have started again."""
        pair, twin = self.pair, self.pair.twin
        wait_for_answer(self._probe)
        twin.wait(pair.twin_ns(self._probe.gate.now_ns()))
        while not twin.drive.listening:
            twin.wait(twin.now_ns + 10 * MS)
        pair.anchor()
        self._course.running = False

    def _open_enabling(self, before: Mapping[str, int]) -> bool:
        """Say whether the manual leaves open if another mode enables the motor. `before`: the settings until then."""
        now = self.pair.twin.drive.settings
        return "axis_lock" not in now or before.get("work_mode") == now.get("work_mode")
