"""A walk: steps that are done to a drive under test and to its twin (`model.twin`), whose replies are compared.

    walk = Walk(probe)                                  brings the drive into a known state, and makes the twin like it
    walk.do(Step("set_subdivision", {"subdivision": 8}))     raises Refuted where the two differ
    walk.do(Step("look", {"first": 3, "count": 4}))          some of the reads, compared
    walk.do(Step("aside", {"aside": 2}))                     a frame that changes nothing

Rules kept here:
- What is discrete must be the same: whether there is a reply, its status, settings, flags. It is compared away from changes.
- Places, speeds and errors are compared through the resolution and the measured noise, of a shaft that stands or has its speed.
- Where the manual leaves open what becomes of the shaft (it is stopped, let go, its mode changes), the twin takes the word
  of the drive. So it does of what differs at the very begin, which no request of the walk has set, and of what power-on does.
- No manual promises currents, voltages or temperatures.
- A number that differs is read again when the shaft surely rests. The twin has a known quirk that explains a reply from
  then on: other claims name it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, MotionKind, Risk, Verb
from analyzer.layout import Field
from conformance.claim import Inconclusive, NotRun, Refuted
from conformance.gate.gate import Refused as GateRefused
from conformance.model.asides import Aside, Way, addressed, aside
from conformance.model.steps import ASIDE, LEAVE, LOOK, WAY, Step, beginning, selectors, steps_text
from conformance.model.twin import Told, Twin
from conformance.model.unasked import Unasked
from conformance.motion import declared, motion, ramp
from conformance.motion.declared import MOVES, QUICK, SUBDIVISION
from conformance.talk.exchange import Answer, Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Until
from conformance.talk.restarts import wait_for_answer

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: Units of what no manual promises.
_UNPROMISED = frozenset({"V", "A", "degC"})
_PLACES = frozenset({"counts", "turns", "deg", "pulses"})
_SPEEDS = frozenset({"rpm", "deg/s"})
#: Until a shaft has settled, one that does not tremble and one that does.
_SETTLES_NS, _TREMBLES_NS = 20 * MS, 120 * MS
#: What a move takes longer than the law at most.
_SLOW, _LATE_NS = 1.07, 150 * MS
#: When a number or a flag that differs is asked again: some drives tell late that they stand.
_AGAIN_NS, _AT_ONCE_NS = (200 * MS, 1_200 * MS), (0, 20 * MS)
#: How often a read is asked for at most, and another command that is not answered.
_ASKED, _TOLD = 4, 2
#: What is left of a motion that is looked at on its way, at least; the time that a frame is given which nobody answers.
_WORTH_NS, _APART_NS = 60 * MS, 6 * MS
#: Reads that fit into the time which a setting has to wait, and the longest that one takes.
_MEANWHILE, _READ_NS = 8, 12 * MS
#: How late what is told unasked was seen to come.
_BEHIND_NS = 800 * MS
#: By then a run has its speed.
_LONG_NS = 100_000 * MS
#: How long a shaft may take to come to rest that its twin's has, and the speed of one that surely turns.
_REST_NS, _TURNS_RPM = 15_000 * MS, 1.5
#: What sets the shaft going.
_TURNING = frozenset({MotionKind.RUN, MotionKind.HOME, *MOVES})
#: A shaft that is let go or held may settle by so many degrees.
_LETS_GO = 2.0
#: A shaft on its way may be so far before its law or behind it.
_SPREAD_NS = 18 * MS
#: What may leave the shaft a little elsewhere, or anywhere if it turned.
_LOOSENS = frozenset(
    {Verb.ENABLE, Verb.MOTOR_ON, Verb.MOTOR_OFF, Verb.BRAKE, Verb.SET_WORK_MODE, Verb.RESTART, Verb.RELEASE_PROTECTION}
)
#: What tells how a speed changes.
_CHANGING = (Verb.READ_STATUS, Verb.READ_SPEED)
#: The rule of bits that are always 0.
_RESERVED = "reserved_bits"
#: What gives the place of an LK shaft another name.
_RENAMES = frozenset({"set_position", "clear_turns"})
#: What tells the place of such a shaft within the turn and over all turns.
_ENCODER = (Verb.READ_ENCODER, Verb.READ_SINGLE_TURN, Verb.READ_POSITION)


class Walk:
    """One drive and its twin. `steps`: what was done."""

    def __init__(self, probe: Probe) -> None:
        self.probe, self.dialect = probe, probe.dialect
        self.steps: list[Step] = []
        self.reads = [c for c in self.dialect.commands if c.all_risks == {Risk.READ} and not c.request_forms[0].layout.named]
        self.running = self._loose = False
        #: Whether a run under way has yet to reach its speed.
        self._rising = False
        #: Whether the line lost or damaged something.
        self._lossy = False
        #: Whether a move goes on that was left to itself.
        self._left_going = False
        #: Which read is next while a setting has to wait, with its values.
        self._next = 0
        self._all_reads: list[tuple[Command, dict[str, int]]] = [(c, {}) for c in self.reads]
        parameters = self.dialect.by_verb.get(Verb.READ_PARAMETER)
        if parameters is not None:
            self._all_reads += [(parameters, {"parameter": number}) for number in selectors(self.dialect)]
        #: Whether the motion under way is a move that began at rest, of which the law tells each place.
        self._from_rest = False
        #: Fields that differed at the begin, and what is told of power-on: the drive's own.
        self._own: set[tuple[str, str]] = set()
        self._missing: set[Verb] = set()
        #: Settings, by field, that the drive does not tell and the walk has not set.
        self._untold = set() if Verb.READ_PARAMETER in self.dialect.by_verb else {_EN_LEVEL}
        self._unasked = Unasked(probe)
        self._rpm: float = 0
        #: The code of the last motion that was left to itself.
        self._left = -1
        #: When the motion under way began, on the clock of the twin, and how fast it goes at most (deg/s).
        self._begun_ns, self._pace = 0, 0.0
        #: By how many degrees the count of pulses of the twin may be off.
        self._pulse_degrees = 0.0
        spread_ns = _SPREAD_NS + probe.noise.latency_ns if self.dialect.ramp is not None else 0
        self.twin = Twin(self.dialect, probe.address, probe.rig.model or self.dialect.model, spread_ns=spread_ns)
        self._shift_ns = self.twin.now_ns - probe.gate.now_ns()
        self._begin()

    # --- the begin ------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        motion.ready_to_move(
            self.probe, declared.bus_modes(self.dialect)[-1] if Verb.SET_WORK_MODE in self.dialect.by_verb else ""
        )
        motion.stand_still(self.probe)
        self._take_settings()
        self._place(anywhere=True)
        for step in beginning(self.dialect):
            self.do(step)
        self._place(anywhere=True)
        self._learn_own(*self.reads)
        self.steps.clear()
        self._unasked.forget()

    def _take_settings(self) -> None:
        """Make the twin hold what the drive holds, as far as it tells."""
        held: dict[str, int] = {}
        for number in selectors(self.dialect):
            answer = self.probe.ask(Verb.READ_PARAMETER, {"parameter": number}, quiet_ns=0).reply
            if answer is None:
                # Other claims judge it.
                self._missing = {Verb.READ_PARAMETER, Verb.WRITE_PARAMETER}
                break
            held |= {} if answer is None else {n: v for n, v in answer.values.items() if n != "parameter"}
        self.twin.change(lambda drive: drive.hold(held))
        self._take_encoder()

    def _take_encoder(self) -> None:
        """Let the encoder of the twin differ from its position by what that of the drive does."""
        if Verb.READ_ENCODER in self.dialect.by_verb:
            told: dict[str, int] = {}
            for read in _ENCODER:
                told |= self.probe.reply(self.probe.ask(read, quiet_ns=0)).values
            self._take(told)

    def _learn_own(self, *commands: Command) -> None:
        """Take what these reads tell otherwise than the twin as the drive's own from now on."""
        for command in commands:
            answer, told = self._asked(command)
            if answer is not None and told is not None:
                self._own |= {(command.name, name) for name in self._different(command, answer, told)}

    # --- steps ----------------------------------------------------------------------------------------------------

    def do(self, step: Step) -> None:
        """Do a step. Raises Refuted where the drive is not what its twin is."""
        self.steps.append(step)
        if step.name == LOOK:
            first, count = step.values["first"], step.values["count"]
            for number in range(count):
                self.look(self.reads[(first + number) % len(self.reads)])
            return
        if step.name == ASIDE:
            self._send_aside(step.values[ASIDE])
            return
        command = self.dialect.by_name[step.name]
        if command.verb in self._missing:
            self.steps.pop()
            return
        if command.all_risks == {Risk.READ}:
            self.look(command, step.values)
            return
        try:
            self._do(command, step.values)
        except (GateRefused, NotRun):
            # This is no step: its bytes could be read as a frame that is not allowed, its values are beyond the bounds, or
            # the old value is not known.
            self.steps.pop()

    def _do(self, command: Command, given: Mapping[str, int]) -> None:
        probe = self.probe
        self._let_end()
        values = {name: value for name, value in given.items() if name not in (LEAVE, WAY, ASIDE)}
        if (
            command.motion is not None
            and command.motion.kind is not MotionKind.STOP
            and (command.motion.speed or command.motion.distance)
        ):
            values = self._values(command, given)
        if values.get(self.twin.drive.group_setting) == probe.address:
            raise NotRun("no manual says what a drive is that is in a group of its own address")
        way = self._way(given)
        built = addressed(probe, command, values, way, self._group)
        if not built.risks <= probe.rig.allowed | {Risk.READ}:
            raise NotRun("not allowed")
        if Risk.SETTING in built.risks:
            self._look_meanwhile()
            self._let_end()
        was_turning = self.twin.turning
        if command.motion is not None:
            law = self.dialect.ramp is not None
            self._from_rest = law and not was_turning and command.motion.kind in MOVES
        if command.motion is not None and command.motion.kind in _TURNING:
            if not was_turning:
                self._begun_ns, self._pace = self._twin_ns(probe.gate.now_ns()), 0.0
            self._pace = max(self._pace, 6.0 * abs(given.get("rpm") or self._home_rpm))
        silent = bool(way) or self.twin.drive.silenced(command)
        until, timeout_ns = (Until.TIMEOUT, probe.noise.silence_ns) if silent else (Until.REPLY, None)
        before, scale = dict(self.twin.drive.settings), 360 / (200 * getattr(self.twin.drive, "subdivision", 1))
        for _ in range(_TOLD):
            exchange = probe.ask_built(built, until=until, timeout_ns=timeout_ns, quiet_ns=0)
            # A request that the line loses does nothing. The second one is the drive's word.
            if silent or not exchange.unanswered:
                break
            self._lossy = True
        told = self.twin.hear(built.item(), self._twin_ns(exchange.sent_ns))
        self._compare_reply(command, exchange, told)
        if not silent and not probe.refused(exchange):
            self._untold -= values.keys()
        self._follow(command, given, was_turning, before)
        if command.verb in (Verb.SET_SUBDIVISION, Verb.SET_DIRECTION):
            self._rescaled(scale)
        if command.name in _RENAMES and not self.twin.turning:
            # Where the drive was beside its twin when the place was named it is from then on.
            for verb in _ENCODER:
                self.look(self.dialect.by_verb[verb])
            self._take_encoder()

    @property
    def _group(self) -> int | None:
        """The group that both drives are in."""
        return self.twin.drive.settings.get(self.twin.drive.group_setting)

    def _way(self, given: Mapping[str, int]) -> int:
        """Return how a step is sent: to the drive alone where no other way is open, or the line loses what nobody answers."""
        way = given.get(WAY, Way.OWN)
        other = self.probe.gate.allowance.alone and not self._lossy and (way != Way.GROUP or self._group)
        return way if other else Way.OWN

    def _send_aside(self, number: int) -> None:
        """Send a frame that changes nothing; what the drive makes of it shows in what is read next."""
        try:
            item = aside(self.probe, number, self._group)
            if number == Aside.UNKNOWN_CODE:
                exchange = self.probe.send(item, until=Until.REPLY, timeout_ns=self.probe.noise.silence_ns)
            else:
                exchange = self.probe.send(item, timeout_ns=_APART_NS)
        except (GateRefused, NotRun):
            return
        self._unasked.expect(self.twin.hear(item, self._twin_ns(exchange.sent_ns)))

    def _look_meanwhile(self) -> None:
        """Look at some of all reads in the time for which the next setting has to wait."""
        probe = self.probe
        for _ in range(_MEANWHILE):
            before_ns = probe.gate.line.setting_ns
            if before_ns is None or before_ns + probe.rig.write_gap_ns - probe.gate.now_ns() < _READ_NS:
                break
            command, values = self._all_reads[self._next % len(self._all_reads)]
            self._next += 1
            if command.verb not in self._missing:
                self.look(command, values)
        before_ns = probe.gate.line.setting_ns
        if before_ns is not None:
            probe.wait(before_ns + probe.rig.write_gap_ns - probe.gate.now_ns())

    def _let_end(self) -> None:
        """Let a motion that was left to itself come to its end if that is near: what is sent while it is told may be lost."""
        self._hear_nothing()
        drive: Any = self.twin.drive
        if self._left_going and (not self.twin.turning or drive.motor.settled - self.twin.now_ns < _WORTH_NS):
            self._left_going = False
            self._rest(watched=True, lawful=False)
            self._place(anywhere=True)

    @property
    def _home_rpm(self) -> float:
        drive: Any = self.twin.drive
        return float(drive.real_speed(drive.settings["home_speed"]))

    def _values(self, command: Command, given: Mapping[str, int]) -> dict[str, int]:
        bounds = self.probe.gate.allowance.bounds
        rpm, acceleration = given.get("rpm", 0), given.get("acceleration", QUICK)
        if bounds.speed is not None:
            rpm = max(-int(bounds.speed), min(int(bounds.speed), rpm))
        if bounds.acceleration is not None:
            acceleration = min(acceleration, int(bounds.acceleration))
        start = motion.place(self.probe, command)
        values = declared.values_of(
            self.dialect,
            command,
            given.get("degrees", 0),
            rpm=rpm,
            acceleration=acceleration,
            subdivision=getattr(self.twin.drive, "subdivision", SUBDIVISION),
            start=start,
        )
        speed = command.motion.speed if command.motion is not None else ""
        return values | ({speed: min(values[speed], declared.field_of(command, speed).high)} if speed else {})

    def _follow(self, command: Command, given: Mapping[str, int], was_turning: bool, before: Mapping[str, int]) -> None:
        """Wait until both drives have done what they were told to; the twin takes over what the manual leaves open."""
        probe, verb, twin = self.probe, command.verb, self.twin
        kind = command.motion.kind if command.motion is not None else None
        if verb is Verb.RESTART:
            wait_for_answer(probe)
            twin.wait(self._twin_ns(probe.gate.now_ns()))
            while not twin.drive.listening:
                twin.wait(twin.now_ns + 10 * MS)
            self._anchor()
            self.running = False
        if (
            verb in _LOOSENS
            or (was_turning and kind is not None and kind is not MotionKind.MOVE_TO)
            or verb is Verb.CLEAR_TURNS
        ):
            self._loose = True
        if verb is Verb.SET_ZERO:
            self._pulse_degrees = 0.0
        if kind in (MotionKind.RUN, MotionKind.HOME) and twin.turning:
            self.running, self._loose, self._left_going = True, True, False
            self._steady(given)
            return
        if verb is Verb.MOTOR_OFF:
            # It runs out.
            self.running = False
        elif kind is not None or not twin.turning:
            # A stop that was refused stops nothing.
            self.running = self.running and twin.turning and twin.drive.next_ns() is None
        if self.running or (given.get(LEAVE) and twin.turning):
            self._left = command.code if kind in _TURNING else self._left
            self._left_going = self.dialect.ramp is not None and not self.running
            return
        self._left_going = False
        self._rpm, self._rising = 0, False
        if self.dialect.ramp is not None and twin.turning:
            self._on_its_way(given.get(ASIDE, 0))
        if twin.turning or was_turning or kind in (MotionKind.STOP, *MOVES):
            self._rest(watched=was_turning, lawful=kind in (MotionKind.STOP, *MOVES))
        if self._loose:
            self._place(anywhere=was_turning or verb in (Verb.RESTART, Verb.CLEAR_TURNS))
            if (verb is Verb.SET_WORK_MODE and self._open_enabling(before)) or verb is Verb.RESTART:
                self._take_enabled()
            if verb is Verb.RESTART and Verb.READ_ZERO_STATUS in self.dialect.by_verb:
                # Whether a zero is kept for power-on no read tells, and a motor that is off does not go back to it.
                self._learn_own(self.dialect.by_verb[Verb.READ_ZERO_STATUS])

    def _on_its_way(self, frame: int) -> None:
        """Look at a motion before its end is told: how it goes there no place at its end tells. `frame`: sent meanwhile."""
        drive: Any = self.twin.drive
        left_ns = int(drive.motor.settled) - self.twin.now_ns - 2 * self.probe.noise.latency_ns
        if left_ns <= _WORTH_NS:
            return
        half_ns = self.probe.gate.now_ns() + left_ns // 2
        self.probe.wait(left_ns // 4)
        self._look_changing()
        if frame:
            self._send_aside(frame)
        if self._from_rest:
            self.probe.wait(half_ns - self.probe.gate.now_ns())
            self.look(self.dialect.by_verb[Verb.READ_POSITION])

    def _look_changing(self) -> None:
        """Look at what tells how the speed changes."""
        for verb in _CHANGING:
            if verb in self.dialect.by_verb:
                self.look(self.dialect.by_verb[verb])

    def _open_enabling(self, before: Mapping[str, int]) -> bool:
        now = self.twin.drive.settings
        return "axis_lock" not in now or before.get("work_mode") == now.get("work_mode")

    def _take_enabled(self) -> None:
        read = self.dialect.by_verb.get(Verb.READ_ENABLED)
        if read is not None:
            self._take({"enabled": self.probe.read(read)})

    def _steady(self, given: Mapping[str, int]) -> None:
        if self.dialect.ramp is not None:
            # A mode or fine subdivisions may let the shaft turn slower than was asked.
            motor: Any = getattr(self.twin.drive, "motor", None)
            before, self._rpm = self._rpm, motor.speed(self.twin.now_ns + _LONG_NS) if "rpm" in given else 0
            most = max(abs(self._rpm - before), abs(self._rpm) * self._rising)
            lasts_ns = most * ramp.step_ns(given.get("acceleration", QUICK)) * _SLOW
            self._rising = bool(given.get(LEAVE))
            if lasts_ns > _WORTH_NS:
                self._rising = True
                self.probe.wait(int(lasts_ns) // 3)
                self._look_changing()
                if given.get(ASIDE):
                    self._send_aside(given[ASIDE])
                lasts_ns *= 2 / 3
                self._rising = bool(given.get(LEAVE))
            if not self._rising:
                self.probe.wait(int(lasts_ns) + (_TREMBLES_NS if self.probe.noise.live else 2 * _SETTLES_NS))
            return
        last = motion.speed(self.probe).value
        for _ in range(40):
            self.probe.wait(60 * MS)
            now = motion.speed(self.probe).value
            if abs(now - last) < 0.5 + self.probe.noise.of("rpm", now):
                break
            last = now
        self._hear_nothing()

    # --- rest -----------------------------------------------------------------------------------------------------

    def _rest(self, *, watched: bool, lawful: bool) -> None:
        """Wait until both shafts stand, and compare what was said unasked meanwhile.

        `watched`: its end is not known. `lawful`: the manual says when it comes.
        """
        probe, twin = self.probe, self.twin
        self._hear_nothing()
        left_ns = 0.0
        if twin.turning or twin.drive.next_ns() is not None:
            begun_ns = twin.now_ns
            self._unasked.expect(twin.settle())
            left_ns = twin.now_ns - begun_ns
        missing = self._unasked.missing()
        until_ns = probe.gate.now_ns() + int(left_ns * _SLOW) + (_LATE_NS + 5 * probe.noise.latency_ns if missing > 0 else 0)
        while (now_ns := probe.gate.now_ns()) < until_ns and (missing > 0 or left_ns):
            heard = probe.listen(until_ns - now_ns, Until.REPLY if missing > 0 else Until.TIMEOUT)
            missing = self._unasked.missing()
            if missing <= 0 and heard.answers:
                break
        if self.dialect.ramp is None or watched:
            limit_ns = int(left_ns * (_SLOW - 1)) + 2 * _LATE_NS + 5 * probe.noise.latency_ns
            self._watch(limit_ns if lawful and self.dialect.ramp is not None and not twin.turning else _REST_NS)
        probe.wait(_TREMBLES_NS if probe.noise.live or probe.noise.lag else _SETTLES_NS)
        self._anchor()
        if self._unasked.missing() > 0:
            probe.listen(_BEHIND_NS)
        if (different := self._unasked.taken(self._left)) is not None:
            self._refute("what is said at the end of a motion", *different)

    def _watch(self, limit_ns: int) -> None:
        try:
            motion.wait_standing(self.probe, limit_ns=limit_ns)
        except Inconclusive:
            rpm = motion.speed(self.probe).value
            if abs(rpm) > _TURNS_RPM + self.probe.noise.rpm:
                self._refute("the shaft does not come to rest", "0 rpm", f"{rpm:.3g} rpm")
            raise

    def _hear_nothing(self) -> None:
        """Let the twin be where time is."""
        self._unasked.expect(self.twin.wait(self._twin_ns(self.probe.gate.now_ns())))

    def _twin_ns(self, t_ns: int) -> int:
        return t_ns + self._shift_ns

    def _anchor(self) -> None:
        """Take it that both drives are now at the same time."""
        self._shift_ns = max(self._shift_ns, self.twin.now_ns - self.probe.gate.now_ns())

    def _place(self, *, anywhere: bool) -> None:
        """Let the shaft of the twin be where that of the drive is."""
        for verb in (Verb.READ_POSITION, Verb.READ_PULSES):
            command = self.dialect.by_verb.get(verb)
            if command is None:
                continue
            answer, told = self._asked(command)
            if answer is None or told is None:
                return
            if not anywhere and (away := self._different(command, answer, told, _LETS_GO)):
                if self._explained(command, answer, away):
                    continue
                self._refute_read(command, answer, told, away)
            if verb is Verb.READ_PULSES and self._pulses_agree(answer, command):
                continue
            self._take(dict(answer.values))
        self._loose = False

    def _take(self, values: dict[str, int]) -> None:
        self.twin.change(lambda drive: drive.stand(values))

    def _pulses_agree(self, answer: Answer, command: Command) -> bool:
        """Say whether the twin counts pulses as the drive does; it knows parts of a pulse, which stay then."""
        drive: Any = self.twin.drive
        degrees = _degrees(drive, command.reply_forms[0].layout.named["pulses"])
        if abs(answer.values["pulses"] - drive.pulses) * degrees <= self.probe.within("degrees") + degrees:
            return True
        self._pulse_degrees = degrees
        return False

    def _rescaled(self, before: float) -> None:
        """Let the twin count pulses as the drive does: what either was off counts anew. `before`: degrees of a pulse."""
        command = self.dialect.by_verb.get(Verb.READ_PULSES)
        if command is None or self.twin.turning:
            return
        answer, told = self._asked(command)
        if answer is None or told is None or answer.values == told.values:
            return
        away = abs(answer.values["pulses"] - told.values["pulses"])
        if away > self.probe.within("degrees") / before + 1:
            self._refute_read(command, answer, told, ["pulses"])
        self._take({"pulses": answer.values["pulses"]})
        self._pulse_degrees = _degrees(self.twin.drive, command.reply_forms[0].layout.named["pulses"])

    # --- looks ----------------------------------------------------------------------------------------------------

    def _asked(self, command: Command, values: Mapping[str, int] | None = None) -> tuple[Answer | None, Told | None]:
        for asked in range(1, _ASKED + 1):
            exchange = self.probe.ask(command, values, quiet_ns=0)
            # One reply may be lost; what the line damages tells nothing.
            if exchange.is_read or (asked > 1 and not exchange.damaged):
                break
            self._lossy = True
        assert exchange.sent is not None
        told = self.twin.hear(exchange.sent, self._twin_ns(exchange.sent_ns), reads=True)
        return exchange.reply if exchange.is_read else None, self._told(command, told)

    def _told(self, command: Command, told: list[Told]) -> Told | None:
        self._unasked.expect(told)
        return next((t for t in told if t.command.name == command.name), None)

    def look(self, command: Command, values: Mapping[str, int] | None = None) -> None:
        """Ask a read and compare. Raises Refuted."""
        answer, told = self._asked(command, values)
        if answer is None or told is None:
            if (answer is None) != (told is None):
                self._unanswered(command, answer)
            return
        different = self._different(command, answer, told)
        if not different:
            return
        # A shaft that turns is elsewhere later on, where its place may be the right one again.
        at_once = self._changing and self._only_passing(command, different)
        for wait_ns in _AT_ONCE_NS if at_once else _AGAIN_NS:
            self.probe.wait(wait_ns)
            answer, told = self._asked(command, values)
            different = self._different(command, answer, told) if answer is not None and told is not None else []
            if answer is None or told is None or not different or self._explained(command, answer, different):
                return
        self._refute_read(command, answer, told, different)

    @property
    def _changing(self) -> bool:
        """Whether the shaft turns, at a speed that changes, or to a place."""
        return self.dialect.ramp is not None and self.twin.turning and (not self.running or self._rising)

    def _only_passing(self, command: Command, different: Iterable[str]) -> bool:
        fields = command.reply_forms[0].layout.named
        units = _PLACES | _SPEEDS if self._from_rest else _SPEEDS
        return all(name in fields and (fields[name].unit in units or name in _OF_MOTION) for name in different)

    def _compare_reply(self, command: Command, exchange: Exchange, told: list[Told]) -> None:
        first = exchange.reply
        # A stop has the code of its motion: whose status it is the analyzer may leave open.
        alike = first is not None and first.is_whole and first.command is not None and first.command.code == command.code
        reply, wanted = first if exchange.is_read or alike else None, self._told(command, told)
        if (reply is None) != (wanted is None):
            if exchange.damaged:
                # What the drive did shows in what is read next.
                return
            if exchange.reply is not None and reply is None:
                raise Inconclusive(f"the reply to {command.name} cannot be read")
            if reply is None:
                more = self.probe.listen(self.probe.rig.late_ns, Until.REPLY)
                if more.answers or more.junk:
                    raise Inconclusive(f"the reply to {command.name} is late")
            self._unanswered(command, reply, exchange)
        elif reply is not None and wanted is not None and command.code not in self._unasked.codes:
            away = self._different(command, reply, wanted)
            if away and not self._explained(command, reply, away):
                self._refute_read(command, reply, wanted, away, exchange)

    # --- comparing ------------------------------------------------------------------------------------------------

    def _different(
        self, command: Command, answer: Answer, told: Told, spare: float = 0.0, twin: Twin | None = None
    ) -> list[str]:
        """Return the fields in which a reply differs from that of the twin."""
        if answer.data == told.data:
            return []
        form = answer.message.form
        assert form is not None  # it can be read
        if not answer.values or not answer.values.keys() <= told.values.keys():
            return [] if answer.bare else ["the reply"]
        twin = twin or self.twin
        # On its way a shaft is between those before it and behind it.
        others = [t.values for each in twin.between for t in each if t.command.name == command.name]
        every = [told.values, *(values for values in others if answer.values.keys() <= values.keys())]
        reserved = [_RESERVED] * any(v.rule == _RESERVED for v in answer.message.violations)
        return reserved + [
            name
            for name, field in form.layout.named.items()
            if (command.name, name) not in self._own
            and field.unit not in _UNPROMISED
            and name not in _UNPROMISED_FIELDS
            and not (name == "enabled" and self._by_pin(twin))
            and not self._same(command, field, answer.values, every, spare, twin.drive)
        ]

    def _by_pin(self, twin: Twin) -> bool:
        """Say whether a pin of unknown level enables the motor, as one does in pulse modes."""
        drive: Any = twin.drive
        return _EN_LEVEL in self._untold and Verb.SET_ENABLE_LEVEL in self.dialect.by_verb and not drive.by_bus

    def _same(
        self, command: Command, field: Field, got: Mapping[str, int], every: list[Mapping[str, int]], spare: float, drive: Any
    ) -> bool:
        """Say whether a field is what one of the drives tells, or between them."""
        name, turning, known = field.name, drive.rest.since_ns < 0, self.dialect.ramp is not None
        if any(got[name] == values[name] for values in every) and name != "carry":
            return True
        if field.unit in _SPEEDS:
            steady = self.running and not self._rising and command.motion is None
            if turning and not steady and (not known or self.probe.noise.live):
                return True
            wanted = [_rpm(field, values[name]) for values in every]
            rpm = max(wanted, key=abs)
            within = self.probe.within("rpm", rpm) + abs(rpm) * 2 * CLOCK_SHARE + max(wanted) - min(wanted)
            return min(wanted) - within <= _rpm(field, got[name]) <= max(wanted) + within
        if field.unit in _PLACES:
            if turning and (not known or name == "angle_error"):
                return True
            if name == "encoder" and "carry" in got:
                return True
            degrees, turn = _degrees(drive, field), drive.counts_per_turn
            aways = [(got[name] - values[name]) * degrees for values in every]
            if name == "carry":
                aways = [a + (got["encoder"] - v["encoder"]) * 360 / turn for a, v in zip(aways, every, strict=True)]
                degrees = 360 / turn
            elif name in _IN_TURN:
                aways = [(away + 180) % 360 - 180 for away in aways]
                # The twin's shaft is where the position says, which each drive counts from where it was when it was named.
                spare += self.probe.noise.place
            gone_ns = self.twin.now_ns - self._begun_ns if turning else 0
            spare += self._pace * gone_ns / 1e9 * CLOCK_SHARE
            within = self.probe.within("degrees") + degrees + spare + self._pulse_degrees + (max(aways) - min(aways)) * 0.5
            return bool(min(aways) - within <= 0 <= max(aways) + within)
        return name in _OF_MOTION and turning and not known and not self.running

    # --- refuting -------------------------------------------------------------------------------------------------

    def _explained(self, command: Command, answer: Answer, different: list[str]) -> bool:
        """Say whether a known quirk, which other claims name, explains a reply; the twin has it from now on."""
        exchange = self.probe.traffic[-1]
        assert exchange.sent is not None
        for other in self.twin.with_quirks():
            told = next((t for t in other.hear(exchange.sent, self.twin.now_ns) if t.command.name == command.name), None)
            if told is not None and not set(self._different(command, answer, told, twin=other)) & set(different):
                self.twin = other
                return True
        return False

    def _unanswered(self, command: Command, answer: Answer | None, exchange: Exchange | None = None) -> None:
        expected, got = ("silence", "a reply") if answer is not None else ("a reply", "silence")
        self._refute(f"{command.name} is {'' if answer is not None else 'not '}answered", expected, got, exchange)

    def _refute_read(
        self, command: Command, answer: Answer, told: Told, different: list[str], exchange: Exchange | None = None
    ) -> None:
        def text(values: Mapping[str, Any], data: bytes) -> str:
            shown = ", ".join(f"{n} {values[n]}" for n in different if n in values)
            return f"{shown or 'another reply'} ({data.hex(' ').upper()})"

        what = f"{command.name}: {' and '.join(different)}"
        self._refute(what, text(told.values, told.data), text(answer.values, answer.data), exchange, command)

    def _refute(
        self, what: str, expected: str, got: str, exchange: Exchange | None = None, command: Command | None = None
    ) -> None:
        raise Refuted(
            f"after {len(self.steps)} steps: {what}",
            expected=f"{expected}{f', by {command.section}' if command else ''}",
            got=f"{got}, after {steps_text(self.steps)}",
            exchange=exchange or (self.probe.traffic[-1] if self.probe.traffic else None),
            key=f"state: {what} after {next((step.name for step in reversed(self.steps) if step.name != LOOK), 'nothing')}",
        )


#: At which level of its pin a motor is enabled in pulse modes.
_EN_LEVEL = "enable_level"
_UNPROMISED_FIELDS = frozenset(
    {"power", "torque_current", "phase_a_current", "phase_b_current", "phase_c_current", "temperature", "current"}
)
#: Angles within the turn, and what is told of a shaft that turns.
_IN_TURN = frozenset({"encoder", "encoder_raw", "angle"})
_OF_MOTION = frozenset({"status", "pend"})


def _rpm(field: Field, value: int) -> float:
    return float(field.physical(value)) / (6 if field.unit == "deg/s" else 1)


def _degrees(drive: Any, field: Field) -> float:
    """Return the degrees of one as sent."""
    if field.unit == "deg":
        return float(field.scale)
    if field.unit == "pulses":
        return 360 / (200 * int(drive.subdivision))
    return 360.0 if field.unit == "turns" else 360 / int(drive.counts_per_turn)
