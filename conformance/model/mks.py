"""The model of an MKS drive: mode, settings, enabled, moving, position; what each step is answered and what follows.

    pulse modes     enabling, motion and what needs a bus mode are refused
    bus modes       disabled: motion is refused; enabled: it begins (1), and ends (2) where the dialect tells the end
    respond 0       motion is not answered         active 0     its end is not told

Rules kept here:
- Positions are counts of the encoder since the last zero. A relative move by pulses goes by pulses x 16384 / (200 x
  subdivision); which way its direction bit means is learnt from the first one, and then it must keep to it.
- After a change of mode nobody can say whether the motor is enabled (CAN: `axis_lock` says it): the model asks.
- A stop, a run that was ended and a motor that was let go leave the shaft where it comes to rest: the model asks.
- What a setting does to a motion under way is not said: such settings are given to a shaft that stands.
- Values are those of the catalogue; a setting outside them is refused and changes nothing.

Not modelled: limits and homing (nobody knows where a real drive has its switches), the ramp, the link.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN, MODE_MAXIMUM_SPEEDS
from conformance.claims.answers import Taken, judged, once, refusable
from conformance.claims.effects import LINK_FIELDS, pulse_counts
from conformance.claims.restarts import restart
from conformance.model.session import Session
from conformance.motion import motion as moving
from conformance.motion import moves, ramp
from conformance.motion.motion import MS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Until

if TYPE_CHECKING:
    pass

#: Counts by which a position may be off, and the share and rpm by which a speed may.
PLAY, SPEED_SHARE, SPEED_PLAY = 30, 0.03, 2.0
#: Nothing is said of F1 until so long after a motion.
QUIET_NS = 1_200 * MS


class MksSession(Session):
    """One MKS drive and its model.

    `mode`: the work mode by name. `enabled`: None where nobody can say. `running`: rpm of the shaft, signed; `at`: counts,
    None while they are not known. `held`: settings by field, as far as they are known.
    """

    mode: str
    enabled: bool | None
    running: float
    at: int | None
    held: dict[str, int]

    # --- begin and end --------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Set a bus mode, 16 subdivisions and both replies, enable, stop, and make this place zero."""
        probe, verbs = self.probe, self.dialect.by_verb
        self.ways: dict[tuple[str, int], int] = {}
        self.quiet_from_ns = 0
        self.mode = moving.bus_modes(self.dialect)[-1]
        moving.set_mode(probe, self.mode)
        probe.do(Verb.ENABLE, {"enabled": 1})
        self.held = {"subdivision": moves.SUBDIVISION, "motor_direction": 0}
        probe.do(Verb.SET_SUBDIVISION, {"subdivision": moves.SUBDIVISION})
        probe.do(Verb.SET_DIRECTION, {"motor_direction": 0})
        if Verb.SET_RESPOND in verbs:
            probe.do(Verb.SET_RESPOND, {"respond": 1, "active": 1})
            self.held |= {"respond": 1, "active": 1}
        moving.stand_still(probe)
        probe.do(Verb.SET_ZERO)
        for command in self.dialect.commands:
            if command.readable:
                self.held |= self._stored(command) or {}
        self.held["work_mode"] = self._code(self.mode)
        self.enabled, self.running, self.at = True, 0.0, 0
        self.compare()

    def end(self) -> None:
        """Stop, and leave the replies to motion on."""
        if "respond" in self.held:
            self.probe.ask(Verb.SET_RESPOND, {"respond": 1, "active": 1})
        if self.by_bus:
            # The end of a stop is told unasked: a request that is sent meanwhile would collide with it.
            self.probe.ask(Verb.STOP_SPEED, {"acceleration": moving.GENTLE}, until=Until.DONE, timeout_ns=5_000 * MS)
        moving.wait_standing(self.probe)

    def _code(self, mode: str) -> int:
        return moving.choice(self.dialect.by_verb[Verb.SET_WORK_MODE], "work_mode", mode)

    @property
    def by_bus(self) -> bool:
        """Whether the bus moves the motor."""
        return self.mode in moving.bus_modes(self.dialect)

    @property
    def ready(self) -> bool:
        """Whether motion begins. Asks the drive where nobody can say."""
        if self.by_bus and self.enabled is None:
            self.enabled = bool(self.probe.read(Verb.READ_ENABLED))
        return self.by_bus and bool(self.enabled)

    def _stored(self, command: Command) -> dict[str, int] | None:
        """Return what a parameter read says of a setting, None where it cannot be read."""
        exchange = self.probe.ask(Verb.READ_PARAMETER, {"parameter": command.code}, quiet_ns=0)
        answer = self.probe.reply(exchange)
        if self.probe.refused(exchange):
            return None
        return {n: int(v) for n, v in answer.values.items() if n in command.request_forms[0].layout.named}

    # --- comparing ------------------------------------------------------------------------------------------------

    def compare(self) -> None:
        """Compare position, speed and enabled with the model."""
        probe = self.probe
        speed = probe.read(Verb.READ_SPEED)
        if abs(abs(speed) - abs(self.running)) > SPEED_PLAY + SPEED_SHARE * abs(self.running):
            raise self.differs("the speed", f"{abs(self.running):.0f} rpm", f"{abs(speed)} rpm")
        if not self.running:
            position = probe.read(Verb.READ_POSITION)
            if self.at is None:
                self.at = position
            elif abs(position - self.at) > PLAY:
                raise self.differs("the position", f"{self.at} counts", f"{position} counts")
        if self.by_bus and self.enabled is not None:
            enabled = probe.read(Verb.READ_ENABLED)
            if enabled != int(self.enabled):
                raise self.differs("enabled", int(self.enabled), enabled)

    # --- settings -------------------------------------------------------------------------------------------------

    def _set(self, command: Command, values: Mapping[str, int]) -> None:
        """Set values, allowed or not, and see to it that they are taken or refused, and read as they should."""
        probe = self.probe
        form = next(f for f in command.request_forms if values.keys() == f.layout.named.keys())
        allowed = all(f.allows(values[n]) for n, f in form.layout.named.items())
        allowed = allowed and (not command.modes or self.by_bus)
        exchange = probe.ask(command, values, form=form)
        taken = judged(probe, exchange)
        if taken is not (Taken.DONE if allowed else Taken.REFUSED):
            raise self.differs(
                f"{command.name} is {taken.value}", Taken.DONE.value if allowed else Taken.REFUSED.value, taken.value, exchange
            )
        before = dict(self.held)
        if allowed:
            self.held |= values
            self._follow(command, before)
        if command.readable:
            self._reads(command, exchange)

    def _reads(self, command: Command, exchange: Exchange | None) -> None:
        """See to it that a setting that can be read reads as it should."""
        wrong = {n: v for n, v in (self._stored(command) or {}).items() if self.held.get(n, v) != v}
        if wrong:
            raise self.differs(f"{command.name} reads", {n: self.held[n] for n in wrong}, wrong, exchange)

    def _follow(self, command: Command, before: Mapping[str, int]) -> None:
        """Take over what else a setting changes."""
        if command.verb is Verb.SET_WORK_MODE:
            same = before.get("work_mode") == self.held["work_mode"]
            names = command.request_forms[0].layout.named["work_mode"].choice_names
            self.mode = names[self.held["work_mode"]]
            self._rest()
            lock = self.held.get("axis_lock")
            self.enabled = None if lock is None or same else bool(lock)
        elif command.verb is Verb.SET_DIRECTION:
            self.ways = {}

    def _setting(self, command: int, **values: int) -> None:
        self._set(self._at(command), values)

    _telling = _stray = _setting

    def _at(self, code: int) -> Command:
        return next(c for c in settable(self) if c.code == code)

    def _user_id(self, user_id: int) -> None:
        self.probe.do(Verb.WRITE_USER_ID, {"user_id": user_id})
        got = self.probe.read(Verb.READ_USER_ID)
        if got != user_id:
            raise self.differs("the user's number", user_id, got)

    def _restart(self) -> None:
        restart(self.probe)
        self.running, self.at, self.enabled = 0.0, None, None
        moving.wait_standing(self.probe)
        for command in self.dialect.commands:
            if command.readable:
                self._reads(command, None)

    # --- enabling and stopping ------------------------------------------------------------------------------------

    def _answered(self, exchange: Exchange, expected: Taken, what: str) -> None:
        taken = judged(self.probe, exchange)
        if taken is not expected:
            raise self.differs(f"{what} is {taken.value}", expected.value, taken.value, exchange)

    def _enable(self, enabled: int) -> None:
        exchange = self.probe.ask(Verb.ENABLE, {"enabled": enabled})
        self._answered(exchange, Taken.DONE if self.by_bus else Taken.REFUSED, f"enable {enabled}")
        if self.by_bus:
            self.enabled = bool(enabled)
            if not enabled:
                self._rest()
                self.at = None

    def _emergency_stop(self) -> None:
        exchange = self.probe.ask(Verb.EMERGENCY_STOP)
        self._answered(exchange, Taken.DONE, "emergency_stop")
        self._rest()

    def _stop(self, motion: int, acceleration: int) -> None:
        """Stop by the stop of one of the motions."""
        verb = list(moves.STOP_OF.values())[motion]
        self._told(self._motion(verb, {"acceleration": acceleration}), self.ready, verb.value)
        self._rest()

    def _rest(self) -> None:
        """Take it that the shaft comes to rest somewhere."""
        if self.running:
            self.standing_at(None)
        self.running = 0.0
        self.quiet_from_ns = self.probe.gate.now_ns()

    def standing_at(self, counts: int | None) -> None:
        """Wait until the shaft stands; `counts`: where that should be, None: wherever."""
        self.standing()
        self.running, self.at = 0.0, counts
        self.quiet_from_ns = self.probe.gate.now_ns()

    # --- motion ---------------------------------------------------------------------------------------------------

    def _motion(self, verb: Verb, values: Mapping[str, Any], counts: int = 0) -> Exchange:
        """Ask for a motion and listen until it has said all that it will; `counts`: how far it goes."""
        respond, active = self.held.get("respond", 1), self.held.get("active", 1)
        tells = moves.tells(self.dialect) and verb is not Verb.RUN_SPEED
        lasts_ns = 0.0
        if counts:
            lasts_ns = ramp.move_ns(counts / COUNTS_PER_TURN, self._real(values["speed"]), values["acceleration"])
        elif self.running:
            lasts_ns = ramp.ramp_ns(self.running, 0, values["acceleration"])
        # Where the end is not to be told, it is listened for until it is over.
        until = Until.REPLY if not tells else Until.DONE if respond and active else Until.TIMEOUT
        if not respond:
            until = Until.TIMEOUT
        timeout_ns = {Until.TIMEOUT: int(lasts_ns) + 500 * MS, Until.DONE: int(lasts_ns) + 8_000 * MS}.get(until)
        return self.clean(self.probe.ask(verb, values, until=until, timeout_ns=timeout_ns))

    def _told(self, exchange: Exchange, ready: bool, what: str) -> None:
        """Compare the replies to a motion with those that it should get."""
        respond, active = self.held.get("respond", 1), self.held.get("active", 1)
        command = exchange.command
        assert command is not None  # it was asked for
        if not respond:
            expected: list[int] = []
            seen = exchange.status()
        elif command.replies.interim and moves.tells(self.dialect):
            expected = ([1, 2] if active else [1]) if ready else [0]
            seen = once(exchange.status())
            # Real drives were seen to answer late while they move, even behind the end of it.
            if len(seen) < len(expected):
                seen += self.probe.listen(LATE_NS).status()
            if sorted(seen) == expected:
                seen = expected
        else:
            seen = [int(judged(self.probe, exchange) is Taken.DONE)] if exchange.answers else []
            expected = [int(ready)]
        if seen != expected:
            if len(seen) < len(expected):
                self.sound()
            raise self.differs(f"{what} is answered {_statuses(seen)}", _statuses(expected), _statuses(seen), exchange)

    def _run_speed(self, direction: int, speed: int, acceleration: int) -> None:
        ready = self.ready
        exchange = self._motion(Verb.RUN_SPEED, {"direction": direction, "speed": speed, "acceleration": acceleration})
        self._told(exchange, ready, "run_speed")
        if not ready:
            return
        rpm = self._real(speed)
        self.probe.wait(int((abs(self.running) + rpm) * (256 - acceleration) * 50_000) + SETTLE_SPEED_NS)
        seen = moving.speed(self.probe).value
        self.running, self.at = rpm, None
        if abs(seen) >= 1:
            way = self._way("run_speed", direction, 1 if seen > 0 else -1)
            if way * seen < 0:
                raise self.differs(f"run_speed with direction {direction} turns", "as before", "the other way", exchange)

    def _real(self, speed: int) -> float:
        highest = MODE_MAXIMUM_SPEEDS.get(self.mode, 3000)
        subdivision = self.held["subdivision"] or 256
        return min(speed, highest) * (1.0 if subdivision in (16, 32, 64) else 16 / subdivision)

    def _way(self, name: str, direction: int, seen: int) -> int:
        """Return which way a direction means; learnt from the first motion, the other direction is the opposite."""
        if (name, direction) not in self.ways:
            self.ways[name, direction], self.ways[name, 1 - direction] = seen, -seen
        return self.ways[name, direction]

    def _move_relative_pulses(self, pulses: int, speed: int, acceleration: int) -> None:
        values = {"direction": int(pulses < 0), "pulses": abs(pulses), "speed": speed, "acceleration": acceleration}
        self._move(Verb.MOVE_RELATIVE_PULSES, values, pulse_counts(abs(pulses), self.held["subdivision"]), int(pulses < 0))

    def _move_absolute_pulses(self, pulses: int, speed: int, acceleration: int) -> None:
        start = self.probe.read(Verb.READ_PULSES)
        self._note(start)
        values = {"position": start + pulses, "speed": speed, "acceleration": acceleration}
        self._move(Verb.MOVE_ABSOLUTE_PULSES, values, pulse_counts(abs(pulses), self.held["subdivision"]), int(pulses < 0))

    def _move_relative_axis(self, counts: int, speed: int, acceleration: int) -> None:
        values = {"position": counts, "speed": speed, "acceleration": acceleration}
        self._move(Verb.MOVE_RELATIVE_AXIS, values, counts, None)

    def _move_absolute_axis(self, counts: int, speed: int, acceleration: int) -> None:
        start = self.probe.read(Verb.READ_POSITION) if self.at is None else self.at
        self._note()
        values = {"position": start + counts, "speed": speed, "acceleration": acceleration}
        self._move(Verb.MOVE_ABSOLUTE_AXIS, values, counts, None)

    def _note(self, pulses: int | None = None) -> None:
        """Tell the gate where the shaft is, so that it can say how far a move to a place goes."""
        probe = self.probe
        probe.gate.note_position(moving.position(probe).value, probe.address, pulses)

    def _move(self, verb: Verb, values: Mapping[str, int], counts: int, direction: int | None) -> None:
        """Move a standing shaft by counts; `direction`: of a move by pulses, whose way is learnt."""
        ready = self.ready
        start = self.probe.read(Verb.READ_POSITION) if self.at is None else self.at
        exchange = self._motion(verb, values, counts)
        self._told(exchange, ready, verb.value)
        if not ready:
            return
        self.standing()
        if direction is not None:
            gone = self.probe.read(Verb.READ_POSITION) - start
            if abs(gone) > PLAY:
                counts *= self._way(verb.value, direction, 1 if gone > 0 else -1)
        self.at, self.running = start + counts, 0.0
        self.quiet_from_ns = self.probe.gate.now_ns()

    # --- looking --------------------------------------------------------------------------------------------------

    def _set_zero(self) -> None:
        self._answered(self.probe.ask(Verb.SET_ZERO), Taken.DONE, "set_zero")
        self.at = 0

    def _look(self) -> None:
        """Read what else there is, once the motor has been let alone for a while."""
        probe = self.probe
        probe.wait(self.quiet_from_ns + QUIET_NS - probe.gate.now_ns())
        status = probe.read(Verb.READ_STATUS)
        expected = 4 if self.running else 1
        if self.by_bus and status != expected:
            raise self.differs("F1", expected, status)
        protected = probe.read(Verb.READ_PROTECTION)
        if protected:
            raise self.differs("3E", 0, protected)
        if not self.running:
            parts = probe.reply(probe.ask(Verb.READ_ENCODER_CARRY)).values
            whole = parts["carry"] * COUNTS_PER_TURN + parts["encoder"]
            if self.at is not None and abs(whole - self.at) > PLAY:
                raise self.differs("30", self.at, whole)


#: How late a reply during motion was seen to come.
LATE_NS = 800 * MS
#: After a ramp a real motor takes so long to come to its speed.
SETTLE_SPEED_NS = 250 * MS


def _statuses(seen: list[int]) -> str:
    return " then ".join(map(str, seen)) or "by silence"


def settable(session: MksSession) -> list[Command]:
    """Return the settings that a session may set: none of the link, of power-on or of the flash."""
    found = []
    for command in session.dialect.commands:
        named = command.request_forms[0].layout.named
        stored = command.verb.value.startswith("set_") and bool(named) and refusable(command)
        if not stored or set(named) & (LINK_FIELDS | {"group_address", "execute"}) or command.verb is Verb.SET_ZERO_MODE:
            continue
        if command.all_risks <= session.probe.rig.allowed:
            found.append(command)
    return found
